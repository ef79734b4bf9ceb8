"""Structured meshes of a silicone finger: half section (axisymmetric) and half body (three-dimensional), in numpy.

The finger stands on its tip: the height is the last coordinate, 0 at the apex; the glass comes from below. A section has
coordinates (r, z), a half body (x, y, z) with y >= 0. A core of parallel layers is wrapped by rings that follow the
skin (an O-grid), so that no element degenerates on the axis; a rigid bone takes the core's place.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from evanesce.errors import InputError

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

CORE_SHARE = 0.55  # of the way from the focus to the skin: rings and core then have elements of like size
CORNER_ANGLE = np.pi / 4  # ray on which the core's edge lies; rays meet both faces of it at about 45 degrees


@dataclass(frozen=True)
class FingerShape:
    """Cylinder with a spherical tip, hung by its top face.

    Attributes
    ----------
    tip_radius : float
        Of the spherical cap [mm]; not below half the diameter.
    diameter : float
        Of the shaft [mm].
    length : float
        From apex to top face [mm].
    bone_radius : float
        Of a rigid round-ended core [mm]; 0 for none. At the apex the skin over it is diameter/2 - bone_radius thick.
    """

    tip_radius: float = 7.5
    diameter: float = 15.0
    length: float = 25.0
    bone_radius: float = 0.0

    def __post_init__(self) -> None:
        half = self.diameter / 2
        for key in ("tip_radius", "diameter", "length", "bone_radius"):
            value = getattr(self, key)
            if not np.isfinite(value) or value < 0 or (value == 0 and key != "bone_radius"):
                raise InputError(f"{value!r} is not a length", key=key, allowed="positive, finite [mm]")
        if self.tip_radius < half:
            raise InputError(f"{self.tip_radius:g} mm", key="tip_radius", allowed=f"at least diameter/2 = {half:g} mm")
        if self.length <= self.cap_height * (1 - 1e-9):
            raise InputError(f"{self.length:g} mm", key="length", allowed=f"at least the cap, {self.cap_height:g} mm")
        if self.bone_radius > 0.9 * half:
            raise InputError(f"{self.bone_radius:g} mm", key="bone_radius", allowed=f"0 to {0.9 * half:g} mm")
        if self.bone_radius > 0 and self.length < half:
            raise InputError(f"{self.length:g} mm", key="length", allowed=f"at least {half:g} mm with a bone")

    @property
    def cap_angle(self) -> float:
        """Polar angle at which the cap meets the shaft [rad]."""
        return float(np.arcsin(min(1.0, self.diameter / 2 / self.tip_radius)))

    @property
    def cap_height(self) -> float:
        """Height at which the cap meets the shaft [mm]."""
        return float(self.tip_radius * (1 - np.cos(self.cap_angle)))


@dataclass(frozen=True)
class MeshSize:
    """How fine a mesh is.

    Attributes
    ----------
    contact : float
        Element size at and near the contact [mm].
    fine_extent : float
        Arc from the apex that keeps this size [mm].
    growth : float
        Ratio of neighbouring elements beyond.
    coarsest : float
        Largest element [mm].
    """

    contact: float = 0.12
    fine_extent: float = 5.5
    growth: float = 1.15
    coarsest: float = 1.25

    def __post_init__(self) -> None:
        if not 0.005 <= self.contact <= 10:
            raise InputError(f"{self.contact:g} mm", key="element_size", allowed="0.005 to 10 mm")
        if not 1.0 < self.growth <= 2.0:
            raise InputError(f"{self.growth:g}", key="growth", allowed="above 1, up to 2")


@dataclass(frozen=True)
class SolidMesh:
    """Nodes and elements of a solid and what they are for.

    Attributes
    ----------
    points : ndarray (n, 2 or 3)
        (r, z) or (x, y, z) [mm].
    cells : ndarray (m, 4 or 8)
        Quadrilaterals, counter-clockwise in (r, z), or hexahedra of positive volume.
    facets : ndarray (f, 2 or 4)
        Edges or faces of the skin: the cap first, then the shaft.
    candidates : ndarray (k,)
        Nodes that may touch the glass: those of the cap.
    clamped : ndarray
        Nodes held in all directions: top face and bone.
    mirror : ndarray
        Nodes held in the direction across: r = 0 in a section, y = 0 in a half body.
    """

    points: Floats
    cells: Ints
    facets: Ints
    candidates: Ints
    clamped: Ints
    mirror: Ints

    @property
    def dim(self) -> int:
        """2 for a section, 3 for a half body."""
        return int(self.points.shape[1])


def graded(length: float, first: float, flat: float, growth: float, coarsest: float) -> Floats:
    """Return division points from 0 to length: elements of size ``first`` up to ``flat``, then growing.

    The sizes are stretched together (by less than one element in all) so that they end at ``length``.
    """
    sizes: list[float] = []
    total, size = 0.0, first
    while total < length * (1 - 1e-9):
        if total >= flat:
            size = min(size * growth, coarsest)
        sizes.append(size)
        total += size
    # drop the last element where the division without it is the closer one
    if len(sizes) > 1 and total - length > sizes[-1] / 2:
        total -= sizes.pop()
    return np.concatenate([[0.0], np.cumsum(sizes)]) * (length / total)


@dataclass(frozen=True)
class _Outline:
    """Skin and inner boundary as two rows of matching nodes: apex first, top last; (r, z) each."""

    outer: Floats
    inner: Floats
    corner: int  # index of the core's edge
    cap: int  # index where the cap meets the shaft
    layers: Floats  # 0 at the skin to 1 at the inner boundary


def _outline(shape: FingerShape, size: MeshSize, cap_arcs: Floats, corner: int) -> _Outline:
    """Place matching nodes on the skin and on core or bone; ``cap_arcs`` are the cap's division points [mm]."""
    radius, half = shape.tip_radius, shape.diameter / 2
    angle = cap_arcs / radius
    cap = np.column_stack([radius * np.sin(angle), radius * (1 - np.cos(angle))])
    cap[0, 0], cap[-1, 0] = 0.0, half
    shaft_length = shape.length - shape.cap_height
    last = cap_arcs[-1] - cap_arcs[-2]
    if shaft_length > 1e-6 * half:
        up = graded(shaft_length, last, 0.0, size.growth, max(size.coarsest, last))[1:]
        shaft = np.column_stack([np.full(up.size, half), shape.cap_height + up])
        outer = np.vstack([cap, shaft])
        outer[-1, 1] = shape.length
    else:
        outer = cap
    n_cap = len(cap) - 1
    if shape.bone_radius > 0:
        inner = _bone_boundary(shape, cap_arcs, outer, n_cap)
    else:
        inner = _core_boundary(shape, outer, corner)
    distance = float(np.linalg.norm(outer[0] - inner[0]))
    layers = graded(distance, size.contact, 0.3 * size.fine_extent, size.growth, size.coarsest) / distance
    return _Outline(outer, inner, corner, n_cap, layers)


def _core_boundary(shape: FingerShape, outer: Floats, corner: int) -> Floats:
    """Return the core's bottom and side, nodes opposite those of the skin."""
    focus = np.array([0.0, min(shape.diameter / 2, shape.length)])
    edge = focus + CORE_SHARE * (outer[corner] - focus)
    bottom_r = edge[0] * outer[: corner + 1, 0] / outer[corner, 0]
    steps = np.linalg.norm(np.diff(outer[corner:], axis=0), axis=1)
    rise = np.concatenate([[0.0], np.cumsum(steps)]) / steps.sum()
    side_z = edge[1] + (shape.length - edge[1]) * rise
    bottom = np.column_stack([bottom_r, np.full(bottom_r.size, edge[1])])
    return np.vstack([bottom, np.column_stack([np.full(side_z.size - 1, edge[0]), side_z[1:]])])


def _bone_boundary(shape: FingerShape, cap_arcs: Floats, outer: Floats, n_cap: int) -> Floats:
    """Return the bone's round end and side, nodes opposite those of the skin."""
    angle = 0.5 * np.pi * cap_arcs / cap_arcs[-1]
    if len(outer) == n_cap + 1:
        angle = angle * min(
            1.0, np.arccos(max(-1.0, (shape.diameter / 2 - shape.length) / shape.bone_radius)) / angle[-1]
        )
    centre = shape.diameter / 2
    end = np.column_stack([shape.bone_radius * np.sin(angle), centre - shape.bone_radius * np.cos(angle)])
    end[0, 0] = 0.0
    rise = (outer[n_cap + 1 :, 1] - outer[n_cap, 1]) / max(shape.length - outer[n_cap, 1], 1e-12)
    side = np.column_stack([np.full(rise.size, shape.bone_radius), centre + (shape.length - centre) * rise])
    return np.vstack([end, side])


def _corner_of(arcs: Floats, shape: FingerShape) -> int:
    """Return the cap node that the core's edge looks at; at least one element lies on either side of it."""
    angle = min(CORNER_ANGLE, 0.75 * shape.cap_angle)
    return int(np.clip(np.argmin(np.abs(arcs / shape.tip_radius - angle)), 1, arcs.size - 2))


def finger_section(shape: FingerShape, size: MeshSize = MeshSize()) -> SolidMesh:
    """Mesh the half section r >= 0 of a finger with quadrilaterals.

    Parameters
    ----------
    shape : FingerShape
    size : MeshSize

    Returns
    -------
    SolidMesh
        ``facets`` run along the skin from the apex to the top; the first ``candidates`` node is the apex.
    """
    cap_length = shape.tip_radius * shape.cap_angle
    arcs = graded(cap_length, size.contact, size.fine_extent, size.growth, size.coarsest)
    if arcs.size < 3:
        arcs = np.linspace(0.0, cap_length, 3)
    line = _outline(shape, size, arcs, _corner_of(arcs, shape))
    rings = line.outer[:, None] + line.layers[None, :, None] * (line.inner - line.outer)[:, None]
    n_line, n_layers = rings.shape[:2]
    index = np.arange(n_line * n_layers).reshape(n_line, n_layers)
    points, cells = [rings.reshape(-1, 2)], [_quads(index)]
    top = [index[-1]]
    axis = [index[0]]
    if shape.bone_radius == 0:
        core, core_cells, core_top, core_axis = _section_core(line, index[:, -1], index.size)
        points.append(core)
        cells.append(core_cells)
        top.append(core_top)
        axis.append(core_axis)
    clamped = np.unique(np.concatenate(top if shape.bone_radius == 0 else [*top, index[:, -1]]))
    skin = index[:, 0]
    mesh_points, mesh_cells = np.vstack(points), np.vstack(cells)
    return SolidMesh(
        points=mesh_points,
        cells=_counter_clockwise(mesh_points, mesh_cells),
        facets=np.column_stack([skin[:-1], skin[1:]]),
        candidates=skin[: line.cap + 1],
        clamped=clamped,
        mirror=np.setdiff1d(np.concatenate(axis), clamped),
    )


def _section_core(line: _Outline, boundary: Ints, start: int) -> tuple[Floats, Ints, Ints, Ints]:
    """Fill the core with layers; its bottom and side nodes are those of the innermost ring."""
    r, z = line.inner[: line.corner + 1, 0], line.inner[line.corner :, 1]
    index = np.empty((r.size, z.size), dtype=np.int64)
    index[:, 0] = boundary[: line.corner + 1]
    index[-1, :] = boundary[line.corner :]
    index[:-1, 1:] = start + np.arange((r.size - 1) * (z.size - 1)).reshape(r.size - 1, z.size - 1)
    inside = np.stack(np.meshgrid(r[:-1], z[1:], indexing="ij"), axis=-1).reshape(-1, 2)
    return inside, _quads(index), index[:, -1], index[0, :]


def _quads(index: Ints) -> Ints:
    """Return the quadrilaterals of a structured index array."""
    return np.stack([index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]], axis=-1).reshape(-1, 4)


def _counter_clockwise(points: Floats, cells: Ints) -> Ints:
    """Turn clockwise quadrilaterals round."""
    x, y = points[cells, 0], points[cells, 1]
    area = (x * np.roll(y, -1, axis=1) - np.roll(x, -1, axis=1) * y).sum(axis=1)
    return np.where(area[:, None] < 0, cells[:, ::-1], cells)


def _half_disc(centre_cells: int, rings: int) -> tuple[Floats, Ints, Ints]:
    """Mesh the unit half disc y >= 0; return points (n, 2), quads and the rim's nodes from x = 1 to x = -1."""
    m, c = centre_cells, centre_cells / (centre_cells + rings) * 0.9
    x, y = np.linspace(-c, c, 2 * m + 1), np.linspace(0.0, c, m + 1)
    block = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1)
    # draw the block's outline half way to a circle: the ring elements at its corners then keep their angles
    square, round_ = np.maximum(np.abs(block[..., 0]), block[..., 1]), np.hypot(block[..., 0], block[..., 1])
    block = block * (0.5 + 0.5 * square / np.where(round_ > 0, round_, 1.0))[..., None]
    index = np.arange((2 * m + 1) * (m + 1)).reshape(2 * m + 1, m + 1)
    edge = np.concatenate([index[-1, :], index[-2::-1, -1], index[0, -2::-1]])
    inner = block.reshape(-1, 2)[edge]
    angle = np.linspace(0.0, np.pi, edge.size)
    rim = np.column_stack([np.cos(angle), np.sin(angle)])
    rim[0, 1] = rim[-1, 1] = 0.0
    share = np.linspace(0.0, 1.0, rings + 1)[1:]
    ring = inner[:, None] + share[None, :, None] * (rim - inner)[:, None]
    ring_index = index.size + np.arange(ring.shape[0] * rings).reshape(ring.shape[0], rings)
    full = np.column_stack([edge, ring_index])
    points = np.vstack([block.reshape(-1, 2), ring.reshape(-1, 2)])
    cells = _counter_clockwise(points, np.vstack([_quads(index), _quads(full)]))
    return points, cells, full[:, -1]


def finger_half(shape: FingerShape, size: MeshSize = MeshSize(contact=0.55)) -> SolidMesh:
    """Mesh the half body y >= 0 of a finger with hexahedra.

    Parameters
    ----------
    shape : FingerShape
    size : MeshSize
        ``contact`` holds up to the core's edge (45 deg on a hemisphere); ``fine_extent`` moves that edge outwards.

    Returns
    -------
    SolidMesh
    """
    edge_angle = min(max(CORNER_ANGLE, size.fine_extent / shape.tip_radius), 0.75 * shape.cap_angle)
    edge_arc = edge_angle * shape.tip_radius
    count = max(3, round(edge_arc / size.contact))
    m = max(1, round(0.45 * count))
    disc, disc_cells, rim = _half_disc(m, count - m)
    rest = graded(shape.tip_radius * shape.cap_angle - edge_arc, size.contact, 0.0, size.growth, size.coarsest)
    arcs = np.concatenate([[0.0, edge_arc], edge_arc + rest[1:]])
    line = _outline(shape, size, arcs, 1)
    blocks = [_cap_block(shape, line, disc, edge_angle), _side_block(line, disc[rim])]
    cells = [_extrude(disc_cells, len(disc), line.layers.size)]
    grid = np.arange(blocks[1].shape[0] * line.layers.size * rim.size).reshape(blocks[1].shape[0], line.layers.size, -1)
    cells.append(_bricks(grid))
    cap_points, side_points = blocks[0].reshape(-1, 3), blocks[1].reshape(-1, 3)
    n_cap_skin = line.cap - line.corner + 1
    facets = [
        disc_cells,
        len(cap_points) + _quads(grid[:n_cap_skin, 0]),
        len(cap_points) + _quads(grid[n_cap_skin - 1 :, 0]),
    ]
    everything = [cap_points, side_points]
    all_cells = [cells[0], len(cap_points) + cells[1]]
    if shape.bone_radius == 0:
        start = len(cap_points) + len(side_points)
        z = line.inner[line.corner :, 1]
        flat = disc * line.inner[line.corner, 0]
        core = np.concatenate([np.column_stack([flat, np.full(len(flat), height)]) for height in z])
        everything.append(core)
        all_cells.append(start + _extrude(disc_cells, len(disc), z.size))
    points, cell_array, renumber = _merged(np.vstack(everything), np.vstack(all_cells))
    skin = [renumber[f] for f in facets]
    clamped = points[:, 2] > shape.length - 1e-7
    if shape.bone_radius > 0:
        inner = np.concatenate(
            [np.arange(len(disc)) + len(disc) * (line.layers.size - 1), len(cap_points) + grid[:, -1].ravel()]
        )
        clamped[renumber[inner]] = True
    return SolidMesh(
        points=points,
        cells=_positive(points, cell_array),
        facets=np.vstack(skin),
        candidates=np.unique(np.vstack(skin[:2])),
        clamped=np.flatnonzero(clamped),
        mirror=np.flatnonzero((np.abs(points[:, 1]) < 1e-9) & ~clamped),
    )


def _cap_block(shape: FingerShape, line: _Outline, disc: Floats, edge_angle: float) -> Floats:
    """Return nodes (layer, node of the disc, xyz) between the tip's skin and the core's bottom or the bone's end."""
    rho = np.hypot(disc[:, 0], disc[:, 1])
    way = disc / np.where(rho > 0, rho, 1.0)[:, None]
    skin_r, skin_z = shape.tip_radius * np.sin(rho * edge_angle), shape.tip_radius * (1 - np.cos(rho * edge_angle))
    if shape.bone_radius > 0:
        centre = shape.diameter / 2
        inner_edge = np.arctan2(line.inner[line.corner, 0], centre - line.inner[line.corner, 1])
        inner_r = shape.bone_radius * np.sin(rho * inner_edge)
        inner_z = centre - shape.bone_radius * np.cos(rho * inner_edge)
    else:
        inner_r, inner_z = rho * line.inner[line.corner, 0], np.full(rho.size, line.inner[line.corner, 1])
    t = line.layers[:, None]
    r, z = skin_r + t * (inner_r - skin_r), skin_z + t * (inner_z - skin_z)
    return np.stack([r * way[:, 0], r * way[:, 1], z], axis=-1)


def _side_block(line: _Outline, rim: Floats) -> Floats:
    """Return nodes (along the skin, layer, round the rim, xyz) beside the core or bone."""
    outer, inner = line.outer[line.corner :], line.inner[line.corner :]
    section = outer[:, None] + line.layers[None, :, None] * (inner - outer)[:, None]
    r, z = section[..., 0][..., None], section[..., 1][..., None]
    return np.stack([r * rim[:, 0], r * rim[:, 1], np.broadcast_to(z, (*r.shape[:2], len(rim)))], axis=-1)


def _extrude(quads: Ints, n_points: int, n_layers: int) -> Ints:
    """Return the hexahedra between n_layers copies of a quadrilateral mesh."""
    below = quads[None] + n_points * np.arange(n_layers - 1)[:, None, None]
    return np.concatenate([below, below + n_points], axis=-1).reshape(-1, 8)


def _bricks(index: Ints) -> Ints:
    """Return the hexahedra of a structured three-dimensional index array."""
    low, high = index[:-1], index[1:]
    corners: list[Ints] = []
    for part in (low, high):
        corners += [part[:, :-1, :-1], part[:, 1:, :-1], part[:, 1:, 1:], part[:, :-1, 1:]]
    return np.stack(corners, axis=-1).reshape(-1, 8)


def _merged(points: Floats, cells: Ints) -> tuple[Floats, Ints, Ints]:
    """Join nodes of neighbouring blocks; return points, cells and the new index of each old node."""
    _, first, new = np.unique(np.round(points, 7) + 0.0, axis=0, return_index=True, return_inverse=True)
    new = new.reshape(-1)
    return points[first], new[cells], new


def _positive(points: Floats, cells: Ints) -> Ints:
    """Turn hexahedra of negative volume inside out."""
    a = points[cells]
    volume = np.einsum("ij,ij->i", np.cross(a[:, 1] - a[:, 0], a[:, 3] - a[:, 0]), a[:, 4] - a[:, 0])
    return np.where(volume[:, None] < 0, cells[:, [4, 5, 6, 7, 0, 1, 2, 3]], cells)


def nodal_areas(points: Floats, facets: Ints, *, projected: bool = False) -> Floats:
    """Return the area that belongs to each node [mm^2], shape (n,): the integral of its shape function over the skin.

    Parameters
    ----------
    points : ndarray (n, 2 or 3)
        (r, z) of a section (the area is that of the whole ring) or (x, y, z).
    facets : ndarray (f, 2 or 4)
    projected : bool
        Of the skin's shadow on the glass instead of the skin itself.
    """
    area = np.zeros(len(points))
    if points.shape[1] == 2:
        a, b = points[facets[:, 0]], points[facets[:, 1]]
        length = np.abs(b[:, 0] - a[:, 0]) if projected else np.linalg.norm(b - a, axis=1)
        np.add.at(area, facets[:, 0], 2 * np.pi * length * (a[:, 0] / 3 + b[:, 0] / 6))
        np.add.at(area, facets[:, 1], 2 * np.pi * length * (a[:, 0] / 6 + b[:, 0] / 3))
        return area
    p = points[facets]
    if projected:
        p = p * np.array([1.0, 1.0, 0.0])
    for i in range(4):  # bilinear faces: the corner's own Jacobian weighs its quarter (trapezoidal rule)
        side, other = p[:, (i + 1) % 4] - p[:, i], p[:, (i - 1) % 4] - p[:, i]
        np.add.at(area, facets[:, i], np.linalg.norm(np.cross(side, other), axis=1) / 4)
    return area
