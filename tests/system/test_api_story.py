"""The public API from a scene to its area: each step agrees with the functions beneath it and the command line."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

import evanesce as ev
from evanesce.chain.simulate import simulate
from evanesce.cli.app import app
from evanesce.contact.programme import press_programme
from evanesce.contact.solve import contact_sequence
from evanesce.core import provenance
from evanesce.dataset.run import make
from evanesce.evaluation.evaluate import Camera as Viewed
from evanesce.evaluation.evaluate import evaluate
from evanesce.evaluation.labels import label, view_geometry
from evanesce.measurement.reference.segment import Chain
from evanesce.optics.projection import Projection
from evanesce.render.fast.transport import render_fast
from evanesce.render.reference.path import render as trace
from evanesce.rig import Scene
from evanesce.sensor.codec import write_png
from support.datasets import tiny_config, tiny_job
from support.rigs import need, small_rig

FORCE_N = 1.3
runner = CliRunner()


def rig() -> Scene:
    """Return the thesis rig on 400 x 300 px, its board with squares so large that they are found in a second."""
    scene = ev.load("thesis").with_(
        grid__samples=512, press__forces_N=(0.6, FORCE_N), card__checkerboard_side_mm=2.0,
        card__checkerboard_squares=(20, 16),
    )  # fmt: skip
    return ev.coarser(scene, 5)


@pytest.fixture(scope="module")
def camera() -> ev.Camera:
    return ev.Camera(rig())


@pytest.fixture(scope="module")
def shot(camera: ev.Camera) -> ev.Shot:
    return camera.shoot(FORCE_N, seed=3, time_s=0.5, index=2)


@pytest.fixture(scope="module")
def targets(camera: ev.Camera) -> tuple[np.ndarray, np.ndarray]:
    return camera.shoot_target("checkerboard", seed=5), camera.shoot_target("square", seed=6)


@pytest.fixture(scope="module")
def calibration(targets: tuple[np.ndarray, np.ndarray]) -> ev.Calibration:
    return ev.calibrate([targets[0]], checker_side_mm=2.0, square=targets[1], tone_curve="bt709")


# --- the readme's snippet ---------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_snippet_of_the_readme_finds_the_area_within_ten_percent() -> None:
    scene = ev.load("thesis_ridged").with_(leds__voltage_V=9.5)
    shot = ev.Camera(scene).shoot(force_N=2.0, seed=1)
    found = ev.measure(shot.frame, scale_mm2_per_px=shot.scale_mm2_per_px, threshold=0.15)
    assert found.area_mm2 == pytest.approx(shot.truth.area_mm2, rel=0.1)


# --- frames -----------------------------------------------------------------------------------------------------------


def test_a_shot_is_what_the_chain_makes_with_the_same_seed(camera: ev.Camera, shot: ev.Shot) -> None:
    beneath = simulate(camera.scene, FORCE_N, seed=3, time_s=0.5, index=2, render=render_fast)
    np.testing.assert_array_equal(shot.frame, beneath.frame.data)
    np.testing.assert_array_equal(shot.raw, beneath.frame.raw)
    np.testing.assert_array_equal(shot.sensor_light.irradiance, beneath.sensor_light.irradiance)
    assert shot.frame.shape == camera.shape == (300, 400)
    assert (shot.index, shot.time_s, shot.contact.normal_force) == (2, 0.5, FORCE_N)
    other = camera.shoot(FORCE_N, seed=4, time_s=0.5, index=2)
    assert not np.array_equal(other.frame, shot.frame)


def test_a_contact_that_is_solved_first_gives_the_same_frame(camera: ev.Camera, shot: ev.Shot) -> None:
    state = ev.solve_contact(camera.scene, FORCE_N, seed=3, time_s=0.5, index=2)
    again = camera.expose(state, seed=3, index=2)
    np.testing.assert_array_equal(again.frame, shot.frame)
    assert again.contact is state


def test_effects_of_the_contact_are_in_the_state_and_not_applied_twice() -> None:
    camera = ev.Camera(rig().with_(effects__force_offset={"offset_N": 0.4}))
    state = ev.solve_contact(camera.scene, FORCE_N, seed=3)
    assert state.normal_force == pytest.approx(FORCE_N - 0.4)  # the load cell reports 0.4 N too much
    np.testing.assert_array_equal(camera.expose(state, seed=3).frame, camera.shoot(FORCE_N, seed=3).frame)


def test_a_finger_that_is_away_leaves_a_dark_frame_and_an_empty_truth(camera: ev.Camera) -> None:
    for dark in (camera.shoot(None, seed=1), camera.expose(None, seed=1)):
        assert dark.contact is None
        assert dark.truth.area_mm2 == 0.0
        assert not dark.truth.mask.any()
        assert dark.frame.max() < 20


def test_the_reference_renderer_is_the_path_tracer_with_its_options() -> None:
    need("scalar")
    scene = small_rig()
    shot = ev.Camera(scene, renderer="reference", samples=4, passes=2, variant="scalar").shoot(0.8, seed=2)
    beneath = simulate(scene, 0.8, seed=2, render=trace, samples_per_pixel=4, passes=2, variant="scalar")
    np.testing.assert_array_equal(shot.frame, beneath.frame.data)
    assert shot.plate_light.variance.max() > 0
    assert shot.provenance["renderer"] == "path"
    assert shot.provenance["family"] == "scalar"


def test_a_renderer_can_be_given(camera: ev.Camera, shot: ev.Shot) -> None:
    again = ev.Camera(camera.scene, renderer=render_fast).shoot(FORCE_N, seed=3, time_s=0.5, index=2)
    np.testing.assert_array_equal(again.frame, shot.frame)


def test_the_programme_gives_the_bytes_of_the_command_line(camera: ev.Camera, tmp_path: Path) -> None:
    ev.save_scene(camera.scene, tmp_path / "rig.toml")
    done = runner.invoke(app, ["render", str(tmp_path / "rig.toml"), "--fast", "--seed", "9", "--out", str(tmp_path)])
    assert done.exit_code == 0, done.output
    result = json.loads((tmp_path / "result.json").read_text())
    shots = list(camera.shoot_all(seed=9))
    assert len(shots) == len(result["frames"]) == 2
    for shot, row in zip(shots, result["frames"], strict=True):
        write_png(tmp_path / "frame.png", shot.frame)
        write_png(tmp_path / "raw.png", shot.raw)
        for kind, name in (("frame", "frame_"), ("raw", "raw/")):
            written = tmp_path / f"{name}{shot.index:06d}.png"
            assert (tmp_path / f"{kind}.png").read_bytes() == written.read_bytes()
        assert (shot.truth.area_mm2, shot.time_s) == (row["true_area_mm2"], row["time_s"])
    assert json.loads(json.dumps(shots[0].provenance)) == result["provenance"]


def test_provenance_names_the_seed_and_the_scene(shot: ev.Shot) -> None:
    found = shot.provenance
    assert found["seed"] == 3
    assert found["config_sha256"] == provenance.digest(shot.camera.scene.as_dict())
    assert found["renderer"] == "transport"


# --- truth ------------------------------------------------------------------------------------------------------------


def test_the_truth_is_the_contact_carried_into_the_frame(shot: ev.Shot) -> None:
    labels = label(shot.contact, view_geometry(Projection.of(shot.scene.camera, shot.scene.plate)))
    truth = shot.truth
    np.testing.assert_array_equal(truth.coverage, labels.mask)
    np.testing.assert_array_equal(truth.mask, labels.mask >= 0.5)
    np.testing.assert_array_equal(truth.pressure_MPa, labels.pressure)
    np.testing.assert_array_equal(truth.gap_mm, labels.gap)
    # Area and force survive the way into the pixels; what is left is the sampling of the contact's edge.
    assert (truth.coverage * truth.pixel_area_mm2).sum() == pytest.approx(truth.area_mm2, rel=2e-3)
    assert (truth.pressure_MPa * truth.pixel_area_mm2).sum() == pytest.approx(FORCE_N, rel=2e-3)


# --- measurement ------------------------------------------------------------------------------------------------------


def test_a_measurement_by_scale_counts_pixels_of_the_frame_as_it_is(camera: ev.Camera, shot: ev.Shot) -> None:
    found = ev.measure(shot.frame, scale_mm2_per_px=shot.scale_mm2_per_px, threshold=0.2, min_blob_px=80)
    assert found.mask.shape == shot.frame.shape
    assert found.area_mm2 == found.pixels * camera.scale_mm2_per_px
    np.testing.assert_array_equal(found.view, shot.frame)
    low, high = found.interval_mm2  # of the area sought: a threshold below half the light reads too large
    assert low < shot.truth.area_mm2 < high < found.area_mm2
    assert found.warnings == ()


def test_compare_and_split_agree_with_the_evaluation(shot: ev.Shot, calibration: ev.Calibration) -> None:
    chain = Chain(threshold=0.2, min_blob=80)
    viewed = Viewed.of(shot.scene, calibration, calibration.mm2_per_px)
    beneath = evaluate(shot.simulated, chain, viewed, seed=shot.seed)
    found = ev.measure(shot.frame, calibration=calibration, threshold=0.2, min_blob_px=80)
    assert found.area_mm2 == beneath.measured.estimate.area
    assert ev.compare(found, shot) == beneath.comparison
    assert ev.split_error(found, shot) == beneath.error


def test_the_refined_estimator_is_nearer_to_the_truth_than_a_threshold(
    shot: ev.Shot, calibration: ev.Calibration
) -> None:
    """A threshold of 0.2 lies below half the contact's light, a pixel outside the boundary: 8 % of this area."""
    reference = ev.measure(shot.frame, calibration=calibration, threshold=0.2, min_blob_px=80)
    refined = ev.measure(shot.frame, calibration=calibration, estimator="refined", finger="smooth")
    errors = [abs(ev.compare(found, shot).error_percent) for found in (reference, refined)]
    assert errors[1] < 1.0 < errors[0] < 12
    low, high = refined.interval_mm2
    assert low < shot.truth.area_mm2 < high
    assert refined.contours_px[0].shape[1] == 2


def test_a_crop_leaves_the_comparison_where_it_was(shot: ev.Shot) -> None:
    options = {"scale_mm2_per_px": shot.scale_mm2_per_px, "threshold": 0.2, "min_blob_px": 80}
    rows, cols = (np.flatnonzero(shot.truth.mask.any(axis=axis)) for axis in (1, 0))
    around = np.s_[rows[0] - 20 : rows[-1] + 21, cols[0] - 15 : cols[-1] + 16]
    whole, cut = ev.measure(shot.frame, **options), ev.measure(shot.frame, crop=around, **options)
    one, other = ev.compare(whole, shot), ev.compare(cut, shot)
    assert (one.area_mm2, one.error_mm2, one.iou) == (other.area_mm2, other.error_mm2, other.iou)
    assert one.displacement_px == other.displacement_px
    with pytest.raises(ev.InputError, match="crop"):
        ev.split_error(cut, shot)


def test_a_measurement_of_another_frame_is_not_compared(shot: ev.Shot) -> None:
    other = ev.measure(shot.frame[:-1], scale_mm2_per_px=shot.scale_mm2_per_px, min_blob_px=80)
    with pytest.raises(ev.InputError, match=r"shape \(299, 400\).*\(300, 400\)"):
        ev.compare(other, shot)


def test_a_folder_is_measured_like_its_frames_and_like_the_command_line(camera: ev.Camera, tmp_path: Path) -> None:
    frames = tmp_path / "frames"
    frames.mkdir()
    shots = list(camera.shoot_all(seed=2))
    for shot in shots:
        write_png(frames / f"frame_{shot.index:06d}.png", shot.frame)
    pipeline = ev.Pipeline(scale_mm2_per_px=camera.scale_mm2_per_px, threshold=0.2, min_blob_px=80)
    by_folder = list(pipeline.measure_all(frames, frame_rate_hz=30.0))
    by_array = list(pipeline.measure_all([shot.frame for shot in shots], frame_rate_hz=30.0))
    target = tmp_path / "measured.json"
    done = runner.invoke(
        app,
        ["measure", str(frames), "--mm2-per-px", repr(camera.scale_mm2_per_px), "--threshold", "0.2", "--min-blob",
         "80", "--no-undistort", "--fps", "30", "--json", str(target)],
    )  # fmt: skip
    assert done.exit_code == 0, done.output
    for one, other, row in zip(by_folder, by_array, json.loads(target.read_text())["frames"], strict=True):
        assert (one.pixels, one.area_mm2, one.index, one.time_s) == (
            other.pixels, other.area_mm2, other.index, other.time_s
        )  # fmt: skip
        assert (row["pixels"], row["area_mm2"], row["index"]) == (one.pixels, one.area_mm2, one.index)
        assert (row["area_low_mm2"], row["area_high_mm2"]) == one.interval_mm2


# --- calibration ------------------------------------------------------------------------------------------------------


def test_frames_in_memory_calibrate_like_their_files_on_the_command_line(
    targets: tuple[np.ndarray, np.ndarray], calibration: ev.Calibration, tmp_path: Path
) -> None:
    for name, picture in zip(("board", "square"), targets, strict=True):
        write_png(tmp_path / f"{name}.png", picture)
    target = tmp_path / "calibration.json"
    done = runner.invoke(
        app,
        ["calibrate", "--checkerboard", str(tmp_path / "board.png"), "--square-mm", "2", "--square",
         str(tmp_path / "square.png"), "--json", str(target)],
    )  # fmt: skip
    assert done.exit_code == 0, done.output
    by_files = ev.load_calibration(target)
    np.testing.assert_array_equal(by_files.camera_matrix, calibration.camera_matrix)
    np.testing.assert_array_equal(by_files.distortion, calibration.distortion)
    assert (by_files.mm2_per_px, by_files.square_side_mm) == (calibration.mm2_per_px, 15.0)
    assert by_files.details["corners"] == calibration.details["corners"]
    calibration.save(tmp_path / "own.json")
    own = ev.load_calibration(tmp_path / "own.json")
    assert own.details["tone_curve"] == "bt709"
    assert ev.Pipeline(calibration=tmp_path / "own.json").scale_mm2_per_px == calibration.mm2_per_px


def test_a_target_by_the_path_tracer_shows_what_the_closed_form_shows() -> None:
    """Both draw the same square; the mean of its white differs by the path tracer's noise and by inter-reflection."""
    need("scalar")
    scene = small_rig(camera__resolution_px=(96, 72)).with_(card__square_side_mm=6.0, camera__exposure_ms=0.004)
    fast = ev.Camera(scene).shoot_target("square")
    traced = ev.Camera(scene, renderer="reference", samples=8, passes=2, variant="scalar").shoot_target("square")
    white = fast > 0.8 * fast.max()
    assert white.sum() > 400
    assert traced[white].mean() == pytest.approx(fast[white].mean(), rel=0.03)


# --- slides, data sets, bundles ---------------------------------------------------------------------------------------


def test_a_slide_shows_stick_then_slip_in_the_pixels() -> None:
    scene = rig().with_(
        contact__law="hertz", press={"forces_N": (1.0,), "frame_rate_hz": 8.0},
        slide={"distance_mm": 2.0, "speed_mm_per_s": 2.0, "press_time_s": 0.5, "friction_coefficient": 0.6,
               "shaft": "rigid"},
    )  # fmt: skip
    camera = ev.Camera(scene)
    states = ev.contact_sequence(scene)
    assert len(states) == len(press_programme(scene))
    for mine, beneath in zip(states, contact_sequence(scene), strict=True):
        np.testing.assert_array_equal(mine.state, beneath.state)
        assert mine.tangential_force == beneath.tangential_force
    truths = [camera.expose(states[i], seed=4, index=i).truth for i in (4, 5, 12)]
    share = [np.mean(truth.surface_state[truth.mask] == ev.SurfaceState.SLIP) for truth in truths]
    assert share[0] == 0.0
    assert 0.2 < share[1] < 0.8
    assert share[2] > 0.99  # but for pixels half in contact whose centre lies beside it
    assert len(states[2:4]) == 2


def test_samples_in_memory_are_the_bytes_of_the_shards(tmp_path: Path) -> None:
    make(tmp_path / "d", tiny_job(frames=12, seed=11))
    memory = ev.make_dataset(small_rig(), trials=2, seed=11, config=tiny_config())
    with ev.open_dataset(tmp_path / "d") as written:
        assert len(memory) == len(written) == 12
        assert memory.trials() == written.trials()
        for mine, stored in zip(memory, written, strict=True):
            assert mine.key == stored.key
            assert {name: mine.bytes_of(name) for name in mine.members} == {
                name: stored.bytes_of(name) for name in stored.members
            }
            assert (mine.row["split"], mine.row["kind"]) == (stored.row["split"], stored.row["kind"])
        np.testing.assert_array_equal(memory[-1].frame, written[-1].frame)


def test_keys_of_a_dataset_are_changed_like_those_of_a_scene() -> None:
    by_keys = ev.make_dataset(small_rig(), trials=1, seed=3, config=tiny_config(), trial__frames=7)
    by_table = ev.make_dataset(small_rig(), trials=1, seed=3, config=tiny_config(trial={"frames": 7}).as_dict())
    assert len(by_keys) == 7
    assert by_keys.job.digest == by_table.job.digest


@pytest.mark.parametrize("with_frames", [True, False])
def test_a_bundle_goes_to_the_critic_of_its_kind(with_frames: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """The critics are tested where they live; here it is which one is asked, and how its answer reads."""
    answer = {"verdict": "causes", "first_line": "1 cause", "causes": [{"id": "defocus"}],
              "posterior": {"inclusion": {"defocus": 0.9}}, "next_measurement": {"what": "a press at 3 N"}}  # fmt: skip
    asked: list[Any] = []

    def critic(kind: str) -> Any:
        return lambda bundle, **options: asked.append((kind, bundle, options)) or SimpleNamespace(
            result=answer, scene="title = ''", pictures=None
        )  # fmt: skip

    monkeypatch.setattr("evanesce.inference.critic.criticise_frames", critic("frames"))
    monkeypatch.setattr("evanesce.inference.series.critic.criticise_series", critic("series"))
    bundle = ev.Bundle(path=Path("x"), scene=small_rig())
    monkeypatch.setattr(ev.Bundle, "has_frames", with_frames)
    found = ev.criticise(bundle, seed=5)
    assert asked[0][:2] == ("frames" if with_frames else "series", bundle)
    assert asked[0][2]["seed"] == 5
    assert (found.verdict, found.next_measurement, found.extended_scene) == ("causes", "a press at 3 N", "title = ''")
    assert found.probabilities == {"defocus": 0.9}
    assert repr(found) == "Criticism('causes', causes ['defocus'])"
