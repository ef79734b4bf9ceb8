"""The joint judgement of the thesis's outcomes: planted sets of mechanisms, contradictions, nulls, tables, evidence.

Synthetic outcomes are drawn by a few lines of their own: Hertz's and JKR's closed forms, and a disc of light convolved
by hand with the scattering profile. Only what has no closed form (solved contacts) is taken from the same tables.
"""

from __future__ import annotations

import json
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import stats
from scipy.signal import fftconvolve
from typer.testing import CliRunner

from evanesce.cli.app import app
from evanesce.core.errors import InputError
from evanesce.prediction.parameters import Parameter
from evanesce.studies.thesis_jointly import tables
from evanesce.studies.thesis_jointly.answer import criticise_thesis
from evanesce.studies.thesis_jointly.data import FILE, Outcome, Outcomes, Row, read_outcomes
from evanesce.studies.thesis_jointly.judge import judge, judge_set, log_predictive, settled
from evanesce.studies.thesis_jointly.mechanisms import MECHANISMS, NOMINAL, NUISANCES, MechanismSet, all_sets
from evanesce.studies.thesis_jointly.menu import ranked
from evanesce.studies.thesis_jointly.page import page
from evanesce.studies.thesis_jointly.predict import Predictor
from evanesce.studies.thesis_jointly.sample import drawn

ROOT = Path(__file__).parents[2]
BUNDLES = ROOT / "bundles"
SHIPPED = (BUNDLES / "thesis_silskin_0", BUNDLES / "thesis_silskin_20")
G = {"silskin_0": 2e-6 * (3693.2 + 49474.0), "silskin_20": 2e-6 * (-1895.4 + 6960.9)}  # table 6 [MPa]
RHEOLOGY = {"silskin_0": (0.0606, 0.2324), "silskin_20": (0.0148, 0.3820)}
RADIUS = 7.5


def row(name: str, kind: str, figure: float, relative: float, unit: str = "1", **at: float) -> Row:
    one = {"id": f"{kind}_{at.get('force_N', 0):g}", "kind": kind, "unit": unit, "value": figure,
           "sd": relative * abs(figure) if kind not in ("growth", "tilt_friction", "lost_below") else relative,
           "at": at, "source": "drawn", "uncertainty": "drawn"}  # fmt: skip
    return Row(name, Outcome.model_validate(one))


EDGE_MM = 0.06  # by which blur moves the edge at threshold 0.15, measured on the real photograph


def hand_read(area: float, share: float, length: float, threshold: float = 0.064) -> float:
    """Area above a threshold of a disc of light of which a share spreads by Christensen and Burley's profile [mm^2]."""
    cell, half = 0.1, 16.0
    x = np.arange(-half, half, cell)
    r = np.hypot(x[:, None], x[None, :])
    edge = np.sqrt(area / np.pi) + EDGE_MM
    if share == 0 or length == 0:
        return float(np.pi * edge**2)
    disc = np.clip((edge - r) / cell + 0.5, 0.0, 1.0)
    d = length / (1.9 - 0.6 + 3.5 * 0.04)
    safe = np.maximum(r, 0.3 * cell)
    kernel = (np.exp(-safe / d) + np.exp(-safe / (3 * d))) / (8 * np.pi * d * safe)
    light = (1 - share) * disc + share * fftconvolve(disc, kernel / kernel.sum(), mode="same")
    return float((light > threshold).sum() * cell**2)


@dataclass(frozen=True)
class Truth:
    """Hertzian fingers of some modulus over table 6, of which one scatters."""

    modulus: dict[str, float]
    scattering: dict[str, tuple[float, float]]
    by_read: bool = False

    def rows(self, rng: np.random.Generator, noise: float = 0.05) -> list[Row]:
        found = []
        for name, factor in self.modulus.items():
            plane = 4 * G[name] * factor
            for force in (0.4, 0.9, 1.7, 3.6):
                radius = (0.75 * force * RADIUS / plane) ** (1 / 3)
                area = np.pi * radius**2
                read = hand_read(area, *self.scattering[name])
                wobble = np.exp(noise * rng.standard_normal(3))
                found.append(row(name, "read_area", read * wobble[0], noise, "mm2", force_N=force))
                found.append(row(name, "depth", radius**2 / RADIUS * wobble[1], noise, "mm", force_N=force))
                if force == 0.9:
                    tau0, alpha = RHEOLOGY[name]
                    mu = tau0 * (read if self.by_read else area) / force + alpha
                    found.append(row(name, "friction", mu * wobble[2], noise, force_N=force))
        return found


STIFF = {"silskin_0": 2.3, "silskin_20": 3.2}
CLEAR = {"silskin_0": (0.0, 0.0), "silskin_20": (0.0, 0.0)}
PLANTED = Truth(STIFF, {"silskin_0": (0.0, 0.0), "silskin_20": (0.55, 0.9)}, by_read=True)


def some_sets(*switches: str) -> list[MechanismSet]:
    """Sets of Hertz's and finite elements' laws, all ways of scattering, and some switches."""
    keep = {"hertz", "finite_strain", "clear", "scatter_alike", "scatter_0", "scatter_20", *switches}
    return [s for s in all_sets() if s.ids <= keep]


def test_the_planted_set_is_found_and_wrong_ones_are_excluded():
    outcomes = Outcomes(tuple(PLANTED.rows(np.random.default_rng(4))))
    found = judge(outcomes, some_sets("modulus", "friction_by_read_area"))
    best = found.sets[0]
    assert best.chosen.ids == {"hertz", "scatter_20", "modulus", "friction_by_read_area"}
    assert found.probability[0] > 0.9
    for wrong in ("finite_strain", "clear", "scatter_alike", "scatter_0"):
        assert found.inclusion(wrong) < 0.02, wrong
    # What was hidden lies within the draws' 99 %.
    for name, hidden in (("silskin_0", 2.3), ("silskin_20", 3.2)):
        low, high = np.percentile(best.points[f"modulus:{name}"], [0.5, 99.5])
        assert low - 0.03 < np.log(hidden) < high + 0.03


def test_a_null_names_nothing():
    """The nominal model's own outcomes, five times: no mechanism is named, and nothing is unexplained."""
    nominal = Truth({"silskin_0": 1.0, "silskin_20": 1.0}, CLEAR)
    shares = []
    for seed in range(5):
        rows = nominal.rows(np.random.default_rng(seed))
        outcomes = Outcomes(tuple(r for r in rows if r.material == "silskin_0"))
        found = settled(outcomes, some_sets("modulus", "adhesion"))
        assert found.unknown == ()
        # Of Silskin 20 % there is no outcome here: its scattering is as probable as before, that of the other less.
        assert found.inclusion("scatter_0") < found.inclusion("scatter_20")
        shares.append([found.inclusion(name) for name in ("finite_strain", "modulus", "adhesion", "scatter_0")])
    assert np.max(shares) < 0.9
    assert np.mean(shares, axis=0) == pytest.approx(np.zeros(4), abs=0.4)


def test_a_planted_contradiction_is_unexplained_and_does_not_move_the_rest():
    rows = PLANTED.rows(np.random.default_rng(4))
    wrong = row("silskin_0", "youngs_modulus", 3.0 * G["silskin_0"] * 2.3 * 12.0, 0.1, "MPa")
    sets = [s for s in some_sets("modulus", "friction_by_read_area") if "hertz" in s.ids]
    found = settled(Outcomes((*rows, wrong)), sets)
    assert found.unknown == ("silskin_0:youngs_modulus",)
    assert found.inclusion("scatter_20") > 0.9
    assert np.median(found.sets[0].points["modulus:silskin_0"]) == pytest.approx(np.log(2.3), abs=0.08)


@pytest.mark.parametrize(("area", "share", "length"), [(20.0, 0.7, 0.7), (60.0, 0.45, 0.7), (60.0, 0.25, 1.1)])
def test_read_areas_are_those_of_a_disc_convolved_by_hand(area: float, share: float, length: float):
    args = [np.array([x]) for x in (np.log(area), share, length, 0.0)]
    read = area * float(np.exp(tables.log_read_over_true(*args)[0]))
    assert read == pytest.approx(hand_read(area, share, length), rel=0.08)
    assert read > 1.1 * area


def test_depths_and_areas_follow_hertz_and_jkr():
    rows = [
        row("silskin_20", "depth", 1.0, 0.1, "mm", force_N=2.0),
        row("silskin_20", "friction", 1.0, 0.1, force_N=2.0),
    ]
    point = {p.name: np.array([p.null]) for p in NUISANCES} | {
        "modulus:silskin_20": np.log([3.0]), "adhesion:silskin_20": np.log([2.0]),
        "modulus:silskin_0": np.zeros(1), "adhesion:silskin_0": np.zeros(1),
    }  # fmt: skip
    chosen = MechanismSet(frozenset({"hertz", "clear", "modulus", "adhesion"}))
    depth, friction = np.exp(Predictor(rows, chosen)(point)[0])
    plane, work = 4 * G["silskin_20"] * 3.0, 2e-3
    pull = 3 * np.pi * work * RADIUS
    radius = (0.75 * RADIUS / plane * (2.0 + pull + np.sqrt(2 * pull * 2.0 + pull**2))) ** (1 / 3)
    assert depth == pytest.approx(radius**2 / RADIUS - np.sqrt(2 * np.pi * radius * work / plane), rel=1e-9)
    tau0, alpha = RHEOLOGY["silskin_20"]
    assert friction == pytest.approx(tau0 * np.pi * radius**2 / 2.0 + alpha, rel=1e-9)


def test_ridges_lower_friction_by_their_share_of_area_and_as_drawn_change_the_finite_elements_alone():
    kinds = {"ridged_over_smooth": "1", "ridged_depth": "1", "ridged_friction": "1"}
    rows = [row("silskin_0", kind, 0.8, 0.1, unit, force_N=1.0) for kind, unit in kinds.items()]
    point = {p.name: np.array([p.null]) for p in NUISANCES}
    moulded, drawn_ = (
        Predictor(rows, MechanismSet(NOMINAL.ids | more))(point)[0] for more in (set(), {"ridges_as_drawn"})
    )
    area, depth, friction = np.exp(moulded[0]), moulded[1], np.exp(moulded[2])
    tau0, alpha = RHEOLOGY["silskin_0"]
    smooth = np.pi * (0.75 * RADIUS / (4 * G["silskin_0"])) ** (2 / 3)  # Hertz at 1 N
    assert friction == pytest.approx((tau0 * smooth * area + alpha) / (tau0 * smooth + alpha), rel=1e-6)
    # A furrow a twentieth of a millimetre deep cannot press the finger deeper by more than that (0.94 mm at 1 N).
    assert 0.0 < depth < 0.05
    assert depth < drawn_[1] < 0.11
    assert np.exp(drawn_[0]) < area
    assert drawn_[2] == moulded[2]


def test_the_area_of_the_finite_elements_is_theirs_whatever_the_finger_is():
    rows = [row("silskin_20", "fe_area", 60.0, 0.05, "mm2", force_N=5.0)]
    point = {p.name: np.array([p.null]) for p in NUISANCES} | {f"modulus:{m}": np.array([0.7]) for m in G}
    solid, bone = (
        float(np.exp(Predictor(rows, MechanismSet(frozenset({law, "clear", "modulus"})))(
            point | {"bone:share": np.array([0.25])})[0, 0]))
        for law in ("finite_strain", "bone")
    )  # fmt: skip
    stiffer = float(np.exp(tables.solved_press("silskin_20", np.zeros(1), np.log([5.0]) - 0.7)[1][0]))
    assert solid > 1.2 * stiffer
    assert bone < solid


def test_solved_contacts_over_a_bone_lie_between_hertz_and_a_bonded_layer():
    log_force = np.log(np.array([0.5, 1.0, 3.0]))
    depth, area = tables.solved_press("silskin_20", np.array(0.25), log_force)
    radius = np.sqrt(np.exp(area) / np.pi)
    # Over a bone, more area than Hertz gives a depth: the skin is thin; and less than a bonded thin layer's four times.
    assert ((radius**2 / RADIUS > 0.8 * np.exp(depth)) & (radius**2 / RADIUS < 4 * np.exp(depth))).all()
    assert (np.diff(depth) > 0).all()


class Line:
    """A model with a closed-form evidence: rows are a line of one parameter."""

    def __init__(self, rows: np.ndarray) -> None:
        self.rows = rows

    def __call__(self, points: Any) -> np.ndarray:
        return np.asarray(points["a:x"])[:, None] * self.rows


@pytest.mark.parametrize(("at", "low"), [(0.8, -np.inf), (-0.9, 0.0)])
def test_sampled_evidence_is_the_integral(at: float, low: float):
    """Also where the data push a parameter against its bound."""
    from evanesce.inference.gauss_newton import Slopes, Solution
    from evanesce.inference.joint_fit import JointFit
    from evanesce.prediction.linear import Metric

    rows, sd = np.array([1.0, 2.0, -1.0]), np.array([0.5, 0.8, 0.7])
    data = at * rows + np.array([0.2, -0.3, 0.1])
    p = Parameter(name="a:x", null=0.0, deviation=0.6, bounds=(low, np.inf), step=0.1)
    precision = float(np.square(rows / sd).sum() + 1 / 0.36)
    best = max(float((rows * data / sd**2).sum() / precision), low)
    held = np.array([best == low])
    solution = Solution(
        np.array([best]), best * rows / sd, Slopes((rows / sd)[None]), 0.0, np.array([[precision]]), held
    )
    metric = Metric.of(np.zeros((0, 3)), np.zeros(0))
    fit = JointFit((), (p,), {"a:x": best}, solution, metric, (data - best * rows) / sd)
    grid = np.linspace(max(low, -6), 6, 20001)
    density = stats.norm(0, 0.6).pdf(grid) / (1 - stats.norm(0, 0.6).cdf(low))
    like = stats.norm(grid[:, None] * rows, sd).pdf(data).prod(axis=1)
    found = drawn(fit, Line(rows), data, sd, np.random.default_rng(1))  # type: ignore[arg-type]
    assert found.log_evidence == pytest.approx(np.log(np.trapezoid(density * like, grid)), abs=0.05)


def test_predictive_density_of_a_group_is_that_of_a_fit_without_it():
    """By a fit without the group; both share one set and have closed forms' fits near."""
    outcomes = Outcomes(tuple(PLANTED.rows(np.random.default_rng(2))))
    chosen = MechanismSet(frozenset({"hertz", "scatter_20", "modulus", "friction_by_read_area"}))
    group = "silskin_0:depth"
    whole, rest = judge_set(outcomes, chosen), judge_set(outcomes.without(group), chosen)
    places = outcomes.of(group)
    units = float(np.log(outcomes.sd()[places]).sum()) + 0.5 * places.size * np.log(2 * np.pi)
    assert log_predictive(whole, places) - units == pytest.approx(whole.log_evidence - rest.log_evidence, abs=0.4)


def test_two_readings_of_a_figure_share_the_evidence():
    figures = row("silskin_0", "read_area", 12.0, 0.05, "mm2", force_N=1.0).outcome.model_dump() | {"value": None}
    both = Outcomes((Row("silskin_0", Outcome.model_validate(figures | {"either": (12.0, 17.9)})),))
    each = [
        judge_set(Outcomes((Row("silskin_0", Outcome.model_validate(figures | {"value": f})),)), NOMINAL)
        for f in (12.0, 17.9)
    ]
    whole = judge_set(both, NOMINAL).log_evidence
    sd = np.array([0.6 / 12.0, 0.6 / 17.9, 0.6 / 14.95])  # a relative sd counts over the mean of both readings
    spread = np.log(sd / sd[2])
    assert whole == pytest.approx(np.logaddexp(*(e.log_evidence for e in each)) - np.log(2), abs=1.0 + spread.max())
    assert judge_set(both, NOMINAL).data == pytest.approx([np.log(17.9)])  # table 6's finger reads 18 mm2


def test_information_of_the_menu_lies_between_nothing_and_the_doubt():
    rows = [r for r in PLANTED.rows(np.random.default_rng(4)) if r.outcome.kind == "read_area"]
    found = judge(Outcomes(tuple(rows)), some_sets("modulus", "scale"))
    menu = ranked(found)
    for entry in menu:
        assert 0 <= entry["information_nats"] <= entry["doubt_nats"] + 1e-9
    assert menu[0]["information_nats"] > 0.1
    by_name = {e["what"].split(" of ")[0]: e for e in menu}
    assert max(by_name["pull-off force"]["about"].values(), default=0.0) < 0.1  # no set has adhesion


def test_shipped_outcomes_are_those_that_the_script_makes(tmp_path: Path):
    import runpy
    import sys

    for folder in SHIPPED:
        (tmp_path / folder.name).mkdir()
    argv = sys.argv
    sys.argv = ["thesis_bundles.py", str(tmp_path)]
    try:
        runpy.run_path(str(BUNDLES.parent / "docs" / "validation" / "thesis_bundles.py"), run_name="__main__")
    finally:
        sys.argv = argv
    for folder in SHIPPED:
        assert (tmp_path / folder.name / FILE).read_text() == (folder / FILE).read_text()


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('kind = "depth"', 'kind = "dept"', "outcome"),
        ("sd = 0.0251", "sd = 0.0", "sd"),
        ("value = 0.50242", "value = -0.50242", "above 0"),
        ("force_N = 1.0", "force_N = 99.0", "force_N"),
        ("schema_version = 1", "schema_version = ", "TOML"),
        ('id = "depth_1N"', 'id = "depth_5N"', "twice"),
    ],
)
def test_what_is_wrong_in_a_file_is_one_line(tmp_path: Path, old: str, new: str, said: str):
    text = (SHIPPED[0] / FILE).read_text()
    assert old in text
    (tmp_path / FILE).write_text(text.replace(old, new, 1))
    with pytest.raises(InputError, match=said):
        read_outcomes([tmp_path])
    result = CliRunner().invoke(app, ["study", "thesis-jointly", str(tmp_path)])
    assert result.exit_code == 2
    assert len(result.stderr.strip().splitlines()) == 1
    assert FILE in result.stderr


def test_every_set_has_one_law_and_one_way_of_scattering():
    sets = list(all_sets())
    assert len({s.ids for s in sets}) == len(sets) == 960
    assert sets[0] == NOMINAL
    assert sum(np.exp(s.log_prior) for s in sets) == pytest.approx(1.0)
    assert all(p.bounds[0] <= p.null <= p.bounds[1] for m in MECHANISMS.values() for p in m.parameters)


@pytest.mark.slow  # fits all 960 sets to all outcomes, several times: minutes
def test_both_fingers_jointly(tmp_path: Path):
    target, report = tmp_path / "j.json", tmp_path / "j.html"
    arguments = ["study", "thesis-jointly", *map(str, SHIPPED), "--json", str(target), "--report", str(report)]
    assert CliRunner().invoke(app, arguments).exit_code == 0
    result = json.loads(target.read_text())
    probability = {m["id"]: m["probability"] for m in result["mechanisms"]}
    assert probability["bone"] > 0.99
    assert probability["clear"] < 0.01
    assert probability["scatter_0"] < 0.01
    assert result["unexplained"] == ["silskin_0:overshoot"]
    other = result["scattering_of_the_other_bundle"]
    assert other["read_mm2"] > 1.4 * max(other["published_mm2"])
    assert report.read_text().count("data:image/png") == len({r["group"] for r in result["outcomes"]}) + 1
    # The page of the documentation says what the command says.
    said = " ".join((ROOT / "docs/criticism/thesis-jointly.md").read_text(encoding="utf-8").split())
    for name, pattern in PRINTED.items():
        (one,) = (p for p in result["parameters"] if p["name"] == name)
        found = re.search(pattern.format(r"([\d.]+)(?: mm)? \(([\d.]+)–([\d.]+)\)"), said)
        assert found is not None, name
        printed = [float(text) for text in found.groups()]
        assert printed == pytest.approx([one["value"], one["low"], one["high"]], rel=0.03, abs=0.01), name


PRINTED = {
    "bone:share": "bone of {}", "modulus:silskin_0": "Moduli {}", "modulus:silskin_20": r"\) and {} times table 6",
    "scatter_20:share": "share {}", "scatter_20:length_mm": "length {}",
}  # fmt: skip
"""Where the page prints a parameter with its interval."""


def test_the_answer_of_a_small_judgement_is_whole():
    rows = PLANTED.rows(np.random.default_rng(4))[:9]
    answer = criticise_thesis(Outcomes(tuple(rows)), sets=some_sets("modulus")[:12])
    json.dumps(answer)
    assert {r["id"] for r in answer["outcomes"]} == {r.outcome.id for r in rows}
    for one in answer["outcomes"]:
        assert one["extended"][1] <= one["extended"][0] <= one["extended"][2]
    html = page(answer, {}).render()
    # A picture for each group, and the mechanisms' probabilities.
    assert html.count("data:image/png") == len({r["group"] for r in answer["outcomes"]}) + 1
    assert "published: 28.9 or 40.3 mm²" in html


def test_wider_deviations_say_less_and_a_factor_out_of_range_is_refused():
    outcomes = Outcomes(tuple(PLANTED.rows(np.random.default_rng(4))))
    sets = [s for s in some_sets("modulus", "friction_by_read_area") if {"hertz", "modulus"} <= s.ids]
    narrow, wide = (judge(Outcomes(outcomes.rows, times), sets) for times in (1.0, 4.0))
    assert wide.inclusion("clear") > 10 * narrow.inclusion("clear")
    arguments = ["study", "thesis-jointly", *map(str, SHIPPED), "--sd-times", "0.01"]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 2
    assert "--sd-times" in result.stderr
    assert "0.2 to 5" in result.stderr


def test_shipped_outcomes_hold_both_fingers_and_a_source_for_each():
    outcomes = read_outcomes(SHIPPED)
    assert len(outcomes.rows) == 32
    assert len(outcomes.groups) == 22
    assert all("assumed" in r.outcome.uncertainty for r in outcomes.rows)
    assert sum(1 for _ in outcomes.readings()) == 2
