"""What the battery looks at: whitened residuals with their covariates, draws of noise, and statistics of both."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]
Tail = Literal["sum", "largest", "normal"]
"""Law of a statistic's upper tail: of a sum of squares (gamma), of a maximum (Gumbel), or normal, two-sided."""


@dataclass(frozen=True, kw_only=True)
class Residuals:
    """What a fitted model leaves of the data, whitened.

    Attributes
    ----------
    cube : ndarray (views, rows, cols)
        (data - model) / standard deviation, nuisances projected out; 0 where not valid.
    valid : ndarray of bool (views, rows, cols)
    level : ndarray (views, rows, cols)
        Predicted level [DN].
    gradient : ndarray (views, 2, rows, cols)
        Of the level along x and y [DN per bin].
    x_mm, y_mm : ndarray (rows, cols)
        Place on the plate [mm].
    distance_mm : ndarray (views, rows, cols)
        Outside (+) or inside (-) the predicted edge of contact; inf where nothing touches [mm].
    radius : ndarray (rows, cols)
        Distance from the optical centre over the half-diagonal.
    covariates : mapping of str to ndarray (views,)
        ``force_N``, ``voltage_V``, ``time_s``, ``displacement_mm``; NaN where not known.
    kinds : tuple of str (views,)
        ``press``, ``replicate``, ``led_off``, ``lens_cap``, ``checkerboard``, ``square``.
    ridge : ndarray (2,), optional
        Wave vector of the finger's ridges [rad/mm].
    series : mapping of str to ndarray
        Standardised residuals of the scalar series, in the order of their abscissa.
    """

    cube: Array
    valid: NDArray[np.bool_]
    level: Array
    gradient: Array
    x_mm: Array
    y_mm: Array
    distance_mm: Array
    radius: Array
    covariates: Mapping[str, Array]
    kinds: tuple[str, ...]
    ridge: Array | None = None
    series: Mapping[str, Array] = field(default_factory=dict)


@dataclass(frozen=True)
class Draws:
    """Residuals of pure noise, nuisances projected out as in the data.

    Attributes
    ----------
    cube : ndarray (draws, views, rows, cols)
    series : mapping of str to ndarray (draws, points)
    """

    cube: Array
    series: Mapping[str, Array] = field(default_factory=dict)
    _kept: dict[str, Array] = field(default_factory=dict, repr=False, compare=False)

    def kept(self, name: str, of: Callable[[Array], Array]) -> Array:
        """Return ``of(cube)``, computed once under this name: many tests look at the same features."""
        if name not in self._kept:
            self._kept[name] = of(self.cube)
        return self._kept[name]


@dataclass(frozen=True)
class Statistic:
    """One statistic of the battery.

    Attributes
    ----------
    of : callable
        ``of(draws) -> ndarray (draws,)``; large values speak against the null, for ``normal`` on both sides.
    tail : str
        :data:`Tail`.
    """

    of: Callable[[Draws], Array]
    tail: Tail
