"""The finger's flank in the fast renderer: its light in tables, and its image.

Beside the contact the lens sees the flank through bare glass, lit by what leaves the plate near its edges and by what
the contact itself sends there over the bottom face. Both are smooth: irradiance is tabulated by the finger's approach,
by station (from the tip upwards, :class:`evanesce.optics.flank.surface.FingerSurface`) and by azimuth, and linear
between. The closed forms are in :mod:`evanesce.optics.flank`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from evanesce.core.states import ContactState
from evanesce.optics.edge_rays import EdgeLight
from evanesce.optics.flank.irradiance import contact_on_flank, flank_sums, mirrored_exchange
from evanesce.optics.patch_light import Interface
from evanesce.optics.path_sums import MOMENTS
from evanesce.optics.projection import IdealView
from evanesce.render.fast.flank_table import (
    APPROACHES,
    positions,
    table_points,
    table_position,
)
from evanesce.render.fast.sampling import BLOCK, enlarged, spread_blocks
from evanesce.rig import Scene

Array = NDArray[np.float64]
Image = NDArray[np.float32]

AZIMUTH_STEP = 2
"""In a coarse table every so many azimuths are computed; between them it is interpolated."""


# --- irradiance in tables --------------------------------------------------------------------------------------------


def unit_tables(scene: Scene, light: EdgeLight, per_edge: int) -> tuple[Array, Array]:
    """Compute the irradiance on the flank by unit sources.

    Parameters
    ----------
    scene : Scene
        Its finger.
    light : EdgeLight
        Its plate; radiances do not count.
    per_edge : int
        Segments of each edge.

    Returns
    -------
    led : ndarray (moments, leds, approaches * stations * azimuths)
        Per radiance of each LED [sr], summed by paths (:mod:`evanesce.optics.path_sums`).
    edge : ndarray (moments, segments, approaches * stations * azimuths)
        Per diffuse radiance of each segment [sr].
    """
    points, normals = table_points(scene)
    return flank_sums(light, points.reshape(-1, 3), normals.reshape(-1, 3), per_edge=per_edge)


def approaches_around(wanted_mm: tuple[float, ...], radius_mm: float) -> NDArray[np.intp]:
    """Return the indices of the tabulated approaches between which those of a tip [mm] lie.

    Parameters
    ----------
    wanted_mm : tuple of float
        [mm].
    radius_mm : float
        Of the tip [mm].

    Returns
    -------
    ndarray of int
    """
    share = np.asarray(wanted_mm) / radius_mm
    above = np.clip(np.searchsorted(APPROACHES, share), 1, APPROACHES.size - 1)
    return np.unique(np.concatenate([above - 1, above]))


def coarse_unit_tables(scene: Scene, light: EdgeLight, per_edge: int, some: NDArray[np.intp]) -> tuple[Array, Array]:
    """Compute :func:`unit_tables` at some approaches (their indices) and a part of the azimuths.

    The other approaches repeat the nearest of them, azimuths are interpolated.

    Parameters
    ----------
    scene, light, per_edge
        As for :func:`unit_tables`.
    some : ndarray of int
        Indices of the approaches.

    Returns
    -------
    led, edge : ndarray
        As of :func:`unit_tables`.
    """
    points, normals = (a[some][:, :, ::AZIMUTH_STEP] for a in table_points(scene))
    coarse = flank_sums(light, points.reshape(-1, 3), normals.reshape(-1, 3), per_edge=per_edge)
    led, edge = (_filled(table.reshape(-1, *points.shape[:-1]), some) for table in coarse)
    return tuple(filled.reshape(MOMENTS, -1, filled.shape[-1]) for filled in (led, edge))  # type: ignore[return-value]


def _filled(table: Array, some: NDArray[np.intp]) -> Array:
    """Return a coarse table (sources, approaches, stations, azimuths) at all approaches and azimuths, (sources, -1)."""
    count = table.shape[-1] * AZIMUTH_STEP
    around = np.repeat(table, AZIMUTH_STEP, axis=-1)
    following = np.repeat(np.roll(table, -1, axis=-1), AZIMUTH_STEP, axis=-1)
    part = np.tile(np.arange(AZIMUTH_STEP) / AZIMUTH_STEP, count // AZIMUTH_STEP)
    fine = around * (1 - part) + following * part
    nearest = np.abs(np.arange(APPROACHES.size)[:, None] - some[None, :]).argmin(axis=1)
    return np.asarray(fine[:, nearest].reshape(table.shape[0], -1))


def rig_tables(
    scene: Scene, light: EdgeLight, interface: Interface, nodes: Array, direct: Array
) -> tuple[Array, Array]:
    """Compute the irradiance on the flank by LEDs and contact, reflections between flank and plate included.

    Parameters
    ----------
    scene : Scene
    light : EdgeLight
    interface : Interface
    nodes : ndarray (points, 2)
        Contacts on the top face [mm].
    direct : ndarray (leds, approaches * stations * azimuths)
        Irradiance per radiance of each LED, diffuse edges included, those reflections not [sr].

    Returns
    -------
    led : ndarray (leds, approaches, stations, azimuths)
        Per radiance of each LED [sr].
    contact : ndarray (approaches, stations, azimuths, points)
        Per power that a contact at each node takes in [1/mm^2].
    """
    points, normals = table_points(scene)
    shape = points.shape[:-1]
    led = direct.reshape(-1, *shape)
    contact = contact_on_flank(
        points.reshape(-1, 3), normals.reshape(-1, 3), nodes, light.thickness, interface, light.absorption_coefficient
    ).reshape(*shape, -1)
    for k in range(shape[0]):
        own = mirrored_exchange(points[k], normals[k], interface.body_reflectance, interface.n_glass)
        led[:, k] = (led[:, k].reshape(len(led), -1) @ own.T).reshape(led[:, k].shape)
        contact[k] = (own @ contact[k].reshape(-1, len(nodes))).reshape(contact[k].shape)
    return led, contact


@dataclass(frozen=True)
class FlankLight:
    """The flank's light for a rig's LED powers.

    Attributes
    ----------
    approaches : ndarray (approaches,)
        Of the tables [mm].
    irradiance : ndarray (approaches, stations, azimuths)
        By light from beside the finger [W mm^-2].
    per_taken : ndarray (approaches, stations, azimuths, points)
        Irradiance per power that a contact at each node of the guided field takes in [1/mm^2].
    response : float
        Radiance in air towards the lens per irradiance, behind bare glass [1/sr].
    """

    approaches: Array
    irradiance: Array
    per_taken: Array
    response: float

    def at(self, approach_mm: float) -> tuple[Array, Array]:
        """Return the radiance at one approach, (stations, azimuths), and what contact adds, (..., points).

        The first is of light from beside the finger [W mm^-2 sr^-1], the second per power that a contact at each node
        takes in [mm^-2 sr^-1].
        """
        share = np.array([np.interp(approach_mm, self.approaches, row) for row in np.eye(self.approaches.size)])
        lit, per_taken = (np.tensordot(share, a, 1) * self.response for a in (self.irradiance, self.per_taken))
        return lit, per_taken

    def radiance(self, approach_mm: float, taken: Array) -> Image:
        """Return the radiance towards the lens by station and azimuth, the first azimuth twice."""
        lit, per_taken = self.at(approach_mm)
        return _closed_table(lit + per_taken @ taken)


def _closed_table(table: Array) -> Image:
    """Return a table (stations, azimuths) with its first azimuth repeated at the end, for interpolation all around."""
    return np.concatenate([table, table[:, :1]], axis=1).astype(np.float32)


# --- images ----------------------------------------------------------------------------------------------------------


def flank_image(
    scene: Scene, light: FlankLight, state: ContactState, taken: Array, view: IdealView, *, step: int
) -> Image:
    """Return the radiance of the finger's flank on a view; smooth, so that every ``step``-th pixel is enough.

    Parameters
    ----------
    scene : Scene
    light : FlankLight
    state : ContactState
    taken : ndarray (points,)
        Power that the contact takes in at the guided field's nodes [W].
    view : IdealView
    step : int

    Returns
    -------
    ndarray of float32 (rows, cols)
        [W mm^-2 sr^-1]; 0 where the view sees no flank.
    """
    coarse: Any = 0.0
    for depth, share, (column, row, seen) in positions(scene, state, view, step):
        lit = cv2.remap(light.radiance(depth, taken), column, row, cv2.INTER_LINEAR)
        coarse = coarse + share * (lit * seen)
    return enlarged(np.asarray(coarse, np.float32), step, view.shape)


@dataclass(frozen=True)
class FlankView:
    """The flank in a camera's frame at one approach.

    Attributes
    ----------
    first_row, first_col : int
        Pixel at which the next three start.
    column, row : ndarray of float32 (rows / step, cols / step)
        Position in the flank's table that each block sees.
    charge : ndarray of float32 (rows / step, cols / step)
        Mean charge per radiance, 0 where no flank is seen [e- mm^2 sr/W].
    lit : ndarray (stations, azimuths)
        Radiance by light from beside the finger [W mm^-2 sr^-1].
    per_taken : ndarray (stations, azimuths, points)
        Radiance per power that the contact takes in at each node [mm^-2 sr^-1].
    step : int
        Side of a block [px].
    """

    first_row: int
    first_col: int
    column: Image
    row: Image
    charge: Image
    lit: Array
    per_taken: Array
    step: int

    @classmethod
    def of(
        cls, scene: Scene, light: FlankLight, approach_mm: float, direction: tuple[Array, Array], charge: Image,
        step: int,
    ) -> FlankView:  # fmt: skip
        """Find the flank in the frame.

        Parameters
        ----------
        scene : Scene
        light : FlankLight
        approach_mm : float
            Of the finger [mm].
        direction : tuple of ndarray
            Undistorted direction (u, v, 1) of the centre of each block of the frame.
        charge : ndarray
            Mean charge per radiance of the blocks [e- mm^2 sr/W].
        step : int
            Side of a block, which divides ``BLOCK`` [px].
        """
        tables = light.at(approach_mm)
        column, row, seen = table_position(scene, *direction, approach_mm)
        charge = charge * seen
        rows, cols = np.nonzero(seen.any(axis=1))[0], np.nonzero(seen.any(axis=0))[0]
        if rows.size == 0:
            return cls(0, 0, column[:2, :2], row[:2, :2], charge[:2, :2] * 0, *tables, step)
        # Whole blocks of the frame, and one sample more on each side.
        per = BLOCK // step
        low = [max(0, n[0] - 1) // per * per for n in (rows, cols)]
        high = [min(-(-(n[-1] + 2) // per) * per, size) for n, size in zip((rows, cols), seen.shape, strict=True)]
        part = np.s_[low[0] : high[0], low[1] : high[1]]
        column, row, charge = (np.ascontiguousarray(a[part], np.float32) for a in (column, row, charge))
        return cls(low[0] * step, low[1] * step, column, row, charge, *tables, step)

    def relit(self, light: FlankLight, approach_mm: float) -> FlankView:
        """Return the same view in the light of other LED powers."""
        lit, per_taken = light.at(approach_mm)
        return replace(self, lit=lit, per_taken=per_taken)

    def mean_charge(self, taken: Array) -> Image:
        """Return the flank's mean charge at all pixels of the view, for the power that the contact takes in [e-]."""
        table = _closed_table(self.lit + self.per_taken @ taken)
        return spread_blocks(cv2.remap(table, self.column, self.row, cv2.INTER_LINEAR) * self.charge, self.step)
