"""A small, lopsided rig with enough pixels to measure with, and a question to it, for tests of the design search."""

from __future__ import annotations

from typing import Any

from evanesce.design.question import Question
from evanesce.design.uncertainty import Draw
from evanesce.evaluation.calibrated_rig import CardErrors
from evanesce.rig import Scene
from support.rigs import small_rig

PERFECT = Draw({}, CardErrors(corner_noise_px=0.0), 0.0)


def camera_rig(**changes: Any) -> Scene:
    """Return a small rig with 18 px/mm."""
    return small_rig(
        **{
            "camera__resolution_px": (220, 180), "camera__scale_px_per_mm": 18.0, "camera__pixel": {"pitch_um": 13.0},
            "camera__exposure_ms": 0.1,
        } | changes
    )  # fmt: skip


def question(**changes: Any) -> Question:
    """Return two forces at the rig's own position."""
    return Question(
        **{"forces_N": (0.8, 2.3), "positions_mm": ((3.3, -2.1),), "materials": ("silskin_0",), "rigs": 8,
           "pixel_factor": 1, "crop_mm": 4.0} | changes
    )  # fmt: skip
