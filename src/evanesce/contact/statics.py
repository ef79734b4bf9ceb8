"""Contact of a scene's finger under a normal force alone: its law, relief and adhesion on the contact grid."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.contact.fem.library import library_state
from evanesce.contact.halfspace.adhered import adhered_contact, adhered_state
from evanesce.contact.halfspace.resolved import Adhesion, pressed_profile, resolved_state
from evanesce.contact.laws import apply_law, finger_modulus, knows_adhesion, solved_press
from evanesce.contact.patch import axisymmetric_state, radii
from evanesce.contact.ridges.ridged import ridged_state
from evanesce.contact.ridges.skin import Skin, require_within_scan, ridge_row_of, skin_of
from evanesce.contact.scaling import stiffened_state, stiffness_factor
from evanesce.contact.tilt import require_on_tip, tilt_of, tilted_heights, turned_skin
from evanesce.core.errors import InputError
from evanesce.core.states import ContactState, PlateGrid
from evanesce.rig import Scene
from evanesce.rig.finger import FemLaw, HalfspaceLaw, JkrLaw


def pressed_state(scene: Scene, grid: PlateGrid, force: float, time: float = 0.0) -> ContactState:
    """Press a scene's finger with a normal force, without friction's history.

    Parameters
    ----------
    scene : Scene
        Its slide is ignored.
    grid : PlateGrid
    force : float
        [N], not negative.
    time : float
        [s].

    Returns
    -------
    ContactState

    Raises
    ------
    InputError
        If the contact does not fit on the grid, the grid is too coarse for the ridges, the contact leaves a scan, or
        the law has no answer for this finger or force.
    """
    if scene.finger.work_of_adhesion_N_per_mm > 0 and not knows_adhesion(scene):
        return _with_adhesion(scene, grid, force, time)
    return _by_law(scene, grid, force, time)


def _by_law(scene: Scene, grid: PlateGrid, force: float, time: float) -> ContactState:
    """Return the law's contact, with the adhesion that the law itself includes."""
    if isinstance(scene.contact, FemLaw):
        return _fem(scene, scene.contact, grid, force, time)
    if isinstance(scene.contact, HalfspaceLaw):
        return _halfspace(scene, scene.contact, grid, force, time)
    return _analytic(scene, grid, force, time)


def _analytic(scene: Scene, grid: PlateGrid, force: float, time: float) -> ContactState:
    found = apply_law(scene, force)
    contact, modulus, parameters = found.contact, found.modulus, found.parameters
    require_on_tip(scene, contact.contact_radius)
    if scene.contact.tilt_deg:
        parameters |= {"tilt_deg": scene.contact.tilt_deg}
    centre, law, ridges = scene.finger.position_mm, scene.contact.law, scene.finger.ridges
    if not scene.finger.is_smooth and isinstance(scene.contact, JkrLaw):
        allowed = "hertz, scaled_hertz, xydas_kao, halfspace, fem"
        raise InputError("a relief on the tip needs a law without adhesion", key="contact.law", allowed=allowed)
    if ridges is None:
        smooth = axisymmetric_state(grid, centre, contact, law=law, parameters=parameters, time=time)
        skin = None if scene.finger.is_smooth else skin_of(turned_skin(scene), grid)
        return smooth if skin is None else _with_relief(scene, smooth, skin, modulus, parameters)
    if ridges.rounding_um is not None:
        allowed = 'law "halfspace", or no rounding'
        raise InputError("the first ridged model has its own shape", key="finger.ridges.rounding_um", allowed=allowed)
    if scene.contact.tilt_deg:
        raise InputError(
            "the first ridged model stands upright", key="contact.tilt_deg", allowed='law "halfspace", or 0'
        )
    row = ridge_row_of(ridges)
    parameters |= row.parameters()
    try:
        return ridged_state(grid, centre, contact, row, modulus, law=f"{law}+ridges", parameters=parameters, time=time)
    except InputError:
        raise
    except ValueError as error:
        raise InputError(str(error), key="finger.ridges") from None


def _halfspace(scene: Scene, law: HalfspaceLaw, grid: PlateGrid, force: float, time: float) -> ContactState:
    modulus = finger_modulus(scene, force)
    upright = tilt_of(scene)[0] == 0.0
    heights = (
        radii(grid, scene.finger.position_mm) ** 2 / (2.0 * scene.finger.tip_radius_mm)
        if upright
        else tilted_heights(scene, grid)
    )
    parameters: dict[str, Any] = {
        "tip_radius_mm": scene.finger.tip_radius_mm,
        "material": scene.finger.material,
        "reduced_modulus_MPa": modulus,
    }
    if not upright:
        parameters |= {"tilt_deg": law.tilt_deg}
    if law.layer_mm is not None:
        parameters["layer_mm"] = law.layer_mm
    skin = skin_of(turned_skin(scene), grid)
    if skin is not None and law.skin_modulus_MPa is not None:
        # two scales: tissue on bone carries the finger, a stiffer skin its relief
        smooth = resolved_state(
            grid, heights, modulus, force, law=law.law, layer=law.layer_mm, parameters=parameters, time=time
        )
        return _with_relief(
            scene, smooth, skin, law.skin_modulus_MPa, parameters | {"skin_modulus_MPa": law.skin_modulus_MPa}
        )
    if skin is not None:
        heights = heights + skin.depth
        parameters |= skin.parameters
    work = law.work_of_adhesion_N_per_mm + scene.finger.work_of_adhesion_N_per_mm
    adhesion = Adhesion(work, law.cohesive_stress_MPa)
    name = law.law if skin is None else f"{law.law}+{skin.name}"
    state = resolved_state(
        grid, heights, modulus, force, law=name, adhesion=adhesion, layer=law.layer_mm, parameters=parameters, time=time
    )
    return state if skin is None else require_within_scan(state, skin)


def _fem(scene: Scene, law: FemLaw, grid: PlateGrid, force: float, time: float) -> ContactState:
    """Return the library's press; a relief on it closes as on a half-space of the local stiffness."""
    tilt_of(scene)  # refuses one
    finger, factor = scene.finger, stiffness_factor(scene.finger, force)
    solved_press(finger, law, force, factor)
    found = library_state(finger.material, force / factor, grid, centre=finger.position_mm, bone=law.bone, time=time)
    smooth = replace(stiffened_state(found, factor), law="fem", normal_force=force)
    skin = skin_of(finger, grid)
    if skin is None:
        return smooth
    modulus = finger_modulus(scene, force)
    return _with_relief(scene, smooth, skin, modulus, {**smooth.parameters, "reduced_modulus_MPa": modulus})


def _with_relief(
    scene: Scene, smooth: ContactState, skin: Skin, modulus: float, parameters: Mapping[str, Any]
) -> ContactState:
    """Return a smooth contact with a relief on it, which closes as on a half-space of the local stiffness."""
    state = resolved_state(
        smooth.grid, _halfspace_heights(smooth, skin, modulus), modulus, smooth.normal_force,
        law=f"{scene.contact.law}+{skin.name}", parameters={**parameters, **skin.parameters}, time=smooth.time,
    )  # fmt: skip
    # the half-space's own approach is not the finger's
    return require_within_scan(replace(state, depth=smooth.depth), skin)


def _halfspace_heights(smooth: ContactState, skin: Skin, modulus: float) -> NDArray[np.float64]:
    """Return the height map [mm] of a half-space that makes a given smooth contact, with a relief on it."""
    pressure, gap = np.asarray(smooth.pressure, dtype=float), np.asarray(smooth.gap, dtype=float)
    return pressed_profile(pressure, gap, skin.depth, smooth.grid.pitch, modulus)


def _with_adhesion(scene: Scene, grid: PlateGrid, force: float, time: float) -> ContactState:
    """Return the contact by a law that has no adhesion, with the finger's own added."""
    work, modulus = scene.finger.work_of_adhesion_N_per_mm, finger_modulus(scene, force)
    dry_finger = scene.finger.model_copy(update={"work_of_adhesion_N_per_mm": 0.0})
    dry = scene.model_copy(update={"finger": dry_finger})
    smooth_finger = dry_finger.model_copy(update={"ridges": None, "height_map": None, "fingerprint": None})
    smooth, skin = dry.model_copy(update={"finger": smooth_finger}), skin_of(turned_skin(scene), grid)
    if skin is None:
        contact, dry_force = adhered_contact(lambda load: apply_law(smooth, load).contact, force, modulus, work)
        state = _by_law(smooth, grid, dry_force, time)
        named = {**state.parameters, "work_of_adhesion_N_per_mm": work, "dry_force_N": dry_force}
        adhesive = axisymmetric_state(grid, scene.finger.position_mm, contact, law=state.law)
        fields = ("pressure", "gap", "contact_mask", "normal_force", "nominal_contact_area", "depth")
        return replace(state, **{name: getattr(adhesive, name) for name in fields}, parameters=named)
    heights = _halfspace_heights(_by_law(smooth, grid, force, time), skin, modulus)
    return require_within_scan(adhered_state(_by_law(dry, grid, force, time), heights, modulus, Adhesion(work)), skin)
