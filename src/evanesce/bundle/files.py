"""Check the files of a bundle: none outside its folder, frames as pictures of one size."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from PIL import Image as PillowImage

from evanesce.bundle.layout import MEASUREMENT_FILE, REPLICATES_FOLDER, REPLICATES_TABLE
from evanesce.core.errors import InputError
from evanesce.measurement.io.frames import natural_key
from evanesce.measurement.io.images import IMAGE_SUFFIXES
from evanesce.rig import Scene

MAX_FILES = 100_000


def inside(root: Path, name: str, key: str | None) -> Path:
    """Return a regular file of the bundle; a name that leads out of the folder is refused.

    Parameters
    ----------
    root : Path
        Folder of the bundle.
    name : str
        Relative path as the bundle states it.
    key : str or None
        Key of ``measurement.toml`` that states it, for the message.

    Returns
    -------
    Path

    Raises
    ------
    InputError
        If it is not there, no regular file, absolute, climbs, or is a link that leaves the bundle.
    """
    where = root / MEASUREMENT_FILE
    parts = Path(name).parts
    if Path(name).is_absolute() or ".." in parts or "\\" in name or "\0" in name or ":" in name:
        raise InputError(f"{name!r} leads out of the bundle", file=where, key=key, allowed="a file inside the folder")
    path = root / name
    if not path.exists():
        if key is None:
            raise InputError("is missing", file=path, allowed="see docs/reference/bundle.md")
        raise InputError(f"no such file: {name}", file=where, key=key, allowed="a file inside the folder")
    check_inside(root, path)
    if not path.is_file():
        raise InputError("is no regular file", file=path)
    return path


def check_inside(root: Path, path: Path) -> None:
    """Refuse a link that leads out of the bundle.

    Parameters
    ----------
    root : Path
        Folder of the bundle.
    path : Path
        File or folder in it.
    """
    if not path.resolve().is_relative_to(root.resolve()):
        raise InputError("is a link that leads out of the bundle", file=path, allowed="files inside the folder")


def picture_files(root: Path, folder: str) -> tuple[Path, ...]:
    """Return a folder's frames in natural order; empty where there is no such folder.

    Parameters
    ----------
    root : Path
        Folder of the bundle.
    folder : str
        Name of the folder of frames.

    Returns
    -------
    tuple of Path
    """
    where = root / folder
    if not where.exists():
        return ()
    check_inside(root, where)
    if not where.is_dir():
        raise InputError("is a file", file=where, allowed="a folder of pictures")
    found = []
    for path in where.iterdir():
        if path.name.startswith(".") or (path.name == REPLICATES_TABLE and folder == REPLICATES_FOLDER):
            continue
        if path.suffix.lower() not in IMAGE_SUFFIXES:
            raise InputError(
                "is no picture", file=path, allowed=f"only {' '.join(sorted(IMAGE_SUFFIXES))} in this folder"
            )
        check_inside(root, path)
        if not path.is_file():
            raise InputError("is no regular file", file=path)
        found.append(path)
        if len(found) > MAX_FILES:
            raise InputError(f"more than {MAX_FILES} files", file=where)
    if not found:
        raise InputError("holds no frame", file=where, allowed="pictures, or no such folder")
    return tuple(sorted(found, key=lambda p: (natural_key(p.name), p.name)))


def numbered(paths: Sequence[Path]) -> dict[int, Path]:
    """Return frames by the number that is their name.

    Parameters
    ----------
    paths : sequence of Path
        Frames named by their numbers.

    Returns
    -------
    dict of int to Path
    """
    found: dict[int, Path] = {}
    for path in paths:
        if not (path.stem.isascii() and path.stem.isdecimal()):
            raise InputError(
                f"{path.stem!r} is no number", file=path, allowed="NNNN.png (.jpg, .tif, .bmp), the index of press.csv"
            )
        if int(path.stem) in found:
            raise InputError(f"is frame {int(path.stem)} once more", file=path, allowed="each number once")
        found[int(path.stem)] = path
    return found


def check_header(path: Path, scene: Scene) -> None:
    """Compare an image's size with the camera's without decoding it.

    Parameters
    ----------
    path : Path
        Picture.
    scene : Scene
        Nominal model; its camera states the size.
    """
    try:
        with PillowImage.open(path, formats=("PNG", "JPEG", "TIFF", "BMP")) as picture:
            size = picture.size
    except (OSError, ValueError, SyntaxError, PillowImage.DecompressionBombError) as error:
        raise InputError(f"cannot be read as a picture: {error}", file=path) from None
    check_size(size, scene, path)


def check_size(size: tuple[int, int], scene: Scene, path: Path) -> None:
    """Refuse an image whose (columns, rows) are not those of the nominal camera.

    Parameters
    ----------
    size : tuple of int
        (cols, rows) [px].
    scene : Scene
        Nominal model; its camera states the size.
    path : Path
        Of the image, for the message.
    """
    cols, rows = scene.camera.resolution_px
    if size != (cols, rows):
        raise InputError(
            f"{size[0]} x {size[1]} pixels", file=path, allowed=f"{cols} x {rows}, the nominal camera's resolution_px"
        )
