"""Table of targets and picture of a run: ``python -m tests.inference.challenge.report RUN.jsonl``.

What it writes is a function of the kept outcomes and of the kept table of what is isolable.
"""

from __future__ import annotations

import argparse
import gzip
import json
import math
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure

from .cases import COMPRESSED, PLAIN
from .score import SURE, Rate, Record, alarmed, expected, rate, summary, top


class Row(NamedTuple):
    """A line of the table: what, its target, the old critic's figure, what came out, and whether the target is met.

    Figures of the old critic are those of its runs h to o (docs/criticism/runs/tables.txt), by its own cases.
    """

    what: str
    target: str
    old: str
    found: str
    met: str


def read(paths: Sequence[Path]) -> list[dict[str, Any]]:
    """Return the last outcome of every case that was judged."""
    latest = {}
    for path in paths:
        opened = gzip.open if path.suffix == ".gz" else open
        with opened(path, "rt", encoding="utf-8") as stream:
            lines = stream.read().splitlines()
        for line in lines:
            try:
                record = json.loads(line)
            except ValueError:
                continue  # cut off
            if "skipped" not in record:
                latest[record["truth"]["id"]] = record
    return list(latest.values())


NOTHING: Mapping[str, Any] = {"hits": 0, "cases": 0}
"""A rate of which there is no case: its row stands in the table all the same."""


def judged(found: Mapping[str, Any] | Rate, least: float | None = None, most: float | None = None) -> str:
    """Tell by Wilson's interval whether a target is met: ``yes``, ``no``, or open with the side of the rate itself."""
    share = found if isinstance(found, Rate) else Rate(found["hits"], found["cases"])
    if not share.cases:
        return "no case"
    low, high = share.interval
    above = least is None or low >= least, most is None or high <= most
    if all(above):
        return "yes"
    if (least is not None and high < least) or (most is not None and low > most):
        return "no"
    inside = (least is None or share.value >= least) and (most is None or share.value <= most)
    return "open, inside" if inside else "open, outside"


def ruled(
    what: str, entry: Mapping[str, Any], old: str = "", *, least: float | None = None, most: float | None = None
) -> Row:
    """Return a rate's row."""
    goal = f"at least {100 * least:.0f} %" if least else f"at most {100 * most:.0f} %" if most else ""
    found = Rate(entry["hits"], entry["cases"])
    return Row(what, goal, old, str(found), judged(found, least, most) if goal else "")


def measured(
    what: str, value: float, text: str, old: str = "", *, least: float | None = None, most: float | None = None
) -> Row:
    """Return the row of a number that is no rate."""
    goal = f"at least {least:g}" if least is not None else f"at most {most:g}" if most is not None else ""
    if math.isnan(value):
        return Row(what, goal, old, "no case", "no case" if goal else "")
    met = (least is None or value >= least) and (most is None or value <= most)
    return Row(what, goal, old, text, ("yes" if met else "no") if goal else "")


OLD_FIRST = {"5": "25 % (16)", "7": "40 % (20)", "10": "52 % (27)", "20": "79 % (19)", "40": "83 % (18)"}
OLD_FOUND = {"5": "57 % *", "7": "67 % *", "10": "95 % *"}
"""Of causes that are no marks, uncompressed; * from a summary of which no run is kept."""


def rows(found: Mapping[str, Any]) -> Iterator[Row]:
    """Yield the table of targets from :func:`score.summary`."""
    old_alarms = {"plain": "0/18", "lowpass": "1/20", "h264": "1/18", "h264-strong": "1/9", "jpeg": "0/17"}
    alarms = found["false_alarms"]
    yield ruled("false alarms at 1 %", alarms["all"], "3.7 % (82)", most=0.02)
    for noise in (*PLAIN, *COMPRESSED):
        yield ruled(f"false alarms, {noise}", alarms.get(noise, NOTHING), old_alarms[noise], most=0.03)
    goals = {"5": 0.80, "7": 0.95, "10": 0.99}
    for s in ("5", "7", "10", "20", "40"):
        entry = found["detection"].get(s, NOTHING)
        yield ruled(f"detection at {s}, no codec, no marks", entry, OLD_FOUND.get(s, ""), least=goals.get(s))
    for s in ("5", "7", "10", "20", "40"):
        old, goal = (".15 of 7 to 10 *", 0.85) if s == "10" else ("", None)
        yield ruled(f"marks detected at {s}, full pixels", found["detection_marks"].get(s, NOTHING), old, least=goal)
    goals = {"7": 0.80, "10": 0.90, "20": 0.95}
    apart = found["first_isolable"]
    for s in ("5", "7", "10", "20", "40"):
        kind, entry = ("all", found["first_all"]) if apart is None else ("isolable", apart)
        yield ruled(f"first answer right at {s}, {kind}", entry.get(s, NOTHING), OLD_FIRST[s], least=goals.get(s))
    for s, entry in (found["first_all"] if apart is not None else {}).items():
        yield ruled(f"first answer right at {s}, all", entry)
    for kind, entry in found["first_by_forms"].items():
        yield ruled(f"first answer right at 7 and above, {kind}", entry)
    yield ruled("95 % sets hold the truth at 7 and above", found["in_set"], "65 % (95)", least=0.95)
    yield measured("their mean size", found["set_size"], f"{found['set_size']:.2f}", "1.26", most=1.6)
    decoys = found["decoys"]
    yield ruled("decoys without the shot: a set", decoys["answered_as_set_without_the_shot"], "36 % (14)", least=0.9)
    yield ruled("decoys without the shot: that shot advised", decoys["right_shot_advised"], "36 % (14)")
    yield ruled("decoys with the shot: told apart", decoys["separated_with_the_shot"], "56 % (18)")
    yield ruled("doubles: both named", found["doubles"], "61 % (18; among the first three)")
    entry = found["unknown"]["unknown"]
    yield ruled(
        "15 families outside the library: unknown", entry["called_unknown"], "39 % (18; 8 families)", least=0.75
    )
    yield ruled("taken out of the library: unknown", found["unknown"]["removed"]["called_unknown"], "58 % (12)")
    yield ruled(f"outside the library: a name with p >= {SURE:g}", entry["wrongly_named"])
    error = found["calibration"]
    (mean, upper), value = error["perfect"], error["error"]
    text = f"{value:.3f}; perfect answerer {mean:.3f}, 95 % of them below {upper:.3f} ({error['pairs']} probabilities)"
    yield measured("ECE of inclusion less a perfect answerer's", value - mean, text, "0.14 (first answers)", most=0.03)
    yield ruled(f"causes given {SURE:g} and more: there", error["sure"])
    yield ruled("the same without a codec", found["sure_plain"])
    gain, right = found["gain"], found["gain_named"]
    for what, own, old, goal in (("all", gain, "0.41", 0.85), ("rightly named", right, "0.69 *", None)):
        text = (
            "median {median:.2f}, 10 % to 90 %: {p10:.2f} to {p90:.2f} ({cases})".format(**own) if own["cases"] else ""
        )
        yield measured(f"held-out gain over the oracle's, {what}", own.get("median", math.nan), text, old, least=goal)
    yield ruled("90 % intervals of parameters hold the truth", found["intervals"]["parameters"], "91 % (11)")
    yield ruled("90 % intervals of areas hold the truth", found["intervals"]["area"])
    yield from _rig_rows(found["rig"])
    seconds = found["seconds"]
    if seconds["cases"]:
        text = f"median {seconds['median']:.0f}, 90 % within {seconds['p90']:.0f}, two cases side by side"
        yield Row("seconds a case", "60 on both cores, alone", "113", text, "")


def _rig_rows(found: Mapping[str, Any]) -> Iterator[Row]:
    """Yield the rows of the group with many causes."""
    goals = (
        ("recall", "rigs: recall, weighed by consequence", {"least": 0.9}),
        ("precision", "rigs: precision, weighed by consequence", {"least": 0.9}),
        ("misfit_removed", "rigs: explainable held-out misfit removed, median", {"least": 0.9}),
        ("area_error_ratio", "rigs: held-out area error after over before, median", {"most": 0.35}),
    )
    for key, what, goal in goals:
        value, low, high = found.get(key, [math.nan] * 3)
        yield measured(what, value, f"{value:.2f} [{low:.2f}, {high:.2f}] ({found['cases']})", **goal)
    if found["cases"]:
        yield ruled("rigs: causes named", found["named"])
        yield ruled("rigs: names that are right", found["named_right"])
        yield ruled("rigs: area better on held-out frames", found["area_better"])
        yield ruled("rigs: unknown said where there is one", found["unknown_said"])
        yield ruled("rigs: unknown said where there is none", found["unknown_said_without"])
        yield ruled("rigs: 90 % intervals of parameters", found["intervals"]["parameters"])
        yield ruled("rigs: 90 % intervals of areas", found["intervals"]["area"])


def beside(records: Sequence[Record]) -> Iterator[tuple[str, Rate, Rate, Rate]]:
    """Yield the critic and the baselines on the same bundles: detected, first answer right, false alarms."""
    same = [r for r in records if r.get("beside") and "error" not in r]
    names = sorted(set.intersection(*(set(r["beside"]) for r in same))) if same else []
    strong = [r for r in same if r["truth"]["group"] == "single" and r["truth"]["strengths"][0] >= 7]
    nulls = [r for r in same if r["truth"]["group"] == "null"]
    for name in ("the critic", *names):
        ours, none = ([r if name == "the critic" else {**r, "answer": r["beside"][name]} for r in some]
                      for some in (strong, nulls))  # fmt: skip
        right = rate(top(r) == expected(r["truth"]) for r in ours)
        yield name, rate(map(alarmed, ours)), right, rate(map(alarmed, none))


def markdown(records: Sequence[Record], known: Mapping[str, Any] | None) -> str:
    """Return the tables of a run."""
    found = summary(records, known)
    out = [f"{found['cases']} cases, {len(found['failed'])} of them broken.", ""]
    out += ["| | target | old critic | found, Wilson's 95 % interval | met |", "|---|---|---|---|---|"]
    out += [f"| {' | '.join(row)} |" for row in rows(found)]
    compared = list(beside(records))
    if len(compared) > 1:
        out += ["", "| same bundles, singles of 7 and above | detected | first answer right | false alarms |"]
        out += ["|---|---|---|---|", *(f"| {' | '.join(map(str, row))} |" for row in compared)]
    out += ["", "| hidden | first answers |", "|---|---|"]
    for name, counts in found["confusion"].items():
        said = ", ".join(f"{'**' if k == name else ''}{k}{'**' if k == name else ''} {n}" for k, n in counts.items())
        out.append(f"| {name} | {said} |")
    if found["failed"]:
        out += ["", "Broken: " + "; ".join(f"{k} {v}" for k, v in found["failed"].items())]
    return "\n".join(out) + "\n"


def picture(records: Sequence[Record], known: Mapping[str, Any] | None, path: Path) -> None:
    """Draw the curves by strength, the confusion of first answers, and what probabilities are worth."""
    found = summary(records, known)
    figure = Figure(figsize=(15, 7.6), layout="constrained")
    left, right = figure.subfigures(1, 2, width_ratios=(1, 1.55))
    curve, worth = left.subplots(2, 1)
    for key, text, colour, shift in (
        ("detection_all", "something is found", "#1f77b4", 0.98),
        ("first_isolable", "first answer right, isolable causes", "#d62728", 1.02),
        ("first_all", "first answer right", "#d62728", 1.02),
    ):
        entries = found[key] if (key != "first_all" or found["first_isolable"] is None) else None
        if entries is None:
            continue
        strength = np.array([float(k) for k in entries]) * shift
        share = np.array([e["rate"] for e in entries.values()])
        low, high = (np.array([e[k] for e in entries.values()]) for k in ("lo", "hi"))
        bars = np.maximum([share - low, high - share], 0.0)
        curve.errorbar(strength, 100 * share, 100 * bars, fmt="o-", color=colour, capsize=3, label=text)
        for x, y, entry in zip(strength, share, entries.values(), strict=True):
            curve.annotate(
                f"{entry['cases']}", (x, 100 * y), (4, -9), textcoords="offset points", color=colour, fontsize=7
            )
    curve.set(xscale="log", xticks=(5, 7, 10, 20, 40), xticklabels=(5, 7, 10, 20, 40), ylim=(0, 103),
              xlabel="strength: whitened norm of the hidden change [1]", ylabel="share of cases [%]",
              title="single causes; Wilson's 95 %, numbers are cases")  # fmt: skip
    curve.minorticks_off()
    curve.legend(loc="lower right", fontsize=8)
    table = found["calibration"]["table"]
    shares, entries = [row["said"] for row in table], [row["right"] for row in table]
    share = np.array([e["rate"] for e in entries])
    bars = np.maximum([share - [e["lo"] for e in entries], [e["hi"] for e in entries] - share], 0.0)
    worth.plot([0, 1], [0, 1], color="0.7")
    worth.errorbar(shares, share, bars, fmt="o", color="#2ca02c", capsize=3)
    for x, y, entry in zip(shares, share, entries, strict=True):
        worth.annotate(f"{entry['cases']}", (x, y), (5, -9), textcoords="offset points", fontsize=7)
    worth.set(xlabel="probability of inclusion [1]", ylabel="share that is there [1]", xlim=(0, 1.03),
              ylim=(0, 1.03), title=f"calibration: expected error {found['calibration']['error']:.3f}, "
              f"a perfect answerer's {found['calibration']['perfect'][0]:.3f}")  # fmt: skip
    _confusion(right.subplots(), found["confusion"])
    figure.savefig(path, dpi=110)


def _confusion(axis: Any, confusion: Mapping[str, Mapping[str, int]]) -> None:
    truths = list(confusion)
    answers = sorted({a for counts in confusion.values() for a in counts} - set(truths) - {"unknown"})
    columns = [*truths, *answers] + ["unknown"] * ("unknown" not in truths)
    grid = np.array([[confusion[t].get(a, 0) for a in columns] for t in truths], float)
    share = grid / np.maximum(grid.sum(1, keepdims=True), 1)
    axis.imshow(share, cmap="Blues", vmin=0, vmax=1, aspect="auto")
    for (row, column), count in np.ndenumerate(grid):
        if count:
            colour = "white" if share[row, column] > 0.6 else "black"
            axis.text(column, row, f"{count:.0f}", ha="center", va="center", color=colour, fontsize=7)
    axis.set_xticks(range(len(columns)), columns, rotation=90, fontsize=7)
    axis.set_yticks(range(len(truths)), truths, fontsize=7)
    axis.set(xlabel="first answer", ylabel="hidden", title="first answers, one cause at the most: number of cases")


def main(arguments: list[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m tests.inference.challenge.report", description=__doc__)
    parser.add_argument("runs", nargs="+", type=Path)
    parser.add_argument("--isolable", type=Path, help="table of isolable.table, as JSON")
    parser.add_argument("--markdown", type=Path, help="file to write; standard output by default")
    parser.add_argument("--picture", type=Path)
    given = parser.parse_args(arguments)
    records = read(given.runs)
    known = json.loads(given.isolable.read_text(encoding="utf-8")) if given.isolable else None
    text = markdown(records, known)
    if given.markdown:
        given.markdown.write_text(text, encoding="utf-8")
    else:
        sys.stdout.write(text)
    if given.picture:
        picture(records, known, given.picture)
    return 0


if __name__ == "__main__":
    sys.exit(main())
