"""Frame rates: exposure and gain follow; and probabilities and strengths of single effects."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest
from pydantic import ValidationError
from typer.testing import CliRunner

from evanesce.cli.app import app
from evanesce.core.errors import InputError
from evanesce.core.quantities import Strict
from evanesce.core.states import ContactState
from evanesce.dataset.config import CHANNELS, DatasetConfig, load_config
from evanesce.dataset.data_card import _besides, _effects, _exposure
from evanesce.dataset.design import draw_effect, rig_plan, trial_plan
from evanesce.dataset.produce import Producer
from evanesce.dataset.rigs import RigCamera, plate_grid, rig_scene, rig_with_effects
from evanesce.dataset.run import Engine, make
from evanesce.dataset.trial import Trial
from evanesce.effects import all_effects
from evanesce.rig import Camera, load_scene
from support.datasets import tiny_config, tiny_job
from support.rigs import small_rig


def rig_at(rate_hz: float, exposure_ms: float = 6.0) -> tuple[RigCamera, ContactState]:
    """Return a camera of the thesis's rig on 200 x 150 px, and a contact."""
    config = tiny_config(
        trial={"frames": 400, "frame_rate_hz": rate_hz},
        programme={"press_time_s": {"constant": 0.1}, "hold_time_s": {"constant": 0.05}},
        rig={"count": 1, "draw": {"camera.exposure_ms": {"constant": exposure_ms}}},
        camera={"scale": 0.1},
    )
    plan = trial_plan(config, 8, 0)
    rig = rig_with_effects(rig_scene(load_scene("thesis"), plan.rig, plan.finger, config), plan.rig.seed)
    state = Trial(plan, config, rig.scene, plate_grid(rig.scene, config)).truth(round(0.12 * rate_hz)).state
    assert state is not None
    return RigCamera(rig, plan.rig.seed), state


def camera_at(rate_hz: float, exposure_ms: float = 6.0) -> Camera:
    return rig_at(rate_hz, exposure_ms)[0].scene.camera


def test_the_mean_level_stays_and_noise_grows_as_photons_become_fewer():
    """The variance of shot noise grows as the exposure's factor, that of read noise as its square."""
    level, noise, cameras = {}, {}, {}
    for rate in (60.0, 500.0, 1000.0):
        camera, state = rig_at(rate)
        frames = [camera.frame(state, index=i, time_s=0.0, with_raw=True).raw for i in range(24)]
        cameras[rate] = camera.scene.camera
        stack = np.stack(frames).astype(float) - cameras[rate].pixel.black_level_DN
        level[rate], noise[rate] = stack.mean(axis=0), stack.var(axis=0, ddof=1)
    lit = (level[60.0] > 30) & (level[60.0] < 3000)
    assert lit.sum() > 100
    for rate in (500.0, 1000.0):
        factor = cameras[60.0].exposure_ms / cameras[rate].exposure_ms
        assert cameras[rate].exposure_ms == pytest.approx(900.0 / rate)
        assert cameras[rate].analogue_gain == pytest.approx(factor)
        assert level[rate][lit].mean() == pytest.approx(level[60.0][lit].mean(), rel=0.01)
        grown = noise[rate][lit].mean() / noise[60.0][lit].mean()
        assert 0.9 * factor < grown < 1.1 * factor**2


def test_rates_that_leave_the_exposure_time_change_nothing():
    camera = camera_at(60.0, 5.0)
    assert (camera.exposure_ms, camera.analogue_gain) == (5.0, load_scene("thesis").camera.analogue_gain)


def test_gains_no_camera_has_are_refused():
    with pytest.raises(InputError, match=r"trial\.frame_rate_hz.*gain.*64"):
        camera_at(1000.0, 100.0)


def test_trials_too_short_to_slide_are_refused(tmp_path):
    (tmp_path / "c.toml").write_text("[trial]\nframe_rate_hz = 1000.0\n")
    with pytest.raises((InputError, ValidationError), match=r"press and hold.*allowed: more than \d+ frames"):
        load_config(tmp_path / "c.toml")


def test_rolling_rows_are_read_between_two_frames():
    config = tiny_config(
        trial={"frames": 400, "frame_rate_hz": 500.0},
        programme={"press_time_s": {"constant": 0.1}, "hold_time_s": {"constant": 0.05}},
        randomisation={"probability": 1.0, "only": ("rolling_shutter",)},
    )
    plan = trial_plan(config, 8, 0)
    scene = rig_scene(small_rig(), plan.rig, plan.finger, config)
    assert scene.effects["rolling_shutter"]["readout_ms"] <= 2.0


def test_the_card_says_what_a_rate_does():
    kept = {"programme": {"press_time_s": {"constant": 0.1}, "hold_time_s": {"constant": 0.05}}}
    draw = {"rig": {"draw": {"camera.exposure_ms": {"constant": 6.0}}}}
    fast = tiny_job(400, 5, trial={"frames": 400, "frame_rate_hz": 500.0}, **kept, **draw)
    said = _exposure(fast)
    assert "1.8 ms" in said
    assert "noise grows" in said
    assert not _exposure(tiny_job(12, 5))


# --- effects ----------------------------------------------------------------------------------------------------------


def test_an_effect_has_its_own_probability_and_strength():
    own = {"led_bin": {"probability": 1.0, "strength": 3.0}, "vignetting": {"probability": 0.0}}
    config = DatasetConfig.model_validate({"randomisation": {"probability": 0.3, "effects": own}})
    plain = DatasetConfig.model_validate({"randomisation": {"probability": 0.3}})
    rigs = [(rig_plan(config, 4, i), rig_plan(plain, 4, i)) for i in range(60)]
    assert all("led_bin" in ours.effects and "vignetting" not in ours.effects for ours, _ in rigs)
    assert 0 < sum("led_bin" in theirs.effects for _, theirs in rigs) < 40
    others = [{k: v for k, v in r.effects.items() if k not in own} for r, _ in rigs]
    assert others == [{k: v for k, v in r.effects.items() if k not in own} for _, r in rigs]
    effect = all_effects()["led_bin"]
    sizes = [
        np.abs([draw_effect(effect, s, np.random.default_rng(k))[name] for k in range(40)]).mean()
        for s in (1.0, 3.0)
        for name in [effect.candidate_parameters()[0].name]
    ]
    assert sizes[1] > 1.5 * sizes[0]


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("[randomisation.effects]\nnone_such = { probability = 0.5 }\n", "none_such"),
        ("[randomisation.effects]\nled_bin = { probability = 1.5 }\n", "probability"),
        ("[randomisation.effects]\nsquare_size = { probability = 0.5 }\n", "square_size"),
        ("[randomisation]\nonly = ['led_bin']\n[randomisation.effects]\nspecks = { strength = 0.5 }\n", "only"),
    ],
)
def test_effects_that_cannot_be_drawn_are_refused(text, word, tmp_path):
    (tmp_path / "c.toml").write_text(text)
    with pytest.raises((InputError, ValidationError), match=word):
        load_config(tmp_path / "c.toml")


def test_motions_liquids_and_markers_are_in_the_card():
    marks = {"pitch_mm": 1.5, "diameter_mm": 0.6}
    job = tiny_job(12, 5, motion={"turn": 0.2, "stick_slip": 0.3}, liquid={"share": 0.1}, markers=marks)
    said = _besides(job)
    for words in ("turn 20 %", "stick_slip 30 %", "10 % of the trials are wet", "0.6 mm wide and 1.5 mm apart"):
        assert words in said
    assert not _besides(tiny_job(12, 5))


def test_shares_of_single_effects_are_in_the_card():
    job = tiny_job(12, 5, randomisation={"probability": 0.2, "effects": {"led_bin": {"probability": 0.7}}})
    assert "led_bin in 70 %" in _effects(job)


# --- what the user writes ---------------------------------------------------------------------------------------------


def test_a_plain_figure_is_a_constant_and_one_name_a_list(tmp_path):
    (tmp_path / "c.toml").write_text(
        '[programme]\nspeed_mm_per_s = 2.5\n[finger]\nmaterial = "silskin_20"\n[labels]\nframe = "all"\nplate = "gap"\n'
    )
    config = load_config(tmp_path / "c.toml")
    assert config.programme.speed_mm_per_s.support() == (2.5, 2.5)
    assert config.finger.material.support() == ("silskin_20",)
    assert config.labels.channels("frame") == tuple(CHANNELS)
    assert config.labels.channels("plate") == ("gap",)
    assert DatasetConfig.model_validate_json(json.dumps(config.as_dict())) == config


@pytest.mark.parametrize("seed", range(4))
def test_what_a_rig_may_draw_is_checked_whatever_is_drawn(seed):
    rig = {"count": 2, "draw": {"leds.voltage_V": {"uniform": (8.6, 80.0)}}}
    with pytest.raises(InputError, match=r"rig\.draw\.'leds\.voltage_V': may draw 80: .*0 to 60 V"):
        tiny_job(12, seed, rig=rig)


def test_the_cameras_own_figures_are_in_the_frames():
    """At 250 Hz a drawn exposure of 8 ms is cut to nine tenths of 4 ms."""
    draw = {"rig": {"count": 1, "draw": {"camera.exposure_ms": {"constant": 8.0}}}}
    quick = {"programme": {"press_time_s": {"constant": 0.1}, "hold_time_s": {"constant": 0.05}}}
    job = tiny_job(400, 5, trial={"frames": 400, "frame_rate_hz": 250.0}, **quick, **draw)
    record = json.loads(Producer(job).record(200).members["json"])
    assert record["rig"]["changes"]["camera.exposure_ms"] == 8.0
    assert record["camera"]["exposure_ms"] == pytest.approx(3.6)
    assert record["camera"]["analogue_gain"] == pytest.approx(job.scene.camera.analogue_gain * 8.0 / 3.6)
    assert record["camera"]["scale_px_per_mm"] == pytest.approx(job.scene.camera.scale_px_per_mm)


def test_a_scheduler_that_does_not_answer_leaves_nothing(tmp_path, monkeypatch):
    monkeypatch.setattr("evanesce.dataset.cluster.ANSWER_S", 0.2)
    with pytest.raises(InputError, match="no scheduler answers"):
        make(tmp_path / "d", tiny_job(12), Engine(scheduler="tcp://127.0.0.1:1"))
    assert not (tmp_path / "d").exists()


def test_the_printed_declaration_holds_every_key_and_reads_back(tmp_path):
    runner, file = CliRunner(), tmp_path / "all.toml"
    assert runner.invoke(app, ["dataset", "config", "--out", str(file)]).exit_code == 0
    assert load_config(file) == DatasetConfig()
    own = tmp_path / "own.toml"
    own.write_text(
        '[finger]\npattern = "print_loop"\n[camera]\nsize_px = [64, 48]\n[randomisation.effects]\n'
        "led_bin = { probability = 0.5, strength = 2.0 }\n[rig.draw]\n"
    )
    printed = runner.invoke(app, ["dataset", "config", "--config", str(own)])
    assert printed.exit_code == 0
    (tmp_path / "again.toml").write_text(printed.output)
    assert load_config(tmp_path / "again.toml") == load_config(own)
    for model in (DatasetConfig, *(type(v) for v in vars(DatasetConfig()).values() if isinstance(v, Strict))):
        for key in model.model_fields:
            assert re.search(rf"^(# )?{key} =|^\[{key}\]|^\[\w+\.{key}\]", printed.output, re.MULTILINE), key
    assert re.search(r"^normal_force_N = .*# 0\.02 to 100 N$", printed.output, re.MULTILINE)
    assert re.search(r"^pattern = \"print_loop\"  # parallel, .*print_whorl$", printed.output, re.MULTILINE)
    gripper = runner.invoke(app, ["dataset", "config", "--scene", "gripper"])
    assert re.search(r"^tip_radius_mm = 10\.0", gripper.output, re.MULTILINE)
    assert "distortion" not in gripper.output.split("[rig.draw]")[1].split("[randomisation]")[0]
    refused = runner.invoke(app, ["dataset", "config", "--out", str(file)])
    assert refused.exit_code == 2
    assert "exists" in refused.output
