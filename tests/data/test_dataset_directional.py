"""Friction of a data set's trials by the direction of ridges and by speed, against closed forms written here."""

from __future__ import annotations

import functools
import math

import numpy as np
import pytest

from evanesce.dataset.audit import audit
from evanesce.dataset.config import KINDS, DatasetConfig
from evanesce.dataset.design import trial_plan
from evanesce.dataset.planar_trial import PlanarTrial, trial_of
from evanesce.dataset.region import contact_reach
from evanesce.dataset.rigs import plate_grid, rig_scene, rig_with_effects
from evanesce.dataset.run import make
from evanesce.dataset.trial import Trial
from support.datasets import tiny_config, tiny_job
from support.rigs import small_rig


def config_of(kind: str = "slide", *, ratio: float = 1.0, exponent: float = 0.0, motion=None, **more) -> DatasetConfig:
    """Return trials of one kind, with ridges at 30 deg and steady friction; ``more`` are the programme's constants."""
    fixed = {"press_time_s": 0.2, "hold_time_s": 0.1, "reversals": 0.0, "distance_mm": 0.7, "direction_deg": 0.0} | more
    return tiny_config(
        kinds={name: float(name == kind) for name in KINDS},
        trial={"frames": 60, "frame_rate_hz": 30.0},
        labels={"grid_samples": 160, "grid_size_mm": 14.0},
        programme={key: {"constant": value} for key, value in fixed.items()},
        finger={"ridged_share": 1.0, "pattern": {"constant": "parallel"}, "ridge_orientation_deg": {"constant": 30.0}},
        friction={
            "ridge_friction_ratio": {"constant": ratio}, "speed_exponent": {"constant": exponent},
            "dynamic_ratio": {"constant": 1.0}, "area_left": {"constant": 1.0},
        },
        motion=motion or {},
    )  # fmt: skip


@functools.cache
def trial(kind: str = "slide", **options) -> Trial:
    config = config_of(kind, **options)
    plan = trial_plan(config, 8, 0)
    rig = rig_with_effects(rig_scene(small_rig(), plan.rig, plan.finger, config), plan.rig.seed)
    return trial_of(plan, config, rig.scene, plate_grid(rig.scene, config))


@functools.cache
def numbers(found: Trial) -> list[dict[str, float]]:
    return [found.truth(i).scalars for i in range(len(found))]


def series(found: Trial, name: str) -> np.ndarray:
    return np.array([row[name] for row in numbers(found)])


def gross(found: Trial) -> int:
    """Return the last frame in which everything slips."""
    return int(np.flatnonzero(series(found, "stick_ratio") == 0.0)[-1])


def strongest(ratio: float, ridges_deg: float, towards: np.ndarray) -> np.ndarray:
    """Force of an ellipse of friction, ``ratio`` along the ridges and 1 across, that resists a motion most."""
    around = np.linspace(0.0, 2.0 * math.pi, 200_001)
    angle = math.radians(ridges_deg)
    along, across = np.array([math.cos(angle), math.sin(angle)]), np.array([-math.sin(angle), math.cos(angle)])
    forces = ratio * np.cos(around)[:, None] * along + np.sin(around)[:, None] * across
    return forces[np.argmax(forces @ towards)]


@pytest.mark.parametrize(("ratio", "direction"), [(0.6, 0.0), (0.6, 100.0), (1.6, -70.0)])
def test_ridges_turn_a_slides_force_as_their_ellipse_says(ratio, direction):
    found, even = trial(ratio=ratio, direction_deg=direction), trial(direction_deg=direction)
    assert isinstance(found, PlanarTrial)
    assert not isinstance(even, PlanarTrial)
    k, j = gross(found), gross(even)
    state = found.truth(k).state
    towards = np.asarray(state.slip_velocity)[:, np.asarray(state.contact_mask) > 0.5].mean(axis=1)
    across = math.hypot(series(even, "Fx_N")[j], series(even, "Fy_N")[j])
    force = np.array([series(found, "Fx_N")[k], series(found, "Fy_N")[k]])
    np.testing.assert_allclose(force, strongest(ratio, 30.0, towards / np.hypot(*towards)) * across, atol=0.02 * across)
    assert series(found, "margin")[k] == pytest.approx(1.0, abs=0.02)
    assert series(found, "margin").max() < 1.02
    assert math.hypot(*force) == pytest.approx(
        series(found, "friction_coefficient")[k] * series(found, "Fz_N")[k], rel=0.02
    )


def test_friction_of_a_slide_is_a_power_of_its_speed():
    fast, slow = (trial(exponent=0.15, speed_mm_per_s=speed) for speed in (8.0, 4.0))
    # the largest: a drive that comes to rest within a frame is slower in it
    force = [np.hypot(series(one, "Fx_N"), series(one, "Fy_N")).max() for one in (fast, slow)]
    assert force[0] / force[1] == pytest.approx(2.0**0.15, rel=1e-3)
    even = trial(speed_mm_per_s=4.0)
    moving = int(np.argmax(series(slow, "drive_mm") > 0.0))
    named = series(slow, "friction_coefficient") / series(even, "friction_coefficient")
    assert named[moving + 2] == pytest.approx(4.0**0.15, rel=1e-6)
    assert series(slow, "margin")[gross(slow)] == pytest.approx(1.0, abs=0.01)


@pytest.mark.parametrize("turned", [False, True])
def test_friction_is_that_of_the_drives_speed_where_it_turns_back_within_a_frame(turned):
    """The way over such a frame is short, the drive is not slow."""
    ratio = 0.999 if turned else 1.0  # the same by springs along a line, and in the plane
    found = trial(exponent=1.0, reversals=20.0, speed_mm_per_s=3.0, distance_mm=0.3, ratio=ratio)
    assert isinstance(found, PlanarTrial) is turned
    force = series(found, "Fx_N")
    moving = int(np.argmax(series(found, "drive_mm") > 0.0))
    mu = series(found, "friction_coefficient")[moving + 1 : -1]
    np.testing.assert_allclose(mu, mu[0], rtol=2e-3)
    # it unloads as contact and shaft in series let it
    contact = found._pressed(moving)
    shear = (2.0 * 4.0 / 3.0) * 0.25 * found._modulus * contact.contact_radius * 2.0
    stiffest = 1.2 / (1.0 / shear + 1.0 / found._shaft)
    gross = series(found, "stick_ratio") == 0.0
    assert gross.sum() >= 3
    assert np.abs(np.diff(force))[moving:].max() < stiffest * 3.0 / 30.0


def test_friction_of_a_finger_that_turns_in_place_has_no_direction():
    found = trial("spin", ratio=0.6)
    mu = series(found, "friction_coefficient")[12:]
    around = np.linspace(0.0, 2.0 * math.pi, 10_000, endpoint=False)
    mean = np.hypot(0.6 * np.cos(around), np.sin(around)).mean()
    np.testing.assert_allclose(mu, mean * found.plan.friction.friction_coefficient, rtol=1e-3)


def test_what_does_not_act_is_not_told():
    plan = trial("wiggle", exponent=0.2).plan
    assert plan.friction.speed_exponent == 0.0
    assert trial("slide", exponent=0.2).plan.friction.speed_exponent == 0.2


def test_a_change_of_speed_in_gross_slip_changes_the_force():
    motion = {"speed_change": 1.0, "speed_factor": {"constant": 3.0}}
    config = config_of(exponent=0.2, motion=motion, speed_mm_per_s=1.0, distance_mm=3.0)
    plan = trial_plan(config, 8, 0)
    rig = rig_with_effects(rig_scene(small_rig(), plan.rig, plan.finger, config), plan.rig.seed)
    found = trial_of(plan, config, rig.scene, plate_grid(rig.scene, config))
    ratio, speed = series(found, "stick_ratio"), np.diff(series(found, "drive_mm")) * 30.0
    force = np.hypot(series(found, "Fx_N"), series(found, "Fy_N"))
    quick = np.flatnonzero((speed > 2.0 * speed[15]) & (ratio[1:] == 0.0)) + 1
    slow = np.flatnonzero((speed < 2.0 * speed[15]) & (ratio[1:] == 0.0) & (speed > 0.0)) + 1
    assert force[quick].max() / np.median(force[slow]) == pytest.approx(3.0**0.2, rel=0.02)


def test_a_twist_takes_the_mean_over_all_directions():
    around = np.linspace(0.0, 2.0 * math.pi, 10_000, endpoint=False)
    mean = np.hypot(0.5 * np.cos(around), np.sin(around)).mean()
    ridged, even = trial("rotation", ratio=0.5), trial("rotation")
    assert series(ridged, "torque_N_mm")[-1] / series(even, "torque_N_mm")[-1] == pytest.approx(mean, rel=1e-3)
    spun = trial("spin", ratio=0.5)
    assert series(spun, "margin")[-1] == pytest.approx(1.0, abs=0.08)  # its soft skin lags behind the turn


def test_the_margin_of_a_slide_that_turns_counts_force_and_torque_together():
    motion = {"torsion": 1.0, "torsion_deg": {"constant": 150.0}}
    config = config_of(motion=motion, distance_mm=1.0)
    plan = trial_plan(config, 8, 0)
    rig = rig_with_effects(rig_scene(small_rig(), plan.rig, plan.finger, config), plan.rig.seed)
    found = trial_of(plan, config, rig.scene, plate_grid(rig.scene, config))
    margin, ratio = series(found, "margin"), series(found, "stick_ratio")
    assert (ratio == 0.0).any()
    assert margin[ratio == 0.0].min() > 0.9  # a soft skin that turns lags
    assert margin.max() < 1.08


def test_a_wiggle_over_ridges_stays_within_its_strength():
    found = trial("wiggle", ratio=0.5, direction_deg=30.0, wiggle_share=0.8, wiggle_frequency_hz=2.0)
    assert isinstance(found, PlanarTrial)
    assert 0.5 < series(found, "margin").max() < 0.85
    assert series(found, "stick_ratio").min() > 0.0


def test_fingers_without_parallel_ridges_keep_their_frames():
    def told(ratio):
        data = config_of(ratio=ratio).model_dump(exclude_none=True)
        data["finger"]["pattern"] = {"constant": "concentric"}
        changed = DatasetConfig.model_validate(data)
        plan = trial_plan(changed, 8, 0)
        rig = rig_with_effects(rig_scene(small_rig(), plan.rig, plan.finger, changed), plan.rig.seed)
        return trial_of(plan, changed, rig.scene, plate_grid(rig.scene, changed)).truth(40)

    one, other = told(1.0), told(0.4)
    assert one.scalars == other.scalars
    np.testing.assert_array_equal(one.state.traction, other.state.traction)


@pytest.mark.parametrize("ratio", [0.3, 3.0])
def test_contacts_stay_where_the_region_holds_them(ratio):
    found = trial(ratio=ratio, direction_deg=75.0, exponent=0.2, speed_mm_per_s=6.0)
    centre = np.array([found.centre(i) for i in range(len(found))])
    radius = max(found._pressed(i).contact_radius for i in range(len(found)))
    away = np.abs(centre - np.array(found.scene.finger.position_mm)).max(axis=0) + radius
    assert np.all(away <= np.array(contact_reach(found.plan, found.scene, found.config.trial)) + 1e-9)


def test_the_audit_finds_nothing(tmp_path):
    config = config_of(ratio=0.6, exponent=0.1, motion={"turn": 0.5, "torsion": 0.5})
    job = tiny_job(120, 5, **config.model_dump(exclude_none=True))
    make(tmp_path / "d", job)
    rows = audit(tmp_path / "d")
    assert not [(row.name, row.value) for row in rows if row.identity and not row.good]
