"""From the radiance that leaves the plate to the irradiance on the sensor: distortion, falling light, blur.

Relative illumination as pure functions (blur in :mod:`evanesce.sensor.blur`), and one adapter,
:func:`form_image`, that reads a :class:`~evanesce.rig.Camera` and keeps the maps of the last few cameras.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from evanesce.core.states import PlateLight, SensorLight
from evanesce.optics.projection import IdealView, Projection
from evanesce.rig import Camera, Plate
from evanesce.sensor.blur import FieldBlur, blur, defocus_disc, field_blur, psf_kernel

Array = NDArray[np.float64]


# --- relative illumination -------------------------------------------------------------------------------------------


def magnification(scale_px_per_mm: float, pitch_um: float) -> float:
    """Return image size over object size on the optical axis: pixels per millimetre times millimetres per pixel.

    Parameters
    ----------
    scale_px_per_mm : float
        On the contact plane [px/mm].
    pitch_um : float
        Of the pixels [um].
    """
    return scale_px_per_mm * pitch_um * 1e-3


def working_f_number(f_number: float, magnification: float) -> float:
    """Return the f-number of the image-side cone, N (1 + m), of a thin lens with its stop at the lens.

    Parameters
    ----------
    f_number : float
        N [1].
    magnification : float
        m [1].

    References
    ----------
    Kingslake, "Optics in Photography", SPIE Press (1992).
    """
    return f_number * (1.0 + magnification)


def distortion_jacobian(x: ArrayLike, y: ArrayLike, coefficients: tuple[float, float, float, float, float]) -> Array:
    """Return the factor by which distortion scales areas, d(x_d, y_d)/d(x, y), at undistorted directions (x, y, 1).

    Parameters
    ----------
    x, y : array_like
        Normalised coordinates before distortion [1].
    coefficients : tuple of float
        k1, k2, p1, p2, k3 in OpenCV's order.
    """
    x, y = np.asarray(x, float), np.asarray(y, float)
    k1, k2, p1, p2, k3 = coefficients
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    slope = 2 * (k1 + r2 * (2 * k2 + r2 * 3 * k3))  # d(radial)/dx = slope x, and in y likewise
    xx = radial + slope * x * x + 2 * p1 * y + 6 * p2 * x
    yy = radial + slope * y * y + 6 * p1 * y + 2 * p2 * x
    cross = slope * x * y + 2 * p1 * x + 2 * p2 * y
    return np.asarray(xx * yy - cross * cross)


def irradiance_per_radiance(
    x: ArrayLike, y: ArrayLike, *, f_number: float, magnification: float, transmittance: float
) -> Array:
    """Return E/L [sr] of an undistorted lens: E = pi L T cos^4(theta) / (4 N^2 (1 + m)^2).

    Parameters
    ----------
    x, y : array_like
        Direction (x, y, 1) of the chief ray from the optical axis [1]; cos(theta) = 1/sqrt(1 + x^2 + y^2).
    f_number : float
        Focal length over entrance pupil, as engraved [1].
    magnification : float
        Image size over object size on the axis [1].
    transmittance : float
        Of the lens [1].

    References
    ----------
    Reiss, "The cos^4 law of illumination", J. Opt. Soc. Am. 35 (1945) 283; for the factor (1 + m)^2 Kingslake,
    "Optics in Photography", SPIE Press (1992).
    """
    cos2 = 1.0 / (1.0 + np.asarray(x, float) ** 2 + np.asarray(y, float) ** 2)
    axis = math.pi * transmittance / (4.0 * working_f_number(f_number, magnification) ** 2)
    return np.asarray(axis * cos2 * cos2)


def field_radius2(shape: tuple[int, int], centre: tuple[float, float]) -> Array:
    """Return squared distance from ``centre`` (x, y) [px] over that of the farthest corner pixel: 0 to 1.

    Parameters
    ----------
    shape : tuple of int
        (rows, cols).
    centre : tuple of float
        [px].

    Returns
    -------
    ndarray (rows, cols)
    """
    rows, cols = shape
    u2 = (np.arange(cols) - centre[0]) ** 2
    v2 = (np.arange(rows) - centre[1]) ** 2
    farthest = max(u2[0], u2[-1]) + max(v2[0], v2[-1])
    return np.asarray((v2[:, None] + u2[None, :]) / farthest)


def vignetting(shape: tuple[int, int], centre: tuple[float, float], k: float) -> Array:
    """Return the share of light left by vignetting beyond cos^4: 1 - k rho^2, rho = 1 at the farthest corner.

    Parameters
    ----------
    shape, centre
        As for :func:`field_radius2`.
    k : float
        [1].

    Returns
    -------
    ndarray (rows, cols)
    """
    return np.asarray(1.0 - k * field_radius2(shape, centre))


# --- adapter ---------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class PreparedLens:
    """What one camera does to every frame."""

    maps: tuple[tuple[NDArray[np.float32], NDArray[np.float32]], ...]
    gain: Array
    spread: FieldBlur | None


def form_image(
    light: PlateLight, camera: Camera, plate: Plate, *, distortion: bool = True, blurred: bool = True
) -> SensorLight:
    """Image the light of an ideal pinhole view onto the sensor.

    Parameters
    ----------
    light : PlateLight
        Radiance [W mm^-2 sr^-1] on any pinhole grid that covers the frame.
    camera : Camera
    plate : Plate
        Its refraction is already in ``light``; it only positions the camera.
    distortion, blurred : bool
        False leaves the lens's distortion, or its defocus and diffraction, out: for the split of an error.

    Returns
    -------
    SensorLight
        Mean irradiance of each pixel [W mm^-2].

    Raises
    ------
    ValueError
        If ``light`` does not cover the frame.

    Notes
    -----
    Light is conserved through distortion: where the lens squeezes the image, the irradiance rises by the inverse of
    :func:`distortion_jacobian`, because the entrance pupil takes in the same flux. cos^4 alone holds only for a lens
    without distortion (Reiss, "The cos^4 law of illumination", J. Opt. Soc. Am. 35 (1945) 283).
    """
    rows, cols = light.radiance.shape
    view = IdealView((rows, cols), light.focal_px, light.principal_point)
    prepared = _prepare(camera, plate, view, distortion, blurred)
    radiance = np.asarray(light.radiance)
    seen = np.zeros(prepared.gain.shape)
    for x, y in prepared.maps:
        seen += cv2.remap(radiance, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    irradiance = seen * prepared.gain
    return SensorLight(irradiance=irradiance if prepared.spread is None else blur(irradiance, prepared.spread))


def prepared_lens(camera: Camera, plate: Plate, view: IdealView) -> PreparedLens:
    """Return what a camera does to light on a pinhole view: remap maps, gain [sr] and blur, as form_image uses them.

    Parameters
    ----------
    camera : Camera
    plate : Plate
    view : IdealView
    """
    return _prepare(camera, plate, view, True, True)


@functools.lru_cache(maxsize=4)  # a fit looks through pixels of three sizes
def _prepare(camera: Camera, plate: Plate, view: IdealView, distortion: bool, blurred: bool) -> PreparedLens:
    projection = Projection.of(camera, plate)
    if not distortion:
        projection = replace(projection, distortion=(0.0, 0.0, 0.0, 0.0, 0.0))
    maps, direction = _maps(
        projection.shape, projection.focal_px, projection.principal_point, projection.distortion, view
    )
    lens = camera.lens
    m = magnification(camera.scale_px_per_mm, camera.pixel.pitch_um)
    gain = irradiance_per_radiance(
        *direction, f_number=lens.f_number, magnification=m, transmittance=lens.transmittance
    )
    gain /= np.abs(distortion_jacobian(*direction, projection.distortion)) * len(maps)
    gain *= vignetting(projection.shape, projection.principal_point, lens.vignetting_k)
    return PreparedLens(maps, gain, lens_blur(camera, plate) if blurred else None)


def lens_blur(camera: Camera, plate: Plate) -> FieldBlur:
    """Return the blur of a camera's focus and diffraction.

    Parameters
    ----------
    camera : Camera
    plate : Plate
    """
    projection, lens = Projection.of(camera, plate), camera.lens
    m = magnification(camera.scale_px_per_mm, camera.pixel.pitch_um)
    pitch, number = camera.pixel.pitch_um, working_f_number(lens.f_number, m)
    curved = lens.field_curvature_um * field_radius2(projection.shape, projection.principal_point)
    disc_px = defocus_disc(lens.defocus_um + curved, number) / pitch
    wavelength_um = camera.wavelength_nm * 1e-3
    return field_blur(
        disc_px,
        lambda c: psf_kernel(pitch_um=pitch, wavelength_um=wavelength_um, f_number=number, disc_um=c * pitch),
    )


@functools.lru_cache(maxsize=12)  # another focus or fall-off bends no ray
def _maps(
    shape: tuple[int, int],
    focal_px: float,
    principal_point: tuple[float, float],
    distortion: tuple[float, float, float, float, float],
    view: IdealView,
) -> tuple[tuple[tuple[NDArray[np.float32], NDArray[np.float32]], ...], tuple[Array, Array]]:
    """Return remap maps, one per sub-sample of the pixel, and the undistorted direction of each pixel's centre.

    A frame pixel at the corner of a barrel lens covers more than one pixel of the ideal view; as many sub-samples as
    it covers, per side, keep the mean of the pixel a mean. Where nothing is distorted there is one, and it is exact.
    """
    # Where the camera stands bends no ray.
    projection = Projection(shape, focal_px, principal_point, distortion, np.eye(3), np.zeros(3), 0.0, 1.0)
    x, y = projection.ideal_maps(view)
    rows, cols = view.shape
    if min(x.min(), y.min()) < -0.5 or x.max() > cols - 0.5 or y.max() > rows - 0.5:
        raise ValueError(
            f"the light covers {cols} x {rows} pixels of the pinhole view, the frame reaches x {x.min():.1f} to"
            f" {x.max():.1f}, y {y.min():.1f} to {y.max():.1f}"
        )
    direction = tuple(
        (axis.astype(np.float64) - centre) / view.focal_px
        for axis, centre in ((x, view.principal_point[0]), (y, view.principal_point[1]))
    )
    x_v, x_u = np.gradient(x)
    y_v, y_u = np.gradient(y)
    covered = float(np.sqrt(np.maximum(x_u**2 + y_u**2, x_v**2 + y_v**2).max()))
    count = max(1, round(covered))
    offsets = (np.arange(count) + 0.5) / count - 0.5
    maps = tuple((x + dv * x_v + du * x_u, y + dv * y_v + du * y_u) for dv in offsets for du in offsets)
    return tuple((a.astype(np.float32), b.astype(np.float32)) for a, b in maps), (direction[0], direction[1])
