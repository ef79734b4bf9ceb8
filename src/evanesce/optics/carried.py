"""Where a sliding finger is: its body moves over the plate with its tip."""

from __future__ import annotations

import math

from evanesce.core.states import ContactState
from evanesce.rig import Scene


def carried_by(scene: Scene, state: ContactState) -> tuple[float, float]:
    """Return how far a scene's slide has carried its finger over the plate as the camera sees it (x, y) [mm].

    Parameters
    ----------
    scene : Scene
    state : ContactState

    Returns
    -------
    tuple of float
        Zeros without a slide, before the tip has moved, and where the glass moves under the camera.
    """
    tip = float(state.parameters.get("tip_displacement_mm", 0.0))
    if scene.slide is None or scene.slide.glass_moves or tip == 0.0:
        return 0.0, 0.0
    angle, aside = math.radians(scene.slide.direction_deg), float(state.parameters.get("tip_aside_mm", 0.0))
    cos, sin = math.cos(angle), math.sin(angle)
    return tip * cos - aside * sin, tip * sin + aside * cos


def carried_finger(scene: Scene, state: ContactState) -> Scene:
    """Return a scene with its finger where a state of its slide has taken it.

    The body moves as its tip does: the shaft's bending, which carries its top further, is left out.

    Parameters
    ----------
    scene : Scene
    state : ContactState

    Returns
    -------
    Scene
        The same one where nothing has moved.
    """
    dx, dy = carried_by(scene, state)
    if not (dx or dy):
        return scene
    x, y = scene.finger.position_mm
    moved = (x + dx, y + dy)
    return scene.model_copy(update={"finger": scene.finger.model_copy(update={"position_mm": moved})})
