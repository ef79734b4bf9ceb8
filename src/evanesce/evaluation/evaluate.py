"""Measure a simulated frame, compare it with its truth and split the error."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace
from typing import Any

from evanesce.chain.simulate import Omission, SimulatedFrame, expose
from evanesce.core.states import Frame
from evanesce.evaluation.compare import Comparison, compare
from evanesce.evaluation.error_split import ErrorSplit, MeasuredArea, Viewing, split
from evanesce.evaluation.labels import FrameLabels, RectifiedView, ViewGeometry, label, view_geometry
from evanesce.measurement.calibration.model import Calibration
from evanesce.measurement.calibration.rectify import Rectification, rectification
from evanesce.measurement.reference.area import Measured, measure_frame
from evanesce.measurement.reference.segment import Chain, segment
from evanesce.optics.projection import Projection
from evanesce.rig import Scene


@dataclass(frozen=True)
class Camera:
    """Calibrated and true geometry of the frames of one rig.

    Attributes
    ----------
    mm2_per_px : float
        Calibrated area of a pixel [mm^2].
    rectified : Rectification or None
        The measurement's undistortion; None where frames are taken as they are.
    geometry : ViewGeometry
        True geometry of the pixels that are measured.
    viewing, straight : Viewing
        For the split: with the measurement's undistortion, and of a camera without distortion.
    """

    mm2_per_px: float
    rectified: Rectification | None
    geometry: ViewGeometry
    viewing: Viewing
    straight: Viewing

    @classmethod
    def of(cls, scene: Scene, calibration: Calibration | None, mm2_per_px: float) -> Camera:
        """Return the geometry of a scene's frames through a calibration.

        Takes seconds: make it once for all frames of a camera.

        Parameters
        ----------
        scene : Scene
            The true rig.
        calibration : Calibration or None
            None leaves frames distorted.
        mm2_per_px : float
            Calibrated area of a pixel [mm^2].

        Returns
        -------
        Camera
        """
        projection = Projection.of(scene.camera, scene.plate)
        rectified = view = None
        if calibration is not None:
            rectified = rectification(calibration)
            view = RectifiedView(
                camera_matrix=calibration.camera_matrix,
                distortion=calibration.distortion,
                camera_matrix_new=rectified.camera_matrix_new,
                shape=rectified.shape,
            )
        geometry = view_geometry(projection, view)
        straight = replace(projection, distortion=(0.0, 0.0, 0.0, 0.0, 0.0))
        viewing = Viewing(geometry.pixel_area, None if view is None else view.maps())
        return cls(mm2_per_px, rectified, geometry, viewing, Viewing.of(straight))


@dataclass(frozen=True, kw_only=True)
class Evaluation:
    """One frame: truth, estimate, comparison and where the error comes from.

    Attributes
    ----------
    measured : Measured
    labels : FrameLabels
    comparison : Comparison
    error : ErrorSplit or None
        None where the light is not available to expose it again.
    """

    measured: Measured
    labels: FrameLabels
    comparison: Comparison
    error: ErrorSplit | None

    def row(self) -> dict[str, Any]:
        """Return the table's row, units in the keys.

        Returns
        -------
        dict
        """
        row: dict[str, Any] = {
            "true_area_mm2": self.comparison.true_area_mm2,
            "measured_area_mm2": self.comparison.area_mm2,
            "pixels": self.measured.estimate.pixels,
            "error_mm2": self.comparison.error_mm2,
            "error_percent": self.comparison.error_percent,
            "iou": self.comparison.iou,
            "boundary_displacement_um": 1e3 * self.comparison.displacement_mm.mean,
        }
        if self.error is not None:
            row["split_percent"] = {name: percent for name, _, percent in self.error.rows() if name != "total"}
        return row


def evaluate(shot: SimulatedFrame, chain: Chain, camera: Camera, *, seed: int, parts: bool = True) -> Evaluation:
    """Measure a simulated frame by the reference segmentation, compare it with the truth and split the error.

    Parameters
    ----------
    shot : SimulatedFrame
        With a contact.
    chain : Chain
        Without a crop where ``parts`` are wanted.
    camera : Camera
    seed : int
        Of the simulation, so that frames exposed again have the same noise.
    parts : bool
        False leaves the split out.

    Returns
    -------
    Evaluation

    Raises
    ------
    ValueError
        If there is no contact.
    """
    if shot.state is None:
        raise ValueError("no contact in this frame")
    measured = measure_frame(shot.frame, chain, camera.mm2_per_px, camera.rectified)
    labels = label(shot.state, camera.geometry)
    mask = measured.estimate.mask

    def retake(without: Collection[Omission]) -> Frame:
        index, time_s = shot.frame.index, shot.frame.time
        return expose(shot.scene, shot.plate_light, seed=seed, index=index, time_s=time_s, without=without)[1]

    error = None
    if parts:
        area = MeasuredArea(
            expose=retake,
            segment=lambda image: segment(image, chain).mask,
            mm2_per_px=camera.mm2_per_px,
            viewing=camera.viewing,
            straight=camera.straight,
        )
        error = split(area, shot.state.nominal_contact_area)
    return Evaluation(
        measured=measured, labels=labels, comparison=compare(mask, measured.estimate.area, labels), error=error
    )
