"""A finger pressed askew: which part of its tip meets the glass, and the body beyond the tip.

A sphere looks the same from every side, so that on the spherical tip the contact is that of the upright finger. Its
skin is turned: the point that touches lies R tilt from the apex, on the side to which the finger leans. Beyond the
tip's rim the cylinder takes over; where the contact reaches there, only the half-space has an answer.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from evanesce.core.errors import InputError
from evanesce.core.states import PlateGrid
from evanesce.rig import Finger, Scene
from evanesce.rig.finger import FemLaw

Array = NDArray[np.float64]


def tilt_of(scene: Scene) -> tuple[float, float]:
    """Return a scene's tilt from the plate's normal and the direction in which the finger's top leans [rad].

    Parameters
    ----------
    scene : Scene

    Returns
    -------
    tuple of float
        (0, 0) for an upright finger.

    Raises
    ------
    InputError
        For a law that has solved upright fingers only.
    """
    law = scene.contact
    if not law.tilt_deg:
        return 0.0, 0.0
    if isinstance(law, FemLaw):
        raise InputError(
            f"a finger tilted by {law.tilt_deg:g} deg was not solved with law fem",
            key="contact.tilt_deg",
            allowed="0, or another law",
        )
    return math.radians(law.tilt_deg), math.radians(law.tilt_direction_deg or 0.0)


def tip_half_angle(finger: Finger) -> float:
    """Return the angle from a tip's axis to its rim, seen from the sphere's centre [rad]; pi/2 of a hemisphere.

    Parameters
    ----------
    finger : Finger

    Returns
    -------
    float
    """
    return math.asin(min(1.0, 0.5 * finger.diameter_mm / finger.tip_radius_mm))


def require_on_tip(scene: Scene, contact_radius: float) -> None:
    """Refuse a round contact [mm] that reaches over the rim of a tilted finger's tip.

    Parameters
    ----------
    scene : Scene
    contact_radius : float
        [mm].

    Raises
    ------
    InputError
    """
    tilt, _ = tilt_of(scene)
    if tilt == 0.0:
        return
    room = tip_half_angle(scene.finger) - math.asin(min(1.0, contact_radius / scene.finger.tip_radius_mm))
    if tilt > room:
        raise InputError(
            f"a contact of radius {contact_radius:.3g} mm reaches over the rim of the tip",
            key="contact.tilt_deg",
            allowed=f"at most {math.degrees(max(room, 0.0)):.3g} deg under this force, or law halfspace",
        )


def turned_skin(scene: Scene) -> Finger:
    """Return the finger with its tip moved to where the apex of its unrolled skin lies beside the contact.

    Parameters
    ----------
    scene : Scene

    Returns
    -------
    Finger
        The scene's own for an upright finger; for placing a relief only.
    """
    tilt, direction = tilt_of(scene)
    finger = scene.finger
    if tilt == 0.0:
        return finger
    arc, (x, y) = finger.tip_radius_mm * tilt, finger.position_mm
    return finger.model_copy(update={"position_mm": (x - arc * math.cos(direction), y - arc * math.sin(direction))})


def tilted_heights(scene: Scene, grid: PlateGrid) -> Array:
    """Return the distance of a tilted smooth finger's surface from the glass it just touches [mm].

    Parameters
    ----------
    scene : Scene
    grid : PlateGrid

    Returns
    -------
    ndarray (rows, cols)
        The tip's parabola r^2/(2 R), as for an upright finger; beyond its rim the cylinder's side
        R + (X cos(tilt) - sqrt(rho^2 - Y^2))/sin(tilt), X along the lean and Y across it; beyond its outline its
        diameter, out of reach.
    """
    finger, (tilt, direction) = scene.finger, tilt_of(scene)
    x, y = grid.x[None, :] - finger.position_mm[0], grid.y[:, None] - finger.position_mm[1]
    radius, rho = finger.tip_radius_mm, 0.5 * finger.diameter_mm
    sphere = (x**2 + y**2) / (2.0 * radius)
    along, across = x * math.cos(direction) + y * math.sin(direction), y * math.cos(direction) - x * math.sin(direction)
    down = np.sqrt(np.clip(radius**2 - along**2 - across**2, 0.0, None))
    # cosine of the angle between a point of the sphere and the apex, which lies against the lean
    on_tip = down * math.cos(tilt) - along * math.sin(tilt) >= radius * math.cos(tip_half_angle(finger))
    inside = np.abs(across) < rho
    side = radius + (along * math.cos(tilt) - np.sqrt(np.clip(rho**2 - across**2, 0.0, None))) / math.sin(tilt)
    beyond = np.where(inside & (along <= rho), np.maximum(side, sphere), sphere + finger.diameter_mm)
    return np.where(on_tip, sphere, beyond)
