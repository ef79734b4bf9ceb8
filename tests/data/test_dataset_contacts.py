"""Tilted fingers, human prints and liquids in data sets."""

from __future__ import annotations

import math

import numpy as np
import pytest
from pydantic import ValidationError

from evanesce.contact.analytic.hertz import hertz_contact
from evanesce.contact.halfspace.resolved import resolved_state
from evanesce.contact.patch import axisymmetric_state
from evanesce.contact.ridges.fingerprint import fingerprint_depth
from evanesce.contact.ridges.print_row import PrintRow
from evanesce.contact.ridges.ridged import with_ridges
from evanesce.core.errors import InputError
from evanesce.core.states import PlateGrid
from evanesce.dataset.config import KINDS, DatasetConfig, load_config, with_size
from evanesce.dataset.design import trial_plan
from evanesce.dataset.job import new_job
from evanesce.dataset.planar_trial import trial_of
from evanesce.dataset.produce import Producer
from evanesce.dataset.rigs import plate_grid, rig_scene, rig_with_effects
from evanesce.dataset.trial import Trial
from evanesce.rig import Fingerprint, load_scene

PRINT = {
    "ridged_share": 1.0, "count": 1, "pattern": {"constant": "print_loop"},
    "ridge_pitch_um": {"constant": 500.0}, "ridge_height_um": {"constant": 60.0},
}  # fmt: skip


def config_of(**sections: dict) -> DatasetConfig:
    data = {
        "kinds": {**dict.fromkeys(KINDS, 0.0), "slide": 1.0},
        "randomisation": {"probability": 0.0},
        "rig": {"count": 1, "draw": {"camera.exposure_ms": {"constant": 6.0}}},
        "finger": {"ridged_share": 0.0, "count": 1},
        "programme": {"normal_force_N": {"constant": 1.0}},
        **sections,
    }
    return with_size(DatasetConfig.model_validate(data), "320x240")


def trial(config: DatasetConfig) -> Trial:
    plan = trial_plan(config, 8, 0)
    whole = config.model_copy(update={"camera": DatasetConfig().camera})
    rig = rig_with_effects(rig_scene(load_scene("thesis"), plan.rig, plan.finger, whole, plan.liquid), plan.rig.seed)
    return trial_of(plan, whole, rig.scene, plate_grid(rig.scene, whole))


def test_a_print_touches_where_the_half_space_says():
    """Two scales against all cells solved at once: the same ridges touch, on about the same area."""
    skin = Fingerprint(pattern="loop", ridge_period_um=500.0, ridge_height_um=60.0, pore_spacing_um=0.0, seed=3)
    grid, modulus, radius, force = PlateGrid((180, 180), 0.03), 0.6, 7.5, 0.5
    x, y = np.meshgrid(grid.x, grid.y)
    heights = (x**2 + y**2) / (2 * radius) + fingerprint_depth(skin, x, y)[0]
    whole = np.asarray(resolved_state(grid, heights, modulus, force, law="halfspace").contact_mask) > 0.5
    smooth = axisymmetric_state(grid, (0.0, 0.0), hertz_contact(force, radius, modulus), law="hertz")
    two = np.asarray(with_ridges(smooth, PrintRow.of(skin), modulus, origin=(0.0, 0.0)).contact_mask) > 0.5
    assert (two & whole).sum() / (two | whole).sum() > 0.7
    assert two.sum() == pytest.approx(whole.sum(), rel=0.15)


def test_a_print_stays_on_the_glass_while_it_sticks():
    found = trial(config_of(finger=PRINT))
    truths = [found.truth(i) for i in range(len(found))]
    pressed = next(i for i, t in enumerate(truths) if t.scalars["Fz_N"] > 0.99)
    stuck = max(i for i, t in enumerate(truths[:40]) if i > pressed and t.scalars["stick_ratio"] > 0.97)
    a, b = (np.asarray(truths[i].state.contact_mask) for i in (pressed + 1, stuck))
    x, y = found.centre(pressed + 1)
    for mask, truth in ((a, truths[pressed + 1]), (b, truths[stuck])):
        assert 0.3 < mask.sum() * truth.state.grid.pitch**2 / (math.pi * 2.2**2) < 0.95
    grids = [truths[i].state.grid for i in (pressed + 1, stuck)]
    rows, cols = (np.arange(-30, 31) for _ in range(2))

    def core(mask, grid):
        row, col = (round(float(v)) for v in grid.index(np.array(x), np.array(y)))
        return mask[np.ix_(row + rows, col + cols)]

    np.testing.assert_allclose(core(a, grids[0]), core(b, grids[1]), atol=0.05)


def test_a_tilted_finger_shows_the_side_of_its_skin():
    """Rings about the apex lie R times the tilt from the contact's middle, away from the lean."""
    finger = {
        "ridged_share": 1.0, "count": 1, "pattern": {"constant": "concentric"},
        "ridge_pitch_um": {"constant": 1000.0}, "ridge_height_um": {"constant": 150.0},
        "tilt_deg": {"constant": 8.0}, "tilt_direction_deg": {"constant": 30.0},
    }  # fmt: skip
    found = trial(config_of(finger=finger))
    state = found.truth(20).state
    arc = 7.5 * math.radians(8.0)
    apex = np.array(found._origin(0)) - arc * np.array([math.cos(math.radians(30.0)), math.sin(math.radians(30.0))])
    x, y = np.meshgrid(state.grid.x - apex[0], state.grid.y - apex[1])
    distance, touches = np.hypot(x, y), np.asarray(state.contact_mask) > 0.5
    crest = np.abs((distance + 0.5) % 1.0 - 0.5)  # furrow on the apex, crests at half pitches
    inside = np.hypot(state.grid.x[None, :] - found.centre(20)[0], state.grid.y[:, None] - found.centre(20)[1]) < 1.5
    assert crest[touches & inside].mean() > crest[~touches & inside].mean() + 0.1
    marked = trial(config_of(finger=finger, markers={"pitch_mm": 1.0})).marked_skin(20)
    np.testing.assert_allclose(marked.origin, apex, atol=1e-12)


def test_a_liquid_fills_its_volume_and_leaves_the_labels():
    dry = Producer(new_job(load_scene("thesis"), config_of(), frames=80, seed=5)).make(8, exposed=True)
    drop = {"share": 1.0, "volume_uL": {"constant": 0.05}, "viscosity_mPa_s": {"constant": 0.01}}
    maker = Producer(new_job(load_scene("thesis"), config_of(liquid=drop), frames=80, seed=5))
    wet = maker.make(8, exposed=True)
    state = maker.trial(0).trial.truth(8).state
    outside = np.asarray(state.contact_mask) < 1.0
    held = float((np.asarray(state.gap) * np.asarray(state.wetted))[outside].sum()) * state.grid.pitch**2
    assert held == pytest.approx(0.05, rel=0.03)
    np.testing.assert_array_equal(dry.mask, wet.mask)
    assert dry.meta["liquid"] == {}
    assert wet.meta["liquid"]["volume_uL"] == 0.05
    # a rim beside the contact is lit
    brighter = wet.picture.data.astype(int) - dry.picture.data > 30
    assert (brighter & (wet.mask < 2)).sum() > 500
    assert (brighter & (wet.mask >= 2)).sum() < 0.02 * (wet.mask >= 2).sum()


def test_an_oil_carries_the_finger():
    """A film far thicker than the roughness shears at viscosity times speed over thickness: friction almost gone."""
    oil = {"share": 1.0, "volume_uL": {"constant": 0.1}, "viscosity_mPa_s": {"constant": 500.0}}
    for motion in ({}, {"turn": 1.0}):
        margins, forces = [], []
        for liquid in ({}, oil):
            found = trial(config_of(liquid=liquid, motion=motion, friction={"dynamic_ratio": {"constant": 1.0}}))
            rows = [found.truth(i).scalars for i in range(40, 80, 4)]
            margins.append(max(row["margin"] for row in rows))
            forces.append(max(math.hypot(row["Fx_N"], row["Fy_N"]) for row in rows))
        assert min(margins) > 0.95
        assert forces[1] < 0.5 * forces[0]


def test_tilts_and_ways_that_leave_tip_or_plane_are_refused_before_the_first_frame():
    steep = {"count": 1, "tip_radius_mm": {"constant": 12.0}, "tilt_deg": {"constant": 45.0}}
    with pytest.raises(InputError, match=r"contact\.tilt_deg.*rim of the tip"):
        new_job(load_scene("thesis"), config_of(finger=steep), frames=80, seed=5)
    far = {"distance_mm": {"constant": 3.0}, "direction_deg": {"constant": 0.0}}
    straight_on = {"turn": 1.0, "turn_deg": {"constant": 10.0}}
    with pytest.raises(InputError, match=r"labels\.grid_size_mm.*ways of up to"):
        new_job(load_scene("thesis"), config_of(motion=straight_on, programme=far), frames=80, seed=5)


def test_shares_of_wet_trials():
    plans = [trial_plan(config_of(liquid={"share": 0.25}), 3, i) for i in range(128)]
    assert np.mean([bool(p.liquid) for p in plans]) == pytest.approx(0.25, abs=0.02)
    assert not any(trial_plan(config_of(), 3, i).liquid for i in range(64))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[finger]\ntilt_deg = { constant = 60.0 }\n", "finger.tilt_deg.*0 to 45 deg"),
        ("[finger]\npattern = { constant = 'print_loop' }\nridge_pitch_um = { constant = 3000.0 }\n", "100 to 2000 um"),
        ("[finger]\npattern = { constant = 'print_tent' }\n", "print_arch, print_loop, print_whorl"),
        ("[finger]\ncounterpart_radius_mm = { constant = 50.0 }\n", "counterpart_radius_mm"),
        ("[liquid]\nrefractive_index = { constant = 1.2 }\n", "liquid.refractive_index.*1.3 to 1.5"),
        ("[liquid]\nshare = 1.2\n", "liquid.share"),
    ],
)
def test_what_has_no_physics_here_is_refused(text, words, tmp_path):
    (tmp_path / "c.toml").write_text(text)
    with pytest.raises((InputError, ValidationError), match=words):
        load_config(tmp_path / "c.toml")
