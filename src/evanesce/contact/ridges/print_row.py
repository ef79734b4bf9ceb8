"""A human print as ridges that close on the scale of their own pitch, so that they move with the skin.

A point as deep below the crests as a ridge of a row is at some distance from its crest closes as that point does: where
ridges run side by side this is the row itself; at endings, bifurcations and pores an approximation.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from evanesce.contact.ridges.fingerprint import fingerprint_depth
from evanesce.contact.ridges.heightmap import RidgeRow, furrow_depth
from evanesce.rig.finger import Fingerprint

Array = NDArray[np.float64]

NODES = 257
"""Depths between which distances are interpolated."""


@dataclass(frozen=True)
class PrintRow(RidgeRow):
    """Ridges of a print, as wide as its furrows.

    Attributes
    ----------
    skin : Fingerprint
        Its pitch and height are those of the row.
    """

    skin: Fingerprint = field(default_factory=Fingerprint)

    @classmethod
    def of(cls, skin: Fingerprint) -> PrintRow:
        """Return the ridges of a print."""
        pitch = 1e-3 * skin.ridge_period_um
        return cls("parallel", pitch, 0.5 * pitch, 1e-3 * skin.ridge_height_um, skin=skin)

    def locate(self, x: Array, y: Array) -> tuple[NDArray[np.int64], Array]:
        """Return 0, and the distance [mm] from a ridge's crest at which it is as deep as the print.

        Parameters
        ----------
        x, y : ndarray
            From the tip [mm]; broadcast.

        Returns
        -------
        number : ndarray of int
        distance : ndarray
            0 to half a pitch [mm].
        """
        depth, _ = fingerprint_depth(self.skin, x, y)
        distance = np.linspace(0.0, 0.5 * self.pitch, NODES)
        known = furrow_depth(distance, self.pitch, self.width, self.height)
        found = np.interp(np.minimum(depth, self.height), known, distance)
        return np.zeros(found.shape, np.int64), found
