"""Other laws that an effect of the library may follow: what a cause looks like is not what one formula says.

A file in this package with ``LAWS``, a mapping of an effect's id to its laws, adds them; an effect without any is drawn
from its own parameters alone. A law is a change of the prediction made from the prediction (:class:`Seen`), or of the
scene, so that it costs little and shares nothing with the effect's own code. Each names its
source, or that it is assumed. How strong a drawn form is does not matter: a cause has its strength apart from its form.
"""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.prediction.views import View
from evanesce.rig import Scene

Array = NDArray[Any]


@dataclass(frozen=True)
class Seen:
    """The nominal prediction, for laws that change it.

    Attributes
    ----------
    scene : Scene
    views : tuple of View
    cube : ndarray (views, rows, cols)
        Bins [DN].
    by_light : ndarray (views, rows, cols)
        Change per relative change of the light on the sensor [DN].
    by_signal : ndarray (views, rows, cols)
        Change per raw DN added before the tone curve [DN/DN].
    x, y : ndarray (rows, cols)
        Place on the sensor from its middle, in half widths of the frame.
    """

    scene: Scene
    views: tuple[View, ...]
    cube: Array
    by_light: Array
    by_signal: Array
    x: Array
    y: Array

    @property
    def radius(self) -> Array:
        """Distance from the middle (rows, cols), in half widths of the frame."""
        return np.hypot(self.x, self.y)

    def per_view(self, of: Callable[[View], float]) -> Array:
        """Return a figure of each view (views, 1, 1)."""
        return np.array([of(v) for v in self.views])[:, None, None]

    def under_leds(self, factor: Array) -> Array:
        """Return the change by a relative change (broadcast to views, rows, cols) of the LEDs' light [DN]."""
        lit = self.per_view(lambda v: float(v.voltage_V > 0 and not v.is_card))
        return np.asarray(self.by_light * lit * factor)


Change = Callable[[Seen, np.random.Generator], Array]
"""Returns a change of the bins (views, rows, cols) [DN]."""
Rig = Callable[[Scene, np.random.Generator], Scene]
"""Returns a changed rig."""


@dataclass(frozen=True)
class Law:
    """One form that a cause may have.

    Attributes
    ----------
    name : str
    source : str
    change : callable, optional
        See :data:`Change`.
    rig : callable, optional
        See :data:`Rig`.
    """

    name: str
    source: str
    change: Change | None = None
    rig: Rig | None = None


@cache
def all_laws() -> Mapping[str, tuple[Law, ...]]:
    """Return the laws of all files of this package by effect."""
    found: dict[str, tuple[Law, ...]] = {}
    for entry in pkgutil.iter_modules(__path__):
        module = importlib.import_module(f"{__name__}.{entry.name}")
        for effect, laws in module.LAWS.items():
            found[effect] = (*found.get(effect, ()), *laws)
    return found
