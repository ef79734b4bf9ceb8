"""Series as data of a joint fit: prediction, nuisances, forms of causes, discrepancy and the unknown, row by row."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.core.errors import InputError
from evanesce.core.provenance import code_digest, digest
from evanesce.core.rng import generator
from evanesce.inference.causes import Cause
from evanesce.inference.constants import DRAWS, OWN_LIGHT, TIED_SHARE, WAVES
from evanesce.inference.joint_fit import JointFit
from evanesce.inference.laws import Law, all_laws
from evanesce.inference.model import one_by_one
from evanesce.inference.series import predict
from evanesce.inference.series.predict import SeriesPredictor, log_of
from evanesce.inference.series.rows import Rows
from evanesce.inference.shapes import BEHIND, SHAPES, drawn_points, sources_of
from evanesce.inference.single_effects import UNKNOWN
from evanesce.inference.unknown import at_largest_strength
from evanesce.prediction import priors
from evanesce.prediction.linear import CovarianceRows
from evanesce.prediction.observe import Observation, model_factor
from evanesce.prediction.parameters import Parameter, value_of
from evanesce.render.fast.field_files import read_arrays, write_arrays

Array = NDArray[Any]
Point = Mapping[str, float]
Tell = Callable[[str], None]

READING_SHARE = 0.1
"""Of what larger pixels read wrongly of the nominal rig: as much may be left of it where a fit has moved to."""
ZERO_MM = 0.02
"""Standard deviation of the place of first contact, or of a slide's start, from which ways count: a load cell that
tells a few mN knows it to so much."""
SILENT_DRAWS = 4
"""Forms of which none moves anything: the others are not made."""
UNKNOWN_HALF_WAVES = 4
"""Cosines, the constant among them, of an unknown function of the abscissa; never as many as a series has rows."""


class SeriesModel:
    """Predicts rows of series; what larger pixels read wrongly is put right at the anchor, as for frames.

    Parameters
    ----------
    observation : Observation
        Nominal rig; its views are not used.
    data : Rows
    widened : bool
        Whether the rows' standard deviations get what larger pixels may leave, for which fine frames are evaluated.
    """

    unexplained = 0.0

    def __init__(self, observation: Observation, data: Rows, *, widened: bool = True) -> None:
        self.observation = observation
        self.fixed: Mapping[str, Mapping[str, Any]] = {}
        self.factor = model_factor(observation.believed)
        self.coarse = SeriesPredictor(observation.believed)
        self.finest = SeriesPredictor(observation.believed, fine=True)
        self.correction: Array = np.zeros(data.sd.size)
        self.data = data
        self._names = {p.name for p in self.nuisances()}
        if widened:
            self.anchor({})
            self.data = data.widened(READING_SHARE * np.abs(self.correction))

    @property
    def observed(self) -> Array:
        """Whitened rows (rows,)."""
        return self.data.whitened

    def nuisances(self) -> tuple[Parameter, ...]:
        """Return light, load of each series, and zero of each displacement."""
        found = []
        if any(one.y_name == "area" for one in self.data.series):
            found.append(Parameter(name="@light", deviation=priors.LIGHT, step=0.1))
        for one in self.data.series:
            load = priors.LOAD
            found.append(Parameter(name=f"@load[{one.name}]", deviation=load, step=0.02, linear=True))
            if one.x_name in ("displacement", "slide"):
                found.append(Parameter(name=f"@zero[{one.name}]", unit="mm", deviation=ZERO_MM, step=ZERO_MM))
        return tuple(found)

    def anchor(self, point: Point) -> Array:
        """Evaluate fine frames at a point, from where on changes are counted; return the logarithms (rows,).

        Raises
        ------
        InputError
            If the rig cannot have these values.
        """
        own = self._relevant(point)
        coarse = log_of(self.coarse, self.data.series, own)
        fine = [
            self.finest.log(one, own) if one.y_name == "area" else coarse[part]
            for one, part in zip(self.data.series, self.data.parts, strict=True)
        ]
        self.correction = np.concatenate([np.zeros(0), *fine]) - coarse
        return coarse + self.correction

    def log(self, point: Point) -> Array:
        """Return the logarithms (rows,)."""
        return log_of(self.coarse, self.data.series, self._relevant(point)) + self.correction

    def vector(self, point: Point) -> Array:
        """Return the whitened prediction (rows,)."""
        return np.asarray(self.log(point) / self.data.sd)

    def derivative(self, point: Point, parameter: Parameter) -> Array:
        """Return the whitened derivative (rows,): central differences, three points of one side at a bound."""
        if parameter.name.startswith("@") and parameter.name not in self._names:
            return np.zeros(self.data.sd.size)
        at, h, (low, high) = value_of(point, parameter), parameter.step, parameter.bounds

        def there(value: float) -> Array:
            return self.vector({**point, parameter.name: value})

        if at - h >= low and at + h <= high:
            return np.asarray((there(at + h) - there(at - h)) / (2 * h))
        side = h if at + 2 * h <= high else -h
        return np.asarray((4 * there(at + side) - there(at + 2 * side) - 3 * there(at)) / (2 * side))

    derivatives = one_by_one

    def of_other_rows(self, data: Rows) -> SeriesModel:
        """Return the model of other rows of the same rig."""
        return SeriesModel(self.observation, data, widened=False)

    def _relevant(self, point: Point) -> dict[str, float]:
        """Return the part of a point that a series knows: causes, and its own nuisances."""
        return {name: value for name, value in point.items() if ":" in name or name in (*self._names, "@black")}


class SeriesBank:
    """Forms of causes about the nominal rig, drawn at the points at which those of frames are.

    Parameters
    ----------
    model : SeriesModel
    tell : callable
    """

    def __init__(self, model: SeriesModel, tell: Tell = lambda line: None) -> None:
        self.model, self.tell = model, tell
        self.predictor = model.coarse

    def blocks(self, causes: Sequence[Cause], data: Rows) -> dict[str, Array]:
        """Return the whitened forms (forms, rows) of causes that move any row, and rows of something unknown."""
        found = {}
        for number, cause in enumerate(causes):
            self.tell(f"forms of {cause.id} ({number + 1} of {len(causes)})")
            changes = self.changes(cause)
            changes = changes[~np.isnan(changes).any(axis=1)]
            if np.any(changes):
                found[cause.id] = changes / data.sd
        return {**found, f"{UNKNOWN} series": unknown_rows(data)}

    def changes(self, cause: Cause) -> Array:
        """Return changes of the logarithms (forms, rows), kept on disk; NaN where the rig cannot have a form."""
        series = self.model.data.series
        state = [[s.x_name, s.y_name, list(map(float, s.x)), sorted(s.held.items())] for s in series]
        scene = self.predictor.scene.model_dump(mode="json")
        own = [code_digest(*BEHIND), inspect.getsource(predict)]
        key = digest(["series", *own, DRAWS, scene, state, *sources_of(cause)])
        kept = read_arrays(key, ("changes",), SHAPES)
        if kept is None:
            kept = {"changes": self._made(cause).astype(np.float32)}
            write_arrays(key, kept, SHAPES)
        return np.asarray(kept["changes"], float)

    def _made(self, cause: Cause) -> Array:
        rng = generator(0, "forms", cause.id)
        series = self.model.data.series
        nominal = log_of(self.predictor, series, {})
        points, laws = drawn_points(cause, rng), all_laws().get(cause.id, ())
        found = np.zeros((len(points) + len(laws), nominal.size))
        for number, point in enumerate(points):
            try:
                found[number] = log_of(self.predictor, series, point) - nominal
            except InputError:
                found[number] = np.nan
            if number + 1 == SILENT_DRAWS and not np.any(np.nan_to_num(found[:SILENT_DRAWS])):
                return found
        for number, law in enumerate(laws, len(points)):
            found[number] = self._by_law(law, rng) - nominal
        return found

    def _by_law(self, law: Law, rng: np.random.Generator) -> Array:
        """Return the logarithms (rows,) by a law of the rig; one that changes bins of frames says nothing of areas."""
        series = self.model.data.series
        if law.rig is None:
            return log_of(self.predictor, series, {})
        rig = law.rig(self.predictor.scene, rng)
        return np.concatenate([self.predictor.of_rig(rig, one) for one in series])


class SeriesDiscrepancy:
    """Rows of the discrepancy: of the nominal light, and of each cause's own change.

    Parameters
    ----------
    model : SeriesModel
    """

    def __init__(self, model: SeriesModel) -> None:
        self.model = model

    def light(self, fitted: JointFit) -> CovarianceRows:
        """Return the rows of the nominal light."""
        light = [p for p in self.model.nuisances() if p.name == "@light"]
        return self._smooth([OWN_LIGHT * self.model.derivative(fitted.point, p) for p in light])

    def tied(self, fitted: JointFit) -> dict[str, CovarianceRows]:
        """Return the rows of each cause by its name."""
        return {name: self._smooth([TIED_SHARE * change]) for name, change in self._changes(fitted).items()}

    def sizes(self, fitted: JointFit) -> dict[str, float]:
        """Return the norm of what each cause changes, by its name [standard deviations]."""
        return {name: float(np.linalg.norm(change)) for name, change in self._changes(fitted).items()}

    def _changes(self, fitted: JointFit) -> dict[str, Array]:
        """Return what each cause changes (rows,), whitened; without those that a rig cannot lack."""
        model, found = self.model, {}
        whole = model.vector(fitted.point)
        for taken in fitted.taken:
            try:
                found[taken.id] = whole - model.vector(fitted.without(taken.id))
            except InputError:
                continue
        return found

    def every_row(self, fitted: JointFit) -> CovarianceRows:
        """Return all rows of a joint fit, the model anchored about it."""
        return CovarianceRows.joined(self.light(fitted), *self.tied(fitted).values())

    def _smooth(self, changes: Sequence[Array]) -> CovarianceRows:
        data = self.model.data
        waves = cosines(data, WAVES, normed=True) / np.sqrt(WAVES)
        rows = np.concatenate([np.zeros((0, data.sd.size)), *(waves * change for change in changes)])
        return CovarianceRows(rows)


def cosines(data: Rows, count: int, *, normed: bool = False) -> Array:
    """Return cosines (k, rows) of the rank of the abscissa within each series, the constant first.

    Parameters
    ----------
    data : Rows
    count : int
        For each series; less than it has rows.
    normed : bool
        To a mean square of 1.
    """
    found = []
    for one, part in zip(data.series, data.parts, strict=True):
        rank = np.argsort(np.argsort(one.x, kind="stable"), kind="stable")
        for k in range(max(min(count, len(one) - 1), 1)):
            wave = np.zeros(data.sd.size)
            wave[part] = np.cos(np.pi * k * (rank + 0.5) / len(one))
            found.append(wave / np.sqrt(np.mean(wave[part] ** 2)) if normed else wave)
    return np.array(found)


def unknown_rows(data: Rows) -> Array:
    """Return whitened rows (k, rows): a smooth function of the abscissa for each series, of any size."""
    return at_largest_strength(cosines(data, UNKNOWN_HALF_WAVES) / data.sd)
