"""Design of one's own rig: what is drawn exists on that rig, and its finger's own stiffness is kept."""

from __future__ import annotations

import pytest

import evanesce as ev
from evanesce.design.question import Case, Question, on_case
from evanesce.design.uncertainty import built_scene, draw, sobol_points, uncertainty_of
from evanesce.effects import Context, Stage, active_effects, apply_stage
from evanesce.optics.led import led_positions
from evanesce.rig import load_scene


@pytest.mark.parametrize("name", ["thesis", "gripper", "prism_reader", "pmma_infrared"])
def test_what_is_drawn_is_there_on_the_rig(name: str) -> None:
    scene = load_scene(name)
    uncertainty = uncertainty_of(scene)
    (first,) = (p for p in (*uncertainty.parameters, *uncertainty.new_fields) if p.name == "led_dead.first")
    last = sum(len(centres) for centres in led_positions(scene.plate, scene.leds).values()) - 1
    assert round(first.value(1.0 - 1e-9)) <= last
    assert round(first.value(0.5)) > 0
    for point in sobol_points(uncertainty, 32, seed=3):
        built = built_scene(scene, draw(uncertainty, point))
        apply_stage(Stage.RIG, built, active_effects(built), Context(built, 0))


def test_effects_that_do_not_know_the_finger_are_left_out() -> None:
    printed, smooth = (uncertainty_of(load_scene(name)).left_out for name in ("prism_reader", "thesis"))
    assert "oval contact of a ridged finger" in printed["off_axis_load"]
    assert "off_axis_load" not in smooth
    assert "no ridges" in smooth["ridge_height"]


def test_an_own_stiffness_is_kept_and_gives_way_to_a_named_material() -> None:
    scene = load_scene("prism_reader")
    own = on_case(scene, Case(1.0, (0.0, 0.0), "own"))
    assert own.finger.material == "own"
    assert own.finger == scene.finger.model_copy(update={"position_mm": (0.0, 0.0)})
    named = on_case(scene, Case(1.0, (0.0, 0.0), "silskin_20"))
    assert named.finger.material == "silskin_20"
    assert named.finger.modulus_MPa is named.finger.reduced_modulus is named.finger.mooney_rivlin is None
    Question(forces_N=(1.0,), positions_mm=((0.0, 0.0),), materials=("own",))
    with pytest.raises(ev.InputError, match=r"loads\.materials.*'own'"):
        on_case(load_scene("thesis"), Case(1.0, (0.0, 0.0), "own"))
