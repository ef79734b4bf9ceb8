"""Closure of a row of ridges under the macroscopic pressure: local pressure, gap and width of each ridge's contact."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from evanesce.contact.ridges.heightmap import RidgeRow, furrow_depth
from evanesce.contact.ridges.profile import closure_pressure, contact_edge, profile_exponent, ridge_gap, ridge_pressure

Array = NDArray[np.float64]


@dataclass(frozen=True)
class RidgeClosure:
    """How each ridge of a row closes under the macroscopic pressure.

    Attributes
    ----------
    ridges : RidgeRow
        Its rounding is not used: a ridge has the shape |sin|^m.
    exponent : float
        m.
    pressure : float
        Mean pressure that closes the furrows [MPa].
    """

    ridges: RidgeRow
    exponent: float
    pressure: float

    @classmethod
    def of(cls, ridges: RidgeRow, modulus: float) -> Self:
        """Return the closure of a row of ridges.

        Parameters
        ----------
        ridges : RidgeRow
        modulus : float
            E* at the scale of the ridges [MPa].

        Returns
        -------
        RidgeClosure

        Raises
        ------
        ValueError
            If a dimension of the ridges is impossible.
        """
        exponent = profile_exponent(ridges.width, ridges.pitch)
        return cls(ridges, exponent, closure_pressure(modulus, ridges.height, ridges.pitch, exponent))

    def local_pressure(self, distance: Array, mean: Array | float) -> Array:
        """Return the pressure [MPa] at distances from a crest [mm] under mean pressures [MPa].

        Parameters
        ----------
        distance : ndarray
            From the crest [mm].
        mean : ndarray or float
            Over a whole pitch [MPa].

        Returns
        -------
        ndarray
            [MPa].
        """
        return ridge_pressure(distance, mean, self.ridges.pitch, self.pressure, self.exponent)

    def gap(self, distance: Array, mean: Array | float) -> Array:
        """Return the gap [mm] at distances from a crest [mm] under mean pressures [MPa].

        Parameters
        ----------
        distance : ndarray
            From the crest [mm].
        mean : ndarray or float
            Over a whole pitch [MPa].

        Returns
        -------
        ndarray
            [mm].
        """
        return ridge_gap(distance, mean, self.ridges.pitch, self.ridges.height, self.pressure, self.exponent)

    def undeformed_gap(self, distance: Array) -> Array:
        """Return the depth [mm] below the crests at distances from a crest [mm], without pressure.

        Parameters
        ----------
        distance : ndarray
            From the crest [mm].

        Returns
        -------
        ndarray
            [mm].
        """
        return furrow_depth(distance, self.ridges.pitch, self.ridges.width, self.ridges.height)

    def half_width(self, mean: Array) -> Array:
        """Return half the width of a ridge's contact [mm] under mean pressures [MPa]; pitch/2 where it is closed.

        Parameters
        ----------
        mean : ndarray
            Over a whole pitch [MPa].

        Returns
        -------
        ndarray
            [mm].
        """
        return self.ridges.pitch / np.pi * np.arcsin(contact_edge(mean, self.pressure, self.exponent))
