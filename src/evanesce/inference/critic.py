"""The joint fit on one page: data, first look, nominal fit, moves, consequences, held-out gain, answer."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from evanesce.bundle.bundle import Bundle
from evanesce.core.errors import InputError
from evanesce.inference.answer import answer, named_causes
from evanesce.inference.causes import causes_of
from evanesce.inference.codec import FIRST_DRAWS, codec_behind, filmed
from evanesce.inference.consequence import AreaReader
from evanesce.inference.data import DataVector, data_vector
from evanesce.inference.form_workers import made
from evanesce.inference.gain import held_out
from evanesce.inference.gate import Gate, GrossDifference, gate_of
from evanesce.inference.joint import Fitter, JointFit
from evanesce.inference.marks import MarkSearch
from evanesce.inference.model import AnchoredModel
from evanesce.inference.next_shot import doubtful, next_shot
from evanesce.inference.pictures import Pictures, pictures_of
from evanesce.inference.posterior import DEFECTS, Judge
from evanesce.inference.search import Search, everything_marginalised
from evanesce.inference.series.beside import bank_of, discrepancy_of, with_series
from evanesce.inference.shapes import FormBank, Forms
from evanesce.inference.unknown import left_of
from evanesce.prediction.observe import Observation, observe, require_monochrome
from evanesce.prediction.recoded import DRAWS
from evanesce.prediction.views import BIN_PX

Tell = Callable[[str], None]

FURTHER = "a further cause"
SILENT = 0.2
"""Share of the noise's amplitude, outliving a codec, below which false alarms were seen (docs/criticism/index.md)."""
SILENT_WORDS = "what it made of the frames is badly known, and causes may be false; record with less compression"
CODEC_CAUSES = ("compression",)
"""Effects that stand for a codec: told by what it does to noise, and not sought again."""


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
        With frames of a monochrome camera.
    seed : int
        Of the draws of noise and of the bootstrap.
    tell : callable
        Told what is done, with the time left where it is known.
    exclude : collection of str
        Effects that are not considered.
    workers : int
        Processes by which forms of a rig that is new are made.

    Returns
    -------
    Criticism

    Raises
    ------
    InputError
        For a bundle without frames, or of a colour camera.
    GrossDifference
        If another rig was measured than the scene's.
    """
    began = time.monotonic()
    start = started(bundle, tell)
    observation, model, gate, fitter, base = start.observation, start.model, start.gate, start.fitter, start.base
    causes, left_out = causes_of(observation, {*exclude, *(CODEC_CAUSES if start.codec else ())})
    areas, discrepancy = AreaReader(model), discrepancy_of(model)
    bank = bank_of(model, _place(gate.start), tell)
    smooth = [cause for cause in causes if not cause.placed]
    made(bank, smooth, workers, tell)
    judge = Judge(fitter, smooth, bank, discrepancy, seed=seed)
    marks = MarkSearch(model, [cause for cause in causes if cause.local], seed)
    search = Search(fitter, smooth, judge, tell, marks=marks)
    best, posterior = search.run(base)
    tell("consequences and held-out conditions")
    fine = model.anchor(best.point)
    may_be_off = discrepancy.every_row(best, fine)
    named = named_causes(search, areas, best, may_be_off, posterior)
    gain = held_out(model, areas, base, best, seed)
    rest = everything_marginalised(best)[0].with_rows(may_be_off).project(best.residual)
    scale = observation.scene.camera.scale_px_per_mm
    left = left_of(model.data, rest, bank.seen.by_light, BIN_PX / scale)
    advice = None
    judged = {
        name: place for name, place in posterior.places.items() if name not in search.scan.places() and name != DEFECTS
    }
    doubt = doubtful({**judged, FURTHER: posterior.further} if posterior.asks else judged)
    if doubt:
        tell("what to measure next")
        place = posterior.places.get(doubt, posterior.further)
        advice = next_shot(model, bank, causes, place, judge.weights(best, doubt, search.unknown))
    seconds = time.monotonic() - began
    known = model.data.noise.measured
    result, scene = answer(
        model, search, gate, best, posterior, named, left, gain, advice, left_out, seconds, replicates=known,
        notes=start.notes,
    )  # fmt: skip
    result["codec"] = start.codec or None
    return Criticism(result, scene, pictures_of(model, base, best, left))


@dataclass(frozen=True)
class Start:
    """The nominal rig's own fit, from which causes are sought.

    Attributes
    ----------
    observation : Observation
    model : AnchoredModel
        Anchored about the fit.
    gate : Gate
    fitter : Fitter
    base : JointFit
    codec : str
        Like which the frames came through one; empty where noise gives none away.
    notes : tuple of str
        To be read before probabilities are believed.
    """

    observation: Observation
    model: AnchoredModel
    gate: Gate
    fitter: Fitter
    base: JointFit
    codec: str = ""
    notes: tuple[str, ...] = ()


def started(bundle: Bundle, tell: Tell = lambda line: None) -> Start:
    """Return the nominal fit of a bundle, with what a codec makes of it where the noise gives one away.

    Parameters
    ----------
    bundle : Bundle
    tell : callable

    Raises
    ------
    GrossDifference
        If another rig was measured than the scene's.
    """
    observation, model, gate = _nominal(bundle, tell)
    for line in gate.lines:
        tell(f"{line.name}: measured {line.measured:.4g}, predicted {line.predicted:.4g} {line.unit}".rstrip())
    if gate.gross:
        raise GrossDifference(gate)
    fitter = Fitter(model)
    tell("nominal model and its nuisances")
    base = fitter.relinearised([], gate.start)
    # What a codec makes of dark levels was taken for another black level and noise.
    point = {**base.point, "@black": 0.0, "@noise": 0.0}
    behind = codec_behind(model, point)
    if behind is None:
        return Start(observation, model, gate, fitter, base)
    tell(f"frames came through a codec like {behind[0]}")
    for draws in (FIRST_DRAWS, DRAWS):
        film = filmed(model, point, *behind, draws)
        left = model.data.cube - model.cube(base.point) + model.codec_bias - film.made.bias
        coded = with_series(observation, film.data(model.data, left), bundle)
        coded.codec_bias = film.made.bias
        model, fitter = coded, Fitter(coded)
        base = fitter.relinearised([], point)
        point = dict(base.point)
    kept = float(np.mean(film.made.passed))
    told = f"{behind[0]} or so left {100 * kept:.0f} % of the camera's noise: {SILENT_WORDS}"
    notes = (told,) if kept < SILENT else ()
    return Start(observation, model, gate, fitter, base, str(behind[0]), notes)


def shapes_of(bundle: Bundle, *, tell: Tell = lambda line: None) -> tuple[list[Forms], DataVector]:
    """Return the forms of all causes about a bundle's nominal rig, and the bundle's data.

    Parameters
    ----------
    bundle : Bundle
        With frames of a monochrome camera.
    tell : callable
    """
    observation, model, gate = _nominal(bundle, tell)
    causes, _ = causes_of(observation)
    return FormBank(model.coarse, _place(gate.start), tell).of([c for c in causes if not c.placed]), model.data


def nominal_judge(bundle: Bundle, *, tell: Tell = lambda line: None) -> tuple[Judge, JointFit]:
    """Return what weighs causes against each other about a bundle's nominal rig, and that rig's own fit.

    Parameters
    ----------
    bundle : Bundle
        With frames of a monochrome camera.
    tell : callable
    """
    observation, model, gate = _nominal(bundle, tell)
    causes, _ = causes_of(observation)
    fitter = Fitter(model)
    base = fitter.relinearised([], gate.start)
    bank = bank_of(model, _place(gate.start), tell)
    return Judge(fitter, [c for c in causes if not c.placed], bank, discrepancy_of(model)), base


def _nominal(bundle: Bundle, tell: Tell) -> tuple[Observation, AnchoredModel, Gate]:
    """Return the data of a bundle, the nominal rig's model of them, and its first look."""
    _require_frames(bundle)
    observation = observe(bundle)
    first = AnchoredModel(observation, data_vector(observation))
    tell("first look: board, field of view, contact, level")
    gate = gate_of(observation, first.coarse)
    model = with_series(observation, data_vector(observation, first.coarse.cube(gate.start)), bundle)
    model.coarse = first.coarse
    return observation, model, gate


def _require_frames(bundle: Bundle) -> None:
    if not bundle.has_frames:
        raise InputError("holds no frame", file=bundle.path, allowed="a bundle with press frames")
    require_monochrome(bundle)


@dataclass(frozen=True)
class Criticism:
    """What came out.

    Attributes
    ----------
    result : dict
        See docs/criticism/index.md.
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
