"""Laws of what the lens does to light: fall-off towards the corners, blur that grows there."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from evanesce.inference.laws import Law, Seen

Array = NDArray[Any]


def natural(seen: Seen, rng: np.random.Generator) -> Array:
    """Return the fall-off cos^4 of a field angle of 10 to 30 degrees at the frame's side."""
    tangent = np.tan(np.radians(rng.uniform(10.0, 30.0))) * seen.radius
    return np.asarray(seen.by_light * ((1.0 + tangent**2) ** -2 - 1.0))


def clipped_pupil(seen: Seen, rng: np.random.Generator) -> Array:
    """Return the overlap of two discs that move apart with the field angle: an aperture before or behind the stop."""
    apart = np.clip(rng.uniform(0.1, 0.8) * seen.radius, 0.0, 1.0)
    overlap = (2.0 / np.pi) * (np.arccos(apart) - apart * np.sqrt(1.0 - apart**2))
    return np.asarray(seen.by_light * (overlap - 1.0))


def hood(seen: Seen, rng: np.random.Generator) -> Array:
    """Return a corner that is shaded linearly from a radius on."""
    start, slope = rng.uniform(0.6, 1.0), rng.uniform(0.3, 1.0)
    return np.asarray(-seen.by_light * np.clip(slope * (seen.radius - start), 0.0, 1.0))


def blurred_corners(seen: Seen, rng: np.random.Generator) -> Array:
    """Return the change by a blur whose width goes with the square of the field: astigmatism, curvature of field."""
    width = rng.uniform(0.15, 0.6)  # bins at the frame's side
    blurred = np.array([ndimage.gaussian_filter(one, width) for one in seen.cube])
    cards = seen.per_view(lambda v: float(v.kind != "lens_cap"))
    return np.asarray((blurred - seen.cube) * np.minimum(seen.radius**2, 2.0) * cards)


LAWS = {
    "vignetting": (
        Law("natural fall-off", "cos^4: Born and Wolf, Principles of Optics, 4.8.1", change=natural),
        Law("clipped pupil", "overlap of pupils: Asada, Amano, Baba 1996, ICPR, 186", change=clipped_pupil),
        Law("hood", "assumed: shade of an edge before the lens, linear to first order", change=hood),
    ),
    "defocus": (
        Law(
            "curved field",
            "Seidel curvature of field, blur as the field squared: Born and Wolf, 5.3",
            change=blurred_corners,
        ),
    ),
}
