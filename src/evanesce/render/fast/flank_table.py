"""The finger's flank as a table, by approach, station and azimuth, and the position in it that a ray meets.

Stations run from the tip upwards (:class:`evanesce.optics.flank.surface.FingerSurface`); between them all is linear.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from evanesce.core.states import ContactState
from evanesce.optics.flank.surface import EPSILON
from evanesce.optics.projection import IdealView, Projection
from evanesce.render.fast.rig_optics import finger_surface, geometry_digest, sight_digest
from evanesce.render.fast.sampling import enlarged, view_rays
from evanesce.render.kept import kept
from evanesce.render.reference.scene import approach
from evanesce.rig import Scene

Array = NDArray[np.float64]
Image = NDArray[np.float32]
Rays = tuple[Array, Array, Array, Array]

APPROACHES = np.array([0.0, 0.08, 0.2, 0.45, 0.85])
"""Approaches of the tables over the tip's radius [1]."""

STATIONS = np.array(
    [-1, -0.5, -EPSILON, 0, 0.02, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1, 1.25, 1.6, 2]
)
AZIMUTHS = 16

APPROACH_STEP_MM = 0.1
"""Step of the approaches for which positions in the table are kept."""

FLANK_MM = 0.07
"""About so far apart on the plate positions in the table are looked up [mm]. Light jumps across the flank's outline: a
third of a millimetre puts a frame off by over twice what its pixels alone do (tests/physics/test_transport.py)."""

OUTLINE_PARTS = 8
"""Rays along each side of a cell of the flank's outline."""


def tabulated_approaches(scene: Scene) -> Array:
    """Return the approaches of a scene's tables [mm].

    Parameters
    ----------
    scene : Scene
    """
    return APPROACHES * scene.finger.tip_radius_mm


def table_points(scene: Scene) -> tuple[Array, Array]:
    """Return points [mm] and outward normals of the tables, each (approaches, stations, azimuths, 3).

    Parameters
    ----------
    scene : Scene
    """
    azimuths = np.arange(AZIMUTHS) * 2 * np.pi / AZIMUTHS
    depth, station, azimuth = np.meshgrid(tabulated_approaches(scene), STATIONS, azimuths, indexing="ij")
    return finger_surface(scene).points(station, azimuth, depth)


def _clipped_approach(scene: Scene, state: ContactState) -> float:
    """Return a state's approach, within those of the tables [mm]."""
    tabulated = tabulated_approaches(scene)
    return float(np.clip(approach(state, scene.finger), tabulated[0], tabulated[-1]))


def rounded_approach(scene: Scene, state: ContactState) -> float:
    """Return a state's approach to a tenth of a millimetre: a single frame shows no difference [mm]."""
    return round(_clipped_approach(scene, state), 1)


def table_position(
    scene: Scene, u: Array, v: Array, approach_mm: float, rays: Rays | None = None
) -> tuple[Image, Image, Image]:
    """Return column and row in the flank's table that directions (u, v, 1) see, and the share that see the flank.

    Directions are those of a grid (rows, cols); at the flank's outline each stands for its cell, so that the outline
    moves with a camera that moves, and does not jump from cell to cell.

    Parameters
    ----------
    scene : Scene
    u, v : ndarray (rows, cols)
        [1].
    approach_mm : float
        [mm].
    rays : tuple of ndarray, optional
        :func:`rays_above` of those directions, where they are known.

    Returns
    -------
    column, row, share : ndarray of float32 (rows, cols)
        [1].
    """
    surface = finger_surface(scene)
    station, azimuth = surface.intersect(*(rays_above(scene, u, v) if rays is None else rays), approach_mm)
    met = np.isfinite(station)
    share = met.astype(float)
    edge = _outline(met)
    if edge.any():
        part = (np.arange(OUTLINE_PARTS) + 0.5) / OUTLINE_PARTS - 0.5
        du, dv = np.gradient(u, axis=1)[edge], np.gradient(v, axis=0)[edge]
        across, down = (part[None, None, :] * du[:, None, None], part[None, :, None] * dv[:, None, None])
        uu, vv = np.broadcast_arrays(u[edge][:, None, None] + across, v[edge][:, None, None] + down)
        stations, azimuths = surface.intersect(*rays_above(scene, uu, vv), approach_mm)
        hit = np.isfinite(stations)
        count = np.maximum(hit.sum(axis=(1, 2)), 1)
        share[edge] = hit.mean(axis=(1, 2))
        station[edge] = np.where(hit, stations, 0.0).sum(axis=(1, 2)) / count
        sine, cosine = (np.where(hit, turn(azimuths), 0.0).sum(axis=(1, 2)) for turn in (np.sin, np.cos))
        azimuth[edge] = np.arctan2(sine, cosine)
    station, azimuth = np.where(share > 0, station, 0.0), np.where(share > 0, azimuth, 0.0)
    row = np.interp(station, STATIONS, np.arange(STATIONS.size))
    column = np.mod(azimuth, 2 * np.pi) * (AZIMUTHS / (2 * np.pi))
    return column.astype(np.float32), row.astype(np.float32), share.astype(np.float32)


def _outline(met: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return where a neighbour differs."""
    kind, around = met.astype(np.uint8), np.ones((3, 3), np.uint8)
    return np.asarray(cv2.dilate(kind, around) != cv2.erode(kind, around))


def rays_above(scene: Scene, u: Array, v: Array) -> Rays:
    """Return where directions (u, v, 1) leave the glass [mm], and dx/dz and dy/dz above it: as steep as below it.

    Parameters
    ----------
    scene : Scene
    u, v : ndarray
        [1].

    Returns
    -------
    x, y, slope_x, slope_y : ndarray
        Shape of ``u``.
    """
    projection = Projection.of(scene.camera, scene.plate)
    return (*projection.ray_to_plate(u, v), *projection.tangents(u, v))


def flank_step(px_per_mm: float) -> int:
    """Return every which pixel, or blocks of how many, share one position in the table: a power of two [px].

    Parameters
    ----------
    px_per_mm : float
        Of a view or a frame.
    """
    return int(2 ** np.floor(np.log2(max(1.0, FLANK_MM * px_per_mm))))


def flank_cover(scene: Scene, state: ContactState, view: IdealView, *, step: int) -> Image:
    """Return the share of each pixel of a view that sees the finger, (rows, cols) [1].

    Parameters
    ----------
    scene : Scene
    state : ContactState
    view : IdealView
    step : int
        Every so many pixels of the view are computed.
    """
    coarse: Any = 0.0
    for _, share, (_, _, seen) in positions(scene, state, view, step):
        coarse = coarse + share * seen
    return enlarged(np.asarray(coarse, np.float32), step, view.shape)


def positions(
    scene: Scene, state: ContactState, view: IdealView, step: int
) -> Iterator[tuple[float, np.float32, tuple[Image, Image, Image]]]:
    """Yield the kept approaches about a state's [mm], their weights and :func:`table_position` of each.

    Two of them: one rounded approach would jump where a force grows.

    Parameters
    ----------
    scene : Scene
    state : ContactState
    view : IdealView
    step : int
        Every so many pixels of the view.

    Yields
    ------
    approach : float
        [mm].
    weight : float
        [1].
    position : tuple of ndarray
        Column, row and share.
    """
    directions = view_rays(view, step)
    rays = kept("rays", f"{sight_digest(scene)}{view}{step}", lambda: rays_above(scene, *directions))
    between = _clipped_approach(scene, state)
    low = int(np.floor(between / APPROACH_STEP_MM))
    for number, share in ((low, 1 - (between / APPROACH_STEP_MM - low)), (low + 1, between / APPROACH_STEP_MM - low)):
        if share > 0:
            depth = round(min(number * APPROACH_STEP_MM, float(tabulated_approaches(scene)[-1])), 3)
            key = f"{geometry_digest(scene)}{view}{step}{depth:.3f}"
            yield depth, np.float32(share), kept("flank", key, partial(table_position, scene, *directions, depth, rays))
