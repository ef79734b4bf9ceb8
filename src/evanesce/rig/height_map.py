"""The file of a scene's height map: its path, its digest, and a copy beside a written scene."""

from __future__ import annotations

import hashlib
import shutil
from pathlib import Path

from evanesce.core.errors import InputError, WorkError
from evanesce.rig.scene import Scene

KEY = "finger.height_map"
SUFFIXES = (".npz", ".csv", ".tif", ".tiff", ".exr")
MAX_BYTES = 1_000_000_000


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
    folder, key = path.resolve().parent, f"{KEY}.file"
    inside = "a file in the folder of the scene's file or below it, named relative to it"
    try:
        # Symbolic links are followed first: a bundle from elsewhere must not read what it does not contain.
        file = (folder / skin.file).resolve()
        if Path(skin.file).is_absolute() or not file.is_relative_to(folder):
            raise InputError(f"{skin.file!r} leaves the scene's folder", file=path, key=key, allowed=inside)
        if file.suffix.lower() not in SUFFIXES:
            raise InputError(f"{skin.file!r}", file=path, key=key, allowed="a file ending in " + ", ".join(SUFFIXES))
        if not file.is_file():
            raise InputError(f"no such file {skin.file!r}", file=path, key=key, allowed=inside)
        if not 0 < file.stat().st_size <= MAX_BYTES:
            size = file.stat().st_size
            raise InputError(f"{skin.file!r} has {size} bytes", file=path, key=key, allowed=f"1 to {MAX_BYTES} bytes")
        digest = digest_of(file)
    except (OSError, ValueError, RuntimeError) as error:  # a NUL in the name, a loop of links, no right to read
        if isinstance(error, InputError):
            raise
        raise InputError(f"{skin.file!r} cannot be read: {error}", file=path, key=key, allowed=inside) from None
    if skin.sha256 not in (None, digest):
        raise InputError(
            f"{skin.file!r} is not the map that the scene was made with", file=path, key=f"{KEY}.sha256",
            allowed=f"{digest}, or none",
        )  # fmt: skip
    return _with_file(scene, str(file), digest)


def digest_of(file: str | Path) -> str:
    """Return the SHA-256 of a file as hexadecimal digits.

    Parameters
    ----------
    file : str or Path

    Returns
    -------
    str
    """
    with Path(file).open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


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
    if skin is None:
        return
    target = folder / _name(skin.file)
    if target.exists() and target.samefile(skin.file):
        return
    part = target.with_name(f".{target.name}.part")
    try:
        shutil.copyfile(skin.file, part)
        part.replace(target)
    except OSError as error:
        part.unlink(missing_ok=True)
        raise WorkError(f"the height map cannot be copied: {error}") from None


def _name(file: str) -> str:
    return "height_map" + Path(file).suffix.lower()


def _with_file(scene: Scene, file: str, sha256: str | None) -> Scene:
    skin = scene.finger.height_map
    assert skin is not None  # both callers have looked
    changed = skin.model_copy(update={"file": file, "sha256": sha256})
    return scene.model_copy(update={"finger": scene.finger.model_copy(update={"height_map": changed})})
