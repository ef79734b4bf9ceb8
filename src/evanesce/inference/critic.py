"""The joint fit on one page: data, first look, nominal fit, moves, consequences, held-out gain, answer."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

from numpy.typing import NDArray

from evanesce.bundle.bundle import Bundle
from evanesce.inference.answer import answer
from evanesce.inference.causes import Cause, causes_of
from evanesce.inference.consequence import AreaReader
from evanesce.inference.constants import CERTAIN
from evanesce.inference.dark_start import dark_start
from evanesce.inference.data import DataVector
from evanesce.inference.discrepancy import Discrepancy
from evanesce.inference.gain import held_out
from evanesce.inference.joint import Fitter
from evanesce.inference.joint_fit import JointFit
from evanesce.inference.judge import Judge
from evanesce.inference.left import left_of
from evanesce.inference.marks import MarkSearch
from evanesce.inference.named import lacking_each, named_causes
from evanesce.inference.next_shot import doubtful, next_shot
from evanesce.inference.pictures import Pictures, pictures_of
from evanesce.inference.posterior import DEFECTS, Posterior
from evanesce.inference.removal import everything_marginalised
from evanesce.inference.search import Search
from evanesce.inference.series.beside import bank_of, discrepancy_of
from evanesce.inference.shapes import FormBank, Forms
from evanesce.inference.single_effects import UNKNOWN
from evanesce.inference.start import CODEC_CAUSES, Start, nominal_rig, refilmed, started
from evanesce.prediction.processes import processes
from evanesce.prediction.views import BIN_PX

Array = NDArray[Any]
Tell = Callable[[str], None]

FURTHER = "a further cause"


def criticise_frames(
    bundle: Bundle,
    *,
    seed: int = 0,
    tell: Tell = lambda line: None,
    exclude: Collection[str] = (),
    workers: int = 1,
) -> Criticism:
    """Find the causes by which a bundle's frames differ from its nominal model, many at once.

    Parameters
    ----------
    bundle : Bundle
        With frames.
    seed : int
        Of the draws of noise and of the bootstrap.
    tell : callable
        Told what is done, with the time left where it is known.
    exclude : collection of str
        Effects that are not considered.
    workers : int
        Processes by which frames are predicted.

    Returns
    -------
    Criticism

    Raises
    ------
    InputError
        For a bundle without frames, or of a camera whose settings are automatic.
    GrossDifference
        If another rig was measured than the scene's.
    """
    with processes(workers):
        return _criticised(bundle, seed, tell, exclude)


def _criticised(bundle: Bundle, seed: int, tell: Tell, exclude: Collection[str]) -> Criticism:
    began = time.monotonic()
    start = started(bundle, tell)
    found = _searched(start, exclude, seed, tell)
    if start.behind and found.best.taken:
        again = refilmed(bundle, found.start, found.best, tell)
        if again.quieter_than(start):
            tell("causes once more: what they explain was taken for the codec's noise")
            found = _searched(again, exclude, seed, tell)
    tell("consequences and held-out conditions")
    start, model = found.start, found.start.model
    best, search = found.best, found.search
    fine = model.anchor(best.point)
    areas = AreaReader(model)
    may_be_off = found.discrepancy.every_row(best, fine)
    told = found.posterior.at_most(CERTAIN)
    gain = held_out(model, areas, start.base, best, lacking_each(search, best), seed)
    named = named_causes(search, areas, best, may_be_off, told, {} if gain is None else gain.by_cause)
    metric = everything_marginalised(best)[0].with_rows(may_be_off)
    rest = metric.project(best.residual)
    draws = None if start.film is None else metric.project(start.film.draws(model))
    scale = start.observation.scene.camera.scale_px_per_mm
    left = left_of(model.data, rest, found.bank.seen.by_light, BIN_PX / scale, draws)
    advice = _advice(found, tell)
    seconds = time.monotonic() - began
    known = model.data.noise.measured
    result, scene = answer(
        model, search, start.gate, best, told, named, left, gain, advice, found.left_out, seconds,
        replicates=known, notes=start.notes,
    )  # fmt: skip
    result["warnings"] += [areas.told] if areas.told else []
    result["codec"] = start.codec or None
    return Criticism(result, scene, pictures_of(model, start.base, best, left))


@dataclass(frozen=True)
class Found:
    """Causes of a bundle.

    Attributes
    ----------
    start : Start
        From which they were sought.
    search : Search
    best : JointFit
        The extended fit.
    posterior : Posterior
    judge : Judge
    bank : FormBank
    discrepancy : Discrepancy
    causes : tuple of Cause
        Judged ones.
    left_out : mapping of str to str
        Others, with the reason.
    """

    start: Start
    search: Search
    best: JointFit
    posterior: Posterior
    judge: Judge
    bank: FormBank
    discrepancy: Discrepancy
    causes: tuple[Cause, ...]
    left_out: Mapping[str, str]


def _searched(start: Start, exclude: Collection[str], seed: int, tell: Tell) -> Found:
    """Return the causes that explain what the nominal fit leaves."""
    model, fitter = start.model, start.fitter
    causes, left_out = causes_of(start.observation, {*exclude, *(CODEC_CAUSES if start.behind else ())})
    bank = bank_of(model, _place(start.gate.start), tell)
    smooth = [cause for cause in causes if not cause.placed]
    discrepancy = discrepancy_of(model)
    judge = Judge(fitter, smooth, bank, discrepancy, seed=seed)
    if start.film:
        tell("the codec's noise along the forms of causes")
        variance, rows = judge.noise(start.base, start.film.draws(model), start.film.made.encoders)
        start = start.with_noise(variance, rows)
        fitter = start.fitter
        judge.set_noise(fitter, variance)
    marks = MarkSearch(model, [cause for cause in causes if cause.local], seed)
    shown = partial(dark_start, model)
    search = Search(fitter, smooth, judge, tell, shown, marks=marks, areas=AreaReader(model))
    best, posterior = search.run(start.base)
    return Found(start, search, best, posterior, judge, bank, discrepancy, tuple(causes), left_out)


def _advice(found: Found, tell: Tell) -> dict[str, Any] | None:
    """Return the shot that would settle what is doubtful most; None if nothing is."""
    posterior = found.posterior
    settled = {*found.search.scan.places(), DEFECTS, UNKNOWN}
    judged = {name: place for name, place in posterior.places.items() if name not in settled}
    doubt = doubtful({**judged, FURTHER: posterior.further} if posterior.asks else judged)
    if not doubt:
        return None
    tell("what to measure next")
    place = posterior.places.get(doubt, posterior.further)
    weights = found.judge.weights(found.best, doubt, found.search.unknown)
    return next_shot(found.start.model, found.bank, found.causes, place, weights)


def shapes_of(bundle: Bundle, *, tell: Tell = lambda line: None) -> tuple[list[Forms], DataVector]:
    """Return the forms of all causes about a bundle's nominal rig, and the bundle's data.

    Parameters
    ----------
    bundle : Bundle
        With frames.
    tell : callable
    """
    observation, model, gate = nominal_rig(bundle, tell)
    causes, _ = causes_of(observation)
    bank = bank_of(model, _place(gate.start), tell)
    return bank.of([c for c in causes if not c.placed]), model.data


def nominal_judge(bundle: Bundle, *, tell: Tell = lambda line: None) -> tuple[Judge, JointFit]:
    """Return what weighs causes against each other about a bundle's nominal rig, and that rig's own fit.

    Parameters
    ----------
    bundle : Bundle
        With frames.
    tell : callable
    """
    observation, model, gate = nominal_rig(bundle, tell)
    causes, _ = causes_of(observation)
    fitter = Fitter(model)
    base = fitter.relinearised([], gate.start)
    bank = bank_of(model, _place(gate.start), tell)
    return Judge(fitter, [c for c in causes if not c.placed], bank, discrepancy_of(model)), base


@dataclass(frozen=True)
class Criticism:
    """What came out.

    Attributes
    ----------
    result : dict
        See docs/reference/criticism-json.md.
    scene : str
        The extended scene as TOML.
    pictures : Pictures
        For the page.
    """

    result: dict[str, Any]
    scene: str
    pictures: Pictures


def _place(start: Mapping[str, float]) -> dict[str, float]:
    """Return where the finger is to a tenth of a millimetre: forms about there are kept for the next bundle."""
    return {name: round(value, 1) for name, value in start.items() if name.startswith("@pose")}
