"""Predicted area error: draws, the measuring's scale, percentiles, and the whole chain on a small rig."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from evanesce.chain.simulate import solve_contact
from evanesce.core import rng
from evanesce.core.errors import InputError
from evanesce.design import measurement, objective
from evanesce.design.evaluate import evaluate, plain_job, read_job
from evanesce.design.objective import (
    CalibratedMeasurement,
    measured,
    percentile,
    percentile_standard,
    prepared,
    samples,
)
from evanesce.design.question import Design
from evanesce.design.uncertainty import (
    Draw,
    UncertainParameter,
    draw,
    read_standard_deviations,
    sobol_points,
    uncertainty_of,
)
from evanesce.effects import all_effects
from evanesce.evaluation.calibrated_rig import CardErrors, calibrated
from evanesce.measurement.calibration.model import Calibration
from evanesce.measurement.calibration.rectify import rectification
from evanesce.render.fast.rig_fields import keep_coarse_fields
from evanesce.render.fast.transport import render_fast
from evanesce.render.kept import forget
from support.design_rig import PERFECT, camera_rig, question
from support.rigs import small_rig


def test_95_percent_and_its_error_for_normal_errors():
    """Of a standard normal the 95th percentile of |x| is 1.960; its standard error sqrt(p(1 - p)/n)/density."""
    errors = np.random.default_rng(5).normal(size=(900, 1))
    density = 2 * stats.norm.pdf(stats.norm.ppf(0.975))
    expected = np.sqrt(0.95 * 0.05 / 900) / density
    assert abs(percentile(errors) - 1.960) < 4 * expected
    # The bootstrap's own scatter of an extreme quantile's error is some 15 % at this count.
    assert percentile_standard(errors, np.random.default_rng(1)) == pytest.approx(expected, rel=0.5)


def test_measurements_of_one_rig_are_not_independent():
    """Each rig's error repeated four times has no more information than once."""
    errors = np.random.default_rng(5).normal(size=(300, 1))
    one, four = (percentile_standard(e, np.random.default_rng(2)) for e in (errors, np.repeat(errors, 4, axis=1)))
    assert four == pytest.approx(one, rel=0.1)


def test_parameters_have_the_stated_deviation():
    by_name = {
        c.name: UncertainParameter(name, c)
        for name in ("led_bin", "lateral_glow", "led_dead")
        for c in all_effects()[name].candidate_parameters()
    }
    even = (np.arange(4000) + 0.5) / 4000
    for name, mean, deviation in (
        ("offset_V", 0.0, 0.1),
        # Half a normal distribution of 0.7 mm: mean s sqrt(2/pi), deviation s sqrt(1 - 2/pi); cut at 3 mm.
        ("length_mm", 0.7 * np.sqrt(2 / np.pi), 0.7 * np.sqrt(1 - 2 / np.pi)),
    ):
        values = np.array([by_name[name].value(s) for s in even])
        assert values.mean() == pytest.approx(mean, abs=2e-3)
        assert values.std() == pytest.approx(deviation, rel=5e-3)
        low, high = by_name[name].candidate.bounds
        assert low <= values.min()
        assert values.max() <= high
    loss = np.array([by_name["loss"].value(s) for s in even])
    assert 0 <= loss.min() < loss.max() <= 1


def test_draws_are_even_and_the_same_for_every_design():
    found = uncertainty_of(small_rig(), {"led_bin": {"offset_V": 0.03}, "modulus": {"relative": 0.2}})
    points = sobol_points(found, 64, 7)
    assert points.shape == (64, 2 + 4)
    for column in points.T:  # each 64th holds one point
        assert sorted(np.floor(64 * column).astype(int)) == list(range(64))
    assert np.array_equal(points, sobol_points(found, 64, 7))
    assert not np.array_equal(points, sobol_points(found, 64, 8))
    one = draw(found, points[0])
    assert set(one.effects) == {"led_bin", "modulus"}
    assert abs(one.cards.board_scale - 1) <= 0.002


def test_effects_are_sorted_by_what_a_held_press_shows():
    found = uncertainty_of(small_rig())
    names = {d.effect for d in found.parameters}
    assert {"lateral_glow", "led_bin", "tone_curve", "specks"} <= names
    assert {d.effect for d in found.new_fields} >= {"glass_absorption", "led_air_gap"}
    assert found.left_out["ridge_height"] == "the finger has no ridges"
    assert found.left_out["square_size"] == "drawn with the cards"
    assert "held press" in found.left_out["frame_rate"]
    every = names | {d.effect for d in found.new_fields} | set(found.left_out)
    assert every == set(all_effects())


@pytest.mark.parametrize(
    ("text", "says"),
    [("[led_bins]\noffset_V = 1", "unknown effect"), ("[led_bin]\noffset = 1", "unknown parameter"),
     ("[led_bin]\noffset_V = -1", "above 0"), ("[led_bin]\noffset_V = true", "above 0"), ("led_bin = 3", "no"),
     ("[lateral_glow]\nshare = 0.2", "lateral_glow: does nothing without length_mm")],
)  # fmt: skip
def test_bad_uncertainties_are_named(tmp_path, text, says):
    (tmp_path / "u.toml").write_text(text)
    with pytest.raises(InputError, match=says if says != "no" else "is not a table"):
        read_standard_deviations(tmp_path / "u.toml")


def test_the_scale_is_that_of_the_card():
    """The square as it is seen by a whole calibration, printed 0.17 % too large and 0.08 mm high."""
    scene = camera_rig()
    nominal, real = (
        calibrated(scene, np.random.default_rng(3), errors, rotation_deg=2.0)
        for errors in (
            CardErrors(corner_noise_px=0.0),
            CardErrors(corner_noise_px=0.0, square_scale=1.0017, height_mm=0.08, square_edge_px=0.3),
        )
    )
    drawn = Draw({}, CardErrors(square_scale=1.0017, height_mm=0.08), 0.3)
    # Lens to plate: focal length over pixel, over the scale. What the edge adds is taken to first order there.
    distance = 6.0 / 0.013 / 18.0
    assert measurement.reference_scale(nominal, drawn, distance) == pytest.approx(real.mm2_per_px, rel=1e-4)


def test_a_perfect_frame_is_counted_right():
    """A disc of known area, drawn as a frame: it is counted to what whole pixels allow."""
    scene = camera_rig()
    wanted = question()
    measuring = CalibratedMeasurement.of(Design(scene=scene, threshold=0.5, min_blob_px=50), wanted, scene)
    assert isinstance(measuring.nominal, Calibration)
    view = rectification(measuring.nominal)
    rows, cols = view.source_shape
    v, u = np.mgrid[:rows, :cols]
    crop = measuring.crop(scene)
    middle = ((crop.r0 + crop.r1 - 1) / 2 + view.origin[1], (crop.c0 + crop.c1 - 1) / 2 + view.origin[0])
    radius = 31.3
    disc = np.clip(radius + 0.5 - np.hypot(v - middle[0], u - middle[1]), 0, 1)
    from evanesce.core.states import Frame

    frame = Frame(data=np.round(255 * disc).astype(np.uint8))
    true = np.pi * radius**2 / scene.camera.scale_px_per_mm**2
    # Gauss' circle problem: a disc of r pixels holds pi r^2 +- some 2 sqrt(r) of them; the glass bends by 0.1 %.
    found = measuring.area(frame, scene, PERFECT, rng.generator(1, "x"))
    assert found == pytest.approx(true, rel=2 * np.sqrt(radius) / (np.pi * radius**2) + 2e-3)
    far = scene.model_copy(update={"finger": scene.finger.model_copy(update={"position_mm": (25.0, 0.0)})})
    with pytest.raises(InputError, match="not in the frame"):
        measuring.crop(far)


def test_a_true_outline_has_its_area_by_one_scale():
    """A circle on the plate, off the axis, carried into the view: pi r^2 to what one scale for the view allows."""
    scene = camera_rig().model_copy(update={"slide": None})
    measuring = CalibratedMeasurement.of(Design(scene=scene), question(), scene)
    angle, radius = np.linspace(0, 2 * np.pi, 400, endpoint=False), 1.94
    line = measuring.to_view(scene, 4.1 + radius * np.cos(angle), -2.6 + radius * np.sin(angle))
    area = 0.5 * abs(np.sum(line[:, 0] * np.roll(line[:, 1], -1) - np.roll(line[:, 0], -1) * line[:, 1]))
    assert area * measuring.nominal.mm2_per_px == pytest.approx(np.pi * radius**2, rel=3e-3)


@pytest.fixture(scope="module")
def bench():
    """A small rig whose fields are there: scene, question."""
    scene, asked = (
        camera_rig(),
        question(standard_deviations={"force_offset": {"offset_N": 0.05}, "led_spread": {"spread": 0.1}}),
    )
    ready = prepared(scene, asked)
    objective.prepare_fields(ready, asked)
    yield scene, asked, ready
    forget()


def test_higher_thresholds_find_less(bench):
    """The same drawn rigs and noise: each area falls with the threshold, and half-way between lies the truth."""
    scene, asked, _ = bench
    areas = []
    for threshold in (0.1, 0.2, 0.35, 0.5):
        found = list(samples(Design(scene=scene, threshold=threshold, min_blob_px=20), asked))
        areas.append([s.measured_mm2 for s in found])
    true = np.array([s.true_mm2 for s in found])
    assert np.all(np.diff(areas, axis=0) <= 0)
    assert np.all(np.array(areas[0]) > true)
    # The load cell is off by 5 % of 0.8 N or so, and the truth with it: areas go as F^(2/3).
    light, heavy = (np.array([s.true_mm2 for s in found if s.case.force_N == f]) for f in (0.8, 2.3))
    assert light.std() / light.mean() == pytest.approx((2 / 3) * 0.05 / 0.8, rel=0.8)
    assert heavy.mean() / light.mean() == pytest.approx((2.3 / 0.8) ** (2 / 3), rel=0.1)


def test_a_trial_is_the_same_in_any_process(bench):
    """Plain data there and back, twice: the same figures to the last bit; the sum of what evaluate does."""
    scene, asked, _ = bench
    job = plain_job(Design(scene=scene, threshold=0.35, min_blob_px=20), asked, None)
    back = read_job(job)
    assert plain_job(*back) == job
    one, two = (evaluate(job, {"measurement.threshold": 0.3}) for _ in range(2))
    assert one["figures"]["area_error"] == two["figures"]["area_error"]
    found = objective.predict(Design(scene=scene, threshold=0.3, min_blob_px=20), asked)
    assert one["figures"]["area_error"] == found.error_percent
    assert one["standard_percent"] == found.standard_percent
    assert "taller than the plate" in evaluate(job, {"plate.thickness_mm": 2.0})["reason"]


def test_the_refined_estimator_measures_too(bench):
    scene, _, ready = bench
    wanted = question(estimator="refined")
    measuring = CalibratedMeasurement.of(Design(scene=scene), wanted, ready)
    found, _ = measured(measuring, ready, PERFECT, 0, wanted.cases[1])
    assert abs(found.error_percent) < 2.0  # 18 px/mm, a third of the thesis's


@pytest.mark.slow
def test_coarse_fields_show_the_same_frame_as_full_fields():
    scene = camera_rig()
    state = solve_contact(scene, 1.3, seed=1)[1]
    forget()
    keep_coarse_fields(scene, (state.depth,))
    coarse = render_fast(scene, state).radiance
    forget()
    full = render_fast(scene, state).radiance
    # The flank is the dim part: an eighth of its own light where that changes most, 0.35 % of a contact's.
    assert np.abs(coarse - full).max() < 5e-3 * full.max()
    forget()
