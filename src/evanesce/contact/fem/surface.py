"""From nodal results to the contact itself: pressure, gap, and the contour at which the gap opens, finer than elements.

Beside the edge of any smooth contact the gap grows with the 3/2 power of the distance (and the pressure with the 1/2
power), so q = gap^(2/3) is straight there. Its continuation to zero from the free side is the contact's edge. Counting
nodes in contact, or their tributary areas, is off by half an element, 14 % of the area at usual sizes.

References
----------
K. L. Johnson, Contact Mechanics (Cambridge, 1985), sections 4.2 and 5.1.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from evanesce.contact.fem.mesh import SolidMesh, nodal_areas

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

EDGE_NODES = 4  # free nodes whose q is continued to zero: fewer follow the noise of one element, more leave the 3/2 law


@dataclass(frozen=True)
class Footprint:
    """Contact of a solved instant at the glass.

    Attributes
    ----------
    place : ndarray (k, 1 or 2)
        r, or (x, y), of the skin's nodes that may touch, relative to the middle of the finger's top [mm].
    pressure : ndarray (k,)
        Nodal force over the node's own area on the glass [MPa].
    traction : ndarray (k, 1 or 2)
        Of the finger on the glass [MPa].
    gap : ndarray (k,)
        [mm]; 0 in contact.
    touching, slipping : ndarray of bool (k,)
    slip : ndarray (k, 1 or 2)
        Slip of the finger over the glass since contact [mm].
    opening : ndarray (k,)
        Signed q = gap^(2/3) [mm^(2/3)]: positive outside, continued to negative values inside the contact.
    area : float
        Of nominal contact, whole finger [mm^2].
    """

    place: Floats
    pressure: Floats
    traction: Floats
    gap: Floats
    touching: NDArray[np.bool_]
    slipping: NDArray[np.bool_]
    slip: Floats
    opening: Floats
    area: float


def footprint(
    mesh: SolidMesh,
    displacement: Floats,
    depth: float,
    force: Floats,
    touching: NDArray[np.bool_],
    slipping: NDArray[np.bool_],
    slip: Floats,
) -> Footprint:
    """Return the footprint of nodal results.

    Parameters
    ----------
    mesh : SolidMesh
    displacement : ndarray (n, d)
        [mm].
    depth : float
        Height of the glass [mm].
    force : ndarray (k, d)
        Contact forces on the candidates [N].
    touching, slipping : ndarray of bool (k,)
    slip : ndarray (k, d - 1)
        [mm].

    Returns
    -------
    Footprint
    """
    position = mesh.points + displacement
    chosen = mesh.candidates
    area = nodal_areas(position, mesh.facets, projected=True)[chosen]
    safe = np.where(area > 0, area, 1.0)
    gap = np.where(touching, 0.0, np.maximum(position[chosen, -1] - depth, 0.0))
    place = position[chosen, :-1]
    if not touching.any():
        opening, total = np.cbrt(gap) ** 2, 0.0
    elif mesh.dim == 2:
        radius = contact_radius(place[:, 0], gap, touching)
        opening = np.where(touching, np.minimum(_inside(place[:, 0], gap, touching, radius), -1e-12), np.cbrt(gap) ** 2)
        total = float(np.pi * radius**2)
    else:
        faces = _faces_of(mesh)
        opening = signed_opening(place, faces, gap, touching)
        total = 2.0 * level_area(place, faces, opening)
    return Footprint(
        place=place,
        pressure=np.where(touching, force[:, -1] / safe, 0.0),
        traction=np.where(touching[:, None], -force[:, :-1] / safe[:, None], 0.0),
        gap=gap,
        touching=touching,
        slipping=slipping & touching,
        slip=np.where(touching[:, None], slip, 0.0),
        opening=opening,
        area=total,
    )


def contact_radius(r: Floats, gap: Floats, touching: NDArray[np.bool_]) -> float:
    """Return the radius [mm] at which the gap of an axisymmetric contact opens.

    Parameters
    ----------
    r, gap : ndarray (k,)
        Of the skin's nodes, from the apex outwards [mm].
    touching : ndarray of bool (k,)

    Returns
    -------
    float
        [mm].
    """
    last = int(np.flatnonzero(touching)[-1])
    if last + 1 >= r.size:
        return float(r[last])
    beyond = slice(last + 1, min(last + 1 + EDGE_NODES, r.size))
    q = np.cbrt(gap[beyond]) ** 2
    if q.size < 2 or q[-1] <= q[0]:
        return float(0.5 * (r[last] + r[last + 1]))
    slope, offset = np.polyfit(r[beyond], q, 1)
    return float(np.clip(-offset / slope, r[last], r[last + 1]))


def _inside(r: Floats, gap: Floats, touching: NDArray[np.bool_], radius: float) -> Floats:
    """Return q continued into an axisymmetric contact with its slope at the edge."""
    first = min(int(np.flatnonzero(touching)[-1]) + 1, r.size - 1)
    slope = np.cbrt(gap[first]) ** 2 / max(r[first] - radius, 1e-9)
    return np.asarray(slope * (r - radius))


def _faces_of(mesh: SolidMesh) -> Ints:
    """Return the cap's faces as indices into the candidates."""
    number = np.full(len(mesh.points), -1)
    number[mesh.candidates] = np.arange(mesh.candidates.size)
    faces = number[mesh.facets]
    return np.asarray(faces[(faces >= 0).all(axis=1)])


def signed_opening(place: Floats, faces: Ints, gap: Floats, touching: NDArray[np.bool_]) -> Floats:
    """Return q = gap^(2/3) with its continuation to negative values at the nodes in contact, shape (k,).

    Each free node beside the contact has a gradient of q, by least squares over its free neighbours; continued along
    the edge to the neighbour in contact it gives that one a value; the mean over its edges is taken.

    Parameters
    ----------
    place : ndarray (k, 2)
        [mm].
    faces : ndarray of int (faces, nodes)
    gap : ndarray (k,)
        [mm].
    touching : ndarray of bool (k,)

    Returns
    -------
    ndarray (k,)
        [mm^(2/3)].
    """
    q = np.cbrt(gap) ** 2
    corners = faces.shape[1]
    joined = [faces[:, [i, j]] for i in range(corners) for j in range(i)]
    pairs = np.unique(np.sort(np.vstack(joined), axis=1), axis=0)
    both = np.vstack([pairs, pairs[:, ::-1]])
    free = ~touching
    moment, right = np.zeros((len(place), 2, 2)), np.zeros((len(place), 2))
    inner = both[free[both[:, 0]] & free[both[:, 1]]]
    way = place[inner[:, 1]] - place[inner[:, 0]]
    weight = 1.0 / np.maximum((way**2).sum(axis=1), 1e-12)
    np.add.at(moment, inner[:, 0], weight[:, None, None] * way[:, :, None] * way[:, None, :])
    np.add.at(right, inner[:, 0], (weight * (q[inner[:, 1]] - q[inner[:, 0]]))[:, None] * way)
    edge = both[touching[both[:, 0]] & free[both[:, 1]]]
    outside = edge[:, 1]
    trace = np.maximum(np.einsum("kii->k", moment[outside]), 1e-12)
    gradient = np.linalg.solve(moment[outside] + 1e-9 * trace[:, None, None] * np.eye(2), right[outside][..., None])[
        ..., 0
    ]
    value = q[outside] + ((place[edge[:, 0]] - place[outside]) * gradient).sum(axis=1)
    total, count = np.zeros(len(place)), np.zeros(len(place))
    np.add.at(total, edge[:, 0], np.minimum(value, 0.0))
    np.add.at(count, edge[:, 0], 1.0)
    deep = float(q[free].max()) if free.any() else 1.0
    inside = np.where(count > 0, total / np.maximum(count, 1.0), -deep)
    return np.where(touching, np.minimum(inside, -1e-12), q)


def triangles(faces: Ints) -> Ints:
    """Return two triangles for each quadrilateral.

    Parameters
    ----------
    faces : ndarray of int (quads, 4)

    Returns
    -------
    ndarray of int (2 quads, 3)
    """
    return np.vstack([faces[:, [0, 1, 2]], faces[:, [0, 2, 3]]])


def level_area(place: Floats, faces: Ints, value: Floats) -> float:
    """Return the area in which a field is negative [mm^2]; quadrilaterals are cut along both diagonals in turn.

    Parameters
    ----------
    place : ndarray (k, 2)
        [mm].
    faces : ndarray (f, 3 or 4)
    value : ndarray (k,)

    Returns
    -------
    float
        [mm^2].
    """
    total = 0.0
    cuts = [faces] * 2 if faces.shape[1] == 3 else [triangles(faces), triangles(np.roll(faces, 1, axis=1))]
    for cut in cuts:  # the mean of both diagonals of a quadrilateral favours neither
        p, v = place[cut], value[cut]
        a, b = p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]
        area = 0.5 * np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
        below = v < 0
        count = below.sum(axis=1)
        share = np.where(count == 3, 1.0, 0.0)
        for n in (1, 2):  # a triangle's lone corner cuts off the product of the two shares along its sides
            for corner in range(3):
                lone = (count == n) & (below[:, corner] == (n == 1))
                v0, v1, v2 = v[lone, corner], v[lone, (corner + 1) % 3], v[lone, (corner + 2) % 3]
                part = v0 / (v0 - v1) * v0 / (v0 - v2)
                share[lone] = part if n == 1 else 1.0 - part
        total += 0.5 * float((share * area).sum())
    return total


def nodal_shares(place: Floats, faces: Ints) -> Floats:
    """Return the area of each node of a flat mesh of triangles or quadrilaterals [mm^2]: a linear field's integral.

    Parameters
    ----------
    place : ndarray (k, 2)
        [mm].
    faces : ndarray of int (faces, nodes)

    Returns
    -------
    ndarray (k,)
        [mm^2].
    """
    share = np.zeros(len(place))
    cut = faces if faces.shape[1] == 3 else np.vstack([triangles(faces), triangles(np.roll(faces, 1, axis=1))])
    p = place[cut]
    a, b = p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]
    area = 0.5 * np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) / (1 if faces.shape[1] == 3 else 2)
    for i in range(3):
        np.add.at(share, cut[:, i], area / 3.0)
    return share
