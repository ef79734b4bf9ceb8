"""Paths of the files that ship with the project: beside the package when installed, in the checkout otherwise."""

from __future__ import annotations

from pathlib import Path

_PACKAGE = Path(__file__).resolve().parent.parent


def resource(*parts: str) -> Path:
    """Return the path of a shipped file or folder, e.g. ``resource("scenes", "thesis.toml")``.

    Parameters
    ----------
    *parts : str
        Path below the package's data.

    Returns
    -------
    Path
    """
    installed = _PACKAGE / "_data"
    root = installed if installed.is_dir() else _PACKAGE.parent.parent
    return root.joinpath(*parts)
