"""The number that an answer should give, for causes whose hidden form and library effect share one.

Most causes are hidden in another functional family than the library's: no parameter of it is the true one. In five the
quantity is the same, or is after a mean over what the form adds; those means are of the whole protocol.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from .cases import CaseSpec
from .library import make_cause
from .make import FORM

MEAN_TIME_S = 100.0
"""Middle of the ramp and its holds."""


def told(truth: Mapping[str, Any]) -> tuple[str, float] | None:
    """Return the library parameter of a single cause and its true value; None where there is none."""
    if truth["group"] != "single" or truth["causes"][0] not in VALUES:
        return None
    fields = {k: tuple(v) if isinstance(v, list) else v for k, v in truth.items() if k in CaseSpec.__dataclass_fields__}
    spec = CaseSpec(**fields)
    cause: Any = make_cause(spec.causes[0], None, spec.seed, FORM[spec.set])  # type: ignore[arg-type]
    name, value = VALUES[spec.causes[0]]
    return name, float(value(cause, float(truth["amplitudes"][0])))


def _black(cause: Any, a: float) -> float:
    return float(cause.sign * a * (1.0 + (0.0 if cause.form == 0 else cause.slope / 3.0)))


def _modulus(cause: Any, a: float) -> float:
    strain = float(np.mean(np.linspace(1 / 6, 1, 6) ** (1 / 3)))
    return math.exp(-cause.sign * a * (1.0 + (-0.2 if cause.form == 0 else 0.2) * strain)) - 1.0


def _force(cause: Any, a: float) -> float:
    return -cause.sign * a * (1.0 - (0.1 if cause.form == 0 else 0.2) * MEAN_TIME_S / 200.0)


VALUES = {
    "black_level": ("offset_DN", _black),
    "square_size": ("square", lambda cause, a: math.exp(cause.sign * a) - 1.0),
    "card_offset": ("height_mm", lambda cause, a: a),
    "modulus": ("relative", _modulus),
    "force_offset": ("offset_N", _force),
}
