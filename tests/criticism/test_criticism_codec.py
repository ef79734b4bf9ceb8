"""What a codec hands from view to view is counted once, and bright marks are not taken for it."""

from __future__ import annotations

import numpy as np
import pytest

from evanesce.criticism.codec import shared


@pytest.mark.parametrize("common", [0.0, 0.3, 0.8])
def test_correlation_between_views_is_that_which_was_put_in(common: float) -> None:
    """Fields sqrt(c) common + sqrt(1 - c) own correlate by c; clipping at two deviations takes some per cent of it."""
    rng = np.random.default_rng(5)
    whole, shape = rng.standard_normal((61, 83)), (5, 61, 83)
    fields = np.sqrt(common) * whole + np.sqrt(1 - common) * rng.standard_normal(shape)
    fields *= np.array([0.3, 1.0, 1.7, 2.9, 11.0])[:, None, None]
    # 10 pairs of some 5000 bins know a correlation to 0.005.
    assert shared(list(fields)) == pytest.approx(common, abs=0.05)


def test_bright_marks_in_every_view_are_no_codecs_work() -> None:
    rng = np.random.default_rng(6)
    fields = rng.standard_normal((4, 60, 80))
    rows, cols = rng.integers(0, 60, 40), rng.integers(0, 80, 40)
    fields[:, rows, cols] += 50.0
    assert shared(list(fields)) < 0.06
    assert np.corrcoef(fields[0].ravel(), fields[1].ravel())[0, 1] > 0.9


def test_fields_that_know_different_places_are_compared_where_both_do() -> None:
    rng = np.random.default_rng(7)
    whole = rng.standard_normal((60, 80))
    one, other = whole.copy(), whole.copy()
    one[:, :30], other[:, 50:] = np.nan, np.nan
    assert shared([one, other]) == pytest.approx(1.0, abs=0.01)
    other[:, 25:] = np.nan
    assert shared([one, other]) == 0.0
