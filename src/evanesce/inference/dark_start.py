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

SHOWN = (("black_level", "offset_DN", "lens_cap"), ("ambient_light", "radiance_W_per_mm2_sr", "led_off"))
"""Effect, parameter, and the frames that show it and, beside what comes before, nothing else."""
REACH = 30.0
"""Prior deviations within which a figure is sought: a black level that nobody set is off by a tenth of the range."""
ERROR_DN = 0.02
"""Of the level found."""


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
    known = {cause.id: cause for cause in causes}
    found: dict[str, float] = {}
    point = {**point, "@black": 0.0}
    for effect, name, kind in SHOWN:
        views = [k for k in model.data.open if model.data.views[k].kind == kind]
        own = [p for p in known[effect].parameters if p.name == f"{effect}:{name}"] if effect in known else []
        if not views or not own:
            continue
        parameter, shown = own[0], model.data.valid[views]
        level = float(model.data.cube[views][shown].mean())

        def surplus(value: float, views: list[int] = views, shown: np.ndarray = shown, level: float = level) -> float:
            cube = model.cube({**point, **found, parameter.name: value}, views)  # noqa: B023
            return float(cube[views][shown].mean()) - level

        low = max(parameter.bounds[0], parameter.null - REACH * parameter.deviation)
        high = min(parameter.bounds[1], parameter.null + REACH * parameter.deviation)
        if surplus(parameter.null) < -ERROR_DN and surplus(high) > 0.0:
            low = parameter.null
        elif not (surplus(parameter.null) > ERROR_DN and surplus(low) < 0.0):
            continue
        else:
            high = parameter.null
        found[parameter.name] = float(brentq(surplus, low, high, xtol=1e-3 * parameter.deviation))
    return {**found, "@black": 0.0} if found else {}
