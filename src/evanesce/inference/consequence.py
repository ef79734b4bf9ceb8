"""What a cause does to the area that the reference segmentation reads."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.linalg import solve
from numpy.typing import NDArray

from evanesce.bundle.area import AreaReading
from evanesce.core.errors import InputError
from evanesce.inference.constants import SUBSTITUTE
from evanesce.inference.joint_fit import JointFit
from evanesce.inference.model import AnchoredModel
from evanesce.prediction.colour import area_in, reading_of
from evanesce.prediction.observe import model_scene

Array = NDArray[Any]

KEPT = 2
"""Points whose areas are kept: the present fit and one beside it."""
ROUNDED = 1e-6
"""Added to variances over themselves: of parameters that stand in for each other exactly, rounding decides the rest."""
NINETY = 1.645
"""Standard deviations of a 90 % interval."""


@dataclass(frozen=True)
class Consequence:
    """Change of the measured area by one cause.

    Attributes
    ----------
    forces_N : tuple of float
    change_mm2, change_percent : tuple of float
        With the cause less without, over the area without; NaN where nothing is read without it.
    low_mm2, high_mm2 : tuple of float
        90 % interval.
    """

    forces_N: tuple[float, ...]
    change_mm2: tuple[float, ...]
    change_percent: tuple[float, ...]
    low_mm2: tuple[float, ...] = ()
    high_mm2: tuple[float, ...] = ()

    @property
    def largest(self) -> float:
        """Largest relative change over the forces [1]; 0 where no area is read."""
        known = [abs(c) for c in self.change_percent if np.isfinite(c)]
        return max(known, default=0.0) / 100.0

    def as_dict(self) -> dict[str, Any]:
        """Return it in the answer's form."""
        return {
            "force_N": list(self.forces_N),
            "mm2": list(self.change_mm2),
            "percent": list(self.change_percent),
            "mm2_lo": list(self.low_mm2),
            "mm2_hi": list(self.high_mm2),
        }


def counted_sd(change_mm2: Array, pixel_mm2: float) -> Array:
    """Return the standard deviation of a change of area that was counted in pixels [mm^2].

    Those that a moved outline takes in lie anywhere about it, so that their number has a Poisson variance: as large as
    itself, and that of one pixel where none is seen to change.

    Parameters
    ----------
    change_mm2 : ndarray
    pixel_mm2 : float
    """
    return np.sqrt(pixel_mm2 * (np.abs(change_mm2) + pixel_mm2))


def nearest(fitted: JointFit, covariance: Array, cause: str) -> str:
    """Return the taken cause that makes more than half of another's variance; empty if there is none.

    Parameters
    ----------
    fitted : JointFit
    covariance : ndarray (n, n)
        Of the fit's parameters.
    cause : str

    Notes
    -----
    By the largest canonical correlation of the two causes' parameters (Hotelling 1936), whose square is that share.
    """
    deviation = np.sqrt(np.diag(covariance))
    correlations = covariance / np.outer(deviation, deviation) + ROUNDED * np.eye(len(deviation))
    whitened = {}
    for name in fitted.ids:
        places = fitted.of_cause(name)
        if places.size:
            whitened[name] = places, np.linalg.cholesky(correlations[np.ix_(places, places)])
    if cause not in whitened:
        return ""
    own, root = whitened.pop(cause)

    def correlation(name: str) -> float:
        places, other = whitened[name]
        return float(np.linalg.norm(solve(other, solve(root, correlations[np.ix_(own, places)]).T), 2))

    each = {name: correlation(name) ** 2 for name in whitened}
    most = max(each, key=lambda name: each[name], default="")
    return most if each.get(most, 0.0) > SUBSTITUTE else ""


class AreaReader:
    """Reads areas from predicted frames of the press views, one view of each force at the scene's voltage.

    Parameters
    ----------
    model : AnchoredModel
    """

    def __init__(self, model: AnchoredModel) -> None:
        self.model = model
        self.scene = model_scene(model.observation.believed)
        chosen: dict[float, int] = {}
        own = self.scene.leds.voltage_V
        for k, view in enumerate(model.data.views):
            if view.kind == "press" and view.force_N and not view.locked and abs(view.voltage_V - own) < 0.05:
                chosen.setdefault(view.force_N, k)
        self.places = tuple(chosen[f] for f in sorted(chosen))
        self.forces = tuple(sorted(chosen))
        self.reading = self._reading()
        self._last: list[tuple[dict[str, float], Array]] = []

    def read(self, frame: Array) -> float:
        """Return the area in a frame (rows, cols) of the model camera [mm^2]."""
        return area_in(frame, self.scene, self.reading)

    @property
    def told(self) -> str:
        """What a reader has to know of the threshold; empty where it is the usual one."""
        if self.reading is None:
            return ""
        usual = AreaReading().threshold
        return (
            f"areas are read at a grey level of {self.reading.threshold:.3g} of 1, half-way from ground to contact:"
            f" {usual:g} of a full pixel's stands not clear of them"
        )

    def _reading(self) -> AreaReading | None:
        """Return the reading of the largest contact that was measured; None for the usual one."""
        if not self.places:
            return None
        return reading_of(np.asarray(self.model.observation.images[self.places[-1]], float), self.scene)

    def areas(self, point: Mapping[str, float]) -> Array:
        """Return the predicted areas at a point [mm^2], one for each force; the last few are kept."""
        kept = next((one for one in self._last if one[0] == point), None)
        if kept is None:
            kept = dict(point), np.array([self.read(self.model.coarse.image(point, k)) for k in self.places])
        self._last = [kept, *(one for one in self._last if one is not kept)][:KEPT]
        return kept[1]

    def of_change(self, with_cause: Mapping[str, float], without: Mapping[str, float]) -> Consequence:
        """Return the consequence of a change of the point.

        Raises
        ------
        InputError
            If the rig cannot have either.
        """
        after, before = self.areas(with_cause), self.areas(without)
        change = after - before
        percent = np.where(before > 0, 100.0 * change / np.where(before > 0, before, 1.0), np.nan)
        return Consequence(self.forces, tuple(map(float, change)), tuple(map(float, percent)))

    def of_causes(self, fitted: JointFit, covariance: Array, *causes: str) -> Consequence:
        """Return the consequence of a taken cause, or of several together, with an interval from the covariance.

        The change is known as well as the causes' size is, 1 / t of it, where t is the distance of their parameters
        from nothing in their own posterior; and as well as pixels can tell (:func:`counted_sd`).

        Parameters
        ----------
        fitted : JointFit
        covariance : ndarray (n, n)
            Of the fit's parameters.
        *causes : str
        """
        try:
            found = self.of_change(fitted.point, fitted.without(*causes))
        except InputError:
            return Consequence((), (), ())
        places = fitted.of_cause(*causes)
        away = fitted.departures()[places]
        t = np.sqrt(max(float(away @ np.linalg.solve(covariance[np.ix_(places, places)], away)), 1e-12))
        change = np.array(found.change_mm2)
        half = NINETY * np.hypot(change / t, counted_sd(change, self.scene.camera.scale_px_per_mm**-2.0))
        low, high = (tuple(map(float, end)) for end in (change - half, change + half))
        return replace(found, low_mm2=low, high_mm2=high)
