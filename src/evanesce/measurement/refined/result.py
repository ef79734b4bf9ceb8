"""Result of the refined area estimator on one frame."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from evanesce.measurement.refined.subsurface import Scattering

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]
Unseen = Literal["", "top", "modelled"]


@dataclass(frozen=True, kw_only=True)
class RefinedArea:
    """Refined area of one frame.

    Attributes
    ----------
    area_mm2, perimeter_mm : float
        Of the contact and of its boundary.
    contours : list of ndarray (n, 2)
        (x, y) in the frame as taken [px]; holes run the other way round.
    mask : ndarray of bool (rows, cols)
        Of the crop.
    scattering : Scattering
    saturated_pixels : int
    islands, dropped : int
        Parts of the contact, and those too small to be it.
    step : float
        Median light of contact over what is beside it, of full scale.
    ground : float
        Median light of the frame, of full scale: what is beside the contact, before a dark frame is taken off.
    edge_px : float, optional
        Blur that the contact's edges show (:func:`.edge_blur`) [px]; None where the frame does not show them.
    spread_mm : float, optional
        How much wider the edge is than at its median (:func:`.edge_spread`); None where it is not the
        frame's own: saturated, or after scattering was inverted.
    sharp_spread_mm : float, optional
        The same of a sharp contact of this shape under this blur and noise (:mod:`.replica`).
    shape_gain : float
        Relative error of the area of such a contact, which is divided out of ``area_mm2`` [1].
    narrow_share : float
        Share of the boundary beside ridges or grooves too narrow for an envelope (:func:`.narrow_share`) [1].
    synthesised, unresolved : bool
        Whether narrow ridges and grooves were found by synthesis (:mod:`.synthesis`), and whether that came to no rest:
        the blur hides them.
    residual : float, optional
        What a drawn sharp contact leaves of the frame at its edge, RMS over the step [1] (:mod:`.replica`); None where
        the frame does not show its edge.
    outside_mm : float
        Expected displacement of the boundary by film of air and codec, taken off ``area_mm2``
        (:func:`~evanesce.measurement.uncertainty.area.corrected_for_edge`) [mm].
    unseen : {"", "top", "modelled"}
        What saturation hides of the edge: nothing; its top, so that its foot was read; more, under scattered light, so
        that the saturated part comes from a model.
    blur_uncertainty_px : float
        How far the boundary moves between the limits of the camera's blur [px], half; 0 where it does not depend on it.
    colour_misfit_DN : float, optional
        Median difference of the contact's colours from those of the camera model at the level that was read [DN].
    colour_unread, colour_uncertainty_px : bool, float
        Whether one channel of a colour frame is clipped and no camera model says what the others show; how far levels
        that colours leave open may move the boundary [px].
    colour_shift_px : float
        How far outside the contact demosaicing moved the boundary (:func:`.demosaicing_shift`), for which ``area_mm2``
        is corrected [px].
    mosaic : bool
        Whether the frame was a raw mosaic, whose sums widen all edges alike.
    """

    area_mm2: float
    perimeter_mm: float
    contours: list[Floats]
    mask: Mask
    scattering: Scattering
    saturated_pixels: int
    islands: int
    dropped: int
    step: float
    ground: float = 0.0
    edge_px: float | None = None
    spread_mm: float | None = None
    sharp_spread_mm: float | None = None
    shape_gain: float = 0.0
    narrow_share: float = 0.0
    synthesised: bool = False
    unresolved: bool = False
    mosaic: bool = False
    residual: float | None = None
    outside_mm: float = 0.0
    unseen: Unseen = ""
    blur_uncertainty_px: float = 0.0
    colour_unread: bool = False
    colour_uncertainty_px: float = 0.0
    colour_misfit_DN: float | None = None
    colour_shift_px: float = 0.0

    @property
    def excess_mm(self) -> float | None:
        """How much wider the edge is than that of a sharp contact of the same shape [mm]; None where not known."""
        if self.spread_mm is None or self.sharp_spread_mm is None:
            return None
        return self.spread_mm - self.sharp_spread_mm
