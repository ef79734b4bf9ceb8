"""Predicted area error of the whole measurement: rigs drawn within their uncertainty, simulated and measured.

The ground truth is the area of the solved contact. The measurement gets what a lab has: frames of its own rig and a
calibration from printed cards with their errors.

References
----------
JCGM 101:2008, Propagation of distributions using a Monte Carlo method.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.chain.simulate import Render, SimulatedFrame, simulate, solve_contact
from evanesce.core import rng
from evanesce.core.errors import InputError, WorkError
from evanesce.core.states import Frame
from evanesce.design.question import Case, Design, Question, coarser_camera, fitted_grid, on_case
from evanesce.design.uncertainty import Draw, Uncertainty, built_scene, draw, sobol_points, uncertainty_of
from evanesce.evaluation.calibrated_rig import CardErrors, calibrated, drawn_corners
from evanesce.measurement.calibration.model import Calibration
from evanesce.measurement.calibration.rectify import Rectification, rectification, undistort_points
from evanesce.measurement.reference.area import measure_frame
from evanesce.measurement.reference.segment import Crop
from evanesce.measurement.refined.estimator import Estimator
from evanesce.optics.projection import Projection
from evanesce.render.fast.rig_fields import keep_coarse_fields
from evanesce.render.fast.transport import render_fast
from evanesce.render.reference.scene import approach
from evanesce.rig import Scene

Floats = NDArray[np.float64]

COVERAGE = 0.95
BOOTSTRAPS = 1000
SATURATED_DN = 255
BLUR_PX = 1.13
"""Blur of the camera that the refined estimator assumes, at full resolution."""

LOWEST_APPROACH, HIGHEST_APPROACH = 0.7, 1.3
"""Drawn fingers are softer or stiffer: range of their approach over that of the nominal one."""


@dataclass(frozen=True, kw_only=True)
class Sample:
    """One measurement of one drawn rig.

    Attributes
    ----------
    rig : int
        Number of the draw.
    case : Case
    true_mm2, measured_mm2 : float
    saturated_share : float
        Pixels at full scale over the true area in pixels.
    """

    rig: int
    case: Case
    true_mm2: float
    measured_mm2: float
    saturated_share: float

    @property
    def error_percent(self) -> float:
        """Relative error of the measured area [%]."""
        return 100.0 * (self.measured_mm2 / self.true_mm2 - 1.0)

    def as_dict(self) -> dict[str, Any]:
        """Return plain data."""
        return asdict(self) | {"error_percent": self.error_percent}


@dataclass(frozen=True, kw_only=True)
class Prediction:
    """Predicted area error of a design.

    Attributes
    ----------
    samples : tuple of Sample
    error_percent, standard_percent : float
        95th percentile of the absolute relative area error, and its standard error by bootstrap [%].
    saturated_share : float
        Mean.
    """

    samples: tuple[Sample, ...]
    error_percent: float
    standard_percent: float
    saturated_share: float

    def by_case(self) -> list[dict[str, Any]]:
        """Return, for each case, count, mean, standard deviation and 95 % of its errors [%]."""
        rows = []
        for case in dict.fromkeys(s.case for s in self.samples):
            own = np.array([s.error_percent for s in self.samples if s.case == case])
            rows.append(
                {
                    "force_N": case.force_N, "position_mm": list(case.position_mm), "material": case.material,
                    "rigs": own.size, "mean_percent": float(own.mean()),
                    "standard_deviation_percent": float(own.std(ddof=1)) if own.size > 1 else None,
                    "error_95_percent": percentile(own),
                }
            )  # fmt: skip
        return rows


def percentile(errors: Floats) -> float:
    """Return the 95th percentile of absolute errors, in their unit."""
    return float(np.quantile(np.abs(errors), COVERAGE))


def percentile_standard(errors: Floats, generator: np.random.Generator, count: int = BOOTSTRAPS) -> float:
    """Return the standard error of :func:`percentile` by bootstrap, in the errors' unit.

    Parameters
    ----------
    errors : ndarray (rigs, measurements)
        The measurements of one rig are correlated: whole rigs are resampled.
    generator : numpy.random.Generator
    count : int

    References
    ----------
    B. Efron, "Bootstrap methods: another look at the jackknife", Annals of Statistics 7 (1979) 1.
    """
    rigs = errors.shape[0]
    drawn = np.abs(errors)[generator.integers(rigs, size=(count, rigs))].reshape(count, -1)
    return float(np.quantile(drawn, COVERAGE, axis=1).std(ddof=1))


def summary(samples: Sequence[Sample], seed: int) -> Prediction:
    """Return the prediction of samples."""
    by_rig: dict[int, list[float]] = {}
    for s in samples:
        by_rig.setdefault(s.rig, []).append(s.error_percent)
    errors = np.array(list(by_rig.values()))
    return Prediction(
        samples=tuple(samples), error_percent=percentile(errors),
        standard_percent=percentile_standard(errors, rng.generator(seed, "bootstrap")),
        saturated_share=float(np.mean([s.saturated_share for s in samples])),
    )  # fmt: skip


# --- the measurement -------------------------------------------------------------------------------------------------


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
        with _as_reason("the camera cannot be calibrated"):
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


# --- the simulation --------------------------------------------------------------------------------------------------


@contextmanager
def _as_reason(what: str) -> Iterator[None]:
    """Report a solver that fails as an infeasible rig: solvers write nothing, so that no disk is the cause."""
    try:
        yield
    except WorkError as error:
        raise InputError(f"{what}: {error}") from None


def contact_radius(scene: Scene, case: Case, seed: int) -> float:
    """Return the radius of the disc that has the contact's area, as drawn [mm].

    Raises
    ------
    InputError
        If that disc reaches over the plate's edge.
    """
    with _as_reason(f"the finger cannot be pressed by {case.name}"):
        state = solve_contact(on_case(scene, case), case.force_N, seed=seed)[1]
    assert state is not None
    radius = float(np.sqrt(state.nominal_contact_area / np.pi))
    for at, length, axis in zip(case.position_mm, scene.plate.size_mm, "xy", strict=True):
        if not abs(at) + radius < length / 2:
            raise InputError(
                f"the contact of {case.name} reaches over the plate's edge", key="loads.positions_mm",
                allowed=f"{axis} within ±{max(0.0, length / 2 - radius):.3g} mm for a radius of {radius:.3g} mm",
            )  # fmt: skip
    return radius


def prepared(scene: Scene, question: Question) -> Scene:
    """Return the scene that frames of a search are taken with: coarser camera, contact grid no larger than needed.

    Raises
    ------
    InputError
        If a contact reaches over the plate's edge.
    """
    radius = max(contact_radius(scene, case, question.seed) for case in question.cases)
    return fitted_grid(coarser_camera(scene, question.pixel_factor), HIGHEST_APPROACH * radius)


def prepare_fields(scene: Scene, question: Question) -> None:
    """Compute the light fields at every position of a question, with a coarse flank; cached in this process."""
    for position in question.positions_mm:
        depths = []
        for case in question.cases:
            if case.position_mm == position:
                rig, state = solve_contact(on_case(scene, case), case.force_N, seed=question.seed)
                assert state is not None
                depth = approach(state, rig.finger)
                depths += [LOWEST_APPROACH * depth, HIGHEST_APPROACH * depth]
        keep_coarse_fields(rig, tuple(depths))


def measured(
    measurement: CalibratedMeasurement,
    scene: Scene,
    drawn: Draw,
    rig: int,
    case: Case,
    *,
    render: Render = render_fast,
    **options: Any,
) -> tuple[Sample, SimulatedFrame]:
    """Simulate the frame of one drawn rig and measure it.

    Parameters
    ----------
    measurement : CalibratedMeasurement
    scene : Scene
        From :func:`prepared`.
    drawn : Draw
    rig : int
        Number of the draw: it seeds specks, dead LEDs and noise.
    case : Case
    render : callable
        :func:`~evanesce.render.fast.transport.render_fast` or the path tracer.
    **options
        Of the renderer.
    """
    seed = rng.integer_seed(measurement.question.seed, "rig", rig)
    with _as_reason(f"drawn rig {rig} cannot be pressed or seen by {case.name}"):
        shot = simulate(on_case(built_scene(scene, drawn), case), case.force_N, seed=seed, render=render, **options)
    assert shot.state is not None
    true = shot.state.nominal_contact_area
    if not true > 0:
        raise InputError(f"a drawn rig has no contact at {case.force_N:g} N", key="loads.forces_N")
    area = measurement.area(shot.frame, on_case(scene, case), drawn, rng.generator(seed, "corners"))
    full = int(np.count_nonzero(shot.frame.data == SATURATED_DN))
    pixels = true * scene.camera.scale_px_per_mm**2
    return Sample(rig=rig, case=case, true_mm2=true, measured_mm2=area, saturated_share=min(1.0, full / pixels)), shot


def assigned_cases(question: Question) -> list[Case]:
    """Return the case that each drawn rig measures: equally many of each, in an order independent of the draws."""
    cases = question.cases
    order = rng.generator(question.seed, "cases").permutation(question.rigs)
    return [cases[k % len(cases)] for k in order]


def predict(
    design: Design, question: Question, uncertainty: Uncertainty | None = None, *, every_case: bool = False
) -> Prediction:
    """Predict a design's area error.

    Parameters
    ----------
    design : Design
    question : Question
    uncertainty : Uncertainty, optional
        Of the design's own scene by default; a search gives that of its base scene, so that draws are common.
    every_case : bool
        Whether each drawn rig measures all cases, for tables by load and position.

    Raises
    ------
    InputError
        If such a rig is infeasible: it cannot be built, pressed or calibrated.
    """
    return summary(list(samples(design, question, uncertainty, every_case=every_case)), question.seed)


def samples(
    design: Design, question: Question, uncertainty: Uncertainty | None = None, *, every_case: bool = False
) -> Iterator[Sample]:
    """Yield the samples of :func:`predict`."""
    scene = prepared(design.scene, question)
    if uncertainty is None:
        uncertainty = uncertainty_of(design.scene, question.standard_deviations)
    prepare_fields(scene, question)
    measurement = CalibratedMeasurement.of(design, question, scene)
    cases = [question.cases] * question.rigs if every_case else [(case,) for case in assigned_cases(question)]
    for number, point in enumerate(sobol_points(uncertainty, question.rigs, question.seed)):
        drawn = draw(uncertainty, point)
        for case in cases[number]:
            yield measured(measurement, scene, drawn, number, case)[0]
