"""From a scene's slide to its programme and its states: chooses friction, shaft and view. No physics of its own."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from evanesce.contact.analytic.partial_slip import tangential_modulus
from evanesce.contact.patch import AxisymmetricContact
from evanesce.contact.scaling import stiffness_factor
from evanesce.contact.sliding.friction import (
    InterfaceFriction,
    coulomb,
    interface_of,
    shaft_stiffness,
    tilted_compliance,
    tip_contact_fits,
)
from evanesce.contact.sliding.programme import SlideProgramme
from evanesce.contact.sliding.solver import march
from evanesce.contact.sliding.states import SlideStates, SlideView
from evanesce.core.errors import InputError
from evanesce.core.states import PlateGrid
from evanesce.materials import material
from evanesce.rig import Scene, Slide


def _slide(scene: Scene) -> Slide:
    if scene.slide is None:
        raise ValueError("the scene has no slide")
    return scene.slide


def slide_programme(scene: Scene) -> SlideProgramme:
    """Return what the machine does in a scene with a slide.

    Raises
    ------
    ValueError
        For a scene without one.
    """
    slide, forces = _slide(scene), scene.press.forces_N
    assert forces is not None  # Scene guarantees one force
    return SlideProgramme(
        normal_force=forces[0],
        preload=slide.preload_N,
        press_time=slide.press_time_s,
        hold_time=slide.hold_time_s,
        speed=slide.speed_mm_per_s,
        distance=slide.distance_mm,
        reciprocate=slide.reciprocate,
        frame_rate=scene.press.frame_rate_hz,
    )


def slide_states(
    scene: Scene,
    grid: PlateGrid,
    contact_law: Callable[[float], AxisymmetricContact],
    modulus: Callable[[float], float],
) -> SlideStates:
    """Return the contact states of a scene's slide; each is sampled when it is indexed.

    Parameters
    ----------
    scene : Scene
    grid : PlateGrid
    contact_law : callable
        Normal force [N] -> contact of the smooth finger.
    modulus : callable
        Normal force [N] -> E* [MPa].

    Raises
    ------
    InputError
        If friction is unknown, the shaft folds, or the contact leaves the grid or the tip.
    """
    slide, finger = _slide(scene), scene.finger
    programme = slide_programme(scene)
    times, forces, drive = programme.sample()
    known = {force: contact_law(force) for force in dict.fromkeys(forces.tolist())}
    contacts = [known[force] for force in forces.tolist()]
    angle = math.radians(slide.contact_angle_deg)
    widest = max(contact.contact_radius for contact in contacts)
    if not tip_contact_fits(widest, finger.tip_radius_mm, angle):
        raise InputError(
            f"a contact of {widest:.3g} mm leaves the tip", key="slide.contact_angle_deg", allowed="a smaller angle"
        )
    friction = _friction(scene)
    poisson = material(finger.material).poisson_ratio
    stiffness = _stiffness(scene, programme.normal_force, contacts[-1].depth, angle)
    shear = np.array([float(tangential_modulus(modulus(force), poisson)) for force in known])
    slid = march(
        contacts, times, drive, friction, np.interp(forces, list(known), shear), drive_stiffness=stiffness,
        area_loss=slide.area_loss_mm2_per_N2,
    )  # fmt: skip
    parameters = {
        "material": finger.material,
        "tip_radius_mm": finger.tip_radius_mm,
        "tau0_MPa": friction.tau0,
        "alpha": friction.alpha,
        "speed_mm_per_s": slide.speed_mm_per_s,
        "area_loss_mm2_per_N2": slide.area_loss_mm2_per_N2,
        "contact_angle_deg": slide.contact_angle_deg,
        "drive_stiffness_N_per_mm": stiffness,
    }
    view = SlideView(
        centre=finger.position_mm, direction=math.radians(slide.direction_deg), follows=not slide.glass_moves
    )
    return SlideStates(slid, grid, view, law=f"{scene.contact.law}+sliding", parameters=parameters)


def _friction(scene: Scene) -> InterfaceFriction:
    coefficient = _slide(scene).friction_coefficient
    if coefficient is not None:
        return coulomb(coefficient)
    try:
        return interface_of(scene.finger.material)
    except ValueError as error:
        raise InputError(str(error), key="slide.friction_coefficient", allowed="a coefficient") from None


def _stiffness(scene: Scene, force: float, depth: float, angle: float) -> float:
    """Return the stiffness of the shaft along the slide [N/mm]; infinite for a rigid one."""
    if _slide(scene).shaft == "rigid":
        return math.inf
    finger, silicone = scene.finger, material(scene.finger.material)
    fit = silicone.mooney_rivlin
    youngs = silicone.youngs_modulus_MPa if fit is None else fit.youngs_modulus_MPa
    youngs *= stiffness_factor(finger, force)
    # the pressed finger is shorter by its depth, where the law knows one
    length = finger.length_mm - (depth if math.isfinite(depth) else 0.0)
    column = finger.tip_radius_mm if finger.tip_radius_mm < length else 0.0
    try:
        axial, bending = shaft_stiffness(
            youngs, 0.5 * finger.diameter_mm, length, normal_force=force, tip_radius=column
        )
    except ValueError as error:
        raise InputError(
            str(error), key="slide.shaft", allowed='"rigid", a shorter finger or a smaller force'
        ) from None
    return 1.0 / float(tilted_compliance(axial, bending, angle)[0, 0])
