"""What is lit beside the contact, for the fast renderer: flank lit by spill and haze, haze itself, a backdrop.

Nothing of it depends on the contact but where the finger hides it: images are computed once for a camera and a pattern
of LED powers, and kept. Closed forms: :mod:`evanesce.optics.spill`, :mod:`evanesce.optics.haze`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RectBivariateSpline

from evanesce.core.provenance import digest
from evanesce.core.states import ContactState
from evanesce.optics.edge_rays import EdgeLight, stacked_radiances
from evanesce.optics.flank.irradiance import flank_sums, mirrored_exchange
from evanesce.optics.flank.pressed import PressedFinger
from evanesce.optics.guided_field import EdgeExchange, edge_response, exchange_sums
from evanesce.optics.haze import FACES, clouds, haze_radiance, hazy_floor
from evanesce.optics.interface import fresnel_reflectance
from evanesce.optics.patch_light import external_diffuse_reflectance
from evanesce.optics.path_sums import in_plate
from evanesce.optics.projection import IdealView, Projection
from evanesce.optics.spill import spilled_irradiance
from evanesce.render.fast.defects import guided_irradiance
from evanesce.render.fast.flank_table import AZIMUTHS, STATIONS, positions
from evanesce.render.fast.rig_fields import PER_EDGE, plate_digest, unit_digest
from evanesce.render.fast.rig_optics import edge_light, finger_surface, geometry_digest
from evanesce.render.fast.sampling import enlarged, view_rays
from evanesce.render.kept import kept
from evanesce.rig import Scene

Array = NDArray[np.float64]
Image = NDArray[np.float32]

STEP = 4
"""Every so many pixels of a view the smooth parts are computed [px]."""

SPILL_NODES = 96
ESCAPE_NODES = 9
"""Nodes along each side of the part of a backdrop that is seen: for spill, which the finger shades, and for what leaves
the plate's top face, which is smooth."""
WHOLE_STEP = 5.0
"""To whose multiples that part is enlarged [mm]: a camera that is turned a little sees the same nodes."""


# --- the finger's flank ----------------------------------------------------------------------------------------------


def surroundings_on_flank(scene: Scene, state: ContactState, view: IdealView, step: int) -> Image:
    """Return the radiance towards the lens of the flank in the light of spill and haze [W mm^-2 sr^-1], (rows, cols).

    Seen through bare glass, diffuse; its own light that the plate mirrors back to it included. Tables by ring and
    azimuth are kept for approaches a tenth of a millimetre apart, between which it is linear.

    Parameters
    ----------
    scene : Scene
    state : ContactState
    view : IdealView
    step : int
        Every so many pixels of the view are computed.
    """
    light = edge_light(scene)
    coarse: Any = 0.0
    for depth, weight, (column, row, seen) in positions(scene, state, view, step):
        finger = pressed_finger(scene, depth)
        table = flank_irradiance_around(scene, finger, stacked_radiances(light)).astype(np.float32)
        table = np.concatenate([table, table[:, :1]], axis=1)
        station = np.interp(row, np.arange(STATIONS.size), STATIONS)
        ring = np.interp(station, finger.stations(), np.arange(len(table))).astype(np.float32)
        coarse = coarse + weight * (cv2.remap(table, column, ring, cv2.INTER_LINEAR) * seen)
    through = np.asarray(_window(scene, view) * (scene.finger.diffuse_reflectance / np.pi), np.float32)
    return enlarged(np.asarray(coarse, np.float32), step, view.shape) * enlarged(through, STEP, view.shape)


def pressed_finger(scene: Scene, depth: float) -> PressedFinger:
    """Return the finger's surface at an approach [mm].

    Parameters
    ----------
    scene : Scene
    depth : float
    """
    own = finger_surface(scene)
    return PressedFinger(own.centre, own.tip_radius, own.half_width, own.length, depth)


def flank_irradiance_around(scene: Scene, finger: PressedFinger, radiances: Array) -> Array:
    """Return the irradiance on the flank by spill and haze, (rings, azimuths) [W mm^-2].

    Parameters
    ----------
    scene : Scene
    finger : PressedFinger
    radiances : ndarray (leds,)
        Of the LEDs [W mm^-2 sr^-1].
    """
    spill, haze = _of(scene).spill, _of(scene).haze
    total: Any = np.zeros((len(finger.rings()[0]), AZIMUTHS))
    if spill.share > 0:
        height = spill.height_mm
        # Above the plate: neither its absorption nor how light enters it counts.
        clear = replace(edge_light(scene), absorption_coefficient=0.0, air_gap_share=0.0)
        where = digest([unit_digest(scene, clear), scene.finger.diffuse_reflectance, repr(finger)])
        table = kept("flank surroundings", f"spill {height} {where}", lambda: _spill_table(scene, finger, height))
        total = total + spill.share * np.tensordot(radiances, table, 1)
    if haze.top_share > 0 or haze.bottom_share > 0:
        here = float(guided_irradiance(scene, *scene.finger.position_mm))
        n = scene.plate.refractive_index
        through = (1.0 - external_diffuse_reflectance(n)) / n**2
        upwards = haze_radiance(haze.top_share, here) + haze_radiance(haze.bottom_share, here) * through
        total = total + np.pi * float(upwards) * _haze_table(scene, finger)
    return np.asarray(total)


def _spill_table(scene: Scene, finger: PressedFinger, height: float) -> Array:
    """Return irradiance per radiance of each LED, all its power spilled, (leds, rings, azimuths) [sr]."""
    points, normals = finger.points(_azimuths())
    found = spilled_irradiance(edge_light(scene), points.reshape(-1, 3), normals.reshape(-1, 3), height)
    return _with_reflections(scene, finger, found.reshape(-1, *points.shape[:-1]))


def _haze_table(scene: Scene, finger: PressedFinger) -> Array:
    """Return irradiance over pi times the even radiance of the plate around the contact (rings, azimuths) [1]; kept."""

    def make() -> Array:
        found = hazy_floor(*finger.rings(), finger.contact_radius)
        return np.asarray(_with_reflections(scene, finger, np.repeat(found[None, :, None], AZIMUTHS, axis=2))[0])

    return kept("flank surroundings", f"haze {_anywhere(scene, finger)}", make)


def _anywhere(scene: Scene, finger: PressedFinger) -> str:
    """Return the key of what depends on the flank and the plate's faces, not on where on the plate the finger is."""
    there = replace(finger, centre=(0.0, 0.0))
    return repr((there, scene.finger.diffuse_reflectance, scene.plate.refractive_index))


def _with_reflections(scene: Scene, finger: PressedFinger, irradiance: Array) -> Array:
    """Return irradiance (sources, rings, azimuths) with the flank's own light, mirrored by the plate."""
    reflectance, n = scene.finger.diffuse_reflectance, scene.plate.refractive_index
    points = finger.points(_azimuths())
    own = kept("flank exchange", _anywhere(scene, finger), lambda: mirrored_exchange(*points, reflectance, n))
    return np.asarray((irradiance.reshape(len(irradiance), -1) @ own.T).reshape(irradiance.shape))


def _azimuths() -> Array:
    return np.asarray(np.arange(AZIMUTHS) * 2 * np.pi / AZIMUTHS)


# --- images ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class SurroundingsView:
    """Radiance towards the lens of what is lit beside the finger [W mm^-2 sr^-1], each (rows, cols).

    Attributes
    ----------
    top : ndarray of float32
        Of haze on the top face; the contact hides it.
    bottom : ndarray of float32
        Of haze on the bottom face; nothing hides it.
    backdrop : ndarray of float32
        Of the backdrop; the finger hides it.
    """

    top: Image
    bottom: Image
    backdrop: Image


def surroundings_view(scene: Scene, view: IdealView, *, finger: bool) -> SurroundingsView:
    """Return what is lit beside the finger on a view; kept, up to the level of the LEDs' power.

    Parameters
    ----------
    scene : Scene
    view : IdealView
    finger : bool
        Whether it shades the backdrop.
    """
    light = edge_light(scene)
    radiances = stacked_radiances(light)
    level = float(radiances.mean())
    if level == 0.0:
        dark = np.zeros(view.shape, np.float32)
        return SurroundingsView(dark, dark, dark)
    shares = np.round(radiances / level, 9)
    parts = [unit_digest(scene), light.edge_reflectance, shares.tolist(), repr(scene.surroundings), finger]
    key = digest([geometry_digest(scene), repr(view), *parts])

    def make() -> SurroundingsView:
        top, bottom = (_haze_image(scene, view, face) / np.float32(level) for face in FACES)
        return SurroundingsView(top, bottom, _backdrop_image(scene, view, finger, shares))

    unit = kept("surroundings", key, make)
    return SurroundingsView(*(image * np.float32(level) for image in (unit.top, unit.bottom, unit.backdrop)))


def _haze_image(scene: Scene, view: IdealView, face: str) -> Image:
    """Return the radiance of haze on one face."""
    haze, plate = _of(scene).haze, scene.plate
    share = haze.top_share if face == "top" else haze.bottom_share
    if share == 0.0:
        return np.zeros(view.shape, np.float32)
    projection, (tan_x, tan_y) = _rays(scene, view)
    bend, cos_air = projection.bend(tan_x, tan_y), 1.0 / np.sqrt(1.0 + tan_x**2 + tan_y**2)
    below = 0.0 if face == "top" else plate.thickness_mm
    reach = projection.clearance + (projection.thickness - below) * bend
    x, y = projection.pinhole[0] + reach * tan_x, projection.pinhole[1] + reach * tan_y
    radiance = haze_radiance(share, guided_irradiance(scene, x, y))
    if face == "top":
        cos_glass = 1.0 / np.sqrt(1.0 + (tan_x**2 + tan_y**2) * bend**2)
        lost = np.exp(-plate.absorption_coefficient_per_mm * plate.thickness_mm / cos_glass)
        radiance = radiance * lost * (1.0 - fresnel_reflectance(cos_air, 1.0, plate.refractive_index))
        radiance = radiance / plate.refractive_index**2
    smooth = enlarged(radiance.astype(np.float32), STEP, view.shape)
    drawn = clouds(plate.size_mm, haze.contrast, haze.correlation_mm, haze.pattern, face)
    col, row = (
        enlarged(((p - first) / drawn.pitch).astype(np.float32), STEP, view.shape)
        for p, first in zip((x, y), drawn.first, strict=True)
    )
    return smooth * np.maximum(cv2.remap(drawn.factor, col, row, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT), 0.0)


def _backdrop_image(scene: Scene, view: IdealView, finger: bool, shares: Array) -> Image:
    """Return the radiance of the backdrop through both faces, per mean radiance of the LEDs."""
    backdrop = _of(scene).backdrop
    if backdrop.reflectance == 0.0:
        return np.zeros(view.shape, np.float32)
    projection, (tan_x, tan_y) = _rays(scene, view)
    reach = projection.clearance + projection.thickness * projection.bend(tan_x, tan_y) + backdrop.distance_mm
    x, y = projection.pinhole[0] + reach * tan_x, projection.pinhole[1] + reach * tan_y
    irradiance = backdrop_irradiance(scene, x, y, shares, finger=finger)
    radiance = backdrop.reflectance / np.pi * irradiance * _window(scene, view)
    return enlarged(radiance.astype(np.float32), STEP, view.shape)


def _window(scene: Scene, view: IdealView) -> Array:
    """Return the share of light from above that the bare plate lets through to the lens, every STEP-th pixel [1].

    Without what goes round between the faces once more: R^2, a fifth of a per cent.
    """
    plate = scene.plate
    projection, (tan_x, tan_y) = _rays(scene, view)
    tan2 = tan_x**2 + tan_y**2
    reflected = fresnel_reflectance(1.0 / np.sqrt(1.0 + tan2), 1.0, plate.refractive_index)
    path = plate.thickness_mm * np.sqrt(1.0 + tan2 * projection.bend(tan_x, tan_y) ** 2)
    return np.asarray((1.0 - reflected) ** 2 * np.exp(-plate.absorption_coefficient_per_mm * path))


def backdrop_irradiance(scene: Scene, x: Array, y: Array, radiances: Array, *, finger: bool) -> Array:
    """Return the irradiance on the backdrop: spill, and what leaves the plate's top face near its edges.

    Spill is shaded by the finger, taken as an upright cylinder. Light of the contact and of haze is left out: both
    stay below a tenth of what the camera sees of them directly.

    Parameters
    ----------
    scene : Scene
    x, y : ndarray
        Points of the backdrop, of one shape [mm].
    radiances : ndarray (leds,)
        Of the LEDs [W mm^-2 sr^-1].
    finger : bool
        Whether it shades.

    Returns
    -------
    ndarray
        [W mm^-2], or per unit of ``radiances``.
    """
    light, surroundings = edge_light(scene), _of(scene)
    height, found = surroundings.backdrop.distance_mm, np.zeros(x.shape)
    shadow = None
    if finger:
        half = min(scene.finger.diameter_mm / 2, scene.finger.tip_radius_mm)
        shadow = (*scene.finger.position_mm, half)
    wide_x, wide_y = (
        np.array([np.floor(p.min() / WHOLE_STEP), np.ceil(p.max() / WHOLE_STEP)]) * WHOLE_STEP for p in (x, y)
    )
    where = [height, wide_x.tolist(), wide_y.tolist()]
    if surroundings.spill.share > 0:
        axes, points, normals = _nodes(wide_x, wide_y, height, SPILL_NODES)
        band = surroundings.spill.height_mm
        clear = replace(light, absorption_coefficient=0.0, air_gap_share=0.0)
        key = digest([plate_digest(scene, clear), *where, band, shadow])
        spill = kept("spill", key, lambda: spilled_irradiance(light, points, normals, band, shadow))
        found = found + surroundings.spill.share * _between(axes, radiances @ spill, x, y, order=1)
    axes, points, normals = _nodes(wide_x, wide_y, height, ESCAPE_NODES)

    def escaping(there: EdgeLight) -> tuple[Array, ...]:
        key = digest([plate_digest(scene, there), *where])
        return kept("escape", key, lambda: flank_sums(there, points, normals, per_edge=PER_EDGE))

    def exchanged(there: EdgeLight) -> tuple[Array, ...]:
        key = plate_digest(scene, there)
        return kept("edge exchange", key, lambda: exchange_sums(there, per_edge=PER_EDGE))

    led, edge = in_plate(light, escaping)
    exchange = EdgeExchange(*in_plate(light, exchanged))
    edges = edge_response(exchange, light.edge_reflectance) @ (exchange.from_led @ radiances)
    return found + _between(axes, radiances @ led + edges @ edge, x, y, order=3)


def _nodes(x: Array, y: Array, height: float, count: int) -> tuple[tuple[Array, Array], Array, Array]:
    """Return axes of a grid that covers points, its nodes at a height and their downward normals (n, 3)."""
    axes = np.linspace(x.min(), x.max(), count), np.linspace(y.min(), y.max(), count)
    nodes = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
    points = np.concatenate([nodes, np.full((len(nodes), 1), height)], axis=1)
    return axes, points, np.tile([0.0, 0.0, -1.0], (len(nodes), 1))


def _between(axes: tuple[Array, Array], values: Array, x: Array, y: Array, *, order: int) -> Array:
    grid = values.reshape(axes[1].size, axes[0].size)
    return np.asarray(RectBivariateSpline(axes[1], axes[0], grid, kx=order, ky=order).ev(y, x))


def _rays(scene: Scene, view: IdealView) -> tuple[Projection, tuple[Array, Array]]:
    projection = Projection.of(scene.camera, scene.plate)
    return projection, projection.tangents(*view_rays(view, STEP))


def _of(scene: Scene) -> Any:
    """Return a scene's surroundings, which it must have."""
    if scene.surroundings is None:
        raise ValueError("a scene without surroundings")
    return scene.surroundings
