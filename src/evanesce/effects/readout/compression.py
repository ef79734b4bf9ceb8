"""Lossy video codec: block transform, coefficients rounded to steps, as in H.264."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dct

from evanesce.core.quantities import Strict, field
from evanesce.core.states import Frame
from evanesce.effects.protocol import Context, Effect, Stage

Image = NDArray[np.float32]


class Parameters(Strict):
    """Step, block size and rounding."""

    step_DN: float = field(
        0.0,
        unit="DN",
        bounds=(0.0, 128.0),
        null=0.0,
        source="H.264: 0.625 * 2^(QP/6) of luma 16 to 235, so 5.8, 11.6 and 23 of 255 at QP 18, 24 and 30",
        doc="step of the coefficients of the orthonormal transform",
    )
    block_px: int = field(8, unit="px", bounds=(2, 64), doc="side of a block, of the frame as it is stored")
    rounding: float = field(
        0.3333,
        unit="1",
        bounds=(0.0, 0.5),
        source="libx264: 1/3 in intra, 1/6 in inter blocks",
        doc="added before a coefficient is cut to whole steps; below 0.5 weak ones vanish",
    )


def quantised(image: NDArray[Any], step: float, block: int, rounding: float) -> Image:
    """Return an image whose block transforms are cut to whole steps.

    Parameters
    ----------
    image : ndarray (rows, cols)
        [DN].
    step : float
        Of every coefficient of the orthonormal cosine transform [DN], not 0.
    block : int
        Side of a block [px]; the last ones are filled up with the border's values.
    rounding : float
        [steps].

    Returns
    -------
    ndarray (rows, cols)
        [DN].
    """
    rows, cols = image.shape
    padded = np.pad(image.astype(np.float32), ((0, -rows % block), (0, -cols % block)), mode="edge")
    basis = dct(np.eye(block), axis=0, norm="ortho").astype(np.float32)
    high, wide = padded.shape
    # Along columns, then along rows: two matrix products for all blocks at once.
    columns = np.matmul(basis, padded.reshape(high // block, block, wide))
    spectrum = columns.reshape(-1, block) @ basis.T
    whole = np.abs(spectrum)
    whole *= np.float32(1.0 / step)
    whole += np.float32(rounding)
    np.floor(whole, out=whole)
    whole *= np.float32(step)
    np.copysign(whole, spectrum, out=whole)
    back = np.matmul(basis.T, (whole @ basis).reshape(high // block, block, wide))
    return np.asarray(back.reshape(high, wide)[:rows, :cols])


def apply(frame: Frame, parameters: Parameters, context: Context) -> Frame:
    """Quantise the frame's blocks, each channel alone; a frame of floats (a prediction) is not rounded after.

    Parameters
    ----------
    frame : Frame
    parameters : Parameters
    context : Context

    Returns
    -------
    Frame
    """
    if parameters.step_DN == 0.0:
        return frame
    data: NDArray[Any] = frame.data
    step, block, rounding = parameters.step_DN, parameters.block_px, parameters.rounding
    made = np.empty(data.shape, np.float32)
    for layer in np.ndindex(data.shape[2:]):
        made[(..., *layer)] = quantised(data[(..., *layer)], step, block, rounding)
    np.clip(made, 0.0, 255.0, out=made)
    if data.dtype != np.uint8:
        return replace(frame, data=made.astype(data.dtype))
    made += np.float32(0.5)
    return replace(frame, data=made.astype(np.uint8))


EFFECT = Effect(
    id="compression",
    stage=Stage.FRAME,
    parameters=Parameters,
    amplitudes=("step_DN",),
    apply=apply,
    # Cameras record at QP 18 to 30; a prior on the step from fine to middling.
    fitted={"step_DN": 10.0},
    scaling="constant in DN; noise is smoothed and correlated within blocks, weak gradients turn into steps",
    # Rounding has no derivative.
    start={"step_DN": (5.0, 12.0, 25.0)},
)
