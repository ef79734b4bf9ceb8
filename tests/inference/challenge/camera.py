"""The injector's own camera behind the lens: fine irradiance to frames, and the mean and variance of what they show."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
from scipy import ndimage
from scipy.constants import c, h
from scipy.special import ndtr
from scipy.stats import poisson

from evanesce.rig import Scene
from evanesce.sensor.tone import CURVES

from .rig import FINER

BIN = 4
CORRELATED = {"lowpass": 0.6}
"""Standard deviation of the sensor's own low-pass on its noise [px], by noise class."""
FEW_E = 50.0


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


Knee = tuple[float, float, int]
"""Raw number above black at which pixels are full [DN], how soft the knee is [1 of that], and the form."""


def filled(above_DN: np.ndarray, knee: Knee) -> np.ndarray:
    """Return raw numbers above black of pixels that fill up softly.

    Form 0 sums exponentials, w - s ln(1 + exp((w - x)/s)) with its value at nothing taken off; form 1 takes in less and
    less from (1 - h) w on, linearly, and nothing beyond (1 + h) w.
    """
    well, soft, form = knee
    x = np.maximum(above_DN, 0.0)
    if form == 0:
        scale = soft * well
        kept = well - scale * np.logaddexp(0.0, (well - x) / scale)
        kept = kept - (well - scale * np.logaddexp(0.0, well / scale))
    else:
        along = np.clip((x / well - (1 - soft)) / (2 * soft), 0.0, 1.0)
        # The integral of 1 - along.
        kept = well * (np.minimum(x / well, 1 - soft) + 2 * soft * (along - 0.5 * along**2))
    return np.where(above_DN > 0, kept, above_DN)


@functools.lru_cache(maxsize=4)
def raw_distributions(electronics: Electronics) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return the distribution of raw numbers above black against the mean charge.

    Returns
    -------
    nodes : ndarray (n,)
        Mean charges [e-].
    low, high, share : ndarray (m,)
        Cells of raw numbers [DN] and what falls into each, of all nodes in a row.
    first : ndarray (n,)
        Where each node's cells begin.
    """
    e = electronics
    nodes = 1.15 * (e.top_DN - e.black_DN) / e.DN_per_e * np.linspace(0, 1, 420) ** 2
    z = np.linspace(-5.5, 5.5, 91)
    lows, highs, shares, first = [], [], [], []
    for charge in nodes:
        if charge < FEW_E:  # Poisson's distribution, each count with read noise
            count = np.arange(int(charge + 8 * np.sqrt(charge) + 12))
            sigma = e.DN_per_e * e.read_e
            edges = np.arange(-6 * sigma, e.DN_per_e * count[-1] + 6 * sigma, 0.2 * sigma)
            share = np.diff(ndtr((edges - e.DN_per_e * count[:, None]) / sigma), axis=1)
            share = poisson.pmf(count, charge) @ share
        else:
            edges = e.DN_per_e * (charge + np.sqrt(charge + e.read_e**2) * z)
            share = np.diff(ndtr(z))
        first.append(sum(map(len, lows)))
        lows.append(edges[:-1])
        highs.append(edges[1:])
        shares.append(share / share.sum())
    return nodes, np.concatenate(lows), np.concatenate(highs), np.concatenate(shares), np.array(first)


class Developed:
    """What noise, rounding and a curve make of a mean charge and an offset: mean and variance of 8-bit values.

    Parameters
    ----------
    electronics : Electronics
    curve : ndarray
        Developed value of each raw number, 0 to 1.
    knee : Knee, optional
        Of pixels that are full early.
    """

    def __init__(self, electronics: Electronics, curve: np.ndarray, knee: Knee | None = None) -> None:
        self.nodes, low, high, self._share, self._first = raw_distributions(electronics)
        if knee is not None:
            low, high = filled(low, knee), filled(high, knee)
        black, beyond = electronics.black_DN, 3000.0
        self._low, self._high = black + low, black + np.maximum(high, low + 1e-6)
        # Integrals of the developed value and its square over raw numbers: straight between half-integers.
        value = np.floor(255.0 * curve + 0.5)
        self._edges = np.concatenate([[-beyond], np.arange(curve.size - 1) + 0.5, [curve.size + beyond]])
        widths = np.diff(self._edges)
        self._integrals = [np.concatenate([[0.0], np.cumsum(widths * value**n)]) for n in (1, 2)]
        self._tables: dict[float, tuple[np.ndarray, np.ndarray]] = {}

    def _table(self, offset_DN: float) -> tuple[np.ndarray, np.ndarray]:
        """Return mean and variance at the nodes for one offset."""
        key = round(offset_DN, 6)
        if key not in self._tables:
            found = []
            for integral in self._integrals:
                low = np.interp(self._low + offset_DN, self._edges, integral)
                high = np.interp(self._high + offset_DN, self._edges, integral)
                found.append(np.add.reduceat(self._share * (high - low) / (self._high - self._low), self._first))
            self._tables[key] = (found[0], np.maximum(found[1] - found[0] ** 2, 0.0))
        return self._tables[key]

    def level(self, charge_e: np.ndarray, offset_DN: np.ndarray | float = 0.0) -> np.ndarray:
        """Return the mean [DN]; an offset that differs from pixel to pixel by a parabola through three."""
        low, high = float(np.min(offset_DN)), float(np.max(offset_DN))
        if high - low < 1e-9:
            return np.interp(charge_e, self.nodes, self._table(low)[0])
        middle = 0.5 * (low + high)
        t = (np.asarray(offset_DN) - middle) / (0.5 * (high - low))
        at = [np.interp(charge_e, self.nodes, self._table(o)[0]) for o in (low, middle, high)]
        return at[1] + 0.5 * t * (at[2] - at[0]) + 0.5 * t * t * (at[2] - 2 * at[1] + at[0])

    def spread(self, charge_e: np.ndarray) -> np.ndarray:
        """Return the variance [DN^2] without an offset."""
        return np.interp(charge_e, self.nodes, self._table(0.0)[1])

    def by_charge(self, charge_e: np.ndarray) -> np.ndarray:
        """Return d mean / d charge [DN/e-]."""
        return np.interp(charge_e, self.nodes, np.gradient(self._table(0.0)[0], self.nodes))

    def by_offset(self, charge_e: np.ndarray) -> np.ndarray:
        """Return d mean / d offset [1]."""
        return 0.5 * (self.level(charge_e, 1.0) - self.level(charge_e, -1.0))


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
    charge_e : ndarray (rows, cols)
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
