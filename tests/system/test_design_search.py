"""The search: Pareto fronts, constraints with reasons, resumption after a kill, the command line's refusals."""

from __future__ import annotations

import logging
import math
import os
import signal
import sqlite3
import subprocess
import sys
import textwrap
import time
from contextlib import closing
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest
from matplotlib.text import Text
from typer.testing import CliRunner

from evanesce.cli.app import app
from evanesce.cli.design import _client
from evanesce.core.errors import InputError, WorkError
from evanesce.core.provenance import code_digest, digest_of_files
from evanesce.design import assessment, evaluate, measurement, objective, search, sensitivity
from evanesce.design.plots import pareto_figure
from evanesce.design.question import Design, Question
from evanesce.design.question_file import read_question
from evanesce.design.search import Limit, Plan, Trial, pareto, run
from evanesce.design.variables import design_variables
from evanesce.rig import dump_scene, load_scene
from support.rigs import small_rig

pytest.importorskip("optuna", reason="the extra 'design' is not installed")
TESTS = Path(__file__).parents[1]


RANGES = {"plate.thickness_mm": {"low": 2, "high": 9}, "camera.exposure_ms": {"low": 1, "high": 20, "log": True}}


def plan(**changes) -> Plan:
    """Return a search over two keys; areas need no light where evaluate is replaced."""
    scene = small_rig()
    return Plan(
        **{
            "base": Design(scene=scene),
            "question": Question(forces_N=(1.0,), positions_mm=((3.3, -2.1),), materials=("silskin_0",), seed=3),
            "variables": design_variables(RANGES, scene),
            "objectives": ("area_error", "exposure"),
            "trials": 12,
        }
        | changes
    )


def synthetic(job, values):
    """Return figures of a made-up rig: an error that light cures, and glass below 3 mm that cannot be."""
    time.sleep(float(os.environ.get("SYNTHETIC_PAUSE_S", "0")))
    thickness, exposure = values["plate.thickness_mm"], values["camera.exposure_ms"]
    if thickness < 3.0:
        return {"reason": f"no glass of {thickness:g} mm", "seconds": 0.0}
    figures = {name: 1.0 for name in search.OBJECTIVES if name != "cost"}
    error = 10.0 / exposure + (thickness - 5.0) ** 2
    return {"figures": figures | {"area_error": error, "exposure": exposure, "cost": float("nan")},
            "standard_percent": 0.1, "seconds": 0.0}  # fmt: skip


@pytest.fixture
def synthetic_rig(monkeypatch):
    monkeypatch.setattr(search, "evaluate", synthetic)


def test_the_front_is_that_of_all_pairs():
    draws = np.random.default_rng(2).integers(0, 9, size=(60, 2)).astype(float)
    trials = [
        Trial(number=k, values={}, figures={"area_error": a, "field_of_view": b}, reason="no" if k % 7 == 0 else "")
        for k, (a, b) in enumerate(draws)
    ]
    found = {t.number for t in pareto(trials, ("area_error", "field_of_view"))}
    able = [k for k in range(60) if k % 7]
    wanted = set()
    for k in able:  # less error, more field
        better = [j for j in able if draws[j, 0] <= draws[k, 0] and draws[j, 1] >= draws[k, 1]]
        if all(tuple(draws[j]) == tuple(draws[k]) for j in better):
            wanted.add(k)
    assert found <= wanted
    assert {tuple(draws[k]) for k in found} == {tuple(draws[k]) for k in wanted}


@pytest.mark.parametrize("sampler", ["tpe", "nsga2"])
def test_a_search_starts_at_the_scene_and_marks_what_cannot_be(synthetic_rig, tmp_path, sampler):
    wanted = plan(sampler=sampler, trials=14, limits=(Limit("exposure", 15.0),))
    found = run(wanted, tmp_path)
    assert [t.number for t in found] == list(range(14))
    assert found[0].values == {"plate.thickness_mm": 5.0, "camera.exposure_ms": 10.0}
    for t in found:
        assert t.reason == (
            f"no glass of {t.values['plate.thickness_mm']:g} mm" if t.values["plate.thickness_mm"] < 3 else ""
        )
        assert t.violated == (("exposure",) if not t.reason and t.values["camera.exposure_ms"] > 15 else ())
    assert any(t.reason for t in found)
    front = pareto(found, wanted.objectives)
    assert front
    assert all(t.feasible for t in front)
    assert all(t.figures["exposure"] <= 15 for t in front)


def test_tpe_finds_what_a_formula_says(synthetic_rig, tmp_path):
    """Of one objective, 10/t + (d - 5)^2 within 20 ms: smallest at 20 ms and 5 mm, 0.5."""
    wanted = plan(objectives=("area_error",), trials=26)
    best = min(t.figures["area_error"] for t in run(wanted, tmp_path) if t.feasible)
    assert 0.5 <= best < 1.5


def test_more_trials_go_on_and_another_question_is_refused(synthetic_rig, tmp_path):
    first = run(plan(trials=3), tmp_path)
    more = run(plan(trials=5), tmp_path)
    assert len(more) == 5
    assert more[:3] == first
    with pytest.raises(InputError, match="holds another search"):
        run(plan(trials=5, objectives=("area_error", "deflection")), tmp_path)


def test_results_of_other_code_are_not_reused(synthetic_rig, tmp_path, monkeypatch):
    """One file of the package differs: its search is refused in a line, and what was kept of winners is not read."""
    kept = assessment._ResultStore(plan(), tmp_path)
    kept.put("trial-1/tolerances", {"rows": []})
    run(plan(trials=2), tmp_path)
    assert assessment._ResultStore(plan(), tmp_path).get("trial-1/tolerances") == {"rows": []}
    monkeypatch.setattr(search, "code_digest", lambda: "of another day")
    assert assessment._ResultStore(plan(), tmp_path).get("trial-1/tolerances") is None
    with pytest.raises(InputError, match=r"other code of evanesce \(allowed: a new folder\)"):
        run(plan(trials=3), tmp_path)
    monkeypatch.setattr(search, "code_digest", code_digest)
    assert len(run(plan(trials=3), tmp_path)) == 3


def test_the_codes_digest_is_of_names_and_contents(tmp_path):
    (tmp_path / "a.py").write_text("x = 1\n")
    (tmp_path / "deep").mkdir()
    (tmp_path / "deep" / "b.py").write_text("y = 2\n")

    def found() -> str:
        return digest_of_files(tmp_path, sorted(tmp_path.rglob("*.py")))

    before = found()
    (tmp_path / "deep" / "b.py").write_text("y = 3\n")
    after = found()
    (tmp_path / "a.py").rename(tmp_path / "c.py")
    assert len({before, after, found()}) == 3
    assert code_digest() == code_digest()
    assert len({code_digest(), code_digest("optics"), code_digest("optics", "rig")}) == 3
    with pytest.raises(ValueError, match="no subpackage optik"):
        code_digest("optik")


def test_a_full_disk_is_no_rig_that_cannot_be(monkeypatch):
    """A failed work ends the command; a solver that fails with the rig as designed is a reason of that rig."""
    asked = Question(forces_N=(1.0,), positions_mm=((3.3, -2.1),), materials=("silskin_0",), pixel_factor=1)
    job = plan(question=asked).job

    def full(*given, **options):
        raise WorkError("disk full")

    monkeypatch.setattr(evaluate, "contact_irradiance", lambda *given: 1.0)
    monkeypatch.setattr(objective, "prepare_fields", lambda *given: None)
    monkeypatch.setattr(measurement, "calibrated", full)
    values = {"plate.thickness_mm": 5.0, "camera.exposure_ms": 10.0}
    assert "cannot be calibrated: disk full" in evaluate.evaluate(job, values)["reason"]
    monkeypatch.setattr(evaluate, "samples", full)
    with pytest.raises(WorkError, match="disk full"):
        evaluate.evaluate(job, values)


def test_effects_taken_out_are_kept_by_the_number_of_rigs(synthetic_rig, monkeypatch, tmp_path):
    """Asked for more rigs, the winner is measured anew without each effect; files of fewer are not shown."""
    row = {"low_percent": 0.0, "high_percent": 1.0}
    rows = [row | {"name": "led_bin.offset_V"}, row | {"name": "lateral_glow.length_mm"}]
    monkeypatch.setattr(assessment, "evaluate", lambda job, values: {"figures": {}})
    monkeypatch.setattr(assessment.winner, "tolerances", lambda job, values: {"rows": rows})
    monkeypatch.setattr(assessment.winner, "assessed", lambda job, values, rigs: {"rigs": rigs})
    monkeypatch.setattr(
        assessment.winner, "without", lambda job, values, effect, rigs: {"effect": effect, "rigs": rigs}
    )
    wanted = plan(trials=4)
    chosen = assessment.choose(wanted, run(wanted, tmp_path), 1)
    for rigs in (8, 12, 8):
        wide = assessment.Assessment(rigs=rigs, trajectories=0, renderings=0)
        own = assessment.study(wanted, chosen, tmp_path, wide)[chosen[1].name]
        assert sorted((w["effect"], w["rigs"]) for w in own["without"]) == [("lateral_glow", rigs), ("led_bin", rigs)]
    assert len(list(tmp_path.glob("trial-*/without-*.json"))) == 4


@pytest.mark.parametrize("sampler", ["tpe", "nsga2"])
def test_a_search_that_goes_on_draws_nothing_twice(synthetic_rig, tmp_path, sampler):
    """Broken off while designs are still drawn at random: the second part is no repetition of the first."""
    run(plan(trials=2, sampler=sampler), tmp_path)
    found = run(plan(trials=4, sampler=sampler), tmp_path)
    assert len({tuple(sorted(t.values.items())) for t in found}) == 4


def test_a_broken_store_is_named(synthetic_rig, tmp_path):
    (tmp_path / search.STORE).write_bytes(b"no database at all")
    with pytest.raises(InputError, match="is not the store of a search"):
        run(plan(), tmp_path)
    (tmp_path / search.STORE).write_bytes(b"SQLite format 3\0" + b"\xff" * 400)
    with pytest.raises(WorkError, match=r"trials\.sqlite"):
        run(plan(), tmp_path)


KILLED = """
    import sys
    from pathlib import Path
    from evanesce.design import search
    import test_design_search as t
    search.evaluate = t.synthetic
    search.run(t.plan(trials=8), Path(sys.argv[1]))
"""


@pytest.mark.slow  # a process killed and begun again: 8 s
def test_a_killed_search_resumes_with_the_exact_number_of_trials(synthetic_rig, tmp_path):
    """SIGKILL in the middle of a trial: that one is done again with its own figures, none is lost or counted twice."""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(TESTS), *sys.path]), "SYNTHETIC_PAUSE_S": "0.15"}
    child = subprocess.Popen([sys.executable, "-c", textwrap.dedent(KILLED), str(tmp_path)], env=environment)
    store, deadline = tmp_path / search.STORE, time.monotonic() + 300

    def rows(state: str) -> list[tuple[int]]:
        with closing(sqlite3.connect(f"file:{store}?mode=ro", uri=True, timeout=5)) as base:
            return base.execute("select trial_id from trials where state = ?", (state,)).fetchall()

    done: list[tuple[int]] = []
    while len(done) < 4 and time.monotonic() < deadline:
        time.sleep(0.05)
        try:
            done = rows("COMPLETE")
        except sqlite3.OperationalError:
            continue
    while not rows("RUNNING") and time.monotonic() < deadline:
        time.sleep(0.005)
    child.send_signal(signal.SIGKILL)
    child.wait()
    assert child.returncode == -signal.SIGKILL
    begun = rows("RUNNING")
    assert len(begun) == 1
    with closing(sqlite3.connect(store)) as base:
        query = "select param_name, param_value from trial_params where trial_id = ?"
        cut_off = dict(base.execute(query, begun[0]).fetchall())
    found = run(plan(trials=8), tmp_path)
    assert len(found) == 8
    assert len({t.number for t in found}) == 8
    assert len(rows("COMPLETE")) == 8
    assert not rows("RUNNING")
    if len(cut_off) == 2:  # else it was killed between its two figures
        inner = [cut_off["plate.thickness_mm"], cut_off["camera.exposure_ms"]]
        again = [[t.values["plate.thickness_mm"], t.values["camera.exposure_ms"]] for t in found]
        assert any(np.allclose(a, inner, rtol=1e-9) for a in again)


class Elsewhere:
    """A figure of a made-up rig, worked out by one of a scheduler's workers, each of which has to do some."""

    seen: ClassVar[list[str]] = []

    @staticmethod
    def evaluate(job, values):
        from distributed import get_worker

        Elsewhere.seen.append(get_worker().address)
        time.sleep(0.05)
        return synthetic(job, values)


@pytest.fixture
def scheduler(monkeypatch):
    """A scheduler of its own with two workers, in threads of this process, reached by its address as another's is."""
    distributed = pytest.importorskip("distributed")
    monkeypatch.setattr(search, "evaluate", Elsewhere.evaluate)
    Elsewhere.seen.clear()
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=False, protocol="tcp", host="127.0.0.1", dashboard_address=None,
        scheduler_kwargs={"dashboard_address": "127.0.0.1:0"}, silence_logs=logging.CRITICAL,
    ) as cluster:  # fmt: skip
        yield cluster.scheduler_address


@pytest.mark.parametrize("sampler", ["tpe", "nsga2"])
def test_two_workers_of_a_scheduler_try_the_designs_that_one_process_tries(scheduler, tmp_path, monkeypatch, sampler):
    """While designs are drawn at random, no outcome is waited for: the same designs, and of each its own figures."""
    assert scheduler.startswith("tcp://")
    wanted = plan(trials=4, sampler=sampler)
    reported = []
    (tmp_path / "two").mkdir()
    with _client(0, scheduler) as client:
        found = run(wanted, tmp_path / "two", client, lambda done, total: reported.append((done, total)))
    assert len(set(Elsewhere.seen)) == 2
    assert reported == [(k, 4) for k in range(5)]
    monkeypatch.setattr(search, "evaluate", synthetic)
    (tmp_path / "one").mkdir()
    one = run(wanted, tmp_path / "one")
    assert [(t.number, t.values, t.figures, t.reason) for t in sorted(found, key=lambda t: t.number)] == [
        (t.number, t.values, t.figures, t.reason) for t in one
    ]


def test_a_search_goes_on_through_a_scheduler(scheduler, tmp_path):
    """Broken off after five of eleven designs by whoever watches: those stay, none is counted twice, none is left."""

    class Enough(Exception):
        pass

    def watch(done, total):
        if done == 5:
            raise Enough

    with _client(0, scheduler) as client, pytest.raises(Enough):
        run(plan(trials=11), tmp_path, client, watch)
    first = search.read(plan(trials=11), tmp_path)
    assert len(first) == 5
    with _client(0, scheduler) as client:
        found = run(plan(trials=11), tmp_path, client)
    assert len(found) == 11
    assert len({t.number for t in found}) == 11
    by_number = {t.number: t for t in found}
    for t in first:
        assert by_number[t.number] == t
    for t in found:
        made_up = synthetic({}, t.values)
        assert t.reason == made_up.get("reason", "")
        if not t.reason:
            assert t.figures["area_error"] == made_up["figures"]["area_error"]
    with closing(sqlite3.connect(tmp_path / search.STORE)) as base:
        assert base.execute("select count(*) from trials where state = 'RUNNING'").fetchone()[0] == 0


def test_names_in_the_pareto_picture_cover_nothing():
    """Five of forty crowded points have names: none over a point, a name or the legend, and all within the axes."""
    draws = np.random.default_rng(8)
    trials = []
    for k, (a, b) in enumerate(np.exp(draws.normal(size=(40, 2)) * (0.5, 0.3) + (2.0, 1.0))):
        figures = dict.fromkeys(search.OBJECTIVES, 1.0) | {"area_error": a, "exposure": b}
        trials.append(Trial(number=k, values={}, figures=figures, standard_percent=0.04 * a))
    chosen = [assessment.Chosen(name=f"trial-{t.number}", why="", values={}, trial=t) for t in trials[:5]]
    figure = pareto_figure(plan(), trials, chosen, trials[7].figures)
    (panel,) = figure.axes
    figure.canvas.draw()
    renderer = figure.canvas.get_renderer()
    notes = [t for t in panel.texts if t.get_text().startswith("trial-")]
    assert sorted(t.get_text() for t in notes) == sorted(c.name for c in chosen)
    boxes = [Text.get_window_extent(t, renderer) for t in notes]
    points = panel.transData.transform([(t.figures["exposure"], t.figures["area_error"]) for t in trials])
    frame = panel.get_window_extent(renderer)
    for i, box in enumerate(boxes):
        assert box.count_contains(points) == 0
        assert not any(box.overlaps(other) for other in boxes[i + 1 :])
        assert not box.overlaps(panel.get_legend().get_window_extent(renderer))
        assert frame.contains(*box.min)
        assert frame.contains(*box.max)


def test_winners_are_the_best_of_all_and_of_what_costs_no_more(synthetic_rig, tmp_path):
    wanted = plan(trials=6)
    trials = run(wanted, tmp_path)
    chosen = assessment.choose(wanted, trials, 3)
    assert chosen[0].name == assessment.BASE
    assert 2 <= len(chosen) <= 4
    errors = [t.figures["area_error"] for t in trials if t.feasible]
    assert chosen[1].trial.figures["area_error"] == min(errors)
    assert len({c.name for c in chosen}) == len(chosen)


def test_morris_of_a_plane_returns_its_slopes():
    """Of a linear function every elementary effect is its slope times the box's side, and nothing spreads."""
    varied = plan().variables
    middle = {"plate.thickness_mm": 5.0, "camera.exposure_ms": 19.5}
    designs = sensitivity.sample(varied, middle, 6, 1)
    low, high = sensitivity.box(varied, middle)[1]
    assert (low, high) == (pytest.approx(17.6), 20.0)
    assert designs[:, 1].min() >= low
    errors = 3.0 * designs[:, 0] - 2.0 * designs[:, 1]
    rows = {row["key"]: row for row in sensitivity.indices(varied, middle, designs, errors, 1)}
    side = {v.key: b - a for v, (a, b) in zip(varied, sensitivity.box(varied, middle), strict=True)}
    assert rows["plate.thickness_mm"]["mu_percent"] == pytest.approx(3.0 * side["plate.thickness_mm"], rel=1e-6)
    assert rows["camera.exposure_ms"]["mu_star_percent"] == pytest.approx(2.0 * side["camera.exposure_ms"], rel=1e-6)
    assert rows["camera.exposure_ms"]["sigma_percent"] == pytest.approx(0.0, abs=1e-9)


def test_one_trajectory_of_morris_tells_no_spread():
    """And no warning of a division by nothing (warnings are errors here)."""
    varied = plan().variables
    middle = {"plate.thickness_mm": 5.0, "camera.exposure_ms": 19.5}
    designs = sensitivity.sample(varied, middle, 1, 1)
    rows = {row["key"]: row for row in sensitivity.indices(varied, middle, designs, 3.0 * designs[:, 0], 1)}
    thickness = rows["plate.thickness_mm"]
    low, high = sensitivity.box(varied, middle)[[v.key for v in varied].index("plate.thickness_mm")]
    assert thickness["mu_percent"] == pytest.approx(3.0 * (high - low), rel=1e-6)
    assert math.isnan(thickness["sigma_percent"])
    assert math.isnan(thickness["half_width_percent"])


QUESTION = """
scene = "thesis"
[variables]
plate.thickness_mm = { low = 3.0, high = 9.0 }
"""
NOTHING_VARIED = 'scene = "thesis"\n'


@pytest.mark.parametrize(
    ("text", "settings", "says"),
    [
        (NOTHING_VARIED, [], "variables: nothing to vary"),
        (
            NOTHING_VARIED + "[variables]\nplate.thickness_mm = { low = 3, high = 100 }\n",
            [],
            "variables.plate.thickness_mm: 3 to 100 leaves the limits (allowed: 0.1 to 50",
        ),
        (
            NOTHING_VARIED + "[variables]\nplate.thickness = {low = 3, high = 9}\n",
            [],
            "plate.thickness: no such number",
        ),
        (NOTHING_VARIED + "[variables]\nplate.thickness_mm = {low = 9, high = 3}\n", [], "low < high"),
        (NOTHING_VARIED + "[variables]\nplate.thickness_mm = 3\n", [], "variables.plate.thickness_mm"),
        (
            NOTHING_VARIED + "[variables]\nplate.thickness_mm = {low = 3}\n",
            [],
            "variables.plate.thickness_mm.high: missing",
        ),
        (QUESTION + "[limit]\ncost = 3\n", [], "limit: unknown key; nearest key: limits"),
        (QUESTION + "[search]\nrig = 16\n", [], "search.rig: unknown key; nearest key: rigs"),
        (QUESTION + "[loads]\nforces_mN = [3]\n", [], "wrong unit: write forces_N instead"),
        ("scene = 3", [], "scene"),
        ("[[", [], "not valid TOML"),
        (QUESTION, ['objectives=["beauty"]'], "objectives: 'beauty'"),
        (QUESTION, ['objectives=["cost"]'], "with parts"),
        (QUESTION, ['limits.exposure="much"'], "limits.exposure"),
        (QUESTION, ["limits.beauty=3"], "limits: 'beauty'"),
        (QUESTION, ['search.sampler="grid"'], "search.sampler: 'grid'"),
        (QUESTION, ['measurement.estimator="best"'], "measurement.estimator: 'best'"),
        (
            QUESTION,
            ["measurement.threshold=1.5"],
            "threshold: 1.5 is out of range (allowed: 0.004 to 0.996)",
        ),
        (QUESTION, ["search.trials=0"], "search.trials: 0"),
        (QUESTION, ["search.rigs=2"], "search.rigs: 2 is out of range (allowed: 8 to 4096)"),
        (QUESTION, ["winners.count=9"], "winners.count: 9"),
        (QUESTION, ["loads.positions_mm=[[3]]"], "loads.positions_mm"),
        (QUESTION, ["loads.positions_mm=[[900, 0]]"], "within ±500 mm"),
        (QUESTION, ["loads.positions_mm=[[100, 0]]"], "loads.positions_mm"),
        (QUESTION, ['loads.materials=["wood"]'], "loads.materials: 'wood'"),
        (QUESTION, ["loads.forces_N=[-1]"], "loads.forces_N: -1 is out of range"),
        (QUESTION, ['uncertainty="nowhere.toml"'], "uncertainty: no such file"),
        (QUESTION, ['parts="nowhere.toml"'], "parts: no such file"),
        (QUESTION, ['scene="nowhere.toml"'], "scene: no such file"),
        (QUESTION, ["overrides.plate.thickness=3"], "plate.thickness"),
        (QUESTION, ["scene.plate=3"], "is not a table"),
    ],
)
def test_bad_questions_end_with_one_line_and_nothing_written(tmp_path, text, settings, says):
    out, file = tmp_path / "out", tmp_path / "question.toml"
    file.write_text(text)
    options = [part for setting in settings for part in ("--set", setting)]
    done = CliRunner().invoke(app, ["design", str(file), "--out", str(out), *options])
    assert done.exit_code == 2
    assert says in done.stderr
    assert "question.toml" in done.stderr or "thesis.toml" in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
    assert not out.exists()


def test_an_absent_question_names_those_that_ship(tmp_path):
    done = CliRunner().invoke(app, ["design", "nothing", "--out", str(tmp_path / "out")])
    assert done.exit_code == 2
    assert "a shipped question: same_cost" in done.stderr


def test_the_shipped_question_is_read_whole():
    """Every key of the documented example by hand, and the defaults of those that it only mentions."""
    wanted, assessed = read_question("same_cost", {"search.trials": 7})
    scene = load_scene("thesis")
    assert wanted.base == Design(scene=scene, threshold=0.15, min_blob_px=2000)
    assert [(v.key, v.low, v.high, v.step, v.log) for v in wanted.variables] == [
        ("plate.thickness_mm", 2, 10, 1, False), ("leds.pitch_mm", 8, 25, None, False),
        ("leds.voltage_V", 8.5, 11, None, False), ("camera.exposure_ms", 2, 20, None, True),
        ("camera.lens.f_number", 2.8, 11, None, False), ("measurement.threshold", 0.08, 0.7, None, False),
    ]  # fmt: skip
    assert wanted.objectives == ("area_error", "motion_blur")
    assert wanted.limits == (Limit("cost", 161.03),)
    assert (wanted.sampler, wanted.trials) == ("tpe", 7)
    q = wanted.question
    assert (q.forces_N, q.positions_mm, q.materials) == ((1.0, 3.0), ((0.0, 0.0),), (scene.finger.material,))
    assert (q.estimator, q.rigs, q.pixel_factor, q.crop_mm, q.speed_mm_per_s, q.seed) == (
        "reference",
        16,
        4,
        7.5,
        5.0,
        1,
    )
    assert q.standard_deviations["led_bin"] == {"offset_V": 0.03}
    assert [p.price for p in wanted.parts.part] == [0.09, 0.12, 0.2, 0.25, 55.0, 28.0, 60.0]
    assert assessed == assessment.Assessment(designs=2, rigs=24, trajectories=1, renderings=2, samples_per_pixel=8)


@pytest.mark.parametrize("form", ["[overrides]\nleds.voltage_V = 9.5\n", '[overrides]\n"leds.voltage_V" = 9.5\n'])
def test_dotted_and_quoted_keys_are_the_same(tmp_path, form):
    (tmp_path / "q.toml").write_text(QUESTION + '"camera.exposure_ms" = { low = 1, high = 20, log = true }\n' + form)
    wanted, _ = read_question(tmp_path / "q.toml")
    assert wanted.base.scene.leds.voltage_V == 9.5
    assert [v.key for v in wanted.variables] == ["plate.thickness_mm", "camera.exposure_ms"]
    assert wanted.variables[1].log


SMALL = """
scene = "rig.toml"
uncertainty = "u.toml"
parts = "p.toml"
[variables]
measurement.threshold = { low = 0.1, high = 0.6 }
plate.thickness_mm = { low = 2, high = 6, step = 1 }
[loads]
forces_N = [1]
[measurement]
min_blob_px = 40
crop_mm = 4
[search]
rigs = 8
pixel_factor = 2
trials = 6
[winners]
count = 1
rigs = 8
trajectories = 1
renderings = 0
"""


@pytest.mark.slow
@pytest.mark.system
def test_the_command_killed_once_ends_with_its_pages(tmp_path):
    """What `make design-demo` does, on a small rig: killed by SIGKILL after the first designs, then run again."""
    scene = small_rig(
        camera__resolution_px=(440, 360), camera__scale_px_per_mm=36.0, camera__pixel={"pitch_um": 6.5},
        camera__exposure_ms=3.0,
    )  # fmt: skip
    (tmp_path / "rig.toml").write_text(dump_scene(scene))
    (tmp_path / "u.toml").write_text("[led_spread]\nspread = 0.1\n[glass_absorption]\nabsorption_per_mm = 0.001\n")
    (tmp_path / "p.toml").write_text("[[part]]\nname = 'LED'\nprice = 0.3\nper = 'led'\n")
    (tmp_path / "question.toml").write_text(SMALL)
    out = tmp_path / "out"
    command = [sys.executable, "-m", "evanesce.cli", "design", str(tmp_path / "question.toml"), "--workers", "1",
               "--out", str(out)]  # fmt: skip
    child = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    store, deadline, done = out / search.STORE, time.monotonic() + 400, 0
    while done < 2 and time.monotonic() < deadline:
        time.sleep(0.2)
        if store.exists():
            try:
                with closing(sqlite3.connect(f"file:{store}?mode=ro", uri=True, timeout=5)) as base:
                    done = base.execute("select count(*) from trials where state = 'COMPLETE'").fetchone()[0]
            except sqlite3.OperationalError:
                continue
    child.send_signal(signal.SIGKILL)
    child.wait()
    assert not (out / "report.html").exists()
    subprocess.run(command, check=True, capture_output=True, timeout=600)
    with closing(sqlite3.connect(store)) as base:
        assert base.execute("select count(*) from trials where state = 'COMPLETE'").fetchone()[0] == 6
    page = (out / "report.html").read_text()
    assert "Pareto front" in page
    assert "taller than the plate" in page or "Every evaluated design" in page
    winner = next(out.glob("trial-*.toml"))
    assert (out / f"{winner.stem}.html").exists()
    load_scene(winner)
    assert "glass_absorption.absorption_per_mm" in (out / f"{winner.stem}.html").read_text()
