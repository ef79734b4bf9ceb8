"""Tone curve that departs from the nominal one in gamma or contrast."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from evanesce.core.quantities import Strict, field
from evanesce.core.states import Frame
from evanesce.effects.protocol import Context, Effect, Stage
from evanesce.rig import Camera
from evanesce.sensor.tone import CURVES, relative_light

Array = NDArray[np.float64]


class Parameters(Strict):
    """Departure of the real from the nominal curve."""

    gamma: float = field(
        0.0, unit="1", bounds=(-0.6, 2.0), null=0.0, doc="exponent on the developed value less 1; negative brightens"
    )
    contrast: float = field(
        0.0, unit="1", bounds=(-1.0, 1.0), null=0.0, doc="S-shape about mid-grey, where the slope is 1 + contrast/2"
    )


def departed(value: ArrayLike, gamma: float, contrast: float) -> Array:
    """Return the real curve's value where the nominal one gives v, 0 to 1.

    w + contrast w (1 - w)(2w - 1) with w = v^(1 + gamma): 0 and 1 stay,
    and the curve rises within the bounds of :class:`Parameters`.

    Parameters
    ----------
    value : array_like
        0 to 1.
    gamma, contrast : float

    Returns
    -------
    ndarray
        0 to 1, in the shape of ``value``.
    """
    power = np.asarray(value, np.float64) ** (1.0 + gamma)
    return np.asarray(power + contrast * power * (1.0 - power) * (2.0 * power - 1.0))


def apply(frame: Frame, parameters: Parameters, context: Context) -> Frame:
    """Develop by the real curve; a frame of floats (a prediction without rounding) stays one.

    Parameters
    ----------
    frame : Frame
    parameters : Parameters
    context : Context

    Returns
    -------
    Frame
    """
    gamma, contrast = parameters.gamma, parameters.contrast
    if gamma == 0.0 and contrast == 0.0:
        return frame
    data: NDArray[Any] = frame.data
    if data.dtype != np.uint8:
        predicted: Any = 255.0 * departed(np.clip(data / 255.0, 0.0, 1.0), gamma, contrast)
        return replace(frame, data=predicted)
    if frame.raw is None or frame.raw.shape != data.shape:
        return replace(frame, data=_rounded(departed(np.arange(256) / 255.0, gamma, contrast))[data])
    # From the raw numbers, so that values are rounded once; by the difference, so that what acted before is kept.
    change = _table_change(context.scene.camera, gamma, contrast)
    return replace(frame, data=np.clip(data + change[frame.raw], 0, 255).astype(np.uint8))


def _table_change(camera: Camera, gamma: float, contrast: float) -> NDArray[np.int16]:
    """Return by how much the 8-bit value of each raw number changes [DN]."""
    pixel = camera.pixel
    light = relative_light(np.arange(2**pixel.bits), black_level_DN=pixel.black_level_DN, bits=pixel.bits)
    value = np.clip(CURVES[camera.tone_curve](light), 0.0, 1.0)
    return _rounded(departed(value, gamma, contrast)).astype(np.int16) - _rounded(value).astype(np.int16)


def _rounded(value: Array) -> NDArray[np.uint8]:
    return np.floor(255.0 * value + 0.5).astype(np.uint8)


EFFECT = Effect(
    id="tone_curve",
    stage=Stage.FRAME,
    parameters=Parameters,
    amplitudes=("gamma", "contrast"),
    apply=apply,
    pointwise=True,
    null_when="all",
    # The published curves differ by this: at a quarter of full light sRGB and libcamera are BT.709 to the power of
    # 0.87 and 0.67.
    fitted={"gamma": 0.2, "contrast": 0.2},
    scaling="a fixed function of the grey level, whatever makes it: voltage, force, exposure",
)
