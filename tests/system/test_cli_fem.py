"""``evanesce fem`` end to end on coarse meshes: figures, files, exit codes, one-line errors."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import typer
from typer.testing import CliRunner, Result

from evanesce.cli import fem as command
from evanesce.contact.fem.result import load_run

FINGER = ["--tip-radius-mm", "6.8", "--diameter-mm", "12.6", "--length-mm", "14"]


@pytest.fixture
def fem(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):  # type: ignore[no-untyped-def]
    monkeypatch.setenv("EVANESCE_CACHE", str(tmp_path / "cache"))
    app = typer.Typer()
    command.register(app)

    @app.callback()
    def _root() -> None: ...

    def call(*arguments: str) -> Result:
        return CliRunner().invoke(app, ["fem", *arguments])

    return call


@pytest.mark.system
def test_press_writes_what_it_prints(fem, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    pytest.importorskip("felupe", reason="the optional extra 'fem' is not installed")
    out, report = tmp_path / "out", tmp_path / "r.json"
    arguments = ["press", *FINGER, "--force-N", "0.3", "--force-N", "0.6", "--element-mm", "0.8", "--vtk"]
    result = fem(*arguments, "--out", str(out), "--json", str(report))
    assert result.exit_code == 0, result.output
    data = json.loads(report.read_text(encoding="utf-8"))
    reached = [row for row in data["steps"] if abs(row["normal_force_N"] - 0.6) < 1e-6]
    assert len(reached) == 1
    assert data["is_thesis_material"]
    assert data["limit"] == ""
    run = load_run(out / "press.npz")
    assert run.row(-1)["area_mm2"] == pytest.approx(reached[0]["area_mm2"])
    assert (out / "press.vtu").is_file()
    assert list((tmp_path / "cache" / "fem").glob("*.npz"))


@pytest.mark.system
def test_press_that_meets_its_limit_keeps_the_steps_and_fails(fem, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    pytest.importorskip("felupe", reason="the optional extra 'fem' is not installed")
    out = tmp_path / "out"
    result = fem("press", *FINGER, "--depth-mm", "12.9", "--element-mm", "2.5", "--no-cache", "--out", str(out))
    assert result.exit_code == 1
    assert "limit reached" in result.stderr
    assert "Traceback" not in result.stderr
    data = json.loads((out / "press.json").read_text(encoding="utf-8"))
    assert len(data["steps"]) > 3
    assert "limit reached" in data["limit"]


@pytest.mark.system
def test_slide_reports_stick_against_the_way(fem, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    pytest.importorskip("felupe", reason="the optional extra 'fem' is not installed")
    out = tmp_path / "out"
    arguments = [
        "--depth-mm",
        "0.7",
        "--distance-mm",
        "0.5",
        "--friction",
        "0.3",
        "--element-mm",
        "2",
        "--hold",
        "depth",
    ]
    result = fem("slide", *FINGER, *arguments, "--out", str(out))
    assert result.exit_code == 0, result.output
    steps = json.loads((out / "slide.json").read_text(encoding="utf-8"))["steps"]
    assert steps[-1]["slide_mm"] == pytest.approx(0.5)
    assert 0 < steps[-1]["tangential_force_N"] <= 0.3 * steps[-1]["normal_force_N"] * (1 + 1e-6)


@pytest.mark.system
def test_a_material_that_is_carried_on_is_told(fem, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    pytest.importorskip("felupe", reason="the optional extra 'fem' is not installed")
    out = tmp_path / "out"
    cases = (("silskin_0", "stiffened from I1 - 3 =", False), ("silskin_20", "nothing to carry on", True))
    for material, told, published in cases:
        arguments = ["--material", material, "--depth-mm", "0.3", "--element-mm", "2.5", "--no-cache", "--carry-on"]
        result = fem("press", *FINGER, *arguments, "--out", str(out))
        assert result.exit_code == 0, result.output
        assert told in " ".join(result.stderr.split())
        report = json.loads((out / "press.json").read_text(encoding="utf-8"))
        assert report["is_thesis_material"] is published


@pytest.mark.system
def test_convergence_plots_and_names_the_size(fem, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    pytest.importorskip("felupe", reason="the optional extra 'fem' is not installed")
    out = tmp_path / "out"
    sizes = [a for size in ("2.5", "1.2", "0.8") for a in ("--element-mm", size)]
    result = fem("convergence", *FINGER, "--force-N", "0.5", *sizes, "--out", str(out))
    assert result.exit_code == 0, result.output
    data = json.loads((out / "convergence.json").read_text(encoding="utf-8"))
    assert [m["element_size_mm"] for m in data["meshes"]] == [2.5, 1.2, 0.8]
    assert data["meshes"][-1]["area_deviation"] == 0
    assert (out / "convergence.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.system
def test_import_writes_a_contact_and_refuses_a_fault(fem, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    x, y = (values.ravel() for values in np.meshgrid(np.linspace(-4, 4, 25), np.linspace(-3.5, 4.2, 27)))
    r = np.hypot(x - 0.4, y + 0.2) / 2.1
    pressure, gap = 0.11 * np.sqrt(np.maximum(1 - r**2, 0)), 0.4 * np.maximum(r - 1, 0) ** 1.5
    table = np.column_stack([x, y, pressure, gap])
    file = tmp_path / "ansys.csv"
    np.savetxt(file, table, delimiter=",", header="x_mm,y_mm,pressure_MPa,gap_mm", comments="")
    result = fem("import", str(file), "--out", str(tmp_path / "out"))
    assert result.exit_code == 0, result.output
    data = json.loads((tmp_path / "out" / "import.json").read_text(encoding="utf-8"))
    # edge continued over a quarter of an element of 0.34 mm
    assert data["area_mm2"] == pytest.approx(np.pi * 2.1**2, rel=2 * 0.25 * 0.34 / 2.1)
    with np.load(tmp_path / "out" / "contact.npz") as contact:
        assert contact["pressure_MPa"].shape == (data["rows"], data["cols"])
    table[11, 2] = np.nan
    np.savetxt(file, table, delimiter=",", header="x_mm,y_mm,pressure_MPa,gap_mm", comments="")
    result = fem("import", str(file), "--out", str(tmp_path / "out"))
    assert result.exit_code == 2
    assert "row 13" in result.stderr
    assert len(result.stderr.strip().splitlines()) == 1


@pytest.mark.system
@pytest.mark.parametrize(
    "arguments",
    [
        ["press", "--material", "silastic_0"],
        ["press", "--force-N", "-1"],
        ["press", "--bone-radius-mm", "7.4"],
        ["press", "--c30-MPa", "-1"],
        ["slide", "--hold", "hand"],
        ["convergence", "--element-mm", "1"],
        ["import", "nowhere.csv"],
    ],
)
def test_bad_input_is_one_line_and_code_two(fem, arguments: list[str], tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    result = fem(*arguments, "--out", str(tmp_path / "out"))
    assert result.exit_code == 2
    assert result.stderr.startswith("error: ")
    assert "Traceback" not in result.output
