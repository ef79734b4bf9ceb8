"""Ground truth of a trial whose finger moves in two directions and turns (:mod:`evanesce.dataset.motions`)."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from evanesce.contact.patch import AxisymmetricContact
from evanesce.contact.sliding.friction_ellipse import FrictionEllipse
from evanesce.contact.sliding.planar import PlanarPath, PlanarSolver
from evanesce.contact.sliding.planar_states import PlanarState, planar_state
from evanesce.contact.sliding.torsion import sliding_torque
from evanesce.core.states import ContactState, PlateGrid
from evanesce.dataset.config import DatasetConfig
from evanesce.dataset.design import TrialPlan
from evanesce.dataset.directional import ridge_friction, twist_factor
from evanesce.dataset.motions import PlanarSampled, is_planar, planar_programme
from evanesce.dataset.numbers import measured, slip_labelled
from evanesce.dataset.trial import LIFTED_N, Floats, Trial
from evanesce.rig import Scene

LEAST_SHARE = 1e-3
"""Of the strength: a smaller force has no direction."""


class PlanarTrial(Trial):
    """As :class:`~evanesce.dataset.trial.Trial`, from the tractions of a half-space in both directions.

    Outlines are round: the loss of area under shear (``friction.area_left``) is along one direction only.
    """

    def _programme(self, stiffness: float, limit: float) -> PlanarSampled:
        return planar_programme(self.plan, self.config.trial, self.reach_mm, stiffness, limit)

    def _solve(self, shear: float) -> None:
        s = self._sampled
        assert isinstance(s, PlanarSampled)
        known = {f: self._contact(f if f > LIFTED_N else 0.0) for f in dict.fromkeys(s.force.tolist())}
        contacts = [known[f] for f in s.force.tolist()]
        poisson = self._silicone.poisson_ratio
        self._solver = PlanarSolver(
            max(c.contact_radius for c in contacts), 0.25 * (2.0 - poisson) * shear, poisson, self._friction,
            drive_stiffness=self._shaft, drop=self.plan.motion.get("stick_slip_drop", 0.0),
            ridges=ridge_friction(self.plan),
        )  # fmt: skip
        self._frames = self._solver.march(contacts, PlanarPath(s.time, s.x, s.y, s.rotation, s.speed))
        self._origins = [self._about(k) for k in range(int(s.placement.max()) + 1)]
        self._kept: tuple[int, PlanarState] | None = None

    def _about(self, placement: int) -> tuple[float, float]:
        """Return where a finger is put down [mm]: its way is about its position in the scene."""
        tips = np.array([f.tip for f, at in zip(self._frames, self._sampled.placement, strict=True) if at == placement])
        middle = 0.5 * (tips.max(axis=0) + tips.min(axis=0))
        (x, y), shift = self.scene.finger.position_mm, self.plan.programme["shift_mm"]
        away = (shift, -0.5 * shift) if placement else (0.0, 0.0)
        return float(x - middle[0] + away[0]), float(y - middle[1] + away[1])

    def _origin(self, placement: int) -> tuple[float, float]:
        return self._origins[placement]

    def _pressed(self, i: int) -> AxisymmetricContact:
        return self._frames[i].contact

    def centre(self, i: int) -> tuple[float, float]:
        """Return the plate point (x, y) in the middle of the contact's outline [mm]."""
        (x, y), tip = self._origin(int(self._sampled.placement[i])), self._frames[i].tip
        return x + tip[0], y + tip[1]

    def _planar(self, i: int) -> PlanarState:
        if self._kept is None or self._kept[0] != i:
            origin, near = self._origin(int(self._sampled.placement[i])), self.config.labels.near_gap_mm
            found = planar_state(
                self._frames[i], self._solver.grid, self.part(i), origin, self._friction, near_gap=near
            )
            self._kept = i, found
        return self._kept[1]

    def _smooth(self, i: int) -> ContactState:
        return slip_labelled(self._planar(i).state)

    def _skin(self, i: int, late_s: Floats | float) -> dict[str, Any]:
        found = self._planar(i)
        return {"skin": found.skin + found.speed * late_s}

    def _may_slip(self, i: int, anywhere: bool) -> bool:
        stick = self._frames[i].stick
        return bool((stick <= 0.0).any() if anywhere else (stick <= 0.0).mean() > 0.5)

    def _strength(self, i: int, fx: float, fy: float) -> float:
        frame, (ratio, angle) = self._frames[i], ridge_friction(self.plan)
        ellipse, most = FrictionEllipse(ratio, angle + frame.rotation), self._limit(self._pressed(i))
        along = twist_factor(self.plan)  # of a finger that turns in place
        if math.hypot(fx, fy) > LEAST_SHARE * most:
            along = float(ellipse.strength(np.array([[fx], [fy]]))[0])
        return most * frame.speed_factor * along

    def _torque_margin(self, i: int) -> float:
        contact, (x, y) = self._pressed(i), self.centre(i)
        torque = measured(self._planar(i).state, (x, y))["torque_N_mm"]
        most = sliding_torque(contact, self._friction) * twist_factor(self.plan)
        return abs(torque) / (most * self._frames[i].speed_factor)

    def _turned(self, i: int) -> dict[str, float]:
        frame = self._frames[i]
        return {"tip_displacement_mm": math.hypot(*frame.tip), "rotation_deg": math.degrees(frame.rotation)}


def trial_of(plan: TrialPlan, config: DatasetConfig, scene: Scene, grid: PlateGrid, load: Any = None) -> Trial:
    """Return the ground truth of a plan; parameters are those of :class:`~evanesce.dataset.trial.Trial`."""
    return (PlanarTrial if is_planar(plan) else Trial)(plan, config, scene, grid, load)
