"""The answer as numbers: sets, mechanisms, parameters, outcomes believed, extended and left out, what decides next."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import special

from evanesce.core.rng import generator
from evanesce.prediction.parameters import Parameter
from evanesce.studies.thesis_jointly.data import Outcomes, Row
from evanesce.studies.thesis_jointly.judge import (
    Judged,
    Tell,
    Verdict,
    judge_set,
    left_out,
    refitted_odds,
    settled,
    unexplained,
    verdict_of,
)
from evanesce.studies.thesis_jointly.mechanisms import (
    MECHANISMS,
    NOMINAL,
    NUISANCES,
    RIDGE_SETS,
    RIDGES,
    MechanismSet,
    all_sets,
)
from evanesce.studies.thesis_jointly.menu import ranked, summary
from evanesce.studies.thesis_jointly.predict import Predictor
from evanesce.studies.thesis_jointly.refuted import alone

Array = NDArray[Any]

POOLED = 2000
LOW, HIGH = 5.0, 95.0
"""Percentiles of all intervals."""
SHOWN_SETS = 10
RIDGED = ("ridged_over_smooth", "ridged_depth", "ridged_friction")
"""Kinds of outcomes that ridges alone decide: judged by themselves, together."""
DOUBTFUL = 0.1
"""Probability of being unexplained, by sets linear about their fits, above which fits decide."""
NAMED = 0.95
"""Probability from which on a mechanism is named, and below one less which it is excluded."""


@dataclass(frozen=True)
class Alternative:
    """A family of sets, to ask what it costs and which outcome is against it."""

    title: str
    holds: Callable[[frozenset[str]], bool]


ALTERNATIVES = (
    Alternative("Hertz's contact", lambda ids: "hertz" in ids),
    Alternative("no bone", lambda ids: "bone" not in ids),
    Alternative("moduli of table 6", lambda ids: "modulus" not in ids),
    Alternative("neither finger scatters (mechanics and reading alone)", lambda ids: "clear" in ids),
    Alternative("Silskin 20 % does not scatter", lambda ids: bool({"clear", "scatter_0"} & ids)),
    Alternative("both scatter alike, one threshold", lambda ids: "scatter_alike" in ids and "threshold" not in ids),
    Alternative("both scatter alike", lambda ids: "scatter_alike" in ids),
    Alternative("friction law of the true area", lambda ids: "friction_by_read_area" not in ids),
    Alternative("no adhesion", lambda ids: "adhesion" not in ids),
    Alternative("one threshold for both", lambda ids: "threshold" not in ids),
    Alternative("areas to scale", lambda ids: "scale" not in ids),
    Alternative("fixed exposure", lambda ids: "exposure_control" not in ids),
)


def criticise_thesis(
    outcomes: Outcomes, tell: Tell = lambda line: None, sets: Sequence[MechanismSet] = ()
) -> dict[str, Any]:
    """Judge all sets of mechanisms on all outcomes.

    Parameters
    ----------
    outcomes : Outcomes
    tell : callable
        Told what is done.
    sets : sequence of MechanismSet
        All of them unless given.

    Returns
    -------
    dict
        JSON-able; units stand beside figures.
    """
    ridged = tuple(row for row in outcomes.rows if row.outcome.kind in RIDGED)
    rest = replace(outcomes, rows=tuple(r for r in outcomes.rows if r.outcome.kind not in RIDGED))
    verdict = settled(rest, list(sets) or list(all_sets()), tell)
    found = [_outcomes_of(verdict, group, tell) for group in rest.groups]
    ridges = [settled(replace(outcomes, rows=ridged), RIDGE_SETS, tell)] if ridged else []
    found += [_outcomes_of(one, group, tell) for one in ridges for group in one.outcomes.groups]
    tell("what to measure next")
    menu = ranked(verdict)
    return {
        "version": 1,
        "sd_times": outcomes.times,
        "first_line": _first_line(verdict, found),
        "sets": [_set(one, p) for one, p in list(zip(verdict.sets, verdict.probability, strict=True))[:SHOWN_SETS]],
        "sets_judged": len(verdict.sets) * len(RIDGE_SETS),
        "mechanisms": _mechanisms(verdict, ridges),
        "parameters": _parameters(verdict, ridges),
        "outcomes": [row for group in found for row in group],
        "alternatives": [_alternative(verdict, one) for one in ALTERNATIVES],
        "scattering_of_the_other_bundle": alone(),
        "unexplained": [group for one in (verdict, *ridges) for group in one.unknown],
        "next_measurement": {"advice": summary(menu), "menu": menu},
    }


def pooled(verdict: Verdict, count: int = POOLED) -> list[tuple[Judged, NDArray[np.int_]]]:
    """Return sets with the draws of each that stand for the posterior over all sets, by number.

    Parameters
    ----------
    verdict : Verdict
    count : int
        Draws in all, about.
    """
    rng, found = generator(0, "pooled"), []
    for one, share in zip(verdict.sets, verdict.probability, strict=True):
        wanted = round(count * float(share))
        if wanted:
            size = len(next(iter(one.points.values())))
            found.append((one, rng.choice(size, wanted, replace=wanted > size)))
    return found


def predicted(verdict: Verdict, rows: Sequence[Row]) -> Array:
    """Return what the posterior over all sets predicts of some rows, as rows count (draws, rows)."""
    return np.concatenate([one.predicted(rows)[places] for one, places in pooled(verdict)])


def _outcomes_of(verdict: Verdict, group: str, tell: Tell) -> list[dict[str, Any]]:
    """Return a group's outcomes: published, believed, extended, and predicted from all others."""
    tell(f"{group} from the others")
    rows = [row for row in verdict.outcomes.rows if row.group == group]
    alone_here = len(verdict.outcomes.groups) == 1
    others = verdict if alone_here else left_out(verdict, group)
    believed = Predictor(rows, NOMINAL)({p.name: np.array([p.null]) for p in NUISANCES})[0]
    extended, ahead = predicted(verdict, rows), predicted(others, rows)
    gain = None if alone_here or group in verdict.unknown else _gain(verdict, others, group)
    outside = 1.0 if group in verdict.unknown else unexplained(verdict, group)
    if group not in verdict.unknown and outside > DOUBTFUL:
        outside = float(special.expit(refitted_odds(verdict, group)))
    found, sd = [], verdict.outcomes.only(group).sd()
    for k, row in enumerate(rows):
        figures = row.outcome.figures
        centre = float(np.median(extended[:, k]))
        z = min(((float(row.scaled(f)) - centre) / sd[k] for f in figures), key=abs)
        found.append(
            {
                "material": row.material, "id": row.outcome.id, "group": group, "unit": row.outcome.unit,
                "published": list(figures), "sd": verdict.outcomes.times * row.outcome.sd,
                "believed": float(row.figure(believed[k])),
                "extended": _interval(row, extended[:, k]),
                "from_others": None if alone_here else _interval(row, ahead[:, k]),
                "residual_sd": z, "gain_nats": gain, "unexplained": outside, "source": row.outcome.source,
                "uncertainty": row.outcome.uncertainty,
                "at": {k: v for k, v in row.outcome.at.model_dump().items() if v is not None},
            }
        )  # fmt: skip
    return found


def _gain(verdict: Verdict, others: Verdict, group: str) -> float:
    """Return by how much better a group is predicted from all others than by the nominal model so fitted [nats]."""
    both = {one.chosen.ids for one in others.sets}
    same = verdict_of(verdict.outcomes, verdict.unknown, [s for s in verdict.sets if s.chosen.ids in both])
    nominal = [judge_set(o, NOMINAL, verdict.unknown).log_evidence for o in (verdict.outcomes, others.outcomes)]
    return same.log_evidence - others.log_evidence - (nominal[0] - nominal[1])


def _interval(row: Row, values: Array) -> list[float]:
    """Return median and ends of the interval of predictions (draws,), as published."""
    return [float(x) for x in row.figure(np.percentile(values, [50.0, LOW, HIGH]))]


def _set(one: Judged, probability: float) -> dict[str, Any]:
    return {
        "set": one.chosen.title, "probability": float(probability), "log_evidence_nats": one.log_evidence,
        "misfit": one.fit.misfit, "rows": one.data.size,
    }  # fmt: skip


def _mechanisms(verdict: Verdict, ridges: Sequence[Verdict]) -> list[dict[str, Any]]:
    found = []
    for name, one in MECHANISMS.items():
        which = ridges[0] if name == RIDGES.id and ridges else verdict
        if name == RIDGES.id and not ridges:
            continue
        p = which.inclusion(name)
        status = "named" if p >= NAMED else "excluded" if p <= 1.0 - NAMED else "open"
        found.append({"id": name, "title": one.title, "probability": p, "verdict": status, "prior": one.prior})
    return found


def _parameters(verdict: Verdict, ridges: Sequence[Verdict]) -> list[dict[str, Any]]:
    """Return every parameter where its mechanism is there: median and interval."""
    every: dict[str, Parameter] = {p.name: p for m in MECHANISMS.values() for p in m.parameters}
    found = []
    for p in (*every.values(), *NUISANCES):
        which = ridges[0] if p.name == "@pitch" and ridges else verdict
        values = [one.points[p.name][places] for one, places in pooled(which) if p.name in one.points]
        owners = [m.id for m in MECHANISMS.values() if p in m.parameters]
        share = sum(which.inclusion(m) for m in owners) if owners else 1.0
        if not values or share < 1.0 - NAMED:
            continue
        logarithmic = p.unit.startswith("ln")
        ends = np.percentile(np.concatenate(values), [50.0, LOW, HIGH])
        prior = np.clip([p.null, p.null - p.deviation, p.null + p.deviation], *p.bounds)
        value, low, high = np.exp(ends) if logarithmic else ends
        found.append(
            {
                "name": p.name, "unit": p.unit.removeprefix("ln").strip() or "1", "probability": share,
                "value": float(value), "low": float(low), "high": float(high),
                "prior": [float(x) for x in (np.exp(prior) if logarithmic else prior)],
            }
        )  # fmt: skip
    return found


def _alternative(verdict: Verdict, one: Alternative) -> dict[str, Any]:
    """Return a family's probability, and the outcomes whose misfit its best set raises most."""
    inside = [s for s in verdict.sets if one.holds(s.chosen.ids)]
    if not inside:
        return {"title": one.title, "probability": 0.0, "loss_nats": None, "against": []}
    own = inside[0]
    outside = [s for s in verdict.sets if not one.holds(s.chosen.ids)]
    rival = outside[0] if outside else own
    raised: list[dict[str, Any]] = []
    for group in verdict.outcomes.groups:
        places = verdict.outcomes.of(group)
        more = float(np.square(own.fit.residual[places]).sum() - np.square(rival.fit.residual[places]).sum())
        raised.append({"group": group, "misfit": more})
    raised.sort(key=lambda row: -row["misfit"])
    total = sum(p for s, p in zip(verdict.sets, verdict.probability, strict=True) if one.holds(s.chosen.ids))
    return {
        "title": one.title, "probability": float(total), "loss_nats": rival.log_weight - own.log_weight,
        "against": [row for row in raised[:3] if row["misfit"] > 1.0],
    }  # fmt: skip


def _first_line(verdict: Verdict, found: Sequence[Sequence[Mapping[str, Any]]]) -> str:
    named = [m.id for m in MECHANISMS.values() if verdict.inclusion(m.id) >= NAMED]
    scatters = 1.0 - verdict.inclusion("clear") - verdict.inclusion("scatter_0")
    words = [f"{', '.join(named) or 'no mechanism'} (each probable to {NAMED:.2f} or more)"]
    words.append(f"Silskin 20 % scatters with probability {scatters:.2f}")
    if verdict.outcomes.times != 1.0:
        words.append(f"all standard deviations times {verdict.outcomes.times:g}")
    if verdict.unknown:
        words.append(f"not explained: {', '.join(verdict.unknown)}")
    far = [row["id"] for group in found for row in group if abs(row["residual_sd"]) > 2.5]
    if far:
        words.append(f"missed by over 2.5 standard deviations: {', '.join(dict.fromkeys(far))}")
    return "; ".join(words)
