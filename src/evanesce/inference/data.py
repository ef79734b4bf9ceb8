"""One vector of whitened data for everything that is compared: here the bins of a bundle's frames.

Weights follow the measured level about a bin, not a prediction, so that a nominal model far from the truth does not
choose what it is judged by.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from evanesce.inference.constants import STEP_SHARE
from evanesce.prediction import priors
from evanesce.prediction.colour import expected_grey
from evanesce.prediction.correlation import Correlation, of_fields
from evanesce.prediction.noise import Noise, noise_of
from evanesce.prediction.noise_scale import LIT_SHARE, noise_scale_of
from evanesce.prediction.observe import Observation, model_factor
from evanesce.prediction.tone import ExpectedTone
from evanesce.prediction.views import View

Array = NDArray[Any]

SATURATED = 254.0 / 255.0
"""Share of a full pixel's level, from which on a bin shows the end of the scale and nothing else."""
BELOW_END_SD = 3.0
"""Standard deviations that a bin's level has to be below that."""
EVEN_SHARE = 0.1
"""Step from a bin to its neighbours, over its level, up to which its scatter is that of its level."""
ALIKE = 1000
"""Bins of like prediction whose mean residual is added to it: how large noise is goes by that level."""
WIDE = np.zeros((19, 19), bool)
"""Bins about each with what is left then in their mean."""
WIDE[::3, ::3] = True
WIDE[9, 9] = False
AROUND = np.pad(np.zeros((3, 3), bool), 1, constant_values=True)
"""The nearest ones.

Neither the bin itself nor those next to it, with which noise is correlated: where variance rises with the level, bins
that are low by chance would have a smaller one, and weigh more than high ones. Darkness in single frames came out below
that in means of many.
"""
OTHER_SD = 5.0
"""Standard deviations of a bin's noise from their median, beyond which a residual is an edge beside it."""
SHRUNK = 4.0
"""A mean residual about a bin is zero up to so many times its variance, and shrunk beyond (James and Stein, 1961)."""
LEAST_BINS = 20
"""Of contact, from which its noise is read: a standard deviation from several frames of each is then good to 10 %."""
SCALE_STEP = 2.0 * priors.SCALE_CLOSE
"""Of the logarithm of the noise's scale: bundles of one camera then share their forms, which are kept by it."""
LEAST_SD_DN = 1e-3
"""Where black is clipped and nothing scatters; rounding makes it larger before anything is weighed by it."""


@dataclass(frozen=True)
class DataVector:
    """Data of several views with their standard deviations.

    Attributes
    ----------
    cube : ndarray (views, rows, cols)
        Means of the bins [DN].
    sd : ndarray (views, rows, cols)
        Standard deviations: noise, and the prediction's discretisation [DN].
    valid : ndarray of bool (views, rows, cols)
    views : tuple of View
    noise : Noise
    scale : float
        Real over modelled noise before the tone curve.
    scale_deviation : float
        Prior standard deviation of its logarithm.
    correlation : Correlation, optional
        Of the noise, where bins of held states err together, or a codec hands errors on from view to view.
    """

    cube: Array
    sd: Array
    valid: NDArray[np.bool_]
    views: tuple[View, ...]
    noise: Noise
    scale: float
    scale_deviation: float
    correlation: Correlation | None = None

    @property
    def open(self) -> tuple[int, ...]:
        """Numbers of the views that fits may use."""
        return tuple(k for k, view in enumerate(self.views) if not view.locked)

    @property
    def held_out(self) -> tuple[int, ...]:
        """Numbers of the views that are kept for the gain."""
        return tuple(k for k, view in enumerate(self.views) if view.locked)

    def over_noise(self, cube: Array, views: Sequence[int] | None = None) -> Array:
        """Return some views (the open ones by default) of a cube over their noise: (chosen views, rows, cols).

        Parameters
        ----------
        cube : ndarray (views, rows, cols)
            [DN].
        views : sequence of int, optional
        """
        chosen = list(self.open if views is None else views)
        found = np.where(self.valid[chosen], cube[chosen] / self.sd[chosen], 0.0)
        return found if self.correlation is None else self.correlation.whitened(found, chosen)

    def whitened(self, cube: Array, views: Sequence[int] | None = None) -> Array:
        """Return the valid bins of some views (the open ones by default) of a cube over their noise, in a row.

        Parameters
        ----------
        cube : ndarray (views, rows, cols)
            [DN].
        views : sequence of int, optional

        Returns
        -------
        ndarray (bins,)
        """
        chosen = list(self.open if views is None else views)
        return np.asarray(self.over_noise(cube, chosen)[self.valid[chosen]])

    def unwhitened(self, row: Array, views: Sequence[int] | None = None) -> Array:
        """Return whitened bins as a cube (chosen views, rows, cols) of whitened values, 0 where not valid."""
        chosen = list(self.open if views is None else views)
        cube = np.zeros((len(chosen), *self.cube.shape[1:]))
        # Rows of series, where there are any, follow those of the bins.
        cube[self.valid[chosen]] = row[: int(self.valid[chosen].sum())]
        return cube

    @property
    def conditions(self) -> NDArray[np.int_]:
        """Condition of each whitened bin of the open views: frames of one force, voltage and session share it."""
        names = [
            (v.kind, v.session, v.condition) if v.kind == "press" else (v.kind, 0, 0)
            for v in (self.views[k] for k in self.open)
        ]
        number = {name: k for k, name in enumerate(dict.fromkeys(names))}
        counts = [int(self.valid[k].sum()) for k in self.open]
        return np.repeat([number[name] for name in names], counts)


def data_vector(observation: Observation, predicted: Array | None = None) -> DataVector:
    """Return the data of an observation's frames.

    Parameters
    ----------
    observation : Observation
    predicted : ndarray (views, rows, cols), optional
        By the nominal model; what it leaves, smoothed, is added before levels are read off it [DN].

    Returns
    -------
    DataVector
    """
    scale, deviation = lit_noise_scale(observation)
    cube = observation.cube
    pixels = model_factor(observation.believed)
    tone = expected_grey(observation.believed, scale, pixels=pixels)
    # No floor that counts: what the model may be off by is said by the discretisation below and by the discrepancy.
    noise = noise_of(observation.held, tone, cube.shape[1:], floor_DN=LEAST_SD_DN, flicker=priors.FLICKER)
    if observation.believed.camera.colour is not None:
        noise = replace(noise, lamp=expected_grey(observation.believed, scale, card=True, pixels=pixels))
    frames, card = (np.array([(v.frames, v.is_card) for v in observation.views]).T)[:, :, None, None]

    def variance_at(level: Array) -> Array:
        return noise.variance(level, frames, card == 1)

    level = _levels(cube, np.zeros_like(cube) if predicted is None else predicted, variance_at)
    variance = variance_at(level) + step_sd(cube) ** 2 + rounding_sd(tone, level) ** 2
    correlation = of_fields(noise.fields, len(observation.views)) if noise.measured else None
    sd, end = np.sqrt(variance), SATURATED * noise.full_DN(card == 1)
    # Of bins about the end of the scale those would be left that are low by chance.
    valid = (cube < end) & (level + BELOW_END_SD * sd < end)
    return DataVector(cube, sd, valid, observation.views, noise, scale, deviation, correlation)


def _levels(cube: Array, predicted: Array, variance_at: Callable[[Array], Array]) -> Array:
    """Return the levels by which noise goes: a prediction, corrected by what is left in ever smaller neighbourhoods.

    First among all bins of a view that are predicted alike: near black half a DN changes noise by an eighth, and of a
    single frame only a thousand bins show it to a per cent.
    """

    def sd_at(level: Array) -> Callable[[Array], Array]:
        return lambda left: np.sqrt(variance_at(level + left))

    level = predicted + _among_alike(cube - predicted, predicted, sd_at(predicted))
    for around in (WIDE, AROUND):
        level = level + _about_bins(cube - level, sd_at(level), around)
    return level


def _among_alike(left: Array, predicted: Array, sd_of: Callable[[Array], Array]) -> Array:
    """Return the mean of what is left in each view where as much is predicted, without what an edge leaves.

    Parameters
    ----------
    left, predicted : ndarray (views, rows, cols)
        [DN].
    sd_of : callable
        As of :func:`_about_bins`.
    """
    found, noise = np.empty_like(left), sd_of(np.zeros_like(left))
    for k in range(len(left)):
        order = np.argsort(predicted[k], axis=None, kind="stable")
        groups = np.array_split(order, max(order.size // ALIKE, 1))
        mine, sd = left[k].ravel(), noise[k].ravel()
        means = []
        for group in groups:
            middle = np.median(mine[group])
            beside = np.abs(mine[group] - middle)
            means.append(np.mean([middle, *mine[group][beside <= OTHER_SD * np.median(sd[group])]]))
        found[k] = np.interp(predicted[k], [predicted[k].ravel()[group].mean() for group in groups], means)
    return found


def _about_bins(left: Array, sd_of: Callable[[Array], Array], around: Array) -> Array:
    """Return the mean of what is left about each bin, without what an edge beside it leaves there.

    A contact that is predicted a little beside its place leaves tens of DN along its rim. Darkness beside it would be
    taken for darker or lighter than it is, and its noise, which goes by the level, for a tenth or ten times as large.

    Parameters
    ----------
    left : ndarray (views, rows, cols)
        Data less prediction [DN].
    sd_of : callable
        ``sd_of(left (views, rows, cols)) -> ndarray``: noise of a bin with so much beside the prediction [DN].
    around : ndarray of bool (side, side)
        Which bins, the middle one standing for the bin itself.
    """
    middle = ndimage.median_filter(left, footprint=around[None], mode="reflect")
    # Of a few values the median may be low by chance, and the noise there small: it is at least the prediction's.
    noise = np.maximum(sd_of(middle), sd_of(np.zeros_like(left)))
    half = len(around) // 2
    padded = np.pad(left, ((0, 0), (half, half), (half, half)), mode="symmetric")
    rows, cols = left.shape[1:]
    total, count = np.zeros_like(left), np.zeros_like(left)
    for down, right in np.argwhere(around):
        beside = padded[:, down : down + rows, right : right + cols]
        alike = np.abs(beside - middle) <= OTHER_SD * noise
        total += np.where(alike, beside, 0.0)
        count += alike
    # The median itself is one of them. What noise may be is none: levels would scatter, and small variances weigh most.
    mean = total / count
    share = 1.0 - SHRUNK * noise**2 / count / np.maximum(mean**2, 1e-12)
    return np.asarray(mean * np.maximum(share, 0.0))


def lit_noise_scale(observation: Observation) -> tuple[float, float]:
    """Return real over modelled noise before the tone curve, and the prior standard deviation of its logarithm.

    From single pixels of held states at levels where the place of black makes no difference to their scatter: below, a
    displaced black level looks like another noise. 1 where there are none. Rounded to :data:`SCALE_STEP`.

    Parameters
    ----------
    observation : Observation
    """
    scale, deviation = _measured_scale(observation)
    return stepped(scale, SCALE_STEP), deviation


def stepped(scale: float, step: float) -> float:
    """Return a scale whose logarithm is the nearest multiple of a step."""
    return float(np.exp(step * np.round(np.log(scale) / step)))


def _measured_scale(observation: Observation) -> tuple[float, float]:
    tone_of = partial(expected_grey, observation.believed)
    size = noise_scale_of(tone_of, observation.scatter, coded=observation.coded)
    if size.codec:
        # What scatter a codec left says nothing of the noise before the tone curve.
        return size.value, size.deviation
    parts = list(observation.scatter.values())
    if not parts:
        return 1.0, priors.SCALE_LOOSE
    level, variance = (np.concatenate([np.ravel(part[k]) for part in parts]) for k in (0, 1))
    tone = tone_of(1.0)
    # A bin over an edge scatters by its pixels' levels, not by their mean.
    even = np.concatenate([np.ravel(np.hypot(*np.gradient(part[0])) < EVEN_SHARE * part[0]) for part in parts])
    lit = (level > LIT_SHARE * tone.full_DN) & (level < SATURATED * tone.full_DN) & even
    if lit.sum() < LEAST_BINS:
        return 1.0, priors.SCALE_LOOSE
    modelled = float(tone.variance_at(level[lit]).mean())
    return float(np.clip(np.sqrt(variance[lit].mean() / modelled), 0.1, 3.0)), priors.SCALE_CLOSE


def rounding_sd(tone: ExpectedTone, level_DN: Array) -> Array:
    """Return by how much rounding may displace the mean of many pixels [DN].

    Noise of standard deviation s before rounding leaves of the stair a wave of amplitude exp(-2 pi^2 s^2) / pi (Widrow
    and Kollar, Quantization Noise, 2008): nothing from half a DN on, a third of a DN where there is no noise, as where
    black is clipped.
    """
    before = np.maximum(tone.variance_at(level_DN) / tone.step_DN**2 - 1.0 / 12.0, 0.0)
    return np.asarray(tone.step_DN * np.exp(-2.0 * np.pi**2 * before) / np.pi)


def step_sd(cube: Array) -> Array:
    """Return what pixels of finite size leave of a fine model at each bin (views, rows, cols) [DN].

    It goes by the step from a bin to its neighbours.
    """
    return STEP_SHARE * np.stack([np.hypot(*np.gradient(one)) for one in np.asarray(cube, float)])
