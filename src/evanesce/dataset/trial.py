"""Compute the ground truth of every frame of a trial from its plan: contact states, slip velocities and scalars.

The physics is that of :mod:`evanesce.contact`: Hertz's contact of the trial's finger, partial slip with its history,
ridges carried by the skin, torsion. A frame's state is computed on demand.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.contact.analytic.partial_slip import tangential_modulus
from evanesce.contact.analytic.roughness import persson_contact_fraction
from evanesce.contact.laws import smooth_contact
from evanesce.contact.liquid import lubricated, wetted_state
from evanesce.contact.patch import AxisymmetricContact, box_around, grid_part
from evanesce.contact.ridges.print_row import PrintRow
from evanesce.contact.ridges.ridged import with_ridges
from evanesce.contact.sliding.area_loss import area_loss_for
from evanesce.contact.sliding.solver import Slide, march
from evanesce.contact.sliding.states import SlideStates, SlideView
from evanesce.contact.sliding.torsion import Twist, sliding_torque, twisted, twisted_state
from evanesce.contact.solve import ridge_row
from evanesce.contact.tilt import require_on_tip, tilt_of
from evanesce.core.states import ContactState, PlateGrid
from evanesce.dataset.config import DatasetConfig
from evanesce.dataset.design import TrialPlan
from evanesce.dataset.markers import MarkedSkin
from evanesce.dataset.mechanics import gross_slip, interface, shaft_stiffness
from evanesce.dataset.numbers import SCALARS, SLIP_SPEED_MM_PER_S, measured, slip_labelled
from evanesce.dataset.programme import Sampled, sample_programme
from evanesce.dataset.shutter import Motion, advanced
from evanesce.materials import silicone_of
from evanesce.rig import Scene

Floats = NDArray[np.float64]

LIFTED_N = 1e-6
"""Below this normal force the finger counts as lifted [N]."""
SPRINGS = 512
"""Of a contact's radius: six of them are as wide as a cell of the default grid for contacts of up to 2.6 mm."""
ENLARGED = 1.1
"""Contact radius over the smooth solution's, up to which effects of the finger may enlarge it [1]."""


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
    reach_mm : float
        Way of the drive from rest to gross slip [mm].
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
        self._now: tuple[int, ContactState] | None = None
        self._silicone = silicone_of(scene.finger)
        held = plan.programme["normal_force_N"]
        contact = self._contact(held)
        self._friction, self._modulus = interface(plan, contact), smooth_contact(scene, held)[1]
        require_on_tip(scene, contact.contact_radius)
        if scene.liquid is not None:
            self._friction = lubricated(
                self._friction, scene.liquid, force=held, area=math.pi * contact.contact_radius**2,
                radius=scene.finger.tip_radius_mm, modulus=self._modulus,
            )  # fmt: skip
        shear = float(tangential_modulus(self._modulus, self._silicone.poisson_ratio))
        self._shaft = shaft_stiffness(plan)
        series = 1.0 / (1.0 / (2.0 * contact.contact_radius * shear) + 1.0 / self._shaft)
        self.reach_mm, limit = gross_slip(plan, config.trial, contact, self._friction, shear, self._shaft)
        sampled = self._programme(series, limit)
        if load is not None:
            commanded = zip(sampled.time.tolist(), sampled.force.tolist(), strict=True)
            actual = [load(i, t, f) if f > LIFTED_N else 0.0 for i, (t, f) in enumerate(commanded)]
            sampled = replace(sampled, force=np.maximum(np.array(actual), 0.0))
        self._travel = self.reach_mm - limit / self._shaft + plan.programme["distance_mm"]
        self._sampled: Sampled = sampled
        self.time = sampled.time
        self._ridges = PrintRow.of(scene.finger.fingerprint) if scene.finger.fingerprint else ridge_row(scene)
        tilt, lean = tilt_of(scene)
        arc = -scene.finger.tip_radius_mm * tilt
        self._apex = arc * math.cos(lean), arc * math.sin(lean)
        self._solve(shear)
        self.onset_first_slip_s, self.onset_gross_slip_s = self._onsets()

    def __len__(self) -> int:
        return len(self.time)

    def truth(self, i: int) -> FrameTruth:
        """Return the truth of frame ``i`` of the trial."""
        if self._sampled.force[i] <= LIFTED_N:
            return FrameTruth(None, self._scalars(i, None))
        state = self.state(i)
        return FrameTruth(state, {**self._scalars(i, state), **measured(state, self.centre(i))})

    def state(self, i: int, late_s: Floats | None = None, *, light_alone: bool = False) -> ContactState:
        """Return the contact of a held finger at frame ``i``, on :meth:`part` of the grid.

        With ``late_s`` [s], of that part's shape, each cell as much later; without traction and strength where only
        the light is wanted.
        """
        if self._now is None or self._now[0] != i:
            self._now = i, self._smooth(i)
        state = self._now[1]
        if light_alone:
            state = replace(state, traction=None, strength=None)
        if late_s is not None:
            state = slip_labelled(advanced(state, self.motion(i), late_s))
        slope = self.scene.finger.roughness_rms_slope
        if self._ridges is not None:
            state = with_ridges(
                state, self._ridges, self._modulus, origin=self._apex_at(i), outline_alone=light_alone and slope <= 0,
                near_gap=self.config.labels.near_gap_mm, **self._skin(i, 0.0 if late_s is None else late_s),
            )  # fmt: skip
        if slope > 0:
            state = replace(state, real_contact_fraction=persson_contact_fraction(state.pressure, self._modulus, slope))
        return state if self.scene.liquid is None else wetted_state(state, self.scene.liquid)

    def marked_skin(self, i: int, late_s: Floats | float = 0.0) -> MarkedSkin:
        """Return where the skin is at frame ``i`` on :meth:`part` of the grid; each cell as much later [s]."""
        state, outer = self._smooth(i), self._skin(i, late_s)
        skin = outer.get("skin")
        if skin is None:
            assert state.slip is not None
            speed = 0.0 if state.slip_velocity is None else np.asarray(state.slip_velocity)
            beside = np.stack([np.broadcast_to(s, state.grid.shape) for s in outer["outer_slip"]])
            skin = np.where(np.asarray(state.contact_mask) > 0, np.asarray(state.slip) + speed * late_s, beside)
        return MarkedSkin(state.grid, self._apex_at(i), np.asarray(skin))

    def part(self, i: int) -> PlateGrid:
        """Return the part of the grid that holds the contact of frame ``i``, and what is seen and labelled about it.

        Half a frame's time around it the contact stays there, and so does one that an effect enlarges by as much as
        :data:`ENLARGED`.
        """
        motion, time = self.motion(i), 0.5 / self.config.trial.frame_rate_hz
        radius = self._pressed(i).contact_radius * (ENLARGED + abs(motion.growth_per_s) * time)
        radius += self.config.labels.margin_mm + math.hypot(*motion.velocity) * time + 4.0 * self.grid.pitch
        return grid_part(self.grid, box_around(self.grid, motion.centre, radius))

    def _smooth(self, i: int) -> ContactState:
        """Return the contact of the same finger without ridges; what moves is labelled slip."""
        if self._twists is not None and self._twists[i] is not None:
            state, velocity = self._twisted(i)
            return slip_labelled(replace(state, slip_velocity=velocity))
        return slip_labelled(self._states[int(self._sampled.placement[i])].on(self.part(i), i))

    # --- solution ----------------------------------------------------------------------------------------------------

    def _programme(self, stiffness: float, limit: float) -> Sampled:
        return sample_programme(self.plan, self.config.trial, stiffness, self.reach_mm, limit)

    def _solve(self, shear: float) -> None:
        self._slide, self._rates = self._march(shear)
        self._states = self._views()
        self._twists = self._twist(shear)

    def _pressed(self, i: int) -> AxisymmetricContact:
        """Return a frame's contact without shear."""
        return self._slide.frames[i].contact

    def _contact(self, force: float) -> AxisymmetricContact:
        return smooth_contact(self.scene, max(force, 0.0))[0]

    def _march(self, shear: float) -> tuple[Slide, list[Floats]]:
        """Return the slide, and the mean speed of each frame's springs since the frame before [mm/s]."""
        s, plan = self._sampled, self.plan
        known = {f: self._contact(f) for f in dict.fromkeys(s.force.tolist())}
        contacts = [known[f] for f in s.force.tolist()]
        held = self._contact(plan.programme["normal_force_N"])
        area = math.pi * held.contact_radius**2
        loss = area_loss_for(area, self._limit(held), plan.friction.area_left) if plan.friction.area_left < 1.0 else 0.0
        slide = march(
            contacts, s.time, s.drive, self._friction, shear, drive_stiffness=self._shaft, area_loss=loss,
            speeds=s.speed, springs=SPRINGS,
        )  # fmt: skip
        rates = [np.zeros_like(slide.frames[0].spring_slip)]
        for before, now in zip(slide.frames[:-1], slide.frames[1:], strict=True):
            moved = np.where(now.spring_slip != 0.0, now.spring_slip - before.spring_slip, 0.0)
            rates.append(moved / (now.time - before.time))
        return slide, rates

    def _origin(self, placement: int) -> tuple[float, float]:
        """Return the position of the tip before sliding [mm], so that a slide passes the finger's position half way."""
        p, (x, y) = self.plan.programme, self.scene.finger.position_mm
        angle = math.radians(p["direction_deg"])
        back = 0.5 * self._travel if self.plan.kind == "slide" else 0.0
        shift = p["shift_mm"] if placement else 0.0
        return x - back * math.cos(angle) + shift, y - back * math.sin(angle) - 0.5 * shift

    def _apex_at(self, i: int) -> tuple[float, float]:
        """Return where the apex of the resting finger's skin, unrolled, lies on the plate [mm]."""
        x, y = self._origin(int(self._sampled.placement[i]))
        return x + self._apex[0], y + self._apex[1]

    def _views(self) -> list[SlideStates]:
        direction = math.radians(self.plan.programme["direction_deg"])
        states = []
        for placement in range(int(self._sampled.placement.max()) + 1):
            view = SlideView(
                centre=self._origin(placement), direction=direction, near_gap=self.config.labels.near_gap_mm
            )
            states.append(SlideStates(self._slide, self.grid, view, law="hertz+sliding", rates=self._rates))
        return states

    def _twist(self, shear: float) -> list[Twist | None] | None:
        if self.plan.kind != "rotation":
            return None
        modulus = 0.25 * self._modulus  # G of an incompressible half-space: E*/4
        found: list[Twist | None] = []
        shares = self._sampled.twist_share.tolist()
        for frame, force, share in zip(self._slide.frames, self._sampled.force, shares, strict=True):
            held = force > LIFTED_N and share > 0.0
            found.append(twisted(frame.contact, self._friction, modulus, share) if held else None)
        return found

    def _twisted(self, i: int) -> tuple[ContactState, Floats]:
        assert self._twists is not None
        twist, contact, grid = self._twists[i], self._slide.frames[i].contact, self.part(i)
        assert twist is not None
        near = self.config.labels.near_gap_mm
        state = twisted_state(grid, self._origin(0), contact, twist, near_gap=near, time=float(self.time[i]))
        before = self._twists[i - 1]
        velocity = np.asarray(state.slip, dtype=float)
        if before is not None:
            earlier = twisted_state(grid, self._origin(0), contact, before, near_gap=near)
            velocity = velocity - np.asarray(earlier.slip)
        return state, velocity / float(self.time[i] - self.time[i - 1])

    def motion(self, i: int) -> Motion:
        """Return how the contact's outline moves at frame ``i``, from the frames beside it in contact."""
        placement, force = self._sampled.placement, self._sampled.force
        low, high = (
            j if 0 <= j < len(self) and placement[j] == placement[i] and force[j] > LIFTED_N else i
            for j in (i - 1, i + 1)
        )
        centre, elapsed = self.centre(i), float(self.time[high] - self.time[low])
        if elapsed == 0.0:
            return Motion(centre, (0.0, 0.0), 0.0)
        velocity = np.subtract(self.centre(high), self.centre(low)) / elapsed
        radius = [self._pressed(j).contact_radius for j in (low, i, high)]
        growth = (radius[2] - radius[0]) / (elapsed * radius[1]) if radius[1] > 0 else 0.0
        return Motion(centre, (float(velocity[0]), float(velocity[1])), growth)

    def _skin(self, i: int, late_s: Floats | float) -> dict[str, Any]:
        """Return what ridges need to know of the skin besides its slip, some time after frame ``i``."""
        slips, rates = self._outer(i, self._slide.frames[i].spring_slip), self._outer(i, self._rates[i])
        return {"outer_slip": tuple(slip + rate * late_s for slip, rate in zip(slips, rates, strict=True))}

    def _outer(self, i: int, springs: Floats) -> tuple[float, float]:
        """Return the slip (or its rate) of the skin beside the contact: that of the outermost spring in contact."""
        angle, radius = math.radians(self.plan.programme["direction_deg"]), self._slide.frames[i].contact.contact_radius
        count = int(np.searchsorted(self._slide.edges[:-1], radius))
        edge = float(springs[count - 1]) if 0 < count <= len(springs) else 0.0
        return edge * math.cos(angle), edge * math.sin(angle)

    def centre(self, i: int) -> tuple[float, float]:
        """Return the plate point (x, y) in the middle of the contact's outline [mm]."""
        placement = int(self._sampled.placement[i])
        return self._origin(placement) if self._twists is not None else self._states[placement].centre(i)

    # --- numbers -----------------------------------------------------------------------------------------------------

    def _limit(self, contact: AxisymmetricContact) -> float:
        """Return the tangential force of full sliding across ridges at static strength and the reference speed [N]."""
        return self._friction.tau0 * math.pi * contact.contact_radius**2 + self._friction.alpha * contact.normal_force

    def _onsets(self) -> tuple[float, float]:
        """Return the times of the first frames in which ``first_slip_share`` of the contact, or all of it, slips."""
        first = 1.0 - self.config.labels.first_slip_share
        return self._onset(first, most=True), self._onset(0.0, most=False)

    def _onset(self, ratio: float, *, most: bool) -> float:
        """Return the time of the first frame with at most this stick ratio [s]; NaN without one.

        The surface moves at most as fast as the fastest spring, and as a whole only if the innermost one moves: other
        frames need no map.
        """
        for i in range(len(self)):
            if self._sampled.force[i] > LIFTED_N and self._may_slip(i, most):
                state = self.state(i)
                if measured(state, (0.0, 0.0))["stick_ratio"] <= ratio:
                    return float(self.time[i])
        return math.nan

    def _may_slip(self, i: int, anywhere: bool) -> bool:
        if self._twists is not None:
            return anywhere and self._twists[i] is not None
        speeds = np.abs(self._rates[i])
        return bool((speeds.max() if anywhere else speeds[0]) >= SLIP_SPEED_MM_PER_S)

    def _scalars(self, i: int, state: ContactState | None) -> dict[str, float]:
        s = self._sampled
        x, y = self.centre(i)
        place = {"time_s": float(s.time[i]), "drive_mm": float(s.drive[i]), "centre_x_mm": x, "centre_y_mm": y}
        if state is None:
            return {**dict.fromkeys(SCALARS, 0.0), **place, "stick_ratio": 1.0}
        contact, (fx, fy) = self._pressed(i), state.tangential_force
        limit = self._strength(i, fx, fy)
        return {
            **place,
            "Fx_N": float(fx),
            "Fy_N": float(fy),
            "Fz_N": float(contact.normal_force),
            "friction_coefficient": limit / contact.normal_force,
            "margin": math.hypot(math.hypot(fx, fy) / limit, self._torque_margin(i)),
            **self._turned(i),
        }

    def _strength(self, i: int, fx: float, fy: float) -> float:
        """Return the force of full sliding in a direction at frame ``i`` [N], static and at its speed."""
        return self._limit(self._pressed(i)) * self._slide.frames[i].speed_factor

    def _torque_margin(self, i: int) -> float:
        """Return a twist's torque over that of full sliding."""
        twist = self._twists[i] if self._twists is not None else None
        return 0.0 if twist is None else twist.torque / sliding_torque(self._pressed(i), self._friction)

    def _turned(self, i: int) -> dict[str, float]:
        twist = self._twists[i] if self._twists is not None else None
        turned = 0.0 if twist is None else math.degrees(twist.angle)
        return {"tip_displacement_mm": float(self._slide.frames[i].tip_displacement), "rotation_deg": turned}
