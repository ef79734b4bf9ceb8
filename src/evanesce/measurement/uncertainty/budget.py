"""Uncertainty of a contact area: linear propagation, and Monte Carlo beside it.

A model of the measurement turns an area as read into the area sought:

    A = A_read (1 + print)^2 (1 - height (1 + nearness) / distance)^2 (1 + scale) - perimeter * boundary + noise

print: printed over stated length of the card; height: printed side over the contact plane, which makes the card smaller
in the picture; nearness: how much nearer than stated the lens may be, of one over its distance; scale: error of the
fitted scale at the contact; boundary: how far outside the contact the curve runs, the sum of blur, film of air,
sampling, codec and threshold; noise: of the frame. Every quantity has a distribution with its origin in words; one that
is not centred corrects the value as well.

References
----------
JCGM 100:2008, Guide to the expression of uncertainty in measurement; JCGM 101:2008, Supplement 1, Propagation of
distributions using a Monte Carlo method.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Finger = Literal["ridged", "smooth"]
Role = Literal["print", "height", "nearness", "scale", "boundary", "noise"]

COVERAGE = 0.95
COVERAGE_FACTOR = 1.959963984540054
DRAWS = 20_000


@dataclass(frozen=True, kw_only=True)
class Component:
    """One input of the budget.

    Attributes
    ----------
    name : str
    role : str
        Where it enters the model; several may share a role, their effects add.
    low, high : float
        Limits of a rectangular distribution, or one standard deviation either side of the mean of a normal one; in the
        unit of the role: relative length, mm, relative inverse length, relative area, mm, mm^2.
    shape : {"rectangular", "normal"}
    origin : str
        Why this size.
    """

    name: str
    role: Role
    low: float
    high: float
    shape: Literal["rectangular", "normal"]
    origin: str

    @property
    def mean(self) -> float:
        """Expected value."""
        return 0.5 * (self.low + self.high)

    @property
    def standard(self) -> float:
        """Standard uncertainty."""
        half = 0.5 * (self.high - self.low)
        return half / math.sqrt(3.0) if self.shape == "rectangular" else half

    def draw(self, rng: np.random.Generator, count: int) -> Floats:
        """Return independent draws.

        Parameters
        ----------
        rng : numpy.random.Generator
        count : int

        Returns
        -------
        ndarray (count,)
            In the unit of the role.
        """
        if self.shape == "rectangular":
            return rng.uniform(self.low, self.high, count)
        return rng.normal(self.mean, self.standard, count)


@dataclass(frozen=True, kw_only=True)
class Reading:
    """One area as read, with what the model needs beside it.

    Attributes
    ----------
    area_mm2, perimeter_mm : float
    distance_mm : float
        From the lens to the contact plane as it appears through the glass: focal length over scale.
    """

    area_mm2: float
    perimeter_mm: float
    distance_mm: float


@dataclass(frozen=True, kw_only=True)
class Uncertain:
    """An area with its uncertainty.

    Attributes
    ----------
    area_mm2 : float
        As read.
    corrected_mm2 : float
        Expected value under the model.
    standard_mm2 : float
        Combined standard uncertainty, linear.
    linear_mm2, interval_mm2 : tuple of float
        95 % interval by linear propagation; by Monte Carlo, probabilistically symmetric.
    contributions_mm2 : mapping
        Standard uncertainty of the area from each component alone.
    components : tuple of Component
        The budget.
    """

    area_mm2: float
    corrected_mm2: float
    standard_mm2: float
    linear_mm2: tuple[float, float]
    interval_mm2: tuple[float, float]
    contributions_mm2: Mapping[str, float]
    components: tuple[Component, ...] = ()

    def as_dict(self) -> dict[str, Any]:
        """Return plain data.

        Returns
        -------
        dict
            Units in the keys.
        """
        return asdict(self)


def model(reading: Reading, values: Mapping[Role, Any]) -> Any:
    """Return the area sought for values of the inputs.

    Parameters
    ----------
    reading : Reading
    values : mapping of float or ndarray (draws,)
        By role.

    Returns
    -------
    float or ndarray (draws,)
        [mm^2].
    """
    smaller = 1.0 - values["height"] * (1.0 + values["nearness"]) / reading.distance_mm
    scale = (1.0 + values["print"]) ** 2 * smaller**2 * (1.0 + values["scale"])
    return reading.area_mm2 * scale - reading.perimeter_mm * values["boundary"] + values["noise"]


def _sums(components: Sequence[Component], of: Mapping[str, Any]) -> dict[Role, Any]:
    found: dict[Role, Any] = dict.fromkeys(get_args(Role), 0.0)
    for component in components:
        found[component.role] = found[component.role] + of[component.name]
    return found


def propagate(
    reading: Reading, components: Sequence[Component], rng: np.random.Generator, draws: int = DRAWS
) -> Uncertain:
    """Propagate a budget through the model, linearly and by Monte Carlo.

    Parameters
    ----------
    reading : Reading
    components : sequence of Component
        Independent of one another, each name once.
    rng : numpy.random.Generator
    draws : int
        Of the Monte Carlo.

    Returns
    -------
    Uncertain
    """
    means = {c.name: c.mean for c in components}
    centre = float(model(reading, _sums(components, means)))
    contributions = {}
    for component in components:
        # central difference over one standard uncertainty, as JCGM 100, 5.1.3 note 2, allows
        up, down = (
            float(
                model(reading, _sums(components, means | {component.name: component.mean + sign * component.standard}))
            )
            for sign in (1.0, -1.0)
        )
        contributions[component.name] = 0.5 * abs(up - down)
    standard = math.sqrt(sum(u * u for u in contributions.values()))
    drawn = np.asarray(model(reading, _sums(components, {c.name: c.draw(rng, draws) for c in components})), np.float64)
    drawn = np.broadcast_to(drawn, (draws,))
    low, high = np.percentile(drawn, [50 * (1 - COVERAGE), 50 * (1 + COVERAGE)])
    wide = COVERAGE_FACTOR * standard
    return Uncertain(
        area_mm2=reading.area_mm2, corrected_mm2=centre, standard_mm2=standard,
        linear_mm2=(max(0.0, centre - wide), max(0.0, centre + wide)),
        interval_mm2=(max(0.0, float(low)), max(0.0, float(high))), contributions_mm2=contributions,
        components=tuple(components),
    )  # fmt: skip
