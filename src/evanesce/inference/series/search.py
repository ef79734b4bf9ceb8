"""Search among causes by fits: rows are few and fits cheap, so that what a cause's fit says stands in for its forms.

About an extended fit the nuisances of so few rows may imitate the very cause that is judged (light, once light scatters
across the threshold). What fills a place is therefore judged where the cause is not: all else fitted again without it,
then with each other cause in its place, by Laplace's evidence of those fits.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from evanesce.inference.constants import SUBSTITUTE, TRIED
from evanesce.inference.joint_fit import JointFit
from evanesce.inference.posterior import Posterior
from evanesce.inference.removal import everything_marginalised
from evanesce.inference.search import Search
from evanesce.inference.single_effects import Place


@dataclass
class SeriesSearch(Search):
    """The moves, with places judged by fits."""

    _judged: dict[tuple[str, ...], Place] = field(default_factory=dict)

    def posterior(self, now: JointFit) -> Posterior:
        """Return the probabilities of all causes at a joint fit, those that can be fitted by their fits."""
        found = super().posterior(now)
        places = dict(found.places)
        for name in (n for n in found.places if n in now.ids):
            # What was fitted in a place at the model's optimum stands above what was fitted by derivatives.
            fitted = {other: gap for (own, other), gap in self._behind.items() if own == name}
            places[name] = self._place(now, name, places[name]).with_fits(name, fitted)
        return replace(found, places=places)

    def _worth_entering(self, ranked: Sequence[str]) -> Sequence[str]:
        """Return all causes but those whose light takes seconds and that are not among the likeliest."""
        costly = {c.id for c in self.causes if c.costly}
        return [name for number, name in enumerate(ranked) if number < TRIED or name not in costly]

    def _place(self, now: JointFit, name: str, by_forms: Place) -> Place:
        key = (name, *now.ids, f"{now.misfit:.6g}")
        if key not in self._judged:
            without = self._refitted(now, name, fine=False)
            self._judged[key] = by_forms if without is None else self._by_fits(now, without, name)
        return self._judged[key]

    def _by_fits(self, now: JointFit, without: JointFit, name: str) -> Place:
        refused = dict(self.refused)
        metric, believed = everything_marginalised(without)
        bayes = dict(self.judge.further(without, self.unknown).place.log_bayes)
        least = (1.0 - SUBSTITUTE) * max(bayes.values())
        sides = {c.id: np.log(2.0) if c.one_sided else 0.0 for c in self.causes}
        for cause in self.causes:
            known = cause.id in bayes and not cause.costly
            if cause.id != name and not (known and bayes[cause.id] > least):
                continue
            found: JointFit | None = now
            if cause.id != name:
                entry = self._entered(without, cause.id, metric, believed)
                found = None if entry is None else self._tried(without, entry, metric, believed)
            if found is None:
                del bayes[cause.id]  # no plausible amount of it shows
            else:
                bayes[cause.id] = found.log_evidence - without.log_evidence + sides[cause.id]
        # What was not entered for another place may still be for the next one.
        self.refused.clear()
        self.refused.update(refused)
        return Place.of(bayes)
