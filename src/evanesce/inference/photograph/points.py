"""Specks, hot pixels and dust: points whose places cannot be known beforehand, by one scan of even print.

Each bin may hold a point, with a small probability of its own for each cause. What a point looks like is a distribution
of forms: a speck is a point seen through the lens, a hot pixel is one bin, dust is a dark disc. The evidence of a cause
is that of all bins together, its density averaged over a grid: noise alone gives it an expected Bayes factor of one,
however many bins are looked at, so that the scan is its own trials factor.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage, special, stats

from evanesce.inference.photograph.light import edge_kernel
from evanesce.inference.photograph.model import LOCAL_BINS
from evanesce.inference.single_effects import NONE, Place, Shapes

Array = NDArray[Any]
Mask = NDArray[np.bool_]

DENSITIES = np.geomspace(1e-5, 0.1, 13)
"""Points to a bin: from one in a frame to one in ten bins, beyond which they are no points."""
TAIL = 1e-3
"""Share of bins whose residual says how far noise goes: the lesser of both signs, since points have one."""
OFFSETS = (-1 / 3, 0.0, 1 / 3)
"""Places of a point in its bin [bins]."""
DUST_BINS = (2.0, 3.0, 4.0)
"""Diameters of a grain's shadow; a wider one is no smaller than what counts as the level about it."""


@dataclass(frozen=True)
class Scan:
    """Evidence of points in each bin of even print.

    Attributes
    ----------
    log_bayes : mapping of str to ndarray (bins,)
        Of a point there over none [nats]; -inf where another bin near it shows more of the same.
    amount : mapping of str to ndarray (bins,)
        Level that a point adds, summed over its bins [DN].
    where : ndarray of int (bins,)
        Flat places.
    widened : float
        By which noise was widened: what scatters as far downwards as upwards is texture of the print.
    """

    log_bayes: Mapping[str, Array]
    amount: Mapping[str, Array]
    where: NDArray[np.int_]
    widened: float


def point_forms(spread: float, disc: float) -> dict[str, tuple[float, Array]]:
    """Return sign and forms (n, k, k) of each cause's points.

    Parameters
    ----------
    spread, disc : float
        Of the even blur, see :func:`evanesce.inference.photograph.light.edge_kernel`.
    """
    places = [(dx, dy) for dx in OFFSETS for dy in OFFSETS]
    specks = [edge_kernel(spread * wider, disc, *at) for wider in (1.0, 1.5) for at in places]
    dust = [edge_kernel(size / 4.0, 1.0) for size in DUST_BINS]
    return {
        "hot_pixels": (1.0, np.ones((1, 1, 1))),
        "sensor_dust": (-1.0, _alike(dust)),
        "specks": (1.0, _alike(specks)),
    }


def _alike(kernels: Sequence[Array]) -> Array:
    """Return kernels padded to one size."""
    half = max(len(k) // 2 for k in kernels)
    return np.array([np.pad(k, half - len(k) // 2) for k in kernels])


def scan_of(left: Array, sd: Array, even: Mask, spread: float, disc: float) -> Scan:
    """Return the evidence of points.

    Parameters
    ----------
    left : ndarray (rows, cols)
        Residual less its neighbourhood's level [DN].
    sd : ndarray (rows, cols)
        [DN].
    even : ndarray of bool (rows, cols)
        Bins that are looked at.
    spread, disc : float
        Of the even blur.
    """
    z = np.where(even, left / sd, 0.0)
    ends = np.quantile(z[even], (TAIL, 1.0 - TAIL)) if even.any() else np.zeros(2)
    widened = max(1.0, float(np.abs(ends).min()) / float(stats.norm.isf(TAIL)))
    z = z / widened
    where = np.flatnonzero(even)
    found, amounts = {}, {}
    for name, (sign, forms) in point_forms(spread, disc).items():
        norms = np.sqrt((forms**2).sum(axis=(1, 2)))
        unit = forms / norms[:, None, None]
        flat = unit.reshape(len(unit), -1)
        shapes = Shapes.of(name, flat @ flat.T)
        along = np.array([ndimage.correlate(z, one, mode="constant") for one in unit])
        strongest = sign * along.max(axis=0) if sign > 0 else -along.min(axis=0)
        peak = (strongest >= ndimage.maximum_filter(strongest, LOCAL_BINS)) & (strongest > 0.0)
        bayes = np.full(where.size, -np.inf)
        some = peak.ravel()[where]
        # Half of a symmetric law of amplitudes has the right sign, and there twice the density.
        coordinates = shapes.coordinates(along.reshape(len(unit), -1)[:, where[some]].T)
        bayes[some] = shapes.log_bayes(coordinates) + np.log(2.0)
        found[name] = bayes
        best = np.abs(along).argmax(axis=0)
        scale = widened * sd * forms.sum(axis=(1, 2))[best] / norms[best]
        amounts[name] = (np.take_along_axis(along, best[None], 0)[0] * scale).ravel()[where]
    return Scan(found, amounts, where, widened)


@dataclass(frozen=True)
class Points:
    """Which causes of points there are.

    Attributes
    ----------
    places : mapping of str to Place
        Of each that is there; under an empty name, that of one more.
    density : mapping of str to tuple of float
        Points to a bin of each, and its 90 % interval.
    held : mapping of str to ndarray of bool (bins,)
        Bins of the scan that more probably hold a point than not.
    """

    places: Mapping[str, Place]
    density: Mapping[str, tuple[float, float, float]]
    held: Mapping[str, NDArray[np.bool_]]


def points_of(scan: Scan) -> Points:
    """Return the causes of points, each judged with those that are there already."""
    taken: dict[str, float] = {}
    places: dict[str, Place] = {}
    while True:
        gains = {
            name: np.array([_log_likelihood(scan, {**taken, name: d}) for d in DENSITIES])
            - _log_likelihood(scan, taken)
            for name in scan.log_bayes
            if name not in taken
        }
        place = Place.of({name: float(special.logsumexp(g) - np.log(len(g))) for name, g in gains.items()})
        if not gains or place.probability[NONE] > 0.5:
            places[""] = place
            break
        best = max(gains, key=lambda name: place.log_bayes[name])
        taken[best] = float(DENSITIES[int(np.argmax(gains[best]))])
        places[best] = place
    held = {name: scan.log_bayes[name] + np.log(d) > 0.0 for name, d in taken.items()}
    density = {}
    for name, which in held.items():
        count, bins = int(which.sum()), max(scan.where.size, 1)
        low, high = stats.gamma.ppf((0.05, 0.95), (max(count, 1e-9), count + 1))
        density[name] = (count / bins, float(low) / bins, float(high) / bins)
    return Points(places, density, held)


def _log_likelihood(scan: Scan, densities: Mapping[str, float]) -> float:
    """Return the log likelihood ratio of all bins with points of given densities over none."""
    none = np.log(max(1.0 - sum(densities.values()), 1e-9))
    total = np.full(scan.where.size, none)
    for name, density in densities.items():
        total = np.logaddexp(total, np.log(density) + scan.log_bayes[name])
    return float(total.sum())
