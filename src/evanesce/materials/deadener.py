"""Young's modulus against deadener: interpolation between the table's mixtures, and the trend's fit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import PchipInterpolator

Floats = NDArray[np.float64]


def interpolate_modulus(deadener: ArrayLike, table_deadener: ArrayLike, table_modulus: ArrayLike) -> Floats:
    """Return Young's modulus [MPa] at a share of deadener [%], through every point of a table.

    A monotone cubic in log modulus: moduli of one series span two decades, and no mixture between two neighbours is
    softer or stiffer than both.

    Parameters
    ----------
    deadener : array_like
        [%], within the table.
    table_deadener, table_modulus : array_like (n,)
        [%], ascending, and [MPa].

    Returns
    -------
    ndarray
        [MPa], in the shape of ``deadener``.

    Raises
    ------
    ValueError
        Outside the table: a trend is not a measurement.

    References
    ----------
    F. N. Fritsch and R. E. Carlson, SIAM J. Numer. Anal. 17 (1980) 238.
    """
    x = np.asarray(deadener, dtype=float)
    nodes, moduli = np.asarray(table_deadener, dtype=float), np.asarray(table_modulus, dtype=float)
    if np.any((x < nodes[0]) | (x > nodes[-1])):
        raise ValueError(f"deadener outside the table ({nodes[0]:g} to {nodes[-1]:g} %)")
    return np.exp(PchipInterpolator(nodes, np.log(moduli))(x))


@dataclass(frozen=True)
class DeadenerFit:
    """E = E_0 exp(-k d).

    Attributes
    ----------
    modulus_0 : float
        [MPa] without deadener.
    decay : float
        k [1/%].
    decay_se : float
        Standard error of k [1/%].
    log_rms : float
        Residual standard deviation of ln E: 0.1 is 10 % of the modulus.
    """

    modulus_0: float
    decay: float
    decay_se: float
    log_rms: float


def fit_deadener(table_deadener: ArrayLike, table_modulus: ArrayLike) -> DeadenerFit:
    """Fit the exponential trend by least squares in ln E (equal relative errors).

    Parameters
    ----------
    table_deadener : array_like (n,)
        [%].
    table_modulus : array_like (n,)
        [MPa], above 0.

    Returns
    -------
    DeadenerFit

    Raises
    ------
    ValueError
        For fewer than 3 mixtures.
    """
    x, y = np.asarray(table_deadener, dtype=float), np.log(np.asarray(table_modulus, dtype=float))
    if len(x) < 3:
        raise ValueError(f"{len(x)} mixtures; at least 3 are needed")
    (slope, start), residual, *_ = np.polyfit(x, y, 1, full=True)
    variance = float(residual[0]) / (len(x) - 2)
    error = float(np.sqrt(variance / np.sum((x - x.mean()) ** 2)))
    return DeadenerFit(float(np.exp(start)), float(-slope), error, float(np.sqrt(variance)))
