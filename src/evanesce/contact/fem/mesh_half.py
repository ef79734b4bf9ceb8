"""Structured mesh of the half body y >= 0 of a silicone finger in hexahedra (for slides along x), in numpy."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from evanesce.contact.fem.mesh import (
    CORNER_ANGLE,
    FingerShape,
    MeshSize,
    Outline,
    SolidMesh,
    counter_clockwise,
    graded,
    outline,
    quads,
)

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


def _half_disc(centre_cells: int, layers: int) -> tuple[Floats, Ints, Ints]:
    """Mesh the unit half disc y >= 0; return points (n, 2), quads and the border's nodes from x = 1 to x = -1."""
    m, c = centre_cells, centre_cells / (centre_cells + layers) * 0.9
    x, y = np.linspace(-c, c, 2 * m + 1), np.linspace(0.0, c, m + 1)
    block = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1)
    # draw the block's outline half way to a circle: the outer elements at its corners then keep their angles
    square, round_ = np.maximum(np.abs(block[..., 0]), block[..., 1]), np.hypot(block[..., 0], block[..., 1])
    block = block * (0.5 + 0.5 * square / np.where(round_ > 0, round_, 1.0))[..., None]
    index = np.arange((2 * m + 1) * (m + 1)).reshape(2 * m + 1, m + 1)
    edge = np.concatenate([index[-1, :], index[-2::-1, -1], index[0, -2::-1]])
    inner = block.reshape(-1, 2)[edge]
    angle = np.linspace(0.0, np.pi, edge.size)
    border = np.column_stack([np.cos(angle), np.sin(angle)])
    border[0, 1] = border[-1, 1] = 0.0
    share = np.linspace(0.0, 1.0, layers + 1)[1:]
    outer = inner[:, None] + share[None, :, None] * (border - inner)[:, None]
    outer_index = index.size + np.arange(outer.shape[0] * layers).reshape(outer.shape[0], layers)
    full = np.column_stack([edge, outer_index])
    points = np.vstack([block.reshape(-1, 2), outer.reshape(-1, 2)])
    cells = counter_clockwise(points, np.vstack([quads(index), quads(full)]))
    return points, cells, full[:, -1]


def finger_half(shape: FingerShape, size: MeshSize) -> SolidMesh:
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
    disc, disc_cells, border = _half_disc(m, count - m)
    rest = graded(shape.tip_radius * shape.cap_angle - edge_arc, size.contact, 0.0, size.growth, size.coarsest)
    arcs = np.concatenate([[0.0, edge_arc], edge_arc + rest[1:]])
    line = outline(shape, size, arcs, 1)
    blocks = [_cap_block(shape, line, disc, edge_angle), _side_block(line, disc[border])]
    cells = [_extrude(disc_cells, len(disc), line.layers.size)]
    grid = np.arange(blocks[1].shape[0] * line.layers.size * border.size).reshape(
        blocks[1].shape[0], line.layers.size, -1
    )
    cells.append(_bricks(grid))
    cap_points, side_points = blocks[0].reshape(-1, 3), blocks[1].reshape(-1, 3)
    n_cap_skin = line.cap - line.corner + 1
    facets = [
        disc_cells,
        len(cap_points) + quads(grid[:n_cap_skin, 0]),
        len(cap_points) + quads(grid[n_cap_skin - 1 :, 0]),
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
    upright, cell_array, renumber = _merged(np.vstack(everything), np.vstack(all_cells))
    skin = [renumber[f] for f in facets]
    clamped = upright[:, 2] > shape.length - 1e-7
    points = _leant(upright, shape)
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


def _leant(points: Floats, shape: FingerShape) -> Floats:
    """Turn a finger about the centre of its tip, which keeps touching the plane z = 0; its top leans towards +x."""
    if shape.tilt_deg == 0.0:
        return points
    angle = np.radians(shape.tilt_deg)
    x, y, up = points[:, 0], points[:, 1], points[:, 2] - shape.tip_radius
    return np.column_stack(
        [np.cos(angle) * x + np.sin(angle) * up, y, shape.tip_radius - np.sin(angle) * x + np.cos(angle) * up]
    )


def _cap_block(shape: FingerShape, line: Outline, disc: Floats, edge_angle: float) -> Floats:
    """Return nodes (layer, node of the disc, xyz) between the tip's skin and the core's bottom or the bone's end."""
    rho = np.hypot(disc[:, 0], disc[:, 1])
    direction = disc / np.where(rho > 0, rho, 1.0)[:, None]
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
    return np.stack([r * direction[:, 0], r * direction[:, 1], z], axis=-1)


def _side_block(line: Outline, border: Floats) -> Floats:
    """Return nodes (along the skin, layer, round the border, xyz) beside the core or bone."""
    outer, inner = line.outer[line.corner :], line.inner[line.corner :]
    section = outer[:, None] + line.layers[None, :, None] * (inner - outer)[:, None]
    r, z = section[..., 0][..., None], section[..., 1][..., None]
    return np.stack([r * border[:, 0], r * border[:, 1], np.broadcast_to(z, (*r.shape[:2], len(border)))], axis=-1)


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
    """Reverse hexahedra of negative volume."""
    a = points[cells]
    volume = np.einsum("ij,ij->i", np.cross(a[:, 1] - a[:, 0], a[:, 3] - a[:, 0]), a[:, 4] - a[:, 0])
    return np.where(volume[:, None] < 0, cells[:, [4, 5, 6, 7, 0, 1, 2, 3]], cells)
