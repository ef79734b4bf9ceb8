"""The corner finder against boards whose corners are known, and against the rig's own photograph."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial import KDTree

from evanesce.core.errors import WorkError
from evanesce.measurement.calibration.corners import CornerGrid, find_corners
from evanesce.measurement.calibration.points import read_points
from evanesce.measurement.calibration.saddle import fit_saddles
from support.boards import corners_inside, draw, warp


def matched(grid: CornerGrid, index: NDArray[np.int64], place: NDArray[np.float64]) -> NDArray[np.float64]:
    """Distance of each true corner's nearest found one; the two indices must agree by ONE lattice symmetry."""
    distance, near = KDTree(grid.fit.position).query(place)
    found = distance < 3.0
    assert len(set(near[found])) == found.sum(), "two true corners share one found corner"
    ones = np.ones((found.sum(), 1))
    symmetry, *_ = np.linalg.lstsq(np.hstack([index[found], ones]), grid.index[near[found]].astype(float), rcond=None)
    rounded = np.rint(symmetry)
    assert abs(round(np.linalg.det(rounded[:2]))) == 1
    assert (np.abs(rounded[:2]).sum(axis=0) == 1).all(), "not a symmetry of the square lattice"
    np.testing.assert_array_equal(np.hstack([index[found], ones]) @ rounded, grid.index[near[found]])
    return np.where(found, distance, np.inf)


def standard_error(noise: float, contrast: float, sigma: float, half_window: float) -> float:
    """Cramer-Rao bound of one coordinate for a blurred corner: the sum of (dI/dx)^2 over the window, in closed form.

    dI/dx = 2 a/(sqrt(2 pi) sigma) exp(-x^2/2 sigma^2) along 2 w pixels of edge -> sum 4 w a^2/(sqrt(pi) sigma).
    """
    return noise / np.sqrt(4 * half_window * contrast**2 / (np.sqrt(np.pi) * sigma))


@pytest.mark.parametrize(
    ("shape", "pitch", "rotation", "barrel", "keystone", "blur"),
    [
        ((300, 420), 23.0, 20.0, 0.12, 0.15, 1.2),
        ((260, 340), 10.5, -8.0, 0.08, -0.1, 0.7),
        ((520, 640), 58.4, 38.0, 0.0, 0.1, 2.5),
        ((310, 400), 26.0, 161.0, 0.2, 0.0, 1.6),
    ],
    ids=["turned 20", "fine", "coarse 38", "upside down, barrel"],
)
def test_all_corners_with_the_right_index(
    shape: tuple[int, int], pitch: float, rotation: float, barrel: float, keystone: float, blur: float
) -> None:
    rng = np.random.default_rng(5)
    mapping = warp(shape, pitch, rotation, barrel=barrel, keystone=keystone)
    grid = find_corners(draw(shape, mapping, rng, blur=blur, noise=1.5))
    index, place = corners_inside(shape, mapping, margin=0.2 * pitch)
    distance = matched(grid, index, place)
    assert np.isfinite(distance).all(), f"{np.isinf(distance).sum()} of {len(index)} corners not found"
    inner = matched(grid, *corners_inside(shape, mapping, margin=0.45 * pitch))
    sampling = np.hypot(blur, np.sqrt(1 / 12))  # pixel box
    bound = standard_error(np.hypot(1.5, np.sqrt(1 / 12)), 45.0, sampling, min(0.42 * pitch, 16.0))
    # Median of a Rayleigh law is 1.18 standard errors; the fit's other ten parameters and its robust weights cost
    # less than a factor 2; curvature of the edges and the finite supersampling (1/4 px, 1/sqrt(12 * edge pixels) of
    # it) add at most 0.015 px.
    assert np.median(inner) < 2 * 1.18 * bound + 0.015
    # orientation: the first axis runs along the picture's x, the second along y
    step = grid.lattice.mean(axis=0)
    assert step[0, 0] > abs(step[1, 0])
    assert step[1, 1] > abs(step[0, 1])
    assert tuple(grid.index.min(axis=0)) == (0, 0)


def test_partial_board_ends_where_the_squares_end() -> None:
    shape, board = (330, 410), (-4, 6, -3, 4)
    mapping = warp(shape, 25.0, 20.0, barrel=0.1, keystone=0.1)
    grid = find_corners(draw(shape, mapping, np.random.default_rng(8), board=board))
    index, place = corners_inside(shape, mapping, margin=5.0, board=board)
    assert len(index) == 9 * 6
    assert np.isfinite(matched(grid, index, place)).all()
    assert len(grid) == len(index), "corners found on the white paper"


@pytest.mark.parametrize("surround", [200.0, 110.0, 30.0], ids=["white", "grey", "black"])
@pytest.mark.parametrize(
    ("turn", "shift"),
    [
        ((0.119, -0.182, -0.239), (-0.37, 0.92, 44.2)),
        ((-0.219, -0.237, 0.034), (2.13, 1.96, 43.1)),
        ((0.05, 0.21, 0.12), (-1.9, -0.6, 46.0)),
        ((-0.16, -0.02, -0.21), (0.8, -1.4, 41.5)),
    ],
)
def test_outer_corners_of_border_squares_are_no_corners(
    turn: tuple[float, float, float], shift: tuple[float, float, float], surround: float
) -> None:
    # 17 x 13 squares of 2 mm have 16 x 12 corners; drawn here by itself: pinhole, supersampled, blurred, compressed.
    side, focal, shape, fine = 2.0, 550.0, (480, 640), 4
    rotation = cv2.Rodrigues(np.array(turn))[0]
    plane = np.column_stack([rotation[:, 0], rotation[:, 1], np.array(shift)])
    v, u = (np.indices((shape[0] * fine, shape[1] * fine)) + 0.5) / fine - 0.5
    ray = np.stack([(u - shape[1] / 2) / focal, (v - shape[0] / 2) / focal, np.ones_like(u)])
    point = np.tensordot(np.linalg.inv(plane), ray, 1)
    x, y = point[0] / point[2] + 17.0, point[1] / point[2] + 13.0
    dark = (np.floor(x / side) + np.floor(y / side)) % 2 == 0
    board = (x > 0) & (x < 34) & (y > 0) & (y < 26)
    light = np.where(board, np.where(dark, 30.0, 200.0), surround)
    light = light.reshape(shape[0], fine, shape[1], fine).mean(axis=(1, 3))
    noisy = cv2.GaussianBlur(light, (0, 0), 0.8) + np.random.default_rng(3).normal(0, 2, shape)
    _, packed = cv2.imencode(".jpg", np.clip(noisy, 0, 255).astype(np.uint8), [cv2.IMWRITE_JPEG_QUALITY, 90])
    found = find_corners(cv2.imdecode(packed, cv2.IMREAD_GRAYSCALE)).fit.position
    j, i = np.indices((12, 16)) + 1
    q = plane @ np.stack([i.ravel() * side - 17.0, j.ravel() * side - 13.0, np.ones(192)])
    true = np.stack([focal * q[0] / q[2] + shape[1] / 2, focal * q[1] / q[2] + shape[0] / 2], axis=1)
    assert len(found) == 192
    assert KDTree(true).query(found)[0].max() < 0.3


def test_specks_blur_and_uneven_light() -> None:
    """400 single-pixel specks, blur from 1 to 4 px: the specks must not pull, the blur must not stop the growth."""
    shape = (420, 560)
    mapping = warp(shape, 24.0, 7.0, barrel=0.15)
    rng = np.random.default_rng(11)
    grid = find_corners(draw(shape, mapping, rng, blur=1.0, corner_blur=4.0, specks=400, noise=2.0))
    index, place = corners_inside(shape, mapping, margin=8.0)
    distance = matched(grid, index, place)
    assert np.isfinite(distance).mean() > 0.99
    found = distance[np.isfinite(distance)]
    bound = standard_error(2.0, 45.0, 4.0, 0.42 * 24.0)  # of the most blurred
    assert np.median(found) < 2 * 1.18 * bound + 0.015
    # a speck next to a corner weighs its ~100 edge pixels' worth of signal if it is not weighted down: 0.1 px and more
    assert np.sqrt((found**2).mean()) < 4 * bound + 0.05


def test_saddle_fit_returns_blur_and_contrast() -> None:
    shape, pitch = (200, 230), 30.0
    mapping = warp(shape, pitch, 12.0)
    picture = draw(shape, mapping, np.random.default_rng(2), blur=1.8, noise=1.0).astype(float)
    index, place = corners_inside(shape, mapping, margin=14.0)
    lattice = np.tile(np.linalg.inv(mapping.matrix[:2, :2]), (len(index), 1, 1))
    fit = fit_saddles(picture, place + 1.5, lattice)
    light = 1 + 0.25 * (place[:, 0] / shape[1] - 0.5) + 0.3 * (place[:, 1] / shape[0] - 0.4) ** 2
    sign = np.where(index.sum(axis=1) % 2 == 0, 1.0, -1.0)
    # s.e. of a level over ~600 pixels is 0.05 DN; curvature of the light over the window (0.3 * 75 * 0.06^2) adds 0.1
    np.testing.assert_allclose(fit.contrast, sign * 55.0 * light, atol=0.6)
    np.testing.assert_allclose(fit.level, 75.0 * light, atol=0.6)
    # blur of 1.8 px, the 1-px box and the shear of 2 %
    np.testing.assert_allclose(np.median(fit.sigma, axis=0), np.sqrt(1.8**2 + 1 / 12), rtol=0.03)
    assert fit.explained.min() > 0.99


def test_a_colour_picture_gives_the_grey_ones_corners() -> None:
    shape = (160, 200)
    picture = draw(shape, warp(shape, 22.0, 5.0), np.random.default_rng(3))
    plain = find_corners(picture)
    colour = find_corners(np.repeat(picture[..., None], 3, axis=2))
    np.testing.assert_array_equal(plain.index, colour.index)
    np.testing.assert_allclose(plain.fit.position, colour.fit.position, atol=1e-3)


@pytest.mark.parametrize("kind", ["flat", "noise", "stripes", "dots", "tiny"])
def test_no_board_is_an_error_in_words(kind: str) -> None:
    rng = np.random.default_rng(4)
    y, x = np.mgrid[0:180, 0:220]
    pictures = {
        "flat": np.full((180, 220), 127.0),
        "noise": rng.normal(100, 20, (180, 220)),
        "stripes": 60 + 100.0 * ((x + y) // 13 % 2),
        "dots": 30 + 150.0 * (np.hypot(x % 24 - 12, y % 24 - 12) < 6),
        "tiny": np.eye(5),
    }
    with pytest.raises(WorkError, match="no checkerboard found"):
        find_corners(np.clip(pictures[kind], 0, 255).astype(np.uint8))


def test_the_real_photograph(rig_photo: Path) -> None:
    """Demanded: 1,000 of 1,139 corners, median under 0.3 px, RMS under 0.6 px, from the image alone."""
    picture = cv2.imread(str(rig_photo / "checkerboard_1mm.png"))[..., ::-1]
    grid = find_corners(picture)
    given = read_points(rig_photo / "corners.csv")[0]
    distance = matched(grid, given.world.astype(np.int64), given.image)
    found = distance[np.isfinite(distance)]
    assert len(found) >= 1000
    assert np.median(found) < 0.3
    nearest, _ = KDTree(grid.fit.position).query(given.image)
    assert np.sqrt((nearest[nearest < 10.0] ** 2).mean()) < 0.6, "also with the corners beyond 3 px counted"


def test_the_real_photograph_has_its_origin_where_the_reference_put_it(rig_photo: Path) -> None:
    """Joined on world coordinates as they stand, without aligning anything, the corners are the thesis's."""
    picture = cv2.imread(str(rig_photo / "checkerboard_1mm.png"))[..., ::-1]
    view = find_corners(picture).view("photo", 1.0)
    given = read_points(rig_photo / "corners.csv")[0]
    places = {tuple(w): p for w, p in zip(given.world.tolist(), given.image, strict=True)}
    distance = [np.hypot(*(p - places[tuple(w)])) for w, p in zip(view.world.tolist(), view.image, strict=True)
                if tuple(w) in places]  # fmt: skip
    assert len(distance) >= 1000
    assert np.median(distance) < 0.3
    assert np.sqrt(np.mean(np.square(distance))) < 0.6
