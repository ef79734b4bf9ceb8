"""Area error of a nominal design by the path tracer at the camera's full resolution, beside the fast renderer's."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from evanesce.core import rng
from evanesce.core.states import ContactState, PlateLight
from evanesce.design.evaluate import read_job
from evanesce.design.measurement import CalibratedMeasurement
from evanesce.design.objective import measured
from evanesce.design.question import on_case
from evanesce.design.uncertainty import Draw
from evanesce.design.variables import design_at
from evanesce.evaluation.calibrated_rig import CardErrors
from evanesce.render.kept import forget
from evanesce.render.reference.path import render
from evanesce.rig import Scene

PERFECT = Draw({}, CardErrors(corner_noise_px=0.0), 0.0)
PASSES = 2


def _reference(scene: Scene, state: ContactState | None, *, seed: int, own: int, samples: int) -> PlateLight:
    """Render by the path tracer with its own seed instead of the simulation's."""
    return render(scene, state, seed=own, samples_per_pixel=samples, passes=PASSES)


def verified(
    job: Mapping[str, Any], values: Mapping[str, float], *, case: int, count: int, samples: int, seed: int
) -> dict[str, Any]:
    """Measure one case of a nominal design by both renderers.

    Parameters
    ----------
    job : mapping
        Of the search.
    values : mapping
        Key -> value of the design.
    case : int
        Number of the case.
    count : int
        Independent renderings by the path tracer, 2 or more for a standard error.
    samples : int
        Paths per pixel of each.
    seed : int
        Of the path tracer: not the search's.

    Returns
    -------
    dict
        ``case``, ``true_mm2``; ``reference_percent`` (errors of each rendering), their ``reference_mean_percent`` and
        ``reference_standard_percent``; ``fast_percent``.
    """
    base, asked, _ = read_job(job)
    question = replace(asked, pixel_factor=1)
    design = design_at(base, values)
    wanted = question.cases[case]
    scene = on_case(design.scene, wanted)
    measurement = CalibratedMeasurement.of(design, question, scene)
    forget()
    fast, _ = measured(measurement, scene, PERFECT, 0, wanted)
    errors = []
    for number in range(count):
        reference = partial(_reference, own=rng.integer_seed(seed, "verify", number), samples=samples)
        found, _ = measured(measurement, scene, PERFECT, 0, wanted, render=reference)
        errors.append(found.error_percent)
    standard = float(np.std(errors, ddof=1) / math.sqrt(count)) if count > 1 else math.nan
    return {
        "case": wanted.name, "true_mm2": fast.true_mm2, "samples_per_pixel": samples,
        "reference_percent": errors, "reference_mean_percent": float(np.mean(errors)),
        "reference_standard_percent": standard, "fast_percent": fast.error_percent,
    }  # fmt: skip
