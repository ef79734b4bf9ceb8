"""What a frame of the fast renderer needs: the rig's fields at its LEDs' powers, and tables by gap."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from evanesce.core.provenance import digest
from evanesce.optics.edge_rays import stacked_radiances
from evanesce.optics.interface import frustrated_transmittance, internal_diffuse_reflectance
from evanesce.optics.patch_light import Interface, returned_radiance, window_transmittance
from evanesce.optics.plate_field import AngleBins
from evanesce.optics.projection import Projection
from evanesce.optics.subsurface import open_inside_reflectance
from evanesce.render.fast.flank import FlankLight
from evanesce.render.fast.flank_table import tabulated_approaches
from evanesce.render.fast.rig_fields import RigFields, node_axes, rig_digest, rig_fields
from evanesce.render.fast.rig_optics import edge_light, interface_of
from evanesce.render.fast.subsurface import Subsurface, spread_of, surface_of
from evanesce.render.kept import kept
from evanesce.render.reference.bsdf import NEAR_WAVELENGTHS
from evanesce.rig import Scene

Array = NDArray[np.float64]

MODES = 4
"""Spatial modes of the coupled field: between positions it differs mostly by a factor, little by its decay with gap.

In contact nothing is missing; in a film the fifth would add less than 1e-3 of the contact's light.
"""

GAP_STEPS = 2048
GAP_KNOTS = 513
"""Gaps at which the tables are computed; the rest by a cubic spline, to some 1e-6."""


@dataclass(frozen=True)
class Fields:
    """What a frame needs: the rig's fields for the powers of its LEDs, and tables by gap for its camera's position.

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
    ghost : float
        Share of radiance that reaches the lens after one more round trip between the faces where the glass is bare [1].
    flank : FlankLight
    rig : RigFields
    subsurface : Subsurface or None
        Scattering inside the silicone; None where light leaves where it entered.
    """

    x: Array
    y: Array
    modes: Array
    gaps: Array
    coupling: Array
    response: Array
    ghost: float
    flank: FlankLight
    rig: RigFields
    subsurface: Subsurface | None = None


@dataclass(frozen=True)
class _Tables:
    """By gap, for one interface and one position of the camera.

    Attributes
    ----------
    gaps : ndarray (GAP_STEPS,)
        [mm].
    transmitted : ndarray (bins, GAP_STEPS)
        Share of each bin's light that enters the silicone [1].
    response : ndarray (GAP_STEPS,)
        As in :class:`Fields`.
    view : float
        Angle inside the glass at which the lens sees the finger's tip [rad].
    window : float
        Radiance in air over radiance at the top face [1].
    """

    gaps: Array
    transmitted: Array
    response: Array
    view: float
    window: float


def fields_of(scene: Scene) -> Fields:
    """Return the fields of a scene, kept for the last few; another voltage costs next to nothing.

    Parameters
    ----------
    scene : Scene
    """
    radiances = stacked_radiances(edge_light(scene))
    tables, grid = _tables_digest(scene), scene.table("grid")
    scattering = scene.finger.scattering_length_mm, scene.finger.scattering_share
    key = digest([rig_digest(scene), tables, radiances.tolist(), scattering, grid])
    return kept("fields", key, lambda: _assemble(scene, radiances, tables))


def _assemble(scene: Scene, radiances: Array, tables_key: str) -> Fields:
    interface = interface_of(scene)
    rig, tables = rig_fields(scene), kept("tables", tables_key, lambda: _tables(scene))
    x, y = node_axes(scene)
    modes, coupling = _modes(np.tensordot(radiances, rig.led, 1), tables.transmitted)
    bare = 1.0 - float(window_transmittance(tables.view, interface.n_glass)) * interface.n_glass**2
    return Fields(
        x=x,
        y=y,
        modes=modes.reshape(MODES, y.size, x.size),
        gaps=tables.gaps,
        coupling=coupling,
        response=tables.response,
        ghost=bare * bare,
        flank=FlankLight(
            approaches=tabulated_approaches(scene),
            irradiance=np.tensordot(radiances, rig.flank, 1),
            per_taken=rig.flank_contact,
            response=interface.body_reflectance / np.pi * (1.0 - bare) * interface.n_glass**2 * tables.window,
        ),
        rig=rig,
        subsurface=_subsurface(scene, interface, tables, tables_key),
    )


def _modes(field: Array, transmitted: Array) -> tuple[Array, Array]:
    """Split the irradiance inside the silicone, by node and gap, into a few products of a map and a curve.

    Parameters
    ----------
    field : ndarray (points, bins)
        Irradiance on the glass side by angle [W mm^-2].
    transmitted : ndarray (bins, GAP_STEPS)
        Share that enters [1].

    Returns
    -------
    modes : ndarray (MODES, points)
        [W mm^-2].
    coupling : ndarray (MODES, GAP_STEPS)
        [1].
    """
    # Contact first, where the most light is; then the remainder by gap, which a part of the gaps determines.
    contact = field @ transmitted[:, 0]
    mean = field.sum(axis=0) @ transmitted / max(float(contact.sum()), 1e-300)
    rest = field @ transmitted[:, ::16] - contact[:, None] * mean[::16]
    left = np.linalg.svd(rest, full_matrices=False)[0][:, : MODES - 1]
    modes = np.concatenate([contact[None, :], left.T * max(float(contact.max()), 1e-300)])
    curves = left.T @ (field @ transmitted - contact[:, None] * mean) / max(float(contact.max()), 1e-300)
    return modes, np.concatenate([mean[None, :], curves])


def _subsurface(scene: Scene, interface: Interface, tables: _Tables, tables_key: str) -> Subsurface | None:
    """Return the tables of subsurface scattering; None where the finger has none."""
    length, grid = scene.finger.scattering_length_mm, scene.grid
    share = scene.finger.scattering_share
    if length <= 0 or share <= 0 or interface.body_reflectance <= 0:
        return None
    pitch = grid.size_mm / grid.samples
    body = f"{interface!r} {length:.17g} {grid.size_mm:.17g} {grid.samples}"
    beyond = open_inside_reflectance(interface.n_silicone, interface.n_glass)
    cell, spread = kept(
        "spread", body, lambda: spread_of(interface.body_reflectance, length, grid.size_mm, pitch, beyond)
    )
    inside, leave = kept(
        "subsurface", tables_key, lambda: surface_of(interface, tables.gaps, tables.view, tables.window)
    )
    return Subsurface(cell, spread, inside, leave, share)


# --- tables by gap ---------------------------------------------------------------------------------------------------


def by_gap(function: Callable[[Array], Array], gaps: Array) -> Array:
    """Return a function of the gap at all gaps of the tables, last axis; computed at a part of them.

    Parameters
    ----------
    function : callable
        Of gaps (n,), returning (..., n).
    gaps : ndarray (GAP_STEPS,)
        Evenly spaced in the square root [mm].
    """
    root = np.linspace(0.0, 1.0, GAP_KNOTS)
    return np.asarray(CubicSpline(root, function(_knots(gaps)), axis=-1)(np.sqrt(gaps / gaps[-1])))


def _knots(gaps: Array) -> Array:
    return np.asarray(gaps[-1] * np.linspace(0.0, 1.0, GAP_KNOTS) ** 2)


def _tables(scene: Scene) -> _Tables:
    interface = interface_of(scene)
    n1, n3, wavelength = interface.n_glass, interface.n_silicone, interface.wavelength
    gaps = NEAR_WAVELENGTHS * wavelength * 1e-6 * np.linspace(0.0, 1.0, GAP_STEPS) ** 2
    cosines = AngleBins.of(n1, n3).cosines

    def transmitted(g: Array) -> Array:
        return np.stack([frustrated_transmittance(c[:, None], g, wavelength, n1, n3).mean(axis=0) for c in cosines])

    def entered() -> Array:
        found = by_gap(transmitted, gaps)
        found[:, -1] = 0.0
        return found

    # A camera that moves sees the same contact under another angle.
    contact = f"{n1:.17g} {n3:.17g} {wavelength:.17g}"
    entering = kept("entering", contact, entered)
    inside = kept("inside at knots", contact, lambda: internal_diffuse_reflectance(_knots(gaps), wavelength, n1, n3))
    view = math.asin(math.sin(_mean_view_angle(scene)) / n1)
    # On its way out the light crosses the plate once more.
    window = float(window_transmittance(view, n1))
    window *= math.exp(-scene.plate.absorption_coefficient_per_mm * scene.plate.thickness_mm / math.cos(view))
    response = by_gap(lambda g: returned_radiance(g, view, interface, inside), gaps)
    return _Tables(gaps, entering, response * window, view, window)


def _tables_digest(scene: Scene) -> str:
    """Return the digest of all that :class:`_Tables` depend on."""
    interface, plate = interface_of(scene), scene.plate
    return digest([vars(interface), plate.absorption_coefficient_per_mm, plate.thickness_mm, _mean_view_angle(scene)])


def _mean_view_angle(scene: Scene) -> float:
    """Angle in air at which the lens sees the finger's tip [rad]."""
    projection = Projection.of(scene.camera, scene.plate)
    x, y = projection.plate_to_ray(*(np.array([p]) for p in scene.finger.position_mm))
    ray = projection.axes @ np.array([x[0], y[0], 1.0])
    return float(np.arccos(ray[2] / np.linalg.norm(ray)))
