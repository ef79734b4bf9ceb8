"""Moves from the nominal rig's fit to the extended one's: causes are added one at a time, dropped, and exchanged.

What is tried is what the evidences of all causes' forms say (:mod:`evanesce.inference.judge`); what is taken is
decided by the joint fit about the fine model, made anew after each move, so that a strong cause's curvature is not
taken for a further cause.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.core.errors import InputError
from evanesce.inference.constants import DETECTED, FITTED, LEAST_SHARE, SUBSTITUTE, WORTH
from evanesce.inference.explained import Scan
from evanesce.inference.gauss_newton import Slopes
from evanesce.inference.joint_fit import JointFit, Taken
from evanesce.inference.marks import NEAR, MarkSearch
from evanesce.inference.moves import Moves
from evanesce.inference.posterior import Further, Posterior
from evanesce.inference.removal import everything_marginalised
from evanesce.inference.single_effects import NONE, UNKNOWN
from evanesce.inference.unknown import told_fields

Array = NDArray[Any]

GROWN = 1.5
"""Ratio of evidences beyond which a cause that was fitted in vain is fitted once more."""
BEGINNING = 2
"""Causes after which the first is asked about again: without others a wrong one may remove most."""
GOOD_BEGINNING = 0.1
"""Share of the misfit that a good beginning leaves: of five to ten strong causes, two rightly named leave less in half
of all rigs (assumed), and another beginning takes as long again."""
MOVES = 60
"""Moves in all: the last resort of a search that does not end by itself."""


@dataclass
class Search(Moves):
    """The moves, from the nominal rig's own fit.

    Attributes
    ----------
    fitted : int
        Causes that are fitted in each round, of those that are entered.
    """

    fitted: int = FITTED
    marks: MarkSearch | None = None
    _scanned: bool = False
    _sought_beside: frozenset[str] | None = None
    """Causes beside which defects were sought; None once they have been sought again."""
    _renewed: frozenset[str] | None = None
    """Causes about which all derivatives were made anew last."""

    def run(self, base: JointFit) -> tuple[JointFit, Posterior]:
        """Return the extended fit, the model anchored about it, and the probabilities of all causes there.

        It ends where no move is left, or at causes at which it has been before: some take turns.

        Parameters
        ----------
        base : JointFit
            Of the nominal model, the model anchored about it.
        """
        self.first, self.floor = base.misfit, float(self.fitter.observed.size)
        now = self._grown(base)
        marked = self._with_defects(now)
        now = now if marked is now else self._grown(marked)
        seen = set()
        while True:
            posterior, compared = self.posterior(now).with_defects(self.scan.places()), len(self._behind)
            posterior = posterior.fitted_in_vain(set(self.in_vain) - set(self.idle))
            known = frozenset(now.ids) | frozenset(self.unknown)
            turning = known in seen
            moved = None if turning else self._dropped(now, posterior) or self._exchanged(now, posterior)
            if moved is not None:
                seen.add(known)
            if turning or len(self.steps) >= MOVES or (moved is None and len(self._behind) == compared):
                moved = self._with_defects_anew(now)
                if moved is None:
                    best = now.known_alone()
                    self.floor = self._floor(best, posterior)
                    return best, posterior
            now = now if moved is None else self._grown(moved)

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
        began, start = time.monotonic(), now
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
                now = self._begun(start, better) if not start.ids and len(better.ids) == BEGINNING else better
                began = time.monotonic()
            elif self._little_left(now):
                return now  # it is told, and not marginalised: forms are off by as much
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

    def _begun(self, start: JointFit, now: JointFit) -> JointFit:
        """Return the better of two beginnings: where the first causes leave much, others are taken without it.

        What several causes do together may look most like one that is not there, and everything after it makes up for
        it. What views show that show nothing else looks like no other.
        """
        surely = {name.partition(":")[0] for name in self.shown(start.point, self.causes)}
        first = next((name for name in now.ids if name not in surely), "")
        if self.unknown or not first or self.share(now.misfit) < GOOD_BEGINNING:
            return now
        steps = self.steps
        self.tell(f"{', '.join(now.ids)} leave much: begun again without {first}")
        self.steps = []
        other = start
        for _ in range(BEGINNING):
            self.in_vain, self._vain_at = {first: "not at first"}, {first: np.inf}
            self.fitter.stand(other.taken, other.point)
            found = self._added(other, self.judge.further(other))
            if found is None:
                break
            other = found
            self.tell(self._words(other))
        self.in_vain, self._vain_at, self.faint = {}, {}, {}
        if other.misfit < now.misfit:
            return other
        self.steps = steps
        self.fitter.stand(now.taken, now.point)
        return now

    def _little_left(self, now: JointFit) -> bool:
        """Return whether less than WORTH of the misfit is left, where that is more than noise varies by."""
        little = WORTH * (self.first - self.floor)
        return now.misfit - self.floor < little and little > np.sqrt(2.0 * now.residual.size)

    def _with_defects(self, now: JointFit) -> JointFit:
        """Return the fit with the localised defects that stand out of it; they are sought once."""
        if self.marks is None or self._scanned:
            return now
        self._scanned = True
        self._sought_beside = frozenset(now.ids)
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

    def _with_defects_anew(self, now: JointFit) -> JointFit | None:
        """Return the fit with defects sought about it; None where the causes are those beside which they were sought.

        What causes that were not taken yet had left beside an edge stood out as well, and hid what should have.
        """
        listed, beside = {found.taken.id for found in self.scan.listed}, self._sought_beside
        if beside is None or frozenset(now.ids) - listed == beside:
            return None
        own = {k for name in listed for k in now.of_cause(name).tolist()}
        rows = now.solution.rows[[k for k in range(len(now.parameters)) if k not in own]]
        point = {name: value for name, value in now.point.items() if name.partition(":")[0] not in listed}
        kept = [t for t in now.taken if t.id not in listed]
        without = self.fitter.relinearised(kept, point, Slopes(rows), renewals=0) if listed else now
        self.refused = {name: why for name, why in self.refused.items() if name not in listed}
        self.scan, self._scanned = Scan(), False
        again = self._with_defects(without)
        self._sought_beside = None
        for name in sorted(listed - set(again.ids)):
            self._note("drop", name, again, now, "stood out beside fewer causes, and does so no more")
            self.tell(self._words(again))
        return None if again is now else again

    def _denied(self, now: JointFit, listed: Sequence[Taken], start: Mapping[str, float]) -> dict[str, str]:
        """Return which causes whose places were found are not taken, with the reason, by a trial fit of them all.

        To some all views together give no strength, or far less than their places showed: what stood out is something
        else, as what a codec leaves beside an edge. Bands may be anything that varies from row to row, so that they
        have to be worth it as any cause has.
        """
        if not listed:
            return {}
        trial = self._beside(now, listed, {**now.point, **start})
        denied = {}
        for t in listed:
            if not np.any(trial.departures()[trial.of_cause(t.id)]):
                denied[t.id] = "places stand out, but the joint fit gives it no strength"
            elif t.id not in self.scan.ripples and _less_than_shown(trial, t.id, start):
                denied[t.id] = "places stand out, but the joint fit gives it less than half of what they show"
        for own in (t for t in listed if t.id in self.scan.ripples and t.id not in denied):
            alone = {name: v for name, v in start.items() if name.startswith(f"{own.id}:")}
            idle = self._idle(now, self._beside(now, [own], {**now.point, **alone}))
            denied |= {own.id: idle} if idle else {}
        return denied

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
        for poor in (e for e in entered if 0.5 * e.removed <= least):
            self.in_vain[poor.entry.cause.id] = f"would bring {0.5 * poor.removed:.1f} nats"
        strong = max(2.0 * least, self._chance(now))
        self.faint = {
            e.entry.cause.id: "takes no more of what is not explained than any form might by chance"
            for e in entered
            if 2.0 * least < e.removed <= strong
        }
        entered = sorted((e for e in entered if e.removed > strong), key=lambda e: -e.removed)
        near = [e for e in entered if e.removed > SUBSTITUTE * entered[0].removed]
        tried = [t for t in (self._tried(now, e, metric, believed) for e in near[: self.fitted]) if t is not None]
        unknown = place.log_bayes.get(UNKNOWN, 0.0)
        unknown = unknown if unknown > asked.library else 0.0
        found: list[JointFit] = []
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
                found.append(better)
            else:
                self.in_vain[cause] = f"brings {0.5 * removed:.1f} nats at the fine model's optimum"
            if 0.5 * removed > SUBSTITUTE * brought:
                break  # where less is kept of what straight lines promised, the next may keep more
        best = min(found, key=lambda one: one.misfit, default=now)
        self.fitter.stand(best.taken, best.point)
        if best is now:
            return None
        nats = 0.5 * (now.misfit - best.misfit)
        self._note("add", best.taken[-1].id, best, now, f"p = {p:.2g} of noise, {nats:.0f} nats by it")
        return best

    def _rounds_left(self, now: JointFit, before: JointFit) -> float:
        """Return how many more causes are expected if each removes as large a share as the last one did."""
        own = float(now.residual.size)
        noise = np.sqrt(2.0 * own)
        left, there = max(now.misfit - own, noise), max(before.misfit - own, 2.0 * noise)
        return float(1 + np.log(left / noise) / max(np.log(there / left), 0.2))


def _less_than_shown(fitted: JointFit, cause: str, shown: Mapping[str, float]) -> bool:
    """Return whether a fit gives all of a cause's parameters surely less than half of what places showed."""
    sd = np.sqrt(np.diag(np.linalg.inv(fitted.solution.precision)))
    found = []
    for k in fitted.of_cause(cause):
        parameter, value = fitted.parameters[k], fitted.solution.values[k]
        there = shown[parameter.name] - parameter.null
        short = np.sign(there) * (shown[parameter.name] - value)
        found.append(short > max(NEAR * sd[k], SUBSTITUTE * abs(there)))
    return all(found)
