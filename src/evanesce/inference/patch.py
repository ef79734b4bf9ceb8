"""Contacts read from frames, in millimetres on the plate, without any model of the light."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from evanesce.optics.projection import Projection
from evanesce.rig import Scene

Array = NDArray[Any]

HALF = 0.5
"""Share of a contact's own light above which a pixel counts to it: no absolute level, so that light makes no area."""
LEAST_CONTRAST_DN = 5.0
"""Of a contact over the plate: some standard deviations of a smoothed pixel's noise, so that noise is no contact."""


@dataclass(frozen=True)
class Patch:
    """The contact of one frame.

    Attributes
    ----------
    area_mm2 : float
    axes : float
        Ratio of the axes of the ellipse of equal second moments, at least 1.
    centre_mm : tuple of float
        On the plate (x, y) [mm].
    level_DN : float
        Median within.
    """

    area_mm2: float
    axes: float
    centre_mm: tuple[float, float]
    level_DN: float


class PlateReader:
    """Reads contacts from frames, in millimetres on the plate."""

    def __init__(self, scene: Scene) -> None:
        projection = Projection.of(scene.camera, scene.plate)
        cols, rows = scene.camera.resolution_px
        u, v = np.meshgrid(np.arange(cols, dtype=float), np.arange(rows, dtype=float))
        self.x, self.y = projection.to_plate(u, v)
        across = np.gradient(self.x, axis=1) * np.gradient(self.y, axis=0)
        self.pixel_mm2 = np.abs(across - np.gradient(self.x, axis=0) * np.gradient(self.y, axis=1))

    def patch(self, image: Array) -> Patch | None:
        """Return the largest bright patch above half its own light; None where there is none."""
        smooth = ndimage.gaussian_filter(np.asarray(image, float), 1.0)
        dark, bright = np.median(smooth), np.quantile(smooth, 0.995)
        if bright - dark < LEAST_CONTRAST_DN:
            return None
        labels, count = ndimage.label(smooth > dark + HALF * (bright - dark))
        if not count:
            return None
        sizes = ndimage.sum_labels(self.pixel_mm2, labels, np.arange(1, count + 1))
        inside = labels == 1 + int(np.argmax(sizes))
        weight = self.pixel_mm2[inside]
        x, y = self.x[inside], self.y[inside]
        mx, my = np.average(x, weights=weight), np.average(y, weights=weight)
        moments = np.cov(np.stack([x, y]), aweights=weight)
        small, large = np.maximum(np.linalg.eigvalsh(moments), 1e-9)
        return Patch(float(weight.sum()), float(np.sqrt(large / small)), (float(mx), float(my)), float(bright))
