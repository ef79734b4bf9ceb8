"""Estimator and budget as parts of the page: the verdict follows from the rows, not from hope."""

from __future__ import annotations

import pytest

from evanesce.validation import budget_part, estimator_part
from evanesce.validation.estimator_study import EstimatorStudy, Row


def row(finger: str, place: str, voltage: float, refined: float, author: float) -> Row:
    """Return a frame of 12.5 mm^2 that both measure with errors in percent."""
    return Row(
        finger=finger, place=place, force_N=1.3, voltage_V=voltage, true_mm2=12.5, author_mm2=12.5 * (1 + author / 100),
        refined_mm2=12.5 * (1 + refined / 100), saturated_share=0.0,
    )  # fmt: skip


def test_estimators_verdict_names_the_worst_frames_and_counts_kept_goals() -> None:
    rows = [
        row("smooth", "centre", 8.0, 0.3, 3.0), row("smooth", "centre", 12.0, -0.45, 8.0),
        row("smooth", "corner", 8.0, 0.7, 4.0), row("ridged with glow", "corner", 9.0, -1.9, 141.0),
    ]  # fmt: skip
    found = estimator_part.findings(EstimatorStudy(rows=rows, threshold=0.15, provenance={}))
    assert "at most 1.90 % (ridged with glow, corner)" in found.verdict[0]
    assert "up to 141 % (ridged with glow, corner)" in found.verdict[0]
    assert "2 of 3 classes" in found.verdict[1]
    assert len(found.tables[0].rows) == 3
    assert [panel.title for panel in found.charts[0].panels] == ["centre", "corner"]


def coverage(finger: str, refined: float) -> dict[str, object]:
    """Return a class of 1000 measurements."""
    return {
        "finger": finger, "place": "centre", "measurements": 1000, "frames": 9, "refined_covered": refined,
        "refined_linear_covered": refined, "author_covered": 0.88, "refined_half_width_percent": 0.9,
        "author_half_width_percent": 4.0, "refined_bias_percent": 0.1, "author_bias_percent": 3.0,
        "contributions_percent": {"print": 0.2, "noise": 0.01},
    }  # fmt: skip


@pytest.mark.parametrize(("shares", "kept"), [((0.95, 0.93), 2), ((0.929, 0.96), 1), ((0.99, 0.5), 0)])
def test_budgets_verdict_counts_classes_inside_the_wanted_share(shares: tuple[float, float], kept: int) -> None:
    found = budget_part.findings([coverage("smooth", shares[0]), coverage("ridged", shares[1])])
    assert f"{kept} of 2 classes lie within 93 to 97 %" in found.verdict[0]
    assert [line[0] for line in found.tables[1].rows] == ["print", "noise"]
