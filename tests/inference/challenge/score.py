"""Scores of a run: rates with Wilson's intervals, curves by strength, confusion, calibration, sets, gain."""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

Record = Mapping[str, Any]

LEVEL = 0.01
BROKEN = "error"
BINS = 10
LEAST_ORACLE_NAT = 2.0
"""Below, the truth itself gains too little on the frames held back to take a share of it."""


@dataclass(frozen=True)
class Rate:
    """A share of cases with its interval.

    Attributes
    ----------
    hits, cases : int
    """

    hits: int
    cases: int

    @property
    def value(self) -> float:
        return self.hits / self.cases if self.cases else math.nan

    @property
    def interval(self) -> tuple[float, float]:
        return wilson(self.hits, self.cases)

    def as_dict(self) -> dict[str, Any]:
        low, high = self.interval
        return {"hits": self.hits, "cases": self.cases, "rate": self.value, "lo": low, "hi": high}

    def __str__(self) -> str:
        if not self.cases:
            return "no case"
        low, high = self.interval
        return f"{100 * self.value:.1f} % [{100 * low:.1f}, {100 * high:.1f}] ({self.hits}/{self.cases})"


def wilson(hits: int, cases: int, z: float = 1.959963985) -> tuple[float, float]:
    """Return Wilson's 95 % interval of a share.

    References
    ----------
    Wilson, "Probable inference, the law of succession, and statistical inference", J. Am. Stat. Assoc. 22 (1927) 209.
    """
    if cases == 0:
        return 0.0, 1.0
    share, z2 = hits / cases, z * z
    centre = (share + z2 / (2 * cases)) / (1 + z2 / cases)
    half = z * math.sqrt(share * (1 - share) / cases + z2 / (4 * cases * cases)) / (1 + z2 / cases)
    return max(0.0, centre - half), min(1.0, centre + half)


def rate(values: Iterable[bool]) -> Rate:
    """Return the share of True."""
    found = list(values)
    return Rate(int(sum(found)), len(found))


# --- what an answer says ---------------------------------------------------------------------------------------------


def alarmed(record: Record) -> bool:
    """Tell whether the critic says that something is wrong; a compressed bundle called compressed is no alarm."""
    answer, truth = record["answer"], record["truth"]
    if answer.get("verdict") == "none":
        return False
    if answer.get("verdict") == BROKEN:
        return bool(truth["group"] == "null")
    named = {effect["id"] for effect in answer.get("effects", [])}
    return not (truth["noise"] not in ("plain", "lowpass") and named == {"compression"})


def ranking(record: Record) -> list[str]:
    """Return what the answer holds likely, the likeliest first, ``none`` left out."""
    shares = {k: v for k, v in (record["answer"].get("probabilities") or {}).items() if k != "none"}
    named = [effect["id"] for effect in record["answer"].get("effects", [])]
    order = sorted(shares, key=lambda k: -shares[k])
    return order or named


def reported_set(record: Record) -> set[str]:
    """Return all that the answer leaves possible."""
    answer = record["answer"]
    if answer.get("verdict") in ("none", "unknown", BROKEN):
        return {answer["verdict"]}
    return {effect["id"] for effect in answer.get("effects", [])} | set(answer.get("ambiguous_with") or [])


def top(record: Record) -> str:
    """Return the first of the ranking, ``none`` where nothing was found."""
    if record["answer"].get("verdict") in ("none", BROKEN):
        return str(record["answer"]["verdict"])
    order = ranking(record)
    return order[0] if order else "none"


# --- scores ----------------------------------------------------------------------------------------------------------


def by_strength(records: Sequence[Record], what: Callable[[Record], bool]) -> dict[str, dict[str, Any]]:
    """Return a rate for each strength of single causes."""
    groups: dict[float, list[bool]] = defaultdict(list)
    for record in records:
        groups[record["truth"]["strengths"][0]].append(what(record))
    return {f"{strength:g}": rate(groups[strength]).as_dict() for strength in sorted(groups)}


def calibration(records: Sequence[Record]) -> dict[str, Any]:
    """Return the expected calibration error of the likeliest answer's probability, and its table."""
    pairs = []
    for record in records:
        shares = record["answer"].get("probabilities") or {}
        truth = record["truth"]
        if not shares or truth["group"] not in ("null", "single", "unknown", "removed"):
            continue
        said = max(shares, key=lambda k: shares[k])
        pairs.append((float(shares[said]), said == expected(truth)))
    if not pairs:
        return {"error": math.nan, "cases": 0, "table": []}
    said, right = (np.array(v, float) for v in zip(*pairs, strict=True))
    place = np.minimum((said * BINS).astype(int), BINS - 1)
    table, error = [], 0.0
    for k in range(BINS):
        here = place == k
        if here.any():
            gap = abs(float(said[here].mean() - right[here].mean()))
            error += gap * float(here.mean())
            table.append({"said": float(said[here].mean()), "right": rate(right[here] > 0.5).as_dict()})
    return {"error": error, "cases": len(pairs), "table": table}


def expected(truth: Mapping[str, Any]) -> str:
    """Return the right answer of a case with at most one cause."""
    if truth["group"] == "null":
        return "none"
    return "unknown" if truth["group"] in ("unknown", "removed") else str(truth["causes"][0])


def confusion(records: Sequence[Record]) -> dict[str, dict[str, int]]:
    """Return counts of first answers by truth."""
    table: dict[str, Counter[str]] = defaultdict(Counter)
    for record in records:
        truth = record["truth"]
        if truth["group"] != "double":
            name = truth["causes"][0] if truth["causes"] else "none"
            name += " (taken out)" if truth["group"] == "removed" else ""
            table[name][top(record)] += 1
    return {name: dict(counts.most_common()) for name, counts in sorted(table.items())}


def covered(record: Record) -> tuple[bool, float] | None:
    """Return whether the interval of the named cause's parameter holds the true value, and its error in half-widths.

    None where the cause was not named or its form has no such number (:mod:`told`).
    """
    from .told import told

    known = told(record["truth"])
    named = {effect["id"]: effect.get("parameters", {}) for effect in record["answer"].get("effects", [])}
    cause = record["truth"]["causes"][0] if record["truth"]["causes"] else ""
    if known is None or known[0] not in named.get(cause, {}):
        return None
    said, true = named[cause][known[0]], known[1]
    half = max(0.5 * (said["hi"] - said["lo"]), 1e-300)
    return bool(said["lo"] <= true <= said["hi"]), float((said["value"] - true) / half)


def gain_share(record: Record) -> float | None:
    """Return the critic's gain on held-back frames over what the truth would; None where that is next to nothing."""
    oracle = record["truth"]["oracle_gain"]
    gain = (record["answer"].get("gain") or {}).get("log_score")
    if oracle < LEAST_ORACLE_NAT or not gain or gain[0] is None:
        return None
    return float(gain[0]) / float(oracle)


def summary(records: Sequence[Record], known: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """Return all scores of a run.

    Parameters
    ----------
    records : sequence of mapping
        ``truth``, ``answer``, ``seconds``; failed ones hold ``error`` and count as answered wrongly: a false alarm
        where nothing is hidden, a miss where something is. They have no part in calibration, intervals, gain, seconds.
    known : mapping, optional
        Of :func:`isolable.table`.
    """
    from .isolable import isolable

    failed = [r for r in records if "error" in r]
    good = [r for r in records if "error" not in r]
    every = good + [{**r, "answer": {"verdict": BROKEN}} for r in failed]
    group = {g: [r for r in every if r["truth"]["group"] == g] for g in
             ("null", "single", "decoy", "double", "unknown", "removed")}  # fmt: skip
    singles = group["single"]
    told = [r for r in singles if known is None or isolable(dict(known), r["truth"]["causes"][0],
                                                           r["truth"]["strengths"][0])]  # fmt: skip
    strong = [r for r in singles if r["truth"]["strengths"][0] >= 7]
    found: dict[str, Any] = {
        "cases": len(records),
        "failed": {r["truth"]["id"]: r["error"] for r in failed},
        "false_alarms": {"all": rate(alarmed(r) for r in group["null"]).as_dict()}
        | {
            noise: rate(alarmed(r) for r in group["null"] if r["truth"]["noise"] == noise).as_dict()
            for noise in sorted({r["truth"]["noise"] for r in group["null"]})
        },
        "detection": by_strength(singles, alarmed),
        "top1_all": by_strength(singles, lambda r: top(r) == r["truth"]["causes"][0]),
        "top1_isolable": by_strength(told, lambda r: top(r) == r["truth"]["causes"][0]),
        "in_set": rate(r["truth"]["causes"][0] in reported_set(r) for r in strong).as_dict(),
        "set_size": _mean_size(strong),
        "set_size_found": _mean_size([r for r in strong if r["answer"].get("verdict") in ("named", "ambiguous")]),
        "decoys": _decoys(group["decoy"]),
        "doubles": {
            str(c): rate(
                alarmed(r) and set(r["truth"]["causes"]) <= set(ranking(r)[:3])
                for r in group["double"]
                if r["truth"]["cancelling"] is c
            ).as_dict()
            for c in (False, True)
        },
        "unknown": {
            g: {
                "called_unknown": rate(r["answer"].get("verdict") == "unknown" for r in group[g]).as_dict(),
                "wrongly_named": rate(_sure_of_a_name(r) for r in group[g]).as_dict(),
            }
            for g in ("unknown", "removed")
        },
        "calibration": calibration(good),
        "gain": _gain(good),
        "intervals": _intervals(good),
        "seconds": _spread([r["seconds"] for r in good]),
        "confusion": confusion(every),
        "null_p": rate(r["answer"].get("global_p", 0.0) < LEVEL for r in group["null"]).as_dict(),
        "within_60_s": rate(r["seconds"] <= 60.0 for r in good).as_dict(),
    }
    return found


def _mean_size(records: Sequence[Record]) -> float:
    return float(np.mean([len(reported_set(r)) for r in records])) if records else math.nan


def _sure_of_a_name(record: Record) -> bool:
    shares = record["answer"].get("probabilities") or {}
    return any(v > 0.8 for k, v in shares.items() if k not in ("none", "unknown"))


def _decoys(records: Sequence[Record]) -> dict[str, Any]:
    lacking = [r for r in records if r["truth"]["drop"]]
    whole = [r for r in records if not r["truth"]["drop"]]

    def both(record: Record) -> bool:
        return {record["truth"]["causes"][0], record["truth"]["decoy"]} <= reported_set(record)

    def advised(record: Record) -> bool:
        advice = str((record["answer"].get("next_measurement") or {}).get("what", ""))
        return any(shot.replace("_", " ") in advice.replace("_", " ") for shot in record["truth"]["drop"])

    def named_alone(record: Record) -> bool:
        names = [effect["id"] for effect in record["answer"].get("effects", [])]
        return reported_set(record) == set(names) == {record["truth"]["causes"][0]}

    return {
        "answered_as_set_without_the_shot": rate(both(r) for r in lacking).as_dict(),
        "right_shot_advised": rate(advised(r) for r in lacking).as_dict(),
        "separated_with_the_shot": rate(named_alone(r) for r in whole).as_dict(),
    }


def _intervals(records: Sequence[Record]) -> dict[str, Any]:
    found: dict[str, list[tuple[bool, float]]] = defaultdict(list)
    for record in records:
        one = covered(record)
        if one is not None:
            found[record["truth"]["causes"][0]].append(one)
    every = [one for group in found.values() for one in group]
    return {"all": rate(held for held, _ in every).as_dict()} | {
        cause: rate(held for held, _ in group).as_dict()
        | {"median_error_half_widths": float(np.median([abs(error) for _, error in group]))}
        for cause, group in sorted(found.items())
    }


def _gain(records: Sequence[Record]) -> dict[str, Any]:
    shares: dict[str, list[float]] = defaultdict(list)
    for record in records:
        share = gain_share(record)
        if share is not None and record["truth"]["group"] != "null":
            shares["unknown" if record["truth"]["group"] in ("unknown", "removed") else "named"].append(share)
    nulls = [(r["answer"].get("gain") or {}).get("log_score") for r in records if r["truth"]["group"] == "null"]
    above = [bool(g and g[1] is not None and g[1] > 0) for g in nulls]
    return {k: _spread(v) for k, v in shares.items()} | {"null_interval_above_0": rate(above).as_dict()}


def _spread(values: Sequence[float]) -> dict[str, float]:
    if not values:
        return {"cases": 0}
    low, middle, high = np.percentile(values, [10, 50, 90])
    return {"cases": len(values), "p10": float(low), "median": float(middle), "p90": float(high)}


def lines(found: Mapping[str, Any]) -> list[str]:
    """Return the scores as lines of text."""

    def show(entry: Mapping[str, Any]) -> str:
        return str(Rate(entry["hits"], entry["cases"]))

    out = [f"cases {found['cases']}, failed {len(found['failed'])}"]
    out += [f"false alarms, {k}: {show(v)}" for k, v in found["false_alarms"].items()]
    for key in ("detection", "top1_isolable", "top1_all"):
        out += [f"{key}, strength {k}: {show(v)}" for k, v in found[key].items()]
    out += [f"truth in the set, strength 7 and more: {show(found['in_set'])}; mean size {found['set_size']:.2f}"]
    out += [f"decoys, {k}: {show(v)}" for k, v in found["decoys"].items()]
    out += [f"doubles, cancelling {k}: both in the first three {show(v)}" for k, v in found["doubles"].items()]
    for k, v in found["unknown"].items():
        out.append(f"{k}: called unknown {show(v['called_unknown'])}, wrongly named {show(v['wrongly_named'])}")
    out.append(
        f"expected calibration error {found['calibration']['error']:.3f} ({found['calibration']['cases']} cases)"
    )
    out += [f"90 % intervals that hold the truth, {k}: {show(v)}" for k, v in found["intervals"].items()]
    out += [f"gain over the oracle's or rate, {k}: {v}" for k, v in found["gain"].items()]
    return [*out, f"seconds a case: {found['seconds']}"]
