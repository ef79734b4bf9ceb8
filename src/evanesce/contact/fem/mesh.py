"""Structured meshes of a silicone finger in numpy: its shape, and its half section (for axisymmetric presses).

The finger stands on its tip: the height is the last coordinate, 0 at the apex; the glass comes from below. A section
has coordinates (r, z), a half body (x, y, z) with y >= 0. A core of parallel layers is wrapped by layers along the
skin (an O-grid), so that no element degenerates on the axis; a rigid bone takes the core's place.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from evanesce.core.errors import InputError

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

CORE_SHARE = 0.55  # of the distance from the focus to the skin: layers and core then have elements of like size
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
    tilt_deg : float
        Lean of the finger's top towards +x from the glass's normal, about the centre of its tip; of half bodies.
    """

    tip_radius: float = 7.5
    diameter: float = 15.0
    length: float = 25.0
    bone_radius: float = 0.0
    tilt_deg: float = 0.0

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
        rim = float(np.degrees(self.cap_angle))
        if not 0.0 <= self.tilt_deg < rim:
            raise InputError(f"{self.tilt_deg:g} deg", key="tilt", allowed=f"0 to below the tip's rim at {rim:.3g} deg")
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
    """Element sizes of a mesh.

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
    """Nodes and elements of a solid, and their roles.

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

    Parameters
    ----------
    length : float
        [mm].
    first : float
        Size of the first element [mm].
    flat : float
        Length of elements of that size [mm].
    growth : float
        Of each element over the one before.
    coarsest : float
        Largest element [mm].

    Returns
    -------
    ndarray (n,)
        [mm], ascending from 0 to ``length``.
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
class Outline:
    """Skin and inner boundary as two rows of matching nodes, apex first, top last.

    Attributes
    ----------
    outer, inner : ndarray (n, 2)
        (r, z) [mm].
    corner : int
        Index of the core's edge.
    cap : int
        Index where the cap meets the shaft.
    layers : ndarray (m,)
        0 at the skin to 1 at the inner boundary.
    """

    outer: Floats
    inner: Floats
    corner: int
    cap: int
    layers: Floats


def outline(shape: FingerShape, size: MeshSize, cap_arcs: Floats, corner: int) -> Outline:
    """Place matching nodes on the skin and on core or bone.

    Parameters
    ----------
    shape : FingerShape
    size : MeshSize
    cap_arcs : ndarray (k,)
        Division points of the cap along the skin, from the apex [mm].
    corner : int
        Index of the core's edge.

    Returns
    -------
    Outline
    """
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
    return Outline(outer, inner, corner, n_cap, layers)


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
    """Return the cap node opposite the core's edge; at least one element lies on either side of it."""
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
    if shape.tilt_deg:
        raise InputError(f"{shape.tilt_deg:g} deg", key="tilt", allowed="0 for an axisymmetric press")
    cap_length = shape.tip_radius * shape.cap_angle
    arcs = graded(cap_length, size.contact, size.fine_extent, size.growth, size.coarsest)
    if arcs.size < 3:
        arcs = np.linspace(0.0, cap_length, 3)
    line = outline(shape, size, arcs, _corner_of(arcs, shape))
    nodes = line.outer[:, None] + line.layers[None, :, None] * (line.inner - line.outer)[:, None]
    n_line, n_layers = nodes.shape[:2]
    index = np.arange(n_line * n_layers).reshape(n_line, n_layers)
    points, cells = [nodes.reshape(-1, 2)], [quads(index)]
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
        cells=counter_clockwise(mesh_points, mesh_cells),
        facets=np.column_stack([skin[:-1], skin[1:]]),
        candidates=skin[: line.cap + 1],
        clamped=clamped,
        mirror=np.setdiff1d(np.concatenate(axis), clamped),
    )


def _section_core(line: Outline, boundary: Ints, start: int) -> tuple[Floats, Ints, Ints, Ints]:
    """Fill the core with layers; its bottom and side nodes are those of the innermost layer."""
    r, z = line.inner[: line.corner + 1, 0], line.inner[line.corner :, 1]
    index = np.empty((r.size, z.size), dtype=np.int64)
    index[:, 0] = boundary[: line.corner + 1]
    index[-1, :] = boundary[line.corner :]
    index[:-1, 1:] = start + np.arange((r.size - 1) * (z.size - 1)).reshape(r.size - 1, z.size - 1)
    inside = np.stack(np.meshgrid(r[:-1], z[1:], indexing="ij"), axis=-1).reshape(-1, 2)
    return inside, quads(index), index[:, -1], index[0, :]


def quads(index: Ints) -> Ints:
    """Return the quadrilaterals of a structured index array.

    Parameters
    ----------
    index : ndarray of int (i, j)
        Node numbers.

    Returns
    -------
    ndarray of int (quads, 4)
    """
    return np.stack([index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]], axis=-1).reshape(-1, 4)


def counter_clockwise(points: Floats, cells: Ints) -> Ints:
    """Reverse clockwise quadrilaterals.

    Parameters
    ----------
    points : ndarray (n, 2)
        [mm].
    cells : ndarray of int (quads, 4)

    Returns
    -------
    ndarray of int (quads, 4)
    """
    x, y = points[cells, 0], points[cells, 1]
    area = (x * np.roll(y, -1, axis=1) - np.roll(x, -1, axis=1) * y).sum(axis=1)
    return np.where(area[:, None] < 0, cells[:, ::-1], cells)


def nodal_areas(points: Floats, facets: Ints, *, projected: bool = False) -> Floats:
    """Return the area that belongs to each node [mm^2], shape (n,): the integral of its shape function over the skin.

    Parameters
    ----------
    points : ndarray (n, 2 or 3)
        (r, z) of a section (the area is that of the whole annulus) or (x, y, z).
    facets : ndarray (f, 2 or 4)
    projected : bool
        Of the skin's shadow on the glass instead of the skin itself.

    Returns
    -------
    ndarray (n,)
        [mm^2].
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
