"""How evidence becomes probabilities: what tests, fits and lists of places say, weighed against each other."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from evanesce.chain.simulate import simulate
from evanesce.core.errors import InputError
from evanesce.criticism import critic, search
from evanesce.criticism.answer import Findings, extended_scene, verdict, warnings
from evanesce.criticism.battery import BatteryResult, Outcome
from evanesce.criticism.extend import Extension
from evanesce.criticism.locked import LockedGain
from evanesce.criticism.score import Scored, ScoreTest
from evanesce.prediction.frozen import FROZEN
from evanesce.prediction.linear import Score
from evanesce.render.fast.transport import render_fast
from evanesce.rig import dump_scene, load_scene


@pytest.fixture(autouse=True)
def no_flexible_term(monkeypatch: pytest.MonkeyPatch) -> None:
    """The flexible term has tests of its own; here it finds nothing."""
    monkeypatch.setattr(critic, "fit_flexible", lambda *a: SimpleNamespace(evidence=0.0))
    monkeypatch.setattr(critic, "describe_unknown", lambda *a: {"where": "somewhere"})
    monkeypatch.setattr(critic, "_projection", lambda *a: None)
    monkeypatch.setattr(critic, "_whitened_maps", lambda *a: {})


def battery(p: float, tail_p: float = 0.2) -> BatteryResult:
    return BatteryResult(p, (Outcome("rows: periodogram", 3.0, p, tail_p),), 999)


def scored(name: str, log_bayes: float) -> Scored:
    result = Score(2 * log_bayes, 1, np.zeros(1), np.eye(1), log_bayes)
    return Scored(SimpleNamespace(id=name), result, -1, 1.0, 0.1, np.eye(1))  # type: ignore[arg-type]


def extension(name: str, log_bayes: float, **more: Any) -> Extension:
    known = {f.name: None for f in fields(Extension)}
    cause = SimpleNamespace(id=name)
    return Extension(**(known | {"ids": (name,), "log_bayes": log_bayes, "at_places": {}, "cause": cause} | more))


def weighed(
    *, p: float, after: float | None = None, tail: float = 0.2, first: dict[str, float], rounds: list[Extension],
    best: Extension | None = None, codec: bool = False, size: int = 40, unlike: float | None = None,
) -> Findings:  # fmt: skip
    """Return findings of two candidates, weighed."""
    test = ScoreTest(tuple(scored(k, v) for k, v in first.items()), p, 4999)
    before = battery(0.5 if after is not None else p, tail)
    found = Findings(global_p=p, first=test, battery=before, rounds=[rounds], best=best, unlike=unlike is not None)
    if after is not None:
        found.after, found.left = battery(after, tail), SimpleNamespace()  # type: ignore[assignment]
    case = SimpleNamespace(
        base=None, problem=SimpleNamespace(sd=np.ones((1, 2, 2)), views=(0,)), codec=codec,
        likeness=SimpleNamespace(evidence=unlike),
    )  # fmt: skip
    signatures = [SimpleNamespace(note="") for _ in range(size)]
    critic.weigh(case, found, SimpleNamespace(), signatures)  # type: ignore[arg-type]
    return found


def share(found: Findings, name: str) -> float:
    assert found.posterior is not None
    return found.posterior.marginal().get(name, 0.0)


def test_a_cause_that_leaves_nothing_is_named() -> None:
    best = extension("vignetting", 20.0, fitted=None)
    found = weighed(p=0.0002, after=0.6, first={"vignetting": 22.0, "modulus": 1.0}, rounds=[best], best=best)
    # All that is against it is what else may draw the same.
    assert share(found, "vignetting") == pytest.approx(1 / (1 + FROZEN.priors["mimic"]), abs=1e-3)
    assert share(found, "unknown") > share(found, "none")
    assert verdict(found) == "named"


@pytest.mark.parametrize("names", [("a",), ("a", "b"), ("a", "b", "c")])
@pytest.mark.parametrize(
    ("after", "codec", "size"), [(0.6, False, 40), (0.6, True, 40), (0.02, False, 40), (0.6, False, 9)]
)
def test_each_named_cause_may_be_something_that_draws_the_same_at_the_same_odds(
    names: tuple[str, ...], after: float, codec: bool, size: int
) -> None:
    """However many are named, however large the library is and whatever the battery says of what they leave."""
    best = extension(names[-1], 100.0 * len(names), ids=names, fitted=None)
    found = weighed(
        p=0.0002, after=after, first=dict.fromkeys(names, 90.0), rounds=[best], best=best, codec=codec, size=size
    )
    odds, others = FROZEN.priors["mimic"], len(names) - 1
    for name in names:
        assert share(found, name) == pytest.approx((1 + others * odds) / (1 + (others + 1) * odds), abs=1e-3)
    assert verdict(found) == "named"


def test_a_pair_that_was_not_accepted_lends_no_name_more_than_its_share() -> None:
    """Rationale: of a coarse camera `tone_curve` had 0.9997, by a pair with `square_size` that was not accepted."""
    best = extension("tone_curve", 60.0, fitted=None)
    pair = extension("square_size", 72.0, ids=("tone_curve", "square_size"), fitted=None)
    found = weighed(p=0.0002, after=0.6, first={"tone_curve": 60.0}, rounds=[best, pair], best=best)
    odds = FROZEN.priors["mimic"]
    assert share(found, "tone_curve") < (1 + odds) / (1 + 2 * odds) + 1e-3
    assert share(found, "unknown") > 0.15


def test_evidence_of_a_score_that_noise_often_makes_is_tempered() -> None:
    """Odds of a p of 0.2 are 1.1 at most; 8 nats of a likelihood with thin tails are not believed."""
    found = weighed(p=0.2, first={"sensor_dust": 8.0, "modulus": -1.0}, rounds=[])
    assert share(found, "none") > 0.5
    assert share(found, "sensor_dust") < share(found, "none")
    assert verdict(found) == "none"


def test_what_rings_and_has_no_cause_is_unknown() -> None:
    found = weighed(p=0.002, tail=1e-9, first={"vignetting": 0.5, "modulus": -1.0}, rounds=[])
    assert found.rings
    assert verdict(found) == "unknown"
    assert share(found, "unknown") > 0.9


@pytest.mark.parametrize("codec", [False, True])
def test_frames_without_the_believed_contact_are_unknown_however_well_an_effect_scores(codec: bool) -> None:
    found = weighed(p=0.0002, first={"glass_absorption": 3e5}, rounds=[], codec=codec, unlike=400.0)
    assert verdict(found) == "unknown"
    assert share(found, "unknown") == pytest.approx(1.0)
    assert share(found, "glass_absorption") == 0.0
    assert found.unknown is not None


def test_a_cause_that_leaves_more_than_half_of_what_it_explains_is_unknown() -> None:
    """The loudest test's tail law stands for what is left: 1e-17 is 30 nats beside 25."""
    best = extension("distortion_drift", 25.0, fitted=None)
    arguments: dict[str, Any] = {"p": 0.0002, "first": {"distortion_drift": 26.0}, "rounds": [best], "best": best}
    much, little = (weighed(after=0.001, tail=tail, **arguments) for tail in (1e-17, 1e-5))
    assert much.unexplained > FROZEN.levels["unknown_share"] > little.unexplained
    assert verdict(much) == "unknown"
    assert verdict(little) == "named"
    assert share(much, "unknown") > 0.9


def test_a_cause_that_bends_away_from_its_straight_line_keeps_no_other_from_being_tried(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A line promises 88 nats of which a fit keeps 16: those that promised 50 are tried, those far below are not."""
    kept = {"saturation": 16.0, "led_bin": 64.0, "led_droop": 66.0, "tone_curve": 12.0, "vignetting": 1.0}
    line = {"saturation": 88.0, "led_bin": 70.0, "led_warmup": 68.0, "led_droop": 50.0, "tone_curve": 30.0}
    monkeypatch.setattr(search, "extend", lambda p, b, k, s: extension(s.id, kept.get(s.id, 62.0)))
    tried = [scored(name, value) for name, value in line.items()]

    def fitted(*candidates: Scored) -> list[str]:
        case: Any = SimpleNamespace(notes=[])
        found = search.fitted_for_good(case, None, None, None, candidates)  # type: ignore[arg-type]
        assert all(s.id == e.ids[0] for s, e in found)
        return [e.ids[0] for _, e in found]

    assert fitted(*tried) == ["saturation", "led_bin", "led_warmup", "led_droop"]
    # Where nothing keeps what was promised, all that is left comes near.
    assert fitted(tried[0], *tried[3:]) == ["saturation", "led_droop", "tone_curve"]


def test_a_cause_that_cannot_be_fitted_sets_no_bar_and_takes_no_place(monkeypatch: pytest.MonkeyPatch) -> None:
    def extend(p: Any, b: Any, k: Any, s: Scored) -> Extension:
        if s.id == "plate_tilt":
            raise InputError("camera within the plate")
        return extension(s.id, s.result.log_bayes)

    monkeypatch.setattr(search, "extend", extend)
    line = {"plate_tilt": 900.0, "saturation": 42.0, "led_bin": 40.0, "led_droop": 39.0, "creep": 38.0, "modulus": 5.0}
    case: Any = SimpleNamespace(notes=[])
    found = search.fitted_for_good(case, None, None, None, [scored(k, v) for k, v in line.items()])  # type: ignore[arg-type]
    assert [e.ids[0] for _, e in found] == ["saturation", "led_bin", "led_droop", "creep"]
    assert case.notes == ["plate_tilt could not be fitted: camera within the plate"]


@pytest.mark.parametrize("codec", [False, True])
def test_a_flexible_term_that_no_battery_confirms_predicts_nothing(codec: bool) -> None:
    """Rationale: under strong H.264, where the battery is silent, it was the codec: -175 nats on the locked part.

    Other marks than a list names ring there as well, and say nothing of the term.
    """
    other = extension("specks", 30.0, at_places={"led_off": 6.3, "lens_cap": 5.9})
    for rounds in ([], [other]):
        found = weighed(p=0.002, tail=1e-9, first={"vignetting": 0.5}, rounds=rounds, codec=codec)
        assert verdict(found) == "unknown"
        assert (critic.confirmed_term(found) is not None) == (not codec)


def test_a_list_of_other_marks_is_evidence_of_the_unknown_and_of_no_name() -> None:
    other = extension("specks", 30.0, at_places={"led_off": 6.3, "lens_cap": 5.9})
    for codec in (False, True):
        found = weighed(p=0.0002, first={"specks": 31.0}, rounds=[other], codec=codec)
        assert found.rings
        assert verdict(found) == "unknown"
        assert share(found, "unknown") > 0.99
        assert share(found, "specks") < 0.01


@pytest.mark.parametrize(("left", "asked"), [(("modulus", "creep"), ("modulus", ["creep"])), (("modulus",), None)])
def test_a_picture_is_advised_where_causes_come_near_and_none_is_worth_its_prior(
    monkeypatch: pytest.MonkeyPatch, left: tuple[str, ...], asked: Any
) -> None:
    """What could be told apart is asked of two or more; with one alone there is nothing to tell it from."""
    monkeypatch.setattr(critic, "metric_of", lambda base: None)
    monkeypatch.setattr(critic, "absorbed", lambda *a: [])
    monkeypatch.setattr(
        critic, "next_measurement", lambda o, p, best, group: {"what": (best.cause.id, [e.cause.id for e in group])}
    )
    inside = {"parameters": (), "fitted": None}
    near = [extension(name, 6.0 - k, **inside) for k, name in enumerate(left)]
    found = weighed(p=0.0002, first={"modulus": 6.0, "creep": 5.0}, rounds=near)
    case = SimpleNamespace(base=SimpleNamespace(parameters=()), observation=None, problem=None)
    critic.isolate(case, [], found)  # type: ignore[arg-type]
    assert [e.cause.id for e in found.group] == list(left)
    assert (found.next_shot or {}).get("what") == asked


@pytest.mark.parametrize(
    ("improved", "near", "kept"),
    [
        (27.0, True, True),  # draws the same picture with more parameters, which cost 9 nats
        (24.0, True, False),  # 6 nats less of it
        (27.0, False, False),
    ],
)
def test_what_draws_the_same_picture_stays_in_the_answer_whatever_its_parameters_cost(
    monkeypatch: pytest.MonkeyPatch, improved: float, near: bool, kept: bool
) -> None:
    """Rationale: of a black level of 10 without dark shots ambient light was left out, whose slope costs 9 nats."""
    distances = np.full((2, 2), 4.0 if near else 40.0)
    monkeypatch.setattr(search, "confusion", lambda causes, metric: distances)
    inside = {"parameters": (), "fitted": None}
    level = extension("black_level", 28.0, improved=30.0, **inside)
    light = extension("ambient_light", 19.0, improved=improved, **inside)
    found = search.rivals([level, light], ("black_level",), None)
    assert [e.cause.id for e in found] == (["ambient_light"] if kept else [])


def test_an_extended_scene_renders_as_any_other_with_the_places_that_the_data_listed(tmp_path: Path) -> None:
    believed = load_scene("thesis", {"camera.resolution_px": [208, 164], "camera.scale_px_per_mm": 7.3})
    point = {"vignetting:k": 0.2, "specks:marks": 1.5, "@light": 0.1, "@pose_x[0]": 0.2}
    named = extension("specks", 9.0, fitted=SimpleNamespace(point=point))
    fixed = {"specks": {"mark_x_mm": [1.1, -6.2], "mark_y_mm": [7.4, 5.0], "mark_light_mm2": [0.2, 0.5]}}
    path = tmp_path / "extended.toml"
    path.write_text(dump_scene(extended_scene(believed, named, fixed)))
    again = load_scene(path)
    assert again.effects["vignetting"]["k"] == 0.2
    assert len(again.effects["specks"]["mark_x_mm"]) == 2
    frames = [simulate(scene, 1.2, seed=3, render=render_fast).frame.data.astype(float) for scene in (believed, again)]
    assert np.abs(frames[1] - frames[0]).max() > 10


def test_the_level_is_stricter_where_a_codec_left_no_noise() -> None:
    kinds = ((False, False), (True, False), (True, True))
    levels = [critic.level_of(SimpleNamespace(codec=codec, silent=silent)) for codec, silent in kinds]  # type: ignore[arg-type]
    assert levels[0] == FROZEN.levels["false_alarm"]
    assert levels[1] == FROZEN.levels["false_alarm_codec"]
    assert levels[2] < levels[1] <= levels[0]


@pytest.mark.parametrize(("highest", "warned"), [(-0.4, True), (0.4, False)])
def test_a_name_that_predicts_the_locked_part_worse_carries_a_warning(highest: float, warned: bool) -> None:
    best = extension("residue_film", 20.0, fitted=None)
    found = weighed(p=0.0002, after=0.6, first={"residue_film": 22.0}, rounds=[best], best=best)
    found.gain = LockedGain((-4.0, -9.0, highest), (1.0, 1.0), (0.1, 0.1), 3)
    assert len(warnings(found)) == warned
