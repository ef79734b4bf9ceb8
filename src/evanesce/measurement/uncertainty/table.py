"""The budget of an area and of the conversion factor as a table of plain data."""

from __future__ import annotations

import math
from dataclasses import asdict
from typing import Any

from evanesce.measurement.uncertainty.budget import Role, Uncertain

FACTOR_ROLES: tuple[Role, ...] = ("print", "height", "nearness", "scale")
"""Roles that enter the conversion factor, area over pixels; the others concern the contact's boundary."""

NOT_COUNTED = {
    "noise": "moves the boundary at random along its length; part of the film law's residual, 0.06 % of an area",
    "LED voltage": "refined: less than 0.01 % from 8.4 to 9.7 V; reference: within 'threshold on the contact'",
    "blur on the card": "a symmetric blur leaves a straight edge at its half-way level; the rest is the half pixel of "
    "'threshold on the card', or in the corners' scatter",
}
"""Quantities without a line of their own, and why."""


def budget_table(found: Uncertain) -> dict[str, Any]:
    """Return a budget as plain data: size and origin of each component, of the area and of the conversion factor.

    Percentages are standard uncertainties, of the area as read and of the factor [mm^2 per px]; the factor's are None
    where a component does not enter it. Of no area they are 0.

    Parameters
    ----------
    found : Uncertain

    Returns
    -------
    dict
    """
    rows = []
    for part in found.components:
        share = 100.0 * found.contributions_mm2[part.name] / found.area_mm2 if found.area_mm2 > 0 else 0.0
        factor = share if part.role in FACTOR_ROLES else None
        rows.append(asdict(part) | {"area_percent": share, "factor_percent": factor})
    together = {
        key: math.sqrt(sum(row[key] ** 2 for row in rows if row[key] is not None))
        for key in ("area_percent", "factor_percent")
    }
    return {
        "area_mm2": found.area_mm2, "corrected_mm2": found.corrected_mm2, "standard_mm2": found.standard_mm2,
        "components": rows, "together": together, "not_counted": NOT_COUNTED,
    }  # fmt: skip
