"""How far outside the contact the refined boundary runs, against the width of its edge: the law of the budget.

Presses on rigs drawn at random, none of them the scene's own: stiffness, ridges, place, force and voltage. A quarter of
the fingers is smooth. The calibration is without error, so that what remains is the boundary's own.

    python benchmarks/film.py [--presses 48] [--seed 77] [--keep FILE] [--json FILE]
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from evanesce.core import provenance, rng
from evanesce.evaluation.calibrated_rig import CardErrors, calibrated
from evanesce.measurement.calibration.model import Calibration
from evanesce.measurement.refined.estimator import Estimator
from evanesce.rig import Scene, load_scene
from evanesce.studies.estimator.study import LitPress


@dataclass(frozen=True)
class Press:
    """One press: what was drawn, what was found.

    Attributes
    ----------
    smooth : bool
    force_N, voltage_V, modulus_MPa : float
    true_mm2, found_mm2, perimeter_mm : float
    spread_mm : float
        Of the edge (:func:`evanesce.measurement.refined.edge.edge_spread`).
    sharp_spread_mm, shape_gain : float
        Of a sharp contact of the same shape (:mod:`evanesce.measurement.refined.replica`).
    """

    smooth: bool
    force_N: float
    voltage_V: float
    modulus_MPa: float
    true_mm2: float
    found_mm2: float
    perimeter_mm: float
    spread_mm: float
    sharp_spread_mm: float
    shape_gain: float

    @property
    def way_mm(self) -> float:
        """How far outside the contact the boundary runs on average, after what the search does to a sharp contact."""
        return (self.found_mm2 / (1 + self.shape_gain) - self.true_mm2) / self.perimeter_mm


def drawn(draw: np.random.Generator, number: int) -> tuple[Scene, float, float]:
    """Return scene, force [N] and voltage [V] of one press."""
    modulus = float(np.exp(draw.uniform(np.log(0.4), np.log(4.0))))
    force = float(np.exp(draw.uniform(np.log(0.5), np.log(5.0))))
    voltage = float(draw.uniform(8.2, 9.8))  # nothing saturates
    place = float(draw.uniform(-11, 11)), float(draw.uniform(-8, 8))
    pitch = float(draw.uniform(800, 1300))
    ridges = {"pitch_um": pitch, "width_um": pitch * float(draw.uniform(0.45, 0.6))}
    ridges |= {"height_um": float(draw.uniform(35, 60)), "orientation_deg": float(draw.uniform(-90, 90))}
    scene = load_scene("thesis" if number % 4 == 3 else "thesis_ridged")
    finger = {"position_mm": place}
    if scene.finger.ridges is not None:
        finger["ridges"] = scene.finger.ridges.model_copy(update=ridges)
    contact = scene.contact.model_copy(update={"reduced_modulus_MPa": modulus})
    return (
        scene.model_copy(update={"finger": scene.finger.model_copy(update=finger), "contact": contact}),
        force,
        voltage,
    )


def pressed(scene: Scene, force: float, voltage: float, calibration: Calibration) -> Press:
    """Solve the contact, expose and measure."""
    press = LitPress.of(scene, force, 1)
    found = Estimator.of(calibration).area(press.frame(voltage, rng.integer_seed(1, "f", f"{force}")).data)
    assert found.spread_mm is not None
    assert found.sharp_spread_mm is not None
    assert scene.contact.reduced_modulus_MPa is not None
    return Press(
        scene.finger.ridges is None, force, voltage, scene.contact.reduced_modulus_MPa, press.true_mm2,
        found.area_mm2, found.perimeter_mm, found.spread_mm, found.sharp_spread_mm, found.shape_gain,
    )  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--presses", type=int, default=48)
    parser.add_argument("--seed", type=int, default=77)
    parser.add_argument(
        "--keep", type=Path, help="finished presses, one JSON object a line; an interrupted run goes on"
    )
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    calibration = calibrated(load_scene("thesis"), rng.generator(1, "nominal"), CardErrors(corner_noise_px=0.0))
    kept = given.keep.read_text().splitlines() if given.keep and given.keep.is_file() else []
    presses = [Press(**json.loads(line)) for line in kept]
    draw = np.random.default_rng(given.seed)
    for number in range(given.presses):
        scene, force, voltage = drawn(draw, number)
        if number < len(presses):
            continue
        start = time.perf_counter()
        presses.append(pressed(scene, force, voltage, calibration))
        p = presses[-1]
        print(
            f"{'smooth' if p.smooth else 'ridged'} {p.modulus_MPa:.2f} MPa {force:.2f} N {voltage:.1f} V: area"
            f" {p.true_mm2:.3f} mm2, {1e3 * p.way_mm:+.2f} um outside, edge {1e3 * p.spread_mm:.2f} um wider,"
            f" {1e3 * p.sharp_spread_mm:.2f} um if sharp, gain {100 * p.shape_gain:+.2f} %;"
            f" {time.perf_counter() - start:.0f} s", flush=True,
        )  # fmt: skip
        if given.keep:
            with given.keep.open("a", encoding="utf-8") as stream:
                stream.write(json.dumps(asdict(p)) + "\n")
    way, spread = np.array([p.way_mm for p in presses]), np.array([p.spread_mm - p.sharp_spread_mm for p in presses])
    terms = np.stack([spread, np.ones_like(spread)], axis=1)
    law, *_ = np.linalg.lstsq(terms, way, rcond=None)
    left = way - terms @ law
    # the scatter of a further rig: that of these, and what their finite number leaves unknown of the line
    standard = float(np.sqrt((left**2).sum() / (len(left) - 2) * (1 + 2 / len(left))))
    percent = 100 * np.array([p.perimeter_mm / p.true_mm2 for p in presses])
    print(
        f"way = {law[0]:.3f} excess {1e3 * law[1]:+.3f} um; left {1e3 * standard:.3f} um, worst"
        f" {1e3 * np.abs(left).max():.2f} um; of the area {np.std(percent * left):.3f} % left of"
        f" {np.sqrt(np.mean((percent * way) ** 2)):.3f} % (RMS)"
    )
    if given.json:
        result = {
            "per_spread": law[0], "offset_mm": law[1], "standard_mm": standard, "presses": [asdict(p) for p in presses],
            "provenance": dict(provenance.record(seed=given.seed)),
        }  # fmt: skip
        given.json.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
