"""The finger's outer surface beside its contact, after Hertz: how far above the glass it stands, and how steep it is.

The flattened sphere of :mod:`evanesce.optics.flank.surface` lies on the glass out to where the unpressed sphere would
pass it, 1.4 times as far as the contact. Light from the side that just passes over the glass meets the surface in
between, so that spill and haze are computed on this one.

References
----------
K. L. Johnson, *Contact Mechanics* (1985), equation 3.42a: surface displacement outside a Hertzian contact.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

CAP_RINGS = 28
"""Radii on the cap beside the contact, evenly spaced in its polar angle."""

WALL_RINGS = (0.02, 0.1, 0.25, 0.6, 1.0)
"""Heights on the cylinder's wall, over the wall's [1]."""


@dataclass(frozen=True)
class PressedFinger:
    """A cap of a sphere on a cylinder, pressed onto the glass; a surface of revolution.

    Attributes
    ----------
    centre : tuple of float
        Of the axis on the plate [mm].
    tip_radius, half_width, length, depth : float
        Of the sphere; of the cylinder; from the unpressed tip to the top; approach [mm].
    """

    centre: tuple[float, float]
    tip_radius: float
    half_width: float
    length: float
    depth: float

    @property
    def contact_radius(self) -> float:
        """Of Hertz for this approach, sqrt(R depth) [mm]; less than the half-width."""
        return float(min(np.sqrt(self.tip_radius * max(self.depth, 0.0)), 0.99 * self.half_width))

    def height(self, r: Array) -> Array:
        """Return the height above the glass at a distance from the axis up to the half-width [mm]."""
        a = self.contact_radius
        if a == 0.0:
            return np.asarray(self._sphere(r))
        at_rim = self._sphere(np.array(a)) + self._lift(np.array(a))
        return np.asarray(np.where(r > a, self._sphere(r) + self._lift(r) - at_rim, 0.0))

    def slope(self, r: Array) -> Array:
        """Return the derivative of :meth:`height` [1]; large where the surface is upright."""
        a, big_r = self.contact_radius, self.tip_radius
        sphere = r / np.sqrt(np.maximum(big_r**2 - r**2, (1e-6 * big_r) ** 2))
        if a == 0.0:
            return np.asarray(sphere)
        out = np.maximum(r, a)
        lift = (2 * a / (np.pi * big_r)) * (np.sqrt(out**2 - a**2) / out - out / a * np.arcsin(a / out))
        return np.asarray(np.where(r > a, np.maximum(sphere + lift, 0.0), 0.0))

    def rings(self) -> tuple[Array, Array, Array]:
        """Return distance from the axis and height [mm] of rings from tip to top, and the normal's angle from down."""
        a, half = self.contact_radius, self.half_width
        first, last = np.arcsin(a / self.tip_radius), np.arcsin(min(1.0, half / self.tip_radius))
        r = self.tip_radius * np.sin(np.linspace(first, last, CAP_RINGS))
        # In contact: axis, half-way, rim; close beside the rim the surface rises as the power 3/2.
        near = a + (r[1] - a) * np.array([0.05, 0.2, 0.5])
        inside = np.array([0.0, 0.5 * a, a]) if a > 0 else np.array([0.0])
        r = np.concatenate([inside, near, r[1:]])
        up = self.height(r)
        wall = up[-1] + np.array(WALL_RINGS) * max(self.length - self.depth - up[-1], 1e-3)
        polar = np.concatenate([np.arctan(self.slope(r)), np.full(wall.size, np.pi / 2)])
        return np.concatenate([r, np.full(wall.size, half)]), np.concatenate([up, wall]), polar

    def points(self, azimuths: Array) -> tuple[Array, Array]:
        """Return points [mm] and outward normals of the rings, (rings, azimuths, 3)."""
        r, z, polar = (a[:, None] for a in self.rings())
        cos_a, sin_a = np.cos(azimuths)[None, :], np.sin(azimuths)[None, :]
        shape = np.broadcast_shapes(r.shape, cos_a.shape)
        place = (self.centre[0] + r * cos_a, self.centre[1] + r * sin_a, z)
        normal = (np.sin(polar) * cos_a, np.sin(polar) * sin_a, -np.cos(polar))
        return tuple(np.stack([np.broadcast_to(c, shape) for c in three], -1) for three in (place, normal))  # type: ignore[return-value]

    def stations(self) -> Array:
        """Return the stations of the rings on :class:`evanesce.optics.flank.surface.FingerSurface` at this approach."""
        r, _, _ = self.rings()
        big_r, depth = self.tip_radius, self.depth
        first = float(np.arccos(1.0 - depth / big_r))
        flat = big_r * np.sin(first)
        cap = float(np.arcsin(min(1.0, self.half_width / big_r)))
        on_cap = (np.arcsin(np.clip(r / big_r, 0.0, 1.0)) - first) / (cap - first)
        found = np.where(r < flat, r / max(flat, 1e-9) - 1.0, np.clip(on_cap, 0.0, 1.0))
        wall = slice(len(r) - len(WALL_RINGS), None)
        found[wall] = 1.0 + np.array(WALL_RINGS)
        return np.asarray(found)

    def _sphere(self, r: Array) -> Array:
        return np.asarray(self.tip_radius - np.sqrt(np.maximum(self.tip_radius**2 - r**2, 0.0)))

    def _lift(self, r: Array) -> Array:
        """Return how far the surface is lifted: a^2/(pi R) ((2 - q^2) asin(1/q) + sqrt(q^2 - 1)), q = r/a."""
        a = self.contact_radius
        q = np.maximum(r / a, 1.0)
        return np.asarray(a**2 / (np.pi * self.tip_radius) * ((2 - q**2) * np.arcsin(1 / q) + np.sqrt(q**2 - 1.0)))
