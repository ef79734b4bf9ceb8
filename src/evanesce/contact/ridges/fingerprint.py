"""A human fingerprint: ridges grown along an orientation field, with sweat pores on them.

The field turns about singular points, loops' cores and deltas, by half a turn each (Sherlock and Monro 1993):

    theta(z) = theta_0 + (1/2) (sum over cores arg(z - c) - sum over deltas arg(z - d)).

Ridges grow from noise by repeated filtering with Gabor functions along that field, as in synthetic prints for matching
(Cappelli, Maio and Maltoni 2002): what is periodic across the field is amplified until it saturates, and bifurcations
and endings remain where neighbouring ridges do not fit. Pores stand on the ridges, no two nearer than their spacing.

References: B. G. Sherlock and D. M. Monro, Pattern Recognition 26 (1993) 1047; R. Cappelli, D. Maio and D. Maltoni,
Proc. ICPR (2002), vol. 3, 744.
"""

from __future__ import annotations

import math
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import cKDTree

from evanesce.core import rng
from evanesce.rig.finger import Fingerprint

Array = NDArray[np.float64]

SAMPLES_PER_PERIOD = 9
ORIENTATIONS = 24
ROUNDS = 24
SINGULAR = {
    "arch": ((), ()),
    "loop": (((0.0, 0.0),), ((-4.5, 6.0),)),
    "whorl": (((0.0, -0.7), (0.0, 0.7)), ((-5.5, 6.0), (5.5, 6.0))),
}
"""Cores and deltas (x, y) from the middle of the pad, towards the wrist positive [mm]; of a typical print."""


def orientation_field(pattern: str, x: Array, y: Array) -> Array:
    """Return the direction along the ridges [rad, modulo pi] at points of the unrolled skin.

    Parameters
    ----------
    pattern : {"arch", "loop", "whorl"}
    x, y : ndarray
        From the middle of the pad [mm], y towards the wrist.

    Returns
    -------
    ndarray
    """
    if pattern == "arch":
        # ridges y = -h(y) cos: flat at the wrist, arched towards the tip
        rise = np.exp(-(((y + 1.0) / 5.0) ** 2))
        return np.asarray(np.arctan(0.9 * rise * np.sin(np.pi * np.clip(x / 9.0, -1, 1))))
    cores, deltas = SINGULAR[pattern]
    turn = np.zeros(np.broadcast_shapes(x.shape, y.shape))
    for px, py in cores:
        turn = turn + np.arctan2(y - py, x - px)
    for px, py in deltas:
        turn = turn - np.arctan2(y - py, x - px)
    # At the first core the ridges end in the direction in which it opens: that fixes theta_0.
    (cx, cy), *others = cores
    opening = math.radians(70.0) if pattern == "loop" else math.pi / 2
    rest = sum(math.atan2(cy - py, cx - px) for px, py in others)
    rest -= sum(math.atan2(cy - py, cx - px) for px, py in deltas)
    return np.asarray(0.5 * turn + 0.5 * opening - 0.5 * rest)


def _gabor(angle: float, period: float) -> NDArray[np.float32]:
    """Return a filter that passes ridges along an angle [rad], period in samples; without mean."""
    spread, half = 0.45 * period, math.ceil(1.4 * period)
    v, u = np.mgrid[-half : half + 1, -half : half + 1].astype(float)
    across = v * math.cos(angle) - u * math.sin(angle)
    along = u * math.cos(angle) + v * math.sin(angle)
    window = np.exp(-0.5 * (across**2 + (along / 1.5) ** 2) / spread**2)
    wave = window * np.cos(2.0 * np.pi * across / period)
    wave -= window * (wave.sum() / window.sum())
    return (wave / np.abs(wave).sum()).astype(np.float32)


def _grown(field: Array, period: float, seed: int) -> NDArray[np.float32]:
    """Return ridges between -1 (furrow) and 1 (crest), grown from noise along a field of directions."""
    random = rng.generator(seed, "fingerprint")
    image = random.normal(size=field.shape).astype(np.float32)
    step = np.pi / ORIENTATIONS
    which = np.rint(np.mod(field, np.pi) / step).astype(int) % ORIENTATIONS
    kernels = [_gabor(k * step, period) for k in range(ORIENTATIONS)]
    used = [k for k in range(ORIENTATIONS) if (which == k).any()]
    for turn in range(ROUNDS):
        after = np.empty_like(image)
        for k in used:
            here = which == k
            rows, cols = np.flatnonzero(here.any(axis=1)), np.flatnonzero(here.any(axis=0))
            margin = kernels[k].shape[0] // 2
            box = (
                slice(max(0, rows[0] - margin), rows[-1] + 1 + margin),
                slice(max(0, cols[0] - margin), cols[-1] + 1 + margin),
            )
            filtered = cv2.filter2D(image[box], -1, kernels[k], borderType=cv2.BORDER_REFLECT)
            after[box][here[box]] = filtered[here[box]]
        # noise is faint after the first round: bring it to the size at which growth saturates
        gain = 4.0 / max(float(np.std(after)), 1e-9) if turn == 0 else 6.0
        image = np.tanh(gain * after).astype(np.float32)
    return image


def _pores(ridges: NDArray[np.float32], pitch: float, skin: Fingerprint) -> Array:
    """Return the places (column, row) of pores [samples]: on ridges' middles, none nearer than the spacing."""
    smooth = ndimage.gaussian_filter(ridges, 1.0)
    peak = (smooth > 0.6) & (smooth >= 0.98 * ndimage.maximum_filter(smooth, 5))
    places = np.argwhere(peak)[:, ::-1].astype(float)
    places = rng.generator(skin.seed, "pores").permutation(places)
    tree, reach = cKDTree(places), 1e-3 * skin.pore_spacing_um / pitch
    free = np.ones(len(places), bool)
    kept = []
    for k, place in enumerate(places):
        if free[k]:
            kept.append(place)
            free[tree.query_ball_point(place, reach)] = False
    return np.array(kept)


@lru_cache(maxsize=4)
def _relief(text: str) -> tuple[Array, float, Array | None]:
    """Return the depth below crests [mm] on a square lattice, its pitch [mm], and where pores are [samples]."""
    skin = Fingerprint.model_validate_json(text)
    pitch = 1e-3 * skin.ridge_period_um / SAMPLES_PER_PERIOD
    half = round(0.5 * skin.size_mm / pitch)
    axis = np.asarray(np.arange(-half, half + 1) * pitch, dtype=float)
    field = orientation_field(skin.pattern, axis[None, :], axis[:, None])
    ridges = _grown(np.broadcast_to(field, (axis.size, axis.size)), SAMPLES_PER_PERIOD, skin.seed)
    furrows = 0.5e-3 * skin.ridge_height_um * (1.0 - ndimage.gaussian_filter(ridges, 0.7))
    pores = _pores(ridges, pitch, skin) if skin.pore_spacing_um > 0 else None
    return np.asarray(furrows, dtype=float), pitch, pores


def fingerprint_depth(skin: Fingerprint, x: Array, y: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Return the depth of a print below its crests at points of the unrolled skin.

    Parameters
    ----------
    skin : Fingerprint
    x, y : ndarray
        From the middle of the pad [mm]; broadcast.

    Returns
    -------
    depth : ndarray
        [mm], cubic between the lattice's points.
    known : ndarray of bool
        Within the print.
    """
    relief, pitch, pores = _relief(skin.model_dump_json())
    x, y = np.broadcast_arrays(x, y)
    turn = math.radians(skin.orientation_deg)
    u, v = x * math.cos(turn) + y * math.sin(turn), y * math.cos(turn) - x * math.sin(turn)
    middle = (relief.shape[0] - 1) / 2
    column, row = u / pitch + middle, v / pitch + middle
    depth = ndimage.map_coordinates(relief, [row, column], order=3, mode="nearest")
    if pores is not None:
        # round, as deep as the furrows, with a sloping rim of half the radius
        radius = 0.5e-3 * skin.pore_diameter_um
        away, _ = cKDTree(pores).query(
            np.stack([column.ravel(), row.ravel()], axis=1), distance_upper_bound=radius / pitch
        )
        hole = np.clip((radius - pitch * away.reshape(x.shape)) / (0.5 * radius), 0.0, 1.0)
        depth = np.maximum(depth, 1e-3 * skin.ridge_height_um * hole)
    inside = (np.abs(u) <= middle * pitch) & (np.abs(v) <= middle * pitch)
    return np.maximum(depth, 0.0), inside
