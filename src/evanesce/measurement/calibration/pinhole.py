"""Full camera calibration from several tilted boards, by OpenCV's bundle adjustment."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from evanesce.core.errors import WorkError
from evanesce.measurement.calibration.errors import shared_errors
from evanesce.measurement.calibration.planar import COEFFICIENTS, MODELS, BoardFit
from evanesce.measurement.calibration.points import BoardView

Array = NDArray[np.float64]

_FLAGS = {
    "radial2": cv2.CALIB_ZERO_TANGENT_DIST | cv2.CALIB_FIX_K3,
    "radial3": cv2.CALIB_ZERO_TANGENT_DIST,
    "full": 0,
}


@dataclass(frozen=True)
class PinholeFit(BoardFit):
    """A fit whose focal lengths were found, with the boards' poses.

    Attributes
    ----------
    normals : ndarray (views, 3)
        Unit normal of each board in camera coordinates.
    distances : ndarray (views,)
        From the pinhole to the middle of each board's corners [mm].
    """

    normals: Array
    distances: Array

    @property
    def tilt_spread_deg(self) -> float:
        """Greatest angle between two board normals [deg], which determines the focal length."""
        cosines = np.clip(np.abs(self.normals @ self.normals.T), 0.0, 1.0)
        return float(np.rad2deg(np.arccos(cosines.min())))

    @property
    def focal_error(self) -> float:
        """Relative standard error of the focal length [1], the worse of both axes."""
        return max(self.standard_errors[f] / self.camera_matrix[i, i] for i, f in enumerate(("fx", "fy")))


def fit_pinhole(views: Sequence[BoardView], image_size: tuple[int, int], model: str = "radial2") -> PinholeFit:
    """Find focal lengths, principal point, distortion and poses.

    Parameters
    ----------
    views : sequence of BoardView
        At least two, tilted against one another.
    image_size : tuple of int
        (cols, rows).
    model : str
        A key of ``planar.MODELS``.

    Returns
    -------
    PinholeFit

    Raises
    ------
    WorkError
        If OpenCV's solver does not converge to finite values.

    References
    ----------
    Zhang, "A flexible new technique for camera calibration", IEEE PAMI 22 (2000) 1330.
    """
    world = [np.column_stack([v.world, np.zeros(len(v))]).astype(np.float32)[:, None, :] for v in views]
    image = [v.image.astype(np.float32)[:, None, :] for v in views]
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 200, 1e-12)
    try:
        _, matrix, k, rvecs, tvecs = cv2.calibrateCamera(
            world, image, image_size, None, None, flags=_FLAGS[model], criteria=criteria
        )
    except cv2.error as error:
        raise WorkError(f"camera calibration failed: {str(error).splitlines()[0]}") from None
    k = np.ravel(k)[:5]
    if not (np.isfinite(matrix).all() and np.isfinite(k).all() and matrix[0, 0] > 0):
        raise WorkError("camera calibration did not converge to finite values")
    rotations = np.array([cv2.Rodrigues(r)[0] for r in rvecs])
    shifts = np.array([np.ravel(t) for t in tvecs])
    homographies = matrix @ np.stack([rotations[:, :, 0], rotations[:, :, 1], shifts], axis=-1)
    middles = np.array([np.append(v.world.mean(axis=0), 0.0) for v in views])
    centres = np.einsum("kab,kb->ka", rotations, middles) + shifts
    names = ("fx", "fy", "cx", "cy", *COEFFICIENTS)
    free = [i for i, name in enumerate(names) if name in {"fx", "fy", "cx", "cy", *MODELS[model]}]
    shared, own, residuals = [], [], []
    for view, r, t in zip(views, rvecs, tvecs, strict=True):
        flat = np.column_stack([view.world, np.zeros(len(view))])
        predicted, slopes = cv2.projectPoints(flat, r, t, matrix, k)
        own.append(slopes[:, :6])
        shared.append(slopes[:, 6:15][:, free])
        residuals.append((view.image - predicted[:, 0]).ravel())
    errors = shared_errors(shared, own, residuals)
    return PinholeFit(
        camera_matrix=np.asarray(matrix, dtype=np.float64),
        distortion=np.asarray(k, dtype=np.float64),
        homographies=homographies,
        standard_errors={names[i]: float(e) for i, e in zip(free, errors, strict=True)},
        normals=rotations[:, :, 2],
        distances=np.linalg.norm(centres, axis=1),
    )
