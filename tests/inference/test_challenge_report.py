"""Scores and the table of targets, of made-up answers in the critic's form."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

from challenge.library import NAMED
from challenge.report import judged, markdown, picture, read
from challenge.score import Rate, calibration, coverage, rigs, strength, summary, top, wilson


def said(*names: str, verdict: str = "", p: float = 0.95, sets: dict | None = None, **more: object) -> dict:
    """Return an answer that names causes, the first taking most of the misfit."""
    verdict = verdict or ("causes" if names else "none")
    places, causes = {}, []
    for k, name in enumerate(names):
        held = (sets or {}).get(name, [name])
        places[name] = {"credible_set": held, "probability": {n: p / len(held) for n in held} | {"none": 1 - p}}
        causes.append({"id": name, "probability": p, "credible_set": held, "misfit_share": 0.5 / (1 + k),
                       "parameters": {}, "area": {}})  # fmt: skip
    inclusion = {n: v for place in places.values() for n, v in place["probability"].items() if n != "none"}
    further = {"credible_set": ["none"], "probability": {"none": 0.9, "specks": 0.04}}
    posterior = {"inclusion": inclusion, "places": places, "further": further}
    return {"verdict": verdict, "causes": causes, "posterior": posterior} | more


def record(group: str, causes: list[str], answer: dict, strengths: list[float] | None = None, **more: object) -> dict:
    strengths = strengths or [20.0] * len(causes)
    truth = {
        "id": repr((group, causes, strengths, more)), "group": group, "causes": causes, "strengths": strengths,
        "strengths_made": strengths, "noise": "plain", "drop": [], "decoy": "", "exclude": [], "cancelling": False,
        "oracle_gain": 20.0, "outside": [], "parameters": [None] * len(causes), "recipes": [False] * len(causes),
        "consequences": [{"force_N": [1.0, 5.0], "mm2": [0.1, 1.0], "percent": [1.0, 10.0], "largest": 0.1}
                         for _ in causes], "unexplainable_DN2": 1.0,
    }  # fmt: skip
    return {"truth": truth | more, "answer": answer, "seconds": 100.0}


def test_wilson_intervals_cover() -> None:
    # Exact figures: Newcombe, Stat. Med. 17 (1998) 857, table I: 81/263 and 15/148, 0/20, 1/29.
    for hits, count, low, high in (
        (81, 263, 0.2553, 0.3662),
        (15, 148, 0.0624, 0.1605),
        (0, 20, 0.0, 0.1611),
        (1, 29, 0.0061, 0.1718),
    ):
        assert wilson(hits, count) == pytest.approx((low, high), abs=6e-5)


@pytest.mark.parametrize(
    ("hits", "cases", "least", "most", "told"),
    [
        (200, 200, 0.95, None, "yes"),
        (10, 10, 0.95, None, "open, inside"),
        (9, 10, 0.95, None, "open, outside"),
        (1, 10, 0.95, None, "no"),
        (0, 10, None, 0.02, "open, inside"),
        (9, 10, None, 0.02, "no"),
        (0, 0, 0.5, None, "no case"),
    ],
)
def test_a_target_is_met_only_where_the_whole_interval_lies_within(hits, cases, least, most, told) -> None:
    assert judged(Rate(hits, cases), least=least, most=most) == told


def test_scores_of_made_up_answers() -> None:
    gain = {"held_out": {"log_score": [18.0, 10.0, 25.0]}}
    both = {"defocus": ["defocus", "lateral_glow"]}
    doubt = said("defocus", sets=both, next_measurement={"what": "a checkerboard"})
    found = summary([
        record("single", ["vignetting"], said("vignetting", "specks", **gain)),
        record("single", ["vignetting"], said("defocus"), noise="lowpass"),
        record("single", ["vignetting"], said(), [5.0]),
        record("single", ["specks"], said("specks"), [10.0]),
        record("null", [], said()),
        record("null", [], said("specks"), noise="h264"),
        record("null", [], said("compression"), noise="jpeg"),
        record("decoy", ["lateral_glow"], doubt, drop=["checkerboard"], decoy="defocus"),
        record("decoy", ["lateral_glow"], said("lateral_glow"), decoy="defocus"),
        record("double", ["creep", "modulus"], said("modulus", "creep", "specks")),
        record("double", ["creep", "tone_curve"], said("creep")),
        record("unknown", ["moire"], said(verdict="unknown"), outside=["moire"]),
        record("unknown", ["moire"], said("residue_film"), outside=["moire"], noise="lowpass"),
        record("removed", ["specks"], said("scratch", verdict="causes and unknown", p=0.6), outside=["specks"]),
    ])  # fmt: skip
    assert (found["detection"]["20"]["hits"], found["detection"]["20"]["cases"]) == (2, 2)
    assert (found["detection"]["5"]["hits"], found["detection"]["5"]["cases"]) == (0, 1)
    assert found["detection_marks"]["10"] == Rate(1, 1).as_dict()
    assert found["first_all"]["20"] == Rate(1, 2).as_dict()
    assert found["false_alarms"]["all"] == Rate(1, 3).as_dict()
    assert found["in_set"] == Rate(2, 3).as_dict()
    assert found["set_size"] == pytest.approx((2 + 1 + 1) / 3)
    decoys = found["decoys"]
    assert all(decoys[key] == Rate(1, 1).as_dict() for key in decoys)
    assert found["doubles"] == Rate(1, 2).as_dict()
    assert found["unknown"]["unknown"]["called_unknown"] == Rate(1, 2).as_dict()
    assert found["unknown"]["unknown"]["wrongly_named"] == Rate(1, 2).as_dict()
    assert found["unknown"]["removed"]["called_unknown"] == Rate(1, 1).as_dict()
    assert found["gain_named"]["median"] == pytest.approx(0.45)
    assert found["confusion"]["vignetting"] == {"vignetting": 1, "defocus": 1, "none": 1}


def test_the_likeliest_of_a_place_is_the_first_answer() -> None:
    place = said("defocus", sets={"defocus": ["defocus", "lateral_glow"]})
    shares = place["posterior"]["places"]["defocus"]["probability"]
    shares["lateral_glow"], shares["defocus"] = 0.6, 0.35
    assert top(record("single", ["lateral_glow"], place)) == "lateral_glow"
    # A cause that is there and could not be fitted is in the further place.
    further = said(verdict="causes")
    further["posterior"]["further"] = {"credible_set": ["creep"], "probability": {"creep": 0.97, "none": 0.03}}
    assert top(record("single", ["creep"], further)) == "creep"
    assert top(record("null", [], said())) == "none"


def test_a_codec_changes_at_which_strength_a_case_counts() -> None:
    assert strength(record("single", ["specks"], said(), [20.0], strengths_made=[7.4])) == 7.0


def test_a_case_that_breaks_counts_as_answered_wrongly() -> None:
    single, null = record("single", ["vignetting"], {}), record("null", [], {})
    for one in (single, null):
        one["error"] = "ValueError: no"
        del one["answer"], one["seconds"]
    found = summary([single, null, record("single", ["vignetting"], said("vignetting"), number=2)])
    assert found["detection"]["20"] == Rate(1, 2).as_dict()
    assert found["false_alarms"]["all"]["hits"] == 1
    assert found["in_set"] == Rate(1, 2).as_dict()
    assert found["confusion"]["none"] == {"error": 1}


def test_calibration_of_a_perfect_answerer_is_that_of_a_perfect_answerer() -> None:
    """Answers right as often as they say err as few cases make them; sure ones that err, far more."""
    rng = np.random.default_rng(3)

    def answers(sure: float | None) -> list[dict]:
        out = []
        for k in range(300):
            p = float(rng.uniform(0.06, 0.99))
            hidden = "creep" if rng.random() < p else "modulus"
            one = said("creep", p=p if sure is None else sure)
            out.append(record("single", [hidden], one, number=k))
        return out

    fair = calibration(answers(None))
    assert fair["pairs"] == 300
    assert 0 < fair["perfect"][0] < fair["perfect"][1]
    assert fair["error"] < 1.3 * fair["perfect"][1]
    boasting = calibration(answers(0.99))
    assert boasting["sure"]["cases"] == boasting["pairs"]
    assert boasting["sure"]["rate"] < 0.9
    assert boasting["error"] > 0.3
    assert boasting["perfect"][1] < 0.03


def test_the_score_itself_gives_chance_where_truths_are_shuffled() -> None:
    rng, names = np.random.default_rng(1), list(NAMED)
    answers = [record("single", [c], said(c), number=k) for k, c in enumerate(names * 20)]
    assert all(top(r) == r["truth"]["causes"][0] for r in answers)
    order = rng.permutation(len(answers))
    right = np.mean([top(a) == answers[o]["truth"]["causes"][0] for a, o in zip(answers, order, strict=True)])
    chance = 1 / len(names)
    assert abs(right - chance) < 4 * np.sqrt(chance / len(answers))


def test_intervals_of_parameters_and_areas_are_counted_where_a_true_cause_is_named() -> None:
    answer = said("modulus", "specks")
    answer["causes"][0] |= {
        "parameters": {"relative": {"value": 0.1, "lo": 0.05, "hi": 0.14}},
        "area": {"force_N": [1.0, 5.0], "mm2_lo": [0.0, 1.2], "mm2_hi": [1.0, 1.6]},
    }
    one = record("single", ["modulus"], answer, parameters=[["relative", 0.12]])
    found = coverage([one, record("single", ["creep"], said("modulus"))])
    assert found["parameters"] == Rate(1, 1).as_dict()
    assert found["area"] == Rate(0, 1).as_dict()  # 1.0 at the force at which it changes most


def rig_case(number: int, named: tuple[str, ...], **held: list[float]) -> dict:
    hidden, large = (
        ["modulus", "creep", "specks", "moire"],
        {"modulus": 0.2, "creep": 0.05, "specks": 0.0, "moire": 0.3},
    )
    consequences = [{"force_N": [5.0], "mm2": [1.0], "percent": [100 * large[c]], "largest": large[c]} for c in hidden]
    answer = said(*named, verdict="causes and unknown", held_out=held)
    for cause in answer["causes"]:
        cause["area"] = {"force_N": [5.0], "percent": [-4.0], "mm2_lo": [0.5], "mm2_hi": [1.5]}
    return record("rig", hidden, answer, consequences=consequences, outside=["moire"], number=number)


def test_rigs_are_scored_by_consequence_and_by_what_could_be_explained() -> None:
    held = {"rms_DN": [3.0, 1.5], "area_error_percent": [8.0, 2.0], "log_score": [900.0, 1.0, 2.0]}
    found = rigs([rig_case(1, ("modulus", "defocus"), **held), rig_case(2, ("modulus", "creep"), **held)])
    # 0.2 + 0.25 of 2 x 0.25 is named; what is outside the library is nobody's to name.
    assert found["recall"][0] == pytest.approx(0.45 / 0.5)
    assert found["precision"][0] == pytest.approx(0.45 / (0.45 + 0.04))
    assert found["misfit_removed"][0] == pytest.approx((9 - 2.25) / (9 - 1))
    assert found["area_error_ratio"][0] == pytest.approx(0.25)
    assert found["named"] == Rate(3, 6).as_dict()
    assert found["unknown_said"] == Rate(2, 2).as_dict()
    gross = record("rig", ["modulus"], {"verdict": "another rig", "causes": []})
    assert rigs([gross])["misfit_removed"][0] == 0.0
    assert rigs([gross])["area_error_ratio"][0] == 1.0


def some() -> list[dict]:
    beside = {"beside": {"matched-filters": said("defocus")}}
    return [
        record("null", [], said()) | beside,
        record("null", [], said("defocus"), noise="h264") | beside,
        record("single", ["vignetting"], said("vignetting"), [7.0]) | beside,
        record("single", ["vignetting"], said("defocus")) | beside,
        record("removed", ["defocus"], said(verdict="unknown"), outside=["defocus"]),
        rig_case(1, ("modulus",), rms_DN=[3.0, 1.5], area_error_percent=[8.0, 2.0]),
        {"truth": {"id": "0006", "group": "single"}, "skipped": "out of reach"},
    ]


def test_table_counts_what_was_judged_beside_target_and_old_figure(tmp_path: Path) -> None:
    path = tmp_path / "run.jsonl"
    path.write_text("".join(json.dumps(r) + "\n" for r in some()) + '{"cut off')
    records = read([path])
    assert len(records) == 6  # what is out of reach was not judged
    lines = {line.split("|")[1].strip(): [c.strip() for c in line.split("|")[2:]]
             for line in markdown(records, None).splitlines() if line.startswith("|")}  # fmt: skip
    assert lines["false alarms at 1 %"][:2] == ["at most 2 %", "3.7 % (82)"]
    assert "(1/2)" in lines["false alarms at 1 %"][2]
    assert "(1/1)" in lines["detection at 7, no codec, no marks"][2]
    assert lines["first answer right at 20, all"][3] == "no"
    assert "first answer right at 20, isolable" not in lines
    known = {"vignetting": {"nearest": "defocus", "sine2": 0.05}}  # 7^2 * 0.05 is less than 9, 20^2 * 0.05 more
    rows = [line for line in markdown(records, known).splitlines() if "isolable" in line]
    assert next(line for line in rows if "at 7," in line).split("|")[5].strip() == "no case"
    assert "(0/1)" in next(line for line in rows if "at 20," in line)
    assert lines["rigs: held-out area error after over before, median"][3] == "yes"
    assert "(2/2)" in lines["matched-filters"][0]
    assert "(0/2)" in lines["matched-filters"][1]
    assert "(2/2)" in lines["matched-filters"][2]
    assert "**vignetting** 1" in lines["vignetting"][0]
    assert "defocus 1" in lines["vignetting"][0]


def test_picture_is_drawn(tmp_path: Path) -> None:
    picture([r for r in some() if "answer" in r], None, tmp_path / "run.png")
    assert (tmp_path / "run.png").stat().st_size > 20_000


def test_kept_tables_are_those_of_kept_runs() -> None:
    """What docs/criticism/challenge.md shows is what its command prints."""
    runs = Path(__file__).parents[2] / "docs" / "criticism" / "runs"
    page = (runs.parent / "challenge.md").read_text(encoding="utf-8")
    shown = re.findall(r"{include} runs/(scored-\w+)\.txt", page)
    assert shown
    for name in shown:
        assert markdown(read([runs / f"{name}.jsonl.gz"]), None) == (runs / f"{name}.txt").read_text(encoding="utf-8")
