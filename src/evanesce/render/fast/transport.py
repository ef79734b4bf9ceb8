"""The fast renderer: a frame as fields computed once per rig and cheap operators per contact state.

Guided light is smooth and nearly unchanged by a contact. What a contact sends to the lens is therefore a product of
the guided irradiance of the empty plate (a field, by angle), the interface's transmittance at the local gap (a table)
and the body's response (a table), corrected for what the contact takes away from itself or gives back, directly
through the plate (convolutions on a coarse grid) and over the edges (a small matrix). Beside the contact the lens sees
the finger's flank, lit by the contact's own light and by what escapes near the plate's edges.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from evanesce.core.states import ContactState, PlateLight
from evanesce.optics.projection import IdealView, Projection
from evanesce.render.fast.fields import MODES, Fields, fields_of, sight_digest
from evanesce.render.fast.patch import PatchLight, enlarged, patch_light, patch_radiance, refinement
from evanesce.render.fast.rig_fields import (
    FLANK_AZIMUTHS,
    FLANK_STATIONS,
    edge_light,
    flank_depths,
    interface_of,
    profile_of,
)
from evanesce.render.kept import kept
from evanesce.render.reference.scene import approach
from evanesce.rig import Scene

Array = NDArray[Any]
Image = NDArray[np.float32]

__all__ = ["MODES", "edge_light", "fields_of", "interface_of", "patch_radiance", "render_fast"]


def render_fast(
    scene: Scene,
    state: ContactState | None,
    *,
    seed: int = 0,
    view: IdealView | None = None,
    fields: Fields | None = None,
) -> PlateLight:
    """Render a contact state by transport; interchangeable with :func:`evanesce.render.reference.path.render`.

    Parameters
    ----------
    scene : Scene
    state : ContactState or None
        None leaves the plate empty, and dark.
    seed : int
        Not used: nothing here is random. Taken so that both renderers are called alike.
    view : IdealView, optional
        Pinhole grid; the one that covers the frame by default.
    fields : Fields, optional
        The scene's own by default; those of a finger close by spare seconds where it has moved a little.

    Returns
    -------
    PlateLight
        With zero variance: there is nothing random in it.
    """
    projection = Projection.of(scene.camera, scene.plate)
    view = projection.ideal_view() if view is None else view
    seen = np.zeros(view.shape, np.float32)
    if state is not None:
        fields = fields_of(scene) if fields is None else fields
        pixel_mm = projection.focal_px / (scene.camera.scale_px_per_mm * view.focal_px)
        patch = patch_light(fields, state, refinement(state.grid.pitch, pixel_mm))
        direct, turned = _patch_views(scene, state, patch, view, pixel_mm)
        bare = 1.0 - direct(patch.cover, patch.refine)
        seen = direct(patch.radiance, 1)
        ghost = np.float32(fields.ghost) * turned(patch.radiance, 1)
        seen += bare * (ghost + flank_image(scene, fields, state, patch.taken, view))
    return PlateLight(
        radiance=seen,
        variance=np.zeros_like(seen),
        focal_px=view.focal_px,
        principal_point=view.principal_point,
        samples=0,
    )


def _patch_views(
    scene: Scene, state: ContactState, patch: PatchLight, view: IdealView, pixel_mm: float
) -> tuple[Callable[[Image, int], Image], ...]:
    """Return functions that carry an image of a patch into a view, directly and after one more turn in the plate.

    Each takes the image and how many times its samples are as large as the refined grid's.
    """
    x0, y0 = (state.grid.extent[i] + patch.pitch / 2 for i in (0, 2))
    key = f"{sight_digest(scene)}{view}{x0:.9g} {y0:.9g} {patch.pitch:.9g}"
    maps = kept("maps", key, lambda: plate_maps(scene, view_rays(view), (x0, y0), patch.pitch))

    def onto(maps: Maps) -> Callable[[Image, int], Image]:
        def carry(image: Image, coarser: int) -> Image:
            # The mean over a pixel; beyond the patch there is nothing, and as much is added as the mean reaches.
            kernel = box_kernel(pixel_mm / (patch.pitch * coarser))
            reach = kernel.size // 2
            wide = cv2.copyMakeBorder(image, reach, reach, reach, reach, cv2.BORDER_CONSTANT)
            mean = cv2.sepFilter2D(wide, cv2.CV_32F, kernel, kernel, borderType=cv2.BORDER_CONSTANT)
            # Samples ``coarser`` times as large have their first (coarser - 1)/2 later.
            shift = reach - (coarser - 1) / 2 / coarser
            x, y = (
                m * np.float32(1 / coarser) + np.float32(shift - first / coarser)
                for m, first in zip(maps, (patch.col, patch.row), strict=True)
            )
            return np.asarray(cv2.remap(mean, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=0))

        return carry

    return onto(maps[0]), onto(maps[1])


def box_kernel(width: float) -> Image:
    """Return the mean over a pixel ``width`` samples wide, as a kernel for a picture that is then interpolated.

    Whatever the width, it is kept: a whole number of samples instead would blur the edge of contact more or less, which
    a tone curve turns into brighter or darker. Interpolation widens by the variance of a triangle, 1/6; by so much the
    box is narrower.

    Parameters
    ----------
    width : float
        Of a pixel [samples].
    """
    narrower = float(np.sqrt(max(width**2 - 2.0, 1.0)))
    half = int(np.ceil((narrower - 1) / 2 - 1e-9))
    kernel = np.ones(2 * half + 1)
    if half > 0:
        kernel[[0, -1]] = (narrower - (2 * half - 1)) / 2
    return np.asarray(kernel / kernel.sum(), np.float32)


Maps = tuple[Image, Image]


def view_rays(view: IdealView, step: int = 1) -> tuple[Array, Array]:
    """Return the directions (u, v, 1) of every ``step``-th pixel of a view."""
    rows, cols = view.shape
    px, py = view.principal_point
    u, v = np.meshgrid(
        (np.arange(0, cols + step - 1, step) - px) / view.focal_px,
        (np.arange(0, rows + step - 1, step) - py) / view.focal_px,
    )
    return u, v


def plate_maps(scene: Scene, rays: tuple[Array, Array], first: tuple[float, float], pitch: float) -> tuple[Maps, Maps]:
    """Return where directions (u, v, 1) fall on the refined contact grid.

    Directly, and after one more turn between the plate's faces.

    Parameters
    ----------
    scene : Scene
    rays : tuple of ndarray
        u, v.
    first : tuple of float
        Place of the grid's first sample [mm].
    pitch : float
        [mm].
    """
    projection = Projection.of(scene.camera, scene.plate)
    x, y, slope_x, slope_y = plate_rays(projection, *rays)
    turn = 2 * scene.plate.thickness_mm
    found: list[Any] = []
    for px, py in ((x, y), (x + turn * slope_x, y + turn * slope_y)):
        found.append(tuple(((p - p0) / pitch).astype(np.float32) for p, p0 in zip((px, py), first, strict=True)))
    return found[0], found[1]


def plate_rays(projection: Projection, u: Array, v: Array) -> tuple[Array, Array, Array, Array]:
    """Return where directions (u, v, 1) meet the contact plane [mm], and dx/dz, dy/dz inside the glass."""
    tan_x, tan_y = projection.tangents(u, v)
    ratio = projection.bend(tan_x, tan_y)
    reach = projection.clearance + projection.thickness * ratio
    return (
        projection.pinhole[0] + reach * tan_x,
        projection.pinhole[1] + reach * tan_y,
        tan_x * ratio,
        tan_y * ratio,
    )


def flank_image(
    scene: Scene, fields: Fields, state: ContactState, taken: Array, view: IdealView, *, step: int = 4
) -> Image:
    """Return the radiance of the finger's flank on a view; smooth, so that every ``step``-th pixel is enough.

    Parameters
    ----------
    scene : Scene
    fields : Fields
    state : ContactState
    taken : ndarray (points,)
        See :class:`PatchLight`.
    view : IdealView
    step : int
    """
    rays = view_rays(view, step)
    between = approach_between(scene, state)
    low = int(np.floor(between / FLANK_DEPTH_MM))
    coarse: Any = 0.0
    # Between two depths that are kept: one rounded depth would jump where a force grows.
    for number, share in ((low, 1 - (between / FLANK_DEPTH_MM - low)), (low + 1, between / FLANK_DEPTH_MM - low)):
        if share > 0:
            depth = round(min(number * FLANK_DEPTH_MM, float(flank_depths(scene)[-1])), 3)
            key = f"{sight_digest(scene)}{view}{step}{depth:.3f}"
            column, row, seen = kept("flank", key, partial(flank_place, scene, *rays, depth))
            lit = cv2.remap(flank_lit(scene, fields, taken, depth), column, row, cv2.INTER_LINEAR)
            coarse = coarse + np.float32(share) * (lit * seen)
    return enlarged(np.asarray(coarse, np.float32), step, view.shape)


FLANK_DEPTH_MM = 0.1
"""Step of the approaches for which the flank's place is kept."""


def approach_between(scene: Scene, state: ContactState) -> float:
    """Return a state's approach, within the depths of the flank's tables [mm]."""
    depths = flank_depths(scene)
    return float(np.clip(approach(state, scene.finger), depths[0], depths[-1]))


def flank_depth(scene: Scene, state: ContactState) -> float:
    """Return a state's approach for the flank's tables to a tenth [mm]: a single frame shows no difference."""
    return round(approach_between(scene, state), 1)


def flank_lit(scene: Scene, fields: Fields, taken: Array, depth: float) -> Image:
    """Return the radiance of the flank towards the lens by station and azimuth, the first azimuth twice."""
    lit, per_taken = flank_tables(scene, fields, depth)
    return flank_turn(lit + per_taken @ taken)


def flank_tables(scene: Scene, fields: Fields, depth: float) -> tuple[Array, Array]:
    """Return the flank's radiance at one approach, (stations, azimuths), and what contact adds, (..., points).

    The first is of light from beside the finger [W mm^-2 sr^-1], the second per power that a contact at each node
    takes in [mm^-2 sr^-1].
    """
    depths = flank_depths(scene)
    between = np.array([np.interp(depth, depths, row) for row in np.eye(depths.size)])
    lit, per_taken = (np.tensordot(between, a, 1) * fields.open_response
                      for a in (fields.flank_lit, fields.rig.flank_contact))  # fmt: skip
    return lit, per_taken


def flank_turn(table: Array) -> Image:
    """Return a table of the flank with its first azimuth repeated at the end, for interpolation all around."""
    return np.concatenate([table, table[:, :1]], axis=1).astype(np.float32)


def flank_place(scene: Scene, u: Array, v: Array, depth: float) -> tuple[Image, Image, Image]:
    """Return column and row in the flank's table that directions (u, v, 1) see, and the share that see the flank.

    Directions are those of a grid (rows, cols); at the flank's outline each stands for its cell, so that the outline
    moves with a camera that moves, and does not jump from cell to cell.
    """
    station, azimuth = _flank_met(scene, u, v, depth)
    met = np.isfinite(station)
    share = met.astype(float)
    edge = _outline(met)
    if edge.any():
        part = (np.arange(OUTLINE_PARTS) + 0.5) / OUTLINE_PARTS - 0.5
        du, dv = np.gradient(u, axis=1)[edge], np.gradient(v, axis=0)[edge]
        across, down = (part[None, None, :] * du[:, None, None], part[None, :, None] * dv[:, None, None])
        uu, vv = np.broadcast_arrays(u[edge][:, None, None] + across, v[edge][:, None, None] + down)
        stations, azimuths = _flank_met(scene, uu, vv, depth)
        hit = np.isfinite(stations)
        count = np.maximum(hit.sum(axis=(1, 2)), 1)
        share[edge] = hit.mean(axis=(1, 2))
        station[edge] = np.where(hit, stations, 0.0).sum(axis=(1, 2)) / count
        sine, cosine = (np.where(hit, turn(azimuths), 0.0).sum(axis=(1, 2)) for turn in (np.sin, np.cos))
        azimuth[edge] = np.arctan2(sine, cosine)
    station, azimuth = np.where(share > 0, station, 0.0), np.where(share > 0, azimuth, 0.0)
    row = np.interp(station, FLANK_STATIONS, np.arange(FLANK_STATIONS.size))
    column = np.mod(azimuth, 2 * np.pi) * (FLANK_AZIMUTHS / (2 * np.pi))
    return column.astype(np.float32), row.astype(np.float32), share.astype(np.float32)


OUTLINE_PARTS = 8
"""Rays along each side of a cell of the flank's outline."""


def _outline(met: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return where a neighbour is of the other kind."""
    kind, around = met.astype(np.uint8), np.ones((3, 3), np.uint8)
    return np.asarray(cv2.dilate(kind, around) != cv2.erode(kind, around))


def _flank_met(scene: Scene, u: Array, v: Array, depth: float) -> tuple[Array, Array]:
    """Return station and azimuth on the flank where directions (u, v, 1) meet it; NaN where they miss."""
    projection = Projection.of(scene.camera, scene.plate)
    x, y = projection.ray_to_plate(u, v)
    # Above the glass a ray is as steep as below it.
    station, azimuth = profile_of(scene).meet(x, y, *projection.tangents(u, v), depth)
    return np.array(station), np.array(azimuth)
