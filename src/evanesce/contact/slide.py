"""A scene's slide: friction, drive and history of its loading programme, solved once for all frames."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import cache, lru_cache

import numpy as np
from numpy.typing import NDArray

from evanesce.contact.analytic.partial_slip import tangential_modulus
from evanesce.contact.laws import apply_law, finger_modulus, knows_adhesion
from evanesce.contact.liquid import lubricated
from evanesce.contact.patch import AxisymmetricContact
from evanesce.contact.programme import slide_programme
from evanesce.contact.rate import rate_factor
from evanesce.contact.ridges.ridged import require_resolved, with_ridges
from evanesce.contact.ridges.skin import ridge_row_of
from evanesce.contact.scaling import stiffness_factor
from evanesce.contact.slide_planar import PlanarSlide, in_plane
from evanesce.contact.sliding.programme import slide_states
from evanesce.contact.sliding.shaft import (
    boned_stiffness,
    shaft_stiffness,
    tilted_compliance,
    tip_contact_fits,
)
from evanesce.contact.sliding.shear_area import Share, bulging_share, peeling_share, solved_strain
from evanesce.contact.sliding.states import SlideStates, SlideView
from evanesce.core.errors import InputError
from evanesce.core.states import ContactState, PlateGrid
from evanesce.materials import silicone_of
from evanesce.materials.friction import InterfaceFriction, coulomb, interface_of
from evanesce.rig import Finger, Scene, Slide
from evanesce.rig.finger import OWN, FemLaw, HertzLaw, JkrLaw

Floats = NDArray[np.float64]

FORCES_GRID = 128
"""Samples along a side where only forces are wanted."""


def slide_frame(scene: Scene, grid: PlateGrid, force: float, time: float) -> ContactState:
    """Return the frame of a scene's slide at a time.

    Parameters
    ----------
    scene : Scene
        With a slide.
    grid : PlateGrid
    force : float
        Normal force at that time [N].
    time : float
        Of a frame [s].

    Returns
    -------
    ContactState

    Raises
    ------
    InputError
        If friction is unknown, the shaft buckles, or the contact leaves the grid or the tip.
    """
    if scene.finger.work_of_adhesion_N_per_mm > 0 and not knows_adhesion(scene):
        raise InputError(
            f"a slide under law {scene.contact.law} has no adhesion",
            key="finger.work_of_adhesion_N_per_mm",
            allowed="0, or law hertz or jkr",
        )
    times, forces, _ = slide_programme(scene).sample()
    index = round(time * scene.press.frame_rate_hz)
    if not 0 <= index < times.size or abs(times[index] - time) > 1e-6 or abs(forces[index] - force) > 1e-6:
        raise InputError(
            f"{force:g} N at {time:g} s is no frame of the slide", key="slide", allowed="a frame of its programme"
        )
    states = _slide_of(scene.model_dump_json(), grid)
    if scene.finger.ridges is None:
        return states[index]
    skin = states.skin(index) if isinstance(states, PlanarSlide) else None
    return _with_moving_ridges(scene, states[index], skin)


def slide_warnings(scene: Scene) -> tuple[str, ...]:
    """Return what is beyond what the area under shear was made of; empty for a scene without slide.

    Parameters
    ----------
    scene : Scene

    Raises
    ------
    InputError
        As :func:`slide_frame`.
    """
    law, slide = scene.contact, scene.slide
    if slide is None or slide.area_under_shear == "constant" or slide.area_loss_mm2_per_N2 > 0:
        return ()
    adheres = _work_of_adhesion(scene) > 0.0
    if in_plane(slide) and (isinstance(law, FemLaw) or adheres):
        return (
            "area stays under shear, and friction that is in proportion to it: the contact of a slide that spins or is"
            " pulled aside is round",
        )
    if isinstance(law, FemLaw):
        fit, most = silicone_of(scene.finger).mooney_rivlin, solved_strain(scene.finger.material, law.bone)
        assert fit is not None  # law fem has one
        held = slide_programme(scene).normal_force
        area = math.pi * apply_law(scene, held).contact.contact_radius ** 2
        shear = max(math.hypot(*state.tangential_force) for state in slide_forces(scene))
        strain = shear / (area * fit.shear_modulus_MPa * stiffness_factor(scene.finger, held))
        if strain > most:
            return (
                f"area under shear: mean shear strain reaches {strain:.2g}, the slides that it is made of {most:.2g};"
                " beyond, the share of area stays: frames and areas there are extrapolated",
            )
        return ()
    if not adheres or not isinstance(law, HertzLaw | JkrLaw):
        return (
            f"area stays under shear: law {law.law} knows no bulging, and no edge adheres"
            " (slide.area_loss_mm2_per_N2, finger.work_of_adhesion_N_per_mm, or law fem)",
        )
    return ()


def slide_forces(scene: Scene) -> list[ContactState]:
    """Return all frames of a scene's slide for their forces alone: on a coarse grid, the finger's ridges left out.

    Parameters
    ----------
    scene : Scene
        With a slide.

    Returns
    -------
    list of ContactState

    Raises
    ------
    InputError
        As :func:`slide_frame`.
    """
    grid = PlateGrid((FORCES_GRID, FORCES_GRID), scene.grid.size_mm / FORCES_GRID, scene.finger.position_mm)
    states = _slide_of(scene.model_dump_json(), grid)
    return [states[k] for k in range(len(states))]


def _with_moving_ridges(scene: Scene, state: ContactState, skin: tuple[Floats, Floats] | None) -> ContactState:
    """Put the finger's ridges on a frame, where they have moved with the skin."""
    slide, ridges = scene.slide, scene.finger.ridges
    assert slide is not None
    assert ridges is not None
    row, tip = ridge_row_of(ridges), float(state.parameters["tip_displacement_mm"])
    require_resolved(state.grid, row)
    angle = math.radians(slide.direction_deg)
    modulus = finger_modulus(scene, state.normal_force)
    return with_ridges(
        state, row, modulus, origin=scene.finger.position_mm, skin=skin,
        outer_slip=(tip * math.cos(angle), tip * math.sin(angle)),
    )  # fmt: skip


@lru_cache(maxsize=2)
def _slide_of(scene_json: str, grid: PlateGrid) -> SlideStates | PlanarSlide:
    """Return a scene's slide, solved once for all its frames; keyed by text because scenes hold tables."""
    return _solve_slide(Scene.model_validate_json(scene_json), grid)


def _solve_slide(scene: Scene, grid: PlateGrid) -> SlideStates | PlanarSlide:
    """Return the contact states of a scene's slide.

    Raises
    ------
    InputError
        If friction is unknown, the shaft buckles, or the contact leaves the grid or the tip.
    """
    slide, finger = scene.slide, scene.finger
    assert slide is not None  # the caller's
    programme, angle = slide_programme(scene), math.radians(slide.contact_angle_deg)

    @cache
    def pressed(force: float, factor: float) -> tuple[AxisymmetricContact, float]:
        loaded = scene.model_copy(
            update={"finger": finger.model_copy(update={"modulus_factor": factor * finger.modulus_factor})}
        )
        return apply_law(loaded, force).contact, finger_modulus(loaded, force)

    poisson = silicone_of(finger).poisson_ratio
    times, forces = (column.tolist() for column in programme.sample()[:2])
    pairs = [(force, rate_factor(scene, force, time)) for time, force in zip(times, forces, strict=True)]
    contacts = [pressed(*pair)[0] for pair in pairs]
    moduli = [float(tangential_modulus(pressed(*pair)[1], poisson)) for pair in pairs]
    widest = max(contact.contact_radius for contact in contacts)
    if not tip_contact_fits(widest, finger.tip_radius_mm, angle):
        raise InputError(
            f"a contact of {widest:.3g} mm leaves the tip", key="slide.contact_angle_deg", allowed="a smaller angle"
        )
    friction = _friction(finger, slide)
    if scene.liquid is not None:
        contact, modulus = contacts[-1], pressed(*pairs[-1])[1]
        friction = lubricated(
            friction, scene.liquid, force=contact.normal_force, area=math.pi * contact.contact_radius**2,
            radius=finger.tip_radius_mm, modulus=modulus,
        )  # fmt: skip
    stiffness = _drive_stiffness(finger, slide, programme.normal_force, contacts[-1].depth, angle, _has_bone(scene))
    if angle and (_has_bone(scene) or slide.shaft == "rigid"):
        raise InputError(
            f"{slide.contact_angle_deg:g} turns a shaft that does not bend", key="slide.contact_angle_deg",
            allowed='0, or slide.shaft = "silicone" and no bone',
        )  # fmt: skip
    if slide.stick_slip_drop and math.isinf(stiffness):
        raise InputError(
            f"{slide.stick_slip_drop:g} with a rigid drive", key="slide.stick_slip_drop",
            allowed="none, or a drive that gives way: drive_stiffness_N_per_mm",
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
        "direction_deg": slide.direction_deg,
    }
    view = SlideView(
        centre=finger.position_mm, direction=math.radians(slide.direction_deg), follows=not slide.glass_moves
    )
    law = f"{scene.contact.law}+sliding"
    if in_plane(slide):
        return PlanarSlide(
            grid, programme, slide, finger, contacts, friction, poisson=poisson,
            shear_modulus=0.25 * (2.0 - poisson) * moduli[-1], drive_stiffness=stiffness, view=view, law=law,
            parameters=parameters,
        )  # fmt: skip
    return slide_states(
        grid, programme, friction, contacts, moduli,
        drive_stiffness=stiffness, area_loss=slide.area_loss_mm2_per_N2, view=view,
        shares=_shares(scene, contacts, [pressed(*pair)[1] for pair in pairs], moduli),
        stick_slip_drop=slide.stick_slip_drop or 0.0, law=law, parameters=parameters,
    )  # fmt: skip


def _shares(
    scene: Scene, contacts: Sequence[AxisymmetricContact], moduli: Sequence[float], tangential: Sequence[float]
) -> list[Share] | None:
    """Return what shear leaves of each contact's area: an adhesive edge peels, a large strain bulges; or neither."""
    finger, law, slide = scene.finger, scene.contact, scene.slide
    assert slide is not None  # the caller's
    if slide.area_under_shear == "constant" or slide.area_loss_mm2_per_N2 > 0:
        return None
    if isinstance(law, FemLaw):
        stiff = silicone_of(finger).mooney_rivlin
        assert stiff is not None  # law fem has one

        @cache
        def bulged(radius: float, force: float) -> Share:
            return bulging_share(
                math.pi * radius**2,
                stiff.shear_modulus_MPa * stiffness_factor(finger, force),
                finger.material,
                law.bone,
            )

        return [bulged(one.contact_radius, one.normal_force) for one in contacts]
    work = _work_of_adhesion(scene)
    if work == 0.0 or not isinstance(law, HertzLaw | JkrLaw):
        return None

    @cache
    def peeled(force: float, modulus: float, stiffness: float) -> Share:
        return peeling_share(force, finger.tip_radius_mm, modulus, stiffness, work)

    return [
        peeled(one.normal_force, modulus, stiffness)
        for one, modulus, stiffness in zip(contacts, moduli, tangential, strict=True)
    ]


def _work_of_adhesion(scene: Scene) -> float:
    """Return the finger's own work of adhesion and the law's [N/mm]."""
    law = scene.contact
    own = law.work_of_adhesion_N_per_mm if isinstance(law, JkrLaw) else 0.0
    return scene.finger.work_of_adhesion_N_per_mm + own


def _friction(finger: Finger, slide: Slide) -> InterfaceFriction:
    friction = _rest_friction(finger, slide)
    if slide.friction_factor is not None:
        friction = friction.times(slide.friction_factor)
    return friction if slide.speed_exponent is None else replace(friction, speed_exponent=slide.speed_exponent)


def _rest_friction(finger: Finger, slide: Slide) -> InterfaceFriction:
    if slide.friction_coefficient is not None:
        return coulomb(slide.friction_coefficient)
    try:
        if finger.material == OWN:
            raise ValueError("no friction is known of the scene's own silicone")
        return interface_of(finger.material)
    except ValueError as error:
        raise InputError(str(error), key="slide.friction_coefficient", allowed="a coefficient") from None


def _has_bone(scene: Scene) -> bool:
    """Return whether a bone, rigid beside silicone, holds the finger: silicone alone gives way."""
    return isinstance(scene.contact, FemLaw) and scene.contact.bone != "none"


def _drive_stiffness(finger: Finger, slide: Slide, force: float, depth: float, angle: float, boned: bool) -> float:
    """Return the stiffness of shaft and machine along the slide [N/mm]; infinite where both are rigid."""
    shaft = _shaft_stiffness(finger, slide, force, depth, angle, boned)
    machine = slide.drive_stiffness_N_per_mm
    return shaft if machine is None else 1.0 / (1.0 / shaft + 1.0 / machine)


def _shaft_stiffness(finger: Finger, slide: Slide, force: float, depth: float, angle: float, boned: bool) -> float:
    if slide.shaft == "rigid":
        return math.inf
    silicone = silicone_of(finger)
    fit = silicone.mooney_rivlin
    if boned:
        assert fit is not None  # law fem has one
        return boned_stiffness(fit.shear_modulus_MPa * stiffness_factor(finger, force), finger.tip_radius_mm)
    youngs = silicone.youngs_modulus_MPa if fit is None else fit.youngs_modulus_MPa
    youngs *= stiffness_factor(finger, force)
    # the pressed finger is shorter by its depth, where the law has one
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
