"""Predicted area error of the whole measurement: rigs drawn within their uncertainty, simulated and measured.

The ground truth is the area of the solved contact. The measurement gets what a lab has: frames of its own rig and a
calibration from printed cards with their errors.

References
----------
JCGM 101:2008, Propagation of distributions using a Monte Carlo method.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.chain.simulate import Render, SimulatedFrame, simulate, solve_contact
from evanesce.core import rng
from evanesce.core.errors import InputError
from evanesce.design.measurement import CalibratedMeasurement, as_infeasible
from evanesce.design.question import Case, Design, Question, coarser_camera, fitted_grid, on_case
from evanesce.design.uncertainty import Draw, Uncertainty, built_scene, draw, sobol_points, uncertainty_of
from evanesce.render.fast.rig_fields import keep_coarse_fields
from evanesce.render.fast.transport import render_fast
from evanesce.render.reference.scene import approach
from evanesce.rig import Scene

Floats = NDArray[np.float64]

COVERAGE = 0.95
BOOTSTRAPS = 1000
SATURATED_DN = 255
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


def contact_radius(scene: Scene, case: Case, seed: int) -> float:
    """Return the radius of the disc that has the contact's area, as drawn [mm].

    Raises
    ------
    InputError
        If that disc reaches over the plate's edge.
    """
    with as_infeasible(f"the finger cannot be pressed by {case.name}"):
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
    with as_infeasible(f"drawn rig {rig} cannot be pressed or seen by {case.name}"):
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
