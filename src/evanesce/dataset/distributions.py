"""Distributions of one number or word, declared as data: `{ uniform = [1.0, 25.0] }` or `1.0`; drawn by quantile."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, ClassVar, Self

from pydantic import model_validator
from scipy.special import ndtr, ndtri

from evanesce.core.quantities import Strict

NORMAL_REACH = 3.0
"""Standard deviations at which a normal distribution is truncated, so that its support is bounded."""


class Distribution(Strict):
    """One distribution: exactly one of the fields; drawn by a quantile in [0, 1), for quasi-random designs.

    Attributes
    ----------
    constant : float or str
    uniform, log_uniform : tuple of float
        (low, high).
    normal : tuple of float
        (mean, standard deviation), truncated at 3 standard deviations.
    choice : tuple of float or str
        Equally likely.
    """

    constant: float | str | None = None
    uniform: tuple[float, float] | None = None
    log_uniform: tuple[float, float] | None = None
    normal: tuple[float, float] | None = None
    choice: tuple[float | str, ...] | None = None

    @model_validator(mode="before")
    @classmethod
    def _plain(cls, value: Any) -> Any:
        """Take a plain figure or word for a constant, and lists from JSON as they are from TOML."""
        if isinstance(value, int | float | str) and not isinstance(value, bool):
            return {"constant": value}
        if isinstance(value, dict):
            return {key: tuple(v) if isinstance(v, list) else v for key, v in value.items()}
        return value

    @model_validator(mode="after")
    def _one_form(self) -> Self:
        forms = [name for name in type(self).model_fields if getattr(self, name) is not None]
        if len(forms) != 1:
            raise ValueError("a distribution is exactly one of constant, uniform, log_uniform, normal, choice")
        for span in (self.uniform, self.log_uniform):
            if span is not None and not span[0] < span[1]:
                raise ValueError(f"{forms[0]} = {list(span)}: the first figure must be below the second")
        if self.log_uniform is not None and self.log_uniform[0] <= 0:
            raise ValueError(f"log_uniform = {list(self.log_uniform)}: figures must be above 0")
        if self.normal is not None and self.normal[1] <= 0:
            raise ValueError(f"normal = {list(self.normal)}: the standard deviation must be above 0")
        if self.choice is not None and not 1 <= len(self.choice) <= 1000:
            raise ValueError("choice needs 1 to 1000 entries")
        return self

    def at(self, quantile: float) -> Any:
        """Return the value at a quantile; choices in their order."""
        if self.constant is not None:
            return self.constant
        if self.uniform is not None:
            low, high = self.uniform
            return low + quantile * (high - low)
        if self.log_uniform is not None:
            low, high = self.log_uniform
            return low * (high / low) ** quantile
        if self.normal is not None:
            mean, deviation = self.normal
            edge = float(ndtr(-NORMAL_REACH))
            return mean + deviation * float(ndtri(edge + quantile * (1.0 - 2.0 * edge)))
        assert self.choice is not None  # one form is always there
        return self.choice[min(int(quantile * len(self.choice)), len(self.choice) - 1)]

    def support(self) -> tuple[float, float] | tuple[str, ...]:
        """Return (low, high) of all draws, or the words that may be drawn."""
        if self.normal is not None:
            mean, deviation = self.normal
            return mean - NORMAL_REACH * deviation, mean + NORMAL_REACH * deviation
        values = self.choice if self.choice is not None else (self.constant,)
        if self.uniform is not None or self.log_uniform is not None:
            span = self.uniform or self.log_uniform
            assert span is not None
            return span
        if any(isinstance(value, str) for value in values):
            return tuple(str(value) for value in values)
        numbers = [float(value) for value in values]  # type: ignore[arg-type]
        return min(numbers), max(numbers)

    def require_within(self, key: str, low: float, high: float, unit: str) -> None:
        """Refuse a distribution that could leave the bounds.

        Raises
        ------
        ValueError
            Naming the key and the bounds.
        """
        support = self.support()
        if any(isinstance(edge, str) for edge in support):
            raise ValueError(f"{key} draws words (allowed: numbers, {low:g} to {high:g} {unit})")
        if not all(math.isfinite(float(edge)) and low <= float(edge) <= high for edge in support):
            raise ValueError(f"{key} draws from {support[0]} to {support[1]} (allowed: {low:g} to {high:g} {unit})")

    def require_words(self, key: str, known: tuple[str, ...]) -> None:
        """Refuse words that are not known.

        Raises
        ------
        ValueError
        """
        values = self.choice if self.choice is not None else (self.constant,)
        if unknown := [value for value in values if value not in known]:
            raise ValueError(f"{key} names {unknown[0]!r} (allowed: {', '.join(known)})")


Bounds = Mapping[str, tuple[float, float, str]]
"""Least, greatest, and unit or what it is of, by key."""


class Drawn(Strict):
    """A section of which distributions have bounds.

    Attributes
    ----------
    SECTION : str
        Its name in a declaration.
    BOUNDS : Bounds
    """

    SECTION: ClassVar[str]
    BOUNDS: ClassVar[Bounds] = {}

    @model_validator(mode="after")
    def _within_bounds(self) -> Self:
        for key, (low, high, unit) in self.BOUNDS.items():
            getattr(self, key).require_within(f"{self.SECTION}.{key}", low, high, unit)
        return self


def constant(value: float | str) -> Distribution:
    """Return the distribution of a constant."""
    return Distribution(constant=value)


def uniform(low: float, high: float) -> Distribution:
    """Return a uniform distribution."""
    return Distribution(uniform=(low, high))


def log_uniform(low: float, high: float) -> Distribution:
    """Return a distribution that is uniform in the logarithm."""
    return Distribution(log_uniform=(low, high))


def choice(*values: float | str) -> Distribution:
    """Return the distribution of equally likely values."""
    return Distribution(choice=values)
