"""Marker layer: dots where OpenCV finds them, moved as rigid motions and Cattaneo's field say."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest
from pydantic import ValidationError

from evanesce.core.errors import InputError
from evanesce.dataset.config import KINDS, DatasetConfig, load_config, with_size
from evanesce.dataset.job import new_job
from evanesce.dataset.produce import Made, Producer
from evanesce.rig import load_scene


def producer(effects=None, *, frames=80, ridged=0.0, **kinds: float) -> Producer:
    config = DatasetConfig.model_validate(
        {
            "kinds": {**dict.fromkeys(KINDS, 0.0), **kinds},
            "markers": {"pitch_mm": 0.9, "diameter_mm": 0.4},
            "finger": {"ridged_share": ridged, "count": 1, "shaft_stiffness_N_per_mm": {"constant": 20.0}},
            "friction": {"area_left": {"constant": 1.0}, "friction_coefficient": {"constant": 0.6}},
            "programme": {
                "normal_force_N": {"constant": 1.2}, "reversals": {"constant": 0.0},
                "speed_mm_per_s": {"constant": 1.0}, "press_time_s": {"constant": 0.2},
                "hold_time_s": {"constant": 0.1},
            },
            "rig": {"count": 1, "draw": {"camera.exposure_ms": {"constant": 6.0}}},
            "randomisation": {"probability": 0.0},
            "motion": {"spin_deg": {"constant": 90.0}},
            "trial": {"frames": frames},
        }
    )  # fmt: skip
    scene = load_scene("thesis").model_copy(update={"effects": effects or {}})
    return Producer(new_job(scene, with_size(config, "320x240"), frames=frames, seed=5))


def by_number(made: Made) -> dict[tuple[int, int], dict]:
    return {(m["col"], m["row"]): m for m in made.meta["markers"]}


def found_by_opencv(made: Made) -> np.ndarray:
    """Return the middles (u, v) of dark dots in the contact [px]."""
    blobs = cv2.SimpleBlobDetector_Params()
    blobs.filterByColor, blobs.blobColor = True, 0
    blobs.filterByArea, blobs.minArea, blobs.maxArea = True, 30.0, 400.0
    blobs.filterByCircularity, blobs.minCircularity = True, 0.8
    blobs.filterByConvexity = blobs.filterByInertia = False
    blobs.minThreshold, blobs.maxThreshold, blobs.thresholdStep = 5, 250, 5
    return np.array([point.pt for point in cv2.SimpleBlobDetector_create(blobs).detect(made.picture.data)])


@pytest.mark.parametrize(("kind", "frame"), [("slide", 8), ("slide", 30), ("slide", 60), ("spin", 40), ("spin", 75)])
def test_opencv_finds_the_dots_where_the_labels_are(kind, frame):
    made = producer(**{kind: 1.0}).make(frame, exposed=True)
    found = found_by_opencv(made)
    inside = cv2.erode((made.mask >= 2).astype(np.uint8), np.ones((25, 25)))
    whole = [m for m in made.meta["markers"] if inside[round(m["v_px"]), round(m["u_px"])]]
    assert len(whole) >= 9
    for marker in whole:
        off = np.hypot(*(found - [marker["u_px"], marker["v_px"]]).T)
        assert off.min() < 0.2


def test_a_sliding_finger_carries_all_its_markers_along():
    maker = producer(slide=1.0)
    trial = maker.trial(0).trial
    first = round(trial.onset_gross_slip_s * 30) + 4
    before, after = by_number(maker.make(first, exposed=False)), by_number(maker.make(first + 6, exposed=False))
    way = np.subtract(trial.centre(first + 6), trial.centre(first))
    assert math.hypot(*way) > 0.1
    shared = [n for n in before if n in after and min(before[n]["touching"], after[n]["touching"]) > 0.99]
    assert len(shared) >= 9
    for n in shared:
        moved = [after[n][k] - before[n][k] for k in ("x_mm", "y_mm")]
        np.testing.assert_allclose(moved, way, atol=0.004)
        assert [after[n][k] - before[n][k] for k in ("dx_mm", "dy_mm")] == pytest.approx(moved, abs=2e-6)


def test_markers_stay_where_the_contact_sticks_and_lag_at_its_rim():
    """Under the sliding force the middle stays on the glass, and skin moves more the nearer it is to the rim."""
    maker = producer(slide=1.0)
    trial = maker.trial(0).trial
    k = next(i for i in range(80) if 0.3 < trial.truth(i).scalars["stick_ratio"] < 0.7)
    rest, now = by_number(maker.make(8, exposed=False)), by_number(maker.make(k, exposed=False))
    radius = float(trial._slide.frames[k].contact.contact_radius)
    stick = radius * math.sqrt(trial.truth(k).scalars["stick_ratio"])
    assert math.hypot(now[0, 0]["dx_mm"], now[0, 0]["dy_mm"]) < 1e-6
    tip = np.subtract(trial.centre(k), trial.centre(8))
    for number, marker in now.items():
        distance = math.hypot(marker["x_mm"] - trial.centre(k)[0], marker["y_mm"] - trial.centre(k)[1])
        moved = math.hypot(marker["dx_mm"], marker["dy_mm"])
        if distance < 0.9 * stick:
            assert moved < 1e-6
        elif distance > 1.1 * stick and marker["touching"] > 0.9:
            assert 0 < moved < math.hypot(*tip)
        assert number in rest or marker["touching"] < 1


def test_a_spun_finger_turns_its_markers():
    maker = producer(spin=1.0)
    made = maker.make(75, exposed=False)
    angle = math.radians(made.meta["scalars"]["rotation_deg"])
    assert angle == pytest.approx(math.pi / 2, abs=1e-3)
    x0, y0 = (made.meta["scalars"][f"centre_{a}_mm"] for a in "xy")
    for (col, row), marker in by_number(made).items():
        rigid = 0.9 * np.array(
            [col * math.cos(angle) - row * math.sin(angle), col * math.sin(angle) + row * math.cos(angle)]
        )
        here = np.array([marker["x_mm"] - x0, marker["y_mm"] - y0])
        # the glass holds the skin back, about the middle
        assert np.hypot(*(here - rigid)) < 0.35
        if (col, row) != (0, 0):
            assert here[0] * rigid[1] - here[1] * rigid[0] > 0


def test_labels_do_not_know_of_ink():
    plain, made = producer(slide=1.0), producer(slide=1.0)
    off = plain.job.config.model_copy(update={"markers": type(plain.job.config.markers)()})
    without = Producer(new_job(plain.job.scene, off, frames=80, seed=5)).make(30, exposed=True)
    drawn = made.make(30, exposed=True)
    assert without.meta["markers"] == []
    assert drawn.meta["scalars"] == without.meta["scalars"]
    np.testing.assert_array_equal(drawn.mask, without.mask)
    darker = without.picture.data.astype(int) - drawn.picture.data
    assert 0.02 < (darker[drawn.mask >= 2] > 20).mean() < 0.4


def test_rolling_rows_and_their_markers_agree():
    made = producer({"rolling_skew": {"readout_ms": 25.0}}, slide=1.0).make(60, exposed=True)
    found = found_by_opencv(made)
    inside = cv2.erode((made.mask >= 2).astype(np.uint8), np.ones((25, 25)))
    for marker in made.meta["markers"]:
        if inside[round(marker["v_px"]), round(marker["u_px"])]:
            assert np.hypot(*(found - [marker["u_px"], marker["v_px"]]).T).min() < 0.3


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("[markers]\npitch_mm = 0.3\ndiameter_mm = 0.29\n", "0.8 markers.pitch_mm"),
        ("[markers]\npitch_mm = 0.3\ndiameter_mm = 0.1\n", "labels.grid_samples"),
        ("[markers]\nabsorbed = 0.0\n", "markers.absorbed"),
    ],
)
def test_impossible_markers_are_refused(text, word, tmp_path):
    (tmp_path / "c.toml").write_text(text)
    with pytest.raises((InputError, ValidationError), match=word):
        load_config(tmp_path / "c.toml")
