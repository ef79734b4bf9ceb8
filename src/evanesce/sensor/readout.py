"""From charge to numbers: read noise, gain, black level, quantisation (EMVA Standard 1288, release 4.0, section 2)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def amplify(
    charge_e: Array,
    *,
    conversion_gain_e_per_DN: float,
    analogue_gain: float,
    read_noise_e: float,
    black_level_DN: float,
    rng: np.random.Generator | None,
) -> Array:
    """Return the signal before quantisation [DN]: (charge + read noise) g / K + black level.

    Parameters
    ----------
    charge_e : ndarray
        [e-].
    conversion_gain_e_per_DN : float
        K at analogue gain 1 [e-/DN].
    analogue_gain : float
        g [1].
    read_noise_e : float
        Standard deviation, referred to the input [e-].
    black_level_DN : float
        [DN]; not amplified: the sensor sets it after its amplifier.
    rng : numpy.random.Generator or None
        None leaves read noise out.
    """
    noisy = charge_e
    if rng is not None and read_noise_e > 0.0:
        noisy = charge_e + read_noise_e * rng.standard_normal(charge_e.shape)
    return noisy * (analogue_gain / conversion_gain_e_per_DN) + black_level_DN


def quantise(signal_DN: NDArray[np.floating[Any]], bits: int) -> NDArray[np.uint16]:
    """Round to whole DN (halves up) and clip to what ``bits`` hold.

    Parameters
    ----------
    signal_DN : ndarray
        [DN].
    bits : int

    Returns
    -------
    ndarray of uint16
        Shape of ``signal_DN``.
    """
    return np.clip(np.floor(signal_DN + 0.5), 0, 2**bits - 1).astype(np.uint16)
