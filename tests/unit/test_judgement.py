"""A calibrated scene is judged by what its errors come to: areas, and light over the contact's."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from evanesce.inference.calibration.judgement import first_line, judged
from evanesce.inference.calibration.own_error import OwnError
from evanesce.inference.gate import LEVEL, Gate, Line


def fitted(area=0.1, level_DN=0.0, left=0.0, follows="level", worse=False, away=0.0, told=True):
    """What a judgement asks of a fit whose contact has 150 DN."""
    gate = Gate((Line(LEVEL, "DN", 150.0, 140.0, gross=False),), {})
    return SimpleNamespace(
        gain=SimpleNamespace(worse=worse, area_percent=(5.0, area)),
        by_kind={"press": 0.9},
        start=SimpleNamespace(gate=gate),
        own_error={"presses": OwnError(level_DN=level_DN)},
        left=SimpleNamespace(found=left > 0, size=left, follows=follows, sentence=lambda: "something"),
        figures={"backdrop:reflectance": SimpleNamespace(told=told, away=away)},
    )


def test_a_scene_that_leaves_nothing_is_good():
    reasons, remarks = judged(fitted())
    assert reasons == remarks == []
    assert "good enough" in first_line(fitted(), 3, reasons)


@pytest.mark.parametrize(
    ("small", "large"),
    [({"level_DN": 1.5}, {"level_DN": 4.5}), ({"left": 0.013}, {"left": 4.5}),
     ({"left": 0.01, "follows": "light"}, {"left": 0.03, "follows": "light"})],
)  # fmt: skip
def test_light_that_is_left_counts_by_its_share_of_the_contacts(small, large):
    reasons, remarks = judged(fitted(**small))
    assert not reasons
    assert len(remarks) == 1
    reasons, remarks = judged(fitted(**large))
    assert len(reasons) == 1
    assert not remarks
    assert "NOT good enough" in first_line(fitted(**large), 3, reasons)


def test_dark_frames_that_are_off_are_told_and_do_not_decide():
    fit = fitted()
    fit.own_error = {"presses": OwnError(), "dark frames": OwnError(level_DN=6.0)}
    reasons, remarks = judged(fit)
    assert not reasons
    assert "dark frames: 6 DN" in remarks[0]


def test_light_is_told_as_a_share_of_the_contacts():
    (said,) = judged(fitted(level_DN=1.5))[1]
    assert "1.5 DN, 1 % of the contact's" in said


def test_areas_that_are_off_or_worse_are_reasons():
    assert "3 %" in judged(fitted(area=3.0))[0][0]
    assert "keep that one" in judged(fitted(area=6.0, worse=True))[0][0]


def test_what_stands_far_from_nominal_and_is_not_determined_stands_in_for_something():
    (said,) = judged(fitted(away=7.0, told=False))[1]
    assert "in place of what is missing: backdrop.reflectance" in said
    (said,) = judged(fitted(away=7.0))[1]
    assert "7.0 prior standard deviations" in said
