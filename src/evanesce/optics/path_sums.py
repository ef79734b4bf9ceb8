"""Light summed over its paths through the glass: one sum serves all plates of about the same absorption.

The light that arrives somewhere is a sum of w exp(-a L) over paths of length L in glass of absorption a. By the sums of
w, w L and w L^2 about one coefficient it is known for others near it (cumulants to second order): paths from one source
to one place are of about one length, and what that varies by acts by its square.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.optics.edge_rays import EdgeLight

Array = NDArray[Any]

SPACING_PER_MM = 1e-2
"""Of the coefficients about which sums are made for edges that mirror nothing [1/mm]. Half of it away the third order
is a ten-thousandth of what edges receive from each other, and less of the rest."""

LEAST_SPACING = 1e-4
"""Share of that which is left where edges mirror all."""

MOMENTS = 3
"""Sums of w, w L and w L^2."""


def add_paths(into: Array, place: Array, weight: Array, length: Array) -> None:
    """Add paths to sums.

    Parameters
    ----------
    into : ndarray (MOMENTS, places)
        Changed.
    place : ndarray of int (paths,)
        Where each arrives.
    weight : ndarray (paths,)
        Light that it carries.
    length : ndarray (paths,)
        [mm].
    """
    for sums in into:
        sums += np.bincount(place, weight, sums.size)
        weight = weight * length


def attenuated(sums: Array, further_per_mm: float) -> Array:
    """Return the light that arrives in glass of another absorption than sums were made for.

    Parameters
    ----------
    sums : ndarray (MOMENTS, ...)
    further_per_mm : float
        By how much the coefficient is larger [1/mm].

    Returns
    -------
    ndarray (...)
    """
    total = np.asarray(sums[0])
    if further_per_mm == 0.0:
        return total
    safe = np.where(total > 0.0, total, 1.0)
    mean = sums[1] / safe
    variance = np.maximum(sums[2] / safe - mean**2, 0.0)
    return np.asarray(total * np.exp(further_per_mm * (0.5 * further_per_mm * variance - mean)))


def in_plate(light: EdgeLight, sums_of: Callable[[EdgeLight], Sequence[Array]]) -> list[Array]:
    """Return the light of a plate's sources, from sums for a plate of about its absorption, with or without air films.

    Light is linear in the share of LEDs behind an air film.

    Parameters
    ----------
    light : EdgeLight
    sums_of : callable
        Returns sums (MOMENTS, ...) of a plate like this one, of another absorption and with air films before all LEDs
        or none.

    Returns
    -------
    list of ndarray (...)
    """
    # Light that edges mirror goes on for some 1 / (1 - polish) widths of the plate, and what that varies by with it.
    spacing = SPACING_PER_MM * max((1.0 - light.edge_polish) ** 2, LEAST_SPACING)
    about = round(light.absorption_coefficient / spacing) * spacing
    further = light.absorption_coefficient - about
    found: list[Array] = []
    for share, film in ((1.0 - light.air_gap_share, 0.0), (light.air_gap_share, 1.0)):
        if share > 0.0:
            sums = sums_of(replace(light, absorption_coefficient=about, air_gap_share=film))
            parts = [share * attenuated(part, further) for part in sums]
            found = [a + b for a, b in zip(found, parts, strict=True)] if found else parts
    return found
