"""Measure the contact area in frames, by the reference segmentation or by the refined estimator."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from evanesce.api.calibrate import Picture, as_image, mosaic_of
from evanesce.core import rng
from evanesce.core.errors import InputError
from evanesce.core.states import Frame
from evanesce.evaluation.camera_model import read_camera_model
from evanesce.measurement.calibration.model import Calibration, load_calibration
from evanesce.measurement.calibration.rectify import Rectification, rectification
from evanesce.measurement.io.frames import open_frames
from evanesce.measurement.io.mosaics import MosaicFormat
from evanesce.measurement.reference.area import Measured, measure_frame
from evanesce.measurement.reference.segment import Chain, Crop
from evanesce.measurement.refined.colour import CameraModel
from evanesce.measurement.refined.estimator import Estimator, refined_measured
from evanesce.measurement.refined.light import Radiometry
from evanesce.measurement.refined.raw import RawModel
from evanesce.measurement.refined.result import RefinedArea
from evanesce.measurement.uncertainty.area import corrected_for_edge, reference_uncertainty, refined_uncertainty
from evanesce.measurement.uncertainty.budget import Finger, Uncertain
from evanesce.measurement.warnings import EdgeLog, FrameLog, Warning
from evanesce.rig import Scene

EstimatorName = Literal["reference", "refined"]


def measure(frame: Picture | Frame, **options: Any) -> Measurement:
    """Measure the contact area in one frame.

    Parameters
    ----------
    frame : ndarray of uint8 (rows, cols) or (rows, cols, 3), Frame, str or Path
        As taken [DN], or an image file.
    **options
        Of :class:`Pipeline`. Either ``scale_mm2_per_px`` or ``calibration`` is needed. With a scale alone the frame
        is segmented as it is, distorted by the lens, and every pixel counts the same area. With a calibration it is
        undistorted first, and the calibration's own area of a pixel counts.

    Returns
    -------
    Measurement
        Area [mm^2] with its 95 % interval, mask and warnings.

    Raises
    ------
    InputError
        If an option is missing or out of range, or does not fit the frame.

    Notes
    -----
    For many frames make a :class:`Pipeline` once: the undistortion takes longer than the segmentation.

    Examples
    --------
    >>> import evanesce as ev
    >>> shot = ev.Camera(ev.coarser(ev.load("thesis"), 4)).shoot(force_N=2.0, seed=1)
    >>> found = ev.measure(shot.frame, scale_mm2_per_px=shot.scale_mm2_per_px, threshold=0.15, min_blob_px=125)
    >>> round(shot.truth.area_mm2, 1), round(found.area_mm2, 1)
    (18.8, 20.1)
    """
    return Pipeline(**options).measure(frame)


class Pipeline:
    """A measurement pipeline with its settings, for any number of frames of one camera.

    Parameters
    ----------
    calibration : Calibration, str or Path, optional
        Of :func:`evanesce.calibrate`, or its file. Frames are undistorted by it.
    scale_mm2_per_px : float, optional
        Area of a pixel [mm^2]; wins over the calibration's.
    threshold : float
        Grey level of the reference segmentation, 0 to 1 of full scale; brighter is contact.
    estimator : {"reference", "refined"}
        The thesis's segmentation, which counts pixels above the threshold, or the boundary half-way between the light
        on its two sides, to a fraction of a pixel; the latter needs a calibration.
    undistort : bool
        Reference only: False leaves the frame distorted although a calibration is given.
    min_blob_px : int, optional
        Minimum size of a dilated blob [px]; by default 2000 of the reference segmentation, as the thesis has it, and
        none of the refined estimator, which drops islands below 0.1 mm^2.
    blur_px : float
        Reference only: standard deviation of the Gaussian before the threshold [px].
    dilation_px : int
        Reference only: radius of the dilating disk [px].
    crop : Crop, str or tuple of slice, optional
        Rows and columns that are measured, ``"r0:r1,c0:c1"`` or ``np.s_[r0:r1, c0:c1]``: of the undistorted view, or
        of the frame where nothing is undistorted.
    dark, flat : sequence of ndarray, str or Path
        Refined only: frames with LEDs on and nothing in contact, and frames of an evenly lit target.
    tune : ndarray, str or Path, optional
        Refined only: a frame of the same finger that does not saturate, from which subsurface scattering and the
        profile of the contact's edge are estimated.
    finger : {"ridged", "smooth"}
        Refined only: the budget of a smooth finger is narrower.
    lossy : bool
        Whether the frames went through a lossy codec, which widens the interval.
    camera_model : CameraModel, RawModel, Scene, str or Path, optional
        Refined, colour frames: what the camera makes of the LEDs' light; a scene, its name or file, or a CSV with
        columns level, red, green, blue (:func:`~evanesce.evaluation.camera_model.read_camera_model`). Light is then
        read from the channels that are not clipped. A ``RawModel`` reads raw mosaics: frames that hold one, or arrays
        and files of 16 bits.

    Raises
    ------
    InputError
        If a setting is missing, out of range or belongs to the other estimator.

    Examples
    --------
    >>> import evanesce as ev
    >>> camera = ev.Camera(ev.coarser(ev.load("thesis"), 4))
    >>> pipeline = ev.Pipeline(scale_mm2_per_px=camera.scale_mm2_per_px, threshold=0.2, min_blob_px=125)
    >>> [round(found.area_mm2, 1) for found in pipeline.measure_all(shot.frame for shot in camera.shoot_all(seed=1))]
    [12.7, 19.9, 35.8]
    """

    def __init__(
        self,
        *,
        calibration: Calibration | str | Path | None = None,
        scale_mm2_per_px: float | None = None,
        threshold: float = 0.15,
        estimator: EstimatorName = "reference",
        undistort: bool = True,
        min_blob_px: int | None = None,
        blur_px: float = 1.0,
        dilation_px: int = 10,
        crop: Crop | str | tuple[slice, slice] | None = None,
        dark: Sequence[Picture] = (),
        flat: Sequence[Picture] = (),
        tune: Picture | None = None,
        finger: Finger = "ridged",
        lossy: bool = False,
        camera_model: CameraModel | RawModel | Scene | str | Path | None = None,
    ) -> None:
        self.calibration = load_calibration(calibration) if isinstance(calibration, str | Path) else calibration
        self.settings = Chain(
            threshold=threshold,
            min_blob=2000 if min_blob_px is None else min_blob_px,
            blur=blur_px,
            radius=dilation_px,
            crop=_crop(crop),
        )
        if finger not in ("ridged", "smooth"):
            raise InputError(f"{finger!r}", key="finger", allowed="'ridged', 'smooth'")
        self.finger, self.lossy = finger, lossy
        self.undistort = undistort and self.calibration is not None
        self.refined: Estimator | None = None
        if estimator == "refined":
            self.refined = self._refined(scale_mm2_per_px, dark, flat, tune, min_blob_px or 0, camera_model)
            self.scale_mm2_per_px = self.refined.plate.middle_area
        elif estimator == "reference":
            for key, given in (("dark", len(dark) > 0), ("flat", len(flat) > 0), ("tune", tune is not None),
                               ("camera_model", camera_model is not None)):  # fmt: skip
                if given:
                    raise InputError("the reference segmentation does not use it", key=key,
                                     allowed="with estimator='refined'")  # fmt: skip
            self.scale_mm2_per_px = self._scale(scale_mm2_per_px)
        else:
            raise InputError(f"{estimator!r}", key="estimator", allowed="'reference', 'refined'")
        self.estimator: EstimatorName = estimator

    def __repr__(self) -> str:
        view = "calibrated" if self.calibration is not None else "not calibrated"
        if self.refined is not None:
            return f"Pipeline(refined, {view})"
        return f"Pipeline(reference, threshold {self.settings.threshold:g}, {view})"

    def measure(self, frame: Picture | Frame, *, lossy: bool | None = None) -> Measurement:
        """Measure one frame.

        Parameters
        ----------
        frame : ndarray of uint8 (rows, cols) or (rows, cols, 3), Frame, str or Path
            As taken [DN].
        lossy : bool, optional
            Whether this frame went through a lossy codec; as for the whole pipeline by default.

        Returns
        -------
        Measurement

        Raises
        ------
        InputError
            If the frame is no 8-bit image, or calibration or crop do not fit it.
        """
        if self.mosaic is not None:
            frame = mosaic_of(frame, self.mosaic)
        if not isinstance(frame, Frame):
            frame = Frame(data=as_image(frame))
        lossy = self.lossy if lossy is None else lossy
        if self.refined is None:
            measured = measure_frame(frame, self.settings, self.scale_mm2_per_px, self.rectified)
            return Measurement(measured=measured, pipeline=self, lossy=lossy)
        read = self.refined.area(frame.data if self.mosaic is None or frame.raw is None else frame.raw)
        found = corrected_for_edge(read, self.refined, video=lossy)
        measured = refined_measured(frame, found, self.refined)
        return Measurement(measured=measured, pipeline=self, lossy=lossy, refined=found)

    def measure_all(
        self, source: Iterable[Picture | Frame] | str | Path, *, frame_rate_hz: float | None = None
    ) -> Iterator[Measurement]:
        """Measure frame after frame, holding one at a time.

        Parameters
        ----------
        source : iterable of frames, str or Path
            Frames, or a video or folder of images. Those of a video count as lossy.
        frame_rate_hz : float, optional
            Of a video or folder [Hz]; wins over the file's own. Frames that are given count from 0 s at this rate
            where they carry no time of their own.

        Yields
        ------
        Measurement

        Raises
        ------
        InputError
            If the source is not readable; a single damaged picture is left out and raised after the last one.
        """
        if isinstance(source, str | Path):
            stream = open_frames(source, frame_rate_hz, self.mosaic)
            for frame in stream:
                lossy = self.lossy or (stream.stated_rate is not None and self.mosaic is None)
                yield self.measure(frame, lossy=lossy)
            stream.finish()
            return
        for index, given in enumerate(source):
            if not isinstance(given, Frame) and self.mosaic is None:
                time = index / frame_rate_hz if frame_rate_hz else math.nan
                given = Frame(data=as_image(given), index=index, time=time)
            yield self.measure(given)

    @cached_property
    def mosaic(self) -> MosaicFormat | None:
        """Form of the frames where they are raw mosaics, else None."""
        raw = None if self.refined is None else self.refined.radiometry.raw
        if raw is None or self.calibration is None:
            return None
        cols, rows = self.calibration.image_size
        return MosaicFormat(full_DN=raw.full_DN, shape=(rows, cols))

    @cached_property
    def rectified(self) -> Rectification | None:
        """How frames are undistorted; None where they are segmented as they are."""
        if self.refined is not None or not self.undistort or self.calibration is None:
            return None
        return rectification(self.calibration)

    def _scale(self, given: float | None) -> float:
        if given is not None and not 0 < given < math.inf:
            raise InputError(f"{given}", key="scale_mm2_per_px", allowed="above 0 mm^2, finite")
        scale = given if given is not None else (self.calibration.mm2_per_px if self.calibration else None)
        if scale is None:
            where = "the calibration holds none" if self.calibration else "there is no calibration"
            raise InputError(
                f"no area per pixel was given and {where}", key="scale_mm2_per_px",
                allowed="mm^2, or a calibration with a square card",
            )  # fmt: skip
        return scale

    def _refined(
        self, scale: float | None, dark: Sequence[Picture], flat: Sequence[Picture], tune: Picture | None,
        min_blob_px: int, camera: CameraModel | RawModel | Scene | str | Path | None,
    ) -> Estimator:  # fmt: skip
        if self.calibration is None:
            raise InputError("is needed by the refined estimator", key="calibration", allowed="a calibration file")
        if scale is not None:
            raise InputError(
                f"{scale:g}", key="scale_mm2_per_px",
                allowed="none: the refined estimator takes the local scale from the calibration",
            )  # fmt: skip
        raw = camera if isinstance(camera, RawModel) else None
        if raw is not None and (len(dark) or len(flat) or tune is not None):
            raise InputError("is not used by a raw mosaic", key="dark, flat, tune", allowed="none")
        dark_shots, flat_shots = ([as_image(shot) for shot in given] for given in (dark, flat))
        model = None if isinstance(camera, RawModel) else camera
        model = model if model is None or isinstance(model, CameraModel) else read_camera_model(model)
        radiometry = Radiometry.of(self.calibration.details, dark_shots, flat_shots, model, raw)
        estimator = Estimator.of(
            self.calibration, radiometry, crop=self.settings.crop, min_blob_px=min_blob_px,
            dilation_px=self.settings.radius,
        )  # fmt: skip
        if tune is None:
            return estimator
        image, file = as_image(tune), tune if isinstance(tune, str | Path) else None
        found, allowed = estimator.area(image), "a frame of a contact that does not saturate"
        if found.unseen:
            raise InputError("the contact is at full scale", file=file, key="tune", allowed=allowed)
        if not found.contours:
            raise InputError("no contact", file=file, key="tune", allowed=allowed)
        return estimator.tuned_on(image)


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class Measurement:
    """The contact area found in one frame.

    Attributes
    ----------
    measured : Measured
        Estimate, segmentation and the view that was segmented.
    pipeline : Pipeline
        That measured it.
    lossy : bool
        Whether the frame went through a lossy codec.
    refined : RefinedArea or None
        What the refined estimator says; None of the reference segmentation.
    """

    measured: Measured
    pipeline: Pipeline
    lossy: bool = False
    refined: RefinedArea | None = None

    def __repr__(self) -> str:
        return f"Measurement(area_mm2={self.area_mm2:.4g}, {self.pixels} px, {self.pipeline.estimator})"

    @property
    def area_mm2(self) -> float:
        """Contact area [mm^2]."""
        return self.measured.estimate.area

    @property
    def interval_mm2(self) -> tuple[float, float]:
        """95 % interval of the area (low, high) [mm^2], from the budget in :attr:`uncertainty`."""
        return self.uncertainty.interval_mm2

    @property
    def mask(self) -> NDArray[np.bool_]:
        """Segmented contact, (rows, cols) of :attr:`view`."""
        return self.measured.estimate.mask

    @property
    def pixels(self) -> int:
        """Pixels of the mask."""
        return self.measured.estimate.pixels

    @property
    def view(self) -> NDArray[np.uint8]:
        """What was measured [DN]: the frame, undistorted by a calibration (reference segmentation), cropped."""
        return self.measured.view

    @property
    def contours_px(self) -> list[NDArray[np.float64]]:
        """Boundary of the contact as (n, 2) arrays of (x, y) [px] in the frame as taken; refined estimator only."""
        return [] if self.refined is None else self.refined.contours

    @property
    def index(self) -> int:
        """Number of the frame."""
        return self.measured.estimate.index

    @property
    def time_s(self) -> float:
        """Time of the frame [s]; NaN where it is not known."""
        return self.measured.estimate.time

    @cached_property
    def uncertainty(self) -> Uncertain:
        """The area's uncertainty: standard uncertainty [mm^2], intervals, and what each component contributes."""
        pipeline, draws = self.pipeline, rng.generator(0, "uncertainty", self.index)
        if self.refined is not None and pipeline.refined is not None:
            return refined_uncertainty(
                self.refined, pipeline.refined, draws, video=self.lossy, finger=pipeline.finger,
            )  # fmt: skip
        return reference_uncertainty(
            self.measured, pipeline.scale_mm2_per_px, pipeline.calibration, draws, video=self.lossy
        )

    @cached_property
    def warnings(self) -> tuple[Warning, ...]:
        """What may spoil this measurement, with the figures behind it: saturation, a cut mask, an idle threshold."""
        if self.refined is None:
            log = FrameLog(self.pipeline.settings.threshold)
            log.add(self.measured.figures)
            return tuple(log.warnings())
        assert self.pipeline.refined is not None  # it measured this frame
        edges = EdgeLog(blur_known=self.pipeline.refined.settings.blur.origin != "nominal")
        edges.add(self.index, self.refined.unseen, self.refined.colour_unread, self.refined.unresolved)
        return tuple(edges.warnings(1))


def _crop(given: Crop | str | tuple[slice, slice] | None) -> Crop:
    if given is None:
        return Crop()
    if isinstance(given, Crop):
        return given
    if isinstance(given, str):
        return Crop.parse(given)
    rows, cols = given
    bounds = (rows.start, rows.stop, cols.start, cols.stop)
    if rows.step or cols.step or any(n is not None and n < 0 for n in bounds):
        raise InputError(f"{given}", key="crop", allowed="slices without step, from 0")
    return Crop(rows.start or 0, rows.stop, cols.start or 0, cols.stop)
