"""Trial fits: what a cause would bring beside those taken, without one of them, and in the place of one.

They are by derivatives about the present anchor, some of them corrected by the steps since; what is taken is fitted
again about the fine model (:mod:`evanesce.inference.search`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.core.errors import InputError
from evanesce.inference.causes import Cause, by_departure, departure, entries_of
from evanesce.inference.constants import SUBSTITUTE, TRIED
from evanesce.inference.gauss_newton import Slopes
from evanesce.inference.joint import Fitter, taken_from
from evanesce.inference.joint_fit import JointFit, Taken
from evanesce.inference.judge import Judge
from evanesce.inference.removal import Removal, everything_marginalised, loss_of, removal
from evanesce.prediction.linear import Metric

Array = NDArray[Any]
Tell = Callable[[str], None]
Shown = Callable[[Mapping[str, float], Sequence[Cause]], Mapping[str, float]]

SHARES = (1.0, 0.4)
"""Of the linear estimate at which a cause is entered: where a straight line overshoots, the shorter one is nearer."""
TRIAL_ROUNDS = 6
"""Steps of a fit that only ranks causes; those that are taken are fitted to their end."""
NEARER = (1.0, 0.3, 0.1)
"""Deviations of what a cause's form may be, over those of its parameters' priors or of the discrepancy; each as
probable."""


@dataclass
class Trials:
    """Fits that are tried.

    Attributes
    ----------
    fitter : Fitter
    causes : sequence of Cause
    judge : Judge
    tell : callable
        Told each move and the time left.
    shown : callable
        Returns at which figures of some causes views that show nothing else are as bright as they are, others as at a
        point.
    """

    fitter: Fitter
    causes: Sequence[Cause]
    judge: Judge
    tell: Tell = lambda line: None
    shown: Shown = lambda point, causes: {}
    refused: dict[str, str] = field(default_factory=dict)
    _weighed: tuple[JointFit, str, float] | None = None
    """A fit, one of its causes, and the evidence against which others in its place are weighed."""
    _lacks: tuple[JointFit, dict[str, JointFit | None]] | None = None
    """A fit, and those without one of its causes."""
    _whole: tuple[JointFit, float] | None = None
    """A fit, and what its causes leave at the best."""

    def _worth_entering(self, ranked: Sequence[str]) -> Sequence[str]:
        """Return which causes of a list, the likeliest first, are entered."""
        return ranked[:TRIED]

    def _occam(self, tried: int) -> float:
        """Return what a fitted cause must bring [nats]: the choice among all causes, and its own strength."""
        return float(np.log(2.0 * len(self.causes)) + 1.0 + np.log(max(tried, 1)))

    def _entered(self, now: JointFit, name: str, metric: Metric, believed: Array) -> Removal | None:
        """Return the best way into a cause, linear about the present fit; None if there is none."""
        cause = next((c for c in self.causes if c.id == name), None)
        if cause is None:
            return None
        model = self.fitter.model
        base = model.vector(now.point)
        # What moves an edge by pixels has no straight line to there from its derivative; forms were drawn as far off.
        drawn = self.judge.departures(cause) if cause.amplitudes else []
        entries = [departure(cause, row, point) for point, row in drawn]
        if not (cause.costly and drawn):  # another light of the plate takes seconds
            if cause.costly:
                self.tell(f"light of the plate for {name}")
            entries += entries_of(model, now.point, base, cause)
        shown = self.shown(now.point, [cause])
        entries += by_departure(model, now.point, base, cause, shown) if shown else []
        if not entries:
            self.refused[name] = "no plausible amount of it shows"
            return None
        projected = metric.project(believed)
        return max((removal(entry, metric, projected) for entry in entries), key=lambda r: r.removed)

    def _tried(self, now: JointFit, found: Removal, metric: Metric, believed: Array) -> JointFit | None:
        """Return the joint fit with an entered cause, by coarse derivatives about the present anchor."""
        taken = taken_from(found.entry)
        best: tuple[float, dict[str, float]] | None = None
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
            return self._beside(now, [taken], {**now.point, **best[1]})
        except InputError:
            return None

    def _beside(self, now: JointFit, more: Sequence[Taken], start: Mapping[str, float]) -> JointFit:
        """Return the joint fit with some causes more, by coarse derivatives about the present anchor."""
        own = [
            row for t in more for row in (t.slow.values() if t.slow else self.fitter.derivatives(start, t.parameters))
        ]
        count = sum(len(t.parameters) for t in now.taken)
        rows = np.concatenate([now.solution.rows[:count], own, now.solution.rows[count:]])
        return self.fitter.fitted(
            (*now.taken, *more), start, metric=now.metric, slopes=Slopes(rows.astype(float)), rounds=TRIAL_ROUNDS,
            renewals=0,
        )  # fmt: skip

    def _refitted(self, now: JointFit, name: str, *, fine: bool = True) -> JointFit | None:
        """Return the fit without a cause; coarse derivatives about the present anchor will do to try others in it."""
        kept = [t for t in now.taken if t.id != name]
        try:
            if fine:
                return self.fitter.relinearised(kept, now.without(name))
            own = set(now.of_cause(name).tolist())
            rows = now.solution.rows[[k for k in range(len(now.parameters)) if k not in own]]
            return self.fitter.fitted(
                kept, now.without(name), metric=now.metric, slopes=Slopes(rows), rounds=TRIAL_ROUNDS, renewals=0
            )
        except InputError:
            return None

    def lost(self, now: JointFit, name: str) -> float:
        """Return by how much the misfit rises without a cause, all else fitted again within its bounds.

        A straight line about the fit does not know that a nuisance which makes up for the cause has a bound, nor that
        a strong cause bends. Where something unknown held the fit elsewhere, that is not the best one without it.
        """
        without = self.lacking(now, name)
        return loss_of(now, name) if without is None else max(without.misfit - self._least(now), 0.0)

    def lacking(self, now: JointFit, name: str) -> JointFit | None:
        """Return the fit without a cause, all else fitted again by straight lines; None if the rig cannot lack it."""
        if self._lacks is None or self._lacks[0] is not now:
            self._lacks = now, {}
        known = self._lacks[1]
        if name not in known:
            known[name] = self._refitted(now, name, fine=False)
        return known[name]

    def _least(self, now: JointFit) -> float:
        """Return the misfit with all causes, fitted again where something unknown was marginalised beside them."""
        if not len(self.fitter.fields) or now.fields:
            return now.misfit
        if self._whole is None or self._whole[0] is not now:
            whole = self._refitted(now, "", fine=False)
            self._whole = now, now.misfit if whole is None else min(whole.misfit, now.misfit)
        return self._whole[1]

    def _lacking(self, now: JointFit, name: str) -> JointFit:
        """Return the fit without a cause, all else as it is: its misfit that with all else marginalised.

        Raises
        ------
        InputError
            If the rig cannot lack it.
        """
        taken = tuple(t for t in now.taken if t.id != name)
        kept = np.delete(np.arange(len(now.parameters)), now.of_cause(name))
        point, old = now.without(name), now.solution
        predicted = self.fitter.predicted(point, taken)
        solution = replace(
            old, values=old.values[kept], predicted=predicted, slopes=Slopes(old.rows[kept]),
            precision=old.precision[np.ix_(kept, kept)], held=old.held[kept],
        )  # fmt: skip
        parameters = tuple(now.parameters[k] for k in kept)
        residual = self.fitter.observed - predicted
        lacking = replace(now, taken=taken, parameters=parameters, point=point, solution=solution, residual=residual)
        metric, believed = everything_marginalised(lacking)
        return replace(lacking, solution=replace(solution, misfit=float(metric.project(believed) @ believed)))

    def _in_place(self, now: JointFit, without: JointFit, name: str, other: str) -> tuple[JointFit | None, float]:
        """Return the fit with another cause in a place, and by how many nats it is more probable than the present one.

        What a straight line says suffices where that falls far short; a coarse fit where it falls short.
        """
        metric, believed = everything_marginalised(without)
        entered = self._entered(without, other, metric, believed)
        if entered is None:
            return None, -np.inf
        short = without.misfit - now.misfit - entered.removed
        if short > SUBSTITUTE * (without.misfit - now.misfit):
            return None, -0.5 * short
        tried = self._tried(without, entered, metric, believed)
        if tried is None:
            return None, -np.inf
        ahead = self._ahead(now, name, tried, other)
        if ahead < 0.0:
            return tried, ahead
        try:
            better = self.fitter.relinearised(tried.taken, tried.point, tried.solution.slopes, renewals=0)
            ahead = self._ahead(now, name, better, other)
        except InputError:
            better, ahead = None, -np.inf
        return better, ahead

    def _ahead(self, now: JointFit, name: str, better: JointFit, other: str) -> float:
        """Return by how many nats a fit with another cause in a place is more probable than the present one.

        Each by the discrepancy of its own causes, which are off by per cents of what they do: that is more than what
        decides between two strong causes that look alike, but no cause is off by what another one does.
        """
        if self._weighed is None or self._weighed[0] is not now or self._weighed[1] != name:
            self._weighed = now, name, self._evidence(now, name)
        return self._evidence(better, other) - self._weighed[2]

    def _evidence(self, fitted: JointFit, name: str) -> float:
        """Return the log evidence of a fit, how strong one of its causes may be left open [nats].

        Along the direction that data know best a cause has no prior but that of strengths, which all causes share. What
        else its form may be is as probably near its null as far from it: room light is often even, a strip's own sides
        alike. So is what forms are off by, or nothing: a law that data follow is not the worse for what it might have
        been off by.
        """
        rows = self.judge.discrepancy.every_row(fitted)
        metrics = [fitted.metric, *(fitted.metric.with_rows(rows.times(nearer)) for nearer in NEARER)]
        each = [self._evidence_in(metric, fitted, name) - 0.5 * metric.log_det for metric in metrics]
        return float(np.logaddexp.reduce(each) - np.log(len(each)))

    def _evidence_in(self, metric: Metric, fitted: JointFit, name: str) -> float:
        """Return it in one metric, without that one's own factor."""
        found = fitted.in_metric(metric)
        places = fitted.of_cause(name)
        cause = next((c for c in self.causes if c.id == name), None)
        amplitudes = cause.amplitudes if cause is not None else frozenset()
        form = np.array([k for k in places if fitted.parameters[k].name not in amplitudes], int)
        half = np.log(2.0) if cause is not None and cause.one_sided else 0.0
        each = []
        for nearer in NEARER if form.size else NEARER[:1]:
            deviation = np.array([p.deviation for p in fitted.parameters])
            deviation[form] *= nearer
            evidence, covariance = found.by_prior(deviation)
            known = covariance[np.ix_(places, places)] / np.outer(deviation[places], deviation[places])
            each.append(evidence - 0.5 * np.log(np.linalg.eigvalsh(known)[0]) + half)
        return float(np.logaddexp.reduce(each) - np.log(len(each)))
