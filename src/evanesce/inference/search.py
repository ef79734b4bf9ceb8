"""Moves: causes added one at a time, each relinearised at the joint optimum; dropped and exchanged at the end."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.core.errors import InputError
from evanesce.criticism.linear import Metric
from evanesce.inference.causes import Cause, Entry, entries_of
from evanesce.inference.consequence import AreaReader
from evanesce.inference.constants import LEAST_AREA, LEAST_SHARE, LINEAR, LISTED_SHARE, TRIED
from evanesce.inference.discrepancy import Discrepancy
from evanesce.inference.gauss_newton import bounded_step
from evanesce.inference.heldout import condition_scores, gain_of
from evanesce.inference.joint import Fitter, JointFit, taken_from

Array = NDArray[Any]
Tell = Callable[[str], None]

SHARES = (1.0, 0.4)
"""Of the linear estimate at which a cause is entered: where a straight line overshoots, the shorter one is nearer."""
TRIAL_ROUNDS = 6
COSTLY_BELOW = 0.1
"""Causes that ask for another light of the plate are looked at once no other would remove more than this share."""
STARTS = 3
"""Of a cause with many starts, those that are linearised anew."""
SURE = 2.0
"""Standard errors by which the held-out score has to gain."""


@dataclass(frozen=True)
class Removal:
    """What a cause would remove of the misfit, linear about the present fit.

    Attributes
    ----------
    entry : Entry
    removed : float
        Of the misfit, priors and bounds kept.
    coordinates : ndarray (k,)
    """

    entry: Entry
    removed: float
    coordinates: Array


@dataclass(frozen=True)
class Step:
    """A move that was made.

    Attributes
    ----------
    move : str
        ``add``, ``drop`` or ``exchange``.
    cause, other : str
        The one that came (went, for a drop), and the one that it replaced.
    misfit : float
        After it.
    removed : float
        By it.
    reason : str
        Why the cause was taken or dropped.
    seconds : float
        Since the beginning.
    """

    move: str
    cause: str
    misfit: float
    removed: float
    reason: str
    seconds: float
    other: str = ""


@dataclass
class Search:
    """The moves, from the nominal model's own fit.

    Attributes
    ----------
    fitter : Fitter
    causes : tuple of Cause
    areas : AreaReader
    discrepancy : Discrepancy
    tell : callable
        Told each move and the time left.
    """

    fitter: Fitter
    causes: Sequence[Cause]
    areas: AreaReader
    discrepancy: Discrepancy
    tell: Tell = lambda line: None
    steps: list[Step] = field(default_factory=list)
    refused: dict[str, str] = field(default_factory=dict)
    first: float = 0.0
    _entries: dict[str, list[Entry]] = field(default_factory=dict)
    _began: float = field(default_factory=time.monotonic)

    def run(self, base: JointFit) -> JointFit:
        """Return the extended fit: nothing is left to add, drop or exchange.

        Parameters
        ----------
        base : JointFit
            Of the nominal model.
        """
        self.first = base.misfit
        now = self._added(base)
        for _ in range(2):
            moved = self._exchanged(self._dropped(now))
            if moved.ids == now.ids:
                break
            now = self._added(moved)
        return now

    def noise(self, fitted: JointFit) -> float:
        """Return the misfit that noise alone would leave: the bins."""
        return float(fitted.residual.size)

    def share(self, misfit: float) -> float:
        """Return a misfit over what there was to explain."""
        return misfit / max(self.first - float(self.fitter.observed.size), 1.0)

    def _added(self, now: JointFit) -> JointFit:
        round_began = time.monotonic()
        while True:
            found = self._next(now)
            if found is None:
                return now
            candidate, reason = found
            try:
                better = self.fitter.relinearised(candidate.taken, candidate.point)
            except InputError as error:
                self.refused[candidate.taken[-1].id] = str(error)
                continue
            if better.misfit >= now.misfit:
                self.refused[candidate.taken[-1].id] = "removes nothing at the fine model's optimum"
                self.fitter.model.anchor(now.point)
                continue
            self._note(Step("add", better.ids[-1], better.misfit, now.misfit - better.misfit, reason, self._seconds))
            took = time.monotonic() - round_began
            self.tell(f"{self._words(better)}; about {self._rounds_left(better, now) * took:.0f} s left")
            round_began, now = time.monotonic(), better

    @property
    def _seconds(self) -> float:
        return time.monotonic() - self._began

    def _note(self, step: Step) -> None:
        self.steps.append(step)

    def _words(self, fitted: JointFit) -> str:
        step = self.steps[-1]
        left = max(fitted.misfit - fitted.residual.size, 0.0)
        return f"{step.move} {step.cause}: {100 * self.share(left):.1f} % of the misfit left, {len(fitted.ids)} causes"

    def _rounds_left(self, now: JointFit, before: JointFit) -> float:
        """Return how many more causes are expected if each removes as large a share as the last one did."""
        own = float(now.residual.size)
        left, there = max(now.misfit - own, 1.0), max(before.misfit - own, 2.0)
        until = max(LEAST_SHARE * self.first, 1.0)
        if left <= until:
            return 1.0
        rate = max(np.log(there / left), 0.2)
        return float(1 + np.log(left / until) / rate)

    def removals(self, now: JointFit, causes: Sequence[Cause]) -> list[Removal]:
        """Return what causes would remove, by the entries that are known, the most first; one for each cause."""
        metric, believed = everything_marginalised(now)
        projected = metric.project(believed)
        found = []
        for cause in causes:
            own = [removal(entry, metric, projected) for entry in self._entries.get(cause.id, [])]
            if own:
                found.append(max(own, key=lambda r: r.removed))
        return sorted(found, key=lambda r: -r.removed)

    def _next(self, now: JointFit) -> tuple[JointFit, str] | None:
        """Return the fit with the cause that removes most of the misfit and is worth being taken; None: no such."""
        free = [c for c in self.causes if c.id not in now.ids and c.id not in self.refused]
        base = self.fitter.model.vector(now.point)
        self._enter([c for c in free if not c.costly], now.point, base)
        ranked = self.removals(now, free)
        if not ranked or self.share(ranked[0].removed) < COSTLY_BELOW:
            self._enter(free, now.point, base)
            ranked = self.removals(now, free)
        if now.taken:
            self._renew(ranked[:LINEAR], now, base)
            ranked = self.removals(now, free)
        worth = [r for r in ranked if r.removed > 0.1 * LEAST_SHARE * self.first or r.removed > 0.1 * ranked[0].removed]
        tied: Array | None = None
        for group in (worth[:TRIED], worth[TRIED : 2 * TRIED]):
            tried = [t for t in (self._tried(now, r) for r in group) if t is not None]
            tried.sort(key=lambda t: t.misfit)
            for fitted in tried:
                removed = now.misfit - fitted.misfit
                if self.share(removed) >= LEAST_SHARE:
                    return fitted, f"takes {100 * self.share(removed):.1f} % of the misfit that was there"
            if not tried:
                continue
            tied = self.discrepancy.rows(now) if tied is None else tied
            for fitted in tried:
                reason = self._by_consequence(now, fitted, tied)
                if reason:
                    return fitted, reason
        return None

    def _renew(self, ranked: Sequence[Removal], now: JointFit, base: Array) -> None:
        """Linearise causes anew at the present point; of many starts those that told most before."""
        metric, believed = everything_marginalised(now)
        projected = metric.project(believed)
        for old in ranked:
            cause, only = old.entry.cause, None
            if cause.costly:
                continue
            if old.entry.start:
                every = sorted(
                    (removal(e, metric, projected) for e in self._entries[cause.id]), key=lambda r: -r.removed
                )
                only = [r.entry.start for r in every[:STARTS]]
            self._entries[cause.id] = entries_of(self.fitter.model, now.point, base, cause, only)

    def _enter(self, causes: Sequence[Cause], point: Mapping[str, float], base: Array) -> None:
        """Find the ways into causes that have none yet."""
        unknown = [c for c in causes if c.id not in self._entries]
        for number, cause in enumerate(unknown):
            if cause.costly:
                self.tell(f"light of the plate for {cause.id} ({number + 1} of {len(unknown)})")
            self._entries[cause.id] = entries_of(self.fitter.model, point, base, cause)

    def _tried(self, now: JointFit, found: Removal) -> JointFit | None:
        """Return the joint fit with a cause, by coarse derivatives about the present anchor; None if it fails."""
        taken = taken_from(found.entry)
        best: tuple[float, dict[str, float]] | None = None
        metric, believed = everything_marginalised(now)
        try:
            for share in SHARES if not taken.slow else (1.0,):
                point = found.entry.point(share * found.coordinates)
                if taken.slow:
                    change = share * (found.coordinates @ found.entry.rows)
                else:
                    change = self.fitter.model.vector({**now.point, **point}) - now.solution.predicted
                left = believed - change
                value = float(metric.project(left) @ left)
                if best is None or value < best[0]:
                    best = (value, point)
            assert best is not None
            start = {**now.point, **best[1]}
            own = (
                np.array(list(taken.slow.values()))
                if taken.slow
                else np.array([self.fitter.model.derivative(start, p) for p in taken.parameters])
            )
            count = sum(len(t.parameters) for t in now.taken)
            rows = np.concatenate([now.solution.rows[:count], own, now.solution.rows[count:]])
            return self.fitter.fitted(
                (*now.taken, taken), start, metric=now.metric, rows=rows, rounds=TRIAL_ROUNDS, renewals=0
            )
        except InputError:
            return None

    def _by_consequence(self, now: JointFit, fitted: JointFit, tied: Array) -> str:
        """Return why a cause below the least share is taken all the same; empty if it is not."""
        cause = fitted.ids[-1]
        try:
            moved = self.areas.of_change(fitted.point, fitted.without(cause)).largest
        except InputError:
            return ""
        removed = now.misfit - fitted.misfit
        if moved < LEAST_AREA and removed < LISTED_SHARE * now.misfit:
            return ""
        data = self.fitter.data
        gain, error = gain_of(condition_scores(data, now, tied), condition_scores(data, fitted, tied))
        if gain <= SURE * error or gain <= 0:
            return ""
        if moved < LEAST_AREA:
            return f"takes {100 * removed / now.misfit:.0f} % of what was left and gains {gain:.0f} +- {error:.0f} nats"
        return f"moves the area by {100 * moved:.2f} % and gains {gain:.0f} +- {error:.0f} nats on conditions left out"

    def _dropped(self, now: JointFit) -> JointFit:
        """Drop causes that are no longer worth it, the least first."""
        while len(now.taken) > 1:
            losses = {t.id: loss_of(now, t.id) for t in now.taken}
            least = min(losses, key=lambda name: losses[name])
            if self.share(losses[least]) >= LEAST_SHARE:
                return now
            kept = [t for t in now.taken if t.id != least]
            without = self.fitter.relinearised(kept, now.without(least))
            reason = self._by_consequence(without, _last(now, least), self.discrepancy.rows(without))
            if self.share(without.misfit - now.misfit) >= LEAST_SHARE or reason:
                self.fitter.model.anchor(now.point)
                return now
            self._note(
                Step("drop", least, without.misfit, now.misfit - without.misfit, "no longer needed", self._seconds)
            )
            self.tell(self._words(without))
            self.refused[least] = "dropped"
            now = without
        return now

    def _exchanged(self, now: JointFit) -> JointFit:
        """Exchange a cause for another that, in its place, leaves less."""
        for name in sorted(now.ids, key=lambda n: loss_of(now, n)):
            others = [c for c in self.causes if c.id not in now.ids]
            rest = _linearly_without(now, name)
            metric, believed = everything_marginalised(rest)
            projected = metric.project(believed)
            best = [
                removal(entry, metric, projected)
                for c in others
                if not c.costly
                for entry in self._entries.get(c.id, [])
            ]
            best.sort(key=lambda r: -r.removed)
            if not best or best[0].removed < 0.8 * loss_of(now, name):
                continue
            kept = [t for t in now.taken if t.id != name]
            try:
                without = self.fitter.fitted(
                    kept, now.without(name), metric=now.metric, rounds=TRIAL_ROUNDS, renewals=1
                )
                tried = self._tried(without, best[0])
                if tried is None or tried.misfit > now.misfit:
                    continue
                better = self.fitter.relinearised(tried.taken, tried.point)
            except InputError:
                continue
            if better.misfit < now.misfit:
                removed = now.misfit - better.misfit
                self._note(Step("exchange", better.ids[-1], better.misfit, removed, "leaves less", self._seconds, name))
                self.tell(self._words(better))
                return better
            self.fitter.model.anchor(now.point)
        return now


def everything_marginalised(now: JointFit) -> tuple[Metric, Array]:
    """Return the metric with all that is fitted marginalised, and the data less the prediction of the priors' means.

    What a bound holds stays where it is.
    """
    free = ~now.solution.held
    own = now.solution.rows[free]
    rows = np.concatenate([now.metric.rows, own])
    deviations = np.array([p.deviation for p in now.parameters])[free]
    metric = Metric.of(rows, np.concatenate([np.ones(len(now.metric.rows)), deviations]))
    return metric, now.residual + now.departures()[free] @ own


def removal(entry: Entry, metric: Metric, projected: Array) -> Removal:
    """Return what a cause would remove, its coordinates kept to their priors and bounds.

    Parameters
    ----------
    entry : Entry
    metric : Metric
        With all that is fitted marginalised.
    projected : ndarray (bins,)
        The metric times the data less the prediction of the priors' means.
    """
    rows = entry.rows
    precision = np.asarray(metric.project(rows) @ rows.T, float) + np.diag(1.0 / entry.deviation**2)
    gradient = np.asarray(rows @ projected, float)
    step = bounded_step(precision, gradient, entry.low, entry.high)
    return Removal(entry, 2.0 * float(step @ gradient) - float(step @ precision @ step), step)


def loss_of(now: JointFit, cause: str) -> float:
    """Return by how much the misfit rises without a cause, all else refitted, linear about the fit."""
    places = now.of_cause(cause)
    away = now.departures()[places]
    covariance = now.solution.covariance[np.ix_(places, places)]
    return float(away @ np.linalg.solve(covariance, away))


def _linearly_without(now: JointFit, cause: str) -> JointFit:
    """Return a fit with a cause at its null and all else moved as its derivatives say."""
    places = now.of_cause(cause)
    kept = np.setdiff1d(np.arange(len(now.parameters)), places)
    away = now.departures()
    covariance = now.solution.covariance
    step = -covariance[:, places] @ np.linalg.solve(covariance[np.ix_(places, places)], away[places])
    values, rows = now.solution.values + step, now.solution.rows[kept]
    solution = replace(now.solution, values=values[kept], rows=rows, held=now.solution.held[kept])
    return JointFit(
        tuple(t for t in now.taken if t.id != cause),
        tuple(now.parameters[k] for k in kept),
        now.without(cause),
        solution,
        now.metric,
        now.residual - step @ now.solution.rows,
    )


def _last(now: JointFit, cause: str) -> JointFit:
    """Return the fit with a cause named last: the order of the others stays."""
    ordered = sorted(now.taken, key=lambda t: t.id == cause)
    places = [k for t in ordered for k in now.of_cause(t.id)]
    places += [k for k, p in enumerate(now.parameters) if p.name.startswith("@")]
    s = now.solution
    solution = replace(
        s,
        values=s.values[places],
        rows=s.rows[places],
        precision=s.precision[np.ix_(places, places)],
        held=s.held[places],
    )
    return replace(now, taken=tuple(ordered), parameters=tuple(now.parameters[k] for k in places), solution=solution)
