"""The finger's outer surface: a spherical cap on a cylinder, pressed flat onto the glass, and rays that meet it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

EPSILON = 1e-6
"""How far the station of the flat part's rim lies below 0, where the surface has a kink [1]."""


@dataclass(frozen=True)
class FingerSurface:
    """Surface of revolution, tip down: a cap of a sphere on a cylinder, lowered onto the glass and flattened there.

    Attributes
    ----------
    centre : tuple of float
        Of the axis on the plate [mm].
    tip_radius, half_width, length : float
        Of the sphere; of the cylinder; from the unpressed tip to the top [mm].
    """

    centre: tuple[float, float]
    tip_radius: float
    half_width: float
    length: float

    @property
    def cap(self) -> float:
        """Polar angle at which the cap meets the cylinder [rad]."""
        return float(np.arcsin(min(1.0, self.half_width / self.tip_radius)))

    @property
    def _wall(self) -> float:
        """Height of the cylinder's wall [mm]."""
        return max(self.length - self.tip_radius * (1 - float(np.cos(self.cap))), 1e-9)

    def points(self, station: Array, azimuth: Array, depth: Array) -> tuple[Array, Array]:
        """Return points and outward normals (..., 3) of the pressed surface.

        ``station`` runs from -1 at the axis to below 0 over the flat part, from 0 to 1 over the rest of the cap and to
        2 at the cylinder's top: the kinks stay where they are when the depth changes.
        """
        first = np.arccos(1.0 - depth / self.tip_radius)
        polar = first + (self.cap - first) * np.clip(station, 0.0, 1.0)
        rise = np.maximum(station - 1.0, 0.0) * self._wall
        flat, on_cap = station < 0.0, station < 1.0
        radius = self.tip_radius * np.sin(polar) * np.where(flat, 1.0 + station, 1.0)
        height = np.maximum(self.tip_radius * (1 - np.cos(polar)) + rise - depth, 0.0)
        slant = np.where(on_cap, np.sin(polar), 1.0) * ~flat
        down = np.where(on_cap, -np.cos(polar), 0.0) * ~flat - flat
        cos_a, sin_a = np.cos(azimuth), np.sin(azimuth)
        shape = np.broadcast(station, azimuth, depth).shape
        points = (self.centre[0] + radius * cos_a, self.centre[1] + radius * sin_a, height)
        normals = (slant * cos_a, slant * sin_a, down)
        return (
            np.stack([np.broadcast_to(p, shape) for p in points], -1),
            np.stack([np.broadcast_to(p, shape) for p in normals], -1),
        )

    def intersect(self, x: Array, y: Array, slope_x: Array, slope_y: Array, depth: float) -> tuple[Array, Array]:
        """Return station and azimuth where rays that leave the glass at (x, y) meet the surface; NaN where they miss.

        ``slope`` is dx/dz and dy/dz of each ray above the glass.
        """
        px, py = x - self.centre[0], y - self.centre[1]
        # The sphere's centre is at height tip_radius - depth.
        up = self.tip_radius - depth
        a = 1 + slope_x**2 + slope_y**2
        b = px * slope_x + py * slope_y - up
        root = b * b - a * (px**2 + py**2 + up**2 - self.tip_radius**2)
        z = np.where(root >= 0, (-b - np.sqrt(np.maximum(root, 0.0))) / a, np.nan)
        # Where the tip is flattened the ray meets it on the glass.
        flat = z <= 0.0
        z = np.where(flat, 0.0, z)
        qx, qy = px + z * slope_x, py + z * slope_y
        radius = np.hypot(qx, qy)
        polar = np.arcsin(np.clip(radius / self.tip_radius, 0.0, 1.0))
        cap = np.isfinite(z) & (polar <= self.cap + 1e-9) & (z + depth <= self.tip_radius)
        # The cylinder, for rays that pass beside the cap.
        a2 = slope_x**2 + slope_y**2
        b2 = px * slope_x + py * slope_y
        root2 = b2 * b2 - a2 * (px**2 + py**2 - self.half_width**2)
        with np.errstate(divide="ignore", invalid="ignore"):
            z2 = (-b2 - np.sqrt(np.maximum(root2, 0.0))) / a2
        start = self.tip_radius * (1 - np.cos(self.cap))
        rise = (z2 + depth - start) / self._wall
        wall = ~cap & (root2 > 0) & (rise >= 0) & (rise <= 1) & (z2 > 0)
        azimuth = np.where(cap, np.arctan2(qy, qx), np.arctan2(py + z2 * slope_y, px + z2 * slope_x))
        first = float(np.arccos(1.0 - depth / self.tip_radius))
        on_cap = np.clip((polar - first) / (self.cap - first), 0.0, 1.0)
        inner = np.minimum(radius / max(self.tip_radius * np.sin(first), 1e-9) - 1.0, -EPSILON)
        station = np.where(cap, np.where(flat, inner, on_cap), np.where(wall, 1.0 + rise, np.nan))
        return station, azimuth
