"""Compare a measurement with the truth of its frame, and split the error by its sources."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from evanesce.core.errors import InputError
from evanesce.evaluation.compare import Comparison
from evanesce.evaluation.compare import compare as compare_mask
from evanesce.evaluation.error_split import ErrorSplit
from evanesce.evaluation.evaluate import Camera as Viewed
from evanesce.evaluation.evaluate import evaluate
from evanesce.evaluation.labels import FrameLabels
from evanesce.measurement.reference.segment import Crop

if TYPE_CHECKING:
    from evanesce.api.camera import Shot
    from evanesce.api.measure import Measurement


def compare(measurement: Measurement, shot: Shot) -> Comparison:
    """Compare a measurement with the truth of its frame.

    Parameters
    ----------
    measurement : Measurement
        Of ``shot.frame``.
    shot : Shot

    Returns
    -------
    Comparison
        Area error [mm^2, %], intersection over union of the masks, and the displacement of the measured boundary
        from the true one [px, mm], positive outwards. The truth is carried through the measurement's own undistortion
        and crop; its area is that of the whole contact.

    Raises
    ------
    InputError
        If the measurement is of a frame of another size.

    Examples
    --------
    >>> import evanesce as ev
    >>> shot = ev.Camera(ev.coarser(ev.load("thesis"), 4)).shoot(force_N=2.0, seed=1)
    >>> found = ev.measure(shot.frame, scale_mm2_per_px=shot.scale_mm2_per_px, min_blob_px=125)
    >>> compared = ev.compare(found, shot)
    >>> round(compared.error_percent, 1), round(compared.iou, 2)
    (7.0, 0.93)
    """
    pipeline = measurement.pipeline
    undistorted = pipeline.calibration if pipeline.refined is None and pipeline.undistort else None
    labels = _cropped(shot.truth.through(undistorted), pipeline.settings.crop)
    if labels.mask.shape != measurement.mask.shape:
        raise InputError(
            f"the mask has shape {measurement.mask.shape}", key="measurement",
            allowed=f"{labels.mask.shape}: a measurement of this shot's frame",
        )  # fmt: skip
    return compare_mask(measurement.mask, measurement.area_mm2, labels)


def split_error(measurement: Measurement, shot: Shot) -> ErrorSplit:
    """Split the area error of a measurement by its sources.

    Each of scale, distortion, blur, threshold and noise is switched off in turn, the frame exposed and measured anew:
    seven exposures of light that is rendered once.

    Parameters
    ----------
    measurement : Measurement
        By the reference segmentation, without crop.
    shot : Shot
        With a contact.

    Returns
    -------
    ErrorSplit
        Parts [mm^2] that add up to the total with ``residual_mm2`` (all sources off) and ``interaction_mm2``.

    Raises
    ------
    InputError
        For the refined estimator, a crop, or a shot without contact.

    Examples
    --------
    >>> import evanesce as ev
    >>> shot = ev.Camera(ev.coarser(ev.load("thesis"), 4)).shoot(force_N=2.0, seed=1)
    >>> found = ev.measure(shot.frame, scale_mm2_per_px=shot.scale_mm2_per_px, min_blob_px=125)
    >>> split = ev.split_error(found, shot)
    >>> sorted(split.parts_mm2)
    ['blur', 'distortion', 'noise', 'scale', 'threshold']
    >>> whole = sum(split.parts_mm2.values()) + split.residual_mm2 + split.interaction_mm2
    >>> abs(whole - split.total_mm2) < 1e-9
    True
    """
    pipeline = measurement.pipeline
    if pipeline.refined is not None:
        raise InputError("refined", key="estimator", allowed="reference: the refined estimator has no threshold")
    if pipeline.settings.crop != Crop():
        raise InputError(f"{pipeline.settings.crop}", key="crop", allowed="none: the whole view is exposed anew")
    if shot.contact is None:
        raise InputError("no contact in this frame", key="shot", allowed="a shot with a contact")
    calibration = pipeline.calibration if pipeline.undistort else None
    viewed = Viewed.of(shot.scene, calibration, pipeline.scale_mm2_per_px)
    error = evaluate(shot.simulated, pipeline.settings, viewed, seed=shot.seed).error
    assert error is not None  # parts were asked for
    return error


def _cropped(labels: FrameLabels, crop: Crop) -> FrameLabels:
    state = labels.surface_state
    return replace(
        labels,
        mask=crop.apply(labels.mask),
        pressure=crop.apply(labels.pressure),
        gap=crop.apply(labels.gap),
        surface_state=None if state is None else crop.apply(state),
        pixel_area=crop.apply(labels.pixel_area),
    )
