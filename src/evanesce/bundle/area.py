"""Contact area of a bundle's frame by the reference segmentation, on a view rectified by the nominal camera.

One pure function, so that areas of a lab and of the simulation are read alike.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from evanesce.measurement.reference.segment import Chain, segment
from evanesce.optics.projection import Projection
from evanesce.rig import Scene

THRESHOLD = 0.15
"""A grey level that an eye may pick from the histogram; the thesis prints none."""

# The segmentation's lengths on the thesis's frames of 58.37 px/mm, in millimetres: coarser frames are treated alike.
DILATION_MM = 10 / 58.37
MIN_BLOB_MM2 = 2000 / 3407


@dataclass(frozen=True, kw_only=True)
class AreaReading:
    """Settings by which an area is read.

    Attributes
    ----------
    threshold : float
        Grey level, 0 to 1.
    blur_px : float
        Standard deviation of the Gaussian [px].
    min_blob_mm2 : float
        Minimum size of a dilated blob [mm^2].
    """

    threshold: float = THRESHOLD
    blur_px: float = 1.0
    min_blob_mm2: float = MIN_BLOB_MM2


def contact_area(frame: NDArray[np.uint8], scene: Scene, reading: AreaReading | None = None) -> float:
    """Measure the contact area of a frame by the reference segmentation.

    Parameters
    ----------
    frame : ndarray of uint8 (rows, cols)
        As the scene's camera sees it [DN].
    scene : Scene
        Nominal; its camera and plate rectify the frame onto the contact plane.
    reading : AreaReading, optional

    Returns
    -------
    float
        [mm^2].
    """
    reading = reading or AreaReading()
    scale = scene.camera.scale_px_per_mm
    projection = Projection.of(scene.camera, scene.plate)
    view = cv2.remap(frame, *_plate_maps(_Key(projection), scale), cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)
    chain = Chain(
        threshold=reading.threshold,
        min_blob=round(reading.min_blob_mm2 * scale**2),
        blur=reading.blur_px,
        radius=max(1, round(DILATION_MM * scale)),
    )
    return segment(np.asarray(view, np.uint8), chain).pixels / scale**2


class _Key:
    """A projection that hashes by its values, arrays included."""

    def __init__(self, projection: Projection) -> None:
        self.projection = projection
        self._value = (
            projection.shape, projection.focal_px, projection.principal_point, projection.distortion,
            projection.axes.tobytes(), projection.pinhole.tobytes(), projection.thickness, projection.refractive_index,
        )  # fmt: skip

    def __hash__(self) -> int:
        return hash(self._value)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Key) and self._value == other._value


@functools.lru_cache(maxsize=4)
def _plate_maps(key: _Key, scale: float) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return maps from a frame onto a square grid of the contact plane, at the axis's scale."""
    rows, cols = key.projection.shape
    edge_u = np.concatenate([np.arange(cols), np.arange(cols), np.zeros(rows), np.full(rows, cols - 1)])
    edge_v = np.concatenate([np.zeros(cols), np.full(cols, rows - 1), np.arange(rows), np.arange(rows)])
    x, y = key.projection.to_plate(edge_u, edge_v)
    xs = np.arange(np.ceil(x.min() * scale), np.floor(x.max() * scale) + 1) / scale
    ys = np.arange(np.ceil(y.min() * scale), np.floor(y.max() * scale) + 1) / scale
    u, v = key.projection.to_image(*np.meshgrid(xs, ys))
    return u.astype(np.float32), v.astype(np.float32)
