"""Structure that no effect of the library explains: a flexible term, and words for what it looks like.

Used after the library was tried, never before. The flexible term is a sum of smooth maps and of bands along the edge
of contact, each times a function of the conditions; its size is shrunk by the residuals' own evidence (MacKay, Neural
Computation 4, 415, 1992). It interpolates between the conditions seen and is held constant beyond them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import optimize, stats

from evanesce.criticism.battery_data import Residuals
from evanesce.criticism.features import BANDS_MM, band_features, contrasts, cosine_features, line_features

Array = NDArray[Any]
Project = Callable[[Array], Array]
"""Takes cubes (n, views, rows, cols), returns them without their part along the nuisances."""

COVARIATES = {"voltage": "voltage_V", "force": "force_N", "time": "time_s", "displacement": "displacement_mm"}


@dataclass(frozen=True)
class Flexible:
    """A fitted flexible term.

    Attributes
    ----------
    coefficients : ndarray (features,)
        [DN].
    ranges : mapping of str to (float, float)
        Of the covariates that it has seen: lowest and highest.
    evidence : float
        Log evidence over that of no term.
    explained : float
        Share of the misfit beyond noise that it takes away, 0 to 1.
    """

    coefficients: Array
    ranges: Mapping[str, tuple[float, float]]
    evidence: float
    explained: float

    def predict(self, views: Residuals) -> Array:
        """Return the term for views, seen or not (views, rows, cols) [DN]."""
        return np.asarray(np.tensordot(self.coefficients, flexible_basis(views, self.ranges), 1))


def covariate_ranges(views: Residuals) -> dict[str, tuple[float, float]]:
    """Return lowest and highest value of each covariate that all press frames have and that varies."""
    press = np.array([kind == "press" for kind in views.kinds])
    found = {}
    for name, key in COVARIATES.items():
        values = np.asarray(views.covariates.get(key, np.full(press.size, np.nan)), float)[press]
        if values.size and np.isfinite(values).all() and np.ptp(values) > 0:
            found[name] = (float(values.min()), float(values.max()))
    return found


def scalings(views: Residuals, ranges: Mapping[str, tuple[float, float]]) -> Array:
    """Return functions of the conditions, 0 for all but press frames: (functions, views).

    Constant; in proportion to the predicted light; and linear in each covariate that varies, from -1 to 1 over the
    range seen, logarithmic in time, constant beyond.
    """
    press = np.array([kind == "press" for kind in views.kinds], float)
    light = np.array([lv[ok].mean() if ok.any() else 0.0 for lv, ok in zip(views.level, views.valid, strict=True)])
    rows = [press]
    if press.any():
        rows.append(press * light / max(float(light[press > 0].mean()), 1e-9))
    for name, (low, high) in ranges.items():
        values = np.clip(np.nan_to_num(np.asarray(views.covariates[COVARIATES[name]], float), nan=low), low, high)
        part = (values - low) / (high - low)
        if name == "time":
            part = np.log1p(values - low) / np.log1p(high - low)
        rows.append(press * (2.0 * part - 1.0))
    return np.array(rows)


def flexible_basis(views: Residuals, ranges: Mapping[str, tuple[float, float]]) -> Array:
    """Return the flexible term's basis: (features, views, rows, cols), each 1 DN large at most."""
    basis_y, basis_x = cosine_features(views.valid.shape[1:])
    maps = np.einsum("iy,jx->ijyx", basis_y, basis_x).reshape(-1, *views.valid.shape[1:])
    maps = maps / np.abs(maps).max(axis=(1, 2), keepdims=True)
    functions = scalings(views, ranges)
    smooth = np.einsum("sv,fyx->sfvyx", functions, maps).reshape(-1, *views.valid.shape)
    bands = band_features(views.distance_mm)
    masks = np.stack([bands == k for k in range(1, len(BANDS_MM) - 1)])
    along = np.einsum("sv,bvyx->sbvyx", functions[:2], masks).reshape(-1, *views.valid.shape)
    return np.concatenate([smooth, along]).astype(np.float32)


def fit_flexible(residuals: Residuals, sigma: Array, project: Project) -> Flexible:
    """Fit the flexible term to what a model leaves.

    Parameters
    ----------
    residuals : Residuals
    sigma : ndarray (views, rows, cols)
        Standard deviation of a bin [DN].
    project : callable
        :data:`Project`: the term must not take what the nuisances may.
    """
    ranges = covariate_ranges(residuals)
    basis = flexible_basis(residuals, ranges) / np.where(residuals.valid, sigma, np.inf)
    basis = project(np.asarray(basis, np.float32)).reshape(len(basis), -1).astype(float)
    data = residuals.cube.ravel().astype(float)
    size = np.sqrt((basis**2).sum(axis=1))
    keep = size > 1e-3 * size.max(initial=1e-300)
    scaled = basis[keep] / size[keep, None]
    values, vectors = np.linalg.eigh(scaled @ scaled.T)
    values = np.maximum(values, 0.0)
    along = vectors.T @ (scaled @ data)

    def loss(log_prior: float) -> float:
        # Minus log evidence over none; prior variance exp(log_prior) for each scaled coefficient.
        gain = 1.0 + np.exp(log_prior) * values
        return float(0.5 * np.log(gain).sum() - 0.5 * (np.exp(log_prior) * along**2 / gain).sum())

    best = optimize.minimize_scalar(loss, bounds=(-6.0, 12.0), method="bounded")
    prior = float(np.exp(best.x))
    coefficients = np.zeros(len(basis))
    coefficients[keep] = (vectors @ (prior * along / (1.0 + prior * values))) / size[keep]
    fitted = coefficients @ basis
    before = excess_power(residuals.cube)
    removed = float((data**2).sum() - ((data - fitted) ** 2).sum())
    explained = float(np.clip(removed / before, 0.0, 1.0)) if before > 0 else 0.0
    return Flexible(coefficients, ranges, max(0.0, -float(best.fun)), explained)


def describe_unknown(residuals: Residuals, candidates: Mapping[str, Array], flexible: Flexible) -> dict[str, Any]:
    """Say in words and figures what remains: where, which symmetry, how it scales, what it is nearest to.

    Parameters
    ----------
    residuals : Residuals
    candidates : mapping of str to ndarray (k, views, rows, cols)
        Whitened, projected changes that each library effect makes; ``k`` directions each.
    flexible : Flexible

    Returns
    -------
    dict
        ``where``, ``symmetry``, ``scaling``, ``moving``, ``nearest`` (id), ``nearest_share``, ``explained``.
    """
    found = contrasts(residuals.kinds, residuals.covariates, residuals.valid)
    loudest, maps = _loudest(residuals, found)
    nearest, share = nearest_candidate(residuals.cube, candidates)
    return {
        "where": where_words(residuals, loudest),
        "contrast": loudest,
        "symmetry": symmetry(residuals, maps),
        "scaling": scaling_words(residuals),
        "moving": bool(moves(residuals)),
        "nearest": nearest,
        "nearest_share": share,
        "explained": flexible.explained,
    }


def _loudest(residuals: Residuals, found: Any) -> tuple[str, Array]:
    """Return the contrast whose smooth part is largest, and its map."""
    maps = found.maps(residuals.cube[None])[0]
    basis_y, basis_x = cosine_features(maps.shape[1:])
    power = ((basis_y @ maps @ basis_x.T) ** 2).sum(axis=(1, 2))
    k = int(np.argmax(power))
    return found.names[k], maps[k]


REGIONS = ("inside the contact", "at the edge of contact", "beside the contact", "far from the contact", "corners")
EDGE_MM, BESIDE_MM = 0.6, 3.0


def region_power(residuals: Residuals) -> dict[str, float]:
    """Return the mean square per bin, over that of noise, of each region of the press frames."""
    press = np.array([kind == "press" for kind in residuals.kinds])[:, None, None] & residuals.valid
    d = residuals.distance_mm
    corner = np.broadcast_to(residuals.radius > 0.8, d.shape)
    masks = (
        d < -EDGE_MM,
        np.abs(d) <= EDGE_MM,
        (d > EDGE_MM) & (d <= BESIDE_MM),
        (d > BESIDE_MM) & ~corner,
        corner & (d > BESIDE_MM),
    )
    found = {}
    for name, mask in zip(REGIONS, masks, strict=True):
        bins = residuals.cube[mask & press]
        if bins.size >= 20:
            found[name] = float((bins**2).mean())
    return found


def where_words(residuals: Residuals, loudest: str) -> str:
    """Name the region of the largest excess; other shots by their kind."""
    if loudest not in ("mean", *COVARIATES):
        return f"in the {loudest} shots"
    power = {name: value - 1.0 for name, value in region_power(residuals).items()}
    if not power:
        return "over the whole frame"
    name, most = max(power.items(), key=lambda item: item[1])
    others = [value for other, value in power.items() if other != name]
    # An excess of like density everywhere belongs to no region.
    return "over the whole frame" if others and min(others) > 0.5 * most else name


def symmetry(residuals: Residuals, m: Array) -> dict[str, Any]:
    """Return the symmetry that explains most of a map's smooth part, and its share.

    Families with as many free levels each: rings about the optical centre, bands about the contact, rows, columns,
    and a plane; ``none`` if none explains half.
    """
    basis_y, basis_x = cosine_features(m.shape)
    smooth = basis_y.T @ (basis_y @ m @ basis_x.T) @ basis_x
    smooth = smooth - smooth.mean()
    rows, cols = np.mgrid[0.0 : m.shape[0], 0.0 : m.shape[1]]
    distance = residuals.distance_mm[[kind == "press" for kind in residuals.kinds]]
    finite = np.isfinite(distance).all(axis=(1, 2))
    families: dict[str, Array] = {
        "rings about the optical centre": _levels(residuals.radius, smooth),
        "rows": _levels(rows, smooth),
        "columns": _levels(cols, smooth),
    }
    if finite.any():
        families["rings about the contact"] = _levels(distance[finite].mean(axis=0), smooth)
    plane = np.stack([np.ones(m.size), rows.ravel(), cols.ravel()], axis=1)
    families["a plane"] = (plane @ np.linalg.lstsq(plane, smooth.ravel(), rcond=None)[0]).reshape(m.shape)
    whole = max(float((smooth**2).sum()), 1e-300)
    shares = {name: 1.0 - float(((smooth - fit) ** 2).sum()) / whole for name, fit in families.items()}
    lines = line_features(m.shape)
    straight = float(np.abs(lines @ m.ravel()).max())
    name, share = max(shares.items(), key=lambda item: item[1])
    return {"name": name if share > 0.5 else "none", "share": share, "shares": shares, "strongest_line": straight}


def _levels(values: Array, image: Array, count: int = 8) -> Array:
    """Return an image with each bin's mean over its class by a value."""
    borders = np.quantile(values, np.linspace(0, 1, count + 1)[1:-1])
    number = np.searchsorted(borders, values)
    means = np.bincount(number.ravel(), image.ravel(), count) / np.maximum(np.bincount(number.ravel(), None, count), 1)
    return np.asarray(means[number])


def view_amplitudes(residuals: Residuals) -> tuple[Array, Array]:
    """Return the press frames' amplitudes of the first common pattern, and their standard error (1: whitened)."""
    press = np.array([kind == "press" for kind in residuals.kinds])
    basis_y, basis_x = cosine_features(residuals.valid.shape[1:])
    coefficients = (basis_y @ residuals.cube[press] @ basis_x.T).reshape(int(press.sum()), -1)
    left, size, _ = np.linalg.svd(coefficients, full_matrices=False)
    amplitude = left[:, 0] * size[0]
    return np.asarray(amplitude * np.sign(amplitude.sum() or 1.0)), np.ones(amplitude.size)


def scaling_words(residuals: Residuals) -> dict[str, Any]:
    """Return how the common pattern's amplitude goes with voltage, force and time: correlation with each, and words."""
    press = np.array([kind == "press" for kind in residuals.kinds])
    if press.sum() < 3:
        return {"words": "too few frames to tell", "correlation": {}}
    amplitude, _ = view_amplitudes(residuals)
    known = {}
    for name, key in COVARIATES.items():
        values = np.asarray(residuals.covariates.get(key, np.full(press.size, np.nan)), float)[press]
        if np.isfinite(values).all() and np.ptp(values) > 0:
            values = np.log1p(values - values.min()) if name == "time" else values
            known[name] = float(np.corrcoef(amplitude, values)[0, 1])
    scatter = float(amplitude.std() / max(abs(float(amplitude.mean())), 1e-9))
    if scatter < 0.25 or not known:
        return {"words": "constant over the frames", "correlation": known, "scatter": scatter}
    name, r = max(known.items(), key=lambda item: abs(item[1]))
    words = "not with voltage, force or time alone"
    if abs(r) > 0.6:
        words = f"{'grows' if r > 0 else 'falls'} with {name}"
    return {"words": words, "correlation": known, "scatter": scatter}


def moves(residuals: Residuals) -> bool:
    """Tell whether the pattern is another one from frame to frame: over a third of its power is not common to them."""
    press = np.array([kind == "press" for kind in residuals.kinds])
    basis_y, basis_x = cosine_features(residuals.valid.shape[1:])
    coefficients = (basis_y @ residuals.cube[press] @ basis_x.T).reshape(int(press.sum()), -1)
    size = np.linalg.svd(coefficients, compute_uv=False) ** 2
    # White noise alone has this much in its first pattern and in all (Marchenko and Pastur's edge, and the mean).
    n, f = coefficients.shape
    first, rest = size[0] - (np.sqrt(n) + np.sqrt(f)) ** 2, size[1:].sum() - (n - 1) * f
    return bool(rest > 0.5 * max(first, 0.0) and rest > 4.0 * np.sqrt(2.0 * n * f))


def nearest_candidate(cube: Array, candidates: Mapping[str, Array]) -> tuple[str | None, float]:
    """Return the library effect whose directions take the largest share of the residuals' structure, and that share.

    Parameters
    ----------
    cube : ndarray (views, rows, cols)
    candidates : mapping of str to ndarray (k, views, rows, cols)
    """
    data, noise = cube.ravel().astype(float), bin_noise(cube)
    best: tuple[str | None, float] = (None, 0.0)
    for name, directions in candidates.items():
        basis, _ = np.linalg.qr(directions.reshape(len(directions), -1).T.astype(float))
        taken = float(((basis.T @ data) ** 2).sum()) - noise * basis.shape[1]
        if taken > best[1]:
            best = (name, taken)
    nearest, taken = best
    if nearest is None:
        return best
    return nearest, taken / max(excess_power(cube), taken)


def bin_noise(cube: Array) -> float:
    """Return the variance of single whitened bins that changes from one to the next but one.

    Weights keep to what no camera is known better than, so that it may be far below 1; a pattern hardly adds to the
    median.
    """
    steps = [
        d[(a != 0) & (b != 0)]
        for a, b in ((cube[:, 2:], cube[:, :-2]), (cube[:, :, 2:], cube[:, :, :-2]))
        for d in [np.asarray(a - b, float)]
    ]
    every = np.concatenate(steps)
    # Median of chi-square of one degree of freedom; a difference has twice the variance.
    return float(np.median(every**2) / stats.chi2.ppf(0.5, 1) / 2.0) if every.size else 1.0


def excess_power(cube: Array) -> float:
    """Return the sum of squares of a whitened cube beyond its noise's."""
    data = np.asarray(cube, float)
    return float((data**2).sum()) - bin_noise(cube) * float(np.count_nonzero(data))
