"""From a rig, its hidden causes and its nuisances to the mean picture of a view."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from evanesce.rig import Scene

from .camera import Developed, Electronics, Knee, on_pixels, true_curve
from .families_camera import moved
from .hidden import Hidden, Rig
from .rig import View, base_light, believed, geometry, power, views

Causes = Sequence[tuple[Hidden, float]]


@dataclass(frozen=True)
class Nuisances:
    """What no lab knows exactly, and every critic has to fit.

    Attributes
    ----------
    log_light : float
        Exposure and gain over the believed ones.
    black_DN : float
        Offset of the raw numbers.
    flicker, log_force : mapping of int to float
        By the shot's index: light of one frame; error of the load cell.
    card_light, card_slope : float, tuple of float
        Of the room on the cards; the slope over half the frame.
    """

    log_light: float = 0.0
    black_DN: float = 0.0
    flicker: Mapping[int, float] = field(default_factory=dict)
    log_force: Mapping[int, float] = field(default_factory=dict)
    card_light: float = 0.0
    card_slope: tuple[float, float] = (0.0, 0.0)


LIGHT_WIDTH, BLACK_WIDTH_DN = 0.08, 0.25
FLICKER, FORCE_ERROR = 0.002, 0.002
CARD_LIGHT_WIDTH, CARD_SLOPE_WIDTH = 0.15, 0.04


def draw_nuisances(rng: np.random.Generator, shots: Sequence[int]) -> Nuisances:
    """Draw nuisances; their widths are those above, the poses those of the rig's pool."""
    return Nuisances(
        log_light=float(rng.uniform(-1, 1) * LIGHT_WIDTH),
        black_DN=float(rng.uniform(-1, 1) * BLACK_WIDTH_DN),
        flicker={k: float(FLICKER * rng.standard_normal()) for k in shots},
        log_force={k: float(FORCE_ERROR * rng.standard_normal()) for k in shots},
        card_light=float(rng.uniform(-1, 1) * CARD_LIGHT_WIDTH),
        card_slope=tuple(float(v) for v in rng.uniform(-1, 1, 2) * CARD_SLOPE_WIDTH),
    )


def rig_of(name: str, pose: int) -> Rig:
    """Return a nominal rig at one pose of its pool."""
    scene: Scene = believed(name)
    return Rig(name, pose, scene, base_light(name, pose), geometry(name), Electronics.of(scene), views(name))


def fine_light(rig: Rig, view: View, causes: Causes, nuisances: Nuisances) -> np.ndarray:
    """Return the fine frame's irradiance [W mm^-2]."""
    shape, index = rig.at.u.shape, view.shot.index
    if view.kind == "lens_cap":
        return np.zeros(shape)
    if view.kind == "led_off":
        fine = np.zeros(shape)
    elif view.is_card:
        slope = nuisances.card_slope
        lit = np.exp(nuisances.card_light) * (1 + slope[0] * rig.at.u + slope[1] * rig.at.v)
        fine = rig.base.cards[view.kind] * lit
    else:
        k = rig.base.force_index(view.shot.force_N)
        pressed = nuisances.log_force.get(index, 0.0) + sum(c.log_force(view, a) for c, a in causes)
        fine = rig.base.pressed(k, pressed)
        shift = np.sum([c.shift_mm(view, a) for c, a in causes] or [(0.0, 0.0)], axis=0)
        if np.any(shift):
            fine = moved(fine, *(np.full(shape, s / rig.at.mm_per_px) for s in shift))
        light = nuisances.log_light + nuisances.flicker.get(index, 0.0)
        fine *= power(rig.name, view.shot.voltage_V) * np.exp(light)
    for cause, a in causes:
        fine = cause.light(fine, view, a)
    return fine


@dataclass(frozen=True)
class Exposure:
    """A view's mean charge [e-] and the offset of its raw numbers [DN]."""

    charge_e: np.ndarray
    offset_DN: np.ndarray | float

    def level(self, table: Developed) -> np.ndarray:
        """Return the mean picture [DN]."""
        return table.level(self.charge_e, self.offset_DN)


def expose(rig: Rig, view: View, causes: Causes, nuisances: Nuisances) -> Exposure:
    """Return what the pixels of a view gather on average."""
    fine = fine_light(rig, view, causes, nuisances)
    charge = rig.electronics.e_per_irradiance * on_pixels(fine)
    offset: np.ndarray | float = nuisances.black_DN
    for cause, a in causes:
        charge = cause.charge(charge, view, a)
        offset = offset + cause.offset_DN(view, a)
    return Exposure(np.maximum(charge, 0.0), offset)


def curve_of(rig: Rig, causes: Causes) -> np.ndarray:
    """Return the developed value of each raw number, 0 to 1."""
    e = rig.electronics
    curve = true_curve(e.curve, e.black_DN, e.top_DN)
    for cause, a in causes:
        curve = cause.curve(curve, a)
    return curve


def knee_of(causes: Causes) -> Knee | None:
    """Return how pixels fill up; None for as believed."""
    knees = [k for k in (cause.knee(a) for cause, a in causes) if k is not None]
    return min(knees) if knees else None


def development(rig: Rig, causes: Causes) -> Developed:
    """Return mean and variance of 8-bit values against charge and offset."""
    return Developed(rig.electronics, curve_of(rig, causes), knee_of(causes))
