"""Published outcomes as data: ``outcomes.toml`` of a bundle, with a standard deviation and its origin for each figure.

Figures that are positive and of which a model is mostly wrong by a factor (areas, depths, moduli, friction) count by
their logarithm, changes and voltages as they are.
"""

from __future__ import annotations

import itertools
import tomllib
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from evanesce.core.errors import InputError
from evanesce.core.quantities import Strict
from evanesce.rig.load import validate

Array = NDArray[Any]

FILE = "outcomes.toml"
MATERIALS = ("silskin_0", "silskin_20")

Kind = Literal[
    "read_area", "depth", "cylinder_depth", "youngs_modulus", "friction", "tilt_friction", "ridged_over_smooth",
    "ridged_depth", "ridged_friction", "fe_area", "overshoot",
    "length_change", "diameter_change", "bone_change", "lost_below", "growth",
]  # fmt: skip
LOGARITHMIC = {
    "read_area", "fe_area", "depth", "cylinder_depth", "youngs_modulus", "friction", "ridged_over_smooth",
    "ridged_friction",
}  # fmt: skip
NEEDS = {
    "read_area": "force_N", "depth": "force_N", "cylinder_depth": "force_N", "friction": "force_N",
    "overshoot": "friction", "growth": "force_N", "fe_area": "force_N", "ridged_friction": "force_N",
}  # fmt: skip
"""Condition that a kind of outcome has to state."""
FORCES_N, FRICTIONS = (0.1, 10.0), (0.6, 1.2)

UNKNOWN_SD, UNKNOWN_SD_V = 0.5, 2.0
"""Standard deviation, in the row's own unit (logarithm, 1 or V), of a figure that something outside the model makes."""


class Conditions(Strict):
    """What an outcome was measured at."""

    force_N: float | None = Field(None, ge=FORCES_N[0], le=FORCES_N[1])
    friction: float | None = Field(None, ge=FRICTIONS[0], le=FRICTIONS[1])


class Outcome(Strict):
    """One published figure.

    Attributes
    ----------
    id : str
    kind : str
        By which the predictor knows it.
    unit : str
    value : float or None
    either : tuple of float
        Figures between which the text leaves the choice, equally probable; in place of ``value``.
    sd : float
        Standard deviation, in ``unit``.
    at : Conditions
    source, uncertainty : str
        Where the figure stands; where its standard deviation comes from.
    """

    id: str = Field(min_length=1, max_length=60)
    kind: Kind
    unit: Literal["mm2", "mm", "MPa", "1", "V"]
    value: float | None = Field(None, ge=-1e4, le=1e4)
    either: tuple[float, ...] = Field((), max_length=4)
    sd: float = Field(gt=0.0, le=1e4)
    at: Conditions = Field(default_factory=lambda: Conditions.model_validate({}))
    source: str = Field(min_length=1)
    uncertainty: str = Field(min_length=1)

    @model_validator(mode="after")
    def _whole(self) -> Self:
        if (self.value is None) == (not self.either):
            raise ValueError("give value or either, one of the two")
        if self.logarithmic and min(self.figures) <= 0:
            raise ValueError(f"{self.kind} has to be above 0")
        need = NEEDS.get(self.kind)
        if need is not None and getattr(self.at, need) is None:
            raise ValueError(f"{self.kind} needs at.{need}")
        return self

    @property
    def figures(self) -> tuple[float, ...]:
        """The figure, or those between which the text leaves the choice."""
        return self.either if self.value is None else (self.value,)

    @property
    def logarithmic(self) -> bool:
        """Whether it counts by its logarithm."""
        return self.kind in LOGARITHMIC


class _File(Strict):
    schema_version: int = Field(1, ge=1, le=1)
    material: Literal["silskin_0", "silskin_20"]
    outcome: tuple[Outcome, ...] = Field(min_length=1, max_length=200)


@dataclass(frozen=True)
class Row:
    """One outcome of one finger in the data vector.

    Attributes
    ----------
    material : str
    outcome : Outcome
    """

    material: str
    outcome: Outcome

    @property
    def name(self) -> str:
        """Material and outcome."""
        return f"{self.material}:{self.outcome.id}"

    @property
    def group(self) -> str:
        """What is left out together: all figures of one kind of one finger."""
        return f"{self.material}:{self.outcome.kind}"

    def scaled(self, figure: Array | float) -> Array:
        """Return figures as they count: logarithms, or themselves."""
        return np.log(np.asarray(figure)) if self.outcome.logarithmic else np.asarray(figure, float)

    def figure(self, scaled: Array | float) -> Array:
        """Return the inverse of :meth:`scaled`."""
        return np.exp(np.asarray(scaled)) if self.outcome.logarithmic else np.asarray(scaled, float)

    @property
    def sd(self) -> float:
        """Standard deviation as the row counts."""
        one = self.outcome
        return one.sd / (sum(one.figures) / len(one.figures)) if one.logarithmic else one.sd


@dataclass(frozen=True)
class Outcomes:
    """Rows of all bundles.

    Attributes
    ----------
    rows : tuple of Row
    times : float
        Factor of all standard deviations: none is printed, and an answer should survive another guess.
    """

    rows: tuple[Row, ...]
    times: float = 1.0

    @property
    def groups(self) -> tuple[str, ...]:
        """Names of the groups, in order."""
        return tuple(dict.fromkeys(row.group for row in self.rows))

    def without(self, group: str) -> Outcomes:
        """Return the rows of all other groups."""
        return replace(self, rows=tuple(row for row in self.rows if row.group != group))

    def only(self, group: str) -> Outcomes:
        """Return a group's rows."""
        return replace(self, rows=tuple(row for row in self.rows if row.group == group))

    def of(self, group: str) -> NDArray[np.int_]:
        """Return the places of a group's rows."""
        return np.flatnonzero([row.group == group for row in self.rows])

    def readings(self) -> Iterator[Array]:
        """Yield the data vector (rows,) for every choice that the text leaves."""
        for choice in itertools.product(*(row.outcome.figures for row in self.rows)):
            yield np.array([float(row.scaled(figure)) for row, figure in zip(self.rows, choice, strict=True)])

    def sd(self, unknown: Collection[str] = ()) -> Array:
        """Return standard deviations (rows,), those of groups that something unknown makes being widened."""
        own = self.times * np.array([row.sd for row in self.rows])
        broad = np.array([UNKNOWN_SD_V if row.outcome.unit == "V" else UNKNOWN_SD for row in self.rows])
        wide = np.array([row.group in unknown for row in self.rows], bool)
        return np.where(wide, np.hypot(own, broad), own)


def read_outcomes(folders: Sequence[Path]) -> Outcomes:
    """Read the outcomes of some bundles.

    Parameters
    ----------
    folders : sequence of Path
        Each holds ``outcomes.toml``.

    Returns
    -------
    Outcomes

    Raises
    ------
    InputError
        Naming file and key of the first thing wrong.
    """
    rows: list[Row] = []
    for folder in folders:
        path = Path(folder) / FILE
        if not path.is_file():
            raise InputError("no such file", file=path, allowed="a bundle with published outcomes")
        try:
            raw = tomllib.loads(path.read_text(encoding="utf-8"))
        except (OSError, ValueError, RecursionError) as error:
            raise InputError(f"not valid TOML: {error}", file=path) from None
        found = validate(_File, raw, path)
        own = [Row(found.material, one) for one in found.outcome]
        known = {row.name for row in rows}
        for row in own:
            if row.name in known:
                raise InputError(f"{row.name!r} is there twice", file=path, key="outcome.id", allowed="each id once")
            known.add(row.name)
        rows += own
    return Outcomes(tuple(rows))
