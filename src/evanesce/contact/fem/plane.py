"""Contact of nodes with a flat rigid glass: penalty in the normal, Coulomb return mapping in the tangent. Numpy only.

The glass is the plane z = depth (the finger's top is held and the glass comes up), shifted along x by ``slide``. The
penalty is a pressure per penetration, times each node's own area, so that small elements are not over-stiff and the
penetration is p/penalty everywhere.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Glass:
    """Rigid plate.

    Attributes
    ----------
    friction : float
        Coulomb's coefficient.
    penalty : float
        Normal pressure per penetration [MPa/mm].
    tangential_ratio : float
        Stiffness of sticking over the normal penalty.
    softness : float
        Penetration over which the penalty sets in [mm].
    """

    friction: float = 0.0
    penalty: float = 500.0
    tangential_ratio: float = 0.5
    softness: float = 0.001


@dataclass(frozen=True)
class Anchors:
    """History of friction at the last accepted step.

    Attributes
    ----------
    touching : ndarray of bool (k,)
    place : ndarray (k, d - 1)
        Point of the glass, in its own coordinates, from which a sticking node is pulled [mm].
    touchdown : ndarray (k, d - 1)
        Where each node came into contact, in the same coordinates; from there to ``place`` it has slipped [mm].
    last : ndarray (k, d)
        Position of each node relative to the glass at that step [mm].
    """

    touching: NDArray[np.bool_]
    place: Floats
    touchdown: Floats
    last: Floats


@dataclass(frozen=True)
class PlaneForces:
    """Forces of the glass on the nodes and how they change.

    Attributes
    ----------
    force : ndarray (k, d)
        [N]; the normal is the last component.
    stiffness : ndarray (k, d, d)
        -d(force)/d(position) [N/mm].
    slipping, touching : ndarray of bool (k,)
    anchors : Anchors
        To be kept if the step is accepted.
    """

    force: Floats
    stiffness: Floats
    slipping: NDArray[np.bool_]
    touching: NDArray[np.bool_]
    anchors: Anchors


def free_anchors(positions: Floats) -> Anchors:
    """Return the anchors of nodes out of contact; ``positions`` are relative to the glass, shape (k, d).

    Parameters
    ----------
    positions : ndarray (k, d)
        [mm].

    Returns
    -------
    Anchors
    """
    flat = positions[:, :-1]
    return Anchors(np.zeros(len(positions), dtype=bool), flat.copy(), flat.copy(), positions.copy())


def plane_forces(relative: Floats, areas: Floats, glass: Glass, anchors: Anchors) -> PlaneForces:
    """Return contact forces at positions relative to the glass.

    A node that came into contact since the last step is anchored where its path crossed the glass, so that movement
    before contact costs nothing.

    Parameters
    ----------
    relative : ndarray (k, d)
        Position minus (slide, [0,] depth) [mm]; negative heights penetrate.
    areas : ndarray (k,)
        [mm^2].
    glass : Glass
    anchors : Anchors

    Returns
    -------
    PlaneForces
    """
    count, dim = relative.shape
    height = relative[:, -1]
    touching = height < 0.0
    depth = np.where(touching, -height, 0.0)
    soft = glass.softness
    # force rises as a parabola over the first `soft` of penetration: its slope then has no jump at first contact, over
    # which Newton's iterations would hop to and fro
    inside = depth < soft
    normal_stiffness = glass.penalty * areas * np.where(inside, depth / soft, 1.0)
    normal = glass.penalty * areas * np.where(inside, 0.5 * depth**2 / soft, depth - 0.5 * soft)
    force, stiffness = np.zeros((count, dim)), np.zeros((count, dim, dim))
    force[:, -1] = normal
    stiffness[:, -1, -1] = normal_stiffness
    new = touching & ~anchors.touching
    origin = anchors.place.copy()
    before = anchors.last[new]
    drop = before[:, -1] - height[new]
    share = np.clip(np.where(drop > 0, before[:, -1] / np.where(drop > 0, drop, 1.0), 0.0), 0.0, 1.0)
    move = relative[new, :-1] - before[:, :-1]
    origin[new] = before[:, :-1] + share[:, None] * move
    # how the way from the anchor changes with the node's place: by itself along the glass, and with its height
    along, with_height = np.ones(count), np.zeros((count, dim - 1))
    along[new] = 1.0 - share
    crossed = drop > 0
    with_height[np.flatnonzero(new)[crossed]] = (-before[crossed, -1] / drop[crossed] ** 2)[:, None] * move[crossed]
    touchdown = np.where(new[:, None], origin, np.where(touching[:, None], anchors.touchdown, relative[:, :-1]))
    slipping, place = touching.copy(), relative[:, :-1].copy()
    if glass.friction > 0 and touching.any():
        way = _Way(relative[:, :-1] - origin, along, with_height)
        tangential, block, slipping = _coulomb(way, areas, normal, normal_stiffness, touching, glass)
        force[:, :-1] = -tangential
        stiffness[:, :-1] = block
        stick = glass.tangential_ratio * glass.penalty * areas
        back = np.divide(tangential, stick[:, None], out=np.zeros_like(tangential), where=stick[:, None] > 0)
        place = np.where(touching[:, None], relative[:, :-1] - back, relative[:, :-1])
    return PlaneForces(force, stiffness, slipping, touching, Anchors(touching, place, touchdown, relative.copy()))


@dataclass(frozen=True)
class _Way:
    """Way of each node from its anchor (k, d - 1), its derivative along the glass (k,) and with height (k, d - 1)."""

    value: Floats
    along: Floats
    with_height: Floats


def _coulomb(
    stretch: _Way,
    areas: Floats,
    normal: Floats,
    normal_stiffness: Floats,
    touching: NDArray[np.bool_],
    glass: Glass,
) -> tuple[Floats, Floats, NDArray[np.bool_]]:
    """Return friction (k, d - 1), its rows of the stiffness (k, d - 1, d) and which nodes slip.

    An elastic trial force beyond Coulomb's cone is drawn back to it.
    """
    count, across_dim = stretch.value.shape
    stick = glass.tangential_ratio * glass.penalty * areas
    pull = stick[:, None] * stretch.value
    size, limit = np.linalg.norm(pull, axis=1), glass.friction * normal
    slipping = touching & (size > limit)
    held = touching & ~slipping
    way = np.divide(pull, size[:, None], out=np.zeros_like(pull), where=size[:, None] > 0)
    tangential = np.where(held[:, None], pull, np.where(slipping[:, None], limit[:, None] * way, 0.0))
    ratio = np.divide(limit, size, out=np.zeros_like(limit), where=size > 0)
    # derivative of the traction by the way: the identity where held, the part across the pull where slipping
    across = (stick * ratio)[:, None, None] * (np.eye(across_dim) - way[:, :, None] * way[:, None, :])
    held_part = stick[:, None, None] * np.eye(across_dim)
    by_way = np.where(held[:, None, None], held_part, np.where(slipping[:, None, None], across, 0.0))
    block = np.zeros((count, across_dim, across_dim + 1))
    block[:, :, :-1] = by_way * stretch.along[:, None, None]
    block[:, :, -1] = (by_way @ stretch.with_height[:, :, None])[:, :, 0]
    # a slipping node's friction follows its pressure, which makes the tangent unsymmetric
    block[:, :, -1] -= np.where(slipping[:, None], glass.friction * normal_stiffness[:, None] * way, 0.0)
    return tangential, block, slipping
