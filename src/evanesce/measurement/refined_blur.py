"""The camera's blur as a calibration knows it: from the edges of the board, in linear light.

A board's corners are fitted in grey levels, where a tone curve widens an edge by 2 to 12 %. How much follows from the
curve and from the levels of the board's dark and bright squares, and is taken off.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import curve_fit
from scipy.special import ndtr

from evanesce.errors import InputError

Floats = NDArray[np.float64]

BELIEVED_PX = 1.13
"""Standard deviation of the simulated thesis camera's blur [px]: what is believed where nothing was measured."""

BELIEVED_LIMITS_PX = (0.6, 3.0)
"""Limits of a blur that nobody measured [px]: the least that pixels leave, and a picture plainly out of focus."""

LEAST_DOUBT = 0.05
"""Relative half-width of a measured blur: what taking off the tone curve leaves is up to 3 %, at 1 to 3 px."""

LEVELS_NOT_KNOWN = (0.88, 1.0)
"""Linear over grey-level width of an edge, where a calibration does not keep its board's levels."""

ALLOWED = "above 0, below 50 px, or what `evanesce calibrate` writes"


@dataclass(frozen=True, kw_only=True)
class Blur:
    """Blur of an edge in linear light.

    Attributes
    ----------
    px : float
        Standard deviation [px].
    low_px, high_px : float
        Limits.
    origin : {"board", "stated", "believed"}
        The calibration's board; a number in its file or of a caller; nothing.
    """

    px: float = BELIEVED_PX
    low_px: float = BELIEVED_LIMITS_PX[0]
    high_px: float = BELIEVED_LIMITS_PX[1]
    origin: str = "believed"

    @classmethod
    def stated(cls, px: float) -> Blur:
        """Return a blur that is known to 5 %."""
        return cls(px=px, low_px=px * (1 - LEAST_DOUBT), high_px=px * (1 + LEAST_DOUBT), origin="stated")

    @classmethod
    def of(cls, details: Mapping[str, Any], tone: Floats, view: int | None = None) -> Blur:
        """Return the blur that a calibration measured, else the believed one.

        Parameters
        ----------
        details : mapping
            ``blur_px``: a number, or one entry a picture with ``median``, ``p05``, ``p95`` and the board's levels
            ``dark_DN`` and ``bright_DN``.
        tone : ndarray (256,)
            Linear light of each grey level.
        view : int, optional
            Number of the picture, from 1, whose board lay on the glass: a tilted one is out of focus somewhere. Without
            it the sharpest counts.

        Raises
        ------
        InputError
            If an entry is not a positive number of pixels.
        """
        found = details.get("blur_px")
        if found is None or (isinstance(found, list) and not found):
            return cls()
        if not isinstance(found, list):
            return cls.stated(_positive(found))
        entries = [entry if isinstance(entry, Mapping) else {} for entry in found]
        medians = [_positive(entry.get("median")) for entry in entries]
        one = int(np.argmin(medians)) if view is None or not 1 <= view <= len(entries) else view - 1
        entry, median = entries[one], medians[one]
        spread = sorted((_positive(entry.get("p05", median)), median, _positive(entry.get("p95", median))))
        if "dark_DN" in entry and "bright_DN" in entry:
            least = most = 1.0 / widened(_level(entry["dark_DN"]), _level(entry["bright_DN"]), tone)
        else:
            least, most = LEVELS_NOT_KNOWN
        middle = 0.5 * (least + most)
        return cls(
            px=median * middle, origin="board",
            low_px=min(spread[0] * least, median * middle * (1 - LEAST_DOUBT)),
            high_px=max(spread[2] * most, median * middle * (1 + LEAST_DOUBT)),
        )  # fmt: skip


def widened(dark_DN: float, bright_DN: float, tone: Floats) -> float:
    """Return how many times wider a blurred edge between two levels is in grey levels than in linear light.

    Parameters
    ----------
    dark_DN, bright_DN : float
        Of the two sides, 0 to 255.
    tone : ndarray (256,)
    """
    levels = np.arange(len(tone), dtype=np.float64)
    dark, bright = np.interp([dark_DN, bright_DN], levels, tone)
    if not bright - dark > 1e-3:
        return 1.0
    at = np.arange(-8.0, 8.05, 0.2)

    def edge(x: Floats, low: float, step: float, middle: float, width: float) -> Floats:
        return np.asarray(low + step * ndtr((x - middle) / width))

    grey = np.interp(edge(at, dark, bright - dark, 0.0, 1.0), tone, levels)
    solved, _ = curve_fit(edge, at, grey, [grey[0], grey[-1] - grey[0], 0.0, 1.0])
    return float(abs(solved[3]))


def _positive(value: Any) -> float:
    if isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value) and 0 < value < 50:
        return float(value)
    raise InputError(f"{str(value)[:80]}", key="blur_px", allowed=ALLOWED)


def _level(value: Any) -> float:
    if isinstance(value, int | float) and not isinstance(value, bool) and -64 <= value <= 320:
        return float(value)  # a fit's own level may lie a little beyond black or white
    raise InputError(f"{str(value)[:80]}", key="blur_px", allowed="dark_DN and bright_DN from 0 to 255")
