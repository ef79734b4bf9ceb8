"""The uncertainty budget of one frame's area, by the reference segmentation or the refined estimator."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Literal

import numpy as np
from skimage.measure import perimeter_crofton

from evanesce.measurement.calibration.model import Calibration
from evanesce.measurement.reference.area import Measured
from evanesce.measurement.reference.segment import grey
from evanesce.measurement.refined.estimator import Estimator
from evanesce.measurement.refined.light import tone_table
from evanesce.measurement.refined.result import RefinedArea
from evanesce.measurement.uncertainty.budget import Component, Finger, Reading, Uncertain, propagate
from evanesce.measurement.uncertainty.components import (
    card_components,
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
    cards: Sequence[Component] | None = None, finger: Finger = "ridged", bits_per_pixel: float | None = None,
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
    bits_per_pixel : float, optional
        Of the video's key frames; without it a codec's influence is taken as that of a low rate.

    Returns
    -------
    Uncertain
    """
    side = math.sqrt(estimator.plate.middle_area)
    spread = estimator.plate.area_standard(found.contours) / found.area_mm2 if found.area_mm2 > 0 else 0.0
    shape = found.shape_gain * found.area_mm2 / found.perimeter_mm if found.perimeter_mm > 0 else 0.0
    distance, nearness = lens_distance(estimator.plate.calibration, side)
    reading = Reading(area_mm2=found.area_mm2, perimeter_mm=found.perimeter_mm, distance_mm=distance)
    # a codec makes edges wider and narrower; demosaicing makes them wider only, so that their width bounds the film
    spread_mm = None if video else found.excess_mm
    seen = not (found.unseen or found.scattering.length_px) and found.perimeter_mm > 0
    half_width = found.area_mm2 / found.perimeter_mm if seen else None
    parts = [
        *(card_components() if cards is None else cards),
        nearness,
        *refined_components(
            side, spread, video=video, finger=finger, spread_mm=spread_mm,
            shape_mm=shape, narrow=found.narrow_share, half_width_mm=half_width, synthesised=found.synthesised,
            unresolved=found.unresolved, bits_per_pixel=bits_per_pixel,
            unseen=found.unseen, scattering=found.scattering.length_px > 0,
            blur_uncertainty_px=found.blur_uncertainty_px, colour_uncertainty_px=found.colour_uncertainty_px,
        ),
    ]  # fmt: skip
    return propagate(reading, parts, rng)


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
