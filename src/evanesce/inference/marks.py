"""Localised defects on full pixels: points, discs, lines and soft blobs, sought by one scan of matched filters.

How a defect goes from view to view (with the LEDs' light, in the dark, with the lens covered) is its behaviour: of each
cause the change per unit amount at every place, from the effect itself. Data weighted by their noise are summed over
views along each behaviour, so that one map of products and one of information are left of each; atoms of several sizes
and directions are matched filters of these maps. The same scan of measured noise says how large the largest of all is
where there is nothing. What behaves like no cause is weighed beside: an amplitude of its own in each kind of view.

Smooth misfit is taken off before (each view less its own smoothed self), and a predicted edge counts as uncertain by a
share of a pixel.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from evanesce.core.rng import generator
from evanesce.core.threads import in_threads
from evanesce.inference.atoms import atoms_of, smoothed
from evanesce.inference.causes import Cause
from evanesce.inference.constants import DETECTED_BESIDE
from evanesce.inference.data import SATURATED
from evanesce.inference.explained import WIDER_PX, Explained, Scan, flattened
from evanesce.inference.listing import behaviour_of, listed, point_spread
from evanesce.inference.model import AnchoredModel
from evanesce.inference.responses import Maps, Peak, Responses
from evanesce.inference.row_waves import ripple_of
from evanesce.prediction.views import BIN_PX

Array = NDArray[Any]

EDGE_PX = 0.2
"""By so much a predicted edge may be displaced in a view; a fit of the finger's place leaves less than a tenth."""
NEAR = 3.0
"""Standard deviations of noise."""
NULLS = 24
"""Scans of noise; the largest of each follows Gumbel's law, whose two figures they give to a tenth."""
TAIL = 20
"""Places of the sign that no cause can make whose sizes tell how large the largest may be."""
MOST = 300
"""Defects of a list; the strongest."""
ROUNDS = 8
"""Scans in which the strongest are taken and hidden; the first take nearly all."""
SHADOW, LEAST_NEAR = 0.1, 1e-4
"""What taking off smooth misfit makes about a defect is less than this share of it; how far that reaches."""
STRONGEST = 0.5
"""Defects of one round have at least this share of the largest: weaker ones may be the tails of stronger ones."""


@dataclass
class MarkSearch:
    """Seeks defects in the frames of an observation.

    Attributes
    ----------
    model : AnchoredModel
    causes : sequence of Cause
        Those whose places only data know.
    seed : int
        Of the draws of noise.
    """

    model: AnchoredModel
    causes: Sequence[Cause]
    seed: int = 0
    _spread: dict[str, Array] = field(default_factory=dict)

    def scan(self, point: Mapping[str, float]) -> Scan:
        """Return the defects that stand out of what the fit at a point leaves.

        Parameters
        ----------
        point : mapping
        """
        left, sd = self._left(point)
        weight = 1.0 / sd
        found = self._of_defects(point, left, weight)
        by_cause, scene = found.by_cause, self.model.observation.scene
        own = [listed(c, by_cause[c.id], scene) for c in self.causes if c.id in by_cause]
        rippling = [ripple_of(self.model, point, c, left, weight) for c in self.causes if c.candidate.effect.bands]
        ripples = [ripple for ripple in rippling if ripple is not None]
        worth = {ripple.taken.id: value for ripple, value in ripples}
        return replace(found, listed=(*own, *(ripple for ripple, _ in ripples)), ripples=worth)

    def _of_defects(self, point: Mapping[str, float], left: Array, weight: Array) -> Scan:
        behaviours = {c.id: behaviour_of(self.model, point, c) for c in self.causes if c.candidate.effect.marks}
        behaviours = {name: b for name, b in behaviours.items() if np.any(b)}
        if not behaviours:
            return Scan()
        for cause in self.causes:
            if cause.id in behaviours and cause.id not in self._spread:
                self._spread[cause.id] = point_spread(self.model, point, cause, behaviours[cause.id])
        rng = generator(self.seed, "marks")
        atoms = atoms_of(self.causes, self._spread)
        nulls, scans = np.zeros(NULLS), []
        for wide in sorted({atom.wide(WIDER_PX) for atom in atoms}):
            flat = flattened(left, weight, wide)
            responses = Responses(
                Maps.of(behaviours, flat * weight, weight, self.model.data),
                [atom for atom in atoms if atom.wide(WIDER_PX) == wide],
            )
            fields = self._noise_fields(wide, left.shape[1:], rng)
            nulls = np.maximum(nulls, self._largest_of_noise(responses, fields, rng))
            scans.append(responses)
        # Gumbel's law by its mean and standard deviation.
        scale = float(np.std(nulls, ddof=1)) * np.sqrt(6.0) / np.pi
        threshold = float(np.mean(nulls)) - np.euler_gamma * scale - scale * np.log(-np.log1p(-DETECTED_BESIDE))
        if self.model.data.correlation is not None:
            # What a codec makes of a place stays there in all frames, and is as often dark as bright.
            threshold = max(threshold, beyond([place for r in scans for place in r.wrong_side(2 * TAIL)]))
        largest = max(r.largest() for r in scans)
        peaks = self._peaks(scans, threshold)
        return Scan(tuple(Explained(self.model, self.causes, point, left, weight).marks(peaks)), threshold, largest)

    def _largest_of_noise(self, responses: Responses, fields: Array, rng: np.random.Generator) -> Array:
        """Return the largest responses (NULLS,) to mixtures of fields of noise (n, rows, cols)."""
        found, draws = np.zeros(NULLS), rng.spawn(NULLS)

        def work(some: range) -> None:
            for k in some:
                found[k] = responses.largest(responses.maps.noise(_mixed(fields, responses, draws[k])))

        in_threads(work, NULLS, 1)
        return found

    def _peaks(self, scans: Sequence[Responses], threshold: float) -> list[tuple[Peak, Responses]]:
        """Return what stands out, the largest first; what has been taken is hidden, and the rest sought again."""
        found: list[tuple[Peak, Responses]] = []
        rows, cols = scans[0].maps.product.shape[1:]
        shadow = np.zeros((rows, cols))
        for _ in range(ROUNDS):
            peaks = sorted(((p, r) for r in scans for p in r.peaks(threshold)), key=lambda pair: -pair[0].z)
            if not peaks or len(found) >= MOST:
                break
            taken = np.zeros((rows, cols), bool)
            for standing, responses in peaks:
                if standing.z < STRONGEST * peaks[0][0].z:
                    break
                peak = responses.refined(standing)
                footprint = peak.atom.footprint(peak.row, peak.col, (rows, cols))
                if not taken[footprint].any():
                    taken[footprint] = True
                    if peak.z > shadow[footprint].max():
                        found.append((peak, responses))
                    near = cv2.GaussianBlur(footprint.astype(np.float32), (0, 0), WIDER_PX) > LEAST_NEAR
                    shadow[near] = np.maximum(shadow[near], SHADOW * peak.z)
            for responses in scans:
                responses.hide(taken)
        return found[:MOST]

    def _left(self, point: Mapping[str, float]) -> tuple[Array, Array]:
        """Return the open views' pixels less the fine prediction, and their standard deviation (views, rows, cols)."""
        model, data = self.model, self.model.data
        frames = model.frames(point, data.open)
        measured = model.observation.images[list(data.open)]
        count = np.array([data.views[k].frames for k in data.open])[:, None, None]
        card = np.array([data.views[k].is_card for k in data.open])[:, None, None]
        variance = BIN_PX**2 * data.noise.variance(frames, count, card)
        slope = np.hypot(np.gradient(frames, axis=1), np.gradient(frames, axis=2))
        if model.recoded is not None and model.recoded.pixels is not None:
            change, scatter = (part[list(data.open)] for part in model.recoded.pixels)
            frames, variance = frames + change, np.maximum(variance, scatter**2)
        sd = np.sqrt(variance + (EDGE_PX * slope) ** 2 + data.noise.tone.step_DN**2 / 12.0 / count)
        # Near the end of the scale the quick prediction may be clipped where the frame is not.
        sd[np.maximum(measured, frames) + NEAR * np.sqrt(variance) >= SATURATED * data.noise.full_DN(card)] = np.inf
        return (measured - frames).astype(np.float32), sd.astype(np.float32)

    def _noise_fields(self, wide: float, shape: tuple[int, ...], rng: np.random.Generator) -> Array:
        """Return fields (n, rows, cols) of noise as it was measured, or white, without what varies smoothly."""
        fields = self.model.observation.pixel_noise
        if fields is None:
            fields = rng.standard_normal((8, *shape), np.float32)
        even = np.ones(fields.shape[1:], np.float32)
        return np.array([one - smoothed(one, even, wide) for one in fields])


def beyond(places: Sequence[tuple[float, float, float]]) -> float:
    """Return the size that the largest of all places exceeds in DETECTED_BESIDE of all scans; 0 for too few places.

    The sizes of the largest places fall off exponentially, at the mean rate by which they exceed the least of them
    (peaks over threshold: Coles, An Introduction to Statistical Modeling of Extreme Values, 2001, ch. 4).

    Parameters
    ----------
    places : sequence of tuple
        Size, row and column; those within :data:`WIDER_PX` of a larger one are the same place.
    """
    apart: list[tuple[float, float, float]] = []
    for place in sorted(places, reverse=True):
        if all(np.hypot(place[1] - other[1], place[2] - other[2]) > WIDER_PX for other in apart):
            apart.append(place)
            if len(apart) > TAIL:
                least = place[0]
                rate = float(np.mean([other[0] for other in apart[:TAIL]])) - least
                return least + rate * float(np.log(TAIL / DETECTED_BESIDE))
    return 0.0


def _mixed(fields: Array, responses: Responses, rng: np.random.Generator) -> Array:
    """Return independent mixtures of fields, each shifted: one for each kind of a scan (kinds, rows, cols)."""
    kinds, (rows, cols) = len(responses.maps.names), fields.shape[1:]
    weights = rng.standard_normal((kinds, len(fields)), np.float32)
    weights /= np.linalg.norm(weights, axis=1, keepdims=True)
    shifts = rng.integers(0, (rows, cols), (kinds, 2))
    mixed = np.tensordot(weights, fields, 1)
    return np.array([np.roll(one, shift, (0, 1)) for one, shift in zip(mixed, shifts, strict=True)])
