"""Scalar series: fits, evidence and left-out scores against closed forms; a cause is found, its twin named."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from evanesce.bundle import read_bundle
from evanesce.bundle.bundle import Bundle
from evanesce.bundle.check import contents
from evanesce.bundle.layout import Series, Shot
from evanesce.bundle.protocol import Protocol
from evanesce.bundle.write import write_bundle
from evanesce.core.errors import InputError
from evanesce.criticism.scalar import (
    SeriesPredictor,
    Table,
    alike,
    chi_square_p,
    fit_series,
    gain_of,
    pairs_of,
)
from evanesce.criticism.scalar_critic import criticise_series, hear, kind_of
from evanesce.effects import all_effects
from evanesce.prediction.candidates import candidates_of
from evanesce.prediction.parameters import Parameter
from evanesce.rig import load_scene


def series(x, y, sigma=None, names=("force", "N", "area", "mm2")):  # type: ignore[no-untyped-def]
    x_name, x_unit, y_name, y_unit = names
    return Series(name="a", x_name=x_name, x_unit=x_unit, y_name=y_name, y_unit=y_unit, x=x, y=y, sigma=sigma)


X = np.array([0.31, 0.52, 0.93, 1.4, 2.2, 2.9, 3.7, 4.8])
BASE = 3.1 + 0.62 * np.log(X)
SHAPES = {"offset:c": np.ones(X.size), "bend:c": np.log(X) ** 2 - 0.5, "copy:c": np.ones(X.size) + 0.02 * X}


def predict(point):  # type: ignore[no-untyped-def]
    return BASE + sum(value * SHAPES[name] for name, value in point.items())


def parameter(name: str, deviation: float = 0.4) -> Parameter:
    return Parameter(name=name, deviation=deviation, bounds=(-2.0, 3.0), step=0.1)


def table(truth: dict[str, float], sigma: float = 0.04, seed: int = 5) -> Table:
    noise = np.random.default_rng(seed).normal(size=X.size) * sigma
    y = np.exp(predict(truth) + noise)
    return Table.of([series(X, y, sigma * y)])


def one(name: str, data: Table):  # type: ignore[no-untyped-def]
    return fit_series(predict, data, (name.partition(":")[0],), [parameter(name)], {})


def test_fit_is_the_ridge_regression_it_should_be() -> None:
    data = table({"bend:c": 0.3})
    fit = one("bend:c", data)
    a = SHAPES["bend:c"] / data.sigma
    r = (data.log_y - BASE) / data.sigma
    precision = a @ a + 1 / 0.4**2
    assert fit.point["bend:c"] == pytest.approx(a @ r / precision, rel=1e-4)
    assert fit.covariance[0, 0] == pytest.approx(1 / precision, rel=1e-4)


def test_evidence_is_that_of_the_gaussian_with_the_prior_folded_in() -> None:
    data = table({"offset:c": 0.2})
    fit, base = one("offset:c", data), fit_series(predict, data, (), (), {})
    r, a = (data.log_y - BASE) / data.sigma, SHAPES["offset:c"] / data.sigma
    marginal = stats.multivariate_normal(cov=np.eye(X.size) + 0.4**2 * np.outer(a, a)).logpdf(r)
    alone = stats.multivariate_normal(cov=np.eye(X.size)).logpdf(r)
    assert fit.log_evidence - base.log_evidence == pytest.approx(marginal - alone, abs=1e-3)


def test_left_out_densities_are_those_of_fits_without_the_point() -> None:
    data = table({"bend:c": -0.2})
    fit = one("bend:c", data)
    r, a = (data.log_y - BASE) / data.sigma, SHAPES["bend:c"] / data.sigma
    for k in range(X.size):
        rest = np.arange(X.size) != k
        precision = a[rest] @ a[rest] + 1 / 0.4**2
        mean, spread = a[k] * (a[rest] @ r[rest]) / precision, np.sqrt(1 + a[k] ** 2 / precision)
        expected = stats.norm(mean, spread).logpdf(r[k]) - np.log(data.sigma[k])
        assert fit.left_out[k] == pytest.approx(expected, abs=1e-3)


def test_right_cause_wins_and_its_copy_is_alike() -> None:
    data = table({"offset:c": 0.5})
    base = fit_series(predict, data, (), (), {})
    right, wrong, copy = one("offset:c", data), one("bend:c", data), one("copy:c", data)
    assert gain_of(right, base)[0] > 2 * gain_of(right, base)[1]
    assert right.log_evidence > wrong.log_evidence + 5
    assert alike(right, copy, data, 9.0)
    assert not alike(right, base, data, 9.0)
    assert [f.ids for f in pairs_of([right, wrong, copy], 2)[0]] == [right.ids, copy.ids] or copy.log_evidence > 0


def test_no_cause_no_alarm_and_alarms_at_their_level() -> None:
    ps = [chi_square_p(fit_series(predict, data, (), (), {}), data) for data in (table({}, seed=k) for k in range(200))]
    # Runs of so few points are discrete, and Fisher's rule then holds at most its level.
    assert np.mean(np.array(ps) < 0.05) <= stats.binom.ppf(0.999, 200, 0.05) / 200


def test_a_fit_at_its_bound_says_so() -> None:
    fit = fit_series(predict, table({"offset:c": 0.9}), ("offset",), [
        Parameter(name="offset:c", deviation=0.4, bounds=(-2.0, 0.5), step=0.1)
    ], {})  # fmt: skip
    assert not fit.within_bounds


def test_series_of_the_rig_are_those_of_its_law() -> None:
    scene = load_scene("thesis", {"camera.resolution_px": [400, 300], "camera.scale_px_per_mm": 11.674})
    force = series(np.array([0.21, 0.44, 0.83]), np.ones(3), None, ("displacement", "mm", "force", "N"))
    values = SeriesPredictor(scene, [force]).values(force, {})
    from evanesce.contact.solve import contact_state

    depth = [contact_state(scene, float(f)).depth for f in values]
    # Forces are interpolated between 14 of the law, in logarithms, where Hertz is straight.
    np.testing.assert_allclose(depth, force.x, rtol=0.02)


def test_square_of_another_size_scales_every_area() -> None:
    scene = load_scene("thesis", {"camera.exposure_ms": 4.0})
    area = series(np.array([0.7, 3.3]), np.ones(2))
    predictor = SeriesPredictor(scene, [area])
    ratio = np.exp(predictor({"square_size:square": 0.04}) - predictor({}))
    np.testing.assert_allclose(ratio, 1 / 1.04**2, rtol=1e-12)


def test_causes_are_told_by_what_they_change() -> None:
    scene = load_scene("thesis")
    expected = {
        "modulus:relative": "mechanical",
        "tone_curve:gamma": "optical",
        "off_axis_load:oval_x_per_N": "mechanical",  # the area stays, its shape does not
        "force_offset:offset_N": "mechanical",
        "square_size:square": "calibration",
    }
    for name, kind in expected.items():
        assert kind_of(all_effects()[name.partition(":")[0]], scene, {name: 0.2}) == kind, name


def test_the_check_and_the_critic_agree_on_what_series_cannot_tell() -> None:
    """No table shows a finger on its way; a square's size, a voltage or a hold may be what moves an area."""
    bundle = read_bundle(Path(__file__).parents[2] / "bundles" / "thesis_silskin_20")
    assert contents(bundle)["cannot_be_named"] == {"rolling_skew": ["motion"]}
    candidates = [c for c in candidates_of(bundle.scene, bundle.testable) if c.id in ("rolling_skew", "square_size")]
    table = Table.of(list(bundle.series.values()))
    predict = SeriesPredictor(bundle.scene, table.series)
    base = fit_series(predict, table, (), (), {})
    heard, deaf = hear(predict, table, base, candidates, bundle.scene)
    assert [(h.candidate.id, h.kind) for h in heard] == [("square_size", "calibration")]
    assert deaf == {"rolling_skew": "needs motion"}


@pytest.fixture(scope="module")
def nothing_hidden(tmp_path_factory: pytest.TempPathFactory) -> Bundle:
    """Series of a simulated bundle, stated to a pixel's area or less, their frames taken away."""
    root = tmp_path_factory.mktemp("series") / "b"
    scene = load_scene("thesis", {"camera.resolution_px": [1240, 930], "camera.scale_px_per_mm": 35.2,
                                  "finger.position_mm": [1.7, -0.9], "leds.voltage_V": 8.7})  # fmt: skip
    shots = [Shot(index=k, time_s=1.0 + k, force_N=f, voltage_V=8.7) for k, f in enumerate((0.45, 1.3, 2.9, 4.6))]
    write_bundle(root, scene, seed=5, protocol=Protocol(press=tuple(shots), replicates=3))
    for kind in ("press", "replicates"):
        shutil.rmtree(root / kind)
    (root / "press.csv").unlink()
    return read_bundle(root)


@pytest.mark.slow  # its bundle takes 8 s
def test_areas_of_a_simulated_bundle_are_predicted_as_they_were_read(nothing_hidden: Bundle) -> None:
    """Larger pixels read 1 to 7 % more: with nothing hidden p was 2e-300."""
    table = Table.of(list(nothing_hidden.series.values()))
    assert table.sigma[:4].max() < 0.005
    predict = SeriesPredictor(nothing_hidden.scene, table.series)
    rough = fit_series(predict, table, (), (), {})
    assert chi_square_p(rough, table) < 1e-6
    spread = predict.refine(nothing_hidden.scene)
    # What is right needs no share of what was put right; forces are not read from frames.
    assert chi_square_p(fit_series(predict, table, (), (), {}), table) > 0.01
    assert np.all(spread[:4] > 0)
    assert np.all(spread[4:] == 0)
    np.testing.assert_allclose(table.widened(spread).sigma, np.hypot(table.sigma, spread))


@pytest.mark.slow
def test_series_of_a_simulated_bundle_with_nothing_hidden_are_none(nothing_hidden: Bundle) -> None:
    answer, _ = criticise_series(nothing_hidden)
    assert answer["verdict"] == "none"
    assert answer["global_p"] > 0.05
    assert answer["probabilities"]["none"] > 0.7


def test_a_series_without_a_touch_is_refused() -> None:
    with pytest.raises(InputError, match=r"series/a.csv.*no area above 0.05 mm2"):
        Table.of([series(X, np.zeros(X.size))])
