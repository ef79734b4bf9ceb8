"""What a dataset is asked to be: distributions, bounds, groups and splits, refused requests."""

from __future__ import annotations

import json
import platform
import re
import time
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
import tomli_w
from pydantic import ValidationError
from scipy.stats import chi2_contingency, kstest

import evanesce.dataset as dataset
from evanesce.core.errors import InputError
from evanesce.dataset.config import KINDS, DatasetConfig, load_config
from evanesce.dataset.design import draw_effect, friction_plan, rig_plan, trial_plan
from evanesce.dataset.distributions import Distribution
from evanesce.dataset.job import load_job, new_job, save_job
from evanesce.dataset.programme import sample_programme, slide_speed
from evanesce.dataset.randomisation import NOT_DRAWN
from evanesce.effects import active_effects, all_effects
from support.datasets import tiny_config, tiny_job
from support.rigs import small_rig


@pytest.mark.parametrize(
    ("form", "low", "middle", "high"),
    [
        ({"uniform": (2.0, 5.0)}, 2.0, 3.5, 5.0),
        ({"log_uniform": (1.0, 25.0)}, 1.0, 5.0, 25.0),
        ({"normal": (1.5, 0.2)}, 0.9, 1.5, 2.1),
        ({"constant": 0.05}, 0.05, 0.05, 0.05),
    ],
)
def test_quantiles(form, low, middle, high):
    d = Distribution(**form)
    np.testing.assert_allclose([d.at(0.0), d.at(0.5), d.at(1.0)], [low, middle, high], rtol=1e-9)
    np.testing.assert_allclose(d.support(), (low, high), rtol=1e-12)


def test_choice_takes_each_equally():
    d = Distribution(choice=("a", "b", "c"))
    assert Counter(d.at(q) for q in (np.arange(300) + 0.5) / 300) == {"a": 100, "b": 100, "c": 100}
    assert d.at(1.0) == "c"


@pytest.mark.parametrize(
    "form", [{}, {"uniform": (1.0, 2.0), "constant": 1.0}, {"uniform": (2.0, 1.0)}, {"log_uniform": (0.0, 1.0)}]
)
def test_a_distribution_is_one_sound_form(form):
    with pytest.raises(ValidationError):
        Distribution(**form)


def test_toml_round_trip(tmp_path):
    config = tiny_config()
    path = tmp_path / "d.toml"
    path.write_text(tomli_w.dumps(config.as_dict()))
    assert load_config(path) == config


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (
            "[programme]\nspeed_mm_per_s = { uniform = [1.0, 5000.0] }",
            "programme.speed_mm_per_s: draws from 1.0 to 5000.0",
        ),
        ("[programme]\nspead_mm_per_s = { constant = 1.0 }", "nearest key: speed_mm_per_s"),
        ("[randomisation]\nwithout = ['speks']", "'speks'"),
        ("[randomisation]\nonly = ['specks', 'square_size']", "'square_size' (not drawn: not observable"),
        ("[finger]\nmaterial = { choice = ['wood'] }", "'wood'"),
        ("[labels]\ngrid_samples = 64", "labels.grid_samples of at least"),
        ("[trial]\nframes = 600", "at most 1024"),
        ("[split]\nby = 'frame'", "frame"),
        ("[kinds]\nslide = -1.0", "out of range"),
        ("x = ", "not valid TOML"),
    ],
)
def test_a_bad_declaration_is_one_line(tmp_path, text, says):
    path = tmp_path / "bad.toml"
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        load_config(path)
    assert says in str(caught.value)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_draws_follow_their_distribution():
    config = DatasetConfig()
    found = [friction_plan(config, 3, i).friction_coefficient for i in range(128)]
    low, high = config.friction.friction_coefficient.log_uniform
    # quasi-random: a Kolmogorov distance of 1/128 and a little, where independent draws have 0.12
    assert kstest(np.log(np.array(found) / low) / np.log(high / low), "uniform").statistic < 0.02


def test_kinds_follow_their_weights():
    config = tiny_config()
    found = Counter(trial_plan(config, 5, i).kind for i in range(128))
    weights = np.array(config.kinds.weights) / sum(config.kinds.weights)
    assert set(found) == {kind for kind, weight in zip(KINDS, weights, strict=True) if weight > 0}
    np.testing.assert_allclose([found[k] / 128 for k in KINDS], weights, atol=0.02)


def test_a_trial_is_a_function_of_seed_and_number():
    config = tiny_config()
    assert trial_plan(config, 5, 17) == trial_plan(config, 5, 17)
    assert trial_plan(config, 5, 17).programme != trial_plan(config, 6, 17).programme
    assert trial_plan(config, 5, 17).programme != trial_plan(config, 5, 18).programme


@pytest.mark.parametrize("by", ["finger_rig", "finger_rig_friction"])
def test_splits_hold_whole_groups(by):
    config = DatasetConfig.model_validate({"split": {"by": by, "test": 0.25, "validation": 0.125}})
    plans = [trial_plan(config, 9, i) for i in range(400)]
    groups: dict[tuple[str, int], set[str]] = {}
    for plan in plans:
        for name in ("finger", "rig", "friction"):
            groups.setdefault((name, getattr(plan, name).index), set()).add(plan.split)
    shared = {name for (name, _), splits in groups.items() if len(splits) > 1}
    assert shared == (set() if "friction" in by else {"friction"})
    splits = [plan.split for plan in plans]
    assert splits.count("test") / 400 == pytest.approx(0.25, abs=0.02)
    assert splits.count("validation") / 400 == pytest.approx(0.125, abs=0.02)
    # every finger and rig is in use, and a rig keeps its place for trials_in_a_row
    assert {p.finger.index for p in plans} == set(range(12))
    assert {p.rig.index for p in plans} == set(range(8))
    assert all(one.rig.index == two.rig.index for one, two in zip(plans[::2], plans[1::2], strict=True))


@pytest.mark.parametrize("group", ["split", "rig"])
def test_kinds_of_trial_are_as_frequent_in_every_split_and_rig(group):
    """Rationale: kind and split of two Sobol sequences shared binary digits; some splits had no rotation at all."""
    config = DatasetConfig.model_validate({"kinds": dict.fromkeys(KINDS, 1.0), "split": {"test": 0.25}})
    plans = [trial_plan(config, 9, i) for i in range(1024)]
    pairs = [(p.split if group == "split" else p.rig.index, p.kind) for p in plans]
    counts = np.array([[pairs.count((name, kind)) for kind in KINDS] for name in {name for name, _ in pairs}])
    assert chi2_contingency(counts).pvalue > 1e-3


def test_a_single_finger_or_rig_is_for_training():
    for groups in ({"finger": {"count": 1}}, {"rig": {"count": 1}}):
        config = DatasetConfig.model_validate(groups)
        assert {trial_plan(config, 9, i).split for i in range(60)} == {"train"}
    few = DatasetConfig.model_validate({"finger": {"count": 3}, "rig": {"count": 3}})
    assert {trial_plan(few, 9, i).split for i in range(60)} == {"train", "validation", "test"}


def test_effects_are_drawn_within_bounds_and_accepted():
    scene = small_rig()
    for name, effect in all_effects().items():
        for k in range(4):
            table = draw_effect(effect, 1.0, np.random.default_rng([k, 77]))
            (found,) = active_effects(scene.model_copy(update={"effects": {name: table}}))
            assert found.effect is effect
            assert set(table) <= set(found.parameters.model_dump())


def test_what_grows_with_time_has_been_at_work_for_a_while():
    ages = [
        draw_effect(all_effects()["led_warmup"], 1.0, np.random.default_rng([k, 3]))["on_before_s"] for k in range(200)
    ]
    assert kstest(np.log(ages) / np.log(3600.0), "uniform").pvalue > 1e-3
    held = [
        draw_effect(all_effects()["creep"], 1.0, np.random.default_rng([k, 3]))["held_before_s"] for k in range(200)
    ]
    assert 0.1 < min(held) < 0.2
    assert 5.0 < max(held) < 10.0


def test_a_scene_whose_effect_moves_pixels_is_refused():
    scene = small_rig().model_copy(update={"effects": {"distortion_drift": {"k1": 0.01}}})
    with pytest.raises(InputError, match=r"effects\.distortion_drift: labels would not follow"):
        new_job(scene, tiny_config(), frames=6, seed=1)


def test_effects_are_on_as_often_as_declared():
    config = tiny_config(randomisation={"probability": 0.3})
    names = config.randomisation.candidates
    assert "distortion_drift" not in names
    assert set(names) == set(all_effects()) - set(NOT_DRAWN)
    found = [len(rig_plan(config, 4, i).effects) for i in range(60)]
    count = 60 * len(names)
    assert abs(sum(found) / count - 0.3) < 4 * np.sqrt(0.3 * 0.7 / count)


def test_a_slide_moves_after_its_rest_and_at_its_speed():
    config = tiny_config(trial={"frames": 60, "frame_rate_hz": 30.0})
    plan = next(p for p in (trial_plan(config, 2, i) for i in range(30)) if p.kind == "slide")
    found = sample_programme(plan, config.trial, 1.7, 0.4, 1.0)
    p = plan.programme
    rest = p["press_time_s"] + p["hold_time_s"]
    assert np.all(found.drive[found.time <= rest] == 0.0)
    stroke = 0.4 + p["distance_mm"]
    assert found.drive.max() <= stroke * (1 + 1e-12)
    forth = (found.time > rest) & (found.time < rest + stroke / slide_speed(plan, config.trial, 0.4))
    speed = slide_speed(plan, config.trial, 0.4)
    assert speed >= p["speed_mm_per_s"]
    np.testing.assert_allclose(found.drive[forth], (found.time[forth] - rest) * speed, rtol=1e-9)
    assert found.force[0] == pytest.approx(min(p["preload_N"], p["normal_force_N"]))
    assert np.all(found.force[found.time >= p["press_time_s"]] == pytest.approx(p["normal_force_N"]))


def test_a_slide_goes_to_and_fro_as_often_as_asked_and_is_fast_enough_to_slip():
    config = tiny_config(
        trial={"frames": 90, "frame_rate_hz": 30.0},
        kinds={kind: float(kind == "slide") for kind in KINDS},
        programme={"speed_mm_per_s": {"constant": 3.0}, "reversals": {"constant": 2.0}},
    )
    plan = trial_plan(config, 2, 0)
    p, time = plan.programme, np.arange(90) / 30.0
    rest, stroke = p["press_time_s"] + p["hold_time_s"], 0.4 + p["distance_mm"]
    turns = rest + np.arange(4) * stroke / 3.0  # forth, back, forth, then at rest
    assert turns[-1] < time[-1]
    found = sample_programme(plan, config.trial, 1.7, 0.4, 1.0)
    np.testing.assert_allclose(found.drive, np.interp(time, turns, [0.0, stroke, 0.0, stroke]), atol=1e-9)
    # 9 mm to gross slip at 3 mm/s would take longer than the trial
    slow = sample_programme(plan, config.trial, 1.7, 9.0, 1.0)
    assert time[np.argmax(slow.drive >= 9.0)] <= rest + 0.6 * (time[-1] - rest) + 1 / 30


def test_a_wiggle_stays_below_the_sliding_force_of_its_springs():
    config = tiny_config(trial={"frames": 60, "frame_rate_hz": 30.0})
    plan = next(p for p in (trial_plan(config, 2, i) for i in range(64)) if p.kind == "wiggle")
    limit = 0.37
    found = sample_programme(plan, config.trial, 1.7, 0.4, limit)
    assert 0 < 1.7 * np.abs(found.drive).max() <= plan.programme["wiggle_share"] * limit * (1 + 1e-9)


@pytest.mark.parametrize("frames", [0, -3, 10**9])
def test_absurd_counts_are_refused_at_once(frames):
    start = time.perf_counter()
    with pytest.raises(InputError, match="frames"):
        new_job(small_rig(), tiny_config(), frames=frames, seed=1)
    assert time.perf_counter() - start < 1.0


def test_absurd_frames_are_refused_before_they_are_made():
    huge = small_rig(camera__resolution_px=(10000, 10000))
    start = time.perf_counter()
    with pytest.raises(InputError, match=r"GB.*allowed: at most 0\.4 GB a frame"):
        new_job(huge, tiny_config(), frames=6, seed=1)
    assert time.perf_counter() - start < 1.0


def test_contacts_must_fit_on_the_sampled_plane():
    with pytest.raises(InputError, match=r"labels\.grid_size_mm"):
        new_job(small_rig(), tiny_config(programme={"distance_mm": {"uniform": (1.0, 20.0)}}), frames=6, seed=1)


def test_a_rig_key_that_names_nothing_is_refused():
    config = tiny_config(rig={"count": 2, "draw": {"camera.exposure_s": {"constant": 1.0}}})
    with pytest.raises(InputError, match="exposure_ms"):
        new_job(small_rig(), config, frames=6, seed=1)


def test_frames_are_rounded_up_to_whole_trials():
    job = tiny_job(frames=13)
    assert (job.frames, job.trials, job.shards) == (18, 3, 3)
    assert [list(job.frames_of(t)) for s in range(3) for t in job.trials_of(s)][2] == [12, 13, 14, 15, 16, 17]


def test_a_job_comes_back_from_its_description(tmp_path: Path):
    job = tiny_job()
    save_job(tmp_path, job)
    back = load_job(tmp_path, check_versions=True)
    assert (back.scene, back.config, back.seed, back.frames, back.digest) == (
        job.scene, job.config, job.seed, job.frames, job.digest,
    )  # fmt: skip
    text = (tmp_path / "dataset.json").read_text()
    (tmp_path / "dataset.json").write_text(text.replace('"seed": 11', '"seed": 12'))
    with pytest.raises(InputError, match="config_sha256"):
        load_job(tmp_path)


@pytest.mark.parametrize(
    ("version", "says"),
    [
        (
            "2",
            r"version 2, of an earlier evanesce: its stick_ratio may be 0.* version 5; make it again",
        ),
        ("1", r"version 1, of an earlier evanesce: .*; make it again"),
        ("3", r"version 3, of an earlier evanesce: its labels have no strength.*; make it again"),
        ("4", r"version 4, of an earlier evanesce: its numbers have no rotation.*; make it again"),
        ("6", r"version 6, of a later evanesce .*install that one"),
        ('"5"', r"version '5' \(allowed: evanesce-dataset version 5\)"),
        ("null", r"version None \(allowed: evanesce-dataset version 5\)"),
    ],
)
def test_another_version_of_the_format_says_what_to_do(tmp_path: Path, version, says):
    """A lifted finger's stick_ratio was 0 before version 3: frames of both must not be read as one."""
    save_job(tmp_path, tiny_job())
    path = tmp_path / "dataset.json"
    path.write_text(path.read_text().replace('"format_version": 5', f'"format_version": {version}'))
    for refused in (lambda: load_job(tmp_path), lambda: save_job(tmp_path, tiny_job()), lambda: dataset.open(tmp_path)):
        with pytest.raises(InputError, match=says) as caught:
            refused()
        assert "\n" not in str(caught.value)


def test_other_versions_are_not_mixed_in(tmp_path: Path):
    save_job(tmp_path, tiny_job())
    path = tmp_path / "dataset.json"
    data = json.loads(path.read_text())
    data["provenance"]["python"] = "3.4.1"
    data["provenance"]["packages"] |= {"numpy": "1.0", "mitsuba": "0.6"}
    path.write_text(json.dumps(data))
    says = (
        rf"dataset\.json: begun with mitsuba 0\.6 \(here \S+\), numpy 1\.0 \(here {re.escape(np.__version__)}\),"
        rf" python 3\.4\.1 \(here {re.escape(platform.python_version())}\): .*--any-versions"
    )
    for refused in (lambda: load_job(tmp_path, check_versions=True), lambda: save_job(tmp_path, tiny_job())):
        with pytest.raises(InputError, match=says) as caught:
            refused()
        assert "scipy" not in str(caught.value)
    load_job(tmp_path)


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"seed": 12}, "seed"),
        ({"frames": 36}, "frames"),
        ({"trials_per_shard": 2}, r"config\.trials_per_shard"),
        ({"split": {"by": "finger_rig_friction"}, "labels": {"raw": True}}, r"config\.labels\.raw, config\.split\.by"),
    ],
)
def test_another_request_does_not_join(tmp_path: Path, changes, named):
    save_job(tmp_path, tiny_job())
    save_job(tmp_path, tiny_job())
    with pytest.raises(InputError, match=f"another dataset: {named} differ"):
        save_job(tmp_path, tiny_job(**changes))


def test_the_digest_in_a_frame_does_not_know_the_shards():
    digests = {tiny_job(**c).digest for c in ({}, {"trials_per_shard": 3}, {"frames": 48})}
    assert len(digests) == 1
    assert tiny_job(labels={"margin_mm": 0.7}).digest not in digests
