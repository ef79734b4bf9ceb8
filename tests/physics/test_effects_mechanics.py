"""Effects on the finger and its load: similarity, closed forms, other laws and solved fingers say what they must do."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage
from scipy.optimize import brentq

from evanesce.chain.simulate import simulate_press, solve_contact
from evanesce.contact.analytic.hertz import hertz_contact
from evanesce.contact.analytic.jkr import jkr_contact
from evanesce.contact.fem.library import library_press
from evanesce.contact.halfspace.adhered import adhered_contact
from evanesce.contact.reshape import reshaped_state
from evanesce.contact.slide import slide_forces
from evanesce.contact.solve import contact_state
from evanesce.core.errors import InputError
from evanesce.core.states import ContactState, PlateLight, SurfaceState
from evanesce.effects import Context, Effect, Stage, active_effects, all_effects, apply_stage
from evanesce.optics.projection import Projection
from evanesce.rig import Press, Ramp, Scene, load_scene

MODULUS = 0.21
LAWS: dict[str, dict[str, object]] = {
    "hertz": {"law": "hertz", "reduced_modulus_MPa": MODULUS},
    "scaled_hertz": {"law": "scaled_hertz", "area_scale": 1.37, "reduced_modulus_MPa": MODULUS},
    "jkr": {"law": "jkr", "work_of_adhesion_N_per_mm": 3e-5, "reduced_modulus_MPa": MODULUS},
    "halfspace": {"law": "halfspace", "reduced_modulus_MPa": MODULUS},
    "xydas_kao": {"law": "xydas_kao", "c_mm": 2.1, "gamma": 0.29},
    "fem": {"law": "fem", "bone": "none"},
}
BASE = {"grid.samples": 150, "grid.size_mm": 15.0, "finger.position_mm": [1.7, -0.9]}


def rig(law: str, name: str = "thesis", **more: object) -> Scene:
    return load_scene(name, {**BASE, "contact": LAWS[law], **more})


def pressed(scene: Scene, force: float, time_s: float = 0.0, **effects: dict[str, float]) -> ContactState:
    state = solve_contact(scene.model_copy(update={"effects": effects}), force, seed=2, time_s=time_s)[1]
    assert state is not None
    return state


def carried(state: ContactState) -> float:
    return float(np.asarray(state.pressure).sum()) * state.grid.pitch**2


# --- stiffness -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("law", ["hertz", "scaled_hertz", "jkr", "halfspace"])
def test_a_stiffer_silicone_is_the_law_with_that_modulus(law: str) -> None:
    found = pressed(rig(law), 1.9, modulus={"relative": 0.6})
    meant = contact_state(
        load_scene("thesis", {**BASE, "contact": LAWS[law] | {"reduced_modulus_MPa": 1.6 * MODULUS}}), 1.9
    )
    np.testing.assert_allclose(found.pressure, meant.pressure, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(found.contact_mask, meant.contact_mask, atol=1e-12)
    assert found.nominal_contact_area == pytest.approx(meant.nominal_contact_area, rel=1e-12)
    assert found.depth == pytest.approx(meant.depth, rel=1e-9)


def test_a_stiffer_silicone_under_a_power_law_and_solved_fingers_is_a_smaller_load() -> None:
    """Similarity: m times as stiff under F has the shape of F/m, and carries F."""
    power = pressed(rig("xydas_kao"), 1.9, modulus={"relative": 0.6})
    assert power.nominal_contact_area == pytest.approx(np.pi * (2.1 * (1.9 / 1.6) ** 0.29) ** 2)
    solved = pressed(rig("fem"), 1.9, modulus={"relative": 0.6})
    assert solved.nominal_contact_area == pytest.approx(library_press("silskin_0").area(1.9 / 1.6), rel=1e-9)
    for state in (power, solved):
        assert state.normal_force == 1.9
        assert carried(state) == pytest.approx(1.9, rel=2e-3)  # annuli on squares


def test_a_modulus_that_rises_with_force_keeps_its_shape() -> None:
    """The material's own E*(F) = E0 + s F, as shape at F/m: m E0 + s F."""
    scene = rig("hertz", contact={"law": "hertz", "reduced_modulus_MPa": 0.2, "reduced_modulus_slope_MPa_per_N": 0.05})
    radius = np.cbrt(3 * 2.3 * 7.5 / (4 * (1.5 * 0.2 + 0.05 * 2.3)))
    state = pressed(scene, 2.3, modulus={"relative": 0.5})
    assert state.nominal_contact_area == pytest.approx(np.pi * radius**2)


@pytest.mark.parametrize("name", ["thesis", "thesis_ridged"])
def test_a_softer_finger_out_of_the_library_is_refused(name: str) -> None:
    with pytest.raises(InputError, match=r"press\.forces_N.*0\.05 to 2\.5 N.*0\.5 times as stiff"):
        pressed(rig("fem", name), 3.0, modulus={"relative": -0.5})


def test_effects_out_of_the_finger_s_range_are_refused() -> None:
    for effect, values in (
        ("modulus", {"relative": -0.9}),
        ("bone_stiffening", {"per_N": 3.0}),
        ("adhesion", {"work_J_per_m2": 5.0}),
    ):
        scene = rig("hertz", **{
            "finger.modulus_factor": 0.06, "finger.stiffening_per_N": 4.0, "finger.work_of_adhesion_N_per_mm": 0.099,
        })  # fmt: skip
        with pytest.raises(InputError, match=f"effects.{effect}"):
            pressed(scene, 1.0, **{effect: values})


@pytest.mark.parametrize("force", [0.5, 1.3, 3.1, 5.0])
def test_stiffening_makes_the_boneless_finger_the_one_with_a_bone(force: float) -> None:
    """Oracle: the finger solved with a bone of half the tip radius."""
    state = pressed(rig("fem"), force, bone_stiffening={"per_N": 0.083})
    # at their fifteen forces the solved areas scatter by up to 1.5 % about one curve: nodes touch one after the other
    assert state.nominal_contact_area == pytest.approx(library_press("silskin_0", "half").area(force), rel=0.02)
    assert carried(state) == pytest.approx(force, rel=2e-3)


def test_stiffening_under_hertz() -> None:
    for force in (0.4, 2.6):
        area = pressed(rig("hertz"), force, bone_stiffening={"per_N": 0.3}).nominal_contact_area
        plain = pressed(rig("hertz"), force).nominal_contact_area
        assert area / plain == pytest.approx((1 + 0.3 * force) ** (-2 / 3))


def dark(scene: Scene, state: ContactState | None, *, seed: int) -> PlateLight:
    view = Projection.of(scene.camera, scene.plate).ideal_view()
    nothing = np.zeros(view.shape)
    return PlateLight(radiance=nothing, variance=nothing, focal_px=view.focal_px, principal_point=view.principal_point)


def test_a_ramp_by_depth_meets_more_force_on_a_stiffer_finger() -> None:
    """The machine moves by mm/min: depths are those imposed, forces those of the finger that is really there."""
    ramp = Ramp(start_N=0.4, stop_N=1.6, rate_mm_per_min=40.0)
    camera = {"camera.resolution_px": [20, 16], "camera.lens.distortion": {"k1": 0.0}}
    scene = rig("hertz", **camera).model_copy(update={"press": Press(ramp=ramp, frame_rate_hz=6.0)})
    for factor in (1.0, 1.5):
        effects = {} if factor == 1.0 else {"modulus": {"relative": factor - 1}}
        shots = simulate_press(scene.model_copy(update={"effects": effects}), seed=1, render=dark)
        first = next(iter(shots))
        second = next(shots)
        assert first.state is not None
        assert second.state is not None
        start = np.cbrt(9 * 0.4**2 / (16 * 7.5 * (factor * MODULUS) ** 2))
        assert first.state.depth == pytest.approx(start)
        assert second.state.depth - first.state.depth == pytest.approx(40.0 / 60 / 6.0)
        assert second.state.normal_force == pytest.approx(
            4 / 3 * factor * MODULUS * np.sqrt(7.5) * (start + 40.0 / 360) ** 1.5
        )


# --- time ------------------------------------------------------------------------------------------------------------


def test_creep_is_lee_and_radoks_step() -> None:
    """Under a held load a^3 follows the creep compliance; nothing has happened at the moment of loading."""
    values = {"per_decade": 0.08, "onset_s": 0.5}
    plain = pressed(rig("hertz"), 1.1).nominal_contact_area
    assert pressed(rig("hertz"), 1.1, 0.0, creep=values).nominal_contact_area == plain
    for time_s, decades in ((4.5, 1.0), (49.5, 2.0)):
        state = pressed(rig("hertz"), 1.1, time_s, creep=values)
        assert (state.nominal_contact_area / plain) ** 1.5 == pytest.approx(1 + 0.08 * decades)
        assert state.normal_force == 1.1
    held = pressed(rig("hertz"), 1.1, 2.0, creep={**values, "held_before_s": 2.5})
    assert (held.nominal_contact_area / plain) ** 1.5 == pytest.approx(1.08)


# --- adhesion --------------------------------------------------------------------------------------------------------


def test_a_sticky_hertz_finger_is_jkr() -> None:
    sticky = pressed(rig("hertz"), 0.7, adhesion={"work_J_per_m2": 0.06})
    meant = contact_state(
        load_scene("thesis", {**BASE, "contact": LAWS["jkr"] | {"work_of_adhesion_N_per_mm": 6e-5}}), 0.7
    )
    np.testing.assert_array_equal(sticky.pressure, meant.pressure)
    assert sticky.nominal_contact_area == meant.nominal_contact_area
    more = pressed(rig("jkr"), 0.7, adhesion={"work_J_per_m2": 0.03})
    assert more.nominal_contact_area == pytest.approx(meant.nominal_contact_area)


@pytest.mark.parametrize("force", [0.0, 0.013, 2.2])
def test_adhesion_on_top_of_hertz_is_jkr(force: float) -> None:
    found, dry = adhered_contact(lambda load: hertz_contact(load, 6.1, 0.3), force, 0.3, 7e-5)
    meant = jkr_contact(force, 6.1, 0.3, 7e-5)
    r = np.linspace(0.0, 3.0, 41) * meant.contact_radius
    assert found.contact_radius == pytest.approx(meant.contact_radius, rel=1e-10)
    assert found.depth == pytest.approx(meant.depth, rel=1e-9)
    np.testing.assert_allclose(found.force_within(r), meant.force_within(r), rtol=1e-8, atol=1e-12 + 1e-9 * dry)
    np.testing.assert_allclose(found.gap(r), meant.gap(r), atol=1e-11)


def test_adhesion_on_a_solved_finger_is_a_dry_one_less_a_punch() -> None:
    """F1 with F1 - sqrt(8 pi w E* a(F1)^3) = F, found here from the library's areas alone."""
    state = pressed(rig("fem"), 1.2, adhesion={"work_J_per_m2": 0.08})
    press, modulus = library_press("silskin_0"), contact_state(rig("fem", "thesis_ridged"), 1.2).parameters
    stiff = float(modulus["reduced_modulus_MPa"])

    def surplus(load: float) -> float:
        return load - np.sqrt(8 * np.pi * 8e-5 * stiff * (press.area(load) / np.pi) ** 1.5) - 1.2

    assert state.nominal_contact_area == pytest.approx(press.area(brentq(surplus, 1.2, 4.0)), rel=1e-8)
    assert state.normal_force == 1.2
    assert float(np.asarray(state.contact_mask).sum()) * 0.01 == pytest.approx(state.nominal_contact_area, rel=1e-9)
    assert np.asarray(state.pressure).min() < 0  # the rim pulls


@pytest.mark.parametrize("law", ["hertz", "fem", "xydas_kao"])
def test_adhesion_on_ridges_adds_what_a_half_space_adds(law: str) -> None:
    fine = {"grid.samples": 128, "grid.size_mm": 10.0}
    scene = rig(law, "thesis_ridged", **fine)
    dry = pressed(scene, 1.3)
    sticky = pressed(scene, 1.3, adhesion={"work_J_per_m2": 0.1})
    gain = sticky.nominal_contact_area - dry.nominal_contact_area
    assert gain > 0
    assert float(np.asarray(sticky.contact_mask).sum()) * sticky.grid.pitch**2 == pytest.approx(
        sticky.nominal_contact_area, rel=1e-6
    )
    assert carried(sticky) == pytest.approx(1.3, rel=5e-3)
    assert (np.asarray(sticky.gap) >= 0).all()
    if law == "hertz":
        published = {"law": "halfspace"} | {k: v for k, v in LAWS["hertz"].items() if k != "law"}
        flat = load_scene("thesis_ridged", {**BASE, **fine, "contact": published})
        direct = pressed(flat, 1.3, adhesion={"work_J_per_m2": 0.1}).nominal_contact_area
        direct -= pressed(flat, 1.3).nominal_contact_area
        # the same solver on Hertz's sampled shape instead of the parabola: cells of the rim, 0.05 mm^2 in 0.5
        assert gain == pytest.approx(direct, rel=0.15)


def test_adhesion_that_no_law_can_take_is_refused() -> None:
    with pytest.raises(InputError, match=r"contact\.law"):
        pressed(rig("jkr", "thesis_ridged"), 1.0, adhesion={"work_J_per_m2": 0.05})
    slide = load_scene("thesis_slide", {"contact": LAWS["xydas_kao"]})
    force = slide.press.forces_N
    assert force is not None
    with pytest.raises(InputError, match="work_of_adhesion"):
        pressed(slide, force[0], adhesion={"work_J_per_m2": 0.05})


# --- shape -----------------------------------------------------------------------------------------------------------


def moments(state: ContactState) -> tuple[np.ndarray, np.ndarray]:
    """Centroid [mm] and covariance [mm^2] of the mask."""
    weight = np.asarray(state.contact_mask, dtype=float)
    x, y = np.meshgrid(state.grid.x, state.grid.y)
    points = np.stack([x.ravel(), y.ravel()])
    return np.average(points, axis=1, weights=weight.ravel()), np.cov(points, aweights=weight.ravel(), ddof=0)


def test_off_axis_load_moves_the_contact_with_its_force() -> None:
    values = {"shift_x_mm_per_N": 0.31, "shift_y_mm_per_N": -0.12}
    for force in (0.8, 2.4):
        plain, moved = pressed(rig("hertz"), force), pressed(rig("hertz"), force, off_axis_load=values)
        np.testing.assert_allclose(moments(moved)[0] - moments(plain)[0], [0.31 * force, -0.12 * force], atol=1e-9)
        np.testing.assert_array_equal(moved.pressure, plain.pressure)


def test_off_axis_load_makes_an_ellipse_of_the_same_area() -> None:
    force, values = 2.2, {"oval_x_per_N": 0.09, "oval_diagonal_per_N": -0.12}
    plain, oval = pressed(rig("hertz"), force), pressed(rig("hertz"), force, off_axis_load=values)
    centre, spread = moments(oval)
    length, axis = np.linalg.eigh(spread)
    # sampled with 21 cells a radius: its second moments are good to (cell/radius)^2
    assert np.sqrt(length[1] / length[0]) == pytest.approx(np.exp(0.15 * force), rel=4e-3)
    assert np.degrees(np.arctan2(axis[1, 1], axis[0, 1])) % 180 == pytest.approx(
        0.5 * np.degrees(np.arctan2(-0.12, 0.09)) % 180, abs=0.3
    )
    np.testing.assert_allclose(centre, moments(plain)[0], atol=2e-3)
    assert oval.nominal_contact_area == pytest.approx(plain.nominal_contact_area, rel=1e-12)
    assert float(np.asarray(oval.contact_mask).sum()) * 0.01 == pytest.approx(oval.nominal_contact_area, rel=1e-6)
    assert carried(oval) == pytest.approx(force, rel=1e-9)
    with pytest.raises(InputError, match="off_axis_load"):
        pressed(rig("hertz", "thesis_ridged"), 1.0, off_axis_load=values)


def test_a_stretched_contact_is_interpolated_as_scipy_does() -> None:
    """Gap, pressure and labels by SciPy's linear interpolation in double precision: to a hundredth of a nanometre."""
    labels = np.random.default_rng(3).integers(0, 3, (150, 150)).astype(np.uint8)
    state = replace(pressed(rig("hertz"), 2.2), state=labels)
    grid, pivot, direction, along, across = state.grid, (1.2, -0.4), 0.7, 1.06, 0.97
    found = reshaped_state(state, along, across, direction, pivot)
    turn = np.array([[np.cos(direction), np.sin(direction)], [-np.sin(direction), np.cos(direction)]])
    points = np.stack(np.meshgrid(grid.x - pivot[0], grid.y - pivot[1]))
    back = np.einsum("ji,j...->i...", turn, np.einsum("ij,j...->i...", turn, points) / [[[along]], [[across]]])
    rows, cols = (back[1] + pivot[1] - grid.y[0]) / grid.pitch, (back[0] + pivot[0] - grid.x[0]) / grid.pitch
    gap, pressure = (
        ndimage.map_coordinates(np.asarray(field, float), [rows, cols], order=1, mode="nearest")
        for field in (state.gap, state.pressure)
    )
    near = gap < 1e-3
    assert np.abs(found.gap - gap)[near].max() < 1e-8 * 1e3 * grid.pitch
    np.testing.assert_allclose(found.gap, gap, rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(
        np.asarray(found.pressure) / found.pressure.sum(), pressure / pressure.sum(), rtol=1e-4, atol=1e-9
    )
    labels = ndimage.map_coordinates(state.state, [rows, cols], order=0, mode="nearest")
    assert np.mean(found.state == labels) > 0.999


@pytest.mark.parametrize("name", [n for n, e in all_effects().items() if e.stage is Stage.CONTACT])
def test_effects_on_a_contact_leave_it_as_deep_as_it_was(name: str) -> None:
    """What series of displacement build on: depths at forces are those of the rig without such effects."""
    own = all_effects()[name]
    values = {key: own.fitted[key] for key in own.amplitudes if key in own.fitted}
    plain, changed = pressed(rig("hertz"), 2.2), pressed(rig("hertz"), 2.2, **{name: values})
    assert changed.depth == plain.depth
    assert np.abs(np.asarray(changed.pressure) - plain.pressure).max() > 0.0 or changed.grid != plain.grid


def test_shear_takes_alpha_q_squared_from_the_trailing_edge() -> None:
    values = {"loss_mm2_per_N2": 3.0, "side_load_share": 0.4, "direction_deg": 90.0}
    plain, sheared = pressed(rig("scaled_hertz"), 2.5), pressed(rig("scaled_hertz"), 2.5, shear_area_loss=values)
    assert plain.nominal_contact_area - sheared.nominal_contact_area == pytest.approx(3.0 * 1.0**2)
    assert carried(sheared) == pytest.approx(2.5, rel=1e-9)
    rows = [np.flatnonzero((np.asarray(s.contact_mask) > 0.5).any(axis=1)) for s in (plain, sheared)]
    radius = np.sqrt(plain.nominal_contact_area / np.pi)
    assert rows[0].max() - rows[1].max() <= 1  # the leading edge, towards +y, stays
    share = sheared.nominal_contact_area / plain.nominal_contact_area
    assert (rows[1].min() - rows[0].min()) * 0.1 == pytest.approx(2 * radius * (1 - share), abs=0.15)
    gone = pressed(rig("hertz"), 2.5, shear_area_loss={"loss_mm2_per_N2": 900.0})
    assert gone.nominal_contact_area == pytest.approx(0.3 * pressed(rig("hertz"), 2.5).nominal_contact_area)
    with pytest.raises(InputError, match="shear_area_loss"):
        pressed(rig("hertz", "thesis_ridged"), 1.0, shear_area_loss=values)


def test_shear_of_a_slide_is_its_own_force() -> None:
    effect: Effect = all_effects()["shear_area_loss"]
    state = pressed(rig("hertz"), 2.0)
    dragged = type(state)(**{**vars(state), "tangential_force": (-0.3, 0.4)})
    found = effect.apply(dragged, effect.parameters(loss_mm2_per_N2=6.0), Context(rig("hertz"), seed=1))
    assert state.nominal_contact_area - found.nominal_contact_area == pytest.approx(6.0 * 0.25)
    assert moments(found)[0] - moments(state)[0] == pytest.approx(
        0.5 * 1.5 / (np.pi * np.sqrt(state.nominal_contact_area / np.pi)) * 2 * np.array([-0.6, 0.8]), abs=5e-3
    )


SLID = {"slide.shaft": "rigid", "grid.size_mm": 30.0, "slide.friction_coefficient": 0.5}


def test_friction_of_a_slide_grows_in_proportion_and_sticks_as_cattaneo_says() -> None:
    scene = rig("hertz", "thesis_slide", **SLID)
    more = scene.model_copy(update={"effects": {"friction": {"relative": 0.3}}})
    moved = apply_stage(Stage.RIG, more, active_effects(more), Context(more, 0, 0.0, 0))
    states = slide_forces(moved)
    forces = np.array([np.linalg.norm(state.tangential_force) for state in states])
    most = 0.65 * states[-1].normal_force
    assert forces[-1] == pytest.approx(most, rel=1e-6)
    assert np.linalg.norm(slide_forces(scene)[-1].tangential_force) == pytest.approx(most / 1.3, rel=1e-6)
    sheared = [state for state, force in zip(states, forces, strict=True) if 0.2 * most < force < 0.8 * most]
    assert sheared
    for state in sheared:
        stuck = (state.state == SurfaceState.STICK).sum() / (state.state >= SurfaceState.STICK).sum()
        share = float(np.linalg.norm(state.tangential_force)) / most
        # Half a cell of 0.23 mm along the rim of the stick core.
        assert np.sqrt(stuck) == pytest.approx((1.0 - share) ** (1 / 3), abs=0.08)


def test_a_press_has_no_friction_and_a_slide_no_more_than_a_rig_allows() -> None:
    still = pressed(rig("hertz"), 2.0, friction={"relative": 0.3})
    np.testing.assert_array_equal(still.pressure, pressed(rig("hertz"), 2.0).pressure)
    wild = rig("hertz", "thesis_slide", **SLID, **{"slide.friction_factor": 10.0})
    with pytest.raises(InputError, match=r"friction_factor becomes 30 .*0.05 to 20"):
        all_effects()["friction"].apply(wild, all_effects()["friction"].parameters(relative=2.0), Context(wild, seed=1))


def test_higher_ridges_are_those_of_a_scene_that_says_so() -> None:
    scene = rig("hertz", "thesis_ridged")
    meant = rig(
        "hertz",
        "thesis_ridged",
        **{"finger.ridges": {"height_um": 47.67 * 1.3, "pitch_um": 1000.0, "orientation_deg": 90.0}},
    )
    state = pressed(scene, 1.0, ridge_height={"relative": 0.3})
    np.testing.assert_allclose(state.gap, contact_state(meant, 1.0).gap, atol=1e-12)
    assert state.nominal_contact_area < 0.99 * pressed(scene, 1.0).nominal_contact_area
    with pytest.raises(InputError, match="no ridges"):
        pressed(rig("hertz"), 1.0, ridge_height={"relative": 0.3})


# --- load ------------------------------------------------------------------------------------------------------------


def test_what_presses_is_the_reading_less_the_offset() -> None:
    state = pressed(rig("hertz"), 1.4, force_offset={"offset_N": 0.35})
    assert state.normal_force == pytest.approx(1.05)
    assert state.nominal_contact_area == pytest.approx(pressed(rig("hertz"), 1.05).nominal_contact_area, rel=1e-12)
    assert pressed(rig("hertz"), 0.2, force_offset={"offset_N": 0.35}).nominal_contact_area == 0.0
    assert solve_contact(rig("hertz"), None, seed=1)[1] is None


@pytest.mark.parametrize(("name", "values"), [("force_offset", {"offset_N": 0.1}), ("creep", {"per_decade": 0.05})])
def test_a_slide_refuses_what_its_march_does_not_know(name: str, values: dict[str, float]) -> None:
    scene = load_scene("thesis_slide")
    force = scene.press.forces_N
    assert force is not None
    with pytest.raises(InputError, match=f"effects.{name}"):
        pressed(scene, force[0], **{name: values})
