"""From the radiance that leaves the plate to the irradiance on the sensor: distortion, falling light, blur.

Three pure parts (relative illumination, point spread function, blur that varies over the field) and one adapter,
:func:`form_image`, that reads a :class:`~evanesce.rig.Camera` and keeps the maps of the last few cameras.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import j1

from evanesce.core.states import PlateLight, SensorLight
from evanesce.optics.projection import IdealView, Projection
from evanesce.rig import Camera, Plate

Array = NDArray[np.float64]

# The kernel reaches this many lambda*N beyond the geometric disc. The 2/(pi^2 * 8) = 2.5 % of an Airy pattern that
# falls outside is spread evenly within, so that no light is lost; stray light farther out is not modelled.
_DIFFRACTION_REACH = 8.0
_MAX_TRANSFORM = 4096  # finest grid of a kernel's transform; only discs far larger than the Airy pattern meet it
_ZONE_STEP_PX = 1.0  # disc diameters of neighbouring blur zones differ by at most this, unless there are too many
_MAX_ZONES = 10


# --- relative illumination -------------------------------------------------------------------------------------------


def magnification(scale_px_per_mm: float, pitch_um: float) -> float:
    """Return image size over object size on the optical axis: pixels per millimetre times millimetres per pixel."""
    return scale_px_per_mm * pitch_um * 1e-3


def working_f_number(f_number: float, magnification: float) -> float:
    """Return the f-number of the image-side cone, N (1 + m), of a thin lens with its stop at the lens.

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
    """Return squared distance from ``centre`` (x, y) [px] over that of the farthest corner pixel: 0 to 1."""
    rows, cols = shape
    u2 = (np.arange(cols) - centre[0]) ** 2
    v2 = (np.arange(rows) - centre[1]) ** 2
    farthest = max(u2[0], u2[-1]) + max(v2[0], v2[-1])
    return np.asarray((v2[:, None] + u2[None, :]) / farthest)


def vignetting(shape: tuple[int, int], centre: tuple[float, float], k: float) -> Array:
    """Return the share of light left by vignetting beyond cos^4: 1 - k rho^2, rho = 1 at the farthest corner."""
    return np.asarray(1.0 - k * field_radius2(shape, centre))


# --- point spread function -------------------------------------------------------------------------------------------


def diffraction_mtf(frequency: ArrayLike, wavelength_um: float, f_number: float) -> Array:
    """Return the modulation transfer of a perfect lens with a round pupil in incoherent light.

    Parameters
    ----------
    frequency : array_like
        Spatial frequency on the sensor [1/um].
    wavelength_um : float
        [um].
    f_number : float
        Working f-number [1]; the cut-off is 1/(lambda N).

    References
    ----------
    Goodman, "Introduction to Fourier Optics", 3rd ed. (2005), section 6.3.
    """
    s = np.clip(np.abs(np.asarray(frequency, float)) * wavelength_um * f_number, 0.0, 1.0)
    return np.asarray((2 / math.pi) * (np.arccos(s) - s * np.sqrt(1 - s * s)))


def disc_mtf(frequency: ArrayLike, diameter_um: float) -> Array:
    """Return the transfer (signed) of a uniform disc of light, the geometric image of a defocused point [1]."""
    argument = math.pi * diameter_um * np.abs(np.asarray(frequency, float))
    return np.divide(2 * j1(argument), argument, out=np.ones_like(argument), where=argument > 1e-12)


def defocus_disc(defocus_um: ArrayLike, f_number: float) -> Array:
    """Return the diameter [um] of a defocused point: the image-side cone of working f-number N, cut off focus."""
    return np.asarray(np.abs(np.asarray(defocus_um, float)) / f_number)


def psf_kernel(*, pitch_um: float, wavelength_um: float, f_number: float, disc_um: float) -> Array:
    """Return the light that a point at a pixel's centre sends into each pixel around it.

    The geometric disc and the Airy pattern are folded (their transfers multiplied), which is exact in either limit;
    between them the exact defocused pupil (Hopkins 1955) differs from the product by some hundredths of contrast.

    Parameters
    ----------
    pitch_um : float
        Pixel pitch [um].
    wavelength_um, f_number : float
        Of the diffraction: wavelength [um], working f-number [1].
    disc_um : float
        Diameter of the geometric disc [um].

    Returns
    -------
    ndarray (k, k), k odd
        Non-negative, sum 1.

    Notes
    -----
    The reach is a length on the sensor, whatever the pixels: an Airy pattern's variance grows with the reach, and a
    reach in whole pixels would make the same lens softer on coarser ones.

    References
    ----------
    Hopkins, "The frequency response of a defocused optical system", Proc. R. Soc. A 231 (1955) 91.
    """
    airy_um = wavelength_um * f_number
    reach_um = disc_um / 2 + _DIFFRACTION_REACH * airy_um
    half = math.ceil(reach_um / pitch_um + 0.5)
    size = 2 * half + 1
    fine = max(1, min(math.ceil(2 * pitch_um / airy_um), _MAX_TRANSFORM // size))  # reaches the diffraction cut-off
    f = np.fft.fftfreq(size * fine, d=pitch_um / fine)
    radial = np.hypot(f[:, None], f[None, :])
    spread = np.fft.ifft2(diffraction_mtf(radial, wavelength_um, f_number) * disc_mtf(radial, disc_um)).real
    offset = np.fft.fftfreq(size * fine, d=1.0 / (size * pitch_um))
    within = np.hypot(offset[:, None], offset[None, :]) <= reach_um
    spread = np.where(within, spread + (1.0 - spread[within].sum()) / within.sum(), 0.0)
    cell = np.sinc(f * pitch_um)  # integral over each receiving pixel
    gathered = np.fft.ifft2(np.fft.fft2(spread) * cell[:, None] * cell).real
    index = np.arange(-half, half + 1) * fine
    kernel = np.clip(gathered[np.ix_(index, index)], 0.0, None)  # rounding leaves -1e-19
    return np.asarray(kernel / kernel.sum())


# --- blur that varies over the field ---------------------------------------------------------------------------------


@dataclass(frozen=True)
class FieldBlur:
    """Kernels of a few blur zones, and where each pixel stands among them.

    Attributes
    ----------
    kernels : tuple of ndarray
        Each non-negative, symmetric, sum 1.
    position : ndarray of float32 (rows, cols) or None
        i + w: shares 1 - w of kernel i and w of kernel i + 1; None where one kernel serves all.
    """

    kernels: tuple[Array, ...]
    position: NDArray[np.float32] | None = None


def field_blur(disc_px: Array, kernel_of: Callable[[float], Array]) -> FieldBlur:
    """Choose a few kernels and shares that reproduce the second moment of each pixel's own disc.

    A disc of diameter c has the variance c^2/16, so shares that are linear in c^2 blend two neighbouring kernels into
    one of exactly the right width.

    Parameters
    ----------
    disc_px : ndarray (rows, cols)
        Geometric disc of each pixel [px].
    kernel_of : callable
        Diameter [px] -> kernel.
    """
    low, high = float(disc_px.min()), float(disc_px.max())
    if high - low < 1e-9:
        return FieldBlur((kernel_of(high),))
    count = min(_MAX_ZONES, math.ceil((high - low) / _ZONE_STEP_PX) + 1)
    knots = np.linspace(low, high, count)
    position = np.interp(disc_px**2, knots**2, np.arange(knots.size)).astype(np.float32)
    return FieldBlur(tuple(kernel_of(float(knot)) for knot in knots), position)


def blur(image: Array, spread: FieldBlur) -> Array:
    """Spread each pixel's light by the kernel of its own position; light is conserved.

    Beyond the border the image is continued by its outermost pixels, so that a flat field stays flat.
    """
    reach = max(kernel.shape[0] // 2 for kernel in spread.kernels)
    result = np.zeros_like(image)
    for i, kernel in enumerate(spread.kernels):
        part = image
        if spread.position is not None:
            part = image * np.clip(1.0 - np.abs(spread.position.astype(np.float64) - i), 0.0, None)
        padded = cv2.copyMakeBorder(part, reach, reach, reach, reach, cv2.BORDER_REPLICATE)
        # Kernels are symmetric, so correlation is convolution.
        result += cv2.filter2D(padded, cv2.CV_64F, kernel, borderType=cv2.BORDER_REPLICATE)[reach:-reach, reach:-reach]
    return result


# --- adapter ---------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Prepared:
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
    radiance = np.asarray(light.radiance, np.float64)
    seen = np.zeros(prepared.gain.shape)
    for x, y in prepared.maps:
        seen += cv2.remap(radiance, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    irradiance = seen * prepared.gain
    return SensorLight(irradiance=irradiance if prepared.spread is None else blur(irradiance, prepared.spread))


def prepared_lens(camera: Camera, plate: Plate, view: IdealView) -> _Prepared:
    """Return what a camera does to light on a pinhole view: remap maps, gain [sr] and blur, as form_image uses them."""
    return _prepare(camera, plate, view, True, True)


@functools.lru_cache(maxsize=2)
def _prepare(camera: Camera, plate: Plate, view: IdealView, distortion: bool, blurred: bool) -> _Prepared:
    projection = Projection.of(camera, plate)
    if not distortion:
        projection = replace(projection, distortion=(0.0, 0.0, 0.0, 0.0, 0.0))
    maps, direction = _maps(projection, view)
    lens = camera.lens
    m = magnification(camera.scale_px_per_mm, camera.pixel.pitch_um)
    gain = irradiance_per_radiance(
        *direction, f_number=lens.f_number, magnification=m, transmittance=lens.transmittance
    )
    gain /= np.abs(distortion_jacobian(*direction, projection.distortion)) * len(maps)
    gain *= vignetting(projection.shape, projection.principal_point, lens.vignetting_k)
    return _Prepared(maps, gain, lens_blur(camera, plate) if blurred else None)


def lens_blur(camera: Camera, plate: Plate) -> FieldBlur:
    """Return the blur of a camera's focus and diffraction."""
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


def _maps(
    projection: Projection, view: IdealView
) -> tuple[tuple[tuple[NDArray[np.float32], NDArray[np.float32]], ...], tuple[Array, Array]]:
    """Return remap maps, one per sub-sample of the pixel, and the undistorted direction of each pixel's centre.

    A frame pixel at the corner of a barrel lens covers more than one pixel of the ideal view; as many sub-samples as
    it covers, per side, keep the mean of the pixel a mean. Where nothing is distorted there is one, and it is exact.
    """
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
