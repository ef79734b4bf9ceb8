"""A liquid about the contact: transfer matrices, volume by quadrature, Stribeck, both renderers."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import brentq

from evanesce.chain.simulate import simulate
from evanesce.contact.analytic.hertz import hertz_contact
from evanesce.contact.liquid import lubricated
from evanesce.contact.solve import contact_sequence, contact_state
from evanesce.core.errors import InputError
from evanesce.materials.friction import InterfaceFriction, coulomb
from evanesce.optics.liquid import film_transmittance, liquid_coupling, lit_contact
from evanesce.render.fast.transport import render_fast
from evanesce.render.reference.path import render
from evanesce.rig import Scene, load_scene
from evanesce.rig.liquid import Liquid

LIGHT = {
    "grid.samples": 256,
    "grid.size_mm": 10.0,
    "contact": {"law": "hertz", "reduced_modulus_MPa": 0.4},
    "camera.resolution_px": [96, 72],
    "camera.scale_px_per_mm": 6.0,
    "camera.pixel.pitch_um": 15.0,
}
WATER = {"volume_uL": 0.3}


def scene(**more: object) -> Scene:
    return load_scene("thesis", LIGHT | {key.replace("__", "."): value for key, value in more.items()})


def matrix_transmittance(theta: float, thickness: float, indices: tuple[float, float, float]) -> float:
    """Return the unpolarised transmittance of a film by Abeles's matrices; thickness in wavelengths."""
    sine = indices[0] * np.sin(theta)
    cosines = [np.sqrt(1 - (sine / n) ** 2 + 0j) for n in indices]
    total = 0.0
    for polarisation in "sp":
        y = [n * c if polarisation == "s" else n / c for n, c in zip(indices, cosines, strict=True)]
        phase = 2 * np.pi * thickness * indices[1] * cosines[1]
        m = np.array([[np.cos(phase), -1j * np.sin(phase) / y[1]], [-1j * y[1] * np.sin(phase), np.cos(phase)]])
        b, c = m @ [1, y[2]]
        total += 0.5 * (1 - abs((y[0] * b - c) / (y[0] * b + c)) ** 2)
    return float(total)


@pytest.mark.parametrize("index", [1.333, 1.38, 1.47])
@pytest.mark.parametrize("angle", [10.0, 43.0, 55.0, 60.5])
def test_a_thick_film_is_the_mean_over_thicknesses_of_transfer_matrices(index: float, angle: float) -> None:
    theta, indices = np.radians(angle), (1.523, index, 1.41)
    # one period of the phase, evenly: the mean over a smooth periodic function converges at once
    period = 0.5 / (index * np.sqrt(1 - (1.523 * np.sin(theta) / index) ** 2))
    mean = np.mean([matrix_transmittance(theta, period * (7 + k / 64), indices) for k in range(64)])
    assert float(film_transmittance(np.cos(theta), *indices)) == pytest.approx(mean, rel=1e-9)


def test_coupling_by_index() -> None:
    assert liquid_coupling(1.523, 1.41, 1.41) == pytest.approx(1.0, rel=1e-12)
    assert liquid_coupling(1.523, 1.0001, 1.41) < 0.002
    water, glycerol = liquid_coupling(1.523, 1.333, 1.41), liquid_coupling(1.523, 1.473, 1.41)
    assert 0.7 < water < 0.85 < 1.0 < glycerol < 1.02  # between two media a third reflects less
    # water admits (1.333^2 - 1)/(1.41^2 - 1) of the guided range; Fresnel at grazing angles takes the rest
    assert water == pytest.approx(0.95 * (1.333**2 - 1) / (1.41**2 - 1), rel=0.02)


def test_the_liquid_keeps_its_volume_and_contact_its_area() -> None:
    dry, wet = contact_state(scene(), 1.2), contact_state(scene(liquid=WATER), 1.2)
    contact = hertz_contact(1.2, 7.5, 0.4)
    a = contact.contact_radius

    def volume(b: float) -> float:
        return quad(lambda r: 2 * np.pi * r * float(contact.gap(np.array([r]))[0]), a, b, epsrel=1e-10)[0]

    edge = brentq(lambda b: volume(b) - 0.3, a, 5.0)
    assert wet.wetted is not None
    assert wet.wetted.sum() * wet.grid.pitch**2 == pytest.approx(np.pi * edge**2, rel=1e-3)
    assert wet.parameters["liquid_height_mm"] == pytest.approx(float(contact.gap(np.array([edge]))[0]), rel=5e-3)
    assert np.array_equal(wet.contact_mask, dry.contact_mask)
    assert wet.nominal_contact_area == dry.nominal_contact_area


def test_no_liquid_changes_no_bit() -> None:
    dry = contact_state(scene(), 1.2)
    none = contact_state(scene(liquid={"volume_uL": 0.0}), 1.2)
    assert none.wetted is None
    assert np.array_equal(none.gap, dry.gap)
    assert none.parameters == dry.parameters
    assert lit_contact(scene(), dry) is dry
    friction = coulomb(0.7)
    assert lubricated(friction, Liquid(volume_uL=0.0), force=1.0, area=10.0, radius=7.5, modulus=0.4) is friction
    plain, null = (
        simulate(scene(effects=effects), 1.2, seed=3, render=render_fast).frame.data
        for effects in ({}, {"liquid_film": {"volume_uL": 0.0}})
    )
    assert np.array_equal(plain, null)


def test_the_effect_is_the_scenes_own_liquid() -> None:
    by_scene = simulate(scene(liquid=WATER), 1.2, seed=3, render=render_fast)
    by_effect = simulate(scene(effects={"liquid_film": WATER}), 1.2, seed=3, render=render_fast)
    assert np.array_equal(by_scene.frame.data, by_effect.frame.data)


def test_the_path_tracer_sees_the_same_rim() -> None:
    wet = scene(liquid=WATER, effects={})
    state = contact_state(wet, 1.2)
    traced = render(wet, state, samples_per_pixel=256, passes=8, seed=1)
    fast = render_fast(wet, state).radiance
    projected = fast > 0.02 * fast.max()
    dry = render_fast(wet, contact_state(scene(), 1.2)).radiance
    rim = projected & (fast > 1.5 * dry)
    assert rim.sum() > 100
    found, error = traced.radiance[rim].mean(), np.sqrt(traced.variance[rim].sum()) / rim.sum()
    assert fast[rim].mean() == pytest.approx(found, abs=4 * error + 0.03 * found)
    assert fast[rim].mean() > 5.0 * dry[rim].mean()


def test_a_film_by_hamrock_and_dowson_in_other_units_and_stribecks_curve() -> None:
    oil = Liquid(volume_uL=5.0, viscosity_mPa_s=300.0, roughness_um=2.0)
    dry = InterfaceFriction(0.02, 0.3)
    wet = lubricated(dry, oil, force=0.8, area=14.0, radius=7.5, modulus=0.4)
    # SI: eta 0.3 Pa s, u 5 mm/s of a slide at 10 mm/s, E' 0.8 MPa, R 7.5 mm
    u, w = 0.3 * 5e-3 / (0.8e6 * 7.5e-3), 0.8 / (0.8e6 * 7.5e-3**2)
    film_mm = 1e3 * 7.5e-3 * 7.32 * (1 - 0.72 * np.exp(-0.28)) * u**0.64 * w**-0.22
    assert wet.film(10.0) == pytest.approx(film_mm, rel=1e-12)
    mu = np.array([float(wet.speed_factor(v)) for v in np.logspace(-4, 4, 60)]) * (0.02 * 14.0 / 0.8 + 0.3)
    assert mu[0] == pytest.approx(0.65, rel=1e-3)
    low = int(np.argmin(mu))
    assert 0 < low < 59
    assert mu[low] < 0.2 * mu[0]
    assert (np.diff(mu[:low]) < 0).all()
    assert (np.diff(mu[low:]) > 0).all()
    # full film: Couette's eta v A/(h F)
    last = 0.3e-6 * 1e4 * 14.0 / (wet.film(1e4) * 0.8)
    assert mu[-1] == pytest.approx(last, rel=1e-6)


def test_a_wet_slide_slips_at_its_lubricated_force() -> None:
    base = LIGHT | {
        "grid.size_mm": 26.0,
        "slide.shaft": "rigid",
        "liquid": {"volume_uL": 2.0, "viscosity_mPa_s": 200.0},
    }
    wet = load_scene("thesis_slide", base)
    last = contact_sequence(wet)[-1]
    friction = lubricated(
        coulomb(0.67),
        Liquid(volume_uL=2.0, viscosity_mPa_s=200.0),
        force=1.0,
        area=last.nominal_contact_area,
        radius=7.5,
        modulus=0.4,
    )
    assert last.tangential_force[0] == pytest.approx(0.67 * float(friction.speed_factor(5.0)), rel=1e-6)
    assert 0.05 < last.tangential_force[0] < 0.6
    assert last.wetted is not None


def test_what_is_no_liquid_is_refused() -> None:
    with pytest.raises(InputError, match=r"liquid\.refractive_index"):
        scene(liquid={"volume_uL": 1.0, "refractive_index": 1.7})
    with pytest.raises(InputError, match=r"liquid\.volume_uL"):
        scene(liquid={"volume_uL": -1.0})


def test_a_vanishing_volume_leaves_dry_friction() -> None:
    dry, oil = coulomb(0.67), {"viscosity_mPa_s": 200.0, "roughness_um": 1.0}

    def factor(volume: float) -> float:
        wet = lubricated(dry, Liquid(volume_uL=volume, **oil), force=1.0, area=18.0, radius=7.5, modulus=0.77)
        return float(wet.speed_factor(5.0))

    full = factor(100.0)
    assert full < 0.3
    assert factor(2.0) == pytest.approx(full, rel=1e-12)  # as much as the film takes up
    assert factor(1e-6) == pytest.approx(float(dry.speed_factor(5.0)), rel=1e-3)
    some = [factor(v) for v in (1e-6, 3e-3, 1e-2, 1.5e-2, 2e-2, 1.0)]
    assert all(a >= b for a, b in pairwise(some))


def test_a_volume_that_finds_no_room_is_told() -> None:
    state = contact_state(load_scene("wet", {"liquid.volume_uL": 1000.0}), 1.0)
    room = np.asarray(state.gap)[np.asarray(state.contact_mask) < 1.0].sum() * state.grid.pitch**2
    assert state.parameters["liquid_left_uL"] == pytest.approx(1000.0 - room, rel=1e-6)
    assert contact_state(load_scene("wet"), 1.0).parameters["liquid_left_uL"] == 0.0
