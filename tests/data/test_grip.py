"""A held object against Newton and Coulomb; the environment's contract; a grip by sight against a constant one."""

from __future__ import annotations

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest

from evanesce.dataset.config import DatasetConfig
from evanesce.dataset.grip_control import ConstantGrip, SightGrip, shift_px
from evanesce.dataset.grip_model import GRAVITY_MM_PER_S2, GripModel, GripTask
from evanesce.dataset.grip_train import RECORD, episode_return, train, trained_grip
from support.rigs import small_rig

CONFIG = DatasetConfig.model_validate(
    {
        "labels": {"grid_samples": 128, "grid_size_mm": 10.0},
        "finger": {"count": 2, "ridged_share": 1.0, "ridge_pitch_um": {"constant": 900.0}},
    }
)
TASK = GripTask(friction=(0.4, 0.4), weight_N=(0.3, 0.3), added=(0.0, 0.0), steps=20, rate_N_per_s=1000.0)


def model(task=TASK, grid_mm=10.0):
    config = CONFIG.model_copy(update={"labels": CONFIG.labels.model_copy(update={"grid_size_mm": grid_mm})})
    return GripModel(small_rig(), config, task, 3)


def test_a_firm_grip_carries_the_weight_and_nothing_slides():
    held = model()
    held.reset(1)
    for _ in range(12):
        found = held.step(1.5)
    assert found.friction_N == pytest.approx(0.3, rel=1e-3)
    assert found.slid_mm == pytest.approx(0.0, abs=1e-9)
    assert not found.lost


def test_a_loose_grip_lets_the_object_fall_by_newtons_law():
    loose = model(replace(TASK, drop_mm=8.0), grid_mm=30.0)
    loose.reset(1)
    for _ in range(6):
        loose.step(1.5)
    # From the first millimetre on: constant acceleration by weight less friction, over the mass.
    fallen = [loose.step(0.7).slid_mm for _ in range(5)]
    acceleration = (0.3 - 0.4 * 0.7) / (0.3 / GRAVITY_MM_PER_S2)
    dt = 1.0 / TASK.frame_rate_hz
    np.testing.assert_allclose(np.diff(fallen, 2)[1:], acceleration * dt**2, rtol=0.01)


def test_weight_is_added_once_and_a_lost_object_is_said_to_be():
    heavier = model(replace(TASK, added=(1.0, 1.0), steps=40, rate_N_per_s=8.0))
    heavier.reset(5)
    weights = [heavier.step(2.5).weight_N for _ in range(39)]
    assert sorted(set(np.round(weights, 9))) == [0.3, 0.6]
    assert np.all(np.diff(weights) >= 0)
    lost = [heavier.step(0.2).lost for _ in range(30)]
    assert not lost[0]
    assert lost[-1]


def test_an_episode_is_a_function_of_its_number_and_the_force():
    one, other = model(), model()
    for held in (one, other):
        held.reset(7)
    other.reset(8)
    assert not np.array_equal(one.frame(), other.frame())
    other.reset(7)
    for force in (1.0, 0.9, 0.6):
        assert one.step(force) == other.step(force)
        np.testing.assert_array_equal(one.frame(), other.frame())


def test_the_actuator_has_a_rate():
    slow = model(replace(TASK, rate_N_per_s=3.0))
    first = slow.reset(1).force_N
    assert slow.step(99.0).force_N == pytest.approx(first + 0.1)
    assert slow.step(0.0).force_N == pytest.approx(first)


@pytest.mark.parametrize("down", [0.1, -0.35, 1.6])
def test_a_picture_that_moves_is_seen_to(down):
    rng = np.random.default_rng(4)
    wide = cv2.GaussianBlur(rng.uniform(0, 255, (90, 120)).astype(np.float32), (0, 0), 3.0) * 4 - 380
    moved = cv2.warpAffine(wide, np.float32([[1, 0, 0], [0, 1, down]]), (120, 90), flags=cv2.INTER_CUBIC)
    frames = [np.clip(f[15:75, 20:100], 0, 255).astype(np.uint8) for f in (wide, moved)]
    assert shift_px(*frames) == pytest.approx(down, abs=0.05)


def test_by_sight_a_grip_lets_go_until_the_picture_moves():
    rng = np.random.default_rng(4)
    still = cv2.GaussianBlur(rng.uniform(0, 255, (60, 80)).astype(np.float32), (0, 0), 2.0).astype(np.uint8)
    sight = SightGrip(TASK)
    sight.reset(still, 1.0)
    forces = [sight.act(still) for _ in range(10)]
    assert np.all(np.diff(forces) < 0)
    gripped = sight.act(np.roll(still, 1, axis=0))
    assert gripped == pytest.approx(1.3 * forces[-1])
    assert min(sight.act(np.roll(still, 1, axis=0)) for _ in range(30)) > forces[-1]
    assert ConstantGrip(0.7).act(still) == 0.7


@pytest.mark.filterwarnings("ignore:.*we recommend using a symmetric and normalized space")
def test_the_environment_keeps_its_contract():
    gymnasium = pytest.importorskip("gymnasium")
    from gymnasium.utils.env_checker import check_env

    from evanesce.dataset.grip import GripEnv

    env = GripEnv(small_rig(), CONFIG, replace(TASK, steps=4))
    check_env(env, skip_render_check=True)
    frame, info = env.reset(seed=3)
    assert env.observation_space.contains(frame)
    assert frame.shape == (48, 64, 1)
    rewards = []
    over = False
    while not over:
        frame, reward, lost, over, info = env.step(np.array([2.5], np.float32))
        rewards.append(reward)
    assert not lost
    assert len(rewards) == 3
    # the greatest force costs 1 a second, and nothing slides
    assert sum(rewards) == pytest.approx(-3 / 30.0, rel=1e-6)
    assert info["friction_coefficient"] == 0.4
    assert isinstance(env, gymnasium.Env)


@pytest.mark.slow
def test_by_sight_unseen_friction_is_held_better_than_by_the_best_constant_grip():
    pytest.importorskip("gymnasium")
    from evanesce.dataset.grip import GripEnv

    seen = GripTask()

    def mean_return(env, controller, seeds):
        every = []
        for seed in seeds:
            frame, info = env.reset(seed=seed)
            controller.reset(frame, info["force_N"])
            total, over = 0.0, False
            while not over:
                action = np.array([controller.act(frame)], np.float32)
                frame, reward, lost, late, info = env.step(action)
                total, over = total + reward, lost or late
            every.append(total)
        return float(np.mean(every))

    env = GripEnv(task=seen)
    best = max((0.5, 0.63, 0.8, 1.0), key=lambda force: mean_return(env, ConstantGrip(force), range(4)))
    for friction in ((0.3, 0.45), (0.9, 1.3)):
        unseen = GripEnv(task=replace(seen, friction=friction))
        by_sight, constant = (mean_return(unseen, c, range(100, 104)) for c in (SightGrip(seen), ConstantGrip(best)))
        assert by_sight > constant


def test_a_slide_too_fast_to_be_read_is_met_at_once():
    rng = np.random.default_rng(4)
    first, other = (rng.integers(0, 255, (60, 80)).astype(np.uint8) for _ in range(2))
    for changed, factor in ((8.0, 2.0), (200.0, 1.0)):
        sight = SightGrip(TASK, changed_DN=changed, moved_px=1e9, release_per_s=0.0)
        sight.reset(first, 0.9)
        assert sight.act(other) == pytest.approx(0.9 * factor)


class Fading:
    """A still picture, and reward for a force that falls at a known rate."""

    rate = 0.9

    def reset(self, *, seed=None):
        self.step_number, self.force = 0, 1.5 + 0.1 * (seed or 0)
        self.wanted = self.force
        return np.full((60, 80), 90, np.uint8), {"force_N": self.force}

    def step(self, action):
        self.step_number += 1
        self.wanted *= 1.0 - self.rate / 30.0
        reward = -((float(action[0]) - self.wanted) ** 2)
        over = self.step_number == 20
        return np.full((60, 80), 90, np.uint8), reward, False, over, {"force_N": float(action[0])}


def test_training_finds_the_figure_that_is_rewarded():
    task = replace(TASK, force_N=(0.05, 3.0))
    start = SightGrip(task)
    trained = train(Fading(), task, generations=8, candidates=9, episodes=range(2))
    assert abs(trained.release_per_s - 0.9) < 0.3 * abs(start.release_per_s - 0.9)
    assert episode_return(Fading(), trained, 1)[0] > episode_return(Fading(), start, 1)[0]
    again = train(Fading(), task, generations=8, candidates=9, episodes=range(2))
    assert again == trained


def test_the_trained_grip_was_better_than_a_constant_one_on_unseen_friction():
    assert trained_grip(TASK).task == TASK
    results = json.loads(RECORD.read_text())["results"]
    for friction in ("lower", "higher"):
        trained, constant = (results[f"{friction}, {name}"] for name in ("trained", "constant"))
        assert trained["return"] > constant["return"]
