"""Averaging independently seeded passes of one view: a fixed number, or until their scatter is small enough."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.core.rng import integer_seed
from evanesce.core.states import PlateLight

Array = NDArray[np.float64]


class Welford:
    """Running mean and sum of squared deviations, one array each.

    References
    ----------
    B. P. Welford, "Note on a method for calculating corrected sums of squares and products", Technometrics 4 (1962)
    419.
    """

    def __init__(self, shape: tuple[int, ...]) -> None:
        self.count = 0
        self.mean: Array = np.zeros(shape)
        self._squares: Array = np.zeros(shape)

    def add(self, value: NDArray[Any]) -> None:
        """Take in one pass."""
        self.count += 1
        step = value - self.mean
        self.mean += step / self.count
        self._squares += step * (value - self.mean)

    @property
    def variance_of_mean(self) -> Array:
        """Variance of the mean; infinite after a single pass."""
        if self.count < 2:
            return np.full(self.mean.shape, np.inf)
        return np.asarray(self._squares / (self.count - 1) / self.count)


def noise_and_level(mean: NDArray[Any], variance: NDArray[Any]) -> tuple[float, float]:
    """Return the RMS standard error of an image's pixels and the RMS of the image without it.

    The square of a noisy mean is too large by its variance, which is taken off; what remains below 0 counts as 0.

    Parameters
    ----------
    mean, variance : ndarray
        Of each pixel, variance that of the mean.
    """
    noise2 = float(np.mean(variance))
    return float(np.sqrt(noise2)), float(np.sqrt(max(float(np.mean(np.square(mean, dtype=float))) - noise2, 0.0)))


def relative_error(light: PlateLight) -> float:
    """Return the standard error of a rendering, RMS over its pixels, over the RMS of its radiance.

    On pixels of one brightness this is the relative standard error of a pixel. 0 in darkness, infinite where nothing
    but noise is seen.

    Parameters
    ----------
    light : PlateLight
    """
    noise, level = noise_and_level(light.radiance, light.variance)
    if noise == 0.0:
        return 0.0
    return noise / level if level > 0 else float("inf")


@dataclass(frozen=True)
class Until:
    """When passes of a view are enough.

    Attributes
    ----------
    passes : int
        At least.
    error : float, optional
        Largest RMS standard error over ``level``, in every channel [1]; none: after ``passes``.
    limit : int
        Passes at most, where ``error`` is given.
    """

    passes: int
    error: float | None = None
    limit: int = 0

    def within(self, part: float) -> Until:
        """Return what leaves this part of the variance."""
        return self if self.error is None else replace(self, error=self.error * np.sqrt(max(part, 1e-3)))

    def used(self, sums: Welford, levels: Array) -> float:
        """Return the variance over what ``error`` allows, of the worst channel; 0 where there is no ``error``."""
        if self.error is None:
            return 0.0
        variance = sums.variance_of_mean.mean(axis=(0, 1))
        allowed = (self.error * levels) ** 2
        return float(np.divide(variance, allowed, out=np.where(variance > 0, np.inf, 0.0), where=allowed > 0).max())

    def expected(self, sums: Welford, levels: Array) -> int:
        """Return how many passes will be enough, judged by those that were made; the number made if they are.

        Parameters
        ----------
        sums : Welford
            Of (rows, cols, channels).
        levels : ndarray (channels,)
            What ``error`` is relative to, by channel; an infinite one sets no limit.
        """
        if self.error is None or sums.count < self.passes:
            return self.passes
        excess = self.used(sums, levels)
        if excess <= 1.0:
            return sums.count
        return int(min(max(np.ceil(sums.count * excess), sums.count + 1), max(self.limit, self.passes)))


def channel_levels(sums: Welford) -> Array:
    """Return the RMS radiance of each channel of (rows, cols, channels), noise taken off.

    Parameters
    ----------
    sums : Welford

    Returns
    -------
    ndarray (channels,)
    """
    variance = sums.variance_of_mean
    pairs = [noise_and_level(sums.mean[..., k], variance[..., k]) for k in range(sums.mean.shape[2])]
    return np.array([level for _, level in pairs])


def average(
    render_pass: Callable[[int], NDArray[Any]],
    shape: tuple[int, int, int],
    until: Until,
    levels: Array | None = None,
    tick: Callable[[int, int], None] = lambda done, total: None,
) -> Welford:
    """Average passes until there are enough.

    Parameters
    ----------
    render_pass : callable
        ``render_pass(k)`` returns pass number k, (rows, cols, channels).
    shape : tuple of int
        (rows, cols, channels).
    until : Until
    levels : ndarray (channels,), optional
        What the error is relative to; the image's own level if not given.
    tick : callable
        ``tick(done, expected)`` after each pass.
    """
    sums, total = Welford(shape), until.passes
    while sums.count < total:
        sums.add(render_pass(sums.count))
        if sums.count >= until.passes and until.error is not None:
            total = until.expected(sums, channel_levels(sums) if levels is None else levels)
        tick(sums.count, total)
    return sums


def pass_samples(total: int, passes: int) -> int:
    """Return samples per pixel of one pass, at least 1, so that all passes together have at least ``total``.

    Parameters
    ----------
    total : int
        Samples per pixel in all passes.
    passes : int
    """
    return max(1, -(-total // passes))


def trace(
    shapes: dict[str, Any],
    sensor: dict[str, Any],
    integrator: Any,
    *,
    samples: int,
    until: Until,
    seed: int,
    name: str,
    levels: Array | None = None,
    tick: Callable[[int, int], None] = lambda done, total: None,
) -> Welford:
    """Average independently seeded passes of a scene through one sensor.

    Parameters
    ----------
    shapes, sensor : dict
        As ``mitsuba.load_dict`` takes them.
    integrator : dict or mitsuba.Integrator
    samples : int
        Per pixel and pass.
    until : Until
    seed : int
    name : str
        Of the random stream.
    levels, tick
        As for :func:`average`.

    Returns
    -------
    Welford
        Of images (rows, cols, channels): all light, then that of each channel of the integrator.
    """
    import mitsuba as mi

    # Python plugins do not survive loading in parallel.
    loaded = mi.load_dict(shapes | {"sensor": sensor, "integrator": integrator}, parallel=False)
    if hasattr(integrator, "learn_emitters"):
        integrator.learn_emitters(loaded)
    film = sensor["film"]
    rows, cols = film.get("crop_height", film["height"]), film.get("crop_width", film["width"])
    channels = 1 + len(getattr(integrator, "groups", ()))

    def one(k: int) -> Array:
        image = mi.render(loaded, spp=samples, seed=integer_seed(seed, "render", name, k))
        return np.asarray(np.array(image), float)[:, :, :channels]

    return average(one, (rows, cols, channels), until, levels, tick)
