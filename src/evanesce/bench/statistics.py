"""Statistics of the thesis's bench tests (by scipy): variance analysis, histograms, modes, repeatability."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import optimize, stats

MAX_BINS = 10_000


def freedman_diaconis_width(values: ArrayLike) -> float:
    """Return the bin width 2 IQR n^(-1/3), in the unit of the values.

    The thesis prints the exponent with the wrong sign (eq 4.4).

    Parameters
    ----------
    values : array_like

    Returns
    -------
    float

    References
    ----------
    D. Freedman and P. Diaconis, Z. Wahrscheinlichkeitstheorie verw. Gebiete 57 (1981) 453.
    """
    x = np.asarray(values, dtype=float).ravel()
    return float(2.0 * stats.iqr(x) / np.cbrt(len(x)))


def histogram(values: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return (density, edges) with Freedman-Diaconis bins, at most 10,000; one when all values are equal.

    Parameters
    ----------
    values : array_like
        Finite.

    Returns
    -------
    tuple of ndarray
        Density (n,) and bin edges (n + 1,).
    """
    x = np.asarray(values, dtype=float).ravel()
    if len(x) == 0 or not np.isfinite(x).all():
        raise ValueError("a histogram needs finite values")
    width, span = freedman_diaconis_width(x), float(np.ptp(x))
    # A few outliers beside a narrow bulk would ask for millions of bins.
    count = 1 if width == 0.0 or span == 0.0 else min(MAX_BINS, max(1, int(np.ceil(span / width))))
    return np.histogram(x, bins=count, density=True)


def kernel_density_mode(values: ArrayLike) -> float:
    """Return the mode of a Gaussian kernel density (Scott's bandwidth), located to 1e-6 of the values' range.

    Parameters
    ----------
    values : array_like
        Finite, two at least.

    Returns
    -------
    float
        In the unit of the values.
    """
    x = np.asarray(values, dtype=float).ravel()
    if len(x) < 2 or not np.isfinite(x).all():
        raise ValueError("a kernel density needs at least 2 finite values")
    span = float(np.ptp(x))
    if span == 0.0:
        return float(x[0])
    density = stats.gaussian_kde(x)
    grid = np.linspace(x.min(), x.max(), 513)
    best = int(np.argmax(density(grid)))
    low, high = grid[max(0, best - 1)], grid[min(512, best + 1)]
    found = optimize.minimize_scalar(
        lambda v: -density(v)[0], bounds=(low, high), method="bounded", options={"xatol": 1e-6 * span}
    )
    return float(found.x)


@dataclass(frozen=True)
class PairwiseDifference:
    """Tukey's comparison of two groups.

    Attributes
    ----------
    first, second : str
        Names of the groups.
    difference : float
        Of their means.
    low, high : float
        Confidence interval of the difference.
    p_value : float
    """

    first: str
    second: str
    difference: float
    low: float
    high: float
    p_value: float


@dataclass(frozen=True)
class Anova:
    """One-way analysis of variance, with Tukey's honestly significant differences where it is significant.

    Attributes
    ----------
    f_statistic, p_value : float
    significant : bool
        p below ``alpha``.
    alpha : float
    pairs : tuple of PairwiseDifference
        Empty where the analysis of variance is not significant.
    """

    f_statistic: float
    p_value: float
    significant: bool
    alpha: float
    pairs: tuple[PairwiseDifference, ...]


def one_way_anova(groups: Mapping[str, ArrayLike], alpha: float = 0.05) -> Anova:
    """Compare group means as the thesis does: one-way ANOVA, and Tukey's HSD only if it is significant.

    Parameters
    ----------
    groups : mapping of str to array_like
    alpha : float
        Level of significance.

    Returns
    -------
    Anova

    Raises
    ------
    ValueError
        For fewer than two groups, a group of fewer than two values, or no variance anywhere.
    """
    names = list(groups)
    data = [np.asarray(groups[name], dtype=float).ravel() for name in names]
    if len(names) < 2 or min(map(len, data)) < 2:
        raise ValueError("an analysis of variance needs at least two groups of at least two values")
    if not all(np.isfinite(group).all() for group in data):
        raise ValueError("a group holds a value that is not finite")
    if all(np.ptp(group) == 0.0 for group in data):
        raise ValueError("no group varies: repeats that are all equal say nothing about significance")
    test = stats.f_oneway(*data)
    significant = bool(test.pvalue < alpha)
    pairs: list[PairwiseDifference] = []
    if significant:
        tukey = stats.tukey_hsd(*data)
        interval = tukey.confidence_interval(1.0 - alpha)
        pairs = [
            PairwiseDifference(
                names[i],
                names[j],
                float(tukey.statistic[i, j]),
                float(interval.low[i, j]),
                float(interval.high[i, j]),
                float(tukey.pvalue[i, j]),
            )
            for i in range(len(names))
            for j in range(i + 1, len(names))
        ]
    return Anova(float(test.statistic), float(test.pvalue), significant, alpha, tuple(pairs))


@dataclass(frozen=True)
class Repeatability:
    """Repeatability of repeated measurements.

    Attributes
    ----------
    mean : float
    within_std : float
        Repeatability standard deviation s_r, pooled over the groups.
    between_std : float
        Standard deviation between groups beyond what s_r explains; 0 where it explains all.
    limit : float
        Repeatability limit 1.96 sqrt(2) s_r: two repeats differ by less in 95 % of cases.
    coefficient_of_variation : float
        s_r over the mean.
    intraclass_correlation : float
        Share of variance that lies between groups.
    """

    mean: float
    within_std: float
    between_std: float
    limit: float
    coefficient_of_variation: float
    intraclass_correlation: float


def repeatability(groups: Mapping[str, ArrayLike]) -> Repeatability:
    """Return the repeatability of repeats grouped by specimen, from the one-way random-effects model.

    Parameters
    ----------
    groups : mapping of str to array_like
        Repeats by specimen.

    Returns
    -------
    Repeatability

    References
    ----------
    ISO 5725-2:2019, Accuracy of measurement methods and results, part 2.
    """
    data = [np.asarray(values, dtype=float).ravel() for values in groups.values()]
    count = sum(map(len, data))
    dof = count - len(data)
    if dof < 1:
        raise ValueError("repeatability needs at least one group with two values")
    mean = float(np.concatenate(data).mean())
    within = sum(float(np.sum((g - g.mean()) ** 2)) for g in data) / dof
    between = 0.0
    if len(data) > 1:
        mean_square = sum(len(g) * float(g.mean() - mean) ** 2 for g in data) / (len(data) - 1)
        typical = (count - sum(len(g) ** 2 for g in data) / count) / (len(data) - 1)
        between = max(0.0, (mean_square - within) / typical)
    total = within + between
    return Repeatability(
        mean,
        float(np.sqrt(within)),
        float(np.sqrt(between)),
        float(1.96 * np.sqrt(2.0 * within)),
        float(np.sqrt(within) / abs(mean)) if mean else float("inf"),
        between / total if total else 0.0,
    )
