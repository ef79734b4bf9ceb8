"""Which way round a board is printed, from a picture of it, against boards drawn by the scene's own convention."""

from __future__ import annotations

import numpy as np
import pytest

from evanesce.bundle.card_light import mean_reflectance
from evanesce.measurement.calibration.board_print import print_of, upper_left_black
from evanesce.measurement.calibration.corners import find_corners
from evanesce.render.cards import checkerboard_of
from evanesce.rig import Cards

SCALE = 18.0


def picture(squares: tuple[int, int], inverted: bool, shift_mm: tuple[float, float] = (0.4, -0.3)) -> np.ndarray:
    """A board of 1.5 mm squares, turned by half a degree, with light that falls off to the right."""
    card = checkerboard_of(
        Cards(checkerboard_squares=squares, checkerboard_side_mm=1.5, checkerboard_inverted=inverted)
    )
    u, v = np.meshgrid((np.arange(520) - 259.5) / SCALE, (np.arange(400) - 199.5) / SCALE)
    turn = np.deg2rad(0.5)
    x = np.cos(turn) * (u - shift_mm[0]) + np.sin(turn) * (v - shift_mm[1])
    y = np.cos(turn) * (v - shift_mm[1]) - np.sin(turn) * (u - shift_mm[0])
    light = mean_reflectance(card, x, y) * np.linspace(240.0, 140.0, 520)
    return np.clip(light + np.random.default_rng(1).normal(0.0, 1.5, light.shape), 0, 255).astype(np.uint8)


@pytest.mark.parametrize("inverted", [False, True])
@pytest.mark.parametrize("squares", [(15, 11), (14, 11), (15, 10), (14, 10)])
def test_the_square_at_the_upper_left_is_read(squares: tuple[int, int], inverted: bool) -> None:
    image = picture(squares, inverted)
    view = find_corners(image).view("board", 1.5)
    assert upper_left_black(view, image, 1.5, squares) is inverted
    assert upper_left_black(view, np.repeat(image[..., None], 3, axis=2), 1.5, squares) is inverted


def test_nothing_is_said_of_a_board_of_other_size_or_one_that_is_cut_off() -> None:
    image = picture((15, 11), True)
    view = find_corners(image).view("board", 1.5)
    assert upper_left_black(view, image, 1.5, (16, 11)) is None
    cut = picture((15, 11), True, shift_mm=(-6.0, 0.0))
    assert upper_left_black(find_corners(cut).view("board", 1.5), cut, 1.5, (15, 11)) is None


def test_pictures_that_say_nothing_are_passed_over_and_those_that_contradict_are_not_believed() -> None:
    whole, cut, other = picture((15, 11), True), picture((15, 11), True, (-6.0, 0.0)), picture((15, 11), False)

    def said(*pictures: np.ndarray) -> bool | None:
        return print_of([find_corners(p).view("board", 1.5) for p in pictures], pictures, 1.5, (15, 11))

    assert said(cut, whole, cut) is True
    assert said(whole, other) is None
    assert said(cut) is None
