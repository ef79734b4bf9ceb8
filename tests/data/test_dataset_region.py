"""The region of interest is a cut of the camera's own view and holds the contacts; a view that cuts them is told of."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from typer.testing import CliRunner

from evanesce.cli.app import app
from evanesce.core.errors import InputError
from evanesce.dataset.config import DatasetConfig, with_size
from evanesce.dataset.design import RigPlan, trial_plan
from evanesce.dataset.job import new_job
from evanesce.dataset.limits import require_possible
from evanesce.dataset.rigs import rig_scene
from evanesce.dataset.stream import stream
from evanesce.optics.projection import Projection
from evanesce.rig import load_scene
from evanesce.sensor.lens import magnification
from support.rigs import small_rig

runner = CliRunner()


def cut(scene, size, region, effects=None):
    """Return the scene of a region, and the whole one."""
    found = []
    for camera in ({"size_px": size, "region_mm": region}, {}):
        config = DatasetConfig.model_validate({"camera": camera})
        rig = RigPlan(0, 0, {}, effects or {})
        found.append(rig_scene(scene, rig, trial_plan(config, 1, 0).finger, config))
    return found


def test_a_region_is_a_binned_cut_of_the_frame():
    """Every plate point keeps its place on the sensor: u -> (u - first + 1/2)/bin - 1/2, with distortion and all."""
    scene = load_scene("thesis", {"finger.position_mm": [2.3, -1.7], "camera.principal_point_offset_px": [7.0, -4.0]})
    part, whole = cut(scene, (160, 120), (8.0, 6.0))
    assert part.camera.resolution_px == (160, 120)
    here, there = (Projection.of(s.camera, s.plate) for s in (part, whole))
    x, y = 2.3 + np.array([-3.0, 0.0, 2.9, 1.2]), -1.7 + np.array([2.0, 0.0, -2.5, 0.4])
    (u, v), (whole_u, whole_v) = here.to_image(x, y), there.to_image(x, y)
    binned = whole.camera.scale_px_per_mm / part.camera.scale_px_per_mm
    np.testing.assert_allclose(np.diff(u) * binned, np.diff(whole_u), rtol=1e-9)
    np.testing.assert_allclose(np.diff(v) * binned, np.diff(whole_v), rtol=1e-9)
    assert (u[1], v[1]) == (pytest.approx(79.5, abs=1e-6), pytest.approx(59.5, abs=1e-6))
    # 8 mm wide at the finger, where distortion changes the scale by some per cent between middle and rim
    assert u[2] - u[0] == pytest.approx(5.9 * 20.0, rel=0.02)
    first = (whole_u + 0.5) / binned - 0.5 - u
    np.testing.assert_allclose(first, first[0], atol=1e-6)
    # the same lens on the same chip: light per area and magnification do not change
    assert magnification(part.camera.scale_px_per_mm, part.camera.pixel.pitch_um) == pytest.approx(
        magnification(whole.camera.scale_px_per_mm, whole.camera.pixel.pitch_um), rel=1e-12
    )


def test_a_region_at_the_border_stays_within_the_view():
    scene = load_scene("thesis", {"finger.position_mm": [18.0, 13.0]})
    part, whole = cut(scene, (160, 120), (8.0, 6.0))
    here, there = (Projection.of(s.camera, s.plate) for s in (part, whole))
    u, v = here.to_image(*there.to_plate(np.array([1999.5]), np.array([1499.5])))
    assert (u[0], v[0]) == (pytest.approx(159.5, abs=0.01), pytest.approx(119.5, abs=0.01))


def test_a_region_larger_than_the_view_is_refused():
    with pytest.raises(InputError, match=r"camera\.region_mm: 80 x 60 mm are more than the camera sees"):
        cut(load_scene("thesis"), (160, 120), (80.0, 60.0))


def test_rows_of_a_region_are_read_out_in_their_share_of_the_time():
    effects = {"rolling_skew": {"readout_ms": 20.0}}
    part, whole = cut(load_scene("thesis"), (160, 120), (8.0, 6.0), effects)
    assert whole.effects["rolling_skew"]["readout_ms"] == 20.0
    rows = 120 * whole.camera.scale_px_per_mm / part.camera.scale_px_per_mm
    assert part.effects["rolling_skew"]["readout_ms"] == pytest.approx(20.0 * rows / 1500)
    assert 3.0 < part.effects["rolling_skew"]["readout_ms"] < 6.0


def test_the_default_region_holds_the_contacts_and_little_else():
    job = new_job(load_scene("thesis"), with_size(DatasetConfig(), "320x240"), frames=3200, seed=7)
    assert job.resolution == (320, 240)
    width, height = job.config.camera.region_mm
    assert width / height == pytest.approx(4 / 3, rel=1e-3)
    # Hertz's contact of the median force of 1 N: a^3 = 3 N R/(4 E*)
    radius = (0.75 * 1.0 * 7.5 / 0.769) ** (1 / 3)
    assert math.pi * radius**2 / (width * height) >= 0.2
    # and it is in the description, so that resuming does not look for it again
    assert DatasetConfig.model_validate_json(json.dumps(job.config.as_dict())).camera.region_mm == (width, height)


@pytest.mark.parametrize(
    ("camera", "says"),
    [
        ({"size_px": (320, 240), "scale": 0.5}, "one of them"),
        ({"region_mm": (8.0, 6.0)}, "without camera.size_px"),
        ({"size_px": (320, 4)}, "8 to 20000 a side"),
        ({"size_px": (320, 240), "region_mm": (8.0, 8.0)}, "square pixels"),
    ],
)
def test_views_that_contradict_themselves_are_refused(camera, says):
    with pytest.raises(ValueError, match=says):
        DatasetConfig.model_validate({"camera": camera})


def test_a_cut_view_is_told_of_and_a_region_is_not():
    common = ["dataset", "make", "thesis", "--n", "800", "--dry-run", "--out", "nowhere"]
    crop = runner.invoke(app, [*common, "--set", "camera.resolution_px=[320, 240]"])
    assert crop.exit_code == 0, crop.output
    text = " ".join(crop.output.split())
    assert "warning: the frame shows 5.48 x 4.11 mm" in text
    assert "--size 320x240" in text
    region = runner.invoke(app, [*common, "--size", "320x240"])
    assert region.exit_code == 0, region.output
    assert "the frame shows" not in region.output
    # ten trials are of too few fingers and rigs to be split in three
    assert "warning: no trial is in validation (train 8, validation 0, test 2)" in " ".join(region.output.split())
    more = runner.invoke(app, [*common[:3], "--n", "4000", *common[5:], "--size", "320x240"])
    assert "warning" not in more.output
    for bad in ("320", "320x4", "ax3", "320x240x3"):
        refused = runner.invoke(app, [*common, "--size", bad])
        assert refused.exit_code == 2
        assert "--size" in refused.output


def test_the_size_counts_for_the_memory_of_a_frame(tmp_path):
    (tmp_path / "c.toml").write_text("[camera]\nsize_px = [9000, 9000]\n")
    with pytest.raises(InputError, match="9000 x 9000 px"):
        require_possible("thesis", tmp_path / "c.toml", {}, 10)
    with pytest.raises(InputError, match="GB"):
        new_job(
            small_rig(), DatasetConfig.model_validate({"camera": {"size_px": (9000, 9000), "region_mm": (8.0, 8.0)}}),
            frames=6, seed=1,
        )  # fmt: skip


def test_frames_do_not_depend_on_how_many_are_asked_for():
    few, many = (
        new_job(load_scene("thesis"), with_size(DatasetConfig(), "320x240"), frames=n, seed=7) for n in (80, 800)
    )
    assert few.config == many.config
    one, two = (next(iter(stream(size="64x48", seed=3, trials=n))) for n in (1, None))
    np.testing.assert_array_equal(one.frame, two.frame)
