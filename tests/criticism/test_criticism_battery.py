"""The battery rings for structure of every kind, names it by the right test, and is quiet for noise, white or not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage, stats

from evanesce.criticism.battery import judge, null_samples, run_battery, tail_law
from evanesce.criticism.battery_data import Draws, Residuals, Statistic
from evanesce.criticism.battery_statistics import battery_tests
from evanesce.criticism.features import contrasts, line_features, smoothed_size

ROWS, COLS = 36, 52
KINDS = ("press",) * 9 + ("led_off", "square")
FORCE = np.array([0.4, 0.9, 1.7, 2.6, 4.1, 3.0, 3.0, 3.0, 3.0, np.nan, np.nan])
VOLTAGE = np.array([9.0, 9.0, 9.0, 9.0, 9.0, 8.4, 9.7, 10.9, 11.6, np.nan, np.nan])
TIME = np.array([0.0, 2.2, 5.1, 9.0, 14.0, 31.0, 33.5, 36.0, 61.0, np.nan, np.nan])
ROW, COL = np.mgrid[0:ROWS, 0:COLS]
X_MM, Y_MM = 0.66 * (COL - 23.7), 0.66 * (ROW - 19.1)
RADIUS = np.hypot(COL - 26.4, ROW - 16.8) / 31.0


def geometry(cube: np.ndarray) -> Residuals:
    """Return residuals of ugly views: a contact off the middle, a corner cut off, unequal conditions."""
    edge = 2.4 * np.cbrt(FORCE)
    away = np.hypot(X_MM - 1.9, Y_MM + 2.3)
    distance = np.where(np.isfinite(edge)[:, None, None], away - edge[:, None, None], np.inf)
    level = 3.0 + 110.0 / (1.0 + np.exp(np.clip(4.0 * distance, -50, 50)))
    valid = np.ones(cube.shape, bool)
    valid[:, :4, :6] = False
    gradient = np.stack(np.gradient(level, axis=(2, 1)), axis=1)
    return Residuals(
        cube=np.where(valid, cube, 0.0), valid=valid, level=level, gradient=gradient, x_mm=X_MM, y_mm=Y_MM,
        distance_mm=distance, radius=RADIUS, kinds=KINDS, ridge=np.array([2.1, 1.3]),
        covariates={"force_N": FORCE, "voltage_V": VOLTAGE, "time_s": TIME},
    )  # fmt: skip


def noise(seed: int, count: int, blur: float = 0.0) -> np.ndarray:
    """Return noise of unit variance, correlated over ``blur`` bins."""
    draws = np.random.default_rng(seed).normal(size=(count, len(KINDS), ROWS, COLS))
    if blur:
        draws = ndimage.gaussian_filter(draws, (0, 0, blur, blur), mode="wrap")
        draws /= draws.std()
    return draws.astype(np.float32)


def null(seed: int, count: int = 299, blur: float = 0.0) -> list[Draws]:
    valid = geometry(np.zeros((len(KINDS), ROWS, COLS))).valid
    return [Draws(noise(seed, count, blur) * valid)]


AWAY, ANGLE = np.hypot(X_MM - 1.9, Y_MM + 2.3), np.arctan2(Y_MM + 2.3, X_MM - 1.9)
DISTANCE = AWAY - np.nan_to_num(2.4 * np.cbrt(FORCE), nan=99.0)[:, None, None]
SOFTER = ndimage.gaussian_filter(1.0 * (DISTANCE < 0), (0, 1.4, 1.4)) - ndimage.gaussian_filter(
    1.0 * (DISTANCE < 0), (0, 0.9, 0.9)
)
RIM, SHARE = np.exp(-3.0 * DISTANCE**2), AWAY**2 / np.nan_to_num(2.4 * np.cbrt(FORCE), nan=0.1)[:, None, None] ** 2
PRESS = np.array([kind == "press" for kind in KINDS])[:, None, None]
STRUCTURES = {
    "vignette": (PRESS * (RADIUS**2 - 0.4), ("radius", "cosine")),
    "spot": (PRESS * np.exp(-((COL - 40) ** 2 + (ROW - 9) ** 2) / 1.0), ("mean: local maximum",)),
    "line": (PRESS * (np.abs(0.6 * (COL - 20) + 0.8 * (ROW - 25)) < 0.6), ("mean: Radon",)),
    "bands": (
        PRESS * np.cos(2 * np.pi * 5 * ROW / ROWS + 1.7 * np.arange(len(KINDS))[:, None, None]), ("rows: periodogram",),
    ),
    "bands of the light": (
        PRESS * (DISTANCE < 0) * np.cos(2 * np.pi * 8 * ROW / ROWS + 2.3 * np.arange(len(KINDS))[:, None, None]),
        ("rows in the light",),
    ),
    "fixed rows": (
        0.4 * np.sin(2.9 * np.arange(ROWS) ** 1.5)[:, None] * np.ones((len(KINDS), 1, COLS)), ("rows: fixed",),
    ),
    "fixed columns": (
        0.4 * np.sin(2.3 * np.arange(COLS) ** 1.4) * np.ones((len(KINDS), ROWS, 1)), ("columns: fixed",),
    ),
    "warming": (PRESS * (np.nan_to_num(np.log1p(TIME)) - 2.4)[:, None, None] * np.ones((ROWS, COLS)), ("view", "time")),
    "fringes": (
        PRESS * (AWAY < 6.0) * np.sin(2 * np.pi * (0.31 * COL + 0.17 * ROW)), ("mean: periodogram", ),
    ),
    "focus that walks": (
        PRESS * np.nan_to_num(np.log1p(TIME) - 2.4)[:, None, None] * (1 + np.cos(2 * ANGLE)) * SOFTER,
        ("outline softens",),
    ),
    "plate that bends": (
        PRESS * np.nan_to_num(FORCE)[:, None, None] * np.cos(ANGLE - 0.7) ** 2 * RIM, ("outline moves", "with force"),
    ),
    "rings in the contact": (
        PRESS * (SHARE < 1.2) * np.cos(2 * np.pi * 3.3 * SHARE + 1.1), ("radius over the contact's",),
    ),
    "led off": (np.array([k == "led_off" for k in KINDS])[:, None, None] * np.ones((ROWS, COLS)), ("led_off",)),
}  # fmt: skip


@pytest.mark.parametrize("name", STRUCTURES)
def test_structure_rings_and_the_test_made_for_it_is_among_the_loudest(name: str) -> None:
    structure, expected = STRUCTURES[name]
    there = geometry(structure.astype(float)).cube
    # Waves of another phase in each view share nothing that could be added up.
    there *= (12.0 if name == "bands of the light" else 9.0) / np.sqrt((there**2).sum())
    found = run_battery(geometry(noise(11, 1)[0] + there), null(5))
    assert found.global_p <= 2 / 300
    loudest = [outcome.name for outcome in found.outcomes[:4]]
    assert any(word in test for word in expected for test in loudest), loudest


def test_what_is_louder_than_all_draws_still_has_a_size() -> None:
    """Draws count to 1 in 300; a structure three times as large is louder by much, and noise alone is not."""
    structure = STRUCTURES["fixed rows"][0].astype(float)
    unit = structure * 9.0 / np.sqrt((geometry(structure).cube ** 2).sum())
    faint, loud = (run_battery(geometry(noise(11, 1)[0] + k * unit), null(5)) for k in (1.0, 3.0))
    assert faint.global_p == loud.global_p
    assert loud.beyond_draws < 1e-6 * faint.beyond_draws
    nothing = run_battery(geometry(noise(11, 1)[0]), null(5))
    assert nothing.beyond_draws == nothing.global_p


def test_wider_or_stiffer_contact_rings_beside_its_edge() -> None:
    base = geometry(np.zeros((len(KINDS), ROWS, COLS)))
    ring = np.where(np.isfinite(base.distance_mm), np.exp(-((base.distance_mm / 0.5) ** 2)), 0.0)
    ring *= 9.0 / np.sqrt((ring**2).sum())
    found = run_battery(geometry(noise(3, 1)[0] + ring), null(6))
    assert found.global_p <= 2 / 300
    assert all("distance from contact" in o.name or "outline" in o.name for o in found.outcomes[:2])


@pytest.mark.slow  # thousands of draws: 10 s
@pytest.mark.parametrize("blur", [0.0, 0.8])
def test_false_alarms_stay_at_their_level_when_draws_share_the_correlation(blur: float) -> None:
    tests = battery_tests(geometry(noise(1, 1)[0]))
    samples = null_samples(tests, null(17, 199, blur))
    ps = [judge(tests, geometry(one), samples).global_p for one in noise(23, 60, blur)]
    # 60 cases at 10 %: binomial bounds that hold in 999 of 1000 runs.
    low, high = stats.binom.ppf([0.0005, 0.9995], 60, 0.1)
    assert low <= sum(p <= 0.1 for p in ps) <= high
    assert stats.kstest(ps, "uniform").pvalue > 1e-3


def test_white_draws_for_correlated_data_give_false_alarms() -> None:
    # The lesson that made the level come from replicates: the test is only as good as its draws.
    tests = battery_tests(geometry(noise(1, 1)[0]))
    samples = null_samples(tests, null(31, 199))
    ps = [judge(tests, geometry(one), samples).global_p for one in noise(29, 12, 0.8)]
    assert np.mean(np.array(ps) <= 0.05) > 0.6


@pytest.mark.parametrize("inside", [0, 1, 2])
def test_a_contact_of_no_bin_or_two_is_judged(inside: int) -> None:
    """Rationale: loads near nothing are legal; its rings and outlines had no rows to take a maximum of."""
    base = geometry(noise(3, 1)[0])
    distance = np.full(base.distance_mm.shape, 5.0 if inside else np.inf)
    distance[:9, 14, 20 : 20 + inside] = -0.1
    residuals = replace(base, distance_mm=distance)
    found = run_battery(residuals, null(5, 99))
    assert 0.0 < found.global_p <= 1.0
    assert all(np.isfinite(o.statistic) and 0.0 < o.p <= 1.0 for o in found.outcomes)


def test_a_frame_with_no_valid_bin_is_left_out_of_the_views_means() -> None:
    """Rationale: one press frame that is all white had no mean, but a time of its own."""
    base = geometry(noise(3, 1)[0])
    valid = base.valid.copy()
    valid[4] = False
    whole = replace(base, valid=valid, cube=np.where(valid, base.cube, 0.0))
    found = run_battery(whole, [Draws(null(5, 99)[0].cube * valid)])
    assert any(o.name == "view means: slope against log time" for o in found.outcomes)


def test_residuals_quieter_than_noise_may_be_are_no_structure() -> None:
    """A twelfth of the noise allowed, neighbours much alike and frames in a row too: what a floor of noise covers."""
    slow = ndimage.gaussian_filter(noise(37, 1)[0], (1.5, 2.0, 2.0))
    quiet = geometry(0.08 * slow / slow.std())
    assert run_battery(quiet, null(19)).global_p > 0.5
    assert run_battery(geometry(quiet.cube / 0.08), null(19)).global_p <= 2 / 300


def test_contrasts_are_orthogonal_and_their_maps_have_unit_variance() -> None:
    base = geometry(noise(1, 1)[0])
    found = contrasts(base.kinds, base.covariates, base.valid)
    assert found.names == ("mean", "voltage", "force", "time", "led_off", "square")
    np.testing.assert_allclose(found.weights @ found.weights.T, np.eye(6), atol=1e-12)
    maps = found.maps(noise(2, 400))[:, :, 6:, 8:]
    bins = maps.shape[0] * maps.shape[2] * maps.shape[3]
    np.testing.assert_allclose(maps.var(axis=(0, 2, 3)), 1.0, atol=5 * np.sqrt(2 / bins))


def test_covariate_that_follows_another_gets_no_contrast_of_its_own() -> None:
    valid = np.ones((4, 3, 5), bool)
    force = np.array([1.0, 2.0, 4.0, 5.0])
    found = contrasts(("press",) * 4, {"force_N": force, "displacement_mm": 0.3 * force + 0.1}, valid)
    assert found.names == ("mean", "force")


def test_lines_of_white_noise_have_unit_variance() -> None:
    lines = line_features((ROWS, COLS))
    sums = lines @ np.random.default_rng(7).normal(size=(ROWS * COLS, 2000))
    np.testing.assert_allclose(sums.var(axis=1), 1.0, atol=6 * np.sqrt(2 / 2000))


@pytest.mark.parametrize("sigma", [1.0, 2.5])
def test_smoothed_size_is_what_noise_shows_at_the_border_too(sigma: float) -> None:
    from evanesce.criticism.features import smoothed

    seen = np.ones((ROWS, COLS))
    seen[:4, :6] = 0.0
    images = noise(9, 400)[:, 0] * seen.astype(np.float32)
    spread = np.std([smoothed(image, sigma) for image in images], axis=0)
    predicted = smoothed_size(seen, sigma)
    here = seen > 0
    np.testing.assert_allclose((spread / predicted)[here], 1.0, atol=6 / np.sqrt(2 * 400))


@pytest.mark.parametrize(("tail", "law"), [("sum", stats.chi2(7)), ("largest", stats.gumbel_r(3.0, 0.7))])
def test_tail_law_returns_the_law_it_was_drawn_from(tail: str, law: stats.rv_continuous) -> None:
    fitted = tail_law(law.rvs(20_000, random_state=4), tail)  # type: ignore[arg-type]
    at = law.isf([0.1, 0.01, 0.001])
    np.testing.assert_allclose(fitted(at), [0.1, 0.01, 0.001], rtol=0.25)


def test_extra_test_joins_the_family() -> None:
    base = noise(41, 1)[0]
    template = np.zeros((len(KINDS), ROWS, COLS), np.float32)
    template[2, 17:20, 30:33] = 1 / 3
    extra = {"score: mine": Statistic(lambda d: (d.cube.reshape(len(d.cube), -1) @ template.ravel()) ** 2, "sum")}
    found = run_battery(geometry(base + 7.0 * template), null(8), extra)
    assert found.loudest.name == "score: mine"
    assert len(found.outcomes) == len(battery_tests(geometry(base))) + 1


def test_series_that_bends_rings_by_its_runs_or_its_misfit() -> None:
    base = geometry(noise(1, 1)[0])
    bend = np.linspace(-1, 1, 24) ** 2 * 6 - 2.0
    rng = np.random.default_rng(2)
    found = run_battery(
        Residuals(**{**vars(base), "series": {"area_force": bend + rng.normal(size=24)}}),
        [Draws(null(3)[0].cube, {"area_force": rng.normal(size=(299, 24))})],
    )
    assert found.loudest.name.startswith("series area_force")


def test_too_few_draws_are_refused() -> None:
    with pytest.raises(ValueError, match="12 draws"):
        run_battery(geometry(noise(1, 1)[0]), null(1, 12))
