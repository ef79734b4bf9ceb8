"""Weighs causes against each other about a joint fit: each one's place by itself, and evidence for one more."""

from __future__ import annotations

from collections.abc import Collection, Hashable, Iterable, Mapping, Sequence
from functools import partial
from types import MappingProxyType
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from evanesce.core.rng import generator
from evanesce.inference.causes import Cause
from evanesce.inference.form_noise import noise_along
from evanesce.inference.joint import Fitter
from evanesce.inference.joint_fit import JointFit
from evanesce.inference.laws import all_laws
from evanesce.inference.posterior import Further, Posterior, Weights
from evanesce.inference.power import Power, expected_power
from evanesce.inference.shapes import drawn_points
from evanesce.inference.single_effects import (
    LEAST_NORM,
    UNKNOWN,
    Place,
    Shapes,
    cause_of,
    null_statistics,
    p_value,
    place_of,
    statistic_of,
)
from evanesce.inference.small_space import SmallSpace
from evanesce.prediction.linear import CovarianceRows

Array = NDArray[Any]

NUISANCES, DISCREPANCY, LIGHT, FITTED, DRAWN = "nuisances", "discrepancy ", "light", "fitted ", "drawn"
"""Blocks of rows, some of them followed by a cause's name; that name alone is the block of its forms."""


class Bank(Protocol):
    """Forms of causes for some kind of data."""

    def blocks(self, causes: Sequence[Cause], data: Any) -> dict[str, Array]:
        """Return the whitened forms (forms, d) of causes that show, and rows of something unknown."""


class Rows(Protocol):
    """Discrepancy for some kind of data."""

    def light(self, fitted: JointFit) -> CovarianceRows:
        """Return the rows of the nominal light."""

    def tied(self, fitted: JointFit) -> Mapping[str, CovarianceRows]:
        """Return the rows of each cause of a joint fit by its name, the model anchored about it; others at ""."""

    def every_row(self, fitted: JointFit) -> CovarianceRows:
        """Return both."""

    def sizes(self, fitted: JointFit) -> Mapping[str, float]:
        """Return the norm of what each cause changes, by its name [standard deviations]."""


class Judge:
    """Weighs causes against each other at a joint fit.

    Parameters
    ----------
    fitter : Fitter
    causes : sequence of Cause
    bank : Bank
    discrepancy : Rows
    reach : float
        Prior deviations up to which a cause may be there; strengths end where its largest form would be exceeded by
        that. Data of few rows tell causes apart by how much of each is plausible.
    seed : int
        Of the draws of noise.
    """

    def __init__(
        self,
        fitter: Fitter,
        causes: Sequence[Cause],
        bank: Bank,
        discrepancy: Rows,
        *,
        reach: float = np.inf,
        seed: int = 0,
    ) -> None:
        self.fitter, self.discrepancy, self.reach, self.seed = fitter, discrepancy, reach, seed
        self.grown = frozenset(c.id for c in causes if c.one_sided) if np.isfinite(reach) else frozenset()
        blocks = bank.blocks(causes, fitter.model.data)
        self.known = tuple(blocks)
        self._forms = SmallSpace(blocks, np.zeros((0, fitter.observed.size)), coarse=True)

    def set_noise(self, fitter: Fitter, variance: float) -> None:
        """Go on with data whose noise has another variance, in units of the present one.

        Forms are counted in its standard deviations; those of something unknown are as large as can be told anyway.
        """
        self.fitter = fitter
        self._forms.scale([name for name in self.known if cause_of(name) != UNKNOWN], 1.0 / float(np.sqrt(variance)))

    def _shapes(self, name: str, gram: Array) -> Shapes:
        reach = np.inf if cause_of(name) == UNKNOWN else self.reach
        return Shapes.of(name, gram, reach=reach, one_sided=name in self.grown)

    def departures(self, cause: Cause) -> list[tuple[dict[str, float], Array]]:
        """Return points of a cause at which forms were drawn, and their whitened changes (d,); none if some failed.

        Parameters
        ----------
        cause : Cause
        """
        points = drawn_points(cause, generator(0, "forms", cause.id))
        own = self._forms.places.get(cause.id)
        if own is None or len(own) != len(points) + len(all_laws().get(cause.id, ())):
            return []
        return [(point, self._forms.rows[k].astype(np.float32)) for point, k in zip(points, own, strict=False)]

    def posterior(
        self,
        fitted: JointFit,
        unknown: Mapping[str, float] = MappingProxyType({}),
        behind: Mapping[tuple[str, str], float] | None = None,
    ) -> Posterior:
        """Return the probabilities of all causes at a joint fit, about which the model is anchored.

        Parameters
        ----------
        fitted : JointFit
        unknown : mapping of str to float
            Amplitudes of the blocks of something unknown that have been taken.
        behind : mapping of tuple of str to float, optional
            By how many nats another cause came out behind a taken one (taken, other) when it was fitted in its place:
            what a fit says, its bounds kept, stands above what drawn forms say.
        """
        space, secants = self._space(fitted, fitted.ids)
        own = self._other_laws(space, fitted)
        marginal, rest = _marginal(secants, unknown, own), self._rest(secants, unknown)
        further, p = self._judged(space, marginal, rest, len(secants), with_p=True)
        places = {}
        for number, name in enumerate(secants):
            others = [n for n in secants if n != name]
            place, _ = self._judged(space, _marginal(others, unknown, own), self._rest(others, unknown), number)
            fits = {b: gap for (a, b), gap in (behind or {}).items() if a == name}
            places[name] = place.beside(further).with_fits(name, fits)
        if unknown:
            every = _marginal(secants, {}, own)
            places[UNKNOWN], _ = self._judged(space, every, self._rest(secants, {}), len(secants))
        return Posterior(places, further, p)

    def further(
        self,
        fitted: JointFit,
        unknown: Mapping[str, float] = MappingProxyType({}),
        left_out: Collection[str] = (),
    ) -> Further:
        """Return what a further cause would be.

        Parameters
        ----------
        fitted : JointFit
        unknown : mapping of str to float
            Amplitudes of the blocks of something unknown that have been taken.
        left_out : collection of str
            Blocks of something unknown that are not asked about.
        """
        space, _ = self._space(fitted, ())
        own = self._other_laws(space, fitted)
        marginal, rest = _marginal(fitted.ids, unknown, own), self._rest([*fitted.ids, *left_out], unknown)
        place, p = self._judged(space, marginal, rest, 0, with_p=True)
        bare = {n: s for n, s in marginal.items() if not n.startswith(DISCREPANCY) and n not in own}
        by_misfit = place_of(*self._products(space, bare, rest, 0)[:2])
        lit, forms = likelier(space, marginal, 0), [block for block in rest if cause_of(block) != UNKNOWN]
        gram, along = space.marginalised(lit, forms, 0)
        every = Shapes.of("library", gram)
        library = float(every.log_bayes(every.coordinates(along)))
        fields: dict[str, tuple[float, float]] = {}
        for block in (name for name in rest if cause_of(name) == UNKNOWN):
            gram, along = space.marginalised(lit, [block], 0)
            shapes = self._shapes(block, gram)
            if shapes.eigenvalues.size:
                unit = shapes.coordinates(along)
                fields[block] = float(shapes.log_bayes(unit)), shapes.strength(unit) * float(shapes.scale.max())
        most = max(fields, key=lambda block: fields[block][0], default=None)
        return Further(place, p, by_misfit, {} if most is None else {most: fields[most][1]}, library)

    def weights(
        self, fitted: JointFit, name: str, unknown: Mapping[str, float] = MappingProxyType({})
    ) -> dict[str, Weights]:
        """Return the weights of the forms of every cause that may fill a place: that of a taken cause, or one more.

        Parameters
        ----------
        fitted : JointFit
        name : str
            Of a taken cause; anything else: of a further one.
        unknown : mapping of str to float
        """
        judged = [name] if name in fitted.ids else []
        space, _ = self._space(fitted, judged)
        others = [n for n in fitted.ids if n != name]
        marginal = _marginal(others, unknown)
        rest = [block for block in self._rest(others, unknown) if cause_of(block) != UNKNOWN]
        gram, along = space.marginalised(likelier(space, marginal, 0), rest, 0)
        found, start = {}, 0
        for cause in rest:
            cut = np.arange(start, start + len(space.places[cause]))
            start += len(cut)
            if cause in judged:
                cut = cut[:-1]  # its relinearised form is known in the present views alone
            shapes = self._shapes(cause, gram[np.ix_(cut, cut)])
            if not shapes.eigenvalues.size:
                continue
            strength = shapes.strength(shapes.coordinates(along[cut]))
            scaled = strength * shapes.scale
            # Forms that are nearly alike leave rounding errors below zero, of what is known from the data.
            known, modes = np.linalg.eigh(scaled[:, None] * gram[np.ix_(cut, cut)] * scaled)
            root = modes / np.sqrt(1.0 + np.maximum(known, 0.0))
            mean = scaled * (root @ (root.T @ (scaled * along[cut])))
            found[cause] = Weights(len(cut), mean, scaled[:, None] * root)
        return found

    def power(self, fitted: JointFit, strengths: Sequence[float], rng: np.random.Generator) -> list[Power]:
        """Return the expected power of a further cause, by cause and strength."""
        space, _ = self._space(fitted, ())
        return expected_power(space, _marginal(fitted.ids, {}), strengths, rng, left_out=(LIGHT,))

    def fields(self, unknown: Mapping[str, float]) -> Array:
        """Return the rows (k, d) of blocks of something unknown times their amplitudes."""
        rows = [self._forms.rows[self._forms.places[block]].astype(np.float32) * a for block, a in unknown.items()]
        return np.concatenate([np.zeros((0, self._forms.rows.shape[1]), np.float32), *rows])

    def noise(self, fitted: JointFit, draws: Array, kinds: Sequence[Hashable] = ()) -> tuple[float, Array]:
        """Return what whitened draws (n, d) of the noise, of some kinds (n,), scatter along all forms.

        Returns
        -------
        variance : float
            Of all directions but a few, in units of what is believed [1].
        rows : ndarray (k, d)
            Of the few, each of unit standard deviation, once the data are divided by the root of ``variance``.
        """
        blocks = {NUISANCES: np.concatenate([fitted.nuisance_rows, _scaled(fitted, "@")]), DRAWN: draws}
        space = self._forms.joined(blocks, np.zeros((0, draws.shape[1])))
        gram, _ = space.marginalised({NUISANCES: 1.0}, [*self.known, DRAWN], None)
        count = gram.shape[0] - len(draws)

        def evidence(inner: Array, along: Array) -> float:
            shapes, products = self._cut(self._forms, self.known, inner, along)
            return float(statistic_of(np.array(list(place_of(shapes, products).log_bayes.values()))))

        found = noise_along(gram[:count, :count], gram[:count, count:], evidence, kinds)
        return found.variance, self._forms.combined(found.factors, self.known)

    def _other_laws(self, space: SmallSpace, fitted: JointFit) -> dict[str, Array]:
        """Return by which factors the forms of taken causes are in the data, by cause: those of their other laws.

        All together are as strong as the cause: the law that was fitted is one of those that it may have. Forms by the
        same law at other figures are none, for figures are fitted.
        """
        found = {}
        for name, size in self.discrepancy.sizes(fitted).items():
            count, drawn = len(all_laws().get(name, ())), len(self._forms.places.get(name, ()))
            if not 0 < count < drawn:
                continue
            factors = np.zeros(len(space.places[name]))
            laws = slice(drawn - count, drawn)
            norms = np.sqrt(np.diag(space.gram)[space.places[name][laws]])
            factors[laws] = np.where(norms > LEAST_NORM, size / np.maximum(norms, LEAST_NORM) / np.sqrt(count), 0.0)
            found[name] = factors
        return found

    def _rest(self, taken: Iterable[str], unknown: Iterable[str]) -> list[str]:
        out = {*taken, *unknown}
        return [name for name in self.known if name not in out]

    def _space(self, fitted: JointFit, judged: Sequence[str]) -> tuple[SmallSpace, dict[str, Array]]:
        """Return all inner products at a fit; its vectors are the data without each judged cause, and the residual."""
        model = self.fitter.model
        blocks: dict[str, Array] = {NUISANCES: np.concatenate([fitted.nuisance_rows, _scaled(fitted, "@")])}
        for taken in fitted.taken:
            blocks[f"{FITTED}{taken.id}"] = _scaled(fitted, f"{taken.id}:")
        # A cause that is not there has no form to be off: its place is judged without its own rows.
        tied = {name: rows.dense() for name, rows in self.discrepancy.tied(fitted).items()}
        none = np.zeros((0, fitted.residual.size), np.float32)
        blocks |= {f"{DISCREPANCY}{name}": tied.get(name, none) for name in ("", *fitted.ids)}
        blocks[LIGHT] = self.discrepancy.light(fitted).dense()
        secants: dict[str, Array] = {}
        if judged:
            whole = model.vector(fitted.point)
            secants = {name: whole - model.vector(fitted.without(name)) for name in judged}
        # What was relinearised is one more form of a cause, as likely as each of those drawn.
        blocks |= {name: secant[None] for name, secant in secants.items()}
        # What is marginalised has its prior's mean, and not what was fitted, in what data are compared with.
        free = ~fitted.solution.held
        away = np.where(free, fitted.departures(), 0.0)[:, None] * fitted.solution.rows
        believed = fitted.residual + away.sum(axis=0)
        own = {name: away[fitted.of_cause(name)].sum(axis=0) for name in secants}
        lefts = np.array([*(believed - own[name] + secant for name, secant in secants.items()), believed])
        return self._forms.joined(blocks, lefts), secants

    def _judged(
        self,
        space: SmallSpace,
        marginal: Mapping[str, float | Array],
        candidates: Sequence[str],
        vector: int,
        *,
        with_p: bool = False,
    ) -> tuple[Place, float]:
        """Return which cause fills a place, averaged over an exact nominal light and one that is off by OWN_LIGHT.

        Both are as probable before the data. A cause's factor is over the average of both without it: what one smooth
        form explains as well as nine free ones do is then the cause's, what it does not is the light's.
        """
        off = space.log_bayes(marginal, LIGHT, vector)
        weights = -np.logaddexp(0.0, off), off - np.logaddexp(0.0, off)
        log_bayes: dict[str, float] = {}
        p = 0.0
        for weight, told in zip(weights, (marginal, {**marginal, LIGHT: 1.0}), strict=True):
            shapes, along, gram = self._products(space, told, candidates, vector)
            place = place_of(shapes, along)
            for name, value in place.log_bayes.items():
                log_bayes[name] = float(np.logaddexp(log_bayes.get(name, -np.inf), weight + value))
            if with_p:
                null = partial(null_statistics, shapes, gram, generator(self.seed, "null statistics"))
                p += float(np.exp(weight)) * p_value(place, null)
        return Place.of(log_bayes), p

    def _products(
        self, space: SmallSpace, marginal: Mapping[str, float | Array], candidates: Sequence[str], vector: int
    ) -> tuple[list[Shapes], dict[str, Array], Array]:
        """Return the candidates' shapes, the products of each one's rows with the data, and all inner products."""
        gram, every = space.marginalised(marginal, candidates, vector)
        return *self._cut(space, candidates, gram, every), gram

    def _cut(
        self, space: SmallSpace, candidates: Sequence[str], gram: Array, every: Array
    ) -> tuple[list[Shapes], dict[str, Array]]:
        """Return the candidates' shapes by inner products of all their rows, and each one's own with the data."""
        shapes, along, start = [], {}, 0
        for name in candidates:
            cut = slice(start, start + len(space.places[name]))
            shapes.append(self._shapes(name, gram[cut, cut]))
            along[name] = every[cut]
            start = cut.stop
        return shapes, along


def likelier(space: SmallSpace, marginal: Mapping[str, float | Array], vector: int) -> Mapping[str, float | Array]:
    """Return what is marginalised, the nominal light among it where it is more probably off than exact."""
    return {**marginal, LIGHT: 1.0} if space.log_bayes(marginal, LIGHT, vector) > 0.0 else marginal


def _marginal(
    taken: Collection[str], unknown: Mapping[str, float], forms: Mapping[str, Array] = MappingProxyType({})
) -> dict[str, float | Array]:
    own = {f"{block}{name}": 1.0 for name in taken for block in (FITTED, DISCREPANCY)}
    return {NUISANCES: 1.0, DISCREPANCY: 1.0, **own, **{n: forms[n] for n in taken if n in forms}, **unknown}


def _scaled(fitted: JointFit, prefix: str) -> Array:
    """Return the derivatives (n, bins) by parameters of a prefix, times their prior standard deviations.

    What a bound holds cannot give way to a cause.
    """
    free = ~fitted.solution.held
    chosen = [k for k, p in enumerate(fitted.parameters) if p.name.startswith(prefix) and free[k]]
    deviations = np.array([fitted.parameters[k].deviation for k in chosen])
    return np.asarray(fitted.solution.rows[chosen] * deviations[:, None], np.float32)
