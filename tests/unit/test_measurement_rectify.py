"""Rectification: an ideal pinhole view, cut to valid pixels, at the scale it had.

The distortions are unequal in every coefficient, the principal point off centre, and fx differs from fy.
"""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from scipy import ndimage, optimize

from evanesce.core.errors import InputError
from evanesce.measurement.calibration.model import Calibration
from evanesce.measurement.calibration.rectify import (
    distort_normalized,
    distortion_jacobian,
    rectification,
    rectify,
    undistort_points,
)

COLS, ROWS = 331, 247
MATRIX = np.array([[402.3, 0.0, 158.6], [0.0, 397.9, 129.2], [0.0, 0.0, 1.0]])
BARREL = np.array([-0.166, 0.024, 0.0, 0.0, 0.0])
PINCUSHION = np.array([0.21, -0.04, 0.0, 0.0, 0.0])
FULL = np.array([-0.31, 0.17, 0.0021, -0.0034, -0.05])
CASES = pytest.mark.parametrize("distortion", [BARREL, PINCUSHION, FULL], ids=["barrel", "pincushion", "full"])


def calibration(distortion, size=(COLS, ROWS), matrix=MATRIX):
    return Calibration(image_size=size, camera_matrix=matrix, distortion=distortion)


@CASES
def test_distortion_is_opencvs_projection(distortion):
    points = np.random.default_rng(0).uniform(-0.5, 0.5, (50, 2))
    expected, _ = cv2.projectPoints(
        np.column_stack([points, np.ones(50)]), np.zeros(3), np.zeros(3), np.eye(3), distortion
    )
    np.testing.assert_allclose(distort_normalized(points, distortion), expected[:, 0], rtol=0, atol=1e-14)


@CASES
def test_jacobian_is_the_derivative(distortion):
    """Central differences of step 1e-6 are off by step^2 and by roundoff over step, together below 1e-9."""
    for point in np.random.default_rng(1).uniform(-0.4, 0.4, (9, 2)):
        numeric = optimize.approx_fprime(point, lambda q: distort_normalized(q, distortion), 1e-6)
        backward = optimize.approx_fprime(point, lambda q: distort_normalized(q, distortion), -1e-6)
        np.testing.assert_allclose(distortion_jacobian(point, distortion), (numeric + backward) / 2, atol=1e-9)


@CASES
def test_undistorted_points_return_to_where_they_were(distortion):
    points = np.random.default_rng(2).uniform([0, 0], [COLS - 1, ROWS - 1], (40, 2))
    ideal = undistort_points(points, MATRIX, distortion)
    rays = np.column_stack([(ideal - MATRIX[:2, 2]) / [MATRIX[0, 0], MATRIX[1, 1]], np.ones(40)])
    back, _ = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), MATRIX, distortion)
    np.testing.assert_allclose(back[:, 0], points, rtol=0, atol=1e-6)
    assert np.abs(ideal - points).max() > 1  # the distortion is not idle


@CASES
def test_view_is_valid_and_cannot_grow(distortion):
    """Every pixel of the view has its four neighbours in the frame; one row or column more on any side has not.

    Checked by OpenCV's own map for the new camera matrix.
    """
    found = rectification(calibration(distortion))
    rows, cols = found.shape
    moved = found.camera_matrix_new.copy()
    moved[:2, 2] += 1
    map_x, map_y = cv2.initUndistortRectifyMap(MATRIX, distortion, None, moved, (cols + 2, rows + 2), cv2.CV_32FC1)
    tolerance = 1e-4  # single precision of coordinates up to 331
    np.testing.assert_allclose(found.map_x, map_x[1:-1, 1:-1], atol=tolerance)
    np.testing.assert_allclose(found.map_y, map_y[1:-1, 1:-1], atol=tolerance)
    assert map_x[1:-1, 1:-1].min() >= -tolerance
    assert map_y[1:-1, 1:-1].min() >= -tolerance
    assert map_x[1:-1, 1:-1].max() <= COLS - 1 + tolerance
    assert map_y[1:-1, 1:-1].max() <= ROWS - 1 + tolerance
    if distortion is not PINCUSHION:  # there the innermost point of an edge is a corner that the view itself cuts off
        assert map_x[1:-1, 0].min() < 0
        assert map_x[1:-1, -1].max() > COLS - 1
        assert map_y[0, 1:-1].min() < 0
        assert map_y[-1, 1:-1].max() > ROWS - 1


@CASES
def test_focal_length_stays_and_the_principal_point_moves_with_the_origin(distortion):
    found = rectification(calibration(distortion))
    assert found.camera_matrix_new[0, 0] == MATRIX[0, 0]
    assert found.camera_matrix_new[1, 1] == MATRIX[1, 1]
    np.testing.assert_allclose(MATRIX[:2, 2] - found.camera_matrix_new[:2, 2], found.origin, atol=1e-12)
    # a frame's point carried by hand arrives where the map says
    ideal = undistort_points(np.array([101.3, 57.8]), MATRIX, distortion) - found.origin
    at = [[ideal[1]], [ideal[0]]]
    assert ndimage.map_coordinates(found.map_x, at, order=1)[0] == pytest.approx(101.3, abs=2e-3)
    assert ndimage.map_coordinates(found.map_y, at, order=1)[0] == pytest.approx(57.8, abs=2e-3)


def test_without_distortion_nothing_changes():
    """Origin (0, 0), full size, and every grey level as it was."""
    found = rectification(calibration(np.zeros(5)))
    assert (found.origin, found.shape) == ((0, 0), (ROWS, COLS))
    image = np.random.default_rng(3).integers(0, 256, (ROWS, COLS, 3), dtype=np.uint8)
    np.testing.assert_array_equal(rectify(image, found), image)


def test_barrel_distortion_widens_the_view_beyond_the_frame():
    """Edges of a barrel image bow inwards when straightened and still lie outside the frame: a negative origin."""
    found = rectification(calibration(BARREL))
    assert found.origin[0] < 0
    assert found.origin[1] < 0
    assert found.shape[0] > ROWS
    assert found.shape[1] > COLS


@CASES
def test_interpolation_is_bilinear(distortion):
    """Against SciPy's in double precision: half a level of rounding, a little for single precision."""
    image = ndimage.gaussian_filter(np.random.default_rng(4).uniform(0, 255, (ROWS, COLS)), 1.2).astype(np.uint8)
    found = rectification(calibration(distortion))
    expected = ndimage.map_coordinates(image.astype(float), [found.map_y, found.map_x], order=1, mode="nearest")
    assert np.abs(rectify(image, found) - expected).max() <= 0.5 + 1e-3


@CASES
def test_a_distorted_grid_becomes_straight_at_its_own_scale(distortion):
    """Dots of a square grid, drawn distorted: their centroids in the view lie on the ideal grid.

    A dot of 4 px radius is bent by the distortion's curvature only, so its centroid moves by some hundredths of a
    pixel; 0.1 px is allowed, where the distortion itself moves dots by pixels.
    """
    ideal = np.stack(np.meshgrid(np.arange(20, COLS - 20, 37.0), np.arange(20, ROWS - 20, 37.0)), -1).reshape(-1, 2)
    rays = (ideal - MATRIX[:2, 2]) / [MATRIX[0, 0], MATRIX[1, 1]]
    y, x = np.mgrid[:ROWS, :COLS].astype(float)
    drawn = np.zeros((ROWS, COLS))
    for px, py in distort_normalized(rays, distortion) * [MATRIX[0, 0], MATRIX[1, 1]] + MATRIX[:2, 2]:
        drawn += 250 * np.exp(-((x - px) ** 2 + (y - py) ** 2) / (2 * 2.0**2))
    found = rectification(calibration(distortion))
    view = rectify(np.clip(np.rint(drawn), 0, 255).astype(np.uint8), found).astype(float)
    rows, cols = found.shape
    moved = 0.0
    for px, py in ideal - found.origin:
        r, c = round(py), round(px)
        if not (9 <= r < rows - 9 and 9 <= c < cols - 9):
            continue
        patch = view[r - 8 : r + 9, c - 8 : c + 9]
        i, j = np.mgrid[-8:9, -8:9]
        assert (patch * i).sum() / patch.sum() + r == pytest.approx(py, abs=0.1)
        assert (patch * j).sum() / patch.sum() + c == pytest.approx(px, abs=0.1)
        moved = max(moved, abs(found.map_x[r, c] - px - found.origin[0]))
    assert moved > 1


def test_a_model_that_folds_over_is_refused():
    with pytest.raises(InputError, match="folds over"):
        rectification(calibration(np.array([-2.5, 0.0, 0.0, 0.0, 0.0])))


def test_a_frame_of_another_size_is_refused():
    with pytest.raises(InputError, match="331 x 247"):
        rectify(np.zeros((ROWS, COLS - 1), np.uint8), rectification(calibration(BARREL)))
