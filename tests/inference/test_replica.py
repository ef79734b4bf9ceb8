"""The refined area of drawn contacts of known area: blur that rounds ridges is corrected, intervals cover."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from scipy import stats

from evanesce.api.measure import Pipeline
from evanesce.measurement.calibration.model import Calibration
from evanesce.measurement.refined.edge import EdgeSettings, find_boundary
from evanesce.measurement.refined.replica import replica
from support import drawn_lab

SHAPE = (300, 400)
PITCH_MM = 1 / 30
CALIBRATION = Calibration(
    image_size=(400, 300), camera_matrix=np.array([[900.0, 0, 199.5], [0, 900, 149.5], [0, 0, 1]]),
    distortion=np.zeros(5), mm2_per_px=PITCH_MM**2, square_side_mm=15.0,
)  # fmt: skip
PIPELINE = Pipeline(calibration=CALIBRATION, estimator="refined", min_blob_px=2000)


def drawn(seed: int, ridges, **light):
    """Return measurement and true area [mm^2] of one drawn frame."""
    rng = np.random.default_rng([seed, 7])
    a = rng.uniform(60, 120)
    middle = 200 + rng.uniform(-9, 9), 150 + rng.uniform(-9, 9)
    share = drawn_lab.contact(SHAPE, middle, (a, a * rng.uniform(0.6, 0.9)), rng.uniform(0, 1), ridges)
    image = drawn_lab.frame(share, rng, **light)
    return PIPELINE.measure(image), float(share.sum()) * PITCH_MM**2


@pytest.mark.parametrize("blur", [1.2, 2.2])
def test_what_blur_rounds_off_a_ridged_contact_is_corrected(blur):
    """The boundary itself misses up to 3 % of a contact of five ridges; the area does not."""
    for seed in range(3):
        found, true = drawn(seed, (24, 0.6), blur=blur)
        assert found.refined is not None
        lost = found.area_mm2 * (1 + found.refined.shape_gain) / true - 1
        assert lost < -0.004 * blur
        assert abs(found.area_mm2 / true - 1) < 0.25 * abs(lost) + 0.001


@pytest.mark.parametrize("ridges", [None, (24, 0.6)])
@pytest.mark.parametrize("blur", [1.2, 2.2])
def test_the_drawn_contact_has_the_blur_of_the_frame(blur, ridges):
    """Between ridges blurred by 2.2 px edges show 2.0 px, because the step is read too small there."""
    share = drawn_lab.contact(SHAPE, (200, 150), (90, 70), 0.4, ridges)
    light = cv2.GaussianBlur(0.01 + 0.35 * share, (0, 0), blur)
    light = light + np.random.default_rng(4).normal(0, 0.004, SHAPE)
    again = replica(light, find_boundary(light, share > 0.5), EdgeSettings())
    assert again is not None
    assert again.blur_px == pytest.approx(blur, rel=0.05)


def test_a_smooth_contact_is_hardly_corrected():
    found, true = drawn(5, None)
    assert found.refined is not None
    assert abs(found.refined.shape_gain) < 0.001
    assert found.area_mm2 == pytest.approx(true, rel=0.001)


@pytest.mark.slow  # a replica per frame: 10 s
def test_intervals_of_single_frames_cover():
    """Rationale: 48 frames with and without ridges, glow, dust and blur. The 95 % interval also holds what a drawing
    lacks, an unknown print of the card and a film, so that it covers more: none may fail that 95 % would not let fail.
    """
    rng, hits, errors = np.random.default_rng(3), [], []
    for seed in range(24):
        light = {"glow": 0.1 * (seed % 2), "blur": 1.0 + 0.5 * (seed % 3)}
        if seed % 4 == 3:
            light["specks"] = drawn_lab.dust(SHAPE, rng, 20)
        found, true = drawn(seed, (22 + seed % 5, 0.6) if seed % 3 else None, **light)
        low, high = found.interval_mm2
        hits.append(low <= true <= high)
        errors.append(found.area_mm2 / true - 1)
        assert low <= found.area_mm2 <= high
    assert sum(hits) >= stats.binom.ppf(0.01, len(hits), 0.95)
    assert np.sqrt(np.mean(np.square(errors))) < 0.005


def test_specks_alone_are_no_contact():
    rng = np.random.default_rng(8)
    image = drawn_lab.frame(np.zeros(SHAPE), rng, specks=drawn_lab.dust(SHAPE, rng, 60, 0.5))
    found = PIPELINE.measure(image)
    assert found.area_mm2 == 0.0
    assert found.measured.segmentation.dropped_blobs > 10
