"""The table of reported outcomes: its values recomputed from solved contacts, its intervals, and what moves them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from evanesce.contact.fem.library import library_press
from evanesce.studies.mechanics.runs import SlideCase, solved_press, solved_slide
from evanesce.studies.thesis.outcomes import Outcome, outcomes, tilted_area


@pytest.fixture(scope="module")
def found() -> dict[str, Outcome]:
    return {one.what: one for one in outcomes()}


def test_every_row_has_an_interval_around_its_value_and_both_ends(found: dict[str, Outcome]) -> None:
    assert len(found) == 10
    for one in found.values():
        assert one.low <= one.value <= one.high
        assert one.moved_by
        assert all(np.isfinite(one.moves))


def test_the_drawn_ridges_explain_the_reported_ratio_and_the_moulded_ones_do_not(found: dict[str, Outcome]) -> None:
    ridged = found["ridged over smooth area, 1 N, Silskin 0 %"]
    moulded, drawn = ridged.moves
    assert ridged.agrees
    assert drawn < 0.83 < 0.9 < moulded


def test_values_follow_from_the_solved_contacts(found: dict[str, Outcome]) -> None:
    slide = solved_slide(SlideCase(1.13, "half", "depth", "far")).scalars["normal_force"]
    held = found["normal force at held depth, mu 1.13"]
    assert "with bone to 20 mm, at 1.11 of 1.13" in held.note  # folds of skin slip by turns
    assert found["normal force at held depth, mu 0.67 (thesis: as mu)"].note == ""
    assert held.value == pytest.approx(slide.max() / slide[0] - 1.0)
    assert held.moves[0] < 0 < held.moves[1]  # without a bone the sign is wrong
    stout, short = (solved_press("silskin_0", name, "half").area(1.0) for name in ("stout", "short"))
    wide = found["area of a slide, D 20 L 10 over D 15 L 7.5, less 1"]
    assert wide.note == f"pressed: {stout / short - 1.0:.2g}"
    slides = [solved_slide(SlideCase(0.82, "half", "force", shape=name)) for name in ("stout", "short")]
    ends = [one.scalars["area"][one.scalars["slide"] > 8.0].mean() for one in slides]
    assert wide.value == pytest.approx(ends[0] / ends[1] - 1.0, abs=0.01)
    for one in slides:  # they slip as a whole
        assert one.scalars["tangential_force"][-1] == pytest.approx(0.82 * one.scalars["normal_force"][-1], rel=0.01)
    seconds = found["press to 5 N at 5 mm/min, Silskin 20 %"]
    assert seconds.moves[0] == pytest.approx(12.0 * float(library_press("silskin_20").at(5.0).depth))
    assert seconds.agrees


def test_friction_of_a_tilted_finger_follows_its_area(found: dict[str, Outcome]) -> None:
    tilted = found["static friction at 45 over 0 deg, less 1, Silskin 0 %"]
    assert not tilted.agrees
    # alpha is 0.2324 of 1.13; the rest goes with the area
    assert tilted.moves[0] == pytest.approx((1.13 - 0.2324) / 1.13 * (tilted_area("silskin_0", "none") - 1.0), rel=1e-9)
    # a bone's round end leaves a sphere on a sphere: the meshes' error
    error = (1.13 - 0.2324) / 1.13 * abs(tilted_area("silskin_0", "half") - 1.0)
    assert 0.0 < error < 0.06
    assert tilted.high == pytest.approx(tilted.moves[0] + error)
    assert tilted.counted
    assert not found["static friction at 45 over 0 deg, less 1, Silskin 20 %"].counted
    assert tilted_area("silskin_20", "none") < 0.95 < 1.03 < tilted_area("silskin_0", "none")


def test_the_page_shows_the_values_that_are_computed(found: dict[str, Outcome]) -> None:
    page = (Path(__file__).parents[2] / "docs" / "background" / "mechanics.md").read_text(encoding="utf-8")
    for one in found.values():
        assert f"{float(f'{one.value:.3g}'):g}"[:5] in page, one
        for end in (one.low, one.high):
            assert f"{round(end, 3):g}" in page or f"{float(f'{end:.3g}'):g}" in page, one
