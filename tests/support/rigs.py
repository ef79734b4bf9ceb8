"""Small, ugly rigs for the tests of the renderer: nothing centred, nothing equal."""

from __future__ import annotations

import functools

import numpy as np
import pytest

from evanesce.core.states import ContactState, PlateGrid
from evanesce.optics.projection import IdealView, Projection
from evanesce.render.variant import attempts
from evanesce.rig import Scene


@functools.cache
def _works(family: str) -> str:
    tried = attempts(family)
    return "" if tried and tried[-1].works else (tried[-1].error if tried else "no libLLVM found")


def need(family: str) -> None:
    """Skip where a variant family does not work on this machine."""
    if reason := _works(family):
        pytest.skip(f"{family} does not work here: {reason}")


def small_rig(**changes: object) -> Scene:
    """Return a plate of 62 x 47 x 5 mm with three lit edges; dotted keys (``plate__edge_reflectance``) replace."""
    data: dict = {
        "plate": {
            "size_mm": (62.0, 47.0),
            "thickness_mm": 5.0,
            "refractive_index": 1.523,
            "absorption_coefficient_per_mm": 0.002,
            "edge_reflectance": 0.35,
        },
        "leds": {
            "edges": ("left", "top", "right"),
            "pitch_mm": 11.0,
            "emitting_width_mm": 4.0,
            "emitting_height_mm": 2.5,
            "voltage_V": 10.0,
            "edge": {"top": {"offset_mm": 1.7, "voltage_V": 9.0}},
        },
        "finger": {"position_mm": (3.3, -2.1), "diffuse_reflectance": 0.6},
        "camera": {
            "resolution_px": (64, 48),
            "scale_px_per_mm": 6.0,
            "centre_mm": (2.5, -1.5),
            "lens": {"focal_length_mm": 6.0},
            "pixel": {"pitch_um": 40.0},
        },
        "press": {"forces_N": (1.0,)},
        "render": {"max_depth": 400},
    }
    for key, value in changes.items():
        section, name = key.split("__")
        data[section][name] = value
    return Scene.model_validate(data)


def hard_contact(
    radius: float = 2.4,
    centre: tuple[float, float] = (3.3, -2.1),
    *,
    side: float = 11.0,
    samples: int = 256,
    gap: float = 0.05,
    notch: bool = True,
) -> ContactState:
    """Return a disc in full contact, with a quadrant bitten out at its lower right, and a wide gap elsewhere."""
    grid = PlateGrid((samples, samples), side / samples, centre)
    x, y = np.meshgrid(grid.x - centre[0], grid.y - centre[1])
    mask = np.hypot(x, y) < radius
    if notch:
        mask &= ~((x > 0.3) & (y > 0.5))
    share = mask.astype(float)
    return ContactState(
        grid=grid,
        pressure=0.1 * share,
        gap=np.where(mask, 0.0, gap),
        contact_mask=share,
        normal_force=1.0,
        nominal_contact_area=float(mask.sum()) * grid.pitch**2,
        depth=0.4,
        law="stamp",
    )


def view_around(scene: Scene, centre: tuple[float, float], pixels: int, scale: float) -> IdealView:
    """Return a square view of ``pixels`` at ``scale`` [px/mm] whose middle sees a plate point."""
    projection = Projection.of(scene.camera, scene.plate)
    focal = projection.focal_px * scale / scene.camera.scale_px_per_mm
    x, y = projection.plate_to_ray(np.array(centre[0]), np.array(centre[1]))
    middle = (pixels - 1) / 2
    return IdealView((pixels, pixels), focal, (middle - float(x) * focal, middle - float(y) * focal))
