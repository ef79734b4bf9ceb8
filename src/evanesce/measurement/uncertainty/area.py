"""The uncertainty budget of one frame's area, by the reference segmentation or the refined estimator."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Literal

import numpy as np
from scipy.spatial import ConvexHull
from skimage.measure import perimeter_crofton

from evanesce.measurement.calibration.model import Calibration
from evanesce.measurement.reference.area import Measured
from evanesce.measurement.reference.segment import grey
from evanesce.measurement.refined.estimator import Estimator
from evanesce.measurement.refined.light import tone_table
from evanesce.measurement.refined.result import RefinedArea
from evanesce.measurement.uncertainty.budget import Component, Finger, Reading, Uncertain, propagate
from evanesce.measurement.uncertainty.components import (
    CODEC_NAME,
    FILM_NAME,
    card_components,
    film_of_contact,
    nearness_component,
    reference_components,
    refined_components,
)

UNKNOWN_DISTANCE_MM = 33.0
"""Lens to plate of the thesis's rig, where no calibration determines it: it only scales the card's height."""

UNKNOWN_SPREAD = 0.02
"""Half the relative spread of the local scale, where no calibration determines it: the thesis rig's own."""


def refined_uncertainty(
    found: RefinedArea, estimator: Estimator, rng: np.random.Generator, *, video: bool = False,
    cards: Sequence[Component] | None = None, finger: Finger = "ridged",
) -> Uncertain:  # fmt: skip
    """Return a refined area with its uncertainty.

    Parameters
    ----------
    found : RefinedArea
    estimator : Estimator
    rng : numpy.random.Generator
    video : bool
        Whether the frame went through a lossy codec.
    cards : sequence of Component, optional
        What is known of the cards; :func:`.card_components` by default.
    finger : {"ridged", "smooth"}

    Returns
    -------
    Uncertain
    """
    spread = estimator.plate.area_standard(found.contours) / found.area_mm2 if found.area_mm2 > 0 else 0.0
    side = math.sqrt(estimator.plate.middle_area)
    distance, nearness = lens_distance(estimator.plate.calibration, side)
    reading = Reading(area_mm2=found.area_mm2, perimeter_mm=found.perimeter_mm, distance_mm=distance)
    own = _own_components(found, estimator, spread, video=video, finger=finger)
    if found.outside_mm:
        own = [_centred(part) if part.name in (FILM_NAME, CODEC_NAME) else part for part in own]
    return propagate(reading, [*(card_components() if cards is None else cards), nearness, *own], rng)


def corrected_for_edge(found: RefinedArea, estimator: Estimator, *, video: bool = False) -> RefinedArea:
    """Return an area without what film of air and codec are expected to add, where the frame's edges do not show them.

    Both have a known sign: a film moves the boundary outwards, a codec inwards (JCGM 100, 3.2.4: a recognised effect is
    corrected, and the correction's uncertainty stays).

    Parameters
    ----------
    found : RefinedArea
        As the estimator read it.
    estimator : Estimator
    video : bool
        Whether the frame went through a lossy codec.

    Returns
    -------
    RefinedArea
    """
    if not _by_opening(found, video=video):
        return found
    own = _own_components(found, estimator, 0.0, video=video, finger="ridged")
    outside = sum(part.mean for part in own if part.name in (FILM_NAME, CODEC_NAME))
    return replace(found, area_mm2=max(found.area_mm2 - found.perimeter_mm * outside, 0.0), outside_mm=outside)


def _by_opening(found: RefinedArea, *, video: bool) -> bool:
    """Return whether an edge is seen whose width says nothing of a film: a codec widens it and narrows it.

    Demosaicing makes edges wider only, so that their width still bounds the film.
    """
    seen = not (found.unseen or found.scattering.length_px) and found.perimeter_mm > 0
    return seen and video


def _own_components(
    found: RefinedArea, estimator: Estimator, scale: float, *, video: bool, finger: Finger
) -> list[Component]:
    """Return the estimator's own part of the budget, the scale's relative standard uncertainty in it."""
    shape = found.shape_gain * found.area_mm2 / found.perimeter_mm if found.perimeter_mm > 0 else 0.0
    film = None
    if _by_opening(found, video=video):
        points = np.concatenate([estimator.plate.to_plate(curve) for curve in found.contours])
        film = film_of_contact(found.area_mm2, found.perimeter_mm, float(ConvexHull(points).volume))
    spread = None if video else found.excess_mm
    return refined_components(
        math.sqrt(estimator.plate.middle_area), scale, video=video, finger=finger, spread_mm=spread,
        shape_mm=shape, narrow=found.narrow_share, synthesised=found.synthesised, unresolved=found.unresolved,
        film_mm=film, residual=found.residual, unseen=found.unseen, scattering=found.scattering.length_px > 0,
        blur_uncertainty_px=found.blur_uncertainty_px, colour_uncertainty_px=found.colour_uncertainty_px,
    )  # fmt: skip


def _centred(part: Component) -> Component:
    """Return a component whose mean was taken off the area."""
    return replace(part, low=part.low - part.mean, high=part.high - part.mean)


def reference_uncertainty(
    measured: Measured, mm2_per_px: float, calibration: Calibration | None, rng: np.random.Generator,
    cards: Sequence[Component] | None = None, *, video: bool = False,
) -> Uncertain:  # fmt: skip
    """Return an area of the reference segmentation with its uncertainty.

    The displacement of the threshold's boundary is estimated from the frame: by the area of a threshold half-way up in
    linear light in the same surviving blobs.

    Parameters
    ----------
    measured : Measured
    mm2_per_px : float
        [mm^2].
    calibration : Calibration, optional
    rng : numpy.random.Generator
    cards : sequence of Component, optional
        As for :func:`refined_uncertainty`.
    video : bool
        Whether the frame went through a lossy codec.

    Returns
    -------
    Uncertain
    """
    side = math.sqrt(mm2_per_px)
    details = calibration.details if calibration else {}
    perimeter_px, away_px = reference_boundary(measured, details.get("tone_curve", "bt709"))
    perimeter, away = perimeter_px * side, away_px * side
    distance, nearness = lens_distance(calibration, side)
    spread = details.get("scale_spread_undistorted")
    square = (calibration.square_side_mm if calibration else None) or 15.0
    parts = reference_components(
        side, square_px=square / side, threshold_mm=away, video=video,
        spread=float(spread) if isinstance(spread, float) and 0 <= spread < 1 else UNKNOWN_SPREAD,
    )  # fmt: skip
    reading = Reading(area_mm2=measured.estimate.area, perimeter_mm=perimeter, distance_mm=distance)
    return propagate(reading, [*(card_components() if cards is None else cards), nearness, *parts], rng)


def lens_distance(calibration: Calibration | None, pixel_mm: float) -> tuple[float, Component]:
    """Return the apparent distance of the contact plane from the lens through the glass [mm], and its uncertainty.

    Focal length over scale. A board that lies flat on the glass does not determine the focal length, so that its
    uncertainty depends on whether it was found, taken from the rig's drawing, or assumed.

    Parameters
    ----------
    calibration : Calibration, optional
    pixel_mm : float
        Side of a pixel on the plate, near the axis [mm].

    Returns
    -------
    distance : float
        [mm].
    component : Component
    """
    if calibration is None:
        return UNKNOWN_DISTANCE_MM, nearness_component("assumed")
    focal, details = float(calibration.camera_matrix[0, 0]), calibration.details
    if details.get("focal_length_identified") is True:
        errors = details.get("standard_errors")
        error = errors.get("fx") if isinstance(errors, Mapping) else None
        if isinstance(error, int | float) and 0 <= error < focal:
            return focal * pixel_mm, nearness_component("found", float(error) / focal)
        return focal * pixel_mm, nearness_component("drawing")  # found, but the file does not state its error
    known: Literal["drawing", "assumed"] = "drawing" if details.get("focal_length_given") is True else "assumed"
    return focal * pixel_mm, nearness_component(known)


def reference_boundary(measured: Measured, curve: str | Sequence[float]) -> tuple[float, float]:
    """Return the length of the mask's boundary, and how far outside the half-way boundary it runs.

    Parameters
    ----------
    measured : Measured
    curve : str or sequence of float
        Tone curve, see :func:`~evanesce.measurement.refined.light.tone_table`.

    Returns
    -------
    perimeter, outside : float
        [px].
    """
    mask = measured.segmentation.mask
    perimeter = float(perimeter_crofton(mask, 4)) if mask.any() else 0.0
    if not perimeter > 0:
        return 0.0, 0.0
    return perimeter, (measured.segmentation.pixels - _half_count(measured, curve)) / perimeter


def _half_count(measured: Measured, curve: str | Sequence[float]) -> int:
    """Return how many pixels of the surviving blobs are brighter than half the light of the mask's median."""
    table, within = tone_table(curve), measured.segmentation.dilated
    rows, cols = np.flatnonzero(within.any(axis=1)), np.flatnonzero(within.any(axis=0))
    box = np.s_[rows[0] : rows[-1] + 1, cols[0] : cols[-1] + 1]
    levels = np.rint(255 * grey(measured.view[box])).astype(np.uint8)
    plateau = int(np.median(levels[measured.segmentation.mask[box]]))
    light = table[levels[within[box]]]
    return int(np.count_nonzero(light > 0.5 * table[plateau]))
