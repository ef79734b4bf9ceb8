"""Series drawn by hand: closed forms of contact mechanics and a disc blurred at its edge; of the project only the
nominal rig's file.

A sphere of 6 mm radius and a reduced modulus of 0.24 MPa on a plate: Hertz 1882; Johnson, Kendall, Roberts 1971 where
it adheres; a compliance that rises with the logarithm of time. Area readings see the contact EDGE_MM larger: at 0.15 of
full scale, below half, an edge that pixels and blur have smeared is found outside of where it is.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.rig import dump_scene, load_scene

Array = NDArray[Any]

RADIUS_MM, MODULUS_MPA, EDGE_MM = 6.0, 0.24, 0.16
NOMINAL = {
    "camera.resolution_px": [400, 300],
    "camera.scale_px_per_mm": 11.674,
    "finger.tip_radius_mm": RADIUS_MM,
    "contact": {"law": "hertz", "reduced_modulus_MPa": MODULUS_MPA},
}
"""The nominal rig: the shipped one with this sphere and a camera of 400 x 300 pixels."""
FORCES = np.array([0.2, 0.4, 0.7, 1.0, 1.5, 2.2, 3.0, 4.0])
DEPTHS = np.array([0.15, 0.25, 0.35, 0.5, 0.65, 0.8, 1.0])
TIMES = np.array([1.0, 3.0, 10.0, 30.0, 100.0, 300.0, 1000.0])


@dataclass(frozen=True)
class Truth:
    """What is hidden.

    Attributes
    ----------
    modulus : float
        Relative change of the reduced modulus.
    creep : float
        Rise of the compliance a decade after 0.1 s.
    offset_N : float
        Real less noted force.
    work_N_per_mm : float
        Of adhesion.
    wave : float
        Amplitude of a factor on areas that waves with the logarithm of force, which no law of contact does.
    """

    modulus: float = 0.0
    creep: float = 0.0
    offset_N: float = 0.0
    work_N_per_mm: float = 0.0
    wave: float = 0.0


def contact_radius(force: Array, modulus: Array | float, work: float) -> Array:
    """Return the radius of contact [mm] (Johnson, Kendall, Roberts 1971)."""
    pull = 3.0 * np.pi * RADIUS_MM * work
    load = force + pull + np.sqrt(2.0 * pull * force + pull**2)
    return np.cbrt(0.75 * RADIUS_MM * load / modulus)


def drawn(truth: Truth, rng: np.random.Generator, sigma: float = 0.03) -> dict[str, tuple[Array, Array, Array]]:
    """Return x, y and sigma of area against force and time, and force against displacement."""
    stiff = MODULUS_MPA * (1.0 + truth.modulus)

    def area(force: Array, time_s: Array) -> Array:
        soft = stiff / (1.0 + truth.creep * np.log10(1.0 + time_s / 0.1))
        return np.pi * (contact_radius(force + truth.offset_N, soft, truth.work_N_per_mm) + EDGE_MM) ** 2

    by_force = area(FORCES, np.zeros(FORCES.size)) * (1.0 + truth.wave * np.sin(2.0 * np.pi * np.log(FORCES) / 1.3))
    by_time = area(np.full(TIMES.size, 3.0), TIMES)
    real = np.linspace(0.01, 12.0, 4000)
    radius = contact_radius(real, stiff, truth.work_N_per_mm)
    depth = radius**2 / RADIUS_MM - np.sqrt(2.0 * np.pi * truth.work_N_per_mm * radius / stiff)
    by_depth = np.interp(DEPTHS, depth, real) - truth.offset_N
    found = {"area_force": (FORCES, by_force), "area_time": (TIMES, by_time), "force_depth": (DEPTHS, by_depth)}
    return {n: (x, y * (1.0 + sigma * rng.standard_normal(x.size)), sigma * y) for n, (x, y) in found.items()}


def written(folder: Any, truth: Truth, seed: int, *, only: tuple[str, ...] = (), sigma: float = 0.03) -> Any:
    """Write a bundle of drawn series, and return its folder."""
    headers = {
        "area_force": "force_N,area_mm2,sigma_mm2",
        "area_time": "time_s,area_mm2,sigma_mm2",
        "force_depth": "displacement_mm,force_N,sigma_N",
    }
    (folder / "series").mkdir(parents=True)
    (folder / "scene.toml").write_text(dump_scene(load_scene("thesis", NOMINAL)))
    (folder / "measurement.toml").write_text('scene = "scene.toml"\n[series.area_time]\nforce_N = 3.0\n' if not only or
                                             "area_time" in only else 'scene = "scene.toml"\n')  # fmt: skip
    for name, (x, y, s) in drawn(truth, np.random.default_rng(seed), sigma).items():
        if only and name not in only:
            continue
        lines = [f"{a:.6g},{b:.6g},{c:.4g}" for a, b, c in zip(x, y, s, strict=True)]
        (folder / "series" / f"{name}.csv").write_text("\n".join([headers[name], *lines]) + "\n")
    return folder
