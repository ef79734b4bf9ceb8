"""What a report shows of a case besides its result: images, residuals, tests and ranking."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from numpy.typing import NDArray

from evanesce.criticism.battery import Outcome

Array = NDArray[Any]


@dataclass(frozen=True)
class Shown:
    """One view, before and after.

    Attributes
    ----------
    title : str
        Kind and conditions, with units.
    data : ndarray (rows, cols)
        Binned measurement [DN].
    before, after : ndarray (rows, cols)
        Standardised residual of the believed and of the extended model; NaN where not used.
    locked : bool
    """

    title: str
    data: Array
    before: Array
    after: Array
    locked: bool = False


@dataclass(frozen=True)
class Ranked:
    """One extension that was tried.

    Attributes
    ----------
    effects : tuple of str
    gain, gain_error : float
        Held-out log score over the believed model by leaving conditions out, and its standard error [nats].
    probability : float
    note : str
        Why it was set aside, if it was.
    """

    effects: tuple[str, ...]
    gain: float
    gain_error: float
    probability: float
    note: str = ""


@dataclass(frozen=True)
class Evidence:
    """All of them.

    Attributes
    ----------
    shown : sequence of Shown
    outcomes : sequence of Outcome
        Of the battery and the score tests, loudest first.
    ranking : sequence of Ranked
    scene_before, scene_after : str
        Believed and extended scene as TOML.
    notes : sequence of str
        What the critic could not do with these data, and what it assumed.
    score_p, battery_p : float, optional
        That noise makes any candidate's score, and any test of the battery, as loud; both make up the global one.
    listened : bool
        Whether the battery counts; under a codec it does not.
    """

    shown: Sequence[Shown] = ()
    outcomes: Sequence[Outcome] = ()
    ranking: Sequence[Ranked] = ()
    scene_before: str = ""
    scene_after: str = ""
    notes: Sequence[str] = field(default_factory=tuple)
    score_p: float | None = None
    battery_p: float | None = None
    listened: bool = True
