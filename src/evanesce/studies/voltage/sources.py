"""Sources of excess area in the voltage study, and scenes with or without them."""

from __future__ import annotations

from typing import Any, Literal, get_args

from evanesce.rig import Scene

Source = Literal["subsurface scattering", "blur", "saturation", "specks"]
SOURCES: tuple[Source, ...] = get_args(Source)
Omitted = frozenset[Source]
NOTHING: Omitted = frozenset()

DEFAULT_LENGTH_MM = 0.5
DEFAULT_SPECKS_PER_CM2 = 418.0


def study_scene(scene: Scene) -> tuple[Scene, list[str]]:
    """Return a scene with the effects that the study switches off, and notes of what was added.

    A scene without subsurface scattering or specks gets them: without scattering no light enters the grooves.

    Parameters
    ----------
    scene : Scene

    Returns
    -------
    scene : Scene
    notes : list of str
    """
    notes = []
    effects: dict[str, Any] = {name: dict(table) for name, table in scene.effects.items()}
    if scene.finger.scattering_length_mm == 0 and "lateral_glow" not in effects:
        effects["lateral_glow"] = {"length_mm": DEFAULT_LENGTH_MM}
        notes.append(f"lateral_glow.length_mm = {DEFAULT_LENGTH_MM:g}: not in the scene, not published")
    if "specks" not in effects:
        effects["specks"] = {"per_cm2": DEFAULT_SPECKS_PER_CM2}
        notes.append(f"specks.per_cm2 = {DEFAULT_SPECKS_PER_CM2:g}: not in the scene; counted on the rig's photograph")
    return scene.model_copy(update={"effects": effects}), notes


def without_sources(scene: Scene, omitted: Omitted) -> Scene:
    """Return a scene without subsurface scattering or specks (blur and saturation belong to the camera).

    Parameters
    ----------
    scene : Scene
    omitted : frozenset of str
        Of :data:`SOURCES`.

    Returns
    -------
    Scene
    """
    effects = dict(scene.effects)
    finger = scene.finger
    if "subsurface scattering" in omitted:
        effects.pop("lateral_glow", None)
        finger = finger.model_copy(update={"scattering_length_mm": 0.0})
    if "specks" in omitted:
        effects.pop("specks", None)
    return scene.model_copy(update={"effects": effects, "finger": finger})


def at_voltage(scene: Scene, voltage: float) -> Scene:
    """Return a scene whose LEDs' common supply is at another voltage [V].

    Parameters
    ----------
    scene : Scene
    voltage : float
        [V].

    Returns
    -------
    Scene
    """
    return scene.model_copy(update={"leds": scene.leds.model_copy(update={"voltage_V": voltage})})
