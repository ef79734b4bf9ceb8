"""Which of the varied figures the winner's error hangs on: Morris' elementary effects in a box about it.

References
----------
M. D. Morris, "Factorial sampling plans for preliminary computational experiments", Technometrics 33 (1991) 161.
F. Campolongo, J. Cariboni and A. Saltelli, "An effective screening design for sensitivity analysis of large models",
Environmental Modelling & Software 22 (2007) 1509: mu*.
W. Usher et al., "SALib", Journal of Open Source Software 2(9) (2017) 97, doi:10.21105/joss.00097.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.design.vary import Vary
from evanesce.extras import require

Array = NDArray[np.float64]

BOX = 0.1
"""Half the box's side over each key's range."""

LEVELS = 4


def box(vary: Sequence[Vary], values: Mapping[str, float]) -> list[tuple[float, float]]:
    """Return the range of each key about a design, cut at the search's own; steps of the search do not count."""
    found = []
    for v in vary:
        reach = BOX * (v.high - v.low)
        found.append((max(v.low, values[v.key] - reach), min(v.high, values[v.key] + reach)))
    return found


def sample(vary: Sequence[Vary], values: Mapping[str, float], trajectories: int, seed: int) -> Array:
    """Return the designs (trajectories (keys + 1), keys) of Morris' plan, in the keys' units; whole numbers rounded."""
    require("design", "sensitivity", "SALib")
    from SALib.sample import morris  # type: ignore[import-untyped]

    drawn = morris.sample(_problem(vary, values), trajectories, num_levels=LEVELS, seed=seed)
    for column, v in enumerate(vary):
        if v.whole:
            drawn[:, column] = np.round(drawn[:, column])
    return np.asarray(drawn)


def indices(
    vary: Sequence[Vary], values: Mapping[str, float], designs: Array, errors: Array, seed: int
) -> list[dict[str, Any]]:
    """Return, for each key, mean absolute and mean effect over the box, their spread, and a half-width of the first.

    Of a single trajectory the last two are not known: NaN.

    Parameters
    ----------
    vary : sequence of Vary
    values : mapping
        Of the design in the box's middle.
    designs : ndarray
        Of :func:`sample`.
    errors : ndarray (designs,)
        Predicted area error [%].
    seed : int
        Of the bootstrap.
    """
    require("design", "sensitivity", "SALib")
    from SALib.analyze import morris  # type: ignore[import-untyped]

    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Degrees of freedom|invalid value", RuntimeWarning)  # a single trajectory
        found = morris.analyze(
            _problem(vary, values), designs, errors, num_levels=LEVELS, num_resamples=200, seed=seed, scaled=False
        )
    single = len(designs) == len(vary) + 1
    rows = []
    for k, v in enumerate(vary):
        low, high = box(vary, values)[k]
        rows.append(
            {
                "key": v.key, "unit": v.unit, "low": low, "high": high, "mu_star_percent": float(found["mu_star"][k]),
                "half_width_percent": math.nan if single else float(found["mu_star_conf"][k]),
                "mu_percent": float(found["mu"][k]),
                "sigma_percent": math.nan if single else float(found["sigma"][k]),
            }
        )  # fmt: skip
    return sorted(rows, key=lambda row: -row["mu_star_percent"])


def _problem(vary: Sequence[Vary], values: Mapping[str, float]) -> dict[str, Any]:
    bounds = [list(pair) for pair in box(vary, values)]
    return {"num_vars": len(vary), "names": [v.key for v in vary], "bounds": bounds}
