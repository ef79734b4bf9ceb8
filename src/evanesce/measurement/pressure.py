"""Pressure from grey level: the inverse of a curve of light against pressure, scaled to the measured force.

A rough skin is in real contact over a share of its nominal contact that grows with pressure, and light enters where it
is. The growth of light with pressure is a table that the caller supplies (a roughness model, or a lab's own press
against a flat); the brightness of complete contact is not known: it is the light with which the pressures add up to the
force of the load cell. Saturated pixels give a lower limit only.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import brentq

from evanesce.core.errors import InputError

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

SMOOTHING_PX = 1.5
BRIGHTEST = 1e4
"""Light of complete contact over the frame's brightest, up to which the scale is searched."""


@dataclass(frozen=True)
class PressureCurve:
    """Light against local pressure.

    Attributes
    ----------
    pressure_MPa : ndarray (n,)
        Rising from 0.
    light : ndarray (n,)
        Of complete contact's, rising from 0 [1].
    """

    pressure_MPa: Floats
    light: Floats

    def __post_init__(self) -> None:
        p, light = self.pressure_MPa, self.light
        if p.shape != light.shape or p.ndim != 1 or len(p) < 3 or not np.isfinite([*p, *light]).all():
            raise InputError(f"{p.shape} and {light.shape}", key="pressure curve", allowed="two finite columns, 3 rows")
        if p[0] != 0 or light[0] != 0 or np.any(np.diff(p) <= 0) or np.any(np.diff(light) < 0) or light[-1] > 1:
            raise InputError(
                f"light {light[0]:g} to {light[-1]:g}",
                key="pressure curve",
                allowed="both rising from 0, light up to 1",
            )

    def pressure(self, light: ArrayLike) -> Floats:
        """Return the pressure [MPa] of light over that of complete contact; beyond the table, its last.

        Parameters
        ----------
        light : array_like
            Over that of complete contact [1].

        Returns
        -------
        ndarray
            [MPa].
        """
        rising = np.maximum.accumulate(self.light + 1e-15 * np.arange(len(self.light)))
        return np.asarray(np.interp(np.asarray(light, np.float64), rising, self.pressure_MPa))


@dataclass(frozen=True, kw_only=True)
class PressureMap:
    """Pressure of one frame.

    Attributes
    ----------
    pressure : ndarray (rows, cols)
        [MPa].
    unknown : ndarray of bool (rows, cols)
        Saturated: the pressure there is a lower limit.
    complete_light : float
        Light of complete contact, of full scale.
    factor : float
        By which pressures had to be multiplied beyond the curve to add up to the force; 1 where the curve sufficed.
    """

    pressure: Floats
    unknown: Mask
    complete_light: float
    factor: float


def pressure_map(
    light: Floats, full: Mask, pixel_area: Floats | float, force_N: float, curve: PressureCurve
) -> PressureMap:
    """Convert the light of a frame to pressure.

    Parameters
    ----------
    light : ndarray (rows, cols)
        Linear, background subtracted.
    full : ndarray of bool (rows, cols)
        Saturated pixels.
    pixel_area : ndarray (rows, cols) or float
        [mm^2].
    force_N : float
        Of the load cell [N].
    curve : PressureCurve

    Returns
    -------
    PressureMap

    Raises
    ------
    InputError
        If the force is not positive, or the frame has no light.
    """
    if not (force_N > 0 and np.isfinite(force_N)):
        raise InputError(f"{force_N:g}", key="force", allowed="above 0 N")
    smooth = np.clip(cv2.GaussianBlur(light, (0, 0), SMOOTHING_PX), 0.0, None)
    brightest = float(smooth.max())
    if not brightest > 0:
        raise InputError("no light", key="frame", allowed="a frame with contact")

    def carried(log_ratio: float) -> float:
        return float((curve.pressure(smooth / (brightest * np.exp(log_ratio))) * pixel_area).sum()) - force_N

    top = float(np.log(BRIGHTEST))
    # the brightest pixel at the curve's own end carries the most that the curve allows
    bottom = -float(np.log(curve.light[-1])) if curve.light[-1] < 1 else 0.0
    if carried(bottom) <= 0:
        complete, factor = brightest * np.exp(bottom), force_N / (carried(bottom) + force_N)
    elif carried(top) >= 0:
        complete, factor = brightest * BRIGHTEST, force_N / (carried(top) + force_N)
    else:
        complete, factor = brightest * np.exp(brentq(carried, bottom, top, xtol=1e-6)), 1.0
    return PressureMap(
        pressure=factor * curve.pressure(smooth / complete), unknown=full, complete_light=complete, factor=factor
    )


def reference_map(level: Floats, dilated: Mask, pixel_area: Floats | float, force_N: float) -> Floats:
    """Return the thesis's map: grey levels under the dilated mask, scaled to the force (the thesis gives no unit).

    Parameters
    ----------
    level : ndarray (rows, cols)
        Grey level, 0 to 1.
    dilated : ndarray of bool (rows, cols)
    pixel_area : ndarray (rows, cols) or float
        [mm^2].
    force_N : float
        [N].

    Returns
    -------
    ndarray (rows, cols)
        [MPa].
    """
    kept = np.where(dilated, level, 0.0)
    total = float((kept * pixel_area).sum())
    return kept * (force_N / total) if total > 0 else kept
