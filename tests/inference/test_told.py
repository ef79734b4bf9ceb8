"""What is told of causes that stand in for each other, or make up for each other."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from evanesce.inference import named as named_module
from evanesce.inference.answer import first_line, nearest_to_unknown
from evanesce.inference.consequence import Consequence, nearest
from evanesce.inference.gain import HeldOut
from evanesce.inference.named import Named
from evanesce.inference.naming import label_of
from evanesce.inference.page import _causes, _scene, cause_figure
from evanesce.inference.posterior import Posterior
from evanesce.inference.series.critic import SeriesGain
from evanesce.inference.single_effects import UNKNOWN, Place


def moving(percent: float) -> Consequence:
    area = 50.0
    return Consequence((6.0,), (percent / 100 * area,), (percent,), (percent / 100 * area - 1,), (percent / 100 + 1,))


def named(name: str, percent: float, credible: tuple[str, ...] = ()) -> Named:
    own = {"value": 1.0, "lo": 0.9, "hi": 1.1, "unit": "1"}
    return Named(name, 0.5, moving(percent), {"x": own}, 0.7, credible or (name,), abs(percent) < 0.2)


def held_out(before: float, after: float) -> HeldOut:
    return HeldOut((1.0, 0.0, 2.0), (2.0, 1.0), (before, after), 2)


@pytest.mark.parametrize(
    ("credible", "told"),
    [
        (("creep",), "creep"),
        (("modulus", "creep"), "creep or modulus"),
        (("modulus",), "modulus, fitted as creep"),
        (("modulus", "friction"), "modulus or friction, fitted as creep"),
    ],
)
def test_no_cause_is_told_that_its_own_place_denies(credible: tuple[str, ...], told: str) -> None:
    cause = named("creep", 3.0, credible)
    assert cause.told.replace(" (size of the contact)", "") == told
    answered = cause.as_dict()
    assert label_of(answered) == (cause.told if "fitted as" in told else "creep")
    section = _causes({"causes": [answered], "posterior": {}})
    assert section.tables[0].rows[0][0] == label_of(answered)


def test_causes_that_stand_for_each_other_are_told_as_their_group() -> None:
    """Only where all belong to it: what is told by a group must not hide the one that does not."""
    assert named("creep", 3.0, ("modulus", "creep")).told == "creep or modulus (size of the contact)"
    assert named("creep", 3.0, ("creep", "vignetting")).told == "creep or vignetting"


@pytest.mark.parametrize(("after", "worse"), [(1.0, False), (1.19, False), (1.21, True), (np.nan, False)])
def test_an_extension_that_makes_areas_worse_says_so_first(after: float, worse: bool) -> None:
    left: Any = SimpleNamespace(found=False)
    line = first_line("causes", [named("creep", 3.0)], 0.99, left, held_out(1.0, after), "")
    assert line.startswith("CAUTION: the extension makes the held-out area worse (1.00 to 1.21 %)") == worse
    assert SeriesGain((1.0, 0.0, 2.0), (2.0, 1.0), (1.0, after), 2).worse == worse


def fitted(covariance: Any) -> tuple[Any, Any]:
    names = ("black:x", "tone:x", "tone:y", "modulus:x")
    of = {cause: [k for k, n in enumerate(names) if n.startswith(cause)] for cause in ("black", "tone", "modulus")}
    return SimpleNamespace(ids=tuple(of), of_cause=lambda cause: np.array(of[cause], int)), covariance


def test_the_nearest_cause_is_that_of_the_largest_correlation_of_any_parameters() -> None:
    rng = np.random.default_rng(5)
    draws = rng.standard_normal((4000, 4)) * [50.0, 1.0, 0.1, 0.01]
    draws[:, 2] += 0.005 * draws[:, 0]
    draws[:, 3] += 0.005 * draws[:, 1]
    one, covariance = fitted(np.cov(draws.T))
    # Shares of variance by hand: 0.25^2 / (0.25^2 + 0.1^2) = 0.86, and 0.005^2 / (0.005^2 + 0.01^2) = 0.2.
    assert nearest(one, covariance, "black") == "tone"
    assert nearest(one, covariance, "tone") == "black"
    assert nearest(one, covariance, "modulus") == ""
    alike = np.full((4, 4), 4.0)
    assert nearest(one, alike, "black") in ("tone", "modulus")
    assert nearest(SimpleNamespace(ids=("tone",), of_cause=one.of_cause), covariance, "tone") == ""


def paired(found: list[Named], near: dict[str, str], both: float) -> list[Named]:
    return named_module._paired(found, lambda name: near.get(name, ""), lambda *names: moving(both))


def test_causes_that_make_up_for_each_other_are_told_once_and_together() -> None:
    found = [named("tone_curve", -95.0), named("modulus", -10.8), named("black_level", 3.3)]
    told = paired(found, {"tone_curve": "black_level", "black_level": "tone_curve"}, -0.8)
    assert [n.id for n in told] == ["modulus", "black_level", "tone_curve"]
    left: Any = SimpleNamespace(found=False)
    line = first_line("causes", told, 0.99, left, None, "")
    assert line == (
        "3 causes explain 99.0 % of the misfit: modulus (-5.40 mm^2, -10.8 % at 6 N), "
        "black_level and tone_curve, which make up for each other (-0.40 mm^2, -0.8 % at 6 N)"
    )
    answers = [n.as_dict() for n in told]
    assert answers[2]["together"]["with"] == "black_level"
    assert answers[2]["area"]["percent"] == [-95.0]
    axis = cause_figure(answers).axes[0]
    assert [t.get_text() for t in axis.get_yticklabels()] == ["modulus, 6 N", "black_level and tone_curve, 6 N"]
    assert [bar.get_width() for bar in axis.patches] == [-10.8, -0.8]
    rows = _causes({"causes": answers}).tables[0].rows
    assert [(row[0], row[3]) for row in rows] == [
        ("modulus", "-10.80 at 6 N"), ("black_level (with tone_curve)", "-0.80 at 6 N"),
        ("tone_curve (with black_level)", "-0.80 at 6 N"),
    ]  # fmt: skip
    still = paired(found, {"tone_curve": "black_level", "black_level": "tone_curve"}, 0.05)
    assert first_line("causes", still, 0.99, left, None, "").endswith(
        "without effect on the area: black_level and tone_curve, which make up for each other"
    )


@pytest.mark.parametrize(("near", "both"), [({}, -0.8), ({"tone_curve": "black_level"}, -60.0)])
def test_causes_that_data_tell_apart_or_that_add_up_are_told_each(near: dict[str, str], both: float) -> None:
    told = paired([named("tone_curve", -95.0), named("black_level", 3.3)], near, both)
    assert [n.together for n in told] == [None, None]
    assert told[0].as_dict()["together"] is None
    assert replace(told[0], together=None).moved is told[0].consequence


def test_causes_that_move_no_area_are_ordered_by_what_they_add_to_held_out_conditions() -> None:
    """Named ones by the area that they move, whatever their score."""
    scores = {"hot_pixels": 40.0, "vignetting": 900.0, "modulus": 1.0, "creep": 5000.0}
    percents = {"hot_pixels": 0.15, "vignetting": 0.01, "modulus": -8.0, "creep": 2.0}
    found = [replace(named(n, p), held_out=(scores[n], scores[n] - 1, scores[n] + 1)) for n, p in percents.items()]
    assert [n.id for n in paired(found, {}, 0.0)] == ["modulus", "creep", "vignetting", "hot_pixels"]
    answered = paired(found, {}, 0.0)[2].as_dict()
    assert answered["held_out_nats"] == [900.0, 899.0, 901.0]
    assert "+900 (+899 to +901)" in _causes({"causes": [answered], "posterior": {}}).tables[0].rows[0]


def test_what_is_unknown_is_told_with_what_comes_nearest_to_it() -> None:
    """Of the place that it has been given, or else of that of a further cause."""
    further = Place.of({UNKNOWN: 50.0, "creep": 12.0, "friction": 30.0})
    assert nearest_to_unknown(Posterior({}, further, 0.001)) == "friction"
    own = Place.of({UNKNOWN: 50.0, "vignetting": 3.0, "creep": 2.0})
    assert nearest_to_unknown(Posterior({UNKNOWN: own}, further, 0.001)) == "vignetting"
    assert nearest_to_unknown(Posterior({}, Place.of({UNKNOWN: 1.0}), 0.001)) == ""


def test_the_page_shows_few_of_a_list_s_numbers() -> None:
    """Rationale: one speck of dust came with 37 places, and the page with 111 lines of them."""
    before = "[effects]\n"
    after = before + "mark_x_mm = [\n" + "".join(f"    {0.5 * k - 1.0},\n" for k in range(9)) + "]\nmarks = 2.0\n"
    rows = [row[0] for row in _scene(before, after).tables[0].rows]
    assert rows[-7:] == [
        "+mark_x_mm = [",
        "+    -1.0,",
        "+    -0.5,",
        "+    0.0,",
        "+    ... 6 more",
        "+]",
        "+marks = 2.0",
    ]
