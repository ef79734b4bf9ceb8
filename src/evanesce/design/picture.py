"""Frame of a nominal design at the camera's full resolution, with the true outline and the measured one."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from skimage.measure import find_contours

from evanesce.chain.simulate import simulate
from evanesce.design.evaluate import read_job
from evanesce.design.measurement import CalibratedMeasurement
from evanesce.design.objective import prepare_fields, prepared
from evanesce.design.question import on_case
from evanesce.design.uncertainty import Draw
from evanesce.design.variables import design_at
from evanesce.evaluation.calibrated_rig import CardErrors
from evanesce.measurement.calibration.rectify import rectify
from evanesce.measurement.reference.area import measure_frame
from evanesce.render.fast.transport import render_fast

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Shot:
    """A frame and its measured part.

    Attributes
    ----------
    title : str
    crop : ndarray of uint8
        Measured part of the frame [DN].
    true_lines, measured_lines : list of ndarray (n, 2)
        Outlines (x, y) in the crop [px].
    frame : ndarray of uint8
        The whole frame [DN].
    """

    title: str
    crop: NDArray[np.uint8]
    true_lines: list[Floats]
    measured_lines: list[Floats]
    frame: NDArray[np.uint8]


def shot(job: Mapping[str, Any], values: Mapping[str, float], case: int = -1) -> Shot:
    """Simulate the frame of one case of a nominal design by the fast renderer, and measure it."""
    base, asked, _ = read_job(job)
    question = replace(asked, pixel_factor=1)
    design = design_at(base, values)
    wanted = question.cases[case]
    question = replace(
        question, forces_N=(wanted.force_N,), positions_mm=(wanted.position_mm,), materials=(wanted.material,)
    )
    scene = on_case(prepared(design.scene, question), wanted)
    prepare_fields(scene, question)
    measurement = CalibratedMeasurement.of(design, question, scene)
    found = simulate(scene, wanted.force_N, seed=question.seed, render=render_fast)
    assert found.state is not None
    crop = measurement.crop(scene)
    grid = found.state.grid
    true_lines = []
    for line in find_contours(np.pad(np.asarray(found.state.contact_mask, float), 1), 0.5):
        row, col = line[:, 0] - 1, line[:, 1] - 1
        x, y = np.interp(col, np.arange(grid.shape[1]), grid.x), np.interp(row, np.arange(grid.shape[0]), grid.y)
        true_lines.append(measurement.to_view(scene, x, y) - np.array([crop.c0, crop.r0]))
    if question.estimator == "reference":
        scale = measurement.nominal.mm2_per_px
        assert scale is not None
        mask = measure_frame(found.frame, design.chain(1, crop), scale, measurement.view).estimate.mask
        shown = crop.apply(rectify(found.frame.data, measurement.view))
        area = float(mask.sum()) * scale
    else:
        result = measurement.refined(
            scene, Draw({}, CardErrors(corner_noise_px=0.0), 0.0), np.random.default_rng(0)
        ).area(found.frame.data)
        mask, area = result.mask, result.area_mm2
        shown = crop.apply(found.frame.data)
    lines = [line[:, ::-1] - 1 for line in find_contours(np.pad(mask.astype(float), 1), 0.5)]
    true = found.state.nominal_contact_area
    title = f"{wanted.force_N:g} N: {area:.2f} mm² of {true:.2f} mm² ({100 * (area / true - 1):+.1f} %)"
    grey = shown if shown.ndim == 2 else shown[..., 1]
    return Shot(title, np.asarray(grey), true_lines, lines, found.frame.data)
