"""Particles at random places on a surface, and particles that a scene lists: dust on the glass or on the sensor."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.core.quantities import field

Array = NDArray[np.float64]

MAX_LISTED = 20000
MAX_PER_CM2 = 2000.0
MM2_PER_CM2 = 100.0


def draw_particles(
    rng: np.random.Generator, size_mm: tuple[float, float], per_cm2: float, log_spread: float
) -> tuple[Array, Array]:
    """Draw particles evenly over a surface, their sizes log-normal; a higher density keeps those of a lower one.

    Parameters
    ----------
    rng : numpy.random.Generator
    size_mm : tuple of float
        Width and height of the surface [mm].
    per_cm2 : float
        Density [1/cm^2], at most :data:`MAX_PER_CM2`.
    log_spread : float
        Standard deviation of the size's logarithm [1].

    Returns
    -------
    places : ndarray (n, 2)
        (x, y) over width and height, 0 to 1.
    sizes : ndarray (n,)
        Over their median.
    """
    count = rng.poisson(MAX_PER_CM2 / MM2_PER_CM2 * size_mm[0] * size_mm[1])
    place, size, order = rng.random((count, 2)), rng.standard_normal(count), rng.random(count)
    there = order < per_cm2 / MAX_PER_CM2
    return place[there], np.exp(log_spread * size[there])


def listed_values(unit: str, bounds: tuple[float, float], doc: str) -> Any:
    """Declare a parameter that holds one number for each listed particle, none by default.

    Parameters
    ----------
    unit : str
    bounds : tuple of float
        Of each number.
    doc : str

    Returns
    -------
    object
        A field of a model (:func:`evanesce.core.quantities.field`), at most :data:`MAX_LISTED` numbers.
    """
    return field((), unit=unit, bounds=bounds, doc=doc, max_length=MAX_LISTED)


def require_one_length(lists: Mapping[str, tuple[float, ...]]) -> None:
    """Refuse lists of different lengths.

    Parameters
    ----------
    lists : mapping of str to tuple of float
        By parameter.

    Raises
    ------
    ValueError
        Naming them.
    """
    if len({len(values) for values in lists.values()}) > 1:
        lengths = ", ".join(f"{name} {len(values)}" for name, values in lists.items())
        raise ValueError(f"lists of one length each: {lengths}")
