"""Components of an area's uncertainty budget: the card, the lens's distance, both estimators, a lossy codec."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from evanesce.measurement.uncertainty.budget import Component, Finger

FILM_NAME, CODEC_NAME = "film of air, edge", "codec"

PRINT_TOLERANCE = 0.002
"""Relative length of a print: paper that takes up moisture, a laser printer's feed."""

CARD_HEIGHT_MM = 0.1
"""Greatest height of a card's printed side over the contact plane: unevenness of paper."""


@dataclass(frozen=True)
class FilmLaw:
    """How far outside the contact the refined boundary runs, by the width of the edge.

    Light couples across a film of air of some 0.1 um. Where the film opens slowly, as over a ridge that is about to
    come into contact, that widens the edge and moves its half-way point outwards: by ``per_spread`` times the widening.

    Attributes
    ----------
    per_spread : float
        [1].
    offset_mm : float
        At an edge that is no wider than a sharp contact's.
    standard_mm : float
        Standard deviation of the residual, rig to rig included.
    """

    per_spread: float
    offset_mm: float
    standard_mm: float

    def at(self, spread_mm: float) -> float:
        """Return the expected displacement of an edge outwards.

        Parameters
        ----------
        spread_mm : float
            Widening of the edge beyond that of a sharp contact of the same shape [mm].

        Returns
        -------
        float
            [mm].
        """
        return self.per_spread * spread_mm + self.offset_mm


FILM = FilmLaw(per_spread=1.72, offset_mm=0.00035, standard_mm=0.00047)
"""Fitted to presses on other rigs: stiffness, ridges, positions, forces and voltages vary (benchmarks/film.py)."""

FILM_LIMITS_MM = {"smooth": (0.0, 0.002), "ridged": (-0.003, 0.007)}
"""Limits of the same displacement where the frame does not show the edge's own width: saturated, or scattering."""


DEPTH_MM = 7.5e-5
"""Depth of the evanescent light in a film of air [mm]: 550 to 850 nm / (4 pi sqrt(n^2 sin^2 - 1)) of light that glass
of n = 1.5 guides at 50 degrees or more and silicone of 1.4 takes up is 5e-5 to 1e-4."""

TIP_RADIUS_MM = 10.0
"""Radius of curvature of a finger's tip [mm], of 5 to 15."""

RIDGE_HEIGHT_MM = 0.05
"""Least height of a ridge [mm]: a sine of period 4 b has crests of radius 8 b^2 / (pi^2 height)."""

UNSEEN_PX = {"top": 0.4, "modelled": 1.2}
"""Limits of the displacement of an edge that saturation hides [px], by what it hides: the estimator study's greatest
errors, rounded up; on another rig they may be larger."""

NARROW_PX = {True: 0.02, False: 0.2}
"""The same of an edge between ridges or grooves narrower than the reach of the blur on either side, found by synthesis
or not. By synthesis drawn ridges 5.5 to 12 px wide, blurred by 0.8 to 1.6 px, were right to 0.006 px."""

UNRESOLVED_PX = 1.0
"""The same where synthesis came to no rest: ridges merge."""

CODEC_PX = (0.02, 100.0)
"""Greatest displacement of an edge inwards by a lossy codec [px]: the first, plus the second times the square of what a
drawn sharp contact leaves of the frame at its edge. A codec drops high frequencies of grey levels, whose tone curve
bends: to second order a contact shrinks. Of 108 drawn H.264 frames (six contacts, quantisers of 14 to 38) the edges
moved inwards by up to 0.36 px, 107 of them between none and this (benchmarks/codec_edges.py)."""

CODEC_UNKNOWN_PX = 0.1
"""The same, either way, where the frame does not show its own edge."""

EDGE_PX = 0.02
"""Limit of an edge's displacement by envelopes and the sampling of the curve [px]: sharp contacts that were drawn are
found to 0.006 px. A blur that is not symmetric moves opposite sides of a contact alike."""

INVERSION_PX = 0.5
"""The same of an edge that was found after inversion of subsurface scattering."""


def film_opening(half_width_mm: float, ridge_mm: float = 0.0) -> float:
    """Return how far outside a contact without adhesion a film of air moves its boundary.

    Beside a Hertz contact of half-width b and radius of curvature R the gap grows as (8 sqrt(2)/(3 pi)) sqrt(b) d^1.5/R
    with the distance d. Light that falls as exp(-gap/depth) adds as much as a step at the integral of that. Adhesion
    opens it more steeply: the displacement lies between none and this.

    Parameters
    ----------
    half_width_mm : float
        Of the contact or of its ridges [mm].
    ridge_mm : float
        Height of the ridges, whose crests have their own radius; 0 of the finger's tip [mm].

    Returns
    -------
    float
        [mm].

    References
    ----------
    K. L. Johnson, *Contact Mechanics* (1985), eq. 3.42.
    """
    if not half_width_mm > 0:
        return 0.0
    radius = TIP_RADIUS_MM
    if ridge_mm > 0:
        radius = min(radius, 8.0 * half_width_mm**2 / (math.pi**2 * ridge_mm))
    opening = 8.0 * math.sqrt(2.0) / (3.0 * math.pi) * math.sqrt(half_width_mm) / radius
    return math.gamma(5.0 / 3.0) * (DEPTH_MM / opening) ** (2.0 / 3.0)


def card_components(*, tolerance: float = PRINT_TOLERANCE, height_mm: float = CARD_HEIGHT_MM) -> list[Component]:
    """Return the components of the card that set the scale.

    Parameters
    ----------
    tolerance : float
        Relative tolerance of the printed length [1].
    height_mm : float
        Greatest height of the printed side over the contact plane [mm].

    Returns
    -------
    list of Component
    """
    return [
        Component(
            name="card print", role="print", low=-tolerance, high=tolerance, shape="rectangular",
            origin="printed over stated length of the card",
        ),
        Component(
            name="card height", role="height", low=0.0, high=height_mm, shape="rectangular",
            origin="printed side over the contact plane, seen through the glass",
        ),
    ]  # fmt: skip


FOCAL_OF_DRAWING = 0.05
"""Relative tolerance of a focal length that a drawing or a lens's label states."""

FOCAL_ASSUMED = 0.6
"""Relative tolerance of one over the distance where the focal length was taken as the longer side of the frame: true
for fields of view of 23 to 77 degrees along that side."""


def nearness_component(known: Literal["found", "drawing", "assumed"], found_error: float = 0.0) -> Component:
    """Return the component of the lens's distance, which only matters for the card's height.

    Parameters
    ----------
    known : {"found", "drawing", "assumed"}
        Where the focal length, and with the scale the distance, comes from: tilted boards determine it, one on the
        glass does not.
    found_error : float
        Relative standard error of a focal length that was found.

    Returns
    -------
    Component
    """
    if known == "found":
        return Component(
            name="lens distance", role="nearness", low=-found_error, high=found_error, shape="normal",
            origin="focal length, from tilted boards",
        )  # fmt: skip
    half = FOCAL_OF_DRAWING if known == "drawing" else FOCAL_ASSUMED
    origin = "focal length by the rig's drawing" if known == "drawing" else "focal length not known: an ordinary lens"
    return Component(name="lens distance", role="nearness", low=-half, high=half, shape="rectangular", origin=origin)


def refined_components(
    pixel_mm: float, scale_standard: float, *, video: bool = False, finger: Finger = "ridged",
    spread_mm: float | None = None, shape_mm: float = 0.0, narrow: float = 0.0, unseen: str = "",
    scattering: bool = False, blur_uncertainty_px: float = 0.0, colour_uncertainty_px: float = 0.0,
    film_mm: float | None = None, synthesised: bool = False, unresolved: bool = False,
    residual: float | None = None,
) -> list[Component]:  # fmt: skip
    """Return the budget of the refined estimator beyond the card.

    Parameters
    ----------
    pixel_mm : float
        Side of a pixel on the plate [mm].
    scale_standard : float
        Relative standard uncertainty of the area from the corners' scatter (tilt and distortion included) [1].
    video : bool
        Whether frames went through a lossy codec.
    finger : {"ridged", "smooth"}
        Counts where the edge's own width is not known.
    spread_mm : float, optional
        Widening of the edge beyond that of a sharp contact of the same shape [mm].
    unseen, blur_uncertainty_px, colour_uncertainty_px : str, float, float, optional
        Of :class:`~evanesce.measurement.refined.result.RefinedArea`.
    shape_mm : float
        How far outside a sharp contact of this shape the boundary runs, on average; the area is corrected for it [mm].
    narrow : float
        Share of the boundary at which ridge or groove is too narrow for an envelope [1].
    film_mm : float, optional
        Greatest mean displacement by a film (:func:`film_of_contact`), where the edge's width is not its own [mm].
    synthesised, unresolved : bool
        Of :class:`~evanesce.measurement.refined.result.RefinedArea`.
    residual : float, optional
        Of :class:`~evanesce.measurement.refined.result.RefinedArea`.
    scattering : bool
        Whether subsurface scattering was inverted.

    Returns
    -------
    list of Component
    """
    found = [
        Component(
            name="scale fit", role="scale", low=-scale_standard, high=scale_standard, shape="normal",
            origin="scatter of the board's corners, propagated through the fit of scale, tilt and distortion",
        ),
        *_film_components(pixel_mm, spread_mm, finger, film_mm),
    ]  # fmt: skip
    if shape_mm:
        origin = (
            "corners and narrow ridges that blur rounds: half of what is corrected for a sharp contact of this shape"
        )
        found.append(_boundary("shape", 0.5 * abs(shape_mm), origin))
    if narrow > 0:
        origin = "ridges or grooves too narrow to show their own light beyond the blur"
        limit = UNRESOLVED_PX if unresolved else NARROW_PX[synthesised]
        found.append(_boundary("narrow parts", limit * narrow * pixel_mm, origin))
    if scattering:
        origin = "inversion of subsurface scattering, whose length is fitted to the frame"
        found.append(_boundary("subsurface scattering", INVERSION_PX * pixel_mm, origin))
    if unseen:
        origin = "the edge is read from light beside the part that is at full scale"
        found.append(_boundary("saturated edge", UNSEEN_PX[unseen] * pixel_mm, origin))
    if blur_uncertainty_px > 0:
        origin = "displacement of the edge by the limits of the blur: the board's, or those of any camera"
        found.append(_boundary("camera's blur", blur_uncertainty_px * pixel_mm, origin))
    if colour_uncertainty_px > 0:
        origin = "demosaicing; levels between the end of one channel's range and the beginning of the next one's"
        found.append(_boundary("colour", colour_uncertainty_px * pixel_mm, origin))
    return [*found, *_codec(pixel_mm, video, residual)]


def film_of_contact(area_mm2: float, perimeter_mm: float, hull_mm2: float) -> float:
    """Return the mean of :func:`film_opening` over a contact's boundary.

    Of the boundary, a share lies on the outline, where the finger's tip opens the film: that of the outline which is in
    contact, as is that of the area. The rest are ridges, half as wide as area over perimeter.

    Parameters
    ----------
    area_mm2, perimeter_mm : float
    hull_mm2 : float
        Area of the contact's convex hull.

    Returns
    -------
    float
        [mm].
    """
    if not (perimeter_mm > 0 and hull_mm2 > 0):
        return 0.0
    radius = math.sqrt(hull_mm2 / math.pi)
    outline = min(2.0 * math.pi * radius * area_mm2 / hull_mm2 / perimeter_mm, 1.0)
    ridges = film_opening(area_mm2 / perimeter_mm, RIDGE_HEIGHT_MM)
    return outline * film_opening(radius) + (1.0 - outline) * ridges


def _boundary(name: str, half_mm: float, origin: str) -> Component:
    """Return a rectangular component of the boundary, symmetric about zero [mm]."""
    return Component(name=name, role="boundary", low=-half_mm, high=half_mm, shape="rectangular", origin=origin)


def _film_components(
    pixel_mm: float, spread_mm: float | None, finger: Finger, film_mm: float | None
) -> list[Component]:
    """Return the components of the film of air beside the contact and of the edge model.

    Whether what a sharp contact of the same shape does not show is a film's or another light's beside the contact is
    not known: the limits hold no film and the law's, each with two standard deviations of the law's residual. An edge
    that a codec or demosaicing widened does not show a film: the limits are those of its opening.
    """
    if spread_mm is not None:
        law = FILM.at(spread_mm)
        return [
            Component(
                name=FILM_NAME, role="boundary", low=min(0.0, law) - 2 * FILM.standard_mm,
                high=max(0.0, law) + 2 * FILM.standard_mm, shape="rectangular", origin="light that still couples beside"
                " the contact, none or by the width of the edge beyond that of a sharp contact of the same shape",
            )
        ]  # fmt: skip
    if film_mm is not None:
        film = Component(
            name=FILM_NAME, role="boundary", low=0.0, high=film_mm, shape="rectangular",
            origin="light that still couples beside the contact: from none to that beside a Hertz contact",
        )  # fmt: skip
        origin = "envelopes, sampling of the curve: drawn contacts are found better than that"
        return [film, _boundary("edge model", EDGE_PX * pixel_mm, origin)]
    origin = "blur that is not symmetric, envelopes, sampling of the curve: a tenth of a pixel"
    edge = _boundary("edge model", 0.1 * pixel_mm, origin)
    low, high = FILM_LIMITS_MM[finger]
    film = Component(
        name=FILM_NAME, role="boundary", low=low, high=high, shape="rectangular",
        origin="light that still couples beside the contact",
    )  # fmt: skip
    return [film, edge]


def _codec(pixel_mm: float, video: bool, residual: float | None = None) -> list[Component]:
    if not video:
        return []
    if residual is None:
        origin = "overshoot of a lossy codec at an edge: a tenth of a pixel"
        return [_boundary(CODEC_NAME, CODEC_UNKNOWN_PX * pixel_mm, origin)]
    least, squared = CODEC_PX
    return [
        Component(
            name=CODEC_NAME, role="boundary", low=-(least + squared * residual**2) * pixel_mm, high=0.0,
            shape="rectangular",
            origin="high frequencies that a lossy codec drops, by what a drawn contact leaves of the frame at its edge",
        )
    ]  # fmt: skip


def reference_components(
    pixel_mm: float, *, square_px: float, spread: float, threshold_mm: float, video: bool = False
) -> list[Component]:
    """Return the budget of the reference segmentation beyond the card.

    Parameters
    ----------
    pixel_mm : float
    square_px : float
        Side of the square card in the picture.
    spread : float
        Half the relative spread of the local scale over the undistorted view.
    threshold_mm : float
        How far the threshold's boundary lies outside the half-way one.
    video : bool
        Whether frames went through a lossy codec.

    Returns
    -------
    list of Component
    """
    edge = 2.0 * 2.0 * 0.5 / square_px  # both edges of both sides, half a pixel each
    # the half-way boundary is the better estimate: a known deviation corrects the value, by JCGM 100, 3.2.4
    away = max(0.5 * abs(threshold_mm), 0.2 * pixel_mm)
    return [
        Component(
            name="threshold on the card", role="scale", low=-edge, high=edge, shape="rectangular",
            origin="half a pixel at each edge of the square, by blur and threshold",
        ),
        Component(
            name="scale over the view", role="scale", low=-spread, high=spread, shape="rectangular",
            origin="one area per pixel for the whole undistorted view",
        ),
        Component(
            name="threshold on the contact", role="boundary", low=threshold_mm - away, high=threshold_mm + away,
            shape="rectangular", origin="distance of the threshold's boundary from the half-way one, known to a half",
        ),
        _boundary("counting", 0.1 * pixel_mm, "whole pixels, undistortion's interpolation"),
        *_codec(pixel_mm, video),
    ]  # fmt: skip
