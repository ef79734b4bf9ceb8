"""Solve a scene's contact: the state under a normal force, or the states of its loading programme.

A press has no memory, so that each state is solved by itself (:mod:`evanesce.contact.statics`). A slide is a loading
programme with friction, whose states depend on those before: it is solved once for all its frames
(:mod:`evanesce.contact.sliding`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import overload

from evanesce.contact.analytic.roughness import persson_contact_fraction
from evanesce.contact.laws import finger_modulus
from evanesce.contact.liquid import wetted_state
from evanesce.contact.programme import press_programme
from evanesce.contact.rate import as_loaded
from evanesce.contact.ridges.heightmap import RidgeRow
from evanesce.contact.ridges.skin import ridge_row_of, skin_of
from evanesce.contact.slide import slide_frame
from evanesce.contact.statics import pressed_state
from evanesce.core.errors import InputError
from evanesce.core.states import ContactState, PlateGrid
from evanesce.rig import Scene


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


PARTS = ("finger", "contact", "grid", "press", "slide", "liquid", "environment")
"""Of a scene, all that its contact depends on."""


def parts_of(scene: Scene) -> tuple[str, ...]:
    """Return what a scene's contact depends on beside force and time: a key for those who keep contacts.

    Parameters
    ----------
    scene : Scene
    """
    return tuple(repr(getattr(scene, name)) for name in PARTS)


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
        state = slide_frame(scene, contact_grid(scene), force_N, time_s)
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
