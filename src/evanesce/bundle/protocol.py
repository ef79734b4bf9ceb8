"""Protocol of a measurement of ten minutes: ramp, hold, voltage sweep, and the shots that separate causes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from evanesce.bundle.layout import Shot, conditions
from evanesce.contact.programme import slide_programme
from evanesce.optics.led import led_radiances
from evanesce.rig import Scene

RAMP = (0.08, 0.2, 0.36, 0.6, 0.8, 1.0)
"""Forces of the ramp over the largest."""

DWELL_S = (5.0, 12.0, 25.0, 45.0, 75.0, 120.0)
"""Times of the hold's frames after the ramp's last [s]."""

LIGHT = (0.35, 0.55, 0.75, 1.25, 1.5)
"""LED power of the voltage sweep's frames over that of the scene's voltage."""

SLIDE_FRAMES = 17
"""Frames of a slide's bundle, at most."""

RAMP_STEP_S = 5.0
SWEEP_STEP_S = 6.0
VOLTAGE_STEP_V = 0.05


@dataclass(frozen=True, kw_only=True)
class Protocol:
    """Frames of a measurement.

    Attributes
    ----------
    press : tuple of Shot
    replicates, led_off, lens_cap, checkerboard, square : int
        Number of frames; replicates repeat the hold's last frame.
    """

    press: tuple[Shot, ...]
    replicates: int = 12
    led_off: int = 4
    lens_cap: int = 4
    checkerboard: int = 1
    square: int = 1


def default_protocol(scene: Scene) -> Protocol:
    """Return the usual protocol of a rig: load only rises, so that creep and stick have one history.

    A ramp of six forces at the scene's voltage, six frames of a hold at the largest over two minutes, five voltages at
    that force; 17 frames in one session. Of a scene with a slide, 17 frames of its programme, spread evenly; it ends in
    motion, so that nothing is held for replicates.

    Parameters
    ----------
    scene : Scene

    Returns
    -------
    Protocol
    """
    if scene.slide is not None:
        return Protocol(press=conditions(_of_slide(scene)), replicates=0)
    largest = (
        max(scene.press.forces_N) if scene.press.forces_N else scene.press.ramp.stop_N if scene.press.ramp else 5.0
    )
    volts = scene.leds.voltage_V
    steps = [(k * RAMP_STEP_S, share * largest, volts) for k, share in enumerate(RAMP)]
    start = steps[-1][0]
    steps += [(start + dwell, largest, volts) for dwell in DWELL_S]
    start = steps[-1][0]
    steps += [(start + (k + 1) * SWEEP_STEP_S, largest, v) for k, v in enumerate(sweep_voltages(scene))]
    shots = [
        Shot(index=k, time_s=time, force_N=round(force, 6), voltage_V=voltage)
        for k, (time, force, voltage) in enumerate(steps)
    ]
    return Protocol(press=conditions(shots))


def _of_slide(scene: Scene) -> list[Shot]:
    times, forces, _ = slide_programme(scene).sample()
    picked = np.unique(np.linspace(0, times.size - 1, min(SLIDE_FRAMES, times.size)).round().astype(int))
    return [
        Shot(index=k, time_s=float(times[i]), force_N=float(forces[i]), voltage_V=scene.leds.voltage_V)
        for k, i in enumerate(picked)
    ]


def sweep_voltages(scene: Scene) -> list[float]:
    """Return the voltages that give the LEDs :data:`LIGHT` times their power, rounded to a supply's step.

    Parameters
    ----------
    scene : Scene

    Returns
    -------
    list of float
        [V].
    """
    volts = np.arange(0.2, 60.0, VOLTAGE_STEP_V)
    own = scene.leds.voltage_V

    def power(voltage: float) -> float:
        leds = scene.leds.model_copy(update={"voltage_V": float(voltage)})
        return float(np.mean(np.concatenate(list(led_radiances(scene.plate, leds).values()))))

    near = volts[(volts > 0.5 * own) & (volts < 1.5 * own)]
    powers = np.array([power(v) for v in near]) / max(power(own), 1e-300)
    found = [round(float(near[np.argmin(np.abs(powers - share))]), 2) for share in LIGHT]
    return [v for k, v in enumerate(found) if v not in found[:k] and abs(v - own) > 1e-6]
