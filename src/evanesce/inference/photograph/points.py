"""Specks, hot pixels and dust: points whose places cannot be known beforehand, by one scan of even print.

Each bin may hold a point, with a small probability of its own for each cause. What a point looks like is a distribution
of forms: a speck is a point seen through the lens, a hot pixel is one bin, dust is a dark disc. The evidence of a cause
is that of all bins together, its density averaged over a grid: noise alone gives it an expected Bayes factor of one,
however many bins are looked at, so that the scan is its own trials factor.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
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
    shape : tuple of int
        (rows, cols).
    """

    log_bayes: Mapping[str, Array]
    amount: Mapping[str, Array]
    where: NDArray[np.int_]
    widened: float
    shape: tuple[int, ...]

    def apart_from(self, held: NDArray[np.bool_]) -> Scan:
        """Return the scan without the neighbourhoods of bins (bins,) that hold a point: it has one cause."""
        taken = np.zeros(self.shape, bool)
        taken.ravel()[self.where[held]] = True
        beside = ndimage.maximum_filter(taken, LOCAL_BINS).ravel()[self.where]
        return replace(self, log_bayes={n: np.where(beside, -np.inf, b) for n, b in self.log_bayes.items()})


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
    # How far noise goes is said by the sign whose largest residual is the lesser: points of one kind have one sign.
    farthest = min(float(z.max()), float(-z.min()))
    widened = max(1.0, farthest / float(stats.norm.isf(1.0 / max(int(even.sum()), 2))))
    z = z / widened
    where = np.flatnonzero(even)
    found, amounts = {}, {}
    for name, (sign, forms) in point_forms(spread, disc).items():
        norms = np.sqrt((forms**2).sum(axis=(1, 2)))
        unit = forms / norms[:, None, None]
        flat = unit.reshape(len(unit), -1)
        shapes = Shapes.of(name, flat @ flat.T)
        along = np.array([ndimage.correlate(z, one, mode="constant") for one in unit])
        best = np.abs(along).argmax(axis=0)
        strongest = sign * np.take_along_axis(along, best[None], 0)[0]
        peak = (strongest >= ndimage.maximum_filter(strongest, LOCAL_BINS)) & (strongest > 0.0)
        bayes = np.full(where.size, -np.inf)
        some = peak.ravel()[where]
        # Half of a symmetric law of amplitudes has the right sign, and there twice the density.
        coordinates = shapes.coordinates(along.reshape(len(unit), -1)[:, where[some]].T)
        bayes[some] = shapes.log_bayes(coordinates) + np.log(2.0)
        found[name] = bayes
        scale = widened * sd * forms.sum(axis=(1, 2))[best] / norms[best]
        amounts[name] = (sign * strongest * scale).ravel()[where]
    return Scan(found, amounts, where, widened, z.shape)


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
    """Return the causes of points, each judged on what those that are there already leave."""
    places: dict[str, Place] = {}
    held: dict[str, NDArray[np.bool_]] = {}
    while True:
        gains = {
            name: np.array([_log_likelihood(bayes, density) for density in DENSITIES])
            for name, bayes in scan.log_bayes.items()
            if name not in held
        }
        place = Place.of({name: float(special.logsumexp(g) - np.log(len(g))) for name, g in gains.items()})
        if not gains or place.probability[NONE] > 0.5:
            places[""] = place
            break
        best = max(gains, key=lambda name: place.log_bayes[name])
        places[best] = place
        held[best] = scan.log_bayes[best] + np.log(DENSITIES[int(np.argmax(gains[best]))]) > 0.0
        scan = scan.apart_from(held[best])
    density = {}
    for name, which in held.items():
        count, bins = int(which.sum()), max(scan.where.size, 1)
        low, high = stats.gamma.ppf((0.05, 0.95), (max(count, 1e-9), count + 1))
        density[name] = (count / bins, float(low) / bins, float(high) / bins)
    return Points(places, density, held)


def _log_likelihood(log_bayes: Array, density: float) -> float:
    """Return the log likelihood ratio over none of all bins (bins,) with points of a given density."""
    return float(np.logaddexp(np.log1p(-density), np.log(density) + log_bayes).sum())
