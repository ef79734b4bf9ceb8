"""A scene's contact law applied to its smooth finger: round contact, reduced modulus, values worth recording.

Each law of :mod:`evanesce.rig.finger` has one entry in :data:`LAWS`. The finger may be stiffer or softer than its
material (:mod:`evanesce.contact.scaling`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from evanesce.contact.analytic.hertz import hertz_contact, reduced_modulus, scaled_hertz_contact
from evanesce.contact.analytic.jkr import jkr_contact
from evanesce.contact.analytic.xydas_kao import xydas_kao_contact
from evanesce.contact.fem.library import library_press
from evanesce.contact.fem.state import axisymmetric_contact
from evanesce.contact.fem.stored import LibraryPress
from evanesce.contact.patch import AxisymmetricContact
from evanesce.contact.scaling import stiffened_contact, stiffness_factor
from evanesce.core.errors import InputError
from evanesce.materials import Material, material, silicone_of
from evanesce.rig import Finger, Scene
from evanesce.rig.finger import OWN, FemLaw, HalfspaceLaw, HertzLaw, JkrLaw, ScaledHertzLaw, XydasKaoLaw


@dataclass(frozen=True)
class SmoothContact:
    """A smooth finger's contact under one normal force.

    Attributes
    ----------
    contact : AxisymmetricContact
    modulus : float
        E* [MPa].
    parameters : dict
        Recorded in the contact state.
    """

    contact: AxisymmetricContact
    modulus: float
    parameters: dict[str, Any]


def apply_law(scene: Scene, force: float) -> SmoothContact:
    """Apply a scene's contact law to its finger without ridges or height map.

    Parameters
    ----------
    scene : Scene
    force : float
        Normal force [N].

    Returns
    -------
    SmoothContact

    Raises
    ------
    InputError
        If the material is unknown or the law has no answer for this finger or force.
    """
    modulus, factor = finger_modulus(scene, force), stiffness_factor(scene.finger, force)
    parameters: dict[str, Any] = {"tip_radius_mm": scene.finger.tip_radius_mm, "material": scene.finger.material}
    if factor != 1.0:
        parameters["stiffness_factor"] = factor
    contact, own = LAWS[type(scene.contact)](scene, scene.contact, force, modulus, factor)
    return SmoothContact(contact, modulus, parameters | own)


def smooth_contact(scene: Scene, force_N: float) -> tuple[AxisymmetricContact, float]:
    """Return a scene's contact without its ridges, and E*.

    Parameters
    ----------
    scene : Scene
    force_N : float
        Normal force [N].

    Returns
    -------
    contact : AxisymmetricContact
    modulus : float
        E* [MPa].

    Raises
    ------
    InputError
        As :func:`apply_law`.
    """
    found = apply_law(scene, force_N)
    return found.contact, found.modulus


def finger_modulus(scene: Scene, force: float) -> float:
    """Return E* of a scene's finger with its own stiffness (:mod:`evanesce.contact.scaling`).

    Parameters
    ----------
    scene : Scene
    force : float
        Normal force [N].

    Returns
    -------
    float
        [MPa].

    Raises
    ------
    InputError
        If the material is unknown, has no hyperelastic fit for law ``fem``, or E* is not positive.
    """
    factor = stiffness_factor(scene.finger, force)
    return factor * _nominal_modulus(scene, force / factor)


def _nominal_modulus(scene: Scene, force: float) -> float:
    """Return E* [MPa]: the law's own values where it gives them, the material's otherwise.

    An intercept without a slope is a constant modulus: the slope of another fit would not belong to it.
    """
    law = scene.contact
    if isinstance(law, FemLaw):
        return law.reduced_modulus_MPa or small_strain_modulus(scene.finger.material)
    silicone = silicone_of(scene.finger)
    if silicone.by_force is not None:
        return _measured_modulus(silicone, force)
    published = silicone.flat_reduced_modulus
    intercept, slope = published.intercept_MPa, published.slope_MPa_per_N
    if not isinstance(law, XydasKaoLaw):
        if law.reduced_modulus_MPa is not None:
            intercept, slope = law.reduced_modulus_MPa, 0.0
        if law.reduced_modulus_slope_MPa_per_N is not None:
            slope = law.reduced_modulus_slope_MPa_per_N
    try:
        return float(reduced_modulus(force, intercept, slope))
    except ValueError as error:
        key = "contact.reduced_modulus_slope_MPa_per_N"
        raise InputError(f"{error} at {force:g} N", key=key, allowed="E* > 0 at every force of the programme") from None


def _measured_modulus(silicone: Material, force: float) -> float:
    """Return E* [MPa] of the scene's own columns; beyond the largest measured force nothing is known."""
    assert silicone.by_force is not None
    last = silicone.by_force.force_N[-1]
    if force > last * (1 + 1e-9):
        raise InputError(
            f"{force:g} N", key="finger.reduced_modulus.force_N", allowed=f"forces up to the last measured, {last:g} N"
        )
    return float(silicone.reduced_modulus(force))


def small_strain_modulus(name: str) -> float:
    """Return E* = 4 G of an incompressible silicone from its Mooney-Rivlin fit.

    Parameters
    ----------
    name : str
        Material.

    Returns
    -------
    float
        [MPa].

    Raises
    ------
    InputError
        For a material without such a fit.
    """
    fit = None if name == OWN else material(name).mooney_rivlin
    if fit is None:
        raise InputError(f"{name!r} has no hyperelastic fit", key="finger.material", allowed="silskin_0, silskin_20")
    return 4.0 * fit.shear_modulus_MPa


def knows_adhesion(scene: Scene) -> bool:
    """Return whether the finger's own work of adhesion enters the law's formulas: Hertz turns into JKR.

    Parameters
    ----------
    scene : Scene

    Returns
    -------
    bool
    """
    if isinstance(scene.contact, HertzLaw | JkrLaw):
        return scene.finger.is_smooth
    return isinstance(scene.contact, HalfspaceLaw)


Answer = tuple[AxisymmetricContact, dict[str, Any]]


def _hertz(scene: Scene, law: HertzLaw, force: float, modulus: float, factor: float) -> Answer:
    radius, work = scene.finger.tip_radius_mm, scene.finger.work_of_adhesion_N_per_mm
    named = {"reduced_modulus_MPa": modulus}
    if work > 0:
        return jkr_contact(force, radius, modulus, work), named | {"work_of_adhesion_N_per_mm": work}
    return hertz_contact(force, radius, modulus), named


def _scaled_hertz(scene: Scene, law: ScaledHertzLaw, force: float, modulus: float, factor: float) -> Answer:
    contact = scaled_hertz_contact(force, scene.finger.tip_radius_mm, modulus, law.area_scale)
    return contact, {"reduced_modulus_MPa": modulus, "area_scale": law.area_scale}


def _jkr(scene: Scene, law: JkrLaw, force: float, modulus: float, factor: float) -> Answer:
    work = scene.finger.work_of_adhesion_N_per_mm + law.work_of_adhesion_N_per_mm
    named = {"reduced_modulus_MPa": modulus, "work_of_adhesion_N_per_mm": work}
    return jkr_contact(force, scene.finger.tip_radius_mm, modulus, work), named


def _xydas_kao(scene: Scene, law: XydasKaoLaw, force: float, modulus: float, factor: float) -> Answer:
    # c N^gamma of a stiffer finger is c (N/factor)^gamma
    contact = xydas_kao_contact(force, scene.finger.tip_radius_mm, law.c_mm * factor**-law.gamma, law.gamma)
    return contact, {"c_mm": law.c_mm, "gamma": law.gamma}


def _halfspace(scene: Scene, law: HalfspaceLaw, force: float, modulus: float, factor: float) -> Answer:
    """Return the round contact that gives a ramp its depth.

    Ridges do not change how far the smooth tip is pressed in, adhesion as in JKR.
    """
    if law.layer_mm is not None:
        raise InputError(
            "a layer on bone has no depth in closed form", key="contact.layer_mm", allowed="forces, or a ramp in N/s"
        )
    work = law.work_of_adhesion_N_per_mm + scene.finger.work_of_adhesion_N_per_mm
    return jkr_contact(force, scene.finger.tip_radius_mm, modulus, work), {"reduced_modulus_MPa": modulus}


def _fem(scene: Scene, law: FemLaw, force: float, modulus: float, factor: float) -> Answer:
    press = solved_press(scene.finger, law, force, factor)
    contact = axisymmetric_contact(press.at(force / factor), scene.finger.length_mm)
    return stiffened_contact(contact, factor), {"reduced_modulus_MPa": modulus, "bone": law.bone}


LAWS: Mapping[type, Callable[[Scene, Any, float, float, float], Answer]] = {
    HertzLaw: _hertz,
    ScaledHertzLaw: _scaled_hertz,
    JkrLaw: _jkr,
    XydasKaoLaw: _xydas_kao,
    HalfspaceLaw: _halfspace,
    FemLaw: _fem,
}
"""By law: (scene, law, force [N], E* [MPa], stiffness factor) -> round contact and the parameters to record."""


def solved_press(finger: Finger, law: FemLaw, force: float, factor: float = 1.0) -> LibraryPress:
    """Return the solved press of a finger; refuse any other shape, material or force than were solved.

    Parameters
    ----------
    finger : Finger
    law : FemLaw
    force : float
        [N].
    factor : float
        Stiffness over the solved material's; such a finger takes the shape that was solved at force/factor.

    Returns
    -------
    LibraryPress

    Raises
    ------
    InputError
        For a finger or a force that was not solved.
    """
    small_strain_modulus(finger.material)
    press = library_press(finger.material, law.bone)
    shape: Mapping[str, Any] = press.inputs["shape"]
    for key in ("tip_radius", "diameter", "length"):
        value, solved = getattr(finger, f"{key}_mm"), float(shape[key])
        if abs(value - solved) > 1e-9 * solved:
            allowed = f"{solved:g}, the finger that was solved (others: `evanesce fem press`)"
            raise InputError(f"{value:g} mm with law fem", key=f"finger.{key}_mm", allowed=allowed)
    low, high = factor * float(press.force[0]), factor * float(press.force[-1])
    if not low * (1 - 1e-9) <= force <= high * (1 + 1e-9):
        stiff = "" if factor == 1.0 else f" and a finger {factor:.4g} times as stiff"
        allowed = f"{low:g} to {high:g} N with law fem{stiff}"
        raise InputError(f"normal force of {force:g} N", key="press.forces_N", allowed=allowed)
    return press
