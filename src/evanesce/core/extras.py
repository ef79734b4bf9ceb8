"""Optional packages: which extra brings which, and the one line that says so where a package is missing.

The core needs what rendering and measuring need. Everything else is imported where it is used, behind :func:`require`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib.util import find_spec

from evanesce.core.errors import InputError

EXTRAS: Mapping[str, tuple[str, ...]] = {
    "dataset": ("dask", "distributed"),
    "export": ("h5py", "pyarrow", "pandas"),
    "design": ("optuna", "SALib", "dask", "distributed"),
    "page": ("nicegui",),
    "fem": ("felupe", "pypardiso", "meshio"),
    "baseline": ("sklearn",),
    "torch": ("torch",),
    "rerun": ("rerun",),
    "mcap": ("mcap", "mcap_ros2"),
    "tiff": ("tifffile",),
    "grip": ("gymnasium",),
}
"""Import names of the packages of each extra of ``pyproject.toml``."""

PURPOSES: Mapping[str, str] = {
    "dataset": "data sets made by several processes",
    "export": "data sets in other formats",
    "design": "search for rigs, sensitivity analysis",
    "page": "live page",
    "fem": "finite elements, VTK files",
    "baseline": "slip detectors trained on data sets",
    "torch": "data sets as PyTorch tensors",
    "rerun": "data sets as Rerun recordings",
    "mcap": "data sets as MCAP with ROS 2 messages",
    "tiff": "data sets as TIFF stacks",
    "grip": "control of a grip as a Gymnasium environment",
}

_DISTRIBUTIONS = {"sklearn": "scikit-learn", "rerun": "rerun-sdk", "mcap_ros2": "mcap-ros2-support"}


class MissingExtraError(InputError, ImportError):
    """A package of an extra is not installed (exit code 2).

    Attributes
    ----------
    extra : str
        Name of the extra that brings it.
    lacking : str
        What needs which package.
    """

    def __init__(self, what: str, extra: str) -> None:
        super().__init__(f"{what}: pip install 'evanesce[{extra}]'")
        self.lacking, self.extra = what, extra

    def __reduce__(self) -> tuple[type[MissingExtraError], tuple[str, str]]:
        return type(self), (self.lacking, self.extra)


def distribution_name(module: str) -> str:
    """Return the name under which a package is installed, from the name under which it is imported."""
    return _DISTRIBUTIONS.get(module, module)


def listed(modules: Sequence[str]) -> str:
    """Return the names under which packages are installed as a part of a sentence: ``dask and distributed``."""
    *most, last = (distribution_name(name) for name in modules)
    return f"{', '.join(most)} and {last}" if most else last


def missing(modules: Sequence[str]) -> tuple[str, ...]:
    """Return those of some modules (top-level import names) that are not installed; imports none of them."""
    return tuple(name for name in modules if find_spec(name) is None)


def require(extra: str, purpose: str, *modules: str) -> None:
    """Check that optional packages are there, without importing them.

    Parameters
    ----------
    extra : str
        Key of :data:`EXTRAS`.
    purpose : str
        What needs them; begins the message.
    *modules : str
        Import names; all of the extra's if none is given.

    Raises
    ------
    MissingExtraError
        In one line that names what is missing and the extra that brings it.
    """
    if absent := missing(modules or EXTRAS[extra]):
        raise MissingExtraError(f"{purpose} needs {listed(absent)}", extra)
