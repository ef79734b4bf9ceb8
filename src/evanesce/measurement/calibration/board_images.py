"""Images of a checkerboard from files: read, checked for saturation and size, and their corners found."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.core.errors import WorkError
from evanesce.measurement.calibration.corners import CornerGrid, find_corners
from evanesce.measurement.calibration.points import BoardView
from evanesce.measurement.io.images import Loaded, read_image
from evanesce.measurement.refined.blur import NOMINAL_LIMITS_PX, NOMINAL_PX, blur_of_board
from evanesce.measurement.warnings import SATURATED_SHARE, Warning

BLURRED = 2.0
"""Times the median blur of all pictures above which one is named."""


@dataclass(frozen=True)
class BoardPictures:
    """Views of a board found in files.

    Attributes
    ----------
    views : list of BoardView
        Named by file.
    blurs : list of dict
        Of :func:`~evanesce.measurement.refined.blur.blur_of_board`, in the same order.
    image_size : tuple of int
        (cols, rows) [px].
    frames : list of ndarray (rows, cols[, 3])
        The picture of each view, to draw on.
    warnings : list of Warning
    """

    views: list[BoardView]
    blurs: list[dict[str, Any]]
    image_size: tuple[int, int]
    frames: list[NDArray[np.uint8]]
    warnings: list[Warning]


def find_boards(paths: Sequence[Path], square_mm: float, *, done: Callable[[], Any] = lambda: None) -> BoardPictures:
    """Find the checkerboard in each image.

    Pictures without a board and pictures of another size than the first are left out with a warning.

    Parameters
    ----------
    paths : sequence of Path
    square_mm : float
        Side of the printed squares [mm].
    done : callable
        Called after each picture.

    Returns
    -------
    BoardPictures

    Raises
    ------
    InputError
        If a picture cannot be read.
    WorkError
        If there is a board in none of them.
    """
    return boards_of(((path.name, read_image(path)) for path in paths), square_mm, done=done)


def boards_of(
    pictures: Iterable[tuple[str, Loaded]], square_mm: float, *, done: Callable[[], Any] = lambda: None
) -> BoardPictures:
    """Find the checkerboard in each picture that is read already; as :func:`find_boards`.

    Parameters
    ----------
    pictures : iterable of (str, Loaded)
        Name and picture.
    square_mm : float
        Side of the printed squares [mm].
    done : callable
        Called after each picture.

    Raises
    ------
    WorkError
        If there is a board in none of them.
    """
    loaded = list(pictures)
    first_name, first = (loaded[0][0], loaded[0][1].data) if loaded else ("", None)
    # A video of a still card, split into files, repeats its pictures: each is searched once.
    keys = [hashlib.sha256(one.data.tobytes()).digest() for _, one in loaded]
    views: list[BoardView] = []
    warnings: list[Warning] = []
    blurs: list[dict[str, Any]] = []
    frames: list[NDArray[np.uint8]] = []
    reason = ""
    # NumPy and SciPy release the interpreter's lock, so that threads share the work over the cores.
    with ThreadPoolExecutor(max_workers=os.cpu_count()) as pool:
        jobs = {
            key: pool.submit(_searched, one.data)
            for key, (_, one) in dict(zip(keys, loaded, strict=True)).items()
            if first is not None and one.data.shape[:2] == first.shape[:2]
        }
        for (name, one), key in zip(loaded, keys, strict=True):
            warnings += one.notes
            if key not in jobs:
                text = f"{name} is {_size(one.data)} pixels, {first_name} {_size(loaded[0][1].data)}: left out"
                warnings.append(Warning("changed_resolution", text))
            else:
                warnings += saturation(one.data, name)
                try:
                    grid, blur = jobs[key].result()
                except WorkError as error:
                    reason = f"{name}: {error}"
                    warnings.append(Warning("no_board", f"{reason}: left out"))
                else:
                    views.append(grid.view(name, square_mm))
                    blurs.append(blur)
                    frames.append(one.data)
            done()
    if first is None or not views:
        raise WorkError(reason or "no picture of a board")
    warnings += out_of_focus([view.name for view in views], [blur["median"] for blur in blurs])
    return BoardPictures(views, blurs, (first.shape[1], first.shape[0]), frames, warnings)


def _searched(picture: NDArray[np.uint8]) -> tuple[CornerGrid, dict[str, Any]]:
    """Return the corners of a picture's board and the blur that its edges show."""
    grid = find_corners(picture)
    return grid, blur_of_board(picture, grid)


def saturation(picture: NDArray[np.uint8], name: str) -> list[Warning]:
    """Warn if more than 1 % of the pixels have a channel at full scale, where edges lie too far outwards.

    Parameters
    ----------
    picture : ndarray of uint8 (rows, cols) or (rows, cols, 3)
        [DN].
    name : str
        Of the file.

    Returns
    -------
    list of Warning
        Empty or one.
    """
    full = (picture == 255).reshape(*picture.shape[:2], -1).any(axis=2)
    if full.mean() <= SATURATED_SHARE:
        return []
    text = f"{100 * full.mean():.1f} % of the pixels of {name} are saturated (limit {100 * SATURATED_SHARE:g} %)"
    return [Warning("saturation", text)]


def out_of_focus(names: Sequence[str], blurs_px: Sequence[float]) -> list[Warning]:
    """Warn of pictures whose edges are blurred beyond what a focused camera leaves, or far beyond the others'.

    Parameters
    ----------
    names : sequence of str
    blurs_px : sequence of float
        Standard deviation of each picture's blur [px].

    Returns
    -------
    list of Warning
        Empty or one.
    """
    usual = float(np.median(blurs_px))
    limit = min(NOMINAL_LIMITS_PX[1], max(BLURRED * usual, NOMINAL_PX))  # a picture as sharp as usual is never named
    named = [f"{name} ({px:.1f} px)" for name, px in zip(names, blurs_px, strict=True) if px > limit]
    if not named:
        return []
    text = (
        f"out of focus, edges blurred by more than {limit:.2g} px (median of all: {usual:.2g} px): {', '.join(named)}"
    )
    return [Warning("out_of_focus", text)]


def _size(picture: NDArray[np.uint8]) -> str:
    return f"{picture.shape[1]} x {picture.shape[0]}"
