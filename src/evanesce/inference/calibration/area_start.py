"""Stiffness and load cell's zero as contact areas show them, for a fit to begin from.

An area at half the contact's own light is read alike whatever the light is, so that it says what the mechanics are
before anything is known of LEDs, camera or lens. A fit that begins with another contact than there is would make up
for it by light.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.inference.calibration.figures import FIGURES
from evanesce.inference.causes import Cause
from evanesce.inference.gauss_newton import Prior, fit
from evanesce.inference.model import AnchoredModel
from evanesce.inference.patch import PlateReader
from evanesce.prediction.linear import Metric

Array = NDArray[Any]

SHOWN = ("modulus", "bone_stiffening", "adhesion", "creep", "force_offset")
"""Effects that make a contact larger or smaller, and what areas have to say of them."""
AREA_SHARE = 0.005
"""Relative standard deviation of an area at half its light: a glow or a blur moves that outline by a tenth of a pixel,
of some forty along the radius."""


def area_start(model: AnchoredModel, point: Mapping[str, float], causes: Collection[Cause]) -> dict[str, float]:
    """Return the figures at which contacts are as large as measured.

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
        Of those effects that are among ``causes``; empty where no contact is seen.
    """
    parameters = [
        p
        for cause in causes
        if cause.id in SHOWN
        for p in cause.parameters
        if p.name.partition(":")[2] in FIGURES[cause.id].names
    ]
    plate = PlateReader(model.observation.scene)
    data = model.data
    pressed = [k for k in data.open if data.views[k].kind == "press" and data.views[k].force_N]
    measured = {k: seen for k in pressed if (seen := plate.patch(model.observation.images[k])) is not None}
    views = list(measured)
    if not parameters or not views:
        return {}
    size = np.log([measured[k].area_mm2 for k in views]) / AREA_SHARE
    gone = np.log(plate.pixel_mm2.mean()) / AREA_SHARE

    def areas(values: Array) -> Array:
        there = {p.name: float(v) for p, v in zip(parameters, values, strict=True)}
        patches = [plate.patch(image) for image in model.coarse.images({**point, **there}, views)]
        return np.array([gone if patch is None else np.log(patch.area_mm2) / AREA_SHARE for patch in patches])

    def slopes(values: Array, predicted: Array, width: Array | None) -> tuple[Array, Array]:
        rows = []
        for place, p in enumerate(parameters):
            # Areas count pixels: over less than a prior deviation they change by steps.
            step = p.deviation if values[place] + p.deviation <= p.bounds[1] else -p.deviation
            there = values.copy()
            there[place] += step
            rows.append((areas(there) - predicted) / step)
        return np.array(rows), predicted

    mean, deviation, low, high = (
        np.array(column) for column in zip(*((p.null, p.deviation, *p.bounds) for p in parameters), strict=True)
    )
    nothing = Metric.of(np.zeros((0, len(views))), np.zeros(0))
    found = fit(areas, slopes, size, Prior(mean, deviation, low, high), mean, metric=nothing)
    return {p.name: float(v) for p, v in zip(parameters, found.values, strict=True)}
