"""Tables of solved contacts, read areas, ridges and slides as smooth functions of a point; arrays in, arrays out."""

from __future__ import annotations

import csv
from collections import defaultdict
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator
from scipy.ndimage import map_coordinates

from evanesce.studies.mechanics.runs import TILT_DEG, TILTED, solved_slide

Array = NDArray[Any]

DATA = Path(__file__).resolve().parent / "data"
FINER = 4
FORCES = np.geomspace(0.02, 60.0, 240)
"""[N]; beyond what was solved, logarithms go on in a straight line."""
SHARES = np.linspace(0.0, 0.8, 33)


class Grid:
    """Multilinear interpolation on a rectangular grid; beyond its ends the value there.

    Parameters
    ----------
    axes : sequence of ndarray
        Ascending.
    values : ndarray
    """

    def __init__(self, axes: Sequence[Array], values: Array) -> None:
        self.axes, self.values = tuple(axes), np.ascontiguousarray(values, float)
        self._places = [np.arange(axis.size, dtype=float) for axis in self.axes]

    def __call__(self, *at: Array) -> Array:
        """Return values where coordinates, which are broadcast, lie."""
        whole = np.empty((len(self.axes), *np.broadcast_shapes(*(np.shape(x) for x in at))))
        for place, x, axis, own in zip(whole, at, self.axes, self._places, strict=True):
            place[...] = np.interp(x, axis, own)
        return np.asarray(map_coordinates(self.values, whole, order=1, mode="nearest"))


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
    """Return a smooth curve through points that goes on beyond its ends in a straight line."""
    inside = PchipInterpolator(known, values)(np.clip(x, known[0], known[-1]))
    first = (values[1] - values[0]) / (known[1] - known[0])
    last = (values[-1] - values[-2]) / (known[-1] - known[-2])
    beyond = np.maximum(x - known[-1], 0.0) * last + np.minimum(x - known[0], 0.0) * first
    return np.asarray(inside + beyond)


@lru_cache(maxsize=4)
def _press_fields(material: str) -> tuple[Grid, Grid]:
    """Return logarithms of depth [mm] and of area [mm^2] by bone share and logarithm of force."""
    known = sorted(share for m, shape, share in _presses() if (m, shape) == (material, "standard"))
    table = []
    for share in known:
        force, depth, radius = _presses()[material, "standard", share].T
        log = (np.log(depth), np.log(np.pi * radius**2))
        table.append(np.stack([_straight_on(np.log(FORCES), np.log(force), one) for one in log], axis=-1))
    smooth = PchipInterpolator(known, np.array(table), axis=0)(SHARES)
    axes = (SHARES, np.log(FORCES))
    return Grid(axes, smooth[..., 0]), Grid(axes, smooth[..., 1])


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
    depth, area = _press_fields(material)
    return depth(share, log_force), area(share, log_force)


@lru_cache(maxsize=4)
def _area_at_1N(shape: str) -> Grid:
    """Return the logarithm of the area of Silskin 0 % at 1 N [mm^2] by bone share, a power law averaging the mesh."""
    known, values = [], []
    for (material, own, share), rows in sorted(_presses().items()):
        if (material, own) == ("silskin_0", shape):
            near = (rows[:, 0] > 0.5) & (rows[:, 0] < 2.0)
            log_force, log_area = np.log(rows[near, 0]), np.log(np.pi * rows[near, 2] ** 2)
            known.append(share)
            values.append(np.polyfit(log_force, log_area, 1)[1])
    return Grid((SHARES,), PchipInterpolator(known, values)(SHARES))


def shape_change(over: str, under: str, share: Array) -> Array:
    """Return the area at 1 N of one shape over another's, less 1, Silskin 0 %, over the same bone share."""
    return np.asarray(np.expm1(_area_at_1N(over)(share) - _area_at_1N(under)(share)))


def bone_change(share: Array) -> Array:
    """Return the area at 1 N of the short finger with a bone over that without, less 1."""
    curve = _area_at_1N("short")
    return np.asarray(np.expm1(curve(share) - curve(np.zeros(1))))


@lru_cache(maxsize=4)
def tilted_area(material: str) -> Grid:
    """Return the logarithm of the pressed area at 45 deg over that at 0 by bone share.

    Over a bone of half the radius or more the tip is a sphere on a sphere, whose contact no tilt changes; what the
    meshes make of that is taken off the solid finger's.
    """
    solid, boned = (
        [
            float(solved_slide(case).scalars["area"][0])
            for tilt in (TILT_DEG, 0.0)
            for case in TILTED
            if (case.material, case.bone, case.tilt_deg) == (material, bone, tilt)
        ]
        for bone in ("none", "half")
    )
    change = np.log(solid[0] / solid[1]) - np.log(boned[0] / boned[1])
    return Grid((SHARES,), np.interp(SHARES, (0.0, 0.5), (change, 0.0)))


@lru_cache(maxsize=1)
def _reading() -> Grid:
    with np.load(DATA / "reading.npz") as kept:
        table, axes = kept["log_ratio"].astype(float), []
        for number, name in enumerate(("log_area", "share", "length_mm", "level")):
            known = kept[name].astype(float)
            # Finer cells of a smooth curve: fits follow slopes, which a coarse grid's cells change by jumps.
            fine = np.interp(np.arange((known.size - 1) * FINER + 1) / FINER, np.arange(known.size), known)
            table = PchipInterpolator(known, table, axis=number)(fine)
            axes.append(fine)
        return Grid(axes, table)


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
    return _reading()(log_area, share, length, level)


@lru_cache(maxsize=2)
def _ridges(column: str) -> Grid:
    found = defaultdict(list)
    for row in _rows("ridges.csv"):
        found[float(row["height_mm"]), float(row["pitch_mm"])].append(float(row[column]))
    heights, pitches = (sorted({key[k] for key in found}) for k in (0, 1))
    table = [[np.mean(found[h, p]) for p in pitches] for h in heights]
    return Grid((np.array(heights), np.array(pitches)), np.array(table))


def ridged_over_smooth(height: Array, pitch: Array) -> Array:
    """Return ridged over smooth area at 1 N, Silskin 0 %, by height and pitch of the ridges [mm]."""
    return _ridges("ratio")(height, pitch)


def ridged_deeper(height: Array, pitch: Array) -> Array:
    """Return ridged over smooth depth at 1 N, less 1, Silskin 0 %, by height and pitch of the ridges [mm]."""
    return _ridges("deeper")(height, pitch)


@lru_cache(maxsize=8)
def _overshoot(friction: float) -> Grid:
    """Return the change of the normal force by bone share at one coefficient of friction.

    Over larger bones slides were solved at mu 0.67 only; the others are taken to be to it as over the half bone.
    """
    found: dict[float, dict[float, float]] = defaultdict(dict)
    for row in _rows("slides.csv"):
        found[float(row["friction"])][float(row["bone_share"])] = float(row["change"])
    base, curves = found[min(found)], []
    for mu in sorted(found):
        own = dict(found[mu])
        for share in base.keys() - own.keys():
            near = 0.0 if share < 0.5 / 2 else 0.5
            own[share] = base[share] * found[mu][near] / base[near]
        curves.append(np.interp(SHARES, sorted(own), [own[share] for share in sorted(own)]))
    known = np.array(sorted(found))
    return Grid((SHARES,), np.array([np.interp(friction, known, column) for column in np.array(curves).T]))


def overshoot(friction: float, share: Array) -> Array:
    """Return the change of the normal force at held depth over that of the press by friction and bone share."""
    return _overshoot(friction)(share)
