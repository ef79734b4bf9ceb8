"""A human finger: tissue on bone against closed forms, a print by its topology, period and direction, area laws."""

from __future__ import annotations

import numpy as np
import pytest

from evanesce.contact.halfspace.resolved import contact_area
from evanesce.contact.halfspace.solver import press_height_map
from evanesce.contact.ridges.fingerprint import fingerprint_depth, orientation_field
from evanesce.contact.solve import contact_state
from evanesce.core.errors import InputError
from evanesce.rig import Scene, load_scene
from evanesce.rig.finger import Fingerprint

HUMAN = {
    "contact": {"law": "halfspace", "layer_mm": 3.0},
    "finger.material": "own",
    "finger.modulus_MPa": 0.1,
    "grid.size_mm": 14.0,
    "grid.samples": 256,
}


def scene(**more: object) -> Scene:
    return load_scene("thesis", HUMAN | {key.replace("__", "."): value for key, value in more.items()})


def test_a_thin_layer_carries_force_as_the_sixth_power_of_the_radius() -> None:
    # lap p = -(3 G/h^3)(d - r^2/2R), p = p' = 0 at the edge: p = 3 G (a^2 - r^2)^2/(32 R h^3), F = pi G a^6/(32 R h^3)
    modulus, thickness, radius, pitch = 0.4, 0.25, 400.0, 0.125
    axis = (np.arange(256) - 127.5) * pitch
    r2 = axis[None, :] ** 2 + axis[:, None] ** 2
    force = np.pi * (modulus / 4) * 6.0**6 / (32 * radius * thickness**3)
    found = press_height_map(r2 / (2 * radius), pitch, modulus, force, layer=thickness)
    middle = 3 * (modulus / 4) * 6.0**4 / (32 * radius * thickness**3)
    assert found.pressure.max() == pytest.approx(middle, rel=0.05)  # h/a = 0.04
    inside = r2 < 5.0**2
    shape = 3 * (modulus / 4) * (36.0 - r2) ** 2 / (32 * radius * thickness**3)
    assert np.abs(found.pressure - shape)[inside].max() < 0.05 * middle


def test_a_thick_layer_is_a_half_space() -> None:
    axis = (np.arange(128) - 63.5) * 0.1
    heights = (axis[None, :] ** 2 + axis[:, None] ** 2) / 15.0
    thick, endless = (press_height_map(heights, 0.1, 0.4, 0.3, layer=t) for t in (60.0, None))
    # the padded grid's images hold the layer back by their own share of a rigid sinking
    np.testing.assert_allclose(thick.pressure, endless.pressure, atol=0.02 * endless.pressure.max())


def test_the_shipped_finger_touches_on_about_the_area_of_real_ones() -> None:
    # the least of the laws quoted in the thesis's section 5.5: 70.9 F^0.36 mm^2 (Dzidek et al., index finger at 45 deg)
    human = load_scene("human_print")
    smooth = {"finger.modulus_MPa": human.finger.modulus_MPa, "finger.tip_radius_mm": human.finger.tip_radius_mm,
              "finger.diameter_mm": 2 * human.finger.tip_radius_mm, "grid.size_mm": 20.0}  # fmt: skip
    contact = {"law": "halfspace", "layer_mm": human.contact.layer_mm}
    forces = np.array([0.5, 1.0, 2.0, 5.0])
    areas = [
        contact_state(load_scene("thesis", HUMAN | smooth | {"contact": contact}), f).nominal_contact_area
        for f in forces
    ]
    ratio = areas / (70.9 * forces**0.36)
    assert ratio == pytest.approx([0.75, 0.84, 0.94, 1.07], abs=0.02)


def test_area_laws_lie_between_a_half_space_and_a_thin_layer() -> None:
    # literature, thesis section 5.5: exponents 0.36 to 0.42; Hertz 2/3, a thin incompressible layer 1/3
    forces, exponents = np.array([0.3, 1.0, 3.0]), []
    for layer in (1.0, 2.0, 3.5):
        areas = [
            contact_state(scene(contact={"law": "halfspace", "layer_mm": layer}), f).nominal_contact_area
            for f in forces
        ]
        exponents.append(np.polyfit(np.log(forces), np.log(areas), 1)[0])
    assert 1 / 3 < exponents[0] < exponents[1] < exponents[2] < 2 / 3
    assert exponents[0] < 0.48


def test_a_stiffer_skin_keeps_its_furrows_open() -> None:
    areas = []
    for modulus in (None, 0.3, 3.0):
        law = {"law": "halfspace", "layer_mm": 3.0} | ({} if modulus is None else {"skin_modulus_MPa": modulus})
        state = contact_state(scene(contact=law, grid__samples=400, finger__fingerprint={"pattern": "whorl"}), 1.0)
        assert state.pressure.sum() * state.grid.pitch**2 == pytest.approx(1.0, rel=1e-6)
        areas.append(state.nominal_contact_area)
    assert areas[0] > areas[1] > 1.5 * areas[2]


def test_a_ridged_pad_touches_less() -> None:
    smooth = contact_state(scene(grid__samples=400), 1.0)
    printed = contact_state(scene(grid__samples=400, finger__fingerprint={"pattern": "whorl", "seed": 3}), 1.0)
    assert printed.law == "halfspace+fingerprint"
    assert printed.pressure.sum() * printed.grid.pitch**2 == pytest.approx(1.0, rel=1e-6)
    assert 0.3 < printed.nominal_contact_area / smooth.nominal_contact_area < 0.9
    assert printed.nominal_contact_area == pytest.approx(contact_area(printed.pressure > 0, printed.grid.pitch))


@pytest.mark.parametrize(("pattern", "cores", "deltas"), [("arch", 0, 0), ("loop", 1, 1), ("whorl", 2, 2)])
def test_the_field_turns_by_half_a_turn_about_each_singular_point(pattern: str, cores: int, deltas: int) -> None:
    def index(x: float, y: float, radius: float) -> float:
        t = np.linspace(0, 2 * np.pi, 721)
        theta = orientation_field(pattern, x + radius * np.cos(t), y + radius * np.sin(t))
        step = np.mod(np.diff(theta) + np.pi / 2, np.pi) - np.pi / 2
        return float(step.sum() / (2 * np.pi))

    assert index(0.0, 0.0, 2.0) == pytest.approx(0.5 * cores, abs=1e-9)
    if deltas:
        assert index(-4.5 if deltas == 1 else -5.5, 6.0, 1.0) == pytest.approx(-0.5, abs=1e-9)
    assert index(0.0, 2.0, 14.0) == pytest.approx(0.5 * (cores - deltas), abs=1e-9)


@pytest.mark.parametrize("pattern", ["arch", "loop", "whorl"])
def test_ridges_have_their_period_and_follow_the_field(pattern: str) -> None:
    skin = Fingerprint(pattern=pattern, ridge_period_um=500.0, pore_spacing_um=0.0, seed=7)
    axis = np.arange(-7.0, 7.0, 0.05)
    x, y = np.meshgrid(axis, axis)
    depth, known = fingerprint_depth(skin, x, y)
    assert known.all()
    assert 0.0 <= depth.min() < 0.005 < 0.055 < depth.max() <= 0.0615
    part = depth[20:120, 90:190] - depth[20:120, 90:190].mean()
    power = np.abs(np.fft.fftshift(np.fft.fft2(part * np.outer(np.hanning(100), np.hanning(100))))) ** 2
    f = np.fft.fftshift(np.fft.fftfreq(100, 0.05))
    near = np.hypot(f[None, :], f[:, None])
    assert (power * near)[near < 4].sum() / power[near < 4].sum() == pytest.approx(
        2.0, rel=0.08
    )  # rings are curved within the window
    gy, gx = np.gradient(depth, 0.05)
    # the gradient points across the ridges: double angles, averaged over a millimetre
    double = (gx + 1j * gy) ** 2
    local = sum(np.roll(double, (i, j), (0, 1)) for i in range(-8, 9, 2) for j in range(-8, 9, 2))
    field = orientation_field(pattern, x, y)
    away = np.abs(np.angle(-local * np.exp(-2j * field)))[30:-30, 30:-30] / 2
    assert np.median(np.degrees(away)) < 5.0


def test_seeds_pores_and_turns() -> None:
    x, y = np.meshgrid(np.arange(-4, 4, 0.02), np.arange(-4, 4, 0.02))
    plain = fingerprint_depth(Fingerprint(pore_spacing_um=0.0), x, y)[0]
    pored = fingerprint_depth(Fingerprint(), x, y)[0]
    assert np.array_equal(plain, fingerprint_depth(Fingerprint(pore_spacing_um=0.0), x, y)[0])
    deeper = pored > plain + 0.03
    assert 0.002 < deeper.mean() < 0.03
    assert (plain[deeper] < 0.03).mean() > 0.8  # they open on ridges
    other = fingerprint_depth(Fingerprint(pore_spacing_um=0.0, seed=1), x, y)[0]
    assert abs(np.corrcoef(plain.ravel(), other.ravel())[0, 1]) < 0.5  # one field, other endings
    turned = fingerprint_depth(Fingerprint(pore_spacing_um=0.0, orientation_deg=90.0), -y, x)[0]
    np.testing.assert_allclose(turned, plain, atol=1e-9)


def test_what_is_no_finger_is_refused() -> None:
    with pytest.raises(InputError, match="too coarse"):
        contact_state(scene(grid__samples=64, finger__fingerprint={}), 1.0)
    with pytest.raises(InputError, match="another relief"):
        scene(finger__fingerprint={}, finger__ridges={"pitch_um": 900.0})
    with pytest.raises(InputError, match=r"layer_mm"):
        scene(contact={"law": "halfspace", "layer_mm": 2.0, "work_of_adhesion_N_per_mm": 1e-4})
    with pytest.raises(InputError, match="skin_modulus_MPa"):
        scene(contact={"law": "halfspace", "skin_modulus_MPa": 2.0})
    with pytest.raises(InputError, match="no print"):
        load_scene("thesis_slide", {"finger.fingerprint": {}})
