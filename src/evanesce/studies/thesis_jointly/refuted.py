"""What the scattering that explains Silskin 20 % alone would make of Silskin 0 %."""

from __future__ import annotations

from typing import Any

import numpy as np

from evanesce.materials.tables import material
from evanesce.studies.thesis.figures import published_depth
from evanesce.studies.thesis_jointly import tables
from evanesce.studies.thesis_jointly.predict import RADIUS_MM

SHARE, LENGTH_MM, FORCE_N = 0.53, 0.90, 5.0
"""Of the single explanation of ``bundles/thesis_silskin_20``: one cause, Hertz's contact with the published E*(F)."""


def alone(share: float = SHARE, length_mm: float = LENGTH_MM) -> dict[str, Any]:
    """Return the area of Silskin 0 % at 5 N that the rig would read if it scattered so, beside the published one.

    Parameters
    ----------
    share, length_mm : float
        Of subsurface scattering.

    Returns
    -------
    dict
        Areas in mm^2.
    """
    hertz = float(np.pi * RADIUS_MM * published_depth("silskin_0", FORCE_N))
    args = [np.array([x]) for x in (np.log(hertz), share, length_mm, 0.0)]
    read = hertz * float(np.exp(tables.log_read_over_true(*args)[0]))
    off = material("silskin_0").area_deviation
    assert off is not None  # in the tables
    return {
        "share": share, "length_mm": length_mm, "force_N": FORCE_N, "hertz_mm2": hertz, "read_mm2": read,
        "published_mm2": [hertz * (1 - off.value), hertz * (1 + off.value)],
    }  # fmt: skip
