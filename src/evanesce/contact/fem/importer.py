"""Finite-element results of other programs (ANSYS, CalculiX, any CSV or VTK) as contact states, checked before use."""

from __future__ import annotations

import io
from collections.abc import Mapping
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import Delaunay, QhullError, cKDTree

from evanesce.contact.fem.state import surface_state
from evanesce.contact.fem.surface import Footprint, level_area, nodal_shares, signed_opening
from evanesce.core.columns import Column, read_columns
from evanesce.core.errors import InputError
from evanesce.core.extras import require
from evanesce.core.states import ContactState, PlateGrid

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

COLUMNS = (
    Column("x", ("x_coordinate", "pos_x", "loc_x"), "length"),
    Column("y", ("y_coordinate", "pos_y", "loc_y"), "length"),
    Column("pressure", ("contpres", "contact_pressure", "cpress", "p"), "stress"),
    Column("gap", ("contgap", "copen", "contact_gap", "g"), "length"),
)
# what a finger's contact can be: outside these bounds the unit is wrong rather than the finger odd
SPAN = (0.5, 200.0)  # [mm] of all nodes
PEAK = (1e-4, 20.0)  # [MPa]
DOUBLE = 1e-6  # of the span: nodes closer than this are one node given twice
PENETRATION = 0.01  # of the span: a gap further below zero is not a penalty's penetration
FORCE_TOLERANCE = 0.25  # of the force stated by the user


@dataclass(frozen=True)
class ForeignContact:
    """A checked footprint of another program.

    Attributes
    ----------
    place : ndarray (n, 2)
        (x, y) [mm].
    pressure, gap : ndarray (n,)
        [MPa], [mm].
    faces : ndarray (f, 3 or 4)
        Counter-clockwise.
    source : str
        File it came from.
    """

    place: Floats
    pressure: Floats
    gap: Floats
    faces: Ints
    source: str

    @property
    def force(self) -> float:
        """Integral of the pressure over the faces [N]."""
        return float(self.pressure @ nodal_shares(self.place, self.faces))

    def footprint(self) -> Footprint:
        """Return the footprint: friction is not in the file, so all contact sticks.

        Returns
        -------
        Footprint
        """
        touching = self.pressure > 0
        gap = np.where(touching, 0.0, self.gap)
        opening = signed_opening(self.place, self.faces, gap, touching)
        nothing = np.zeros_like(self.place)
        area = level_area(self.place, self.faces, opening)
        slipping = np.zeros(len(touching), dtype=bool)
        return Footprint(self.place, self.pressure, nothing, gap, touching, slipping, nothing, opening, area)

    def state(
        self, grid: PlateGrid, *, centre: tuple[float, float] = (0.0, 0.0), beyond: float = 25.0, time: float = 0.0
    ) -> ContactState:
        """Return the contact on a plate grid, ``centre`` being where the file's origin lies [mm].

        Parameters
        ----------
        grid : PlateGrid
        centre : tuple of float
        beyond : float
            Gap where there is no finger over the glass [mm].
        time : float
            [s].

        Returns
        -------
        ContactState

        Raises
        ------
        InputError
            If the contact does not fit on the grid.
        """
        return surface_state(
            grid,
            centre,
            self.footprint(),
            depth=float("nan"),
            normal_force=self.force,
            tangential_force=0.0,
            beyond=beyond,
            parameters={"source": self.source},
            mirrored=False,
            law="fem_import",
            time=time,
        )


def check_contact(
    place: Floats,
    pressure: Floats,
    gap: Floats,
    cells: Ints | None = None,
    *,
    source: str,
    force: float | None = None,
    first_index: int = 0,
) -> ForeignContact:
    """Check nodal results and connect their nodes.

    Parameters
    ----------
    place : ndarray (n, 2)
        (x, y) [mm].
    pressure, gap : ndarray (n,)
        [MPa], [mm].
    cells : ndarray (f, 3 or 4), optional
        Faces of the skin; without them the nodes are triangulated.
    source : str
        File, for messages.
    force : float, optional
        What the pressure should add up to [N].
    first_index : int
        Number of the first node in messages.

    Returns
    -------
    ForeignContact

    Raises
    ------
    InputError
        With the index of the first node or face that is not finite, double, inverted, under pressure below zero or
        deep in the glass; for units that are off; if nothing is in contact.
    """
    n = len(place)
    if place.shape != (n, 2) or pressure.shape != (n,) or gap.shape != (n,):
        raise InputError(
            f"{place.shape}, {pressure.shape}, {gap.shape}", file=source, allowed="as many values as nodes"
        )
    if n < 4:
        raise InputError(f"{n} nodes", file=source, allowed="at least 4")
    for name, values in (("x", place[:, 0]), ("y", place[:, 1]), ("pressure", pressure), ("gap", gap)):
        bad = np.flatnonzero(~np.isfinite(values))
        if bad.size:
            raise InputError(
                f"node {bad[0] + first_index}: {values[bad[0]]}", file=source, key=name, allowed="finite numbers"
            )
    span = float(np.hypot(*(place.max(axis=0) - place.min(axis=0))))
    _check_units(span, pressure, source)
    _check_doubles(place, span, source, first_index)
    _check_signs(pressure, gap, span, source, first_index)
    faces = _triangulated(place, source) if cells is None else _checked_cells(place, cells, source)
    found = ForeignContact(place, np.maximum(pressure, 0.0), np.maximum(gap, 0.0), faces, source)
    if force is not None:
        _check_force(found.force, force, source)
    return found


def _check_units(span: float, pressure: Floats, source: str) -> None:
    low, high = SPAN
    if not low <= span <= high:
        factor = 1000.0 if low <= span * 1000 <= high else 0.001 if low <= span / 1000 <= high else None
        hint = "" if factor is None else f"; times {factor:g} it would fit: is the unit of length off by 1000?"
        raise InputError(f"nodes span {span:.4g} mm{hint}", file=source, key="x, y", allowed=f"{low:g} to {high:g} mm")
    if not (pressure > 0).any():
        index = int(np.argmax(pressure))
        raise InputError(
            f"empty contact: the largest pressure is {pressure[index]:g} MPa at node {index}",
            file=source,
            key="pressure",
            allowed="at least one node above 0",
        )
    peak, (low, high) = float(pressure.max()), PEAK
    if not low <= peak <= high:
        factors = [f for f in (1e-3, 1e-6, 1e3, 1e6) if low <= peak * f <= high]
        hint = f"; times {factors[0]:g} it would fit: is the unit of pressure off?" if factors else ""
        where = int(np.argmax(pressure))
        raise InputError(
            f"peak pressure {peak:.4g} MPa at node {where}{hint}",
            file=source,
            key="pressure",
            allowed=f"{low:g} to {high:g} MPa",
        )


def _check_doubles(place: Floats, span: float, source: str, first_index: int) -> None:
    pairs = cKDTree(place).query_pairs(DOUBLE * span, output_type="ndarray")
    if len(pairs):
        a, b = sorted(pairs[np.lexsort(pairs.T[::-1])][0] + first_index)
        raise InputError(f"nodes {a} and {b} lie at the same place", file=source, key="x, y", allowed="each node once")


def _check_signs(pressure: Floats, gap: Floats, span: float, source: str, first_index: int) -> None:
    below = np.flatnonzero(pressure < -1e-6 * pressure.max())
    if below.size:
        raise InputError(
            f"node {below[0] + first_index}: {pressure[below[0]]:g} MPa",
            file=source,
            key="pressure",
            allowed="0 or more: contact pressure presses",
        )
    deep = np.flatnonzero(gap < -PENETRATION * span)
    if deep.size:
        raise InputError(
            f"node {deep[0] + first_index}: {gap[deep[0]]:g} mm is inside the glass",
            file=source,
            key="gap",
            allowed=f"above {-PENETRATION * span:.3g} mm",
        )
    far = int(np.argmax(gap))
    if gap[far] > 10 * span:
        raise InputError(
            f"node {far + first_index}: {gap[far]:g} mm over nodes that span {span:.4g} mm",
            file=source,
            key="gap",
            allowed=f"below {10 * span:.3g} mm; is its unit off by 1000?",
        )
    apart = np.flatnonzero((pressure > 0) & (gap > PENETRATION * span))
    if apart.size:
        i = int(apart[0])
        raise InputError(
            f"node {i + first_index} carries {pressure[i]:g} MPa at a gap of {gap[i]:g} mm",
            file=source,
            key="gap",
            allowed="no pressure across a gap",
        )


def _checked_cells(place: Floats, cells: Ints, source: str) -> Ints:
    """Return faces turned counter-clockwise; refuse what is folded over, flat, or turned against its neighbours."""
    outside = np.flatnonzero(((cells < 0) | (cells >= len(place))).any(axis=1))
    if outside.size:
        raise InputError(
            f"face {outside[0]} names a node that does not exist", file=source, allowed=f"0 to {len(place) - 1}"
        )
    p = place[cells]
    ahead, behind = np.roll(p, -1, axis=1) - p, np.roll(p, 1, axis=1) - p
    turn = ahead[..., 0] * behind[..., 1] - ahead[..., 1] * behind[..., 0]
    sense = 1.0 if np.sum(np.sign(turn.sum(axis=1))) >= 0 else -1.0
    bad = np.flatnonzero((turn * sense <= 0).any(axis=1))
    if bad.size:
        raise InputError(
            f"face {bad[0]} (nodes {', '.join(map(str, cells[bad[0]]))}) is inverted or flat",
            file=source,
            key="cells",
            allowed="faces all turned the same way",
        )
    return cells if sense > 0 else cells[:, ::-1]


def _triangulated(place: Floats, source: str) -> Ints:
    try:
        cells = Delaunay(place).simplices.astype(np.int64)
    except QhullError:
        raise InputError("nodes lie on one line", file=source, key="x, y", allowed="an area of nodes") from None
    a, b = place[cells[:, 1]] - place[cells[:, 0]], place[cells[:, 2]] - place[cells[:, 0]]
    area = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    kept = np.abs(area) > 1e-9 * np.abs(area).max()  # slivers on the border of the hull
    return np.where(area[kept, None] < 0, cells[kept, ::-1], cells[kept])


def _check_force(found: float, stated: float, source: str) -> None:
    if not np.isfinite(stated) or stated <= 0:
        raise InputError(f"{stated!r}", key="force", allowed="above 0, finite [N]")
    if abs(found - stated) > FORCE_TOLERANCE * stated:
        raise InputError(
            f"pressures add up to {found:.4g} N, not {stated:g} N ({found / stated:.4g} times)",
            file=source,
            key="pressure",
            allowed=f"within {FORCE_TOLERANCE:.0%}; a wrong unit or half a model?",
        )


def read_foreign(
    path: Path,
    *,
    force: float | None = None,
    names: Mapping[str, str] | None = None,
    length_unit_mm: float = 1.0,
    pressure_unit_MPa: float = 1.0,
) -> ForeignContact:
    """Read a contact from a CSV with headings (``x_mm, y_mm, pressure_MPa, gap_mm``; any unit) or from a VTK file.

    Parameters
    ----------
    path : Path
        ``.csv`` or ``.txt``; otherwise whatever meshio reads.
    force : float, optional
        What the pressure should add up to [N]; checked.
    names : mapping, optional
        Names of VTK point data: ``{"pressure": ..., "gap": ...}``.
    length_unit_mm, pressure_unit_MPa : float
        Of a VTK file, which does not say its units.

    Returns
    -------
    ForeignContact

    Raises
    ------
    InputError
        See :func:`check_contact`.
    """
    if path.suffix.lower() in (".csv", ".txt", ".tsv"):
        data = read_columns(path, COLUMNS)
        place = np.column_stack([data["x"], data["y"]])
        # rows of the file: the heading is row 1
        return check_contact(place, data["pressure"], data["gap"], source=str(path), force=force, first_index=2)
    return _read_vtk(path, force, dict(names or {}), length_unit_mm, pressure_unit_MPa)


def _read_vtk(path: Path, force: float | None, names: dict[str, str], length: float, stress: float) -> ForeignContact:
    if not path.is_file():
        raise InputError("no such file", file=path, allowed="a CSV or VTK file")
    require("fem", "reading VTK", "meshio")
    import meshio

    said = io.StringIO()
    try:
        with redirect_stdout(said), redirect_stderr(said):
            mesh = meshio.read(path)
    except (Exception, SystemExit) as error:  # its readers raise whatever their formats do; some print and exit
        why = " ".join(said.getvalue().split()) if isinstance(error, SystemExit) else str(error)
        raise InputError(f"not readable: {why}", file=path, allowed="a CSV or a mesh file of meshio") from None
    fields = {key: np.asarray(values, dtype=float) for key, values in mesh.point_data.items() if np.ndim(values) == 1}
    wanted = {}
    for key, usual in (
        ("pressure", ("pressure_MPa", "pressure", "CONTPRES", "CPRESS")),
        ("gap", ("gap_mm", "gap", "COPEN")),
    ):
        name = names.get(key) or next((u for u in usual if u in fields), "")
        if name not in fields:
            raise InputError(
                f"no point data {name or key!r}", file=path, key=key, allowed=", ".join(fields) or "point data"
            )
        wanted[key] = fields[name]
    shells = [b.data for b in mesh.cells if b.type in ("triangle", "quad")]
    if len(shells) != 1:
        raise InputError(
            f"{len(shells)} blocks of triangles or quadrilaterals",
            file=path,
            key="cells",
            allowed="one: the skin that faces the glass",
        )
    used = np.unique(shells[0])
    number = np.full(len(mesh.points), -1, dtype=np.int64)
    number[used] = np.arange(used.size)
    return check_contact(
        mesh.points[used, :2] * length,
        wanted["pressure"][used] * stress,
        wanted["gap"][used] * length,
        number[shells[0]],
        source=str(path),
        force=force,
    )


def summary(contact: ForeignContact) -> dict[str, Any]:
    """Return counts, force, area, peak pressure and largest gap of an imported contact.

    Parameters
    ----------
    contact : ForeignContact

    Returns
    -------
    dict
    """
    print_ = contact.footprint()
    return {
        "nodes": len(contact.place),
        "faces": len(contact.faces),
        "normal_force_N": contact.force,
        "area_mm2": print_.area,
        "peak_pressure_MPa": float(contact.pressure.max()),
        "largest_gap_mm": float(contact.gap.max()),
    }
