"""Motions within a trial: their shares, what the labels say of them, and that the audit finds nothing."""

from __future__ import annotations

import functools
import math

import numpy as np
import pytest
from pydantic import ValidationError

from evanesce.core.errors import InputError
from evanesce.dataset.audit import audit
from evanesce.dataset.config import DatasetConfig, load_config
from evanesce.dataset.design import trial_plan
from evanesce.dataset.planar_trial import PlanarTrial, trial_of
from evanesce.dataset.region import contact_reach
from evanesce.dataset.rigs import plate_grid, rig_scene, rig_with_effects
from evanesce.dataset.run import make
from support.datasets import tiny_config, tiny_job
from support.rigs import small_rig

SHARES = ("torsion", "turn", "speed_change", "force_change", "stick_slip")
SLIDES = {"load_stop": 0.0, "wiggle": 0.0, "rotation": 0.0, "ramp": 0.0, "release": 0.0, "change": 0.0}


def config_of(
    motion: dict, *, slide: float = 1.0, spin: float = 0.0, regrasp: float = 0.0, **programme
) -> DatasetConfig:
    return tiny_config(
        kinds={**SLIDES, "slide": slide, "spin": spin, "regrasp": regrasp},
        trial={"frames": 80, "frame_rate_hz": 30.0},
        labels={"grid_samples": 160, "grid_size_mm": 14.0},
        programme={
            "press_time_s": {"constant": 0.2},
            "hold_time_s": {"constant": 0.1},
            "reversals": {"constant": 0.0},
            "distance_mm": {"constant": 0.7},
            **programme,
        },
        motion=motion,
    )


@functools.cache
def trial(name: str, **figures: float) -> PlanarTrial:
    """Return the first trial with one motion; ``figures`` are its distributions' constants."""
    kinds = {"spin": (0.0, 1.0, 0.0), "regrasp": (0.0, 0.0, 1.0)}
    slide, spin, regrasp = kinds.get(name, (1.0, 0.0, 0.0))
    motion = {key: {"constant": value} for key, value in figures.items()}
    if name in SHARES:
        motion[name] = 1.0
    config = config_of(motion, slide=slide, spin=spin, regrasp=regrasp)
    plan = trial_plan(config, 8, 0)
    rig = rig_with_effects(rig_scene(small_rig(), plan.rig, plan.finger, config), plan.rig.seed)
    found = trial_of(plan, config, rig.scene, plate_grid(rig.scene, config))
    assert isinstance(found, PlanarTrial)
    return found


def series(found: PlanarTrial, name: str) -> np.ndarray:
    return np.array([found.truth(i).scalars[name] for i in range(len(found))])


def middle_velocity(found: PlanarTrial, i: int) -> np.ndarray:
    """Mean velocity of the skin that touches [mm/s]."""
    state = found.truth(i).state
    touching = np.asarray(state.contact_mask) > 0.5
    return np.asarray(state.slip_velocity)[:, touching].mean(axis=1)


def test_shares_are_those_of_the_slides():
    config = DatasetConfig.model_validate({"motion": {"stick_slip": 0.25, "turn": 0.5}})
    plans = [trial_plan(config, 3, i) for i in range(256)]
    slides = [p for p in plans if p.kind == "slide"]
    for key, share in (("stick_slip_drop", 0.25), ("turn_deg", 0.5)):
        assert np.mean([key in p.motion for p in slides]) == pytest.approx(share, abs=0.06)
    assert all(not p.motion for p in plans if p.kind != "slide")
    # a share changes no other draw
    plain = [trial_plan(DatasetConfig(), 3, i) for i in range(256)]
    assert not any(p.motion for p in plain)
    assert [p.programme for p in plain] == [p.programme for p in plans]


def test_a_fifth_of_the_slides_stick_and_slip_when_asked_for():
    config = config_of({"stick_slip": 0.3})
    assert np.mean([bool(trial_plan(config, 5, i).motion) for i in range(100)]) >= 0.2
    found = trial("stick_slip", stick_slip_drop=0.4)
    ratio, force = series(found, "stick_ratio"), np.hypot(series(found, "Fx_N"), series(found, "Fy_N"))
    jumps = [i for i in range(1, len(found) - 1) if ratio[i] == 0.0 and ratio[i + 1] > 0.9]
    assert len(jumps) >= 2
    limit = series(found, "friction_coefficient") * series(found, "Fz_N")
    for i in jumps:
        assert force[i] == pytest.approx(0.6 * limit[i], rel=0.05)
        assert force[i - 1] > 0.9 * limit[i - 1]
        assert np.hypot(*middle_velocity(found, i)) > 3 * np.hypot(*middle_velocity(found, i - 1))
    assert np.diff(jumps).min() >= 5


def test_a_slide_changes_direction():
    found = trial("turn", turn_deg=90.0)
    gross = np.flatnonzero(series(found, "stick_ratio") == 0.0)
    before, after = middle_velocity(found, gross[0]), middle_velocity(found, gross[-1])
    turned = math.degrees(math.atan2(before[0] * after[1] - before[1] * after[0], before @ after))
    assert turned == pytest.approx(90.0, abs=15.0)
    force = np.stack([series(found, "Fx_N"), series(found, "Fy_N")])[:, gross[-1]]
    assert force @ after / np.hypot(*force) / np.hypot(*after) > 0.97


def test_speed_and_force_change_half_way():
    found = trial("speed_change", speed_factor=3.0)
    drive, time = series(found, "drive_mm"), series(found, "time_s")
    speed = np.diff(drive) / np.diff(time)
    moving = speed[speed > 1e-6]
    assert moving.max() == pytest.approx(3.0 * np.median(moving[:10]), rel=0.02)
    found = trial("force_change", force_factor=0.6)
    force = series(found, "Fz_N")
    assert force[-1] == pytest.approx(0.6 * force[20], rel=1e-6)


def test_a_finger_turns_while_it_slides_and_past_gross_slip():
    found = trial("torsion", torsion_deg=35.0)
    assert series(found, "rotation_deg").max() == pytest.approx(35.0, abs=0.5)
    assert np.abs(series(found, "torque_N_mm")).max() > 0.05
    found = trial("spin", spin_deg=-100.0)
    rotation, ratio = series(found, "rotation_deg"), series(found, "stick_ratio")
    assert rotation.min() == pytest.approx(-100.0, abs=0.01)
    gross = np.flatnonzero(ratio == 0.0)
    assert len(gross) > 5
    assert not math.isnan(found.onset_gross_slip_s)
    # all slips: the skin moves as the rigid finger, about its middle
    i = gross[-1]
    state, (x0, y0) = found.truth(i).state, found.centre(i)
    x, y = np.meshgrid(state.grid.x - x0, state.grid.y - y0)
    spin = math.radians(rotation[i] - rotation[i - 1]) * 30.0
    touching = np.asarray(state.contact_mask) > 0.5
    np.testing.assert_allclose(
        np.asarray(state.slip_velocity)[:, touching], (spin * np.stack([-y, x]))[:, touching], atol=0.12 * abs(spin)
    )


def test_the_margin_of_a_spin_is_its_torques():
    """It grows with the turn; once nothing sticks it is the ratio of dynamic to static friction, as that of a slide."""
    found = trial("spin", spin_deg=-100.0)
    margin, stick = series(found, "margin"), series(found, "stick_ratio")
    held = series(found, "Fz_N") > 0.5 * series(found, "Fz_N").max()
    partly = held & (stick < 0.9) & (stick > 0.5)
    assert margin[held & (stick == 0.0)] == pytest.approx(found._friction.dynamic_ratio, rel=0.01)
    assert partly.any()
    assert np.all((margin[partly] > 0.3) & (margin[partly] < 0.97))


def test_a_finger_is_put_down_elsewhere_and_slides_again():
    found = trial("regrasp")
    force, slip = series(found, "Fz_N"), series(found, "stick_ratio") < 0.9
    lifted = np.flatnonzero(force == 0.0)
    assert lifted.size
    assert slip[: lifted[0]].any()
    assert slip[lifted[-1] :].any()
    assert np.hypot(*np.subtract(found.centre(5), found.centre(int(lifted[-1]) + 1))) > 0.05
    # as long as before: press of 0.2 s and hold of 0.1 s at first, press of 0.2 s again
    assert len(force) - lifted[-1] - 6 == pytest.approx(lifted[0] - 3 - 9, abs=2)


def test_a_trial_too_short_for_a_second_slide_is_refused():
    slides = dict(motion={}, slide=0.0, regrasp=1.0)
    config_of(**slides, press_time_s={"constant": 0.9})
    with pytest.raises((InputError, ValidationError), match=r"second press up to 2\.9 s.*more than 88 frames"):
        config_of(**slides, press_time_s={"constant": 1.0})


@pytest.mark.parametrize(
    ("name", "figures"), [("turn", {"turn_deg": 90.0}), ("force_change", {"force_factor": 0.6}), ("regrasp", {})]
)
def test_the_region_holds_the_contacts_and_little_more(name, figures):
    found = trial(name, **figures)
    wanted = np.array(contact_reach(found.plan, found.scene, found.config.trial))
    x0, y0 = found.scene.finger.position_mm
    sides = [
        np.abs(np.subtract(found.centre(i), (x0, y0))) + found._pressed(i).contact_radius
        for i in range(len(found))
        if found._pressed(i).contact_radius > 0
    ]
    share = np.max(sides, axis=0) / wanted
    assert 0.8 < share.max() <= 1.005


@pytest.mark.slow  # 30 s: frames of every motion, each decoded and checked
def test_the_audit_of_all_motions_finds_nothing(tmp_path):
    everything = config_of(dict.fromkeys(SHARES, 0.5), spin=0.3, regrasp=0.3)
    job = tiny_job(80 * 10, 5, **everything.model_dump(exclude_none=True))
    make(tmp_path / "d", job)
    rows = audit(tmp_path / "d")
    assert not [(row.name, row.value) for row in rows if row.identity and not row.good]
    assert all(row.of for row in rows if row.identity)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[motion]\nturn = 1.5\n", ("motion.turn", "1.5")),
        ("[motion]\nturn_deg = { uniform = [0.0, 200.0] }\n", ("motion.turn_deg", "-180 to 180")),
        ("[motion]\nstick_slip_drop = { constant = 0.95 }\n", ("motion.stick_slip_drop", "0.1 to 0.9")),
        ("[motion]\nhop = 0.5\n", ("motion.hop",)),
    ],
)
def test_impossible_motions_are_refused_in_one_line(text, words, tmp_path):
    (tmp_path / "c.toml").write_text(text)
    with pytest.raises((InputError, ValidationError)) as caught:
        load_config(tmp_path / "c.toml")
    line = str(caught.value)
    assert "\n" not in line
    assert "c.toml" in line
    assert all(word in line for word in words)
