"""Compute the ground truth of every frame of a trial from its plan: contact states, slip velocities and scalars.

The physics is that of :mod:`evanesce.contact`: the scene's contact law, partial slip with its history, ridges carried
by the skin, torsion. A frame's state is computed on demand.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from evanesce.contact.analytic.partial_slip import tangential_modulus
from evanesce.contact.analytic.roughness import persson_contact_fraction
from evanesce.contact.laws import smooth_contact
from evanesce.contact.patch import AxisymmetricContact
from evanesce.contact.ridges.ridged import with_ridges
from evanesce.contact.sliding.area_loss import area_loss_for
from evanesce.contact.sliding.shaft import tilted_compliance
from evanesce.contact.sliding.solver import Slide, march
from evanesce.contact.sliding.states import SlideStates, SlideView
from evanesce.contact.sliding.torsion import Twist, sliding_torque, twisted, twisted_state
from evanesce.contact.solve import ridge_row
from evanesce.core.states import ContactState, PlateGrid
from evanesce.dataset.config import DatasetConfig
from evanesce.dataset.design import TrialPlan
from evanesce.dataset.programme import Sampled, sample_programme
from evanesce.materials import silicone_of
from evanesce.materials.friction import InterfaceFriction
from evanesce.rig import Scene

Floats = NDArray[np.float64]

LIFTED_N = 1e-6
"""Below this normal force the finger counts as lifted [N]."""


@dataclass(frozen=True)
class FrameTruth:
    """Ground truth of one frame.

    Attributes
    ----------
    state : ContactState or None
        None where the finger is lifted.
    scalars : dict
        The frame's numbers, units in the keys.
    """

    state: ContactState | None
    scalars: dict[str, float]

    @property
    def slip_velocity(self) -> Floats | None:
        """Of the skin over the glass (x, y) [mm/s], (2, rows, cols)."""
        found = None if self.state is None else self.state.slip_velocity
        return None if found is None else np.asarray(found, dtype=float)


class Trial:
    """Ground truth of a trial.

    Parameters
    ----------
    plan : TrialPlan
    config : DatasetConfig
    scene : Scene
        The rig with its effects applied.
    grid : PlateGrid
    load : callable, optional
        ``load(frame, time_s, force_N) -> force_N``: actual normal force for a commanded one.

    Attributes
    ----------
    time : ndarray (n,)
        [s].
    onset_first_slip_s, onset_gross_slip_s : float
        NaN where it does not occur.
    """

    def __init__(
        self,
        plan: TrialPlan,
        config: DatasetConfig,
        scene: Scene,
        grid: PlateGrid,
        load: Callable[[int, float, float], float] | None = None,
    ) -> None:
        self.plan, self.config, self.scene, self.grid = plan, config, scene, grid
        self._silicone = silicone_of(scene.finger)
        held = plan.programme["normal_force_N"]
        contact = self._contact(held)
        self._friction, self._modulus = _interface(plan, contact), smooth_contact(scene, held)[1]
        shear = float(tangential_modulus(self._modulus, self._silicone.poisson_ratio))
        self._shaft = _shaft(plan)
        series = 1.0 / (1.0 / (2.0 * contact.contact_radius * shear) + 1.0 / self._shaft)
        sampled = sample_programme(plan, config.trial, series)
        if load is not None:
            commanded = zip(sampled.time.tolist(), sampled.force.tolist(), strict=True)
            actual = [load(i, t, f) if f > LIFTED_N else 0.0 for i, (t, f) in enumerate(commanded)]
            sampled = replace(sampled, force=np.maximum(np.array(actual), 0.0))
        self._sampled: Sampled = sampled
        self.time = sampled.time
        self._slide, self._rates = self._march(shear)
        self._states, self._velocity = self._views()
        self._ridges = ridge_row(scene)
        self._twists = self._twist(shear)
        self._ratio = self._stick_ratios()
        self.onset_first_slip_s, self.onset_gross_slip_s = self._onsets()

    def __len__(self) -> int:
        return len(self.time)

    def truth(self, i: int) -> FrameTruth:
        """Return the truth of frame ``i`` of the trial."""
        if self._sampled.force[i] <= LIFTED_N:
            return FrameTruth(None, self._scalars(i, None))
        if self._twists is not None and self._twists[i] is not None:
            smooth, velocity = self._twisted(i)
        else:
            at = int(self._sampled.placement[i])
            smooth, velocity = self._states[at][i], np.asarray(self._velocity[at][i].slip, dtype=float)
        state = smooth
        if self._ridges is not None:
            drift = self._outer_slip(i)
            origin = self._origin(int(self._sampled.placement[i]))
            state = with_ridges(
                smooth, self._ridges, self._modulus, origin=origin, outer_slip=drift,
                near_gap=self.config.labels.near_gap_mm,
            )  # fmt: skip
            velocity = velocity * (np.asarray(state.contact_mask) > 0)
        slope = self.scene.finger.roughness_rms_slope
        if slope > 0:
            state = replace(state, real_contact_fraction=persson_contact_fraction(state.pressure, self._modulus, slope))
        strength = (self._friction.tau0 + self._friction.alpha * np.asarray(state.pressure)) * (
            np.asarray(state.contact_mask) > 0
        )
        state = replace(state, slip_velocity=velocity, strength=strength)
        return FrameTruth(state, self._scalars(i, state))

    # --- solution ----------------------------------------------------------------------------------------------------

    def _contact(self, force: float) -> AxisymmetricContact:
        return smooth_contact(self.scene, max(force, 0.0))[0]

    def _march(self, shear: float) -> tuple[Slide, Slide]:
        """Return the slide, and the same with slip velocities instead of slips."""
        s, plan = self._sampled, self.plan
        known = {f: self._contact(f) for f in dict.fromkeys(s.force.tolist())}
        contacts = [known[f] for f in s.force.tolist()]
        full = self._limit(self._contact(plan.programme["normal_force_N"]))
        area = math.pi * self._contact(plan.programme["normal_force_N"]).contact_radius ** 2
        loss = area_loss_for(area, full, plan.friction.area_left) if plan.friction.area_left < 1.0 else 0.0
        slide = march(contacts, s.time, s.drive, self._friction, shear, drive_stiffness=self._shaft, area_loss=loss)
        rates = [replace(slide.frames[0], spring_slip=np.zeros_like(slide.frames[0].spring_slip))]
        for before, now in zip(slide.frames[:-1], slide.frames[1:], strict=True):
            moved = np.where(now.spring_slip != 0.0, now.spring_slip - before.spring_slip, 0.0)
            rates.append(replace(now, spring_slip=moved / (now.time - before.time)))
        return slide, Slide(tuple(rates), slide.edges)

    def _origin(self, placement: int) -> tuple[float, float]:
        """Return the position of the tip before sliding [mm], so that a slide passes the finger's position half way."""
        p, (x, y) = self.plan.programme, self.scene.finger.position_mm
        angle = math.radians(p["direction_deg"])
        back = 0.5 * p["distance_mm"] if self.plan.kind == "slide" else 0.0
        shift = p["shift_mm"] if placement else 0.0
        return x - back * math.cos(angle) + shift, y - back * math.sin(angle) - 0.5 * shift

    def _views(self) -> tuple[list[SlideStates], list[SlideStates]]:
        direction = math.radians(self.plan.programme["direction_deg"])
        states, velocities = [], []
        for placement in range(int(self._sampled.placement.max()) + 1):
            view = SlideView(
                centre=self._origin(placement), direction=direction, near_gap=self.config.labels.near_gap_mm
            )
            states.append(SlideStates(self._slide, self.grid, view, law="hertz+sliding"))
            velocities.append(SlideStates(self._rates, self.grid, view, law="hertz+sliding"))
        return states, velocities

    def _twist(self, shear: float) -> list[Twist | None] | None:
        if self.plan.kind != "rotation":
            return None
        modulus = 0.25 * self._modulus  # G of an incompressible half-space: E*/4
        found: list[Twist | None] = []
        for force, share in zip(self._sampled.force, self._sampled.twist_share, strict=True):
            held = force > LIFTED_N and share > 0.0
            found.append(twisted(self._contact(float(force)), self._friction, modulus, float(share)) if held else None)
        return found

    def _twisted(self, i: int) -> tuple[ContactState, Floats]:
        assert self._twists is not None
        twist, contact = self._twists[i], self._contact(float(self._sampled.force[i]))
        assert twist is not None
        near = self.config.labels.near_gap_mm
        state = twisted_state(self.grid, self._origin(0), contact, twist, near_gap=near, time=float(self.time[i]))
        before = self._twists[i - 1]
        velocity = np.asarray(state.slip, dtype=float)
        if before is not None:
            earlier = twisted_state(self.grid, self._origin(0), contact, before, near_gap=near)
            velocity = velocity - np.asarray(earlier.slip)
        return state, velocity / float(self.time[i] - self.time[i - 1])

    def _outer_slip(self, i: int) -> tuple[float, float]:
        """Return the displacement of the skin beside the contact: that of the outermost spring in contact."""
        frame = self._slide.frames[i]
        angle = math.radians(self.plan.programme["direction_deg"])
        count = int(np.searchsorted(self._slide.edges[:-1], frame.contact.contact_radius))
        edge = float(frame.spring_slip[count - 1]) if 0 < count <= len(frame.spring_slip) else 0.0
        return edge * math.cos(angle), edge * math.sin(angle)

    def centre(self, i: int) -> tuple[float, float]:
        """Return the plate point (x, y) under the tip [mm]."""
        x, y = self._origin(int(self._sampled.placement[i]))
        along = float(self._slide.frames[i].tip_displacement)
        angle = math.radians(self.plan.programme["direction_deg"])
        return x + along * math.cos(angle), y + along * math.sin(angle)

    # --- numbers -----------------------------------------------------------------------------------------------------

    def _limit(self, contact: AxisymmetricContact) -> float:
        """Return the tangential force of full sliding at static strength [N]."""
        return self._friction.tau0 * math.pi * contact.contact_radius**2 + self._friction.alpha * contact.normal_force

    def _stick_ratios(self) -> Floats:
        ratios = np.array([frame.stick_ratio for frame in self._slide], dtype=float)
        if self._twists is not None:
            for i, twist in enumerate(self._twists):
                if twist is not None:
                    ratios[i] = (twist.stick_radius / self._slide.frames[i].contact.contact_radius) ** 2
        return ratios

    def _onsets(self) -> tuple[float, float]:
        """Return the times at which ``first_slip_share`` of the contact and all of it slips [s]."""
        held = self._sampled.force > LIFTED_N
        slipping = np.where(held, 1.0 - self._ratio, 0.0)
        found = []
        for level in (self.config.labels.first_slip_share, 1.0 - 1e-9):
            reached = np.flatnonzero(slipping >= level)
            found.append(float(self.time[reached[0]]) if reached.size else math.nan)
        return found[0], found[1]

    def _scalars(self, i: int, state: ContactState | None) -> dict[str, float]:
        frame, s = self._slide.frames[i], self._sampled
        x, y = self.centre(i)
        place = {"centre_x_mm": x, "centre_y_mm": y}
        if state is None:
            nothing = {**dict.fromkeys(SCALARS, 0.0), **place}
            return {**nothing, "stick_ratio": 1.0, "time_s": float(s.time[i]), "drive_mm": float(s.drive[i])}
        contact = frame.contact
        limit = self._limit(contact)
        fx, fy = state.tangential_force
        twist = self._twists[i] if self._twists is not None else None
        torque = 0.0 if twist is None else twist.torque
        margin = math.hypot(fx, fy) / limit
        if twist is not None:
            margin = max(margin, torque / sliding_torque(contact, self._friction))
        return {
            "time_s": float(s.time[i]),
            "Fx_N": float(fx),
            "Fy_N": float(fy),
            "Fz_N": float(contact.normal_force),
            "torque_N_mm": float(torque),
            **areas(state),
            **place,
            "stick_ratio": float(self._ratio[i]),
            "friction_coefficient": limit / contact.normal_force,
            "margin": margin,
            "drive_mm": float(s.drive[i]),
            "tip_displacement_mm": float(frame.tip_displacement),
        }


SCALARS: dict[str, str] = {
    "time_s": "s",
    "Fx_N": "N",
    "Fy_N": "N",
    "Fz_N": "N",
    "torque_N_mm": "N mm",
    "nominal_area_mm2": "mm^2",
    "real_area_mm2": "mm^2",
    "centre_x_mm": "mm",
    "centre_y_mm": "mm",
    "stick_ratio": "1",
    "friction_coefficient": "1",
    "margin": "1",
    "drive_mm": "mm",
    "tip_displacement_mm": "mm",
}
"""Numbers of each frame and their units. Forces are those of the finger on the glass."""

MEANINGS = {
    "torque_N_mm": "of the finger on the glass about the contact's centre, from x towards y",
    "centre_x_mm": "of the contact on the plate: where the tip's axis meets it",
    "centre_y_mm": "of the contact on the plate: where the tip's axis meets it",
    "Fz_N": "0: the finger is lifted, and forces, areas, friction coefficient and margin are 0",
    "stick_ratio": "share of the contact that sticks; 1 where the finger is lifted (Fz_N = 0): nothing slips",
    "margin": "|Ft| / (mu Fn), or the same of the torque; 0 where the finger is lifted",
}
"""Meanings of numbers beyond their names."""


def areas(state: ContactState) -> dict[str, float]:
    """Return nominal and real area of a contact, by their names among the scalars."""
    nominal = real = float(state.nominal_contact_area)
    if state.real_contact_fraction is not None:
        fraction = np.asarray(state.contact_mask) * np.asarray(state.real_contact_fraction)
        real = float(fraction.sum()) * state.grid.pitch**2
    return {"nominal_area_mm2": nominal, "real_area_mm2": real}


def _interface(plan: TrialPlan, contact: AxisymmetricContact) -> InterfaceFriction:
    """Return the interface tau0 + alpha p of a friction coefficient at the held load."""
    f = plan.friction
    mean = contact.normal_force / (math.pi * contact.contact_radius**2)
    return InterfaceFriction(
        tau0=f.adhesive_share * f.friction_coefficient * mean,
        alpha=(1.0 - f.adhesive_share) * f.friction_coefficient,
        dynamic_ratio=f.dynamic_ratio,
        weakening_distance=f.weakening_distance_mm,
    )


def _shaft(plan: TrialPlan) -> float:
    """Return the stiffness of the tilted shaft along the slide [N/mm]."""
    angle = math.radians(plan.programme["contact_angle_deg"])
    f = plan.finger
    return 1.0 / float(tilted_compliance(f.axial_stiffness_N_per_mm, f.shaft_stiffness_N_per_mm, angle)[0, 0])
