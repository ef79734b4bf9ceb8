"""Files of a bundle and the values read from them. See docs/reference/bundle.md."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from evanesce.core.states import ContactState

Array = NDArray[np.float64]

MEASUREMENT_FILE = "measurement.toml"
PRESS_TABLE = "press.csv"
PRESS_FOLDER = "press"
REPLICATES_FOLDER = "replicates"
REPLICATES_TABLE = "replicates.csv"
SERIES_FOLDER = "series"

AUXILIARY = ("led_off", "lens_cap", "checkerboard", "square")
"""Folders of shots that need no table."""

OBSERVABLES = (
    "press", "voltage", "force", "time", "motion", "displacement", "replicates", "led_off", "lens_cap", "checkerboard",
    "square", "series",
)  # fmt: skip
"""What a bundle may hold; effects name what they need in these words.

``press``: frames of presses; ``voltage``, ``force``: at least two of them; ``time``: frames of one held state that lie
at least :data:`MIN_DWELL_S` apart; ``motion``: frames of a moving finger, :data:`MAX_STEP_S` apart at most, or a
rig that slides it; ``displacement``: given for each frame; ``replicates``: at least :data:`MIN_REPLICATES` frames;
the rest: folders of that name.
"""

SERIES_OBSERVABLES = ("press", "voltage", "force", "time", "square")
"""Observables of a bundle without frames: its series depend on light, load, hold and card. Whether they are sensitive
to an effect follows from its prediction only. None of them shows a moving finger."""

MIN_REPLICATES = 3
"""Frames of a held state from which noise is measured."""

MIN_DWELL_S = 10.0
"""Shortest hold of one state from which anything slow can be seen [s]."""

MAX_STEP_S = 0.5
"""Longest time between two frames of unlike forces in which the finger surely moved [s]."""

SAME_FORCE = (0.01, 0.02)
"""Absolute [N] and relative difference of forces that count as one condition: a load cell never repeats a figure."""

SAME_VOLTAGE_V = 0.05
"""Difference of voltages that count as one condition [V]."""


@dataclass(frozen=True, kw_only=True)
class Shot:
    """One frame's line of a table.

    Attributes
    ----------
    index : int
        Number of the frame: its file's name, or its position in the video.
    time_s : float
        Mid-exposure time since an origin that all tables share [s].
    force_N : float
        Normal force [N].
    voltage_V : float
        Supply of the LEDs [V].
    displacement_mm : float
        Of the finger's top towards the plate since first contact [mm]; NaN where not given.
    session : int
        Frames between which the finger was not lifted or moved over the plate share one.
    condition : int
        Frames of one session, force and voltage share one; counted from 0 in the order of appearance.
    held_s : float
        Time since the first frame of this hold: the unbroken run of frames of one session and force [s].
    tangential_force_N, slide_mm, torque_Nmm : float
        Along the slide [N], way of the finger's top over the plate [mm], about the plate's normal [N mm]; NaN where not
        given.
    exposure_ms, analogue_gain, red_gain, blue_gain : float
        What the camera chose itself: exposure [ms], gain, white balance over green [1]; NaN where not given.
    """

    index: int
    time_s: float
    force_N: float
    voltage_V: float
    displacement_mm: float = math.nan
    session: int = 0
    condition: int = 0
    held_s: float = 0.0
    tangential_force_N: float = math.nan
    slide_mm: float = math.nan
    torque_Nmm: float = math.nan
    exposure_ms: float = math.nan
    analogue_gain: float = math.nan
    red_gain: float = math.nan
    blue_gain: float = math.nan


@dataclass(frozen=True)
class Replicates:
    """Frames of a held state: their differences are noise.

    Attributes
    ----------
    shots : tuple of Shot
        One for each frame; empty where the state is not known (the frames then show noise alone).
    count : int
        Number of frames.
    """

    shots: tuple[Shot, ...] = ()
    count: int = 0

    def __len__(self) -> int:
        return self.count


@dataclass(frozen=True, kw_only=True)
class Series:
    """A scalar measured against another.

    Attributes
    ----------
    name : str
        Its file's name without suffix.
    x_name, x_unit : str
        ``force`` [N], ``voltage`` [V], ``time`` [s], ``displacement`` [mm], or ``slide`` [mm].
    y_name, y_unit : str
        ``area`` [mm2], ``force`` [N], ``tangential_force`` [N] along the slide, or ``torque`` [Nmm] about the plate's
        normal.
    x, y : ndarray (n,)
    sigma : ndarray (n,) or None
        Standard deviation of ``y``, in its unit; None where not given.
    held : Mapping of str to float
        What was held while it was measured and the settings of an area, as :data:`HELD` names them.
    """

    name: str
    x_name: str
    x_unit: str
    y_name: str
    y_unit: str
    x: Array
    y: Array
    sigma: Array | None = None
    held: Mapping[str, float] = field(default_factory=lambda: MappingProxyType({}))

    def __len__(self) -> int:
        return int(self.x.size)


@dataclass(frozen=True)
class Column:
    """A column of a table: its closed bounds, and whether it has to be there."""

    lo: float
    hi: float
    unit: str
    required: bool = False
    whole: bool = False

    def __str__(self) -> str:
        whole = "whole numbers " if self.whole else ""
        return f"{whole}{self.lo:g} to {self.hi:g}" + ("" if self.unit == "1" else f" {self.unit}")


SHOT_COLUMNS: Mapping[str, Column] = MappingProxyType(
    {
        "index": Column(0, 9_999_999, "1", required=True, whole=True),
        "time_s": Column(0.0, 1e7, "s", required=True),
        "force_N": Column(0.0, 1000.0, "N", required=True),
        "voltage_V": Column(0.0, 60.0, "V"),
        "displacement_mm": Column(-10.0, 100.0, "mm"),
        "session": Column(0, 9999, "1", whole=True),
        "tangential_force_N": Column(-1000.0, 1000.0, "N"),
        "slide_mm": Column(-1000.0, 1000.0, "mm"),
        "torque_Nmm": Column(-1e5, 1e5, "N mm"),
        "exposure_ms": Column(1e-4, 1e6, "ms"),
        "analogue_gain": Column(1e-3, 1e4, "1"),
        "red_gain": Column(1e-3, 1e3, "1"),
        "blue_gain": Column(1e-3, 1e3, "1"),
    }
)
"""Columns of ``press.csv`` and ``replicates.csv``."""

SHEARED = ("tangential_force_N", "slide_mm", "torque_Nmm")
"""Columns of a rig that slides or twists its finger, written where they are known of all frames."""

CHOSEN = ("exposure_ms", "analogue_gain", "red_gain", "blue_gain")
"""Columns of what a camera with automatic exposure or white balance chose."""

SERIES_X: Mapping[str, Column] = MappingProxyType(
    {
        "force_N": Column(0.0, 1000.0, "N"),
        "voltage_V": Column(0.0, 60.0, "V"),
        "time_s": Column(0.0, 1e7, "s"),
        "displacement_mm": Column(-10.0, 100.0, "mm"),
        "slide_mm": SHOT_COLUMNS["slide_mm"],
    }
)
SERIES_Y: Mapping[str, Column] = MappingProxyType(
    {
        "area_mm2": Column(0.0, 1e6, "mm2"),
        "force_N": Column(0.0, 1000.0, "N"),
        "tangential_force_N": SHOT_COLUMNS["tangential_force_N"],
        "torque_Nmm": SHOT_COLUMNS["torque_Nmm"],
    }
)

HELD: Mapping[str, Column] = MappingProxyType(
    {
        "force_N": Column(0.0, 1000.0, "N"),
        "voltage_V": Column(0.0, 60.0, "V"),
        "time_s": Column(0.0, 1e7, "s"),
        "threshold": Column(0.0, 1.0, "1"),
        "blur_px": Column(0.0, 100.0, "px"),
        "min_blob_mm2": Column(0.0, 1e4, "mm2"),
    }
)
"""Keys of a table ``[series.NAME]`` of ``measurement.toml``: the held state, and the settings of an area."""


def with_chosen(shot: Shot, chosen: Mapping[str, float]) -> Shot:
    """Return a shot with what the camera chose itself.

    Parameters
    ----------
    shot : Shot
    chosen : mapping
        Some of :data:`CHOSEN`.

    Returns
    -------
    Shot
    """
    exposure, gain, red, blue = (chosen.get(name, math.nan) for name in CHOSEN)
    return replace(shot, exposure_ms=exposure, analogue_gain=gain, red_gain=red, blue_gain=blue)


def with_shear(shot: Shot, state: ContactState) -> Shot:
    """Return a shot with what a slide's load cell reads: tangential force, way and torque.

    Parameters
    ----------
    shot : Shot
    state : ContactState

    Returns
    -------
    Shot
        As given for a contact that does not slide.
    """
    tip = state.parameters.get("tip_displacement_mm")
    if tip is None:
        return shot
    angle = math.radians(state.parameters.get("direction_deg", 0.0))
    x, y = state.tangential_force
    along = x * math.cos(angle) + y * math.sin(angle)
    drive = float(tip) + along / float(state.parameters.get("drive_stiffness_N_per_mm", math.inf))
    torque = float(state.parameters.get("torque_N_mm", 0.0))
    return replace(shot, tangential_force_N=along, slide_mm=drive, torque_Nmm=torque)


def conditions(shots: list[Shot]) -> tuple[Shot, ...]:
    """Return the shots with their condition and the time since their hold began.

    Parameters
    ----------
    shots : list of Shot
        In the order of time.

    Returns
    -------
    tuple of Shot
    """
    firsts: list[Shot] = []
    found: list[Shot] = []
    hold: Shot | None = None
    for shot in shots:
        number = next((k for k, first in enumerate(firsts) if same_condition(first, shot)), len(firsts))
        if number == len(firsts):
            firsts.append(shot)
        if hold is None or hold.session != shot.session or not same_force(hold.force_N, shot.force_N):
            hold = shot
        found.append(replace(shot, condition=number, held_s=shot.time_s - hold.time_s))
    return tuple(found)


def same_force(one: float, other: float) -> bool:
    """Return whether two forces [N] agree within the repeatability of a load cell.

    Parameters
    ----------
    one, other : float
        [N].

    Returns
    -------
    bool
    """
    absolute, relative = SAME_FORCE
    return abs(one - other) <= absolute + relative * max(abs(one), abs(other))


def same_condition(one: Shot, other: Shot) -> bool:
    """Return whether two shots are of one session, force and voltage.

    Parameters
    ----------
    one, other : Shot

    Returns
    -------
    bool
    """
    return (
        one.session == other.session
        and same_force(one.force_N, other.force_N)
        and abs(one.voltage_V - other.voltage_V) <= SAME_VOLTAGE_V
    )
