"""Grey levels on the two sides of a contact's edge, the threshold half-way between them, and what others would count.

A symmetric blur leaves an edge in place where light is half-way between its two sides. A threshold below that counts
blur and light beside the contact, one above it misses contact.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from evanesce.measurement.reference.segment import LUMA, LUMA_SCALE, Chain, segment
from evanesce.measurement.refined.edge import EdgeSettings, coarse_mask, edge_width, envelopes, find_boundary
from evanesce.measurement.refined.light import tone_table
from evanesce.measurement.warnings import Warning

Floats = NDArray[np.float64]
Image = NDArray[np.uint8]

MIN_STEP = 0.01
"""Light of contact over what is beside it, of full scale, below which there is no contact."""

FAR_FROM_HALF = (0.25, 0.75)
"""Shares of the way from ground to contact outside which a threshold counts as far from half: there a Gaussian blur
displaces the edge by more than 0.67 of its standard deviation."""

CURVE_POINTS = 24


@dataclass(frozen=True, kw_only=True)
class EdgeLevels:
    """Light on the two sides of a contact's edge, in linear light of full scale.

    Attributes
    ----------
    ground, contact : float
        Median light outside and inside along the edge.
    blur_px : float
        Standard deviation of the edge [px].
    tone : ndarray (256,)
        Linear light of each grey level.
    """

    ground: float
    contact: float
    blur_px: float
    tone: Floats

    def grey(self, light: float) -> float:
        """Return the grey level 0 to 1 of a light."""
        return float(np.interp(light, self.tone, np.arange(len(self.tone)))) / (len(self.tone) - 1)

    @property
    def half(self) -> float:
        """Threshold half-way between ground and contact in linear light: grey level, 0 to 1."""
        return self.grey(0.5 * (self.ground + self.contact))

    def share(self, threshold: float) -> float:
        """Return how far a threshold stands on the way from ground to contact in linear light: 0 to 1 between them."""
        light = float(np.interp(255.0 * threshold, np.arange(len(self.tone)), self.tone))
        return (light - self.ground) / (self.contact - self.ground)

    def blurred_out_px(self, threshold: float, chain_blur_px: float) -> float:
        """Return how far outside the half-way boundary a threshold runs by blur alone [px]."""
        share = float(np.clip(self.share(threshold), 0.005, 0.995))
        return -float(ndtri(share)) * float(np.hypot(self.blur_px, chain_blur_px))

    def as_dict(self) -> dict[str, float]:
        """Return plain data: grey levels 0 to 1 of both sides and half-way, and the blur [px]."""
        return {
            "ground": self.grey(self.ground), "contact": self.grey(self.contact), "half": self.half,
            "blur_px": self.blur_px,
        }  # fmt: skip


def edge_levels(view: Image, curve: str | Sequence[float] = "bt709") -> EdgeLevels | None:
    """Read the levels on the two sides of a contact's edge from one frame.

    Parameters
    ----------
    view : ndarray of uint8, (rows, cols) or (rows, cols, 3)
        [DN].
    curve : str or sequence of float
        Tone curve, see :func:`~evanesce.measurement.refined.light.tone_table`.

    Returns
    -------
    EdgeLevels, or None
        None where the frame shows no contact.
    """
    tone = tone_table(curve)
    light = luma_light(view, tone)
    mask = coarse_mask(light, MIN_STEP)
    if mask is None:
        return None
    settings = EdgeSettings()
    boundary = find_boundary(light, mask, settings)
    inside = boundary.level > 0.5
    near = cv2.morphologyEx(inside.astype(np.uint8), cv2.MORPH_GRADIENT, np.ones((3, 3), np.uint8)) > 0
    if not near.any():
        return None
    inner, outer = envelopes(light, inside, settings)
    ground, contact = float(np.median(outer[near])), float(np.median(inner[near]))
    if not contact - ground > MIN_STEP:
        return None
    total = edge_width(boundary) / np.sqrt(2 * np.pi)
    blur = float(np.sqrt(max(total**2 - settings.smoothing_px**2, 0.0)))
    return EdgeLevels(ground=ground, contact=contact, blur_px=blur, tone=tone)


def luma_light(view: Image, tone: Floats) -> Floats:
    """Return linear light of a frame's luma, (rows, cols).

    Parameters
    ----------
    view : ndarray of uint8, (rows, cols) or (rows, cols, 3)
        [DN].
    tone : ndarray (256,)

    Returns
    -------
    ndarray (rows, cols)
    """
    if view.ndim == 2:
        return np.asarray(tone[view], np.float64)
    luma = 255.0 * (view.astype(np.float32) @ np.array(LUMA, np.float32)) / LUMA_SCALE
    return np.asarray(np.interp(luma, np.arange(len(tone)), tone))


def threshold_curve(view: Image, chain: Chain, mm2_per_px: float, levels: EdgeLevels) -> list[dict[str, float]]:
    """Return the area that the reference segmentation counts at thresholds between ground and contact.

    Parameters
    ----------
    view : ndarray of uint8, (rows, cols) or (rows, cols, 3)
        Cropped already [DN].
    chain : Chain
        Its own threshold is one of the points.
    mm2_per_px : float
        [mm^2].
    levels : EdgeLevels

    Returns
    -------
    list of dict
        ``threshold`` [1], ``share`` of the way from ground to contact [1], ``area_mm2``; thresholds rise.
    """
    lights = levels.ground + (levels.contact - levels.ground) * np.linspace(0.04, 0.96, CURVE_POINTS)
    thresholds = sorted({*(round(levels.grey(light), 5) for light in lights), levels.half, chain.threshold})
    plain = replace(chain, crop=type(chain.crop)())
    return [
        {
            "threshold": threshold,
            "share": levels.share(threshold),
            "area_mm2": segment(view, replace(plain, threshold=threshold)).pixels * mm2_per_px,
        }
        for threshold in thresholds
    ]


def threshold_warning(threshold: float, levels: EdgeLevels, index: int) -> Warning | None:
    """Return a warning where a threshold is far from half the contact's level.

    Parameters
    ----------
    threshold : float
        Grey level, 0 to 1.
    levels : EdgeLevels
    index : int
        Of the frame they were read from.

    Returns
    -------
    Warning or None
    """
    share = levels.share(threshold)
    if FAR_FROM_HALF[0] <= share <= FAR_FROM_HALF[1]:
        return None
    what = "blur and light beside the contact count as contact" if share < 0.5 else "contact is missed"
    return Warning(
        "threshold_far_from_half",
        f"threshold {threshold:g} stands {100 * share:.0f} % of the way from ground ({levels.grey(levels.ground):.3f}) "
        f"to contact ({levels.grey(levels.contact):.3f}) in linear light of frame {index}: {what}; "
        f"half-way is {levels.half:.3f} (--threshold auto)",
    )
