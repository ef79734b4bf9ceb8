"""What the fast renderer computes once per rig, and keeps on disk: fields per LED, kernels, light on the flank."""

from __future__ import annotations

import contextlib
import math
import os
import tempfile
import zipfile
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import platformdirs
from numpy.typing import NDArray

from evanesce.optics.flank import EPSILON, Profile, contact_on_flank, flank_irradiance, mirrored_exchange
from evanesce.optics.guided_field import EdgeLight, stacked_radiances
from evanesce.optics.interface import frustrated_transmittance
from evanesce.optics.led import led_positions, led_radiances
from evanesce.optics.patch_light import (
    Interface,
    feedback,
    returned_radiance,
    window_transmittance,
)
from evanesce.optics.plate_field import AngleBins, UnitFields, unit_fields
from evanesce.optics.projection import Projection
from evanesce.provenance import digest
from evanesce.render.bsdf import NEAR_WAVELENGTHS
from evanesce.render.glow import Glow, make_glow
from evanesce.rig import Scene

Array = NDArray[np.float64]
T = TypeVar("T")

FORMAT = 4
"""Of the cached files; a change of any formula here or in ``optics`` counts it up."""

MODES = 3
"""Spatial modes of the guided field's angular shape; the fourth is below 1e-4 of the first on any rig tried."""

GAP_STEPS = 2048
FIELD_SPACING = 1.5
"""Spacing of the field's nodes [mm]."""

FEEDBACK_CELL = 0.25
"""Cell of the feedback's coarse grid [mm]."""

FLANK_DEPTHS = 5
FLANK_STATIONS = np.array(
    [-1, -0.5, -EPSILON, 0, 0.02, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1, 1.25, 1.6, 2]
)
FLANK_AZIMUTHS = 16


@dataclass(frozen=True)
class RigFields:
    """What depends on plate, LEDs' places and finger, but on no LED's power.

    Attributes
    ----------
    led : ndarray (leds, points, bins)
        Irradiance at the nodes by bin of angle per radiance of each LED, diffuse edges included [sr].
    edges : ndarray (points, points)
        Irradiance into silicone at each node that the edges return, per power that a contact at another takes in
        [1/mm^2]; negative where the contact keeps more from the edges than it sends there.
    loss, gain : ndarray (kernel, kernel)
        See :class:`evanesce.optics.patch_light.Feedback`, summed over a cell of the coarse grid [1].
    flank : ndarray (leds, depths, stations, azimuths)
        Irradiance on the finger's flank per radiance of each LED [sr].
    flank_contact : ndarray (depths, stations, azimuths, points)
        The same per power that a contact at each node takes in [1/mm^2].
    """

    led: Array
    edges: Array
    loss: Array
    gain: Array
    flank: Array
    flank_contact: Array


@dataclass(frozen=True)
class Fields:
    """What a frame needs: the rig's fields for the powers of its LEDs, and tables by gap for its camera's place.

    Attributes
    ----------
    x, y : ndarray
        Nodes of the field on the plate [mm].
    modes : ndarray (MODES, y, x)
        Spatial modes of the guided irradiance [W mm^-2].
    gaps : ndarray (GAP_STEPS,)
        Gaps of the tables, evenly spaced in the square root [mm].
    coupling : ndarray (MODES, GAP_STEPS)
        Irradiance inside the silicone per mode [1].
    response : ndarray (GAP_STEPS,)
        Radiance in air towards the lens per irradiance inside the silicone [1/sr].
    open_response : float
        The same per irradiance on the flank behind open glass [1/sr].
    ghost : float
        Share of radiance that reaches the lens after one more turn between the faces where the glass is open [1].
    flank_lit : ndarray (depths, stations, azimuths)
        Irradiance on the flank by light from beside the finger [W mm^-2].
    rig : RigFields
    glow : Glow or None
        Lateral spread inside the silicone; None where light leaves where it entered.
    """

    x: Array
    y: Array
    modes: Array
    gaps: Array
    coupling: Array
    response: Array
    open_response: float
    ghost: float
    flank_lit: Array
    rig: RigFields
    glow: Glow | None = None


def edge_light(scene: Scene) -> EdgeLight:
    """Return the plate of a scene as a light guide with its LEDs at their powers."""
    return EdgeLight(
        size=scene.plate.size_mm,
        thickness=scene.plate.thickness_mm,
        refractive_index=scene.plate.refractive_index,
        absorption_coefficient=scene.plate.absorption_coefficient_per_mm,
        edge_reflectance=scene.plate.edge_reflectance,
        positions=led_positions(scene.plate, scene.leds),
        radiances=led_radiances(scene.plate, scene.leds),
        emitter_size=(scene.leds.emitting_width_mm, scene.leds.emitting_height_mm),
        edge_polish=scene.plate.edge_polish,
        air_gap_share=scene.leds.air_gap_share,
    )


def interface_of(scene: Scene) -> Interface:
    """Return the interface of a scene's plate and finger."""
    return Interface(
        n_glass=scene.plate.refractive_index,
        n_silicone=scene.finger.refractive_index,
        body_reflectance=scene.finger.diffuse_reflectance,
        wavelength=scene.camera.wavelength_nm,
    )


def profile_of(scene: Scene) -> Profile:
    """Return the finger's outer shape."""
    finger = scene.finger
    half = min(finger.diameter_mm / 2, finger.tip_radius_mm)
    return Profile(finger.position_mm, finger.tip_radius_mm, half, finger.length_mm)


def flank_depths(scene: Scene) -> Array:
    """Return the approaches [mm] at which the flank's light is tabulated."""
    return np.asarray(np.linspace(0.0, 0.4 * scene.finger.tip_radius_mm, FLANK_DEPTHS))


def node_axes(scene: Scene) -> tuple[Array, Array]:
    """Nodes over the contact grid, kept off the edges."""
    half = scene.grid.size_mm / 2
    axes = []
    for centre, size in zip(scene.finger.position_mm, scene.plate.size_mm, strict=True):
        low, high = max(centre - half, -size / 2 + 0.5), min(centre + half, size / 2 - 0.5)
        axes.append(np.linspace(low, high, max(4, math.ceil((high - low) / FIELD_SPACING) + 1)))
    return axes[0], axes[1]


def _nodes(scene: Scene) -> Array:
    return np.stack(np.meshgrid(*node_axes(scene)), axis=-1).reshape(-1, 2)


def compute_rig_fields(scene: Scene) -> RigFields:
    """Compute the fields of a rig: some ten seconds."""
    light, interface = edge_light(scene), interface_of(scene)
    bins = AngleBins.of(interface.n_glass, interface.n_silicone)
    nodes = _nodes(scene)
    unit = unit_fields(light, nodes, bins)
    edge_radiances = unit.response @ unit.edge_from_led
    led = unit.led + np.einsum("sl,spb->lpb", edge_radiances, unit.edge)
    angular = led.sum(axis=(0, 1)) / np.diff(bins.borders)
    kernels = _kernels(scene, interface, bins.centres, angular)
    depths = flank_depths(scene)
    mesh = np.meshgrid(depths, FLANK_STATIONS, np.arange(FLANK_AZIMUTHS) * 2 * np.pi / FLANK_AZIMUTHS, indexing="ij")
    points, normals = profile_of(scene).surface(mesh[1], mesh[2], mesh[0])
    flank_led, flank_edge = flank_irradiance(light, points.reshape(-1, 3), normals.reshape(-1, 3))
    flank = (flank_led + edge_radiances.T @ flank_edge).reshape(-1, *mesh[0].shape)
    flank_contact = contact_on_flank(
        points.reshape(-1, 3), normals.reshape(-1, 3), nodes, light.thickness, interface, light.absorption_coefficient
    ).reshape(*mesh[0].shape, -1)
    for k in range(depths.size):
        own = mirrored_exchange(points[k], normals[k], interface.body_reflectance, interface.n_glass)
        flank[:, k] = (flank[:, k].reshape(len(flank), -1) @ own.T).reshape(flank[:, k].shape)
        flank_contact[k] = (own @ flank_contact[k].reshape(-1, len(nodes))).reshape(flank_contact[k].shape)
    return RigFields(led, _edge_feedback(unit, bins, interface), *kernels, flank, flank_contact)


def _edge_feedback(unit: UnitFields, bins: AngleBins, interface: Interface) -> Array:
    """Return :attr:`RigFields.edges`: contact -> edges -> contact, light sent less light withheld."""
    n1, n3, wavelength = interface.n_glass, interface.n_silicone, interface.wavelength
    taken = frustrated_transmittance(bins.cosines, 0.0, wavelength, n1, n3).mean(axis=1)
    sent = returned_radiance(0.0, np.arccos(bins.cosines), interface).mean(axis=1)
    # By reciprocity what a segment would send to a node is what the node sends to the segment. The guided light that
    # a contact takes in is spread over the edges as if it came from all angles alike.
    guided = np.arange(bins.count) >= bins.critical
    withheld = taken * guided / (np.pi * np.diff(bins.borders) @ (taken * guided))
    to_edges = (unit.edge @ (sent - withheld)) / unit.segment_area[:, None]
    return np.asarray((unit.edge @ taken).T @ unit.response @ to_edges)


def _kernels(scene: Scene, interface: Interface, theta: Array, radiance: Array) -> tuple[Array, Array]:
    """Return the feedback's kernels, which reach over the contact grid, as sums over coarse cells."""
    reach = math.ceil(scene.grid.size_mm / FEEDBACK_CELL)
    steps = np.arange(-reach, reach + 1) * FEEDBACK_CELL
    r = np.hypot(steps[None, :], steps[:, None])
    # A cell onto itself: its mean distance; the rings there have theta near 0, where little is guided.
    r[reach, reach] = 0.3826 * FEEDBACK_CELL
    found = feedback(
        r,
        scene.plate.thickness_mm,
        interface,
        theta,
        radiance,
        absorption_coefficient=scene.plate.absorption_coefficient_per_mm,
    )
    return found.loss * FEEDBACK_CELL**2, found.gain * FEEDBACK_CELL**2


# --- kept on disk and in the process ---------------------------------------------------------------------------------


def rig_digest(scene: Scene) -> str:
    """Return the digest of all that :class:`RigFields` depend on: voltages, load and camera are not among it."""
    data = scene.as_dict()
    finger = ("position_mm", "refractive_index", "diffuse_reflectance", "tip_radius_mm", "diameter_mm", "length_mm")
    leds = ("emitting_width_mm", "emitting_height_mm", "air_gap_share")
    places = {edge: places.tolist() for edge, places in led_positions(scene.plate, scene.leds).items()}
    return digest(
        [
            FORMAT,
            data["plate"],
            {key: data["leds"][key] for key in leds},
            places,
            {key: data["finger"][key] for key in finger},
            scene.camera.wavelength_nm,
            data["grid"]["size_mm"],
        ]
    )


def cache_folder() -> Path:
    """Return the folder of cached fields, under ``EVANESCE_CACHE`` or the user's cache folder."""
    return Path(os.environ.get("EVANESCE_CACHE") or platformdirs.user_cache_dir("evanesce")) / "fields"


def _read(path: Path, shapes: dict[str, tuple[int, ...]]) -> RigFields | None:
    """Return cached fields, None where there are none that can be used."""
    try:
        with np.load(path, allow_pickle=False) as data:
            arrays = {name: data[name] for name in RigFields.__dataclass_fields__}
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
        return None
    for name, array in arrays.items():
        if array.dtype != np.float64 or not np.isfinite(array).all() or array.shape != shapes.get(name, array.shape):
            return None
    return RigFields(**arrays)


def _write(path: Path, fields: RigFields) -> None:
    """Keep fields on disk, whole or not at all; a cache that cannot be written is no error."""
    with contextlib.suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, part = tempfile.mkstemp(dir=path.parent, suffix=".part")
        try:
            with os.fdopen(handle, "wb") as stream:
                np.savez(stream, **{name: getattr(fields, name) for name in RigFields.__dataclass_fields__})
            os.replace(part, path)
        except BaseException:
            Path(part).unlink(missing_ok=True)
            raise


def rig_fields(scene: Scene) -> RigFields:
    """Return the fields of a rig from this process, from disk, or computed."""
    key = rig_digest(scene)

    def make() -> RigFields:
        path = cache_folder() / f"{key}.npz"
        nodes = _nodes(scene).shape[0]
        leds = sum(places.size for places in led_positions(scene.plate, scene.leds).values())
        bins = AngleBins.of(scene.plate.refractive_index, scene.finger.refractive_index).count
        side = 2 * math.ceil(scene.grid.size_mm / FEEDBACK_CELL) + 1
        shapes: dict[str, tuple[int, ...]] = {"led": (leds, nodes, bins), "edges": (nodes, nodes)}
        shapes |= {"loss": (side, side), "gain": (side, side)}
        table = (FLANK_DEPTHS, FLANK_STATIONS.size, FLANK_AZIMUTHS)
        shapes |= {"flank": (leds, *table), "flank_contact": (*table, nodes)}
        found = _read(path, shapes)
        if found is None:
            found = compute_rig_fields(scene)
            _write(path, found)
        return found

    return kept("rig" + key, make)


_KEPT: OrderedDict[str, Any] = OrderedDict()
_KEEP = 16


def kept(key: str, make: Callable[[], T]) -> T:
    """Return a cached value of this process, made if needed; the oldest beyond a few are dropped."""
    if key not in _KEPT:
        _KEPT[key] = make()
        while len(_KEPT) > _KEEP:
            _KEPT.popitem(last=False)
    _KEPT.move_to_end(key)
    found: T = _KEPT[key]
    return found


# --- for a frame -----------------------------------------------------------------------------------------------------


def optics_digest(scene: Scene) -> str:
    """Return the digest of all that :class:`Fields` depend on: a change of load, exposure or tone keeps them."""
    data = scene.as_dict()
    camera = {k: v for k, v in data["camera"].items() if k not in ("exposure_ms", "analogue_gain", "tone_curve")}
    length = scene.finger.scattering_length_mm
    return digest([rig_digest(scene), data["leds"], camera, data["grid"], length])


def fields_of(scene: Scene) -> Fields:
    """Return the fields of a scene, kept for the last few."""
    return kept("fields" + optics_digest(scene), lambda: _assemble(scene))


@dataclass(frozen=True)
class _Tables:
    """By gap, for one interface and one place of the camera."""

    gaps: Array
    transmitted: Array
    response: Array
    view: float
    window: float


def _tables(scene: Scene, bins: AngleBins) -> _Tables:
    interface = interface_of(scene)
    n1, n3, wavelength = interface.n_glass, interface.n_silicone, interface.wavelength
    end = NEAR_WAVELENGTHS * wavelength * 1e-6
    gaps = end * np.linspace(0.0, 1.0, GAP_STEPS) ** 2
    transmitted = np.stack(
        [frustrated_transmittance(c[None, :], gaps[:, None], wavelength, n1, n3).mean(axis=1) for c in bins.cosines]
    )
    transmitted[:, -1] = 0.0
    view = math.asin(math.sin(_mean_view_angle(scene)) / n1)
    # On its way out the light crosses the plate once more.
    window = float(window_transmittance(view, n1))
    window *= math.exp(-scene.plate.absorption_coefficient_per_mm * scene.plate.thickness_mm / math.cos(view))
    return _Tables(gaps, transmitted, returned_radiance(gaps, view, interface) * window, view, window)


def _assemble(scene: Scene) -> Fields:
    interface = interface_of(scene)
    n1 = interface.n_glass
    bins = AngleBins.of(n1, interface.n_silicone)
    rig, light = rig_fields(scene), edge_light(scene)
    radiances = stacked_radiances(light)
    x, y = node_axes(scene)
    tables = _tables(scene, bins)
    left, strength, shapes = np.linalg.svd(np.tensordot(radiances, rig.led, 1), full_matrices=False)
    modes = (left[:, :MODES] * strength[:MODES]).T.reshape(MODES, y.size, x.size)
    length, grid = scene.finger.scattering_length_mm, scene.grid
    glow = None
    if length > 0 and interface.body_reflectance > 0:
        pitch = grid.size_mm / grid.samples
        glow = make_glow(interface, length, grid.size_mm, pitch, tables.gaps, tables.view, tables.window)
    bare = 1.0 - float(window_transmittance(tables.view, n1)) * n1**2
    return Fields(
        x,
        y,
        modes,
        tables.gaps,
        shapes[:MODES] @ tables.transmitted,
        np.asarray(tables.response),
        interface.body_reflectance / np.pi * (1.0 - bare) * n1**2 * tables.window,
        bare * bare,
        np.tensordot(radiances, rig.flank, 1),
        rig,
        glow,
    )


def _mean_view_angle(scene: Scene) -> float:
    """Angle in air at which the lens sees the finger's tip [rad]."""
    projection = Projection.of(scene.camera, scene.plate)
    x, y = projection.plate_to_ray(*(np.array([p]) for p in scene.finger.position_mm))
    ray = projection.axes @ np.array([x[0], y[0], 1.0])
    return float(np.arccos(ray[2] / np.linalg.norm(ray)))
