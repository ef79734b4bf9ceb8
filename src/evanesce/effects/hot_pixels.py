"""Pixels with a dark current far above that of their neighbours, at the same places in every frame."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from evanesce.effects.protocol import Context, Effect, Stage
from evanesce.quantities import Strict, field


class Parameters(Strict):
    """How many, and how hot."""

    fraction: float = field(0.0, unit="1", bounds=(0.0, 0.1), null=0.0, doc="share of pixels that are hot")
    rate_e_per_s: float = field(
        0.0, unit="e_per_s", bounds=(0.0, 1e8), null=0.0, doc="mean of their exponentially distributed dark current"
    )


def apply(charge_e: NDArray[np.float64], parameters: Parameters, context: Context) -> NDArray[np.float64]:
    """Add rate times exposure to a fixed random choice of pixels.

    Chosen by thresholding one uniform number per pixel, so that a larger fraction keeps the pixels of a smaller one.
    """
    rng = context.generator("hot_pixels", per_frame=False)
    hot = rng.random(charge_e.shape) < parameters.fraction
    rate = rng.standard_exponential(charge_e.shape) * parameters.rate_e_per_s
    return charge_e + np.where(hot, rate * (context.scene.camera.exposure_ms * 1e-3), 0.0)


EFFECT = Effect(
    id="hot_pixels",
    stage=Stage.CHARGE,
    parameters=Parameters,
    amplitudes=("fraction", "rate_e_per_s"),
    apply=apply,
    # Assumed: bright enough to show beside contact light, 600 e- in 6 ms.
    fitted={"fraction": 0.001, "rate_e_per_s": 1e5},
    scaling="single pixels, constant in electrons: grows with exposure, not with LED power",
    # One of the two is nothing without the other.
    start={"fraction": 0.001, "rate_e_per_s": 1e5},
)
