"""Fits and score tests of the critic on a linear toy whose truth is known, and effects as candidates."""

import textwrap
from dataclasses import dataclass, fields, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy import ndimage, stats

import evanesce.effects
from evanesce.core.errors import InputError
from evanesce.criticism import case
from evanesce.criticism.case import FAR, PLACES, ROUGH, anchored, finely_fitted, left_by_derivatives, settled
from evanesce.criticism.extend import NEARER, Extension, _nearer, at_bound, condition_of_bins, extend, held_out_gain
from evanesce.criticism.problem import Problem, fit
from evanesce.criticism.residuals import noise_draws
from evanesce.criticism.score import score_test
from evanesce.criticism.signatures import Signature, signature_of
from evanesce.prediction.candidates import Candidate, candidates_of
from evanesce.prediction.noise import noise_of
from evanesce.prediction.parameters import Parameter, derivative
from evanesce.prediction.predict import scene_with
from evanesce.prediction.views import View
from evanesce.rig import load_scene

SHAPE = (24, 32)
VIEWS = tuple(View(kind="press", force_N=1.0 + k, condition=k) for k in range(4))


@dataclass
class Toy:
    """A prediction that is a known function of its point."""

    maps: dict
    views: tuple = VIEWS
    bend: float = 0.0

    def cube(self, point, only=None):
        total = np.full((len(self.views), *SHAPE), 50.0)
        for name, amount in point.items():
            total = total + (amount + self.bend * amount**2) * self.maps[name]
        kept = np.zeros(len(self.views), bool)
        kept[list(range(len(self.views)) if only is None else only)] = True
        return np.where(kept[:, None, None], total, np.nan)


def parameter(name, **more):
    return Parameter(**({"name": name, "deviation": 1.0, "step": 0.1} | more))


@pytest.fixture
def toy():
    rng = np.random.default_rng(17)
    return Toy({name: ndimage.gaussian_filter(rng.standard_normal((4, *SHAPE)), 2) for name in ("a:x", "b:y", "@n")})


def problem_of(toy, data, fields):
    tone = SimpleNamespace(variance_at=lambda level: np.full_like(level, 16.0))
    noise = noise_of({}, tone, SHAPE, floor_DN=1e-3, flicker=0.0)
    noise = type(noise)(tone, noise.levels, noise.ratio, 0.0, fields, True, 1e-3)
    return Problem.of(toy, data, noise, np.zeros_like(data), [0, 1, 2, 3], toy.cube({}))


def noise_fields(rng, blur):
    fields = ndimage.gaussian_filter(rng.standard_normal((40, *SHAPE)), (0, blur, blur), mode="wrap")
    return fields / fields.std()


@pytest.mark.parametrize("bend", [0.0, 0.3])
def test_fit_finds_what_was_put_in(toy, bend):
    """Within 4 posterior standard deviations, also where the prediction is bent and derivatives are those at null."""
    toy.bend = bend
    rng = np.random.default_rng(2)
    data = toy.cube({"a:x": 0.8, "@n": -0.4}) + rng.standard_normal((4, *SHAPE))
    found = fit(problem_of(toy, data, noise_fields(rng, 0)), [parameter("a:x"), parameter("@n")], {}, secant=bend > 0)
    sd = np.sqrt(np.diag(found.covariance()))
    assert abs(found.point["a:x"] - 0.8) < 4 * sd[0]
    assert abs(found.point["@n"] + 0.4) < 4 * sd[1]


def test_fit_stays_within_bounds(toy):
    data = toy.cube({"a:x": -2.0})
    rng = np.random.default_rng(2)
    found = fit(problem_of(toy, data, noise_fields(rng, 0)), [parameter("a:x", bounds=(0.0, 5.0))], {"a:x": 0.5})
    assert found.point["a:x"] >= 0.0


def test_derivative_at_a_bound_is_as_exact_as_a_central_one(toy):
    """Of a parabola both are exact; a one-sided difference of first order would be off by bend times step."""
    toy.bend = 0.7
    for bounds in ((-9.0, 9.0), (0.0, 9.0), (-9.0, 0.0)):
        found = derivative(toy, {}, parameter("a:x", bounds=bounds), [0, 1, 2, 3])
        np.testing.assert_allclose(found, toy.maps["a:x"], rtol=1e-9, atol=1e-12)


def signatures(problem, toy):
    found = []
    for name in ("a:x", "b:y"):
        effect = SimpleNamespace(id=name[0])
        row = problem.whitened(toy.maps[name])[None].astype(np.float32)
        found.append(Signature(Candidate(effect, (parameter(name),), ()), row, np.ones(1), True))
    return found


@pytest.mark.parametrize("blur", [0.0, 1.0])
def test_false_alarms_at_5_percent_are_5_percent_in_correlated_noise(toy, blur):
    """100 cases; 4 standard errors of a 5 % rate are 9 %."""
    rng = np.random.default_rng(4)
    alarms = 0
    for _ in range(100):
        data = toy.cube({}) + noise_fields(rng, blur)[:4]
        problem = problem_of(toy, data, noise_fields(rng, blur))
        base = fit(problem, [parameter("@n")], {}, rounds=2)
        alarms += score_test(problem, base, signatures(problem, toy), draws=99, rng=rng).p <= 0.05
    assert alarms / 100 < 0.14


def test_the_right_candidate_scores_highest(toy):
    rng = np.random.default_rng(9)
    data = toy.cube({"b:y": 1.5, "@n": 2.0}) + noise_fields(rng, 0.7)[:4]
    problem = problem_of(toy, data, noise_fields(rng, 0.7))
    base = fit(problem, [parameter("@n", deviation=50.0)], {}, rounds=2)
    found = score_test(problem, base, signatures(problem, toy), draws=499, rng=rng)
    assert found.scored[0].id == "b"
    assert found.p <= 0.01


def test_a_fit_that_stopped_short_lends_no_candidate_what_it_left(toy):
    """Rationale: nulls were called unknown. Nuisances take all but 1/300 of some candidates; 0.3 deviations left of the
    nuisance were worth 60 nats to them. Scores have to be those of the settled fit, within the bend's own size."""
    rng = np.random.default_rng(5)
    toy.maps["a:x"] = 300.0 * toy.maps["@n"] + toy.maps["a:x"]
    data = toy.cube({"@n": 0.7}) + rng.standard_normal((4, *SHAPE)) * 4
    problem = problem_of(toy, data, noise_fields(rng, 0))
    best = fit(problem, [parameter("@n", deviation=50.0)], {})
    point = {"@n": best.point["@n"] + 0.3 * float(np.sqrt(best.covariance()[0, 0]))}
    short = replace(best, point=point, residual=problem.residual(toy.cube(point)))
    found = [score_test(problem, f, signatures(problem, toy), draws=99, rng=rng).of("a").result for f in (best, short)]
    assert found[1].statistic == pytest.approx(found[0].statistic, abs=0.01)
    # What the residual itself, projected or not, would have said of the shorter fit.
    row = problem.whitened(toy.maps["a:x"])
    information = best.metric(best.parameters).project(row) @ row
    assert (row @ short.residual) ** 2 / information > 100 * max(found[0].statistic, 1.0)


def test_derivatives_are_made_anew_where_a_fit_ended(toy):
    toy.bend = 0.2
    rng = np.random.default_rng(6)
    data = toy.cube({"@n": 1.5}) + rng.standard_normal((4, *SHAPE)) * 4
    problem = problem_of(toy, data, noise_fields(rng, 0))
    first = fit(problem, [parameter("@n", deviation=50.0)], {})
    found = settled(problem, first)
    slope = (1 + 2 * toy.bend * first.point["@n"]) * toy.maps["@n"]
    np.testing.assert_allclose(found.rows[0], problem.whitened(slope), rtol=1e-3, atol=1e-4)
    assert not np.allclose(first.rows[0], found.rows[0], rtol=0.05)
    assert found.misfit <= first.misfit


class Rough(Toy):
    """A quick prediction: it moves with the contact as it should but for what jumps from place to place."""

    correction = 0.0

    def cube(self, point, only=None):
        jumps = 0.2 * np.sin(900.0 * point.get("@pose_x[0]", 0.0)) * np.sign(self.maps["@n"])
        return super().cube(point, only) + jumps + self.correction


def test_the_last_micrometre_is_gone_by_derivatives_alone(toy):
    """Rationale: a fit stopped 3 um beside the finger, where a rough prediction rose first; at a rig whose bins are far
    quieter than the weights, what it left there was called creep."""
    name = "@pose_x[0]"
    rough = Rough({name: toy.maps["a:x"], "@n": toy.maps["@n"]})
    rng = np.random.default_rng(8)
    data = toy.cube({"a:x": 0.043, "@n": 0.5}) + 0.01 * rng.standard_normal((4, *SHAPE))
    problem = problem_of(rough, data, noise_fields(rng, 0))
    parameters = tuple(parameter(n, deviation=50.0, step=40.0) for n in (name, "@n"))
    start = {name: 0.003}
    # What a fine prediction says at the start, with nothing of the jumps.
    rough.correction = toy.cube({"a:x": 0.003}) - rough.cube(start)
    stopped = fit(problem, parameters, start)
    found = anchored(problem, parameters, start, stopped)
    assert abs(stopped.point[name] - 0.043) > 5 * abs(found.point[name] - 0.043)
    assert found.misfit < stopped.misfit
    np.testing.assert_allclose(rough.cube(found.point), found.predicted, atol=1e-9)
    np.testing.assert_allclose(found.residual, problem.residual(found.predicted), atol=1e-5)
    # What is left to ask for a fine prediction there: the share of the displacement, over the noise seen.
    row = problem.whitened(toy.maps["a:x"]) * (found.point[name] - 0.003)
    expected = ROUGH**2 * (row @ row) / np.mean(found.residual**2)
    assert left_by_derivatives(found, start) == pytest.approx(expected, rel=0.1)
    again = anchored(problem, parameters, dict(found.point), found)
    assert left_by_derivatives(again, found.point) < 0.01 * expected


@pytest.mark.parametrize(
    ("scatter", "away", "made"),
    [(1.0, 0.1, 1), (0.005, 0.9, 2), (1.0, 5.0, 2), (0.005, 500.0, 3)],
    ids=["loud", "quiet", "displaced", "displaced and quiet"],
)
def test_the_fine_prediction_follows_the_finger(toy, monkeypatch, scatter, away, made):
    """It is made anew where the fit left its place, or where derivatives may err by more than the noise shows."""
    name, slope = "@pose_x[0]", 40.0 * toy.maps["a:x"]
    truth = away * FAR["@pose"]
    smooth, rough = Toy({name: slope, "@n": toy.maps["@n"]}), Rough({name: slope, "@n": toy.maps["@n"]})
    rng = np.random.default_rng(8)
    data = smooth.cube({name: truth, "@n": 0.5}) + scatter * rng.standard_normal((4, *SHAPE))
    problem = problem_of(rough, data, noise_fields(rng, 0))
    computed, places = parameter("@n", deviation=50.0), []

    def fine(observation, problem, point, *how):
        places.append(point.get(name, 0.0))
        rough.correction = 0.0
        rough.correction = smooth.cube({name: places[-1]}) - rough.cube({name: places[-1]})
        return problem, (computed,), "frames"

    monkeypatch.setattr(case, "at_place", fine)
    pose = [parameter(name, deviation=50.0, step=40.0)]
    renewed, every, fitted, frames = finely_fitted(
        None, problem, pose, {name: 0.0}, SimpleNamespace(codec=False, silent=False)
    )
    assert len(places) == made <= PLACES
    assert (renewed, every, frames) == (problem, [*pose, computed], "frames")
    assert fitted.point[name] == pytest.approx(truth, abs=4 * scatter / np.linalg.norm(slope) + 1e-5)
    np.testing.assert_allclose(rough.cube(fitted.point), fitted.predicted, atol=1e-9)


def test_a_fit_that_never_stays_is_predicted_anew_three_times(toy, monkeypatch):
    """Each fine prediction here sends the fit ten times as far as it may go."""
    name, places = "@pose_x[0]", []
    predictor = Rough({name: toy.maps["a:x"], "@n": 0.0 * toy.maps["@n"]})
    problem = problem_of(predictor, toy.cube({}), None)

    def fine(observation, problem, point, *how):
        places.append(point.get(name, 0.0))
        predictor.correction = -(places[-1] + 10 * FAR["@pose"]) * toy.maps["a:x"]
        return problem, (), "frames"

    monkeypatch.setattr(case, "at_place", fine)
    pose = [parameter(name, deviation=50.0, step=40.0)]
    fitted = finely_fitted(None, problem, pose, {}, SimpleNamespace(codec=False, silent=False))[2]
    np.testing.assert_allclose(places, 10 * FAR["@pose"] * np.arange(PLACES), rtol=1e-3, atol=1e-6)
    assert fitted.point[name] == pytest.approx(10 * FAR["@pose"] * PLACES, rel=1e-3)


def test_a_fit_that_derivatives_do_not_better_stays(toy):
    """A prediction that bends is followed where it goes, and no correction is made for it."""
    toy.bend, toy.correction = 0.4, 0.0
    rng = np.random.default_rng(8)
    data = toy.cube({"@n": 1.7}) + rng.standard_normal((4, *SHAPE))
    problem, parameters = problem_of(toy, data, noise_fields(rng, 0)), (parameter("@n", deviation=50.0),)
    best = fit(problem, parameters, {}, secant=True)
    rows = problem.whitened(toy.maps["@n"])[None]
    assert anchored(problem, parameters, {}, replace(best, rows=rows)).point == best.point
    assert toy.correction == 0.0


def test_a_departure_that_nuisances_take_is_seen_where_it_is_straight(toy):
    """The whole step bends; what bending leaves is no signature. Another departure is taken as it is."""
    toy.bend = 0.2
    toy.maps["a:x"] = 300.0 * toy.maps["@n"] + toy.maps["a:x"]
    problem = problem_of(toy, toy.cube({}), np.zeros((2, *SHAPE)))
    base = fit(problem, [parameter("@n", deviation=1e4)], {})
    for name, share in (("a:x", 0.1), ("b:y", 1.0)):
        effect = SimpleNamespace(id=name[0], amplitudes=(name[2],))
        found = signature_of(problem, base, Candidate(effect, (parameter(name),), ({name: 0.5},)))
        straight = 0.5 + toy.bend * 0.25 * share
        np.testing.assert_allclose(found.rows[0], problem.whitened(straight * toy.maps[name]), rtol=1e-4, atol=1e-4)


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


@pytest.mark.parametrize("reach", [0.5, 2.0, 30.0])
def test_draws_hold_nuisances_by_their_priors(toy, reach):
    """Closed form: of a nuisance that moves the data by ``reach`` a prior deviation, noise and it together leave
    1 / sqrt(1 + reach^2) along it; noise alone would leave 1 / (1 + reach^2). 600 draws know that to 3 %."""
    rng = np.random.default_rng(3)
    problem = problem_of(toy, toy.cube({}), noise_fields(rng, 0))
    row = problem.whitened(toy.maps["@n"])
    size = float(np.sqrt(row @ row))
    base = fit(problem, [parameter("@n", deviation=reach / size)], {})
    left = np.concatenate([draws.cube for draws in noise_draws(problem, base, 600, rng)])
    along = np.tensordot(left, problem.unwhitened(row / size), 3)
    assert along.std() == pytest.approx(1 / np.hypot(1, reach), rel=0.12)


def test_a_hold_is_left_out_in_thirds_and_other_conditions_whole() -> None:
    """Creep is told by its hold alone: left out as a whole, nothing would speak of it, and its gain would be none."""
    views = [View(kind="press", condition=k) for k in (0, 1, 1, 1, 1, 1, 1, 1, 2)] + [
        View(kind="replicate", condition=1), View(kind="square"), View(kind="square"),
    ]  # fmt: skip
    problem = SimpleNamespace(kinds=views, views=range(len(views)), valid=np.ones((len(views), 1, 2), bool))
    groups = condition_of_bins(problem)[::2]
    assert list(groups) == [0, 1, 2, 3, 1, 2, 3, 1, 4, 2, 5, 5]


def test_starts_that_a_rig_cannot_have_are_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    """Rationale: one LED number beyond the rig's last once cost the whole candidate."""
    candidate = {c.id: c for c in candidates_of(load_scene("thesis"), {"press"})}["led_dead"]

    def departure(problem: object, base: object, candidate: Candidate, start: dict[str, float]) -> np.ndarray:
        if start["led_dead:first"] > last:
            raise InputError("no such LED")
        return np.full(3, start["led_dead:first"], np.float32)

    monkeypatch.setattr("evanesce.criticism.signatures._departure", departure)
    base = SimpleNamespace(residual=np.zeros(3), point={}, parameters=())
    last = 7.0
    found = signature_of(None, base, candidate)  # type: ignore[arg-type]
    assert [start["led_dead:first"] for start in found.candidate.starts] == [0.0, 2.0, 4.0, 6.0]
    assert list(found.rows[:, 0]) == [0.0, 2.0, 4.0, 6.0]
    last = -1.0
    assert "no such LED" in signature_of(None, base, candidate).note  # type: ignore[arg-type]


def test_no_side_of_an_imbalance_is_far_from_where_a_fit_enters_it() -> None:
    """Rationale: entered forwards only, from two directions, half of all sides were never tried."""
    candidate = {c.id: c for c in candidates_of(load_scene("thesis"), {"press"})}["led_imbalance"]
    tried = np.radians([start["led_imbalance:direction_deg"] for start in candidate.starts])
    assert all(start["led_imbalance:contrast"] > 0 for start in candidate.starts)
    sides = np.radians(np.arange(-180.0, 180.0, 7.0))
    assert np.cos(sides[:, None] - tried).max(axis=1).min() > 0.92


def test_a_nuisance_far_from_what_is_known_of_it_predicts_no_better_than_the_cause_it_stands_for(toy):
    """Frames left out are told as well by a nuisance of eight deviations; what was known of it is data, too."""
    toy.maps["a:x"] = toy.maps["@n"] = 30.0 * toy.maps["a:x"]
    rng = np.random.default_rng(5)
    problem = problem_of(toy, toy.cube({"a:x": 0.8}) + rng.standard_normal((4, *SHAPE)), noise_fields(rng, 0))
    nuisance, cause = parameter("@n", deviation=0.1), parameter("a:x")
    base, extended = fit(problem, [nuisance], {}), fit(problem, [cause, nuisance], {})
    assert base.point["@n"] > 6 * nuisance.deviation
    gain, error = held_out_gain(problem, base, extended, 1, 1.0)
    known = 0.5 * (base.point["@n"] / nuisance.deviation) ** 2
    assert gain == pytest.approx(known, rel=0.25)
    assert error < gain / 2
    # What the nuisance may well be is no gain of the cause's.
    nothing = problem_of(toy, toy.cube({"@n": 0.1}) + rng.standard_normal((4, *SHAPE)), noise_fields(rng, 0))
    base, extended = fit(nothing, [nuisance], {}), fit(nothing, [cause, nuisance], {})
    gain, error = held_out_gain(nothing, base, extended, 1, 1.0)
    assert gain < 2 * max(error, 1.0)


def test_a_fit_enters_an_effect_beyond_its_threshold(monkeypatch: pytest.MonkeyPatch, toy) -> None:
    """A straight line to the start would enter it where nothing happens, and a fit would never leave that place."""
    plain = toy.cube

    def cube(point, only=None):
        share = max(point.get("saturation:well_loss", 0.0) - 0.25, 0.0) * 120.0
        return plain({"a:x": share, "@n": point.get("@n", 0.0)}, only)

    toy.scene = load_scene("thesis")
    monkeypatch.setattr(toy, "cube", cube)
    rng = np.random.default_rng(9)
    problem = problem_of(
        toy, cube({"saturation:well_loss": 0.28}) + rng.standard_normal((4, *SHAPE)), noise_fields(rng, 0)
    )
    (candidate,) = (c for c in candidates_of(toy.scene, {"press", "voltage"}) if c.id == "saturation")
    base = fit(problem, [parameter("@n")], {})
    signature = signature_of(problem, base, candidate)
    (scored,) = score_test(problem, base, [signature], draws=99, rng=rng).scored
    found = extend(problem, base, None, scored)
    sd = 1.0 / (120.0 * np.sqrt(float(np.sum((toy.maps["a:x"] / problem.sd) ** 2))))
    assert found.fitted.point["saturation:well_loss"] == pytest.approx(0.28, abs=4 * sd)


def test_a_fit_that_ends_worse_than_nothing_is_entered_nearer(monkeypatch: pytest.MonkeyPatch, toy: Toy) -> None:
    """Rationale: LEDs that warm, on top of a droop, were entered where they bend and stayed at -3000 nats."""
    plain = toy.cube

    def cube(point, only=None):
        # Straight for small amounts, which is what its derivative knows; beyond 0.3 something else happens.
        amount = point.get("modulus:relative", 0.0)
        beyond = 300.0 if amount > 0.3 else 0.0
        return plain({"a:x": 4.0 * amount, "b:y": beyond, "@n": point.get("@n", 0.0)}, only)

    toy.scene = load_scene("thesis")
    monkeypatch.setattr(toy, "cube", cube)
    rng = np.random.default_rng(9)
    data = plain({"a:x": 2.4, "b:y": 0.0, "@n": 0.1}) + rng.standard_normal((4, *SHAPE))
    problem = problem_of(toy, data, noise_fields(rng, 0))
    (candidate,) = (c for c in candidates_of(toy.scene, {"press"}) if c.id == "modulus")
    base = fit(problem, [parameter("@n")], {"@n": 0.0})
    (scored,) = score_test(problem, base, [signature_of(problem, base, candidate)], draws=99, rng=rng).scored
    assert scored.result.estimate[0] > 0.5
    found = extend(problem, base, None, scored)
    assert found.improved > 0.0
    assert found.fitted.point["modulus:relative"] > 0.1
    monkeypatch.setattr("evanesce.criticism.extend.NEARER", 1.0)
    assert extend(problem, base, None, scored).improved < 0.0


def test_of_two_causes_of_one_picture_the_one_that_could_draw_more_has_no_more_evidence(
    monkeypatch: pytest.MonkeyPatch, toy: Toy
) -> None:
    """Noise is loud along that picture, and not along what else a distortion draws: rings at the frame's border.

    Rationale: under JPEG a tilt of 20 and a distortion took the same 170 nats from the checkerboard, of which the tilt
    kept 126 and the distortion 170.
    """
    plain = toy.cube
    rng = np.random.default_rng(31)
    others = ("k2", "p1", "p2", "centre_x_um", "centre_y_um")
    toy.maps |= {f"c:{name}": rng.standard_normal((4, *SHAPE)) for name in others}

    def cube(point, only=None):
        # A plausible modulus (0.2) and a plausible k1 (0.01) draw as much of it.
        drawn = {"a:x": 60.0 * point.get("modulus:relative", 0.0) + 1200.0 * point.get("distortion_drift:k1", 0.0)}
        drawn |= {f"c:{name}": point.get(f"distortion_drift:{name}", 0.0) for name in others}
        return plain(drawn | {"@n": point.get("@n", 0.0)}, only)

    toy.scene = load_scene("thesis")
    monkeypatch.setattr(toy, "cube", cube)
    fields = noise_fields(rng, 1.2)
    data = plain({"a:x": 12.0}) + fields[rng.integers(0, 40, 4)]
    problem = problem_of(toy, data, fields)
    candidates = {c.id: c for c in candidates_of(toy.scene, {"press"})}
    base = fit(problem, [parameter("@n")], {"@n": 0.0})
    found, by_mean = {}, {}
    for name in ("modulus", "distortion_drift"):
        signature = signature_of(problem, base, candidates[name])
        (scored,) = score_test(problem, base, [signature], draws=999, rng=rng).scored
        found[name], by_mean[name] = extend(problem, base, None, scored), scored.inflation
    one, more = found["modulus"], found["distortion_drift"]
    assert by_mean["modulus"] > 1.5 * by_mean["distortion_drift"]
    assert one.inflation > 2.0
    assert more.inflation == pytest.approx(one.inflation, rel=0.1)
    assert one.improved > 20.0
    # Five more parameters take a chi-square of as many degrees.
    assert abs(more.improved - one.improved) < stats.chi2.ppf(0.999, 5) / 2 + 0.1 * one.improved
    assert one.log_bayes > more.log_bayes, (one.inflation, more.inflation, by_mean)


def test_what_shows_in_no_picture_is_not_judged(monkeypatch: pytest.MonkeyPatch, toy: Toy) -> None:
    """A camera's clock stamps frames; pictures of a rig in which nothing believed moves do not depend on it."""
    toy.scene = load_scene("thesis")
    plain = toy.cube
    monkeypatch.setattr(toy, "cube", lambda point, only=None: plain({"@n": point.get("@n", 0.0)}, only))
    rng = np.random.default_rng(3)
    problem = problem_of(toy, plain({"@n": 0.1}) + rng.standard_normal((4, *SHAPE)), noise_fields(rng, 0))
    base = fit(problem, [parameter("@n")], {"@n": 0.0})
    (candidate,) = (c for c in candidates_of(toy.scene, {"press", "time"}) if c.id == "frame_rate")
    signature = signature_of(problem, base, candidate)
    assert "shows in these data" in signature.note
    assert score_test(problem, base, [signature], draws=99, rng=rng).scored == ()


def test_the_nearer_entry_leaves_places_and_shapes_where_a_start_has_them() -> None:
    """Rows are those of the start: at a share of its direction an imbalance is another candidate."""
    scene = load_scene("thesis")
    candidates = {c.id: c for c in candidates_of(scene, {"press", "voltage"})}
    for name, shapes in (("led_imbalance", {"led_imbalance:direction_deg"}), ("vignetting", {"vignetting:exponent"})):
        candidate = candidates[name]
        number = next(k for k, s in enumerate(candidate.starts) if all(s.get(p, 0.0) for p in shapes))
        start = dict(candidate.starts[number])
        at: Any = SimpleNamespace(start=number)
        near = _nearer(candidate, at, candidate.parameters, start)
        assert near
        assert not set(near) & shapes
        for key, value in near.items():
            null = next(p.null for p in candidate.parameters if p.name == key)
            assert value - null == pytest.approx(NEARER * (start[key] - null))
    modulus = candidates["modulus"]
    near = _nearer(modulus, SimpleNamespace(start=-1), modulus.parameters, {"modulus:relative": 0.5})  # type: ignore[arg-type]
    assert near == {"modulus:relative": pytest.approx(0.5 * NEARER)}


@pytest.mark.parametrize(
    ("name", "value", "ended"),
    [
        ("led_warmup:time_constant_s", 5.0, False),  # a thousandth of the bounds' width is 10 s
        ("led_warmup:time_constant_s", 0.1, True),
        ("led_droop:peak_current_mA", 0.5, False),
        ("led_droop:peak_current_mA", 1000.0, True),
        ("vignetting:k", 0.0, False),  # its null
    ],
)
def test_a_plausible_value_is_no_bound(name: str, value: float, ended: bool) -> None:
    effect = name.partition(":")[0]
    (candidate,) = (c for c in candidates_of(load_scene("thesis"), {"press", "voltage", "time"}) if c.id == effect)
    (own,) = (p for p in candidate.parameters if p.name == name)
    fitted = SimpleNamespace(point={name: value})
    known: dict[str, Any] = {f.name: None for f in fields(Extension)}
    assert at_bound(own, value) == ended
    assert Extension(**(known | {"parameters": (own,), "fitted": fitted})).within_bounds == (not ended)


def test_a_shape_that_is_silent_at_nothing_is_fitted_where_its_amplitude_is(
    monkeypatch: pytest.MonkeyPatch, toy: Toy
) -> None:
    """Rationale: room light was fitted as even, whatever its slope and bow, whose derivatives at no light are none."""
    plain = toy.cube

    def cube(point, only=None):
        light = point.get("ambient_light:radiance_W_per_mm2_sr", 0.0) * 1e8
        at = {"a:x": light, "b:y": light * point.get("ambient_light:bow", 0.0), "@n": point.get("@n", 0.0)}
        return plain(at, only)

    toy.scene = load_scene("thesis")
    monkeypatch.setattr(toy, "cube", cube)
    rng = np.random.default_rng(9)
    truth = {"ambient_light:radiance_W_per_mm2_sr": 1.3e-7, "ambient_light:bow": -0.4}
    problem = problem_of(toy, cube(truth) + rng.standard_normal((4, *SHAPE)), noise_fields(rng, 0))
    (candidate,) = (c for c in candidates_of(toy.scene, {"press"}) if c.id == "ambient_light")
    base = fit(problem, [parameter("@n")], {})
    signature = signature_of(problem, base, candidate)
    assert not np.any(signature.rows[candidate.names.index("ambient_light:bow")])
    (scored,) = score_test(problem, base, [signature], draws=99, rng=rng).scored
    found = extend(problem, base, None, scored)
    sd = dict(zip((p.name for p in found.fitted.parameters), np.sqrt(np.diag(found.fitted.covariance())), strict=True))
    for name, value in truth.items():
        assert found.fitted.point[name] == pytest.approx(value, abs=4 * sd[name])
    assert sd["ambient_light:bow"] < 0.1 * 0.5
    # Nothing was ever told of its slope, which stays where it is known to be.
    assert found.fitted.point["ambient_light:gradient[0]"] == 0.0
