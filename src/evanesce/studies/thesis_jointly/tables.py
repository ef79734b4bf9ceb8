"""Tables of solved contacts, read areas, ridges and slides as smooth functions of a point; arrays in, arrays out."""

from __future__ import annotations

import csv
from collections import defaultdict
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator, RegularGridInterpolator

Array = NDArray[Any]

DATA = Path(__file__).resolve().parent / "data"
FORCES = np.geomspace(0.02, 60.0, 60)
"""[N]; beyond what was solved, logarithms go on in a straight line."""
SHARES = np.linspace(0.0, 0.8, 33)


def _rows(name: str) -> list[dict[str, str]]:
    with (DATA / name).open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


@lru_cache(maxsize=1)
def _presses() -> dict[tuple[str, str, float], Array]:
    """Return force, depth and radius of contact (forces, 3) by material, shape and bone share."""
    found = defaultdict(list)
    for row in _rows("presses.csv"):
        key = (row["material"], row["shape"], float(row["bone_share"]))
        found[key].append([float(row[c]) for c in ("force_N", "depth_mm", "contact_radius_mm")])
    return {key: np.array(rows) for key, rows in found.items()}


def _straight_on(x: Array, known: Array, values: Array) -> Array:
    """Return linear interpolation that goes on beyond its ends as it came."""
    inside = np.interp(x, known, values)
    first = (values[1] - values[0]) / (known[1] - known[0])
    last = (values[-1] - values[-2]) / (known[-1] - known[-2])
    beyond = np.maximum(x - known[-1], 0.0) * last + np.minimum(x - known[0], 0.0) * first
    return np.asarray(inside + beyond)


@lru_cache(maxsize=4)
def _press_field(material: str) -> RegularGridInterpolator:
    """Return logarithms of depth [mm] and area [mm^2] by bone share and logarithm of force."""
    known = sorted(share for m, shape, share in _presses() if (m, shape) == (material, "standard"))
    table = []
    for share in known:
        force, depth, radius = _presses()[material, "standard", share].T
        log = (np.log(depth), np.log(np.pi * radius**2))
        table.append(np.stack([_straight_on(np.log(FORCES), np.log(force), one) for one in log], axis=-1))
    smooth = PchipInterpolator(known, np.array(table), axis=0)(SHARES)
    return RegularGridInterpolator((SHARES, np.log(FORCES)), smooth, bounds_error=False, fill_value=None)


def solved_press(material: str, share: Array, log_force: Array) -> tuple[Array, Array]:
    """Return logarithms of depth [mm] and area [mm^2] by finite elements over a bone.

    Parameters
    ----------
    material : str
    share : ndarray
        Bone radius over the shaft's radius.
    log_force : ndarray
        Of the force [N] on the material of table 6; one that is m times as stiff carries m times the force.

    Returns
    -------
    log_depth, log_area : ndarray
    """
    share, log_force = np.broadcast_arrays(share, log_force)
    found = _press_field(material)(np.stack([share, log_force], axis=-1))
    return found[..., 0], found[..., 1]


@lru_cache(maxsize=4)
def _area_at_1N(shape: str) -> PchipInterpolator:
    """Return the logarithm of the area of Silskin 0 % at 1 N [mm^2] by bone share, a power law averaging the mesh."""
    known, values = [], []
    for (material, own, share), rows in sorted(_presses().items()):
        if (material, own) == ("silskin_0", shape):
            near = (rows[:, 0] > 0.5) & (rows[:, 0] < 2.0)
            log_force, log_area = np.log(rows[near, 0]), np.log(np.pi * rows[near, 2] ** 2)
            known.append(share)
            values.append(np.polyfit(log_force, log_area, 1)[1])
    return PchipInterpolator(known, values)


def shape_change(over: str, under: str, share: Array) -> Array:
    """Return the area at 1 N of one shape over another's, less 1, Silskin 0 %, over the same bone share."""
    return np.asarray(np.expm1(_area_at_1N(over)(share) - _area_at_1N(under)(share)))


def bone_change(share: Array) -> Array:
    """Return the area at 1 N of the short finger with a bone over that without, less 1."""
    curve = _area_at_1N("short")
    return np.asarray(np.expm1(curve(share) - curve(0.0)))


@lru_cache(maxsize=1)
def _reading() -> RegularGridInterpolator:
    with np.load(DATA / "reading.npz") as kept:
        axes = tuple(kept[name] for name in ("log_area", "share", "length_mm", "level"))
        return RegularGridInterpolator(axes, kept["log_ratio"].astype(float), bounds_error=False, fill_value=None)


def log_read_over_true(log_area: Array, share: Array, length: Array, level: Array) -> Array:
    """Return the logarithm of the area that the reference segmentation reads over the true one.

    Parameters
    ----------
    log_area : ndarray
        Of the true area [mm^2].
    share, length : ndarray
        Subsurface scattering: share of the light [1], length [mm].
    level : ndarray
        Logarithm of light over threshold, over that of the nominal scene at threshold 0.15.

    Returns
    -------
    ndarray
    """
    field = _reading()
    low, high = (np.array([axis[end] for axis in field.grid]) for end in (0, -1))
    points = np.stack(np.broadcast_arrays(log_area, share, length, level), axis=-1)
    return np.asarray(field(np.clip(points, low, high)))


@lru_cache(maxsize=1)
def _ridges() -> RegularGridInterpolator:
    found = defaultdict(list)
    for row in _rows("ridges.csv"):
        found[float(row["height_mm"]), float(row["pitch_mm"])].append(float(row["ratio"]))
    heights, pitches = (sorted({key[k] for key in found}) for k in (0, 1))
    table = [[np.log(np.mean(found[h, p])) for p in pitches] for h in heights]
    return RegularGridInterpolator((heights, pitches), np.array(table), bounds_error=False, fill_value=None)


def log_ridged_over_smooth(height: Array, pitch: Array) -> Array:
    """Return the logarithm of ridged over smooth area at 1 N, Silskin 0 %, by height and pitch of the ridges [mm]."""
    return np.asarray(_ridges()(np.stack(np.broadcast_arrays(height, np.clip(pitch, 0.75, 1.5)), axis=-1)))


@lru_cache(maxsize=1)
def _slides() -> dict[float, tuple[Array, Array]]:
    found = defaultdict(list)
    for row in _rows("slides.csv"):
        found[float(row["friction"])].append((float(row["bone_share"]), float(row["change"])))
    return {mu: (np.array(sorted(rows))[:, 0], np.array(sorted(rows))[:, 1]) for mu, rows in found.items()}


def overshoot(friction: float, share: Array) -> Array:
    """Return the change of the normal force at held depth over that of the press by friction and bone share."""
    known = sorted(_slides())
    values = np.array([np.interp(share, *_slides()[mu]) for mu in known])
    place = float(np.clip(np.interp(friction, known, np.arange(len(known))), 0, len(known) - 1))
    low = min(int(place), len(known) - 2)
    return np.asarray(values[low] + (place - low) * (values[low + 1] - values[low]))
