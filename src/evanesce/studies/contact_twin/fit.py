"""Fits of a contact frame with more and more causes, each judged on blocks that no fit has seen."""

from __future__ import annotations

import itertools
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares, minimize
from scipy.stats import t as student

from evanesce.studies.contact_twin.model import KELVIN, Model
from evanesce.studies.contact_twin.picture import BLOCK

Array = NDArray[np.float64]

ROBUST_DN = 12.0
"""Residuals beyond this count less: a few pixels of what is not modelled must not decide."""
TAIL = 4.0
"""Degrees of freedom of the residuals' distribution in the score: heavier tails than normal, finite variance."""
LEAST_DN = 1.0
"""No channel is predicted better than a picture of whole numbers allows."""
PRIOR_SD = {"green": 0.35, "blue": 0.5, "temperature": 0.3, "cloud": 0.5, "_right": 0.7, "_down": 0.7}
"""Standard deviations of weak priors about what is published: what the frame does not determine stays near that."""
MOST_EVALUATIONS = 60
STREAK_PX, LEAST_STREAK_PX = 1.5, 8
"""Half width of the band in which a streak is looked for, and how many pixels it needs there [px]."""
COARSE_DN = 8.0
"""Colours are rounded to this where filters and white balance are looked for: finer than what is robust."""
TRIED = {
    "temperature": np.log(np.array([2400.0, 2850.0, 3250.0, 4000.0, 5000.0, 5900.0])),
    "green": np.log(np.array([0.04, 0.06, 0.08, 0.1, 0.12, 0.15, 0.2, 0.27, 0.35])),
    "blue": np.log(np.array([0.01, 0.02, 0.03, 0.04, 0.05, 0.06, 0.08, 0.1, 0.15])),
}
"""Colour temperature [K], green and blue shares of the red one [1], as logarithms."""


@dataclass(frozen=True)
class Fit:
    """A model with some causes, fitted to the blocks that may be seen.

    Attributes
    ----------
    causes : tuple of str
    value : dict of float
        Every parameter.
    predicted : ndarray (rows, cols, 3)
        [DN].
    spread : ndarray (3,)
        Scale of each channel's residuals on the fitted blocks [DN].
    free : tuple of str
        Names of the parameters that were fitted.
    covariance : ndarray (free, free)
        Of the parameters that were fitted: residuals of one block vary together.
    cost : float
        What the fit has made least [1].
    """

    causes: tuple[str, ...]
    value: dict[str, float]
    predicted: Array
    spread: Array
    free: tuple[str, ...]
    covariance: Array
    cost: float


def fit(model: Model, causes: Collection[str], starts: Sequence[Mapping[str, float]] = ({},)) -> Fit:
    """Fit a model with some causes.

    Parameters
    ----------
    model : Model
    causes : collection of str
    starts : sequence of mappings of str to float
        Where parameters begin, others as their table says; the best of the fits is returned.

    Returns
    -------
    Fit
    """
    return min((_fit(model, causes, start) for start in starts), key=lambda found: found.cost)


def _fit(model: Model, causes: Collection[str], given: Mapping[str, float]) -> Fit:
    table = model.table
    free = tuple(name for name, p in table.items() if p.acts(causes) and p.cause != "response")
    scale = np.array([table[n].scale for n in free])
    begin = np.array([np.clip(given.get(n, table[n].start), table[n].low, table[n].high) for n in free])
    seen = ~model.picture.held_out
    priors = [(k, sd) for k, name in enumerate(free) for ending, sd in PRIOR_SD.items() if _is(name, ending)]

    def values(vector: Array) -> dict[str, float]:
        return model.values({**given, **dict(zip(free, vector.tolist(), strict=True))}, causes)

    def residuals(steps: Array) -> Array:
        vector = steps * scale
        left = (model.predict(values(vector), causes) - model.picture.data)[seen].ravel() / ROBUST_DN
        return np.concatenate([_softened(left), [(vector[k] - table[free[k]].null) / sd for k, sd in priors]])

    low, high = (np.array([getattr(table[n], end) for n in free]) / scale for end in ("low", "high"))
    inside = np.clip(begin / scale, low + 1e-6, high - 1e-6)

    def jacobian(steps: Array) -> Array:
        # Differences over a tenth of a step that is small for each number: relative ones vanish at 0.
        columns, here = [], residuals(steps)
        for k in range(len(steps)):
            width = np.zeros(len(steps))
            width[k] = 0.1 if steps[k] + 0.1 < high[k] else -0.1
            columns.append((residuals(steps + width) - here) / width[k])
        return np.stack(columns, axis=1)

    found = least_squares(residuals, inside, jac=jacobian, bounds=(low, high), max_nfev=MOST_EVALUATIONS, x_scale="jac")
    value = values(found.x * scale)
    predicted = model.predict(value, causes)
    spread = _scale((predicted - model.picture.data)[seen])
    blocks = np.repeat(_block_numbers(model)[seen], 3)
    covariance = _covariance(found.jac, found.fun, blocks) * np.outer(scale, scale)
    return Fit(tuple(causes), value, predicted, spread, free, covariance, float(found.cost))


def _block_numbers(model: Model) -> NDArray[np.int64]:
    rows, cols = np.indices(model.picture.shape) // BLOCK
    return np.asarray(rows * (cols.max() + 1) + cols)


def _covariance(jacobian: Array, residual: Array, blocks: NDArray[np.int64]) -> Array:
    """Return the covariance of fitted numbers: the larger, number by number, of two.

    By the curvature alone, residuals taken for independent with the variance they have; and by the gradients of whole
    blocks, which vary together where the model lacks something (clustered sandwich). Priors count as rows of their own.
    """
    hessian = jacobian.T @ jacobian
    inverse = np.linalg.pinv(hessian + 1e-9 * np.diag(np.diag(hessian)))
    plain = inverse * max(1.0, float((residual[: blocks.size] ** 2).mean()))
    numbers = np.concatenate([blocks, blocks.max() + 1 + np.arange(residual.size - blocks.size)])
    gradients = np.zeros((int(numbers.max()) + 1, jacobian.shape[1]))
    np.add.at(gradients, numbers, jacobian * residual[:, None])
    clustered = inverse @ (gradients.T @ gradients) @ inverse
    variance = np.diag(clustered)
    # A number that no block tells anything of has no correlation with others, and the curvature's variance.
    own = np.where(variance > 0, 1.0 / np.sqrt(np.where(variance > 0, variance, 1.0)), 0.0)
    correlation = np.clip(own[:, None] * clustered * own, -1.0, 1.0)
    np.fill_diagonal(correlation, 1.0)
    deviation = np.sqrt(np.maximum(variance, np.abs(np.diag(plain))))
    return np.asarray(deviation[:, None] * correlation * deviation)


def _is(name: str, ending: str) -> bool:
    return name == ending or name.startswith(f"{ending}_") or (ending.startswith("_") and name.endswith(ending))


def _softened(left: Array) -> Array:
    """Return residuals whose squares are the soft absolute value of what they were."""
    return np.sign(left) * np.sqrt(2.0 * (np.sqrt(1.0 + left**2) - 1.0))


def _scale(left: Array) -> Array:
    """Return the scale of a Student distribution for each channel's residuals (n, 3), by maximum likelihood."""
    scale = np.maximum(1.4826 * np.median(np.abs(left), axis=0), LEAST_DN)
    for _ in range(50):
        weight = (TAIL + 1.0) / (TAIL + (left / scale) ** 2)
        scale = np.maximum(np.sqrt((weight * left**2).mean(axis=0)), LEAST_DN)
    return np.asarray(scale)


def log_score(model: Model, found: Fit) -> Array:
    """Return the logarithm of the predictive density of each pixel, all channels (rows, cols) [nat].

    Parameters
    ----------
    model : Model
    found : Fit
    """
    left = model.picture.data - found.predicted
    return np.asarray(student.logpdf(left / found.spread, TAIL).sum(axis=-1) - np.log(found.spread).sum())


def response_of(model: Model) -> dict[str, float]:
    """Return filters and white balance under which one level at each pixel comes nearest to the colours that are seen.

    A level of its own at each pixel is what all causes together can do at the most, wherever they put their light: what
    is found so does not depend on them. Weak priors hold the filters near the published ones.

    Parameters
    ----------
    model : Model

    Returns
    -------
    dict of float
        Parameters of the cause ``response``.
    """
    seen = model.picture.data[~model.picture.held_out]
    # Some hundred colours stand for all: each pixel's, rounded.
    colours, count = np.unique(np.round(seen / COARSE_DN), axis=0, return_counts=True)
    names = tuple(TRIED)

    def misfit(logs: Array) -> float:
        value = dict(zip(names, logs.tolist(), strict=True))
        prior = sum(((value[n] - model.table[n].null) / PRIOR_SD[n]) ** 2 for n in names)
        if not KELVIN[0] <= value["temperature"] <= KELVIN[1]:
            return 1e12
        square = ((colours[:, None] * COARSE_DN - model.curve(value)[::10]) ** 2).sum(axis=2).min(axis=1)
        return float(count @ (square / ROBUST_DN**2)) + prior

    start = min((np.array(one) for one in itertools.product(*TRIED.values())), key=misfit)
    found = minimize(misfit, start, method="Nelder-Mead", options={"xatol": 1e-3, "fatol": 1e-3, "maxfev": 400})
    return dict(zip(names, found.x.tolist(), strict=True))


def streak_start(model: Model, found: Fit) -> dict[str, float]:
    """Return the line outwards from the finger's rim along which a frame is brightest beyond what a fit makes of it.

    Parameters
    ----------
    model : Model
    found : Fit
        Without reflections.

    Returns
    -------
    dict of float
        Where a streak begins and its direction. Blocks that are held out are not looked at.
    """
    left = (model.picture.data - found.predicted).mean(axis=-1)
    y, x = np.nonzero(~model.picture.held_out)
    value, radius = found.value, found.value["rim_px"]
    best: tuple[float, dict[str, float]] = (-np.inf, {})
    for around in np.arange(0.0, 2 * np.pi, np.pi / 36):
        foot = np.array([value["x"] + radius * np.cos(around), value["y"] + radius * np.sin(around)])
        dx, dy = x - foot[0], y - foot[1]
        for angle in around + np.arange(-6, 7) * np.pi / 18:
            along, away = dx * np.cos(angle) + dy * np.sin(angle), dx * np.sin(angle) - dy * np.cos(angle)
            here = (along > 0) & (np.abs(away) < STREAK_PX)
            if here.sum() >= LEAST_STREAK_PX:
                gain = float(left[y[here], x[here]].mean() * np.sqrt(here.sum()))
                start = {
                    "streak_x": float(foot[0]),
                    "streak_y": float(foot[1]),
                    "streak_angle": float(angle % (2 * np.pi)),
                }
                best = max(best, (gain, start), key=lambda one: one[0])
    return best[1] | {"streak_level": -1.5, "streak_width": STREAK_PX / 2}
