"""Which cause the defects that stand out are: by the whole prediction of each, pixel by pixel in all views."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.inference.atoms import smoothed
from evanesce.inference.causes import Cause
from evanesce.inference.constants import STRENGTHS
from evanesce.inference.listing import Listed, Mark, listed
from evanesce.inference.model import AnchoredModel
from evanesce.inference.responses import Peak, Responses
from evanesce.inference.single_effects import UNKNOWN, Place

Array = NDArray[Any]

OWN_FORM = 0.2
"""Standard deviation by which a defect may differ from its form, in any view and pixel: blur, middle, tone curve."""
AMOUNTS = 3
"""Rounds in which amounts are fitted: the tone curve bends what strong defects add."""
LEAST_FACTOR, MOST_FACTOR = 0.2, 5.0
"""Of an amount, in a round."""
WIDER_PX = 8.0
"""Smooth misfit is what varies over more than so many pixels (of blobs: three of their radii)."""
SHARES = 5
"""Rounds of the shares of causes among all defects."""


@dataclass(frozen=True)
class Scan:
    """What was found.

    Attributes
    ----------
    marks : tuple of Mark
    threshold : float
        Size that the largest response to noise alone exceeds in DETECTED_BESIDE of all scans [standard deviations].
    largest : float
        In the data.
    listed : tuple of Listed
        Causes with what was found of them.
    ripples : mapping of str to float
        Log Bayes factors of causes that ripple the light from row to row [nats].
    """

    marks: tuple[Mark, ...] = ()
    threshold: float = np.inf
    largest: float = 0.0
    listed: tuple[Listed, ...] = ()
    ripples: Mapping[str, float] = field(default_factory=dict)

    @property
    def by_cause(self) -> dict[str, tuple[Mark, ...]]:
        """Defects by the cause that explains them best."""
        names = dict.fromkeys(mark.cause for mark in self.marks)
        return {name: tuple(m for m in self.marks if m.cause == name) for name in names}

    def without(self, causes: Collection[str]) -> Scan:
        """Return what was found less what is some causes'."""
        return replace(
            self,
            marks=tuple(m for m in self.marks if m.cause not in causes),
            listed=tuple(own for own in self.listed if own.taken.id not in causes),
            ripples={name: value for name, value in self.ripples.items() if name not in causes},
        )

    def places(self) -> dict[str, Place]:
        """Return, for the defects of each cause, which cause they are: their log Bayes factors add up."""
        found = {name: Place.of({name: value}) for name, value in self.ripples.items()}
        for name, marks in self.by_cause.items():
            every = {n for mark in marks for n in mark.log_bayes}
            # What one mark cannot be, the list cannot be.
            total = {n: float(sum(m.log_bayes.get(n, -np.inf) for m in marks)) for n in every}
            found[name] = Place.of({n: v for n, v in total.items() if np.isfinite(v)})
        return found


def flattened(left: Array, weight: Array, wide: float) -> Array:
    """Return views (views, rows, cols) less what varies over more than some pixels."""
    return np.array([one - smoothed(one, w**2, wide) for one, w in zip(left, weight, strict=True)], np.float32)


@dataclass
class Explained:
    """Weighs causes for defects.

    Attributes
    ----------
    model : AnchoredModel
    causes : sequence of Cause
    point : mapping
        Of the fit whose residual was scanned.
    left, weight : ndarray (open views, rows, cols)
        Data less prediction [DN]; one over the standard deviation.
    """

    model: AnchoredModel
    causes: Sequence[Cause]
    point: Mapping[str, float]
    left: Array
    weight: Array

    def marks(self, peaks: Sequence[tuple[Peak, Responses]]) -> list[Mark]:
        """Return what the peaks are."""
        found: list[Mark] = []
        by_kind: dict[Any, list[tuple[Peak, Responses]]] = {}
        for peak, responses in peaks:
            # Points are listed together; of lines and blobs an effect has one.
            by_kind.setdefault("point" if peak.atom.kind == "point" else peak, []).append((peak, responses))
        for members in by_kind.values():
            wide = members[0][0].atom.wide(WIDER_PX)
            flat = flattened(self.left, self.weight, wide)
            # A strong defect is known no better than its form is: the same weights for all that may explain it.
            known = replace(self, weight=self.weight / np.sqrt(1.0 + (OWN_FORM * flat * self.weight) ** 2))
            found += known._together([p for p, _ in members], [r for _, r in members], flat * known.weight, wide)
        return sorted(found, key=lambda m: -m.z)

    def _together(
        self, peaks: Sequence[Peak], responses: Sequence[Responses], whitened: Array, wide: float
    ) -> list[Mark]:
        windows = [self._window(peak) for peak in peaks]
        cost = [float(np.log(r.trials)) for r in responses]
        bayes: list[dict[str, float]] = [{} for _ in peaks]
        amounts: dict[str, Array] = {}
        changes: dict[str, Array] = {}
        for cause in self.causes:
            kind = peaks[0].atom.causes.get(cause.id)
            if kind is None:
                continue
            start = np.array([p.amounts[kind] for p in peaks])
            amounts[cause.id], each, changes[cause.id] = self._by_cause(cause, peaks, windows, start, whitened, wide)
            for own, value, paid in zip(bayes, each, cost, strict=True):
                own[cause.id] = value - paid
        for own, peak, window, paid in zip(bayes, peaks, windows, cost, strict=True):
            best = max(own, key=lambda name: own[name], default=None)
            # The same form for all, so that behaviour from view to view alone decides.
            known = best is not None and np.isfinite(own[best])
            change = changes[best] if best is not None and known else np.zeros_like(whitened)
            own[UNKNOWN] = self._unknown(peak, change, window, whitened) - paid
        chosen = _assigned(bayes)
        return [
            Mark(name, p.atom, p.row, p.col, 0.0 if name == UNKNOWN else float(amounts[name][k]), p.z, bayes[k])
            for k, (name, p) in enumerate(zip(chosen, peaks, strict=True))
            if bayes[k][name] > 0.0
        ]

    def _by_cause(
        self,
        cause: Cause,
        peaks: Sequence[Peak],
        windows: Sequence[tuple[slice, slice]],
        start: Array,
        whitened: Array,
        wide: float,
    ) -> tuple[Array, list[float], Array]:
        """Return amounts (peaks,), log Bayes factors over nothing, and whitened changes (views, rows, cols)."""
        amounts = np.where(start > 0, start, 0.0)
        if not np.any(amounts):
            return amounts, [-np.inf] * len(peaks), np.zeros_like(whitened)
        for number in range(AMOUNTS + 1):
            change = self._change(cause, peaks, amounts)
            change = flattened(change, self.weight, wide) * self.weight
            if number == AMOUNTS:
                break
            for k, window in enumerate(windows):
                own, data = change[(slice(None), *window)], whitened[(slice(None), *window)]
                size = float((own**2).sum())
                if size > 0:
                    amounts[k] *= np.clip(float((own * data).sum()) / size, LEAST_FACTOR, MOST_FACTOR)
        found = []
        for k, window in enumerate(windows):
            own, data = change[(slice(None), *window)], whitened[(slice(None), *window)]
            found.append(_log_bayes(own, data) if amounts[k] > 0 else -np.inf)
        return amounts, found, change

    def _change(self, cause: Cause, peaks: Sequence[Peak], amounts: Array) -> Array:
        """Return what a list of defects changes in the open views (views, rows, cols) [DN]."""
        model = self.model
        marks = [
            Mark(cause.id, p.atom, p.row, p.col, float(a), p.z, {})
            for p, a in zip(peaks, amounts, strict=True)
            if a > 0
        ]
        own = listed(cause, marks, model.observation.scene)
        before = {name: v for name, v in self.point.items() if not name.startswith(f"{cause.id}:")}
        base = [model.coarse.image(before, k) for k in model.data.open]
        kept = dict(model.coarse.fixed)
        model.coarse.fixed = {**kept, cause.id: own.settings}
        try:
            after = [model.coarse.image({**before, **own.start}, k) for k in model.data.open]
        finally:
            model.coarse.fixed = kept
        return np.array(after, np.float32) - np.array(base, np.float32)

    def _unknown(self, peak: Peak, change: Array, window: tuple[slice, slice], whitened: Array) -> float:
        """Return the log Bayes factor of an amplitude of its own in each view, all of one random size.

        The form is that of a cause's change (views, rows, cols), or the atom's where that shows nothing.
        """
        image = peak.atom.image(peak.row, peak.col, (self.left.shape[1], self.left.shape[2]), peak.kind)[window]
        rows, own = image * self.weight[(slice(None), *window)], change[(slice(None), *window)]
        rows = np.where((own**2).sum(axis=(1, 2), keepdims=True) > 1.0, own, rows)
        size = np.sqrt((rows**2).sum(axis=(1, 2)))
        along = np.where(
            size > 0, (rows * whitened[(slice(None), *window)]).sum(axis=(1, 2)) / np.where(size > 0, size, 1.0), 0.0
        )
        size2 = np.square(STRENGTHS)[:, None] / max(np.count_nonzero(size), 1)
        each = 0.5 * (along**2 * (size2 / (1 + size2)) - np.log1p(size2) * (size > 0)).sum(axis=1)
        return float(np.logaddexp.reduce(each) - np.log(len(each)))

    def _window(self, peak: Peak) -> tuple[slice, slice]:
        """Return the rows and columns of a defect's footprint."""
        seen = peak.atom.footprint(peak.row, peak.col, (self.left.shape[1], self.left.shape[2]))
        rows, cols = np.flatnonzero(seen.any(axis=1)), np.flatnonzero(seen.any(axis=0))
        return slice(int(rows[0]), int(rows[-1]) + 1), slice(int(cols[0]), int(cols[-1]) + 1)


def _log_bayes(change: Array, data: Array) -> float:
    """Return the log Bayes factor of a whitened change (views, rows, cols), uncertain in size, over nothing."""
    size = (change**2).sum(axis=(1, 2))
    along = (change * data).sum(axis=(1, 2))
    left = along - size
    share = OWN_FORM**2
    each = along - 0.5 * size + 0.5 * share * left**2 / (1 + share * size) - 0.5 * np.log1p(share * size)
    # The amount was fitted: as much as a flat prior over its own size costs.
    return float(each.sum() - 0.5 * np.log1p(size.sum()))


def _assigned(bayes: Sequence[Mapping[str, float]]) -> list[str]:
    """Return the cause of each defect: a mixture whose shares all of them together tell."""
    names = sorted({name for own in bayes for name in own})
    table = np.array([[own.get(name, -np.inf) for name in names] for own in bayes])
    share = np.full(len(names), 1.0 / len(names))
    for _ in range(SHARES):
        weight = table + np.log(share)
        chance = np.exp(weight - np.logaddexp.reduce(weight, axis=1, keepdims=True))
        share = (chance.sum(axis=0) + 1.0 / len(names)) / (len(bayes) + 1.0)
    return [names[k] for k in np.argmax(table + np.log(share), axis=1)]
