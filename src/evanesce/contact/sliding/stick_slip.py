"""A finger as a mass on a spring, pulled over glass: stick, slip, and the frequency of their alternation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Slider:
    """A finger on a compliant drive.

    Attributes
    ----------
    mass : float
        Moving mass [kg].
    stiffness : float
        Of drive and finger in series, along the slide [N/mm].
    damping : float
        Of the drive [N s/mm].
    normal_force : float
        [N].
    static_friction, dynamic_friction : float
        Coefficients; the dynamic one at vanishing speed.
    speed_slope : float
        Rise of the dynamic coefficient with speed [s/mm]; negative weakens.
    """

    mass: float
    stiffness: float
    normal_force: float
    static_friction: float
    dynamic_friction: float
    damping: float = 0.0
    speed_slope: float = 0.0

    def __post_init__(self) -> None:
        if min(self.mass, self.stiffness, self.normal_force) <= 0 or self.damping < 0:
            raise ValueError("mass, stiffness and normal force must be positive, damping not negative")
        if not 0 < self.dynamic_friction <= self.static_friction:
            raise ValueError("dynamic friction must be positive and not exceed static friction")

    @property
    def _mass(self) -> float:
        """Mass in N s^2/mm, so that forces come out in N with lengths in mm."""
        return self.mass * 1e-3

    @property
    def natural_frequency(self) -> float:
        """Of the free mass on its spring [Hz]."""
        return float(np.sqrt(self.stiffness / self._mass) / (2.0 * np.pi))


def stick_slip_period(slider: Slider, speed: float) -> float:
    """Return the period of steady stick-slip [s], in closed form, without damping and speed dependence.

    Sticking lasts 2 (mu_s - mu_d) N/(k V), the slide (2/omega)(pi - arctan((mu_s - mu_d) N omega/(k V))).

    Parameters
    ----------
    slider : Slider
    speed : float
        Of the drive [mm/s], > 0.

    Returns
    -------
    float
        [s].

    Raises
    ------
    ValueError
        For a slider with damping or speed dependence, which has no such form.

    References
    ----------
    F. P. Bowden and D. Tabor, The Friction and Lubrication of Solids (1950), chapter 5; B. N. J. Persson, Sliding
    Friction (2000), section 3.2.
    """
    if slider.damping or slider.speed_slope or speed <= 0:
        raise ValueError("the closed form holds without damping and speed dependence, at a speed above 0")
    omega = 2.0 * np.pi * slider.natural_frequency
    drop = (slider.static_friction - slider.dynamic_friction) * slider.normal_force / slider.stiffness
    return float(2.0 * drop / speed + 2.0 / omega * (np.pi - np.arctan(drop * omega / speed)))


@dataclass(frozen=True)
class StickSlip:
    """Motion of the slider.

    Attributes
    ----------
    time : ndarray (n,)
        [s], even.
    position : ndarray (n,)
        Of the finger on the glass [mm].
    spring_force : ndarray (n,)
        What the load cell reads [N].
    sticking : ndarray of bool (n,)
    onsets : ndarray (m,)
        Times at which it broke away [s].
    """

    time: Floats
    position: Floats
    spring_force: Floats
    sticking: NDArray[np.bool_]
    onsets: Floats


def simulate_stick_slip(slider: Slider, speed: float, duration: float, sampling_rate: float = 1000.0) -> StickSlip:
    """Pull the slider from rest at a constant drive speed.

    While it sticks, nothing moves but the drive, and the time of break-away is known exactly; each slide is integrated
    until the finger's speed returns to zero.

    Parameters
    ----------
    slider : Slider
    speed : float
        Of the drive [mm/s], > 0.
    duration : float
        [s].
    sampling_rate : float
        Of the returned record [Hz].

    Returns
    -------
    StickSlip

    Raises
    ------
    ValueError
        For a non-positive speed or duration, or a record of more than 10^7 samples.
    """
    if speed <= 0 or duration <= 0 or not 1 < duration * sampling_rate <= 1e7:
        raise ValueError("speed and duration must be positive, and the record between 2 and 10^7 samples")
    n, k, c, m = slider.normal_force, slider.stiffness, slider.damping, slider._mass
    time = np.arange(int(duration * sampling_rate) + 1) / sampling_rate
    position, velocity, sticking = np.zeros_like(time), np.zeros_like(time), np.zeros(len(time), dtype=bool)
    t, x, onsets = 0.0, 0.0, []

    def slide(s: float, y: Floats) -> list[float]:
        drag = n * (slider.dynamic_friction + slider.speed_slope * max(y[1], 0.0))
        return [y[1], (k * (speed * s - y[0]) + c * (speed - y[1]) - drag) / m]

    def stops(s: float, y: Floats) -> float:
        return y[1]

    stops.terminal, stops.direction = True, -1.0  # type: ignore[attr-defined]
    step = 0.05 / slider.natural_frequency
    while t < duration:
        # Strength is compared with the whole pull, spring and dashpot.
        away = max(t, ((slider.static_friction * n - c * speed) / k + x) / speed)
        held = (time >= t) & (time < min(away, duration + 1.0))
        position[held], sticking[held] = x, True
        if away >= duration:
            break
        onsets.append(away)
        # A push of one part in 10^9 of the drive speed places the solver on one side of rest.
        run = solve_ivp(
            slide, (away, duration), [x, 1e-9 * speed], method="DOP853", events=stops, max_step=step,
            rtol=1e-9, atol=1e-12, dense_output=True,
        )  # fmt: skip
        t = float(run.t[-1])
        moving = (time >= away) & (time <= t)
        if moving.any():
            position[moving], velocity[moving] = run.sol(time[moving])
        x = float(run.y[0, -1])
        if t <= away:
            break
    force = k * (speed * time - position) + c * (speed - velocity)
    return StickSlip(time, position, force, sticking, np.array(onsets))
