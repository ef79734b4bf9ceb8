"""What the page of a criticism shows: frames as they were measured, and what either model leaves of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.inference.joint_fit import JointFit
from evanesce.inference.left import Left
from evanesce.inference.model import AnchoredModel

Array = NDArray[Any]

MOST = 4


@dataclass(frozen=True)
class Shown:
    """One view.

    Attributes
    ----------
    title : str
    measured, before, after : ndarray (rows, cols)
        Bins [DN]; residuals of the nominal and the extended model over their standard deviation.
    """

    title: str
    measured: Array
    before: Array
    after: Array


@dataclass(frozen=True)
class Pictures:
    """Views, those that the nominal model misses most first, and the map of what is left.

    Attributes
    ----------
    views : tuple of Shown
    left : Left
    """

    views: tuple[Shown, ...]
    left: Left


def pictures_of(model: AnchoredModel, base: JointFit, best: JointFit, left: Left) -> Pictures:
    """Return the views to be shown: of each kind, force and voltage one.

    Parameters
    ----------
    model : AnchoredModel
    base, best : JointFit
        Nominal and extended.
    left : Left
    """
    data = model.data
    before, after = (data.unwhitened(fit.residual) for fit in (base, best))
    chosen: dict[tuple[Any, ...], tuple[float, int]] = {}
    for n, k in enumerate(data.open):
        view = data.views[k]
        size = float(np.square(before[n]).mean())
        key = (view.kind, view.force_N, view.voltage_V)
        if key not in chosen or size > chosen[key][0]:
            chosen[key] = (size, n)
    ordered = sorted(chosen.values(), reverse=True)[:MOST]
    shown = []
    for _, n in sorted(ordered, key=lambda pair: pair[1]):
        k = data.open[n]
        shown.append(Shown(_title(data.views[k]), data.cube[k], before[n], after[n]))
    return Pictures(tuple(shown), left)


def _title(view: Any) -> str:
    if view.kind in ("press", "replicate"):
        mean = f", mean of {view.frames}" if view.frames > 1 else ""
        return f"{view.force_N:g} N, {view.voltage_V:g} V{mean}"
    return {
        "led_off": "LEDs off", "lens_cap": "lens capped", "checkerboard": "checkerboard", "square": "square",
    }[view.kind]  # fmt: skip
