"""Noise along forms, as draws of it show: against covariances that are known."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from evanesce.inference.form_noise import noise_along
from evanesce.inference.marks import TAIL, beyond
from evanesce.inference.single_effects import Shapes, place_of, statistic_of

BINS, FORMS, DRAWS = 400, 60, 24


def _forms(rng: np.random.Generator) -> np.ndarray:
    return rng.standard_normal((FORMS, 5)) @ rng.standard_normal((5, BINS)) + 0.3 * rng.standard_normal((FORMS, BINS))


def _scores(forms: np.ndarray, covariance: np.ndarray, noise: np.ndarray) -> np.ndarray:
    """Standard scores (forms, samples) of noise (bins, samples) along forms, by a believed covariance."""
    weighted = np.linalg.solve(covariance, forms.T).T
    return (weighted @ noise) / np.sqrt(np.einsum("ij,ij->i", weighted, forms))[:, None]


def _evidence(gram: np.ndarray, along: np.ndarray) -> float:
    """Of ten causes of as many forms each."""
    parts = {str(k): slice(k * FORMS // 10, (k + 1) * FORMS // 10) for k in range(10)}
    place = place_of([Shapes.of(k, gram[c, c]) for k, c in parts.items()], {k: along[c] for k, c in parts.items()})
    return float(statistic_of(np.array(list(place.log_bayes.values()))))


@pytest.mark.parametrize("size", [0.0, 0.4, 1.0])
def test_scores_of_further_noise_are_standard(size: float) -> None:
    rng = np.random.default_rng(3)
    forms, regions = _forms(rng), size * rng.standard_normal((8, BINS))
    root = np.linalg.cholesky(np.eye(BINS) + regions.T @ regions)
    draws = (root @ rng.standard_normal((BINS, DRAWS))).T
    draws -= draws.mean(axis=0)
    found = noise_along(forms @ forms.T, forms @ draws.T, _evidence)
    assert found.variance >= 1.0
    rows = found.factors @ forms
    believed = found.variance * (np.eye(BINS) + rows.T @ rows)
    further = root @ rng.standard_normal((BINS, 1000))
    scores = _scores(forms, believed, further)
    # Never told better than it is, and not much worse; without the draws, several times too well.
    assert 0.6 < np.sqrt(np.mean(scores**2)) < 1.15
    if size:
        assert np.sqrt(np.mean(_scores(forms, np.eye(BINS), further) ** 2)) > 1.3


def test_noise_that_is_as_believed_adds_little() -> None:
    rng = np.random.default_rng(4)
    forms, draws = _forms(rng), rng.standard_normal((DRAWS, BINS))
    found = noise_along(forms @ forms.T, forms @ (draws - draws.mean(axis=0)).T, _evidence)
    assert found.variance < 1.3
    assert (np.linalg.norm(found.factors @ forms, axis=1) ** 2).max(initial=0.0) < 2.0


def test_noise_with_heavy_tails_is_seldom_evidence() -> None:
    rng = np.random.default_rng(8)
    forms = _forms(rng)
    regions = rng.standard_normal((8, BINS))

    def noise(count: int) -> np.ndarray:
        # Regions that come and go: most draws have next to nothing of them, some a lot.
        sizes = 0.5 * rng.standard_t(2.5, (count, 8))
        return rng.standard_normal((count, BINS)) + sizes @ regions

    draws = noise(DRAWS)
    mean = draws.mean(axis=0)
    found = noise_along(forms @ forms.T, forms @ (draws - mean).T, _evidence)
    told = [_evidence(*found.marginalised(forms @ forms.T, forms @ (one - mean))) for one in noise(200)]
    as_believed = [_evidence(forms @ forms.T, forms @ (one - mean)) for one in noise(200)]
    # By Markov's inequality a Bayes factor of 20 comes up once in twenty times at most.
    assert np.mean(np.array(told) > np.log(20.0)) < 0.1
    assert np.mean(np.array(as_believed) > np.log(20.0)) > 0.3


def test_noise_of_a_kind_that_was_not_drawn_is_seldom_evidence() -> None:
    """Four encoders, each with errors of its own that all its draws share: another one's are found by leave-one-out."""
    rng = np.random.default_rng(9)
    forms, regions = _forms(rng), rng.standard_normal((40, BINS))

    def noise(kinds: np.ndarray) -> np.ndarray:
        own = 0.6 * np.random.default_rng(int(rng.integers(1 << 30))).standard_normal((kinds.max() + 1, 40))
        return rng.standard_normal((len(kinds), BINS)) + own[kinds] @ regions

    kinds = np.arange(DRAWS) % 4
    draws, others = noise(kinds), noise(np.arange(200))
    mean, gram = draws.mean(axis=0), forms @ forms.T

    def alarms(known: list[int]) -> float:
        found = noise_along(gram, forms @ (draws - mean).T, _evidence, known)
        return float(
            np.mean([_evidence(*found.marginalised(gram, forms @ (one - mean))) > np.log(20.0) for one in others])
        )

    assert alarms(kinds.tolist()) < 0.1
    assert alarms([]) > 2.0 * alarms(kinds.tolist())
    # One kind alone, or one that leaves too few others, is as if none were told.
    same = noise_along(gram, forms @ (draws - mean).T, _evidence, [0] * DRAWS)
    assert same.variance == noise_along(gram, forms @ (draws - mean).T, _evidence).variance


def test_too_few_draws_say_nothing() -> None:
    forms = _forms(np.random.default_rng(5))
    found = noise_along(forms @ forms.T, np.zeros((FORMS, 3)), _evidence)
    assert found.variance == 1.0
    assert found.factors.shape == (0, FORMS)


def test_one_scan_in_a_hundred_exceeds_what_places_foretell() -> None:
    rng, exceeded = np.random.default_rng(6), 0
    for _ in range(400):
        sizes = stats.expon(scale=2.0).rvs(300, random_state=rng)
        spread = rng.permutation(300 * 20)[:300] * 50.0
        threshold = beyond([(float(z), float(at), 0.0) for z, at in zip(sizes, spread, strict=True)])
        exceeded += int(stats.expon(scale=2.0).rvs(300, random_state=rng).max() > threshold)
    assert exceeded / 400 < 0.05


def test_places_near_a_larger_one_count_once() -> None:
    assert beyond([(float(k), 0.01 * k, 0.0) for k in range(10 * TAIL)]) == 0.0
