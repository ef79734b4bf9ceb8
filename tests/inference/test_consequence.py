"""Changes of area that are counted in pixels, against discs whose area is known."""

from __future__ import annotations

import numpy as np
import pytest

from evanesce.inference.consequence import NINETY, counted_sd


@pytest.mark.parametrize("grown_px", [0.005, 0.02, 0.1, 0.5])
def test_counted_changes_scatter_about_true_ones_as_they_say(grown_px: float) -> None:
    """Discs anywhere on the pixels, of any size, that grow by a fraction of a pixel."""
    rng = np.random.default_rng(2)
    y, x = np.mgrid[:80, :80]
    away = []
    for _ in range(300):
        (row, col), radius = rng.uniform(38.0, 42.0, 2), rng.uniform(15.0, 25.0)
        distance = np.hypot(y - row, x - col)
        counted = float((distance < radius + grown_px).sum() - (distance < radius).sum())
        true = np.pi * ((radius + grown_px) ** 2 - radius**2)
        # Pixels of 0.01 mm^2.
        away.append((true - counted) * 0.01 / counted_sd(np.array(counted * 0.01), 0.01))
    assert np.mean(np.abs(away) < NINETY) > 0.88
    assert 0.4 < np.std(away) < 1.2
