"""The file of a scene's height map: its path, its digest, and a copy beside a written scene."""

from __future__ import annotations

from pathlib import Path

from evanesce.rig.beside import copy_beside, digest_of, file_beside
from evanesce.rig.scene import Scene

KEY = "finger.height_map"
SUFFIXES = (".npz", ".csv", ".tif", ".tiff", ".exr")
MAX_BYTES = 1_000_000_000

__all__ = ["KEY", "MAX_BYTES", "SUFFIXES", "copy_height_map", "digest_of", "located", "relative"]


def located(scene: Scene, path: Path) -> Scene:
    """Return a scene whose height map is an absolute path with its digest.

    Parameters
    ----------
    scene : Scene
        As its file ``path`` has it: the map is named relative to that file.
    path : Path

    Returns
    -------
    Scene

    Raises
    ------
    InputError
        For a map outside the folder of the scene's file, of an unknown kind, absent, empty, larger than
        :data:`MAX_BYTES`, unreadable, or with another digest than the scene says.
    """
    skin = scene.finger.height_map
    if skin is None:
        return scene
    file, digest = file_beside(
        skin.file, path, key=f"{KEY}.file", suffixes=SUFFIXES, max_bytes=MAX_BYTES, sha256=skin.sha256,
        sha256_key=f"{KEY}.sha256",
    )  # fmt: skip
    return _with_file(scene, file, digest)


def relative(scene: Scene) -> Scene:
    """Return a scene whose map is named as :func:`copy_height_map` names the copy.

    Parameters
    ----------
    scene : Scene

    Returns
    -------
    Scene
    """
    skin = scene.finger.height_map
    return scene if skin is None else _with_file(scene, _name(skin.file), skin.sha256)


def copy_height_map(scene: Scene, folder: Path) -> None:
    """Copy a scene's height map into a folder, ``height_map`` with its own ending.

    Parameters
    ----------
    scene : Scene
    folder : Path

    Raises
    ------
    WorkError
        If it cannot be read or written.
    """
    skin = scene.finger.height_map
    if skin is not None:
        copy_beside(skin.file, folder / _name(skin.file), "the height map")


def _name(file: str) -> str:
    return "height_map" + Path(file).suffix.lower()


def _with_file(scene: Scene, file: str, sha256: str | None) -> Scene:
    skin = scene.finger.height_map
    assert skin is not None  # both callers have looked
    changed = skin.model_copy(update={"file": file, "sha256": sha256})
    return scene.model_copy(update={"finger": scene.finger.model_copy(update={"height_map": changed})})
