"""Measurement of a simulated frame with the calibration that a lab would have: printed cards with their errors."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from evanesce.core import rng
from evanesce.core.errors import InputError, WorkError
from evanesce.core.states import Frame
from evanesce.design.question import Design, Question
from evanesce.design.uncertainty import Draw
from evanesce.evaluation.calibrated_rig import CardErrors, calibrated, drawn_corners
from evanesce.measurement.calibration.model import Calibration
from evanesce.measurement.calibration.rectify import Rectification, rectification, undistort_points
from evanesce.measurement.reference.area import measure_frame
from evanesce.measurement.reference.segment import Crop
from evanesce.measurement.refined.estimator import Estimator
from evanesce.optics.projection import Projection
from evanesce.rig import Scene

Floats = NDArray[np.float64]

BLUR_PX = 1.13
"""Blur of the camera that the refined estimator assumes, at full resolution."""


@contextmanager
def as_infeasible(what: str) -> Iterator[None]:
    """Report a solver that fails as an infeasible rig: solvers write nothing, so that no disk is the cause."""
    try:
        yield
    except WorkError as error:
        raise InputError(f"{what}: {error}") from None


@dataclass(frozen=True)
class CalibratedMeasurement:
    """Measurement by the calibration of a design's camera.

    Attributes
    ----------
    design : Design
    question : Question
    nominal : Calibration
        By cards without error, of the camera that takes the frames.
    view : Rectification
    """

    design: Design
    question: Question
    nominal: Calibration
    view: Rectification

    @classmethod
    def of(cls, design: Design, question: Question, camera: Scene) -> CalibratedMeasurement:
        """Calibrate the camera of a scene (the design's, perhaps with larger pixels); once for all drawn rigs."""
        with as_infeasible("the camera cannot be calibrated"):
            found = calibrated(camera, rng.generator(question.seed, "nominal"), CardErrors(corner_noise_px=0.0))
        return cls(design, question, found, rectification(found))

    def area(self, frame: Frame, camera: Scene, drawn: Draw, generator: np.random.Generator) -> float:
        """Return the measured area [mm^2] of a frame, by a calibration with a draw's card errors.

        Parameters
        ----------
        frame : Frame
        camera : Scene
            As designed; its card is nominal.
        drawn : Draw
        generator : numpy.random.Generator
            Of the corners' scatter.
        """
        factor = self.question.pixel_factor
        crop = self.crop(camera)
        if self.question.estimator == "reference":
            projection = Projection.of(camera.camera, camera.plate)
            distance = projection.focal_px / camera.camera.scale_px_per_mm
            mm2_per_px = reference_scale(self.nominal, drawn, distance, factor)
            return measure_frame(frame, self.design.chain(factor, crop), mm2_per_px, self.view).estimate.area
        return self.refined(camera, drawn, generator).area(frame.data).area_mm2

    def refined(self, camera: Scene, drawn: Draw, generator: np.random.Generator) -> Estimator:
        """Return the refined estimator by a calibration with a draw's card errors; parameters as for :meth:`area`."""
        factor = self.question.pixel_factor
        errors = replace(drawn.cards, corner_noise_px=drawn.cards.corner_noise_px / factor)
        corners = drawn_corners(camera, errors, generator)
        calibration = replace(self.nominal, details={**self.nominal.details, "corners": corners})
        return Estimator.of(calibration, blur_px=BLUR_PX / factor, crop=self.crop(camera))

    def crop(self, camera: Scene) -> Crop:
        """Return the square about the finger's position, of the undistorted view or, refined, of the frame as taken.

        Raises
        ------
        InputError
            If the position is not in the frame.
        """
        x, y = camera.finger.position_mm
        ((col, row),) = self.to_view(camera, np.array([x]), np.array([y]))
        rows, cols = self.view.shape if self.question.estimator == "reference" else self.view.source_shape
        reach = self.question.crop_mm * camera.camera.scale_px_per_mm
        r0, r1 = (int(np.clip(p, 0, rows)) for p in (row - reach, row + reach + 1))
        c0, c1 = (int(np.clip(p, 0, cols)) for p in (col - reach, col + reach + 1))
        if not (0 <= row < rows and 0 <= col < cols and r1 > r0 and c1 > c0):
            raise InputError(
                f"the position ({x:g}, {y:g}) mm is not in the frame", key="loads.positions_mm",
                allowed=f"within the {cols / camera.camera.scale_px_per_mm:.3g} x"
                f" {rows / camera.camera.scale_px_per_mm:.3g} mm of the frame",
            )  # fmt: skip
        return Crop(r0, r1, c0, c1)

    def to_view(self, camera: Scene, x: Floats, y: Floats) -> Floats:
        """Return (column, row) of plate points [mm] in what is measured: the undistorted view or, refined, the frame.

        By the calibration's camera matrix: one flat card determines only the product of focal length and distance.
        """
        u, v = Projection.of(camera.camera, camera.plate).to_image(x, y)
        seen = np.stack([u, v], axis=-1)
        if self.question.estimator != "reference":
            return np.asarray(seen)
        straight = undistort_points(seen, self.nominal.camera_matrix, self.nominal.distortion)
        return np.asarray(straight - np.array(self.view.origin))


def reference_scale(nominal: Calibration, drawn: Draw, distance_mm: float, factor: int = 1) -> float:
    """Return the area per pixel [mm^2] by a square card with the errors of its print, height and edge.

    Parameters
    ----------
    nominal : Calibration
        By a perfect card.
    drawn : Draw
    distance_mm : float
        From the lens to the contact plane as it appears through the glass; a calibration by one flat card does not
        determine it.
    factor : int
        Pixel pitch over that of the scene's camera.
    """
    if nominal.mm2_per_px is None or nominal.square_side_mm is None:
        raise ValueError("the calibration holds no scale")
    side = float(np.sqrt(nominal.mm2_per_px))
    square_px = nominal.square_side_mm / side
    lies = drawn.cards.square_scale / (1.0 + drawn.cards.height_mm / distance_mm)
    return nominal.mm2_per_px / (lies + 2.0 * drawn.square_edge_px / factor / square_px) ** 2
