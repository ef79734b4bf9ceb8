"""Comparison of masks against discs whose difference is known in closed form."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from evanesce.evaluation.compare import boundary_displacement, compare
from evanesce.evaluation.labels import FrameLabels

SHAPE = (231, 274)
AT = (118.37, 121.61)
R = 71.3


def radius_from(row: float, col: float) -> np.ndarray:
    v, u = np.indices(SHAPE)
    return np.hypot(v - row, u - col)


def coverage(radius: float = R, at: tuple[float, float] = AT) -> np.ndarray:
    return np.clip(radius - radius_from(*at) + 0.5, 0, 1)


def labels(cover: np.ndarray, pixel_area: float | np.ndarray = 0.0004) -> FrameLabels:
    area = pixel_area * np.ones(SHAPE)
    return FrameLabels(
        mask=cover.astype(np.float32),
        pressure=np.zeros(SHAPE, np.float32),
        gap=np.zeros(SHAPE, np.float32),
        surface_state=None,
        pixel_area=area,
        area=float(np.pi * R**2 * 0.0004),
        normal_force=1.0,
    )


@pytest.mark.parametrize("outwards", [-6.3, -0.4, 0.0, 0.7, 4.9])
def test_a_disc_that_is_larger_all_round(outwards: float) -> None:
    estimate = radius_from(*AT) < R + outwards
    result = compare(estimate, float(estimate.sum()) * 0.0004, labels(coverage()))
    # Boundary points lie midway between pixels: uniform within half a pixel of the circle, 600 points: 0.29/sqrt(600).
    # Polygons through such points cut the true circle's arc by less than 1/(8 R).
    assert result.displacement_px.mean == pytest.approx(outwards, abs=0.06)
    assert result.displacement_mm.mean == pytest.approx(outwards * 0.02, abs=0.06 * 0.02)
    assert result.displacement_px.percentile_5 == pytest.approx(outwards, abs=0.6)
    inner, outer = sorted((R, R + outwards))
    # The half-covered rim of either mask: 450 pixels of 16,000, at random.
    assert result.iou == pytest.approx((inner / outer) ** 2, abs=0.01)
    assert result.error_percent == pytest.approx(100 * ((R + outwards) ** 2 / R**2 - 1), abs=0.5)
    assert result.error_mm2 == pytest.approx(result.area_mm2 - result.true_area_mm2)


def test_a_disc_that_is_shifted() -> None:
    """Displacement s cos(phi): no mean, s/sqrt(2) RMS, 5 % beyond s cos(9 deg)."""
    s = 5.2
    estimate = radius_from(AT[0] + 0.6 * s, AT[1] - 0.8 * s) < R
    result = compare(estimate, 1.0, labels(coverage())).displacement_px
    # Second order of the shift: s^2/(4 R) = 0.09.
    assert result.mean == pytest.approx(0.0, abs=0.15)
    assert result.rms == pytest.approx(s / np.sqrt(2), abs=0.15)
    assert result.percentile_95 == pytest.approx(s * np.cos(0.05 * np.pi), abs=0.3)
    assert result.percentile_5 == pytest.approx(-s * np.cos(0.05 * np.pi), abs=0.3)


def test_millimetres_follow_the_local_scale() -> None:
    estimate = radius_from(*AT) < R + 3.0
    scale = np.where(np.arange(SHAPE[1]) < AT[1], 0.01, 0.03)[None, :]
    _, size = boundary_displacement(estimate, coverage(), scale**2 * np.ones(SHAPE))
    assert set(np.round(size, 6)) == {0.01, 0.03}
    assert (size == size.min()).mean() == pytest.approx(0.5, abs=0.02)


def test_a_stray_blob_shows_in_the_tail_and_in_the_overlap() -> None:
    estimate = (radius_from(*AT) < R) | (radius_from(20.0, 255.0) < 9.0)
    result = compare(estimate, 1.0, labels(coverage()))
    assert abs(result.displacement_px.percentile_50) < 0.3
    assert result.displacement_px.percentile_95 > 50
    assert result.iou < 0.99


def test_hole_and_ring_have_the_right_sign() -> None:
    ring = coverage() - coverage(30.0)
    estimate = (radius_from(*AT) < R + 2) & (radius_from(*AT) > 30.0 - 2)
    displacement, _ = boundary_displacement(estimate, ring, np.ones(SHAPE))
    # Both edges of the estimate lie outside the true ring.
    assert displacement.mean() == pytest.approx(2.0, abs=0.1)


def test_the_views_own_border_is_no_boundary() -> None:
    """A contact cut by the crop: only its real edge counts."""
    at = (118.37, 5.0)
    estimate = radius_from(*at) < R + 2.5
    displacement, _ = boundary_displacement(estimate, coverage(R, at), np.ones(SHAPE))
    assert displacement.mean() == pytest.approx(2.5, abs=0.1)
    assert np.abs(displacement - 2.5).max() < 1.5


def test_empty_masks() -> None:
    nothing = np.zeros(SHAPE, bool)
    missed = compare(nothing, 0.0, labels(coverage()))
    assert missed.iou == 0.0
    assert missed.error_percent == pytest.approx(-100.0)
    assert missed.displacement_px.points == 0
    assert np.isnan(missed.displacement_px.mean)
    empty = FrameLabels(**{**vars(labels(np.zeros(SHAPE))), "area": 0.0})
    quiet = compare(nothing, 0.0, empty)
    assert quiet.iou == 1.0
    assert np.isnan(quiet.error_percent)
    assert quiet.error_mm2 == 0.0
    ghost = compare(radius_from(*AT) < 10, 0.1, empty)
    assert ghost.iou == 0.0
    assert ghost.displacement_px.points == 0


def test_masks_of_different_views_are_refused() -> None:
    with pytest.raises(ValueError, match="shape"):
        compare(np.zeros((5, 5), bool), 0.0, labels(coverage()))


@settings(deadline=None, max_examples=25)
@given(row=st.floats(90, 140), col=st.floats(90, 180), radius=st.floats(8, 60), outwards=st.floats(-4, 8))
@example(row=90.0, col=90.0, radius=8.0, outwards=-0.6875)
def test_any_disc(row: float, col: float, radius: float, outwards: float) -> None:
    estimate = radius_from(row, col) < radius + outwards
    displacement, _ = boundary_displacement(estimate, coverage(radius, (row, col)), np.ones(SHAPE))
    # A small disc about a pixel's middle is eight times the same steps, so that it is larger or smaller than drawn by a
    # quarter of a pixel; its own area tells by how much. Few points (25 at radius 4), the worst of many tries counts.
    outwards = np.sqrt(estimate.sum() / np.pi) - radius
    assert displacement.mean() == pytest.approx(outwards, abs=0.05 + 1.0 / np.sqrt(displacement.size))
