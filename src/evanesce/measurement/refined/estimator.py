"""Refined contact area, to a fraction of a pixel, from frames and the rig's own calibration; no ground truth enters.

The steps: grey level to linear light (:mod:`.light`); glow inside the silicone taken back to where it entered
(:mod:`.subsurface`); boundary half-way between the light on its two sides (:mod:`.edge`); what saturates, put
in from the light that does not; and the curve carried onto the plate point by point (:mod:`.plate`), so that
there is no single area per pixel. Frames are read as taken: nothing is resampled.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from evanesce.core.errors import InputError
from evanesce.core.states import Estimate, Frame
from evanesce.measurement.calibration.model import Calibration
from evanesce.measurement.reference.area import Measured
from evanesce.measurement.reference.segment import Crop, Segmentation
from evanesce.measurement.refined.blur import Blur
from evanesce.measurement.refined.edge import (
    Boundary,
    EdgeSettings,
    coarse_mask,
    edge_spread,
    find_boundary,
    half_contours,
)
from evanesce.measurement.refined.light import Radiometry
from evanesce.measurement.refined.plate import PlateMap
from evanesce.measurement.refined.saturation import (
    contact_edge,
    contact_within,
    doubt_of_edge,
    filled_by,
    lies_within,
    shift_of_edge,
)
from evanesce.measurement.refined.subsurface import Walk, entered, find_walk

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]
Unseen = Literal["", "top", "modelled"]

PLAIN_MARGIN_PX = 60
GLOW_MARGIN_PX = 260
GLOW_REACH_PX = 200.0
GLOW_SMOOTHING_PX = 1.5
FILL_ROUNDS = 4
BLURS_TRIED = 7
"""Within the limits of the camera's blur, to see how far a saturated edge depends on it."""

SATURATED_SHARE = 0.02
"""Of the contact's pixels: up to here noise takes single pixels to the top, which are read as they are."""

SATURATED_LEVEL = 0.8
"""Light at which the edge of a saturated contact is read: the highest that noise keeps from the top."""


@dataclass(frozen=True, kw_only=True)
class Settings:
    """What the estimator may be told.

    Attributes
    ----------
    edge : EdgeSettings
    blur : Blur
        Of the camera; only saturated frames need it.
    least_step : float
        Light of contact over the background, of full scale, below which nothing touches.
    least_area_mm2 : float
        Smaller islands are specks.
    walk : Walk, optional
        Of the light in this finger's silicone; looked for in each frame that does not saturate if not given.
    crop : Crop
        In the frame as taken.
    """

    edge: EdgeSettings = field(default_factory=EdgeSettings)
    blur: Blur = field(default_factory=Blur)
    least_step: float = 0.01
    least_area_mm2: float = 0.1
    walk: Walk | None = None
    crop: Crop = field(default_factory=Crop)


@dataclass(frozen=True, kw_only=True)
class RefinedArea:
    """What the estimator says of one frame.

    Attributes
    ----------
    area_mm2, perimeter_mm : float
        Of the contact and of its boundary.
    contours : list of ndarray (n, 2)
        (x, y) in the frame as taken [px]; holes run the other way round.
    mask : ndarray of bool (rows, cols)
        Of the crop.
    walk : Walk
    saturated_pixels : int
    islands, dropped : int
        Parts of the contact, and those too small to be it.
    step : float
        Median light of contact over what is beside it, of full scale.
    spread_mm : float, optional
        How much wider the edge is than at its median (:func:`.edge_spread`); None where it is not the
        frame's own: saturated, or after light's walk was turned round.
    unseen : {"", "top", "modelled"}
        What saturation hides of the edge: nothing; its top, so that its foot was read; more, under glow, so that the
        saturated part was put in by a model.
    blur_doubt_px : float
        How far the boundary would move by the limits of the camera's blur [px]; 0 where the edge does not need it.
    """

    area_mm2: float
    perimeter_mm: float
    contours: list[Floats]
    mask: Mask
    walk: Walk
    saturated_pixels: int
    islands: int
    dropped: int
    step: float
    spread_mm: float | None = None
    unseen: Unseen = ""
    blur_doubt_px: float = 0.0


@dataclass(frozen=True, kw_only=True)
class Estimator:
    """The estimator with the rig's calibration; made once for all frames.

    Attributes
    ----------
    plate : PlateMap
    radiometry : Radiometry
    settings : Settings
    """

    plate: PlateMap
    radiometry: Radiometry
    settings: Settings = field(default_factory=Settings)

    @classmethod
    def of(cls, calibration: Calibration, radiometry: Radiometry | None = None, **settings: Any) -> Estimator:
        """Return the estimator of a calibration; keywords go to :class:`Settings`.

        ``blur_px`` states the camera's blur; without it (or ``blur``) it is what the calibration's board shows.

        Raises
        ------
        InputError
            If the calibration tells no scale, or its tone curve or blur is not valid.
        """
        if radiometry is None:
            radiometry = Radiometry.of(calibration.details)
        plate = PlateMap.of(calibration)
        if "blur_px" in settings:
            settings["blur"] = Blur.stated(settings.pop("blur_px"))
        elif "blur" not in settings:
            settings["blur"] = Blur.of(calibration.details, radiometry.tone, plate.view)
        return cls(plate=plate, radiometry=radiometry, settings=Settings(**settings))

    def taught(self, image: NDArray[np.uint8]) -> Estimator:
        """Return the estimator that has learnt how far light walks in this finger, and how it rises across the edge.

        The edge is learnt where light does not walk: a film of air beside the contact widens it beyond the blur.

        Parameters
        ----------
        image : ndarray of uint8, (rows, cols) or (rows, cols, 3)
            Unsaturated [DN].
        """
        found = self.area(image)
        blur = self.settings.blur
        if found.contours and not found.unseen and not found.walk.length_px:
            light = self.settings.crop.apply(self.radiometry.light(image)[0])
            window = _window(found.mask, PLAIN_MARGIN_PX)
            boundary = find_boundary(light[window], found.mask[window], self.settings.edge)
            blur = replace(blur, response=contact_edge(light[window], boundary, self.settings.edge) or blur.response)
        return replace(self, settings=replace(self.settings, walk=found.walk, blur=blur))

    def area(self, image: NDArray[np.uint8]) -> RefinedArea:
        """Measure one frame.

        Parameters
        ----------
        image : ndarray of uint8, (rows, cols) or (rows, cols, 3)
            As taken, not undistorted [DN].

        Raises
        ------
        InputError
            If the frame does not fit the calibration or the crop.
        """
        cols, rows = self.plate.calibration.image_size
        if image.shape[:2] != (rows, cols):
            raise InputError(
                f"the frame is {image.shape[1]} x {image.shape[0]} pixels, the calibration holds for {cols} x {rows}",
                key="--calibration",
                allowed="frames of the size that was calibrated",
            )
        light, full = self.radiometry.light(image)
        crop = self.settings.crop
        light, full = crop.apply(light), crop.apply(full)
        coarse = coarse_mask(light, self.settings.least_step)
        if coarse is None:
            return self._nothing(light.shape, full)
        coarse, dropped = self._without_specks(coarse, (crop.r0, crop.c0))
        if not coarse.any():
            return replace(self._nothing(light.shape, full), dropped=dropped)
        return replace(self._contact(light, full, coarse), dropped=dropped)

    def _nothing(self, shape: tuple[int, ...], full: Mask) -> RefinedArea:
        return RefinedArea(
            area_mm2=0.0, perimeter_mm=0.0, contours=[], mask=np.zeros(shape, np.bool_),
            walk=self.settings.walk or Walk(), saturated_pixels=int(full.sum()), islands=0, dropped=0, step=0.0,
        )  # fmt: skip

    def _without_specks(self, mask: Mask, origin: tuple[int, int]) -> tuple[Mask, int]:
        """Drop islands below the least area; return the rest and their number."""
        labels, count = ndimage.label(mask, np.ones((3, 3)))
        if not count:
            return mask, 0
        sizes = np.bincount(labels.ravel(), minlength=count + 1)[1:]
        middles = np.array(ndimage.center_of_mass(mask, labels, np.arange(1, count + 1)))[:, ::-1] + origin[::-1]
        keep = sizes * self.plate.pixel_area(middles) >= self.settings.least_area_mm2
        return np.asarray(np.concatenate([[False], keep])[labels]), int((~keep).sum())

    def _contact(self, light: Floats, full: Mask, coarse: Mask) -> RefinedArea:
        settings = self.settings
        saturated = bool((full & coarse).sum() > SATURATED_SHARE * coarse.sum())
        wide = _window(coarse, GLOW_MARGIN_PX)
        walk = settings.walk
        if walk is None:
            walk = Walk() if saturated else self._find_walk(light[wide], coarse[wide])
        window = _window(coarse, GLOW_MARGIN_PX if walk.length_px else PLAIN_MARGIN_PX)
        local, first = light[window], coarse[window]
        inward = doubt = 0.0
        unseen: Unseen = ""
        if walk.length_px:
            boundary = self._under_glow(local, full[window] if saturated else None, first, walk)
            if saturated:
                unseen, doubt = "modelled", 0.5 * (settings.blur.high_px - settings.blur.low_px)
        elif saturated:
            inward, doubt, boundary = self._saturated_edge(local, full[window])
            unseen = "top"
        else:
            boundary = find_boundary(local, first, settings.edge)
        found = replace(
            self._measured(boundary, window, light.shape, full, walk, inward), unseen=unseen, blur_doubt_px=doubt
        )
        if walk.length_px or saturated or not found.contours:
            return found
        side = np.sqrt(self.plate.pixel_area(np.concatenate(found.contours)).mean())
        return replace(found, spread_mm=edge_spread(boundary) * float(side))

    def _find_walk(self, light: Floats, mask: Mask) -> Walk:
        """Look for the walk twice: the first contact is too large where grooves glow."""
        walk = find_walk(light, mask, reach_px=GLOW_REACH_PX)
        if not walk.length_px:
            return walk
        return find_walk(light, self._under_glow(light, None, mask, walk).level > 0.5, reach_px=GLOW_REACH_PX)

    def _under_glow(self, light: Floats, full: Mask | None, mask: Mask, walk: Walk) -> Boundary:
        """Find the boundary in the light that entered; what saturates is put in by what the contact would make."""
        edge = replace(self.settings.edge, smoothing_px=0.3)
        if full is None:
            source = entered(light, walk, GLOW_SMOOTHING_PX)
            first = coarse_mask(source, 0.0)
            return find_boundary(source, mask if first is None else first, edge)
        full = cv2.dilate(full.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
        start = coarse_mask(entered(light, walk, GLOW_SMOOTHING_PX), 0.0)
        mask = light > SATURATED_LEVEL if start is None else start
        for _ in range(FILL_ROUNDS):
            filled = filled_by(light, full, mask, walk, self.settings.blur.px)
            found = find_boundary(entered(filled, walk, GLOW_SMOOTHING_PX), mask, replace(edge, rounds=2))
            mask = found.level > 0.5
        if not lies_within(mask, full):
            return found
        return contact_within(light, full, walk, self.settings.blur.px)

    def _saturated_edge(self, light: Floats, full: Mask) -> tuple[float, float, Boundary]:
        """Return how far inwards of a fixed level the half-way point lies, how far by the blur's limits it may lie
        elsewhere [px], and the curve at that level."""
        level = cv2.GaussianBlur(light, (0, 0), self.settings.edge.smoothing_px) / (2 * SATURATED_LEVEL)
        boundary = Boundary(contours=half_contours(level), level=level, step=np.full(light.shape, 1.0))
        blur = self.settings.blur
        blurs = [blur.px, *np.geomspace(blur.low_px, blur.high_px, BLURS_TRIED)]
        tried = shift_of_edge(light, full, boundary, SATURATED_LEVEL, blur, blurs)
        return float(tried[0, 0]), doubt_of_edge(tried), boundary

    def _measured(
        self,
        boundary: Boundary,
        window: tuple[slice, slice],
        shape: tuple[int, ...],
        full: Mask,
        walk: Walk,
        inward_px: float,
    ) -> RefinedArea:
        crop = self.settings.crop
        mask = np.zeros(shape, np.bool_)
        mask[window] = boundary.level > 0.5
        _, islands = ndimage.label(mask, np.ones((3, 3)))
        origin = np.array([window[1].start + crop.c0, window[0].start + crop.r0])
        contours = [contour + origin for contour in boundary.contours]
        on_plate = [self.plate.to_plate(contour) for contour in contours]
        contours = [c for c, p in zip(contours, on_plate, strict=True) if len(p) > 3]
        perimeter = sum(float(np.linalg.norm(np.diff(p, axis=0), axis=1).sum()) for p in on_plate)
        area = self.plate.area(contours)
        if inward_px and contours:  # to first order a curve moved along its normal changes area by length times way
            side = np.sqrt(self.plate.pixel_area(np.concatenate(contours)).mean())
            area -= perimeter * inward_px * float(side)
        inside = boundary.level > 0.5
        return RefinedArea(
            area_mm2=max(area, 0.0), perimeter_mm=perimeter, contours=contours, mask=mask, walk=walk,
            saturated_pixels=int((full & mask).sum()), islands=islands, dropped=0,
            step=float(np.median(boundary.step[inside])) if inside.any() else 0.0,
        )  # fmt: skip


def _window(mask: Mask, margin: int) -> tuple[slice, slice]:
    rows, cols = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    return (
        slice(max(0, rows[0] - margin), min(mask.shape[0], rows[-1] + margin + 1)),
        slice(max(0, cols[0] - margin), min(mask.shape[1], cols[-1] + margin + 1)),
    )


def refined_measured(frame: Frame, found: RefinedArea, estimator: Estimator) -> Measured:
    """Return what was found in the form of the reference segmentation; the view is the frame as taken, cropped."""
    view = estimator.settings.crop.apply(frame.data)
    levels = view if view.ndim == 2 else view.max(axis=2)
    pixels = int(found.mask.sum())
    estimate = Estimate(mask=found.mask, pixels=pixels, area=found.area_mm2, time=frame.time, index=frame.index)
    segmentation = Segmentation(
        mask=found.mask, dilated=found.mask, pixels=pixels, blobs=found.islands, dropped_blobs=found.dropped,
        grey_range=(float(levels.min()) / 255, float(levels.max()) / 255),
    )  # fmt: skip
    return Measured(estimate=estimate, segmentation=segmentation, view=view)
