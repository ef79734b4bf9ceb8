"""How far the critic's prediction is from one by eight times finer pixels, in standard deviations of the measurement.

Run: python benchmarks/critic_pixels.py [--json FILE]

Printed is the root of the sum of squares over all bins of a view, over the noise of replicates: 1 is what the noise of
a single bin would do. A cause of that strength would be imitated. Coarse is the predictor that fits step by; then the
fine model's two sides of pixels, Richardson's extrapolation from both, which is what data are compared with, and
what the data's standard deviations count as unknown.

The second table is of derivatives, by which causes are told apart: of a small change of each cause by fine pixels, what
the light and the load of single views do not make up for, the share (a squared cosine) that derivatives hold, by whole
pixels of the model camera and, as the critic's, by halves; and by how much it seems larger than it is for what
derivatives by load do not hold. Kept is its norm over the data's standard deviations by that over noise alone.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from evanesce.bundle.protocol import default_protocol
from evanesce.bundle.read import read_bundle
from evanesce.bundle.write import write_bundle
from evanesce.inference.causes import causes_of
from evanesce.inference.data import data_vector, step_sd
from evanesce.inference.model import COARSER_PX, AnchoredModel
from evanesce.prediction.fine import CARD_PX, FINE_PX
from evanesce.prediction.linear import Metric
from evanesce.prediction.observe import observe
from evanesce.prediction.parameters import Parameter
from evanesce.prediction.predict import Predictor
from evanesce.prediction.views import binned
from evanesce.rig import load_scene

RIG = {
    "camera.resolution_px": [400, 300],
    "camera.scale_px_per_mm": 12.0,
    "camera.exposure_ms": 0.6,
    "card.checkerboard_squares": [9, 7],
    "card.checkerboard_side_mm": 3.0,
    "press.forces_N": [2.0, 5.0],
}
FINEST_PX = 8
CAUSES = ("adhesion", "bone_stiffening", "creep", "defocus", "force_offset", "modulus", "off_axis_load", "vignetting")
MOVED_MM = (0.0, 0.03)
"""Of the finger: its edge lies otherwise among the pixels."""


def whitened(change: np.ndarray, sd: np.ndarray, valid: np.ndarray) -> float:
    """Return the norm of a change of one view over its noise."""
    return float(np.linalg.norm((change / sd)[valid]))


def one_view(model: AnchoredModel, noise: np.ndarray, k: int, point: dict[str, float]) -> dict[str, float]:
    """Return the distances of a view's predictions from that by the finest pixels."""
    view, data = model.data.views[k], model.data
    px = CARD_PX if view.is_card else FINE_PX

    def by(side: int) -> np.ndarray:
        return np.asarray(binned(model.fine(point, [view], side).frames())[0])

    truth = by(FINEST_PX)
    anchored = model.anchor(point)[k]
    predictions = {
        "coarse": model.coarse.cube(point)[k] - model.coarse.correction[k],
        f"{COARSER_PX} pixels": by(COARSER_PX), f"{px} pixels": by(px), "extrapolated": anchored,
    }  # fmt: skip
    found = {name: whitened(one - truth, noise[k], data.valid[k]) for name, one in predictions.items()}
    return found | {"counted as unknown": whitened(step_sd(data.cube)[k], noise[k], data.valid[k])}


def derivatives(model: AnchoredModel, noise: np.ndarray, causes: Sequence[str]) -> list[tuple[str, dict[str, float]]]:
    """Return for each cause how much of its change by fine pixels the critic's derivatives hold."""
    data, found = model.data, []
    nuisances = [p for p in model.nuisances() if p.linear or p.name.startswith("@pose")]
    model.anchor({})

    def fine(point: dict[str, float]) -> np.ndarray:
        return np.asarray(binned(model.fine(point).frames()))

    base = fine({})

    def fine_row(point: dict[str, float], step: float, views: Sequence[int] | None = None) -> np.ndarray:
        change = np.nan_to_num(fine(point) - base) / step
        chosen = np.isin(np.arange(len(change)), range(len(change)) if views is None else views)
        return np.asarray(data.whitened(np.where(chosen[:, None, None], change, 0.0)))

    def fine_nuisance(parameter: Parameter) -> np.ndarray:
        step = 0.1 * parameter.deviation if not parameter.name.startswith("@pose") else 0.01
        return fine_row({parameter.name: step}, step, parameter.views)

    scene, scale = model.observation.scene, data.scale
    halves, whole = model.coarse, Predictor(scene, data.views, noise_scale=scale, pixels=model.factor)
    deviations = np.array([p.deviation for p in nuisances])
    exact = Metric.of(np.array([fine_nuisance(p) for p in nuisances]), deviations)
    metrics = []
    for model.coarse in (halves, whole):
        metrics.append(Metric.of(np.array([model.derivative({}, p) for p in nuisances]), deviations))
    for cause in causes_of(model.observation)[0]:
        if cause.id not in causes:
            continue
        amplitude = next(p for p in cause.parameters if p.name in cause.amplitudes)
        step = amplitude.null + 0.1 * amplitude.deviation
        true = fine_row({amplitude.name: step}, 1.0)
        row = {}
        for name, model.coarse, quick in zip(("whole pixels", "halves"), (whole, halves), metrics[::-1], strict=True):
            own = model.vector({amplitude.name: step}) - model.vector({})
            left = float(true @ quick.project(true))
            row[name] = float(true @ quick.project(own)) ** 2 / left / float(own @ quick.project(own))
        # Halves came last: their metric is the critic's.
        row["seems larger"] = float(np.sqrt(left / float(true @ exact.project(true))))
        larger_sd = (data.sd / noise)[list(data.open)]
        row["kept"] = float(np.linalg.norm(true) / np.linalg.norm(data.unwhitened(true) * larger_sd))
        found.append((amplitude.name, row))
    return found


def table(rows: Sequence[tuple[str, dict[str, float]]]) -> str:
    """Return distances as text."""
    names = list(dict.fromkeys(name for _, row in rows for name in row))
    lines = [f"{'view':34s}" + "".join(f"{name:>20s}" for name in names)]
    return "\n".join([*lines, *(f"{k:34s}" + "".join(f"{row.get(n, np.nan):20.2f}" for n in names) for k, row in rows)])


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", type=Path)
    target = parser.parse_args().json
    scene = load_scene("thesis", RIG)
    protocol = replace(default_protocol(scene), replicates=8)
    rows: list[tuple[str, dict[str, float]]] = []
    slopes: list[tuple[str, dict[str, float]]] = []
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "bundle"
        write_bundle(path, scene, seed=5, nominal=scene, protocol=protocol)
        observation = observe(read_bundle(path))
        data = data_vector(observation)
        noise = np.sqrt(data.sd**2 - step_sd(data.cube) ** 2)
        model = AnchoredModel(observation, data)
        known: set[Any] = set()
        for k, view in enumerate(data.views):
            if (kind := (view.kind, view.force_N, view.voltage_V)) in known or not (view.touches or view.is_card):
                continue
            known.add(kind)
            for moved in MOVED_MM if view.touches else MOVED_MM[:1]:
                point = {f"@pose_x[{view.session}]": moved} if moved else {}
                name = f"{view.kind} {view.force_N or 0:g} N {view.voltage_V:g} V" + (f", {moved} mm" if moved else "")
                rows.append((name, one_view(model, noise, k, point)))
                print(table(rows[-1:]), flush=True)
        slopes = derivatives(model, noise, CAUSES)
    print("\n" + table(rows) + "\n\n" + table(slopes))
    if target is not None:
        target.write_text(json.dumps({"pixels": dict(rows), "derivatives": dict(slopes)}, indent=1), encoding="utf-8")


if __name__ == "__main__":
    main()
