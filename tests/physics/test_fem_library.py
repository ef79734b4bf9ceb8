"""The library of presses: laws it must obey, interpolation against forces left out, and a new solution."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from evanesce.contact.fem.library import FOLDER, library_names, library_press, library_state
from evanesce.core.errors import InputError
from evanesce.core.states import PlateGrid

PRESSES = [(m, b) for m in ("silskin_0", "silskin_20") for b in ("none", "half")]
GRID = PlateGrid((230, 240), 0.07, (0.4, -0.2))


def test_the_library_is_whole_and_small() -> None:
    assert library_names() == tuple(sorted(f"{m}_{b}" for m, b in PRESSES))
    assert sum(path.stat().st_size for path in FOLDER.glob("*.npz")) < 4e6


@pytest.mark.parametrize(("material", "bone"), PRESSES)
def test_area_and_depth_rise_with_force_and_a_bone_stiffens(material: str, bone: str) -> None:
    press = library_press(material, bone)
    assert press.force[0] <= 0.5
    assert press.force[-1] == pytest.approx(5.0)
    assert (np.diff(press.depth) > 0).all()
    assert (np.diff(press.contact_radius) > 0).all()
    if bone == "half":
        assert (press.depth < library_press(material, "none").depth).all()


@pytest.mark.parametrize(("material", "bone"), PRESSES)
def test_stored_pressure_carries_the_stored_force(material: str, bone: str) -> None:
    """Integrated here by Simpson's rule on p^2, straight between nodes; the file holds nodal forces over areas."""
    press = library_press(material, bone)
    for i, force in enumerate(press.force):
        a = press.contact_radius[i]
        r, p = press.profiles["r"][i].astype(float), press.profiles["pressure"][i].astype(float)
        inside = np.flatnonzero(p > 0)[:-1]
        knots, squares = np.append(r[inside], a), np.append(p[inside] ** 2, 0.0)
        fine = np.linspace(0, a, 4001)
        line_force = 2 * np.pi * fine * np.sqrt(np.interp(fine, knots, squares))
        h = fine[1]
        carried = h / 3 * (line_force[0] + 4 * line_force[1::2].sum() + 2 * line_force[2:-1:2].sum() + line_force[-1])
        # the edge lies within a quarter of an element of 0.06 mm, and carries p there
        assert carried == pytest.approx(force, rel=3 * 0.25 * 0.06 / a + 0.005)


@pytest.mark.parametrize(("material", "bone"), PRESSES)
def test_a_force_left_out_is_found_again_by_interpolation(material: str, bone: str) -> None:
    whole = library_press(material, bone)
    for drop in (4, 9):
        kept = np.delete(np.arange(whole.force.size), drop)
        thinned = replace(
            whole,
            force=whole.force[kept],
            depth=whole.depth[kept],
            contact_radius=whole.contact_radius[kept],
            profiles={key: values[kept] for key, values in whole.profiles.items()},
        )
        force = float(whole.force[drop])
        found, known = thinned.at(force), whole.at(force)
        # log-log curvature times the square of a gap twice as wide as the library's own, 0.7 in log force, over 8;
        # and the edge's place on its mesh, a quarter of 0.06 mm
        assert found.contact_radius == pytest.approx(
            known.contact_radius, rel=0.01 + 0.25 * 0.06 / known.contact_radius
        )
        assert found.depth == pytest.approx(known.depth, rel=0.01)
        r = np.linspace(0.1, 0.8, 8) * known.contact_radius
        inner = [np.interp(r, p.r, p.pressure) for p in (found, known)]
        np.testing.assert_allclose(inner[0], inner[1], rtol=0.03)


@pytest.mark.parametrize(("material", "bone"), PRESSES)
@pytest.mark.parametrize("force", [0.5, 0.83, 3.7])
def test_states_on_a_grid(material: str, bone: str, force: float) -> None:
    centre = (0.9, -0.6)
    state = library_state(material, force, GRID, centre=centre, bone=bone)
    cell = GRID.pitch**2
    assert state.contact_mask.sum() * cell == pytest.approx(state.nominal_contact_area, rel=1e-9)
    assert state.pressure.sum() * cell == pytest.approx(force, rel=5e-3)  # annuli placed on squares
    assert (state.gap[state.contact_mask == 0] > 0).all()
    assert (state.gap[state.contact_mask == 1] == 0).all()
    assert state.normal_force == force
    area = np.pi * library_press(material, bone).at(force).contact_radius ** 2
    assert state.nominal_contact_area == pytest.approx(area)


def test_between_forces_the_area_rises_without_jumps() -> None:
    press = library_press("silskin_20", "none")
    forces = np.geomspace(0.2, 4.9, 60)
    areas = [press.area(float(f)) for f in forces]
    for low, high in pairwise(areas):
        assert low < high < 1.1 * low


def test_what_the_library_does_not_hold_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="silskin_0_none"):
        library_state("silastic_0", 1.0, GRID)
    with pytest.raises(InputError, match="N in the library"):
        library_state("silskin_0", 7.0, GRID)
    with pytest.raises(InputError, match="does not fit"):
        library_state("silskin_0", 2.0, PlateGrid((20, 20), 0.1))
    (tmp_path / "silskin_0_none.npz").write_bytes(b"PK\x03\x04 no")
    with pytest.raises(InputError, match="damaged"):
        library_press("silskin_0", "none", tmp_path)


def test_reading_needs_no_finite_element_library() -> None:
    script = (
        "import sys\n"
        "for name in ('felupe', 'pypardiso', 'meshio'): sys.modules[name] = None\n"
        "from evanesce.contact.fem.library import library_state\n"
        "from evanesce.core.states import PlateGrid\n"
        "print(library_state('silskin_0', 1.0, PlateGrid((120, 120), 0.1)).nominal_contact_area)\n"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=60, check=True)
    assert float(done.stdout) == pytest.approx(np.pi * library_press("silskin_0").at(1.0).contact_radius ** 2)


@pytest.mark.slow
@pytest.mark.parametrize("material", ["silskin_0", "silskin_20"])
def test_a_fresh_solution_on_another_mesh_agrees(material: str) -> None:
    pytest.importorskip("felupe", reason="the optional extra 'fem' is not installed")
    from evanesce.contact.fem.material import rubber
    from evanesce.contact.fem.mesh import FingerShape, MeshSize
    from evanesce.contact.fem.programme import press

    friction = library_press(material).inputs["glass"]["friction"]
    size = MeshSize(contact=0.2)
    run = press(FingerShape(), rubber(material), forces=(1.0,), friction=friction, size=size)
    kept = library_press(material)
    assert run.row(-1)["depth_mm"] == pytest.approx(kept.at(1.0).depth, rel=5e-3)
    radius = kept.at(1.0).contact_radius
    assert np.sqrt(run.row(-1)["area_mm2"] / np.pi) == pytest.approx(radius, abs=0.25 * (0.2 + 0.06))


def test_only_one_file_knows_the_finite_element_library() -> None:
    source = FOLDER.parent
    naming = {
        path.name for path in source.glob("*.py") if "felupe" in path.read_text(encoding="utf-8").split('"""')[-1]
    }
    assert naming <= {"felupe_adapter.py", "runs.py"}  # runs.py imports the adapter, when there is something to solve
    assert 'import_module("felupe")' in (source / "felupe_adapter.py").read_text(encoding="utf-8")
