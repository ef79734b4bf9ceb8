"""Registry, rows that survive a kill, the page, and the threshold slider in a real browser."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from evanesce.chain.simulate import solve_contact
from evanesce.cli.app import app
from evanesce.core import provenance
from evanesce.evaluation.perfect_view import PerfectView
from evanesce.measurement.reference.segment import Chain, segment
from evanesce.report.charts import CaptionedImage, Chart, Panel, Series
from evanesce.report.html import Table, write
from evanesce.rig import Scene, load_scene
from evanesce.studies.estimator import study as estimator_study
from evanesce.studies.ledger import Ledger
from evanesce.studies.page import page
from evanesce.studies.registry import Findings, Progress, Study, studies
from evanesce.studies.threshold.slider import SliderFrame, slider
from support.tiny import TINY

CHROMIUM = next((found for name in ("chromium", "chromium-browser", "google-chrome", "chrome")
                 if (found := shutil.which(name))), None)  # fmt: skip


def test_every_part_is_found_once_in_order_and_has_its_command() -> None:
    found = studies()
    names = [study.name for study in found]
    assert {"threshold", "time", "thesis"} <= set(names)
    assert len(set(names)) == len(names)
    assert [study.order for study in found] == sorted(study.order for study in found)
    listed = CliRunner().invoke(app, ["study", "--help"]).output
    assert all(re.search(rf"\b{name}\b", listed) for name in ("all", "threshold", "time", "thesis"))


def test_rows_survive_a_kill_in_the_middle_of_a_line(tmp_path: Path) -> None:
    path, calls = tmp_path / "rows.jsonl", []

    def make(value: float) -> dict[str, object]:
        calls.append(value)
        return {"area": np.float64(value), "lost": float("nan"), "pair": (np.int64(3), [np.inf])}

    ledger = Ledger(path, {"scene": 1})
    first = ledger.row("a", lambda: make(1.25))
    ledger.row("b", lambda: make(2.5))
    assert first == {"area": 1.25, "lost": None, "pair": [3, [None]]}
    path.write_text(path.read_text(encoding="utf-8")[:-17], encoding="utf-8")
    again = Ledger(path, {"scene": 1})
    assert "a" in again
    assert "b" not in again
    assert again.row("a", lambda: make(0.0)) == first
    again.row("b", lambda: make(2.5))
    assert calls == [1.25, 2.5, 2.5]
    assert len([json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]) == 3


def test_rows_of_another_scene_are_not_taken(tmp_path: Path) -> None:
    path = tmp_path / "rows.jsonl"
    Ledger(path, {"scene": 1}).row("a", lambda: {"x": 1})
    assert "a" not in Ledger(path, {"scene": 2})
    assert "a" not in Ledger(path, {"scene": 1})


def test_rows_of_other_source_code_are_not_taken(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Rows of a ledger and of the estimator's study go with the code that made them."""
    path, study = tmp_path / "rows.jsonl", tmp_path / "study.jsonl"
    row = estimator_study.Row(
        finger="smooth", place="centre", force_N=1.0, voltage_V=8.5, true_mm2=3.1, reference_mm2=3.2, refined_mm2=3.0,
        saturated_share=0.0,
    )  # fmt: skip
    pressed: list[str] = []

    def rows_of(name: str, place: str, *args: object, **options: object) -> list[estimator_study.Row]:
        pressed.append(place)
        return [replace(row, finger=name, place=place)]

    monkeypatch.setattr(estimator_study, "rows_of", rows_of)
    scene, counts = load_scene("thesis", TINY), []
    for digest in ("one", "one", "other"):
        monkeypatch.setattr(provenance, "code_digest", lambda digest=digest: digest)
        kept = "a" in Ledger(path, {"scene": 1})
        Ledger(path, {"scene": 1}).row("a", lambda: {"x": 1})
        options = {"voltages": (8.5,), "forces": (1.0,), "fingers": ("smooth",), "keep": Ledger(study, "all").row}
        estimator_study.run_study(scene, scene, **options)
        counts.append((kept, len(pressed)))
    assert counts == [(False, 2), (True, 2), (False, 4)]


def test_a_view_without_calibration_error_sees_the_true_area() -> None:
    scene = load_scene("thesis")
    finger = scene.finger.model_copy(update={"position_mm": (5.2, -3.1)})
    scene = scene.model_copy(update={"finger": finger})
    view = PerfectView.of(scene)
    _, state = solve_contact(scene, 2.0, seed=3)
    assert state is not None
    crop = view.window(5.0)
    labels = view.labels(state, crop)
    rows, cols = np.nonzero(labels.mask >= 0.5)
    row, col = view.to_view(5.2, -3.1)
    # a round contact is centred on the tip; perspective through glass moves its middle by far less than a pixel
    assert rows.mean() + crop.r0 == pytest.approx(row, abs=0.5)
    assert cols.mean() + crop.c0 == pytest.approx(col, abs=0.5)
    assert labels.mask.sum() * view.mm2_per_px == pytest.approx(state.nominal_contact_area, rel=2e-3)


def drawn_frame(k: int = 0) -> SliderFrame:
    """Return a patch with a dim rim, noise, a speck that stays and one that goes."""
    y, x = np.mgrid[:181, :233]
    r = np.hypot((x - 101.4) / 1.2, y - 77.7)
    level = 20 + 130 / (1 + np.exp((r - 41 - 3 * k) / 6)) + np.random.default_rng(k).normal(0, 4, r.shape)
    level[150:156, 200:206] = 180  # dilated by 10 px: below 2000 px
    level[2:40, 190:230] = 120
    image = np.clip(np.rint(level), 0, 255).astype(np.uint8)
    truth = np.where(r < 41, 255, 0).astype(np.uint8)
    return SliderFrame(
        f"patch </script> {k}", image, truth, 21.3, 0.0037, Chain(threshold=0.3), ((0.1, 80.0), (0.5, -9.0))
    )


def findings() -> Findings:
    series = Series(label="a", x=[1, 2, 4], y=[3.0, 4.0, None], low=[2, 3, 3], high=[4, 5, 6])  # type: ignore[list-item]
    panel = Panel(title="t", x_label="x [mm]", y_label="y [%]", series=[series, series], log_x=True, y_range=(0, 9))
    return Findings(
        verdict=["It errs by <7 %."],
        charts=[Chart(panels=[panel], caption="Rises.")],
        pictures=[CaptionedImage(image=np.zeros((9, 7), np.uint8), caption="Dark.")],
        tables=[Table(columns=("a", "b [mm]"), rows=[("x", "1")], caption="Of numbers.")],
    )


def test_page_has_figures_first_tables_below_and_needs_no_other_file() -> None:
    part = Study("x", "Some part", 1, lambda *_, **__: findings())
    text = page("T", [(part, findings()), (part, findings())], {"seed": 7}, slider([drawn_frame()])).render()
    assert "It errs by &lt;7 %." in text
    assert text.index("slider-picture") < text.index("Rises.") < text.rindex("Rises.") < text.index("Of numbers.")
    assert text.rindex("Of numbers.") < text.index("Provenance")
    assert not re.search(r"<[a-z]+[^>]*\s(?:src|href)=[\"']?(?!\"?data:)", text)
    assert "http" not in re.sub(r"data:[^\"]*", "", text)
    # a title cannot end the script element that holds the data
    assert "patch </script>" not in text


@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium is installed")
@pytest.mark.system
@pytest.mark.parametrize(("frame", "threshold"), [(0, 0.3), (1, 0.1425), (0, 0.65)])
def test_slider_counts_what_the_chain_counts_in_a_real_browser(tmp_path: Path, frame: int, threshold: float) -> None:
    frames = [drawn_frame(0), drawn_frame(1)]
    path = write(tmp_path / "page.html", page("T", [], {}, slider(frames)))
    assert CHROMIUM is not None
    shown = subprocess.run(
        [CHROMIUM, "--headless", "--no-sandbox", "--disable-gpu", f"--user-data-dir={tmp_path / 'profile'}",
         "--virtual-time-budget=20000", "--dump-dom", f"{path.as_uri()}#frame={frame}&threshold={threshold}"],
        capture_output=True, text=True, timeout=120, check=True,
    ).stdout  # fmt: skip
    result = re.search(r'<output id="slider-result"([^>]*)>([^<]*)<', shown)
    assert result is not None
    expected = segment(frames[frame].image, Chain(threshold=threshold))
    assert expected.pixels < np.count_nonzero(frames[frame].image)
    assert threshold < 0.6 or expected.pixels == 0
    assert f'data-pixels="{expected.pixels}"' in result[1]
    error = 100 * (expected.pixels * 0.0037 / 21.3 - 1)
    sign = "+" if error >= 0 else "−"
    assert result[2] == f"measured {expected.pixels * 0.0037:.2f} mm², true 21.30 mm²: {sign}{abs(error):.1f} %"


def test_all_writes_report_results_and_figures(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The parts and frames are drawn; what becomes of them is the command's own."""
    seen: list[tuple[str, bool, int]] = []

    def work(scene: Scene, out: Path, progress: Progress, *, quick: bool, seed: int) -> Findings:
        progress("rows", 1, 2)
        seen.append((scene.title, quick, seed))
        return replace(findings(), data={"area_mm2": [1.5, float("nan")]})

    monkeypatch.setattr("evanesce.studies.registry.studies", lambda: [Study("drawn", "Drawn part", 1, work)])
    monkeypatch.setattr("evanesce.studies.threshold.slider.slider_frames", lambda scene, seed: [drawn_frame()])
    out = tmp_path / "out"
    done = CliRunner().invoke(app, ["study", "all", "thesis", "--quick", "--seed", "9", "--out", str(out)])
    assert done.exit_code == 0, done.output
    assert seen == [(load_scene("thesis").title, True, 9)]
    assert {p.name for p in out.iterdir()} == {"report.html", "result.json", "drawn-1.png", "drawn-2.png"}
    result = json.loads((out / "result.json").read_text(encoding="utf-8"))
    assert result["drawn"] == {"verdict": ["It errs by <7 %."], "area_mm2": [1.5, None]}
    assert set(result["provenance"]["seconds"]) == {"drawn", "slider"}
    text = (out / "report.html").read_text(encoding="utf-8")
    assert "slider-picture" in text
    assert "quick: fewer forces and speeds" in text


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["study", "all", "thesis", "--only", "voltge"], "--only"),
        (["study", "threshold", "thesis_slide"], "slide"),
        (["study", "time", "nowhere.toml"], "nowhere.toml"),
    ],
)
def test_bad_input_is_one_line_and_writes_nothing(tmp_path: Path, arguments: list[str], named: str) -> None:
    done = CliRunner().invoke(app, [*arguments, "--out", str(tmp_path / "out")])
    assert done.exit_code == 2
    assert named in done.output + done.stderr
    assert not (tmp_path / "out").exists()
