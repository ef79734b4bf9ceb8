"""What is lit beside the contact, for the fast renderer: flank lit by spill and haze, haze itself, a backdrop.

Nothing of it depends on the contact but where the finger hides it: images are computed once for a camera and a pattern
of LED powers, and kept. Closed forms: :mod:`evanesce.optics.spill`, :mod:`evanesce.optics.haze`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RectBivariateSpline

from evanesce.core.provenance import digest
from evanesce.optics.edge_rays import stacked_radiances
from evanesce.optics.flank.irradiance import flank_irradiance, mirrored_exchange
from evanesce.optics.guided_field import EdgeExchange, edge_response
from evanesce.optics.haze import FACES, clouds, haze_radiance, hazy_floor
from evanesce.optics.interface import fresnel_reflectance
from evanesce.optics.patch_light import external_diffuse_reflectance
from evanesce.optics.projection import IdealView, Projection
from evanesce.optics.spill import spilled_irradiance
from evanesce.render.fast.defects import guided_irradiance
from evanesce.render.fast.flank_table import table_points, tabulated_approaches
from evanesce.render.fast.rig_fields import PER_EDGE, unit_digest, unit_light
from evanesce.render.fast.rig_optics import edge_light, geometry_digest
from evanesce.render.fast.sampling import enlarged, view_rays
from evanesce.render.kept import kept
from evanesce.rig import Scene

Array = NDArray[np.float64]
Image = NDArray[np.float32]

STEP = 4
"""Every so many pixels of a view the smooth parts are computed [px]."""

SPILL_NODES = 64
ESCAPE_NODES = 9
"""Nodes along each side of the part of a backdrop that is seen: for spill, which the finger shades, and for what leaves
the plate's top face, which is smooth."""


# --- the finger's flank ----------------------------------------------------------------------------------------------


def flank_surroundings(scene: Scene, radiances: Array) -> Array:
    """Return the irradiance that spill and haze add on the flank, reflections between it and the plate included.

    Parameters
    ----------
    scene : Scene
    radiances : ndarray (leds,)
        Of the LEDs [W mm^-2 sr^-1].

    Returns
    -------
    ndarray (approaches, stations, azimuths)
        [W mm^-2].
    """
    spill, haze = _of(scene).spill, _of(scene).haze
    total = np.zeros(table_points(scene)[0].shape[:-1])
    if spill.share > 0:
        total += spill.share * np.tensordot(radiances, _spill_table(scene), 1)
    if haze.top_share > 0 or haze.bottom_share > 0:
        here = float(guided_irradiance(scene, *scene.finger.position_mm))
        n = scene.plate.refractive_index
        through = (1.0 - external_diffuse_reflectance(n)) / n**2
        upwards = haze_radiance(haze.top_share, here) + haze_radiance(haze.bottom_share, here) * through
        total += np.pi * upwards * _haze_table(scene)
    return total


def flank_digest(scene: Scene) -> str:
    """Return the digest of all that :func:`flank_surroundings` depends on beside rig and powers; empty for none.

    Parameters
    ----------
    scene : Scene
    """
    return "" if scene.surroundings is None else repr(scene.surroundings)


def _spill_table(scene: Scene) -> Array:
    """Return irradiance on the flank per radiance of each LED, all its power spilled (leds, approaches, ...) [sr]."""
    height, reflectance = _of(scene).spill.height_mm, scene.finger.diffuse_reflectance

    def make() -> Array:
        points, normals = table_points(scene)
        found = spilled_irradiance(edge_light(scene), points.reshape(-1, 3), normals.reshape(-1, 3), height)
        return _with_reflections(scene, found.reshape(-1, *points.shape[:-1]))

    return kept("flank surroundings", digest(["spill", unit_digest(scene), height, reflectance]), make)


def _haze_table(scene: Scene) -> Array:
    """Return irradiance on the flank over pi times the even radiance of the plate around the contact [1]."""

    def make() -> Array:
        points, normals = table_points(scene)
        first = points[:, :, 0], normals[:, :, 0]
        axis = np.array(scene.finger.position_mm)
        found = np.zeros(points.shape[:-1])
        for k, depth in enumerate(tabulated_approaches(scene)):
            hole = float(np.sqrt(max(2 * scene.finger.tip_radius_mm * depth - depth**2, 0.0)))
            distance = np.hypot(*(first[0][k, :, :2] - axis).T)
            polar = np.arccos(np.clip(-first[1][k, :, 2], -1.0, 1.0))
            found[k] = hazy_floor(distance, first[0][k, :, 2], polar, hole)[:, None]
        return _with_reflections(scene, found[None])[0]

    return kept("flank surroundings", digest(["haze", unit_digest(scene), scene.finger.diffuse_reflectance]), make)


def _with_reflections(scene: Scene, irradiance: Array) -> Array:
    """Return irradiance (sources, approaches, stations, azimuths) with the flank's own light, mirrored by the plate."""
    points, normals = table_points(scene)
    found = np.empty(irradiance.shape)
    for k in range(points.shape[0]):
        own = mirrored_exchange(points[k], normals[k], scene.finger.diffuse_reflectance, scene.plate.refractive_index)
        found[:, k] = (irradiance[:, k].reshape(len(irradiance), -1) @ own.T).reshape(irradiance[:, k].shape)
    return found


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
        haze = [_haze_image(scene, view, face) / np.float32(level) for face in FACES]
        return SurroundingsView(*haze, _backdrop_image(scene, view, finger, shares))

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
    backdrop, plate = _of(scene).backdrop, scene.plate
    if backdrop.reflectance == 0.0:
        return np.zeros(view.shape, np.float32)
    projection, (tan_x, tan_y) = _rays(scene, view)
    bend, cos_air = projection.bend(tan_x, tan_y), 1.0 / np.sqrt(1.0 + tan_x**2 + tan_y**2)
    reach = projection.clearance + projection.thickness * bend + backdrop.distance_mm
    x, y = projection.pinhole[0] + reach * tan_x, projection.pinhole[1] + reach * tan_y
    irradiance = backdrop_irradiance(scene, x, y, shares, finger=finger)
    cos_glass = 1.0 / np.sqrt(1.0 + (tan_x**2 + tan_y**2) * bend**2)
    through = (1.0 - fresnel_reflectance(cos_air, 1.0, plate.refractive_index)) ** 2
    through = through * np.exp(-plate.absorption_coefficient_per_mm * plate.thickness_mm / cos_glass)
    radiance = backdrop.reflectance / np.pi * irradiance * through
    return enlarged(radiance.astype(np.float32), STEP, view.shape)


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
    if surroundings.spill.share > 0:
        axes, points, normals = _nodes(x, y, height, SPILL_NODES)
        lit = radiances @ spilled_irradiance(light, points, normals, surroundings.spill.height_mm, shadow)
        found = found + surroundings.spill.share * _between(axes, lit, x, y, order=1)
    axes, points, normals = _nodes(x, y, height, ESCAPE_NODES)
    led, edge = flank_irradiance(light, points, normals, per_edge=PER_EDGE)
    unit = unit_light(scene)
    exchange = EdgeExchange(unit.edge_from_led.astype(float), unit.edge_from_edge.astype(float))
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
