"""The joint fit on one page: data, first look, nominal fit, moves, consequences, held-out gain, answer."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.bundle.bundle import Bundle
from evanesce.core.errors import InputError
from evanesce.inference.answer import answer, named_causes
from evanesce.inference.card_start import on_prints
from evanesce.inference.causes import Cause, causes_of
from evanesce.inference.codec import FIRST_DRAWS, Filmed, codec_behind, filmed
from evanesce.inference.consequence import AreaReader
from evanesce.inference.constants import CERTAIN, ODD_LIGHT
from evanesce.inference.dark_start import dark_start
from evanesce.inference.data import DataVector, data_vector
from evanesce.inference.discrepancy import Discrepancy
from evanesce.inference.gain import held_out
from evanesce.inference.gate import Gate, GrossDifference, gate_of
from evanesce.inference.joint import Fitter
from evanesce.inference.joint_fit import JointFit
from evanesce.inference.judge import Judge
from evanesce.inference.left import left_of
from evanesce.inference.marks import MarkSearch
from evanesce.inference.model import AnchoredModel
from evanesce.inference.next_shot import doubtful, next_shot
from evanesce.inference.pictures import Pictures, pictures_of
from evanesce.inference.posterior import DEFECTS, Posterior
from evanesce.inference.removal import everything_marginalised
from evanesce.inference.search import Search
from evanesce.inference.series.beside import bank_of, discrepancy_of, with_series
from evanesce.inference.shapes import FormBank, Forms
from evanesce.inference.single_effects import UNKNOWN
from evanesce.prediction.codecs import Likely
from evanesce.prediction.colour import require_predictable
from evanesce.prediction.observe import Observation, observe
from evanesce.prediction.processes import processes
from evanesce.prediction.recoded import DRAWS
from evanesce.prediction.views import BIN_PX

Array = NDArray[Any]
Tell = Callable[[str], None]

FURTHER = "a further cause"
SILENT = 0.2
"""Share of the noise's amplitude, outliving a codec, below which false alarms were seen (docs/criticism/index.md)."""
SILENT_WORDS = "what it made of frames is badly known; causes may be false or missed; record with less compression"
QUIETER = 0.05
"""Share by which a codec's noise has to shrink about the extended rig for causes to be sought once more: a cause that
was hidden by less would have been found."""
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
    named = named_causes(search, areas, best, may_be_off, told)
    gain = held_out(model, areas, start.base, best, seed)
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
    behind : Likely, optional
        What the frames may have come through; None where noise gives none away.
    film : Filmed, optional
        What it made of the frames.
    """

    observation: Observation
    model: AnchoredModel
    gate: Gate
    fitter: Fitter
    base: JointFit
    behind: Likely | None = None
    film: Filmed | None = None

    @property
    def kept(self) -> float:
        """Share of the noise's amplitude that outlived the codec."""
        return 1.0 if self.film is None else float(np.mean(self.film.made.passed))

    @property
    def codec(self) -> str:
        """Like which the frames came through one; empty where noise gives none away."""
        return str(self.behind.codec) if self.behind else ""

    @property
    def notes(self) -> tuple[str, ...]:
        """To be read before probabilities are believed."""
        told = f"{self.codec} or so left {100 * self.kept:.0f} % of the camera's noise: {SILENT_WORDS}"
        notes = (*self.gate.odd, light_note(self.base.point), told if self.kept < SILENT else "")
        return tuple(n for n in notes if n)

    def with_noise(self, variance: float, rows: Array) -> Start:
        """Return the nominal fit where all noise has another variance, and some rows more are noise.

        Parameters
        ----------
        variance : float
            In units of the present one [1].
        rows : ndarray (k, d)
            Each of unit standard deviation by the new one.
        """
        model = self.model
        model.data = replace(model.data, sd=np.sqrt(variance) * model.data.sd)
        fitter = Fitter(model)
        fitter.noise = rows
        return replace(self, fitter=fitter, base=fitter.relinearised([], self.base.point))

    def quieter_than(self, other: Start) -> bool:
        """Tell whether noise that hangs together is weaker than in another one by more than :data:`QUIETER`."""
        own, before = self.model.data.correlation, other.model.data.correlation
        return own is not None and before is not None and own.size < (1.0 - QUIETER) * before.size


def light_note(point: Mapping[str, float]) -> str:
    """Return what is odd about the light of a fitted point; empty for little."""
    light = float(np.exp(point.get("@light", 0.0)))
    if 1.0 / ODD_LIGHT <= light <= ODD_LIGHT:
        return ""
    return f"the light is {light:.2g} of the scene's: look at exposure, gain and voltage first"


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
    tell(f"frames came through a codec like {behind.codec}")
    start = Start(observation, model, gate, fitter, base, behind)
    for draws in (FIRST_DRAWS, DRAWS):
        start = _filmed_at(bundle, start, point, base, draws)
        base = start.base
        point = dict(base.point)
    return start


def refilmed(bundle: Bundle, start: Start, best: JointFit, tell: Tell = lambda line: None) -> Start:
    """Return the nominal fit by what the codec makes of the extended rig's frames, and of what that rig leaves.

    About the nominal rig all that causes do is left, and counts as the codec's: strong causes hide weaker ones.

    Parameters
    ----------
    bundle : Bundle
    start : Start
        Of frames that came through a codec.
    best : JointFit
        The extended fit.
    tell : callable
    """
    tell("the codec's noise about the extended rig")
    return _filmed_at(bundle, start, best.point, best, DRAWS)


def _filmed_at(bundle: Bundle, start: Start, point: Mapping[str, float], fit: JointFit, draws: int) -> Start:
    """Return the nominal fit by what a codec makes of the frames predicted at a point, and what a fit leaves."""
    assert start.behind is not None
    model = start.model
    film = filmed(model, point, start.behind, draws)
    left = model.data.cube - model.cube(fit.point) + model.codec_bias - film.made.bias
    coded = with_series(start.observation, film.data(model.data, left), bundle)
    coded.codec_bias, coded.recoded = film.made.bias, film.made
    fitter = Fitter(coded)
    base = fitter.relinearised([], {name: value for name, value in point.items() if name.startswith("@")})
    return replace(start, model=coded, fitter=fitter, base=base, film=film)


def shapes_of(bundle: Bundle, *, tell: Tell = lambda line: None) -> tuple[list[Forms], DataVector]:
    """Return the forms of all causes about a bundle's nominal rig, and the bundle's data.

    Parameters
    ----------
    bundle : Bundle
        With frames.
    tell : callable
    """
    observation, model, gate = _nominal(bundle, tell)
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
    data = data_vector(observation, first.coarse.cube(gate.start))
    data = replace(data, valid=data.valid & on_prints(observation, gate.start))
    model = with_series(observation, data, bundle)
    model.coarse = first.coarse
    return observation, model, gate


def _require_frames(bundle: Bundle) -> None:
    if not bundle.has_frames:
        raise InputError("holds no frame", file=bundle.path, allowed="a bundle with press frames")
    require_predictable(bundle)


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
