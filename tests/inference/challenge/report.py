"""Table of targets and picture of a run: ``python -m tests.criticism.challenge.report RUN.jsonl``.

What it writes is a function of the kept outcomes and of the kept table of what is isolable, so that a test can make it
again and compare (`tests/criticism/test_challenge_report.py`).
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure

from .score import Rate, Record, alarmed, expected, rate, summary, top

NOISE = ("plain", "lowpass", "h264", "h264-strong", "jpeg")


class Row(NamedTuple):
    """A line of the table: what, its target, what came out, and whether the target is met."""

    what: str
    target: str
    found: str
    met: str


def read(paths: Sequence[Path]) -> list[dict[str, Any]]:
    """Return the last outcome of every case that was judged."""
    latest = {}
    for path in paths:
        for line in path.read_text(encoding="utf-8").splitlines():
            record = json.loads(line)
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


def show(entry: Mapping[str, Any] | Rate) -> str:
    """Return a rate with its interval and counts."""
    share = entry if isinstance(entry, Rate) else Rate(entry["hits"], entry["cases"])
    return str(share)


def joined(entries: Sequence[Mapping[str, Any]]) -> Rate:
    """Return the rate over several groups together."""
    return Rate(sum(e["hits"] for e in entries), sum(e["cases"] for e in entries))


def rows(found: Mapping[str, Any]) -> Iterator[Row]:
    """Yield the table of targets from :func:`score.summary`."""
    alarms = found["false_alarms"]
    yield Row("false alarms", "at most 2 %", show(alarms["all"]), judged(alarms["all"], most=0.02))
    for noise in NOISE:
        entry = alarms.get(noise, NOTHING)
        yield Row(f"false alarms, {noise}", "at most 3 %", show(entry), judged(entry, most=0.03))
    yield Row("nulls whose p is below 0.01, at whatever level it counts", "1 %", show(found["null_p"]), "")
    for key, text, least in (
        ("detection", "detection", {"4": 0.65, "5": 0.90, "7": 0.98}),
        ("top1_isolable", "first answer right, isolable causes", {"7": 0.85, "10": 0.90, "20": 0.95}),
    ):
        for strength, entry in found[key].items():
            goal = least.get(strength)
            target = "" if goal is None else f"{100 * goal:.0f} %"
            yield Row(f"{text}, SNR {strength}", target, show(entry), judged(entry, least=goal) if goal else "")
    for strength, entry in found["top1_all"].items():
        yield Row(f"first answer right, all causes, SNR {strength}", "", show(entry), "")
    in_set, size = found["in_set"], found["set_size"]
    yield Row("truth in the reported set, SNR 7 and above", "95 %", show(in_set), judged(in_set, least=0.95))
    yield Row("mean size of the set", "at most 1.5", f"{size:.2f}", "" if math.isnan(size) else _plain(size <= 1.5))
    found_size = found["set_size_found"]
    yield Row("the same of answers that name something", "", f"{found_size:.2f}", "")
    decoys = found["decoys"]
    for key, text, least in (
        ("answered_as_set_without_the_shot", "decoys without the shot: answered as a set", 0.95),
        ("right_shot_advised", "decoys without the shot: the separating shot advised", 0.90),
        ("separated_with_the_shot", "decoys with the shot: told apart", 0.90),
    ):
        yield Row(text, f"{100 * least:.0f} %", show(decoys[key]), judged(decoys[key], least=least))
    doubles = joined(list(found["doubles"].values()))
    yield Row("doubles: both in the first three", "80 %", show(doubles), judged(doubles, least=0.8))
    for cancel, text in (("False", "that do not cancel"), ("True", "of which one takes from the other")):
        yield Row(f"doubles {text}", "", show(found["doubles"].get(cancel, NOTHING)), "")
    for key, text in (("unknown", "outside the library"), ("removed", "taken out of the library")):
        entry = found["unknown"][key]["called_unknown"]
        yield Row(f"{text}, SNR 15: `unknown`", "90 %", show(entry), judged(entry, least=0.9))
    wrong = joined([found["unknown"][key]["wrongly_named"] for key in ("unknown", "removed")])
    yield Row("of both: a wrong name with p > 0.8", "at most 5 %", show(wrong), judged(wrong, most=0.05))
    error, spread = found["calibration"]["error"], found["calibration"]["cases"]
    yield Row("expected calibration error", "at most 0.05", f"{error:.3f} ({spread} cases)", _plain(error <= 0.05))
    covers = found["intervals"]["all"]
    yield Row("90 % intervals that cover", "86 to 94 %", show(covers), judged(covers, least=0.86, most=0.94))
    for key, text, least in (("named", "held-out gain over the oracle's, causes of the library, missed ones too", 0.9),
                             ("unknown", "held-out gain over the oracle's, unknowns", 0.6)):  # fmt: skip
        entry = found["gain"].get(key, {"cases": 0})
        if not entry["cases"]:
            yield Row(text, f"{least:g}", "no case", "no case")
            continue
        text_found = f"median {entry['median']:.2f}, 10 % to 90 %: {entry['p10']:.2f} to {entry['p90']:.2f}"
        yield Row(text, f"{least:g}", f"{text_found} ({entry['cases']} cases)", _plain(entry["median"] >= least))
    null = found["gain"]["null_interval_above_0"]
    yield Row("nulls whose gain's interval lies above 0", "at most 2.5 %", show(null), judged(null, most=0.025))
    seconds = found["seconds"]
    if seconds["cases"]:
        yield Row("elapsed seconds a case, two side by side on two cores, each on one", "60 s a case on two cores",
                  f"median {seconds['median']:.0f}, so one in {seconds['median'] / 2:.0f} s; "
                  f"within 60 s {show(found['within_60_s'])}", _plain(seconds["median"] <= 60))  # fmt: skip


def _plain(met: bool) -> str:
    return "yes" if met else "no"


def beside(records: Sequence[Record]) -> Iterator[Row]:
    """Yield lines that compare the critic with the baselines that saw the same bundles."""
    same = [r for r in records if r.get("beside") and "error" not in r]
    names = sorted(set.intersection(*(set(r["beside"]) for r in same))) if same else []
    loud = [r for r in same if r["truth"]["group"] == "single" and r["truth"]["strengths"][0] >= 7]
    nulls = [r for r in same if r["truth"]["group"] == "null"]
    for name in ("the critic", *names):
        seen = [r if name == "the critic" else {**r, "answer": r["beside"][name]} for r in (*loud, *nulls)]
        right = rate(top(r) == expected(r["truth"]) for r in seen[: len(loud)])
        yield Row(name, show(right), show(rate(alarmed(r) for r in seen[len(loud) :])), "")


def markdown(records: Sequence[Record], known: Mapping[str, Any] | None) -> str:
    """Return the tables of a run."""
    found = summary(records, known)
    out = [f"{found['cases']} cases, {len(found['failed'])} of them broken.", ""]
    raw = [r for r in records if r["truth"]["noise"] in ("plain", "lowpass")]
    without = {row.what: row.found for row in rows(summary(raw, known))}
    out += ["| | target | found, Wilson's 95 % interval | met | the same where nothing was compressed |"]
    out += ["|---|---|---|---|---|"]
    out += [f"| {' | '.join(row)} | {without.get(row.what, '')} |" for row in rows(found)]
    compared = list(beside(records))
    if len(compared) > 1:
        out += ["", "| same bundles | first answer right, singles of SNR 7 and above | false alarms |", "|---|---|---|"]
        out += [f"| {row.what} | {row.target} | {row.found} |" for row in compared]
    out += ["", "| hidden | first answers |", "|---|---|"]
    for name, counts in found["confusion"].items():
        said = ", ".join(f"{'**' if k == name else ''}{k}{'**' if k == name else ''} {n}" for k, n in counts.items())
        out.append(f"| {name} | {said} |")
    return "\n".join(out) + "\n"


def picture(records: Sequence[Record], known: Mapping[str, Any] | None, path: Path) -> None:
    """Draw the curves by strength, the confusion of first answers, and what probabilities are worth."""
    found = summary(records, known)
    figure = Figure(figsize=(15, 7.6), layout="constrained")
    left, right = figure.subfigures(1, 2, width_ratios=(1, 1.55))
    curve, worth = left.subplots(2, 1)
    for key, text, colour, shift in (
        ("detection", "something is found", "#1f77b4", 0.98),
        ("top1_isolable", "first answer right, isolable causes", "#d62728", 1.02),
    ):
        entries = found[key]
        strength = np.array([float(k) for k in entries]) * shift
        share = np.array([e["rate"] for e in entries.values()])
        low, high = (np.array([e[k] for e in entries.values()]) for k in ("lo", "hi"))
        bars = np.maximum([share - low, high - share], 0.0)
        curve.errorbar(strength, 100 * share, 100 * bars, fmt="o-", color=colour, capsize=3, label=text)
        for x, y, entry in zip(strength, share, entries.values(), strict=True):
            curve.annotate(
                f"{entry['cases']}", (x, 100 * y), (4, -9), textcoords="offset points", color=colour, fontsize=7
            )
    curve.set(xscale="log", xticks=(4, 5, 7, 10, 20, 40), xticklabels=(4, 5, 7, 10, 20, 40), ylim=(0, 103),
              xlabel="strength: whitened norm of the hidden change [1]", ylabel="share of cases [%]",
              title="single causes; Wilson's 95 %, numbers are cases")  # fmt: skip
    curve.minorticks_off()
    curve.legend(loc="lower right", fontsize=8)
    table = found["calibration"]["table"]
    said, entries = [row["said"] for row in table], [row["right"] for row in table]
    share = np.array([e["rate"] for e in entries])
    bars = np.maximum([share - [e["lo"] for e in entries], [e["hi"] for e in entries] - share], 0.0)
    worth.plot([0, 1], [0, 1], color="0.7")
    worth.errorbar(said, share, bars, fmt="o", color="#2ca02c", capsize=3)
    for x, y, entry in zip(said, share, entries, strict=True):
        worth.annotate(f"{entry['cases']}", (x, y), (5, -9), textcoords="offset points", fontsize=7)
    worth.set(xlabel="probability of the likeliest answer [1]", ylabel="share that is right [1]", xlim=(0, 1.03),
              ylim=(0, 1.03), title=f"calibration: expected error {found['calibration']['error']:.3f}")  # fmt: skip
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
    axis.set(xlabel="first answer", ylabel="hidden", title="first answers, doubles left out: number of cases")


def main(arguments: list[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m tests.criticism.challenge.report", description=__doc__)
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
