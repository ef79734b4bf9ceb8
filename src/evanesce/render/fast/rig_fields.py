"""What the fast renderer computes once per rig: the light of each LED and each stretch of edge, and what answers it.

Two stages. The light of unit sources in the empty plate takes seconds, is independent of what edges and finger reflect,
and is kept on disk. The rig's own fields follow from it by linear algebra.
"""

from __future__ import annotations

import contextlib
import math
import os
import tempfile
import zipfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import platformdirs
from numpy.typing import NDArray

from evanesce.core.provenance import digest
from evanesce.optics.flank.field import EPSILON, Profile, contact_on_flank, flank_irradiance, mirrored_exchange
from evanesce.optics.guided_field import EdgeExchange, EdgeLight, edge_response
from evanesce.optics.interface import frustrated_transmittance
from evanesce.optics.led import led_positions, led_radiances
from evanesce.optics.patch_light import Interface, feedback, returned_radiance
from evanesce.optics.plate_field import AngleBins, segment_areas, unit_fields
from evanesce.render.kept import kept
from evanesce.rig import Scene

Array = NDArray[np.float64]
Single = NDArray[np.float32]

FORMAT = 7
"""Of the files; a change of any formula of their content counts it up."""

KEEP_FILES = 24
"""Files of unit light in the cache folder, some 10 MB each; the longest unused beyond them are removed."""

FIELD_SPACING = 1.5
"""Spacing of the field's nodes [mm]."""

FEEDBACK_CELL = 0.25
"""Cell of the feedback's coarse grid [mm]."""

PER_EDGE = 48
"""Segments of each edge."""

FLANK_DEPTHS = np.array([0.0, 0.08, 0.2, 0.45, 0.85])
"""Approaches over the tip's radius at which the flank's light is tabulated; linear between them."""

FLANK_STATIONS = np.array(
    [-1, -0.5, -EPSILON, 0, 0.02, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1, 1.25, 1.6, 2]
)
FLANK_AZIMUTHS = 16


@dataclass(frozen=True)
class UnitLight:
    """Light of unit sources in the empty plate; what it depends on is in :func:`unit_digest`.

    Attributes
    ----------
    led : ndarray (leds, points, bins)
        Irradiance at the nodes by bin of angle per radiance of each LED [sr].
    edge : ndarray (segments, points, bins)
        The same per diffuse radiance of each segment of the edges [sr].
    edge_from_led : ndarray (segments, leds)
        Irradiance on each segment per radiance of each LED [sr].
    edge_from_edge : ndarray (segments, segments)
        The same per diffuse radiance of each segment [sr].
    flank_led : ndarray (leds, depths * stations * azimuths)
        Irradiance on the finger's flank per radiance of each LED [sr].
    flank_edge : ndarray (segments, depths * stations * azimuths)
        The same per diffuse radiance of each segment [sr].
    """

    led: Single
    edge: Single
    edge_from_led: Single
    edge_from_edge: Single
    flank_led: Single
    flank_edge: Single


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


# --- a scene as the closed forms need it -----------------------------------------------------------------------------


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
    return FLANK_DEPTHS * scene.finger.tip_radius_mm


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


def _bins(scene: Scene) -> AngleBins:
    return AngleBins.of(scene.plate.refractive_index, scene.finger.refractive_index)


def _flank_surface(scene: Scene) -> tuple[Array, Array]:
    """Return points and normals of the flank's tables, (depths, stations, azimuths, 3)."""
    azimuths = np.arange(FLANK_AZIMUTHS) * 2 * np.pi / FLANK_AZIMUTHS
    depth, station, azimuth = np.meshgrid(flank_depths(scene), FLANK_STATIONS, azimuths, indexing="ij")
    return profile_of(scene).surface(station, azimuth, depth)


# --- unit light ------------------------------------------------------------------------------------------------------


def compute_unit_light(scene: Scene) -> UnitLight:
    """Compute the light of unit sources: seconds."""
    light = edge_light(scene)
    unit = unit_fields(light, _nodes(scene), _bins(scene), per_edge=PER_EDGE)
    points, normals = _flank_surface(scene)
    flank = flank_irradiance(light, points.reshape(-1, 3), normals.reshape(-1, 3), per_edge=PER_EDGE)
    found = (unit.led, unit.edge, unit.exchange.from_led, unit.exchange.from_edge, *flank)
    return UnitLight(*(np.asarray(a, np.float32) for a in found))


def unit_digest(scene: Scene) -> str:
    """Return the digest of all that :class:`UnitLight` depends on: no voltage, reflectance, load or camera."""
    data = scene.as_dict()
    plate = ("size_mm", "thickness_mm", "refractive_index", "absorption_coefficient_per_mm", "edge_polish")
    leds = ("emitting_width_mm", "emitting_height_mm", "air_gap_share")
    finger = ("position_mm", "refractive_index", "tip_radius_mm", "diameter_mm", "length_mm")
    places = {edge: places.tolist() for edge, places in led_positions(scene.plate, scene.leds).items()}
    parts = [{key: data[room][key] for key in keys} for room, keys in
             (("plate", plate), ("leds", leds), ("finger", finger), ("grid", ("size_mm",)))]  # fmt: skip
    return digest([FORMAT, parts, places])


def unit_light(scene: Scene) -> UnitLight:
    """Return the unit light of a rig from this process, from disk, or computed."""
    key = unit_digest(scene)

    def make() -> UnitLight:
        path = cache_folder() / f"{key}.npz"
        found = _read(path, _shapes(scene))
        if found is None:
            found = compute_unit_light(scene)
            _write(path, found)
        return found

    return kept("unit", key, make)


# --- rig fields ------------------------------------------------------------------------------------------------------


def compute_rig_fields(scene: Scene, unit: UnitLight | None = None) -> RigFields:
    """Compute the fields of a rig from its unit light, which is computed, too, if not given."""
    unit = compute_unit_light(scene) if unit is None else unit
    light, interface, bins, nodes = edge_light(scene), interface_of(scene), _bins(scene), _nodes(scene)
    exchange = EdgeExchange(unit.edge_from_led.astype(float), unit.edge_from_edge.astype(float))
    response = edge_response(exchange, light.edge_reflectance)
    edge_radiances = response @ exchange.from_led
    segments = edge_radiances.shape[0]
    by_segment = unit.edge.reshape(segments, -1).astype(float)
    led = unit.led.astype(float) + (edge_radiances.T @ by_segment).reshape(unit.led.shape)
    angular = led.sum(axis=(0, 1)) / np.diff(bins.borders)
    kernels = _kernels(scene, interface, bins.centres, angular)
    points, normals = _flank_surface(scene)
    shape = points.shape[:-1]
    flank = (unit.flank_led + edge_radiances.T @ unit.flank_edge).reshape(-1, *shape)
    flank_contact = contact_on_flank(
        points.reshape(-1, 3), normals.reshape(-1, 3), nodes, light.thickness, interface, light.absorption_coefficient
    ).reshape(*shape, -1)
    for k in range(shape[0]):
        own = mirrored_exchange(points[k], normals[k], interface.body_reflectance, interface.n_glass)
        flank[:, k] = (flank[:, k].reshape(len(flank), -1) @ own.T).reshape(flank[:, k].shape)
        flank_contact[k] = (own @ flank_contact[k].reshape(-1, len(nodes))).reshape(flank_contact[k].shape)
    edges = _edge_feedback(unit.edge.astype(float), response, segment_areas(light, PER_EDGE), bins, interface)
    return RigFields(led, edges, *kernels, flank, flank_contact)


def _edge_feedback(edge: Array, response: Array, areas: Array, bins: AngleBins, interface: Interface) -> Array:
    """Return :attr:`RigFields.edges`: contact -> edges -> contact, light sent less light withheld."""
    n1, n3, wavelength = interface.n_glass, interface.n_silicone, interface.wavelength
    taken = frustrated_transmittance(bins.cosines, 0.0, wavelength, n1, n3).mean(axis=1)
    sent = returned_radiance(0.0, np.arccos(bins.cosines), interface).mean(axis=1)
    # By reciprocity what a segment would send to a node is what the node sends to the segment. The guided light that
    # a contact takes in is spread over the edges as if it came from all angles alike.
    guided = np.arange(bins.count) >= bins.critical
    withheld = taken * guided / (np.pi * np.diff(bins.borders) @ (taken * guided))
    to_edges = (edge @ (sent - withheld)) / areas[:, None]
    return np.asarray((edge @ taken).T @ response @ to_edges)


def _kernels(scene: Scene, interface: Interface, theta: Array, radiance: Array) -> tuple[Array, Array]:
    """Return the feedback's kernels, which reach over the contact grid, as sums over coarse cells."""
    reach = math.ceil(scene.grid.size_mm / FEEDBACK_CELL)
    steps = np.arange(-reach, reach + 1) * FEEDBACK_CELL
    r = np.hypot(steps[None, :], steps[:, None])
    # A cell onto itself: its mean distance; the rings there have theta near 0, where little is guided.
    r[reach, reach] = 0.3826 * FEEDBACK_CELL
    distinct, place = np.unique(np.round(r, 9), return_inverse=True)
    found = feedback(
        distinct,
        scene.plate.thickness_mm,
        interface,
        theta,
        radiance,
        absorption_coefficient=scene.plate.absorption_coefficient_per_mm,
    )
    return tuple(table[place].reshape(r.shape) * FEEDBACK_CELL**2 for table in (found.loss, found.gain))  # type: ignore[return-value]


def rig_digest(scene: Scene) -> str:
    """Return the digest of all that :class:`RigFields` depend on: voltages, load and camera are not among it."""
    optical = (scene.plate.edge_reflectance, scene.finger.diffuse_reflectance, scene.camera.wavelength_nm)
    return digest([unit_digest(scene), optical])


def rig_fields(scene: Scene) -> RigFields:
    """Return the fields of a rig, kept for the last few."""
    return kept("rig", rig_digest(scene), lambda: compute_rig_fields(scene, unit_light(scene)))


# --- on disk ---------------------------------------------------------------------------------------------------------


def cache_folder() -> Path:
    """Return the folder of unit light, under ``EVANESCE_CACHE`` or the user's cache folder."""
    return Path(os.environ.get("EVANESCE_CACHE") or platformdirs.user_cache_dir("evanesce")) / "fields"


def _shapes(scene: Scene) -> dict[str, tuple[int, ...]]:
    leds = sum(places.size for places in led_positions(scene.plate, scene.leds).values())
    nodes, bins, segments = _nodes(scene).shape[0], _bins(scene).count, 4 * PER_EDGE
    flank = FLANK_DEPTHS.size * FLANK_STATIONS.size * FLANK_AZIMUTHS
    return {
        "led": (leds, nodes, bins),
        "edge": (segments, nodes, bins),
        "edge_from_led": (segments, leds),
        "edge_from_edge": (segments, segments),
        "flank_led": (leds, flank),
        "flank_edge": (segments, flank),
    }


def _read(path: Path, shapes: dict[str, tuple[int, ...]]) -> UnitLight | None:
    """Return kept light, None where there is none that can be used."""
    try:
        # Opened here: numpy leaves a file open that turns out to be no archive.
        with path.open("rb") as stream, np.load(stream, allow_pickle=False) as data:
            arrays = {name: data[name] for name in shapes}
        os.utime(path)
    except (OSError, ValueError, KeyError, EOFError, AttributeError, TypeError, zipfile.BadZipFile):
        return None
    for name, array in arrays.items():
        if array.dtype != np.float32 or array.shape != shapes[name] or not np.isfinite(array).all():
            return None
    return UnitLight(**arrays)


def _write(path: Path, light: UnitLight) -> None:
    """Keep light on disk, whole or not at all; a cache that cannot be written is no error."""
    with contextlib.suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, part = tempfile.mkstemp(dir=path.parent, suffix=".part")
        try:
            with os.fdopen(handle, "wb") as stream:
                np.savez(stream, **{name: getattr(light, name) for name in UnitLight.__dataclass_fields__})
            os.replace(part, path)
        except BaseException:
            Path(part).unlink(missing_ok=True)
            raise
        files = sorted(path.parent.glob("*.npz"), key=lambda file: file.stat().st_mtime, reverse=True)
        for old in files[KEEP_FILES:]:
            old.unlink(missing_ok=True)
