"""Scenes whose contact is a solved press, and scenes that slide."""

from __future__ import annotations

from itertools import islice
from pathlib import Path

import numpy as np
import pytest

from evanesce.chain.simulate import simulate_press
from evanesce.contact.fem.library import library_press
from evanesce.contact.programme import press_programme
from evanesce.contact.slide import slide_forces, slide_warnings
from evanesce.contact.sliding.shaft import boned_stiffness
from evanesce.contact.solve import contact_grid, contact_sequence, contact_state
from evanesce.core.errors import InputError
from evanesce.core.states import ContactState, PlateLight, SurfaceState
from evanesce.materials.tables import material
from evanesce.optics.projection import Projection
from evanesce.rig import Scene, dump_scene, load_scene

UGLY = {"finger.position_mm": [1.7, -2.3], "grid.samples": 300, "grid.size_mm": 13.7}
SLIDE = {"distance_mm": 1.3, "speed_mm_per_s": 2.6, "direction_deg": 30.0, "press_time_s": 0.4, "hold_time_s": 0.2}


def fem(name: str = "thesis", law: dict | None = None, **more: object) -> Scene:
    named = {key.replace("__", "."): value for key, value in more.items()}
    return load_scene(name, UGLY | {"contact": {"law": "fem", "bone": "none"} | (law or {})} | named)


def sliding(slide: dict | None = None, **more: object) -> Scene:
    named = {key.replace("__", "."): value for key, value in more.items()}
    base = {"press": {"forces_N": [0.9], "frame_rate_hz": 20.0}, "slide": SLIDE | (slide or {})}
    return load_scene("thesis", UGLY | base | named)


def test_the_solved_press_is_where_and_how_large_the_scene_says() -> None:
    state = contact_state(fem(), 1.0, time_s=0.3)
    press = library_press("silskin_0", "none")
    stored = np.pi * press.contact_radius[np.isclose(press.force, 1.0)][0] ** 2
    cell = state.grid.pitch**2
    assert state.nominal_contact_area == pytest.approx(stored, rel=1e-6)
    assert np.asarray(state.contact_mask).sum() * cell == pytest.approx(stored, rel=1e-3)
    assert np.asarray(state.pressure).sum() * cell == pytest.approx(1.0, rel=2e-3)
    middle = (np.asarray(state.contact_mask).sum(axis=0) @ state.grid.x) / np.asarray(state.contact_mask).sum()
    assert middle == pytest.approx(1.7, abs=state.grid.pitch)
    assert (state.law, state.time) == ("fem", 0.3)


def test_a_bone_makes_the_finger_shallower_and_the_patch_smaller() -> None:
    bare, boned = (contact_state(fem(law={"bone": bone}), 2.0) for bone in ("none", "half"))
    assert boned.nominal_contact_area < bare.nominal_contact_area
    assert boned.depth < 0.7 * bare.depth


def test_ridges_of_vanishing_height_leave_the_solved_press() -> None:
    flat = contact_state(fem("thesis_ridged", finger__ridges__height_um=0.1), 1.0)
    smooth = contact_state(fem(), 1.0)
    # cells of 46 um on a radius of 2.33 mm: a quarter of a cell of border, 0.25 * 2 * 0.046 / 2.33
    assert flat.nominal_contact_area == pytest.approx(smooth.nominal_contact_area, rel=0.01)
    assert flat.law == "fem+ridges"
    assert flat.depth == smooth.depth


def test_moulded_ridges_take_area_and_carry_the_force() -> None:
    ridged, smooth = (
        contact_state(fem("thesis_ridged", finger__ridges__height_um=120.0), 1.0),
        contact_state(fem(), 1.0),
    )
    assert ridged.nominal_contact_area < 0.8 * smooth.nominal_contact_area
    assert np.asarray(ridged.pressure).sum() * ridged.grid.pitch**2 == pytest.approx(1.0, rel=1e-4)
    assert np.asarray(ridged.pressure).max() > np.asarray(smooth.pressure).max()


def test_a_ramp_in_depth_follows_the_solved_depths() -> None:
    ramp = {"ramp": {"start_N": 0.5, "stop_N": 2.0, "rate_mm_per_min": 30.0}, "frame_rate_hz": 4.0}
    programme = press_programme(fem(press=ramp, assumptions={}))
    press = library_press("silskin_0", "none")
    depths = [press.at(force).depth for _, force in programme]
    assert np.diff(depths) == pytest.approx(30.0 / 60.0 / 4.0, rel=1e-6)


@pytest.mark.parametrize(
    ("overrides", "force", "key"),
    [
        ({"finger.tip_radius_mm": 6.3}, 1.0, "finger.tip_radius_mm"),
        ({"finger.length_mm": 7.5}, 1.0, "finger.length_mm"),
        ({"finger.material": "silskin_10"}, 1.0, "finger.material"),
        ({}, 0.01, "press.forces_N"),
        ({}, 9.0, "press.forces_N"),
    ],
)
def test_what_was_not_solved_is_refused(overrides: dict, force: float, key: str) -> None:
    with pytest.raises(InputError) as caught:
        contact_state(load_scene("thesis", {"contact": {"law": "fem"}} | overrides), force)
    assert key in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_slide_is_one_state_a_frame() -> None:
    scene = sliding()
    states, programme = contact_sequence(scene), press_programme(scene)
    # press 0.4 s, hold 0.2 s, slide 0.5 s at 20 Hz
    assert len(states) == len(programme) == 23
    assert [force for _, force in programme[:2]] == pytest.approx([0.05, 0.05 + 0.85 * 0.05 / 0.4])
    for index in (0, 5, 12, 22):
        assert states[index].time == pytest.approx(programme[index][0])
        assert states[index].normal_force == pytest.approx(programme[index][1])
    assert states[12].tangential_force == (0.0, 0.0)


def test_a_slide_pulls_along_its_direction_up_to_friction() -> None:
    scene = sliding({"friction_coefficient": 0.3, "shaft": "rigid"})
    last = contact_sequence(scene)[-1]
    x, y = last.tangential_force
    assert np.hypot(x, y) == pytest.approx(0.3 * 0.9, rel=1e-6)
    assert np.degrees(np.arctan2(y, x)) == pytest.approx(30.0)
    assert last.state is not None
    assert SurfaceState.SLIP in last.state
    assert SurfaceState.STICK not in last.state


def test_the_finger_travels_unless_the_glass_does() -> None:
    def middle(scene: Scene, index: int) -> tuple[float, float]:
        mask = np.asarray(contact_sequence(scene)[index].contact_mask)
        grid = contact_grid(scene)
        return float(mask.sum(axis=0) @ grid.x / mask.sum()), float(mask.sum(axis=1) @ grid.y / mask.sum())

    rigid = {"friction_coefficient": 0.3, "shaft": "rigid"}
    start, end = (np.array(middle(sliding(rigid), i)) for i in (0, -1))
    way = end - start
    assert np.degrees(np.arctan2(way[1], way[0])) == pytest.approx(30.0, abs=0.5)
    # the pressed place travels with a rigid shaft, whether its skin sticks or slips
    assert np.hypot(*way) == pytest.approx(1.3, abs=1e-4)
    assert np.array(middle(sliding(rigid | {"glass_moves": True}), -1)) == pytest.approx(start, abs=1e-6)


def test_a_solved_press_may_slide() -> None:
    held = {"preload_N": 0.2, "area_under_shear": "constant"}
    scene = sliding(held, contact={"law": "fem", "bone": "none"})
    last = contact_sequence(scene)[-1]
    press = library_press("silskin_0", "none")
    assert last.nominal_contact_area == pytest.approx(np.pi * press.at(0.9).contact_radius ** 2, rel=1e-6)
    assert last.law == "fem+sliding"


def test_a_softer_shaft_delays_the_force() -> None:
    stiff, soft = (contact_sequence(sliding({"shaft": shaft}))[15] for shaft in ("rigid", "silicone"))
    assert np.hypot(*soft.tangential_force) < 0.5 * np.hypot(*stiff.tangential_force)


def test_a_scene_with_a_slide_is_written_and_read_alike(tmp_path: Path) -> None:
    scene = sliding({"friction_coefficient": 0.67})
    file = tmp_path / "slide.toml"
    file.write_text(dump_scene(scene), encoding="utf-8")
    assert load_scene(file) == scene


@pytest.mark.parametrize(
    ("slide", "more", "part"),
    [
        ({}, {"press": {"forces_N": [0.5, 0.9]}}, "one force"),
        ({"preload_N": 1.0}, {}, "preload"),
        ({}, {"contact": {"law": "halfspace"}}, "halfspace"),
        ({"distance_mm": -1.0}, {}, "slide.distance_mm"),
        ({"pace": 1.0}, {}, "pace"),
    ],
)
def test_a_slide_that_cannot_be_is_refused(slide: dict, more: dict, part: str) -> None:
    with pytest.raises(InputError, match=part):
        sliding(slide, **more)


def test_a_moment_between_frames_is_refused() -> None:
    with pytest.raises(InputError, match="no frame"):
        contact_state(sliding(), 0.9, time_s=0.7125)


def test_a_slide_beyond_the_grid_is_refused() -> None:
    with pytest.raises(InputError, match=r"grid\.size_mm"):
        contact_sequence(sliding({"distance_mm": 12.0, "shaft": "rigid"}))[0]


def test_the_simulation_takes_a_slide_frame_by_frame() -> None:
    def dark(scene: Scene, state: ContactState | None, *, seed: int) -> PlateLight:
        view = Projection.of(scene.camera, scene.plate).ideal_view()
        nothing = np.zeros(view.shape, np.float32)
        return PlateLight(
            radiance=nothing, variance=nothing, focal_px=view.focal_px, principal_point=view.principal_point
        )

    scene = sliding(camera__resolution_px=[64, 48], sources={}, assumptions={})
    shots = list(islice(simulate_press(scene, seed=3, render=dark), 14))
    wanted = contact_sequence(scene)
    for shot, state in zip(shots, wanted, strict=False):
        assert shot.state is not None
        assert shot.state.tangential_force == state.tangential_force
        assert shot.frame.time == state.time
    assert np.hypot(*shots[-1].state.tangential_force) > 0


def test_a_finger_over_a_bone_gives_way_as_its_solved_slide_does() -> None:
    from evanesce.studies.mechanics.runs import SlideCase, solved_slide

    solved = solved_slide(SlideCase(0.82, "half", "force"))
    changes = {"contact.bone": "half", "slide.friction_coefficient": 0.82, "slide.distance_mm": 1.6}
    states = slide_forces(load_scene("thesis_slide", changes))
    drive = [state.tangential_force[0] / float(state.parameters["drive_stiffness_N_per_mm"])
             + float(state.parameters["tip_displacement_mm"]) for state in states]  # fmt: skip
    force = np.interp([0.25, 0.475, 0.9], drive, [state.tangential_force[0] for state in states])
    wanted = [solved.scalar("tangential_force", way) for way in (0.25, 0.475, 0.9)]
    # The rate of the solved normal contact is not that of a half-space once it is sheared: some per cent.
    np.testing.assert_allclose(force, wanted, rtol=0.05)


@pytest.mark.parametrize(("check", "share"), [(False, 1.0), (True, 0.99)])
def test_silicone_round_a_bone_is_what_the_solved_slides_lack_of_a_half_space(check: bool, share: float) -> None:
    from evanesce.studies.mechanics.runs import SlideCase, solved_slide

    solved = solved_slide(SlideCase(0.67, "half", "depth", "check" if check else ""))
    way, pull, area = (solved.scalars[name][1] for name in ("slide", "tangential_force", "area"))  # all but stuck
    shear = material("silskin_0").mooney_rivlin.shear_modulus_MPa
    # Mindlin: a stuck disc on an incompressible half-space, 2 a G* = 16 a G/3
    half_space = 16.0 / 3.0 * np.sqrt(area / np.pi) * shear
    left = 1.0 / (way / pull - 1.0 / half_space)
    assert left == pytest.approx(share * boned_stiffness(shear, 7.5), rel=0.02)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"slide.contact_angle_deg": 30.0, "contact.bone": "half"}, "contact_angle_deg"),
        ({"slide.contact_angle_deg": 30.0, "slide.shaft": "rigid"}, "contact_angle_deg"),
    ],
)
def test_an_angle_that_would_do_nothing_is_refused(changes: dict, words: str) -> None:
    with pytest.raises(InputError, match=words):
        slide_forces(load_scene("thesis_slide", changes))


def test_slides_beyond_what_their_area_was_made_of_are_told() -> None:
    assert slide_warnings(load_scene("thesis_slide")) == ()
    assert slide_warnings(load_scene("thesis")) == ()
    assert slide_warnings(load_scene("soft_slide")) == ()
    (rough,) = slide_warnings(
        load_scene("thesis_slide", {"slide.friction_coefficient": 1.6, "slide.shaft": "rigid", "grid.size_mm": 24.0})
    )
    assert "extrapolated" in rough
    (dry,) = slide_warnings(sliding())
    assert "stays" in dry
    assert slide_warnings(sliding({"area_under_shear": "constant"})) == ()
