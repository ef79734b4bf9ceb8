"""A scene's slide that turns about its normal or is pulled aside by its ridges, solved in the plane."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.contact.patch import AxisymmetricContact, require_fit
from evanesce.contact.sliding.planar import PlanarFrame, PlanarPath, PlanarSolver
from evanesce.contact.sliding.planar_states import PlanarState, planar_state
from evanesce.contact.sliding.programme import SlideProgramme
from evanesce.contact.sliding.states import SlideView
from evanesce.core.states import ContactState, PlateGrid
from evanesce.materials.friction import InterfaceFriction
from evanesce.rig import Finger, Slide

Floats = NDArray[np.float64]

STEP_TURN_RAD = 0.05
"""Largest rotation in a step: the skin's displacement turns by a twentieth of itself."""
STEP_WAY = 0.1
"""Largest way of the drive in a step, over the contact radius."""


def in_plane(slide: Slide) -> bool:
    """Return whether a slide leaves its line: by a spin, or by ridges of another friction along than across.

    Parameters
    ----------
    slide : Slide
    """
    return bool(slide.spin_deg_per_s) or slide.ridge_friction_ratio not in (None, 1.0)


class PlanarSlide:
    """The contact states of a slide in the plane; each is put on the grid when it is indexed.

    Outlines stay round and the shear modulus is that of the last frame's contact.

    Parameters
    ----------
    grid : PlateGrid
    programme : SlideProgramme
    slide : Slide
    finger : Finger
    contacts : sequence of AxisymmetricContact (frames,)
    friction : InterfaceFriction
        Across ridges.
    shear_modulus : float
        G [MPa].
    poisson : float
    drive_stiffness : float
        Of shaft and drive, in any direction [N/mm].
    view : SlideView
    law : str
    parameters : mapping
        Recorded in each state.
    """

    def __init__(
        self, grid: PlateGrid, programme: SlideProgramme, slide: Slide, finger: Finger,
        contacts: Sequence[AxisymmetricContact], friction: InterfaceFriction, *, shear_modulus: float, poisson: float,
        drive_stiffness: float, view: SlideView, law: str, parameters: Mapping[str, Any],
    ) -> None:  # fmt: skip
        self._grid, self._friction, self._view, self._law = grid, friction, view, law
        self._parameters = dict(parameters)
        ratio, ridges = slide.ridge_friction_ratio or 1.0, finger.ridges
        turned = math.radians(ridges.orientation_deg) if ridges is not None else 0.0
        largest = max(contact.contact_radius for contact in contacts)
        # a finger that leaps overshoots: twice the share of strength that is lost is gone of the force
        solver = PlanarSolver(
            largest, shear_modulus, poisson, friction, drive_stiffness=drive_stiffness,
            drop=2.0 * (slide.stick_slip_drop or 0.0), ridges=(ratio, turned),
        )  # fmt: skip
        self._cells = solver.grid
        path, pressed, last = _path(programme, slide, contacts, largest)
        marched = solver.march(pressed, path)
        self._frames: list[PlanarFrame] = [marched[k] for k in last]
        for frame in self._frames:
            require_fit(grid, self._middle(frame), frame.contact.contact_radius)
        self._made = lru_cache(maxsize=2)(self._make)

    def __len__(self) -> int:
        return len(self._frames)

    def __getitem__(self, index: int) -> ContactState:
        return self._made(index).state

    def skin(self, index: int) -> tuple[Floats, Floats]:
        """Return how far the piece of skin above each cell is from where the resting finger had it (x, y) [mm].

        Parameters
        ----------
        index : int
        """
        x, y = self._made(index).skin
        return x, y

    def _middle(self, frame: PlanarFrame) -> tuple[float, float]:
        (x, y), tip = self._view.centre, frame.tip
        return (x + tip[0], y + tip[1]) if self._view.follows else (x, y)

    def _make(self, index: int) -> PlanarState:
        frame, view = self._frames[index], self._view
        middle = self._middle(frame)
        origin = (middle[0] - frame.tip[0], middle[1] - frame.tip[1])
        found = planar_state(frame, self._cells, self._grid, origin, self._friction, near_gap=view.near_gap)
        cos, sin = math.cos(view.direction), math.sin(view.direction)
        (x, y), state = frame.tip, found.state
        assert state.traction is not None
        away_x, away_y = self._grid.x[None, :] - middle[0], self._grid.y[:, None] - middle[1]
        torque = (away_x * state.traction[1] - away_y * state.traction[0]).sum() * self._grid.pitch**2
        stick = float((frame.stick > 0.0).sum() / max((frame.stick != -1.0).sum(), 1))
        told = {
            **self._parameters, "stick_ratio": stick, "tip_displacement_mm": x * cos + y * sin,
            "tip_aside_mm": y * cos - x * sin, "rotation_deg": math.degrees(frame.rotation),
            "torque_N_mm": float(torque),
        }  # fmt: skip
        return replace(found, state=replace(state, law=self._law, parameters=told))


def _path(
    programme: SlideProgramme, slide: Slide, contacts: Sequence[AxisymmetricContact], radius: float
) -> tuple[PlanarPath, list[AxisymmetricContact], list[int]]:
    """Return the drive's path in steps, the contact in each, and which steps end a frame."""
    time, _, drive = programme.sample()
    start = programme.press_time + programme.hold_time
    spin, angle = math.radians(slide.spin_deg_per_s or 0.0), math.radians(slide.direction_deg)
    ways, turns = np.abs(np.diff(drive)), abs(spin) * np.diff(np.maximum(time - start, 0.0))
    counts = np.maximum(np.ceil(np.maximum(ways / (STEP_WAY * radius), turns / STEP_TURN_RAD)), 1).astype(int)
    moments, pressed, last = [float(time[0])], [contacts[0]], [0]
    for k, count in enumerate(counts):
        moments += np.linspace(time[k], time[k + 1], count + 1)[1:].tolist()
        pressed += [contacts[k + 1]] * int(count)
        last.append(len(moments) - 1)
    at = np.array(moments)
    along = np.interp(at, time, drive)
    turned = spin * np.maximum(at - start, 0.0)
    path = PlanarPath(at, along * math.cos(angle), along * math.sin(angle), turned, programme.speeds(at))
    return path, pressed, last
