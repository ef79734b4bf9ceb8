"""The camera's blur from the edges of the calibration board, in linear light.

A board's corners are fitted in grey levels, where a tone curve widens an edge by 2 to 12 %. The factor follows from
the curve and from the levels of the board's dark and bright squares, and is divided out.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import curve_fit
from scipy.special import erfc, ndtr

from evanesce.core.errors import InputError
from evanesce.measurement.calibration.board_edge import END_PX, edge_profile
from evanesce.measurement.calibration.corners import CornerGrid

Floats = NDArray[np.float64]

NOMINAL_PX = 1.13
"""Standard deviation of the simulated thesis camera's blur [px]: assumed where nothing was measured."""

NOMINAL_LIMITS_PX = (0.6, 3.0)
"""Limits of a blur that was not measured [px]: the smallest that pixels allow, and an image clearly out of focus."""

MIN_HALF_WIDTH = 0.05
"""Relative half-width of a measured blur: removing the tone curve leaves an error of up to 3 %, at 1 to 3 px."""

MOSAIC_PX2 = (0.25, 0.5)
"""Variance that bilinear demosaicing adds to a blur [px^2]: of green, which is most of a board's grey; of red and blue.
Of blue pixels a quarter are exact, the rest are means of two or four neighbours at one pixel's distance."""

BOARD_FULL_DN = 250.0
"""Level of a board's bright squares from which they are clipped, so that its edges say little about the blur [DN]."""

UNKNOWN_LEVELS = (0.88, 1.0)
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
    origin : {"board", "stated", "nominal"}
        The calibration's board; a number in its file or of a caller; assumed.
    response : tuple of ndarray, optional
        Positions from dark to bright [px] and the light there of a unit step, where the board's edges show it; else
        the edge is Gaussian.
    """

    px: float = NOMINAL_PX
    low_px: float = NOMINAL_LIMITS_PX[0]
    high_px: float = NOMINAL_LIMITS_PX[1]
    origin: str = "nominal"
    response: tuple[Floats, Floats] | None = None

    def as_dict(self) -> dict[str, Any]:
        """Return plain data: widths, origin and, where known, the edge's profile as positions [px] and light [1].

        Returns
        -------
        dict
        """
        found: dict[str, Any] = {"px": self.px, "low_px": self.low_px, "high_px": self.high_px, "origin": self.origin}
        if self.response is not None:
            found["edge"] = {"positions_px": self.response[0].tolist(), "light": self.response[1].tolist()}
        return found

    def edge(self, distance: Floats, px: float | None = None) -> Floats:
        """Return the light of a unit step at distances outside it [px], as if the blur were ``px`` wide.

        Parameters
        ----------
        distance : ndarray
            Outside the step [px].
        px : float, optional
            Standard deviation of the blur; its own by default [px].

        Returns
        -------
        ndarray
            0 to 1.
        """
        width = self.px if px is None else px
        if self.response is None:
            return edge_response(distance, width)
        positions, shares = self.response
        return np.asarray(np.interp(-np.asarray(distance) * self.px / width, positions, shares))

    def of_mosaic(self) -> Blur:
        """Return the blur of red and blue channels behind a filter mosaic, demosaiced bilinearly.

        Returns
        -------
        Blur
            Gaussian; a stated one unchanged, since it is stated for the frames that are measured.
        """
        if self.origin == "stated":
            return self
        own = MOSAIC_PX2[1] - (MOSAIC_PX2[0] if self.origin == "board" else 0.0)
        px, low, high = (math.sqrt(width**2 + own) for width in (self.px, self.low_px, self.high_px))
        return Blur(px=px, low_px=low, high_px=high, origin=self.origin)

    @classmethod
    def stated(cls, px: float) -> Blur:
        """Return a blur that is known to 5 %.

        Parameters
        ----------
        px : float
            Standard deviation [px].

        Returns
        -------
        Blur
        """
        return cls(px=px, low_px=px * (1 - MIN_HALF_WIDTH), high_px=px * (1 + MIN_HALF_WIDTH), origin="stated")

    @classmethod
    def of(cls, details: Mapping[str, Any], tone: Floats, view: int | None = None, *, colour: bool = False) -> Blur:
        """Return the blur that a calibration measured, else the nominal one.

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
        colour : bool
            For colour frames that are read by a camera model (:meth:`of_mosaic`).

        Returns
        -------
        Blur

        Raises
        ------
        InputError
            If an entry is not a positive number of pixels.
        """
        found = details.get("blur_px")
        if found is None or (isinstance(found, list) and not found):
            return cls().of_mosaic() if colour else cls()
        if not isinstance(found, list):
            return cls.stated(_positive(found))
        entries = [entry if isinstance(entry, Mapping) else {} for entry in found]
        medians = [_positive(entry.get("median")) for entry in entries]
        one = int(np.argmin(medians)) if view is None or not 1 <= view <= len(entries) else view - 1
        entry, median = entries[one], medians[one]
        spread = sorted((_positive(entry.get("p05", median)), median, _positive(entry.get("p95", median))))
        if "dark_DN" in entry and "bright_DN" in entry:
            if colour and _level(entry["bright_DN"]) >= BOARD_FULL_DN:
                return cls().of_mosaic()
            low = high = 1.0 / widened(_level(entry["dark_DN"]), _level(entry["bright_DN"]), tone)
        else:
            low, high = UNKNOWN_LEVELS
        middle = 0.5 * (low + high)
        blur = cls(
            px=median * middle, origin="board", response=_response(entry.get("edge"), tone),
            low_px=min(spread[0] * low, median * middle * (1 - MIN_HALF_WIDTH)),
            high_px=max(spread[2] * high, median * middle * (1 + MIN_HALF_WIDTH)),
        )  # fmt: skip
        return blur.of_mosaic() if colour else blur


def edge_response(distance: Floats, blur_px: float) -> Floats:
    """Return the light of a unit step at distances outside it [px], blurred by a Gaussian.

    Parameters
    ----------
    distance : ndarray
        Outside the step [px].
    blur_px : float
        Standard deviation [px].

    Returns
    -------
    ndarray
        0 to 1.
    """
    return np.asarray(0.5 * erfc(distance / (np.sqrt(2.0) * blur_px)))


def blur_of_board(image: NDArray[np.uint8], grid: CornerGrid) -> dict[str, Any]:
    """Return the spread of the blur over a picture of a board, as a calibration keeps it.

    Parameters
    ----------
    image : ndarray (rows, cols[, 3])
    grid : CornerGrid
        Of that picture.

    Returns
    -------
    dict
        ``median``, ``p05`` and ``p95`` [px] of the corners, in grey levels; ``dark_DN`` and ``bright_DN`` of the
        squares; ``edge``, of :func:`~evanesce.measurement.calibration.board_edge.edge_profile`, where there is one.
    """
    sigma = np.sqrt((grid.fit.sigma**2).mean(axis=1))
    found = {name: float(np.percentile(sigma, q)) for name, q in (("median", 50), ("p05", 5), ("p95", 95))}
    level, half = float(np.median(grid.fit.level)), float(np.median(np.abs(grid.fit.contrast)))
    profile = edge_profile(image, grid)
    return found | {"dark_DN": level - half, "bright_DN": level + half} | ({"edge": profile} if profile else {})


def widened(dark_DN: float, bright_DN: float, tone: Floats) -> float:
    """Return how many times wider a blurred edge between two levels is in grey levels than in linear light.

    Parameters
    ----------
    dark_DN, bright_DN : float
        Of the two sides, 0 to 255.
    tone : ndarray (256,)

    Returns
    -------
    float
        [1].
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


def _response(edge: Any, tone: Floats) -> tuple[Floats, Floats] | None:
    """Return a stored profile as positions and shares of light, made symmetric about its half-way point."""
    if edge is None:
        return None
    try:
        first, step = float(edge["first_px"]), float(edge["step_px"])
        levels = np.array(edge["levels_DN"], np.float64)
    except (KeyError, TypeError, ValueError):
        raise InputError("not a profile", key="blur_px: edge", allowed=ALLOWED) from None
    positions = first + step * np.arange(levels.size)
    sound = levels.ndim == 1 and levels.size > 8 and step > 0 and abs(positions[0] + positions[-1]) < 1e-6
    if not (sound and np.isfinite(levels).all() and ((levels >= -64) & (levels <= 320)).all()):
        raise InputError("not a profile", key="blur_px: edge", allowed=ALLOWED)
    light = np.interp(levels, np.arange(len(tone), dtype=np.float64), tone)
    count = max(1, min(round(END_PX / step), levels.size // 4))
    dark, bright = light[:count].mean(), light[-count:].mean()
    if not bright - dark > 1e-3:
        return None
    share = (light - dark) / (bright - dark)
    # a tone curve moves the half-way point of grey levels off that of light
    share = np.interp(positions + np.interp(0.5, np.maximum.accumulate(share), positions), positions, share)
    even = np.maximum.accumulate(0.5 * (share + 1.0 - share[::-1]))
    return np.asarray(positions, np.float64), np.asarray(even, np.float64)


def _positive(value: Any) -> float:
    if isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value) and 0 < value < 50:
        return float(value)
    raise InputError(f"{str(value)[:80]}", key="blur_px", allowed=ALLOWED)


def _level(value: Any) -> float:
    if isinstance(value, int | float) and not isinstance(value, bool) and -64 <= value <= 320:
        return float(value)  # a fit's own level may lie a little beyond black or white
    raise InputError(f"{str(value)[:80]}", key="blur_px", allowed="dark_DN and bright_DN from 0 to 255")
