"""The prediction of a fit: the coarse model's changes about a point at which the fine model was evaluated."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from evanesce.core.errors import InputError
from evanesce.inference.anchors import Anchors, Evaluated
from evanesce.inference.data import DataVector
from evanesce.prediction.fine import CARD_PX, FINE_PX, FineFrames
from evanesce.prediction.nuisance import nuisance_parameters
from evanesce.prediction.observe import Observation, model_factor
from evanesce.prediction.parameters import Parameter, derivative
from evanesce.prediction.predict import CONTACT_PX, Predictor
from evanesce.prediction.processes import present
from evanesce.prediction.recoded import Recoded
from evanesce.prediction.views import View, binned

Array = NDArray[Any]
Point = Mapping[str, float]

COARSER_PX = 2
"""Of finer pixels along each of the model camera's, for the other end of the extrapolation."""
ORDER, CARD_ORDER = 2.4, 2.0
"""Power of the pixel with which the prediction's error falls, of presses and of cards."""


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
    unexplained : float
        Root of the misfit beyond noise's that the last fit left: an anchor need be no more exact than that asks for.
    """

    observation: Observation
    data: Any
    factor: int
    fixed: Mapping[str, Mapping[str, Any]]
    unexplained: float

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

    def derivatives(self, asked: Sequence[tuple[Point, Parameter]]) -> list[Array | InputError]:
        """Return derivatives (d,), each by a parameter at a point, or why the rig cannot have it."""


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

    unexplained = 0.0

    def __init__(self, observation: Observation, data: DataVector) -> None:
        self.observation, self.data = observation, data
        self.factor = model_factor(observation.believed)
        self.coarse = Predictor(
            observation.scene,
            data.views,
            noise_scale=data.scale,
            pixels=self.factor,
            before=CONTACT_PX,
            finer=CONTACT_PX,
        )
        self.fixed: Mapping[str, Mapping[str, Any]] = {}
        """Settings of effects that list defects: places that data showed."""
        self.codec_bias = np.zeros_like(data.cube)
        """Mean change by a codec (views, rows, cols) [DN]."""
        self.recoded: Recoded | None = None
        """What a codec makes of the frames."""
        self.discretisation = np.zeros_like(data.cube)
        """What extrapolation to finer pixels added at the anchor (views, rows, cols) [DN]."""
        groups = [[k for k, v in enumerate(data.views) if v.is_card is card] for card in (False, True)]
        self._anchors = [(views, Anchors(partial(_size, data, views))) for views in groups if views]
        self._anchored: list[Evaluated] = []

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
        self.coarse.correction = None
        coarse = self.coarse.cube(point)
        correction = self.codec_bias.copy()
        self.discretisation = np.zeros_like(coarse)
        self._anchored = []
        for views, anchors in self._anchors:
            found = anchors.at(coarse[views], partial(self._evaluated, point, views, coarse), self.unexplained)
            self._anchored.append(found)
            correction[views] += found.correction
            self.discretisation[views] = found.discretisation
        self.coarse.correction = correction
        return np.asarray(coarse + correction)

    def stay(self, point: Point) -> None:
        """Take what the fine model added at the anchor for what it adds at a point: that of a fit about the anchor.

        Parameters
        ----------
        point : mapping
        """
        correction, self.coarse.correction = self.coarse.correction, None
        try:
            coarse = self.coarse.cube(point)
        finally:
            self.coarse.correction = correction
        for (views, anchors), found in zip(self._anchors, self._anchored, strict=True):
            anchors.stay(coarse[views], found)

    def _evaluated(self, point: Point, views: Sequence[int], coarse: Array) -> Evaluated:
        """Return what the fine model adds at a point to some views, all of them cards or none.

        Richardson's extrapolation to endlessly fine pixels from light gathered by pixels of two sizes. Where the real
        camera's are as small as that, nothing is left to extrapolate.
        """
        card = self.data.views[views[0]].is_card
        px, order = (CARD_PX, CARD_ORDER) if card else (FINE_PX, ORDER)
        frames = self._fine_frames(point, views, px)
        sides = [math.ceil(size / self.factor) for size in (px, COARSER_PX)]
        change = np.zeros_like(frames)
        if sides[0] != sides[1]:
            coarser = self._fine_frames(point, views, COARSER_PX)
            change = (frames - coarser) / np.float32((sides[0] / sides[1]) ** order - 1.0)
        frames += change
        added = frames - self.coarse.images(point, views).astype(np.float32)
        return Evaluated(coarse[views], added, binned(frames) - coarse[views], binned(change))

    def _fine_frames(self, point: Point, views: Sequence[int], fine_px: int) -> Array:
        """Return fine frames of some views (chosen views, rows, cols) [DN]; a view's own nuisances go by its number."""
        renamed = dict(point)
        for new, old in enumerate(views):
            for name in ("force", "flicker"):
                renamed[f"@{name}[{new}]"] = point.get(f"@{name}[{old}]", 0.0)
        return self.fine(renamed, [self.data.views[k] for k in views], fine_px).frames()

    def fine(self, point: Point, views: Sequence[View] | None = None, fine_px: int = FINE_PX) -> FineFrames:
        """Return the fine model at a point, of all views by default."""
        return FineFrames(
            self.observation.believed,
            self.data.views if views is None else views,
            self.factor,
            point,
            noise_scale=self.data.scale,
            fixed=self.fixed,
            fine_px=fine_px,
        )

    def frames(self, point: Point, views: Sequence[int]) -> Array:
        """Return frames of some views (chosen views, rows, cols) at the model camera's pixels, as at the anchor [DN].

        Without what a codec makes of them.
        """
        correction, self.coarse.correction = self.coarse.correction, None
        try:
            coarse = self.coarse.cube(point)
            found: dict[int, Array] = {}
            for group, anchors in self._anchors:
                if set(group) & set(views):
                    evaluate = partial(self._evaluated, point, group, coarse)
                    added = anchors.at(coarse[group], evaluate, self.unexplained).added
                    found |= dict(zip(group, added, strict=True))
        finally:
            self.coarse.correction = correction
        return self.coarse.images(point, views) + np.array([found[k] for k in views])

    def cube(self, point: Point, only: Sequence[int] | None = None) -> Array:
        """Return the bins (views, rows, cols) [DN]; NaN in views that are not in ``only`` (the open ones)."""
        return self.coarse.cube(point, list(self.data.open if only is None else only))

    def cubes(self, points: Sequence[Point]) -> list[Array | InputError]:
        """Return the bins of the open views at several points, or why the rig cannot have one."""
        return self.coarse.cubes(points, list(self.data.open))

    def vector(self, point: Point) -> Array:
        """Return the whitened bins (bins,) of the open views."""
        return self.data.whitened(self.cube(point))

    def derivative(self, point: Point, parameter: Parameter) -> Array:
        """Return the whitened derivative (bins,) by a parameter."""
        return self._whitened(derivative(self.coarse, point, parameter, self.data.open))

    def derivatives(self, asked: Sequence[tuple[Point, Parameter]]) -> list[Array | InputError]:
        """Return whitened derivatives (bins,), each by a parameter at a point, or why the rig cannot have it."""
        together = present()
        if together is None:
            return one_by_one(self, asked)
        tasks = [(dict(point), parameter, list(self.data.open)) for point, parameter in asked]
        running = together.begin(self.coarse.recipe, self.coarse.fixed, derivative, tasks)
        meanwhile = self._beside(asked)
        found = [one if isinstance(one, InputError) else self._whitened(one) for one in running.results()]
        return [_joined(one, other) for one, other in zip(found, meanwhile, strict=True)]

    def _beside(self, asked: Sequence[tuple[Point, Parameter]]) -> list[Array | InputError]:
        """Return the part of derivatives that follows the bins: of other data than frames, none here."""
        return [np.zeros(0, np.float32) for _ in asked]

    def _whitened(self, slope: Array) -> Array:
        return self.data.whitened(slope).astype(np.float32)


def one_by_one(model: Model, asked: Sequence[tuple[Point, Parameter]]) -> list[Array | InputError]:
    """Return derivatives (d,), each by a parameter at a point, or why the rig cannot have it.

    Parameters
    ----------
    model : Model
    asked : sequence of tuple
    """
    found: list[Array | InputError] = []
    for point, parameter in asked:
        try:
            found.append(model.derivative(point, parameter))
        except InputError as error:
            found.append(error)
    return found


def cube_by_cube(model: Any, points: Sequence[Point]) -> list[Array | InputError]:
    """Return the bins at several points, or why the rig cannot have one, of a model that knows them one by one.

    Parameters
    ----------
    model : object
        With a method ``cube``.
    points : sequence of mapping
    """
    found: list[Array | InputError] = []
    for point in points:
        try:
            found.append(model.cube(point))
        except InputError as error:
            found.append(error)
    return found


def _joined(one: Array | InputError, other: Array | InputError) -> Array | InputError:
    """Return two parts of a derivative as one, or why there is none."""
    if isinstance(one, InputError):
        return one
    return other if isinstance(other, InputError) else np.concatenate([one, other])


def _size(data: DataVector, views: Sequence[int], cube: Array) -> float:
    """Return the root of the sum of squares of bins (views, rows, cols) over their noise."""
    chosen = list(views)
    return float(np.linalg.norm((cube / data.sd[chosen])[data.valid[chosen]]))
