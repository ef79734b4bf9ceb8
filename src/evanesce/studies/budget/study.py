"""Coverage of the stated intervals: cards and corners drawn anew, one of a class's frames drawn, per finger and place.

Each measurement draws one calibration (print, height and square of the cards, scatter of the corners) and one frame of
each class. What a frame's boundary is does not depend on the calibration, so that it is found once per frame.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.core import provenance, rng
from evanesce.evaluation.calibrated_rig import SQUARE_EDGE_PX, CardErrors, calibrated, drawn_corners, with_board_blur
from evanesce.measurement.calibration.model import Calibration
from evanesce.measurement.calibration.rectify import rectification
from evanesce.measurement.reference.area import measure_frame
from evanesce.measurement.reference.segment import Chain
from evanesce.measurement.refined.estimator import Estimator
from evanesce.measurement.refined.result import RefinedArea, Unseen
from evanesce.measurement.refined.subsurface import Scattering
from evanesce.measurement.uncertainty.area import lens_distance, reference_boundary, refined_uncertainty
from evanesce.measurement.uncertainty.budget import Finger, Reading, propagate
from evanesce.measurement.uncertainty.components import (
    CARD_HEIGHT_MM,
    PRINT_TOLERANCE,
    card_components,
    reference_components,
)
from evanesce.optics.projection import Projection
from evanesce.rig import Scene
from evanesce.studies.budget.colour import camera_components, deviations, drawn_deviation, radiometry_of
from evanesce.studies.estimator.study import POSITIONS, REFERENCE_V, LitPress, fingers_of, placed
from evanesce.studies.ledger import Keep, not_kept

FORCES = (0.8, 1.1, 1.7, 2.3, 3.6, 4.4)
"""At 0.8 N a ridge is about to come into contact: the widest film of air [N]."""

VOLTAGES = (8.4, 9.7)
FINGERS = ("smooth", "ridged")
BLOCK = 50
"""Measurements that are kept together."""

Tick = Callable[[str, int, int], None]


@dataclass(frozen=True, kw_only=True)
class Shot:
    """What one frame gives without a calibration.

    Attributes
    ----------
    true_mm2 : float
    contours : list of ndarray (n, 2)
        Of the refined estimator, (x, y) in the frame as taken [px].
    spread_mm, sharp_spread_mm : float or None
        Of its edge, and of a sharp contact's (:class:`~evanesce.measurement.refined.estimator.RefinedArea`).
    corrected : float
        Area as read over that within the contours [1].
    pixels : int
    perimeter_px, away_px : float
        Of the reference segmentation (:func:`~evanesce.measurement.uncertainty.area.reference_boundary`).
    unseen : str
    scattering : Scattering
    blur_uncertainty_px, colour_uncertainty_px : float
        Of the refined estimator.
    camera_percent : dict
        Of a colour camera: change of the refined area where it is not as stated
        (:func:`~evanesce.studies.budget.colour.deviations`) [%].
    """

    true_mm2: float
    contours: list[NDArray[np.float64]]
    spread_mm: float | None
    pixels: int
    perimeter_px: float
    away_px: float
    unseen: Unseen = ""
    scattering: Scattering = field(default_factory=Scattering)
    blur_uncertainty_px: float = 0.0
    colour_uncertainty_px: float = 0.0
    camera_percent: dict[str, float] = field(default_factory=dict)
    sharp_spread_mm: float | None = None
    corrected: float = 1.0

    def as_dict(self) -> dict[str, Any]:
        """Return plain data, from which :meth:`of` makes the same shot to the last bit.

        Returns
        -------
        dict
        """
        contours = [contour.tolist() for contour in self.contours]
        return {**vars(self), "contours": contours, "scattering": asdict(self.scattering)}

    @classmethod
    def of(cls, data: Mapping[str, Any]) -> Shot:
        """Return a shot of plain data.

        Parameters
        ----------
        data : mapping
            Of :meth:`as_dict`.

        Returns
        -------
        Shot
        """
        contours = [np.array(contour, np.float64) for contour in data["contours"]]
        return cls(**{**data, "contours": contours, "scattering": Scattering(**data["scattering"])})


@dataclass(frozen=True, kw_only=True)
class ClassCoverage:
    """Coverage of one class.

    Attributes
    ----------
    finger, place : str
    measurements, frames : int
    refined_covered, reference_covered : float
        Share of measurements whose 95 % interval holds the truth.
    refined_linear_covered : float
        The same of the linear interval.
    refined_half_width_percent, reference_half_width_percent : float
        Median half-width of the interval [% of the area].
    refined_bias_percent, reference_bias_percent : float
        Mean error of the area as read [%].
    contributions_percent : dict
        Median standard uncertainty of the refined area from each component [%].
    reference_contributions_percent : dict
        The same of the area by the reference segmentation.
    """

    finger: str
    place: str
    measurements: int
    frames: int
    refined_covered: float
    refined_linear_covered: float
    reference_covered: float
    refined_half_width_percent: float
    reference_half_width_percent: float
    refined_bias_percent: float
    reference_bias_percent: float
    contributions_percent: dict[str, float]
    reference_contributions_percent: dict[str, float]


@dataclass(frozen=True, kw_only=True)
class BudgetStudy:
    """All classes."""

    classes: list[ClassCoverage]
    provenance: dict[str, Any]

    def as_dict(self) -> dict[str, Any]:
        """Return the JSON result.

        Returns
        -------
        dict
        """
        return {"classes": [asdict(c) for c in self.classes], "provenance": self.provenance}


def shots_of(
    scene: Scene,
    calibration: Calibration,
    forces: Sequence[float],
    voltages: Sequence[float],
    threshold: float,
    seed: int,
) -> list[Shot]:
    """Return the frames of one finger at one place, at each force and voltage.

    Parameters
    ----------
    scene : Scene
    calibration : Calibration
        Nominal.
    forces, voltages : sequence of float
        [N], [V].
    threshold : float
        Of the reference segmentation, 0 to 1.
    seed : int

    Returns
    -------
    list of Shot
    """
    presses = [LitPress.of(scene, force, seed) for force in forces]
    teacher = presses[0].frame(REFERENCE_V, rng.integer_seed(seed, "teach")).data
    estimator = Estimator.of(calibration, radiometry_of(scene, calibration)).tuned_on(teacher)
    view, chain = rectification(calibration), Chain(threshold=threshold)
    assert calibration.mm2_per_px is not None
    shots = []
    for k, press in enumerate(presses):
        for voltage in voltages:
            noise = rng.integer_seed(seed, "frame", k)
            frame = press.frame(voltage, noise)
            reference = measure_frame(frame, chain, calibration.mm2_per_px, view)
            perimeter, away = reference_boundary(reference, calibration.details["tone_curve"])
            found = estimator.area(frame.data)
            shots.append(
                Shot(
                    true_mm2=press.true_mm2, contours=found.contours, spread_mm=found.spread_mm,
                    pixels=reference.segmentation.pixels, perimeter_px=perimeter, away_px=away,
                    unseen=found.unseen, scattering=found.scattering, blur_uncertainty_px=found.blur_uncertainty_px,
                    colour_uncertainty_px=found.colour_uncertainty_px,
                    camera_percent=deviations(press, voltage, noise, estimator, found.area_mm2),
                    sharp_spread_mm=found.sharp_spread_mm,
                    corrected=found.area_mm2 / within if (within := estimator.plate.area(found.contours)) > 0 else 1.0,
                )
            )  # fmt: skip
    return shots


def draw_errors(draws: np.random.Generator) -> tuple[CardErrors, float]:
    """Draw card errors from the distributions that the budget states.

    Parameters
    ----------
    draws : numpy.random.Generator

    Returns
    -------
    errors : CardErrors
    edge : float
        Displacement of the square's edges [px].
    """
    errors = CardErrors(
        board_scale=1.0 + draws.uniform(-PRINT_TOLERANCE, PRINT_TOLERANCE), height_mm=draws.uniform(0.0, CARD_HEIGHT_MM)
    )
    square = 1.0 + draws.uniform(-PRINT_TOLERANCE, PRINT_TOLERANCE)
    return replace(errors, square_scale=square), draws.uniform(-SQUARE_EDGE_PX, SQUARE_EDGE_PX)


def run_study(
    smooth: Scene,
    ridged: Scene,
    *,
    measurements: int = 1000,
    forces: Sequence[float] = FORCES,
    voltages: Sequence[float] = VOLTAGES,
    fingers: Sequence[str] = FINGERS,
    positions: Sequence[str] = tuple(POSITIONS),
    threshold: float = 0.15,
    seed: int = 1,
    tick: Tick = lambda what, done, total: None,
    keep: Keep = not_kept,
) -> BudgetStudy:
    """Run the study.

    Parameters
    ----------
    smooth, ridged : Scene
    measurements : int
        Of each class.
    forces, voltages : sequence of float
        Of the frames that are measured [N], [V].
    fingers, positions : sequence of str
        Names of :func:`~evanesce.studies.estimator.study.fingers_of` and of its positions.
    threshold : float
        Of the reference segmentation.
    seed : int
    tick : callable
        ``tick(what, done, total)``.
    keep : callable
        Keeps the frames of a class and each block of measurements, so that an interrupted run goes on; see
        :data:`~evanesce.studies.ledger.Keep`.

    Returns
    -------
    BudgetStudy
    """
    perfect = calibrated(smooth, rng.generator(seed, "nominal"), CardErrors(corner_noise_px=0.0))
    nominal = with_board_blur(perfect, smooth, seed)
    scenes = fingers_of(smooth, ridged)
    keys = [(finger, place) for place in positions for finger in fingers]
    shots: dict[tuple[str, str], list[Shot]] = {}
    for finger, place in keys:
        scene = placed(scenes[finger], POSITIONS[place])

        def exposed(scene: Scene = scene) -> dict[str, Any]:
            taken = shots_of(scene, nominal, forces, voltages, threshold, seed)
            return {"shots": [shot.as_dict() for shot in taken]}

        kept = keep(f"frames: {finger}, {place}", exposed)["shots"]
        shots[finger, place] = [Shot.of(data) for data in kept]
        tick("frames", len(shots), len(keys))
    tallies: dict[tuple[str, str], list[Mapping[str, Any]]] = {key: [] for key in keys}
    for first in range(0, measurements, BLOCK):
        numbers = range(first, min(first + BLOCK, measurements))
        block = keep(f"measurements from {first}", partial(_block, numbers, smooth, nominal, shots, seed))["rows"]
        for row in block:
            for key, one in zip(keys, row, strict=True):
                tallies[key].append(one)
        tick("measurements", numbers.stop, measurements)
    found = [_summed(key, tallies[key], len(shots[key])) for key in keys]
    config = {"smooth": smooth.as_dict(), "ridged": ridged.as_dict(), "measurements": measurements}
    return BudgetStudy(classes=found, provenance=dict(provenance.record(seed=seed, config=config)))


def _block(
    numbers: range, scene: Scene, nominal: Calibration, shots: Mapping[tuple[str, str], list[Shot]], seed: int
) -> dict[str, Any]:
    """Return some measurements, a row of one result a class; each draws from its own number."""
    rows = []
    flat = Projection.of(scene.camera, scene.plate)
    distance = flat.clearance + flat.thickness / flat.refractive_index  # of the contact plane, through the glass
    for number in numbers:
        draws = rng.generator(seed, "budget", number)
        errors, edge_px = draw_errors(draws)
        calibration = replace(nominal, details={**nominal.details, "corners": drawn_corners(scene, errors, draws)})
        estimator = Estimator.of(calibration)
        # the square as printed and as it lies; the calibration without errors holds the scale of a perfect one
        assert nominal.mm2_per_px is not None
        assert nominal.square_side_mm is not None
        square_px = nominal.square_side_mm / np.sqrt(nominal.mm2_per_px)
        square = errors.square_scale / (1.0 + errors.height_mm / distance) + 2.0 * edge_px / square_px
        rows.append(
            [
                _measure(
                    some[int(draws.integers(len(some)))], estimator, calibration, square, draws,
                    "ridged" if "ridged" in finger else "smooth",
                )
                for (finger, _), some in shots.items()
            ]
        )  # fmt: skip
    return {"rows": rows}


def _measure(
    shot: Shot, estimator: Estimator, calibration: Calibration, square: float, draws: np.random.Generator,
    finger: Finger,
) -> dict[str, Any]:  # fmt: skip
    plate = estimator.plate
    on_plate = [plate.to_plate(curve) for curve in shot.contours]
    perimeter = sum(float(np.linalg.norm(np.diff(curve, axis=0), axis=1).sum()) for curve in on_plate)
    found = RefinedArea(
        area_mm2=shot.corrected * plate.area(shot.contours), perimeter_mm=perimeter, contours=shot.contours,
        mask=np.zeros((0, 0), np.bool_), scattering=shot.scattering, saturated_pixels=0, islands=1, dropped=0, step=0.0,
        spread_mm=shot.spread_mm, sharp_spread_mm=shot.sharp_spread_mm, unseen=shot.unseen,
        blur_uncertainty_px=shot.blur_uncertainty_px,
        colour_uncertainty_px=shot.colour_uncertainty_px,
    )  # fmt: skip
    cards = [*card_components(), *camera_components(shot.camera_percent, found)]
    # the camera as it is: what was stated of it differs by a draw from the same distributions
    found = replace(found, area_mm2=found.area_mm2 * (1.0 + drawn_deviation(shot.camera_percent, draws)))
    refined = refined_uncertainty(found, estimator, draws, cards=cards, finger=finger)
    assert calibration.mm2_per_px is not None
    assert calibration.square_side_mm is not None
    side = float(np.sqrt(calibration.mm2_per_px))
    distance, nearness = lens_distance(calibration, side)
    scale = calibration.mm2_per_px / square**2
    area = shot.pixels * scale
    reading = Reading(area_mm2=area, perimeter_mm=shot.perimeter_px * np.sqrt(scale), distance_mm=distance)
    spread = float(calibration.details["scale_spread_undistorted"])
    parts = reference_components(
        side, square_px=calibration.square_side_mm / side, spread=spread, threshold_mm=shot.away_px * side
    )
    reference = propagate(reading, [*card_components(), nearness, *parts], draws)
    true = shot.true_mm2
    intervals = (refined.interval_mm2, refined.linear_mm2, reference.interval_mm2)
    return {
        "covered": [bool(low < true < high) for low, high in intervals],
        "widths": [50 * (u.interval_mm2[1] - u.interval_mm2[0]) / true for u in (refined, reference)],
        "errors": [100 * (found.area_mm2 / true - 1), 100 * (area / true - 1)],
        "parts": {name: 100 * u / true for name, u in refined.contributions_mm2.items()},
        "reference_parts": {name: 100 * u / true for name, u in reference.contributions_mm2.items()},
    }


def _summed(key: tuple[str, str], tally: Sequence[Mapping[str, Any]], frames: int) -> ClassCoverage:
    refined, linear, reference = np.mean([m["covered"] for m in tally], axis=0)
    widths = np.median([m["widths"] for m in tally], axis=0)
    errors = np.mean([m["errors"] for m in tally], axis=0)
    return ClassCoverage(
        finger=key[0], place=key[1], measurements=len(tally), frames=frames,
        refined_covered=float(refined), refined_linear_covered=float(linear), reference_covered=float(reference),
        refined_half_width_percent=float(widths[0]), reference_half_width_percent=float(widths[1]),
        refined_bias_percent=float(errors[0]), reference_bias_percent=float(errors[1]),
        contributions_percent=_medians([m["parts"] for m in tally]),
        reference_contributions_percent=_medians([m["reference_parts"] for m in tally]),
    )  # fmt: skip


def _medians(parts: Sequence[Mapping[str, float]]) -> dict[str, float]:
    return {name: float(np.median([part[name] for part in parts])) for name in parts[0]}
