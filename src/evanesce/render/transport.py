"""The fast renderer: a frame as fields computed once per rig and cheap operators per contact state.

Guided light is smooth and nearly unchanged by a contact. What a contact sends to the lens is therefore a product of
the guided irradiance of the empty plate (a field, by angle), the interface's transmittance at the local gap (a table)
and the body's response (a table), corrected for what other parts of the contact take away or give back through the
plate (a convolution on a coarse grid).
"""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.signal import fftconvolve

from evanesce.optics.guided_field import EdgeLight, azimuthal_radiance, edge_radiance
from evanesce.optics.led import led_positions, led_radiances
from evanesce.optics.patch_light import (
    Interface,
    angle_nodes,
    feedback,
    returned_radiance,
    transmitted_irradiance_kernel,
    window_transmittance,
)
from evanesce.optics.projection import IdealView, Projection
from evanesce.provenance import digest
from evanesce.render.glow import Glow, glow_radiance, make_glow
from evanesce.rig import Scene
from evanesce.states import ContactState, PlateLight

Array = NDArray[np.float64]
T = TypeVar("T")

MODES = 3
"""Spatial modes of the guided field's angular shape; the fourth is below 1e-4 of the first on any rig tried."""

GAP_END = 2e-3
"""Gap [mm] beyond which nothing couples (exp(-2 kappa g) < 1e-9 but within 0.5 deg of the critical angle)."""

GAP_STEPS = 2048
FIELD_SPACING = 1.5
"""Spacing of the field's nodes [mm]."""

FEEDBACK_CELL = 0.25
"""Cell of the feedback's coarse grid [mm]."""


@dataclass(frozen=True)
class Fields:
    """What is computed once per rig.

    Attributes
    ----------
    x, y : ndarray
        Nodes of the field on the plate [mm].
    modes : ndarray (MODES, y, x)
        Spatial modes of the guided radiance [W mm^-2 sr^-1].
    gaps : ndarray (GAP_STEPS,)
        Gaps of the tables, evenly spaced in the square root [mm].
    coupling : ndarray (MODES, GAP_STEPS)
        Irradiance inside the silicone per mode [sr].
    response : ndarray (GAP_STEPS,)
        Radiance in air towards the lens per irradiance inside the silicone [1/sr].
    loss, gain : ndarray
        Feedback kernels on the coarse grid, sums over cells [1].
    glow : Glow or None
        Lateral spread inside the silicone; None where light leaves where it entered.
    """

    x: Array
    y: Array
    modes: Array
    gaps: Array
    coupling: Array
    response: Array
    loss: Array
    gain: Array
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


def precompute(scene: Scene) -> Fields:
    """Compute the fields of a rig: a second or two of work."""
    light, interface = edge_light(scene), interface_of(scene)
    theta, weights = angle_nodes(24, interface.n_glass)
    x, y = _nodes(scene)
    points = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    radiance = azimuthal_radiance(light, points[:, 0], points[:, 1], theta, diffuse=edge_radiance(light))
    left, strength, shapes = np.linalg.svd(radiance * weights, full_matrices=False)
    modes = (left[:, :MODES] * strength[:MODES]).T.reshape(MODES, y.size, x.size)
    gaps = GAP_END * np.linspace(0.0, 1.0, GAP_STEPS) ** 2
    kernel = transmitted_irradiance_kernel(theta, np.ones_like(theta), gaps, interface)
    coupling = shapes[:MODES] @ kernel.T
    coupling[:, -1] = 0.0
    view = math.asin(math.sin(_mean_view_angle(scene)) / interface.n_glass)
    # On its way out the light crosses the plate once more.
    way = scene.plate.thickness_mm / math.cos(view)
    window = float(window_transmittance(view, interface.n_glass))
    window *= math.exp(-scene.plate.absorption_coefficient_per_mm * way)
    response = returned_radiance(gaps, view, interface) * window
    loss, gain = _feedback_kernels(scene, interface, theta, radiance.mean(axis=0))
    length, grid = scene.finger.scattering_length_mm, scene.grid
    glow = None
    if length > 0 and interface.body_reflectance > 0:
        glow = make_glow(interface, length, grid.size_mm, grid.size_mm / grid.samples, gaps, view, window)
    return Fields(x, y, modes, gaps, coupling, np.asarray(response), loss, gain, glow)


def _nodes(scene: Scene) -> tuple[Array, Array]:
    """Nodes over the contact grid, kept off the edges."""
    half = scene.grid.size_mm / 2
    axes = []
    for centre, size in zip(scene.finger.position_mm, scene.plate.size_mm, strict=True):
        low, high = max(centre - half, -size / 2 + 0.5), min(centre + half, size / 2 - 0.5)
        axes.append(np.linspace(low, high, max(4, math.ceil((high - low) / FIELD_SPACING) + 1)))
    return axes[0], axes[1]


def _mean_view_angle(scene: Scene) -> float:
    """Angle in air at which the lens sees the finger's tip [rad]."""
    projection = Projection.of(scene.camera, scene.plate)
    x, y = projection.plate_to_ray(*(np.array([p]) for p in scene.finger.position_mm))
    ray = projection.axes @ np.array([x[0], y[0], 1.0])
    return float(np.arccos(ray[2] / np.linalg.norm(ray)))


def _feedback_kernels(scene: Scene, interface: Interface, theta: Array, radiance: Array) -> tuple[Array, Array]:
    """Return loss and gain kernels that reach over the contact grid, as sums over coarse cells."""
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


def rig_digest(scene: Scene) -> str:
    """Return the digest of all that the fields depend on: a change of load, exposure or tone keeps them."""
    data = scene.as_dict()
    optical = ("position_mm", "refractive_index", "diffuse_reflectance", "scattering_length_mm")
    finger = {key: data["finger"][key] for key in optical}
    camera = {k: v for k, v in data["camera"].items() if k not in ("exposure_ms", "analogue_gain", "tone_curve")}
    return digest([data["plate"], data["leds"], finger, camera, data["grid"]])


_KEPT: OrderedDict[str, Any] = OrderedDict()
_KEEP = 8


def _kept(key: str, make: Callable[[], T]) -> T:
    """Return a cached value of this process, made if needed; the oldest beyond a few are dropped."""
    if key not in _KEPT:
        _KEPT[key] = make()
        while len(_KEPT) > _KEEP:
            _KEPT.popitem(last=False)
    _KEPT.move_to_end(key)
    found: T = _KEPT[key]
    return found


def fields_of(scene: Scene) -> Fields:
    """Return the fields of a scene, kept for the last few rigs."""
    return _kept("fields" + rig_digest(scene), lambda: precompute(scene))


def patch_radiance(fields: Fields, state: ContactState, refine: int = 2) -> tuple[NDArray[np.float32], float]:
    """Return the radiance towards the lens on the contact grid, ``refine`` times as fine, and its pitch [mm].

    The gap is interpolated bilinearly between the grid's samples, as the path tracer's texture does it.
    """
    rows, cols = state.grid.shape
    gap = np.asarray(state.gap, np.float32)
    fine = cv2.resize(gap, (cols * refine, rows * refine), interpolation=cv2.INTER_LINEAR)
    pitch = state.grid.pitch / refine
    x = state.grid.centre[0] + (np.arange(cols * refine) - (cols * refine - 1) / 2) * pitch
    y = state.grid.centre[1] + (np.arange(rows * refine) - (rows * refine - 1) / 2) * pitch
    index = np.sqrt(np.minimum(fine, GAP_END) / GAP_END) * np.float32(GAP_STEPS - 1)
    low = np.minimum(index.astype(np.int32), GAP_STEPS - 2)
    part = index - low
    irradiance = np.zeros_like(fine)
    map_x = np.broadcast_to(
        ((x - fields.x[0]) / (fields.x[1] - fields.x[0])).astype(np.float32)[None, :], fine.shape
    ).copy()
    map_y = np.broadcast_to(
        ((y - fields.y[0]) / (fields.y[1] - fields.y[0])).astype(np.float32)[:, None], fine.shape
    ).copy()
    for mode, table in zip(fields.modes, fields.coupling.astype(np.float32), strict=True):
        field = cv2.remap(mode.astype(np.float32), map_x, map_y, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
        irradiance += field * (table[low] * (1 - part) + table[low + 1] * part)
    touching = _touching(state, (rows * refine, cols * refine))
    if touching is not None:
        irradiance *= touching
    irradiance *= 1.0 + _feedback(fields, irradiance, pitch)
    if fields.glow is not None:
        return glow_radiance(fields.glow, irradiance, low, part, touching, pitch), pitch
    response = fields.response.astype(np.float32)
    return irradiance * (response[low] * (1 - part) + response[low + 1] * part), pitch


def _touching(state: ContactState, shape: tuple[int, int]) -> NDArray[np.float32] | None:
    """Return the real-contact fraction on the fine grid, 1 outside nominal contact; None where all of it touches."""
    if state.real_contact_fraction is None:
        return None
    fraction = np.where(np.asarray(state.contact_mask) > 0, state.real_contact_fraction, 1.0)
    fine = cv2.resize(np.asarray(np.clip(fraction, 0.0, 1.0), np.float32), shape[::-1], interpolation=cv2.INTER_LINEAR)
    return np.asarray(fine, np.float32)


def _feedback(fields: Fields, irradiance: NDArray[np.float32], pitch: float) -> NDArray[np.float32]:
    """Return the relative change of irradiance through the plate, on the fine grid."""
    rows, cols = irradiance.shape
    coarse = (max(1, round(cols * pitch / FEEDBACK_CELL)), max(1, round(rows * pitch / FEEDBACK_CELL)))
    peak = float(irradiance.max())
    if peak <= 0.0:
        return np.zeros_like(irradiance)
    covered = cv2.resize(irradiance, coarse, interpolation=cv2.INTER_AREA) / peak
    change = fftconvolve(covered, fields.gain - fields.loss, mode="same")
    return cv2.resize(change.astype(np.float32), (cols, rows), interpolation=cv2.INTER_LINEAR)


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
    dark = np.zeros(view.shape, np.float32)
    if state is None:
        return PlateLight(
            radiance=dark, variance=dark, focal_px=view.focal_px, principal_point=view.principal_point, samples=0
        )
    radiance, pitch = patch_radiance(fields_of(scene), state)
    footprint = max(1, round(1.0 / (scene.camera.scale_px_per_mm * pitch)))
    smooth = cv2.blur(radiance, (footprint, footprint), borderType=cv2.BORDER_CONSTANT)
    x0, y0 = state.grid.extent[0] + pitch / 2, state.grid.extent[2] + pitch / 2
    key = f"maps{rig_digest(scene)}{view}{x0:.9g} {y0:.9g} {pitch:.9g}"
    map_x, map_y = _kept(key, lambda: _plate_maps(scene, view, x0, y0, pitch))
    seen = cv2.remap(smooth, map_x, map_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=0)
    return PlateLight(
        radiance=seen,
        variance=np.zeros_like(seen),
        focal_px=view.focal_px,
        principal_point=view.principal_point,
        samples=0,
    )


def _plate_maps(
    scene: Scene, view: IdealView, x0: float, y0: float, pitch: float
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return where each pixel of a pinhole view falls on the refined contact grid."""
    projection = Projection.of(scene.camera, scene.plate)
    rows, cols = view.shape
    px, py = view.principal_point
    u, v = np.meshgrid((np.arange(cols) - px) / view.focal_px, (np.arange(rows) - py) / view.focal_px)
    x, y = projection.ray_to_plate(u, v)
    return ((x - x0) / pitch).astype(np.float32), ((y - y0) / pitch).astype(np.float32)
