"""What is found out about one design of a finished search: its errors on fresh draws, and which build error spoils it.

Everything is a function of plain data to plain data, so that any process can do it and a file can keep it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from evanesce.core.errors import InputError
from evanesce.design.evaluate import contact_irradiance, read_job
from evanesce.design.objective import Lab, light_up, measured, prepared, samples, summary
from evanesce.design.question import Case, Design, Question
from evanesce.design.secondary import figures
from evanesce.design.uncertainty import CARDS, Departure, Draw, uncertainty_of, with_departures
from evanesce.design.vary import design_at
from evanesce.effects import all_effects
from evanesce.evaluation.calibrated_rig import SQUARE_EDGE_PX, CardErrors
from evanesce.measurement.uncertainty.components import CARD_HEIGHT_MM, PRINT_TOLERANCE
from evanesce.rig import Scene

FRESH = 1
"""Added to the search's seed: the winner was chosen for its luck with the old draws, too."""

PERFECT = CardErrors(corner_noise_px=0.0)
LOW_SHARE, HIGH_SHARE = 0.158655, 0.841345
"""Shares of a distribution one standard deviation below and above the middle of a normal one."""


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
    question = replace(asked, rigs=rigs, seed=asked.seed + FRESH)
    design = design_at(base, values)
    uncertainty = uncertainty_of(base.scene, question.sizes)
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
    """Return what each departure alone, one standard deviation either way, does to the error of one measurement.

    Returns
    -------
    dict
        ``case``; ``error_percent`` of the rig as drawn; ``rows`` with ``name``, ``unit``, values ``low`` and ``high``,
        ``low_percent``, ``high_percent`` (error less that of the rig as drawn), or ``reason`` where it cannot be.
    """
    base, asked, _ = read_job(job)
    design, uncertainty = design_at(base, values), uncertainty_of(base.scene, asked.sizes)
    cases = asked.cases
    case = cases[len(cases) // 2]
    question = replace(asked, forces_N=(case.force_N,), places_mm=(case.place_mm,), materials=(case.material,))
    bench = _Bench(design, question, case)
    nominal = bench.error(Draw({}, PERFECT, 0.0))
    stated = uncertainty.departures + uncertainty.new_light
    rows = [bench.departure(d, stated, nominal, new_light=False) for d in _amplitudes(uncertainty.departures)]
    rows += [bench.card(name, nominal) for name in CARDS[1 if asked.estimator == "reference" else 0 :]]
    rows += [bench.departure(d, stated, nominal, new_light=True) for d in _amplitudes(uncertainty.new_light)]
    return {"case": case.name, "error_percent": nominal, "rows": rows}


def _amplitudes(departures: tuple[Departure, ...]) -> list[Departure]:
    """Return those that make an effect what it is; a direction or a place alone does nothing."""
    return [d for d in departures if d.candidate.amplitude]


class _Bench:
    """One measurement of a design, for one departure after the other."""

    def __init__(self, design: Design, question: Question, case: Case) -> None:
        self.question, self.case = question, case
        self.scene = prepared(design.scene, question)
        light_up(self.scene, question)
        self.lab = Lab.of(design, question, self.scene)

    def error(self, drawn: Draw) -> float:
        """Return the error of one drawn rig [%]; all of them have the same noise."""
        return measured(self.lab, self.scene, drawn, 0, self.case)[0].error_percent

    def departure(
        self, departure: Departure, stated: tuple[Departure, ...], nominal: float, *, new_light: bool
    ) -> dict[str, Any]:
        """Return the row of one departure.

        Other amplitudes that multiply it stand one standard deviation up if they are among the ``stated`` ones, else
        at the effect's own default, as in the rigs that are drawn.
        """
        effect, c = all_effects()[departure.effect], departure.candidate
        low, high = departure.value(LOW_SHARE), departure.value(HIGH_SHARE)
        row: dict[str, Any] = {"name": departure.name, "unit": c.unit, "low": low, "high": high}
        fellows = {}
        if effect.null_when == "any":
            fellows = {
                other: other.value(HIGH_SHARE)
                for other in _amplitudes(stated)
                if other.effect == effect.id and other.candidate.name != c.name
            }
        try:
            for key, value in (("low", low), ("high", high)):
                drawn = Draw(with_departures({**fellows, departure: value}), PERFECT, 0.0)
                if new_light:
                    light_up(_with_effects(self.scene, drawn), self.question)
                row[f"{key}_percent"] = self.error(drawn) - nominal
        except InputError as error:
            row["reason"] = str(error)
        return row

    def card(self, name: str, nominal: float) -> dict[str, Any]:
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
    """Return a design's error on fresh draws without one effect; draws are those of :func:`assessed`."""
    base, asked, _ = read_job(job)
    question = replace(asked, rigs=rigs, seed=asked.seed + FRESH)
    whole = uncertainty_of(base.scene, question.sizes)
    held = replace(whole, held=frozenset({effect}))
    prediction = summary(list(samples(design_at(base, values), question, held, every_case=True)), question.seed)
    return {
        "effect": effect,
        "error_percent": prediction.error_percent,
        "standard_percent": prediction.standard_percent,
    }
