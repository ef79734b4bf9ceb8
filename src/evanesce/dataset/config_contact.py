"""Section ``liquid`` of a dataset's configuration, and words for human prints."""

from __future__ import annotations

from typing import ClassVar

from evanesce.core.quantities import field
from evanesce.dataset.distributions import Bounds, Distribution, Drawn, constant, log_uniform

RIDGE_PATTERNS = ("parallel", "concentric", "loop", "whorl")
PRINT_PATTERNS = {"print_arch": "arch", "print_loop": "loop", "print_whorl": "whorl"}
"""Patterns of human prints, and what a scene calls them."""
PRINT_LIMITS_UM = {"ridge_pitch_um": (100.0, 2000.0), "ridge_height_um": (1.0, 500.0)}
"""Of a scene's ``finger.fingerprint``."""


class Wet(Drawn):
    """Liquid about the contact in a share of the trials, in the terms of a scene's ``[liquid]``."""

    SECTION: ClassVar[str] = "liquid"
    BOUNDS: ClassVar[Bounds] = {
        "volume_uL": (0.0, 1000.0, "uL"),
        "refractive_index": (1.3, 1.5, ""),
        "viscosity_mPa_s": (0.01, 1e5, "mPa s"),
        "roughness_um": (0.001, 100.0, "um"),
    }

    share: float = field(0.0, unit="1", bounds=(0.0, 1.0), doc="of the trials")
    volume_uL: Distribution = log_uniform(0.02, 2.0)
    refractive_index: Distribution = constant(1.333)
    viscosity_mPa_s: Distribution = constant(1.0)
    roughness_um: Distribution = constant(1.0)
