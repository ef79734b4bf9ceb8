"""Defocus beyond the nominal model: a further blur, which may grow or shrink towards the frame's corners."""

from __future__ import annotations

import functools
import math

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import ive

from evanesce.core.quantities import Strict, field
from evanesce.core.states import SensorLight
from evanesce.effects.inference_hints import SQUARE
from evanesce.effects.protocol import Context, Effect, Stage
from evanesce.sensor.lens import field_radius2

Array = NDArray[np.float64]

ZONE_STEP_PX = 0.75
MAX_ZONES = 8


class Parameters(Strict):
    """Width of the added blur on the sensor, at the optical axis and towards the corners."""

    blur_um: float = field(
        0.0,
        unit="um",
        bounds=(0.0, 60.0),
        null=0.0,
        doc="standard deviation on the axis, on the sensor; a focus shift dz gives |dz|/(4 N (1 + m))",
    )
    corner_blur_um: float = field(
        0.0,
        unit="um",
        bounds=(-60.0, 60.0),
        null=0.0,
        source="rig photograph: edges of 3.0 px at the centre and 6.25 px in the corners, that is 13 um more",
        doc="added to blur_um at the corner, growing as r^2; negative: sharper outwards, and blurred again beyond",
    )


def discrete_gaussian(variance: float) -> Array:
    """Return the discrete kernel exp(-v) I_n(v), whose variance is exactly v [px^2], however narrow it is.

    That of a sampled Gaussian is not, below a pixel's width; with this kernel pixels of any size have the same blur.

    Parameters
    ----------
    variance : float
        [px^2].

    Returns
    -------
    ndarray (n,)
        Sum 1.

    References
    ----------
    T. Lindeberg, "Scale-space for discrete signals", IEEE Trans. Pattern Anal. Machine Intell. 12 (1990) 234.
    """
    reach = reach_of(variance)
    kernel = ive(np.abs(np.arange(-reach, reach + 1)), variance)
    return np.asarray(kernel / kernel.sum())


def reach_of(variance: float) -> int:
    """Return how far the kernel of a variance [px^2] carries light [px]."""
    return max(1, math.ceil(4.5 * math.sqrt(variance) + 1.0))


def spread_by(image: Array, variance: Array) -> Array:
    """Spread each pixel's light by a Gaussian of its own variance [px^2]; total light is kept.

    Kernels of a few widths are blended linearly in the variance, so that every pixel's second moment is exact.
    Beyond the border the image is continued by its outermost pixels.

    Parameters
    ----------
    image : ndarray (rows, cols)
        Any unit.
    variance : ndarray (rows, cols)
        [px^2].

    Returns
    -------
    ndarray (rows, cols)
    """
    low, high = math.sqrt(float(variance.min())), math.sqrt(float(variance.max()))
    whole, here = np.zeros_like(image), lit_part(image, high**2)
    if high - low < 1e-9:
        whole[here] = _blurred(image[here], high**2)
        return whole
    knots = np.linspace(low, high, min(MAX_ZONES, math.ceil((high - low) / ZONE_STEP_PX) + 1)) ** 2
    image, variance = np.ascontiguousarray(image[here]), np.ascontiguousarray(variance[here])
    if not image.size:
        return whole
    total, part, slope = np.zeros_like(image), np.empty_like(image), np.empty_like(image)
    first, last = np.searchsorted(knots, [variance.min(), variance.max()])
    for i, knot in enumerate(knots):
        if not first - 1 <= i <= last:  # no pixel has a share of it
            continue
        # Shares fall linearly to the neighbouring knots; together they are 1.
        part.fill(1.0)
        for neighbour in (*knots[max(i - 1, 0) : i], *knots[i + 1 : i + 2]):
            np.subtract(variance, neighbour, out=slope)
            slope /= knot - neighbour
            np.minimum(part, slope, out=part)
        np.maximum(part, 0.0, out=part)
        part *= image
        total += _blurred(part, float(knot))
    whole[here] = total
    return whole


def lit_part(image: Array, variance: float) -> tuple[slice, slice]:
    """Return rows and columns outside which an image is dark after a blur, as far as its kernel reaches.

    Parameters
    ----------
    image : ndarray (rows, cols)
    variance : float
        Largest of the blur [px^2].
    """
    lit, reach = image != 0.0, reach_of(variance)
    sides = []
    for axis in (1, 0):
        there = np.flatnonzero(lit.any(axis=axis))
        low, high = (int(there[0]), int(there[-1]) + 1) if there.size else (0, 0)
        sides.append(
            slice(max(0, low - reach), min(image.shape[1 - axis], high + reach)) if there.size else slice(0, 0)
        )
    return sides[0], sides[1]


def _blurred(image: Array, variance: float) -> Array:
    if variance == 0.0 or not image.size:
        return image
    kernel = discrete_gaussian(variance)
    return np.asarray(cv2.sepFilter2D(image, cv2.CV_64F, kernel, kernel, borderType=cv2.BORDER_REPLICATE))


def apply(light: SensorLight, parameters: Parameters, context: Context) -> SensorLight:
    """Blur by |blur + corner_blur rho^2|, rho = 1 at the corner farthest from the optical axis.

    Parameters
    ----------
    light : SensorLight
    parameters : Parameters
    context : Context

    Returns
    -------
    SensorLight
    """
    if parameters.blur_um == 0.0 and parameters.corner_blur_um == 0.0:
        return light
    image = np.ascontiguousarray(light.irradiance, np.float64)
    camera = context.scene.camera
    if parameters.corner_blur_um == 0.0:
        return SensorLight(irradiance=_blurred(image, (parameters.blur_um / camera.pixel.pitch_um) ** 2))
    rows, cols = image.shape
    dx, dy = camera.principal_point_offset_px
    rho2 = _field_radius2((rows, cols), ((cols - 1) / 2 + dx, (rows - 1) / 2 + dy))
    variance = parameters.corner_blur_um * rho2
    variance += parameters.blur_um
    variance *= variance
    variance /= camera.pixel.pitch_um**2
    return SensorLight(irradiance=spread_by(image, variance))


@functools.lru_cache(maxsize=4)
def _field_radius2(shape: tuple[int, int], centre: tuple[float, float]) -> Array:
    return field_radius2(shape, centre)


EFFECT = Effect(
    id="defocus",
    stage=Stage.SENSOR_LIGHT,
    parameters=Parameters,
    amplitudes=("blur_um", "corner_blur_um"),
    apply=apply,
    null_when="all",
    # On the axis a focus set by hand: 0.1 mm at f/5.6; in the corners as in the rig's photograph.
    fitted={"blur_um": 5.0, "corner_blur_um": 10.0},
    needs=("press",),
    scaling="moves a share of the light that goes with the square of the blur; follows LED power, same in every frame",
    # Variances add: to first order a narrow blur changes nothing.
    coordinates={"blur_um": SQUARE},
    start={"blur_um": (3.0, 8.0), "corner_blur_um": (6.0, 15.0)},
)
