"""What lies on the smooth shape of a scene's finger: designed ridges, or a height map from a scan."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from evanesce.bench.relief import HeightMap, RepeatedProfile
from evanesce.bench.surface_files import read_skin
from evanesce.contact.ridges.fingerprint import fingerprint_depth
from evanesce.contact.ridges.heightmap import RidgeRow
from evanesce.contact.ridges.ridged import MIN_SAMPLES_PER_PITCH, require_resolved
from evanesce.core.errors import InputError
from evanesce.core.states import ContactState, PlateGrid
from evanesce.rig import Finger, Fingerprint, Ridges, ScannedSkin
from evanesce.rig.height_map import digest_of

Array = NDArray[np.float64]

MIN_RMS_KEPT = 0.95
"""Share of a scan's rms height that must survive the mean over cells: a sinusoid of 5.7 samples a period has it."""


@dataclass(frozen=True, eq=False)
class Skin:
    """Relief of a finger on a contact grid.

    Attributes
    ----------
    name : str
        ``ridges``, ``height_map`` or ``fingerprint``; ends the name of the contact's law.
    depth : ndarray (rows, cols)
        Below the crests, or below the mean crest of a scan [mm].
    known : ndarray of bool (rows, cols)
        False beyond a scan, where the border's depth goes on.
    parameters : dict
        Worth recording.
    """

    name: str
    depth: Array
    known: NDArray[np.bool_]
    parameters: dict[str, Any]


def skin_of(finger: Finger, grid: PlateGrid) -> Skin | None:
    """Return a finger's relief on a grid; None for a smooth finger.

    Parameters
    ----------
    finger : Finger
    grid : PlateGrid

    Returns
    -------
    Skin or None

    Raises
    ------
    InputError
        For ridges or a scan that the grid is too coarse for, impossible ridges, or a scan's file that is unfit.
    """
    x, y = grid.x[None, :] - finger.position_mm[0], grid.y[:, None] - finger.position_mm[1]
    if finger.height_map is not None:
        return _scanned(finger.height_map, x, y, grid.pitch)
    if finger.fingerprint is not None:
        return _printed(finger.fingerprint, x, y, grid.pitch)
    if finger.ridges is None:
        return None
    row = ridge_row_of(finger.ridges)
    require_resolved(grid, row)
    try:
        depth = row.heights(x, y)
    except ValueError as error:
        raise InputError(str(error), key="finger.ridges") from None
    return Skin("ridges", depth, np.ones(grid.shape, dtype=bool), row.parameters())


def require_within_scan(state: ContactState, skin: Skin) -> ContactState:
    """Return the state; refuse it where contact reaches beyond the scan.

    Parameters
    ----------
    state : ContactState
    skin : Skin

    Returns
    -------
    ContactState

    Raises
    ------
    InputError
    """
    beyond = int(np.count_nonzero((np.asarray(state.contact_mask) > 0) & ~skin.known))
    if beyond:
        raise InputError(
            f"{beyond * state.grid.pitch**2:.3g} mm^2 of contact lie beyond the scan of "
            + " x ".join(f"{side:.4g}" for side in skin.parameters["height_map_size_mm"]) + " mm",
            key=f"finger.{skin.name}", allowed="a scan or print that covers the contact, or a smaller force",
        )  # fmt: skip
    return state


def ridge_row_of(ridges: Ridges) -> RidgeRow:
    """Return a scene's ridges in mm and rad.

    Parameters
    ----------
    ridges : Ridges

    Returns
    -------
    RidgeRow
    """
    return RidgeRow(
        pattern=ridges.pattern,
        pitch=1e-3 * ridges.pitch_um,
        width=1e-3 * ridges.width_um,
        height=1e-3 * ridges.height_um,
        orientation=math.radians(ridges.orientation_deg),
        rounding=None if ridges.rounding_um is None else 1e-3 * ridges.rounding_um,
        core_length=ridges.core_length_mm,
    )


def _printed(skin: Fingerprint, x: Array, y: Array, cell: float) -> Skin:
    if cell * MIN_SAMPLES_PER_PITCH > 1e-3 * skin.ridge_period_um:
        raise InputError(
            f"contact grid of {1e3 * cell:.4g} um per sample is too coarse for a print of {skin.ridge_period_um:g} um",
            key="grid.samples", allowed=f"at least {MIN_SAMPLES_PER_PITCH} samples per ridge",
        )  # fmt: skip
    depth, known = fingerprint_depth(skin, x, y)
    size = (skin.size_mm, skin.size_mm)
    return Skin("fingerprint", depth, known, {"fingerprint": skin.pattern, "height_map_size_mm": size})


def scanned_depth(
    scan: HeightMap | RepeatedProfile, x: Array, y: Array, cell: float
) -> tuple[Array, NDArray[np.bool_], float]:
    """Return a scan's depth below its mean crest, as means over cells.

    Parameters
    ----------
    scan : HeightMap or RepeatedProfile
    x, y : ndarray
        Points from the scan's middle, along its columns and rows [mm]; broadcast.
    cell : float
        Side of a cell [mm]. A scan finer than cells is averaged over them, a coarser one follows a cubic spline.

    Returns
    -------
    depth : ndarray
        [mm].
    known : ndarray of bool
        Within the scan.
    kept : float
        Share of the scan's rms height that the mean over cells leaves.
    """
    x, y = np.broadcast_arrays(x, y)
    heights, window = scan.height, max(1, round(cell / scan.pitch))
    if isinstance(scan, RepeatedProfile):
        mean = ndimage.uniform_filter1d(heights, window, mode="wrap")
        # of an even window the filter's middle lies half a sample to the left
        place = x / scan.pitch + (0.5 if window % 2 == 0 else 0.0)
        depth = -ndimage.map_coordinates(mean, [place.ravel()], order=3, mode="grid-wrap").reshape(x.shape)
        return depth, np.ones(x.shape, dtype=bool), _kept(mean, heights)
    mean = ndimage.uniform_filter(heights, window, mode="nearest")
    rows, cols = heights.shape
    column, row = x / scan.pitch + (cols - 1) / 2, y / scan.pitch + (rows - 1) / 2
    known = (np.abs(x) <= 0.5 * cols * scan.pitch) & (np.abs(y) <= 0.5 * rows * scan.pitch)
    shift = 0.5 if window % 2 == 0 else 0.0
    depth = -ndimage.map_coordinates(mean, [row + shift, column + shift], order=3, mode="nearest")
    return depth, known, _kept(mean, heights)


def _kept(mean: Array, heights: Array) -> float:
    return float(mean.std() / heights.std())


def _scanned(skin: ScannedSkin, x: Array, y: Array, cell: float) -> Skin:
    scan = _read(skin.file, skin.sha256 or "", skin.pitch_um, skin.height_unit, skin.form_degree)
    turn = math.radians(skin.orientation_deg)
    cos, sin = math.cos(turn), math.sin(turn)
    x, y = x - skin.offset_mm[0], y - skin.offset_mm[1]
    depth, known, kept = scanned_depth(scan, x * cos + y * sin, -x * sin + y * cos, cell)
    if kept < MIN_RMS_KEPT:
        raise InputError(
            f"contact grid of {1e3 * cell:.4g} um per sample leaves {kept:.0%} of the scan's rms height",
            key="grid.samples", allowed=f"cells that leave at least {MIN_RMS_KEPT:.0%}",
        )  # fmt: skip
    size = (math.inf, math.inf) if isinstance(scan, RepeatedProfile) else scan.size
    parameters = {
        "height_map": Path(skin.file).name,
        "height_map_sha256": skin.sha256,
        "height_map_size_mm": size,
        "height_map_rms_mm": float(scan.height.std()),
    }
    return Skin("height_map", depth, known, parameters)


@lru_cache(maxsize=1)
def _read(file: str, sha256: str, pitch_um: float | None, unit: str | None, degree: int) -> HeightMap | RepeatedProfile:
    """Return a scan, read once for all forces of a scene."""
    path = Path(file)
    if not path.is_absolute() or not path.is_file() or digest_of(path) != sha256:
        raise InputError(
            "not the file that the scene was read with", file=path, key="finger.height_map.file",
            allowed="a scene from load_scene, its map unchanged since",
        )  # fmt: skip
    return read_skin(path, None if pitch_um is None else 1e-3 * pitch_um, unit, degree)
