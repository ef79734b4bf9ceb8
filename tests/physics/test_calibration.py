"""Calibration against cameras that the test makes up: every figure has a known truth and a derived tolerance."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from evanesce.core.errors import InputError
from evanesce.measurement.calibration.distinct import distinct_views
from evanesce.measurement.calibration.fit import Calibrated, calibrate, report
from evanesce.measurement.calibration.local_scale import local_scale
from evanesce.measurement.calibration.pinhole import PinholeFit, fit_pinhole
from evanesce.measurement.calibration.planar import fit_planar
from evanesce.measurement.calibration.points import BoardView, read_points

Array = NDArray[np.float64]

SIZE = (1000, 740)
MATRIX = np.array([[1130.0, 0, 517.0], [0, 1130.0, 352.0], [0, 0, 1]])
DISTORTION = np.array([-0.31, 0.12, 0.0, 0.0, 0.0])


def board(nx: int = 13, ny: int = 10, square: float = 2.5) -> Array:
    return np.array([(i * square, j * square) for i in range(nx) for j in range(ny)])


def seen(
    world: Array, tilt: tuple[float, float, float], centre: tuple[float, float, float], distortion: Array = DISTORTION
) -> Array:
    """Image of a board by the camera above: rotation vector [rad], middle of the board at ``centre`` [mm]."""
    rotation, _ = cv2.Rodrigues(np.array(tilt))
    flat = np.column_stack([world - world.mean(axis=0), np.zeros(len(world))])
    q = flat @ rotation.T + centre
    x, y = q[:, 0] / q[:, 2], q[:, 1] / q[:, 2]
    r2 = x * x + y * y
    k1, k2, p1, p2, k3 = distortion
    radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    xd = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    yd = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    return np.column_stack([xd * MATRIX[0, 0] + MATRIX[0, 2], yd * MATRIX[1, 1] + MATRIX[1, 2]])


TILTS = [
    (0.35, 0.1, 0.05),
    (-0.3, 0.22, 0.4),
    (0.1, -0.4, -0.2),
    (0.25, 0.3, 1.1),
    (-0.15, -0.3, 0.7),
    (0.02, 0.05, 0.0),
]
PLACES = [
    (1.0, -0.5, 45.0),
    (-2.0, 1.0, 50.0),
    (1.5, 1.5, 48.0),
    (-1.0, -1.0, 52.0),
    (2.0, 0.3, 47.0),
    (0.0, 0.5, 44.0),
]


def tilted(noise: float, rng: np.random.Generator) -> list[BoardView]:
    views = []
    for k, (tilt, place) in enumerate(zip(TILTS, PLACES, strict=True)):
        points = seen(board(), tilt, place)
        inside = ((points > 0) & (points < np.array(SIZE) - 1)).all(axis=1)
        points = points[inside] + rng.normal(0, noise, (inside.sum(), 2))
        views.append(BoardView(f"v{k}", board()[inside], points))
    return views


def frontal(noise: float, rng: np.random.Generator, place: tuple[float, float, float] = (0.4, -0.7, 42.0)) -> BoardView:
    """A board filling the frame, hardly tilted, like a card lying on the plate."""
    world = board(21, 15, 1.9)
    points = seen(world, (0.01, -0.015, 0.03), place)
    inside = ((points > 0) & (points < np.array(SIZE) - 1)).all(axis=1)
    return BoardView(f"z{place[2]:g}", world[inside], points[inside] + rng.normal(0, noise, (inside.sum(), 2)))


def codes(result: Calibrated) -> set[str]:
    return {warning.code for warning in result.warnings}


def test_tilted_boards_identify_the_camera_within_its_standard_errors() -> None:
    result = calibrate(tilted(0.06, np.random.default_rng(21)), SIZE, expect_focal_px=1130.0, expect_distance_mm=48.0)
    fit = result.fit
    assert isinstance(fit, PinholeFit)
    assert codes(result) == set()
    truth = {"fx": 1130.0, "fy": 1130.0, "cx": 517.0, "cy": 352.0, "k1": -0.31, "k2": 0.12}
    found = dict(
        zip(("fx", "fy", "cx", "cy"), (fit.camera_matrix[i] for i in ((0, 0), (1, 1), (0, 2), (1, 2))), strict=True)
    )
    found |= {"k1": fit.distortion[0], "k2": fit.distortion[1]}
    assert set(fit.standard_errors) == set(truth)
    for name, value in truth.items():  # 4 sigma: a false alarm in 6 draws once in 2,600 seeds
        assert abs(found[name] - value) < 4 * fit.standard_errors[name], name
    assert fit.focal_error < 0.005
    # distances as laid out, to the focal length's own relative error and 4 sigma
    np.testing.assert_allclose(fit.distances, [np.hypot(np.hypot(*p[:2]), p[2]) for p in PLACES], rtol=0.01)


def test_held_out_residual_is_the_noise() -> None:
    """Left-out corners miss by the noise alone: RMS^2 = 2 sigma^2 (1 + p/n), p/n = 12 parameters of ~300 x 2 / 2."""
    noise = 0.2
    view = frontal(noise, np.random.default_rng(3))
    result = calibrate([view], SIZE)
    n = len(view)
    expected = noise * np.sqrt(2 * (1 + 12 / n))
    spread = expected / np.sqrt(4 * n)  # of an RMS over 2 n normal values
    assert abs(result.grid_rms_px - expected) < 4 * spread + 0.01 * expected
    # undistorting stretches the residual by at most the radial derivative's inverse at the corner of the frame
    assert result.grid_rms_px <= result.straight_rms_px < 1.5 * result.grid_rms_px


@pytest.mark.parametrize("focal", [300.0, 1130.0, 5000.0])
def test_planar_fit_finds_distortion_whatever_focal_length_is_assumed(focal: float) -> None:
    """k1/f^2 and k2/f^4 are what a flat board holds; without noise they come back to rounding for a level camera."""
    world = board(21, 15, 1.9)
    points = seen(world, (0.0, 0.0, 0.2), (0.4, -0.7, 42.0))
    inside = ((points > 0) & (points < np.array(SIZE) - 1)).all(axis=1)
    fit = fit_planar([BoardView("a", world[inside], points[inside])], SIZE, focal)
    np.testing.assert_allclose(fit.distortion[0] / focal**2, DISTORTION[0] / 1130.0**2, rtol=1e-6)
    np.testing.assert_allclose(fit.distortion[1] / focal**4, DISTORTION[1] / 1130.0**4, rtol=1e-5)
    np.testing.assert_allclose(fit.camera_matrix[:2, 2], MATRIX[:2, 2], atol=1e-4)
    np.testing.assert_allclose(fit.predict(0, world[inside]), points[inside], atol=1e-5)


def test_planar_standard_errors_cover() -> None:
    """Pulls over 40 noise draws: their RMS is 1 within 4/sqrt(2 * 40 * 4 values)."""
    clean = frontal(0.0, np.random.default_rng(0))
    truth = np.array([*MATRIX[:2, 2], -0.31, 0.12])
    base = fit_planar([clean], SIZE, 1130.0)
    start = np.array([*base.camera_matrix[:2, 2], *base.distortion[:2]])
    np.testing.assert_allclose(start[2:], truth[2:], rtol=0.05)  # the slight tilt shifts the centre, not the barrel
    pulls = []
    for seed in range(40):
        noise = np.random.default_rng(seed).normal(0, 0.15, clean.image.shape)
        fit = fit_planar([BoardView("n", clean.world, clean.image + noise)], SIZE, 1130.0)
        found = np.array([*fit.camera_matrix[:2, 2], *fit.distortion[:2]])
        pulls.append((found - start) / [fit.standard_errors[n] for n in ("cx", "cy", "k1", "k2")])
    assert abs(np.sqrt(np.mean(np.square(pulls))) - 1) < 4 / np.sqrt(2 * 160)


def test_full_model_finds_tangential_distortion_that_radial2_leaves() -> None:
    bent = np.array([-0.31, 0.12, 0.004, -0.006, 0.0])
    world = board()
    views = []
    for k, (tilt, place) in enumerate(zip(TILTS, PLACES, strict=True)):
        points = seen(world, tilt, place, bent)
        inside = ((points > 0) & (points < np.array(SIZE) - 1)).all(axis=1)
        views.append(BoardView(str(k), world[inside], points[inside]))
    fit = fit_pinhole(views, SIZE, "full")
    np.testing.assert_allclose(fit.distortion[2:4], bent[2:4], atol=1e-4)  # float32 corners: 3e-5 px
    full, plain = (calibrate(views, SIZE, model=m).grid_rms_px for m in ("full", "radial2"))
    assert full < 1e-2 < plain


def test_repeated_views_count_once() -> None:
    rng = np.random.default_rng(6)
    view = frontal(0.0, rng)
    copies = [BoardView(str(k), view.world, view.image + rng.normal(0, 0.03, view.image.shape)) for k in range(7)]
    result = calibrate(copies, SIZE)
    assert {"identical_views", "views_too_alike"} <= codes(result)
    assert len(result.distinct) == 1
    text = next(w.text for w in result.warnings if w.code == "identical_views")
    assert text.startswith("7 views are 1")
    # one view alone is not called repeated, and gives the same fit
    alone = calibrate(copies[:1], SIZE)
    assert codes(alone) == {"views_too_alike"}
    np.testing.assert_array_equal(alone.fit.distortion, result.fit.distortion)


def test_boards_in_parallel_planes_do_not_identify_the_focal_length() -> None:
    rng = np.random.default_rng(9)
    views = [frontal(0.1, rng, (0.4, -0.7, z)) for z in (42.0, 46.0, 51.0)]
    result = calibrate(views, SIZE, expect_focal_px=1300.0)
    assert not isinstance(result.fit, PinholeFit)
    text = next(w.text for w in result.warnings if w.code == "views_too_alike")
    assert "3 distinct views" in text
    assert "deg" in text
    assert "1300 px" in text
    assert result.calibration.camera_matrix[0, 0] == 1300.0
    assert result.grid_rms_px < 0.1 * np.sqrt(2) * 1.1  # the joint fit still serves all three


def test_distinct_views_keeps_small_motions_apart() -> None:
    view = frontal(0.0, np.random.default_rng(0))
    moved = BoardView("moved", view.world, view.image + 0.4)
    again = BoardView("again", view.world[::-1], view.image[::-1])
    kept, warnings = distinct_views([view, moved, again])
    assert [v.name for v in kept] == [view.name, "moved"]
    assert "3 views are 2" in warnings[0].text


def test_focal_length_and_distance_at_odds_name_both_figures() -> None:
    result = calibrate(tilted(0.06, np.random.default_rng(2)), SIZE, expect_focal_px=1500.0, expect_distance_mm=70.0)
    texts = {w.code: w.text for w in result.warnings}
    assert set(texts) == {"focal_length_at_odds", "distance_at_odds"}
    assert "1500 px" in texts["focal_length_at_odds"]
    assert "-24" in texts["focal_length_at_odds"]
    assert "70 mm" in texts["distance_at_odds"]


def test_planar_fit_compares_the_distance_that_the_assumption_implies() -> None:
    view = frontal(0.05, np.random.default_rng(2))
    assert "distance_at_odds" not in codes(calibrate([view], SIZE, expect_focal_px=1130.0, expect_distance_mm=42.0))
    assert "distance_at_odds" in codes(calibrate([view], SIZE, expect_focal_px=1130.0, expect_distance_mm=30.0))


def test_anisotropic_scale() -> None:
    view = frontal(0.05, np.random.default_rng(2))
    stretched = BoardView("wide", view.world * [1.03, 1.0], view.image)
    assert "anisotropic_scale" not in codes(calibrate([view], SIZE))
    text = next(w.text for w in calibrate([stretched], SIZE).warnings if w.code == "anisotropic_scale")
    assert "2.9" in text or "3.0" in text
    squashed = [BoardView(v.name, v.world, v.image * [1.0, 0.95]) for v in tilted(0.05, np.random.default_rng(5))]
    assert "anisotropic_scale" in codes(calibrate(squashed, SIZE))


def test_local_scale_of_unequal_lines_and_holes() -> None:
    """x = 12 X + Y, y = 9 Y - 2 X has determinant 110 everywhere; a cell without its corner is left out."""
    xs, ys = np.array([0.0, 1.0, 2.5, 3.0]), np.array([-1.0, 0.5, 2.0])
    world = np.array([(x, y) for x in xs for y in ys])
    image = world @ np.array([[12.0, -2.0], [1.0, 9.0]]) + [40, 30]
    whole = local_scale(BoardView("a", world, image))
    np.testing.assert_allclose(whole.px_per_mm2, 110.0)
    assert len(whole.px_per_mm2) == 6
    assert whole.summary()["median"] == pytest.approx(110.0)
    keep = np.arange(len(world)) != 4  # a corner of four cells
    assert len(local_scale(BoardView("a", world[keep], image[keep])).px_per_mm2) == 2
    assert np.isnan(local_scale(BoardView("a", world[:3], image[:3])).summary()["min"])


def test_corners_outside_the_frame_or_too_few() -> None:
    view = frontal(0.0, np.random.default_rng(0))
    with pytest.raises(InputError, match="outside the frame"):
        calibrate([view], (640, 480))
    with pytest.raises(InputError, match="at least 16"):
        calibrate([BoardView("a", view.world[:12], view.image[:12])], SIZE)


def test_the_rigs_corner_list(rig_photo: Path) -> None:
    """Twelve views that are one; straight to 0.75 px on corners left out of the fit; the scale the README gives."""
    result = calibrate(read_points(rig_photo / "corners.csv"), (1024, 768))
    figures = report(result)
    assert codes(result) == {"identical_views", "views_too_alike", "grid_rms_high", "outlying_corners"}
    assert figures["grid_rms_px"] <= 0.75
    assert len(figures["corners"]) == 12 * 1139
    # normalised to the half-diagonal of 640 px the README's k1 = -0.166, k2 = +0.024, to half a unit of the last digit
    k1, k2 = result.fit.distortion[:2] * np.array([640.0 / 1024.0, (640.0 / 1024.0) ** 2]) ** 2
    assert k1 == pytest.approx(-0.166, abs=0.002)
    assert k2 == pytest.approx(0.024, abs=0.002)
    assert 600 < figures["scale_px_per_mm2"]["median"] < 800
    spread = figures["scale_undistorted_px_per_mm2"]
    assert spread["p95"] / spread["median"] - 1 < 0.05
