"""The prediction of a fit: the coarse model's changes about a point at which the fine model was evaluated."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.criticism.fine import FineFrames
from evanesce.criticism.observe import Observation, model_factor
from evanesce.criticism.parameters import Parameter, derivative
from evanesce.criticism.predict import Predictor
from evanesce.inference.data import DataVector

Array = NDArray[Any]
Point = Mapping[str, float]


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
        self.anchors = 0

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
        fine = self.fine(point).cube()
        self.coarse.correction = None
        self.coarse.correction = np.nan_to_num(fine - self.coarse.cube(point), nan=0.0)
        self.anchors += 1
        return fine

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
