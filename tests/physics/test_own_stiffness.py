"""A finger whose stiffness stands in the scene: Hertz in closed form, and what is refused."""

from __future__ import annotations

import json

import numpy as np
import pytest

from evanesce.chain.simulate import solve_contact
from evanesce.contact.laws import finger_modulus, smooth_contact
from evanesce.core.errors import InputError
from evanesce.rig import Scene, dump_scene, load_scene

RADIUS = 7.5
GRID = {"grid.samples": 256}
OWN = {"finger.material": "own"}


def hertz_area(force, modulus):
    """H. Hertz (1882): a^3 = 3 F R / (4 E*)."""
    return np.pi * (0.75 * force * RADIUS / modulus) ** (2 / 3)


@pytest.mark.parametrize(
    ("keys", "reduced"),
    [
        ({"finger.modulus_MPa": 0.3}, lambda force: 0.3 / (1 - 0.49**2)),
        ({"finger.reduced_modulus": {"force_N": [1.0, 3.0, 9.0], "modulus_MPa": [0.2, 0.4, 0.5]}},
         lambda force: {0.5: 0.2, 2.0: 0.3, 6.0: 0.45}[force]),
        ({"finger.mooney_rivlin": {"C10_Pa": 20e3, "C01_Pa": 5e3}}, lambda force: 8 * 25e-3),
    ],
)  # fmt: skip
@pytest.mark.parametrize("force", [0.5, 2.0, 6.0])
def test_area_and_depth_are_hertz_of_the_figures(keys, reduced, force):
    """E/(1 - nu^2); straight lines between the columns; an incompressible solid has E* = 4 G = 8 (C10 + C01)."""
    scene = load_scene("thesis", GRID | OWN | keys)
    contact, modulus = smooth_contact(scene, force)
    assert modulus == pytest.approx(reduced(force), rel=1e-12)
    assert np.pi * contact.contact_radius**2 == pytest.approx(hertz_area(force, reduced(force)), rel=1e-12)
    assert contact.depth == pytest.approx(contact.contact_radius**2 / RADIUS, rel=1e-12)


def test_the_field_on_the_grid_has_the_area_and_carries_the_force():
    scene = load_scene("thesis", GRID | OWN | {"finger.modulus_MPa": 0.3})
    state = solve_contact(scene, 4.0, seed=0)[1]
    pixel = (scene.grid.size_mm / scene.grid.samples) ** 2
    assert state.contact_mask.sum() * pixel == pytest.approx(hertz_area(4.0, 0.3 / (1 - 0.49**2)), rel=0.01)
    assert state.pressure.sum() * pixel == pytest.approx(4.0, rel=0.01)


def test_the_columns_of_a_constant_are_that_modulus_and_twice_as_stiff_is_twice():
    """Limits: two equal moduli are one modulus; modulus_factor m gives contact(F, m E*) = contact(F/m, E*)."""
    one = load_scene("thesis", OWN | {"finger.modulus_MPa": 0.3 * (1 - 0.49**2)})
    two = load_scene("thesis", OWN | {"finger.reduced_modulus": {"force_N": [1, 9], "modulus_MPa": [0.3, 0.3]}})
    assert smooth_contact(two, 5.0)[0].contact_radius == pytest.approx(smooth_contact(one, 5.0)[0].contact_radius)
    rising = {"force_N": [0.0, 9.0], "modulus_MPa": [0.2, 0.5]}
    stiff = load_scene("thesis", OWN | {"finger.reduced_modulus": rising, "finger.modulus_factor": 2.0})
    plain = load_scene("thesis", OWN | {"finger.reduced_modulus": rising})
    assert finger_modulus(stiff, 4.0) == pytest.approx(2.0 * finger_modulus(plain, 2.0))


def test_named_materials_keep_their_bytes_and_own_figures_come_back(tmp_path):
    thesis = load_scene("thesis")
    assert "modulus_MPa" not in dump_scene(thesis)
    assert thesis.finger.material == "silskin_0"
    own = load_scene("thesis", OWN | {"finger.mooney_rivlin": {"C10_Pa": 2e4, "C01_Pa": 5e3, "C11_Pa": -100.0}})
    path = tmp_path / "own.toml"
    path.write_text(dump_scene(own))
    assert load_scene(str(path)) == own
    text = path.read_text()
    path.write_text(text.replace('material = "own"\n', ""))
    assert load_scene(str(path)) == own  # figures alone need no name
    assert Scene.model_validate_json(json.dumps(own.as_dict())) == own  # as data sets keep it


@pytest.mark.parametrize(
    ("keys", "says"),
    [
        ({"finger.modulus_MPa": 0.3}, "finger.material = 'silskin_0' and finger.modulus_MPa"),
        (OWN, "'own' alone"),
        (OWN | {"finger.modulus_MPa": 0.3, "finger.mooney_rivlin": {"C10_Pa": 1e4, "C01_Pa": 0.0}}, "mooney_rivlin"),
        (OWN | {"finger.modulus_MPa": -1.0}, "modulus_MPa"),
        (OWN | {"finger.mooney_rivlin": {"C10_Pa": 1e4, "C01_Pa": -2e4}}, "above 0 Pa"),
        (OWN | {"finger.reduced_modulus": {"force_N": [1, 2], "modulus_MPa": [0.1]}}, "modulus"),
        (OWN | {"finger.reduced_modulus": {"force_N": [2, 1], "modulus_MPa": [0.1, 0.2]}}, "does not rise"),
        (OWN | {"finger.modulus_MPa": 0.3, "contact.reduced_modulus_MPa": 0.5}, "both given"),
    ],
)
def test_exactly_one_stiffness(keys, says):
    with pytest.raises(InputError, match="thesis") as caught:
        load_scene("thesis", keys)
    assert says in str(caught.value)
    assert "\n" not in str(caught.value)


def test_beyond_what_was_measured_or_solved():
    columns = load_scene("thesis", OWN | {"finger.reduced_modulus": {"force_N": [1, 5], "modulus_MPa": [0.2, 0.3]}})
    with pytest.raises(InputError, match="up to the last measured, 5 N"):
        smooth_contact(columns, 6.0)
    solved = load_scene("thesis", OWN | {"finger.modulus_MPa": 0.3, "contact": {"law": "fem"}})
    with pytest.raises(InputError, match="no hyperelastic fit"):
        smooth_contact(solved, 2.0)
