"""Files that a scene names: found beside the scene's file, checked, and copied beside a written scene."""

from __future__ import annotations

import hashlib
import shutil
from pathlib import Path

from evanesce.core.errors import InputError, WorkError

INSIDE = "a file in the folder of the scene's file or below it, named relative to it"


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


def file_beside(
    name: str, path: Path, *, key: str, suffixes: tuple[str, ...], max_bytes: int, sha256: str | None, sha256_key: str
) -> tuple[str, str]:
    """Return the absolute path and the digest of a file that the scene file ``path`` names relative to itself.

    Parameters
    ----------
    name : str
        As the scene has it.
    path : Path
        Of the scene's file.
    key : str
        Of the scene, for errors.
    suffixes : tuple of str
        Endings that are allowed, in lower case.
    max_bytes : int
        Largest size [bytes].
    sha256 : str or None
        Digest that the scene gives.
    sha256_key : str
        Its key, for errors.

    Returns
    -------
    file, digest : str

    Raises
    ------
    InputError
        For a file outside the folder of the scene's file, of another ending, absent, empty, too large, unreadable, or
        with another digest than the scene gives.
    """
    folder = path.resolve().parent
    try:
        # Symbolic links are followed first: a bundle from elsewhere must not read what it does not contain.
        file = (folder / name).resolve()
        if Path(name).is_absolute() or not file.is_relative_to(folder):
            raise InputError(f"{name!r} leaves the scene's folder", file=path, key=key, allowed=INSIDE)
        if file.suffix.lower() not in suffixes:
            raise InputError(f"{name!r}", file=path, key=key, allowed="a file ending in " + ", ".join(suffixes))
        if not file.is_file():
            raise InputError(f"no such file {name!r}", file=path, key=key, allowed=INSIDE)
        if not 0 < file.stat().st_size <= max_bytes:
            size = file.stat().st_size
            raise InputError(f"{name!r} has {size} bytes", file=path, key=key, allowed=f"1 to {max_bytes} bytes")
        digest = digest_of(file)
    except (OSError, ValueError, RuntimeError) as error:  # a NUL in the name, a loop of links, no right to read
        if isinstance(error, InputError):
            raise
        raise InputError(f"{name!r} cannot be read: {error}", file=path, key=key, allowed=INSIDE) from None
    if sha256 not in (None, digest):
        raise InputError(
            f"{name!r} is not the file that the scene was made with", file=path, key=sha256_key,
            allowed=f"{digest}, or none",
        )  # fmt: skip
    return str(file), digest


def copy_beside(file: str, target: Path, what: str) -> None:
    """Copy a file, whole or not at all.

    Parameters
    ----------
    file : str
    target : Path
    what : str
        Named in the error.

    Raises
    ------
    WorkError
        If it cannot be read or written.
    """
    if target.exists() and target.samefile(file):
        return
    part = target.with_name(f".{target.name}.part")
    try:
        shutil.copyfile(file, part)
        part.replace(target)
    except OSError as error:
        part.unlink(missing_ok=True)
        raise WorkError(f"{what} cannot be copied: {error}") from None
