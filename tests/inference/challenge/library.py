"""All causes by name."""

from __future__ import annotations

import numpy as np

from .families_camera import CAMERA
from .families_light import LIGHT
from .hidden import Hidden, Rig
from .recipes import RECIPES
from .unknown import UNKNOWN

NAMED = {cause.id: cause for cause in (*CAMERA, *LIGHT)}
NOT_IN_LIBRARY = {cause.id: cause for cause in UNKNOWN}
MARKS = frozenset(name for name, cause in NAMED.items() if cause.mark)

NOT_INJECTED = {
    "frame_rate": "leaves no trace where nothing believed moves: the protocol's states stand still",
    "compression": "is a noise class here: three in five of the nulls are compressed",
    "ridge_height": "the believed fingers of these sets are smooth",
    "friction": "the protocol presses, it does not slide",
    "shear_area_loss": "the protocol presses, it does not slide",
}
"""Effects of the library that no case hides, and why."""


def make_cause(name: str, rig: Rig, seed: int, form: int, plain: bool = False, *, recipe: bool = False) -> Hidden:
    """Return a cause with a shape drawn from its seed, of the families or of the recipes; unknowns have families."""
    kind = NOT_IN_LIBRARY.get(name) or (RECIPES if recipe else NAMED)[name]
    digits = [ord(c) for c in name]
    return kind(np.random.default_rng([seed, *digits]), rig, form, plain)
