"""Undistortion without calibration error, for studies of the errors that remain."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from evanesce.core.states import ContactState
from evanesce.evaluation.labels import FrameLabels, RectifiedView, label, view_geometry
from evanesce.measurement.calibration.model import Calibration
from evanesce.measurement.calibration.rectify import Rectification, rectification, rectify
from evanesce.measurement.reference.segment import Crop
from evanesce.optics.projection import Projection
from evanesce.optics.seen import seen_at
from evanesce.rig import Scene


def true_calibration(scene: Scene) -> Calibration:
    """Return the lens of a scene as a calibration without error and without scale.

    Parameters
    ----------
    scene : Scene

    Returns
    -------
    Calibration
    """
    projection = Projection.of(scene.camera, scene.plate)
    x, y = projection.principal_point
    matrix = np.array([[projection.focal_px, 0.0, x], [0.0, projection.focal_px, y], [0.0, 0.0, 1.0]])
    rows, cols = projection.shape
    return Calibration(image_size=(cols, rows), camera_matrix=matrix, distortion=np.array(projection.distortion))


@dataclass(frozen=True)
class PerfectView:
    """Frames of one camera, undistorted without error.

    Attributes
    ----------
    scene : Scene
        As its LEDs' light sees it (:func:`~evanesce.optics.seen.seen_at`).
    rectified : Rectification
    view : RectifiedView
        The same for the truth.
    """

    scene: Scene
    rectified: Rectification
    view: RectifiedView

    @classmethod
    def of(cls, scene: Scene) -> PerfectView:
        """Return the view of a scene's camera; make it once for all its frames.

        Parameters
        ----------
        scene : Scene

        Returns
        -------
        PerfectView
        """
        calibration = true_calibration(scene)
        rectified = rectification(calibration)
        view = RectifiedView(
            camera_matrix=calibration.camera_matrix,
            distortion=calibration.distortion,
            camera_matrix_new=rectified.camera_matrix_new,
            shape=rectified.shape,
        )
        return cls(seen_at(scene), rectified, view)

    @cached_property
    def projection(self) -> Projection:
        """True geometry of the camera."""
        return Projection.of(self.scene.camera, self.scene.plate)

    def straight(self, frame: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Return a frame undistorted [DN].

        Parameters
        ----------
        frame : ndarray of uint8 (rows, cols) or (rows, cols, 3)
            [DN].

        Returns
        -------
        ndarray of uint8
        """
        return rectify(frame, self.rectified)

    def to_view(self, x: float, y: float) -> tuple[float, float]:
        """Return (row, col) of the view that sees a plate point [mm].

        Parameters
        ----------
        x, y : float
            On the plate [mm].

        Returns
        -------
        row, col : float
            [px].
        """
        u, v = self.projection.plate_to_ray(np.array(x), np.array(y))
        matrix = self.view.camera_matrix_new
        return float(v * matrix[1, 1] + matrix[1, 2]), float(u * matrix[0, 0] + matrix[0, 2])

    @cached_property
    def mm2_per_px(self) -> float:
        """True area of the pixel that sees the finger's tip [mm^2]."""
        row, col = self.to_view(*self.scene.finger.position_mm)
        u, v = np.array([col - 0.5, col + 0.5, col]), np.array([row, row, row])
        x, y = self.projection.to_plate(*self.view.to_frame(u, v))
        across = np.hypot(x[1] - x[0], y[1] - y[0])
        x, y = self.projection.to_plate(*self.view.to_frame(v * 0 + col, np.array([row - 0.5, row + 0.5, row])))
        return float(across * np.hypot(x[1] - x[0], y[1] - y[0]))

    def window(self, half_mm: float) -> Crop:
        """Return the square crop about the finger's tip that reaches ``half_mm`` to each side, within the view.

        Parameters
        ----------
        half_mm : float
            Half the side [mm].

        Returns
        -------
        Crop
        """
        row, col = self.to_view(*self.scene.finger.position_mm)
        reach = half_mm / self.mm2_per_px**0.5
        rows, cols = self.view.shape
        return Crop(max(0, int(row - reach)), min(rows, int(row + reach) + 1),
                    max(0, int(col - reach)), min(cols, int(col + reach) + 1))  # fmt: skip

    def labels(self, state: ContactState, crop: Crop) -> FrameLabels:
        """Return the truth in a crop of the view.

        Parameters
        ----------
        state : ContactState
        crop : Crop
            Of the view.

        Returns
        -------
        FrameLabels
        """
        rows, cols = self.view.shape
        r1, c1 = rows if crop.r1 is None else crop.r1, cols if crop.c1 is None else crop.c1
        view = RectifiedView(
            camera_matrix=self.view.camera_matrix,
            distortion=self.view.distortion,
            camera_matrix_new=self.view.camera_matrix_new,
            shape=(r1 - crop.r0, c1 - crop.c0),
            origin=(crop.r0, crop.c0),
        )
        return label(state, view_geometry(self.projection, view))
