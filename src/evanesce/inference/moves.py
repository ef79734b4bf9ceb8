"""What is done with a cause once it is in the joint fit: it is dropped, exchanged, or left for something unknown."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.core.errors import InputError
from evanesce.inference.consequence import AreaReader
from evanesce.inference.constants import LEAST_AREA, SUBSTITUTE, TRIED, WORTH
from evanesce.inference.explained import Scan
from evanesce.inference.gauss_newton import Slopes
from evanesce.inference.joint_fit import JointFit, Taken
from evanesce.inference.posterior import Posterior
from evanesce.inference.removal import loss_of
from evanesce.inference.single_effects import NONE, UNKNOWN
from evanesce.inference.trials import Trials

Array = NDArray[Any]

AHEAD = 1.0
"""Nats by which another cause has to be more probable to take a place: a fit ends within half a nat of its optimum."""
GAVE_WAY = "something unknown is more probable in its place"
"""Of a cause that was given up for something unknown, as long as that is there."""

DROPPED, REMOVES = "dropped", "removes"
"""Words with which reasons begin."""


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
class Moves(Trials):
    """Moves by which causes leave the joint fit, and what all moves leave behind."""

    steps: list[Step] = field(default_factory=list)
    in_vain: dict[str, str] = field(default_factory=dict)
    """Causes that were fitted beside the present ones and bring too little, with what they bring."""
    faint: dict[str, str] = field(default_factory=dict)
    """Those that would take no more of what is not explained than any form might."""
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

    def posterior(self, now: JointFit) -> Posterior:
        """Return the probabilities of all causes at a joint fit, about which the model is anchored."""
        return self.judge.posterior(now, self.unknown, self._behind)

    @property
    def not_taken(self) -> dict[str, str]:
        """Causes that are not in the fit though they were tried or not worth it, with the reason."""
        return {**self.refused, **self.in_vain, **self.faint}

    @property
    def idle(self) -> tuple[str, ...]:
        """Causes that were not taken, or dropped, for moving no area: what is left may be theirs."""
        return tuple(
            name for name, why in self.not_taken.items() if why.removeprefix(f"{DROPPED}: ").startswith(REMOVES)
        )

    def share(self, misfit: float) -> float:
        """Return a misfit over what there was to explain."""
        return misfit / max(self.first - self.floor, 1.0)

    def _with_unknown(
        self, taken: Sequence[Taken], point: Mapping[str, float], unknown: dict[str, float], slopes: Slopes
    ) -> JointFit:
        """Return the fit of some causes with blocks of something unknown marginalised, and no other of them."""
        self.unknown, self.fitter.fields = unknown, self.judge.fields(unknown)
        self._behind.clear()
        return self.fitter.relinearised(taken, point, Slopes(slopes.rows), renewals=0)

    def _chance(self, now: JointFit) -> float:
        """Return of how much misfit a form might take its share by chance: of what nothing explains.

        Where something unknown is taken, of what is explained as well: no field follows it exactly.
        """
        left = max(now.misfit - self.floor, 0.0)
        return WORTH * (left + (max(self.first - now.misfit, 0.0) if self.unknown else 0.0))

    def _idle(self, now: JointFit, fitted: JointFit) -> str:
        """Return why a further cause would change nothing that a user asks for; empty if it would.

        What strong causes leave because no form is exact asks for many weak ones: beside what was taken before, a cause
        has to remove a share of as much, or to move the area that the fit predicts. What it moves by itself does not
        count: others that it takes from may move it back.
        """
        explained = max(self.first - now.misfit, 1.0)
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
        return f"{REMOVES} {share}, moves the area by {100 * change.largest:.2g} %"

    def _dropped(self, now: JointFit, posterior: Posterior) -> JointFit | None:
        """Return the fit without a cause whose place is more probably empty, or filled by something unknown."""
        place = posterior.places.get(UNKNOWN)
        if place is not None and place.probability.get(UNKNOWN, 0.0) < 0.5:
            self.not_unknown |= set(self.unknown)
            self.refused = {name: why for name, why in self.refused.items() if why != GAVE_WAY}
            known = self._with_unknown(now.taken, now.point, {}, now.solution.slopes)
            self._note("drop", UNKNOWN, known, now, "its place is more probably another cause's or empty")
            self.tell(self._words(known))
            return known
        for name, place in posterior.places.items():
            if name in now.ids and name not in self.scan.places() and place.probability.get(UNKNOWN, 0.0) > 0.5:
                without = self._given_up(now, name)
                if without is not None:
                    return without
        taken = [name for name in posterior.places if name in now.ids]
        for name in sorted(taken, key=lambda name: loss_of(now, name)):
            place = posterior.places[name]
            empty = place.probability[NONE] > 0.5
            reason = "its place is more probably empty" if empty else self._idle_by_now(now, name)
            without = self._refitted(now, name) if reason else None
            if without is not None:
                self.refused[name] = f"{DROPPED}: {reason}"
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
        self.refused[name] = GAVE_WAY
        self._note("exchange", UNKNOWN, found, now, "is more probable", name)
        self.tell(self._words(found))
        return found

    def _exchanged(self, now: JointFit, posterior: Posterior) -> JointFit | None:
        """Return the fit with another cause in a place, where that is more probable.

        Fitted are all of a place's credible set, and once those that come near by their forms.
        """
        for number, (name, place) in enumerate(posterior.places.items(), 1):
            if name not in now.ids or name in self.scan.places():
                continue
            own = place.log_bayes.get(name, 0.0)
            near = sorted(place.log_bayes, key=lambda n: -place.log_bayes[n])
            if any(taken == name for taken, _ in self._behind):
                near = list(place.credible_set)
            else:
                # Forms of a strong cause are off by its curvature, and the taken one's own is not: the first rival
                # is always asked.
                rivals = [n for n in near if n not in (name, UNKNOWN)][:1]
                close = [n for n in near if n in place.credible_set or place.log_bayes[n] > (1.0 - SUBSTITUTE) * own]
                near = close + [n for n in rivals if n not in close]
            # What was dropped from beside others does not come back by taking their place, unless that is left to
            # nothing else.
            gone = {name, UNKNOWN, *(self.refused if name in place.credible_set else ())}
            near = [n for n in near if n not in gone and (name, n) not in self._behind]
            if not near:
                continue
            try:
                without = self._lacking(now, name)
            except InputError:
                continue
            for other in near[:TRIED]:
                self.tell(f"{other} in the place of {name} (place {number} of {len(posterior.places)})")
                better, ahead = self._in_place(now, without, name, other)
                if better is not None and ahead > AHEAD:
                    self._behind[other, name] = ahead
                    self.refused.pop(other, None)
                    self._note("exchange", other, better, now, "is more probable", name)
                    self.tell(self._words(better))
                    return better
                self._behind[name, other] = -ahead
                self.fitter.stand(now.taken, now.point)
        return None

    def _note(self, move: str, cause: str, after: JointFit, before: JointFit, reason: str, other: str = "") -> None:
        if move != "add":
            self.in_vain.clear()
            self.faint.clear()
            self._vain_at.clear()
        seconds = time.monotonic() - self._began
        self.steps.append(Step(move, cause, after.misfit, before.misfit - after.misfit, reason, seconds, other))

    def _words(self, fitted: JointFit) -> str:
        step = self.steps[-1]
        left = max(fitted.misfit - fitted.residual.size, 0.0)
        return f"{step.move} {step.cause}: {100 * self.share(left):.3g} % of the misfit left, {len(fitted.ids)} causes"
