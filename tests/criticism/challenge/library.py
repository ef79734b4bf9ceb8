"""All causes by name."""

from __future__ import annotations

import numpy as np

from .families_camera import CAMERA
from .families_light import LIGHT
from .hidden import Hidden, Rig
from .unknown import UNKNOWN

NAMED = {cause.id: cause for cause in (*CAMERA, *LIGHT)}
NOT_IN_LIBRARY = {cause.id: cause for cause in UNKNOWN}

NOT_INJECTED = {
    "frame_rate": "leaves no trace where nothing believed moves: the protocol's states stand still",
    "compression": "is a noise class here: half of the nulls are compressed",
    "ridge_height": "the believed fingers of these sets are smooth",
    "shear_area_loss": "the protocol presses, it does not slide",
}
"""Effects of the library that no case hides, and why."""


def make_cause(name: str, rig: Rig, seed: int, form: int, plain: bool = False) -> Hidden:
    """Return a cause with a shape drawn from its seed."""
    kind = NAMED.get(name) or NOT_IN_LIBRARY[name]
    digits = [ord(c) for c in name]
    return kind(np.random.default_rng([seed, *digits]), rig, form, plain)
