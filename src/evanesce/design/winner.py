"""Errors of one design of a finished search on rigs drawn anew, and their tolerances to each uncertain parameter.

Functions of plain data to plain data, so that any process can compute them and a file can keep them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from evanesce.core.errors import InputError
from evanesce.design.evaluate import contact_irradiance, read_job
from evanesce.design.measurement import CalibratedMeasurement
from evanesce.design.objective import measured, prepare_fields, prepared, samples, summary
from evanesce.design.question import Case, Design, Question
from evanesce.design.secondary import figures
from evanesce.design.uncertainty import CARDS, Draw, UncertainParameter, effects_at, uncertainty_of
from evanesce.design.variables import design_at
from evanesce.effects import all_effects
from evanesce.evaluation.calibrated_rig import SQUARE_EDGE_PX, CardErrors
from evanesce.measurement.uncertainty.components import CARD_HEIGHT_MM, PRINT_TOLERANCE
from evanesce.rig import Scene

NEW_DRAWS = 1
"""Added to the search's seed: on the draws by which it was selected, a winner's error is biased low."""

PERFECT = CardErrors(corner_noise_px=0.0)
LOW, HIGH = 0.158655, 0.841345
"""Probabilities one standard deviation below and above the mean of a normal distribution."""


def assessed(job: Mapping[str, Any], values: Mapping[str, float], rigs: int) -> dict[str, Any]:
    """Return a design's errors on drawn rigs that the search has not seen, each measuring every case.

    Parameters
    ----------
    job : mapping
        Of the search (:func:`~evanesce.design.evaluate.plain_job`).
    values : mapping
        Key -> value of the design; empty for the base itself.
    rigs : int

    Returns
    -------
    dict
        ``error_percent``, ``standard_percent``, ``saturated_share``, ``by_case``, ``figures`` and ``errors_percent`` by
        case.
    """
    base, asked, parts = read_job(job)
    question = replace(asked, rigs=rigs, seed=asked.seed + NEW_DRAWS)
    design = design_at(base, values)
    uncertainty = uncertainty_of(base.scene, question.standard_deviations)
    found = list(samples(design, question, uncertainty, every_case=True))
    prediction = summary(found, question.seed)
    return {
        "rigs": rigs, "error_percent": prediction.error_percent, "standard_percent": prediction.standard_percent,
        "saturated_share": prediction.saturated_share, "by_case": prediction.by_case(),
        "figures": figures(design, question, prediction, contact_irradiance(design, question), parts),
        "errors_percent": {
            case.name: [s.error_percent for s in found if s.case == case] for case in question.cases
        },
    }  # fmt: skip


def tolerances(job: Mapping[str, Any], values: Mapping[str, float]) -> dict[str, Any]:
    """Return how the error of one measurement changes with each parameter alone, by one standard deviation.

    Returns
    -------
    dict
        ``case``; ``error_percent`` of the nominal rig; ``rows`` with ``name``, ``unit``, values ``low`` and ``high``,
        ``low_percent``, ``high_percent`` (error less that of the nominal rig), or ``reason`` where it is infeasible.
    """
    base, asked, _ = read_job(job)
    design, uncertainty = design_at(base, values), uncertainty_of(base.scene, asked.standard_deviations)
    cases = asked.cases
    case = cases[len(cases) // 2]
    question = replace(asked, forces_N=(case.force_N,), positions_mm=(case.position_mm,), materials=(case.material,))
    measurement = _SingleMeasurement(design, question, case)
    nominal = measurement.error(Draw({}, PERFECT, 0.0))
    stated = uncertainty.parameters + uncertainty.new_fields
    rows = [measurement.row(p, stated, nominal, new_fields=False) for p in _amplitudes(uncertainty.parameters)]
    rows += [measurement.card_row(name, nominal) for name in CARDS[1 if asked.estimator == "reference" else 0 :]]
    rows += [measurement.row(p, stated, nominal, new_fields=True) for p in _amplitudes(uncertainty.new_fields)]
    return {"case": case.name, "error_percent": nominal, "rows": rows}


def _amplitudes(parameters: tuple[UncertainParameter, ...]) -> list[UncertainParameter]:
    """Return the amplitudes: a direction or a position alone has no effect."""
    return [p for p in parameters if p.candidate.amplitude]


class _SingleMeasurement:
    """One case of a design, measured with one parameter changed at a time."""

    def __init__(self, design: Design, question: Question, case: Case) -> None:
        self.question, self.case = question, case
        self.scene = prepared(design.scene, question)
        prepare_fields(self.scene, question)
        self.measurement = CalibratedMeasurement.of(design, question, self.scene)

    def error(self, drawn: Draw) -> float:
        """Return the error of one drawn rig [%]; all have the same noise."""
        return measured(self.measurement, self.scene, drawn, 0, self.case)[0].error_percent

    def row(
        self, parameter: UncertainParameter, stated: tuple[UncertainParameter, ...], nominal: float, *, new_fields: bool
    ) -> dict[str, Any]:
        """Return the row of one parameter.

        Other amplitudes that multiply it stand one standard deviation up if they are among the ``stated`` ones, else
        at the effect's own default, as in the rigs that are drawn.
        """
        effect, c = all_effects()[parameter.effect], parameter.candidate
        low, high = parameter.value(LOW), parameter.value(HIGH)
        row: dict[str, Any] = {"name": parameter.name, "unit": c.unit, "low": low, "high": high}
        factors = {}
        if effect.null_when == "any":
            factors = {
                other: other.value(HIGH)
                for other in _amplitudes(stated)
                if other.effect == effect.id and other.candidate.name != c.name
            }
        try:
            for key, value in (("low", low), ("high", high)):
                drawn = Draw(effects_at({**factors, parameter: value}), PERFECT, 0.0)
                if new_fields:
                    prepare_fields(_with_effects(self.scene, drawn), self.question)
                row[f"{key}_percent"] = self.error(drawn) - nominal
        except InputError as error:
            row["reason"] = str(error)
        return row

    def card_row(self, name: str, nominal: float) -> dict[str, Any]:
        """Return the row of one error of the cards, at one standard deviation of its rectangular distribution."""
        part = 1.0 / 3.0**0.5
        unit = {"card height": "mm", "square edge": "px"}.get(name, "1")
        middle, half = {
            "card height": (CARD_HEIGHT_MM / 2, CARD_HEIGHT_MM / 2),
            "square edge": (0.0, SQUARE_EDGE_PX),
        }.get(name, (0.0, PRINT_TOLERANCE))
        row: dict[str, Any] = {"name": name, "unit": unit, "low": middle - part * half, "high": middle + part * half}
        for key in ("low", "high"):
            value = row[key]
            cards, edge = PERFECT, 0.0
            if name == "checkerboard print":
                cards = replace(PERFECT, board_scale=1.0 + value)
            elif name == "square print":
                cards = replace(PERFECT, square_scale=1.0 + value)
            elif name == "card height":
                cards = replace(PERFECT, height_mm=value)
            else:
                edge = value
            row[f"{key}_percent"] = self.error(Draw({}, cards, edge)) - nominal
        return row


def _with_effects(scene: Scene, drawn: Draw) -> Scene:
    return scene.model_copy(update={"effects": {**scene.effects, **drawn.effects}})


def without(job: Mapping[str, Any], values: Mapping[str, float], effect: str, rigs: int) -> dict[str, Any]:
    """Return a design's error without one effect, on the draws of :func:`assessed`."""
    base, asked, _ = read_job(job)
    question = replace(asked, rigs=rigs, seed=asked.seed + NEW_DRAWS)
    whole = uncertainty_of(base.scene, question.standard_deviations)
    without_it = replace(whole, excluded=frozenset({effect}))
    prediction = summary(list(samples(design_at(base, values), question, without_it, every_case=True)), question.seed)
    return {
        "effect": effect,
        "error_percent": prediction.error_percent,
        "standard_percent": prediction.standard_percent,
    }
