"""Sensitivity of the winner's error to the design variables: Morris' elementary effects in a box about it.

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

from evanesce.core.extras import require
from evanesce.design.variables import DesignVariable

Array = NDArray[np.float64]

BOX = 0.1
"""Half the box's side over each variable's range."""

LEVELS = 4


def box(variables: Sequence[DesignVariable], values: Mapping[str, float]) -> list[tuple[float, float]]:
    """Return the range of each variable about a design, within that of the search; steps are ignored."""
    found = []
    for v in variables:
        reach = BOX * (v.high - v.low)
        found.append((max(v.low, values[v.key] - reach), min(v.high, values[v.key] + reach)))
    return found


def sample(variables: Sequence[DesignVariable], values: Mapping[str, float], trajectories: int, seed: int) -> Array:
    """Return the designs (trajectories (variables + 1), variables) of Morris' plan; integers rounded."""
    require("design", "sensitivity", "SALib")
    from SALib.sample import morris  # type: ignore[import-untyped]

    drawn = morris.sample(_problem(variables, values), trajectories, num_levels=LEVELS, seed=seed)
    for column, v in enumerate(variables):
        if v.whole:
            drawn[:, column] = np.round(drawn[:, column])
    return np.asarray(drawn)


def indices(
    variables: Sequence[DesignVariable], values: Mapping[str, float], designs: Array, errors: Array, seed: int
) -> list[dict[str, Any]]:
    """Return for each variable the mean absolute and mean elementary effect, their spread, and a confidence half-width.

    Spread and half-width of a single trajectory are NaN.

    Parameters
    ----------
    variables : sequence of DesignVariable
    values : mapping
        Of the design in the box's middle.
    designs : ndarray (designs, variables)
        From :func:`sample`.
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
            _problem(variables, values), designs, errors, num_levels=LEVELS, num_resamples=200, seed=seed, scaled=False
        )
    single = len(designs) == len(variables) + 1
    rows = []
    for k, v in enumerate(variables):
        low, high = box(variables, values)[k]
        rows.append(
            {
                "key": v.key, "unit": v.unit, "low": low, "high": high, "mu_star_percent": float(found["mu_star"][k]),
                "half_width_percent": math.nan if single else float(found["mu_star_conf"][k]),
                "mu_percent": float(found["mu"][k]),
                "sigma_percent": math.nan if single else float(found["sigma"][k]),
            }
        )  # fmt: skip
    return sorted(rows, key=lambda row: -row["mu_star_percent"])


def _problem(variables: Sequence[DesignVariable], values: Mapping[str, float]) -> dict[str, Any]:
    bounds = [list(pair) for pair in box(variables, values)]
    return {"num_vars": len(variables), "names": [v.key for v in variables], "bounds": bounds}
