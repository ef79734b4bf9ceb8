"""Which causes there are, with which probability: the joint fit as a sum of single effects.

Each taken cause has a place of its own. What its place is filled by is judged on the data less the prediction without
that cause, with all that else is fitted, and the discrepancy, marginalised: the cause itself, any cause that was not
taken, something unknown, or nothing. One more place asks for a further cause. So whatever else is said of the causes
(verdict, sets, groups) is read off these probabilities.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

from numpy.typing import NDArray

from evanesce.inference.constants import DETECTED
from evanesce.inference.single_effects import (
    NONE,
    UNKNOWN,
    Place,
)

Array = NDArray[Any]

DEFECTS = "localised defects"
"""Place of those that behave like no cause."""


@dataclass(frozen=True)
class Posterior:
    """Probabilities of the causes.

    Attributes
    ----------
    places : mapping of str to Place
        Of each taken cause, and of what was taken as unknown.
    further : Place
        One more.
    further_p : float
        p-value of the evidence for a further cause, against noise.
    """

    places: Mapping[str, Place]
    further: Place
    further_p: float
    most: float = 1.0
    """Highest probability that is told."""

    def with_defects(self, found: Mapping[str, Place]) -> Posterior:
        """Return it with the places of localised defects as their scan has them.

        Parameters
        ----------
        found : mapping of str to Place
            By the cause that explains them best, ``unknown`` for those that behave like none.
        """
        named = {name if name != UNKNOWN else DEFECTS: place for name, place in found.items()}
        return replace(self, places={**self.places, **named})

    def fitted_in_vain(self, causes: Iterable[str]) -> Posterior:
        """Return it where some causes were fitted in the place of a further one and brought too little.

        What a sum of a cause's forms explains but no figures of its law do is made by something that the library lacks.

        Parameters
        ----------
        causes : iterable of str
        """
        places = {name: p.without_law(causes) if name == UNKNOWN else p for name, p in self.places.items()}
        return replace(self, places=places, further=self.further.without_law(causes))

    def at_most(self, most: float) -> Posterior:
        """Return it where no cause has more than a probability, in a place or in all (:meth:`Place.at_most`)."""
        places = {name: place.at_most(most) for name, place in self.places.items()}
        return replace(self, places=places, further=self.further.at_most(most), most=most)

    @property
    def asks(self) -> bool:
        """Whether noise alone would hardly give as much evidence for a further cause."""
        return self.further_p < DETECTED

    @property
    def inclusion(self) -> dict[str, float]:
        """Probability of each cause to be in the rig, the most probable first."""
        out: dict[str, float] = {}
        for place in (*self.places.values(), self.further):
            for name, probability in place.probability.items():
                if name != NONE:
                    out[name] = out.get(name, 1.0) * (1.0 - probability)
        told = {name: min(1.0 - left, self.most) for name, left in out.items()}
        return dict(sorted(told.items(), key=lambda pair: -pair[1]))

    def as_dict(self) -> dict[str, Any]:
        """Return it in the answer's form."""
        return {
            "inclusion": self.inclusion,
            "places": {
                name: {"credible_set": list(p.credible_set), "probability": _largest(p)}
                for name, p in self.places.items()
            },
            "further": {
                "credible_set": list(self.further.credible_set), "probability": _largest(self.further),
                "p_value": self.further_p,
            },
        }  # fmt: skip


def _largest(place: Place) -> dict[str, float]:
    ordered = sorted(place.probability.items(), key=lambda pair: -pair[1])
    return {name: value for name, value in ordered if value >= 0.001}


@dataclass(frozen=True)
class Further:
    """Evidence for one more cause.

    Attributes
    ----------
    place : Place
        The discrepancy marginalised: decides whether there is any.
    p_value : float
        Of that, against noise.
    by_misfit : Place
        Without the discrepancy: who takes most of the misfit. While most of it is there, what a strong cause's form may
        be off by hides which cause comes next.
    unknown : mapping of str to float
        The block of something unknown that has most evidence, with its amplitude; empty where none is left.
    library : float
        Log Bayes factor of a sum of all forms of the library over nothing: many causes at once may look like a smooth
        field, which a library that makes all of them explains better [nats].
    """

    place: Place
    p_value: float
    by_misfit: Place
    unknown: Mapping[str, float]
    library: float


@dataclass(frozen=True)
class Weights:
    """What data say of the weights of a cause's forms.

    Attributes
    ----------
    forms : int
    mean : ndarray (forms,)
    root : ndarray (forms, m)
        Root of their covariance.
    """

    forms: int
    mean: Array
    root: Array
