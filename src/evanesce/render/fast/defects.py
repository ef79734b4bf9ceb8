"""Scatterers on the plate's top face, which send guided light to the lens without contact: dust, scratches, films.

Their light is stated relative to that of a contact: one of relative radiance 1 is as bright as the finger would be in
contact there. So it follows voltage, dead LEDs and absorption, and no absolute figure has to be invented.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import RectBivariateSpline
from scipy.ndimage import map_coordinates

from evanesce.core.provenance import digest
from evanesce.core.states import PlateLight
from evanesce.optics.edge_rays import EdgeLight, stacked_radiances
from evanesce.optics.interface import frustrated_transmittance
from evanesce.optics.led import led_positions
from evanesce.optics.patch_light import returned_radiance, window_transmittance
from evanesce.optics.path_sums import in_plate
from evanesce.optics.plate_field import AngleBins, fields_of_sums, unit_sums
from evanesce.optics.projection import Projection
from evanesce.render.fast.field_files import Folder, read_arrays, write_arrays
from evanesce.render.fast.rig_optics import edge_light, interface_of, radiances_of
from evanesce.render.kept import kept
from evanesce.rig import Scene

Array = NDArray[np.float64]

NODE_SPACING = 10.0
"""Spacing of the field's nodes [mm]: it varies over the distance of the edges."""

TABLE_SPACING = 0.2
"""Between the nodes a cubic spline is tabulated so densely [mm]: linear from there, a view of millions of rays takes a
tenth of the time, and what a field that varies over centimetres is off by is 1e-5 of it, 1e-4 beside the edges."""

EDGE_MARGIN = 0.5
"""Nodes stay this far inside the plate [mm]."""

RAYS = 1 << 12
"""From each node to the edges, whose own light is smooth; that of the LEDs is a quadrature."""

OVER_PLATE = Folder("over_plate", 256)
"""Fields over the plate, some 2 kB each: every share of power among the LEDs has its own."""


def contact_radiance(scene: Scene, x: ArrayLike, y: ArrayLike) -> Array:
    """Return the radiance towards the lens that a small contact would have at plate points; 0 off the plate.

    Parameters
    ----------
    scene : Scene
    x, y : array_like
        Points on the top face [mm], of one shape.

    Returns
    -------
    ndarray
        [W mm^-2 sr^-1].
    """
    return _over_plate(scene, x, y, _field_of)


def contact_radiance_seen(scene: Scene, light: PlateLight) -> NDArray[np.float32]:
    """Return :func:`contact_radiance` at the plate point of each pixel of the light's pinhole grid (rows, cols).

    Kept for the last few rigs, whatever the level of their LEDs.

    Parameters
    ----------
    scene : Scene
    light : PlateLight
        Its pinhole grid.
    """
    level = _level(scene)
    if level == 0.0:
        return np.zeros(light.radiance.shape, np.float32)
    key = digest([_view_key(scene, light), *_contact_parts(scene, level)])

    def make() -> NDArray[np.float32]:
        return (contact_radiance(scene, *plate_points(scene, light)) / level).astype(np.float32)

    return np.asarray(kept("contact radiance seen", key, make) * np.float32(level))


def guided_irradiance(scene: Scene, x: ArrayLike, y: ArrayLike) -> Array:
    """Return the irradiance of guided light on a face of the empty plate at points of it; 0 off the plate.

    Guided light meets both faces alike. It is that beyond the critical angle to air, up to grazing incidence.

    Parameters
    ----------
    scene : Scene
    x, y : array_like
        Points [mm], of one shape.

    Returns
    -------
    ndarray
        [W mm^-2].
    """
    return _over_plate(scene, x, y, _guided_field_of)


class _Table:
    """A smooth field over the plate, tabulated.

    Parameters
    ----------
    y, x : ndarray
        Nodes, ascending [mm].
    values : ndarray (y, x)
    """

    def __init__(self, y: Array, x: Array, values: Array) -> None:
        dense = [np.linspace(axis[0], axis[-1], math.ceil((axis[-1] - axis[0]) / TABLE_SPACING) + 1) for axis in (y, x)]
        self._first = [float(axis[0]) for axis in dense]
        self._spacing = [float(axis[1] - axis[0]) for axis in dense]
        self._values = RectBivariateSpline(y, x, values)(*dense)

    def at(self, y: Array, x: Array) -> Array:
        """Return the field at points [mm]; beyond the nodes that of the nearest."""
        places = [(p - first) / step for p, first, step in zip((y, x), self._first, self._spacing, strict=True)]
        found = map_coordinates(self._values, [p.ravel() for p in places], order=1, mode="nearest")
        return np.asarray(found).reshape(y.shape)


def _over_plate(scene: Scene, x: ArrayLike, y: ArrayLike, field_of: Callable[..., _Table]) -> Array:
    """Return a field at plate points; 0 off the plate."""
    x, y = np.broadcast_arrays(np.asarray(x, float), np.asarray(y, float))
    half_x, half_y = (size / 2 for size in scene.plate.size_mm)
    level = _level(scene)
    if level == 0.0:
        return np.zeros(x.shape)
    found = level * field_of(scene, level).at(y, x)
    on_plate = (np.abs(x) <= half_x) & (np.abs(y) <= half_y)
    return np.asarray(np.where(on_plate, np.maximum(found, 0.0), 0.0))


def _level(scene: Scene) -> float:
    """Return the mean radiance of the LEDs: one field serves all voltages while their shares stay."""
    return float(np.mean(np.concatenate(list(radiances_of(scene).values()))))


def _field_of(scene: Scene, level: float) -> _Table:
    """Return contact radiance over the plate per mean radiance of the LEDs."""
    return _kept_field(_contact_parts(scene, level), lambda: _contact_field(scene, level))


def _contact_parts(scene: Scene, level: float) -> list[Any]:
    """Return all that the radiance of a contact depends on, up to the LEDs' level."""
    optical = [scene.finger.refractive_index, scene.finger.diffuse_reflectance, scene.camera.wavelength_nm]
    return ["contact radiance 2", *_light_parts(scene, level), optical]


def _guided_field_of(scene: Scene, level: float) -> _Table:
    """Return guided irradiance over the plate per mean radiance of the LEDs."""
    return _kept_field(["guided irradiance 1", *_light_parts(scene, level)], lambda: _guided_field(scene, level))


def _light_parts(scene: Scene, level: float) -> list[Any]:
    """Return all that the guided field depends on, up to the LEDs' level."""
    shares = {e: np.round(r / level, 9).tolist() for e, r in radiances_of(scene).items()}
    positions = {e: p.tolist() for e, p in led_positions(scene.plate, scene.leds).items()}
    faces = [scene.leds.emitting_width_mm, scene.leds.emitting_height_mm, scene.leds.air_gap_share]
    return [scene.table("plate"), faces, shares, positions]


def _kept_field(parts: list[Any], compute: Callable[[], tuple[Array, Array, Array]]) -> _Table:
    """Return a field over the plate from this process, from disk, or computed."""
    key = digest(parts)

    def make() -> _Table:
        found = _read(key)
        if found is None:
            found = compute()
            write_arrays(key, dict(zip(("y", "x", "values"), found, strict=True)), OVER_PLATE)
        y, x, values = found
        return _Table(y, x, values)

    return kept("contact radiance", key, make)


def _read(key: str) -> tuple[Array, Array, Array] | None:
    """Return a field kept on disk, None where there is none that can be used."""
    arrays = read_arrays(key, ("y", "x", "values"), OVER_PLATE)
    if arrays is None:
        return None
    y, x, values = (np.asarray(array, float) for array in arrays.values())
    return (y, x, values) if values.shape == (y.size, x.size) else None


def _contact_field(scene: Scene, level: float) -> tuple[Array, Array, Array]:
    """Return nodes y, x and contact radiance (y, x) per mean radiance of the LEDs, over the plate."""
    interface = interface_of(scene)
    bins = AngleBins.of(interface.n_glass, interface.n_silicone)
    y, x, irradiance = _irradiance_by_bin(scene, bins)
    entering = frustrated_transmittance(
        bins.cosines, 0.0, interface.wavelength, interface.n_glass, interface.n_silicone
    ).mean(axis=1)
    seen = float(returned_radiance(0.0, 0.0, interface) * window_transmittance(0.0, interface.n_glass))
    seen *= math.exp(-scene.plate.absorption_coefficient_per_mm * scene.plate.thickness_mm)
    return y, x, (irradiance @ entering * seen).reshape(y.size, x.size) / level


def _guided_field(scene: Scene, level: float) -> tuple[Array, Array, Array]:
    """Return nodes y, x and guided irradiance (y, x) per mean radiance of the LEDs, over the plate."""
    n = scene.plate.refractive_index
    bins = AngleBins.of(n, n)  # up to grazing incidence
    y, x, irradiance = _irradiance_by_bin(scene, bins)
    return y, x, irradiance[:, bins.critical :].sum(axis=1).reshape(y.size, x.size) / level


def _irradiance_by_bin(scene: Scene, bins: AngleBins) -> tuple[Array, Array, Array]:
    """Return nodes y, x and the irradiance (y * x, bins) on the top face from the glass, over the plate."""
    light = edge_light(scene)
    axes = []
    for size in scene.plate.size_mm:
        half = size / 2 - EDGE_MARGIN
        axes.append(np.linspace(-half, half, max(4, math.ceil(2 * half / NODE_SPACING) + 1)))
    points = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
    # Unit light serves any share of power among the same LEDs.
    data = scene.as_dict()
    leds = [data["leds"][key] for key in ("emitting_width_mm", "emitting_height_mm")]
    positions = {edge: own.tolist() for edge, own in light.positions.items()}
    plate = {k: v for k, v in data["plate"].items() if k not in ("edge_reflectance", "absorption_coefficient_per_mm")}

    def sums_of(there: EdgeLight) -> tuple[Array, ...]:
        where = [plate, leds, positions, bins.borders.tolist(), there.absorption_coefficient, there.air_gap_share]
        return kept("plate unit light", digest(where), lambda: unit_sums(there, points, bins, rays=RAYS))

    unit = fields_of_sums(light, *in_plate(light, sums_of))
    return axes[1], axes[0], unit.irradiance(stacked_radiances(light), light.edge_reflectance)


def view_position(scene: Scene, light: PlateLight, x: ArrayLike, y: ArrayLike) -> tuple[Array, Array]:
    """Return where plate points [mm] appear on the light's pinhole grid (column, row) [px].

    Parameters
    ----------
    scene : Scene
    light : PlateLight
        Its pinhole grid.
    x, y : array_like
        Points on the top face [mm].
    """
    xn, yn = Projection.of(scene.camera, scene.plate).plate_to_ray(x, y)
    px, py = light.principal_point
    return xn * light.focal_px + px, yn * light.focal_px + py


def plate_points(scene: Scene, light: PlateLight) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return the plate point (x, y) [mm] of each pixel of the light's pinhole grid; kept for the last few rigs.

    Parameters
    ----------
    scene : Scene
    light : PlateLight
        Its pinhole grid.

    Returns
    -------
    x, y : ndarray of float32 (rows, cols)
    """

    def make() -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        rows, cols = light.radiance.shape
        px, py = light.principal_point
        u, v = np.meshgrid((np.arange(cols) - px) / light.focal_px, (np.arange(rows) - py) / light.focal_px)
        x, y = Projection.of(scene.camera, scene.plate).ray_to_plate(u, v)
        return x.astype(np.float32), y.astype(np.float32)

    return kept("plate points", _view_key(scene, light), make)


def _view_key(scene: Scene, light: PlateLight) -> str:
    """Return a digest of all that decides which plate points a light's pinhole grid shows."""
    data = scene.as_dict()
    return digest([data["camera"], data["plate"], light.radiance.shape, light.focal_px, light.principal_point])


def pixel_area(scene: Scene, light: PlateLight, u: Array, v: Array) -> Array:
    """Return the area of the contact plane [mm^2] that a pixel at (u, v) of the light's grid sees.

    Parameters
    ----------
    scene : Scene
    light : PlateLight
        Its pinhole grid.
    u, v : ndarray
        Column and row [px].
    """
    projection = Projection.of(scene.camera, scene.plate)
    px, py = light.principal_point

    def at(du: float, dv: float) -> Array:
        return np.stack(projection.ray_to_plate((u + du - px) / light.focal_px, (v + dv - py) / light.focal_px))

    across, down = at(0.5, 0.0) - at(-0.5, 0.0), at(0.0, 0.5) - at(0.0, -0.5)
    return np.asarray(np.abs(across[0] * down[1] - across[1] * down[0]))


def add_points(scene: Scene, light: PlateLight, x: Array, y: Array, flux: Array) -> PlateLight:
    """Add points of light on the contact plane.

    Parameters
    ----------
    scene : Scene
    light : PlateLight
    x, y : ndarray (points,)
        On the top face [mm].
    flux : ndarray (points,)
        Radiance times area [W sr^-1].

    Returns
    -------
    PlateLight
        Each point shared among the four pixels around it, so that radiance summed over the plane keeps ``flux`` and
        its position; what falls off the grid is dropped.
    """
    u, v = view_position(scene, light, x, y)
    rows, cols = light.radiance.shape
    inside = (u > -1) & (u < cols) & (v > -1) & (v < rows)
    u, v = u[inside], v[inside]
    weight = flux[inside] / pixel_area(scene, light, u, v)
    col, row = np.floor(u).astype(np.int64), np.floor(v).astype(np.int64)
    part_u, part_v = u - col, v - row
    added = np.zeros(rows * cols)
    for dv, share_v in ((0, 1 - part_v), (1, part_v)):
        for du, share_u in ((0, 1 - part_u), (1, part_u)):
            at_row, at_col = row + dv, col + du
            ok = (at_row >= 0) & (at_row < rows) & (at_col >= 0) & (at_col < cols)
            index = at_row[ok] * cols + at_col[ok]
            added += np.bincount(index, (weight * share_v * share_u)[ok], rows * cols)
    return replace(light, radiance=light.radiance + added.reshape(rows, cols))
