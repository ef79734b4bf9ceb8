"""Exposure of a scene whose own is not known, and the figures that a rig comes to."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from evanesce.api.camera import Camera
from evanesce.core.errors import InputError, WorkError
from evanesce.optics.led import led_positions, led_powers
from evanesce.optics.led_circuit import segment_current
from evanesce.optics.projection import Projection
from evanesce.rig import Scene
from evanesce.rig.camera import Pixel
from evanesce.rig.change import changed
from evanesce.rig.coarser import coarser_camera

COLUMNS = 256
"""Columns of the frame by which exposure is found: light needs no detail."""
GRID_SAMPLES = 256
LEVEL = 0.5
"""Share of full scale at which the brightest hundredth of the contact is exposed."""
LEVEL_PERCENT = 99.0
MOST_GAIN = 16.0
DARKER = 8.0
CLEAR = (0.2, 0.9)
"""Levels between which neither noise nor a full pixel displaces the brightest hundredth."""
ATTEMPTS = 8
WIDE = 0.5
"""Contact radius over the tip's above which a sphere's depth is over 7 % more than the paraboloid's of Hertz [1]."""


@dataclass(frozen=True)
class RigFigures:
    """What a rig comes to.

    Attributes
    ----------
    field_mm : tuple of float
        Width and height of the field of view on the contact plane, before distortion [mm].
    pixel_um : float
        Of the contact plane, to a pixel [um].
    distance_mm : float
        Pinhole of the lens below the plate's lower face [mm].
    leds : dict
        Number by edge.
    segment_mA, led_mW : float
        Current of a segment of the strip, radiant power of an LED.
    force_N : float
        Largest of the programme.
    area_mm2, tip_radius_mm : float
        True contact area at it, and radius of the tip.
    level : float
        Brightest hundredth of the contact over full scale, linear [1].
    """

    field_mm: tuple[float, float]
    pixel_um: float
    distance_mm: float
    leds: dict[str, int]
    segment_mA: float
    led_mW: float
    force_N: float
    area_mm2: float
    tip_radius_mm: float
    level: float

    def warnings(self) -> list[str]:
        """Return what is likely wrong with such a rig."""
        found = []
        if self.distance_mm <= 0:
            found.append(
                f"the lens would stand {-self.distance_mm:.3g} mm inside the plate: check scale, lens and pixel"
            )
        if not sum(self.leds.values()):
            found.append("no LED fits on the edges: check leds.pitch_mm and plate.size_mm")
        if self.level > 1.0:
            found.append(f"the contact is overexposed {self.level:.3g} times: shorten camera.exposure_ms")
        elif self.level < 0.02:
            found.append(f"the contact reaches {100 * self.level:.2g} % of full scale: more light or a longer exposure")
        radius = math.sqrt(self.area_mm2 / math.pi)
        if 2 * radius > min(self.field_mm):
            found.append("the contact is wider than the field of view")
        if radius > WIDE * self.tip_radius_mm:
            found.append(
                f"at {self.force_N:g} N the contact's radius is {radius / self.tip_radius_mm:.2g} of the tip's: laws of"
                " small contacts, such as Hertz's, do not hold"
            )
        return found


def exposed(scene: Scene) -> tuple[Scene, float]:
    """Return the scene with exposure time and gain by which its contact is well exposed, and the level reached.

    The largest force is simulated with large pixels and a linear curve. Gain rises only where the frame rate leaves too
    little time.

    Parameters
    ----------
    scene : Scene

    Returns
    -------
    scene : Scene
    level : float
        Brightest hundredth of the contact over full scale [1].

    Raises
    ------
    InputError
        If the supply's voltage is too low for the LEDs.
    WorkError
        If the contact sends no light to the camera for another reason.
    """
    level, exposure = contact_level(scene)
    if level <= 0.0:
        circuit, volts = scene.leds.circuit, scene.leds.voltage_V
        series = circuit.leds_per_segment * circuit.forward_voltage_V
        if volts < series:
            raise InputError(
                f"{volts:g}: the contact sends no light to the camera", file="init", key="leds.voltage_V",
                allowed=f"about {series:.3g} V or more, {circuit.leds_per_segment} LEDs in series",
            )  # fmt: skip
        raise WorkError("the contact sends no light to the camera")
    wanted = exposure * LEVEL / level
    longest = 1e3 / scene.press.frame_rate_hz
    time = float(f"{min(max(wanted, 0.001), longest):.3g}")
    gain = float(f"{min(max(wanted / time, 1.0), MOST_GAIN):.3g}") if wanted > time else 1.0
    found = changed(scene, {"camera.exposure_ms": time, "camera.analogue_gain": gain}, file="init")
    why = (
        f"exposes the contact at {largest_force(scene):g} N to {100 * LEVEL * time * gain / wanted:.0f} % of full scale"
    )
    said = {**found.assumptions, "camera.exposure_ms": why}
    if gain > 1.0:
        said["camera.analogue_gain"] = "the frame rate leaves too little time"
    return found.model_copy(update={"assumptions": said}), LEVEL * time * gain / wanted


def contact_level(scene: Scene) -> tuple[float, float]:
    """Return the linear level of the brightest hundredth of the contact [1] and the exposure at gain 1 for it [ms].

    Parameters
    ----------
    scene : Scene
    """
    coarse = coarse_grey(scene)
    camera = coarse.camera
    exposure = camera.exposure_ms * camera.analogue_gain
    pixel = camera.pixel
    full = min(
        2.0**pixel.bits - 1.0 - pixel.black_level_DN, pixel.full_well_capacity_e / pixel.conversion_gain_e_per_DN
    )
    for _ in range(ATTEMPTS):
        time = min(max(exposure, 0.001), 10000.0)
        shot = Camera(changed(coarse, {"camera.exposure_ms": time, "camera.analogue_gain": 1.0})).shoot(
            largest_force(scene)
        )
        inside = shot.raw[shot.truth.mask]
        if inside.size == 0:
            return 0.0, time
        level = (float(np.percentile(inside, LEVEL_PERCENT)) - pixel.black_level_DN) / full
        if CLEAR[0] < level < CLEAR[1] or not 0.001 < time < 10000.0:
            return level, time
        exposure = time / DARKER if level >= CLEAR[1] else time * min(LEVEL / max(level, 1e-6), DARKER)
    return level, time


def figures(scene: Scene) -> RigFigures:
    """Return what a rig comes to, by simulating its largest force with large pixels.

    Parameters
    ----------
    scene : Scene
    """
    camera, force = scene.camera, largest_force(scene)
    cols, rows = camera.resolution_px
    level, exposure = contact_level(scene)
    area = Camera(coarse_grey(scene)).shoot(force).truth.area_mm2
    return RigFigures(
        field_mm=(cols / camera.scale_px_per_mm, rows / camera.scale_px_per_mm),
        pixel_um=1e3 / camera.scale_px_per_mm,
        distance_mm=Projection.of(camera, scene.plate).clearance,
        leds={edge: len(centres) for edge, centres in led_positions(scene.plate, scene.leds).items()},
        segment_mA=float(segment_current(scene.leds.circuit, scene.leds.voltage_V)) * 1e3,
        led_mW=1e3 * max(led_powers(scene.leds).values(), default=0.0),
        force_N=force,
        area_mm2=float(area),
        tip_radius_mm=scene.finger.tip_radius_mm,
        level=level * camera.exposure_ms * camera.analogue_gain / exposure,
    )


def largest_force(scene: Scene) -> float:
    """Return the largest force of a scene's programme [N]."""
    press = scene.press
    if press.forces_N is not None:
        return max(press.forces_N)
    assert press.ramp is not None
    return max(press.ramp.start_N, press.ramp.stop_N)


def coarse_grey(scene: Scene) -> Scene:
    """Return the scene with few large pixels, in grey and linear."""
    cols, rows = scene.camera.resolution_px
    pixel = scene.camera.pixel
    # Larger pixels have larger wells: none beyond what a scene may state.
    most = [
        cols // COLUMNS, _bound("pitch_um") / pixel.pitch_um,
        math.sqrt(_bound("full_well_capacity_e") / pixel.full_well_capacity_e),
        math.sqrt(_bound("conversion_gain_e_per_DN") / pixel.conversion_gain_e_per_DN),
    ]  # fmt: skip
    factor = max(1, int(min(most)))
    cut: dict[str, Any] = {
        "camera.resolution_px": [cols - cols % factor, rows - rows % factor],
        "camera.tone_curve": "linear", "camera.auto_exposure": None,
    }  # fmt: skip
    if scene.finger.fingerprint is None and scene.finger.height_map is None:
        cut["grid.samples"] = min(scene.grid.samples, GRID_SAMPLES)
    return coarser_camera(changed(scene, cut), factor)


def _bound(key: str) -> float:
    return dict(Pixel.quantities())[key].bounds[1]
