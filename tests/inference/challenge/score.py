"""Scores of a run: rates with Wilson's intervals, curves by strength, confusion, calibration, sets, gain, rigs."""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from .cases import PLAIN, STRENGTHS
from .library import MARKS

Record = Mapping[str, Any]

NONE, UNKNOWN, BROKEN = "none", "unknown", "error"
BINS = 10
LEAST_ORACLE_NAT = 10.0
"""Below, the truth itself gains too little on the frames held back to take a share of it."""
LEAST_SAID = 0.05
"""Probability of inclusion below which a cause is no part of the calibration: nearly all of those are zeros."""
SURE = 0.7
"""Probability from which a cause counts as told for sure."""
STRONG = 7.0


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


def said(record: Record) -> str:
    """Return the verdict, with what it names, the one that takes most of the misfit first."""
    answer = record["answer"]
    return " ".join([str(answer.get("verdict")), *(cause["id"] for cause in named(record))])


def named(record: Record) -> list[Mapping[str, Any]]:
    """Return the causes of an answer, the one that takes most of the misfit first."""
    return sorted(record["answer"].get("causes") or [], key=lambda c: -c.get("misfit_share", 0.0))


def alarmed(record: Record) -> bool:
    """Tell whether something is said to be wrong; a compressed bundle called compressed is no alarm."""
    verdict = record["answer"].get("verdict")
    if verdict in (NONE, BROKEN):
        return verdict == BROKEN and record["truth"]["group"] == "null"
    names = {cause["id"] for cause in named(record)}
    return not (record["truth"]["noise"] not in PLAIN and names == {"compression"})


def calls_unknown(record: Record) -> bool:
    """Tell whether the answer says that something is outside the library."""
    return UNKNOWN in str(record["answer"].get("verdict"))


def places(record: Record) -> list[Mapping[str, Any]]:
    """Return the places of the sum of causes: each with its credible set and its probabilities."""
    posterior = record["answer"].get("posterior") or {}
    own = posterior.get("places") or {}
    found = [own.get(cause["id"], cause) for cause in named(record)]
    if not found and record["answer"].get("verdict") not in (NONE, BROKEN, UNKNOWN) and posterior.get("further"):
        found.append(posterior["further"])
    return found


def top(record: Record) -> str:
    """Return the first answer: the likeliest of the place that takes most of the misfit; ``none``, ``unknown``."""
    verdict = str(record["answer"].get("verdict"))
    for place in places(record):
        shares = place.get("probability")
        if not isinstance(shares, Mapping):
            return str(place["id"])
        return max((n for n in shares if n != NONE), key=lambda n: shares[n], default=verdict)
    return verdict


def reported_set(record: Record) -> set[str]:
    """Return all that the answer leaves possible: the credible sets, and ``unknown`` where that is said."""
    found = {name for place in places(record) for name in place["credible_set"]} - {NONE}
    if calls_unknown(record):
        found.add(UNKNOWN)
    return found or {str(record["answer"].get("verdict"))}


def right_ones(truth: Mapping[str, Any]) -> set[str]:
    """Return what an answer should hold: the causes, those outside the library as ``unknown``."""
    outside = truth["group"] in ("unknown", "removed")
    return {UNKNOWN if outside or c in truth.get("outside", ()) else c for c in truth["causes"]}


def expected(truth: Mapping[str, Any]) -> str:
    """Return the right answer of a case with at most one cause."""
    return next(iter(right_ones(truth)), NONE)


# --- scores ----------------------------------------------------------------------------------------------------------


def strength(record: Record) -> float:
    """Return the nominal strength that a single cause's comes nearest to: a codec leaves it only about as asked for."""
    made = (record["truth"].get("strengths_made") or record["truth"]["strengths"])[0]
    return min(STRENGTHS, key=lambda s: abs(math.log(s / max(made, 1e-3))))


def by_strength(records: Sequence[Record], what: Callable[[Record], bool]) -> dict[str, dict[str, Any]]:
    """Return a rate for each strength of single causes."""
    groups: dict[float, list[bool]] = defaultdict(list)
    for record in records:
        groups[strength(record)].append(what(record))
    return {f"{s:g}": rate(groups[s]).as_dict() for s in sorted(groups)}


def calibration(records: Sequence[Record]) -> dict[str, Any]:
    """Return the expected calibration error of inclusion probabilities, its table, and a perfect answerer's error.

    A perfect answerer is right as often as it says: its error on these very probabilities is that of few cases alone.
    """
    pairs = []
    for record in records:
        inside = (record["answer"].get("posterior") or {}).get("inclusion") or {}
        truth = right_ones(record["truth"])
        pairs += [(float(p), name in truth) for name, p in inside.items() if p >= LEAST_SAID]
    if not pairs:
        none = rate([]).as_dict()
        return {"error": math.nan, "perfect": [math.nan, math.nan], "pairs": 0, "table": [], "sure": none}
    shares, right = (np.array(v, float) for v in zip(*pairs, strict=True))
    place = np.minimum((shares * BINS).astype(int), BINS - 1)

    def error(hits: np.ndarray) -> float:
        gaps = np.bincount(place, hits - shares, BINS)
        return float(np.abs(gaps).sum() / shares.size)

    rng = np.random.default_rng(12)
    perfect = [error((rng.random(shares.size) < shares).astype(float)) for _ in range(1000)]
    table = [
        {"said": float(shares[place == k].mean()), "right": rate(right[place == k] > 0.5).as_dict()}
        for k in range(BINS)
        if (place == k).any()
    ]
    ends = [float(np.mean(perfect)), float(np.percentile(perfect, 95))]
    sure = rate(right[shares >= SURE] > 0.5).as_dict()
    return {"error": error(right), "perfect": ends, "pairs": len(pairs), "table": table, "sure": sure}


def confusion(records: Sequence[Record]) -> dict[str, dict[str, int]]:
    """Return counts of first answers by truth, of cases with one cause at the most."""
    table: dict[str, Counter[str]] = defaultdict(Counter)
    for record in records:
        truth = record["truth"]
        if len(truth["causes"]) <= 1:
            name = truth["causes"][0] if truth["causes"] else NONE
            name += " (taken out)" if truth["group"] == "removed" else ""
            table[name][top(record)] += 1
    return {name: dict(counts.most_common()) for name, counts in sorted(table.items())}


def coverage(records: Sequence[Record]) -> dict[str, Any]:
    """Return how often 90 % intervals hold the truth: of parameters where form and library share one, and of areas.

    An area counts once for each named cause, at the force at which it changes most.
    """
    parameters, area = [], []
    for record in records:
        truth = record["truth"]
        answers = {cause["id"]: cause for cause in named(record)}
        for k, name in enumerate(truth["causes"]):
            if name not in answers or not truth.get("consequences"):
                continue
            own = truth["parameters"][k]
            interval = answers[name].get("parameters", {}).get(own[0]) if own else None
            if interval:
                parameters.append(interval["lo"] <= own[1] <= interval["hi"])
            true, found = truth["consequences"][k], answers[name].get("area") or {}
            change = dict(zip(true["force_N"], true["mm2"], strict=True))
            ends = zip(found.get("force_N", ()), found.get("mm2_lo", ()), found.get("mm2_hi", ()), strict=True)
            known = [(abs(change[f]), low <= change[f] <= high) for f, low, high in ends if f in change]
            if known:
                area.append(max(known)[1])
    return {"parameters": rate(parameters).as_dict(), "area": rate(area).as_dict()}


def gain_share(record: Record) -> float | None:
    """Return the gain on held-out frames over the truth's; None where that is next to nothing."""
    oracle = record["truth"]["oracle_gain"]
    if oracle <= LEAST_ORACLE_NAT or record["truth"]["group"] not in ("single", "double", "decoy"):
        return None
    gain = (record["answer"].get("held_out") or {}).get("log_score") or [0.0]
    return float(gain[0]) / float(oracle)


# --- rigs ------------------------------------------------------------------------------------------------------------


def consequence_weights(record: Record) -> tuple[float, float, float]:
    """Return what the named true causes, all true ones, and the named wrong ones change the area by [1], summed.

    True ones by the injector's reading, wrong ones by what the answer itself says of them.
    """
    truth, answers = record["truth"], {cause["id"]: cause for cause in named(record)}
    found = every = wrong = 0.0
    for name, own in zip(truth["causes"], truth["consequences"], strict=True):
        if name not in truth["outside"]:
            every += own["largest"]
            found += own["largest"] if name in answers else 0.0
    for name, cause in answers.items():
        if name not in truth["causes"]:
            percent = [abs(p) for p in (cause.get("area") or {}).get("percent", ()) if p is not None and p == p]
            wrong += max(percent, default=0.0) / 100
    return found, every, wrong


def removed_share(record: Record) -> float:
    """Return the share of the explainable misfit that is gone from held-out frames; 0 where nothing was fitted."""
    rms = (record["answer"].get("held_out") or {}).get("rms_DN")
    if not rms:
        return 0.0
    floor = record["truth"]["unexplainable_DN2"]
    return float(min(1.0, (rms[0] ** 2 - rms[1] ** 2) / max(rms[0] ** 2 - floor, 1e-9)))


def area_ratio(record: Record) -> float:
    """Return the area's error on held-out frames with the extension over without; 1 where nothing was fitted."""
    error = (record["answer"].get("held_out") or {}).get("area_error_percent")
    return float(error[1] / max(error[0], 1e-9)) if error and error[0] == error[0] else 1.0


def rigs(records: Sequence[Record]) -> dict[str, Any]:
    """Return the scores of the group with many causes, each with a 95 % interval by bootstrap over cases."""
    if not records:
        return {"cases": 0}
    weights = np.array([consequence_weights(r) for r in records])
    removed, area = np.array([removed_share(r) for r in records]), np.array([area_ratio(r) for r in records])
    scores: dict[str, Callable[[np.ndarray], float]] = {
        "recall": lambda n: _over(weights[n, 0].sum(), weights[n, 1].sum()),
        "precision": lambda n: _over(weights[n, 0].sum(), weights[n, 0].sum() + weights[n, 2].sum()),
        "misfit_removed": lambda n: float(np.median(removed[n])),
        "area_error_ratio": lambda n: float(np.median(area[n])),
    }
    rng, out = np.random.default_rng(4), dict[str, Any]()
    draws = rng.integers(0, len(records), (1000, len(records)))
    for name, score in scores.items():
        spread = [score(n) for n in draws]
        low, high = np.nanpercentile(spread, [2.5, 97.5]) if not np.isnan(spread).all() else (math.nan, math.nan)
        out[name] = [score(np.arange(len(records))), float(low), float(high)]
    causes = [(c, r) for r in records for c in r["truth"]["causes"] if c not in r["truth"]["outside"]]
    return out | {
        "cases": len(records),
        "named": rate(c in {n["id"] for n in named(r)} for c, r in causes).as_dict(),
        "named_right": rate(n["id"] in r["truth"]["causes"] for r in records for n in named(r)).as_dict(),
        "area_better": rate(area_ratio(r) < 1 for r in records).as_dict(),
        "unknown_said": rate(calls_unknown(r) for r in records if r["truth"]["outside"]).as_dict(),
        "unknown_said_without": rate(calls_unknown(r) for r in records if not r["truth"]["outside"]).as_dict(),
        "intervals": coverage(records),
    }


def _over(part: float, whole: float) -> float:
    return float(part / whole) if whole > 0 else math.nan


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
    group: dict[str, list[Record]] = defaultdict(list)
    for record in every:
        group[record["truth"]["group"]].append(record)
    singles, nulls = group["single"], group["null"]
    plain = [r for r in singles if r["truth"]["noise"] in PLAIN and r["truth"]["causes"][0] not in MARKS]
    marks = [r for r in singles if r["truth"]["causes"][0] in MARKS]
    apart = [r for r in singles if known is not None and isolable(dict(known), r["truth"]["causes"][0], strength(r))]
    strong = [r for r in singles if strength(r) >= STRONG]
    noises = sorted({r["truth"]["noise"] for r in nulls})

    def first_right(record: Record) -> bool:
        return top(record) == expected(record["truth"])

    return {
        "cases": len(records),
        "failed": {r["truth"]["id"]: r["error"] for r in failed},
        "false_alarms": {"all": rate(map(alarmed, nulls)).as_dict()}
        | {noise: rate(alarmed(r) for r in nulls if r["truth"]["noise"] == noise).as_dict() for noise in noises},
        "detection": by_strength(plain, alarmed),
        "detection_marks": by_strength(marks, alarmed),
        "detection_all": by_strength(singles, alarmed),
        "first_isolable": None if known is None else by_strength(apart, first_right),
        "first_all": by_strength(singles, first_right),
        "first_by_forms": {
            kind: rate(first_right(r) for r in strong if (r["truth"].get("recipes") or [False])[0] is recipe).as_dict()
            for kind, recipe in (("families", False), ("recipes", True))
        },
        "in_set": rate(r["truth"]["causes"][0] in reported_set(r) for r in strong).as_dict(),
        "set_size": float(np.mean([len(reported_set(r)) for r in strong])) if strong else math.nan,
        "decoys": _decoys(group["decoy"]),
        "doubles": rate(
            set(r["truth"]["causes"]) <= {cause["id"] for cause in named(r)} for r in group["double"]
        ).as_dict(),
        "unknown": {
            g: {
                "called_unknown": rate(map(calls_unknown, group[g])).as_dict(),
                "wrongly_named": rate(
                    any(c.get("probability", 1.0) >= SURE for c in named(r)) for r in group[g]
                ).as_dict(),
            }
            for g in ("unknown", "removed")
        },
        "calibration": calibration(good),
        "sure_plain": calibration([r for r in good if r["truth"]["noise"] in PLAIN])["sure"],
        "gain": _spread([s for s in map(gain_share, good) if s is not None]),
        "gain_named": _spread([s for r in singles if first_right(r) and (s := gain_share(r)) is not None]),
        "intervals": coverage(good),
        "rig": rigs(group["rig"]),
        "seconds": _spread([r["seconds"] for r in good]),
        "confusion": confusion(every),
    }


def _decoys(records: Sequence[Record]) -> dict[str, Any]:
    lacking = [r for r in records if r["truth"]["drop"]]
    whole = [r for r in records if not r["truth"]["drop"]]

    def both(record: Record) -> bool:
        return {record["truth"]["causes"][0], record["truth"]["decoy"]} <= reported_set(record)

    def advised(record: Record) -> bool:
        advice = str((record["answer"].get("next_measurement") or {}).get("what", ""))
        return any(shot.replace("_", " ") in advice.replace("_", " ") for shot in record["truth"]["drop"])

    return {
        "answered_as_set_without_the_shot": rate(map(both, lacking)).as_dict(),
        "right_shot_advised": rate(map(advised, lacking)).as_dict(),
        "separated_with_the_shot": rate(reported_set(r) == set(r["truth"]["causes"]) for r in whole).as_dict(),
    }


def _spread(values: Sequence[float]) -> dict[str, float]:
    if not values:
        return {"cases": 0}
    low, middle, high = np.percentile(values, [10, 50, 90])
    return {"cases": len(values), "p10": float(low), "median": float(middle), "p90": float(high)}
