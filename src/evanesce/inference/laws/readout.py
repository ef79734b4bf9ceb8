"""Laws of light that is not the plate's, and of what the camera makes of levels."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.inference.laws import Law, Seen

Array = NDArray[Any]


def even_light(seen: Seen, rng: np.random.Generator) -> Array:
    """Return room light with a slope, the same in all frames without cap or card."""
    a, b = rng.uniform(-0.4, 0.4, 2)
    shown = seen.per_view(lambda v: float(v.kind != "lens_cap" and not v.is_card))
    return np.asarray(3.0 * seen.by_signal * shown * (1.0 + a * seen.x + b * seen.y))


def window(seen: Seen, rng: np.random.Generator) -> Array:
    """Return room light that comes as one broad spot: the mirror image of a window in the plate."""
    x, y, width = rng.uniform(-0.8, 0.8), rng.uniform(-0.6, 0.6), rng.uniform(0.3, 0.8)
    spot = np.exp(-0.5 * ((seen.x - x) ** 2 + (seen.y - y) ** 2) / width**2)
    shown = seen.per_view(lambda v: float(v.kind != "lens_cap" and not v.is_card))
    return np.asarray(4.0 * seen.by_signal * shown * (0.3 + spot))


def curve(seen: Seen, rng: np.random.Generator) -> Array:
    """Return another tone curve: one or two humps between black and white, both ends held."""
    level = np.clip(seen.cube / 255.0, 0.0, 1.0)
    first, second = rng.standard_normal(2)
    return np.asarray(6.0 * (first * np.sin(np.pi * level) + 0.5 * second * np.sin(2 * np.pi * level)))


def knee(seen: Seen, rng: np.random.Generator) -> Array:
    """Return highlights pressed together above a knee."""
    level, start = seen.cube / 255.0, rng.uniform(0.5, 0.85)
    return np.asarray(-255.0 * rng.uniform(0.1, 0.4) * np.clip(level - start, 0.0, None))


LAWS = {
    "ambient_light": (
        Law("sloped", "Lambert's cosine law for a distant lamp, first order in place", change=even_light),
        Law("window", "assumed: mirror image of an extended source, a Gaussian", change=window),
    ),
    "tone_curve": (
        Law(
            "humps",
            "empirical response curves: Grossberg and Nayar 2004, PAMI 26, 1272, first components",
            change=curve,
        ),
        Law("knee", "assumed: highlights compressed as by broadcast cameras", change=knee),
    ),
}
