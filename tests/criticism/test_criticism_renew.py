"""Loud causes are compared as finely predicted where each of them ended, not where the believed rig was."""

from __future__ import annotations

from dataclasses import fields
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from evanesce.core.errors import InputError
from evanesce.criticism import renew, search
from evanesce.criticism.answer import Findings
from evanesce.criticism.extend import Extension
from evanesce.criticism.score import Scored, ScoreTest
from evanesce.prediction.fine import FineFrames, in_pixels
from evanesce.prediction.frozen import FROZEN
from evanesce.prediction.linear import Score
from evanesce.prediction.observe import model_factor, model_scene
from evanesce.prediction.parameters import Parameter
from evanesce.prediction.predict import Predictor
from evanesce.prediction.views import View
from evanesce.rig import load_scene

VIEWS = (
    View(kind="press", force_N=1.3, voltage_V=9.0, index=0, condition=0),
    View(kind="press", force_N=3.7, voltage_V=9.4, index=1, condition=1),
    View(kind="lens_cap"),
)


def test_where_a_fit_ended_the_prediction_is_the_fine_one_and_the_believed_rigs_stays() -> None:
    """A fifth of the modulus moves the edge by half a millimetre; what was put right at the old edge misses it."""
    believed = load_scene(
        "thesis",
        {
            "camera.resolution_px": [160, 120],
            "camera.scale_px_per_mm": 58.37 / 12.5,
            "camera.pixel.pitch_um": 38.75,
            "finger.position_mm": [1.3, -0.7],
            "grid.samples": 512,
        },
    )
    factor, predictor = model_factor(believed), Predictor(model_scene(believed), VIEWS)
    predictor.correction = old = FineFrames(believed, VIEWS, factor, {}).cube() - predictor.cube({})
    point = {"modulus:relative": -0.35, "@light": 0.02}
    fitted: Any = SimpleNamespace(point=point, parameters=())
    problem: Any = SimpleNamespace(predictor=predictor, coded=None)
    case: Any = SimpleNamespace(observation=SimpleNamespace(believed=believed))

    def put(of: Any, predictor: Predictor) -> Any:
        return SimpleNamespace(predictor=predictor, coded=of.coded)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(renew, "replace", put)
        anew = renew.at_fitted(case, problem, fitted)
    exact = FineFrames(believed, VIEWS, factor, point).cube()
    np.testing.assert_allclose(anew.predictor.cube(point), exact, atol=1e-9)
    assert predictor.correction is old
    left = np.abs(predictor.cube(point) - exact).max()
    assert left > 1.0, "nothing to put right"
    # Beside that point it is still nearly right: a fit may move.
    beside = {**point, "modulus:relative": -0.345}
    off = np.abs(anew.predictor.cube(beside) - FineFrames(believed, VIEWS, factor, beside).cube()).max()
    assert off < 0.5 * left


def test_marks_at_places_from_the_data_and_a_codecs_change_are_in_what_is_predicted_anew() -> None:
    believed = load_scene(
        "thesis",
        {"camera.resolution_px": [160, 120], "camera.scale_px_per_mm": 58.37 / 12.5, "camera.pixel.pitch_um": 38.75},
    )
    views, point = VIEWS[:1], {"specks:marks": 1.4}
    predictor = Predictor(model_scene(believed), views)
    places = {"mark_x_mm": (1.1, -6.2), "mark_y_mm": (7.4, 5.0), "mark_light_mm2": (0.2, 0.5)}
    predictor.fixed = {"specks": places}
    predictor.correction = np.zeros_like(predictor.cube({}))
    bias = np.random.default_rng(3).normal(0.0, 2.0, predictor.correction.shape)
    case: Any = SimpleNamespace(observation=SimpleNamespace(believed=believed))
    fitted: Any = SimpleNamespace(point=point, parameters=())
    found = {}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(renew, "replace", lambda of, predictor: SimpleNamespace(predictor=predictor))
        for name, coded in (("plain", None), ("coded", SimpleNamespace(bias=bias))):
            problem: Any = SimpleNamespace(predictor=predictor, coded=coded)
            found[name] = renew.at_fitted(case, problem, fitted).predictor.cube(point)
    factor = model_factor(believed)
    exact = FineFrames(believed, views, factor, point, fixed=predictor.fixed).cube()
    np.testing.assert_allclose(found["plain"], exact, atol=1e-9)
    np.testing.assert_allclose(found["coded"], exact + bias, atol=1e-9)
    # The marks themselves are there: without them the frame is another one.
    assert np.abs(exact - FineFrames(believed, views, factor, {}).cube()).max() > 3.0


def test_a_second_cause_is_sought_by_the_prediction_that_named_the_first(monkeypatch: pytest.MonkeyPatch) -> None:
    """And the first one's evidence is what the second one's is counted from."""
    asked: list[tuple[Any, Any, Any]] = []
    names = iter(["modulus", "vignetting"])

    def for_good(case: Any, problem: Any, base: Any, known: Any, tried: Any) -> list[tuple[Any, Any]]:
        asked.append((problem, base, known and known.ids))
        return [(None, next(names))]

    def again(case: Any, problem: Any, base: Any, known: Any, tried: Any) -> list[Extension]:
        ((_, name),) = tried
        ids = (*(known.ids if known else ()), name)
        return [extension(name, 500.0 * len(ids), ids=ids, problem=f"anew for {name}", fitted=f"fit of {name}")]

    monkeypatch.setattr(search, "fitted_for_good", for_good)
    monkeypatch.setattr(search, "renewed", again)
    monkeypatch.setattr(search, "acceptable", lambda better, known, library: True)
    found = Findings(global_p=1e-4, first=ScoreTest((), 1e-4, 4999), battery=None)  # type: ignore[arg-type]
    ps = iter([1e-4, 0.9])
    monkeypatch.setattr(search, "test", lambda case, signatures, base, number: ScoreTest((), next(ps), 4999))
    monkeypatch.setattr(search, "ring", lambda case, base, number: (SimpleNamespace(global_p=0.5), None))
    case: Any = SimpleNamespace(problem="believed", base="base", codec=False)
    search.search(case, [], found)
    assert asked == [("believed", "base", None), ("anew for modulus", "fit of modulus", ("modulus",))]
    assert found.best is not None
    assert (found.best.ids, found.best.problem) == (("modulus", "vignetting"), "anew for vignetting")


def test_a_centre_in_pixels_stays_where_it_is_on_finer_ones() -> None:
    """Rationale: a vignette's centre, in pixels of the model camera, lay at a third of its offset in the fine picture.

    A fall of light has little that finer pixels could change: the fine picture is the quick one, edges aside.
    """
    believed = load_scene(
        "thesis",
        {"camera.resolution_px": [160, 120], "camera.scale_px_per_mm": 58.37 / 12.5, "camera.pixel.pitch_um": 38.75},
    )
    views, point = VIEWS[:1], {"vignetting:k": 0.6, "vignetting:centre_offset_px[0]": 31.0}
    predictor = Predictor(model_scene(believed), views)
    changed = predictor.cube(point) - predictor.cube({})
    factor = model_factor(believed)
    none = FineFrames(believed, views, factor, {}).cube()
    off = np.abs(FineFrames(believed, views, factor, point).cube() - none - changed).mean()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("evanesce.prediction.fine.in_pixels", lambda point, smaller: dict(point))
        wrong = np.abs(FineFrames(believed, views, factor, point).cube() - none - changed).mean()
    assert off < 0.5 * wrong, (off, wrong)
    real = in_pixels({"vignetting:centre_offset_px[0]": 31.0, "vignetting:k": 0.6, "@pose_x[0]": 1.0}, 5.0)
    assert real == {"vignetting:centre_offset_px[0]": 155.0, "vignetting:k": 0.6, "@pose_x[0]": 1.0}


def scored(name: str, log_bayes: float, change: float = 0.0) -> Scored:
    """Return a candidate by its linear evidence and the size of the change that a straight line ascribes to it."""
    result = Score(2 * log_bayes, 1, np.array([1.0]), np.eye(1), log_bayes)
    signature = SimpleNamespace(id=name, rows=np.array([[change, 0.0, 0.0]]))
    return Scored(signature, result, -1, 1.0, 0.1, np.eye(1))  # type: ignore[arg-type]


def extension(name: str, log_bayes: float, change: float = 0.0, **more: Any) -> Extension:
    known: dict[str, Any] = {f.name: None for f in fields(Extension)}
    cause = SimpleNamespace(id=name, signal=np.array([change, 0.0]))
    own = Parameter(name=f"{name}:x", deviation=1.0, step=0.1, linear=more.pop("linear", False))
    fitted = SimpleNamespace(parameters=(own,))
    mine = {"ids": (name,), "log_bayes": log_bayes, "cause": cause, "fitted": fitted, "problem": "old"}
    return Extension(**(known | mine | more))


@pytest.fixture
def anew(monkeypatch: pytest.MonkeyPatch) -> dict[str, float]:
    """Return the evidence that each cause has once predicted anew; a cause not in it may not be asked."""
    found: dict[str, float] = {}
    monkeypatch.setattr(renew, "at_fitted", lambda case, problem, fitted: "new")

    def again(problem: Any, base: Any, known: Any, scored: Scored, found_before: Extension) -> Extension:
        return extension(scored.id, found[scored.id], problem=problem)

    monkeypatch.setattr(renew, "extend_again", again)
    return found


def told(tried: list[tuple[Scored, Extension]]) -> dict[str, tuple[float, Any]]:
    case: Any = SimpleNamespace(notes=[])
    extensions = renew.renewed(case, None, None, None, tried)  # type: ignore[arg-type]
    return {e.ids[0]: (e.log_bayes, e.problem) for e in extensions}


def test_a_loud_cause_is_judged_by_the_fine_prediction_where_it_ended(anew: dict[str, float]) -> None:
    """A stiffening bone had the better derivative of 3 % of modulus; a line or a faint rival is left as it is."""
    loud = np.sqrt(2 * 3000.0 / FROZEN.search["quick_share"])
    anew.update(bone_stiffening=4777.0, modulus=4896.0)
    found = told(
        [
            (scored("bone_stiffening", 4040.0), extension("bone_stiffening", 3737.0, loud)),
            (scored("modulus", 520.0), extension("modulus", 2400.0, loud)),
            (scored("vignetting", 560.0), extension("vignetting", 500.0, 30.0)),
            (scored("residue_film", 560.0), extension("residue_film", 3000.0, loud, linear=True)),
        ]
    )
    assert found["modulus"] == (4896.0, "new")
    assert found["bone_stiffening"] == (4777.0, "new")
    assert found["vignetting"] == (500.0, "old")
    assert found["residue_film"] == (3000.0, "old")


def test_what_only_a_line_knows_is_no_bar_for_what_can_be_predicted_anew(anew: dict[str, float]) -> None:
    """A film in the glass, 9000 nats by a straight line, kept both others from being put right."""
    loud = np.sqrt(2 * 3000.0 / FROZEN.search["quick_share"])
    anew.update(bone_stiffening=4777.0, modulus=4896.0)
    found = told(
        [
            (scored("glass_absorption", 9000.0), extension("glass_absorption", 9000.0, loud, linear=True)),
            (scored("bone_stiffening", 4040.0), extension("bone_stiffening", 3737.0, loud)),
            (scored("modulus", 520.0), extension("modulus", 2400.0, loud)),
        ]
    )
    assert found["modulus"] == (4896.0, "new")
    assert found["bone_stiffening"] == (4777.0, "new")


def test_the_best_is_predicted_anew_until_it_settles_and_a_point_that_none_can_render_ends_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    gains = {"modulus": iter([4896.0, 4990.0, 4990.3, 9999.0]), "adhesion": iter([4000.0])}
    monkeypatch.setattr(renew, "at_fitted", lambda case, problem, fitted: "new")

    def again(problem: Any, base: Any, known: Any, scored: Scored, before: Extension) -> Extension:
        if scored.id == "ridge_height":
            raise InputError("the finger has no ridges")
        return extension(scored.id, next(gains[scored.id]), problem=problem)

    monkeypatch.setattr(renew, "extend_again", again)
    loud = np.sqrt(2 * 3000.0 / FROZEN.search["quick_share"])
    case: Any = SimpleNamespace(notes=[])
    names = {"modulus": 4800.0, "adhesion": 4500.0, "ridge_height": 4400.0}
    tried = [(scored(k, v), extension(k, v, loud)) for k, v in names.items()]
    found = {e.ids[0]: (e.log_bayes, e.problem) for e in renew.renewed(case, None, None, None, tried)}  # type: ignore[arg-type]
    assert found == {"modulus": (4990.3, "new"), "adhesion": (4000.0, "new"), "ridge_height": (4400.0, "old")}
    assert case.notes == ["ridge_height could not be predicted anew: the finger has no ridges"]


def test_a_faint_cause_is_not_predicted_anew(anew: dict[str, float]) -> None:
    faint = 0.9 * FROZEN.search["renew_nats"]
    found = told([(scored("modulus", faint), extension("modulus", faint, 100.0))])
    assert found == {"modulus": (faint, "old")}


def test_of_loud_causes_one_that_the_quick_prediction_may_have_misjudged_is_fitted(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Modulus has an eighth of the bone's linear evidence: derivatives of a moving edge are that bad. It is tried."""
    monkeypatch.setattr(search, "extend", lambda p, b, k, s: extension(s.id, s.result.log_bayes))
    loud = np.sqrt(2 * 4000.0 / FROZEN.search["quick_share"])
    tried = [
        scored("bone_stiffening", 4040.0, loud),
        scored("adhesion", 562.0),
        scored("real_contact", 554.0),
        scored("modulus", 522.0, loud),
        scored("vignetting", 443.0, 10.0),
    ]
    case: Any = SimpleNamespace(notes=[])
    found = search.fitted_for_good(case, None, None, None, tried)  # type: ignore[arg-type]
    assert [e.ids[0] for _, e in found] == ["bone_stiffening", "adhesion", "real_contact", "modulus"]
