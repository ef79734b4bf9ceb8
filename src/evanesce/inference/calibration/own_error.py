"""By how much a model's light is off in ways that no figure stands for, so that it does not decide what it cannot.

A real rig is lit as no model is to a hundredth of the noise: halos fade otherwise, haze is brighter, a lamp stands
aside, LEDs follow the voltage by another law. Where noise alone weighs what is left, contacts are moved to mend a halo
by a tenth of a DN. Here the light at each voltage is known to a share, and every bin to a level, both as large as what
is left says (the likelihood's maximum), besides noise: edges, which are high, then weigh more than halos. A model that
leaves little more than noise has no such errors.

A share of the light of every bin was tried in place of a level: the contact, which weighs least by that, went dark to
mend the haze about it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.inference.data import DataVector
from evanesce.prediction.views import View

Array = NDArray[Any]

LOUD = 4.0
"""Mean square over the noise's variance above which errors of the light are sought: a twin that is left with two
standard deviations is not good, and noise no longer says how to weigh what is left."""
TRIED: Mapping[str, Array] = {
    "voltage": np.concatenate([[0.0], np.geomspace(0.001, 1.0, 25)]),
    "level_DN": np.concatenate([[0.0], np.geomspace(0.01, 30.0, 28)]),
}
"""Finely enough to come within a sixth."""
ROUNDS = 4
"""In which each is sought given the others; they settle in three."""
ALIKE = 0.1
"""Mean change of the logarithm of standard deviations by which nothing that is fitted moves."""
PRESSES = "presses"
GROUPS = (PRESSES, "cards", "dark frames")


@dataclass(frozen=True)
class OwnError:
    """Errors of the light of one group of views.

    Attributes
    ----------
    voltage : float
        Standard deviation of the light at another supply voltage than most views have, over that light [1].
    level_DN : float
        Of a bin besides [DN].
    """

    voltage: float = 0.0
    level_DN: float = 0.0

    def __bool__(self) -> bool:
        """Return whether there is any."""
        return max(self.voltage, self.level_DN) > 0.0

    def share(self, light_DN: float) -> float:
        """Return the larger of its parts over the contact's light [1].

        Parameters
        ----------
        light_DN : float
            Of the contact [DN].
        """
        return max(self.voltage, self.level_DN / light_DN)

    def sentence(self, group: str, light_DN: float | None = None) -> str:
        """Return it in words.

        Parameters
        ----------
        group : str
        light_DN : float, optional
            Of the contact, to compare with [DN].
        """
        share = "" if light_DN is None else f", {100 * self.level_DN / light_DN:.2g} % of the contact's"
        parts = [
            f"{100 * self.voltage:.2g} % at other voltages" if self.voltage else "",
            f"{self.level_DN:.2g} DN{share}" if self.level_DN else "",
        ]
        return f"light of {group}: " + ", ".join(part for part in parts if part)

    def as_dict(self) -> dict[str, float]:
        """Return it in the answer's form."""
        return {"voltage": self.voltage, "level_DN": self.level_DN}


def own_errors(data: DataVector, predicted: Array) -> dict[str, OwnError]:
    """Return the errors of the light, by group of views, that make what a prediction leaves most probable.

    Parameters
    ----------
    data : DataVector
        With noise alone.
    predicted : ndarray (views, rows, cols)
        Of the open views [DN].
    """
    light, left = light_of(data), data.cube - predicted
    found = {}
    for group, views in _groups(data).items():
        parts = []
        for other, same in _by_voltage(data, views):
            valid = data.valid[same]
            parts.append((other, left[same][valid], data.sd[same][valid] ** 2, light[same][valid]))
        size = [float(np.mean(part**2 / noise)) for _, part, noise, _ in parts if part.size]
        if not size or np.mean(size) < LOUD:
            found[group] = OwnError()
            continue
        now = OwnError(level_DN=float(np.sqrt(np.mean([np.mean(part**2) for _, part, _, _ in parts if part.size]))))
        for _ in range(ROUNDS):
            for name, tried in TRIED.items():
                now = min((replace(now, **{name: float(v)}) for v in tried), key=lambda e: _cost(e, parts))
        found[group] = now
    return found


def _cost(error: OwnError, parts: Sequence[tuple[bool, Array, Array, Array]]) -> float:
    """Return twice the negative log likelihood of views of several voltages.

    Of each: whether it is another voltage than that of most, what is left, the noise's variance and the light of bins.
    """
    total = 0.0
    for other, left, noise, light in parts:
        variance = noise + error.level_DN**2
        free = error.voltage if other else 0.0
        shown = free**2 * float(np.sum(light**2 / variance))
        along = free * float(np.sum(light * left / variance))
        total += float(np.sum(np.log(variance) + left**2 / variance)) + np.log1p(shown) - along**2 / (1.0 + shown)
    return total


def _by_voltage(data: DataVector, views: Sequence[int]) -> list[tuple[bool, list[int]]]:
    """Return views of each supply voltage, and whether it is another than that of most."""
    found: dict[float, list[int]] = {}
    for k in views:
        found.setdefault(round(data.views[k].voltage_V, 1), []).append(k)
    most = max(found, key=lambda volt: len(found[volt]), default=0.0)
    return [(volt != most, same) for volt, same in found.items()]


def voltage_rows(data: DataVector, errors: Mapping[str, OwnError], size: int) -> Array:
    """Return the whitened rows (voltages, size) of errors at other voltages, each of unit standard deviation.

    Parameters
    ----------
    data : DataVector
        Weighed by the errors.
    errors : mapping of str to OwnError
    size : int
        Of a row: of the open bins, and of what follows them.
    """
    light, rows = light_of(data), [np.zeros((0, size), np.float32)]
    for group, views in _groups(data).items():
        for other, same in _by_voltage(data, views):
            if other and errors[group].voltage:
                only = np.zeros_like(light)
                only[same] = errors[group].voltage * light[same]
                bins = data.whitened(only).astype(np.float32)
                rows.append(np.pad(bins, (0, size - bins.size))[None])
    return np.concatenate(rows)


def at_first(errors: Mapping[str, OwnError]) -> dict[str, OwnError]:
    """Return errors for a first pass, by which frames without light are known no better than those of contacts.

    What exposure and tone curve do to the little light of a room is no line over the steps of a first pass, and frames
    that are known to a hundredth of a DN would allow none.

    Parameters
    ----------
    errors : mapping of str to OwnError
    """
    return {**errors, GROUPS[2]: OwnError(level_DN=errors[GROUPS[0]].level_DN)}


def light_of(data: DataVector) -> Array:
    """Return the light of each bin (views, rows, cols): what is above frames without it [DN].

    Parameters
    ----------
    data : DataVector
    """
    light = np.zeros_like(data.cube)
    for group, views in list(_groups(data).items())[:2]:
        # A room that lights a card is light; under a finger it is what is there without LEDs.
        kinds = ("led_off", "lens_cap") if group == GROUPS[0] else ("lens_cap",)
        dark = next((d for kind in kinds for d in data.open if data.views[d].kind == kind), None)
        for k in views:
            below = np.nanmin(data.cube[k]) if dark is None else data.cube[dark].mean()
            light[k] = np.maximum(data.cube[k] - below, 0.0)
    return light


def with_errors(data: DataVector, errors: Mapping[str, OwnError]) -> DataVector:
    """Return data of which every bin is known as well as the light is, noise that hangs together being the least of it.

    Parameters
    ----------
    data : DataVector
        With noise alone.
    errors : mapping of str to OwnError
    """
    if not any(errors.values()):
        return data
    sd = data.sd.copy()
    for k, view in enumerate(data.views):
        group = _group(view)
        if group in errors:
            sd[k] = np.hypot(data.sd[k], errors[group].level_DN)
    return replace(data, sd=sd, correlation=None)


def alike(one: DataVector, other: DataVector) -> bool:
    """Return whether bins of two data vectors weigh the same, but for :data:`ALIKE` on average.

    Parameters
    ----------
    one, other : DataVector
    """
    return float(np.abs(np.log(one.sd / other.sd))[list(one.open)].mean()) < ALIKE


def reweighed(rows: Array, before: DataVector, after: DataVector) -> Array | None:
    """Return rows (k, bins) that were whitened by some data as others whiten them; None where noise hangs together.

    Parameters
    ----------
    rows : ndarray (k, bins)
    before, after : DataVector
    """
    if before.correlation is not None or after.correlation is not None:
        return None
    chosen = list(before.open)
    ratio = (before.sd / after.sd)[chosen][before.valid[chosen]]
    # Rows of series, where there are any, follow those of the bins.
    return np.asarray(rows * np.pad(ratio, (0, rows.shape[1] - ratio.size), constant_values=1.0))


def _group(view: View) -> str:
    """Return a view's group."""
    if view.is_card:
        return GROUPS[1]
    return GROUPS[0] if view.touches else GROUPS[2]


def _groups(data: DataVector) -> dict[str, list[int]]:
    """Return the numbers of the open views of each group."""
    return {group: [k for k in data.open if _group(data.views[k]) == group] for group in GROUPS}
