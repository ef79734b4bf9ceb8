"""Provenance of a result: versions, seed, variant, digest of the configuration; part of every file written."""

from __future__ import annotations

import hashlib
import json
import platform
from collections.abc import Iterable, Mapping
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from evanesce.core.version import __version__

_PACKAGES = ("mitsuba", "drjit", "numpy", "scipy", "opencv-contrib-python-headless", "scikit-image", "OpenEXR", "av")


def package_versions(names: tuple[str, ...] = _PACKAGES) -> dict[str, str]:
    """Return installed versions; a missing package reads ``"missing"``.

    Parameters
    ----------
    names : tuple of str
        Of distributions.

    Returns
    -------
    dict of str to str
    """
    found = {}
    for name in names:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "missing"
    return found


def digest(value: Any) -> str:
    """Return the SHA-256 of a JSON-able value, independent of key order.

    Parameters
    ----------
    value : object
        JSON-able.

    Returns
    -------
    str
        Hexadecimal.

    Raises
    ------
    ValueError
        For NaN or infinity, which have no canonical JSON form.
    """
    text = json.dumps(value, sort_keys=True, separators=(",", ":"), allow_nan=False, ensure_ascii=False)
    return hashlib.sha256(text.encode()).hexdigest()


@cache
def code_digest(*packages: str) -> str:
    """Return the SHA-256 of the package's own source files, names and contents, as they were at the first call.

    Parameters
    ----------
    *packages : str
        Subpackages, such as ``"optics"``; all source files if none is named.

    Returns
    -------
    str
        Hexadecimal.

    Raises
    ------
    ValueError
        For a subpackage that does not exist.
    """
    root = Path(__file__).resolve().parent.parent
    missing = [name for name in packages if not (root / name).is_dir()]
    if missing:
        raise ValueError(f"no subpackage {', '.join(missing)}")
    folders = [root / name for name in packages] or [root]
    return digest_of_files(root, sorted(file for folder in folders for file in folder.rglob("*.py")))


def digest_of_files(root: Path, files: Iterable[Path]) -> str:
    """Return the SHA-256 of files below a folder, by their names there and their contents.

    Parameters
    ----------
    root : Path
        Folder.
    files : iterable of Path
        Below it.

    Returns
    -------
    str
        Hexadecimal.
    """
    return digest(
        [[file.relative_to(root).as_posix(), hashlib.sha256(file.read_bytes()).hexdigest()] for file in files]
    )


def record(*, seed: int | None = None, config: Any = None, **more: Any) -> Mapping[str, Any]:
    """Return the provenance record of a result; ``more`` holds variant, LLVM version and the like.

    Parameters
    ----------
    seed : int, optional
        Of the run.
    config : object
        JSON-able.
    **more : object
        Further entries, such as variant and LLVM version.

    Returns
    -------
    mapping
    """
    entry: dict[str, Any] = {
        "evanesce": __version__,
        "python": platform.python_version(),
        "platform": platform.system() + " " + platform.machine(),
        "packages": package_versions(),
    }
    if seed is not None:
        entry["seed"] = seed
    if config is not None:
        entry["config_sha256"] = digest(config)
    entry.update(more)
    return entry
