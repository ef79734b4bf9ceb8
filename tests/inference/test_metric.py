"""Inner products with nuisances marginalised, and scores of held-out data, against dense algebra."""

import numpy as np
import pytest
from scipy import stats

from evanesce.prediction.linear import Metric, distance2, score
from evanesce.prediction.scores import bootstrap_sum, leave_one_out, log_scores

BINS = 400


@pytest.fixture
def rng():
    return np.random.default_rng(71)


def no_nuisance():
    return Metric.of(np.zeros((0, BINS)), np.zeros(0))


def test_score_of_one_direction_is_the_matched_filter(rng):
    """Rationale: in white noise the best detector of a known shape is (s.d)/|s| (North 1943)."""
    shape, data = 0.3 * rng.standard_normal(BINS), rng.standard_normal(BINS) + 0.2
    metric = no_nuisance()
    found = score(metric.gram(shape[None]), shape[None] @ metric.project(data), np.array([1e6]))
    assert found.statistic == pytest.approx((shape @ data) ** 2 / (shape @ shape), rel=1e-12)
    assert found.estimate[0] == pytest.approx(shape @ data / (shape @ shape), rel=1e-9)


def test_free_nuisances_leave_nothing_along_them(rng):
    rows = rng.standard_normal((3, BINS))
    left = Metric.of(rows, np.full(3, 1e7)).project(rng.standard_normal((5, BINS)))
    assert np.abs(left @ rows.T).max() < 1e-6


def test_metric_is_the_inverse_covariance_of_noise_and_nuisances(rng):
    """Oracle: numpy's inverse of the dense covariance."""
    rows, deviations = rng.standard_normal((4, 30)), np.array([0.1, 3.0, 0.7, 12.0])
    dense = np.eye(30) + rows.T @ np.diag(deviations**2) @ rows
    vector = rng.standard_normal(30)
    np.testing.assert_allclose(Metric.of(rows, deviations).project(vector), np.linalg.solve(dense, vector), rtol=1e-9)


def test_whitened_squares_are_those_of_the_metric(rng):
    rows, deviations = rng.standard_normal((4, 30)), np.array([0.1, 3.0, 0.7, 12.0])
    vectors, metric = rng.standard_normal((5, 30)), Metric.of(rows, deviations)
    white = metric.whiten(vectors)
    np.testing.assert_allclose(white @ white.T, metric.gram(vectors), rtol=1e-9, atol=1e-12)


def test_log_bayes_factor_is_the_ratio_of_gaussian_evidences(rng):
    """Oracle: scipy's multivariate normal density of the data under both models."""
    rows, deviations = rng.standard_normal((2, 25)), np.array([0.4, 2.0])
    data = rng.standard_normal(25) + 0.5 * rows[0]
    metric = Metric.of(np.zeros((0, 25)), np.zeros(0))
    found = score(metric.gram(rows), rows @ data, deviations)
    wide = np.eye(25) + rows.T @ np.diag(deviations**2) @ rows
    law = stats.multivariate_normal
    assert found.log_bayes == pytest.approx(law.logpdf(data, cov=wide) - law.logpdf(data, cov=np.eye(25)), rel=1e-9)


def test_intervals_cover(rng):
    """Over 400 draws from prior and noise, 90 % intervals hold the truth in 90 % (4 standard errors: 6 %)."""
    rows, deviations = rng.standard_normal((2, BINS)) * 0.1, np.array([0.5, 1.5])
    nuisance = rng.standard_normal((1, BINS))
    metric = Metric.of(nuisance, np.array([2.0]))
    information, reach, held = metric.gram(rows), stats.norm.ppf(0.95), 0
    for _ in range(400):
        truth = deviations * rng.standard_normal(2)
        data = truth @ rows + 2.0 * rng.standard_normal() * nuisance[0] + rng.standard_normal(BINS)
        found = score(information, rows @ metric.project(data), deviations)
        held += abs(found.estimate[0] - truth[0]) < reach * np.sqrt(found.covariance[0, 0])
    assert abs(held / 400 - 0.90) < 0.06


def test_distance_is_least_squares(rng):
    """Oracle: numpy's least squares with the nuisances as further columns."""
    signal, columns, nuisances = rng.standard_normal(60), rng.standard_normal((2, 60)), rng.standard_normal((3, 60))
    everything = np.concatenate([columns, nuisances]).T
    best = np.linalg.lstsq(everything, signal, rcond=None)[0]
    expected = float(np.sum((signal - everything @ best) ** 2))
    assert distance2(signal, Metric.of(nuisances, np.full(3, 1e6)), columns) == pytest.approx(expected, rel=1e-6)


def test_leaving_out_predicts_as_a_refit_does(rng):
    """Oracle: the Gaussian predictive density with the parameters' posterior from the other groups."""
    rows, deviations = rng.standard_normal((2, 24)), np.array([1.0, 0.5])
    data, groups = rng.standard_normal(24) + rows[0], np.repeat([0, 1, 2], 8)
    found = leave_one_out(rows, data, deviations, np.zeros(2), groups)
    for group in range(3):
        mine = groups == group
        part, rest = rows[:, mine], rows[:, ~mine]
        covariance = np.linalg.inv(rest @ rest.T + np.diag(deviations**-2))
        mean = covariance @ rest @ data[~mine]
        law = stats.multivariate_normal(part.T @ mean, np.eye(8) + part.T @ covariance @ part)
        assert found[group] == pytest.approx(law.logpdf(data[mine]) + 4 * np.log(2 * np.pi), rel=1e-8)


def test_log_scores_add_up_and_their_interval_holds_the_sum(rng):
    residual = rng.standard_normal((3, 23, 37))
    valid = rng.random((3, 23, 37)) > 0.1
    blocks = log_scores(residual, valid)
    assert blocks.sum() == pytest.approx(-0.5 * (residual[valid] ** 2).sum())
    value, low, high = bootstrap_sum(blocks, level=0.95, count=200, rng=rng)
    assert low < value < high
