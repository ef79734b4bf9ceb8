"""From scene to contact: laws, materials, grids and loading programmes, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest

from evanesce.contact.programme import press_programme
from evanesce.contact.solve import PARTS, contact_grid, contact_state, parts_of
from evanesce.core.errors import InputError
from evanesce.rig import Scene, load_scene

UGLY = {
    "finger.position_mm": [1.7, -2.3],
    "finger.tip_radius_mm": 6.3,
    "grid.samples": 500,
    "grid.size_mm": 13.7,
}


def scene(name: str = "thesis", **more: object) -> Scene:
    return load_scene(name, UGLY | {key.replace("__", "."): value for key, value in more.items()})


def test_hertz_area_of_the_thesis_materials() -> None:
    for name, intercept, slope in (("silskin_0", 0.7686, 0.0004), ("silskin_20", 0.0558, 0.0396)):
        s = scene(finger__material=name)
        for force in (0.3, 1.0, 4.7):
            state = contact_state(s, force, time_s=0.25)
            modulus = intercept + slope * force
            exact = np.pi * (0.75 * force * 6.3 / modulus) ** (2 / 3)
            assert state.nominal_contact_area == pytest.approx(exact, rel=1e-12)
            assert state.contact_mask.sum() * state.grid.pitch**2 == pytest.approx(exact, rel=1e-3)
            assert state.depth == pytest.approx((0.75 * force / (modulus * np.sqrt(6.3))) ** (2 / 3), rel=1e-12)
            assert (state.time, state.law, state.normal_force) == (0.25, "hertz", force)


def test_the_grid_lies_around_the_finger() -> None:
    grid = contact_grid(scene())
    assert grid.extent == pytest.approx((1.7 - 6.85, 1.7 + 6.85, -2.3 - 6.85, -2.3 + 6.85))
    state = contact_state(scene(), 0.2)
    row, col = np.unravel_index(np.argmax(state.pressure), grid.shape)
    assert (grid.x[col], grid.y[row]) == pytest.approx((1.7, -2.3), abs=grid.pitch)


def test_a_modulus_given_in_the_scene_replaces_the_materials_line() -> None:
    flat = contact_state(scene(contact__reduced_modulus_MPa=0.31), 2.0)
    assert flat.parameters["reduced_modulus_MPa"] == 0.31
    both = {"contact__reduced_modulus_MPa": 0.31, "contact__reduced_modulus_slope_MPa_per_N": 0.05}
    assert contact_state(scene(**both), 2.0).parameters["reduced_modulus_MPa"] == pytest.approx(0.41)


def test_each_law_answers() -> None:
    hertz = contact_state(scene(), 1.0)
    scaled = contact_state(scene(contact={"law": "scaled_hertz", "area_scale": 1.66}), 1.0)
    assert scaled.nominal_contact_area == pytest.approx(1.66 * hertz.nominal_contact_area, rel=1e-12)
    jkr = contact_state(scene(contact={"law": "jkr", "work_of_adhesion_N_per_mm": 1e-3}), 1.0)
    assert jkr.nominal_contact_area > hertz.nominal_contact_area
    null = contact_state(scene(contact={"law": "jkr", "work_of_adhesion_N_per_mm": 0.0}), 1.0)
    assert null.nominal_contact_area == pytest.approx(hertz.nominal_contact_area, rel=1e-12)
    power = contact_state(scene(contact={"law": "xydas_kao", "c_mm": 2.1, "gamma": 0.2}), 3.0)
    assert power.nominal_contact_area == pytest.approx(np.pi * (2.1 * 3.0**0.2) ** 2, rel=1e-12)


def test_ridges_of_the_scene_are_those_of_the_contact() -> None:
    ridged = contact_state(scene("thesis_ridged"), 1.0)
    smooth = contact_state(scene("thesis"), 1.0)
    assert ridged.law == "hertz+ridges"
    assert ridged.parameters["ridge_height_mm"] == pytest.approx(0.04767)
    assert 0.5 < ridged.nominal_contact_area / smooth.nominal_contact_area < 1.0
    assert ridged.depth == smooth.depth


def test_forces_are_one_frame_each() -> None:
    s = scene(press__forces_N=[3.0, 0.4, 2.2], press__frame_rate_hz=12.5)
    assert press_programme(s) == [(0.0, 3.0), (0.08, 0.4), (0.16, 2.2)]


def ramp(**entries: float) -> dict[str, object]:
    return {"press": {"ramp": entries, "frame_rate_hz": 7.0}, "assumptions": {}, "sources": {}}


def test_a_force_ramp_is_sampled_at_the_frame_rate_up_and_down() -> None:
    up = press_programme(scene(**ramp(start_N=0.5, stop_N=2.5, rate_N_per_s=0.7)))
    times, forces = np.array(up).T
    assert times == pytest.approx(np.arange(len(up)) / 7.0)
    assert forces == pytest.approx(0.5 + 0.7 * times)
    assert len(up) == 21  # 2.0/0.7 s at 7 Hz is exactly 20 intervals
    down = press_programme(scene(**ramp(start_N=2.5, stop_N=0.5, rate_N_per_s=0.7)))
    assert [f for _, f in down] == pytest.approx([f for _, f in reversed(up)])


def test_a_depth_ramp_moves_evenly() -> None:
    s = scene(**ramp(start_N=0.1, stop_N=5.0, rate_mm_per_min=5.0), finger__material="silskin_20")
    frames = press_programme(s)
    # Hertz with E* = i + s F, independent of the inversion: depth = (3F/(4 E* sqrt(R)))^(2/3)
    depths = [(0.75 * f / ((0.0558 + 0.0396 * f) * np.sqrt(6.3))) ** (2 / 3) for _, f in frames]
    steps = np.diff(depths)
    assert steps == pytest.approx(5.0 / 60.0 / 7.0, rel=1e-6)
    assert frames[0][1] == pytest.approx(0.1)
    total = (0.75 * 5 / ((0.0558 + 0.0396 * 5) * np.sqrt(6.3))) ** (2 / 3)
    assert total - depths[-1] < 5.0 / 60.0 / 7.0


@pytest.mark.parametrize(
    ("overrides", "force", "key"),
    [
        ({}, -0.1, "press.forces_N"),
        ({}, float("nan"), "press.forces_N"),
        ({}, float("inf"), "press.forces_N"),
        ({}, 900.0, "grid.size_mm"),
        ({"grid__size_mm": 40.0, "finger__diameter_mm": 11.0}, 30.0, "cross-section"),
        ({"finger__material": "butter"}, 1.0, "finger.material"),
        ({"contact__reduced_modulus_MPa": 0.1, "contact__reduced_modulus_slope_MPa_per_N": -0.1}, 1.5, "slope"),
    ],
)
def test_what_cannot_be_is_refused_in_one_line(overrides: dict, force: float, key: str) -> None:
    with pytest.raises(InputError, match=key) as caught:
        contact_state(scene(**overrides), force)
    assert "\n" not in str(caught.value)


def test_ridges_are_refused_where_the_model_has_no_answer() -> None:
    with pytest.raises(InputError, match=r"contact\.law"):
        contact_state(scene("thesis_ridged", contact={"law": "jkr", "work_of_adhesion_N_per_mm": 1e-3}), 1.0)
    with pytest.raises(InputError, match=r"grid\.samples"):
        contact_state(scene("thesis_ridged", grid__samples=64), 1.0)
    with pytest.raises(InputError, match=r"finger\.ridges"):
        contact_state(scene("thesis_ridged", finger__ridges__width_um=1000.0), 1.0)


def test_programmes_are_capped_and_need_a_depth() -> None:
    with pytest.raises(InputError, match=r"press\.max_frames"):
        press_programme(scene(press__forces_N=[1.0] * 9, press__max_frames=8))
    long = {"press": {"ramp": {"start_N": 0.0, "stop_N": 5.0, "rate_N_per_s": 1e-4}, "frame_rate_hz": 10000.0}}
    long |= {"assumptions": {}, "sources": {}}
    with pytest.raises(InputError, match=r"press\.max_frames"):
        press_programme(scene(**long))
    with pytest.raises(InputError, match="depth"):
        press_programme(
            scene(**ramp(stop_N=2.0, rate_mm_per_min=5.0), contact={"law": "xydas_kao", "c_mm": 2.0, "gamma": 0.2})
        )


# --- half-space


def halfspace(name: str = "thesis", law: dict | None = None, **more: object) -> Scene:
    return scene(name, contact={"law": "halfspace"} | (law or {}), grid__samples=256, **more)


def test_the_half_space_of_a_smooth_finger_is_hertz() -> None:
    solved, hertz = contact_state(halfspace(), 1.3), contact_state(scene(), 1.3)
    assert solved.law == "halfspace"
    assert solved.nominal_contact_area == pytest.approx(hertz.nominal_contact_area, rel=0.01)
    assert solved.depth == pytest.approx(hertz.depth, rel=1e-3)
    assert solved.pressure.max() == pytest.approx(hertz.pressure.max(), rel=0.01)


@pytest.mark.parametrize("pattern", ["parallel", "concentric", "loop", "whorl"])
@pytest.mark.parametrize("rounding", [None, 60.0])
def test_every_pattern_presses(pattern: str, rounding: float | None) -> None:
    ridges = {"finger__ridges__pattern": pattern, "finger__ridges__height_um": 90.0}
    if rounding is not None:
        ridges["finger__ridges__rounding_um"] = rounding
    state = contact_state(halfspace("thesis_ridged", **ridges), 1.3)
    smooth = contact_state(scene(), 1.3)
    assert state.law == "halfspace+ridges"
    assert 0.3 < state.nominal_contact_area / smooth.nominal_contact_area < 1.0
    assert state.pressure.sum() * state.grid.pitch**2 == pytest.approx(1.3, rel=1e-9)
    assert state.parameters["ridge_pattern"] == pattern
    if rounding is None:
        first = contact_state(scene("thesis_ridged", **ridges), 1.3)
        # pitch over radius is 0.5: the models agree to a part of it
        assert first.nominal_contact_area == pytest.approx(state.nominal_contact_area, rel=0.25)
        assert first.contact_mask.sum() * first.grid.pitch**2 == pytest.approx(first.nominal_contact_area, rel=1e-3)


def test_the_half_space_sticks_where_the_scene_says_so() -> None:
    dry = contact_state(halfspace(), 0.4)
    sticky = contact_state(halfspace(law={"work_of_adhesion_N_per_mm": 1e-3}), 0.4)
    jkr = contact_state(scene(contact={"law": "jkr", "work_of_adhesion_N_per_mm": 1e-3}), 0.4)
    assert dry.nominal_contact_area < sticky.nominal_contact_area < 1.02 * jkr.nominal_contact_area
    # four cells of 54 um to the cohesive zone: Maugis's parameter is about 1.3, area within a tenth of JKR's
    assert sticky.nominal_contact_area == pytest.approx(jkr.nominal_contact_area, rel=0.1)


def test_rounding_needs_the_half_space() -> None:
    with pytest.raises(InputError, match=r"rounding_um.*halfspace"):
        contact_state(scene("thesis_ridged", finger__ridges__rounding_um=30.0), 1.0)


def test_roughness_makes_real_contact_a_share_that_grows_with_pressure() -> None:
    smooth = contact_state(scene(), 1.0)
    assert smooth.real_contact_fraction is None
    rough = contact_state(scene(finger__roughness_rms_slope=0.3), 1.0)
    share = rough.real_contact_fraction
    assert share is not None
    assert np.array_equal(rough.pressure, smooth.pressure)
    order = np.argsort(rough.pressure.ravel())
    assert (np.diff(share.ravel()[order]) >= 0).all()
    assert 0.3 < share.max() < 1.0
    assert share[rough.contact_mask == 0].max() == 0.0


def test_a_depth_ramp_of_the_half_space_takes_hertz_depth() -> None:
    entries = ramp(start_N=0.1, stop_N=1.0, rate_mm_per_min=5.0)
    solved, hertz = np.array(press_programme(halfspace(**entries))), np.array(press_programme(scene(**entries)))
    np.testing.assert_allclose(solved, hertz, rtol=1e-9)


@pytest.mark.parametrize("name", ["thesis", "thesis_ridged", "wet", "tilted", "human_print", "gripper"])
def test_contacts_depend_on_no_part_of_a_scene_but_those_named(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """What is kept by :func:`parts_of` would otherwise answer for another rig."""
    one = load_scene(name)
    asked: set[str] = set()
    plain = Scene.__getattribute__

    def noted(self: Scene, key: str) -> object:
        if key in Scene.model_fields:
            asked.add(key)
        return plain(self, key)

    monkeypatch.setattr(Scene, "__getattribute__", noted)
    contact_state(one, 1.0)
    assert {"finger", "contact", "grid"} <= asked <= set(PARTS)


def test_what_a_contact_depends_on_names_liquid() -> None:
    dry, wet = scene(), scene(liquid={"volume_uL": 3.0, "refractive_index": 1.33})
    assert parts_of(dry) != parts_of(wet)
