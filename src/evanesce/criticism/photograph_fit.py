"""Robust fit of a photograph's light model, and what it predicts of blocks that were left out.

A Student t core with a scale of its own for each model (Lange, Little & Taylor, JASA 84 (1989) 881): a speck fifty
deviations off pulls a least-squares fit of light or blur; here its weight falls as the inverse square of its height.
The free scale keeps a poor model from being judged by noise it does not claim, and makes every gain smaller.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from evanesce.core import rng
from evanesce.criticism.photograph_light import COSINES, SIDES, LightModel, Photograph
from evanesce.criticism.photograph_tails import (
    FREEDOM,
    TAILS,
    Inverse,
    Law,
    Seen,
    Tail,
    core_log_density,
    core_share,
    fit_tail,
    law_of,
    local_level,
    log_density,
    seen_of,
)
from evanesce.effects import all_effects
from evanesce.sensor.tone import CURVES

Array = NDArray[np.float64]

FOLDS = 5
ROUNDS = 3
DAMPINGS = (1e-6, 0.03, 0.3, 3.0)
"""Added to the diagonal of the scaled normal equations, one after the other until a step gains (Levenberg)."""

ENOUGH_NATS = 3.0
EVEN_SLOPE_DN = 3.0
NOISE_WINDOW = 5
BLUR_FORM = 0.05
"""Share of a step by which the edge of a disc of the same spread departs from a Gaussian's: 0.040 at most."""


@dataclass(frozen=True)
class Free:
    """A number that a fit may move.

    Attributes
    ----------
    name, unit : str
    start, low, high, step : float
        Where it starts, its bounds, and the step of its derivative.
    """

    name: str
    unit: str
    start: float
    low: float
    high: float
    step: float


NUISANCES = (
    Free("light.bright", "1", 0.1, 1e-3, 1.0, 1e-3),
    Free("light.dark", "1", 0.01, 0.0, 1.0, 2e-4),
    Free("lens.blur_px", "bins", 0.7, 0.15, 6.0, 0.03),
    Free("print.ink_mm", "mm", 0.0, -0.15, 0.15, 0.003),
)


def _bounded(effect_id: str, parameter: str, start: float, step: float, name: str | None = None) -> Free:
    quantity = dict(all_effects()[effect_id].parameters.quantities())[parameter]
    return Free(f"{effect_id}.{name or parameter}", quantity.unit, start, *quantity.bounds, step)


def candidates() -> dict[str, tuple[Free, ...]]:
    """Return what each effect may move, in alphabetical order of ids; effects without places have none here."""
    table: dict[str, tuple[Free, ...]] = {
        # its even part adds to the level of dark print, which is fitted: only what slopes over the frame is left
        "ambient_light": tuple(
            Free(f"ambient_light.{axis}", "of bright print, per tangent", 0.0, -5.0, 5.0, 3e-3) for axis in "xy"
        ),
        "black_level": (_bounded("black_level", "offset_DN", 0.0, 2.0),),
        "defocus": (replace(_bounded("defocus", "corner_blur_um", 6.0, 0.3), low=0.0),),
        "distortion_drift": tuple(
            _bounded("distortion_drift", name, 0.0, step)
            for name, step in (("k1", 0.002), ("k2", 0.002), ("centre_x_um", 3.0), ("centre_y_um", 3.0))
        ),
        "led_edge_reflections": (
            *(Free(f"led_edge_reflections.{side}", "of bright print", 0.02, 0.0, 3.0, 2e-3) for side in SIDES),
            _bounded("led_edge_reflections", "decay_mm", 3.1, 0.1),
        ),
        "plate_tilt": tuple(_bounded("plate_tilt", name, 0.0, 0.02) for name in ("about_x_deg", "about_y_deg")),
        "residue_film": (
            _bounded("residue_film", "relative_radiance", 0.03, 2e-3),
            *(Free(f"residue_film.middle_{axis}_mm", "mm", 0.0, -500.0, 500.0, 0.1) for axis in "xy"),
            _bounded("residue_film", "radius_mm", 2.5, 0.1),
        ),
        "tone_curve": (_bounded("tone_curve", "gamma", 0.0, 5e-3), _bounded("tone_curve", "contrast", 0.0, 5e-3)),
        "vignetting": (
            _bounded("vignetting", "k", 0.03, 2e-3),
            *(Free(f"vignetting.centre_{axis}_px", "bins", 0.0, -2000.0, 2000.0, 5.0) for axis in "xy"),
        ),
        **{name: () for name in TAILS},
    }  # fmt: skip
    return dict(sorted(table.items()))


FLEXIBLE = "uneven_light"


def flexible() -> tuple[Free, ...]:
    """Return the smooth light field's numbers; it is no effect of the library, and only tried when that is done."""
    return tuple(Free(f"{FLEXIBLE}.c{i}{j}", "log of light", 0.0, -2.0, 2.0, 2e-3) for i, j in COSINES)


@dataclass(frozen=True)
class Fit:
    """A model fitted to the open blocks.

    Attributes
    ----------
    ids : tuple of str
    free : tuple of Free
    values : mapping of str to float
    tails : tuple of Tail
    scale : float
        Of the core's deviations over the photograph's own noise [1].
    score : float
        Log likelihood of the open blocks [nats].
    held_out : ndarray (blocks,)
        Log density of each open block by fits without its fold [nats].
    """

    ids: tuple[str, ...]
    free: tuple[Free, ...]
    values: Mapping[str, float]
    tails: tuple[Tail, ...]
    scale: float
    score: float
    held_out: Array


class Bench:
    """A photograph's open blocks with their noise and folds; fits models to them.

    Parameters
    ----------
    photograph : Photograph
    seed : int
        Of the folds.
    """

    def __init__(self, photograph: Photograph, seed: int = 0) -> None:
        self.photograph, self.model = photograph, LightModel(photograph)
        self.opened = np.flatnonzero(photograph.opened.ravel())
        names, self.block = np.unique(photograph.block.ravel()[self.opened], return_inverse=True)
        self.blocks = len(names)
        shuffled = rng.generator(seed, "photograph", "folds").permutation(self.blocks) % FOLDS
        self.fold = shuffled[self.block]
        self.inverse = Inverse.of(photograph.data, photograph.curve)
        self.start = self._start()
        self.noise_DN, self.deviation = _noise(photograph, self.model(self.start))

    @property
    def pixel_noise_DN(self) -> float:
        """Noise of one pixel of the picture as it came, were bins averages of independent pixels [DN]."""
        return float(np.mean(list(self.noise_DN.values()))) * self.photograph.bin_px

    def _start(self) -> dict[str, float]:
        data, share = self.photograph.data[self.photograph.opened], self.photograph.share[self.photograph.opened]
        light = np.linspace(0.0, 1.0, 8192)
        table = 255.0 * CURVES[self.photograph.curve](light)
        found = {f.name: f.start for f in NUISANCES}
        for name, which in (("light.bright", share > 0.98), ("light.dark", share < 0.02)):
            found[name] = float(np.interp(np.median(data[which]), table, light))
        return found

    def seen(self, values: Mapping[str, float], scale: float, which: NDArray[np.int64] | None = None) -> Seen:
        """Return the open bins (or those of flat indices) under a model."""
        which = self.opened if which is None else which
        return seen_of(self.photograph.data, self.model(values), scale * self.deviation, self.inverse, which)

    def laws(self, tails: tuple[Tail, ...], values: Mapping[str, float], more: str | None = None) -> dict[str, Law]:
        """Return the laws of the tails in play."""
        names = [tail.id for tail in tails] + ([more] if more else [])
        return {name: law_of(name, self.model, values) for name in names}

    def fit(
        self, ids: tuple[str, ...], free: tuple[Free, ...], start: Mapping[str, float], tails: tuple[Tail, ...]
    ) -> Fit:
        """Fit the mean's numbers, tails held, and predict each fold by one step from the fit without it."""
        values = {**start, **{f.name: start.get(f.name, f.start) for f in free}}
        laws = self.laws(tails, values)
        scale, weight, score = self._weigh(values, tails, laws)
        for _ in range(ROUNDS):
            slopes, residual = self._slopes(values, free)
            better = None
            for damping in DAMPINGS:
                step = _solve(slopes, weight, residual, values, free, damping)
                tried = dict(values)
                for f, d in zip(free, step, strict=True):
                    tried[f.name] = float(np.clip(values[f.name] + d, f.low, f.high))
                found = self._weigh(tried, tails, laws)
                if found[2] > score:
                    better = (tried, *found)
                    break
            if better is None:
                break
            gained = better[3] - score
            values, scale, weight, score = better
            if gained < ENOUGH_NATS:
                break
        held = self._held_out(values, free, tails, laws, scale, weight)
        return Fit(ids, free, values, tails, scale, score, held)

    def add_tail(self, fit: Fit, name: str) -> Fit:
        """Add an effect without places to a fit and predict each fold by the tail fitted without it.

        With and without it are compared on what stands out of its own neighbourhood: what a model of smooth light still
        gets wrong is no point, and a tail would take it up as long as it is there.
        """
        laws = self.laws(fit.tails, fit.values, name)
        seen = self.standing_out(fit)
        tail = fit_tail(name, seen, fit.tails, laws)
        gained = np.zeros(self.blocks)
        for k in range(FOLDS):
            inside = self.fold == k
            part = fit_tail(name, seen.some(~inside), fit.tails, laws, start=tail)
            left = seen.some(inside)
            density = log_density(left, (*fit.tails, part), laws) - log_density(left, fit.tails, laws)
            gained += np.bincount(self.block[inside], weights=density, minlength=self.blocks)
        score = float(log_density(self.seen(fit.values, fit.scale), (*fit.tails, tail), laws).sum())
        held = fit.held_out + gained
        return replace(fit, ids=(*fit.ids, name), tails=(*fit.tails, tail), score=score, held_out=held)

    def standing_out(self, fit: Fit) -> Seen:
        """Return the open bins against their own neighbourhood's level, with a core of its own scale."""
        one, mean = self.photograph, self.model(fit.values)
        mean = mean + local_level(one.data - mean, one.opened)
        plain = ((one.data - mean) / self.deviation).ravel()[self.opened]
        scale = core_scale(plain, np.ones(plain.shape))
        return seen_of(one.data, mean, scale * self.deviation, self.inverse, self.opened)

    def refit(self, fit: Fit) -> Fit:
        """Fit mean and tails in turn once more, all together."""
        for tail in fit.tails:
            others = tuple(t for t in fit.tails if t.id != tail.id)
            laws = self.laws(fit.tails, fit.values)
            new = fit_tail(tail.id, self.standing_out(fit), others, laws, start=tail)
            fit = replace(fit, tails=tuple(new if t.id == tail.id else t for t in fit.tails))
        return self.fit(fit.ids, fit.free, fit.values, fit.tails)

    def density(self, fit: Fit, which: NDArray[np.bool_]) -> Array:
        """Return the log density of the bins of a mask, (n,) [nats per DN]."""
        seen = self.seen(fit.values, fit.scale, np.flatnonzero(which.ravel()))
        return log_density(seen, fit.tails, self.laws(fit.tails, fit.values))

    def _weigh(
        self, values: Mapping[str, float], tails: tuple[Tail, ...], laws: dict[str, Law]
    ) -> tuple[float, Array, float]:
        """Return the scale, the weights of the squared residuals and the log likelihood of the open bins."""
        mean = self.model(values)
        plain = ((self.photograph.data - mean) / self.deviation).ravel()[self.opened]
        share = np.ones(plain.shape)
        scale = core_scale(plain, share)
        weight = _t_weight(plain, scale, share)
        deviation = self.deviation.ravel()[self.opened]
        if not tails:
            score = core_log_density(plain * deviation, scale * deviation).sum()
            return scale, weight / (scale * deviation) ** 2, float(score)
        share = core_share(self.seen(values, scale), tails, laws)
        scale = core_scale(plain, share, scale)
        weight = _t_weight(plain, scale, share)
        score = log_density(self.seen(values, scale), tails, laws).sum()
        return scale, weight / (scale * deviation) ** 2, float(score)

    def _slopes(self, values: Mapping[str, float], free: tuple[Free, ...]) -> tuple[Array, Array]:
        mean = self.model(values)
        columns = []
        for f in free:
            step = f.step if values[f.name] + f.step <= f.high else -f.step
            moved = self.model({**values, f.name: values[f.name] + step})
            columns.append(((moved - mean) / step).ravel()[self.opened])
        return np.array(columns), (self.photograph.data - mean).ravel()[self.opened]

    def _held_out(
        self,
        values: Mapping[str, float],
        free: tuple[Free, ...],
        tails: tuple[Tail, ...],
        laws: dict[str, Law],
        scale: float,
        weight: Array,
    ) -> Array:
        slopes, residual = self._slopes(values, free)
        seen = self.seen(values, scale)
        total = np.zeros(self.blocks)
        # where the fit stopped short of its optimum, all folds would step on towards it: that part is no news of a fold
        onward = _solve(slopes, weight, residual, values, free, 1e-6)
        for k in range(FOLDS):
            inside = self.fold == k
            step = -onward + _solve(slopes[:, ~inside], weight[~inside], residual[~inside], values, free, 1e-6)
            shift = step @ slopes[:, inside]
            part = seen.some(inside)
            # the scale moves little from fold to fold; the mean is what a fold must not have taught
            moved = replace(part, residual=part.residual - shift, excess=part.excess - shift * part.slope)
            total += np.bincount(self.block[inside], weights=log_density(moved, tails, laws), minlength=self.blocks)
        return total


def core_scale(plain: Array, share: Array, start: float | None = None) -> float:
    """Return the scale of the core's t law for residuals over the noise, each counted by its share in the core."""
    scale = max(1.4826 * float(np.median(np.abs(plain))), 0.2) if start is None else start
    for _ in range(8):
        scale = float(np.sqrt((_t_weight(plain, scale, share) * plain**2).sum() / share.sum()))
    return scale


def _t_weight(plain: Array, scale: float, share: Array) -> Array:
    return np.asarray(share * (FREEDOM + 1) / (FREEDOM + (plain / scale) ** 2))


def _solve(
    slopes: Array, weight: Array, residual: Array, values: Mapping[str, float], free: tuple[Free, ...], damping: float
) -> Array:
    """Return the weighted Gauss-Newton step; numbers that would leave their bounds stay where they are."""
    weighted = slopes * weight
    normal, pull = weighted @ slopes.T, weighted @ residual
    kept = np.diag(normal) > 0
    step = np.zeros(len(free))
    for _ in range(len(free)):
        index = np.flatnonzero(kept)
        if not index.size:
            break
        size = np.sqrt(np.diag(normal)[index])
        scaled = normal[np.ix_(index, index)] / np.outer(size, size) + damping * np.eye(index.size)
        step[:] = 0.0
        step[index] = np.linalg.solve(scaled, pull[index] / size) / size
        at = np.array([values[f.name] for f in free])
        out = kept & (((at <= [f.low for f in free]) & (step < 0)) | ((at >= [f.high for f in free]) & (step > 0)))
        if not out.any():
            break
        kept &= ~out
    return step


def _noise(photograph: Photograph, mean: Array) -> tuple[dict[str, float], Array]:
    """Measure the noise of even print and return its deviation in every bin [DN].

    Even print is where neither neighbour's share of bright differs; its noise is the median absolute difference from a
    local median, of dark and of bright squares, variance linear in the level between. At edges the error of the fitted
    corners, times the believed picture's slope, adds, and a share of the step, because no lens draws it as the model's
    Gaussian does.
    """
    data = photograph.data
    local = ndimage.median_filter(data, size=NOISE_WINDOW)
    rise = np.hypot(*np.gradient(mean))
    spread = ndimage.maximum_filter(mean, 5) - ndimage.minimum_filter(mean, 5)
    even = photograph.opened & (spread < EVEN_SLOPE_DN)
    levels, variances = [], []
    for which in (photograph.share < 0.5, photograph.share >= 0.5):
        some = even & which
        # a median of n pixels takes pi/(2n) of the variance along
        lost = 1.0 + np.pi / (2 * NOISE_WINDOW**2)
        levels.append(float(np.median(local[some])))
        variances.append(
            float((1.4826 * np.median(np.abs((data - local)[some]))) ** 2 / lost + 1 / 12 / photograph.bin_px**2)
        )
    slope = (variances[1] - variances[0]) / max(levels[1] - levels[0], 1.0)
    level = np.clip(local, levels[0], levels[1])
    variance = np.maximum(variances[0] + slope * (level - levels[0]), min(variances))
    figures = {"dark": float(np.sqrt(variances[0])), "bright": float(np.sqrt(variances[1]))}
    return figures, np.sqrt(variance + (photograph.corner_error_px * rise) ** 2 + (BLUR_FORM * spread) ** 2)
