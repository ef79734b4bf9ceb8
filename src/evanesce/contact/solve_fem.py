"""From a scene's finger to the library of solved presses: which one it is, and what it cannot be."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from evanesce.contact.fem.library import LibraryPress, library_press, library_state
from evanesce.contact.fem.state import axisymmetric_contact
from evanesce.contact.patch import AxisymmetricContact
from evanesce.contact.scaling import stiffened_contact, stiffened_state
from evanesce.core.errors import InputError
from evanesce.core.states import ContactState, PlateGrid
from evanesce.materials import material
from evanesce.rig import Finger
from evanesce.rig.finger import FemLaw


def small_strain_modulus(name: str) -> float:
    """Return E* = 4 G [MPa] of an incompressible silicone from its Mooney-Rivlin fit.

    Raises
    ------
    InputError
        For a material without such a fit.
    """
    fit = material(name).mooney_rivlin
    if fit is None:
        raise InputError(f"{name!r} has no hyperelastic fit", key="finger.material", allowed="silskin_0, silskin_20")
    return 4.0 * fit.shear_modulus_MPa


def _library(finger: Finger, law: FemLaw, force: float, factor: float) -> LibraryPress:
    """Return the press that a finger asks for; refuse any other shape, material or force than were solved.

    A finger ``factor`` times as stiff takes the shape that was solved at the force over ``factor``.
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


def fem_contact(finger: Finger, law: FemLaw, force: float, factor: float = 1.0) -> AxisymmetricContact:
    """Return the smooth finger's contact at a force [N], its silicone ``factor`` times as stiff as was solved.

    Raises
    ------
    InputError
        For a finger or a force that was not solved.
    """
    press = _library(finger, law, force, factor)
    return stiffened_contact(axisymmetric_contact(press.at(force / factor), finger.length_mm), factor)


def fem_state(
    finger: Finger, law: FemLaw, force: float, grid: PlateGrid, time: float, factor: float = 1.0
) -> ContactState:
    """Return the smooth finger's contact at a force [N] on a grid, its law named ``fem``; ``factor`` as above.

    Raises
    ------
    InputError
        For a finger or a force that was not solved, or a contact that does not fit on the grid.
    """
    _library(finger, law, force, factor)
    found = library_state(finger.material, force / factor, grid, centre=finger.position_mm, bone=law.bone, time=time)
    return replace(stiffened_state(found, factor), law="fem", normal_force=force)
