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
    """

    observation: Observation
    data: Any
    factor: int

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
        self.discretisation = np.zeros_like(data.cube)
        """What extrapolation to finer pixels added at the anchor (views, rows, cols) [DN]."""
        self._cards: tuple[Array, Array] | None = None

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
            self.observation.believed, chosen, self.factor, renamed, noise_scale=scale, fine_px=fine_px
        ).cube()

    def fine(self, point: Point) -> FineFrames:
        """Return the fine model at a point."""
        return FineFrames(self.observation.believed, self.data.views, self.factor, point, noise_scale=self.data.scale)

    def cube(self, point: Point, only: Sequence[int] | None = None) -> Array:
        """Return the bins (views, rows, cols) [DN]; NaN in views that are not in ``only`` (the open ones)."""
        return self.coarse.cube(point, list(self.data.open if only is None else only))

    def vector(self, point: Point) -> Array:
        """Return the whitened bins (bins,) of the open views."""
        return self.data.whitened(self.cube(point))

    def derivative(self, point: Point, parameter: Parameter) -> Array:
        """Return the whitened derivative (bins,) by a parameter."""
        return self.data.whitened(derivative(self.coarse, point, parameter, self.data.open)).astype(np.float32)
