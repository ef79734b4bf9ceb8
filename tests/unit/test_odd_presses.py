"""Presses that contradict each other are named, whatever the model; those that do not are left alone."""

from __future__ import annotations

from dataclasses import replace

import pytest

from evanesce.inference.odd_presses import odd_presses
from evanesce.inference.patch import Patch
from evanesce.prediction.views import View

FORCES = (0.3, 0.6, 1.0, 1.6, 2.4, 3.3, 4.5, 6.0)


def pressed(forces=FORCES, areas=None, x=None, session=0):
    """A ball of Hertz's law that moves by 0.03 mm/N, as a load off the axis makes it."""
    areas = [20.0 * force ** (2 / 3) for force in forces] if areas is None else areas
    x = [0.4 + 0.03 * force for force in forces] if x is None else x
    views = [
        View(kind="press", force_N=force, voltage_V=9.0, session=session, condition=100 * session + k)
        for k, force in enumerate(forces)
    ]
    return views, [Patch(area, 1.0, (at, -0.1), 90.0) for area, at in zip(areas, x, strict=True)]


def test_presses_that_agree_say_nothing():
    assert odd_presses(*pressed()) == []


def test_forces_that_were_exchanged_are_named():
    views, patches = pressed()
    patches[2], patches[5] = patches[5], patches[2]
    (said,) = odd_presses(views, patches)
    assert "3.3 N" in said
    assert "1 N" in said
    assert "own force" in said


def test_silicone_that_is_let_go_keeps_more_than_it_had():
    """The same forces up and down; the way down has a tenth more area, and a tenth of a second press less."""
    up, down = pressed(), pressed(areas=[22.0 * force ** (2 / 3) for force in FORCES])
    down = [replace(view, condition=50 + view.condition) for view in down[0]], down[1]
    assert odd_presses([*up[0], *down[0]], [*up[1], *down[1]]) == []


def test_mirrored_frames_are_named():
    views, patches = pressed()
    for k in (0, 2, 4):
        patches[k] = Patch(patches[k].area_mm2, 1.0, (-patches[k].centre_mm[0] - 1.5, -0.1), 90.0)
    (said,) = odd_presses(views, patches)
    assert "mirrored" in said


def test_a_finger_that_slides_under_one_force_contradicts_nothing():
    views, patches = pressed(forces=(2.0,) * 6, x=[3.0 * k for k in range(6)])
    assert odd_presses([replace(view, condition=1) for view in views], patches) == []


@pytest.mark.parametrize("away", [0.0, 5.0])
def test_a_finger_set_anew_is_another_session(away):
    first, second = pressed(), pressed(x=[away + 0.4] * len(FORCES), session=1)
    assert odd_presses([*first[0], *second[0]], [*first[1], *second[1]]) == []


def test_one_press_contradicts_nothing():
    views, patches = pressed(forces=(1.0,))
    assert odd_presses(views, patches) == []
