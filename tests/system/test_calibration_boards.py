"""Boards of other sizes in other resolutions, by a strongly distorting lens: the corner search finds what is there."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import KDTree

from evanesce.measurement.calibration.corners import find_corners
from support.lab_boards import Board, Look, draw, lens_of, pose_of

pytestmark = pytest.mark.system

LOOKS = {
    "white paper": Look(),
    "black paper": Look(surround=30.0),
    "glare": Look(surround=30.0, glare=150.0, glare_at=(0.35, 0.4)),
    "finger": Look(surround=110.0, finger=True, noise=4.0),
    "blur and coarse JPEG": Look(blur=2.5, jpeg=60),
}


def check(size: tuple[int, int], squares: tuple[int, int], look: Look) -> None:
    rng = np.random.default_rng([squares[0], size[0]])
    lens, board = lens_of(rng, size, k1=-0.25, k2=0.03), Board(*squares, 2.0)
    pose = pose_of(rng, lens, board)
    grid = find_corners(draw(lens, board, pose, look, rng))
    true = lens.project(pose.place(board.corners()))
    off = KDTree(true).query(grid.fit.position)[0]
    pitch = np.sqrt(np.abs(np.linalg.det(grid.lattice)))
    assert (off < 0.25 * pitch).all(), "a corner where the board has none"
    assert np.median(off) < 0.15
    if look.finger or look.glare:
        assert len(true) > len(grid) > 0.75 * len(true) if look.finger else len(grid) > 0.75 * len(true)
    else:
        assert len(grid) == len(true)
        lines = sorted(np.ptp(grid.index, axis=0) + 1)
        assert lines == sorted(n - 1 for n in squares)


@pytest.mark.parametrize("look", LOOKS.values(), ids=LOOKS)
@pytest.mark.parametrize("squares", [(7, 5), (17, 13)])
def test_small_pictures(squares: tuple[int, int], look: Look) -> None:
    check((480, 360), squares, look)


@pytest.mark.slow  # pictures of up to 3 Mpx drawn pixel by pixel: 2 min
@pytest.mark.parametrize("look", LOOKS.values(), ids=LOOKS)
@pytest.mark.parametrize("squares", [(7, 5), (17, 13), (42, 31)])
@pytest.mark.parametrize("size", [(640, 480), (1280, 960), (2000, 1500)])
def test_all_resolutions(size: tuple[int, int], squares: tuple[int, int], look: Look) -> None:
    check(size, squares, look)
