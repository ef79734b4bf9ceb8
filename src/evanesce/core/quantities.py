"""Parameters with their unit, bounds, null value and source: one declaration serves configuration, docs and fits."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from pydantic import BaseModel, ConfigDict, Field
from pydantic.fields import FieldInfo

# Canonical units; a key in another unit carries that unit as its suffix all the same, so that every key says its own.
UNIT_SUFFIXES: dict[str, str] = {
    "mm": "mm",
    "um": "µm",
    "nm": "nm",
    "m": "m",
    "cm": "cm",
    "in": "inch",
    "N": "N",
    "mN": "mN",
    "MPa": "MPa",
    "kPa": "kPa",
    "Pa": "Pa",
    "s": "s",
    "ms": "ms",
    "us": "µs",
    "hz": "Hz",
    "deg": "deg",
    "rad": "rad",
    "W": "W",
    "mW": "mW",
    "V": "V",
    "mA": "mA",
    "A": "A",
    "ohm": "ohm",
    "K": "K",
    "C": "degC",
    "e": "e-",
    "DN": "DN",
    "px": "px",
    "per_mm": "1/mm",
    "per_N": "1/N",
    "px_per_mm": "px/mm",
    "N_per_mm": "N/mm",
    "N_per_s": "N/s",
    "mm_per_min": "mm/min",
    "mm_per_s": "mm/s",
    "MPa_per_N": "MPa/N",
    "e_per_DN": "e-/DN",
    "e_per_s": "e-/s",
    "eV": "eV",
    "kg_per_m3": "kg/m^3",
    "V_per_K": "V/K",
    "per_K": "1/K",
    "ohm_per_mm": "ohm/mm",
    "per_cm2": "1/cm^2",
    "deg_per_s": "deg/s",
    "uL": "uL",
    "mPa_s": "mPa s",
}


@dataclass(frozen=True)
class Quantity:
    """Unit, bounds, null and source of a parameter.

    Attributes
    ----------
    unit : str
        Printed unit; ``"1"`` for a pure number.
    bounds : tuple of float
        Closed interval of allowed values.
    null : float or None
        The value at which an effect is absent, bit for bit; None where the parameter has none.
    source : str
        Where the default comes from.
    doc : str
        One line for tables.
    """

    unit: str
    bounds: tuple[float, float]
    null: float | None = None
    source: str = ""
    doc: str = ""

    def __str__(self) -> str:
        lo, hi = self.bounds
        return f"{lo:g} to {hi:g}" + ("" if self.unit == "1" else f" {self.unit}")


def field(
    default: Any = ...,
    *,
    unit: str,
    bounds: tuple[float, float],
    null: float | None = None,
    source: str = "",
    doc: str = "",
    **extra: Any,
) -> Any:
    """Declare a numeric pydantic field that carries its :class:`Quantity`.

    Bounds are closed and apply to each element of a list or tuple field; they are enforced by :class:`Strict`.

    Parameters
    ----------
    default : object
    unit : str
    bounds : tuple of float
        Lowest and highest value allowed, of each number of a tuple.
    null : float, optional
        Value at which an effect is absent; None where there is none.
    source, doc : str
    **extra : object
        Passed on to pydantic.

    Returns
    -------
    object
        A pydantic field.
    """
    quantity = Quantity(unit, bounds, null, source, doc)
    schema_extra: Any = {"quantity": quantity}  # pydantic types this as JSON, but keeps the object as it is
    return Field(default, description=doc or None, json_schema_extra=schema_extra, **extra)


def quantity_of(info: FieldInfo) -> Quantity | None:
    """Return the :class:`Quantity` of a pydantic field, or None.

    Parameters
    ----------
    info : pydantic.fields.FieldInfo

    Returns
    -------
    Quantity or None
    """
    extra = info.json_schema_extra
    found = extra.get("quantity") if isinstance(extra, dict) else None
    return found if isinstance(found, Quantity) else None


class Strict(BaseModel):
    """Frozen, strict configuration data: unknown keys, wrong types, NaN and infinity are errors."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, allow_inf_nan=False, validate_default=True)

    @classmethod
    def quantities(cls) -> Iterator[tuple[str, Quantity]]:
        """Yield ``(name, quantity)`` of every field declared with :func:`field`.

        Yields
        ------
        name : str
        quantity : Quantity
        """
        for name, info in cls.model_fields.items():
            found = quantity_of(info)
            if found is not None:
                yield name, found
