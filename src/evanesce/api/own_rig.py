"""A scene of one's own rig, from a preset and answers about plate, LEDs, camera, lens and finger."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from evanesce.api.own_answers import Changes, RigAnswers
from evanesce.api.own_camera import camera_changes, card_changes
from evanesce.api.own_finger import finger_changes
from evanesce.core.errors import InputError
from evanesce.core.resources import resource
from evanesce.optics.led_circuit import segment_current
from evanesce.optics.seen import seen_finger
from evanesce.optics.spectrum import spectrum_of
from evanesce.rig import Scene, load_scene, scene_path
from evanesce.rig.catalogue import MATERIALS, PACKAGES, chosen
from evanesce.rig.change import changed
from evanesce.rig.load import validate

PRESETS = ("thesis", "thesis_ridged", "pmma_infrared", "gripper", "prism_reader", "human_print")
WHITE_NM = 589.3
"""Wavelength of published indices, at which white light is seen [nm]."""


@dataclass(frozen=True)
class OwnRig:
    """A scene of one's own rig.

    Attributes
    ----------
    scene : Scene
    heading : str
        First lines for its file.
    notes : tuple of str
        What a user has to know: figures that were taken along, what is not simulated.
    changed : frozenset of str
        Dotted keys that do not come from the preset.
    """

    scene: Scene
    heading: str
    notes: tuple[str, ...]
    changed: frozenset[str] = frozenset()


def preset_heading(preset: str) -> str:
    """Return the comment at the head of a preset's file, without comment signs.

    Parameters
    ----------
    preset : str

    Raises
    ------
    InputError
        If there is no such preset.
    """
    if preset not in PRESETS or not resource("scenes", f"{preset}.toml").is_file():
        raise InputError(f"'{preset}' is not known", key="preset", allowed=", ".join(PRESETS))
    lines = scene_path(preset).read_text(encoding="utf-8").splitlines()
    head = [line for line in lines[: next(k for k, line in enumerate(lines) if not line.startswith("#"))]]
    return "\n".join(line.removeprefix("#").strip() for line in head)


def own_rig(answers: RigAnswers, preset: str = "thesis") -> OwnRig:
    """Return a scene made of a preset and of what is known of a rig.

    Parameters
    ----------
    answers : RigAnswers
    preset : str
        One of :data:`PRESETS`: whatever is not known is taken from it.

    Returns
    -------
    OwnRig
        With no exposure found yet: :func:`evanesce.api.own_exposure.exposed`.

    Raises
    ------
    InputError
        For an unknown name, a value out of range, or answers that contradict each other, naming the scene's key or the
        answer.

    Examples
    --------
    >>> import evanesce as ev
    >>> rig = ev.own_rig(ev.RigAnswers(thickness_mm=8.0, material="pmma", camera="pi_3", field_mm=60.0))
    >>> rig.scene.plate.refractive_index, rig.scene.camera.resolution_px
    (1.4905, (2304, 1296))
    """
    heading = preset_heading(preset)
    base = load_scene(preset)
    scene, changes, given = base, Changes(), set[str]()
    if answers.is_empty:
        return OwnRig(base, heading, ())
    for step in (_light, _plate, finger_changes, camera_changes, card_changes, _rest):
        found = Changes()
        step(scene, answers, found)
        scene = _applied(scene, found)
        changes.notes += found.notes
        given |= found.values.keys()
    if answers.settings:
        found = Changes()
        for key, value in answers.settings.items():
            found.known(key.replace("__", "."), value)
        scene = _applied(scene, found)
        given |= found.values.keys()
    return OwnRig(_with_origins(scene, base, preset), _heading(heading, preset), tuple(changes.notes), frozenset(given))


def _with_origins(scene: Scene, base: Scene, preset: str) -> Scene:
    """Return a scene in which what the preset says of its own figures is said to be the preset's."""
    said = {name: dict(getattr(scene, name)) for name in ("sources", "assumptions")}
    for name, texts in said.items():
        own = getattr(base, name)
        texts.update({key: f"of the preset {preset}: {text}" for key, text in texts.items() if own.get(key) == text})
    return scene.model_copy(update=said)


def _heading(heading: str, preset: str) -> str:
    return f"Rig written by `evanesce init`, from the preset {preset}. The preset says of itself:\n{heading}"


def _applied(scene: Scene, changes: Changes) -> Scene:
    """Return the scene with keys replaced, and what is said of them."""
    if not changes.values:
        return scene
    found = changed(scene, changes.values, file="init")
    data = found.as_dict()
    for name, said in (("sources", changes.sources), ("assumptions", changes.assumptions)):
        data[name].update({key: text for key, text in said.items() if _has(data, key)})
    return validate(Scene, data, "init")


def _has(data: Mapping[str, Any], key: str) -> bool:
    value: Any = data
    for part in key.split("."):
        value = value.get(part) if isinstance(value, Mapping) else None
    return value is not None


def _light(scene: Scene, answers: RigAnswers, found: Changes) -> None:
    if answers.spectrum is not None:
        if scene.figures_at_nm is not None and answers.material is None and answers.index is None:
            raise InputError(
                f"figures of the preset's plate hold at {scene.figures_at_nm:g} nm", key="spectrum",
                allowed="with the plate's material",
            )  # fmt: skip
        if answers.spectrum != scene.leds.spectrum:
            found.values["leds.circuit"] = {}  # another type of LED has another circuit
            found.notes.append(f"circuit of the strips: that of {answers.spectrum} LEDs, see [leds.circuit]")
        found.known("leds.spectrum", answers.spectrum)
        found.values["figures_at_nm"] = None
    found.known("leds.pitch_mm", answers.led_pitch_mm)
    if answers.package is not None:
        package = chosen(PACKAGES, answers.package, "package")
        found.assumed("leds.emitting_width_mm", package.width_mm, package.source)
        found.assumed("leds.emitting_height_mm", package.height_mm, package.source)
        # a package that is taller than the preset's plate may fit the one that is given
        found.known("plate.thickness_mm", answers.thickness_mm)
    if answers.edges is not None:
        found.known("leds.edges", list(answers.edges))
    if answers.voltage_V is not None and answers.current_mA is not None:
        raise InputError("is given beside the voltage", key="current_mA", allowed="one of them")
    found.known("leds.voltage_V", answers.voltage_V)


def _plate(scene: Scene, answers: RigAnswers, found: Changes) -> None:
    if answers.plate_size_mm is not None:
        found.known("plate.size_mm", list(answers.plate_size_mm))
    found.known("plate.thickness_mm", answers.thickness_mm)
    if answers.material is None:
        found.known("plate.refractive_index", answers.index)
        found.known("plate.absorption_coefficient_per_mm", answers.absorption_per_mm)
    else:
        _material(scene, answers, found)
    if answers.current_mA is not None:
        voltage = voltage_of(scene, answers.current_mA)
        found.known("leds.voltage_V", voltage, f"{answers.current_mA:g} mA given, by [leds.circuit]")


def _material(scene: Scene, answers: RigAnswers, found: Changes) -> None:
    """State index and absorption of a named material at the LEDs' wavelength, or as published in white light."""
    material = chosen(MATERIALS, answers.material or "", "material")
    white = scene.leds.spectrum == "white"
    wavelength = WHITE_NM if white else float(round(spectrum_of(scene.leds).mean_wavelength_nm))
    at = f" at {wavelength:g} nm"
    found.known("plate.refractive_index", material.index(wavelength), material.index_source + at)
    found.assumed(
        "plate.absorption_coefficient_per_mm", float(f"{material.absorption_per_mm(wavelength):.3g}"),
        material.absorption_source,
    )  # fmt: skip
    found.known("plate.refractive_index", answers.index)
    if answers.absorption_per_mm is not None:
        del found.assumptions["plate.absorption_coefficient_per_mm"]
        found.known("plate.absorption_coefficient_per_mm", answers.absorption_per_mm)
    if not white:
        # Else the plate would be taken from white light to this wavelength as if it were soda-lime glass.
        found.known("figures_at_nm", wavelength, "mean wavelength of the LEDs")
        found.known("camera.wavelength_nm", wavelength, "mean wavelength of the LEDs")
        seen = seen_finger(scene, wavelength)
        source = f"the preset's, taken to {wavelength:g} nm by the dispersion of PDMS (Schneider et al. 2009)"
        found.assumed("finger.refractive_index", round(seen.refractive_index, 4), source)
    elif scene.figures_at_nm is not None:
        found.values["figures_at_nm"] = None
        found.assumed("finger.refractive_index", 1.41, "published PDMS data run from 1.395 to 1.432")


def voltage_of(scene: Scene, current_mA: float) -> float:
    """Return the supply voltage at which a segment of the scene's strips carries a current [V].

    Parameters
    ----------
    scene : Scene
    current_mA : float

    Raises
    ------
    InputError
        If no voltage up to 60 V drives it.
    """
    from scipy.optimize import brentq

    most = float(segment_current(scene.leds.circuit, 60.0)) * 1e3
    if not 0.0 < current_mA <= most:
        raise InputError(f"{current_mA:g}", key="current_mA", allowed=f"above 0, to {most:.3g} mA at 60 V")

    def missing(voltage: float) -> float:
        return float(segment_current(scene.leds.circuit, voltage)) * 1e3 - current_mA

    return round(float(brentq(missing, 0.0, 60.0)), 4)


def _rest(scene: Scene, answers: RigAnswers, found: Changes) -> None:
    if answers.forces_N is not None:
        found.known("press.forces_N", list(answers.forces_N))
        found.values["press.ramp"] = None
    found.values["title"] = answers.title if answers.title is not None else f"Own rig, from: {scene.title}"[:200]
