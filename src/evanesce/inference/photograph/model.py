"""A photograph's bins as a data vector with their noise, and the model, fitter, judge and search of one picture."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from evanesce.core.rng import generator
from evanesce.inference.data import SATURATED, DataVector
from evanesce.inference.discrepancy import Discrepancy, tied_rows
from evanesce.inference.joint import Fitter
from evanesce.inference.joint_fit import JointFit
from evanesce.inference.judge import Judge
from evanesce.inference.model import cube_by_cube, one_by_one
from evanesce.inference.photograph.causes import photo_nuisances
from evanesce.inference.photograph.light import LightModel
from evanesce.inference.photograph.picture import Photograph
from evanesce.inference.posterior import Further
from evanesce.inference.search import Search
from evanesce.inference.single_effects import UNKNOWN, cause_of
from evanesce.prediction.linear import CovarianceRows, Metric
from evanesce.prediction.noise import Noise
from evanesce.prediction.parameters import Parameter, derivative
from evanesce.prediction.tone import expected_tone
from evanesce.prediction.views import View

Array = NDArray[Any]
Mask = NDArray[np.bool_]

EVEN_DN = 3.0
"""Rise of the prediction over five bins below which print counts as even."""
BLUR_FORM = 0.1
"""Standard deviation of what the even blur does to an edge over its own size: a kernel of the same width but of another
form (disc or Gaussian) changes it by 4 % of the step, a fifth of what the blur does, and half of that is fitted."""
STEP_SHARE = 0.02
"""Standard deviation of a bin over the step to its neighbours, for what the pixels by which a board's light is gathered
leave of its edges."""
SHARPEST_BINS = 0.15
"""Blur of a bin's square hardly shows."""
LOCAL_BINS = 7
"""Side of the window whose median is the level about a bin."""
CLIPPED = 3.5
"""Standard deviations beyond which a residual is no noise; of a normal law that loses 0.5 % of the variance."""
CLIPPED_LOSS = 0.9945
FREEDOM = 4.0
"""Of Student's t law for what stands out of its neighbourhood: a line fifty deviations high weighs nothing (Lange,
Little and Taylor 1989, J. Am. Stat. Assoc. 84, 881)."""

VIEWS = (
    # A board that lies on the plate is judged as what touches it: one view for fits, and the same held out.
    View(kind="press", force_N=0.0),
    View(kind="press", force_N=0.0, locked=True),
)


def local_residual(residual: Array, which: Mask) -> Array:
    """Return residuals (rows, cols) less the median about each bin, over the bins that count; 0 elsewhere.

    What a smooth model of light gets wrong is alike over some bins, and is no point and no line.

    Parameters
    ----------
    residual : ndarray (rows, cols)
    which : ndarray of bool (rows, cols)
    """
    nearest = ndimage.distance_transform_edt(~which, return_distances=False, return_indices=True)
    filled = residual[tuple(nearest)]
    return np.where(which, residual - ndimage.median_filter(filled, LOCAL_BINS, mode="nearest"), 0.0)


def clipped_sd(values: Array) -> float:
    """Return the standard deviation of values (n,) without what stands out; whole numbers do not disturb it."""
    sd = float(np.std(values))
    for _ in range(30):
        kept = values[np.abs(values) < CLIPPED * sd]
        new = float(np.sqrt(np.mean(kept**2) / CLIPPED_LOSS)) if kept.size else sd
        if abs(new - sd) < 1e-4 * sd:
            break
        sd = new
    return max(sd, 1e-3)


def even_print(light: LightModel, mean: Array) -> Mask:
    """Return the bins (rows, cols) about which the predicted level hardly changes."""
    spread = ndimage.maximum_filter(mean, 5) - ndimage.minimum_filter(mean, 5)
    return np.asarray((light.photograph.block >= 0) & (spread < EVEN_DN))


def noise_of_print(photograph: Photograph, mean: Array, even: Mask) -> tuple[Noise, Array]:
    """Return the noise of even print over the camera's own, and the standard deviation (rows, cols) of every bin [DN].

    At edges the error of the fitted corners, times the slope of the prediction, adds, and a share of the step.

    Parameters
    ----------
    photograph : Photograph
    mean : ndarray (rows, cols)
        Prediction [DN].
    even : ndarray of bool (rows, cols)
    """
    tone = expected_tone(photograph.rig.camera, 1.0)
    level = ndimage.median_filter(photograph.data, 5)
    modelled = np.sqrt(tone.variance_at(level)) / photograph.bin_px
    left = local_residual(photograph.data - mean, even) / modelled
    opened = even & photograph.opened
    white = local_residual(generator(0, "photograph", "white noise").standard_normal(mean.shape), even)
    levels, ratios = [], []
    for which in (photograph.share < 0.5, photograph.share >= 0.5):
        levels.append(float(np.median(level[opened & which])))
        # What the local level takes along, white noise loses as well.
        ratios.append((clipped_sd(left[opened & which]) / clipped_sd(white[opened & which])) ** 2)
    noise = Noise(tone, np.array(levels), np.array(ratios), 0.0, np.zeros((0, *mean.shape)), False, 0.0)
    variance = np.interp(level, levels, ratios) * modelled**2
    spread = ndimage.maximum_filter(mean, 3) - ndimage.minimum_filter(mean, 3)
    slope = np.hypot(*np.gradient(mean))
    variance = variance + (photograph.corner_error_px * slope) ** 2 + (STEP_SHARE * spread) ** 2
    return noise, np.sqrt(variance)


def photo_data(photograph: Photograph, noise: Noise, sd: Array, left_out: Mask) -> DataVector:
    """Return the data vector: the open blocks as one view, the held-out ones as another.

    Parameters
    ----------
    photograph : Photograph
    noise : Noise
    sd : ndarray (rows, cols)
        [DN].
    left_out : ndarray of bool (rows, cols)
        Bins that are no part of what smooth causes explain.
    """
    counted = (photograph.data < 255.0 * SATURATED) & ~left_out
    valid = np.array([photograph.opened & counted, photograph.locked & (photograph.block >= 0) & counted])
    cube, sds = (np.repeat(x[None], 2, axis=0) for x in (photograph.data, sd))
    return DataVector(cube, sds, valid, VIEWS, noise, 1.0, 0.0)


class PhotoModel:
    """The photograph's model as :class:`~evanesce.inference.joint.Fitter` asks for it.

    Parameters
    ----------
    light : LightModel
    data : DataVector
    """

    factor = 1
    unexplained = 0.0

    def __init__(self, light: LightModel, data: DataVector) -> None:
        self.light, self.data = light, data
        self.discretisation = np.zeros_like(data.cube)
        """Nothing: print and kernels are drawn in closed form, or on samples much finer than a bin."""

    def anchor(self, point: Mapping[str, float]) -> None:
        """Draw the print with a point's ink; all else acts as it is."""
        self.light.anchor(point)

    def cube(self, point: Mapping[str, float], only: Any = None) -> Array:
        """Return the bins (views, rows, cols) [DN]."""
        return np.repeat(self.light(point)[None], len(VIEWS), axis=0)

    def vector(self, point: Mapping[str, float]) -> Array:
        """Return the whitened bins (bins,) of the open blocks."""
        return self.data.whitened(self.cube(point))

    def derivative(self, point: Mapping[str, float], parameter: Parameter) -> Array:
        """Return the whitened derivative (bins,) by a parameter."""
        found = derivative(self, point, parameter, self.data.open)  # type: ignore[arg-type]
        return self.data.whitened(found).astype(np.float32)

    derivatives = one_by_one
    cubes = cube_by_cube


class PhotoFitter(Fitter):
    """Fits causes and the photograph's nuisances jointly.

    Parameters
    ----------
    model : PhotoModel
    """

    def __init__(self, model: PhotoModel) -> None:
        self.model = model  # type: ignore[assignment]
        self.observed = model.data.whitened(model.data.cube)
        self.nuisances = photo_nuisances(model.light.photograph)
        self.jitter = ()
        self._evaluated_at, self._differentiated_at = {}, {}

    @staticmethod
    def start_of(photograph: Photograph) -> dict[str, float]:
        """Return the nuisances where their priors have them."""
        return {p.name: p.null for p in photo_nuisances(photograph)}

    def jitter_metric(self, point: Mapping[str, float]) -> Metric:
        """Return the plain inner product: one picture has no jitter from view to view."""
        return Metric.of(np.zeros((0, self.observed.size)), np.zeros(0))


class PhotoDiscrepancy(Discrepancy):
    """Discrepancy with the even blur in it: its form is not known, and varies over the frame."""

    def tied(self, fitted: JointFit, fine: Array | None = None) -> dict[str, CovarianceRows]:
        """Return the rows of each cause by its name, and at "" those of the blur as well."""
        whole, blur = self.model.cube(fitted.point), fitted.point["@blur"]
        other = ({"@blur": SHARPEST_BINS}, {"@blur": 2.0 * blur}, {"@disc": 0.0}, {"@disc": 1.0})
        found = super().tied(fitted)
        for changed in other:
            change = whole - self.model.cube({**fitted.point, **changed})
            rows = tied_rows(self.model.data, change, BLUR_FORM, by_view=False)
            found[""] = CovarianceRows.joined(found[""], rows)
        return found


class PhotoJudge(Judge):
    """Weighs causes; something unknown is asked for when no cause of the library brings any more.

    A field of some two hundred waves would take most of what several causes do together before any of them is known.
    """

    growing = False

    def further(
        self,
        fitted: JointFit,
        unknown: Mapping[str, float] = MappingProxyType({}),
        left_out: Collection[str] = (),
    ) -> Further:
        """Return what a further cause would be, of the library's alone."""
        self.growing = True
        try:
            return super().further(fitted, unknown, left_out)
        finally:
            self.growing = False

    def _rest(self, taken: Iterable[str], unknown: Iterable[str]) -> list[str]:
        rest = super()._rest(taken, unknown)
        return [block for block in rest if cause_of(block) != UNKNOWN] if self.growing else rest


@dataclass
class PhotoSearch(Search):
    """Adds, drops and exchanges causes; then takes what is left as unknown, under which each cause is judged again."""

    warm: JointFit | None = None
    """Fit to begin with in place of the nominal one."""

    def _grown(self, now: JointFit) -> JointFit:
        now, self.warm = self.warm or now, None
        grown = super()._grown(now)
        asked = Judge.further(self.judge, grown, {}, self.not_unknown)
        self.unknown = dict(asked.unknown) if asked.place.log_bayes.get(UNKNOWN, 0.0) > 0.0 else {}
        return grown

    def _given_up(self, now: JointFit, name: str) -> JointFit | None:
        """Return None: what is unknown is weighed when all causes are in, and no cause gives way to it."""
        return None


def robust_sd(sd: Array, left: Array) -> Array:
    """Return standard deviations (rows, cols) widened where a residual stands out of its neighbourhood, by a t law.

    Parameters
    ----------
    sd : ndarray (rows, cols)
    left : ndarray (rows, cols)
        Residual less its neighbourhood's level [DN].
    """
    z2 = (left / sd) ** 2
    # Below the cut noise is noise: widening it there as well would make every test insensitive.
    return np.asarray(sd * np.sqrt(np.where(z2 > CLIPPED**2, (FREEDOM + z2) / (FREEDOM + 1.0), 1.0)))
