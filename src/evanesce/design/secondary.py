"""Objectives beside the area error: motion blur, saturation, light per watt, fields, deflection, power, cost."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from evanesce.design.bending import deflection, rigidity
from evanesce.design.objective import Prediction, contact_radius
from evanesce.design.parts import PartsTable, cost
from evanesce.design.question import Design, Question
from evanesce.optics.led import led_positions
from evanesce.optics.led_circuit import segment_current
from evanesce.rig import Camera, Scene
from evanesce.sensor.lens import magnification

MIN_PATCH_MM = 1e-3
"""Side of the loaded square for a finger without contact [mm]."""


@dataclass(frozen=True)
class Objective:
    """A figure to be minimised or maximised.

    Attributes
    ----------
    name, unit, doc : str
    direction : {"minimize", "maximize"}
    """

    name: str
    unit: str
    direction: Literal["minimize", "maximize"]
    doc: str


OBJECTIVES: Mapping[str, Objective] = {
    o.name: o
    for o in (
        Objective("area_error", "%", "minimize", "95 % of measured areas are nearer to the truth than this"),
        Objective("exposure", "ms", "minimize", "exposure time"),
        Objective("motion_blur", "mm", "minimize", "sliding distance during the exposure"),
        Objective("saturation", "1", "minimize", "share of the contact at full scale, mean over drawn rigs"),
        Objective("light_per_watt", "nW/mm² per W", "maximize", "irradiance of the contact's image"),
        Objective("field_of_view", "mm", "maximize", "shorter side of the camera's field"),
        Objective("depth_of_field", "mm", "maximize", "depth within which a point stays in one pixel"),
        Objective("deflection", "µm", "minimize", "of the plate under the largest force at the worst position"),
        Objective("power", "W", "minimize", "electrical power of the LED strips"),
        Objective("cost", "currency", "minimize", "of the parts, by the user's table"),
    )
}  # fmt: skip


def motion_blur_mm(speed_mm_per_s: float, exposure_ms: float) -> float:
    """Return the sliding distance during an exposure [mm]."""
    return speed_mm_per_s * exposure_ms * 1e-3


def depth_of_field_mm(camera: Camera) -> float:
    """Return the depth in which a point's disc stays below one pixel: 2 N c (1 + m)/m^2 [mm].

    For distances far below the hyperfocal one, as close-up pictures are taken at; in air, before the plate stretches
    it by its refractive index.

    References
    ----------
    Kingslake, "Optics in Photography", SPIE Press (1992), chapter 5.
    """
    m = magnification(camera.scale_px_per_mm, camera.pixel.pitch_um)
    return 2.0 * camera.lens.f_number * camera.pixel.pitch_um * 1e-3 * (1.0 + m) / m**2


def field_of_view_mm(camera: Camera) -> tuple[float, float]:
    """Return the camera's field along columns and rows, before distortion [mm]."""
    cols, rows = camera.resolution_px
    return cols / camera.scale_px_per_mm, rows / camera.scale_px_per_mm


def electrical_power_W(scene: Scene) -> float:
    """Return the electrical power of all LEDs: each draws its share of its segment's current [W].

    Strips without resistance; whole segments need not fit on an edge.
    """
    leds, total = scene.leds, 0.0
    for edge, positions in led_positions(scene.plate, leds).items():
        own = next((v for k, v in leds.edge.items() if k == edge), None)
        voltage = leds.voltage_V if own is None or own.voltage_V is None else own.voltage_V
        total += (
            positions.size / leds.circuit.leds_per_segment * voltage * float(segment_current(leds.circuit, voltage))
        )
    return total


def plate_deflection_um(scene: Scene, question: Question) -> float:
    """Return the plate's deflection under the worst case of a question, its edges simply supported [µm].

    The load spreads over a square of the contact's area. Clamped edges would bend less.

    Raises
    ------
    InputError
        If a contact reaches over the plate's edge.
    """
    worst, bending = 0.0, rigidity(scene.plate.thickness_mm)
    for case in question.cases:
        side = max(math.sqrt(math.pi) * contact_radius(scene, case, question.seed), MIN_PATCH_MM)
        worst = max(worst, deflection(case.force_N, case.position_mm, (side, side), scene.plate.size_mm, bending))
    return 1e3 * worst


def figures(
    design: Design, question: Question, prediction: Prediction, irradiance: float, parts: PartsTable | None
) -> dict[str, float]:
    """Return all objectives of a design, in their units; the cost is NaN without a table.

    Parameters
    ----------
    design : Design
    question : Question
    prediction : Prediction
    irradiance : float
        Of the contact's image, as designed [W mm^-2].
    parts : PartsTable, optional
    """
    scene = design.scene
    power = electrical_power_W(scene)
    return {
        "area_error": prediction.error_percent,
        "exposure": scene.camera.exposure_ms,
        "motion_blur": motion_blur_mm(question.speed_mm_per_s, scene.camera.exposure_ms),
        "saturation": prediction.saturated_share,
        "light_per_watt": 1e9 * irradiance / power if power > 0 else 0.0,
        "field_of_view": min(field_of_view_mm(scene.camera)),
        "depth_of_field": depth_of_field_mm(scene.camera),
        "deflection": plate_deflection_um(scene, question),
        "power": power,
        "cost": float(np.nan) if parts is None else cost(parts, design),
    }
