"""The table of targets: what it says of rates, and that the one in the docs is that of the kept outcomes."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from challenge.report import judged, main, markdown, picture, read
from challenge.score import Rate, summary
from evanesce.prediction.frozen import FROZEN

DOCS = Path(__file__).resolve().parents[2] / "docs"
RUNS = DOCS / "criticism" / "runs"
RUN = RUNS / "scored-o.jsonl"
TOGETHER = [RUNS / f"scored-{name}.jsonl" for name in "hijklmno"]


def record(number: int, group: str, causes: list[str], strengths: list[float], answer: dict, **more: object) -> dict:
    truth = {
        "id": f"{number:04d}", "group": group, "causes": causes, "strengths": strengths, "noise": "plain", "drop": [],
        "decoy": "", "exclude": [], "cancelling": False, "oracle_gain": 8.0, "amplitudes": [0.1], "set": "scored",
        "number": number,
    }  # fmt: skip
    effects = [{"id": name, "parameters": {}} for name in answer.pop("named", [])]
    said = {"verdict": "none", "probabilities": {"none": 1.0}, "ambiguous_with": [], "effects": effects} | answer
    return {"truth": truth | more, "answer": said, "seconds": 100.0}


def some() -> list[dict]:
    named = {"verdict": "named", "named": ["vignetting"], "probabilities": {"vignetting": 0.9, "none": 0.1}}
    wrong = {"verdict": "named", "named": ["defocus"], "probabilities": {"defocus": 0.95, "unknown": 0.05}}
    beside = {"beside": {"chi-square": {"verdict": "unknown", "probabilities": {"unknown": 1.0}}}}
    return [
        record(1, "null", [], [], {}) | beside,
        record(2, "null", [], [], dict(wrong), noise="h264") | beside,
        record(3, "single", ["vignetting"], [7.0], dict(named)) | beside,
        record(4, "single", ["vignetting"], [20.0], dict(wrong)) | beside,
        record(5, "removed", ["defocus"], [15.0], {"verdict": "unknown", "probabilities": {"unknown": 0.9}}),
        {"truth": {"id": "0006", "group": "single"}, "skipped": "out of reach"},
    ]


def test_odds_against_a_loud_name_are_those_of_the_kept_runs() -> None:
    """What ``mimic`` rests on: names of a probability above 0.8, and how many of them were right."""
    right = wrong = 0
    for run in "hijklm":
        for line in (RUNS / f"scored-{run}.jsonl").read_text().splitlines():
            kept = json.loads(line)
            truth, answer = kept["truth"], kept.get("answer") or {}
            probabilities = answer.get("probabilities") or {"none": 1.0}
            first = max(probabilities, key=lambda name: probabilities[name])
            loud = first not in ("none", "unknown") and probabilities[first] > 0.8 and answer["verdict"] != "none"
            if loud and truth["group"] != "double":
                known = truth["group"] in ("single", "decoy") and first in truth["causes"]
                right, wrong = right + known, wrong + (not known)
    assert (right, wrong) == (55, 14)
    assert FROZEN.priors["mimic"] == pytest.approx(wrong / right, abs=0.01)


@pytest.mark.parametrize(
    ("hits", "cases", "least", "most", "said"),
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
def test_a_target_is_met_only_where_the_whole_interval_lies_within(hits, cases, least, most, said) -> None:
    assert judged(Rate(hits, cases), least=least, most=most) == said


def test_table_counts_what_was_judged_and_keeps_codecs_apart(tmp_path: Path) -> None:
    path = tmp_path / "run.jsonl"
    path.write_text("".join(json.dumps(r) + "\n" for r in some()))
    records = read([path])
    assert len(records) == 5  # what is out of reach was not judged
    lines = {line.split("|")[1].strip(): line for line in markdown(records, None).splitlines() if line.startswith("|")}
    assert "50.0 %" in lines["false alarms"]
    assert "(1/2)" in lines["false alarms"]
    assert "(0/1)" in lines["false alarms"].split("|")[-2]
    assert "(1/1)" in lines["detection, SNR 7"]
    assert "(0/1)" in lines["first answer right, isolable causes, SNR 20"]
    assert lines["first answer right, isolable causes, SNR 20"].split("|")[4].strip() == "no"
    assert "(1/1)" in lines["taken out of the library, SNR 15: `unknown`"]
    assert "50.0 %" in lines["the critic"]
    assert "(2/2)" in lines["chi-square"].split("|")[3]
    assert "**vignetting** 1" in lines["vignetting"]
    assert "defocus 1" in lines["vignetting"]


def test_two_causes_that_nobody_saw_are_not_among_the_first_three() -> None:
    """Where nothing is said to be wrong some pair of names is always the likeliest."""
    shares = {"probabilities": {"none": 0.7, "defocus": 0.2, "vignetting": 0.1}}
    missed = record(1, "double", ["vignetting", "defocus"], [10.0, 10.0], dict(shares))
    named = record(2, "double", ["vignetting", "defocus"], [10.0, 10.0], {**shares, "verdict": "named"})
    assert summary([missed, named])["doubles"]["False"] == Rate(1, 2).as_dict()


def test_picture_is_drawn(tmp_path: Path) -> None:
    picture(read_some(tmp_path), None, tmp_path / "run.png")
    assert (tmp_path / "run.png").stat().st_size > 20_000


def read_some(folder: Path) -> list[dict]:
    path = folder / "run.jsonl"
    path.write_text("".join(json.dumps(r) + "\n" for r in some()))
    return read([path])


def test_the_run_of_the_table_is_one_critics_with_the_thresholds_of_today() -> None:
    """Frozen: one commit, and one digest, which is that of the thresholds that users get; nothing stripped or spent."""
    records = [json.loads(line) for line in RUN.read_text(encoding="utf-8").splitlines()]
    assert len({r["commit"] for r in records}) == 1
    assert not records[0]["commit"].endswith("+changes")
    assert {r["strip"] for r in records} == {""}
    assert {r["answer"]["frozen_sha256"] for r in records if "answer" in r} == {FROZEN.digest}
    before = {
        json.loads(line)["truth"]["id"]
        for path in RUNS.glob("scored-*.jsonl")
        if path.name < RUN.name
        for line in path.read_text(encoding="utf-8").splitlines()
    }
    assert not before & {r["truth"]["id"] for r in records}


@pytest.mark.parametrize(("name", "runs"), [("table", [RUN]), ("together", TOGETHER)])
def test_the_docs_hold_the_tables_of_the_kept_outcomes(name: str, runs: list[Path], tmp_path: Path) -> None:
    text = (RUNS / "tables.txt").read_text(encoding="utf-8")
    begin, end = f"<!-- {name}: begin -->\n", f"<!-- {name}: end -->"
    shown = text[text.index(begin) + len(begin) : text.index(end)]
    made = tmp_path / "table.md"
    scored = *map(str, runs), "--isolable", str(RUNS / "isolable-scored.json")
    assert main([*scored, "--markdown", str(made)]) == 0
    assert shown.strip() == made.read_text(encoding="utf-8").strip()
