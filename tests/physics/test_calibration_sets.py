"""Calibration of made-up cameras from drawn boards, all through: what is stated as a standard error has to be one.

Each set: another camera, another board, eight views, paper around it white, grey or black; three views in ten with
glare, three in ten with a finger over a corner of the board; blur, noise and JPEG.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial import KDTree

from evanesce.measurement.calibration.corners import find_corners
from evanesce.measurement.calibration.fit import calibrate
from evanesce.measurement.calibration.outliers import without_outliers
from evanesce.measurement.calibration.pinhole import PinholeFit, fit_pinhole
from evanesce.measurement.calibration.points import BoardView
from support.lab_boards import Board, Lens, draw, lens_of, look_of, pose_of, view_look

Array = NDArray[np.float64]
VIEWS = 8  # of the fifty sets


def pulls(fit: object, lens: Lens) -> Array:
    """Estimate minus truth in standard errors: fx, fy, cx, cy, k1, k2."""
    assert isinstance(fit, PinholeFit)
    m, k, e = fit.camera_matrix, fit.distortion, fit.standard_errors
    found = np.array([m[0, 0], m[1, 1], m[0, 2], m[1, 2], k[0], k[1]])
    true = np.array([lens.fx, lens.fy, lens.cx, lens.cy, lens.k1, lens.k2])
    return np.asarray((found - true) / [e[name] for name in ("fx", "fy", "cx", "cy", "k1", "k2")])


def drawn_set(number: int, size: tuple[int, int], count: int = VIEWS) -> Array:
    rng = np.random.default_rng([77, number])
    lens, look = lens_of(rng, size), look_of(rng)
    board = Board(int(rng.integers(9, 20)), int(rng.integers(7, 14)), 2.0)
    views = []
    for k in range(count):
        pose, seen = pose_of(rng, lens, board), view_look(look, rng)
        grid = find_corners(draw(lens, board, pose, seen, rng))
        true = lens.project(pose.place(board.corners()))
        off = KDTree(true).query(grid.fit.position)[0]
        if not (seen.finger or seen.glare):
            assert len(grid) == len(true), "a clean view shows every corner and no other"
            assert off.max() < 0.3
        # half a square at the most: what a finger's edge draws beside a corner, never a corner of the board's border
        assert off.max() < 0.5 * np.sqrt(np.abs(np.linalg.det(grid.lattice))).min()
        assert np.mean(off < 0.3) > 0.9
        views.append(grid.view(str(k), board.side))
    return pulls(calibrate(views, size).fit, lens)


@pytest.mark.slow  # 5 s: five sets of photographs
def test_five_sets_within_three_standard_errors() -> None:
    found = np.abs([drawn_set(k, (400, 300), 6) for k in range(5)])
    assert found.max() < 3.0


@pytest.mark.slow  # draws and searches 400 pictures: 2 min
def test_fifty_sets_within_three_standard_errors() -> None:
    with ThreadPoolExecutor(2) as pool:
        found = np.abs(list(pool.map(lambda k: drawn_set(k, (640, 480)), range(50))))
    within = {k: float((found < k).mean()) for k in (1, 2, 3)}
    print(f"within 1, 2, 3 standard errors: {within}")
    assert within[3] == 1.0
    assert within[2] > 0.954  # of a Gaussian law; stated errors are the greater of two and may be larger
    assert within[1] > 0.683


LENS = Lens((640, 480), 700.0, 701.0, 330.0, 231.0, -0.2, 0.05)
BOARD = Board(13, 10, 2.5)


def seen_views(rng: np.random.Generator, together_px: float, alone_px: float) -> list[BoardView]:
    """Eight views whose corners err alone, and together: a smooth field of its own in each view."""
    views = []
    world = BOARD.corners()
    u, v = (2 * world / np.ptp(world, axis=0)).T
    smooth = np.stack([u * u, u * v, v * v, u**3, u * u * v, u * v * v, v**3], axis=-1)
    for k in range(VIEWS):
        place = LENS.project(pose_of(rng, LENS, BOARD).place(world))
        field = smooth @ rng.normal(0, 1, (smooth.shape[1], 2))
        field *= together_px / np.sqrt((field**2).mean())
        views.append(BoardView(str(k), world, place + field + rng.normal(0, alone_px, place.shape)))
    return views


def test_errors_hold_where_corners_of_a_view_err_together() -> None:
    rng = np.random.default_rng(31)
    sets = 60
    found = np.array([pulls(fit_pinhole(seen_views(rng, 0.05, 0.02), LENS.size), LENS) for _ in range(sets)])
    # Least squares' own errors, blind to the views, are too small by sqrt(corners/parameters of the field) or so: 5.
    # fx and fy, k1 and k2 move together, so that the share of 6 x 60 pulls has the scatter of about 4 x 60.
    share = np.mean(np.abs(found) < 2)
    assert share > 0.954 - 3 * np.sqrt(0.954 * 0.046 / (4 * sets))
    assert np.abs(found).max() < 5  # beyond 5 times 1.21 lies 5e-4 of Student's law of 7 degrees of freedom


def test_errors_hold_where_corners_err_alone() -> None:
    rng = np.random.default_rng(32)
    sets = 60
    found = np.array([pulls(fit_pinhole(seen_views(rng, 0.0, 0.05), LENS.size), LENS) for _ in range(sets)])
    assert np.mean(np.abs(found) < 2) > 0.954 - 3 * np.sqrt(0.954 * 0.046 / (4 * sets))
    # the greater of two estimates is larger than either, but not by much: pulls keep a scatter of order one
    assert 0.55 < np.sqrt((found**2).mean()) < 1.1


def test_a_handful_of_wrong_corners_does_not_move_the_fit() -> None:
    rng = np.random.default_rng(33)
    views = seen_views(rng, 0.0, 0.03)
    wrong = [(0, 3), (0, 50), (2, 17), (5, 80), (5, 81), (5, 82), (7, 0)]
    damaged = [BoardView(v.name, v.world, v.image.copy()) for v in views]
    for view, corner in wrong:
        damaged[view].image[corner] += rng.uniform(1, 4) * np.array([np.cos(corner), np.sin(corner)])
    plain = fit_pinhole(damaged, LENS.size)
    assert abs(plain.distortion[1] - LENS.k2) > 3 * fit_pinhole(views, LENS.size).standard_errors["k2"], "they do pull"
    fit, kept = without_outliers(damaged, lambda some: fit_pinhole(some, LENS.size))
    for view, corner in wrong:
        assert not kept[view][corner]
    assert sum(int((~one).sum()) for one in kept) == len(wrong), "no good corner is lost"
    assert np.abs(pulls(fit, LENS)).max() < 3.0


def test_a_view_that_does_not_fit_is_not_thinned_out() -> None:
    views = seen_views(np.random.default_rng(34), 0.0, 0.03)
    bad = views[3].image.copy()
    bad[::3] += np.random.default_rng(1).normal(0, 3, bad[::3].shape)
    views[3] = BoardView("3", views[3].world, bad)
    _, kept = without_outliers(views, lambda some: fit_pinhole(some, LENS.size))
    assert kept[3].all()
    codes = {w.code: w.text for w in calibrate(views, LENS.size).warnings}
    assert "3 (" in codes["view_rms_high"]
