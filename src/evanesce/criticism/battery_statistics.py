"""The statistics of the battery: smooth maps, local maxima, lines, rows, profiles, single views, series."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import fft
from scipy.sparse import csr_matrix, vstack

from evanesce.criticism.battery_data import Draws, Residuals, Statistic
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

SCALES_BINS = (0.0, 1.0, 2.5, 6.0)
"""Widths over which local maxima are sought [bins]."""

RINGS, RINGS_TO = 16, 1.5
"""Rings of equal area in a contact, and as far out as this many times its area."""

FAINT = 1e-3
"""Share of a pattern's largest value below which it is left out."""


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
        light = np.sqrt(np.tensordot(found.weights[k] ** 2, np.where(residuals.valid, residuals.level, 0.0) ** 2, 1))
        tests |= _map_tests(name, k, found, light.astype(np.float32))
    if "mean" in found.names:
        tests |= _line_tests(found, residuals)
        linear = _Linear(residuals)
        tests |= _profile_tests(residuals, linear)
        tests |= _edge_tests(residuals, found, linear)
        tests |= _view_tests(residuals, linear)
    for name, values in residuals.series.items():
        if np.asarray(values).size >= 4:
            tests |= _series_tests(name)
    return tests


def _map_tests(name: str, k: int, found: Contrasts, light: Array) -> dict[str, Statistic]:
    """Return the tests of one contrast's map: smooth, local at several scales, neighbours alike, waves of its light."""
    basis_y, basis_x = (b.astype(np.float32) for b in cosine_features(found.seen.shape[1:]))

    def m(draws: Draws) -> Array:
        return np.asarray(draws.kept("maps", found.maps)[:, k])

    def cosines(draws: Draws) -> Array:
        return np.asarray(basis_y @ m(draws) @ basis_x.T)

    bins = float(found.seen[k].sum())

    def neighbours(draws: Draws) -> Array:
        # A map quieter than noise may be has nothing to say, however alike its neighbours are.
        here = m(draws)
        alike = np.einsum("nyx,nyx->n", here[:, 1:], here[:, :-1])
        alike += np.einsum("nyx,nyx->n", here[:, :, 1:], here[:, :, :-1])
        return np.asarray(alike / np.maximum(np.einsum("nyx,nyx->n", here, here), max(bins, 1.0)))

    def peak(scale: float) -> Callable[[Draws], Array]:
        # The expected size of the smoothed map, so that a place near the border counts like any other.
        size = smoothed_size(found.seen[k], scale)

        def of(draws: Draws) -> Array:
            return np.array([np.abs(smoothed(one, scale) / size).max() for one in m(draws)])

        return of

    def waves(draws: Draws) -> Array:
        # Fringes multiply the light: where there is none they add but noise. Slow waves are for the other tests.
        power = np.abs(fft.rfft2(m(draws) * light, axes=(1, 2))) ** 2
        power[:, :3, :3] = power[:, -2:, :3] = 0.0
        return np.asarray(power.max(axis=(1, 2)))

    tests = {
        f"{name}: cosine power": Statistic(lambda d: (cosines(d) ** 2).sum(axis=(1, 2)), "sum"),
        f"{name}: largest cosine": Statistic(lambda d: np.abs(cosines(d)).max(axis=(1, 2)), "largest"),
        f"{name}: neighbours alike (Moran)": Statistic(neighbours, "normal"),
        f"{name}: periodogram of the map": Statistic(waves, "largest"),
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

    light = np.where(residuals.valid, residuals.level, 0.0)[press].astype(np.float32)
    size = (light**2).sum(axis=2)
    size /= np.maximum(size.sum(axis=1, keepdims=True), 1e-30)

    def lit_rows(draws: Draws) -> Array:
        # Most of a frame is dark, and bands of the LEDs are where their light is; all of it up or down is none.
        profile = np.einsum("nvrc,vrc->nvr", draws.cube[:, press], light)
        profile = profile - profile.sum(axis=2, keepdims=True) * size
        power = np.abs(np.fft.rfft(profile, 2 * profile.shape[2], axis=2)) ** 2
        power /= np.maximum((light**2).sum(axis=(1, 2)), 1e-30)[:, None]
        return np.asarray(power.sum(axis=1)[:, 4:].max(axis=1))

    def fixed(along: int) -> Callable[[Draws], Array]:
        # A pattern that stays in all shots, dark ones too.
        count = np.sqrt(np.maximum(residuals.valid.sum(axis=(0, along)), 1)).astype(np.float32)

        def of(draws: Draws) -> Array:
            profile = draws.cube.sum(axis=(1, along + 1)) / count
            return np.asarray(((profile - profile.mean(axis=1, keepdims=True)) ** 2).sum(axis=1))

        return of

    return {
        "mean: Radon maximum": Statistic(radon, "largest"),
        "rows: periodogram": Statistic(rows, "largest"),
        "rows in the light: periodogram": Statistic(lit_rows, "largest"),
        "rows: fixed pattern": Statistic(fixed(2), "sum"),
        "columns: fixed pattern": Statistic(fixed(1), "sum"),
    }


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


def _edge_tests(residuals: Residuals, found: Contrasts, linear: _Linear) -> dict[str, Statistic]:
    """Return the tests of the contact's outline: where it lies and how soft it is, by direction, and rings within.

    An outline that moves changes the frame by the level's gradient, one that softens by its curvature; either as
    force, voltage or time go, alike all around or as two or four sectors.
    """
    contacts = [_contact(residuals, k) for k in range(len(residuals.kinds))]
    if not any(c is not None for c in contacts):
        return {}
    down = np.gradient(residuals.gradient[:, 1], axis=1)
    right = np.gradient(residuals.gradient[:, 0], axis=2)
    shapes = {"moves": np.hypot(residuals.gradient[:, 0], residuals.gradient[:, 1]), "softens": down + right}
    tests: dict[str, Statistic] = {}
    for name, shape in shapes.items():
        templates = []
        for k, contrast in enumerate(found.names):
            if contrast in ("mean", "voltage", "force", "time", "displacement"):
                templates += _sectors(shape * found.weights[k][:, None, None], contacts, linear.pressed)
        of = linear.templates(np.array(templates))
        tests[f"outline {name}: sum"] = _squares(of)
        tests[f"outline {name}: largest"] = Statistic(_largest(of), "largest")
    rings = np.full(linear.pressed.shape, -1)
    for k, contact in enumerate(contacts):
        if contact is not None:
            share = contact[0] ** 2
            rings[k] = np.where(share < RINGS_TO, np.floor(share * RINGS), -1)
    of_rings = linear.means(rings)
    # Rings that alternate are a wave along the shares of the area, whatever their phase.
    return tests | {
        "radius over the contact's: sum": _squares(of_rings),
        "radius over the contact's: periodogram": Statistic(lambda d: _periodogram(of_rings(d)), "largest"),
    }


def _periodogram(series: Array) -> Array:
    """Return the largest power of series (points, draws) at any but the lowest frequency."""
    if len(series) < 2:
        return np.zeros(series.shape[1])
    power = np.abs(np.fft.rfft(series - series.mean(axis=0), axis=0)) ** 2
    return np.asarray(power[1:].max(axis=0))


def _contact(residuals: Residuals, view: int) -> tuple[Array, Array] | None:
    """Return distance (rows, cols) from the contact's middle over its radius, and direction [rad]; None without one."""
    distance = residuals.distance_mm[view]
    inside = distance < 0
    if residuals.kinds[view] != "press" or not inside.any():
        return None
    x, y = (place - place[inside].mean() for place in (residuals.x_mm, residuals.y_mm))
    radius = float(np.hypot(x, y)[inside].mean()) * 1.5  # of a disc, whose points are at two thirds on average
    if radius == 0.0:  # one bin has no direction
        return None
    return np.hypot(x, y) / radius, np.arctan2(y, x)


def _sectors(shape: Array, contacts: Sequence[tuple[Array, Array] | None], pressed: NDArray[np.bool_]) -> list[Array]:
    """Return a pattern (views, rows, cols) times 1, cosine and sine of the direction and of twice it."""
    found = []
    for wave in (lambda a: np.ones_like(a), np.cos, np.sin, lambda a: np.cos(2 * a), lambda a: np.sin(2 * a)):
        template = np.zeros(shape.shape, np.float32)
        for k, contact in enumerate(contacts):
            if contact is not None:
                template[k] = np.where(pressed[k], shape[k] * wave(contact[1]), 0.0)
        template[np.abs(template) < FAINT * np.abs(template).max(initial=0.0)] = 0.0
        found.append(template)
    return found


def _places(order: Array, views: int) -> Array:
    """Return each view's place in an order of some of them, -1 for the others."""
    found = np.full(views, -1)
    found[order] = np.arange(order.size)
    return found


def _squares(of: Callable[[Draws], Array]) -> Statistic:
    return Statistic(lambda draws: (of(draws) ** 2).sum(axis=0), "sum")


def _largest(of: Callable[[Draws], Array]) -> Callable[[Draws], Array]:
    return lambda draws: np.abs(of(draws)).max(axis=0, initial=0.0)


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
    press = np.flatnonzero(linear.pressed.any(axis=(1, 2)))
    # Less scatter than was allowed for is no structure: cameras may be quieter than any is believed to be.
    tests = {"all bins: chi-square": Statistic(lambda d: np.einsum("nvyx,nvyx->n", d.cube, d.cube), "sum")}
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
        n = m.shape[1]
        power = np.maximum((m**2).sum(axis=1), n - 1.0)
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
