"""Moves from the nominal rig's fit to the extended one's: causes are added one at a time, dropped, and exchanged.

What is tried is what the evidences of all causes' forms say (:mod:`evanesce.inference.judge`); what is taken is
decided by the joint fit about the fine model, made anew after each move, so that a strong cause's curvature is not
taken for a further cause.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.core.errors import InputError
from evanesce.inference.consequence import AreaReader
from evanesce.inference.constants import DETECTED, FITTED, LEAST_AREA, LEAST_SHARE, SUBSTITUTE, TRIED, WORTH
from evanesce.inference.explained import Scan
from evanesce.inference.gauss_newton import Slopes
from evanesce.inference.joint import JointFit, Taken
from evanesce.inference.marks import MarkSearch
from evanesce.inference.posterior import Further, Posterior
from evanesce.inference.removal import everything_marginalised, loss_of
from evanesce.inference.single_effects import NONE, UNKNOWN
from evanesce.inference.trials import Trials
from evanesce.inference.unknown import told_fields

Array = NDArray[Any]

GROWN = 1.5
"""Ratio of evidences beyond which a cause that was fitted in vain is fitted once more."""
AHEAD = 1.0
"""Nats by which another cause has to be more probable to take a place: a fit ends within half a nat of its optimum."""
MOVES = 60
"""Moves in all: a search that does not end by itself has met two causes that take turns."""


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
class Search(Trials):
    """The moves, from the nominal rig's own fit.

    Attributes
    ----------
    fitted : int
        Causes that are fitted in each round, of those that are entered.
    """

    fitted: int = FITTED
    steps: list[Step] = field(default_factory=list)
    in_vain: dict[str, str] = field(default_factory=dict)
    """Causes that were fitted beside the present ones and bring too little, with what they bring."""
    marks: MarkSearch | None = None
    areas: AreaReader | None = None
    """Reads what a cause does to the area; without it that is not asked."""
    scan: Scan = field(default_factory=Scan)
    """Defects that were found."""
    first: float = 0.0
    floor: float = 0.0
    """Misfit that noise makes."""
    unknown: dict[str, float] = field(default_factory=dict)
    """Blocks of something unknown that have been taken, with their amplitudes."""
    not_unknown: set[str] = field(default_factory=set)
    """Blocks of it that were dropped."""
    _vain_at: dict[str, float] = field(default_factory=dict)
    """Evidence [nats] of those that were fitted in vain, then."""
    _began: float = field(default_factory=time.monotonic)
    _behind: dict[tuple[str, str], float] = field(default_factory=dict)
    _busy: dict[str, frozenset[str]] = field(default_factory=dict)
    """Causes that change something, with the others beside which that was found."""
    _scanned: bool = False
    _renewed: frozenset[str] | None = None
    """Causes about which all derivatives were made anew last."""

    def run(self, base: JointFit) -> tuple[JointFit, Posterior]:
        """Return the extended fit, the model anchored about it, and the probabilities of all causes there.

        Parameters
        ----------
        base : JointFit
            Of the nominal model, the model anchored about it.
        """
        self.first, self.floor = base.misfit, float(self.fitter.observed.size)
        now = self._grown(base)
        marked = self._with_defects(now)
        now = now if marked is now else self._grown(marked)
        while True:
            posterior, compared = self.posterior(now).with_defects(self.scan.places()), len(self._behind)
            posterior = posterior.fitted_in_vain(self.in_vain)
            moved = self._dropped(now, posterior) or self._exchanged(now, posterior)
            if len(self.steps) >= MOVES or (moved is None and len(self._behind) == compared):
                best = now.known_alone()
                self.floor = self._floor(best, posterior)
                return best, posterior
            now = now if moved is None else self._grown(moved)

    def posterior(self, now: JointFit) -> Posterior:
        """Return the probabilities of all causes at a joint fit, about which the model is anchored."""
        return self.judge.posterior(now, self.unknown, self._behind)

    @property
    def not_taken(self) -> dict[str, str]:
        """Causes that are not in the fit though they were tried or not worth it, with the reason."""
        return {**self.refused, **self.in_vain}

    def share(self, misfit: float) -> float:
        """Return a misfit over what there was to explain."""
        return misfit / max(self.first - self.floor, 1.0)

    def _floor(self, best: JointFit, posterior: Posterior) -> float:
        """Return the misfit that noise makes: the last one where nothing more shows, as noise is known to a per cent.

        A per cent of all bins is more than what a weak cause takes.
        """
        return best.misfit if not (posterior.asks or self.unknown) else min(self.floor, best.misfit)

    def _grown(self, now: JointFit) -> JointFit:
        """Return the fit to which no cause is worth being added, its derivatives made anew.

        Derivatives take longest, and many causes want many. Until no cause is worth being added those do that steps
        have corrected since they were made: what they are off by leaves per cent of what is left, and an added cause
        takes more.
        """
        while True:
            now = self._grown_roughly(now)
            renewed = self._renewed_or_same(now)
            if renewed is now:
                return now
            now = renewed

    def _renewed_or_same(self, now: JointFit) -> JointFit:
        """Return the fit by derivatives made where it is, once for the same causes.

        What steps have corrected predicts further steps, but mixes up causes that moved together.
        """
        if now.solution.slopes.made is not None or frozenset(now.ids) == self._renewed:
            return now
        self._renewed = frozenset(now.ids)
        return self.fitter.relinearised(now.taken, now.point)

    def _grown_roughly(self, now: JointFit) -> JointFit:
        """Return the fit to which no cause is worth being added."""
        began = time.monotonic()
        while len(self.steps) < MOVES:
            asked = self.judge.further(now, self.unknown, self.not_unknown)
            place = asked.place
            if asked.p_value > DETECTED or place.probability[NONE] > 0.5:
                return now
            if 2.0 * max(asked.by_misfit.log_bayes.values()) < LEAST_SHARE * self.first:
                return now
            known = len(self.in_vain)
            better = self._added(now, asked)
            if better is not None:
                took = time.monotonic() - began
                self.tell(f"{self._words(better)}; about {self._rounds_left(better, now) * took:.0f} s left")
                began, now = time.monotonic(), better
            elif place.log_bayes.get(UNKNOWN, 0.0) > 0.0 and asked.unknown:
                explained = self._with_defects(now)
                if explained is now and not self.unknown:
                    explained = self._renewed_or_same(now)
                if explained is now and not self.unknown:
                    explained = self._exchanged(now, self.posterior(now)) or now
                if explained is not now:  # the library first: what another cause leaves looks like something unknown
                    now = explained
                    continue
                found = self._with_unknown(now.taken, now.point, {**self.unknown, **asked.unknown}, now.solution.slopes)
                self._note("add", UNKNOWN, found, now, told_fields(asked.unknown))
                self.tell(told_fields(asked.unknown))
                now = found
            elif len(self.in_vain) > known and set(place.credible_set) - {UNKNOWN, *self.refused, *self.in_vain}:
                continue
            else:
                return now
        return now

    def _with_defects(self, now: JointFit) -> JointFit:
        """Return the fit with the localised defects that stand out of it; they are sought once."""
        if self.marks is None or self._scanned:
            return now
        self._scanned = True
        self.tell("localised defects")
        self.scan = self.marks.scan(now.point)
        new = [found for found in self.scan.listed if found.taken.id not in now.ids]
        for found in new:
            self.marks.model.list_defects(found.taken.id, found.settings)
        denied = self._denied(now, [f.taken for f in new], {name: v for f in new for name, v in f.start.items()})
        self.scan = self.scan.without(denied)
        self.refused |= {f.taken.id: denied.get(f.taken.id, "its places were found") for f in self.scan.listed} | denied
        new = [found for found in new if found.taken.id not in denied]
        if not new:
            return now
        start = {**now.point, **{name: v for found in new for name, v in found.start.items()}}
        trial = self._beside(now, [found.taken for found in new], start)
        better = self.fitter.relinearised(trial.taken, trial.point, trial.solution.slopes, renewals=0)
        for found in new:
            own = found.taken.id
            self._note("add", own, better, now, f"{max(len(self.scan.by_cause.get(own, ())), 1)} places stand out")
            self.tell(self._words(better))
        return better

    def _denied(self, now: JointFit, listed: Sequence[Taken], start: Mapping[str, float]) -> dict[str, str]:
        """Return which causes whose places were found are not taken, with the reason, by a trial fit of them all.

        To some all views together give no strength: what stood out is something else. Bands may be anything that
        varies from row to row, so that they have to be worth it as any cause has.
        """
        if not listed:
            return {}
        trial = self._beside(now, listed, {**now.point, **start})
        at, away = {t.id: trial.of_cause(t.id) for t in listed}, trial.departures()
        denied = {
            name: "places stand out, but the joint fit gives it no strength"
            for name in at
            if not np.any(away[at[name]])
        }
        for own in (t for t in listed if t.id in self.scan.ripples and t.id not in denied):
            alone = {name: v for name, v in start.items() if name.startswith(f"{own.id}:")}
            idle = self._idle(now, self._beside(now, [own], {**now.point, **alone}))
            denied |= {own.id: idle} if idle else {}
        return denied

    def _with_unknown(
        self, taken: Sequence[Taken], point: Mapping[str, float], unknown: dict[str, float], slopes: Slopes
    ) -> JointFit:
        """Return the fit of some causes with blocks of something unknown marginalised, and no other of them."""
        self.unknown, self.fitter.fields = unknown, self.judge.fields(unknown)
        self._behind.clear()
        return self.fitter.relinearised(taken, point, Slopes(slopes.rows), renewals=0)

    def _added(self, now: JointFit, asked: Further) -> JointFit | None:
        """Return the fit with the cause that leaves least, of those of most evidence; None if none is worth it.

        What was fitted in vain is fitted again where its evidence has grown since.
        """
        evidence = {name: max(b, asked.place.log_bayes.get(name, b)) for name, b in asked.by_misfit.log_bayes.items()}
        least = self._occam(1)
        for name in [n for n in self.in_vain if evidence.get(n, 0.0) > GROWN * max(self._vain_at[n], least)]:
            del self.in_vain[name], self._vain_at[name]
        try:
            return self._best_added(now, asked)
        finally:
            self._vain_at = {n: self._vain_at.get(n, evidence.get(n, 0.0)) for n in self.in_vain}

    def _best_added(self, now: JointFit, asked: Further) -> JointFit | None:
        place, p = asked.place, asked.p_value
        wanted: list[str] = []
        tried_before = {UNKNOWN, *self.refused, *self.in_vain}
        for bayes in (asked.by_misfit.log_bayes, place.log_bayes):
            ranked = [n for n in sorted(bayes, key=lambda n: -bayes[n]) if n not in tried_before]
            wanted += [n for n in self._worth_entering(ranked) if n not in wanted]
        metric, believed = everything_marginalised(now)
        entered = [e for e in (self._entered(now, name, metric, believed) for name in wanted) if e is not None]
        least = self._occam(len(wanted))
        if self.unknown:  # weak causes would take what the fields of something unknown do not follow
            least = max(least, 0.5 * WORTH * (self.first - now.misfit))
        for poor in (e for e in entered if 0.5 * e.removed <= least):
            self.in_vain[poor.entry.cause.id] = f"would bring {0.5 * poor.removed:.1f} nats"
        entered = sorted((e for e in entered if 0.5 * e.removed > least), key=lambda e: -e.removed)
        near = [e for e in entered if e.removed > SUBSTITUTE * entered[0].removed]
        tried = [t for t in (self._tried(now, e, metric, believed) for e in near[: self.fitted]) if t is not None]
        unknown = place.log_bayes.get(UNKNOWN, 0.0)
        unknown = unknown if unknown > asked.library else 0.0
        for fitted in sorted(tried, key=lambda t: t.misfit):
            cause = fitted.taken[-1].id
            brought = 0.5 * (now.misfit - fitted.misfit)
            idle = self._idle(now, fitted)
            if idle:
                self.in_vain[cause] = idle
                continue
            if brought < unknown:  # what is left looks more like nothing in the library
                self.in_vain[cause] = f"brings {brought:.1f} nats, less than something unknown"
                continue
            try:
                better = self.fitter.relinearised(fitted.taken, fitted.point, fitted.solution.slopes, renewals=0)
            except InputError as error:
                self.refused[cause] = str(error)
                continue
            removed = now.misfit - better.misfit
            if 0.5 * removed > least and removed > LEAST_SHARE * self.first:
                self._note("add", cause, better, now, f"p = {p:.2g} of noise, {0.5 * removed:.0f} nats by it")
                return better
            self.in_vain[cause] = f"brings {0.5 * removed:.1f} nats at the fine model's optimum"
            self.fitter.model.anchor(now.point)
        return None

    def _idle(self, now: JointFit, fitted: JointFit) -> str:
        """Return why a further cause would change nothing that a user asks for; empty if it would.

        What strong causes leave because no form is exact asks for many weak ones: beside what was taken before, a cause
        has to remove a share of as much, or to move the area that the fit predicts. What it moves by itself does not
        count: others that it takes from may move it back.
        """
        explained = max(self.first - now.misfit, 0.0)
        removed = now.misfit - fitted.misfit
        if self.areas is None or removed >= WORTH * explained:
            return ""
        try:
            change = self.areas.of_change(fitted.point, now.point)
        except InputError:
            return ""
        if change.largest >= LEAST_AREA or not np.isfinite(change.change_percent).any():
            return ""
        share = f"{100 * removed / explained:.2g} % of what the others remove"
        return f"removes {share}, moves the area by {100 * change.largest:.2g} %"

    def _dropped(self, now: JointFit, posterior: Posterior) -> JointFit | None:
        """Return the fit without a cause whose place is more probably empty, or filled by something unknown."""
        place = posterior.places.get(UNKNOWN)
        if place is not None and place.probability.get(UNKNOWN, 0.0) < 0.5:
            self.not_unknown |= set(self.unknown)
            known = self._with_unknown(now.taken, now.point, {}, now.solution.slopes)
            self._note("drop", UNKNOWN, known, now, "its place is more probably another cause's or empty")
            self.tell(self._words(known))
            return known
        for name, place in posterior.places.items():
            if name in now.ids and name not in self.scan.places() and place.probability.get(UNKNOWN, 0.0) > 0.5:
                without = self._given_up(now, name)
                if without is not None:
                    return without
        for name, place in posterior.places.items():
            if name in now.ids:
                empty = place.probability[NONE] > 0.5
                reason = "its place is more probably empty" if empty else self._idle_by_now(now, name)
                without = self._refitted(now, name) if reason else None
                if without is not None:
                    self.refused[name] = f"dropped: {reason}"
                    self._note("drop", name, without, now, reason)
                    self.tell(self._words(without))
                    return without
        return None

    def _idle_by_now(self, now: JointFit, name: str) -> str:
        """Return why a taken cause changes nothing beside those that were taken after it; empty if it does.

        What strong causes together do may first look like another one.
        """
        others = frozenset(now.ids) - {name}
        loss = loss_of(now, name)
        if name in self.scan.places() or self._busy.get(name) == others:
            return ""
        self._busy[name] = others
        if loss >= WORTH * (self.first - now.misfit - loss):
            return ""
        without = self._refitted(now, name, fine=False)
        return "" if without is None else self._idle(without, now)

    def _given_up(self, now: JointFit, name: str) -> JointFit | None:
        """Return the fit with something unknown in the place of a cause; None if no block of it is left."""
        without = self._refitted(now, name, fine=False)
        if without is None:
            return None
        asked = self.judge.further(without, self.unknown, self.not_unknown)
        if not asked.unknown:
            return None
        kept = [t for t in now.taken if t.id != name]
        found = self._with_unknown(
            kept, without.point, {**self.unknown, **asked.unknown}, without.solution.slopes
        )  # fmt: skip
        self.refused[name] = "something unknown is more probable in its place"
        self._note("exchange", UNKNOWN, found, now, "is more probable", name)
        self.tell(self._words(found))
        return found

    def _exchanged(self, now: JointFit, posterior: Posterior) -> JointFit | None:
        """Return the fit with another cause in a place, where that is more probable.

        Fitted are all of a place's credible set, and once those that come near by their forms.
        """
        for name, place in posterior.places.items():
            if name not in now.ids or name in self.scan.places():
                continue
            own = place.log_bayes.get(name, 0.0)
            near = sorted(place.log_bayes, key=lambda n: -place.log_bayes[n])
            if any(taken == name for taken, _ in self._behind):
                near = list(place.credible_set)
            else:
                near = [n for n in near if n in place.credible_set or place.log_bayes[n] > (1.0 - SUBSTITUTE) * own]
            near = [n for n in near if n not in (name, UNKNOWN) and (name, n) not in self._behind]
            if not near:
                continue
            try:
                without = self._lacking(now, name)
            except InputError:
                continue
            for other in near[:TRIED]:
                better, ahead = self._in_place(now, without, name, other)
                if better is not None and ahead > AHEAD:
                    self._behind[other, name] = ahead
                    self._note("exchange", other, better, now, "is more probable", name)
                    self.tell(self._words(better))
                    return better
                self._behind[name, other] = -ahead
                self.fitter.model.anchor(now.point)
        return None

    def _note(self, move: str, cause: str, after: JointFit, before: JointFit, reason: str, other: str = "") -> None:
        if move != "add":
            self.in_vain.clear()
            self._vain_at.clear()
        seconds = time.monotonic() - self._began
        self.steps.append(Step(move, cause, after.misfit, before.misfit - after.misfit, reason, seconds, other))

    def _words(self, fitted: JointFit) -> str:
        step = self.steps[-1]
        left = max(fitted.misfit - fitted.residual.size, 0.0)
        return f"{step.move} {step.cause}: {100 * self.share(left):.3g} % of the misfit left, {len(fitted.ids)} causes"

    def _rounds_left(self, now: JointFit, before: JointFit) -> float:
        """Return how many more causes are expected if each removes as large a share as the last one did."""
        own = float(now.residual.size)
        noise = np.sqrt(2.0 * own)
        left, there = max(now.misfit - own, noise), max(before.misfit - own, 2.0 * noise)
        return float(1 + np.log(left / noise) / max(np.log(there / left), 0.2))
