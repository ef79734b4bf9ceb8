"""The prediction of a fit: the coarse model's changes about a point at which the fine model was evaluated."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from evanesce.inference.data import DataVector
from evanesce.prediction.fine import FINE_PX, FineFrames
from evanesce.prediction.nuisance import nuisance_parameters
from evanesce.prediction.observe import Observation, model_factor
from evanesce.prediction.parameters import Parameter, derivative
from evanesce.prediction.predict import Predictor
from evanesce.prediction.views import binned

Array = NDArray[Any]
Point = Mapping[str, float]

COARSER_PX = 2
"""Of finer pixels along each of the model camera's, for the other end of the extrapolation."""
ORDER = 2.4
"""Power of the pixel with which the prediction's error falls; measured: 44, 9 and 3 standard deviations at 1, 2, 3."""

CARD_STAYS_DN = 4.0
"""Change of a calibration target's bins up to which what the fine model adds to them is kept: their ink is sharp, and
evaluating it takes as long as all presses."""


class Model(Protocol):
    """What a joint fit asks of a prediction, whatever the data are.

    Attributes
    ----------
    observation : Observation
    data : object
        What is compared.
    factor : int
        Real pixels along each of the model camera's.
    fixed : mapping
        Settings of effects that data showed.
    """

    observation: Observation
    data: Any
    factor: int
    fixed: Mapping[str, Mapping[str, Any]]

    @property
    def observed(self) -> Array:
        """Whitened data (d,)."""

    def nuisances(self) -> tuple[Parameter, ...]:
        """Return what every fit varies."""

    def anchor(self, point: Point) -> Array:
        """Evaluate the fine model at a point, from where on changes are counted."""

    def vector(self, point: Point) -> Array:
        """Return the whitened prediction (d,)."""

    def derivative(self, point: Point, parameter: Parameter) -> Array:
        """Return its derivative (d,) by a parameter."""

    def further_rows(self) -> Array:
        """Return rows (k, d) whose outer products add to the covariance of the noise."""


class AnchoredModel:
    """Predicts the bins of all views at a point, a mapping of parameter names to values.

    The fine model gives the value at the anchor, the coarse one the change from there: an exact prediction at the
    anchor at the price of one fine evaluation, and derivatives at the price of coarse ones. A fit that is anchored
    anew where it ended, until it stays, ends at the fine model's own optimum to within what the coarse derivatives are
    off by (some per cent of the last step).

    Parameters
    ----------
    observation : Observation
    data : DataVector
    """

    def __init__(self, observation: Observation, data: DataVector) -> None:
        self.observation, self.data = observation, data
        self.factor = model_factor(observation.believed)
        self.coarse = Predictor(observation.scene, data.views, noise_scale=data.scale)
        self.fixed: Mapping[str, Mapping[str, Any]] = {}
        """Settings of effects that list defects: places that data showed."""
        self.codec_bias = np.zeros_like(data.cube)
        """Mean change by a codec (views, rows, cols) [DN]."""
        self.codec_rows: Array | None = None
        """What that may be off by: whitened rows (k, bins) of its covariance."""
        self.discretisation = np.zeros_like(data.cube)
        """What extrapolation to finer pixels added at the anchor (views, rows, cols) [DN]."""
        self._cards: tuple[Array, Array] | None = None

    def further_rows(self) -> Array:
        """Return rows (k, bins) of the covariance of what a codec does."""
        if self.codec_rows is not None:
            return self.codec_rows
        return np.zeros((0, int(self.data.valid[list(self.data.open)].sum())), np.float32)

    def list_defects(self, effect: str, settings: Mapping[str, Any]) -> None:
        """Hand over the places of an effect's defects; they act where a point names the effect.

        Parameters
        ----------
        effect : str
        settings : mapping
        """
        self.fixed = {**self.fixed, effect: settings}
        self.coarse.fixed = dict(self.fixed)

    @property
    def observed(self) -> Array:
        """Whitened bins (bins,) of the open views."""
        return self.data.whitened(self.data.cube)

    def nuisances(self) -> tuple[Parameter, ...]:
        """Return the nuisances that touch any open view."""
        data = self.data
        every = nuisance_parameters(data.views, data.noise.flicker, data.scale_deviation)
        return tuple(p for p in every if p.views is None or set(p.views) & set(data.open))

    def anchor(self, point: Point) -> Array:
        """Evaluate the fine model at a point, from where on changes are counted; return its bins (views, rows, cols).

        Parameters
        ----------
        point : mapping

        Raises
        ------
        InputError
            If the rig cannot have these values.
        """
        cards = [k for k, view in enumerate(self.data.views) if view.is_card]
        others = [k for k in range(len(self.data.views)) if k not in cards]
        self.coarse.correction = None
        coarse = self.coarse.cube(point)
        correction = np.zeros_like(coarse)
        self.discretisation = np.zeros_like(coarse)
        if others:
            finest, change = self.extrapolated(point, others)
            correction[others] = finest - coarse[others]
            self.discretisation[others] = change
        if cards:
            if self._cards is None or np.abs(coarse[cards] - self._cards[0]).max() > CARD_STAYS_DN:
                self._cards = coarse[cards], self.fine_cube(point, cards) - coarse[cards]
            correction[cards] = self._cards[1]
        correction += self.codec_bias
        self.coarse.correction = correction
        return np.asarray(coarse + correction)

    def extrapolated(self, point: Point, views: Sequence[int]) -> tuple[Array, Array]:
        """Return bins (views, rows, cols) extrapolated to endlessly fine pixels, and what that added [DN].

        Richardson's extrapolation from light gathered by pixels of a third and of a half of the model camera's. Where
        the real camera's are as small as that, nothing is left to extrapolate.
        """
        fine = self.fine_cube(point, views, FINE_PX)
        sides = [math.ceil(px / self.factor) for px in (FINE_PX, COARSER_PX)]
        if sides[0] == sides[1]:
            return fine, np.zeros_like(fine)
        change = (fine - self.fine_cube(point, views, COARSER_PX)) / ((sides[0] / sides[1]) ** ORDER - 1.0)
        return fine + change, change

    def fine_cube(self, point: Point, views: Sequence[int], fine_px: int = FINE_PX) -> Array:
        """Return the fine bins of some views (chosen views, rows, cols) [DN]."""
        chosen = [self.data.views[k] for k in views]
        renamed = dict(point)
        for new, old in enumerate(views):
            for name in ("force", "flicker"):
                renamed[f"@{name}[{new}]"] = point.get(f"@{name}[{old}]", 0.0)
        scale = self.data.scale
        return FineFrames(
            self.observation.believed,
            chosen,
            self.factor,
            renamed,
            noise_scale=scale,
            fixed=self.fixed,
            fine_px=fine_px,
        ).cube()

    def fine(self, point: Point) -> FineFrames:
        """Return the fine model at a point."""
        return FineFrames(
            self.observation.believed,
            self.data.views,
            self.factor,
            point,
            noise_scale=self.data.scale,
            fixed=self.fixed,
        )

    def frames(self, point: Point, views: Sequence[int]) -> Array:
        """Return fine frames of some views (chosen views, rows, cols), at the model camera's pixels [DN]."""
        fine = self.fine(point)
        found = []
        for k in views:
            picture = fine.picture(k)
            found.append(binned(picture, self.factor) if self.factor > 1 else picture)
        return np.array(found)

    def cube(self, point: Point, only: Sequence[int] | None = None) -> Array:
        """Return the bins (views, rows, cols) [DN]; NaN in views that are not in ``only`` (the open ones)."""
        return self.coarse.cube(point, list(self.data.open if only is None else only))

    def vector(self, point: Point) -> Array:
        """Return the whitened bins (bins,) of the open views."""
        return self.data.whitened(self.cube(point))

    def derivative(self, point: Point, parameter: Parameter) -> Array:
        """Return the whitened derivative (bins,) by a parameter."""
        return self.data.whitened(derivative(self.coarse, point, parameter, self.data.open)).astype(np.float32)
