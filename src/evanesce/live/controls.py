"""Controls of the live page with their limits, and the scene of a setting. No pictures, no browser."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal

from evanesce.contact.solve import check_skin
from evanesce.core.errors import InputError
from evanesce.measurement.reference.segment import Chain
from evanesce.optics.led import led_positions
from evanesce.rig import Scene
from evanesce.rig.coarser import coarser_camera
from evanesce.rig.finger import OWN_FIGURES, Ridges
from evanesce.rig.load import validate

SET_HERE = "set on the live page"
DEFAULT_RIDGES = Ridges(pitch_um=1000.0, orientation_deg=90.0)
"""Ridges of a finger without ridges in its scene: those of the shipped ridged scene."""

BLUR_PX, RADIUS_PX = 1.0, 10
"""Blur and dilation radius of the reference segmentation, in pixels of the full resolution."""


@dataclass(frozen=True)
class Knob:
    """A slider.

    Attributes
    ----------
    name : str
        Field of :class:`Controls`.
    label, unit : str
        As printed; unit "" for a pure number.
    low, high, step : float
    digits : int
        Decimals that are shown.
    hint : str
        One line of help.
    """

    name: str
    label: str
    unit: str
    low: float
    high: float
    step: float
    digits: int
    hint: str

    def text(self, value: float) -> str:
        """Return a value with its unit."""
        return f"{value:.{self.digits}f}" + (f" {self.unit}" if self.unit else "")

    def including(self, value: float) -> Knob:
        """Return the slider with limits that include a value: a scene may lie beyond the usual range."""
        return replace(self, low=min(self.low, value), high=max(self.high, value))


KNOBS = (
    Knob("voltage_V", "LED voltage", "V", 6.0, 12.0, 0.05, 2, "supply of all strips that have none of their own"),
    Knob("threshold", "Threshold", "", 0.0, 1.0, 0.0025, 4, "grey level, 0 to 1; brighter is contact"),
    Knob("min_blob_px", "Minimum blob size", "px", 0.0, 20_000.0, 50.0, 0, "of the dilated mask, at full resolution"),
    Knob("force_N", "Force", "N", 0.0, 10.0, 0.05, 2, "normal force"),
    Knob("ridge_height_um", "Ridge height", "µm", 0.0, 150.0, 1.0, 1, "0: a smooth finger"),
    Knob("defocus_um", "Defocus", "µm", -300.0, 300.0, 5.0, 0, "sensor behind best focus"),
    Knob("line_mm", "Profile line", "mm", -8.0, 8.0, 0.05, 2, "distance of the line from the finger's tip"),
)
"""Sliders in the page's order."""


@dataclass(frozen=True, kw_only=True)
class Controls:
    """One setting of all controls of the page.

    Attributes
    ----------
    voltage_V, force_N, ridge_height_um, defocus_um : float
        Of the rig [V, N, um, um]; a ridge height of 0 is a smooth finger.
    led_power : tuple of float
        Power of each LED over that of its circuit, in the order of :func:`led_names`.
    material : str
    threshold : float
        Grey level, 0 to 1.
    min_blob_px : float
        Minimum size of a dilated blob, in pixels of the full resolution.
    line_mm : float
        Distance of the profile's line from the finger's tip [mm].
    along : {"x", "y"}
        Direction of the line.
    coarser : int
        Pixel pitch of camera and contact grid over the scene's: 2 is half the resolution.
    """

    voltage_V: float
    led_power: tuple[float, ...]
    force_N: float
    material: str
    ridge_height_um: float
    defocus_um: float
    threshold: float = 0.15
    min_blob_px: float = 2000.0
    line_mm: float = 0.0
    along: Literal["x", "y"] = "x"
    coarser: int = 2

    def changed(self, **values: Any) -> Controls:
        """Return the setting with some fields replaced.

        Raises
        ------
        InputError
            For a number that is not finite.
        """
        for name, value in values.items():
            if isinstance(value, float) and not math.isfinite(value):
                raise InputError(f"{value}", key=name, allowed="a finite number")
        return replace(self, **values)

    @property
    def chain(self) -> Chain:
        """The reference segmentation at this resolution: its lengths in pixels are divided by ``coarser``."""
        return Chain(
            threshold=self.threshold,
            min_blob=round(self.min_blob_px / self.coarser**2),
            blur=BLUR_PX / self.coarser,
            radius=round(RADIUS_PX / self.coarser),
        )

    @property
    def contact_key(self) -> tuple[Any, ...]:
        """Values that the contact depends on."""
        return self.force_N, self.material, self.ridge_height_um, self.coarser


def led_names(scene: Scene) -> tuple[tuple[str, int], ...]:
    """Return (edge, number from 1) of each LED: edges in the scene's order, each from -x or -y on."""
    return tuple((edge, i + 1) for edge, at in led_positions(scene.plate, scene.leds).items() for i in range(at.size))


def powers_of(scene: Scene) -> tuple[float, ...]:
    """Return the relative power of each LED of a scene."""
    found: list[float] = []
    for edge, at in led_positions(scene.plate, scene.leds).items():
        own = scene.leds.edge.get(edge)  # type: ignore[call-overload]
        found += own.relative_power if own is not None and own.relative_power else (1.0,) * at.size
    return tuple(found)


def controls_of(scene: Scene, *, coarser: int = 2) -> Controls:
    """Return the first setting of a scene: its own values, and the middle one of its forces."""
    forces = scene.press.forces_N
    ramp = scene.press.ramp
    force = forces[len(forces) // 2] if forces else (ramp.start_N + ramp.stop_N) / 2 if ramp is not None else 1.0
    return Controls(
        voltage_V=scene.leds.voltage_V,
        led_power=powers_of(scene),
        force_N=force,
        material=scene.finger.material,
        ridge_height_um=0.0 if scene.finger.ridges is None else scene.finger.ridges.height_um,
        defocus_um=scene.camera.lens.defocus_um,
        coarser=coarser if all(n % coarser == 0 for n in scene.camera.resolution_px) else 1,
    )


def knobs_of(scene: Scene) -> dict[str, Knob]:
    """Return the sliders by name, with limits that include the scene's own values."""
    start = controls_of(scene)
    return {knob.name: knob.including(float(getattr(start, knob.name))) for knob in KNOBS}


def scene_of(base: Scene, controls: Controls) -> Scene:
    """Return the scene of a setting at full resolution; it presses with one force and does not slide.

    Changed keys are listed under ``assumptions`` instead of their former source.

    Raises
    ------
    InputError
        If such a rig is infeasible.
    """
    start = controls_of(base)
    data = base.as_dict()
    changed: list[str] = []
    if controls.voltage_V != start.voltage_V:
        data["leds"]["voltage_V"] = controls.voltage_V
        changed.append("leds.voltage_V")
    if controls.led_power != start.led_power:
        changed += _set_powers(base, data, controls.led_power)
    if controls.material != start.material:
        data["finger"] = {key: value for key, value in data["finger"].items() if key not in OWN_FIGURES}
        data["finger"]["material"] = controls.material
        changed.append("finger.material")
    if controls.ridge_height_um != start.ridge_height_um:
        changed += _set_ridges(base, data, controls.ridge_height_um)
    if controls.defocus_um != start.defocus_um:
        data["camera"]["lens"]["defocus_um"] = controls.defocus_um
        changed.append("camera.lens.defocus_um")
    if base.press.forces_N != (controls.force_N,):
        data["press"] = {"forces_N": [controls.force_N], "frame_rate_hz": base.press.frame_rate_hz}
        changed.append("press.forces_N")
    data.pop("slide", None)
    for table in ("sources", "assumptions"):
        kept = {key: text for key, text in data[table].items() if key not in changed and _present(data, key)}
        data[table] = kept
    data["assumptions"] |= dict.fromkeys(changed, SET_HERE)
    data["assumptions"] = {key: text for key, text in data["assumptions"].items() if _present(data, key)}
    return validate(Scene, data, "page")


def _set_powers(base: Scene, data: dict[str, Any], powers: tuple[float, ...]) -> list[str]:
    """Write the LEDs' powers into plain scene data; return the keys that changed."""
    names = led_names(base)
    if len(powers) != len(names):
        raise InputError(f"{len(powers)} figures for {len(names)} LEDs", key="leds", allowed="one for each LED")
    changed, old = [], powers_of(base)
    for edge in led_positions(base.plate, base.leds):
        at = [i for i, (name, _) in enumerate(names) if name == edge]
        if any(powers[i] != old[i] for i in at):
            data["leds"]["edge"].setdefault(edge, {})["relative_power"] = [powers[i] for i in at]
            changed.append(f"leds.edge.{edge}.relative_power")
    return changed


def _set_ridges(base: Scene, data: dict[str, Any], height_um: float) -> list[str]:
    """Write the ridges' height into plain scene data; return the keys that changed."""
    if height_um == 0.0:
        data["finger"].pop("ridges", None)
        return []
    ridges = base.finger.ridges or DEFAULT_RIDGES
    data["finger"]["ridges"] = ridges.model_dump(mode="json", exclude_none=True) | {"height_um": height_um}
    if base.finger.ridges is not None:
        return ["finger.ridges.height_um"]
    return [f"finger.ridges.{key}" for key in ("height_um", "width_um", "pitch_um", "orientation_deg")]


def _present(data: Mapping[str, Any], dotted: str) -> bool:
    """Return whether a dotted key is in plain scene data, where None is left out."""
    value: Any = data
    for part in dotted.split("."):
        if not isinstance(value, Mapping) or part not in value:
            return False
        value = value[part]
    return True


def scene_at_resolution(scene: Scene, coarser: int) -> Scene:
    """Return a scene with camera and contact grid at a lower resolution; the grid remains where ridges need it.

    Raises
    ------
    InputError
        If the resolution does not divide.
    """
    if coarser == 1:
        return scene
    seen = coarser_camera(scene, coarser, key="resolution")
    fewer = scene.grid.model_copy(update={"samples": max(16, scene.grid.samples // coarser)})
    lighter = seen.model_copy(update={"grid": fewer})
    try:
        check_skin(lighter)
    except InputError:
        return seen
    return lighter
