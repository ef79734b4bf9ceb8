"""Names that have moved: still found where they were, with a warning that says until which version."""

from __future__ import annotations

import importlib
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Moved:
    """Where a name has gone.

    Attributes
    ----------
    target : str
        ``package.module`` for a module, ``package.module:name`` for what a module holds.
    removal : str
        Version that no longer knows the old name.
    """

    target: str
    removal: str

    def load(self) -> Any:
        """Return what the name stands for."""
        module, _, name = self.target.partition(":")
        found = importlib.import_module(module)
        return getattr(found, name) if name else found


def moved_names(module: str, names: Mapping[str, Moved], *, stacklevel: int = 2) -> Callable[[str], Any]:
    """Return the ``__getattr__`` (PEP 562) of a module some of whose names have moved.

    Parameters
    ----------
    module : str
        The module's ``__name__``.
    names : mapping of str to Moved
        By old name.
    stacklevel : int
        Frames between the warning and the line it names: 2 where the function is the module's ``__getattr__`` itself.

    Returns
    -------
    callable
        Warns with a :class:`DeprecationWarning` at the caller's line; raises AttributeError for any other name.

    Examples
    --------
    >>> old = moved_names("evanesce", {"errors": Moved("evanesce.core.errors", removal="0.4")})
    >>> with warnings.catch_warnings(record=True) as caught:
    ...     warnings.simplefilter("always")
    ...     found = old("errors").__name__
    >>> found, str(caught[0].message)
    ('evanesce.core.errors', 'evanesce.errors is now evanesce.core.errors; the old name goes with 0.4')
    """

    def __getattr__(name: str) -> Any:
        moved = names.get(name)
        if moved is None:
            raise AttributeError(f"module {module!r} has no attribute {name!r}")
        new = moved.target.replace(":", ".")
        text = f"{module}.{name} is now {new}; the old name goes with {moved.removal}"
        warnings.warn(text, DeprecationWarning, stacklevel=stacklevel)
        return moved.load()

    return __getattr__
