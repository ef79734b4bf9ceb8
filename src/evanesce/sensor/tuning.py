"""White points and colour matrices of the IMX477 in the tuning that libcamera publishes.

"rpi.awb" ct_curve and "rpi.ccm" of src/ipa/rpi/vc4/data/imx477.json (github.com/raspberrypi/libcamera, commit
26bfadc66e8d7f727a993fe58174217b8a96f7f9), straight between their points.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

# Colour temperature [K], red and blue raw values of a white card over its green one.
_WHITE_IMX477 = np.array(
    [
        (2360, 0.6009, 0.3093),
        (2848, 0.5071, 0.4),
        (2903, 0.4905, 0.4392),
        (3628, 0.4261, 0.5564),
        (3643, 0.4228, 0.5623),
        (4660, 0.3529, 0.68),
        (5579, 0.3227, 0.7),
        (6125, 0.3129, 0.71),
        (6671, 0.3065, 0.72),
        (7217, 0.3014, 0.73),
        (7763, 0.295, 0.74),
        (9505, 0.2524, 0.7856),
    ]
)
# Colour temperature [K], and the matrix from balanced camera colour to linear sRGB, row by row.
_MATRICES_IMX477 = np.array(
    [
        (2850, 1.97469, -0.71439, -0.26031, -0.43521, 2.09769, -0.66248, -0.04826, -0.84642, 1.89468),
        (2960, 2.12952, -0.91185, -0.21768, -0.38018, 1.90789, -0.52771, 0.03988, -1.10079, 2.06092),
        (3580, 2.03422, -0.80048, -0.23374, -0.39089, 1.97221, -0.58132, -0.08969, -0.61439, 1.70408),
        (4559, 2.15423, -0.98143, -0.17279, -0.38131, 2.14763, -0.76632, -0.10069, -0.54383, 1.64452),
        (5881, 2.18464, -0.95493, -0.22971, -0.36826, 2.00298, -0.63471, -0.15219, -0.38055, 1.53274),
        (7600, 2.30687, -0.97295, -0.33392, -0.30872, 2.32779, -1.01908, -0.17761, -0.55891, 1.73651),
    ]
)


def white_imx477(temperature_K: ArrayLike) -> Array:
    """Return the raw red and blue values of a white card over its green one, by the published tuning.

    Parameters
    ----------
    temperature_K : array_like
        Colour temperature of the light, 2360 to 9505 [K].

    Returns
    -------
    ndarray (2, ...)
        Red, blue [1].

    Raises
    ------
    ValueError
        If a temperature lies outside.
    """
    temperature = np.asarray(temperature_K, np.float64)
    low, high = _WHITE_IMX477[0, 0], _WHITE_IMX477[-1, 0]
    if not np.all((low <= temperature) & (temperature <= high)):
        raise ValueError(f"colour temperature {temperature!s} K; must be from {low:g} to {high:g} K")
    return np.array([np.interp(temperature, _WHITE_IMX477[:, 0], _WHITE_IMX477[:, k]) for k in (1, 2)])


def matrix_imx477(temperature_K: float) -> tuple[tuple[float, float, float], ...]:
    """Return the matrix from balanced camera colour to linear sRGB at a colour temperature [K].

    Parameters
    ----------
    temperature_K : float
        Outside the calibrated temperatures the nearest matrix holds, as in libcamera.

    Returns
    -------
    tuple of 3 x 3 float
        Row by row [1].
    """
    terms = [np.interp(temperature_K, _MATRICES_IMX477[:, 0], column) for column in _MATRICES_IMX477[:, 1:].T]
    a, b, c, d, e, f, g, h, i = (float(term) for term in terms)
    return (a, b, c), (d, e, f), (g, h, i)
