"""The battery: does anything of structure remain in what a model leaves, wherever it may be?

Every test is a statistic of the whitened residuals, computed in the same way for the data and for draws of pure noise
from which the same nuisances were taken. Each statistic gets a tail law from its draws; the smallest tail probability
of all is compared with the smallest of each draw (Westfall & Young, Resampling-Based Multiple Testing, 1993), so that
the number of tests and their correlation cost just what they cost.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage, stats
from scipy.sparse import csr_matrix, vstack

from evanesce.criticism.features import (
    Contrasts,
    band_features,
    contrasts,
    cosine_features,
    line_features,
    ring_features,
    smoothed,
    smoothed_size,
)

Array = NDArray[Any]
Tail = Literal["sum", "largest", "normal"]
"""Law of a statistic's upper tail: of a sum of squares (gamma), of a maximum (Gumbel), or normal, two-sided."""

SCALES_BINS = (0.0, 1.0, 2.5, 6.0)
"""Widths over which local maxima are sought [bins]."""


@dataclass(frozen=True, kw_only=True)
class Residuals:
    """What a fitted model leaves of the data, whitened.

    Attributes
    ----------
    cube : ndarray (views, rows, cols)
        (data - model) / standard deviation, nuisances projected out; 0 where not valid.
    valid : ndarray of bool (views, rows, cols)
    level : ndarray (views, rows, cols)
        Predicted level [DN].
    gradient : ndarray (views, 2, rows, cols)
        Of the level along x and y [DN per bin].
    x_mm, y_mm : ndarray (rows, cols)
        Place on the plate [mm].
    distance_mm : ndarray (views, rows, cols)
        Outside (+) or inside (-) the predicted edge of contact; inf where nothing touches [mm].
    radius : ndarray (rows, cols)
        Distance from the optical centre over the half-diagonal.
    covariates : mapping of str to ndarray (views,)
        ``force_N``, ``voltage_V``, ``time_s``, ``displacement_mm``; NaN where not known.
    kinds : tuple of str (views,)
        ``press``, ``replicate``, ``led_off``, ``lens_cap``, ``checkerboard``, ``square``.
    ridge : ndarray (2,), optional
        Wave vector of the finger's ridges [rad/mm].
    series : mapping of str to ndarray
        Standardised residuals of the scalar series, in the order of their abscissa.
    """

    cube: Array
    valid: NDArray[np.bool_]
    level: Array
    gradient: Array
    x_mm: Array
    y_mm: Array
    distance_mm: Array
    radius: Array
    covariates: Mapping[str, Array]
    kinds: tuple[str, ...]
    ridge: Array | None = None
    series: Mapping[str, Array] = field(default_factory=dict)


@dataclass(frozen=True)
class Draws:
    """Residuals of pure noise, nuisances projected out as in the data.

    Attributes
    ----------
    cube : ndarray (draws, views, rows, cols)
    series : mapping of str to ndarray (draws, points)
    """

    cube: Array
    series: Mapping[str, Array] = field(default_factory=dict)
    _kept: dict[str, Array] = field(default_factory=dict, repr=False, compare=False)

    def kept(self, name: str, of: Callable[[Array], Array]) -> Array:
        """Return ``of(cube)``, computed once under this name: many tests look at the same features."""
        if name not in self._kept:
            self._kept[name] = of(self.cube)
        return self._kept[name]


@dataclass(frozen=True)
class Statistic:
    """One statistic of the battery.

    Attributes
    ----------
    of : callable
        ``of(draws) -> ndarray (draws,)``; large values speak against the null, for ``normal`` on both sides.
    tail : str
        :data:`Tail`.
    """

    of: Callable[[Draws], Array]
    tail: Tail


@dataclass(frozen=True)
class Outcome:
    """Of one test.

    Attributes
    ----------
    name : str
    statistic : float
    p : float
        Share of draws as large, (1 + #) / (1 + B).
    tail_p : float
        By the tail law; says how far beyond the draws it lies, not calibrated there.
    """

    name: str
    statistic: float
    p: float
    tail_p: float


@dataclass(frozen=True)
class BatteryResult:
    """Of all tests.

    Attributes
    ----------
    global_p : float
        That pure noise makes any of the tests ring as loudly: (1 + #) / (1 + B).
    outcomes : tuple of Outcome
        Loudest first.
    draws : int
        B.
    """

    global_p: float
    outcomes: tuple[Outcome, ...]
    draws: int

    @property
    def loudest(self) -> Outcome:
        """The test with the smallest tail probability."""
        return self.outcomes[0]


def run_battery(
    residuals: Residuals, draws: Iterable[Draws], extra: Mapping[str, Statistic] | None = None
) -> BatteryResult:
    """Test residuals against draws of pure noise.

    Parameters
    ----------
    residuals : Residuals
    draws : iterable of Draws
        In chunks; at least 999 in all for a level of 1 %.
    extra : mapping of str to Statistic, optional
        More members of the family, such as the score tests of the candidates.

    Raises
    ------
    ValueError
        For fewer than 19 draws.
    """
    tests = battery_tests(residuals) | dict(extra or {})
    return judge(tests, residuals, null_samples(tests, draws))


def null_samples(tests: Mapping[str, Statistic], draws: Iterable[Draws]) -> dict[str, Array]:
    """Return every test's statistic for every draw: (draws,) by name.

    Raises
    ------
    ValueError
        For fewer than 19 draws.
    """
    parts: dict[str, list[Array]] = {name: [] for name in tests}
    for chunk in draws:
        for name, test in tests.items():
            parts[name].append(test.of(chunk))
    null = {name: np.concatenate(found) for name, found in parts.items()}
    count = next(iter(null.values())).size
    if count < 19:
        raise ValueError(f"{count} draws cannot tell a level below 5 %")
    return null


def judge(tests: Mapping[str, Statistic], residuals: Residuals, null: Mapping[str, Array]) -> BatteryResult:
    """Return the result of all tests, with the family's own probability, from their draws."""
    seen = Draws(residuals.cube[None], {name: np.asarray(v)[None] for name, v in residuals.series.items()})
    count = next(iter(null.values())).size
    outcomes, loudest_null, loudest = [], np.ones(count), 1.0
    for name, test in tests.items():
        sample, value = null[name], float(test.of(seen)[0])
        if not np.isfinite(value) or np.ptp(sample) == 0.0:
            continue  # a test that has nothing to look at here, such as rings of a contact that no view shows
        law = tail_law(sample, test.tail)
        of_data, of_draws = float(law(np.array([value]))[0]), law(sample)
        loudest, loudest_null = min(loudest, of_data), np.minimum(loudest_null, of_draws)
        middle = float(np.median(sample))
        far = np.abs(sample - middle) >= abs(value - middle) if test.tail == "normal" else sample >= value
        outcomes.append(Outcome(name, value, float((1 + far.sum()) / (1 + count)), of_data))
    outcomes.sort(key=lambda o: o.tail_p)
    return BatteryResult(float((1 + (loudest_null <= loudest).sum()) / (1 + count)), tuple(outcomes), count)


def tail_law(sample: Array, tail: Tail) -> Callable[[Array], Array]:
    """Return a survival function fitted to draws of a statistic by their first two moments.

    It needs to be no more than a fair common scale for statistics of different kinds: the level comes from the draws.

    Parameters
    ----------
    sample : ndarray (draws,)
    tail : str
        :data:`Tail`.
    """
    mean, sd = float(sample.mean()), float(sample.std(ddof=1))
    if tail == "normal":
        return lambda t: np.asarray(2.0 * stats.norm.sf(np.abs(t - mean) / sd))
    if tail == "largest":
        scale = sd * np.sqrt(6.0) / np.pi
        law = stats.gumbel_r(loc=mean - np.euler_gamma * scale, scale=scale)
    else:
        law = stats.gamma((mean / sd) ** 2, scale=sd**2 / mean)
    # Far out the survival function underflows; loudness still has an order there.
    return lambda t: np.asarray(np.exp(np.maximum(law.logsf(t), -700.0)))


class _Linear:
    """Linear features of the whole cube, gathered into one sparse matrix so that each chunk is read once."""

    def __init__(self, residuals: Residuals) -> None:
        self.press = np.array([kind == "press" for kind in residuals.kinds])
        self.pressed = residuals.valid & self.press[:, None, None]
        self._rows: list[csr_matrix] = []
        self._all: csr_matrix | None = None

    def add(self, matrix: csr_matrix) -> Callable[[Draws], Array]:
        """Add features (features, bins); returns what reads them of draws: (features, draws)."""
        start = sum(m.shape[0] for m in self._rows)
        self._rows.append(matrix.astype(np.float32))
        part = slice(start, start + matrix.shape[0])
        return lambda draws: draws.kept("linear", self.features)[part]

    def features(self, cube: Array) -> Array:
        """Return all features (features, draws) of cubes (draws, views, rows, cols)."""
        if self._all is None:
            self._all = vstack(self._rows).tocsr()
        flat = np.ascontiguousarray(cube.reshape(len(cube), -1).T, dtype=np.float32)
        return np.asarray(self._all @ flat)

    def templates(self, templates: Array) -> Callable[[Draws], Array]:
        """Add projections on templates (features, views, rows, cols), each made a unit vector."""
        flat = templates.reshape(len(templates), -1)
        size = np.sqrt((flat**2).sum(axis=1, keepdims=True))
        return self.add(csr_matrix(flat / np.where(size > 0, size, np.inf)))

    def means(self, labels: Array, weights: Array | None = None) -> Callable[[Draws], Array]:
        """Add weighted means over labelled bins of the press frames; label -1 is left out."""
        labels = np.where(self.pressed, labels, -1)
        keep = np.flatnonzero(labels >= 0)
        number = labels.ravel()[keep].astype(int)
        weight = np.ones(keep.size) if weights is None else np.asarray(weights)[keep // labels[0].size]
        size = np.bincount(number, weight**2, 1)
        values = weight / np.sqrt(np.maximum(size, 1e-300))[number] if keep.size else weight
        matrix = csr_matrix((values, (number, keep)), (size.size, labels.size))
        return self.add(matrix[np.flatnonzero(size > 0)])


def battery_tests(residuals: Residuals) -> dict[str, Statistic]:
    """Return the tests that these residuals allow, by name."""
    tests: dict[str, Statistic] = {}
    found = contrasts(residuals.kinds, residuals.covariates, residuals.valid)
    for k, name in enumerate(found.names):
        tests |= _map_tests(name, k, found)
    if "mean" in found.names:
        tests |= _line_tests(found, residuals)
        linear = _Linear(residuals)
        tests |= _profile_tests(residuals, linear)
        tests |= _view_tests(residuals, linear)
    for name, values in residuals.series.items():
        if np.asarray(values).size >= 4:
            tests |= _series_tests(name)
    return tests


def _map_tests(name: str, k: int, found: Contrasts) -> dict[str, Statistic]:
    """Return the tests of one contrast's map: smooth, local at several scales, neighbours alike."""
    basis_y, basis_x = (b.astype(np.float32) for b in cosine_features(found.seen.shape[1:]))

    def m(draws: Draws) -> Array:
        return np.asarray(draws.kept("maps", found.maps)[:, k])

    def cosines(draws: Draws) -> Array:
        return np.asarray(basis_y @ m(draws) @ basis_x.T)

    def neighbours(draws: Draws) -> Array:
        here = m(draws)
        alike = np.einsum("nyx,nyx->n", here[:, 1:], here[:, :-1])
        alike += np.einsum("nyx,nyx->n", here[:, :, 1:], here[:, :, :-1])
        return np.asarray(alike / np.maximum(np.einsum("nyx,nyx->n", here, here), 1e-30))

    def peak(scale: float) -> Callable[[Draws], Array]:
        # The expected size of the smoothed map, so that a place near the border counts like any other.
        size = smoothed_size(found.seen[k], scale)

        def of(draws: Draws) -> Array:
            return np.array([np.abs(smoothed(one, scale) / size).max() for one in m(draws)])

        return of

    tests = {
        f"{name}: cosine power": Statistic(lambda d: (cosines(d) ** 2).sum(axis=(1, 2)), "sum"),
        f"{name}: largest cosine": Statistic(lambda d: np.abs(cosines(d)).max(axis=(1, 2)), "largest"),
        f"{name}: neighbours alike (Moran)": Statistic(neighbours, "normal"),
    }
    for scale in SCALES_BINS:
        tests[f"{name}: local maximum, {scale:g} bins"] = Statistic(peak(scale), "largest")
    return tests


def _line_tests(found: Contrasts, residuals: Residuals) -> dict[str, Statistic]:
    """Return the tests for straight lines and for rows."""
    lines = line_features(residuals.valid.shape[1:]).astype(np.float32)
    mean = found.names.index("mean")
    press = np.array([kind == "press" for kind in residuals.kinds])

    def radon(draws: Draws) -> Array:
        m = draws.kept("maps", found.maps)[:, mean]
        return np.abs(lines @ np.ascontiguousarray(m.reshape(len(m), -1).T)).max(axis=0)

    def rows(draws: Draws) -> Array:
        # Bands run over the frame with another phase each time: powers of the views add, not their waves.
        profile = draws.cube[:, press].mean(axis=3)
        power = np.abs(np.fft.rfft(profile - profile.mean(axis=2, keepdims=True), axis=2)) ** 2
        return np.asarray(power.sum(axis=1)[:, 2:].max(axis=1))

    return {"mean: Radon maximum": Statistic(radon, "largest"), "rows: periodogram": Statistic(rows, "largest")}


def _profile_tests(residuals: Residuals, linear: _Linear) -> dict[str, Statistic]:
    """Return the tests along one predicted quantity: radius, distance from contact, level, gradient, ridges."""
    press, pressed = linear.press, linear.pressed
    force = np.asarray(residuals.covariates.get("force_N", np.full(press.size, np.nan)), float)
    bands = band_features(residuals.distance_mm)
    features = {
        "radius from the optical centre": linear.means(
            ring_features(np.broadcast_to(residuals.radius, residuals.cube.shape), 10)
        ),
        "distance from contact": linear.means(bands),
        "predicted level": linear.means(ring_features(np.where(pressed, residuals.level, np.nan), 12)),
    }
    if np.isfinite(force[press]).all() and np.ptp(force[press]) > 0:
        slope = np.where(press, force - force[press].mean(), 0.0)
        features["distance from contact, with force"] = linear.means(bands, slope)
    tests: dict[str, Statistic] = {}
    for name, of in features.items():
        tests[f"{name}: sum"] = _squares(of)
        tests[f"{name}: largest"] = Statistic(_largest(of), "largest")
    near = np.where(pressed & np.isfinite(residuals.distance_mm), residuals.distance_mm, 0.0)
    edge = linear.templates((near * np.exp(-2.0 * near**2))[None])
    tests["edge spread"] = Statistic(lambda d: edge(d)[0], "normal")
    shift = np.where(pressed[:, None], residuals.gradient, 0.0)
    tests["shift along the gradient"] = _squares(linear.templates(_one_view_each(shift, press)))
    if residuals.ridge is not None:
        phase = residuals.ridge[0] * residuals.x_mm + residuals.ridge[1] * residuals.y_mm
        inside = pressed & (residuals.distance_mm < 0)
        waves = np.stack([np.cos(phase), np.sin(phase)])[None] * inside[:, None]
        tests["ridge band"] = _squares(linear.templates(_one_view_each(waves, press)))
    return tests


def _places(order: Array, views: int) -> Array:
    """Return each view's place in an order of some of them, -1 for the others."""
    found = np.full(views, -1)
    found[order] = np.arange(order.size)
    return found


def _squares(of: Callable[[Draws], Array]) -> Statistic:
    return Statistic(lambda draws: (of(draws) ** 2).sum(axis=0), "sum")


def _largest(of: Callable[[Draws], Array]) -> Callable[[Draws], Array]:
    return lambda draws: np.abs(of(draws)).max(axis=0)


def _one_view_each(patterns: Array, press: Array) -> Array:
    """Return patterns (views, k, rows, cols) as templates (press views * k, views, rows, cols), one view in each."""
    found = []
    for view in np.flatnonzero(press):
        for pattern in patterns[view]:
            template = np.zeros((patterns.shape[0], *pattern.shape), np.float32)
            template[view] = pattern
            found.append(template)
    return np.array(found)


def _view_tests(residuals: Residuals, linear: _Linear) -> dict[str, Statistic]:
    """Return the tests of whole views: their scatter, their means in the order of time."""
    press = np.flatnonzero(linear.press)
    tests = {"all bins: chi-square": Statistic(lambda d: np.einsum("nvyx,nvyx->n", d.cube, d.cube), "normal")}
    if press.size < 4:
        return tests
    time = np.asarray(residuals.covariates.get("time_s", np.full(len(residuals.kinds), np.nan)), float)[press]
    timed = bool(np.isfinite(time).all() and np.ptp(time) > 0)
    order = press[np.argsort(time, kind="stable")] if timed else press
    read = linear.means(np.where(linear.pressed, _places(order, linear.press.size)[:, None, None], -1))

    def means(draws: Draws) -> Array:
        return np.asarray(read(draws).T)

    def cusum(draws: Draws) -> Array:
        m = means(draws)
        return np.abs(np.cumsum(m - m.mean(axis=1, keepdims=True), axis=1)).max(axis=1)

    def ljung_box(draws: Draws) -> Array:
        m = means(draws)
        m = m - m.mean(axis=1, keepdims=True)
        n, power = m.shape[1], np.maximum((m**2).sum(axis=1), 1e-30)
        lags = range(1, min(4, n - 1))
        return np.asarray(n * (n + 2) * sum(((m[:, k:] * m[:, :-k]).sum(axis=1) / power) ** 2 / (n - k) for k in lags))

    tests["view means: sum"] = _squares(read)
    tests["view means: CUSUM"] = Statistic(cusum, "largest")
    tests["view means: Ljung-Box"] = Statistic(ljung_box, "sum")
    if timed:
        clock = np.log1p(np.sort(time) - time.min())
        clock = (clock - clock.mean()) / np.sqrt(((clock - clock.mean()) ** 2).sum())
        tests["view means: slope against log time"] = Statistic(lambda d: means(d) @ clock, "normal")
    return tests


def _series_tests(name: str) -> dict[str, Statistic]:
    """Return lack of fit (sum of squares) and runs of one sign for a scalar series."""

    def lack(draws: Draws) -> Array:
        return np.asarray((draws.series[name] ** 2).sum(axis=1))

    def runs(draws: Draws) -> Array:
        sign = draws.series[name] > 0
        return np.asarray((sign[:, 1:] != sign[:, :-1]).sum(axis=1), float)

    return {f"series {name}: lack of fit": Statistic(lack, "sum"), f"series {name}: runs": Statistic(runs, "normal")}


def local_peaks(m: Array, threshold: float) -> list[tuple[int, int, float]]:
    """Return places (row, col, value) where a map's absolute value peaks above a threshold, largest first.

    Parameters
    ----------
    m : ndarray (rows, cols)
    threshold : float
    """
    size = np.abs(m)
    peak = (size == ndimage.maximum_filter(size, 3)) & (size > threshold)
    places = sorted(zip(*np.nonzero(peak), strict=True), key=lambda rc: -size[rc])
    return [(int(r), int(c), float(m[r, c])) for r, c in places]
