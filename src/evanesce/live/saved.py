"""Write a setting as a scene's TOML text; values that have no key in a scene are comments above it."""

from __future__ import annotations

from evanesce.live.controls import Controls, scene_of
from evanesce.rig import Scene
from evanesce.rig.load import dump_scene


def scene_text(base: Scene, controls: Controls) -> str:
    """Return the scene of a setting at full resolution as text that :func:`evanesce.rig.load_scene` reads back equal.

    Height map and spectrum are named as :func:`evanesce.rig.copy_scene_files` names their copies, which belong beside
    the text.

    Raises
    ------
    InputError
        If the setting is infeasible.
    """
    scene = scene_of(base, controls)
    lines = [
        "Saved from the live page (evanesce serve).",
        f"Shown there with threshold {controls.threshold:g}, minimum blob size {controls.min_blob_px:g} px, "
        f"pixels {controls.coarser} times as large.",
        "evanesce render THIS --fast, then",
        f"evanesce compare FOLDER --threshold {controls.threshold:g} --min-blob {controls.min_blob_px:.0f} "
        "--calibration CALIBRATION",
    ]
    return "".join(f"# {line}\n" for line in lines) + "\n" + dump_scene(scene)
