"""Foreign finite-element results: a Hertz contact read back whole, and every fault refused with its index."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from evanesce.contact.fem.importer import ForeignContact, check_contact, read_foreign
from evanesce.core.errors import InputError
from evanesce.core.states import PlateGrid

A, RADIUS, FORCE = 2.37, 7.5, 1.3  # [mm], [mm], [N]
CENTRE = np.array([0.6, -0.35])


def _hertz(place: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    r = np.hypot(*(place - CENTRE).T) / A
    pressure = 1.5 * FORCE / (np.pi * A**2) * np.sqrt(np.maximum(1 - r**2, 0))
    s = np.maximum(r, 1)
    gap = A**2 / (np.pi * RADIUS) * (np.sqrt(s**2 - 1) + (s**2 - 2) * np.arccos(1 / s))
    return pressure, np.where(r > 1, gap, 0.0)


def _nodes(n: int = 33) -> np.ndarray:
    """A skewed, unevenly spaced patch, so that rows, columns and symmetry cannot hide a mistake."""
    u = np.linspace(-1, 1, n)
    x, y = np.meshgrid(u + 0.08 * u**3, u, indexing="ij")
    return np.column_stack([(4.4 * x + 0.5 * y).ravel() + 0.5, (4.1 * y).ravel() - 0.3])


def _quads(n: int = 33) -> np.ndarray:
    index = np.arange(n * n).reshape(n, n)
    return np.stack([index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]], axis=-1).reshape(-1, 4)


def _contact(cells: bool = True) -> ForeignContact:
    place = _nodes()
    return check_contact(place, *_hertz(place), _quads() if cells else None, source="hertz")


@pytest.mark.parametrize("cells", [True, False], ids=["cells", "triangulated"])
def test_hertz_comes_back_with_its_area_and_force(cells: bool) -> None:
    contact = _contact(cells)
    h = 4.4 * 2 / 32 * 1.24  # widest spacing
    # the edge is continued over part of an element: a quarter of it; the pressure's square root is cut by chords
    assert contact.footprint().area == pytest.approx(np.pi * A**2, rel=2 * 0.25 * h / A)
    assert contact.force == pytest.approx(FORCE, rel=(h / A) ** 1.5)


def test_state_of_an_import_lies_where_it_should() -> None:
    grid = PlateGrid((110, 130), 0.07, (0.9, 0.2))
    state = _contact().state(grid, centre=(0.4, 0.15))
    cell = grid.pitch**2
    assert state.pressure.sum() * cell == pytest.approx(state.normal_force, rel=1e-9)
    x, y = np.meshgrid(grid.x, grid.y)
    for axis, values in enumerate((x, y)):
        place = (state.contact_mask * values).sum() / state.contact_mask.sum()
        assert place == pytest.approx(CENTRE[axis] + (0.4, 0.15)[axis], abs=0.02)
    middle = grid.index(np.array(CENTRE[0] + 0.4), np.array(CENTRE[1] + 0.15))
    peak = state.pressure[round(float(middle[0])), round(float(middle[1]))]
    assert peak == pytest.approx(1.5 * FORCE / (np.pi * A**2), rel=0.03)
    assert (state.gap[state.contact_mask == 0] > 0).all()


def _spoil(change: Callable[[np.ndarray, np.ndarray, np.ndarray, np.ndarray], None]) -> None:
    place = _nodes()
    pressure, gap = _hertz(place)
    cells = _quads()
    change(place, pressure, gap, cells)
    check_contact(place, pressure, gap, cells, source="foreign.csv", force=FORCE)


def _nan(place: np.ndarray, pressure: np.ndarray, gap: np.ndarray, cells: np.ndarray) -> None:
    pressure[417] = np.nan


def _double(place: np.ndarray, pressure: np.ndarray, gap: np.ndarray, cells: np.ndarray) -> None:
    place[700] = place[31]


def _inverted(place: np.ndarray, pressure: np.ndarray, gap: np.ndarray, cells: np.ndarray) -> None:
    cells[88] = cells[88, ::-1]


def _folded(place: np.ndarray, pressure: np.ndarray, gap: np.ndarray, cells: np.ndarray) -> None:
    cells[90, [0, 1]] = cells[90, [1, 0]]


def _metres(place: np.ndarray, pressure: np.ndarray, gap: np.ndarray, cells: np.ndarray) -> None:
    place *= 1e-3
    gap *= 1e-3


def _kilopascal(place: np.ndarray, pressure: np.ndarray, gap: np.ndarray, cells: np.ndarray) -> None:
    pressure *= 1e3


def _empty(place: np.ndarray, pressure: np.ndarray, gap: np.ndarray, cells: np.ndarray) -> None:
    pressure[:] = 0


def _pulling(place: np.ndarray, pressure: np.ndarray, gap: np.ndarray, cells: np.ndarray) -> None:
    pressure[55] = -0.02


def _deep(place: np.ndarray, pressure: np.ndarray, gap: np.ndarray, cells: np.ndarray) -> None:
    gap[600] = -0.8


def _apart(place: np.ndarray, pressure: np.ndarray, gap: np.ndarray, cells: np.ndarray) -> None:
    gap[544] = 0.7


def _half(place: np.ndarray, pressure: np.ndarray, gap: np.ndarray, cells: np.ndarray) -> None:
    pressure *= 0.5


def _beyond(place: np.ndarray, pressure: np.ndarray, gap: np.ndarray, cells: np.ndarray) -> None:
    cells[12, 2] = 5000


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (_nan, "node 417: nan"),
        (_double, "nodes 31 and 700"),
        (_inverted, "face 88"),
        (_folded, "face 90"),
        (_metres, "times 1000 it would fit"),
        (_kilopascal, "times 0.001 it would fit"),
        (_empty, "empty contact"),
        (_pulling, "node 55: -0.02 MPa"),
        (_deep, "node 600"),
        (_apart, "node 544"),
        (_half, "add up to"),
        (_beyond, "face 12"),
    ],
)
def test_faults_are_refused_with_their_index(change: Callable[..., None], says: str) -> None:
    with pytest.raises(InputError, match=says) as caught:
        _spoil(change)
    assert "foreign.csv" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_sound_contact_passes_the_same_check() -> None:
    _spoil(lambda place, pressure, gap, cells: None)


def test_cells_all_clockwise_are_turned() -> None:
    place = _nodes()
    contact = check_contact(place, *_hertz(place), _quads()[:, ::-1], source="x")
    assert contact.force == pytest.approx(_contact().force, rel=1e-12)


def _csv(path: Path, unit: str = "mm", scale: float = 1.0) -> Path:
    place = _nodes()
    pressure, gap = _hertz(place)
    rows = [
        f"{x * scale:.9g};{y * scale:.9g};{p * 1e3:.9g};{g * scale:.9g}"
        for (x, y), p, g in zip(place, pressure, gap, strict=True)
    ]
    path.write_text(f"x [{unit}];y [{unit}];CONTPRES [kPa];gap [{unit}]\n" + "\n".join(rows) + "\n", encoding="utf-8")
    return path


@pytest.mark.parametrize(("unit", "scale"), [("mm", 1.0), ("m", 1e-3), ("um", 1e3)])
def test_csv_is_read_in_the_units_of_its_headings(tmp_path: Path, unit: str, scale: float) -> None:
    contact = read_foreign(_csv(tmp_path / "a.csv", unit, scale), force=FORCE)
    assert contact.force == pytest.approx(_contact(False).force, rel=1e-6)


def test_csv_with_units_off_by_a_thousand_or_without_a_column_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="off by 1000"):
        read_foreign(_csv(tmp_path / "a.csv", "mm", 1e-3))
    (tmp_path / "b.csv").write_text("x_mm,y_mm,pressure_MPa\n0,0,1\n", encoding="utf-8")
    with pytest.raises(InputError, match="no column 'gap'"):
        read_foreign(tmp_path / "b.csv")
    with pytest.raises(InputError, match="no such file"):
        read_foreign(tmp_path / "c.vtu")


def test_vtk_is_read_and_rubbish_refused(tmp_path: Path) -> None:
    meshio = pytest.importorskip("meshio")
    place = _nodes()
    pressure, gap = _hertz(place)
    data = {"CONTPRES": pressure * 1e6, "COPEN": gap * 1e-3}
    points = np.column_stack([place * 1e-3, np.zeros(len(place))])
    meshio.Mesh(points, [("quad", _quads())], point_data=data).write(tmp_path / "a.vtu")
    contact = read_foreign(tmp_path / "a.vtu", length_unit_mm=1e3, pressure_unit_MPa=1e-6, force=FORCE)
    assert contact.force == pytest.approx(_contact().force, rel=1e-9)
    with pytest.raises(InputError, match="no point data"):
        read_foreign(tmp_path / "a.vtu", names={"pressure": "nothing"})
    (tmp_path / "b.vtu").write_text("<VTKFile", encoding="utf-8")
    with pytest.raises(InputError, match="not readable"):
        read_foreign(tmp_path / "b.vtu")
