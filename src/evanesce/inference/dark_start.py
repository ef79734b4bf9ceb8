"""Black level and the room's light as frames without LEDs show them, for a fit to begin from.

A level that is predicted as black as the scale goes has no derivative by its black level: a fit that begins below it
stays there, and lets other figures make the level of every other frame.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping

import numpy as np
from scipy.optimize import brentq

from evanesce.inference.causes import Cause
from evanesce.inference.model import AnchoredModel
from evanesce.prediction.parameters import Parameter

SHOWN = (("black_level:offset_DN", "lens_cap"), ("ambient_light:radiance_W_per_mm2_sr", "led_off"))
"""Parameter, and the frames that show it and, beside what comes before, nothing else."""
REACH = 30.0
"""Prior deviations within which a figure is sought: a black level that nobody set is off by a tenth of the range."""
ERROR_DN = 0.02
"""Of the mean level: no figure is begun with for less."""


def dark_start(model: AnchoredModel, point: Mapping[str, float], causes: Collection[Cause]) -> dict[str, float]:
    """Return the figures at which frames without LEDs have their mean level.

    Parameters
    ----------
    model : AnchoredModel
    point : mapping
        Of the nominal fit.
    causes : collection of Cause
        That may be there.

    Returns
    -------
    dict of str to float
        Of those that such frames show; what a fit took for black, within its rounding, made up for them.
    """
    known = {p.name: p for cause in causes for p in cause.parameters}
    found: dict[str, float] = {}
    for name, kind in SHOWN:
        views = [k for k in model.data.open if model.data.views[k].kind == kind]
        if views and name in known:
            value = _figure(model, {**point, "@black": 0.0, **found}, known[name], views)
            found |= {} if value is None else {name: value}
    return {**found, "@black": 0.0} if found else {}


def _figure(model: AnchoredModel, point: Mapping[str, float], parameter: Parameter, views: list[int]) -> float | None:
    """Return the value at which views have their mean level; None where that is the nominal one or out of reach."""
    shown = model.data.valid[views]
    level = float(model.data.cube[views][shown].mean())

    def surplus(value: float) -> float:
        cube = model.cube({**point, parameter.name: value}, views)
        return float(cube[views][shown].mean()) - level

    off = surplus(parameter.null)
    end = float(np.clip(parameter.null - np.sign(off) * REACH * parameter.deviation, *parameter.bounds))
    if abs(off) <= ERROR_DN or off * surplus(end) >= 0.0:
        return None
    return float(brentq(surplus, *sorted((parameter.null, end)), xtol=1e-3 * parameter.deviation))
