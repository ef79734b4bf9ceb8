"""The finger of one's own rig."""

from __future__ import annotations

from evanesce.api.own_answers import FINGERS, Changes, RigAnswers
from evanesce.core.errors import InputError
from evanesce.rig import Scene, load_scene

PAD_RADIUS = 2.0
"""Radius of a pad's tip over its diameter: the bluntest tip of a scene, as flat faces are not simulated."""


def finger_changes(scene: Scene, answers: RigAnswers, found: Changes) -> None:
    """Add what is known of the finger to a rig's changes.

    Parameters
    ----------
    scene : Scene
    answers : RigAnswers
    found : Changes
    """
    kind = answers.finger
    if kind is not None and kind not in FINGERS:
        raise InputError(f"'{kind}' is not known", key="finger", allowed=", ".join(FINGERS))
    if kind is not None:
        found.values |= {"finger.ridges": None, "finger.fingerprint": None, "finger.height_map": None}
    radius = answers.tip_radius_mm
    if kind == "pad" and radius is None:
        blunt = PAD_RADIUS * scene.finger.diameter_mm
        found.assumed("finger.tip_radius_mm", blunt, "a pad: flat faces are not simulated, a blunt tip is")
        found.notes.append(f"a flat pad is simulated as a ball of {blunt:g} mm radius: contact grows from its middle")
    if radius is not None:
        found.known("finger.tip_radius_mm", radius)
        if kind != "pad":
            found.known("finger.diameter_mm", min(2.0 * radius, 200.0), "twice the tip's radius")
    given = any(v is not None for v in (answers.ridge_height_um, answers.ridge_width_um, answers.ridge_pitch_um))
    new = kind == "ridged" or (kind == "pad" and given)
    if new or (scene.finger.ridges is not None and kind is None):
        _ridges(answers, new, found)
    elif given:
        raise InputError(
            "is given for a finger without ridges", key="ridge_height_um", allowed="with --finger ridged or pad"
        )
    if kind == "print":
        human = load_scene("human_print")
        found.known("finger.fingerprint", human.finger.fingerprint, "the preset human_print")
        found.values["contact"] = human.contact
        found.values |= {"finger.reduced_modulus": None, "finger.mooney_rivlin": None, "finger.material": "own"}
        for key in ("modulus_MPa", "refractive_index", "diffuse_reflectance"):
            found.assumed(f"finger.{key}", getattr(human.finger, key), "a human finger, as in the preset human_print")
        found.known("grid.samples", 640, "some twenty to a ridge")
        found.known("grid.size_mm", 16.0, "as in the preset human_print")
    if answers.silicone is not None and answers.modulus_MPa is not None:
        raise InputError("is given beside the modulus", key="silicone", allowed="one of them")
    if answers.silicone is not None or answers.modulus_MPa is not None:
        found.values |= {"finger.modulus_MPa": None, "finger.reduced_modulus": None, "finger.mooney_rivlin": None}
        found.known("finger.material", "own" if answers.silicone is None else answers.silicone)
        found.known("finger.modulus_MPa", answers.modulus_MPa)


def _ridges(answers: RigAnswers, new: bool, found: Changes) -> None:
    moulded = "thesis, section 3.5.1, table 4, moulded"
    if new:
        found.known("finger.ridges.height_um", 47.67, moulded)
        found.known("finger.ridges.width_um", 501.1, moulded)
        found.assumed("finger.ridges.pitch_um", 1000.0, "about twice the width")
    found.known("finger.ridges.height_um", answers.ridge_height_um)
    found.known("finger.ridges.width_um", answers.ridge_width_um)
    if answers.ridge_pitch_um is not None:
        found.assumptions.pop("finger.ridges.pitch_um", None)
        found.known("finger.ridges.pitch_um", answers.ridge_pitch_um)
