"""What the fast renderer computes once per rig: the light of LEDs and edges, and the plate's response to contact.

Two stages. The light of unit sources in the empty plate takes seconds, is independent of what edges and finger reflect,
and is kept on disk. The rig's own fields follow from it by linear algebra.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.core.provenance import digest
from evanesce.optics.edge_rays import EdgeLight
from evanesce.optics.guided_field import EdgeExchange, edge_response
from evanesce.optics.interface import frustrated_transmittance
from evanesce.optics.led import led_positions
from evanesce.optics.patch_light import Interface, feedback, returned_radiance
from evanesce.optics.path_sums import MOMENTS, in_plate
from evanesce.optics.plate_field import AngleBins, segment_areas, unit_sums
from evanesce.render.fast import flank, flank_table
from evanesce.render.fast.field_files import read_arrays, write_arrays
from evanesce.render.fast.rig_optics import edge_light, interface_of
from evanesce.render.kept import kept
from evanesce.rig import Scene

Array = NDArray[np.float64]
Single = NDArray[np.float32]

FORMAT = 8
"""Of the files; a change of any formula of their content counts it up."""

FIELD_SPACING = 1.5
"""Spacing of the field's nodes [mm]."""

FEEDBACK_CELL = 0.25
"""Cell of the feedback's coarse grid [mm]."""

PER_EDGE = 48
"""Segments of each edge."""


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
    flank_led : ndarray (leds, approaches * stations * azimuths)
        Irradiance on the finger's flank per radiance of each LED [sr].
    flank_edge : ndarray (segments, approaches * stations * azimuths)
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
    """What depends on plate, LEDs' positions and finger, but on no LED's power.

    Attributes
    ----------
    led : ndarray (leds, points, bins)
        Irradiance at the nodes by bin of angle per radiance of each LED, diffuse edges included [sr].
    edges : ndarray (points, points)
        Irradiance into silicone at each node that the edges return, per power that a contact at another takes in
        [1/mm^2]; negative where the contact keeps more from the edges than it sends there.
    loss, gain : ndarray (kernel, kernel)
        See :class:`evanesce.optics.patch_light.Feedback`, summed over a cell of the coarse grid [1].
    flank : ndarray (leds, approaches, stations, azimuths)
        Irradiance on the finger's flank per radiance of each LED [sr].
    flank_contact : ndarray (approaches, stations, azimuths, points)
        The same per power that a contact at each node takes in [1/mm^2].
    """

    led: Array
    edges: Array
    loss: Array
    gain: Array
    flank: Array
    flank_contact: Array


def node_axes(scene: Scene) -> tuple[Array, Array]:
    """Return the field's nodes along x and y, over the contact grid and off the plate's edges [mm].

    Parameters
    ----------
    scene : Scene
    """
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


# --- unit light ------------------------------------------------------------------------------------------------------


def compute_unit_light(scene: Scene, approaches: NDArray[np.intp] | None = None) -> UnitLight:
    """Compute the light of unit sources: seconds.

    Parameters
    ----------
    scene : Scene
    approaches : ndarray of int, optional
        Indices of the flank's approaches that are needed; the flank is then coarse, a fifth of the time
        (:func:`evanesce.render.fast.flank.coarse_unit_tables`).
    """
    return UnitLight(
        *in_plate(edge_light(scene), lambda light: list(compute_unit_sums(scene, light, approaches).values()))
    )


def compute_unit_sums(scene: Scene, light: EdgeLight, approaches: NDArray[np.intp] | None = None) -> dict[str, Single]:
    """Compute the light of unit sources, summed by paths (:mod:`evanesce.optics.path_sums`).

    Parameters
    ----------
    scene : Scene
    light : EdgeLight
        Its plate, or one that differs by what sums serve.
    approaches : ndarray of int, optional
        As for :func:`compute_unit_light`.

    Returns
    -------
    dict of ndarray (moments, ...)
        By name, in the order of :class:`UnitLight`.
    """
    led, edge, from_led, from_edge = unit_sums(light, _nodes(scene), _bins(scene), per_edge=PER_EDGE)
    if approaches is None:
        tables = flank.unit_tables(scene, light, PER_EDGE)
    else:
        tables = flank.coarse_unit_tables(scene, light, PER_EDGE, approaches)
    found = (led, edge, from_led, from_edge, *tables)
    return {name: np.asarray(a, np.float32) for name, a in zip(UnitLight.__dataclass_fields__, found, strict=True)}


def unit_digest(scene: Scene, light: EdgeLight | None = None) -> str:
    """Return the digest of all that :class:`UnitLight` depends on: no voltage, reflectance, load or camera.

    Parameters
    ----------
    scene : Scene
    light : EdgeLight, optional
        As for :func:`plate_digest`.
    """
    finger = ("position_mm", "refractive_index", "tip_radius_mm", "diameter_mm", "length_mm")
    parts = [_chosen(scene.table(table), keys) for table, keys in (("finger", finger), ("grid", ("size_mm",)))]
    return digest([plate_digest(scene, light), parts])


def plate_digest(scene: Scene, light: EdgeLight | None = None) -> str:
    """Return the digest of what decides light in the empty plate per unit of its sources.

    Parameters
    ----------
    scene : Scene
    light : EdgeLight, optional
        Of another absorption, or with other air films.
    """
    plate = ("size_mm", "thickness_mm", "refractive_index", "edge_polish")
    leds = ("emitting_width_mm", "emitting_height_mm")
    positions = {edge: own.tolist() for edge, own in led_positions(scene.plate, scene.leds).items()}
    parts = [_chosen(scene.table(table), keys) for table, keys in (("plate", plate), ("leds", leds))]
    light = edge_light(scene) if light is None else light
    return digest([FORMAT, parts, positions, light.absorption_coefficient, light.air_gap_share])


def _chosen(table: Mapping[str, Any], keys: Sequence[str]) -> dict[str, Any]:
    return {key: table[key] for key in keys}


def unit_light(scene: Scene) -> UnitLight:
    """Return the unit light of a rig, from sums of this process, from disk, or computed.

    Parameters
    ----------
    scene : Scene
    """

    def sums_of(light: EdgeLight) -> list[Single]:
        key = unit_digest(scene, light)

        def make() -> dict[str, Single]:
            found = _read(key, _shapes(scene))
            if found is None:
                found = compute_unit_sums(scene, light)
                write_arrays(key, found)
            return found

        return list(kept("unit sums", key, make).values())

    return kept("unit", unit_digest(scene), lambda: UnitLight(*in_plate(edge_light(scene), sums_of)))


# --- rig fields ------------------------------------------------------------------------------------------------------


def compute_rig_fields(scene: Scene, unit: UnitLight | None = None) -> RigFields:
    """Compute the fields of a rig from its unit light, which is computed, too, if not given.

    Parameters
    ----------
    scene : Scene
    unit : UnitLight, optional
    """
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
    on_flank = unit.flank_led + edge_radiances.T @ unit.flank_edge
    tables = flank.rig_tables(scene, light, interface, nodes, on_flank)
    edges = _edge_feedback(unit.edge.astype(float), response, segment_areas(light, PER_EDGE), bins, interface)
    return RigFields(led, edges, *kernels, *tables)


def _edge_feedback(edge: Array, response: Array, areas: Array, bins: AngleBins, interface: Interface) -> Array:
    """Return :attr:`RigFields.edges`: contact -> edges -> contact, light sent less light withheld."""
    n1, n3, wavelength = interface.n_glass, interface.n_silicone, interface.wavelength
    taken = frustrated_transmittance(bins.cosines, 0.0, wavelength, n1, n3).mean(axis=1)
    sent = returned_radiance(0.0, np.arccos(bins.cosines), interface).mean(axis=1)
    # By reciprocity what a segment would send to a node is what the node sends to the segment. The guided light that
    # a contact takes in is spread over the edges as if it came from all angles alike.
    guided = taken * (np.arange(bins.count) >= bins.critical)
    all_guided = float(np.pi * np.diff(bins.borders) @ guided)
    withheld = guided / all_guided if all_guided > 0.0 else guided  # a plate of air's index guides none
    to_edges = (edge @ (sent - withheld)) / areas[:, None]
    return np.asarray((edge @ taken).T @ response @ to_edges)


def _kernels(scene: Scene, interface: Interface, theta: Array, radiance: Array) -> tuple[Array, Array]:
    """Return the feedback's kernels, which reach over the contact grid, as sums over coarse cells."""
    reach = math.ceil(scene.grid.size_mm / FEEDBACK_CELL)
    steps = np.arange(-reach, reach + 1) * FEEDBACK_CELL
    r = np.hypot(steps[None, :], steps[:, None])
    # A cell onto itself: its mean distance; the annuli there have theta near 0, where little is guided.
    r[reach, reach] = 0.3826 * FEEDBACK_CELL
    distinct, which = np.unique(np.round(r, 9), return_inverse=True)
    found = feedback(
        distinct,
        scene.plate.thickness_mm,
        interface,
        theta,
        radiance,
        absorption_coefficient=scene.plate.absorption_coefficient_per_mm,
    )
    return tuple(table[which].reshape(r.shape) * FEEDBACK_CELL**2 for table in (found.loss, found.gain))  # type: ignore[return-value]


def rig_digest(scene: Scene) -> str:
    """Return the digest of all that :class:`RigFields` depend on: voltages, load and camera are not among it.

    Parameters
    ----------
    scene : Scene
    """
    optical = (scene.plate.edge_reflectance, scene.finger.diffuse_reflectance, scene.camera.wavelength_nm)
    return digest([unit_digest(scene), optical])


def rig_fields(scene: Scene) -> RigFields:
    """Return the fields of a rig, kept for the last few.

    Parameters
    ----------
    scene : Scene
    """
    return kept("rig", rig_digest(scene), lambda: compute_rig_fields(scene, unit_light(scene)))


def keep_coarse_fields(scene: Scene, approaches_mm: tuple[float, ...]) -> RigFields:
    """Compute a rig's fields in a fifth of the time, for a search over many rigs: with a coarse flank.

    Nine tenths of a new rig's fields go into the flank, which is dim and smooth; what the contact itself sends to the
    lens is computed as for any other rig. The fields are kept in this process only, under the rig's own key, until
    :func:`~evanesce.render.kept.forget`, and :func:`~evanesce.render.fast.transport.render_fast` takes them; the files
    of full fields on disk are neither read nor written.

    Parameters
    ----------
    scene : Scene
        After effects of the rig.
    approaches_mm : tuple of float
        Approaches of the finger that will be rendered [mm].
    """
    some = flank.approaches_around(approaches_mm, scene.finger.tip_radius_mm)

    def unit() -> UnitLight:
        return kept("unit", f"coarse {unit_digest(scene)} {some}", lambda: compute_unit_light(scene, some))

    return kept("rig", rig_digest(scene), lambda: compute_rig_fields(scene, unit()))


# --- on disk ---------------------------------------------------------------------------------------------------------


def _shapes(scene: Scene) -> dict[str, tuple[int, ...]]:
    leds = sum(own.size for own in led_positions(scene.plate, scene.leds).values())
    nodes, bins, segments = _nodes(scene).shape[0], _bins(scene).count, 4 * PER_EDGE
    on_flank = flank_table.APPROACHES.size * flank_table.STATIONS.size * flank_table.AZIMUTHS
    shapes = {
        "led": (leds, nodes, bins),
        "edge": (segments, nodes, bins),
        "edge_from_led": (segments, leds),
        "edge_from_edge": (segments, segments),
        "flank_led": (leds, on_flank),
        "flank_edge": (segments, on_flank),
    }
    return {name: (MOMENTS, *shape) for name, shape in shapes.items()}


def _read(key: str, shapes: dict[str, tuple[int, ...]]) -> dict[str, Single] | None:
    """Return kept sums, None where there are none that can be used."""
    arrays = read_arrays(key, shapes)
    if arrays is None or any(a.dtype != np.float32 or a.shape != shapes[name] for name, a in arrays.items()):
        return None
    return arrays
