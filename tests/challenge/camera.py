"""The injector's own camera behind the lens: fine irradiance to frames, and the mean and variance of what they show."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
from scipy import ndimage
from scipy.constants import c, h
from scipy.special import ndtri

from evanesce.rig import Scene
from evanesce.sensor.tone import CURVES

from .rig import FINER

BIN = 4
QUANTILES = 129


@dataclass(frozen=True)
class Electronics:
    """What turns light into numbers, as the rig believes it.

    Attributes
    ----------
    e_per_irradiance : float
        [e- mm^2/W].
    DN_per_e : float
        Raw [DN/e-].
    read_e, well_e, black_DN : float
    top_DN : int
        Largest raw number.
    curve : str
    """

    e_per_irradiance: float
    DN_per_e: float
    read_e: float
    well_e: float
    black_DN: float
    top_DN: int
    curve: str

    @classmethod
    def of(cls, scene: Scene) -> Electronics:
        camera, pixel = scene.camera, scene.camera.pixel
        area_mm2 = (pixel.pitch_um * 1e-3) ** 2 * pixel.fill_factor
        photons = area_mm2 * camera.exposure_ms * 1e-3 * camera.wavelength_nm * 1e-9 / (h * c)
        return cls(
            e_per_irradiance=photons * pixel.quantum_efficiency,
            DN_per_e=camera.analogue_gain / pixel.conversion_gain_e_per_DN,
            read_e=pixel.read_noise_e,
            well_e=pixel.full_well_capacity_e,
            black_DN=pixel.black_level_DN,
            top_DN=2**pixel.bits - 1,
            curve=camera.tone_curve,
        )

    def raw_noise_DN(self, charge_e: np.ndarray) -> np.ndarray:
        """Return the standard deviation of raw numbers [DN]."""
        return self.DN_per_e * np.sqrt(np.maximum(charge_e, 0.0) + self.read_e**2)


def binned(image: np.ndarray, side: int = BIN) -> np.ndarray:
    """Return means of blocks of ``side`` by ``side`` pixels of the last two axes."""
    *lead, rows, cols = image.shape
    return image.reshape(*lead, rows // side, side, cols // side, side).mean(axis=(-3, -1))


def on_pixels(fine: np.ndarray) -> np.ndarray:
    """Return what the frame's pixels gather of the fine image."""
    return binned(np.asarray(fine, np.float64), FINER)


@functools.lru_cache(maxsize=4)
def true_curve(curve: str, black_DN: float, top_DN: int) -> np.ndarray:
    """Return the developed value, 0 to 1 and not rounded, of each raw number."""
    light = np.clip((np.arange(top_DN + 1) - black_DN) / (top_DN - black_DN), 0.0, 1.0)
    return np.asarray(CURVES[curve](light))


@dataclass(frozen=True)
class Developed:
    """Mean and variance of 8-bit values [DN] against the mean raw number.

    Attributes
    ----------
    nodes : ndarray (n,)
        Mean raw numbers [DN].
    mean, variance : ndarray (n,)
        [DN], [DN^2].
    """

    nodes: np.ndarray
    mean: np.ndarray
    variance: np.ndarray

    def level(self, raw: np.ndarray) -> np.ndarray:
        return np.interp(raw, self.nodes, self.mean)

    def spread(self, raw: np.ndarray) -> np.ndarray:
        return np.interp(raw, self.nodes, self.variance)

    def slope(self, raw: np.ndarray) -> np.ndarray:
        """Return d mean / d raw [1]."""
        return np.interp(raw, self.nodes, np.gradient(self.mean, self.nodes))


Knee = tuple[float, float]
"""Raw number above black at which pixels are full [DN], and how sharp the knee is."""


def filled(above_DN: np.ndarray, knee: Knee) -> np.ndarray:
    """Return raw numbers above black of pixels that fill up softly: x / (1 + (x/w)^p)^(1/p)."""
    well, sharp = knee
    x = np.maximum(above_DN, 0.0)
    return np.where(above_DN > 0, x / (1 + (x / well) ** sharp) ** (1 / sharp), above_DN)


def developed(electronics: Electronics, curve: np.ndarray, knee: Knee | None = None) -> Developed:
    """Return what noise, an early full well, rounding and a curve make of mean raw numbers."""
    black, top = electronics.black_DN, electronics.top_DN
    below = black - 6 * electronics.raw_noise_DN(np.zeros(1))[0] - 60
    nodes = np.concatenate(
        [np.arange(below, black, 4.0), black + (np.linspace(0, 1, 500) ** 1.6) * (1.15 * top - black)]
    )
    charge = np.maximum(nodes - black, 0.0) / electronics.DN_per_e
    z = ndtri((np.arange(QUANTILES) + 0.5) / QUANTILES)
    z /= z.std()
    raw = nodes[:, None] + electronics.raw_noise_DN(charge)[:, None] * z
    if knee is not None:
        raw = black + filled(raw - black, knee)
    value = np.floor(255.0 * curve + 0.5)[np.clip(np.floor(raw + 0.5), 0, top).astype(int)]
    return Developed(nodes, value.mean(axis=1), value.var(axis=1))


def noisy_frame(
    electronics: Electronics,
    charge_e: np.ndarray,
    offset_DN: np.ndarray | float,
    curve: np.ndarray,
    rng: np.random.Generator,
    *,
    correlated: float = 0.0,
    knee: Knee | None = None,
) -> np.ndarray:
    """Draw a frame, uint8.

    Parameters
    ----------
    electronics : Electronics
    charge_e : ndarray (300, 400)
        Mean charge [e-].
    offset_DN : float or ndarray
        On the raw numbers [DN].
    curve : ndarray
        Developed value of each raw number, 0 to 1.
    rng : numpy.random.Generator
    correlated : float
        Standard deviation of the sensor's own low-pass on its noise [px].
    knee : Knee, optional
        Of pixels that are full early.
    """
    charge = rng.poisson(np.maximum(charge_e, 0.0)).astype(np.float64)
    noise = electronics.DN_per_e * (charge - charge_e + electronics.read_e * rng.standard_normal(charge.shape))
    if correlated:
        noise = ndimage.gaussian_filter(noise, correlated, mode="wrap")
    above = np.minimum(electronics.DN_per_e * charge_e, electronics.DN_per_e * electronics.well_e) + noise
    if knee is not None:
        above = filled(above, knee)
    raw = electronics.black_DN + above + offset_DN
    index = np.clip(np.floor(raw + 0.5), 0, electronics.top_DN).astype(int)
    return np.floor(255.0 * curve + 0.5)[index].astype(np.uint8)
