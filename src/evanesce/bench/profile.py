"""Ridges from a surface scan: height, width, pitch and rounding with their spread."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.polynomial.legendre import legvander
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage

from evanesce.core.errors import WorkError

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Spread:
    """Mean, standard deviation and count of a measure.

    Attributes
    ----------
    mean, std : float
    count : int
    """

    mean: float
    std: float
    count: int

    @property
    def standard_error(self) -> float:
        """Of the mean."""
        return self.std / float(np.sqrt(self.count)) if self.count else float("nan")


@dataclass(frozen=True)
class RidgeResult:
    """Ridges of a scan; lengths in mm.

    Attributes
    ----------
    height : Spread
        Central third of the crest above the central third of the furrows beside it, as ISO 5436-1 takes a step; 0.955
        of the full height for a sinusoid.
    width : Spread
        At half height.
    pitch : Spread
        Distance of neighbouring ridge middles.
    edge : Spread
        Horizontal run of a flank from 10 to 90 % of the height: the rounding. A vertical wall has 0, a sinusoid 0.295
        of its pitch.
    crest_radius : Spread
        Radius of curvature of the crest's upper tenth.
    orientation : float
        Direction along the ridges, from x towards y [rad]; NaN for a single profile.
    lines : int
        Profiles evaluated.
    """

    height: Spread
    width: Spread
    pitch: Spread
    edge: Spread
    crest_radius: Spread
    orientation: float
    lines: int


def _form(z: Floats, design: Floats) -> Floats:
    """Return the coefficients (terms,) of the form of z (n,), fitted together with a step between ridges and furrows.

    Without the step the form would lean towards whatever side of the scan holds the larger share of a ridge.
    """
    known = np.isfinite(z)
    if known.sum() < max(0.5 * len(z), 8):
        raise WorkError(f"only {known.mean():.0%} of the scan holds data; at least half is needed")
    form = np.linalg.lstsq(design[known], z[known], rcond=None)[0]
    for _ in range(5):
        rest = z[known] - design[known] @ form
        raised = (rest > np.percentile(rest, [10, 90]).mean()).astype(float)
        form = np.linalg.lstsq(np.column_stack([design[known], raised - raised.mean()]), z[known], rcond=None)[0][:-1]
    return np.asarray(form, dtype=float)


def level(height: ArrayLike, degree: int = 1) -> Floats:
    """Return a map (rows, cols) with its form removed; NaN allowed and kept.

    Parameters
    ----------
    height : array_like (rows, cols)
    degree : int
        Of the polynomial in x and y: 1 levels, 2 flattens a round finger.

    Returns
    -------
    ndarray (rows, cols)
        [mm].
    """
    z = np.asarray(height, dtype=float)
    y, x = (np.linspace(-1.0, 1.0, n) for n in z.shape)
    powers = [(i, j) for i in range(degree + 1) for j in range(degree + 1 - i)]
    # A part of the samples fixes a handful of coefficients; all of a large scan would only cost time and memory.
    step = max(1, int(np.ceil(np.sqrt(z.size / 2e5))))
    design = np.column_stack([np.multiply.outer(y[::step] ** j, x[::step] ** i).ravel() for i, j in powers])
    form = _form(z[::step, ::step].ravel(), design)
    flat = z.copy()
    for (i, j), share in zip(powers, form, strict=True):
        flat -= np.multiply.outer(share * y**j, x**i)
    return flat


def remove_form(height: ArrayLike, degree: int = 2) -> Floats:
    """Return a profile with a polynomial form removed: a scan across a round finger is curved.

    Parameters
    ----------
    height : array_like (n,)
    degree : int
        Of the polynomial.

    Returns
    -------
    ndarray (n,)
        In the unit of ``height``.
    """
    z = np.asarray(height, dtype=float)
    design = np.asarray(legvander(np.linspace(-1.0, 1.0, len(z)), degree), dtype=float)
    return z - design @ _form(z, design)


def fill_gaps(height: ArrayLike) -> Floats:
    """Return a scan with its lost samples (NaN) taken from the nearest known one.

    Parameters
    ----------
    height : array_like
        A profile or a map, NaN where lost.

    Returns
    -------
    ndarray
        In the shape of ``height``.
    """
    z = np.asarray(height, dtype=float)
    lost = ~np.isfinite(z)
    if not lost.any():
        return z
    if lost.all():
        raise WorkError("the scan holds no data")
    nearest = ndimage.distance_transform_edt(lost, return_distances=False, return_indices=True)
    return z[tuple(nearest)]


@dataclass(frozen=True)
class _Ridge:
    middle: float
    height: float
    width: float
    edges: tuple[float, ...]
    crest_radius: float


def _central_third(z: Floats, start: int, stop: int) -> float:
    """Return the mean height of the central third of a plateau: unbiased by noise and by rounded flanks."""
    third = (stop - start) // 3
    return float(z[start + third : stop - third].mean())


def _crossing(x: Floats, z: Floats, target: float, falling: bool) -> float:
    """Return where z first passes a target along x, between samples."""
    past = z <= target if falling else z >= target
    hits = np.flatnonzero(past)
    if len(hits) == 0 or hits[0] == 0:
        return float("nan")
    i = int(hits[0])
    return float(x[i - 1] + (target - z[i - 1]) / (z[i] - z[i - 1]) * (x[i] - x[i - 1]))


def _ridge(x: Floats, z: Floats, left: int, right: int, before: int, after: int) -> _Ridge | None:
    """Measure the ridge between sample indices left and right, with furrows from ``before`` and up to ``after``."""
    if right - left < 3 or min(left - before, after - right) < 3:
        return None
    # Furrows cut by an end of the scan count only where there is no whole one.
    furrows = [(before, left, before > 0), (right, after, after < len(z))]
    whole = [f for f in furrows if f[2]] or furrows
    floor = float(np.mean([_central_third(z, start, stop) for start, stop, _ in whole]))
    crest = _central_third(z, left, right)
    height = crest - floor
    if height <= 0:
        return None
    peak = left + int(np.argmax(z[left:right]))
    sides = []
    for s, part in ((-1.0, slice(peak, before, -1)), (1.0, slice(peak, after))):
        run, fall = s * (x[part] - x[peak]), z[part]
        sides.append([_crossing(run, fall, floor + share * height, True) for share in (0.9, 0.5, 0.1)])
    (l90, l50, l10), (r90, r50, r10) = sides
    if not (np.isfinite(l50) and np.isfinite(r50)):
        return None
    edges = tuple(e for e in (l10 - l90, r10 - r90) if np.isfinite(e))
    top = slice(left, right)
    upper = z[top] > crest - 0.1 * height
    radius = float("nan")
    if upper.sum() >= 5:
        curvature = -2.0 * np.polyfit(x[top][upper] - x[peak], z[top][upper], 2)[0]
        radius = 1.0 / curvature if curvature > 0 else float("inf")
    return _Ridge(x[peak] + 0.5 * (r50 - l50), height, l50 + r50, edges, float(radius))


def ridges_of_profile(x: ArrayLike, z: ArrayLike) -> list[_Ridge]:
    """Find and measure the whole ridges of one levelled profile.

    Ridges are where the profile, lightly smoothed, stands above the middle between its upper and lower tenth;
    hysteresis of a fifth of the height keeps noise from splitting them. Ridges cut by the ends are left out.

    Parameters
    ----------
    x : array_like (n,)
        [mm], ascending.
    z : array_like (n,)
        Levelled [mm].

    Returns
    -------
    list
        One entry a ridge.
    """
    x, z = np.asarray(x, dtype=float), np.asarray(z, dtype=float)
    low, high = np.percentile(z, [10, 90])
    smooth = ndimage.gaussian_filter1d(z, max(1.0, len(z) / 2000.0))
    middle, margin = 0.5 * (low + high), 0.2 * (high - low)
    # State of the last certain sample (well above or well below): hysteresis without a loop.
    certain = np.where(smooth > middle + margin, 1, np.where(smooth < middle - margin, -1, 0))
    last = np.maximum.accumulate(np.where(certain != 0, np.arange(len(z)), 0))
    up = certain[last] > 0
    turns: list[int] = np.flatnonzero(np.diff(up.astype(int))).tolist()
    # A turn is noticed a margin late; it lies where the profile last crossed the middle.
    index = np.arange(len(z))
    low_before = np.maximum.accumulate(np.where(smooth < middle, index, 0)).tolist()
    high_before = np.maximum.accumulate(np.where(smooth >= middle, index, 0)).tolist()
    starts = [low_before[t + 1] + 1 for t in turns if not up[t]]
    ends = [high_before[t + 1] + 1 for t in turns if up[t]]
    found = []
    for i, start in enumerate(starts):
        end = next((e for e in ends if e > start), None)
        if end is None:
            break
        before = max((e for e in ends if e <= start), default=0)
        after = starts[i + 1] if i + 1 < len(starts) else len(z)
        ridge = _ridge(x, z, start, end, before, after)
        if ridge is not None:
            found.append(ridge)
    return found


def _spread(values: list[float]) -> Spread:
    finite = np.array([v for v in values if np.isfinite(v)])
    if len(finite) == 0:
        return Spread(float("nan"), float("nan"), 0)
    return Spread(float(finite.mean()), float(finite.std(ddof=1)) if len(finite) > 1 else 0.0, len(finite))


def _collect(profiles: list[tuple[Floats, Floats]], orientation: float) -> RidgeResult:
    per_line = [ridges_of_profile(x, z) for x, z in profiles]
    every = [ridge for line in per_line for ridge in line]
    if not every:
        raise WorkError("no whole ridge found: the scan must hold at least one ridge with a furrow on either side")
    middles = [sorted(ridge.middle for ridge in line) for line in per_line]
    return RidgeResult(
        height=_spread([r.height for r in every]),
        width=_spread([r.width for r in every]),
        pitch=_spread([float(d) for line in middles for d in np.diff(line)]),
        edge=_spread([e for r in every for e in r.edges]),
        crest_radius=_spread([r.crest_radius for r in every]),
        orientation=orientation,
        lines=len(profiles),
    )


def analyse_profile(x: ArrayLike, z: ArrayLike, form_degree: int = 1) -> RidgeResult:
    """Measure the ridges of one profile.

    Parameters
    ----------
    x, z : array_like (n,)
        Position and height [mm].
    form_degree : int
        Polynomial taken off first: 1 levels, 2 flattens a round finger.

    Returns
    -------
    RidgeResult

    Raises
    ------
    WorkError
        If no whole ridge is found.
    """
    flat = remove_form(fill_gaps(np.asarray(z, dtype=float)), form_degree)
    return _collect([(np.asarray(x, dtype=float), flat)], float("nan"))


def ridge_orientation(height: ArrayLike) -> float:
    """Return the direction along the ridges of a levelled map [rad], in (-pi/2, pi/2], from its structure tensor.

    Parameters
    ----------
    height : array_like (rows, cols)

    Returns
    -------
    float
        [rad].

    References
    ----------
    J. Bigun and G. H. Granlund, Proc. 1st ICCV (1987) 433.
    """
    z = ndimage.gaussian_filter(np.asarray(height, dtype=float), 2.0)
    gy, gx = np.gradient(z)
    across = 0.5 * np.arctan2(2.0 * np.sum(gx * gy), np.sum(gx**2 - gy**2))
    along = across + np.pi / 2
    return float(along - np.pi if along > np.pi / 2 else along)


def analyse_map(height: ArrayLike, pitch: float, lines: int = 64, form_degree: int = 1) -> RidgeResult:
    """Measure the ridges of a map along lines across them.

    Parameters
    ----------
    height : array_like (rows, cols)
        [mm]; NaN where the scanner saw nothing.
    pitch : float
        Sample distance [mm].
    lines : int
        Evenly spaced profiles.
    form_degree : int
        As :func:`level`.

    Returns
    -------
    RidgeResult

    Raises
    ------
    WorkError
        If no whole ridge is found, or most of the map is lost.
    """
    z = level(height, form_degree)
    filled = fill_gaps(z)
    along = ridge_orientation(filled)
    # Image axes: x along columns, y along rows, both in samples.
    step = np.array([-np.sin(along), np.cos(along)])
    centre = np.array([(z.shape[1] - 1) / 2, (z.shape[0] - 1) / 2])
    reach = 0.5 * float(np.hypot(*z.shape))
    s = np.arange(-reach, reach, 1.0)
    profiles = []
    for offset in np.linspace(-0.9, 0.9, lines) * 0.5 * min(z.shape):
        x = centre[0] + s * step[0] + offset * np.cos(along)
        y = centre[1] + s * step[1] + offset * np.sin(along)
        inside = (x >= 0) & (x <= z.shape[1] - 1) & (y >= 0) & (y <= z.shape[0] - 1)
        if inside.sum() < 32:
            continue
        values = ndimage.map_coordinates(filled, [y[inside], x[inside]], order=1)
        profiles.append((s[inside] * pitch, values))
    if not profiles:
        raise WorkError("the map is too small: fewer than 32 samples across the ridges")
    return _collect(profiles, along)


def against_design(result: RidgeResult, design: Mapping[str, float]) -> dict[str, dict[str, float]]:
    """Return measured, designed [mm] and relative deviation for each of ``height``, ``width``, ``pitch`` designed.

    Parameters
    ----------
    result : RidgeResult
    design : mapping of str to float
        ``height``, ``width``, ``pitch`` [mm].

    Returns
    -------
    dict of str to dict
    """
    table = {}
    for name, wanted in design.items():
        measured: Spread = getattr(result, name)
        table[name] = {
            "measured_mm": measured.mean,
            "std_mm": measured.std,
            "design_mm": wanted,
            "relative_deviation": measured.mean / wanted - 1.0,
        }
    return table
