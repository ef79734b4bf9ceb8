"""An object held against the plate by a grip force, seen by the camera: what the environment of a grip simulates.

The silicone finger is the tip of an object that hangs on the plate. The grip presses it on with the force that is asked
for; its weight pulls it along the plate, and grows at a moment that is not known. Partial slip, ridges and light are
those of the data sets. Newton's law moves the object: m dv/dt = weight - friction - c (v - slip rate): shear of the
silicone is lossy beside friction.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from evanesce.contact.analytic.partial_slip import tangential_modulus
from evanesce.contact.laws import smooth_contact
from evanesce.contact.patch import AxisymmetricContact, box_around, grid_part
from evanesce.contact.ridges.ridged import with_ridges
from evanesce.contact.sliding.solver import Slide
from evanesce.contact.sliding.states import SlideStates, SlideView
from evanesce.contact.sliding.stepping import SteppedSlide
from evanesce.contact.solve import ridge_row
from evanesce.core import rng
from evanesce.core.states import PlateGrid
from evanesce.dataset.config import DatasetConfig
from evanesce.dataset.design import RigPlan, finger_plan
from evanesce.dataset.rigs import RigCamera, plate_grid, rig_scene, rig_with_effects
from evanesce.materials import silicone_of
from evanesce.materials.friction import InterfaceFriction
from evanesce.rig import Scene

GRAVITY_MM_PER_S2 = 9806.65
SUBSTEPS = 24
"""Steps of the object's motion in one of control: 20 to a period of a 10 g object on the contact's springs."""
DAMPING = 0.7
"""Of the object on the contact's springs, over critical [1]: it settles in one swing."""
QUANTUM_N = 0.01
"""Grip forces are multiples of it [N], so that contacts are computed once."""


@dataclass(frozen=True)
class GripTask:
    """What changes from one episode to the next, and what is asked for.

    Attributes
    ----------
    friction : tuple of float
        Range of the friction coefficient [1].
    weight_N : tuple of float
        Range of the weight at the beginning [N].
    added : tuple of float
        Range of the weight that is added at an unknown moment, over the first [1].
    force_N : tuple of float
        Least and greatest grip force [N].
    rate_N_per_s : float
        Of the grip's actuator [N/s].
    drop_mm : float
        Slide after which the object is lost [mm].
    frame_rate_hz : float
        Of camera and control [Hz].
    steps : int
        Of an episode.
    """

    friction: tuple[float, float] = (0.5, 0.8)
    weight_N: tuple[float, float] = (0.15, 0.35)
    added: tuple[float, float] = (0.0, 0.6)
    force_N: tuple[float, float] = (0.2, 2.5)
    rate_N_per_s: float = 8.0
    drop_mm: float = 1.0
    frame_rate_hz: float = 30.0
    steps: int = 90


@dataclass(frozen=True)
class GripStep:
    """What an episode has come to.

    Attributes
    ----------
    force_N, weight_N, friction_N : float
        Grip force, weight, and what the contact carries of it [N].
    slid_mm, slid_now_mm : float
        Slide of the contact's middle in all, and in this step [mm].
    stick_ratio : float
        Share of the contact that sticks [1].
    lost : bool
    """

    force_N: float
    weight_N: float
    friction_N: float
    slid_mm: float
    slid_now_mm: float
    stick_ratio: float
    lost: bool


class GripModel:
    """Episodes of one rig.

    Parameters
    ----------
    scene : Scene
    config : DatasetConfig
        Fingers, camera and labels' grid; ``camera.region_mm`` with ``camera.size_px``.
    task : GripTask
    seed : int
        Of fingers and rig.
    """

    def __init__(self, scene: Scene, config: DatasetConfig, task: GripTask, seed: int = 0) -> None:
        self.scene, self.config, self.task, self.seed = scene, config, task, seed
        self._cameras: dict[int, tuple[Scene, RigCamera, PlateGrid]] = {}

    def reset(self, episode: int) -> GripStep:
        """Begin an episode: its number determines object, friction and weights."""
        task, generator = self.task, rng.generator(self.seed, "grip", episode)
        self._episode, self._step = episode, 0
        finger = finger_plan(self.config, self.seed, int(generator.integers(self.config.finger.count)))
        if finger.index not in self._cameras:
            rig = rig_with_effects(rig_scene(self.scene, RigPlan(0, self.seed, {}, {}), finger, self.config), self.seed)
            camera = RigCamera(rig, self.seed, self.config.camera.backend)
            self._cameras[finger.index] = (rig.scene, camera, plate_grid(camera.scene, self.config))
        self._rig, self._camera, self._grid = self._cameras[finger.index]
        self.friction_coefficient = float(generator.uniform(*task.friction))
        self._weight = float(generator.uniform(*task.weight_N))
        self._more = self._weight * float(generator.uniform(*task.added))
        self._from = int(generator.integers(task.steps // 4, 3 * task.steps // 4))
        self._contacts: dict[float, AxisymmetricContact] = {}
        self._force = min(
            task.force_N[1], 2.0 * self._weight / task.friction[0]
        )  # held at first, whatever the friction
        smooth, self._modulus = smooth_contact(self._rig, self._force)
        self._shear = float(tangential_modulus(self._modulus, silicone_of(self._rig.finger).poisson_ratio))
        friction = InterfaceFriction(tau0=0.0, alpha=self.friction_coefficient)
        largest = smooth_contact(self._rig, task.force_N[1])[0].contact_radius
        self._slide = SteppedSlide(smooth, friction, self._shear, largest)
        x, y = self._rig.finger.position_mm
        self._view = SlideView(centre=(x, y - 0.5 * task.drop_mm), direction=0.5 * math.pi)
        self._states = SlideStates(Slide((self._slide.frame,), self._slide.edges), self._grid, self._view)
        self._x = self._v = self._shear_rate = 0.0
        return self.step(self._force)

    @property
    def done(self) -> bool:
        """Whether the episode's time is over."""
        return self._step >= self.task.steps

    def step(self, force_N: float) -> GripStep:
        """Let the grip move towards a force for one frame's time, and the object with it."""
        task, dt = self.task, 1.0 / self.task.frame_rate_hz
        most = task.rate_N_per_s * dt
        asked = float(np.clip(force_N, *task.force_N))
        self._force = float(np.clip(asked, self._force - most, self._force + most))
        contact = self._contact(self._force)
        weight = self._weight + (self._more if self._step >= self._from else 0.0)
        mass = weight / GRAVITY_MM_PER_S2  # [N s^2/mm]
        stiffness = 2.0 * contact.contact_radius * self._shear
        damping = 2.0 * DAMPING * math.sqrt(stiffness * mass)
        before, time = float(self._slide.frame.spring_slip[0]), self._step * dt
        self._springs_before = self._slide.frame.spring_slip
        h = dt / SUBSTEPS
        for k in range(SUBSTEPS):
            last = self._slide.frame
            pull = weight - last.tangential_force - damping * self._shear_rate
            self._v += h * pull / mass
            self._x += h * self._v
            moved = self._slide.step(contact, time + (k + 1) * h, self._x)
            self._shear_rate = self._v - float(moved.spring_slip[0] - last.spring_slip[0]) / h
        frame = self._slide.frame
        self._step += 1
        slid = float(frame.spring_slip[0])
        return GripStep(
            self._force, weight, frame.tangential_force, slid, slid - before, frame.stick_ratio, slid > task.drop_mm
        )

    def frame(self) -> NDArray[np.uint8]:
        """Return what the camera sees now, (rows, cols) [DN]."""
        frame, view = self._slide.frame, self._view
        rates = (frame.spring_slip - self._springs_before) * self.task.frame_rate_hz
        radius = 1.1 * frame.contact.contact_radius + 0.3
        part = grid_part(self._grid, box_around(self._grid, self._states.centre_of(frame), radius))
        state = self._states.of(frame, part, rates)
        ridges = ridge_row(self._rig)
        if ridges is not None:
            count = int(np.searchsorted(self._slide.edges[:-1], frame.contact.contact_radius))
            outer = (0.0, float(frame.spring_slip[count - 1]))
            state = with_ridges(state, ridges, self._modulus, origin=view.centre, outer_slip=outer)
        index = self._episode * (self.task.steps + 1) + self._step
        seen = self._camera.frame(state, index=index, time_s=frame.time, with_raw=False, grid=self._grid)
        return np.asarray(seen.data)

    def _contact(self, force: float) -> AxisymmetricContact:
        key = round(force / QUANTUM_N) * QUANTUM_N
        if key not in self._contacts:
            self._contacts[key] = smooth_contact(self._rig, key)[0]
        return self._contacts[key]
