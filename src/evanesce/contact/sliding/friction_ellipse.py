"""Friction that depends on direction: the forces that parallel ridges allow.

Across parallel ridges friction may differ from that along them. Of all friction forces that an ellipse of strength
allows, the one that resists most acts: the force across the sliding direction follows.

Reference: A. Zmitrowicz, Int. J. Solids Struct. 25 (1989) 837 (orthotropic friction).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def directional_friction(ratio: float, angle: float) -> tuple[float, float]:
    """Return friction along the motion and across it, over friction across the ridges.

    Parameters
    ----------
    ratio : float
        Friction along the ridges over that across them.
    angle : float
        From the motion to the ridges [rad], counted from x towards y.

    Returns
    -------
    along, across : float
        Against the motion; and to its left, from x towards y, of the finger on the glass.
    """
    with_ridges, over = math.cos(angle), -math.sin(angle)  # the motion's components along and across the ridges
    power = math.hypot(ratio * with_ridges, over)
    along_ridges, across_ridges = ratio**2 * with_ridges / power, over / power
    return power, along_ridges * math.sin(angle) + across_ridges * math.cos(angle)


class FrictionEllipse:
    """Tractions within unit strength, where friction along ridges is another than across them.

    Parameters
    ----------
    ratio : float
        Friction along the ridges over that across them.
    angle : float
        Of the ridges [rad].

    Attributes
    ----------
    widest : float
        Strength in the strongest direction.
    """

    def __init__(self, ratio: float = 1.0, angle: float = 0.0) -> None:
        self.widest, self._even = max(ratio, 1.0), ratio == 1.0
        along = np.array([math.cos(angle), math.sin(angle)])
        ridges = np.outer(along, along)
        self._matrix = np.eye(2) + (ratio - 1.0) * ridges
        self._inverse = np.eye(2) + (1.0 / ratio - 1.0) * ridges

    def stretched(self, vector: Floats) -> Floats:
        """Return vectors (2, ...) of a disc as those of the ellipse."""
        return vector if self._even else np.tensordot(self._matrix, vector, 1)

    def rounded(self, vector: Floats) -> Floats:
        """Return vectors (2, ...) of the ellipse as those of a disc."""
        return vector if self._even else np.tensordot(self._inverse, vector, 1)

    def strength(self, traction: Floats) -> Floats:
        """Return the strength in each traction's direction [1]; across the ridges where there is none."""
        if self._even:
            return np.ones(traction.shape[1:])
        size, disc = np.hypot(*traction), np.hypot(*self.rounded(traction))
        return np.divide(size, disc, out=np.ones_like(size), where=disc > 0.0)
