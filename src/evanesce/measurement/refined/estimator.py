"""Refined contact area, to a fraction of a pixel, from frames and the rig's own calibration.

Steps: grey level to linear light (:mod:`~evanesce.measurement.refined.light`); subsurface scattering inverted
(:mod:`~evanesce.measurement.refined.subsurface`); boundary half-way between the light on its two sides
(:mod:`~evanesce.measurement.refined.edge`); saturated parts replaced by a model fitted to the unsaturated light
(:mod:`~evanesce.measurement.refined.saturation`); curve mapped onto the plate point by point
(:mod:`~evanesce.measurement.refined.plate`), so that there is no single area per pixel. Frames are not resampled.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from evanesce.core.errors import InputError
from evanesce.core.states import Estimate, Frame
from evanesce.measurement.calibration.model import Calibration
from evanesce.measurement.reference.area import Measured
from evanesce.measurement.reference.blobs import large_blobs
from evanesce.measurement.reference.segment import Crop, Segmentation
from evanesce.measurement.refined.blur import Blur
from evanesce.measurement.refined.demosaicing import demosaicing_shift
from evanesce.measurement.refined.edge import (
    Boundary,
    EdgeSettings,
    coarse_mask,
    edge_spread,
    find_boundary,
    half_contours,
    narrow_share,
)
from evanesce.measurement.refined.light import Radiometry
from evanesce.measurement.refined.plate import PlateMap
from evanesce.measurement.refined.raw import MOSAIC_PX
from evanesce.measurement.refined.replica import edge_blur, replica
from evanesce.measurement.refined.result import RefinedArea, Unseen
from evanesce.measurement.refined.saturation import (
    contact_edge,
    contact_within,
    edge_uncertainty,
    filled_by,
    lies_within,
    shift_of_edge,
)
from evanesce.measurement.refined.specks import filled, without_specks
from evanesce.measurement.refined.subsurface import Scattering, entered, find_scattering
from evanesce.measurement.refined.synthesis import NARROW_SHARE, synthesised

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

PLAIN_MARGIN_PX = 60
SCATTERING_MARGIN_PX = 260
SCATTERING_REACH_PX = 200.0
SCATTERING_SMOOTHING_PX = 1.5
FILL_ROUNDS = 4
BLURS_TRIED = 7
"""Blurs within the camera's limits by which the dependence of a saturated edge on the blur is estimated."""

SATURATED_SHARE = 0.02
"""Of the contact's pixels: up to here noise saturates single pixels, which are read as they are."""

GROUND_PERCENTILE = 5.0
"""Of the light of a frame without a dark frame: what is taken for the light without contact."""

EDGE_BLUR = 0.2
"""Relative half-width of a blur that is read from the contact's own edges, where the camera's is not known."""

SATURATED_LEVEL = 0.8
"""Light at which the edge of a saturated contact is read: the highest that noise does not saturate."""


@dataclass(frozen=True, kw_only=True)
class Settings:
    """Settings of the estimator.

    Attributes
    ----------
    edge : EdgeSettings
    blur : Blur
        Of the camera; only saturated frames need it.
    min_step : float
        Light of contact over the background, of full scale, below which there is no contact.
    min_area_mm2 : float
        Smaller islands are specks, where there is no minimum size of a blob.
    scattering : Scattering, optional
        Of this finger's silicone; fitted to each frame that does not saturate if not given.
    min_blob_px : int
        Minimum size of an island after dilation by a disk, as the reference segmentation has it [px]; 0 for none.
    dilation_px : int
        Radius of that disk [px].
    crop : Crop
        In the frame as taken.
    """

    edge: EdgeSettings = field(default_factory=EdgeSettings)
    blur: Blur = field(default_factory=Blur)
    min_step: float = 0.01
    min_area_mm2: float = 0.1
    scattering: Scattering | None = None
    min_blob_px: int = 0
    dilation_px: int = 10
    crop: Crop = field(default_factory=Crop)


@dataclass(frozen=True, kw_only=True)
class Estimator:
    """Refined area estimator with the rig's calibration; made once for all frames.

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
        """Return the estimator of a calibration; keywords go to :class:`Settings`, ``blur_px`` is the camera's blur.

        Parameters
        ----------
        calibration : Calibration
        radiometry : Radiometry, optional
            From the calibration's tone curve by default.
        **settings
            Of :class:`Settings`; ``blur_px`` [px], by default what the calibration's board shows.

        Returns
        -------
        Estimator

        Raises
        ------
        InputError
            If the calibration holds no scale, or its tone curve or blur is not valid.
        """
        if radiometry is None:
            radiometry = Radiometry.of(calibration.details)
        plate = PlateMap.of(calibration)
        if "blur_px" in settings:
            settings["blur"] = Blur.stated(settings.pop("blur_px"))
        elif "blur" not in settings:
            settings["blur"] = Blur.of(
                calibration.details, radiometry.tone, plate.view, colour=radiometry.camera is not None
            )
        return cls(plate=plate, radiometry=radiometry, settings=Settings(**settings))

    def tuned_on(self, image: NDArray[np.uint8]) -> Estimator:
        """Return the estimator with scattering and edge profile fitted to a frame of the same finger.

        The edge profile is fitted where there is no scattering: a film of air beside the contact widens it beyond the
        blur.

        Parameters
        ----------
        image : ndarray of uint8, (rows, cols) or (rows, cols, 3)
            Unsaturated [DN].

        Returns
        -------
        Estimator
        """
        found = self.area(image)
        blur = self.settings.blur
        if found.contours and not found.unseen and not found.scattering.length_px:
            light = self.settings.crop.apply(self.radiometry.light(image)[0])
            window = _window(found.mask, PLAIN_MARGIN_PX)
            boundary = find_boundary(light[window], found.mask[window], self.settings.edge)
            blur = replace(blur, response=contact_edge(light[window], boundary, self.settings.edge) or blur.response)
        return replace(self, settings=replace(self.settings, scattering=found.scattering, blur=blur))

    def area(self, image: NDArray[np.uint8] | NDArray[np.uint16]) -> RefinedArea:
        """Measure one frame.

        Parameters
        ----------
        image : ndarray of uint8, (rows, cols) or (rows, cols, 3), or of uint16 (rows, cols)
            As taken, not undistorted [DN]; of 16 bits a raw mosaic, where the radiometry reads those.

        Returns
        -------
        RefinedArea

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
        found, camera = self._area(image), self.radiometry.camera
        if image.dtype == np.uint16:
            return replace(found, mosaic=True, colour_uncertainty_px=MOSAIC_PX if found.contours else 0.0)
        levels = image if image.ndim == 2 else image.max(axis=2)
        found = replace(found, ground=float(self.radiometry.tone[int(np.median(levels))]))
        if camera is None or image.ndim == 2 or not found.contours:
            return replace(found, colour_unread=self.radiometry.leaves_colour(image))
        view = self.settings.crop.apply(image)
        unsure = camera.edge_uncertainty(view, found.mask, self.settings.blur.px, seen=not found.unseen)
        found = replace(found, colour_uncertainty_px=unsure, colour_misfit_DN=camera.misfit(view, found.mask))
        if found.unseen or found.scattering.length_px:  # the half-way point was not read from colours
            return found
        shift = demosaicing_shift(camera, *camera.sides(view, found.mask), self.settings.blur.px)
        # the correction is taken to be known to a half
        found = replace(found, colour_shift_px=shift, colour_uncertainty_px=unsure + 0.5 * abs(shift))
        return self._displaced(found, shift)

    def _area(self, image: NDArray[np.uint8] | NDArray[np.uint16]) -> RefinedArea:
        light, full = self.radiometry.light(image)
        crop = self.settings.crop
        light, full = crop.apply(light), crop.apply(full)
        if not isinstance(self.radiometry.dark, np.ndarray):  # else the scattered light would seem to have no end
            light = light - np.percentile(light, GROUND_PERCENTILE)
        coarse = coarse_mask(light, self.settings.min_step * self.radiometry.first_full(image))
        if coarse is None:
            return self._nothing(light.shape, full)
        bright = coarse
        settings = self.settings
        if settings.min_blob_px:
            blobs = large_blobs(bright, settings.dilation_px, settings.min_blob_px)
            coarse, dropped = bright & blobs.dilated, blobs.dropped
        else:
            coarse, dropped = without_specks(
                bright, self.plate, settings.min_area_mm2, settings.dilation_px, (crop.r0, crop.c0)
            )
        if not coarse.any():
            return replace(self._nothing(light.shape, full), dropped=dropped)
        if dropped:
            light = filled(light, bright & ~coarse)
        return replace(self._contact(light, full, coarse), dropped=dropped)

    def _nothing(self, shape: tuple[int, ...], full: Mask) -> RefinedArea:
        return RefinedArea(
            area_mm2=0.0, perimeter_mm=0.0, contours=[], mask=np.zeros(shape, np.bool_),
            scattering=self.settings.scattering or Scattering(), saturated_pixels=int(full.sum()), islands=0, dropped=0,
            step=0.0,
        )  # fmt: skip

    def _contact(self, light: Floats, full: Mask, coarse: Mask) -> RefinedArea:
        settings = self.settings
        saturated = bool((full & coarse).sum() > SATURATED_SHARE * coarse.sum())
        wide = _window(coarse, SCATTERING_MARGIN_PX)
        scattering = settings.scattering
        if scattering is None:
            scattering = Scattering() if saturated else self._find_scattering(light[wide], coarse[wide])
        window = _window(coarse, SCATTERING_MARGIN_PX if scattering.length_px else PLAIN_MARGIN_PX)
        local, first = light[window], coarse[window]
        inward = uncertainty = 0.0
        unseen: Unseen = ""
        if scattering.length_px:
            boundary = self._without_scattering(local, full[window] if saturated else None, first, scattering)
            if saturated:
                unseen, uncertainty = "modelled", 0.5 * (settings.blur.high_px - settings.blur.low_px)
        elif saturated:
            inward, uncertainty, boundary = self._saturated_edge(local, full[window])
            unseen = "top"
        else:
            boundary = find_boundary(local, first, settings.edge)
        found = replace(
            self._measured(boundary, window, light.shape, full, scattering, inward),
            unseen=unseen,
            blur_uncertainty_px=uncertainty,
        )
        if scattering.length_px or saturated or not found.contours:
            return found
        side = np.sqrt(self.plate.pixel_area(np.concatenate(found.contours)).mean())
        again, narrow = replica(local, boundary, settings.edge), narrow_share(boundary, settings.edge)
        gain = 0.0 if again is None else again.gain
        found = replace(
            found,
            edge_px=edge_blur(boundary, settings.edge),
            spread_mm=edge_spread(boundary) * float(side),
            sharp_spread_mm=None if again is None else again.spread_px * float(side),
            narrow_share=narrow,
            residual=None if again is None else again.residual,
        )
        if narrow > NARROW_SHARE:
            return self._narrow(local, boundary, window, found, full)
        return replace(found, area_mm2=found.area_mm2 / (1.0 + gain), shape_gain=gain)

    def _narrow(
        self, light: Floats, boundary: Boundary, window: tuple[slice, slice], found: RefinedArea, full: Mask
    ) -> RefinedArea:
        """Return an area whose narrow ridges and grooves are found by synthesis, at the blur and at its limits."""
        blur = self.settings.blur
        px, low, high = blur.px, blur.low_px, blur.high_px
        if blur.origin == "nominal":
            px = edge_blur(boundary, self.settings.edge)
            low, high = (1.0 - EDGE_BLUR) * px, (1.0 + EDGE_BLUR) * px
        best = synthesised(light, boundary, px, self.settings.edge)
        wide = synthesised(light, best.boundary, high, self.settings.edge)
        moved = self._measured(best.boundary, window, found.mask.shape, full, found.scattering, 0.0)
        if not moved.contours:
            return found
        other = self._measured(wide.boundary, window, found.mask.shape, full, found.scattering, 0.0)
        side = float(np.sqrt(self.plate.pixel_area(np.concatenate(moved.contours)).mean()))
        # the area changes by the blur almost linearly between its limits
        slope = (other.area_mm2 - moved.area_mm2) / (high - px) / moved.perimeter_mm / side
        return replace(
            moved,
            edge_px=found.edge_px,
            spread_mm=found.spread_mm,
            sharp_spread_mm=found.sharp_spread_mm,
            narrow_share=found.narrow_share,
            synthesised=True,
            unresolved=not best.rests,
            residual=best.residual,
            blur_uncertainty_px=abs(slope) * 0.5 * (high - low),
        )

    def _find_scattering(self, light: Floats, mask: Mask) -> Scattering:
        """Fit the scattering twice: the first contact is too large where light is scattered into grooves."""
        scattering = find_scattering(light, mask, reach_px=SCATTERING_REACH_PX)
        if not scattering.length_px:
            return scattering
        return find_scattering(
            light, self._without_scattering(light, None, mask, scattering).level > 0.5, reach_px=SCATTERING_REACH_PX
        )

    def _without_scattering(self, light: Floats, full: Mask | None, mask: Mask, scattering: Scattering) -> Boundary:
        """Find the boundary in the light that entered; saturated parts are replaced by the light of the contact."""
        edge = replace(self.settings.edge, smoothing_px=0.3)
        if full is None:
            source = entered(light, scattering, SCATTERING_SMOOTHING_PX)
            first = coarse_mask(source, 0.0)
            return find_boundary(source, mask if first is None else first, edge)
        full = cv2.dilate(full.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
        start = coarse_mask(entered(light, scattering, SCATTERING_SMOOTHING_PX), 0.0)
        mask = light > SATURATED_LEVEL if start is None else start
        for _ in range(FILL_ROUNDS):
            filled = filled_by(light, full, mask, scattering, self.settings.blur.px)
            found = find_boundary(entered(filled, scattering, SCATTERING_SMOOTHING_PX), mask, replace(edge, rounds=2))
            mask = found.level > 0.5
        if not lies_within(mask, full):
            return found
        return contact_within(light, full, scattering, self.settings.blur.px)

    def _saturated_edge(self, light: Floats, full: Mask) -> tuple[float, float, Boundary]:
        """Return how far inside a fixed level the half-way point lies and its uncertainty by the blur's limits [px],
        and the curve at that level."""
        level = cv2.GaussianBlur(light, (0, 0), self.settings.edge.smoothing_px) / (2 * SATURATED_LEVEL)
        boundary = Boundary(contours=half_contours(level), level=level, step=np.full(light.shape, 1.0))
        blur = self.settings.blur
        blurs = [blur.px, *np.geomspace(blur.low_px, blur.high_px, BLURS_TRIED)]
        tried = shift_of_edge(light, full, boundary, SATURATED_LEVEL, blur, blurs)
        return float(tried[0, 0]), edge_uncertainty(tried), boundary

    def _side(self, contours: list[Floats]) -> float:
        """Return the side of a pixel at a boundary [mm]."""
        return float(np.sqrt(self.plate.pixel_area(np.concatenate(contours)).mean()))

    def _displaced(self, found: RefinedArea, outward_px: float) -> RefinedArea:
        """Return an area without a displacement of its boundary."""
        moved = found.area_mm2 - found.perimeter_mm * outward_px * self._side(found.contours)
        return replace(found, area_mm2=max(moved, 0.0))

    def _measured(
        self,
        boundary: Boundary,
        window: tuple[slice, slice],
        shape: tuple[int, ...],
        full: Mask,
        scattering: Scattering,
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
        # to first order a curve displaced along its normal changes area by length times displacement
        if inward_px and contours:
            area -= perimeter * inward_px * self._side(contours)
        inside = mask[window]
        return RefinedArea(
            area_mm2=max(area, 0.0), perimeter_mm=perimeter, contours=contours, mask=mask, scattering=scattering,
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
    """Return a refined area in the form of the reference segmentation's result.

    Parameters
    ----------
    frame : Frame
    found : RefinedArea
        Of that frame.
    estimator : Estimator

    Returns
    -------
    Measured
        Its view is the frame as taken, cropped.
    """
    view = estimator.settings.crop.apply(frame.data)
    levels = view if view.ndim == 2 else view.max(axis=2)
    pixels = int(found.mask.sum())
    estimate = Estimate(mask=found.mask, pixels=pixels, area=found.area_mm2, time=frame.time, index=frame.index)
    segmentation = Segmentation(
        mask=found.mask, dilated=found.mask, pixels=pixels, blobs=found.islands, dropped_blobs=found.dropped,
        grey_range=(float(levels.min()) / 255, float(levels.max()) / 255),
    )  # fmt: skip
    return Measured(estimate=estimate, segmentation=segmentation, view=view)
