"""The joint fit of scalar series on one page, and what is read off it: areas, gain, what is left, what to measure."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from evanesce.bundle.bundle import Bundle
from evanesce.bundle.layout import Series
from evanesce.core.errors import InputError
from evanesce.core.rng import generator
from evanesce.inference.answer import answer
from evanesce.inference.causes import Cause, causes_of
from evanesce.inference.consequence import NINETY, AreaReader
from evanesce.inference.constants import CERTAIN, FAR, LEFT
from evanesce.inference.gain import Interval, areas_worse
from evanesce.inference.gate import Gate
from evanesce.inference.joint import Fitter
from evanesce.inference.joint_fit import JointFit
from evanesce.inference.judge import Judge
from evanesce.inference.named import lacking_each, named_causes, scaled, widened_covariance
from evanesce.inference.next_shot import advice_of, doubtful, entropy, entropy_left, rivals
from evanesce.inference.posterior import Posterior
from evanesce.inference.removal import everything_marginalised
from evanesce.inference.search import Search
from evanesce.inference.series.model import SeriesBank, SeriesDiscrepancy, SeriesModel
from evanesce.inference.series.picture import Curve
from evanesce.inference.series.rows import ASSUMED_SIGMA, Rows, rows_of
from evanesce.inference.series.search import SeriesSearch
from evanesce.inference.single_effects import UNKNOWN
from evanesce.prediction.linear import CovarianceRows, Metric
from evanesce.prediction.observe import Observation, model_scene

Array = NDArray[Any]
Tell = Callable[[str], None]

MENU: Sequence[tuple[str, float, str, str, Mapping[str, float], Array]] = (
    ("areas below 0.3 N", 5.0, "force", "area", {}, np.geomspace(0.03, 0.3, 5)),
    ("the same areas read at threshold 0.35", 5.0, "force", "area", {"threshold": 0.35}, np.linspace(0.5, 5.0, 6)),
    ("area over 2 minutes at 3 N", 5.0, "time", "area", {"force_N": 3.0}, np.array([1.0, 4, 12, 30, 60, 120])),
    ("area against LED voltage at 3 N, 8 to 12 V", 10.0, "voltage", "area", {"force_N": 3.0}, np.linspace(8, 12, 6)),
    ("force against displacement, 0.1 to 1.2 mm", 20.0, "displacement", "force", {}, np.linspace(0.1, 1.2, 8)),
)  # fmt: skip
"""Further series that a lab could take: what, minutes, abscissa, ordinate, what is held, values."""
FITTED_HERE = 6
"""Causes that are fitted in each round, of all that are entered: a fit of some rows takes seconds."""
FURTHER = "a further cause"
UNITS = {"force": "N", "displacement": "mm", "voltage": "V", "time": "s", "area": "mm2"}


@dataclass(frozen=True)
class SeriesCriticism:
    """What came out: see :class:`evanesce.inference.critic.Criticism`.

    Attributes
    ----------
    result : dict
    scene : str
    pictures : tuple of Curve
    """

    result: dict[str, Any]
    scene: str
    pictures: tuple[Curve, ...]


def criticise_series(
    bundle: Bundle, *, seed: int = 0, tell: Tell = lambda line: None, exclude: Collection[str] = ()
) -> SeriesCriticism:
    """Find the causes by which a bundle's scalar series differ from its nominal model, many at once.

    Parameters
    ----------
    bundle : Bundle
        With series; frames in it are not looked at.
    seed : int
        Of the draws of noise.
    tell : callable
        Told what is done.
    exclude : collection of str
        Effects that are not considered.

    Returns
    -------
    SeriesCriticism

    Raises
    ------
    InputError
        For a bundle without series that are predicted.
    """
    began = time.monotonic()
    used, held, left_out = rows_of(bundle.series)
    if not used.series:
        raise InputError("holds neither frames nor series", file=bundle.path, allowed="press frames or series/*.csv")
    model = SeriesModel(observation_of(bundle), used)
    tell("nominal model and its nuisances")
    fitter = Fitter(model)
    base = fitter.relinearised([], {})
    causes, without = causes_of(model.observation, exclude)
    bank, discrepancy, areas = SeriesBank(model, tell), SeriesDiscrepancy(model), SeriesAreas(model)
    judge = Judge(fitter, causes, bank, discrepancy, reach=FAR, seed=seed)
    silent = {c.id: "moves none of these series" for c in causes if c.id not in judge.known}
    search = SeriesSearch(fitter, causes, judge, tell, fitted=FITTED_HERE)
    best, posterior = search.run(base)
    tell("consequences and held-out rows")
    model.anchor(best.point)
    tied = discrepancy.every_row(best)
    told = posterior.at_most(CERTAIN)
    gain = gain_of(model.of_other_rows(held), base, best, lacking_each(search, best)) if held.series else None
    named = named_causes(search, areas, best, tied, told, {} if gain is None else gain.by_cause)
    covariance = widened_covariance(best, tied) * scaled(best.metric, best.residual)
    left = left_of(model, best, tied)
    advice = _advice(model, bank, judge, search, causes, best, posterior, tell)
    shown = _shown(model, held, base, best, covariance)
    notes = _notes(used)
    result, scene = answer(
        model, search, Gate((), {}), best, told, named, left, gain, advice, {**left_out, **without, **silent},
        time.monotonic() - began, replicates=True, notes=notes,
    )  # fmt: skip
    return SeriesCriticism(result, scene, shown)


def observation_of(bundle: Bundle) -> Observation:
    """Return what a bundle's series are, without frames."""
    return Observation(
        believed=bundle.scene, scene=model_scene(bundle.scene), views=(), images=np.zeros((0, 1, 1)),
        series=dict(bundle.series), available=bundle.testable,
    )  # fmt: skip


class SeriesAreas(AreaReader):
    """Areas that a rig would read: at the forces of a series of areas, or else at those of the scene.

    Parameters
    ----------
    model : SeriesModel
    """

    def __init__(self, model: SeriesModel) -> None:
        scene = model.observation.believed
        own = [s for s in model.data.series if (s.x_name, s.y_name) == ("force", "area")]
        forces = np.asarray(own[0].x if own else scene.press.forces_N, float)
        self.predictor = model.coarse
        self.scene = model_scene(scene)
        self.series = _series("areas", "force", "area", forces, own[0].held if own else {})
        self.forces = tuple(map(float, forces))

    def areas(self, point: Mapping[str, float], places: Sequence[int] | None = None) -> Array:
        """Return the predicted areas at a point [mm^2], one for each force."""
        own = {n: v for n, v in point.items() if ":" in n or n in ("@light", "@black")}
        found = np.exp(self.predictor.log(self.series, own))
        return found if places is None else found[list(places)]


@dataclass(frozen=True)
class SeriesGain:
    """Gain on held-out rows.

    Attributes
    ----------
    log_score : tuple of float
        Gain, and its 95 % interval by the rows' own scatter if the extended model is right [nats].
    rms_sd : tuple of float
        Root mean square residual over the standard deviation, before and after.
    area_percent : tuple of float
        Mean absolute error of areas, before and after; NaN where none is held out.
    views : int
        Rows.
    by_cause : mapping of str to tuple of float
        What each cause adds to the log score, and its interval [nats].
    """

    log_score: Interval
    rms_sd: tuple[float, float]
    area_percent: tuple[float, float]
    views: int
    by_cause: Mapping[str, Interval] = field(default_factory=dict)

    @property
    def worse(self) -> bool:
        """Whether the extension makes the area worse."""
        return areas_worse(*self.area_percent)

    def as_dict(self) -> dict[str, Any]:
        """Return it in the answer's form."""
        return {
            "log_score": list(self.log_score), "rms_sd": list(self.rms_sd),
            "area_error_percent": [None if np.isnan(a) else a for a in self.area_percent], "area_worse": self.worse,
            "views": self.views,
        }  # fmt: skip


def gain_of(model: SeriesModel, base: JointFit, best: JointFit, lacking: Mapping[str, JointFit]) -> SeriesGain:
    """Return the gain on held-out rows by fine frames of both models, their load errors marginalised.

    Parameters
    ----------
    model : SeriesModel
        Of the held-out rows.
    base, best : JointFit
    lacking : mapping of str to JointFit
        The extended fit without each cause.
    """

    def off(fitted: JointFit) -> tuple[Array, Array]:
        load = [p for p in model.nuisances() if p.linear]
        rows = np.array([model.derivative(fitted.point, p) for p in load]).reshape(len(load), -1)
        left = model.observed - model.vector(fitted.point)
        return left, Metric.of(rows, np.array([p.deviation for p in load])).whiten(left)

    left: list[Array] = []
    white: list[Array] = []
    for fitted in (base, best):
        model.anchor(fitted.point)
        for told, one in zip((left, white), off(fitted), strict=True):
            told.append(one)

    def gained(without: Array) -> Interval:
        value = 0.5 * float((without**2 - white[1] ** 2).sum())
        # With d the difference of the predictions and unit noise the gain scatters by |d|.
        spread = 1.96 * float(np.linalg.norm(without - white[1]))
        return value, value - spread, value + spread

    by_cause = {name: gained(off(fitted)[1]) for name, fitted in lacking.items()}
    area = np.concatenate([np.full(len(s), s.y_name == "area") for s in model.data.series])
    errors = [
        100.0 * float(np.mean(np.abs(np.expm1(-(r * model.data.sd)[area])))) if area.any() else np.nan for r in left
    ]
    rms = [float(np.sqrt(np.mean(w**2))) for w in white]
    return SeriesGain(gained(white[0]), (rms[0], rms[1]), (errors[0], errors[1]), area.size, by_cause)


@dataclass(frozen=True)
class SeriesLeft:
    """What an extended model leaves of the rows that were fitted.

    Attributes
    ----------
    chi2 : float
        Mean square of the residual, all that is fitted and the discrepancy marginalised; 1 for noise.
    p_value : float
        Of it, for independent noise.
    series : mapping of str to mapping
        Of each series, the mean factor of measured over predicted, and its exponent of the abscissa.
    """

    chi2: float
    p_value: float
    series: Mapping[str, Mapping[str, float]]

    @property
    def found(self) -> bool:
        """Whether it is more than noise."""
        return self.p_value < LEFT

    def as_dict(self) -> dict[str, Any]:
        """Return it in the answer's form."""
        series = {name: dict(part) for name, part in self.series.items()}
        return {"chi2": self.chi2, "p_value": self.p_value, "series": series, "found": self.found}

    def sentence(self) -> str:
        """Return what it looks like."""
        words = ["something that no cause of the library makes"]
        for name, part in self.series.items():
            (exponent,) = [k for k in part if k != "factor"]
            words.append(f"{name} times {part['factor']:.3g}, with {exponent.replace('_', ' ')} {part[exponent]:+.2f}")
        return ", ".join(words)


def left_of(model: SeriesModel, fitted: JointFit, tied: CovarianceRows) -> SeriesLeft:
    """Return what is left of the rows that were fitted.

    Parameters
    ----------
    model : SeriesModel
    fitted : JointFit
    tied : CovarianceRows
        Of the discrepancy.
    """
    metric, believed = everything_marginalised(fitted)
    whole = metric.with_rows(tied)
    square = float(whole.project(believed) @ believed)
    found = {}
    for one, part in zip(model.data.series, model.data.parts, strict=True):
        off = (fitted.residual * model.data.sd)[part]
        x = np.log(np.maximum(one.x, 1e-9))
        slope = float(np.polyfit(x, off, 1)[0]) if len(one) > 2 and np.ptp(x) > 0 else 0.0
        found[one.name] = {"factor": float(np.exp(off.mean())), f"exponent_of_{one.x_name}": slope}
    count = fitted.residual.size
    return SeriesLeft(square / count, float(stats.chi2.sf(square, count)), found)


def _advice(
    model: SeriesModel, bank: SeriesBank, judge: Judge, search: Search, causes: Sequence[Cause], best: JointFit,
    posterior: Posterior, tell: Tell,
) -> dict[str, Any] | None:  # fmt: skip
    """Return the series of the menu that is expected to lessen the doubt about a place most."""
    judged = {name: place for name, place in posterior.places.items() if name != UNKNOWN}
    doubt = doubtful({**judged, FURTHER: posterior.further} if posterior.asks else judged)
    if not doubt:
        return None
    tell("what to measure next")
    weights = judge.weights(best, doubt, search.unknown)
    chosen, prior = rivals(causes, posterior.places.get(doubt, posterior.further), weights)
    before = entropy(prior)
    found = []
    for what, minutes, x_name, y_name, held, x in MENU:
        data = Rows.of([_series(what, x_name, y_name, x, held)])
        other = SeriesBank(model.of_other_rows(data), lambda line: None)
        other.predictor = bank.predictor
        try:
            blocks = other.blocks(chosen, data)
            load = [p for p in other.model.nuisances() if p.linear]
            rows = np.array([other.model.derivative(best.point, p) for p in load])
        except InputError:
            continue  # the law does not know this
        metric = Metric.of(rows, np.array([p.deviation for p in load]))
        shown = {
            c.id: metric.whiten(blocks[c.id])
            for c in chosen
            if c.id in blocks and len(blocks[c.id]) == weights[c.id].forms
        }
        names = [c.id for c in chosen]
        left = (
            entropy_left(shown, x.size, names, prior, weights, generator(0, "next series", what)) if shown else before
        )
        found.append((max(before - left, 0.0), what, minutes))
    return advice_of(chosen, before, found)


def _shown(model: SeriesModel, held: Rows, base: JointFit, best: JointFit, covariance: Array) -> tuple[Curve, ...]:
    """Return the curves of all rows, by fine frames."""
    curves = []
    for one in model.data.series:
        rest = [h for h in held.series if h.name == one.name]
        x = np.concatenate([one.x, *(h.x for h in rest)])
        y = np.concatenate([one.y, *(h.y for h in rest)])
        sigma = None if one.sigma is None else np.concatenate([one.sigma, *(np.asarray(h.sigma) for h in rest)])
        data = Rows.of([replace(one, x=x, y=y, sigma=sigma)])
        whole = model.of_other_rows(data)
        nominal, extended = (np.exp(whole.anchor(fitted.point)) for fitted in (base, best))
        slopes = np.array([whole.derivative(best.point, p) for p in best.parameters]).reshape(-1, x.size) * data.sd
        spread = NINETY * np.sqrt(np.einsum("kn,kl,ln->n", slopes, covariance, slopes))
        locked, order = np.arange(x.size) >= len(one), np.argsort(x)
        held_words = ", ".join(f"{k.partition('_')[0]} {v:g}" for k, v in one.held.items())
        curves.append(
            Curve(
                one.name + (f" ({held_words})" if held_words else ""), f"{one.x_name} [{one.x_unit}]",
                f"{one.y_name} [{one.y_unit}]", x[order], y[order], (data.sd * y)[order], nominal[order],
                extended[order], (extended * np.exp(-spread))[order], (extended * np.exp(spread))[order],
                locked[order],
            )
        )  # fmt: skip
    return tuple(curves)


def _series(name: str, x_name: str, y_name: str, x: Array, held: Mapping[str, float]) -> Series:
    return Series(
        name=name, x_name=x_name, x_unit=UNITS[x_name], y_name=y_name, y_unit=UNITS[y_name], x=np.asarray(x, float),
        y=np.ones(len(x)), held=held,
    )  # fmt: skip


def _notes(rows: Rows) -> list[str]:
    notes = ["no frames: of the light only what moves these figures can be told"]
    if rows.assumed:
        notes.append(
            f"a series states no standard deviation: {100 * ASSUMED_SIGMA:g} % of each value is assumed, independent"
            " from row to row, and probabilities depend on it"
        )
    return notes
