"""Truth of a trial: torsion, ridges under slip, numbers of each kind, labels in both planes, the camera's ways."""

from __future__ import annotations

import functools
import math

import numpy as np
import pytest
from scipy.integrate import quad

from evanesce.chain.simulate import expose, expose_light
from evanesce.contact.analytic.hertz import hertz_contact, hertz_radius
from evanesce.contact.patch import axisymmetric_state
from evanesce.contact.ridges.heightmap import RidgeRow
from evanesce.contact.ridges.ridged import with_ridges
from evanesce.contact.sliding.torsion import sliding_torque, twisted, twisted_state
from evanesce.core.states import PlateGrid, PlateLight, SurfaceState, embedded
from evanesce.dataset.config import CHANNELS, KINDS, DatasetConfig, with_size
from evanesce.dataset.design import RigPlan, trial_plan
from evanesce.dataset.job import new_job
from evanesce.dataset.labels import FrameLabeller, plate_labels
from evanesce.dataset.rigs import RigCamera, plate_grid, rig_scene, rig_with_effects
from evanesce.dataset.slip_scores import Series, alarms, choose_threshold, score
from evanesce.dataset.trial import Trial
from evanesce.evaluation.labels import label, view_geometry
from evanesce.materials.friction import InterfaceFriction, coulomb
from evanesce.optics.projection import Projection
from evanesce.render.fast.transport import render_fast
from evanesce.rig import Scene, load_scene
from evanesce.sensor.lens import form_image
from support.datasets import tiny_config
from support.rigs import small_rig

E, R, N, MU, G = 0.64, 7.1, 1.3, 0.83, 0.17
CONTACT = hertz_contact(N, R, E)
A = float(hertz_radius(N, R, E))


# --- torsion ----------------------------------------------------------------------------------------------------------


def test_full_sliding_torque_is_the_closed_form():
    # 2 pi mu integral of r^2 p dr over Hertz's ellipse: 3 pi mu N a/16
    assert sliding_torque(CONTACT, coulomb(MU)) == pytest.approx(3 * np.pi * MU * N * A / 16, rel=2e-6)
    # an even strength: 2 pi tau a^3/3; the outermost annulus contributes as the root of the rim
    assert sliding_torque(CONTACT, InterfaceFriction(0.05, 0.0)) == pytest.approx(2 * np.pi * 0.05 * A**3 / 3, rel=1e-4)


def test_a_small_twist_is_reissner_and_sagoci():
    twist = twisted(CONTACT, coulomb(MU), G, 1e-4)
    # Lubkin's compliance grows linearly in the torque at first: by 1e-4 of itself, here
    assert twist.torque / twist.angle == pytest.approx(16 / 3 * G * A**3, rel=1e-3)
    assert twist.stick_radius == pytest.approx(A, rel=1e-3)


@pytest.mark.parametrize("share", [0.23, 0.71, 0.96])
def test_traction_carries_the_torque_and_keeps_its_limits(share):
    twist = twisted(CONTACT, coulomb(MU), G, share)
    carried = 2 * np.pi * np.trapezoid(twist.radii**2 * twist.traction, twist.radii)
    assert carried == pytest.approx(twist.torque, rel=2e-4)
    assert twist.torque == pytest.approx(share * 3 * np.pi * MU * N * A / 16, rel=2e-4)
    p0 = 1.5 * N / (np.pi * A**2)
    strength = MU * p0 * np.sqrt(np.clip(1 - (twist.radii / A) ** 2, 0, None))
    slips = twist.radii > twist.stick_radius
    np.testing.assert_allclose(twist.traction[slips], strength[slips], atol=2e-3 * MU * p0)
    assert np.all(twist.traction <= strength + 2e-3 * MU * p0)
    assert np.all(twist.slip[~slips] == 0)
    assert np.all(np.diff(twist.slip[slips]) > 0)


def test_the_twist_is_lubkins_integral():
    # angle = (1/2G) integral of mu p/sqrt(r^2 - c^2) dr from c to a, by another quadrature
    twist = twisted(CONTACT, coulomb(MU), G, 0.6)
    c, p0 = twist.stick_radius, 1.5 * N / (np.pi * A**2)
    # r = sqrt(c^2 + s^2) takes the root away
    exact = quad(
        lambda s: MU * p0 * math.sqrt(max(1 - (c * c + s * s) / A**2, 0.0)) / math.sqrt(c * c + s * s),
        0.0, math.sqrt(A * A - c * c),
    )[0] / (2 * G)  # fmt: skip
    assert twist.angle == pytest.approx(exact, rel=1e-4)


def test_a_twisted_state_turns_from_x_to_y():
    grid = PlateGrid((240, 251), 0.027, (0.3, -0.2))
    twist = twisted(CONTACT, coulomb(MU), G, 0.6)
    state = twisted_state(grid, (0.21, -0.34), CONTACT, twist)
    x, y = grid.x[None, :] - 0.21, grid.y[:, None] + 0.34
    torque = float((x * state.traction[1] - y * state.traction[0]).sum()) * grid.pitch**2
    assert torque == pytest.approx(twist.torque, rel=2e-3)  # cells at the rim: (pitch/a)^1.5
    np.testing.assert_allclose(state.traction.sum((1, 2)) * grid.pitch**2, 0, atol=1e-3 * twist.torque / A)
    stuck = (state.state == SurfaceState.STICK).sum() * grid.pitch**2
    assert stuck == pytest.approx(np.pi * twist.stick_radius**2, rel=0.01)


# --- ridges -----------------------------------------------------------------------------------------------------------

ROW = RidgeRow("parallel", pitch=0.9, width=0.42, height=0.15, orientation=0.4)
GRID = PlateGrid((300, 310), 0.025, (0.1, 0.2))


def ridged(origin=(0.23, 0.11), slip=None, state=None):
    smooth = axisymmetric_state(GRID, (0.23, 0.11), CONTACT, law="hertz")
    from dataclasses import replace

    smooth = replace(smooth, slip=slip, state=state, traction=None if slip is None else slip * 0.1)
    return smooth, with_ridges(smooth, ROW, E, origin=origin)


def test_ridges_carry_the_force_on_less_area():
    smooth, found = ridged()
    assert found.pressure.sum() * GRID.pitch**2 == pytest.approx(N, rel=1e-9)
    assert found.nominal_contact_area < 0.8 * smooth.nominal_contact_area
    assert found.pressure.max() > smooth.pressure.max()
    assert np.all(found.gap[np.asarray(found.contact_mask) >= 1] == 0)
    # crests lie where the row says, a pitch apart from the origin
    x, y = GRID.x[None, :] - 0.23, GRID.y[:, None] - 0.11
    distance = ROW.locate(x, y)[1]
    in_contact = np.asarray(found.contact_mask) > 0.5
    assert np.abs(distance[in_contact]).max() < 0.5 * ROW.pitch
    assert np.abs(distance[in_contact]).mean() < np.abs(distance).mean() * 0.8


def test_ridges_move_with_the_skin_and_stay_where_it_sticks():
    along = np.zeros((2, *GRID.shape))
    _, rest = ridged(slip=along)
    shift = np.array([12, -7]) * GRID.pitch  # whole cells, so that the pattern must come back exactly
    along[0], along[1] = shift[0], shift[1]
    smooth, moved = ridged(slip=along)
    _, same = ridged(origin=(0.23 + shift[0], 0.11 + shift[1]), slip=np.zeros_like(along))
    in_contact = np.asarray(smooth.contact_mask) > 0
    np.testing.assert_allclose(moved.contact_mask, same.contact_mask, atol=1e-9)
    np.testing.assert_allclose(moved.pressure[in_contact], same.pressure[in_contact], rtol=1e-9, atol=1e-12)
    assert np.abs(np.asarray(moved.contact_mask) - np.asarray(rest.contact_mask)).max() > 0.9
    half = np.zeros_like(along)
    half[:, :, 160:] = along[:, :, 160:]
    _, part = ridged(slip=half)
    np.testing.assert_array_equal(part.contact_mask[:, :160], rest.contact_mask[:, :160])


@pytest.mark.parametrize("pattern", ["parallel", "whorl"])
@pytest.mark.parametrize("pitch", [0.5, 1.2])
def test_ridges_carry_what_the_smooth_contact_carries(pattern, pitch):
    """No force appears in a twist, strength stays mu N, and where it sticks traction stays below strength."""
    friction = InterfaceFriction(0.03, 0.5)
    smooth = twisted_state(GRID, (0.23, 0.11), CONTACT, twisted(CONTACT, friction, G, 0.7))
    row = RidgeRow(pattern, pitch=pitch, width=0.5 * pitch, height=0.15, orientation=0.4)
    found = with_ridges(smooth, row, E, origin=(0.4, -0.1))
    cell = GRID.pitch**2
    assert np.abs(found.traction.sum((1, 2))).max() * cell < 1e-3 * 0.7 * N
    full = friction.tau0 * np.pi * A**2 + friction.alpha * N
    assert found.strength.sum() * cell == pytest.approx(full, rel=2e-3)
    assert found.pressure.sum() * cell == pytest.approx(N, rel=2e-3)
    traction, strength = np.hypot(*found.traction), np.asarray(found.strength)
    assert np.all(traction <= strength * (1 + 1e-3) + 1e-9)
    outside = np.asarray(found.contact_mask) == 0
    assert not traction[outside].any()
    assert not strength[outside].any()


# --- trials -----------------------------------------------------------------------------------------------------------

ALONG = KINDS[:7]  # those that move in two directions: test_dataset_motion.py
CONFIG = tiny_config(
    kinds=dict.fromkeys(ALONG, 1.0),
    trial={"frames": 40, "frame_rate_hz": 30.0},
    labels={"grid_samples": 160, "grid_size_mm": 14.0},
    programme={
        "press_time_s": {"uniform": (0.2, 0.3)},
        "hold_time_s": {"constant": 0.1},
        "speed_mm_per_s": {"uniform": (2.0, 4.0)},
        "distance_mm": {"uniform": (1.9, 2.0)},
    },
)


@functools.cache
def trial_of(kind: str, smooth: bool = False) -> Trial:
    number = next(
        i for i in range(200)
        if (p := trial_plan(CONFIG, 8, i)).kind == kind and (not p.finger.pattern) == smooth
    )  # fmt: skip
    plan = trial_plan(CONFIG, 8, number)
    rig = rig_with_effects(rig_scene(small_rig(), plan.rig, plan.finger, CONFIG), plan.rig.seed)
    return Trial(plan, CONFIG, rig.scene, plate_grid(rig.scene, CONFIG))


@pytest.mark.parametrize("kind", ALONG)
def test_numbers_agree_with_the_fields(kind):
    trial = trial_of(kind)
    cell = trial.grid.pitch**2
    for i in range(1, len(trial), 5):
        truth = trial.truth(i)
        s = truth.scalars
        if truth.state is None:
            assert kind in ("release", "change")
            assert s["Fz_N"] == 0
            continue
        state = truth.state
        assert state.pressure.sum() * cell == pytest.approx(s["Fz_N"], rel=1e-6)
        got = state.traction.sum((1, 2)) * cell
        np.testing.assert_allclose(got, [s["Fx_N"], s["Fy_N"]], atol=2e-3 * s["Fz_N"])
        assert s["nominal_area_mm2"] == pytest.approx(np.asarray(state.contact_mask).sum() * cell, rel=1e-9)
        assert 0 <= s["real_area_mm2"] <= s["nominal_area_mm2"] * (1 + 1e-12)
        assert 0 <= s["stick_ratio"] <= 1
        assert -1e-9 <= s["margin"] <= 1 + 1e-6
        x, y = state.grid.x[None, :] - s["centre_x_mm"], state.grid.y[:, None] - s["centre_y_mm"]
        torque = (x * state.traction[1] - y * state.traction[0]).sum() * cell
        assert torque == pytest.approx(s["torque_N_mm"], rel=1e-9, abs=1e-12)
        if kind == "rotation" and s["margin"] > 0:
            # of the twist in closed form, as far as cells tell the steep stress at the rim of what still sticks
            wanted = s["margin"] * sliding_torque(trial._contact(s["Fz_N"]), trial._friction)
            assert torque == pytest.approx(wanted, rel=0.02 if s["margin"] > 0.1 else 0.13)
        stick, slip = ((state.state == value).sum() for value in (SurfaceState.STICK, SurfaceState.SLIP))
        assert s["stick_ratio"] == pytest.approx(stick / (stick + slip), rel=1e-12)
        traction = np.hypot(*state.traction)
        held = state.state == SurfaceState.STICK
        assert np.all(traction[held] <= np.asarray(state.strength)[held] * (1 + 1e-3) + 1e-3 * state.strength.max())
        # ridges slip at their strength, as the smooth contact does: at each place the share is the same
        smooth = trial._smooth(i)
        slips, under = state.state == SurfaceState.SLIP, np.asarray(smooth.strength) > 0
        share = np.hypot(*smooth.traction)[slips & under] / np.asarray(smooth.strength)[slips & under]
        np.testing.assert_allclose(
            traction[slips & under], share * np.asarray(state.strength)[slips & under], rtol=0.02
        )
        moves = np.hypot(*truth.slip_velocity)
        assert np.all(moves[state.state == SurfaceState.SLIP] >= 1e-3)
        assert np.all(moves[held] < 1e-3)


@pytest.mark.parametrize("kind", ALONG)
def test_only_a_slide_slips_as_a_whole(kind):
    trial = trial_of(kind)
    ratios = np.array([trial.truth(i).scalars["stick_ratio"] for i in range(len(trial))])
    held = np.array([trial.truth(i).state is not None for i in range(len(trial))])
    if kind == "slide":
        assert trial.onset_first_slip_s <= trial.onset_gross_slip_s
        first = round(trial.onset_gross_slip_s * 30)
        assert ratios[first] == 0
        assert np.all(ratios[:first] > 0)
    else:
        assert math.isnan(trial.onset_gross_slip_s)
        assert ratios[held].min() > 0
    if kind in ("load_stop", "ramp", "release", "change"):
        assert math.isnan(trial.onset_first_slip_s)
        assert np.all(ratios[held] == 1)
    if kind == "rotation":
        assert trial.truth(len(trial) - 1).scalars["margin"] == pytest.approx(
            trial.plan.programme["rotation_share"], rel=1e-3
        )


def test_slip_is_the_sum_of_its_velocity():
    trial = trial_of("slide", smooth=True)
    middle = None
    total = 0.0
    for i in range(1, len(trial)):
        truth = trial.truth(i)
        # follow the contact's middle: there the skin slips last, and the skin's own frame is the contact's
        s = truth.scalars
        angle = math.radians(trial.plan.programme["direction_deg"])
        x0, y0 = trial._origin(0)
        along = np.array([math.cos(angle), math.sin(angle)])
        x, y = np.array([x0, y0]) + s["tip_displacement_mm"] * along
        at = tuple(round(float(v)) for v in truth.state.grid.index(x, y))
        total += float(along @ truth.slip_velocity[:, at[0], at[1]]) / 30.0
        middle = float(along @ np.asarray(truth.state.slip)[:, at[0], at[1]])
    assert middle > 0.5
    assert total == pytest.approx(middle, rel=0.02)


def test_a_sliding_contact_slips_at_the_drives_speed():
    trial = trial_of("slide", smooth=True)
    p = trial.plan.programme
    end = p["press_time_s"] + p["hold_time_s"] + p["distance_mm"] / p["speed_mm_per_s"]
    late = [i for i in range(len(trial)) if trial.onset_gross_slip_s + 0.06 < trial.time[i] < end - 0.04]
    assert late
    truth = trial.truth(late[-1])
    speed = np.hypot(*truth.slip_velocity)[np.asarray(truth.state.state) == SurfaceState.SLIP]
    # weakening still moves the shaft a little
    assert np.median(speed) == pytest.approx(p["speed_mm_per_s"], rel=0.1)


# --- labels -----------------------------------------------------------------------------------------------------------


def test_labels_in_the_frame_are_those_of_the_truth_room():
    trial = trial_of("slide")
    truth = trial.truth(20)
    scene = trial.scene
    labeller = FrameLabeller(scene, trial.grid)
    found = labeller.labels(truth, 0.5)
    geometry = view_geometry(Projection.of(scene.camera, scene.plate))
    exact = label(truth.state, geometry, supersample=labeller.supersample)
    # OpenCV rounds a sample position to 1/32 of a cell; the other way it moves an edge by as much, in few samples
    np.testing.assert_allclose(found.whole("contact_mask"), exact.mask, atol=0.01)
    np.testing.assert_allclose(found.whole("pressure"), exact.pressure, atol=0.01 * exact.pressure.max())
    assert found.whole("contact_mask").sum() == pytest.approx(exact.mask.sum(), rel=1e-3)
    here = found.whole("contact_mask") > 0
    np.testing.assert_array_equal(found.whole("state")[here], exact.surface_state[here])
    near = ~np.isnan(found.whole("gap"))
    np.testing.assert_allclose(found.whole("gap")[near], exact.gap[near], rtol=0.01, atol=1e-4)
    # traction summed over what pixels see is the force
    force = (
        (found.whole("traction.x") * geometry.pixel_area).sum(),
        (found.whole("traction.y") * geometry.pixel_area).sum(),
    )
    wanted = truth.scalars["Fx_N"], truth.scalars["Fy_N"]
    np.testing.assert_allclose(force, wanted, atol=0.03 * math.hypot(*wanted))


def test_labels_on_the_plate_are_the_state_itself():
    trial = trial_of("slide")
    truth = trial.truth(20)
    box = plate_labels(truth, trial.grid, 0.5)
    assert box.shape == trial.grid.shape
    state = embedded(truth.state, trial.grid)
    np.testing.assert_array_equal(box.whole("pressure"), np.float32(state.pressure))
    np.testing.assert_array_equal(box.whole("slip_velocity.y"), np.float32(state.slip_velocity[1]))
    kept = ~np.isnan(box.whole("gap"))
    np.testing.assert_array_equal(box.whole("gap")[kept], np.float32(state.gap)[kept])
    assert set(box.channels) == set(CHANNELS)
    # the margin is kept around the contact
    rows = np.flatnonzero((np.asarray(state.contact_mask) > 0).any(axis=1))
    assert rows[0] - box.row == math.ceil(0.5 / trial.grid.pitch)


def test_a_lifted_finger_has_no_labels():
    trial = trial_of("release")
    truth = trial.truth(len(trial) - 1)
    assert truth.state is None
    # Without contact there is no slip: a detector must not learn a lifted finger as a slip.
    assert (truth.scalars["Fz_N"], truth.scalars["margin"], truth.scalars["stick_ratio"]) == (0.0, 0.0, 1.0)
    box = FrameLabeller(trial.scene, trial.grid).labels(truth, 0.5)
    assert box.channels["gap"].size == 0
    assert box.shape == (48, 64)


def test_labels_follow_a_state_on_a_moved_grid():
    from dataclasses import replace

    trial = trial_of("slide")
    truth = trial.truth(20)
    labeller = FrameLabeller(trial.scene, trial.grid)
    grid = truth.state.grid
    moved = PlateGrid(grid.shape, grid.pitch, (grid.centre[0] + 0.31, grid.centre[1] - 0.22))
    there = labeller.labels(replace(truth, state=replace(truth.state, grid=moved)), 0.5)
    exact = label(replace(truth.state, grid=moved), view_geometry(Projection.of(trial.scene.camera, trial.scene.plate)))
    assert there.whole("contact_mask").sum() == pytest.approx(exact.mask.sum(), rel=2e-3)
    assert np.abs(there.whole("contact_mask") - exact.mask).max() < 0.05  # another count of sub-samples


# --- the camera -------------------------------------------------------------------------------------------------------


def test_behind_the_lens_is_the_general_chain():
    effects = {
        "vignetting": {"k": 0.2},
        "hot_pixels": {"fraction": 0.01, "rate_e_per_s": 1e5},
        "black_level": {"offset_DN": 3.0},
    }
    scene = small_rig().model_copy(update={"effects": effects})
    rng = np.random.default_rng(4)
    view = Projection.of(scene.camera, scene.plate).ideal_view()
    light = PlateLight(
        radiance=2e-6 * rng.random(view.shape), variance=np.zeros(view.shape), focal_px=view.focal_px,
        principal_point=view.principal_point,
    )  # fmt: skip
    _, exact = expose(scene, light, seed=9, time_s=0.4, index=37)
    seen = form_image(light, scene.camera, scene.plate)
    found = expose_light(scene, seen, seed=9, time_s=0.4, index=37)
    np.testing.assert_array_equal(found.raw, exact.raw)
    np.testing.assert_array_equal(found.data, exact.data)


@pytest.mark.parametrize(
    ("effects", "way"),
    [
        ({}, "fast"),
        ({"modulus": {"relative": 0.1}}, "fast"),
        ({"vignetting": {"k": 0.1}}, "fast"),
        ({"specks": {"per_cm2": 100.0}}, "fast"),
        ({"off_axis_load": {"shift_x_mm_per_N": 0.1}}, "fast"),
        ({"rolling_shutter": {"ripple": 0.1}}, "fast"),
    ],
)
def test_the_camera_takes_the_fastest_way_that_is_right(effects, way):
    scene = small_rig().model_copy(update={"effects": effects})
    assert RigCamera(rig_with_effects(scene, 3), 3).method == way


FOLDED = [
    {},
    {"specks": {"per_cm2": 300.0}, "scratch": {"relative_radiance": 0.3}, "vignetting": {"k": 0.4}},
    {"defocus": {"blur_um": 6.0, "corner_blur_um": 9.0}, "sensor_dust": {"per_cm2": 2000.0}, "residue_film": {
        "relative_radiance": 0.1, "middle_mm": [1.0, 0.5], "radius_mm": 2.0}},
    {"ambient_light": {"radiance_W_per_mm2_sr": 2e-7}, "rolling_shutter": {"ripple": 0.3, "readout_ms": 9.0},
     "vignetting": {"k": 0.2}},
    {"hot_pixels": {"fraction": 0.02, "rate_e_per_s": 1e7}, "black_level": {"offset_DN": 40.0},
     "led_edge_reflections": {"relative_radiance": 0.1}},
    {"saturation": {"well_loss": 0.6, "knee": 0.2, "bloom": 0.3}, "tone_curve": {"gamma": 0.1}},
    {"off_axis_load": {"shift_x_mm_per_N": 0.31, "shift_y_mm_per_N": -0.17}, "compression": {"step_DN": 6.0}},
    {"plate_haze": {"top_share": 0.01, "bottom_share": 0.01}, "backdrop": {"reflectance": 0.2}, "led_spill": {
        "share": 0.1}},
    {"lateral_glow": {"length_mm": 0.6, "share": 0.5}},
]  # fmt: skip


@functools.cache
def seen_trial() -> tuple[Scene, Trial]:
    """Return the thesis's rig as a data set of 320 x 240 px sees it, and a slide."""
    job = new_job(load_scene("thesis"), with_size(DatasetConfig(), "320x240"), frames=80, seed=8)
    plan = next(p for i in range(200) if (p := trial_plan(job.config, 8, i)).kind == "slide" and p.finger.pattern)
    scene = rig_scene(job.scene, RigPlan(0, 3, {}, {}), plan.finger, job.config)
    return scene, Trial(plan, job.config, scene, plate_grid(scene, job.config))


@pytest.mark.parametrize("effects", FOLDED, ids=lambda effects: "+".join(effects) or "none")
def test_effects_folded_into_the_fast_camera_are_those_of_the_general_chain(effects):
    scene, trial = seen_trial()
    camera = RigCamera(rig_with_effects(scene.model_copy(update={"effects": effects}), 3), 3)
    assert camera.method == "fast"
    touched = camera.contact(trial.truth(20).state, 5, 0.6)
    light = render_fast(camera.scene, embedded(touched, trial.grid))
    count, blocks = 8, (60, 4, 80, 4)
    fast, general, variance = np.zeros((60, 80)), np.zeros((60, 80)), np.zeros((60, 80))
    for i in range(count):
        found = camera.frame(touched, index=i, time_s=0.6, with_raw=False, grid=trial.grid).data.astype(float)
        exact = expose(camera.scene, light, seed=3, time_s=0.6, index=1000 + i)[1].data.astype(float)
        found, exact = (frame.reshape(blocks).mean(axis=(1, 3)) for frame in (found, exact))
        fast, general, variance = fast + found / count, general + exact / count, variance + exact**2 / count
    noise = np.sqrt(np.maximum(variance - general**2, 0.0) * 2.0 / (count - 1))
    # Means over 4 x 4 pixels: two noises of eight frames, and 2.5 % of the white at edges, after a curve that is steep
    # in the dark.
    excess = np.abs(fast - general) - 5.0 * noise - 0.025 * general.max()
    assert excess.max() < 0.5
    assert abs(float((fast - general).mean())) < 0.003 * float(general.max())
    if effects:  # seen at all: another frame than that of the rig without them
        plain = RigCamera(rig_with_effects(scene, 3), 3).frame(touched, index=0, time_s=0.6, with_raw=False).data
        assert np.abs(plain.reshape(blocks).mean(axis=(1, 3)) - general).max() > 2.0


def test_effects_that_refuse_a_finger_are_left_out_and_named():
    plan = trial_of("slide", smooth=True).plan
    scene = rig_scene(small_rig(), plan.rig, plan.finger, CONFIG)
    effects = {"ridge_height": {"relative": 0.2}, "modulus": {"relative": 0.2}}
    rig = rig_with_effects(scene.model_copy(update={"effects": effects}), 3)
    assert rig.left_out == ("ridge_height",)
    assert list(rig.scene.effects) == ["modulus"]
    assert rig.scene.finger.modulus_factor == pytest.approx(1.2)


# --- scores -----------------------------------------------------------------------------------------------------------


def test_scores_by_hand():
    time = np.arange(10) / 10.0
    slide = Series(
        time, np.array([0, 0, 0, 0, 1, 3, 4, 5, 5, 5.0]), np.r_[np.ones(4), 0.9, 0.7, 0.3, 0, 0, 0], 0.4, 0.7
    )
    quiet = Series(time, np.array([0, 0, 4, 4, 0, 0, 0, 0, 0, 0.0]), np.ones(10), math.nan, math.nan)
    assert list(alarms(slide.evidence, 2.0)) == [6]
    found = score([slide, quiet], 2.0)
    assert (found.detected, found.slides) == (1.0, 1)
    assert found.latency_s == pytest.approx(0.2)
    assert found.lead_s == pytest.approx(0.1)
    assert found.minutes == pytest.approx(1.4 / 60)
    assert found.false_per_minute == pytest.approx(1 / (1.4 / 60))
    assert choose_threshold([slide, quiet], 1.0) >= 4.0  # seconds bound no rate: no alarm
    # one alarm is a rate of up to 3.3 (Poisson, 84 %) a time without slip
    assert choose_threshold([slide, quiet], 3.2 / found.minutes) >= 4.0
    assert choose_threshold([slide, quiet], 3.4 / found.minutes) < 4.0
    assert score([slide, quiet], 4.5).detected == 0.0
