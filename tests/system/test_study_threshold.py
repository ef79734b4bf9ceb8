"""The threshold study: its areas on images whose answer is known, its flat parts and cliffs on curves by hand."""

from __future__ import annotations

import numpy as np
import pytest
from skimage import filters

from evanesce.measurement.reference.segment import Crop
from evanesce.rig import load_scene
from evanesce.studies.scenes import Finger, check_studied, every_finger
from evanesce.studies.threshold.page import findings
from evanesce.studies.threshold.study import (
    FORCES,
    RULES,
    THESIS_THRESHOLDS,
    THRESHOLDS,
    cliff,
    errors_by_setting,
    flat_range,
    frame_row,
    ranked,
)

SCALE = 0.0031


def two_levels(inside: int = 171, outside: int = 23) -> np.ndarray:
    """Return a bright rectangle of 61 x 83 px on a dark plate."""
    image = np.full((211, 257), outside, np.uint8)
    image[47:108, 90:173] = inside
    return image


def test_settings_of_the_thesis_are_among_the_levels_once() -> None:
    assert set(THESIS_THRESHOLDS) <= set(THRESHOLDS)
    assert list(THRESHOLDS) == sorted(set(THRESHOLDS))


def test_every_rule_is_scikit_images_own() -> None:
    level = np.random.default_rng(3).beta(2.0, 5.0, (97, 61))
    assert RULES["Otsu"](level) == filters.threshold_otsu(level)
    assert RULES["2.5 x Otsu"](level) == 2.5 * filters.threshold_otsu(level)
    assert RULES["Li"](level) == filters.threshold_li(level)
    assert RULES["Yen"](level) == filters.threshold_yen(level)
    assert RULES["mean"](level) == pytest.approx(level.mean())
    assert RULES["triangle"](level) == filters.threshold_triangle(level)


def test_a_sharp_rectangle_has_its_own_area_between_its_two_levels() -> None:
    truth = 61 * 83 * SCALE
    row = frame_row(two_levels(), truth, SCALE, Crop(20, 150, 60, 200))
    between = [k for k, t in enumerate(THRESHOLDS) if 0.3 <= t <= 0.45]
    # near half-way the blur of one pixel moves a straight edge by less than half a pixel; four corners lose a pixel
    for k in between:
        assert abs(row["manual"][k] - truth) <= 4 * SCALE + (61 + 83) * SCALE
    assert row["manual"][-1] == 0.0
    assert row["rules"]["whole frame"]["Otsu"]["area_mm2"] == pytest.approx(truth, rel=0.03)
    # dilated by 10 px it has some 8200 px: below, not above the greatest blob asked for
    assert row["blob"][0] == row["blob"][2] > 0
    assert row["blob"][-1] == 0.0


def test_more_dark_plate_lowers_the_mean_rule_and_not_otsus() -> None:
    row = frame_row(two_levels(), 1.0, SCALE, Crop(30, 125, 75, 190))
    wide, near = (row["rules"][where] for where in ("whole frame", "around the finger"))
    assert wide["mean"]["threshold"] < 0.8 * near["mean"]["threshold"]
    assert wide["Otsu"]["threshold"] == pytest.approx(near["Otsu"]["threshold"], abs=0.05)


def test_flat_range_and_cliff_of_curves_by_hand() -> None:
    t = (0.1, 0.2, 0.3, 0.4, 0.5)
    assert flat_range(t, (20.0, 10.1, 10.0, 9.95, 3.0)) == (0.2, 0.4)
    assert np.isnan(flat_range(t, (20.0, 15.0, 10.0, 5.0, 0.0))).all()
    assert cliff(t, (20.0, 10.1, 10.0, 7.0, 3.0), 10.0) == 0.4
    assert np.isnan(cliff(t, (20.0, 12.0, 11.0, 10.0, 9.0), 10.0))
    assert cliff(t, (1.0, 1.0, 1.0, 1.0, 1.0), 10.0) == 0.1
    # a hole in the curve is no cliff: what follows counts
    assert cliff(t, (10.0, 5.0, 10.0, 5.0, 5.0), 10.0) == 0.4


def rows() -> dict:
    """Return rows of every finger whose fixed levels err by a known share."""
    found = {}
    for finger in every_finger():
        for force in FORCES:
            truth = 7.0 + force
            areas = [truth * (1.5 if finger.scattering else 1.1) - 2.0 * t for t in THRESHOLDS]
            rules = {n: {"threshold": 0.3, "area_mm2": truth * (1.0 + 0.01 * k)} for k, n in enumerate(RULES)}
            found[finger, force] = {
                "true_area_mm2": truth, "manual": areas, "manual_whole_frame": [truth] * 4,
                "blob": [truth] * 5, "blur": [truth] * 5,
                "rules": {"whole frame": rules, "around the finger": rules},
            }  # fmt: skip
    return found


def test_ranking_is_by_root_mean_square_and_names_the_best_rule() -> None:
    table = ranked(errors_by_setting(rows()))
    assert [entry[2] for entry in table] == sorted(entry[2] for entry in table)
    by_name = {entry[0]: entry for entry in table}
    assert by_name["mean, whole frame"][1:] == pytest.approx((0.03, 0.03, 0.03))
    card = {"halfway_threshold": 0.42, "halfway": -0.003, "thresholds": [0.3, 0.4], "scale_error": [None, -0.004]}
    found = findings(rows(), card)
    crop = next(table for table in found.tables if "Effect of the crop" in table.caption)
    by_finger = {row[0]: row[1:] for row in crop.rows}
    # crops find 1.1 of the truth less 2 t, the whole frame the truth: at 0.6, 1.2/7.5 - 0.1 (0.5 N) and 1.2/12 - 0.1
    assert by_finger["smooth"][3] in ("+0.0 to +6.0", "-0.0 to +6.0")
    assert by_finger["smooth"][0] == "-9.4 to -9.0"
    assert found.verdict[0].startswith("Of scikit-image's rules Otsu")
    assert any("not found" in cell for table in found.tables for row in table.rows for cell in row)


def test_fingers_differ_in_what_they_say() -> None:
    scene = load_scene("thesis")
    plain, full = (Finger("silskin_20", ridged=True, scattering=g).on(scene) for g in (False, True))
    assert plain.finger.material == full.finger.material == "silskin_20"
    assert plain.finger.ridges is not None
    assert not plain.effects
    assert set(full.effects) == {"lateral_glow", "specks"}
    check_studied(plain)
    with pytest.raises(ValueError, match="effects"):
        check_studied(full)
