"""Series beside frames: one data vector, the whitened rows after the whitened bins.

:func:`with_series` gives the three things that a joint fit of frames is made of; where a bundle holds no series that
says more than its frames they are those of the frames.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.bundle.bundle import Bundle
from evanesce.core.errors import InputError
from evanesce.inference.causes import Cause
from evanesce.inference.data import DataVector
from evanesce.inference.discrepancy import Discrepancy, FormRows
from evanesce.inference.joint_fit import JointFit
from evanesce.inference.model import AnchoredModel, one_by_one
from evanesce.inference.series.model import SeriesBank, SeriesDiscrepancy, SeriesModel, unknown_rows
from evanesce.inference.series.rows import rows_of
from evanesce.inference.shapes import FormBank, form_predictor
from evanesce.inference.single_effects import UNKNOWN
from evanesce.prediction.linear import CovarianceRows
from evanesce.prediction.observe import Observation
from evanesce.prediction.parameters import Parameter

Array = NDArray[Any]
Point = Mapping[str, float]
Tell = Callable[[str], None]


def with_series(observation: Observation, data: DataVector, bundle: Bundle) -> AnchoredModel:
    """Return the model of a bundle's frames and of the series that were not read from them.

    Parameters
    ----------
    observation : Observation
    data : DataVector
    bundle : Bundle
    """
    used, _, _ = rows_of(bundle.series, bundle.press)
    return FramesAndSeries(observation, data, SeriesModel(observation, used)) if used.series else AnchoredModel(
        observation, data
    )  # fmt: skip


def bank_of(model: AnchoredModel, point: Point, tell: Tell = lambda line: None) -> FormBank:
    """Return the forms for a model of :func:`with_series`; arguments as of :class:`FormBank`."""
    coarse = form_predictor(model.coarse.scene, model.coarse.views, model.data.scale, model.coarse.pixels)
    if not isinstance(model, FramesAndSeries):
        return FormBank(coarse, point, tell)
    bank = FramesAndSeriesBank(coarse, point, tell)
    bank.rows = SeriesBank(model.series)
    return bank


def discrepancy_of(model: AnchoredModel, rows: FormRows | None = None) -> Discrepancy:
    """Return the discrepancy for a model of :func:`with_series`; rows of frames as of :class:`Discrepancy`."""
    return (FramesAndSeriesDiscrepancy if isinstance(model, FramesAndSeries) else Discrepancy)(model, rows)


class FramesAndSeries(AnchoredModel):
    """Predicts the bins of frames and the rows of series; light and black level are one for both.

    Parameters
    ----------
    observation : Observation
    data : DataVector
    series : SeriesModel
    """

    def __init__(self, observation: Observation, data: DataVector, series: SeriesModel) -> None:
        super().__init__(observation, data)
        self.series = series

    @property
    def observed(self) -> Array:
        """Whitened bins of the open views, then rows (bins + rows,)."""
        return np.concatenate([super().observed, self.series.observed])

    def nuisances(self) -> tuple[Parameter, ...]:
        """Return those of the frames, and those that the series have by themselves."""
        frames = super().nuisances()
        shared = {p.name for p in frames}
        return (*frames, *(p for p in self.series.nuisances() if p.name not in shared))

    def anchor(self, point: Point) -> Array:
        """Evaluate the fine model of both at a point; return its bins (views, rows, cols)."""
        self.series.anchor(point)
        return super().anchor(point)

    def vector(self, point: Point) -> Array:
        """Return the whitened prediction (bins + rows,)."""
        frames = self.coarse.begun(point, list(self.data.open))
        series = self.series.vector(point)
        return np.concatenate([self.data.whitened(frames()), series])

    def derivative(self, point: Point, parameter: Parameter) -> Array:
        """Return its derivative (bins + rows,) by a parameter."""
        series = self.series.derivative(point, parameter)
        size = self.observed.size - series.size
        frames = np.zeros(size, np.float32) if self._of_series(parameter) else super().derivative(point, parameter)
        return np.concatenate([frames, series])

    def derivatives(self, asked: Sequence[tuple[Point, Parameter]]) -> list[Array | InputError]:
        """Return derivatives (bins + rows,), each by a parameter at a point, or why the rig cannot have it."""
        frames = [one for one in asked if not self._of_series(one[1])]
        found = iter(super().derivatives(frames))
        return [self.derivative(*one) if self._of_series(one[1]) else next(found) for one in asked]

    def _beside(self, asked: Sequence[tuple[Point, Parameter]]) -> list[Array | InputError]:
        return one_by_one(self.series, asked)

    def _of_series(self, parameter: Parameter) -> bool:
        """Return whether no frame knows a nuisance."""
        return parameter.name in {p.name for p in self.series.nuisances()} - {p.name for p in super().nuisances()}


class FramesAndSeriesBank(FormBank):
    """Forms in bins and rows, drawn at the same points."""

    rows: SeriesBank

    def blocks(self, causes: Sequence[Cause], data: DataVector) -> dict[str, Array]:
        """Return the whitened forms (forms, bins + rows), and rows of something unknown in either."""
        frames = super().blocks(causes, data)
        sd = self.rows.model.data.sd
        found = {}
        for cause in causes:
            changes = self.rows.changes(cause)
            if cause.id not in frames:
                if not np.any(np.nan_to_num(changes)):
                    continue
                frames[cause.id] = np.zeros((len(changes), next(iter(frames.values())).shape[1]), np.float32)
            count = len(frames[cause.id])
            # Either both could have a drawn rig or neither; a law of the frames alone is no change of a row.
            known = changes[~np.isnan(changes).any(axis=1)] if len(changes) != count else np.nan_to_num(changes)
            own = np.zeros((count, sd.size), np.float32)
            own[: len(known)] = known[:count]
            found[cause.id] = np.concatenate([frames.pop(cause.id), own / sd.astype(np.float32)], axis=1)
        nothing = np.zeros((0, sd.size), np.float32)
        found |= {name: _beside(rows, nothing) for name, rows in frames.items()}
        no_bins = np.zeros((0, next(iter(frames.values())).shape[1]), np.float32)
        return found | {f"{UNKNOWN} series": _beside(no_bins, unknown_rows(self.rows.model.data))}


class FramesAndSeriesDiscrepancy(Discrepancy):
    """Rows of the discrepancy in bins and rows; they are independent of each other."""

    model: FramesAndSeries

    def light(self, fitted: JointFit) -> CovarianceRows:
        """Return the rows of the nominal light."""
        return _rows_beside(super().light(fitted), SeriesDiscrepancy(self.model.series).light(fitted))

    def tied(self, fitted: JointFit, fine: Array | None = None) -> dict[str, CovarianceRows]:
        """Return the rows of each cause by its name, and at "" that of what extrapolation to finer pixels added."""
        series = SeriesDiscrepancy(self.model.series).tied(fitted)
        none = CovarianceRows(np.zeros((0, self.model.series.observed.size), np.float32))
        return {name: _rows_beside(rows, series.get(name, none)) for name, rows in super().tied(fitted, fine).items()}

    def sizes(self, fitted: JointFit) -> dict[str, float]:
        """Return the norm of what each cause changes in bins and rows, by its name [standard deviations]."""
        rows = SeriesDiscrepancy(self.model.series).sizes(fitted)
        return {name: float(np.hypot(bins, rows.get(name, 0.0))) for name, bins in super().sizes(fitted).items()}


def _rows_beside(frames: CovarianceRows, series: CovarianceRows) -> CovarianceRows:
    """Return the same of rows of a covariance; series follow the bins, whose stretches stay."""
    return CovarianceRows(_beside(frames.whole, series.whole), frames.stretches)


def _beside(frames: Array, series: Array) -> Array:
    """Return rows of bins and rows of series in one data vector, each without the other."""
    found = np.zeros((len(frames) + len(series), frames.shape[1] + series.shape[1]), np.float32)
    found[: len(frames), : frames.shape[1]] = frames
    found[len(frames) :, frames.shape[1] :] = series
    return found
