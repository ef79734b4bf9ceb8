"""Section ``motion`` of a dataset's configuration: what a slide does besides going to and fro."""

from __future__ import annotations

from typing import ClassVar

from evanesce.core.quantities import field
from evanesce.dataset.distributions import Bounds, Distribution, Drawn, log_uniform, uniform

MOTIONS = ("torsion", "turn", "speed_change", "force_change", "stick_slip")
"""What a slide may do besides, each in its own share of the slides."""


class Motion(Drawn):
    """Shares of the slides in which the finger also turns, changes direction, speed or force, or sticks and slips.

    Each motion is drawn independently. A slide turned by ``torsion_deg`` is so at its far end; one that changes
    direction goes on by ``turn_deg`` past gross slip; speed and force change by their factors in gross slip, at the
    latest half way. Stick-slip: once the whole contact slips, a share ``stick_slip_drop`` of the friction is lost in
    one frame and back in the next; the speed is such that a cycle lasts at least six frames. ``spin_deg`` is the
    rotation of the kind ``spin``.
    """

    SECTION: ClassVar[str] = "motion"
    BOUNDS: ClassVar[Bounds] = {
        "torsion_deg": (-180.0, 180.0, "deg"),
        "turn_deg": (-180.0, 180.0, "deg"),
        "speed_factor": (0.05, 20.0, "of the speed"),
        "force_factor": (0.1, 5.0, "of the force"),
        "stick_slip_drop": (0.1, 0.9, "of the friction"),
        "spin_deg": (-360.0, 360.0, "deg"),
    }

    torsion: float = field(0.0, unit="1", bounds=(0.0, 1.0), doc="share of slides")
    turn: float = field(0.0, unit="1", bounds=(0.0, 1.0), doc="share of slides")
    speed_change: float = field(0.0, unit="1", bounds=(0.0, 1.0), doc="share of slides")
    force_change: float = field(0.0, unit="1", bounds=(0.0, 1.0), doc="share of slides")
    stick_slip: float = field(0.0, unit="1", bounds=(0.0, 1.0), doc="share of slides")
    torsion_deg: Distribution = uniform(-40.0, 40.0)
    turn_deg: Distribution = uniform(-150.0, 150.0)
    speed_factor: Distribution = log_uniform(0.3, 3.0)
    force_factor: Distribution = uniform(0.6, 1.4)
    stick_slip_drop: Distribution = uniform(0.2, 0.6)
    spin_deg: Distribution = uniform(50.0, 120.0)


MOTION_KEYS = tuple(Motion.model_fields)[len(MOTIONS) :]
"""Distributions of the section, drawn for each trial with a motion."""
