"""A small, lopsided rig for the live page's tests, and what the library itself says of it, without the page's code."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from evanesce.chain.fast import FastCamera
from evanesce.chain.simulate import solve_contact
from evanesce.evaluation.perfect_view import PerfectView
from evanesce.measurement.reference.segment import Chain, Crop, segment
from evanesce.rig import Scene, load_scene
from evanesce.rig.coarser import coarser_camera

# A third of the pixels of the thesis's camera along each side, binned; finger as in test_fast.py, whose unit
# light is then computed once for both.
RIG: dict[str, Any] = {
    "camera.resolution_px": [668, 500],
    "camera.scale_px_per_mm": 19.4,
    "camera.pixel.pitch_um": 9.3,
    "camera.pixel.full_well_capacity_e": 73_600.0,
    "camera.pixel.conversion_gain_e_per_DN": 19.2,
    "camera.pixel.read_noise_e": 9.0,
    "camera.centre_mm": [0.7, -0.4],
    "finger.position_mm": [1.3, -0.8],
    "grid.samples": 512,
}


def rig(name: str = "thesis_ridged", **changes: Any) -> Scene:
    return load_scene(name, RIG | changes)


@dataclass(frozen=True)
class Expected:
    """What the library says of one frame."""

    frame: np.ndarray
    view: np.ndarray
    mask: np.ndarray
    truth: np.ndarray
    area_mm2: float
    true_mm2: float


def expected(
    force_N: float, *, threshold: float = 0.15, min_blob_px: int = 2000, coarser: int = 2, seed: int = 0, **changes: Any
) -> Expected:
    """Press, take the picture and measure at a lower resolution, each step by its own function."""
    scene = rig(**changes, **{"grid.samples": 512 // coarser})
    scene = coarser_camera(scene, coarser)
    _, state = solve_contact(scene, force_N, seed=seed)
    assert state is not None
    frame = FastCamera(scene).frame(state, seed=seed).data
    perfect = PerfectView.of(scene)
    view = perfect.straight(frame)
    chain = Chain(threshold=threshold, min_blob=round(min_blob_px / coarser**2), blur=1 / coarser, radius=10 // coarser)
    found = segment(view, chain)
    truth = np.asarray(perfect.labels(state, Crop()).mask)
    return Expected(frame, view, found.mask, truth, found.pixels * perfect.mm2_per_px, state.nominal_contact_area)
