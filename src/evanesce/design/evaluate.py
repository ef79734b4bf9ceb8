"""Evaluate one design: all its objectives, or the reason why it is infeasible. Plain data in and out."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any

import numpy as np

from evanesce.chain.simulate import solve_contact
from evanesce.core.errors import InputError
from evanesce.design.objective import prepare_fields, prepared, samples, summary
from evanesce.design.parts import PartsTable
from evanesce.design.question import Design, Question, on_case
from evanesce.design.secondary import figures
from evanesce.design.uncertainty import uncertainty_of
from evanesce.design.variables import design_at
from evanesce.render.fast.transport import render_fast
from evanesce.rig import Scene
from evanesce.rig.load import validate
from evanesce.sensor.lens import form_image

HALF = 0.5


def plain_job(base: Design, question: Question, parts: PartsTable | None) -> dict[str, Any]:
    """Return the input of every trial as plain data that any process can read."""
    return {
        "scene": base.scene.as_dict(), "threshold": base.threshold, "min_blob_px": base.min_blob_px,
        "question": question.as_dict(), "parts": None if parts is None else parts.model_dump(mode="json"),
    }  # fmt: skip


def read_job(job: Mapping[str, Any]) -> tuple[Design, Question, PartsTable | None]:
    """Return base design, question and parts from the data of :func:`plain_job`."""
    scene = validate(Scene, job["scene"], "design")
    asked = dict(job["question"])
    asked["positions_mm"] = tuple((float(x), float(y)) for x, y in asked["positions_mm"])
    for key in ("forces_N", "materials"):
        asked[key] = tuple(asked[key])
    parts = None
    if job["parts"] is not None:
        data = dict(job["parts"])
        data["part"] = [{k: v for k, v in row.items() if v is not None} for row in data["part"]]
        parts = validate(PartsTable, data, "parts")
    base = Design(scene=scene, threshold=job["threshold"], min_blob_px=job["min_blob_px"])
    return base, Question(**asked), parts


def evaluate(job: Mapping[str, Any], values: Mapping[str, float]) -> dict[str, Any]:
    """Return the objectives of a base design with keys set, or ``reason`` why it is infeasible.

    Parameters
    ----------
    job : mapping
        From :func:`plain_job`.
    values : mapping
        Key -> value, as :func:`~evanesce.design.variables.design_at` takes them.

    Returns
    -------
    dict
        ``figures`` and ``standard_percent`` of the area error, or ``reason``; ``seconds``.

    Raises
    ------
    WorkError
        If the work failed for a reason that is not the rig, such as a full disk.
    """
    started = time.monotonic()
    base, question, parts = read_job(job)
    try:
        found = _evaluated(base, design_at(base, values), question, parts)
    except InputError as error:
        found = {"reason": str(error)}
    return found | {"seconds": time.monotonic() - started}


def _evaluated(base: Design, design: Design, question: Question, parts: PartsTable | None) -> dict[str, Any]:
    uncertainty = uncertainty_of(base.scene, question.standard_deviations)
    irradiance = contact_irradiance(design, question)
    prediction = summary(list(samples(design, question, uncertainty)), question.seed)
    return {
        "figures": figures(design, question, prediction, irradiance, parts),
        "standard_percent": prediction.standard_percent,
        "mean_percent": float(np.mean([s.error_percent for s in prediction.samples])),
    }


def contact_irradiance(design: Design, question: Question) -> float:
    """Return the mean irradiance of the contact's image as designed, at the first case [W mm^-2]."""
    scene = prepared(design.scene, question)
    prepare_fields(scene, question)
    case = question.cases[0]
    rig, state = solve_contact(on_case(scene, case), case.force_N, seed=question.seed)
    seen = form_image(render_fast(rig, state), rig.camera, rig.plate).irradiance
    peak = float(seen.max())
    return float(seen[seen > HALF * peak].mean()) if peak > 0 else 0.0
