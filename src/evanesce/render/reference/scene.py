"""The rig as a Mitsuba scene: plate, LEDs on its edges, frustrated patch, finger, pinhole camera. Lengths in mm."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import maximum_filter

from evanesce.core.states import ContactState
from evanesce.optics.led import emitter_radiance, led_positions
from evanesce.optics.liquid import lit_contact
from evanesce.optics.projection import IdealView, Projection
from evanesce.render.reference.bsdf import InterfaceOptics, blended_bsdf, frustrated_bsdf
from evanesce.render.reference.edge import edge_bsdf
from evanesce.render.reference.haze import face_share, hazy
from evanesce.rig import Finger, Scene

if TYPE_CHECKING:
    import trimesh

Array = NDArray[np.float64]
EDGES = ("left", "right", "top", "bottom")
# The finger's mesh stays this far above the glass; nearer silicone belongs to the interface. Mitsuba moves the start
# of a ray off its surface by about 1e-4 (1 + |p|): 1 um at 10 mm.
FINGER_CLEARANCE = 0.02
FINGER_SEGMENTS = 96


@dataclass(frozen=True)
class Window:
    """Rectangle of a view's pixels: rows row0 to row1, columns col0 to col1, ends excluded."""

    row0: int
    row1: int
    col0: int
    col1: int

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, cols)."""
        return self.row1 - self.row0, self.col1 - self.col0


def interface_optics(scene: Scene) -> InterfaceOptics:
    """Return the constants of the scene's interface.

    Parameters
    ----------
    scene : Scene
    """
    return InterfaceOptics(
        scene.plate.refractive_index,
        scene.finger.refractive_index,
        scene.finger.diffuse_reflectance,
        scene.camera.wavelength_nm,
    )


def interface_maps(state: ContactState, near_gap: float) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return the textures of the interface: gap of what is not in contact [mm], and share in contact.

    In a cell partly in contact the state's gap is that of its centre, maybe 0; the part not in contact gets the
    largest gap of the neighbourhood, so that contact is counted once, by its share.

    Parameters
    ----------
    state : ContactState
    near_gap : float
        Gap from which on glass and silicone are separate bodies [mm].

    Returns
    -------
    gap, share : ndarray of float32 (rows, cols)
    """
    share = np.clip(np.asarray(state.contact_mask, float), 0.0, 1.0)
    gap = np.clip(np.nan_to_num(np.asarray(state.gap, float), posinf=np.inf), 0.0, 4 * near_gap)
    gap = np.where(share > 0, maximum_filter(gap, 3, mode="nearest"), gap)
    if state.real_contact_fraction is not None:
        # Between the asperities the film is micrometres thick: out of reach of the evanescent wave.
        fraction = np.clip(np.asarray(state.real_contact_fraction, float), 0.0, 1.0)
        gap = np.where((share > 0) & (fraction < 1), np.maximum(gap, 0.999 * near_gap), gap)
        share = share * fraction
    return gap.astype(np.float32), share.astype(np.float32)


def _bitmap(data: NDArray[np.float32]) -> dict[str, Any]:
    import mitsuba as mi

    tensor = np.ascontiguousarray(data[:, :, None])
    return {"type": "bitmap", "bitmap": mi.Bitmap(tensor), "raw": True, "filter_type": "bilinear", "wrap_mode": "clamp"}


def make_mesh(name: str, vertices: Any, faces: Any, bsdf: Any, uv: Any = None, **children: Any) -> Any:
    """Return a mitsuba.Mesh; ``children`` are further plugins (emitter, media) as dictionaries or objects."""
    import mitsuba as mi

    props = mi.Properties()
    for key, child in {"bsdf": bsdf, **children}.items():
        if child is not None:
            props[key] = mi.load_dict(child) if isinstance(child, dict) else child
    vertices, faces = np.asarray(vertices, np.float32), np.asarray(faces, np.uint32)
    mesh = mi.Mesh(name, len(vertices), len(faces), props, False, uv is not None)
    params = mi.traverse(mesh)
    params["vertex_positions"] = vertices.ravel()
    params["faces"] = faces.ravel()
    if uv is not None:
        params["vertex_texcoords"] = np.asarray(uv, np.float32).ravel()
    params.update()
    return mesh


def quads_of(corners: Array) -> tuple[Array, NDArray[np.int64]]:
    """Return vertices and faces of quads given as (n, 4, 3) corners, counter-clockwise seen from the normal's side."""
    start = 4 * np.arange(len(corners))[:, None]
    faces = np.concatenate([start + np.array(corner) for corner in ((0, 1, 2), (0, 2, 3))])
    return corners.reshape(-1, 3), faces


def _horizontal(rectangles: list[tuple[float, float, float, float]], z: float, up: bool) -> Array:
    """Return quads (x0, x1, y0, y1) at height z, normal +z or -z."""
    quads = np.array([[(x0, y0, z), (x1, y0, z), (x1, y1, z), (x0, y1, z)] for x0, x1, y0, y1 in rectangles])
    return quads if up else quads[:, ::-1]


def on_edge(edge: str, half: tuple[float, float], spans: list[tuple[float, float, float, float]]) -> Array:
    """Return quads (along0, along1, z0, z1) on an edge face of the plate, normal into the glass."""
    hx, hy = half
    quads = []
    for a0, a1, z0, z1 in spans:
        corners_2d = [(a0, z0), (a1, z0), (a1, z1), (a0, z1)]
        if edge in ("left", "right"):
            quads.append([(-hx if edge == "left" else hx, a, z) for a, z in corners_2d])
        else:
            quads.append([(a, -hy if edge == "top" else hy, z) for a, z in corners_2d])
    corners = np.array(quads).reshape(-1, 4, 3)
    # (along, z) turns counter-clockwise about +x for y-z and about -y for x-z.
    return corners if edge in ("left", "bottom") else corners[:, ::-1]


def edge_spans(
    length: float, thickness: float, centres: Array, width: float, height: float
) -> tuple[list[tuple[float, float, float, float]], list[tuple[float, float, float, float]]]:
    """Tile an edge face exactly: rectangles (along0, along1, z0, z1) [mm] of the LEDs, and of what is between."""
    z0, z1 = -thickness / 2 - height / 2, -thickness / 2 + height / 2
    lit = [(float(c) - width / 2, float(c) + width / 2, z0, z1) for c in np.sort(centres)]
    dark = []
    ends = [-length / 2, *(a for span in lit for a in span[:2]), length / 2]
    for start, stop in zip(ends[0::2], ends[1::2], strict=True):
        if stop - start > 1e-9:
            dark.append((start, stop, -thickness, 0.0))
    if height < thickness - 1e-9:
        for a0, a1, _, _ in lit:
            dark += [(a0, a1, -thickness, z0), (a0, a1, z1, 0.0)]
    return lit, dark


def finger_mesh(finger: Finger, depth: float) -> trimesh.Trimesh:
    """Return the finger, tip down, pressed by ``depth`` [mm] against z = 0 and flattened there.

    A hemisphere on a cylinder (a cap where the tip's radius exceeds the cylinder's), without ridges: those are in the
    interface's gap.
    """
    import trimesh  # a third of a second that those who trace no path need not wait

    radius, half = finger.tip_radius_mm, min(finger.diameter_mm / 2, finger.tip_radius_mm)
    polar = np.arcsin(half / radius)
    angles = polar * np.linspace(0.0, 1.0, FINGER_SEGMENTS // 2 + 1)
    profile = [(radius * np.sin(a), radius * (1 - np.cos(a))) for a in angles]
    profile[0] = (0.0, 0.0)
    if finger.length_mm > profile[-1][1]:
        profile.append((half, finger.length_mm))
    profile.append((0.0, profile[-1][1]))
    mesh = trimesh.creation.revolve(np.array(profile), sections=FINGER_SEGMENTS)
    vertices = mesh.vertices + np.array([*finger.position_mm, -depth])
    vertices[:, 2] = np.maximum(vertices[:, 2], FINGER_CLEARANCE)
    return trimesh.Trimesh(vertices, mesh.faces, process=False)


def approach(state: ContactState, finger: Finger) -> float:
    """Return the state's depth, or that of a sphere cut at the contact area where the law has none [mm].

    Parameters
    ----------
    state : ContactState
    finger : Finger
    """
    if np.isfinite(state.depth):
        return float(state.depth)
    return state.nominal_contact_area / (np.pi * finger.tip_radius_mm)


class _Plate:
    """The plate's shapes, with or without the glass as a medium."""

    def __init__(self, scene: Scene, medium: Any) -> None:
        self.half = (scene.plate.size_mm[0] / 2, scene.plate.size_mm[1] / 2)
        self.scene, self.medium = scene, medium
        self.glass = {"type": "dielectric", "int_ior": scene.plate.refractive_index, "ext_ior": 1.0}

    def faces(self, hole: tuple[float, float, float, float] | None) -> dict[str, Any]:
        """Return bottom and top face; the top one leaves ``hole`` (x0, x1, y0, y1) open."""
        hx, hy = self.half
        whole = (-hx, hx, -hy, hy)
        top = [whole]
        if hole is not None:
            x0, x1, y0, y1 = hole
            frame = [(-hx, x0, -hy, hy), (x1, hx, -hy, hy), (x0, x1, -hy, y0), (x0, x1, y1, hy)]
            top = [r for r in frame if r[1] - r[0] > 1e-9 and r[3] - r[2] > 1e-9]
        shapes = {"bottom": _horizontal([whole], -self.scene.plate.thickness_mm, up=False)}
        if top:
            shapes["top"] = _horizontal(top, 0.0, up=True)
        glass = {k: hazy(self.scene, k, self.glass, glass_front=False, contact=None) for k in shapes}
        return {k: make_mesh(k, *quads_of(q), glass[k], interior=self.medium) for k, q in shapes.items()}

    def edges(
        self, powers: Mapping[str, ArrayLike], groups: Mapping[str, ArrayLike]
    ) -> tuple[dict[str, Any], dict[str, int]]:
        """Return the edge faces: LEDs with their radiant powers [W] (in ascending position), and the rest.

        The LEDs' own faces scatter like the ground part of the edge around them. Returned as well: the group's number
        of each shape that emits.
        """
        leds, plate = self.scene.leds, self.scene.plate
        ground = {"type": "diffuse", "reflectance": {"type": "uniform", "value": plate.edge_reflectance}}
        positions = led_positions(plate, leds)
        shapes, numbers, rest, unlit = {}, {}, [], []
        for edge in EDGES:
            length = plate.size_mm[1] if edge in ("left", "right") else plate.size_mm[0]
            lit, dark = edge_spans(
                length,
                plate.thickness_mm,
                positions.get(edge, np.zeros(0)),
                leds.emitting_width_mm,
                leds.emitting_height_mm,
            )
            rest.append(on_edge(edge, self.half, dark))
            power = np.broadcast_to(np.asarray(powers.get(edge, 0.0), float), (len(lit),))
            group = np.broadcast_to(np.asarray(groups.get(edge, 0)), (len(lit),))
            faces = on_edge(edge, self.half, lit)
            unlit.append(faces[power <= 0])
            for number in np.unique(group):
                for k, level in enumerate(np.unique(power[power > 0])):
                    same = faces[(power == level) & (group == number)]
                    if not len(same):
                        continue
                    radiance = {"type": "uniform", "value": emitter_radiance(leds, float(level))}
                    emitter = {"type": "area", "radiance": radiance}
                    name = f"leds_{edge}_{number}_{k}"
                    shapes[name] = make_mesh(name, *quads_of(same), ground, emitter=emitter, exterior=self.medium)
                    numbers[name] = int(number)
        finish: Any = ground
        if plate.edge_polish > 0:
            finish = edge_bsdf(plate.edge_reflectance, plate.edge_polish, plate.refractive_index)
        for name, quads, bsdf in (("edges", rest, finish), ("leds_off", unlit, ground)):
            bare = np.concatenate(quads)
            if len(bare):
                shapes[name] = make_mesh(name, *quads_of(bare), bsdf, exterior=self.medium)
        return shapes, numbers


def camera_dict(projection: Projection, view: IdealView, window: Window | None = None) -> dict[str, Any]:
    """Return the pinhole of an ideal view as a Mitsuba sensor (box filter, grey film), cropped to a window."""
    import mitsuba as mi

    rows, cols = view.shape
    px, py = view.principal_point
    # Mitsuba's camera has x to the left and y up; OpenCV's, which the projection uses, x to the right and y down.
    to_world = np.eye(4)
    to_world[:3, :3] = projection.axes * [-1.0, -1.0, 1.0]
    to_world[:3, 3] = projection.pinhole
    film: dict[str, Any] = {
        "type": "hdrfilm",
        "width": cols,
        "height": rows,
        "pixel_format": "luminance",
        "component_format": "float32",
        "rfilter": {"type": "box"},
    }
    if window is not None:
        film |= {
            "crop_offset_x": window.col0,
            "crop_offset_y": window.row0,
            "crop_width": window.shape[1],
            "crop_height": window.shape[0],
        }
    return {
        "type": "perspective",
        "fov": float(np.rad2deg(2 * np.arctan(cols / 2 / view.focal_px))),
        "fov_axis": "x",
        "principal_point_offset_x": 0.5 - (px + 0.5) / cols,
        "principal_point_offset_y": 0.5 - (py + 0.5) / rows,
        "near_clip": 1e-3,
        "far_clip": 1e5,
        "to_world": mi.ScalarTransform4f(to_world.tolist()),
        "film": film,
        "sampler": {"type": "independent"},
    }


@dataclass(frozen=True)
class Patch:
    """The frustrated part of the top face.

    Attributes
    ----------
    extent : tuple of float
        (x0, x1, y0, y1) on the plate [mm].
    reflectance : callable
        ``reflectance(x, y, cos_theta, active)`` for light from the glass (llvm and cuda only).
    """

    extent: tuple[float, float, float, float]
    reflectance: Callable[[Any, Any, Any, Any], Any] | None = None


@dataclass(frozen=True)
class PlateModel:
    """Shapes for ``mitsuba.load_dict`` (the sensor is not among them), the patch among them, groups of the emitters."""

    shapes: dict[str, Any]
    patch: Patch | None
    group_of: dict[str, int]


def _patch(scene: Scene, state: ContactState, jit: bool, medium: Any) -> tuple[Any, Patch]:
    """Return the mesh of the frustrated patch, the contact grid cut to the plate, and its description."""
    optics = interface_optics(scene)
    gap, share = interface_maps(lit_contact(scene, state), optics.near_gap)
    # Plain floats: numpy's scalars would swallow Dr.Jit's arrays in arithmetic.
    extent = tuple(float(v) for v in state.grid.extent)
    hx, hy = scene.plate.size_mm[0] / 2, scene.plate.size_mm[1] / 2
    x0, x1, y0, y1 = max(extent[0], -hx), min(extent[1], hx), max(extent[2], -hy), min(extent[3], hy)
    reflectance = None
    if jit:
        import mitsuba as mi

        touching = mi.load_dict(_bitmap(share))
        clean = frustrated_bsdf(mi.load_dict(_bitmap(gap)), touching, optics)
        haze = face_share(scene, "top")
        bsdf = hazy(scene, "top", clean, glass_front=True, contact=touching.eval_1)

        def reflectance(x: Any, y: Any, cos_theta: Any, active: Any) -> Any:
            u, v = (x - extent[0]) / (extent[1] - extent[0]), (y - extent[2]) / (extent[3] - extent[2])
            return clean.reflectance(u, v, cos_theta, active, haze)

    else:
        bsdf = blended_bsdf(_bitmap(optics.coupling(share, gap).astype(np.float32)), optics)
    vertices, faces = quads_of(_horizontal([(x0, x1, y0, y1)], 0.0, up=False))
    u = (vertices[:, 0] - extent[0]) / (extent[1] - extent[0])
    v = (vertices[:, 1] - extent[2]) / (extent[3] - extent[2])
    mesh = make_mesh("patch", vertices, faces, bsdf, uv=np.stack([u, v], axis=1), exterior=medium)
    return mesh, Patch((x0, x1, y0, y1), reflectance)


def plate_scene(
    scene: Scene,
    state: ContactState | None,
    powers: Mapping[str, ArrayLike],
    jit: bool,
    groups: Mapping[str, ArrayLike] | None = None,
) -> PlateModel:
    """Return the rig as shapes.

    Parameters
    ----------
    scene : Scene
    state : ContactState or None
        None: the finger is lifted out of sight.
    powers : mapping
        Radiant power [W] by edge, of each LED there or of every one; edges left out are dark.
    jit : bool
        Whether the current variant is llvm or cuda: frustrated interface, absorption in the integrator. Otherwise
        built-in plugins only, absorption as a medium.
    groups : mapping, optional
        Number of the group that LEDs belong to, by edge, of each LED there or of every one; 0 if not given.
    """
    import mitsuba as mi

    absorption = scene.plate.absorption_coefficient_per_mm
    medium = None
    if absorption > 0 and not jit:
        medium = mi.load_dict({"type": "homogeneous", "albedo": 0.0, "sigma_t": absorption})
    plate = _Plate(scene, medium)
    shapes: dict[str, Any] = {"type": "scene"}
    patch = None
    if state is not None:
        shapes["patch"], patch = _patch(scene, state, jit, medium)
        mesh = finger_mesh(scene.finger, approach(state, scene.finger))
        body = {"type": "diffuse", "reflectance": {"type": "uniform", "value": scene.finger.diffuse_reflectance}}
        shapes["finger"] = make_mesh("finger", mesh.vertices, mesh.faces, {"type": "twosided", "bsdf": body})
    edges, group_of = plate.edges(powers, groups or {})
    shapes |= plate.faces(patch.extent if patch else None) | edges
    return PlateModel(shapes, patch, group_of)


def card_mesh(
    name: str,
    tiles: list[tuple[float, float, float, float]],
    to_plate: Callable[[Array], Array],
    reflectance: float,
) -> Any:
    """Return tiles (x0, x1, y0, y1) of a card as one diffuse mesh that faces down; ``to_plate`` transforms points."""
    flat = _horizontal(tiles, 0.0, up=False)
    placed = to_plate(flat.reshape(-1, 3)[:, :2]).reshape(flat.shape)
    bsdf = {"type": "diffuse", "reflectance": {"type": "uniform", "value": reflectance}}
    return make_mesh(name, *quads_of(placed), {"type": "twosided", "bsdf": bsdf})
