"""Effects of the library as candidates: a new file is one more."""

import math
import textwrap

import pytest

import evanesce.effects
from evanesce.contact.solve import contact_state
from evanesce.effects import Context, Stage, active_effects, apply_stage
from evanesce.prediction.candidates import candidates_of
from evanesce.prediction.point import scene_with
from evanesce.prediction.views import View
from evanesce.rig import load_scene

SHAPE = (24, 32)
VIEWS = tuple(View(kind="press", force_N=1.0 + k, condition=k) for k in range(4))


def test_an_effect_file_is_a_candidate_with_no_other_change(tmp_path, monkeypatch):
    (tmp_path / "test_only_haze.py").write_text(
        textwrap.dedent(
            '''
            """Haze."""
            from evanesce.effects.protocol import Effect, Stage
            from evanesce.core.quantities import Strict, field

            class Parameters(Strict):
                """Amount."""
                amount: float = field(0.0, unit="1", bounds=(0.0, 2.0), null=0.0)

            EFFECT = Effect(id="test_only_haze", stage=Stage.SENSOR_LIGHT, parameters=Parameters,
                            amplitudes=("amount",), apply=lambda light, parameters, context: light)
            '''
        )
    )
    monkeypatch.setattr(evanesce.effects, "__path__", [*evanesce.effects.__path__, str(tmp_path)])
    evanesce.effects.all_effects.cache_clear()
    try:
        scene = load_scene("thesis")
        found = {c.id: c for c in candidates_of(scene, {"press"})}["test_only_haze"]
        assert found.names == ("test_only_haze:amount",)
        assert found.parameters[0].deviation == pytest.approx(0.2)
        extended = scene_with(scene, {"test_only_haze:amount": 0.3})
        assert extended.effects["test_only_haze"]["amount"] == 0.3
    finally:
        evanesce.effects.all_effects.cache_clear()


def test_what_an_effect_needs_and_lacks_is_said():
    found = {c.id: c for c in candidates_of(load_scene("thesis"), {"press"})}
    assert found["led_warmup"].missing or found["creep"].missing
    assert found["vignetting"].missing == ()


def test_believed_effects_are_where_a_candidate_starts():
    scene = load_scene("thesis", {"effects.vignetting.k": 0.2})
    found = {c.id: c for c in candidates_of(scene, {"press"})}["vignetting"]
    assert {p.name: p.null for p in found.parameters}["vignetting:k"] == 0.2
    assert scene_with(scene, {"vignetting:k": 0.25}).effects["vignetting"]["k"] == 0.25


def test_a_point_has_coordinates_and_a_scene_has_values():
    """Work of adhesion by its root, the onset of creep by its logarithm; their priors are as wide there."""
    scene = load_scene("thesis")
    found = {c.id: c for c in candidates_of(scene, {"press", "time"})}
    (work,) = found["adhesion"].parameters
    onset = next(p for p in found["creep"].parameters if p.name == "creep:onset_s")
    assert (work.null, work.bounds[0], work.deviation) == (0.0, 0.0, pytest.approx(math.sqrt(0.05)))
    assert (onset.null, onset.bounds) == (pytest.approx(-1.0), (pytest.approx(-4.0), pytest.approx(4.0)))
    assert onset.deviation == pytest.approx(math.log10(1.1 / 0.1))
    made = scene_with(scene, {work.name: 0.3, "creep:per_decade": 0.05, onset.name: 0.5}).effects
    assert made["adhesion"]["work_J_per_m2"] == pytest.approx(0.09)
    assert made["creep"]["onset_s"] == pytest.approx(math.sqrt(10.0))
    believed = load_scene("thesis", {"effects.adhesion.work_J_per_m2": 0.04})
    (own,) = {c.id: c for c in candidates_of(believed, {"press"})}["adhesion"].parameters
    assert (own.null, own.deviation) == (pytest.approx(0.2), pytest.approx(0.3 - 0.2))


def test_area_is_nearly_a_straight_line_of_the_root_of_the_work():
    """By the work itself the slope at nothing is infinite; by its root half the step gives half the area, to 5 %."""
    scene = load_scene("thesis", {"contact.law": "hertz"})

    def area(root: float) -> float:
        there = scene_with(scene, {"adhesion:work_J_per_m2": root})
        rig = apply_stage(Stage.RIG, there, active_effects(there), Context(there, 0))
        return contact_state(rig, 2.0).nominal_contact_area

    none, half, whole = (area(root) for root in (0.0, 0.05, 0.1))
    assert (half - none) / (whole - none) == pytest.approx(0.5, rel=0.05)
