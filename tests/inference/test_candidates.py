"""Effects of the library as candidates: a new file is one more."""

import textwrap

import pytest

import evanesce.effects
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
