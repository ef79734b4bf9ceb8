"""Labelled sequences for slip detectors: simulate, write, verify, read and export them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from evanesce.dataset.read import Dataset, open
    from evanesce.dataset.stream import stream

__all__ = ["Dataset", "open", "stream"]


def __getattr__(name: str) -> Any:
    # The reader imports OpenCV and OpenEXR, which planning does not need.
    if name == "stream":
        # the function, not the module of its name, which importing it puts in its place
        import importlib

        found = importlib.import_module("evanesce.dataset.stream").stream
        globals()["stream"] = found
        return found
    if name in __all__:
        from evanesce.dataset import read

        return getattr(read, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
