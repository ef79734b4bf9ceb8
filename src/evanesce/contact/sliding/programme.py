"""The thesis's friction programme: preload, press to the load, slide, perhaps back again; and its contact states."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.contact.analytic.hertz import hertz_contact
from evanesce.contact.analytic.partial_slip import tangential_modulus
from evanesce.contact.patch import AxisymmetricContact
from evanesce.contact.sliding.shaft import tilted_compliance
from evanesce.contact.sliding.shear_area import Share
from evanesce.contact.sliding.solver import march
from evanesce.contact.sliding.states import SlideStates, SlideView
from evanesce.core.errors import InputError
from evanesce.core.states import PlateGrid
from evanesce.materials.friction import InterfaceFriction
from evanesce.materials.tables import Material

Floats = NDArray[np.float64]
MAX_FRAMES = 100_000


@dataclass(frozen=True)
class SlideProgramme:
    """What the machine does.

    Attributes
    ----------
    normal_force, preload : float
        [N].
    press_time, hold_time : float
        From preload to load, and resting there [s].
    speed, distance : float
        Of the slide [mm/s], [mm].
    reciprocate : bool
        Slide back to the start afterwards.
    frame_rate : float
        [Hz].
    """

    normal_force: float = 1.0
    preload: float = 0.05
    press_time: float = 2.0
    hold_time: float = 0.0
    speed: float = 1.0
    distance: float = 5.0
    reciprocate: bool = False
    frame_rate: float = 30.0

    def sample(self) -> tuple[Floats, Floats, Floats]:
        """Return time, normal force and drive displacement of every frame.

        Returns
        -------
        time, force, drive : ndarray (frames,)
            [s], [N], [mm].

        Raises
        ------
        InputError
            For a programme that cannot run, or has more than 100,000 frames.
        """
        positive = ("normal_force", "press_time", "speed", "distance", "frame_rate")
        for name in (*positive, "preload", "hold_time"):
            value = getattr(self, name)
            if not np.isfinite(value) or value < 0 or (value == 0 and name in positive):
                raise InputError(f"{value:g}", key=name, allowed="a finite number above 0")
        turn = self.press_time + self.hold_time
        one_way = self.distance / self.speed
        end = turn + one_way * (2 if self.reciprocate else 1)
        frames = int(np.floor(end * self.frame_rate)) + 1
        if not 2 <= frames <= MAX_FRAMES:
            raise InputError(f"{frames} frames", key="frame_rate", allowed=f"2 to {MAX_FRAMES} frames")
        time = np.arange(frames) / self.frame_rate
        force = np.interp(time, [0.0, self.press_time], [self.preload, self.normal_force])
        back = 0.0 if self.reciprocate else self.distance
        drive = np.interp(time, [turn, turn + one_way, turn + 2 * one_way], [0.0, self.distance, back])
        return time, force, drive

    def speeds(self, time: Floats) -> Floats:
        """Return the drive's speed while it moves, in the time up to each of some times [mm/s].

        Parameters
        ----------
        time : ndarray (n,)
            [s], ascending.

        Returns
        -------
        ndarray (n,)
            0 where it rests all that time.
        """
        start = self.press_time + self.hold_time
        end = start + self.distance / self.speed * (2 if self.reciprocate else 1)
        before = np.append(time[0], time[:-1])
        return np.where((time > start) & (before < end) & (time > before), self.speed, 0.0)


def slide_states(
    grid: PlateGrid,
    programme: SlideProgramme,
    friction: InterfaceFriction,
    contacts: Sequence[AxisymmetricContact],
    moduli: Sequence[float],
    *,
    drive_stiffness: float = float("inf"),
    area_loss: float = 0.0,
    shares: Sequence[Share] | None = None,
    stick_slip_drop: float = 0.0,
    view: SlideView | None = None,
    law: str = "sliding",
    parameters: Mapping[str, Any] | None = None,
) -> SlideStates:
    """Solve a press and slide; each state is sampled on the grid when it is indexed.

    Parameters
    ----------
    grid : PlateGrid
    programme : SlideProgramme
    friction : InterfaceFriction
    contacts : sequence of AxisymmetricContact (frames,)
        Of the smooth finger, in each frame of the programme.
    moduli : sequence of float (frames,)
        G* [MPa] (:func:`~evanesce.contact.analytic.partial_slip.tangential_modulus`).
    drive_stiffness : float
        Of shaft and drive along the slide [N/mm].
    area_loss : float
        Sahli's alpha_A [mm^2/N^2].
    shares : sequence of callable (frames,), optional
    stick_slip_drop : float
        As for :func:`~evanesce.contact.sliding.solver.march`.
    view : SlideView, optional
    law, parameters
        Passed on to the states.

    Returns
    -------
    SlideStates

    Raises
    ------
    InputError
        If the programme cannot run or the contact leaves the grid.
    """
    time, _, drive = programme.sample()
    slide = march(
        contacts,
        time,
        drive,
        friction,
        np.asarray(moduli),
        drive_stiffness=drive_stiffness,
        area_loss=area_loss,
        shares=shares,
        stick_slip_drop=stick_slip_drop,
        speeds=programme.speeds(time),
    )
    return SlideStates(slide, grid, view, law=law, parameters=parameters)


def press_and_slide(
    grid: PlateGrid,
    material: Material,
    friction: InterfaceFriction,
    programme: SlideProgramme,
    *,
    tip_radius: float = 7.5,
    contact_law: Callable[[float], AxisymmetricContact] | None = None,
    shaft_stiffness: tuple[float, float] = (float("inf"), float("inf")),
    contact_angle: float = 0.0,
    area_loss: float = 0.0,
    view: SlideView | None = None,
) -> SlideStates:
    """Press a finger of a silicone to a held normal force and slide it.

    Parameters
    ----------
    grid : PlateGrid
    material : Material
        Gives the force-dependent reduced modulus and Poisson's ratio.
    friction : InterfaceFriction
    programme : SlideProgramme
    tip_radius : float
        [mm].
    contact_law : callable, optional
        Normal force [N] -> contact; Hertz with the material's modulus by default. Any axisymmetric law or imported
        finite-element profile will do.
    shaft_stiffness : tuple of float
        Along and across the finger's axis [N/mm].
    contact_angle : float
        Between the finger's axis and the plate's normal [rad]; the contact stays on the hemisphere.
    area_loss : float
        Sahli's alpha_A [mm^2/N^2].
    view : SlideView, optional

    Returns
    -------
    SlideStates

    Raises
    ------
    InputError
        If the programme cannot run or the contact leaves the grid.

    Notes
    -----
    The normal force is held by the machine, so that of a tilted shaft only the compliance along the slide matters.
    """

    def hertz(load: float) -> AxisymmetricContact:
        return hertz_contact(load, tip_radius, float(material.reduced_modulus(load)))

    def shear_modulus(load: float) -> float:
        return float(tangential_modulus(material.reduced_modulus(load), material.poisson_ratio))

    loads = programme.sample()[1].tolist()
    law = contact_law or hertz
    contact = {load: law(load) for load in dict.fromkeys(loads)}
    stiffness = float("inf")
    if np.isfinite(shaft_stiffness).all():
        stiffness = 1.0 / float(tilted_compliance(*shaft_stiffness, contact_angle)[0, 0])
    parameters = {
        "material": material.name,
        "tip_radius_mm": tip_radius,
        "tau0_MPa": friction.tau0,
        "alpha": friction.alpha,
        "speed_mm_per_s": programme.speed,
        "area_loss_mm2_per_N2": area_loss,
        "contact_angle_deg": float(np.degrees(contact_angle)),
    }
    return slide_states(
        grid, programme, friction, [contact[load] for load in loads], [shear_modulus(load) for load in loads],
        drive_stiffness=stiffness, area_loss=area_loss, view=view,
        law="hertz+sliding" if contact_law is None else "sliding", parameters=parameters,
    )  # fmt: skip
