"""Reflections of the LEDs at the frame's border: a veil from each side that decays inwards, brighter beside an LED."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from evanesce.core.quantities import Strict, field
from evanesce.core.states import PlateLight
from evanesce.effects.protocol import Context, Effect, Stage
from evanesce.optics.led import led_positions, led_radiances
from evanesce.optics.projection import Projection
from evanesce.render.fast.defects import contact_radiance, plate_points

SIDES = ("left", "right", "top", "bottom")
Array = NDArray[np.float64]


class Parameters(Strict):
    """Radiance at the border, decay length, and share of each side."""

    relative_radiance: float = field(
        0.0,
        unit="1",
        bounds=(0.0, 3.0),
        null=0.0,
        source="rig photograph: 0.37 of the white paper at the left border",
        doc="mean along the brightest side's border, over the radiance of a contact in the frame's middle",
    )
    decay_mm: float = field(
        3.1, unit="mm", bounds=(0.05, 100.0), source="rig photograph, left border", doc="fades by e over this, inwards"
    )
    sides: tuple[float, float, float, float] = field(
        (1.0, 0.08, 0.29, 0.04),
        unit="1",
        bounds=(0.0, 1.0),
        source="rig photograph",
        doc="share of left, right, top, bottom",
    )
    along_mm: float = field(
        3.0, unit="mm", bounds=(0.05, 500.0), doc="width (standard deviation) of one LED's veil along its side"
    )
    slant_deg: float = field(
        0.0,
        unit="deg",
        bounds=(-80.0, 80.0),
        doc="of the veils from straight inwards, towards +x or +y: narrow and long ones are oblique streaks",
    )


def apply(light: PlateLight, parameters: Parameters, context: Context) -> PlateLight:
    """Add, for each lit edge, its share of exp(-distance from the frame's border/decay) times its LEDs' comb.

    Parameters
    ----------
    light : PlateLight
    parameters : Parameters
    context : Context

    Returns
    -------
    PlateLight
    """
    if parameters.relative_radiance == 0.0:
        return light
    scene = context.scene
    x, y = plate_points(scene, light)
    radiances, positions = led_radiances(scene.plate, scene.leds), led_positions(scene.plate, scene.leds)
    mean = float(np.mean(np.concatenate(list(radiances.values()))))
    if mean == 0.0:
        return light
    borders = _borders(Projection.of(scene.camera, scene.plate))
    added = np.zeros(light.radiance.shape)
    for side, share in zip(SIDES, parameters.sides, strict=True):
        if side not in radiances or share == 0.0:
            continue
        inwards = {"left": x - borders[0], "right": borders[1] - x, "top": y - borders[2], "bottom": borders[3] - y}
        fading = np.exp(-np.maximum(inwards[side], 0.0) / parameters.decay_mm)
        coordinate = y if side in ("left", "right") else x
        along = np.linspace(float(coordinate.min()), float(coordinate.max()), 512)
        coordinate = coordinate - inwards[side] * math.tan(math.radians(parameters.slant_deg))
        comb = led_comb(along, positions[side], radiances[side] / mean, scene.leds.pitch_mm, parameters.along_mm)
        added += share * fading * np.interp(coordinate, along, comb)
    middle = float(contact_radiance(scene, *(np.array(c) for c in scene.camera.centre_mm)))
    return replace(light, radiance=light.radiance + parameters.relative_radiance * middle * added)


def led_comb(along: Array, positions: Array, power: Array, pitch: float, width: float) -> Array:
    """Return one Gaussian for each LED, so that a long row of equal LEDs of power 1 averages to 1.

    Parameters
    ----------
    along : ndarray (n,)
        [mm], along the edge.
    positions : ndarray (m,)
        Of the LEDs [mm].
    power : ndarray (m,)
        Of each, over the mean.
    pitch : float
        Of the LEDs [mm].
    width : float
        Standard deviation of a Gaussian [mm].

    Returns
    -------
    ndarray (n,)
    """
    bell = np.exp(-0.5 * ((along[:, None] - positions[None, :]) / width) ** 2)
    return np.asarray(bell @ power * (pitch / (width * math.sqrt(2 * math.pi))))


def _borders(projection: Projection) -> tuple[float, float, float, float]:
    """Return x of the left and right and y of the top and bottom border's middle on the plate [mm]."""
    rows, cols = projection.shape
    u = np.array([-0.5, cols - 0.5, (cols - 1) / 2, (cols - 1) / 2])
    v = np.array([(rows - 1) / 2, (rows - 1) / 2, -0.5, rows - 0.5])
    x, y = projection.to_plate(u, v)
    return float(x[0]), float(x[1]), float(y[2]), float(y[3])


EFFECT = Effect(
    id="led_edge_reflections",
    stage=Stage.PLATE_LIGHT,
    parameters=Parameters,
    amplitudes=("relative_radiance",),
    apply=apply,
    # The rig's photograph: 0.37 of paper, which is about 0.35 of a contact.
    fitted={"relative_radiance": 0.13, "decay_mm": 1.5},
    scaling="follows LED power: a veil at the frame's border that no force changes",
)
