"""The battery: does anything of structure remain in what a model leaves, wherever it may be?

Every test is a statistic of the whitened residuals, computed in the same way for the data and for draws of pure noise
from which the same nuisances were taken. Each statistic gets a tail law from its draws; the smallest tail probability
of all is compared with the smallest of each draw (Westfall & Young, Resampling-Based Multiple Testing, 1993), so that
the number of tests and their correlation cost just what they cost.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from evanesce.criticism.battery_data import Draws, Residuals, Statistic, Tail
from evanesce.criticism.battery_statistics import battery_tests

Array = NDArray[Any]


@dataclass(frozen=True)
class Outcome:
    """Of one test.

    Attributes
    ----------
    name : str
    statistic : float
    p : float
        Share of draws as large, (1 + #) / (1 + B).
    tail_p : float
        By the tail law; says how far beyond the draws it lies, not calibrated there.
    """

    name: str
    statistic: float
    p: float
    tail_p: float


@dataclass(frozen=True)
class BatteryResult:
    """Of all tests.

    Attributes
    ----------
    global_p : float
        That pure noise makes any of the tests ring as loudly: (1 + #) / (1 + B).
    outcomes : tuple of Outcome
        Loudest first.
    draws : int
        B.
    """

    global_p: float
    outcomes: tuple[Outcome, ...]
    draws: int

    @property
    def loudest(self) -> Outcome:
        """The test with the smallest tail probability."""
        return self.outcomes[0]

    @property
    def beyond_draws(self) -> float:
        """Probability of the loudest test by its tail law, times the tests; no more than ``global_p``.

        Draws count no further than 1 / (1 + B): what is much louder than all of them still has a size.
        """
        return min(self.global_p, len(self.outcomes) * max(self.loudest.tail_p, 1e-300))


def run_battery(
    residuals: Residuals, draws: Iterable[Draws], extra: Mapping[str, Statistic] | None = None
) -> BatteryResult:
    """Test residuals against draws of pure noise.

    Parameters
    ----------
    residuals : Residuals
    draws : iterable of Draws
        In chunks; at least 999 in all for a level of 1 %.
    extra : mapping of str to Statistic, optional
        More members of the family, such as the score tests of the candidates.

    Raises
    ------
    ValueError
        For fewer than 19 draws.
    """
    tests = battery_tests(residuals) | dict(extra or {})
    return judge(tests, residuals, null_samples(tests, draws))


def null_samples(tests: Mapping[str, Statistic], draws: Iterable[Draws]) -> dict[str, Array]:
    """Return every test's statistic for every draw: (draws,) by name.

    Raises
    ------
    ValueError
        For fewer than 19 draws.
    """
    parts: dict[str, list[Array]] = {name: [] for name in tests}
    for chunk in draws:
        for name, test in tests.items():
            parts[name].append(test.of(chunk))
    null = {name: np.concatenate(found) for name, found in parts.items()}
    count = next(iter(null.values())).size
    if count < 19:
        raise ValueError(f"{count} draws cannot tell a level below 5 %")
    return null


def judge(tests: Mapping[str, Statistic], residuals: Residuals, null: Mapping[str, Array]) -> BatteryResult:
    """Return the result of all tests, with the family's own probability, from their draws."""
    seen = Draws(residuals.cube[None], {name: np.asarray(v)[None] for name, v in residuals.series.items()})
    count = next(iter(null.values())).size
    outcomes, loudest_null, loudest = [], np.ones(count), 1.0
    for name, test in tests.items():
        sample, value = null[name], float(test.of(seen)[0])
        if not np.isfinite(value) or np.ptp(sample) == 0.0:
            continue  # a test that has nothing to look at here, such as rings of a contact that no view shows
        law = tail_law(sample, test.tail)
        of_data, of_draws = float(law(np.array([value]))[0]), law(sample)
        loudest, loudest_null = min(loudest, of_data), np.minimum(loudest_null, of_draws)
        middle = float(np.median(sample))
        far = np.abs(sample - middle) >= abs(value - middle) if test.tail == "normal" else sample >= value
        outcomes.append(Outcome(name, value, float((1 + far.sum()) / (1 + count)), of_data))
    outcomes.sort(key=lambda o: o.tail_p)
    return BatteryResult(float((1 + (loudest_null <= loudest).sum()) / (1 + count)), tuple(outcomes), count)


def tail_law(sample: Array, tail: Tail) -> Callable[[Array], Array]:
    """Return a survival function fitted to draws of a statistic by their first two moments.

    It needs to be no more than a fair common scale for statistics of different kinds: the level comes from the draws.

    Parameters
    ----------
    sample : ndarray (draws,)
    tail : str
        :data:`Tail`.
    """
    mean, sd = float(sample.mean()), float(sample.std(ddof=1))
    if tail == "normal":
        return lambda t: np.asarray(2.0 * stats.norm.sf(np.abs(t - mean) / sd))
    if tail == "largest":
        scale = sd * np.sqrt(6.0) / np.pi
        law = stats.gumbel_r(loc=mean - np.euler_gamma * scale, scale=scale)
    else:
        law = stats.gamma((mean / sd) ** 2, scale=sd**2 / mean)
    # Far out the survival function underflows; loudness still has an order there.
    return lambda t: np.asarray(np.exp(np.maximum(law.logsf(t), -700.0)))
