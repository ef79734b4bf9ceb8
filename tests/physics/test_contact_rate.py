"""Rate, dwell and temperature of a press: against the history integral of a viscoelastic sphere, and quadrature."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import quad

from evanesce.bench.dma import prony_of
from evanesce.contact.analytic.viscoelastic import press_by_force
from evanesce.contact.programme import press_programme
from evanesce.contact.rate import EVEN_DEPTH, mean_compliance, rate_factor
from evanesce.contact.solve import contact_sequence, contact_state
from evanesce.core.errors import InputError
from evanesce.rig import Scene, load_scene

LIGHT = {"grid.samples": 128, "contact": {"law": "hertz", "reduced_modulus_MPa": 0.05}, "finger.material": "silskin_20"}
SLIDE = LIGHT | {
    "grid.size_mm": 30.0,
    "slide.press_time_s": 0.4,
    "slide.hold_time_s": 0.6,
    "slide.preload_N": 0.05,
    "slide.speed_mm_per_s": 5.0,
}


def scene(**more: object) -> Scene:
    return load_scene("thesis", LIGHT | {key.replace("__", "."): value for key, value in more.items()})


@pytest.mark.parametrize(
    ("rise", "dwell", "power"), [(0.3, 0.0, 1.0), (2.0, 0.7, 1.5), (1e-4, 3.0, 1.5), (700.0, 0.0, 1.5)]
)
def test_mean_compliance_is_the_integral_over_the_history(rise: float, dwell: float, power: float) -> None:
    creep = prony_of("silskin_20", 33.0).creep()
    # u = v^(1/power) takes the weight away
    exact, _ = quad(
        lambda v: float(creep.creep(dwell + rise * (1 - v ** (1 / power)))), 0, 1, epsabs=0, epsrel=1e-11, limit=400
    )
    assert mean_compliance(creep, rise, dwell, power) == pytest.approx(exact, rel=1e-9)


def test_the_area_is_that_of_a_viscoelastic_sphere() -> None:
    # The contact law of a sphere has one modulus; ratios of cubed radii are ratios of compliances.
    force, dwell = 1.3, 2.5
    fast, slow = (
        scene(press__rate_mm_per_min=rate, press__dwell_s=rest) for rate, rest in ((600.0, dwell), (5.0, 0.0))
    )
    depth = contact_state(slow, force).depth
    cubes = []
    for rate, rest in ((600.0, dwell), (5.0, 0.0)):
        rise = 60.0 * depth / rate
        time = np.concatenate([rise * np.linspace(0, 1, 1500), rise + rest * np.linspace(0, 1, 200)[1:]])
        loads = force * np.minimum(time / rise, 1.0) ** EVEN_DEPTH
        cubes.append(press_by_force(time, loads, 7.5, prony_of("silskin_20", 20.0)).radius[-1] ** 3)
    areas = [contact_state(one, force).nominal_contact_area for one in (fast, slow)]
    assert areas[0] / areas[1] == pytest.approx((cubes[0] / cubes[1]) ** (2 / 3), rel=2e-5)


def test_faster_and_colder_is_stiffer_and_a_dwell_creeps() -> None:
    usual = contact_state(scene(), 1.0)
    fast, held = (
        contact_state(scene(press__rate_mm_per_min=3000.0), 1.0),
        contact_state(scene(press__rate_mm_per_min=3000.0, press__dwell_s=1.0), 1.0),
    )
    assert fast.nominal_contact_area < held.nominal_contact_area < 1.001 * usual.nominal_contact_area
    assert fast.depth < usual.depth
    cold, warm = (contact_state(scene(environment__temperature_C=t), 1.0) for t in (0.0, 50.0))
    # the storage modulus falls by 45 % from 0 to 50 degC: areas go as its power -2/3
    assert warm.nominal_contact_area / cold.nominal_contact_area == pytest.approx((1 - 0.45) ** (-2 / 3), rel=0.02)


def test_at_the_rate_and_temperature_of_the_published_moduli_no_bit_changes() -> None:
    plain = contact_state(scene(), 1.0)
    for same in (
        scene(environment={"temperature_C": 20.0}),
        scene(press__rate_mm_per_min=5.0),
        scene(press__dwell_s=0.0),
    ):
        assert rate_factor(same, 1.0) == 1.0
        found = contact_state(same, 1.0)
        assert np.array_equal(found.pressure, plain.pressure)
        assert np.array_equal(found.gap, plain.gap)
        assert found.parameters == plain.parameters


def test_a_ramp_in_mm_per_min_pushes_a_stiffer_finger_harder() -> None:
    ramp = {"press.ramp": {"stop_N": 2.0, "rate_mm_per_min": 600.0}, "press.forces_N": None}
    plain, cold = scene().with_(ramp), scene(environment__temperature_C=5.0).with_(ramp)
    depth = 10.0 * press_programme(cold)[3][0]
    assert contact_state(cold, press_programme(cold)[3][1]).depth == pytest.approx(depth, rel=1e-6)
    assert press_programme(cold)[3][1] > press_programme(plain)[3][1]


def test_a_slide_creeps_while_it_is_held() -> None:
    warm = load_scene("thesis_slide", SLIDE | {"environment.temperature_C": 40.0, "slide.shaft": "rigid"})
    states = contact_sequence(warm)
    areas = [states[i].nominal_contact_area for i in (8, 12, 18)]
    assert areas[0] < areas[1] < areas[2]
    held = load_scene("thesis", LIGHT | {"environment.temperature_C": 40.0})
    creep, old = prony_of("silskin_20", 40.0).creep(), prony_of("silskin_20", 20.0).creep()
    usual = 12.0 * contact_state(load_scene("thesis", LIGHT), 1.0).depth
    factor = mean_compliance(old, usual, 0.0, 1.5) / mean_compliance(creep, 0.4 / 0.95, 0.5, 1.0)
    stiff = held.with_(environment=None, finger__modulus_factor=factor)
    assert areas[2] == pytest.approx(contact_state(stiff, 1.0).nominal_contact_area, rel=1e-9)


def test_friction_grows_with_speed_and_a_soft_drive_delays_slip() -> None:
    forces = []
    for speed in (1.0, 16.0):
        fast = load_scene(
            "thesis_slide",
            SLIDE
            | {
                "slide.speed_mm_per_s": speed,
                "slide.speed_exponent": 0.1,
                "slide.shaft": "rigid",
                "press.frame_rate_hz": 10.0,
            },
        )
        forces.append(contact_sequence(fast)[-1].tangential_force[0])
    assert forces[0] == pytest.approx(0.67, rel=1e-9)
    assert forces[1] / forces[0] == pytest.approx(16.0**0.1, rel=1e-9)
    soft = load_scene("thesis_slide", SLIDE | {"slide.shaft": "rigid", "slide.drive_stiffness_N_per_mm": 0.5})
    last = contact_sequence(soft)[-1]
    assert last.tangential_force[0] == pytest.approx(0.67, rel=1e-9)
    assert last.parameters["tip_displacement_mm"] == pytest.approx(8.0 - 0.67 / 0.5, abs=1e-6)


def test_what_cannot_be_is_refused() -> None:
    with pytest.raises(InputError, match=r"environment\.temperature_C"):
        scene(environment__temperature_C=60.0)
    with pytest.raises(InputError, match=r"finger\.material"):
        contact_state(scene(finger__material="silastic_10", environment__temperature_C=30.0), 1.0)
    with pytest.raises(InputError, match=r"press_time_s"):
        load_scene("thesis_slide", {"press.rate_mm_per_min": 10.0})
    with pytest.raises(InputError, match="ramp's own rate"):
        scene().with_(
            {"press.ramp": {"stop_N": 2.0, "rate_N_per_s": 1.0}, "press.forces_N": None, "press.dwell_s": 1.0}
        )
