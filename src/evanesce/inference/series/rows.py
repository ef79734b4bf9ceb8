"""Rows of scalar series as data: logarithms over their standard deviations, and which of them are held out.

Logarithms, because what a nominal model gets wrong of an area or a force is mostly a factor, and a factor is linear
there however large it is.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.bundle.layout import SAME_VOLTAGE_V, SERIES_FOLDER, Series, Shot, same_force
from evanesce.core.errors import InputError
from evanesce.prediction.observe import locked_conditions

Array = NDArray[Any]

ASSUMED_SIGMA = 0.05
"""Relative standard deviation of a series that states none."""
LEAST_AREA_MM2, LEAST_FORCE_N = 0.05, 1e-3
"""Below, a finger does not touch as far as a lab can tell."""
LEAST = {"area": LEAST_AREA_MM2, "force": LEAST_FORCE_N, "tangential_force": LEAST_FORCE_N, "torque": LEAST_FORCE_N}
SHEAR = ("tangential_force", "torque")
"""Ordinates whose sign is a matter of direction: their magnitudes are compared."""


@dataclass(frozen=True)
class Rows:
    """Rows of series, one after the other.

    Attributes
    ----------
    series : tuple of Series
    log_y, sd : ndarray (rows,)
        Logarithm of the values, and its standard deviation.
    assumed : bool
        Whether any standard deviation had to be assumed.
    """

    series: tuple[Series, ...]
    log_y: Array
    sd: Array
    assumed: bool = False

    @classmethod
    def of(cls, series: Sequence[Series]) -> Rows:
        """Gather series whose values are all large enough to have a logarithm.

        Parameters
        ----------
        series : sequence of Series
        """
        y = [np.asarray(one.y, float) for one in series]
        sd = [
            np.full(len(one), ASSUMED_SIGMA) if one.sigma is None else np.asarray(one.sigma, float) / one.y
            for one in series
        ]
        assumed = any(one.sigma is None for one in series)
        log_y = np.log(np.concatenate([np.ones(0), *y]))
        return cls(tuple(series), log_y, np.concatenate([np.zeros(0), *sd]), assumed)

    def widened(self, spread: Array) -> Rows:
        """Return rows with a further standard deviation (rows,) of the logarithm: what a prediction may be off by."""
        return replace(self, sd=np.hypot(self.sd, spread))

    @property
    def parts(self) -> tuple[slice, ...]:
        """Where each series stands."""
        ends = np.cumsum([0, *map(len, self.series)])
        return tuple(slice(int(a), int(b)) for a, b in pairwise(ends))

    @property
    def whitened(self) -> Array:
        """Values over their standard deviations (rows,)."""
        return np.asarray(self.log_y / self.sd)


def rows_of(series: Mapping[str, Series], press: Sequence[Shot] = ()) -> tuple[Rows, Rows, dict[str, str]]:
    """Return the rows that a fit may use, those that are held out, and why series are left out.

    One in four is held out, spread, the extremes never (:func:`evanesce.prediction.observe.locked_conditions`).

    Parameters
    ----------
    series : mapping of str to Series
    press : sequence of Shot
        Frames of the same bundle: an area of a force and voltage that a frame shows was read from that frame, and is no
        further data.

    Returns
    -------
    used, held_out : Rows
    left_out : dict of str to str

    Raises
    ------
    InputError
        If a series has no value that is large enough.
    """
    used, held, left_out = [], [], {}
    for one in series.values():
        why = _not_predicted(one)
        if why:
            left_out[one.name] = why
            continue
        if one.y_name in SHEAR:
            one = replace(one, y=np.abs(one.y))
        least = LEAST[one.y_name]
        large = np.asarray(one.y) > least
        if not large.any():
            raise InputError(
                f"holds nothing to compare: no {one.y_name} above {least:g} {one.y_unit}",
                file=Path(SERIES_FOLDER) / f"{one.name}.csv", key=f"column {one.y_name}_{one.y_unit}",
                allowed="values of a finger that touches",
            )  # fmt: skip
        own = large & ~_in_frames(one, press)
        if not own.any():
            left_out[one.name] = "was read from frames that are there"
            continue
        kept = _cut(one, own)
        locked = _locked(kept)
        used.append(_cut(kept, ~locked))
        if locked.any():
            held.append(_cut(kept, locked))
    return Rows.of(used), Rows.of(held), left_out


def _not_predicted(series: Series) -> str:
    """Return why a series is not compared, empty if it is."""
    x, y = series.x_name, series.y_name
    if (y in SHEAR) != (x == "slide") or (y == "force" and x != "displacement"):
        return f"{y.replace('_', ' ')} against {x} is not predicted"
    if x == "slide" and np.any(np.diff(series.x) <= 0):
        return "its slide turns back: force against slide is no function"
    return ""


def _in_frames(series: Series, press: Sequence[Shot]) -> NDArray[np.bool_]:
    """Return which rows (n,) of an area have a frame of their force and voltage."""
    found = np.zeros(len(series), bool)
    if series.y_name != "area" or series.x_name == "displacement":
        return found
    for k, x in enumerate(series.x):
        state: dict[str, float] = {**series.held, f"{series.x_name}_{series.x_unit}": float(x)}
        force, voltage = state.get("force_N"), state.get("voltage_V")
        found[k] = any(
            (force is None or same_force(force, shot.force_N))
            and (voltage is None or abs(voltage - shot.voltage_V) <= SAME_VOLTAGE_V)
            for shot in press
        )
    return found


def _locked(series: Series) -> NDArray[np.bool_]:
    """Return which rows (n,) are held out; rows of one abscissa share one condition."""
    values, condition = np.unique(series.x, return_inverse=True)
    shots = [Shot(index=k, time_s=0.0, force_N=float(x), voltage_V=0.0, condition=k) for k, x in enumerate(values)]
    return np.isin(condition, list(locked_conditions(shots)))


def _cut(series: Series, keep: NDArray[np.bool_]) -> Series:
    sigma = None if series.sigma is None else np.asarray(series.sigma)[keep]
    return replace(series, x=np.asarray(series.x)[keep], y=np.asarray(series.y)[keep], sigma=sigma)
