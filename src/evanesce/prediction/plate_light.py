"""Light that leaves the plate in predictions (moved contacts, veiled cards, none at all), and what decides it."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import numpy as np

from evanesce.core.states import ContactState, PlateLight
from evanesce.optics.led import led_positions
from evanesce.optics.projection import IdealView, Projection
from evanesce.render.cards import Illumination
from evanesce.render.fast.fields import fields_of
from evanesce.render.fast.rig_optics import radiances_of
from evanesce.render.fast.transport import render_fast
from evanesce.rig import Scene


def render_moved(
    rig: Scene, state: ContactState, shift_mm: tuple[float, float], finer: int = 1, step: int | None = None
) -> PlateLight:
    """Render a contact beside its believed place; the guided light of the plate is the believed place's own field.

    The field is smooth and known over the whole contact grid; a new one would cost seconds for each place.
    """
    view = finer_view(rig, finer)
    if not any(shift_mm):
        return render_fast(rig, state, view=view, step=step)
    dx, dy = shift_mm
    grid = state.grid
    moved_state = replace(state, grid=replace(grid, centre=(grid.centre[0] + dx, grid.centre[1] + dy)))
    x, y = rig.finger.position_mm
    moved = rig.model_copy(update={"finger": rig.finger.model_copy(update={"position_mm": (x + dx, y + dy)})})
    return render_fast(moved, moved_state, view=view, fields=fields_of(rig), step=step)


def finer_view(rig: Scene, finer: int) -> IdealView:
    """Return the rig's pinhole grid with so many times as many pixels along each side."""
    return Projection.of(rig.camera, rig.plate).ideal_view().finer(finer)


def veiled(light: PlateLight, veil: float) -> PlateLight:
    """Return a card's light with some that covers it evenly, over its illumination; there is never less than none."""
    added = veil * Illumination().radiance
    return replace(light, radiance=np.maximum(light.radiance + added, 0.0)) if veil else light


def dark(rig: Scene) -> PlateLight:
    """Return no light, seen by the rig's camera."""
    view = Projection.of(rig.camera, rig.plate).ideal_view()
    nothing = np.zeros(view.shape, np.float32)
    return PlateLight(
        radiance=nothing, variance=nothing, focal_px=view.focal_px, principal_point=view.principal_point, samples=0
    )


def sight(rig: Scene) -> tuple[Any, ...]:
    """Return all of the camera that decides which rays it gathers."""
    seen = Projection.of(rig.camera, rig.plate)
    return (
        seen.shape, seen.focal_px, seen.principal_point, seen.distortion, seen.axes.tobytes(), seen.pinhole.tobytes(),
        seen.thickness, seen.refractive_index, rig.camera.wavelength_nm,
    )  # fmt: skip


def behind_plate(rig: Scene, marked: bool, leds: bool) -> str:
    """Return all that decides the irradiance on the sensor for a given light.

    Parameters
    ----------
    rig : Scene
    marked : bool
        Whether effects act on the way, by the exposure or light of their own.
    leds : bool
        Whether the LEDs that those scatter are to be told as well.
    """
    camera = rig.camera.model_dump(exclude={"exposure_ms", "analogue_gain", "tone_curve", "pixel"})
    marks = [rig.camera.exposure_ms, rig.camera.pixel.model_dump()] if marked else []
    marks += [rig.leds.model_dump()] if marked and leds else []
    return json.dumps([camera, rig.camera.pixel.pitch_um, rig.plate.model_dump(), marks], sort_keys=True)


def unlit(rig: Scene) -> Scene:
    """Return the rig with its LEDs off."""
    edges = {name: strip.model_copy(update={"voltage_V": None}) for name, strip in rig.leds.edge.items()}
    return rig.model_copy(update={"leds": rig.leds.model_copy(update={"voltage_V": 0.0, "edge": edges})})


def led_pattern(rig: Scene) -> tuple[tuple[Any, ...], float]:
    """Return places and relative radiances of the LEDs, and their mean radiance [W mm^-2 sr^-1]."""
    radiances = radiances_of(rig)
    every = np.concatenate(list(radiances.values()))
    level = float(every.mean())
    shares = every / level if level > 0 else every
    places = tuple((edge, place.tobytes()) for edge, place in led_positions(rig.plate, rig.leds).items())
    return (places, tuple(np.round(shares, 12))), level
