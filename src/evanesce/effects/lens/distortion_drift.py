"""Lens that moved since its calibration: distortion and principal point depart from the nominal ones.

The image by the nominal lens is warped into that of the real one, without rendering again. Labels that the truth draws
into the image are those of the nominal lens; areas on the plate are compared with the truth as usual.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from evanesce.core.errors import InputError
from evanesce.core.quantities import Strict, field
from evanesce.core.states import SensorLight
from evanesce.effects.protocol import Context, Effect, Stage
from evanesce.optics.projection import Projection, distort
from evanesce.rig import Camera, Plate
from evanesce.sensor.lens import distortion_jacobian

Array = NDArray[np.float64]

NODES = 14
"""Chebyshev nodes along each side: the warp is smooth, and interpolated to 2e-4 px of a frame of 2000."""

STRIPE_ROWS = 16


class Parameters(Strict):
    """Real minus nominal values."""

    k1: float = field(0.0, unit="1", bounds=(-0.3, 0.3), null=0.0, doc="radial coefficient of r^2, OpenCV's")
    k2: float = field(0.0, unit="1", bounds=(-1.0, 1.0), null=0.0, doc="radial coefficient of r^4")
    k3: float = field(0.0, unit="1", bounds=(-3.0, 3.0), null=0.0, doc="radial coefficient of r^6")
    p1: float = field(0.0, unit="1", bounds=(-0.05, 0.05), null=0.0, doc="tangential coefficient")
    p2: float = field(0.0, unit="1", bounds=(-0.05, 0.05), null=0.0, doc="tangential coefficient")
    centre_x_um: float = field(
        0.0, unit="um", bounds=(-600.0, 600.0), null=0.0, doc="optical axis on the sensor, to the right"
    )
    centre_y_um: float = field(0.0, unit="um", bounds=(-600.0, 600.0), null=0.0, doc="optical axis, downwards")


AMPLITUDES = ("k1", "k2", "k3", "p1", "p2", "centre_x_um", "centre_y_um")


def apply(light: SensorLight, parameters: Parameters, context: Context) -> SensorLight:
    """Move the light of each direction to where the real lens images it, brighter where the image is compressed.

    Parameters
    ----------
    light : SensorLight
    parameters : Parameters
    context : Context

    Returns
    -------
    SensorLight

    Raises
    ------
    InputError
        If the real lens would fold the image over itself.
    """
    if all(getattr(parameters, name) == 0.0 for name in AMPLITUDES):
        return light
    image = np.asarray(light.irradiance, np.float64)
    along, across, gain = _warp(context.scene.camera, context.scene.plate, parameters, image.shape)
    moved = across(along(image))
    return SensorLight(irradiance=np.maximum(moved * gain, 0.0))


@functools.lru_cache(maxsize=2)  # frames of one trial share it
def _warp(camera: Camera, plate: Plate, parameters: Parameters, shape: tuple[int, ...]) -> tuple[Shift, Shift, Array]:
    """Return how an image is read along its rows and then down them, and the light's gain (rows, cols)."""
    nominal = Projection.of(camera, plate)
    added = (parameters.k1, parameters.k2, parameters.p1, parameters.p2, parameters.k3)
    k1, k2, p1, p2, k3 = (old + new for old, new in zip(nominal.distortion, added, strict=True))
    real = replace(nominal, distortion=(k1, k2, p1, p2, k3))
    rows, cols = shape
    dx, dy = camera.principal_point_offset_px
    axis = ((cols - 1) / 2 + dx, (rows - 1) / 2 + dy)
    pitch = camera.pixel.pitch_um
    real_axis = (axis[0] + parameters.centre_x_um / pitch, axis[1] + parameters.centre_y_um / pitch)

    (at_x, spread_x), (at_y, spread_y) = _interpolation(cols), _interpolation(rows)
    u, v = np.meshgrid(at_x, at_y)
    focal = nominal.focal_px
    direction = real.undistort((u - real_axis[0]) / focal, (v - real_axis[1]) / focal)
    compressed = distortion_jacobian(*direction, real.distortion)
    landed = distort(*direction, real.distortion)
    missed = max(float(np.abs(a * focal + c - w).max()) for a, c, w in zip(landed, real_axis, (u, v), strict=True))
    if compressed.min() <= 0.0 or missed > 1e-3:
        raise InputError(
            "the lens would fold the image over itself",
            key="effects.distortion_drift",
            allowed="coefficients whose radial curve rises out to the frame's corner",
        )
    x, y = distort(*direction, nominal.distortion)
    gain = distortion_jacobian(*direction, nominal.distortion) / compressed
    right, down = x * focal + axis[0] - u, y * focal + axis[1] - v
    steeper = np.gradient(spread_y, axis=0) @ right @ spread_x.T
    right, down, gain = (spread_y @ values @ spread_x.T for values in (right, down, gain))
    # The first moves rows' light along the row, where it is read by the second: one line further on.
    return Shift.of(right - down * steeper, axis=1), Shift.of(down, axis=0), gain


@functools.lru_cache(maxsize=8)
def _interpolation(count: int) -> tuple[Array, Array]:
    """Return Chebyshev nodes over 0 to count - 1, and the matrix (count, NODES) that takes values there to each."""
    angle = np.pi * (np.arange(NODES) + 0.5) / NODES
    order = np.arange(NODES)[:, None]
    norm = np.where(order == 0, 1.0, 2.0) / NODES
    everywhere = np.arccos(np.clip(2.0 * np.arange(count) / (count - 1) - 1.0, -1.0, 1.0))
    matrix = np.cos(order * everywhere).T @ (norm * np.cos(order * angle))
    return np.asarray((np.cos(angle) + 1.0) * (count - 1) / 2), np.asarray(matrix)


@dataclass(frozen=True)
class Shift:
    """How an image is read some way along an axis from each pixel, by Keys' cubic convolution; borders are continued.

    ``cv2.remap`` resolves 1/32 px only: the effect of less would vanish in a fit.

    Attributes
    ----------
    axis : int
        0 down the rows, 1 along them.
    beyond : int
        By how much an image is continued beyond its borders [px].
    first : ndarray of int (rows, cols)
        Place of the first of four taps among all numbers of the continued image.
    weights : ndarray (4, rows, cols)
        Of the taps [1].

    References
    ----------
    R. G. Keys, "Cubic convolution interpolation for digital image processing", IEEE Trans. Acoust., Speech, Signal
    Processing 29 (1981) 1153; with a = -1/2 quadratics are reproduced exactly.
    """

    axis: int
    beyond: int
    first: NDArray[np.intp]
    weights: Array

    @classmethod
    def of(cls, shift: Array, axis: int) -> Shift:
        """Return that by a shift (rows, cols) [px]."""
        beyond = int(np.abs(shift).max()) + 3
        rows, cols = shift.shape
        wide = cols + 2 * beyond * axis
        stride = 1 if axis == 1 else wide
        whole = np.floor(shift)
        f = shift - whole
        f2 = f * f
        f3 = f2 * f
        first = np.arange(rows)[:, None] * wide + np.arange(cols) + (beyond - 1) * stride
        weights = np.array(
            [f2 - 0.5 * (f3 + f), 1.5 * f3 - 2.5 * f2 + 1.0, 2.0 * f2 - 1.5 * f3 + 0.5 * f, 0.5 * (f3 - f2)]
        )
        return cls(axis, beyond, first + stride * whole.astype(np.intp), weights)

    def __call__(self, image: Array) -> Array:
        """Return an image (rows, cols) read so."""
        around = (self.beyond, self.beyond)
        padded = np.pad(image, [(0, 0), around] if self.axis == 1 else [around, (0, 0)], mode="edge")
        stride = 1 if self.axis == 1 else padded.shape[1]
        values, total = padded.ravel(), np.empty_like(image)
        for start in range(0, len(image), STRIPE_ROWS):  # what is worked on stays in the processor's cache
            part = np.s_[start : start + STRIPE_ROWS]
            at = self.first[part]
            found = self.weights[0, part] * values.take(at)
            for tap in range(1, 4):
                found += self.weights[tap, part] * values.take(at + tap * stride)
            total[part] = found
        return total


EFFECT = Effect(
    id="distortion_drift",
    stage=Stage.SENSOR_LIGHT,
    parameters=Parameters,
    amplitudes=AMPLITUDES,
    apply=apply,
    null_when="all",
    # Assumed of a calibration from one view: each term moves the frame's corner by some 10 px of 2000.
    fitted={"k1": 0.01, "k2": 0.02, "k3": 0.03, "p1": 0.002, "p2": 0.002, "centre_x_um": 30.0, "centre_y_um": 30.0},
    scaling="moves edges by the same pixels at every voltage, force and time; most at the frame's border",
)
