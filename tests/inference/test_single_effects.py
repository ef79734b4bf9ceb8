"""Evidences against dense algebra, probabilities against how often they are right, verdicts against their rule."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy import stats

from evanesce.inference.answer import first_line, verdict_of, warnings_of
from evanesce.inference.consequence import Consequence
from evanesce.inference.constants import STRENGTHS
from evanesce.inference.data import DataVector
from evanesce.inference.gate import Gate, _contact_lines
from evanesce.inference.judge import Judge
from evanesce.inference.left import left_of
from evanesce.inference.named import Named
from evanesce.inference.patch import Patch
from evanesce.inference.posterior import Posterior
from evanesce.inference.power import expected_power
from evanesce.inference.single_effects import NONE, UNKNOWN, Place, Shapes, null_statistics, p_value, place_of
from evanesce.inference.small_space import SmallSpace
from evanesce.inference.start import Start, light_note
from evanesce.prediction.linear import Metric
from evanesce.prediction.views import View

BINS = 80


def spaces(rng: Any, causes: int = 6, forms: int = 3) -> Any:
    """Return rows of nuisances and of causes, and their inner products with the nuisances marginalised."""
    rows = {"nuisances": 5.0 * rng.standard_normal((4, BINS))}
    rows |= {f"c{k}": rng.standard_normal((forms, BINS)) + 2.0 * rng.standard_normal(BINS) for k in range(causes)}
    return rows, [n for n in rows if n != "nuisances"]


def test_forms_of_a_very_strong_cause_that_are_nearly_alike_are_marginalised():
    """Twelve forms that differ by a thousandth, of a cause of 30,000 standard deviations: what another one has left."""
    rng, bins = np.random.default_rng(6), 40_000
    form, other = rng.standard_normal(bins), rng.standard_normal((1, bins))
    forms = (form + 0.001 * rng.standard_normal((12, bins))).astype(np.float32)
    size = 3e4 / np.linalg.norm(forms[0])
    gram, _ = SmallSpace({"forms": forms, "other": other}, np.zeros((0, bins))).marginalised(
        {"forms": size}, ["other"], None
    )
    left, values, _ = np.linalg.svd(size * forms.astype(float).T, full_matrices=False)
    seen = left.T @ other[0]
    expected = other[0] @ other[0] - np.sum(seen**2 * values**2 / (1.0 + values**2))
    assert gram[0, 0] == pytest.approx(expected, rel=1e-6)


def test_evidence_is_the_ratio_of_normal_densities():
    """Against scipy's multivariate normal density, with the covariance of noise, nuisances and shapes written out."""
    rng = np.random.default_rng(3)
    rows, names = spaces(rng)
    y = 3.0 * rng.standard_normal(BINS)
    space = SmallSpace(rows, y[None])
    gram, along = space.marginalised({"nuisances": 1.0}, names, 0)
    covariance = np.eye(BINS) + rows["nuisances"].T @ rows["nuisances"]
    none = stats.multivariate_normal(cov=covariance).logpdf(y)
    inverse = np.linalg.inv(covariance)
    for k, name in enumerate(names):
        cut = slice(3 * k, 3 * k + 3)
        own = rows[name]
        np.testing.assert_allclose(gram[cut, cut], own @ inverse @ own.T, rtol=1e-4, atol=1e-4)
        scaled = own / np.sqrt(3 * np.diag(own @ inverse @ own.T))[:, None]
        every = [covariance + size**2 * scaled.T @ scaled for size in STRENGTHS]
        dense = np.array([stats.multivariate_normal(cov=one).logpdf(y) for one in every]) - none
        shapes = Shapes.of(name, gram[cut, cut])
        found = shapes.log_bayes(shapes.coordinates(along[cut]))
        assert found == pytest.approx(np.logaddexp.reduce(dense) - np.log(len(STRENGTHS)), abs=1e-3)


def test_evidence_is_averaged_over_a_light_that_is_exact_and_one_that_is_off():
    """Against normal densities written out; where the light was surely off, a cause that looks like it loses."""
    rng = np.random.default_rng(8)
    rows, names = spaces(rng)
    rows |= {"light": 2.0 * rng.standard_normal((5, BINS)), "discrepancy": np.zeros((1, BINS))}
    judge = Judge.__new__(Judge)
    judge.reach, judge.grown, judge.seed = np.inf, frozenset(), 0
    exact = np.eye(BINS) + rows["nuisances"].T @ rows["nuisances"]
    off = exact + rows["light"].T @ rows["light"]
    for y in (3.0 * rng.standard_normal(BINS), rng.standard_normal(5) @ rows["light"], 6.0 * rows["c0"][0]):
        space = SmallSpace(rows, y[None])
        place, p = judge._judged(space, {"nuisances": 1.0, "discrepancy": 1.0}, names, 0, with_p=True)
        assert 0.0 < p <= 1.0
        none = [stats.multivariate_normal(cov=c).logpdf(y) for c in (exact, off)]
        for name in names:
            dense = []
            for covariance in (exact, off):
                own = rows[name]
                norms = np.sqrt(np.diag(own @ np.linalg.solve(covariance, own.T)) * len(own))
                scaled = own / norms[:, None]
                every = [covariance + size**2 * scaled.T @ scaled for size in STRENGTHS]
                dense += [stats.multivariate_normal(cov=one).logpdf(y) - np.log(len(STRENGTHS)) for one in every]
            expected = np.logaddexp.reduce(dense) - np.logaddexp.reduce(none)
            assert place.log_bayes[name] == pytest.approx(expected, abs=1e-2)


def test_further_blocks_join_as_if_they_had_been_there():
    rng = np.random.default_rng(5)
    rows, names = spaces(rng)
    vectors = rng.standard_normal((2, BINS))
    whole = SmallSpace(rows, vectors)
    parts = SmallSpace({n: rows[n] for n in names}, vectors[:0]).joined({"nuisances": rows["nuisances"]}, vectors)
    for a, b in zip(*(s.marginalised({"nuisances": 0.7}, names, 1) for s in (whole, parts)), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-5, atol=1e-5)


def test_probabilities_are_how_often_they_are_right():
    rng = np.random.default_rng(11)
    rows, names = spaces(rng)
    space = SmallSpace(rows, np.zeros((1, BINS)))
    gram, _ = space.marginalised({"nuisances": 1.0}, names, 0)
    shapes = [Shapes.of(n, gram[3 * k : 3 * k + 3, 3 * k : 3 * k + 3]) for k, n in enumerate(names)]
    worlds = 4000
    covered, sure, present = [], [], []
    for _ in range(worlds):
        y = rng.standard_normal(BINS) + rng.standard_normal(4) @ rows["nuisances"]
        k = int(rng.integers(len(names))) if rng.uniform() < 0.5 else None
        if k is not None:
            y = y + rng.choice(STRENGTHS) * rng.standard_normal(3) @ (shapes[k].scale[:, None] * rows[names[k]])
        cross = np.concatenate([rows[n] for n in names]) @ y
        out = rows["nuisances"]
        inner = np.linalg.solve(np.eye(4) + out @ out.T, out @ y)
        cross = cross - np.concatenate([rows[n] for n in names]) @ out.T @ inner
        place = place_of(shapes, {n: cross[3 * j : 3 * j + 3] for j, n in enumerate(names)})
        truth = NONE if k is None else names[k]
        sure.append((max(place.probability.values()), max(place.probability, key=place.probability.get) == truth))
        present.append((place.present, k is not None))
        if k is not None and place.present > 0.5:
            covered.append(truth in place.credible_set)
    for pairs in (np.array(sure, float), np.array(present, float)):
        assert abs(pairs[:, 0].mean() - pairs[:, 1].mean()) < 0.02
        for low, high in ((0.3, 0.6), (0.6, 0.9), (0.9, 1.01)):
            inside = (pairs[:, 0] >= low) & (pairs[:, 0] < high)
            if inside.sum() > 200:
                error = np.sqrt(0.25 / inside.sum())
                assert abs(pairs[inside, 0].mean() - pairs[inside, 1].mean()) < 3 * error
    assert np.mean(covered) > 0.94


def test_noise_has_evenly_spread_p_values():
    rng = np.random.default_rng(2)
    rows, names = spaces(rng)
    space = SmallSpace(rows, rng.standard_normal((400, BINS)) + rng.standard_normal((400, 4)) @ rows["nuisances"])
    gram, _ = space.marginalised({"nuisances": 1.0}, names, 0)
    shapes = [Shapes.of(n, gram[3 * k : 3 * k + 3, 3 * k : 3 * k + 3]) for k, n in enumerate(names)]
    null = null_statistics(shapes, gram, rng)
    found = []
    for number in range(400):
        _, along = space.marginalised({"nuisances": 1.0}, names, number)
        found.append(
            p_value(place_of(shapes, {n: along[3 * k : 3 * k + 3] for k, n in enumerate(names)}), lambda: null)
        )
    assert stats.kstest(found, "uniform").pvalue > 1e-3
    for factor in (10.0, 100.0, 1000.0):  # as rare as a mean Bayes factor of mean 1 has to be
        assert np.mean(null > np.log(factor)) < 1.0 / factor


def test_evidence_beyond_all_draws_needs_none():
    strong, weak = (Place.of({"a": nats}) for nats in (12.0, 9.0))
    assert p_value(strong, lambda: pytest.fail("drawn")) == pytest.approx(1.0 / 20_001)
    assert p_value(weak, lambda: np.linspace(0.0, 20.0, 100)) == pytest.approx(1.0 - 45 / 101, abs=0.02)


def test_verdict_never_contradicts_the_probabilities():
    """Random posteriors: every place that is more probably filled than empty is told of, as what is likelier there."""
    rng = np.random.default_rng(4)
    for _ in range(500):
        drawn = [rng.dirichlet(np.full(4, rng.choice([0.1, 1.0]))) for _ in range(int(rng.integers(1, 4)))]
        every = [Place({}, dict(zip((NONE, UNKNOWN, "a", "b"), map(float, p), strict=True))) for p in drawn]
        left = bool(rng.integers(2))
        further_p = float(rng.choice([0.5, 0.001]))
        posterior = Posterior({f"c{k}": p for k, p in enumerate(every[:-1])}, every[-1], further_p)
        verdict = verdict_of(posterior, left)
        counted = every if further_p < 0.01 else every[:-1]
        if verdict == "none":
            assert not left
            assert all(p.probability[NONE] >= 0.5 for p in counted)
        if any(p.probability["a"] + p.probability["b"] > 0.5 for p in counted):
            assert "causes" in verdict
        if left or any(p.probability[UNKNOWN] > 0.5 for p in counted):
            assert "unknown" in verdict
        if "causes" in verdict:
            assert any(p.probability["a"] + p.probability["b"] > 0.25 for p in counted)
        if "unknown" in verdict and not left:
            assert any(p.probability[UNKNOWN] > 0.25 for p in counted)
        assert all(0.0 <= told <= 0.75 for told in posterior.at_most(0.75).inclusion.values())
        for place in every:
            if place.present > 0:
                held = sum(place.probability[n] for n in place.credible_set)
                assert held >= 0.95 * place.present - 1e-9


def test_doubts_are_said_before_probabilities_are_believed():
    assert warnings_of("causes", True, replicates=True) == []
    (noise,) = warnings_of("none", False, replicates=False)
    assert "false alarms" in noise
    (unknown,) = warnings_of("causes and unknown", True, replicates=True)
    assert "stand in" in unknown
    assert warnings_of("unknown", False, replicates=True) == []


def test_the_first_line_says_what_makes_it_doubtful():
    structure = left(lambda x, y: 0.02 * np.cos(2 * np.pi * 0.3 * x))
    note = "a codec left 6 % of the camera's noise"
    told = first_line("unknown", [], 0.0, structure, None, "", [note])
    assert told.startswith(f"CAUTION: {note}. There is something")
    assert "CAUTION" not in first_line("unknown", [], 0.0, structure, None, "")
    assert first_line("none", [], 0.0, structure, None, "", [note]).startswith(f"CAUTION: {note}. The data are")


def test_the_first_line_begins_with_presses_that_contradict_each_other():
    nothing: Any = None
    gate = Gate((), {}, 1.0, ("frames of 1 N and 3.3 N look exchanged",))
    base: Any = SimpleNamespace(point={"@light": 0.1})
    notes = Start(nothing, nothing, gate, nothing, base).notes
    structure: Any = SimpleNamespace(found=False, sentence=lambda: "")
    assert first_line("none", [], 0.0, structure, None, "", notes).startswith(f"CAUTION: {gate.odd[0]}. ")


def test_the_first_line_says_what_could_not_be_fitted():
    structure: Any = SimpleNamespace(found=False, sentence=lambda: "")
    place = Place.of({"vignetting": 7.0, "defocus": 5.0, "creep": -3.0})
    told = first_line("causes", [], 0.0, structure, None, "", further=place)
    assert told.startswith("There is a cause that could not be fitted, most probably vignetting (")
    assert "defocus" in told
    assert "creep" not in told


def test_the_first_line_says_that_what_is_left_may_be_what_was_given_up():
    structure = left(lambda x, y: 0.02 * np.cos(2 * np.pi * 0.3 * x))
    assert structure.found
    told = first_line("unknown", [], 0.0, structure, None, "", idle=("led_imbalance",))
    assert told.endswith("; or it is led_imbalance, without effect on the area.")


def test_what_moves_no_area_and_was_not_taken_is_told_in_its_place():
    """Nothing unknown: the likeliest further cause was given up for doing nothing to the area."""
    named = [Named("modulus", 0.9, Consequence((), (), ()), {}, 0.7, ("modulus",), listed=True)]
    structure: Any = SimpleNamespace(found=False, sentence=lambda: "")
    further = Place.of({"led_droop": 600.0, "tone_curve": 590.0, UNKNOWN: 580.0})
    told = first_line("causes", named, 0.99, structure, None, "", further=further, idle=("tone_curve", "led_droop"))
    assert told.endswith("Beside them there is led_droop, without effect on the area")
    assert "Beside" not in first_line("causes", named, 0.99, structure, None, "", further=further)


def test_a_contact_of_far_other_light_is_told_and_not_refused():
    """As behind glass that absorbs eight times as much: a setting or a cause, no other rig."""
    seen, believed = Patch(10.0, 1.01, (0.1, -0.2), 28.0), Patch(10.2, 1.0, (0.0, 0.0), 214.0)
    lines, moved, light = _contact_lines([(seen, believed)])
    gate = Gate(tuple(lines), moved, light)
    assert not gate.gross
    assert "0.13 of the scene's" in light_note({"@light": float(np.log(light))})
    assert not light_note({"@light": 0.5})
    lines, _, _ = _contact_lines([(Patch(20.0, 1.0, (0.0, 0.0), 200.0), believed)])
    assert Gate(tuple(lines), {}).gross


def test_a_fit_stands_above_drawn_forms():
    """A rival whose forms look better, but that was fitted and came out 30 nats behind, is none; others stay."""
    place = Place.of({"a": 100.0, "b": 140.0, "c": 99.0}).with_fits("a", {"b": 30.0})
    assert place.log_bayes["b"] == pytest.approx(70.0)
    assert place.probability["b"] < 1e-9
    assert set(place.credible_set) == {"a", "c"}
    assert Place.of({"a": 100.0, "b": 80.0}).with_fits("a", {"b": 5.0}).log_bayes["b"] == pytest.approx(95.0)


SIZE = (40, 52)


def blotches(rng: Any, views: int) -> Any:
    """Return noise (views, rows, cols) as a video codec makes it: blocks and rows that err together, alike in views."""
    rows, cols = SIZE
    blocks = rng.standard_normal((rows // 8, cols // 4)).repeat(8, 0).repeat(4, 1)
    every = rng.standard_normal((rows, 1)) * 0.5 + blocks
    return every + 0.5 * rng.standard_normal((views, rows, cols))


def left(extra: Any, seed: int = 8, dark: float = 20.0, draws: int = 0) -> Any:
    """Return what is left of six views of a disc of light, unit noise (or blotches) and a relative change of it."""
    rng = np.random.default_rng(seed)
    views = tuple(View(kind="press", force_N=2.0, voltage_V=8.0 + 0.3 * k, condition=k, index=k) for k in range(6))
    y, x = np.indices(SIZE)
    disc = dark + 180.0 * (np.hypot(y - 19, x - 26) < 15)
    light = np.array([disc * (0.5 + 0.1 * k) for k in range(6)])
    sd = np.full(light.shape, 0.4)
    noise: Any = None
    data = DataVector(light, sd, np.ones(light.shape, bool), views, noise, 1.0, 0.01)
    if not draws:
        residual = sd * rng.standard_normal(light.shape) + light * extra(x, y)
        return left_of(data, data.whitened(residual), light, 0.5)
    drawn = np.array([sd * blotches(rng, len(views)) for _ in range(draws)])
    residual = sd * blotches(rng, len(views)) - drawn.mean(axis=0) + light * extra(x, y)
    noise_left = np.array([data.whitened(one - drawn.mean(axis=0)) for one in drawn])
    return left_of(data, data.whitened(residual), light, 0.5, noise_left)


def test_noise_leaves_nothing():
    found = [left(lambda x, y: 0.0 * x, seed) for seed in range(20)]
    assert np.mean([f.found for f in found]) <= 0.1
    assert np.mean([f.chi2 for f in found]) == pytest.approx(1.0, abs=0.02)


def test_noise_that_hangs_together_is_no_structure_where_draws_show_it():
    def nothing(x: Any, y: Any) -> Any:
        return 0.0 * x

    shown = [left(nothing, seed, draws=24) for seed in range(40)]
    assert sum(f.found for f in shown) == 0
    # each probability by itself is one: below a tenth in a tenth of the cases
    for each in ("periodic", "bands"):
        small = np.mean([getattr(f, each).p_value < 0.1 for f in shown])
        assert small <= 0.3, each  # binomial, 40 cases, of two fields the less probable
    striped = left(lambda x, y: 0.02 * np.cos(2 * np.pi * 0.3 * x), draws=24)
    assert striped.periodic.p_value < 1e-6


def test_stripes_are_told_with_period_direction_and_size():
    """1.5 % of the light, 3.3 bins a period: finer than any cause of the library draws."""
    angle, frequency = np.radians(25.0), 0.3
    found = left(lambda x, y: 0.015 * np.cos(2 * np.pi * frequency * (x * np.cos(angle) + y * np.sin(angle)) + 1.0))
    assert found.found
    assert found.follows == "light"
    wave = found.periodic
    assert wave.p_value < 1e-6
    assert wave.period_mm == pytest.approx(0.5 / frequency, rel=0.02)
    assert wave.direction_deg % 180 == pytest.approx(25.0, abs=1.5)
    # Drawn at points, so that no bin averaged it: what is told is larger by what a bin would have taken.
    kept = np.sinc(frequency * np.cos(angle)) * np.sinc(frequency * np.sin(angle))
    assert wave.amplitude == pytest.approx(0.015 / kept, rel=0.1)
    assert "stripes" in found.sentence()


def test_faint_stripes_of_the_light_are_seen_where_all_bins_together_show_noise():
    """A wave of strength 10 in the light: beside the light, where a third of all bins are lit, it has a third of it."""
    y, x = np.indices(SIZE)
    lit = 180.0 * (np.hypot(y - 19, x - 26) < 15) + 0.5
    wave = np.cos(2 * np.pi * 0.23 * x)
    size = np.sqrt(sum((((0.5 + 0.1 * k) * lit * wave / 0.4) ** 2).sum() for k in range(6)))
    found = [left(lambda x, y: 10.0 / size * np.cos(2 * np.pi * 0.23 * x), seed, dark=0.5) for seed in range(12)]
    assert all(f.found for f in found)
    assert all(f.follows == "light" for f in found)
    assert np.median([f.p_value for f in found]) > 1e-3


@pytest.mark.parametrize(("axis", "along"), [(0, "rows"), (1, "columns")])
def test_rows_and_columns_of_the_sensor_that_differ_are_told(axis, along):
    """Each by 2 % of the light rms, at random; half a wave of 5 % along them is none."""
    own = 0.02 * np.random.default_rng(2).standard_normal(SIZE[axis])
    found = left(lambda x, y: own[(y, x)[axis]])
    assert found.bands.along == along
    assert found.bands.p_value < 1e-6
    assert found.bands.amplitude == pytest.approx(0.02, rel=0.25)
    assert f"{along} of the sensor by themselves" in found.sentence()
    assert found.bands.share > 0.8
    smooth = left(lambda x, y: 0.05 * np.cos(3 * (y, x)[axis] / SIZE[axis]))
    assert "by themselves" not in smooth.sentence()


def test_a_ring_is_told_as_round():
    found = left(lambda x, y: 0.02 * np.exp(-(((np.hypot(y - 19, x - 26) - 8.0) / 3.0) ** 2)))
    assert found.found
    assert found.radial > 0.5
    assert found.concentrated < 0.5


def test_a_few_spots_are_told_as_spots():
    spots = np.zeros(SIZE)
    spots[tuple(np.random.default_rng(1).integers(8, 32, (2, 9)))] = -0.05
    found = left(lambda x, y: spots)
    assert found.found
    assert found.concentrated > 0.8
    assert "spots" in found.sentence()
    assert left(lambda x, y: 0.0 * x).concentrated < 0.5


def test_nuisances_change_no_statement_about_metric():
    """Marginalising in the small space is the metric of the data space."""
    rng = np.random.default_rng(6)
    rows, names = spaces(rng)
    y = rng.standard_normal(BINS)
    gram, along = SmallSpace(rows, y[None]).marginalised({"nuisances": 1.0}, names, 0)
    metric = Metric.of(rows["nuisances"], np.ones(4))
    every = np.concatenate([rows[n] for n in names])
    np.testing.assert_allclose(gram, metric.gram(every), rtol=1e-4, atol=1e-3)
    np.testing.assert_allclose(along, every @ metric.project(y), rtol=1e-4, atol=1e-3)


def test_expected_power_is_what_drawn_data_give():
    """Against data drawn in full, noise and nuisances in them, for one cause; nothing at strength 0, all at 40."""
    rng = np.random.default_rng(9)
    rows, names = spaces(rng, causes=4, forms=4)
    space = SmallSpace(rows, np.zeros((0, BINS)))
    marginal = {"nuisances": 1.0}
    found = {(p.id, p.strength): p for p in expected_power(space, marginal, (0.0, 5.0, 40.0), rng, draws=300)}
    assert np.mean([found[n, 0.0].detected for n in names]) == pytest.approx(0.01, abs=0.006)
    assert min(found[n, 40.0].detected for n in names) == 1.0
    assert np.mean([found[n, 40.0].first for n in names]) > 0.9
    gram, _ = space.marginalised(marginal, names, None)
    shapes = {n: Shapes.of(n, gram[4 * k : 4 * k + 4, 4 * k : 4 * k + 4]) for k, n in enumerate(names)}
    threshold = np.quantile(null_statistics(list(shapes.values()), gram, rng), 0.99)
    metric = Metric.of(rows["nuisances"], np.ones(4))
    hits = []
    for place in range(4):
        others = [k for k in range(4) if k != place]
        own = Shapes.of("c1", gram[np.ix_([4 + k for k in others], [4 + k for k in others])])
        signal = rows["c1"][place] / np.sqrt(gram[4 + place, 4 + place])
        for _ in range(400):
            y = 5.0 * signal + rng.standard_normal(BINS) + rng.standard_normal(4) @ rows["nuisances"]
            projected = metric.project(y)
            bayes = [
                (own if n == "c1" else s).log_bayes(
                    (own if n == "c1" else s).coordinates((rows[n][others] if n == "c1" else rows[n]) @ projected)
                )
                for n, s in shapes.items()
            ]
            hits.append(np.logaddexp.reduce(bayes) - np.log(len(bayes)) > threshold)
    assert found["c1", 5.0].detected == pytest.approx(np.mean(hits), abs=4 * np.sqrt(0.25 / 1600 + 0.25 / 1200))
