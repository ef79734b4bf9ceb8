"""Variance over the pixels of one frame of uniform light, as the sensor model predicts it."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

ROUNDING_DN2 = 1.0 / 12.0


def frame_variance(
    light_e: ArrayLike, *, exposure_s: ArrayLike, conversion_gain_e_per_DN: ArrayLike, analogue_gain: ArrayLike,
    read_noise_e: Any, prnu: Any, dsnu_e: Any, dark_current_e_per_s: Any, dark_nonuniformity_e_per_s: Any,
) -> Array:  # fmt: skip
    """Return the variance over the pixels of a frame below saturation [DN^2].

    (g/K)^2 (N + D t + sigma_r^2 + (PRNU N)^2 + DSNU^2 + (sigma_D t)^2) + 1/12: shot noise of light and dark current,
    read noise, the fixed patterns of sensitivity, offset and dark current, rounding.

    Parameters
    ----------
    light_e : array_like (n,)
        Mean charge by light, N [e-].
    exposure_s : array_like
        t [s].
    conversion_gain_e_per_DN : array_like
        K at analogue gain 1 [e-/DN].
    analogue_gain : array_like
        g [1].
    read_noise_e, prnu, dsnu_e, dark_current_e_per_s, dark_nonuniformity_e_per_s : array_like
        As in ``[camera.pixel]``, at the sensor's temperature.

    Returns
    -------
    ndarray (n,)

    References
    ----------
    EMVA Standard 1288, release 4.0 Linear (2021), sections 2.3 and 8.1.
    """
    light, t = np.asarray(light_e, float), np.asarray(exposure_s, float)
    charge = light + np.asarray(dark_current_e_per_s) * t + np.square(read_noise_e)
    pattern = np.square(prnu * light) + np.square(dsnu_e) + np.square(np.asarray(dark_nonuniformity_e_per_s) * t)
    scale = np.asarray(analogue_gain, float) / np.asarray(conversion_gain_e_per_DN, float)
    return np.asarray(scale**2 * (charge + pattern) + ROUNDING_DN2)
