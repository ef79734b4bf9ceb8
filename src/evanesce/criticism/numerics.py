"""What the critic's own resolution costs: its prediction at twice the resolution less its own, kept on disk.

Taken as a variance beside the noise's, so that a discretised edge is not discovered as an effect.
"""

from __future__ import annotations

import contextlib
import os
import tempfile
import zipfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from evanesce.criticism.predict import Predictor
from evanesce.criticism.views import View
from evanesce.provenance import digest
from evanesce.render.rig_fields import cache_folder
from evanesce.rig import Scene

Array = NDArray[Any]

FORMAT = "numerics 1"
FINER = 2
NEIGHBOURS = 3
"""Edges lie elsewhere on the grid in each session: the largest difference nearby counts [bins]."""


def numerics_variance(scene: Scene, views: Sequence[View], base: Array) -> Array:
    """Return the variance (views, rows, cols) that the resolution adds [DN^2].

    Parameters
    ----------
    scene : Scene
        At the critic's resolution.
    views : sequence of View
    base : ndarray (views, rows, cols)
        The prediction at null [DN].
    """
    states = [[v.kind, v.force_N, v.voltage_V, v.time_s] for v in views]
    path = cache_folder() / (digest([FORMAT, FINER, scene.as_dict(), states]) + ".npz")
    found = _read(path, base.shape)
    if found is None:
        finer = scene.grid.model_copy(update={"samples": scene.grid.samples * FINER})
        predictor = Predictor(scene.model_copy(update={"grid": finer}), views, finer=FINER)
        difference = np.abs(predictor.cube({}) - base)
        found = ndimage.maximum_filter(difference, size=(1, NEIGHBOURS, NEIGHBOURS)) ** 2
        _write(path, found)
    return found


def _read(path: Path, shape: tuple[int, ...]) -> Array | None:
    try:
        with np.load(path, allow_pickle=False) as data:
            variance = np.asarray(data["variance"], float)
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
        return None
    return variance if variance.shape == shape and np.isfinite(variance).all() else None


def _write(path: Path, variance: Array) -> None:
    with contextlib.suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, part = tempfile.mkstemp(dir=path.parent, suffix=".part")
        try:
            with os.fdopen(handle, "wb") as stream:
                np.savez_compressed(stream, variance=variance.astype(np.float32))
            os.replace(part, path)
        except BaseException:
            Path(part).unlink(missing_ok=True)
            raise
