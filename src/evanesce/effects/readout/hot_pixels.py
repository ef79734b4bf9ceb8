"""Hot pixels: dark current far above that of their neighbours, at the same pixels in every frame."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from pydantic import model_validator

from evanesce.core.quantities import Strict, field
from evanesce.effects.inference_hints import Marks
from evanesce.effects.particles import listed_values, require_one_length
from evanesce.effects.protocol import Context, Effect, Stage
from evanesce.rig import Scene


class Parameters(Strict):
    """Share of hot pixels and their dark current; or a list of them."""

    fraction: float = field(0.0, unit="1", bounds=(0.0, 0.1), null=0.0, doc="share of pixels that are hot")
    rate_e_per_s: float = field(
        1e5, unit="e_per_s", bounds=(0.0, 1e8), doc="mean of their exponentially distributed dark current"
    )
    marks: float = field(0.0, unit="1", bounds=(0.0, 10.0), null=0.0, doc="multiplies the rates of the listed pixels")
    mark_x_mm: tuple[float, ...] = listed_values("mm", (0.0, 100.0), "listed pixels, from the sensor's left edge")
    mark_y_mm: tuple[float, ...] = listed_values("mm", (0.0, 100.0), "from its upper edge")
    mark_rate_e_per_s: tuple[float, ...] = listed_values("e_per_s", (0.0, 1e9), "dark current of each")

    @model_validator(mode="after")
    def _lists(self) -> Parameters:
        require_one_length({name: getattr(self, name) for name in ("mark_x_mm", "mark_y_mm", "mark_rate_e_per_s")})
        return self


def apply(charge_e: NDArray[np.float64], parameters: Parameters, context: Context) -> NDArray[np.float64]:
    """Add rate times exposure to a fixed random choice of pixels, and to those that are listed.

    Chosen by thresholding one uniform number per pixel, so that a larger fraction keeps the pixels of a smaller one.

    Parameters
    ----------
    charge_e : ndarray (rows, cols)
        [e-].
    parameters : Parameters
    context : Context

    Returns
    -------
    ndarray (rows, cols)
        [e-].
    """
    camera = context.scene.camera
    rate = np.zeros(charge_e.shape)
    if parameters.fraction > 0.0:
        rng = context.generator("hot_pixels", per_frame=False)
        hot = rng.random(charge_e.shape) < parameters.fraction
        rate += np.where(hot, rng.standard_exponential(charge_e.shape) * parameters.rate_e_per_s, 0.0)
    if parameters.marks > 0.0:
        pitch = camera.pixel.pitch_um * 1e-3
        row = np.floor(np.array(parameters.mark_y_mm) / pitch).astype(int)
        col = np.floor(np.array(parameters.mark_x_mm) / pitch).astype(int)
        rows, cols = charge_e.shape
        there = (row < rows) & (col < cols)
        listed_rate = parameters.marks * np.array(parameters.mark_rate_e_per_s)
        np.add.at(rate, (row[there], col[there]), listed_rate[there])
    return charge_e + rate * (camera.exposure_ms * 1e-3)


def _noticeable(scene: Scene, area_mm2: float) -> float:
    """Return the rate that fills a hundredth of all wells of an area [e-/s]."""
    camera = scene.camera
    wells = area_mm2 / (camera.pixel.pitch_um * 1e-3) ** 2 * camera.pixel.full_well_capacity_e
    return 0.01 * wells / (camera.exposure_ms * 1e-3)


EFFECT = Effect(
    id="hot_pixels",
    stage=Stage.CHARGE,
    parameters=Parameters,
    amplitudes=("fraction", "marks"),
    null_when="all",
    apply=apply,
    # Assumed: bright enough to show beside contact light, 600 e- in 6 ms.
    fitted={"fraction": 0.001, "rate_e_per_s": 1e5},
    scaling="single pixels, constant in electrons: grows with exposure, not with LED power",
    # The share has a derivative only at its own random pixels; those that data show are listed.
    start={"fraction": 0.001, "rate_e_per_s": 1e5},
    marks=Marks(
        scale="marks", x="mark_x_mm", y="mark_y_mm", amount="mark_rate_e_per_s", where="sensor", unit=_noticeable
    ),
)
