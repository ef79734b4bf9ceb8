"""Undistort to the "valid" view: no undefined pixel, focal length kept, so nothing is rescaled.

This is the thesis's step, MATLAB's ``undistortImage(I, params, "OutputView", "valid")``: the ideal image is cut to
whole pixels at the innermost point of each of its four curved edges, the principal point moves with the cut, and the
focal length stays [1]_. Two things are done otherwise. MATLAB traces the edges on a pixel mask; here they are carried
through the inverse distortion, so a cut may differ by a pixel. And a pixel counts as defined if bilinear interpolation
needs no sample outside the frame, so the outermost half pixel of the frame is not used. Where the frame bows the other
way (pincushion) the innermost point of an edge is a corner, and the rectangle is a little below the largest possible.

.. [1] MathWorks, undistortImage, documentation of R2021a; the camera matrix of each view is stated in
   MATLAB Answers 2009332.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from evanesce.core.errors import InputError
from evanesce.measurement.calibration.model import Calibration

Floats = NDArray[np.float64]

NEWTON_STEPS = 50
RESIDUAL_PX = 1e-6


@dataclass(frozen=True, kw_only=True)
class Rectification:
    """The map from a rectified view back into the distorted frame; made once, used for every frame.

    Attributes
    ----------
    map_x, map_y : ndarray of float32 (rows, cols)
        Column and row in the distorted frame of each rectified pixel [px].
    camera_matrix_new : ndarray (3, 3)
        Camera matrix of the rectified view: the principal point moved by the origin, the rest unchanged.
    origin : tuple of int
        (x, y) of the rectified view's first pixel in the ideal (distortion-free) frame of the original camera matrix.
    shape : tuple of int
        (rows, cols) of the rectified view.
    source_shape : tuple of int
        (rows, cols) of the distorted frame.
    """

    map_x: NDArray[np.float32]
    map_y: NDArray[np.float32]
    camera_matrix_new: Floats
    origin: tuple[int, int]
    shape: tuple[int, int]
    source_shape: tuple[int, int]


def distort_normalized(points: Floats, distortion: Floats) -> Floats:
    """Carry ideal normalized image points to distorted ones.

    Parameters
    ----------
    points : ndarray (..., 2)
        (x/z, y/z) [1].
    distortion : ndarray (5,)
        k1, k2, p1, p2, k3 in OpenCV's order.

    Returns
    -------
    ndarray (..., 2)

    References
    ----------
    D. C. Brown, Decentering distortion of lenses, Photogrammetric Engineering 32(3), 444-462, 1966.
    """
    k1, k2, p1, p2, k3 = distortion
    x, y = points[..., 0], points[..., 1]
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    return np.stack(
        [x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x), y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y],
        axis=-1,
    )


def distortion_jacobian(points: Floats, distortion: Floats) -> Floats:
    """Return the derivative of :func:`distort_normalized` by its points, shape (..., 2, 2); it is symmetric.

    Parameters
    ----------
    points : ndarray (..., 2)
        Ideal (x/z, y/z) [1].
    distortion : ndarray (5,)
        k1, k2, p1, p2, k3.

    Returns
    -------
    ndarray (..., 2, 2)
    """
    k1, k2, p1, p2, k3 = distortion
    x, y = points[..., 0], points[..., 1]
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    slope = k1 + r2 * (2 * k2 + r2 * 3 * k3)  # of radial by r2
    across = 2 * x * y * slope + 2 * p1 * x + 2 * p2 * y
    jacobian = np.empty((*x.shape, 2, 2))
    jacobian[..., 0, 0] = radial + 2 * x * x * slope + 2 * p1 * y + 6 * p2 * x
    jacobian[..., 1, 1] = radial + 2 * y * y * slope + 6 * p1 * y + 2 * p2 * x
    jacobian[..., 0, 1] = jacobian[..., 1, 0] = across
    return jacobian


def undistort_points(points: Floats, camera_matrix: Floats, distortion: Floats) -> Floats:
    """Carry distorted pixel coordinates into the ideal frame of the same camera matrix.

    Subtract a rectification's ``origin`` to arrive in the rectified view.

    Parameters
    ----------
    points : ndarray (..., 2)
        (x, y) [px].
    camera_matrix : ndarray (3, 3)
    distortion : ndarray (5,)

    Returns
    -------
    ndarray (..., 2)
        (x, y) [px].

    Raises
    ------
    InputError
        If the model folds over before it reaches a point: no ideal point is carried there.
    """
    inverse = np.linalg.inv(camera_matrix)
    target = np.asarray(points, dtype=np.float64) @ inverse[:2, :2].T + inverse[:2, 2]
    found = target.copy()
    for _ in range(NEWTON_STEPS):
        jacobian = distortion_jacobian(found, distortion)
        if np.any(np.linalg.det(jacobian) <= 0):
            break
        step = np.linalg.solve(jacobian, (target - distort_normalized(found, distortion))[..., None])[..., 0]
        found = found + step
        if not np.all(np.isfinite(found)) or np.abs(step).max(initial=0) < 1e-15:
            break
    residual = np.abs(distort_normalized(found, distortion) - target).max(initial=0) * max(camera_matrix[0, 0], 1)
    folded = not np.all(np.linalg.det(distortion_jacobian(found, distortion)) > 0) if np.isfinite(residual) else True
    if folded or residual > RESIDUAL_PX:
        raise InputError(
            f"the distortion {np.array2string(np.asarray(distortion), precision=4)} folds over within the frame",
            key="distortion",
            allowed="coefficients under which distinct points of the frame stay distinct",
        )
    return np.asarray(found @ camera_matrix[:2, :2].T + camera_matrix[:2, 2])


def _valid_bounds(size: tuple[int, int], camera_matrix: Floats, distortion: Floats) -> tuple[int, int, int, int]:
    """Return (x0, x1, y0, y1), inclusive whole pixels of the ideal frame, innermost to all four edges of the frame."""
    cols, rows = size
    across, down = np.arange(cols, dtype=np.float64), np.arange(rows, dtype=np.float64)

    def ideal(x: Floats, y: Floats) -> Floats:
        return undistort_points(np.stack(np.broadcast_arrays(x, y), axis=-1), camera_matrix, distortion)

    # a whole number that the inverse meets but for rounding must not be cut off
    slack = RESIDUAL_PX
    x0 = int(np.ceil(ideal(np.zeros(1), down)[:, 0].max() - slack))
    x1 = int(np.floor(ideal(np.full(1, cols - 1.0), down)[:, 0].min() + slack))
    y0 = int(np.ceil(ideal(across, np.zeros(1))[:, 1].max() - slack))
    y1 = int(np.floor(ideal(across, np.full(1, rows - 1.0))[:, 1].min() + slack))
    return x0, x1, y0, y1


def rectification(calibration: Calibration) -> Rectification:
    """Return the map to the "valid" view of a calibration.

    All coefficients of the calibration are used; the thesis's model has two radial ones, the others zero.

    Parameters
    ----------
    calibration : Calibration

    Returns
    -------
    Rectification

    Raises
    ------
    InputError
        If the distortion folds over within the frame or leaves no valid rectangle.
    """
    size, matrix, distortion = calibration.image_size, calibration.camera_matrix, calibration.distortion
    x0, x1, y0, y1 = _valid_bounds(size, matrix, distortion)
    if x1 <= x0 or y1 <= y0:
        raise InputError(f"the distortion {distortion.tolist()} leaves no valid rectangle", key="distortion")
    new = matrix.copy()
    new[0, 2] -= x0
    new[1, 2] -= y0
    rows, cols = y1 - y0 + 1, x1 - x0 + 1
    ideal = np.stack(np.meshgrid(np.arange(cols, dtype=np.float64), np.arange(rows, dtype=np.float64)), axis=-1)
    inverse = np.linalg.inv(new)
    distorted = distort_normalized(ideal @ inverse[:2, :2].T + inverse[:2, 2], distortion)
    source = distorted @ matrix[:2, :2].T + matrix[:2, 2]
    # rounding may carry a border pixel outwards by less than RESIDUAL_PX
    limit = np.array(size, dtype=np.float64) - 1
    beyond = max(float((-source).max()), float((source - limit).max()))
    if beyond > 2 * RESIDUAL_PX:
        raise InputError(f"the valid view reaches {beyond:.3f} px beyond the frame", key="distortion")
    source = np.clip(source, 0, limit)
    return Rectification(
        map_x=source[..., 0].astype(np.float32),
        map_y=source[..., 1].astype(np.float32),
        camera_matrix_new=new,
        origin=(x0, y0),
        shape=(rows, cols),
        source_shape=(size[1], size[0]),
    )


def rectify(image: NDArray[np.uint8], rectified: Rectification) -> NDArray[np.uint8]:
    """Resample a frame into the rectified view, bilinear, rounded to whole grey levels.

    Parameters
    ----------
    image : ndarray of uint8, (rows, cols) or (rows, cols, 3)
        Distorted frame [DN].
    rectified : Rectification

    Returns
    -------
    ndarray of uint8 (rows, cols) or (rows, cols, 3)

    Raises
    ------
    InputError
        If the frame has another size than the calibration.
    """
    if image.shape[:2] != rectified.source_shape:
        rows, cols = rectified.source_shape
        raise InputError(
            f"the frame is {image.shape[1]} x {image.shape[0]} pixels, the calibration holds for {cols} x {rows}",
            key="--calibration",
            allowed="frames of the size that was calibrated",
        )
    return np.asarray(
        cv2.remap(image, rectified.map_x, rectified.map_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE),
        dtype=np.uint8,
    )
