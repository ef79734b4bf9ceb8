"""The fast renderer: a frame as fields computed once per rig and cheap operators per contact state.

Guided light is smooth and nearly unchanged by a contact. What a contact sends to the lens is therefore a product of
the guided irradiance of the empty plate (a field, by angle), the interface's transmittance at the local gap (a table)
and the body's response (a table), corrected for what the contact absorbs of the light or returns to itself, directly
through the plate (convolutions on a coarse grid) and over the edges (a small matrix). Beside the contact the lens sees
the finger's flank, lit by the contact's own light and by what escapes near the plate's edges.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from evanesce.core.states import ContactState, PlateLight
from evanesce.optics.carried import carried_by, carried_finger
from evanesce.optics.liquid import lit_contact
from evanesce.optics.projection import IdealView, Projection
from evanesce.render.fast.fields import Fields, fields_of
from evanesce.render.fast.flank import flank_image
from evanesce.render.fast.flank_table import flank_cover, flank_step
from evanesce.render.fast.patch import PatchLight, patch_light, refinement
from evanesce.render.fast.rig_optics import sight_digest
from evanesce.render.fast.sampling import Maps, view_rays
from evanesce.render.fast.surroundings import surroundings_on_flank, surroundings_view
from evanesce.render.kept import kept
from evanesce.rig import Scene

Array = NDArray[Any]
Image = NDArray[np.float32]

WINDOW_STEP = 16
"""Every so many pixels of a view it is looked whether they see the patch [px]."""
BLOCK_ROWS = 64
"""Of a view whose rays are followed at once: their intermediate results stay in the processor's cache."""


def render_fast(
    scene: Scene,
    state: ContactState | None,
    *,
    seed: int = 0,
    view: IdealView | None = None,
    fields: Fields | None = None,
    step: int | None = None,
) -> PlateLight:
    """Render a contact state by transport; interchangeable with :func:`evanesce.render.reference.path.render`.

    Parameters
    ----------
    scene : Scene
    state : ContactState or None
        None leaves the plate empty, and dark but for what the scene's surroundings show of it.
    seed : int
        Not used: nothing is random. Accepted so that both renderers have one signature.
    view : IdealView, optional
        Pinhole grid; the one that covers the frame by default.
    fields : Fields, optional
        The scene's own by default; those of a finger nearby save seconds after a small shift.
    step : int, optional
        Every so many pixels of the view it is looked what they see of the finger's flank.

    Returns
    -------
    PlateLight
        With zero variance: there is nothing random in it.
    """
    projection = Projection.of(scene.camera, scene.plate)
    view = projection.ideal_view() if view is None else view
    step = flank_step(scene.camera.scale_px_per_mm * view.focal_px / projection.focal_px) if step is None else step
    seen, bare = np.zeros(view.shape, np.float32), np.ones((), np.float32)
    if state is not None:
        state = lit_contact(scene, state)
        fields = fields_of(scene) if fields is None else fields
        pixel_mm = projection.focal_px / (scene.camera.scale_px_per_mm * view.focal_px)
        patch = patch_light(fields, state, refinement(state.grid.pitch, pixel_mm))
        taken, (x, y) = patch.taken, carried_by(scene, state)
        if x or y:
            # Tables of the flank are of a finger that has not moved, lit by a contact under it.
            cx, cy = state.grid.centre
            scene = carried_finger(scene, state)
            back = replace(state, grid=replace(state.grid, centre=(cx - x, cy - y)))
            taken = patch_light(fields, back, 1).taken
        direct, reflected = _patch_views(scene, state, patch, view, pixel_mm)
        bare = 1.0 - direct(patch.cover, patch.refine)
        seen = reflected(patch.radiance, 1)
        # In place: a finer view's images take longest to allocate.
        seen *= np.float32(fields.ghost)
        seen += flank_image(scene, fields.flank, state, taken, view, step=step)
        seen *= bare
        seen += direct(patch.radiance, 1)
    if scene.surroundings is not None:
        beside = surroundings_view(scene, view, finger=state is not None)
        behind = beside.backdrop
        if state is not None:
            behind = (1.0 - flank_cover(scene, state, view, step=step)) * behind
            behind += surroundings_on_flank(scene, state, view, step)
        seen += bare * (beside.top + behind) + beside.bottom
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
    """Return functions that carry an image of a patch into a view, directly and after one more round trip in the plate.

    Each takes the image and how many times its samples are as large as the refined grid's.
    """
    starts = [state.grid.extent[i] + patch.pitch / 2 for i in (0, 2)]
    # In millimetres of the plate: they stay while a finger moves.
    maps = kept("maps", f"{sight_digest(scene)}{view}", lambda: plate_maps(scene, view_rays(view), (0.0, 0.0), 1.0))

    def onto(maps: Maps) -> Callable[[Image, int], Image]:
        def carry(image: Image, coarser: int) -> Image:
            # The mean over a pixel; beyond the patch there is nothing, and as much is added as the mean reaches.
            kernel = box_kernel(pixel_mm / (patch.pitch * coarser))
            reach = kernel.size // 2
            wide = cv2.copyMakeBorder(image, reach, reach, reach, reach, cv2.BORDER_CONSTANT)
            mean = cv2.sepFilter2D(wide, cv2.CV_32F, kernel, kernel, borderType=cv2.BORDER_CONSTANT)
            # Samples ``coarser`` times as large have their first (coarser - 1)/2 later.
            shift = reach - (coarser - 1) / 2 / coarser
            ratio = np.float32(1 / (patch.pitch * coarser))
            first = [
                np.float32(shift - cells / coarser - start / (patch.pitch * coarser))
                for cells, start in zip((patch.col, patch.row), starts, strict=True)
            ]
            seen = np.zeros(maps[0].shape, np.float32)
            some = [m[::WINDOW_STEP, ::WINDOW_STEP] * ratio + f for m, f in zip(maps, first, strict=True)]
            part = window(some, mean.shape[::-1])
            x, y = (m[part] * ratio + f for m, f in zip(maps, first, strict=True))
            if x.size:
                seen[part] = cv2.remap(mean, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=0)
            return seen

        return carry

    return onto(maps[0]), onto(maps[1])


def window(maps: Sequence[Image], size: tuple[int, int]) -> tuple[slice, slice]:
    """Return the rows and columns of a view outside of which nothing of a picture is seen.

    Parameters
    ----------
    maps : sequence of ndarray of float32
        Column and row on the picture of every :data:`WINDOW_STEP`-th pixel of the view.
    size : tuple of int
        Columns and rows of the picture.
    """
    inside = np.ones(maps[0].shape, bool)
    for m, length in zip(maps, size, strict=True):
        # No pixel is farther on the picture from its nearest sample than neighbours are from each other.
        apart = sum(float(np.abs(np.diff(m, axis=axis)).max(initial=0.0)) for axis in (0, 1)) + 1.0
        inside &= (m > -apart) & (m < length - 1 + apart)
    if not inside.any():
        return slice(0, 0), slice(0, 0)
    rows, cols = (np.flatnonzero(inside.any(axis=axis)) for axis in (1, 0))
    down, across = (slice(max(hit[0] - 1, 0) * WINDOW_STEP, (hit[-1] + 2) * WINDOW_STEP) for hit in (rows, cols))
    return down, across


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


def plate_maps(scene: Scene, rays: tuple[Array, Array], first: tuple[float, float], pitch: float) -> tuple[Maps, Maps]:
    """Return the positions on the refined contact grid that directions (u, v, 1) meet.

    Directly, and after one more round trip between the plate's faces.

    Parameters
    ----------
    scene : Scene
    rays : tuple of ndarray
        u, v.
    first : tuple of float
        Position of the grid's first sample [mm].
    pitch : float
        [mm].
    """
    projection = Projection.of(scene.camera, scene.plate)
    round_trip = 2 * scene.plate.thickness_mm
    u, v = rays
    direct, again = ((np.empty(u.shape, np.float32), np.empty(u.shape, np.float32)) for _ in range(2))
    # In blocks of rows: the intermediate results of a view of millions of rays take half a gigabyte at once.
    for top in range(0, len(u), BLOCK_ROWS):
        some = slice(top, top + BLOCK_ROWS)
        x, y, slope_x, slope_y = plate_rays(projection, u[some], v[some])
        for maps, (px, py) in ((direct, (x, y)), (again, (x + round_trip * slope_x, y + round_trip * slope_y))):
            for own, p, p0 in zip(maps, (px, py), first, strict=True):
                own[some] = (p - p0) / pitch
    return direct, again


def plate_rays(projection: Projection, u: Array, v: Array) -> tuple[Array, Array, Array, Array]:
    """Return where directions (u, v, 1) meet the contact plane [mm], and dx/dz, dy/dz inside the glass.

    Parameters
    ----------
    projection : Projection
    u, v : ndarray
        [1].

    Returns
    -------
    x, y, slope_x, slope_y : ndarray
        Shape of ``u``.
    """
    tan_x, tan_y = projection.tangents(u, v)
    ratio = projection.bend(tan_x, tan_y)
    reach = projection.clearance + projection.thickness * ratio
    return (
        projection.pinhole[0] + reach * tan_x,
        projection.pinhole[1] + reach * tan_y,
        tan_x * ratio,
        tan_y * ratio,
    )
