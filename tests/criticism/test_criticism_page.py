"""The critic's page says the verdict in words, shows residuals, and never hides that something is missing."""

from __future__ import annotations

import html

import numpy as np
import pytest

from evanesce.criticism.battery import Outcome
from evanesce.criticism.evidence import Evidence, Ranked, Shown
from evanesce.criticism.report_page import page, residual_figure, verdict_words

RESULT = {
    "global_p": 0.001,
    "verdict": "ambiguous",
    "probabilities": {"none": 0.01, "black_level": 0.6, "ambient_light": 0.37, "unknown": 0.02},
    "effects": [
        {"id": "black_level", "parameters": {"offset_DN": {"value": 1.31, "lo": 1.02, "hi": 1.63, "unit": "DN"}}}
    ],
    "ambiguous_with": ["ambient_light"],
    "absorbed": [{"id": "modulus", "by": "contact scale"}],
    "next_measurement": {"what": "a lens-cap frame", "separates": ["black_level", "ambient_light"]},
    "unknown": None,
    "gain": {"log_score": [41.2, 30.1, 55.8], "rmse_dn": [1.31, 0.42], "area_error_pct": [3.1, 0.7]},
    "extended_scene": "extended.toml",
    "false_alarm_control": False,
}


def shown() -> Shown:
    rng = np.random.default_rng(3)
    return Shown("3.1 N, 9.4 V", rng.uniform(0, 90, (30, 41)), rng.normal(2, 1, (30, 41)), rng.normal(size=(30, 41)))


def test_page_tells_all_that_the_result_holds() -> None:
    evidence = Evidence(
        [shown()], [Outcome("lens_cap: cosine power", 91.2, 0.001, 3e-12)],
        [Ranked(("black_level",), 41.0, 5.5, 0.6), Ranked(("vignetting",), 3.0, 2.5, 0.0, "gain within its error")],
        'title = "a"\n', 'title = "a"\n[effects.black_level]\noffset_DN = 1.31\n', ["No locked voltage."],
    )  # fmt: skip
    text = page(RESULT, evidence, "bundle-7", {"seed": 5}).render()
    for words in (
        "tell it from ambient_light", "not controlled", "1.02 to 1.63", "modulus would not be seen: contact scale",
        "a lens-cap frame", "+30.1 to +55.8", "+[effects.black_level]", "gain within its error", "No locked voltage.",
    ):  # fmt: skip
        assert words in text, words


def test_causes_without_a_fit_are_told_by_their_probabilities() -> None:
    """The section stood empty where nothing rang."""
    unknown = {f"effect_{k}": 1e-4 / (1 + k) for k in range(9)}
    quiet = RESULT | {"verdict": "none", "effects": [], "ambiguous_with": [], "probabilities": {"none": 0.74} | unknown}
    text = page(quiet, Evidence(), "b", {}).render()
    for words in ("No cause was fitted", "0.74", "effect_2"):
        assert words in text
    assert "effect_8" not in text
    assert "No cause was fitted" not in page(RESULT, Evidence(ranking=[Ranked(("a",), 1, 1, 1)]), "b", {}).render()


@pytest.mark.parametrize("verdict", ["none", "named", "ambiguous", "unknown"])
def test_every_verdict_has_words_with_its_probability(verdict: str) -> None:
    words = verdict_words(RESULT | {"verdict": verdict})
    assert "0.001" in words
    assert ("black_level" in words) == (verdict in ("named", "ambiguous"))


def cause(name: str) -> dict[str, object]:
    return {"id": name, "parameters": {}}


@pytest.mark.parametrize(
    ("verdict", "accepted", "others", "words"),
    [
        ("named", ["a"], [], "one cause explains it: a."),
        ("named", ["a", "b"], [], "these causes explain it together: a and b."),
        ("ambiguous", ["a"], ["b", "c"], "a would explain it, but these data cannot tell it from b or c."),
        ("ambiguous", ["a", "b"], ["c"], "a and b would explain it, but these data cannot tell them from c."),
        ("ambiguous", [], ["a"], "a may explain it, but not well enough to be named."),
        ("ambiguous", [], ["a", "b"], "one of these may explain it, none well enough to be named: a or b."),
    ],
)
def test_causes_that_act_together_are_not_taken_for_alternatives(
    verdict: str, accepted: list[str], others: list[str], words: str
) -> None:
    found = RESULT | {"verdict": verdict, "effects": [cause(n) for n in accepted], "ambiguous_with": others}
    assert words in verdict_words(found)


def test_the_page_says_which_noise_was_drawn() -> None:
    frames = Evidence(score_p=0.2, battery_p=0.3)
    replicates, camera, points = "differences of replicate frames", "the believed camera's noise", "(chi-square)"
    for result, evidence, words in (
        (RESULT | {"false_alarm_control": True}, frames, replicates),
        (RESULT, frames, camera),
        (RESULT, Evidence(), points),
    ):
        text = html.unescape(page(result, evidence, "b", {}).render())
        assert [noise for noise in (replicates, camera, points) if noise in text] == [words]


def test_the_batterys_own_probability_is_told_and_whether_it_counts() -> None:
    """The global probability is not the battery's: of 999 draws none is below 0.001."""
    outcomes = [Outcome("lens_cap: cosine power", 91.2, 0.001, 3e-12)]
    plain = page(RESULT, Evidence(outcomes=outcomes, score_p=0.0007, battery_p=0.41), "b", {}).render()
    assert "0.0007" in plain
    assert "any of these 1 tests with 0.41" in plain
    assert "do not count" not in plain
    coded = Evidence(outcomes=outcomes, score_p=0.0007, battery_p=0.41, listened=False)
    assert "do not count" in page(RESULT, coded, "b", {}).render()


@pytest.mark.parametrize(
    ("verdict", "words"),
    [("none", "no shot is asked for"), ("unknown", "No cause of the library"), ("named", "draws the same")],
)
def test_without_advice_the_page_claims_no_more_than_the_verdict(verdict: str, words: str) -> None:
    text = page(RESULT | {"verdict": verdict, "next_measurement": None}, Evidence(), "b", {}).render()
    assert words in text


def test_page_without_frames_or_gain_says_so() -> None:
    bare = RESULT | {"gain": {}, "unknown": {"where": "corners", "scaling": {"words": "grows with force"}}}
    text = page(bare, Evidence(), "series only", {}).render()
    assert "no frames" in text
    assert "no gain can be claimed" in text
    assert "grows with force" in text


def test_figure_has_a_row_for_data_before_and_after() -> None:
    figure = residual_figure([shown(), shown()])
    assert len([a for a in figure.axes if a.images]) == 6
