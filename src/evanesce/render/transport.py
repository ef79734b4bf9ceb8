"""The fast renderer: a frame as fields computed once per rig and cheap operators per contact state.

Guided light is smooth and nearly unchanged by a contact. What a contact sends to the lens is therefore a product of
the guided irradiance of the empty plate (a field, by angle), the interface's transmittance at the local gap (a table)
and the body's response (a table), corrected for what the contact takes away from itself or gives back, directly
through the plate (convolutions on a coarse grid) and over the edges (a small matrix). Beside the contact the lens sees
the finger's flank, lit by the contact's own light and by what escapes near the plate's edges.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import fft

from evanesce.optics.projection import IdealView, Projection
from evanesce.render.fields import (
    FEEDBACK_CELL,
    FLANK_AZIMUTHS,
    FLANK_STATIONS,
    GAP_STEPS,
    MODES,
    Fields,
    edge_light,
    fields_of,
    flank_depths,
    interface_of,
    kept,
    optics_digest,
    profile_of,
)
from evanesce.render.glow import glow_radiance
from evanesce.render.scene import approach, interface_maps
from evanesce.rig import Scene
from evanesce.states import ContactState, PlateGrid, PlateLight

Array = NDArray[Any]
Image = NDArray[np.float32]

__all__ = ["MODES", "edge_light", "fields_of", "interface_of", "patch_radiance", "render_fast"]

ROUNDS = 3
"""Of the feedback; each is some 1 % of the one before."""


@dataclass(frozen=True)
class CoarseGrid:
    """Coarse cells over a contact grid, and all that the feedback needs on them.

    Attributes
    ----------
    shape : tuple of int
        (rows, cols) of cells.
    area : float
        Of a cell [mm^2].
    contact : ndarray (rows, cols)
        Irradiance into silicone in full contact, without feedback [W mm^-2].
    spectrum : ndarray
        Transform of the kernel, gain less loss.
    padded : tuple of int
        Shape of the transforms.
    onto_x, onto_y : ndarray (nodes, cells)
        Linear interpolation between the field's nodes, along x and y.
    """

    shape: tuple[int, int]
    area: float
    contact: Array
    spectrum: NDArray[np.complex128]
    padded: tuple[int, int]
    onto_x: Array
    onto_y: Array


def _hats(nodes: Array, x: Array) -> Array:
    """Return the weights (nodes, points) of linear interpolation between even nodes, ends continued."""
    place = np.clip((x - nodes[0]) / (nodes[1] - nodes[0]), 0, nodes.size - 1)
    return np.asarray(np.clip(1.0 - np.abs(place[None, :] - np.arange(nodes.size)[:, None]), 0.0, None))


def coarse_grid(fields: Fields, grid: PlateGrid) -> CoarseGrid:
    """Return the coarse grid of a contact grid."""
    rows, cols = (max(1, round(n * grid.pitch / FEEDBACK_CELL)) for n in grid.shape)
    x0, x1, y0, y1 = grid.extent
    dx, dy = (x1 - x0) / cols, (y1 - y0) / rows
    x, y = x0 + (np.arange(cols) + 0.5) * dx, y0 + (np.arange(rows) + 0.5) * dy
    onto_x, onto_y = _hats(fields.x, x), _hats(fields.y, y)
    contact = onto_y.T @ np.tensordot(fields.coupling[:, 0], fields.modes, 1) @ onto_x
    padded = (fft.next_fast_len(2 * rows, real=True), fft.next_fast_len(2 * cols, real=True))
    kernel = fields.rig.gain - fields.rig.loss
    middle = kernel.shape[0] // 2
    reach_y, reach_x = min(rows - 1, middle), min(cols - 1, middle)
    around = np.zeros(padded)
    iy, ix = np.arange(-reach_y, reach_y + 1), np.arange(-reach_x, reach_x + 1)
    around[iy[:, None] % padded[0], ix[None, :] % padded[1]] = kernel[middle + iy[:, None], middle + ix[None, :]]
    return CoarseGrid((rows, cols), dx * dy, contact, fft.rfft2(around), padded, onto_x, onto_y)


def feedback(fields: Fields, coarse: CoarseGrid, entering: Array) -> tuple[Array, Array]:
    """Return what the contact does to its own light.

    Parameters
    ----------
    fields : Fields
    coarse : CoarseGrid
    entering : ndarray (rows, cols)
        Irradiance that enters the silicone, mean of each cell, without feedback [W mm^-2].

    Returns
    -------
    change : ndarray (rows, cols)
        Of the irradiance, relative [1].
    taken : ndarray (points,)
        Power that the contact takes in, shared among the field's nodes [W].
    """
    rows, cols = coarse.shape
    level = np.maximum(coarse.contact, 1e-300)
    change, taken = np.zeros_like(entering), np.zeros(0)
    for _ in range(ROUNDS):
        inside = entering * (1.0 + change)
        # The loss is relative to the field at the second place; the field is nearly even, and the first serves, too.
        net = coarse.spectrum * fft.rfft2(inside, coarse.padded)
        taken = (coarse.onto_y @ inside @ coarse.onto_x.T).ravel() * coarse.area
        edges = (fields.rig.edges @ taken).reshape(fields.y.size, fields.x.size)
        returned = fft.irfft2(net, coarse.padded)[:rows, :cols] + coarse.onto_y.T @ edges @ coarse.onto_x
        change = returned / level
    return change, taken


def field_images(fields: Fields, x: Array, y: Array) -> Image:
    """Return the field's modes at plate points x, y [mm] (rows, cols), cubic between the nodes: (MODES, rows, cols)."""
    map_x = ((x - fields.x[0]) / (fields.x[1] - fields.x[0])).astype(np.float32)
    map_y = ((y - fields.y[0]) / (fields.y[1] - fields.y[0])).astype(np.float32)
    found = [
        cv2.remap(m.astype(np.float32), map_x, map_y, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
        for m in fields.modes
    ]
    return np.stack(found)


def table_place(gap: Image, end: float) -> tuple[NDArray[np.int32], Image]:
    """Return each gap's node below in the tables, and the part beyond it; all wide gaps are at the last node."""
    # The gap between rough asperities is set just below the end; it is open.
    wide = gap >= np.float32(0.998 * end)
    index = np.where(wide, GAP_STEPS - 1, np.sqrt(np.minimum(gap / np.float32(end), 1)) * np.float32(GAP_STEPS - 1))
    low = np.minimum(index.astype(np.int32), GAP_STEPS - 2)
    return low, np.asarray(index - low, np.float32)


@dataclass(frozen=True)
class PatchLight:
    """What a contact shows on a refined contact grid.

    Attributes
    ----------
    radiance : ndarray (rows, cols)
        Towards the lens, of silicone at the glass [W mm^-2 sr^-1].
    cover : ndarray (rows, cols)
        Share where silicone at the glass hides the finger's flank [1].
    taken : ndarray (points,)
        Power that the contact takes in, shared among the field's nodes [W].
    pitch : float
        [mm].
    """

    radiance: Image
    cover: Image
    taken: Array
    pitch: float


def patch_light(fields: Fields, state: ContactState, refine: int = 2) -> PatchLight:
    """Return the light of a contact on its grid, ``refine`` times as fine.

    Gap and share in contact are those of the path tracer's textures, interpolated bilinearly as it does.
    """
    grid = state.grid
    rows, cols = grid.shape
    end = float(fields.gaps[-1])
    size = (cols * refine, rows * refine)
    gap, share = (cv2.resize(m, size, interpolation=cv2.INTER_LINEAR) for m in interface_maps(state, end))
    pitch = grid.pitch / refine
    x = grid.centre[0] + (np.arange(size[0]) - (size[0] - 1) / 2) * pitch
    y = grid.centre[1] + (np.arange(size[1]) - (size[1] - 1) / 2) * pitch
    low, part = table_place(gap, end)

    def mixed(table: Array) -> Image:
        table32 = table.astype(np.float32)
        return np.asarray(share * table32[0] + (1 - share) * (table32[low] * (1 - part) + table32[low + 1] * part))

    images = field_images(fields, *np.meshgrid(x, y))
    irradiance = np.zeros_like(gap)
    for image, table in zip(images, fields.coupling, strict=True):
        irradiance += image * mixed(table)
    coarse = coarse_grid(fields, grid)
    entering = cv2.resize(irradiance, coarse.shape[::-1], interpolation=cv2.INTER_AREA).astype(float)
    change, taken = feedback(fields, coarse, entering)
    rise = cv2.resize(1.0 + change.astype(np.float32), size, interpolation=cv2.INTER_LINEAR)
    cover = np.where(gap < np.float32(end), np.float32(1.0), share)
    if fields.glow is not None:
        return PatchLight(glow_radiance(fields.glow, irradiance * rise, share, low, part, pitch), cover, taken, pitch)
    radiance = np.zeros_like(gap)
    for image, table in zip(images, fields.coupling * fields.response, strict=True):
        radiance += image * mixed(table)
    return PatchLight(radiance * rise, cover, taken, pitch)


def patch_radiance(fields: Fields, state: ContactState, refine: int = 2) -> tuple[Image, float]:
    """Return radiance and pitch of :func:`patch_light`."""
    found = patch_light(fields, state, refine)
    return found.radiance, found.pitch


def render_fast(
    scene: Scene, state: ContactState | None, *, seed: int = 0, view: IdealView | None = None
) -> PlateLight:
    """Render a contact state by transport; interchangeable with :func:`evanesce.render.path.render`.

    Parameters
    ----------
    scene : Scene
    state : ContactState or None
        None leaves the plate empty, and dark.
    seed : int
        Not used: nothing here is random. Taken so that both renderers are called alike.
    view : IdealView, optional
        Pinhole grid; the one that covers the frame by default.

    Returns
    -------
    PlateLight
        With zero variance: there is nothing random in it.
    """
    projection = Projection.of(scene.camera, scene.plate)
    view = projection.ideal_view() if view is None else view
    seen = np.zeros(view.shape, np.float32)
    if state is not None:
        fields = fields_of(scene)
        patch = patch_light(fields, state)
        scale = scene.camera.scale_px_per_mm * view.focal_px / projection.focal_px
        footprint = max(1, round(1.0 / (scale * patch.pitch)))
        x0, y0 = (state.grid.extent[i] + patch.pitch / 2 for i in (0, 2))
        key = f"maps{optics_digest(scene)}{view}{x0:.9g} {y0:.9g} {patch.pitch:.9g}"
        direct, turned = kept(key, lambda: plate_maps(scene, view_rays(view), (x0, y0), patch.pitch, footprint))

        def on_view(image: Image, maps: Maps) -> Image:
            mean = cv2.blur(image, (footprint, footprint), borderType=cv2.BORDER_CONSTANT)
            found = cv2.remap(mean, *maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=0)
            return np.asarray(found, np.float32)

        bare = 1.0 - on_view(patch.cover, direct)
        flank = flank_image(scene, fields, state, patch.taken, view)
        seen = on_view(patch.radiance, direct)
        seen += bare * (np.float32(fields.ghost) * on_view(patch.radiance, turned) + flank)
    return PlateLight(
        radiance=seen,
        variance=np.zeros_like(seen),
        focal_px=view.focal_px,
        principal_point=view.principal_point,
        samples=0,
    )


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


def plate_maps(
    scene: Scene, rays: tuple[Array, Array], first: tuple[float, float], pitch: float, footprint: int
) -> tuple[Maps, Maps]:
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
    footprint : int
        Samples that the box filter before takes together: an even one of OpenCV is half a sample off.
    """
    projection = Projection.of(scene.camera, scene.plate)
    x, y, slope_x, slope_y = plate_rays(projection, *rays)
    turn = 2 * scene.plate.thickness_mm
    found: list[Any] = []
    for px, py in ((x, y), (x + turn * slope_x, y + turn * slope_y)):
        places = (
            (p - p0) / pitch + (0.5 if footprint % 2 == 0 else 0.0) for p, p0 in zip((px, py), first, strict=True)
        )
        found.append(tuple(place.astype(np.float32) for place in places))
    return found[0], found[1]


def plate_rays(projection: Projection, u: Array, v: Array) -> tuple[Array, Array, Array, Array]:
    """Return where directions (u, v, 1) meet the contact plane [mm], and dx/dz, dy/dz inside the glass."""
    x, y = projection.ray_to_plate(u, v)
    d = u[..., None] * projection.axes[:, 0] + v[..., None] * projection.axes[:, 1] + projection.axes[:, 2]
    tan_x, tan_y = d[..., 0] / d[..., 2], d[..., 1] / d[..., 2]
    tan2 = tan_x**2 + tan_y**2
    ratio = 1.0 / np.sqrt(projection.refractive_index**2 * (1 + tan2) - tan2)
    return x, y, tan_x * ratio, tan_y * ratio


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
    depth = flank_depth(scene, state)
    key = f"flank{optics_digest(scene)}{view}{step}{depth:.1f}"
    column, row, seen = kept(key, lambda: flank_place(scene, *view_rays(view, step), depth))
    coarse = cv2.remap(flank_lit(scene, fields, taken, depth), column, row, cv2.INTER_LINEAR) * seen
    return enlarged(np.asarray(coarse, np.float32), step, view.shape)


def enlarged(coarse: Image, step: int, shape: tuple[int, int]) -> Image:
    """Return an image sampled at pixels 0, step, 2 step, ... at all pixels."""
    onto = np.array([[step, 0, 0], [0, step, 0]], np.float32)
    return np.asarray(cv2.warpAffine(coarse, onto, shape[::-1], flags=cv2.INTER_LINEAR), np.float32)


def flank_depth(scene: Scene, state: ContactState) -> float:
    """Return a state's approach for the flank's tables [mm]: a tenth changes nothing that can be seen."""
    depths = flank_depths(scene)
    return round(float(np.clip(approach(state, scene.finger), depths[0], depths[-1])), 1)


def flank_lit(scene: Scene, fields: Fields, taken: Array, depth: float) -> Image:
    """Return the radiance of the flank towards the lens by station and azimuth, the first azimuth twice."""
    depths = flank_depths(scene)
    between = np.array([np.interp(depth, depths, row) for row in np.eye(depths.size)])
    lit = np.tensordot(between, fields.flank_lit, 1) + np.tensordot(between, fields.rig.flank_contact, 1) @ taken
    lit = lit * fields.open_response
    return np.concatenate([lit, lit[:, :1]], axis=1).astype(np.float32)


def flank_place(scene: Scene, u: Array, v: Array, depth: float) -> tuple[Image, Image, Image]:
    """Return column and row in the flank's table that directions (u, v, 1) see, and 1 where they see the flank."""
    projection = Projection.of(scene.camera, scene.plate)
    x, y, slope_x, slope_y = plate_rays(projection, u, v)
    # Out of the glass: slope in the air from that in the glass.
    n = projection.refractive_index
    inside = slope_x**2 + slope_y**2
    leave = n / np.sqrt(np.maximum(1 + inside - n * n * inside, 1e-6))
    station, azimuth = profile_of(scene).meet(x, y, slope_x * leave, slope_y * leave, depth)
    seen = np.isfinite(station)
    station, azimuth = np.where(seen, station, 0.0), np.where(seen, azimuth, 0.0)
    row = np.interp(station, FLANK_STATIONS, np.arange(FLANK_STATIONS.size))
    column = np.mod(azimuth, 2 * np.pi) * (FLANK_AZIMUTHS / (2 * np.pi))
    return column.astype(np.float32), row.astype(np.float32), seen.astype(np.float32)
