"""The nominal rig's own fit, from which causes are sought: data, first look, codec, nuisances."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.bundle.bundle import Bundle
from evanesce.core.errors import InputError
from evanesce.inference.card_start import on_prints
from evanesce.inference.codec import FIRST_DRAWS, Filmed, codec_behind, filmed
from evanesce.inference.constants import ODD_LIGHT
from evanesce.inference.data import data_vector
from evanesce.inference.gate import Gate, GrossDifference, gate_of
from evanesce.inference.joint import Fitter
from evanesce.inference.joint_fit import JointFit
from evanesce.inference.model import AnchoredModel
from evanesce.inference.series.beside import with_series
from evanesce.prediction.codecs import Likely
from evanesce.prediction.colour import require_predictable
from evanesce.prediction.observe import Observation, observe
from evanesce.prediction.recoded import DRAWS

Array = NDArray[Any]
Tell = Callable[[str], None]

SILENT = 0.2
"""Share of the noise's amplitude, outliving a codec, below which false alarms were seen (docs/criticism/index.md)."""
SILENT_WORDS = "what it made of frames is badly known; causes may be false or missed; record with less compression"
QUIETER = 0.05
"""Share by which a codec's noise has to shrink about the extended rig for causes to be sought once more: a cause that
was hidden by less would have been found."""
CODEC_CAUSES = ("compression",)
"""Effects that stand for a codec: told by what it does to noise, and not sought again."""


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
    observation, model, gate = nominal_rig(bundle, tell)
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


def nominal_rig(bundle: Bundle, tell: Tell) -> tuple[Observation, AnchoredModel, Gate]:
    """Return the data of a bundle, the nominal rig's model of them, and its first look.

    Parameters
    ----------
    bundle : Bundle
    tell : callable

    Raises
    ------
    InputError
        For a bundle without frames, or of a camera whose settings are automatic.
    """
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
