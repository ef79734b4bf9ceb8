"""Solve a scene's contact: the state under a normal force, or the states of its loading programme.

A press has no memory, so that each state is solved by itself (:mod:`evanesce.contact.statics`). A slide is a loading
programme with friction, whose states depend on those before: it is solved once for all its frames
(:mod:`evanesce.contact.sliding`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import cache, lru_cache
from typing import overload

from evanesce.contact.analytic.partial_slip import tangential_modulus
from evanesce.contact.analytic.roughness import persson_contact_fraction
from evanesce.contact.laws import apply_law, finger_modulus, knows_adhesion
from evanesce.contact.liquid import lubricated, wetted_state
from evanesce.contact.patch import AxisymmetricContact
from evanesce.contact.programme import press_programme, slide_programme
from evanesce.contact.rate import as_loaded, rate_factor
from evanesce.contact.ridges.heightmap import RidgeRow
from evanesce.contact.ridges.skin import ridge_row_of, skin_of
from evanesce.contact.scaling import stiffness_factor
from evanesce.contact.sliding.programme import slide_states
from evanesce.contact.sliding.shaft import shaft_stiffness, tilted_compliance, tip_contact_fits
from evanesce.contact.sliding.states import SlideStates, SlideView
from evanesce.contact.statics import pressed_state
from evanesce.core.errors import InputError
from evanesce.core.states import ContactState, PlateGrid
from evanesce.materials import silicone_of
from evanesce.materials.friction import InterfaceFriction, coulomb, interface_of
from evanesce.rig import Finger, Scene, Slide
from evanesce.rig.finger import OWN


def contact_grid(scene: Scene) -> PlateGrid:
    """Return the square grid around the finger's tip that ``scene.grid`` describes.

    Parameters
    ----------
    scene : Scene

    Returns
    -------
    PlateGrid
    """
    count = scene.grid.samples
    return PlateGrid(shape=(count, count), pitch=scene.grid.size_mm / count, centre=scene.finger.position_mm)


def check_skin(scene: Scene) -> None:
    """Refuse a scene whose ridges or height map cannot be put on its grid, before any work is done.

    Parameters
    ----------
    scene : Scene

    Raises
    ------
    InputError
    """
    skin_of(scene.finger, contact_grid(scene))


def contact_state(scene: Scene, force_N: float, *, time_s: float = 0.0) -> ContactState:
    """Return the contact of a scene's finger under a normal force.

    Parameters
    ----------
    scene : Scene
    force_N : float
        Normal force [N], not negative.
    time_s : float
        Time stamp of the state [s]; of a scene with a slide, the time of one of its frames.

    Returns
    -------
    ContactState
        On :func:`contact_grid`; ``law`` ends in ``+ridges`` or ``+height_map`` where the finger has them.

    Raises
    ------
    InputError
        If the force is impossible, the contact does not fit on the grid or the finger, the grid is too coarse for the
        ridges, the contact leaves a scan, the material is unknown, or the law has no answer for this force.
    """
    if not (math.isfinite(force_N) and force_N >= 0):
        raise InputError(f"normal force of {force_N:g} N", key="press.forces_N", allowed="a finite force, not negative")
    if scene.slide is None:
        scene = as_loaded(scene, force_N)
        state = pressed_state(scene, contact_grid(scene), force_N, time_s)
    else:
        state = _slide_frame(scene, force_N, time_s)
    _require_on_finger(scene, state)
    if scene.liquid is not None:
        state = wetted_state(state, scene.liquid)
    slope = scene.finger.roughness_rms_slope
    if slope == 0:
        return state
    fraction = persson_contact_fraction(state.pressure, finger_modulus(scene, force_N), slope)
    parameters = {**state.parameters, "roughness_rms_slope": slope}
    return replace(state, real_contact_fraction=fraction, parameters=parameters)


def contact_sequence(scene: Scene) -> Sequence[ContactState]:
    """Return the contact of every frame of a scene's loading programme, each solved when it is indexed.

    Parameters
    ----------
    scene : Scene

    Returns
    -------
    sequence of ContactState

    Raises
    ------
    InputError
        As :func:`contact_state` and :func:`~evanesce.contact.programme.press_programme`.
    """
    return _Sequence(scene, press_programme(scene))


class _Sequence(Sequence[ContactState]):
    def __init__(self, scene: Scene, programme: list[tuple[float, float]]) -> None:
        self._scene, self._programme = scene, programme

    def __len__(self) -> int:
        return len(self._programme)

    @overload
    def __getitem__(self, index: int) -> ContactState: ...
    @overload
    def __getitem__(self, index: slice) -> list[ContactState]: ...
    def __getitem__(self, index: int | slice) -> ContactState | list[ContactState]:
        if isinstance(index, slice):
            return [self[i] for i in range(*index.indices(len(self)))]
        time, force = self._programme[index]
        return contact_state(self._scene, force, time_s=time)


def ridge_row(scene: Scene) -> RidgeRow | None:
    """Return the ridges of a scene's finger; None for a smooth one.

    Parameters
    ----------
    scene : Scene

    Returns
    -------
    RidgeRow or None

    Raises
    ------
    InputError
        For a finger with a height map, which no row of ridges stands for.
    """
    if scene.finger.height_map is not None:
        raise InputError("a height map does not slide", key="finger.height_map", allowed="finger.ridges, or neither")
    return None if scene.finger.ridges is None else ridge_row_of(scene.finger.ridges)


def _require_on_finger(scene: Scene, state: ContactState) -> None:
    """Refuse a contact larger than the finger's cross-section: no law here includes the finger's side."""
    largest = math.pi * (0.5 * scene.finger.diameter_mm) ** 2
    if state.nominal_contact_area > largest:
        raise InputError(
            f"{state.normal_force:g} N would press {state.nominal_contact_area:.4g} mm^2 of contact",
            key="press.forces_N",
            allowed=f"at most the finger's cross-section of {largest:.4g} mm^2",
        )


def _slide_frame(scene: Scene, force: float, time: float) -> ContactState:
    """Return the frame of a scene's slide at a time."""
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
    return _slide_of(scene.model_dump_json())[index]


@lru_cache(maxsize=2)
def _slide_of(scene_json: str) -> SlideStates:
    """Return a scene's slide, solved once for all its frames; keyed by text because scenes hold tables."""
    return _solve_slide(Scene.model_validate_json(scene_json))


def _solve_slide(scene: Scene) -> SlideStates:
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
    stiffness = _drive_stiffness(finger, slide, programme.normal_force, contacts[-1].depth, angle)
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
    return slide_states(
        contact_grid(scene), programme, friction, contacts, moduli,
        drive_stiffness=stiffness, area_loss=slide.area_loss_mm2_per_N2, view=view,
        law=f"{scene.contact.law}+sliding", parameters=parameters,
    )  # fmt: skip


def _friction(finger: Finger, slide: Slide) -> InterfaceFriction:
    friction = _rest_friction(finger, slide)
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


def _drive_stiffness(finger: Finger, slide: Slide, force: float, depth: float, angle: float) -> float:
    """Return the stiffness of shaft and machine along the slide [N/mm]; infinite where both are rigid."""
    shaft = _shaft_stiffness(finger, slide, force, depth, angle)
    machine = slide.drive_stiffness_N_per_mm
    return shaft if machine is None else 1.0 / (1.0 / shaft + 1.0 / machine)


def _shaft_stiffness(finger: Finger, slide: Slide, force: float, depth: float, angle: float) -> float:
    if slide.shaft == "rigid":
        return math.inf
    silicone = silicone_of(finger)
    fit = silicone.mooney_rivlin
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
