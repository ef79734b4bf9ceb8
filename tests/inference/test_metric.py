"""Inner products with nuisances marginalised, and scores of held-out data, against dense algebra."""

import numpy as np
import pytest

from evanesce.prediction.linear import CovarianceRows, Metric
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


def stretched(rng):
    """Return rows over all of 60 bins, over two stretches of them, and all as one array."""
    rows = CovarianceRows(
        rng.standard_normal((3, 60)), {0: 2.0 * rng.standard_normal((2, 20)), 35: rng.standard_normal((4, 15))}
    )
    return rows, rows.dense()


def test_rows_over_stretches_are_those_of_the_whole_array(rng):
    rows, dense = stretched(rng)
    vectors = rng.standard_normal((5, 60))
    assert dense.shape == (len(rows), 60) == (9, 60)
    assert not dense[3:5, 20:].any()
    assert not dense[5:, :35].any()
    np.testing.assert_allclose(rows.products(vectors), vectors @ dense.T, rtol=1e-12)


@pytest.mark.parametrize("shape", [(60,), (4, 60)])
def test_a_metric_of_stretches_is_that_of_the_whole_array(rng, shape):
    """Oracle: numpy's inverse of the dense covariance, the nuisances of another metric in it."""
    rows, dense = stretched(rng)
    own, vectors = rng.standard_normal((2, 60)), rng.standard_normal(shape)
    metric = Metric.of(own, np.array([3.0, 0.5])).with_rows(rows)
    covariance = np.eye(60) + dense.T @ dense + own.T @ np.diag([9.0, 0.25]) @ own
    np.testing.assert_allclose(metric.project(vectors), np.linalg.solve(covariance, vectors.T).T, rtol=1e-8)
    white = np.atleast_2d(metric.whiten(vectors))
    np.testing.assert_allclose(white @ white.T, metric.gram(np.atleast_2d(vectors)), rtol=1e-8, atol=1e-12)
    assert metric.log_det == pytest.approx(np.linalg.slogdet(covariance)[1], rel=1e-9)


def test_stretches_that_are_added_later_join_those_that_are_there(rng):
    rows, dense = stretched(rng)
    once = (
        Metric.of(np.zeros((0, 60)), np.zeros(0))
        .with_rows(rows)
        .with_rows(CovarianceRows(np.zeros((0, 60)), rows.stretches))
    )
    both = np.concatenate([dense, dense[3:]])
    vector = rng.standard_normal(60)
    np.testing.assert_allclose(once.project(vector), np.linalg.solve(np.eye(60) + both.T @ both, vector), rtol=1e-8)
