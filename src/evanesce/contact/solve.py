"""From a scene to its contact: chooses the law, the grid and the loading programme. No physics of its own."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any, overload

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from evanesce.contact.analytic.hertz import hertz_contact, reduced_modulus, scaled_hertz_contact
from evanesce.contact.analytic.jkr import jkr_contact
from evanesce.contact.analytic.roughness import persson_contact_fraction
from evanesce.contact.analytic.xydas_kao import xydas_kao_contact
from evanesce.contact.halfspace.adhered import adhered_contact, adhered_state
from evanesce.contact.halfspace.resolved import Adhesion, pressed_profile, resolved_state
from evanesce.contact.patch import AxisymmetricContact, axisymmetric_state, radii
from evanesce.contact.ridges.heightmap import RidgeRow
from evanesce.contact.ridges.ridged import ridged_state
from evanesce.contact.ridges.skin import Skin, require_within_scan, ridge_parameters, ridge_row_of, skin_of
from evanesce.contact.scaling import stiffness_factor
from evanesce.contact.sliding.states import SlideStates
from evanesce.contact.solve_fem import fem_contact, fem_state, small_strain_modulus
from evanesce.contact.solve_slide import slide_programme, slide_states
from evanesce.core.errors import InputError
from evanesce.core.states import ContactState, PlateGrid
from evanesce.materials import material
from evanesce.rig import Scene
from evanesce.rig.finger import FemLaw, HalfspaceLaw, HertzLaw, JkrLaw, ScaledHertzLaw, XydasKaoLaw


def contact_grid(scene: Scene) -> PlateGrid:
    """Return the square grid around the finger's tip that ``scene.grid`` describes."""
    count = scene.grid.samples
    return PlateGrid(shape=(count, count), pitch=scene.grid.size_mm / count, centre=scene.finger.position_mm)


def check_skin(scene: Scene) -> None:
    """Refuse a scene whose ridges or height map cannot be put on its grid, before any work is done.

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
        Time stamp of the state [s].

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
    if scene.slide is not None:
        state = _sliding_state(scene, force_N, time_s)
    elif scene.finger.work_of_adhesion_N_per_mm > 0 and not _knows_adhesion(scene):
        state = _adhesive_state(scene, force_N, time_s)
    else:
        state = _state_by_law(scene, force_N, time_s)
    _require_on_finger(scene, state)
    slope = scene.finger.roughness_rms_slope
    if slope == 0:
        return state
    fraction = persson_contact_fraction(state.pressure, _modulus(scene, force_N), slope)
    parameters = {**state.parameters, "roughness_rms_slope": slope}
    return replace(state, real_contact_fraction=fraction, parameters=parameters)


def _state_by_law(scene: Scene, force: float, time: float) -> ContactState:
    """Return what the scene's law says, with the adhesion that the law knows of."""
    if isinstance(scene.contact, FemLaw):
        return _fem_state(scene, scene.contact, force, time)
    if isinstance(scene.contact, HalfspaceLaw):
        return _halfspace_state(scene, scene.contact, force, time)
    return _analytic_state(scene, force, time)


def _adhesive_state(scene: Scene, force: float, time: float) -> ContactState:
    """Return the contact under a law that knows no adhesion, with the finger's own on top."""
    work, modulus = scene.finger.work_of_adhesion_N_per_mm, _modulus(scene, force)
    grid, centre = contact_grid(scene), scene.finger.position_mm
    dry_finger = scene.finger.model_copy(update={"work_of_adhesion_N_per_mm": 0.0})
    dry = scene.model_copy(update={"finger": dry_finger})
    smooth, skin = _without_skin(dry), skin_of(scene.finger, grid)
    if skin is None:
        contact, dry_force = adhered_contact(lambda load: _smooth(smooth, load)[0], force, modulus, work)
        state = _state_by_law(smooth, dry_force, time)
        named = {**state.parameters, "work_of_adhesion_N_per_mm": work, "dry_force_N": dry_force}
        adhesive = axisymmetric_state(grid, centre, contact, law=state.law)
        fields = ("pressure", "gap", "contact_mask", "normal_force", "nominal_contact_area", "depth")
        return replace(state, **{name: getattr(adhesive, name) for name in fields}, parameters=named)
    base = _state_by_law(smooth, force, time)
    heights = _on_pressed(base, skin, modulus)
    return require_within_scan(adhered_state(_state_by_law(dry, force, time), heights, modulus, Adhesion(work)), skin)


def _without_skin(scene: Scene) -> Scene:
    """Return the scene with a smooth finger."""
    smooth = scene.finger.model_copy(update={"ridges": None, "height_map": None})
    return scene.model_copy(update={"finger": smooth})


def _on_pressed(smooth: ContactState, skin: Skin, modulus: float) -> NDArray[np.float64]:
    """Return the height map [mm] that stands for a relief on a smooth contact that is known."""
    pressure, gap = np.asarray(smooth.pressure, dtype=float), np.asarray(smooth.gap, dtype=float)
    return pressed_profile(pressure, gap, skin.depth, smooth.grid.pitch, modulus)


def _skinned(
    scene: Scene, smooth: ContactState, skin: Skin, modulus: float, parameters: Mapping[str, Any]
) -> ContactState:
    """Return a smooth contact with a relief on it, which closes as on a half-space of the local stiffness."""
    state = resolved_state(
        smooth.grid, _on_pressed(smooth, skin, modulus), modulus, smooth.normal_force,
        law=f"{scene.contact.law}+{skin.name}", parameters={**parameters, **skin.parameters}, time=smooth.time,
    )  # fmt: skip
    # the half-space's own approach is not the finger's
    return require_within_scan(replace(state, depth=smooth.depth), skin)


def _knows_adhesion(scene: Scene) -> bool:
    """Tell whether the finger's own work of adhesion enters the law's formulas: Hertz turns into JKR."""
    if isinstance(scene.contact, HertzLaw | JkrLaw):
        return scene.finger.is_smooth
    return isinstance(scene.contact, HalfspaceLaw)


def _require_on_finger(scene: Scene, state: ContactState) -> None:
    """Refuse a contact larger than the finger's cross-section: no law here knows of the finger's side."""
    largest = math.pi * (0.5 * scene.finger.diameter_mm) ** 2
    if state.nominal_contact_area > largest:
        raise InputError(
            f"{state.normal_force:g} N would press {state.nominal_contact_area:.4g} mm^2 of contact",
            key="press.forces_N",
            allowed=f"at most the finger's cross-section of {largest:.4g} mm^2",
        )


def _analytic_state(scene: Scene, force: float, time: float) -> ContactState:
    contact, modulus, parameters = _smooth(scene, force)
    grid, centre, law = contact_grid(scene), scene.finger.position_mm, scene.contact.law
    ridges, scan = scene.finger.ridges, scene.finger.height_map
    if not scene.finger.is_smooth and isinstance(scene.contact, JkrLaw):
        allowed = "hertz, scaled_hertz, xydas_kao, halfspace, fem"
        raise InputError("a relief on the tip needs a law without adhesion", key="contact.law", allowed=allowed)
    if ridges is None:
        smooth = axisymmetric_state(grid, centre, contact, law=law, parameters=parameters, time=time)
        skin = None if scan is None else skin_of(scene.finger, grid)
        return smooth if skin is None else _skinned(scene, smooth, skin, modulus, parameters)
    if ridges.rounding_um is not None:
        allowed = 'law "halfspace", or no rounding'
        raise InputError("the first ridged model has its own shape", key="finger.ridges.rounding_um", allowed=allowed)
    row = ridge_row_of(ridges)
    parameters |= ridge_parameters(row)
    try:
        return ridged_state(grid, centre, contact, row, modulus, law=f"{law}+ridges", parameters=parameters, time=time)
    except InputError:
        raise
    except ValueError as error:
        raise InputError(str(error), key="finger.ridges") from None


def _halfspace_state(scene: Scene, law: HalfspaceLaw, force: float, time: float) -> ContactState:
    grid, centre, modulus = contact_grid(scene), scene.finger.position_mm, _modulus(scene, force)
    heights = radii(grid, centre) ** 2 / (2.0 * scene.finger.tip_radius_mm)
    parameters: dict[str, Any] = {
        "tip_radius_mm": scene.finger.tip_radius_mm,
        "material": scene.finger.material,
        "reduced_modulus_MPa": modulus,
    }
    skin = skin_of(scene.finger, grid)
    if skin is not None:
        heights = heights + skin.depth
        parameters |= skin.parameters
    work = law.work_of_adhesion_N_per_mm + scene.finger.work_of_adhesion_N_per_mm
    adhesion = Adhesion(work, law.cohesive_stress_MPa)
    name = law.law if skin is None else f"{law.law}+{skin.name}"
    state = resolved_state(grid, heights, modulus, force, law=name, adhesion=adhesion, parameters=parameters, time=time)
    return state if skin is None else require_within_scan(state, skin)


def _fem_state(scene: Scene, law: FemLaw, force: float, time: float) -> ContactState:
    """Return the library's press; ridges ride on it as on a half-space of the local stiffness."""
    grid = contact_grid(scene)
    smooth = fem_state(scene.finger, law, force, grid, time, stiffness_factor(scene.finger, force))
    skin = skin_of(scene.finger, grid)
    if skin is None:
        return smooth
    modulus = _modulus(scene, force)
    return _skinned(scene, smooth, skin, modulus, {**smooth.parameters, "reduced_modulus_MPa": modulus})


def contact_sequence(scene: Scene) -> Sequence[ContactState]:
    """Return the contact of every frame of a scene's programme, each made when it is asked for.

    Parameters
    ----------
    scene : Scene

    Raises
    ------
    InputError
        As :func:`contact_state` and :func:`press_programme`.
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


@lru_cache(maxsize=2)
def _slide_of(scene_json: str) -> SlideStates:
    """Return a scene's slide, marched once for all its frames; keyed by text because scenes hold tables."""
    scene = Scene.model_validate_json(scene_json)
    return slide_states(
        scene, contact_grid(scene), lambda force: _smooth(scene, force)[0], lambda force: _modulus(scene, force)
    )


def _sliding_state(scene: Scene, force: float, time: float) -> ContactState:
    """Return the frame of a scene's slide that is seen at a time."""
    if scene.finger.work_of_adhesion_N_per_mm > 0 and not _knows_adhesion(scene):
        raise InputError(
            f"a slide under law {scene.contact.law} knows no adhesion",
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


def _modulus(scene: Scene, force: float) -> float:
    """Return E* [MPa] of the finger as stiff as it is (:mod:`evanesce.contact.scaling`)."""
    factor = stiffness_factor(scene.finger, force)
    return factor * _nominal_modulus(scene, force / factor)


def _nominal_modulus(scene: Scene, force: float) -> float:
    """Return E* [MPa]: the law's own figures where it gives them, the material's otherwise.

    An intercept without a slope is a constant modulus: the slope of another fit would not belong to it.
    """
    law = scene.contact
    if isinstance(law, FemLaw):
        return law.reduced_modulus_MPa or small_strain_modulus(scene.finger.material)
    published = material(scene.finger.material).flat_reduced_modulus
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


def smooth_contact(scene: Scene, force_N: float) -> tuple[AxisymmetricContact, float]:
    """Return a scene's contact without its ridges, and E* [MPa], under a normal force [N]."""
    return _smooth(scene, force_N)[:2]


def ridge_row(scene: Scene) -> RidgeRow | None:
    """Return the ridges of a scene's finger; None for a smooth one.

    Raises
    ------
    InputError
        For a finger with a height map, which no row of ridges stands for.
    """
    if scene.finger.height_map is not None:
        raise InputError("a height map does not slide", key="finger.height_map", allowed="finger.ridges, or neither")
    return None if scene.finger.ridges is None else ridge_row_of(scene.finger.ridges)


def _smooth(scene: Scene, force: float) -> tuple[AxisymmetricContact, float, dict[str, Any]]:
    """Return the smooth finger's contact, E* [MPa] and the parameters worth recording."""
    law, radius = scene.contact, scene.finger.tip_radius_mm
    modulus, factor = _modulus(scene, force), stiffness_factor(scene.finger, force)
    work = scene.finger.work_of_adhesion_N_per_mm
    parameters: dict[str, Any] = {"tip_radius_mm": radius, "material": scene.finger.material}
    if factor != 1.0:
        parameters["stiffness_factor"] = factor
    if isinstance(law, XydasKaoLaw):
        parameters |= {"c_mm": law.c_mm, "gamma": law.gamma}
        # c N^gamma of a stiffer finger is c (N/factor)^gamma
        contact = xydas_kao_contact(force, radius, law.c_mm * factor**-law.gamma, law.gamma)
        return contact, modulus, parameters
    parameters["reduced_modulus_MPa"] = modulus
    match law:
        case HertzLaw() if work > 0:
            parameters["work_of_adhesion_N_per_mm"] = work
            return jkr_contact(force, radius, modulus, work), modulus, parameters
        case HertzLaw():
            return hertz_contact(force, radius, modulus), modulus, parameters
        case ScaledHertzLaw():
            parameters["area_scale"] = law.area_scale
            return scaled_hertz_contact(force, radius, modulus, law.area_scale), modulus, parameters
        case JkrLaw():
            work += law.work_of_adhesion_N_per_mm
            parameters["work_of_adhesion_N_per_mm"] = work
            return jkr_contact(force, radius, modulus, work), modulus, parameters
        case FemLaw():
            return fem_contact(scene.finger, law, force, factor), modulus, parameters | {"bone": law.bone}
        case HalfspaceLaw():
            # for the depth of a ramp: ridges do not change what the smooth tip sinks in, adhesion as JKR has it
            return jkr_contact(force, radius, modulus, law.work_of_adhesion_N_per_mm + work), modulus, parameters


def press_programme(scene: Scene) -> list[tuple[float, float]]:
    """Return when which normal force is seen: one ``(time_s, force_N)`` per frame.

    A slide is sampled at the frame rate. A list of forces is one frame each at the frame rate. A ramp starts at its
    first force and is sampled at the frame rate until it has reached the last; in mm/min the depth moves evenly and the
    law's own depth gives the force.

    Parameters
    ----------
    scene : Scene

    Raises
    ------
    InputError
        If it needs more than ``press.max_frames`` frames, or a ramp in mm/min meets a law without a depth.
    """
    press = scene.press
    if scene.slide is not None:
        times, loads, _ = slide_programme(scene).sample()
        _require_frames(times.size, press.max_frames)
        return [(float(t), float(f)) for t, f in zip(times, loads, strict=True)]
    if press.forces_N is not None:
        _require_frames(len(press.forces_N), press.max_frames)
        return [(index / press.frame_rate_hz, force) for index, force in enumerate(press.forces_N)]
    ramp = press.ramp
    if ramp is None:  # Press guarantees one of the two
        raise InputError("neither forces_N nor ramp", key="press")
    low, high = sorted((ramp.start_N, ramp.stop_N))
    if ramp.rate_N_per_s is not None:
        first, last, rate = ramp.start_N, ramp.stop_N, ramp.rate_N_per_s
    else:
        first, last = _depth(scene, ramp.start_N), _depth(scene, ramp.stop_N)
        rate = (ramp.rate_mm_per_min or 0.0) / 60.0
    # the tolerance keeps a last frame that rounding would push past the end
    frames = math.floor(abs(last - first) / rate * press.frame_rate_hz + 1e-9) + 1
    _require_frames(frames, press.max_frames)
    times = np.arange(frames) / press.frame_rate_hz
    path = first + math.copysign(rate, last - first) * times
    if ramp.rate_N_per_s is not None:
        forces = np.clip(path, low, high)
    else:
        forces = np.array([_force_at(scene, depth, low, high) for depth in path])
    return [(float(t), float(f)) for t, f in zip(times, forces, strict=True)]


def _require_frames(frames: int, limit: int) -> None:
    if frames > limit:
        raise InputError(
            f"the loading programme needs {frames} frames", key="press.max_frames", allowed=f"at most {limit}"
        )


def _depth(scene: Scene, force: float) -> float:
    depth = _smooth(scene, force)[0].depth
    if not math.isfinite(depth):
        raise InputError(
            f"law {scene.contact.law} has no depth, which a ramp in mm/min needs",
            key="press.ramp.rate_mm_per_min",
            allowed="rate_N_per_s, or law hertz, scaled_hertz, jkr or halfspace",
        )
    return depth


def _force_at(scene: Scene, depth: float, low: float, high: float) -> float:
    """Invert depth(force) between two forces; it rises with force for every law that has a depth."""
    if depth <= _depth(scene, low):
        return low
    if depth >= _depth(scene, high):
        return high
    return float(brentq(lambda force: _depth(scene, force) - depth, low, high, xtol=1e-10))
