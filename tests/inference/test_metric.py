"""Inner products with nuisances marginalised, and scores of held-out data, against dense algebra."""

import numpy as np
import pytest

from evanesce.prediction.linear import Metric
from evanesce.prediction.scores import bootstrap_sum, log_scores

BINS = 400


@pytest.fixture
def rng():
    return np.random.default_rng(71)


def no_nuisance():
    return Metric.of(np.zeros((0, BINS)), np.zeros(0))


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


def test_log_scores_add_up_and_their_interval_holds_the_sum(rng):
    residual = rng.standard_normal((3, 23, 37))
    valid = rng.random((3, 23, 37)) > 0.1
    blocks = log_scores(residual, valid)
    assert blocks.sum() == pytest.approx(-0.5 * (residual[valid] ** 2).sum())
    value, low, high = bootstrap_sum(blocks, level=0.95, count=200, rng=rng)
    assert low < value < high
