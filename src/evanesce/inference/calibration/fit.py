"""Calibrate a rig's scene by a bundle: the joint fit of all its continuous figures, judged by held-out conditions."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.bundle.bundle import Bundle
from evanesce.core.errors import InputError
from evanesce.inference.calibration.area_start import area_start
from evanesce.inference.calibration.figures import FIGURES, Entered, entered
from evanesce.inference.calibration.form_error import form_errors
from evanesce.inference.calibration.intervals import Interval, intervals
from evanesce.inference.calibration.own_error import (
    OwnError,
    alike,
    at_first,
    own_errors,
    reweighed,
    voltage_rows,
    with_errors,
)
from evanesce.inference.causes import causes_of
from evanesce.inference.consequence import AreaReader
from evanesce.inference.dark_start import dark_start
from evanesce.inference.data import DataVector
from evanesce.inference.gain import HeldOut, held_out
from evanesce.inference.gauss_newton import Slopes
from evanesce.inference.joint import Fitter
from evanesce.inference.joint_fit import JointFit
from evanesce.inference.left import Left, left_of
from evanesce.inference.model import AnchoredModel
from evanesce.inference.patch import PlateReader
from evanesce.inference.pictures import Pictures, pictures_of
from evanesce.inference.removal import everything_marginalised
from evanesce.inference.series.beside import discrepancy_of
from evanesce.inference.start import CODEC_CAUSES, Start, refilmed, started
from evanesce.prediction.linear import CovarianceRows, Metric
from evanesce.prediction.parameters import Parameter, derivative
from evanesce.prediction.processes import processes
from evanesce.prediction.views import BIN_PX, View

Array = NDArray[Any]
Tell = Callable[[str], None]


PASSES = 5
"""With other weights at most; they settle in three to five."""
PASS_ROUNDS = 8
"""Predictions of a pass: what it would gain by more is less than the next one gains by its weights, or the last by its
derivatives."""
LAST_ROUNDS = 12
"""Predictions with exact derivatives; some steps fail where a cell of a contact's rim begins to be covered."""
EDGE_PX = 0.4
"""Standard deviation by which all contacts' edges may be off together, a tenth of a bin: so far were those of a rig
that NumPy drew (``tests/support/foreign_rig.py``), with its own light and tone curve."""
LOAD = "@force["
"""Names of the loads of single frames begin so."""


@dataclass(frozen=True)
class Areas:
    """Measured and simulated areas of press views at the nominal voltage, by one reading.

    Attributes
    ----------
    views : tuple of View
    measured, nominal, calibrated : ndarray (views,)
        By the reference segmentation [mm^2].
    frames : ndarray (views, rows, cols)
        Simulated by the calibrated model [DN].
    images : ndarray (views, rows, cols)
        Measured [DN].
    """

    views: tuple[View, ...]
    measured: Array
    nominal: Array
    calibrated: Array
    frames: Array
    images: Array


@dataclass(frozen=True)
class RigFit:
    """A calibrated rig.

    Attributes
    ----------
    start : Start
        Nominal fit.
    best : JointFit
        With the figures.
    figures : mapping of str to Interval
        Of all figures and nuisances that took part, by name.
    left_out : mapping of str to str
        Figures that took no part, and why.
    gain : HeldOut or None
    left : Left
        What no figure explains.
    areas : Areas
    by_kind : mapping of str to float
        Root mean square of the residual over its standard deviation, by kind of view [1].
    pictures : Pictures
    seconds : float
    replicates : bool
        Whether frames of a held state say how much the data scatter.
    own_error : mapping of str to OwnError
        By how much the light is off in ways that no figure stands for, by group of views.
    reading : str
        How areas are read, where not as usual.
    """

    start: Start
    best: JointFit
    figures: dict[str, Interval]
    left_out: dict[str, str]
    gain: HeldOut | None
    left: Left
    areas: Areas
    by_kind: dict[str, float]
    pictures: Pictures
    seconds: float
    replicates: bool
    own_error: Mapping[str, OwnError]
    reading: str = ""


def fit_rig(
    bundle: Bundle,
    *,
    seed: int = 0,
    tell: Tell = lambda line: None,
    exclude: Collection[str] = (),
    workers: int = 1,
) -> RigFit:
    """Fit all continuous figures of a bundle's rig at once.

    Every figure that any view responds to takes part. Those that the bundle does not determine stay at their most
    probable values: at the nominal ones they would displace what they are correlated with.

    Parameters
    ----------
    bundle : Bundle
        With frames.
    seed : int
        Of the bootstrap.
    tell : callable
        Told what is done, with the time left where it is known.
    exclude : collection of str
        Effects that are not fitted.
    workers : int
        Processes by which frames are predicted.

    Returns
    -------
    RigFit

    Raises
    ------
    InputError
        For a bundle without frames, or of a camera whose settings are automatic.
    GrossDifference
        If another rig was measured than the scene's.
    """
    with processes(workers):
        return _fitted(bundle, seed, tell, exclude)


def _fitted(bundle: Bundle, seed: int, tell: Tell, exclude: Collection[str]) -> RigFit:
    began = time.monotonic()
    tell = _timed(tell, began)
    start = started(bundle, tell)
    start, best, into, lacking, off = _joint(start, exclude, tell)
    if start.behind:
        # Noise of a codec is measured by what is left, and the nominal rig leaves all that is wrong with it.
        start, best, into, lacking, off = _joint(refilmed(bundle, start, best, tell), exclude, tell)
    model = start.model
    tell("fine model and derivatives at the fit")
    best = _settled(start.fitter, best)
    # Held-out conditions are judged by what was fitted, about its anchor.
    model.stay(best.point)
    tell(f"misfit {best.misfit:.6g} of {best.residual.size} bins and rows; intervals")
    tied = CovarianceRows.joined(discrepancy_of(model, form_errors).every_row(best), _edges(model, best))
    figures = intervals(best, tied)
    tell("held-out conditions and areas")
    reader = AreaReader(model)
    gain = held_out(model, reader, start.base, best, {}, seed)
    areas = _areas(start, reader, best)
    whole = everything_marginalised(best)[0].with_rows(tied)
    left = _left(start, best, whole)
    missing = {name: why for name, why in lacking.items() if name in FIGURES}
    kinds = _by_kind(start, best, whole)
    return RigFit(
        start, best, figures, {**missing, **into.left_out}, gain, left, areas, kinds,
        pictures_of(model, start.base, best, left), time.monotonic() - began, model.data.noise.measured,
        off, reader.told,
    )  # fmt: skip


def _joint(
    start: Start, exclude: Collection[str], tell: Tell
) -> tuple[Start, JointFit, Entered, Mapping[str, str], Mapping[str, OwnError]]:
    """Return the start by the last weights, the fit, what entered it, what a bundle lacks, and the light's own errors.

    It begins where dark frames and areas of contact are right, every bin weighed by how well its light is known there;
    each pass leaves less, and the next weighs by that, until weights stay.
    """
    causes, lacking = causes_of(start.observation, CODEC_CAUSES if start.codec else ())
    model, noise = start.model, start.model.data
    allowed = [cause for cause in causes if cause.id not in exclude]
    shown = dark_start(model, start.base.point, allowed)
    shown |= area_start(model, {**start.base.point, **shown}, allowed)
    errors = at_first(own_errors(noise, model.cube({**start.base.point, **shown})))
    model.data = with_errors(noise, errors)
    into = entered(model, {**start.base.point, **shown}, causes, exclude, tell)
    tell(f"joint fit of {sum(len(t.parameters) for t in into.taken)} figures")
    point: Mapping[str, float] = into.begin
    known: Mapping[str, Array] | Slopes | None = into.rows
    for number in range(PASSES):
        tell("; ".join(error.sentence(group) for group, error in errors.items() if error) or "weighed by noise alone")
        fitter = _sizes_known(Fitter(model))
        if not any(errors.values()):
            fitter.noise = start.fitter.noise
            best = fitter.relinearised(into.taken, point, known, tell, 1, PASS_ROUNDS, 0, anchored=True)
            break
        fitter.fields = voltage_rows(model.data, errors, fitter.observed.size)
        best = fitter.relinearised(into.taken, point, known, tell, 1, PASS_ROUNDS, 0)
        errors = own_errors(noise, model.cube(best.point))
        now = with_errors(noise, errors)
        if number == PASSES - 1 or alike(model.data, now):
            break
        known = _weighed(model, best, now)
        point = best.point
    base = fitter.fitted([], start.base.point, metric=fitter.jitter_metric(start.base.point), rounds=0)
    return replace(start, fitter=fitter, base=base), best, into, lacking, errors


def _settled(fitter: Fitter, best: JointFit) -> JointFit:
    """Return a fit at the fine model's optimum, with the derivatives that intervals ask for.

    One anchor more moved misfits by less than the fine model's own errors do. Derivatives that steps corrected
    (Broyden) overstate what the data determine.
    """
    fitter.stand(best.taken, best.point)
    made = fitter.slopes_about(best)
    best = fitter.fitted(best.taken, best.point, metric=best.metric, slopes=made, rounds=LAST_ROUNDS, renewals=0)
    return fitter.fitted(best.taken, best.point, metric=best.metric, slopes=made, rounds=0, renewals=0)


def _sizes_known(fitter: Fitter) -> Fitter:
    """Return a fitter to which a contact of another size than its load says is no error of that load.

    Where the light is of another form than any figure's, a frame's load would be moved by several of its standard
    deviations to mend it: what contacts' edges say of the mechanics would then be lost. Errors of loads widen intervals
    (:func:`_edges`).
    """
    fitter.jitter = tuple(p for p in fitter.jitter if not p.name.startswith(LOAD))
    return fitter


def _edges(model: AnchoredModel, best: JointFit) -> CovarianceRows:
    """Return the rows by which contacts' edges may be off, each of unit deviation.

    The loads of single frames, and one shift of all edges: what blur, tone curve and film make of an edge within a bin.
    """
    loads = [p for p in model.nuisances() if p.name.startswith(LOAD)]
    plate, found = PlateReader(model.observation.scene), []
    shift, shift_mm = np.zeros(best.residual.size), EDGE_PX / model.observation.scene.camera.scale_px_per_mm
    for p, row in zip(loads, model.derivatives([(best.point, p) for p in loads]), strict=True):
        if isinstance(row, InputError) or p.views is None:
            continue
        found.append(row * p.deviation)
        patch = plate.patch(model.observation.images[p.views[0]])
        if patch is not None:
            # A radius goes as the cube root of the load.
            shift += row * 3.0 * shift_mm / np.sqrt(patch.area_mm2 / np.pi)
    return CovarianceRows(np.array([*found, shift], np.float32))


def _weighed(model: AnchoredModel, best: JointFit, data: DataVector) -> Slopes | None:
    """Hand a model other weights of its bins; return a fit's derivatives by those, None where they have to be made."""
    before, model.data = model.data, data
    rows = reweighed(best.solution.slopes.rows, before, data)
    return None if rows is None else Slopes(rows)


def _timed(tell: Tell, began: float) -> Tell:
    def told(line: str) -> None:
        tell(f"{line} [{time.monotonic() - began:.0f} s]")

    return told


def _areas(start: Start, reader: AreaReader, best: JointFit) -> Areas:
    """Read the areas of one press view of each force, held-out conditions among them."""
    model = start.model
    own = start.observation.scene.leds.voltage_V
    chosen: dict[tuple[float, bool], int] = {}
    for k, view in enumerate(model.data.views):
        if view.kind == "press" and view.force_N and abs(view.voltage_V - own) < 0.05:
            chosen.setdefault((view.force_N, view.locked), k)
    places = [chosen[key] for key in sorted(chosen)]
    if not places:
        empty = np.zeros((0, *start.observation.images.shape[1:]))
        return Areas((), np.zeros(0), np.zeros(0), np.zeros(0), empty, empty)
    frames = model.frames(best.point, places)
    nominal = model.frames(start.base.point, places)
    images = start.observation.images[places]
    read = [np.array([reader.read(frame) for frame in stack]) for stack in (images, nominal, frames)]
    return Areas(tuple(model.data.views[k] for k in places), read[0], read[1], read[2], frames, images)


def _left(start: Start, best: JointFit, whole: Metric) -> Left:
    """Return what is left by a metric in which all that is fitted is marginalised, discrepancy included."""
    model = start.model
    rest = whole.project(best.residual)
    light = Parameter(name="@light", deviation=1.0, step=0.01)
    lit = [k for k in model.data.open if model.data.views[k].touches]
    by_light = derivative(model.coarse, best.point, light, lit)
    scale = start.observation.scene.camera.scale_px_per_mm
    return left_of(model.data, rest, by_light, BIN_PX / scale)


def _by_kind(start: Start, best: JointFit, whole: Metric) -> dict[str, float]:
    """Return the residual's root mean square over its standard deviation, discrepancy included, by kind of view."""
    data = start.model.data
    cube = data.unwhitened(whole.whiten(best.residual))
    found: dict[str, list[float]] = {}
    for n, k in enumerate(data.open):
        part = cube[n][data.valid[k]]
        found.setdefault(data.views[k].kind, []).append(float(np.mean(part**2)) if part.size else 0.0)
    return {kind: float(np.sqrt(np.mean(squares))) for kind, squares in found.items()}
