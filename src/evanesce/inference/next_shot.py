"""Which shot to take next: by how much each of a costed menu is expected to lessen the doubt about a place.

The doubt is the entropy of the causes that may fill a place. What a shot would show under each of them follows from
their forms, whose weights the present data have narrowed; shots are drawn, judged, and the entropy that is left is
averaged. Forms of a shot that was not taken are drawn at the same parameters as those of the shots that were.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.core.rng import generator
from evanesce.inference.causes import Cause
from evanesce.inference.constants import LEAST_PROBABLE
from evanesce.inference.data import rounding_sd
from evanesce.inference.model import AnchoredModel
from evanesce.inference.posterior import Weights
from evanesce.inference.shapes import FormBank, form_predictor
from evanesce.inference.single_effects import NONE, UNKNOWN, Place
from evanesce.prediction.linear import Metric
from evanesce.prediction.nuisance import nuisance_parameters
from evanesce.prediction.parameters import derivative
from evanesce.prediction.predict import Predictor
from evanesce.prediction.views import View

Array = NDArray[Any]

FRAMES = 8
"""Of a suggested shot."""
RESOLVED = 0.05
"""Of the doubt, that a shot has to resolve to be advised."""
DRAWN = 400
"""Shots drawn for each entry of the menu: the mean entropy is then good to a few hundredths of a nat."""


@dataclass(frozen=True)
class Shot:
    """An entry of the menu.

    Attributes
    ----------
    what : str
    minutes : float
        What it costs a lab.
    view : View
    """

    what: str
    minutes: float
    view: View


def menu(views: Sequence[View]) -> list[Shot]:
    """Return what could be measured beyond some views, cheapest first.

    Parameters
    ----------
    views : sequence of View
    """
    press = [v for v in views if v.kind == "press"]
    have = {v.kind for v in views}
    cheap = {"led_off": 0.5, "lens_cap": 1.0, "checkerboard": 3.0, "square": 3.0}
    words = {"led_off": "frames with the LEDs off", "lens_cap": "frames with the lens capped"}
    found = [
        Shot(words.get(kind, f"a {kind}"), cost, View(kind=kind, frames=FRAMES))
        for kind, cost in cheap.items()
        if kind not in have
    ]
    if press:
        last = max(press, key=lambda v: (v.force_N or 0.0, v.time_s))
        voltages = {v.voltage_V for v in press}
        for voltage in (min(voltages) - 1.0, max(voltages) + 1.0):
            found.append(Shot(f"press at {voltage:g} V", 1.0, replace(last, voltage_V=voltage, frames=FRAMES)))
        low, high = (of(v.force_N or 0.0 for v in press) for of in (min, max))
        for force in (low / 3.0, 2.0 * high):
            found.append(Shot(f"press with {force:.2g} N", 2.0, replace(last, force_N=force, frames=FRAMES)))
        found.append(
            Shot("the same press held 30 minutes", 30.0, replace(last, time_s=last.time_s + 1800.0, frames=FRAMES))
        )
    return sorted(found, key=lambda s: s.minutes)


def doubtful(places: Mapping[str, Place]) -> str:
    """Return the name of the place of most entropy; empty if none has two causes that are probable at all.

    Parameters
    ----------
    places : mapping of str to Place
    """
    entropies = {name: entropy(np.array(list(_members(place).values()))) for name, place in places.items()}
    most = max(entropies, key=lambda n: entropies[n], default="")
    return most if most and len(_members(places[most])) > 1 else ""


def next_shot(
    model: AnchoredModel,
    bank: FormBank,
    causes: Sequence[Cause],
    place: Place,
    weights: Mapping[str, Weights],
) -> dict[str, Any]:
    """Return the shot that is expected to lessen the doubt about a place most, with the whole menu.

    Parameters
    ----------
    model : AnchoredModel
    bank : FormBank
        Of the shots that were taken.
    causes : sequence of Cause
    place : Place
    weights : mapping of str to Weights
        Of each cause's forms, as the present data have narrowed them.
    """
    chosen, prior = rivals(causes, place, weights)
    before = entropy(prior)
    rows: list[tuple[float, str, float]] = []
    for shot in menu(model.data.views):
        predictor = form_predictor(model.coarse.scene, [shot.view], model.data.scale, model.coarse.pixels)
        forms = {f.id: f for f in FormBank(predictor, bank.point).of(chosen)}
        left = before
        if forms:
            left = _entropy_after(model, predictor, shot.view, bank.point, forms, chosen, prior, weights)
        rows.append((max(before - left, 0.0), shot.what, shot.minutes))
    return advice_of(chosen, before, rows)


def rivals(causes: Sequence[Cause], place: Place, weights: Mapping[str, Weights]) -> tuple[list[Cause], Array]:
    """Return the causes that may fill a place, and their probabilities among themselves."""
    members = {n: p for n, p in _members(place).items() if n in weights}
    chosen = [c for c in causes if c.id in members]
    prior = np.array([members[c.id] for c in chosen])
    return chosen, prior / prior.sum()


def advice_of(chosen: Sequence[Cause], before: float, rows: Sequence[tuple[float, str, float]]) -> dict[str, Any]:
    """Return the advice in the answer's form.

    Parameters
    ----------
    chosen : sequence of Cause
    before : float
        Entropy now [nats].
    rows : sequence of tuple
        Expected fall of the entropy [nats], what to measure, minutes that it costs.
    """
    ordered = sorted(rows, key=lambda r: (-round(r[0], 2), r[2]))
    best = ordered[0][1] if ordered and ordered[0][0] > RESOLVED * before else None
    return {
        "between": [c.id for c in chosen], "entropy_nats": before, "what": best,
        "menu": [{"what": what, "minutes": minutes, "gain_nats": gain} for gain, what, minutes in ordered],
    }  # fmt: skip


def _members(place: Place) -> dict[str, float]:
    return {n: p for n, p in place.probability.items() if n not in (NONE, UNKNOWN) and p > LEAST_PROBABLE}


def entropy(probability: Array) -> float:
    """Return the entropy of probabilities (n,), which need not sum to 1 [nats]."""
    total = probability.sum()
    if total <= 0:
        return 0.0
    shares = probability[probability > 0] / total
    return float(-(shares * np.log(shares)).sum())


def _entropy_after(
    model: AnchoredModel,
    predictor: Predictor,
    view: View,
    point: Mapping[str, float],
    forms: Mapping[str, Any],
    chosen: Sequence[Cause],
    prior: Array,
    weights: Mapping[str, Weights],
) -> float:
    """Return the mean entropy after a shot, over shots drawn under each cause in proportion to its probability."""
    base = predictor.cube(point)
    sd = np.sqrt(
        model.data.noise.variance(base, view.frames, view.is_card) + rounding_sd(model.data.noise.tone, base) ** 2
    )
    # Pose and levels are known by now; the shot's own jitter, and a card's place, are not.
    new = [p for p in nuisance_parameters([view], model.data.noise.flicker) if p.linear or view.is_card]
    slopes = [(derivative(predictor, point, p, [0], base) / sd).ravel() for p in new]
    rows = np.array(slopes).reshape(len(new), base.size)
    metric = Metric.of(rows, np.array([p.deviation for p in new]))
    shown = {}
    for c in chosen:
        if c.id in forms and len(forms[c.id].changes) == weights[c.id].forms:
            whitened = (forms[c.id].changes.astype(float) / sd).reshape(weights[c.id].forms, -1)
            shown[c.id] = metric.whiten(whitened)
    return entropy_left(shown, base.size, [c.id for c in chosen], prior, weights, generator(0, "next shot", view.kind))


def entropy_left(
    shown: Mapping[str, Array],
    size: int,
    chosen: Sequence[str],
    prior: Array,
    weights: Mapping[str, Weights],
    rng: np.random.Generator,
) -> float:
    """Return the mean entropy after further data, over data drawn under each cause in proportion to its probability.

    Parameters
    ----------
    shown : mapping of str to ndarray (forms, size)
        Whitened forms of causes in those data; causes that do not show are not in it.
    size : int
    chosen : sequence of str
        Causes.
    prior : ndarray (causes,)
    weights : mapping of str to Weights
    rng : numpy.random.Generator
    """
    means = [weights[n].mean @ shown[n] if n in shown else np.zeros(size) for n in chosen]
    spreads = [weights[n].root.T @ shown[n] if n in shown else np.zeros((0, size)) for n in chosen]
    every = np.concatenate([np.array(means), *spreads])
    _, values, axes = np.linalg.svd(every, full_matrices=False)
    axes = axes[values > 1e-9 * max(values[0], 1e-300)]
    small = [(m @ axes.T, s @ axes.T) for m, s in zip(means, spreads, strict=True)]
    left = 0.0
    for number in range(DRAWN):
        truth = int(np.searchsorted(np.cumsum(prior), (number + 0.5) / DRAWN))
        mean, spread = small[min(truth, len(small) - 1)]
        drawn = mean + rng.standard_normal(len(spread)) @ spread + rng.standard_normal(len(axes))
        log = np.array([_log_density(drawn - m, s) for m, s in small]) + np.log(prior)
        left += entropy(np.exp(log - log.max()))
    return left / DRAWN


def _log_density(off: Array, spread: Array) -> float:
    """Return the log density, up to a constant, of a departure (d,) under unit noise and spread (k, d)."""
    inner = np.eye(len(spread)) + spread @ spread.T
    along = spread @ off
    return float(-0.5 * (off @ off - along @ np.linalg.solve(inner, along)) - 0.5 * np.linalg.slogdet(inner)[1])
