"""A rolling shutter sees the trial's own motion: outlines move, ridges stay where they stick, labels with the frame."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from evanesce.contact.analytic.hertz import hertz_contact
from evanesce.contact.patch import axisymmetric_state
from evanesce.core.errors import InputError
from evanesce.core.states import PlateGrid, embedded
from evanesce.dataset.config import KINDS
from evanesce.dataset.design import rig_plan
from evanesce.dataset.encode import decode_exr
from evanesce.dataset.job import new_job
from evanesce.dataset.produce import Producer
from evanesce.dataset.shutter import Motion, advanced, smeared
from evanesce.effects.contact.rolling_skew import lateness
from support.datasets import tiny_config
from support.rigs import small_rig

GRID = PlateGrid((201, 190), 0.03, (0.2, -0.1))
CENTRE, VELOCITY = (0.3, -0.2), (21.0, -8.0)
STATE = axisymmetric_state(GRID, CENTRE, hertz_contact(0.8, 7.1, 0.7), law="hertz")


def row_centre(mask, row):
    return float(mask[row] @ GRID.x) / float(mask[row].sum())


def test_an_outline_is_sheared_by_its_velocity_and_grows_about_its_middle():
    late = (GRID.y[:, None] - 0.1) * 1e-3 + np.zeros(GRID.shape)  # a millisecond a millimetre
    seen = advanced(STATE, Motion(CENTRE, (21.0, 0.0), 0.0), late)
    for row in (70, 100, 130):
        shift = row_centre(np.asarray(seen.contact_mask), row) - row_centre(np.asarray(STATE.contact_mask), row)
        assert shift == pytest.approx(21.0 * late[row, 0], abs=2e-3)
    grown = advanced(STATE, Motion(CENTRE, (0.0, 0.0), 3.0), 0.01)
    areas = [float(np.asarray(s.contact_mask).sum()) for s in (STATE, grown)]
    assert areas[1] / areas[0] == pytest.approx((1 + 3.0 * 0.01) ** 2, rel=1e-3)


def test_slip_goes_on_at_its_velocity():
    rate = np.stack([np.full(GRID.shape, 5.0), np.full(GRID.shape, -2.0)])
    state = replace(STATE, slip=0.1 + 0 * rate, slip_velocity=rate)
    seen = advanced(state, Motion(CENTRE, (0.0, 0.0), 0.0), 0.004)
    np.testing.assert_allclose(seen.slip, 0.1 + 0.004 * rate)


def test_an_edge_is_smeared_over_the_way_of_its_exposure():
    """Of the exposure T an edge x = x0 + v t leaves the share clip(1/2 + (x0 - x)/(v T)) behind it in contact."""
    exposure, speed = 0.006, 25.0
    way = exposure * speed

    def at(late):
        mask = np.clip(0.5 + (0.4 + speed * late - GRID.x[None, :]) / GRID.pitch, 0.0, 1.0)
        return replace(STATE, contact_mask=mask, gap=np.where(mask >= 1, 0.0, 0.02))

    seen = smeared(at(np.zeros(GRID.shape)), at, np.zeros(GRID.shape), exposure, way, way / 7.5)
    exact = np.clip(0.5 + (0.4 - GRID.x) / way, 0.0, 1.0)
    # eight moments on cells of a fifth of the way
    np.testing.assert_allclose(seen.contact_mask[5], exact, atol=0.1)
    assert np.asarray(seen.contact_mask)[5].sum() == pytest.approx(exact.sum(), abs=0.02)
    still = smeared(STATE, lambda late: STATE, np.zeros(GRID.shape), exposure, 0.0, 0.01)
    assert still is STATE


def slides(effects=None, ridged=1.0, exposure_ms=2.0, speed=3.0):
    config = tiny_config(
        kinds={kind: float(kind == "slide") for kind in KINDS},
        trial={"frames": 40, "frame_rate_hz": 30.0},
        programme={
            "press_time_s": {"constant": 0.2}, "hold_time_s": {"constant": 0.15}, "reversals": {"constant": 0.0},
            "speed_mm_per_s": {"constant": speed}, "direction_deg": {"constant": 20.0},
            "normal_force_N": {"constant": 0.8}, "distance_mm": {"constant": 0.5 * speed},
        },
        friction={"levels": 1, "friction_coefficient": {"constant": 0.6}, "area_left": {"constant": 1.0}},
        finger={"ridged_share": ridged, "count": 1, "shaft_stiffness_N_per_mm": {"constant": 20.0}},
        rig={"count": 1, "draw": {}},
        labels={"grid_samples": 160, "grid_size_mm": 12.0},
    )  # fmt: skip
    scene = small_rig().model_copy(update={"effects": effects or {}})
    scene = scene.model_copy(update={"camera": scene.camera.model_copy(update={"exposure_ms": exposure_ms})})
    return Producer(new_job(scene, config, frames=40, seed=11))


def phases(trial):
    """Return a frame at rest under load, one in which the core sticks while the tip moves, one of gross slip."""
    gross = round(trial.onset_gross_slip_s * 30)
    moving = next(i for i in range(gross) if math.hypot(*trial.motion(i).velocity) > 0.5)
    return 8, moving + 1, gross + 4


def test_ridges_stay_where_they_stick_and_move_with_the_skin():
    trial = slides().trial(0).trial
    rest, stuck, gross = phases(trial)
    late = 0.01
    for i, skin in ((rest, 0.0), (stuck, 0.0), (gross, None)):
        motion = trial.motion(i)
        now, later = (np.asarray(trial.state(i, t).contact_mask, dtype=float) for t in (0.0, late))
        grid = trial.part(i)
        x, y = grid.x[None, :] - motion.centre[0], grid.y[:, None] - motion.centre[1]
        core = np.hypot(x, y) < 0.5 * float(trial._slide.frames[i].contact.contact_radius)
        if skin == 0.0:
            np.testing.assert_allclose(later[core], now[core], atol=0.03)
        else:
            speed = math.hypot(*motion.velocity)
            assert speed == pytest.approx(3.0, rel=0.1)
            assert np.abs(later - now)[core].max() > 0.2
    # the frame a thirtieth of a second later is told better with the motion than without
    after, now, later = (
        np.asarray(embedded(state, trial.grid).contact_mask, dtype=float)
        for state in (trial.state(gross + 1), trial.state(gross, 0.0), trial.state(gross, 1 / 30))
    )
    without, told = (np.abs(mask - after).sum() for mask in (now, later))
    assert told < 0.3 * without


def test_frames_and_their_labels_are_skewed_together_and_only_in_motion():
    plain, rolling = slides(), slides({"rolling_skew": {"readout_ms": 300.0}})
    rest, _, gross = phases(plain.trial(0).trial)
    for i in (rest, gross):
        one, other = plain.record(i).members, rolling.record(i).members
        same = {name: one[name] == other[name] for name in ("frame.png", "mask.png", "plate.exr")}
        assert same == {"frame.png": i == rest, "mask.png": i == rest, "plate.exr": True}
        a, b = (json.loads(m["json"])["scalars"] for m in (one, other))
        assert a == b
    # the light moves as the labels do: both centroids, by the velocity times the lateness of their rows
    current = rolling.trial(0)
    scene = current.ready.camera.scene
    late = lateness(scene, current.ready.grid, 0.3)
    motion = current.trial.motion(gross)
    shifts = []
    for name in ("contact_mask", "pressure"):
        found = []
        for producer in (plain, rolling):
            box = decode_exr(producer.record(gross).members["labels.exr"])[0].whole(name)
            found.append((box * np.arange(box.shape[1])).sum() / box.sum())
        shifts.append(found[1] - found[0])
    at = [round(float(v)) for v in current.ready.grid.index(*motion.centre)]
    wanted = motion.velocity[0] * late[at[0], at[1]] * scene.camera.scale_px_per_mm
    assert abs(wanted) > 0.3
    np.testing.assert_allclose(shifts, wanted, rtol=0.25)


def test_an_exposure_smears_what_moves_without_a_rolling_shutter_and_leaves_the_labels():
    """A gross slide of 12 mm/s over 30 ms: the light is the mean of outlines up to 0.18 mm before and after."""
    fast, slow = (slides(ridged=0.0, exposure_ms=e, speed=12.0) for e in (2.0, 30.0))
    trial = slow.trial(0).trial
    rest, gross = 8, next(i for i in range(40) if math.hypot(*trial.motion(i).velocity) > 11.5) + 2
    for i in (rest, gross):
        current = slow.trial(0)
        state = current.trial.truth(i).state
        lit, visible = slow._visible(current, i, state, True)
        assert visible is state
        assert (lit is state) == (i == rest)
        assert fast.record(i).members["mask.png"] == slow.record(i).members["mask.png"]
    # between the outlines at the first and the last moment of the exposure a place is in contact for half of it
    ends = [np.asarray(trial.state(gross, t).contact_mask, dtype=float) for t in (-0.0125, 0.0125)]
    mask, once = np.asarray(lit.contact_mask), np.abs(ends[0] - ends[1]) > 0.99
    assert once.sum() * trial.part(gross).pitch ** 2 > 0.2
    assert mask[once].mean() == pytest.approx(0.5, abs=0.06)
    assert mask[np.minimum(*ends) > 0.99].min() > 0.99
    assert mask[np.maximum(*ends) < 0.01].max() < 0.2


def test_motion_is_the_trials_and_no_other():
    config = tiny_config(randomisation={"probability": 1.0})
    drawn = rig_plan(config, 4, 0).effects["rolling_skew"]
    assert drawn["velocity_x_mm_per_s"] == drawn["velocity_y_mm_per_s"] == drawn["growth_per_s"] == 0.0
    assert drawn["readout_ms"] > 0
    scene = small_rig().model_copy(update={"effects": {"rolling_skew": {"velocity_x_mm_per_s": 4.0}}})
    with pytest.raises(InputError, match=r"effects\.rolling_skew: the motion is each trial's own.*readout_ms alone"):
        new_job(scene, tiny_config(), frames=6, seed=1)
