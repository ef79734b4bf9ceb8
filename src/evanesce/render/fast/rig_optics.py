"""A scene's plate, interface and finger as the closed forms of :mod:`evanesce.optics` take them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from evanesce.core.provenance import digest
from evanesce.optics.edge_rays import EdgeLight
from evanesce.optics.flank.surface import FingerSurface
from evanesce.optics.led import led_positions, led_radiances
from evanesce.optics.patch_light import Interface
from evanesce.render.kept import kept
from evanesce.rig import Scene

Array = NDArray[np.float64]

_NOT_GEOMETRY = ("exposure_ms", "analogue_gain", "tone_curve")


def edge_light(scene: Scene) -> EdgeLight:
    """Return the plate of a scene as a light guide with its LEDs at their powers.

    Parameters
    ----------
    scene : Scene
    """
    return EdgeLight(
        size=scene.plate.size_mm,
        thickness=scene.plate.thickness_mm,
        refractive_index=scene.plate.refractive_index,
        absorption_coefficient=scene.plate.absorption_coefficient_per_mm,
        edge_reflectance=scene.plate.edge_reflectance,
        positions=led_positions(scene.plate, scene.leds),
        radiances=radiances_of(scene),
        emitter_size=(scene.leds.emitting_width_mm, scene.leds.emitting_height_mm),
        edge_polish=scene.plate.edge_polish,
        air_gap_share=scene.leds.air_gap_share,
    )


def radiances_of(scene: Scene) -> dict[str, Array]:
    """Return :func:`~evanesce.optics.led.led_radiances` of a scene, kept: each is a circuit solved.

    Parameters
    ----------
    scene : Scene
    """
    key = repr((scene.plate.size_mm, scene.leds))
    return dict(kept("led radiances", key, lambda: led_radiances(scene.plate, scene.leds)))


def interface_of(scene: Scene) -> Interface:
    """Return the interface of a scene's plate and finger.

    Parameters
    ----------
    scene : Scene
    """
    return Interface(
        n_glass=scene.plate.refractive_index,
        n_silicone=scene.finger.refractive_index,
        body_reflectance=scene.finger.diffuse_reflectance,
        wavelength=scene.camera.wavelength_nm,
    )


def finger_surface(scene: Scene) -> FingerSurface:
    """Return the finger's outer surface, without ridges.

    Parameters
    ----------
    scene : Scene
    """
    finger = scene.finger
    half = min(finger.diameter_mm / 2, finger.tip_radius_mm)
    return FingerSurface(finger.position_mm, finger.tip_radius_mm, half, finger.length_mm)


def geometry_digest(scene: Scene) -> str:
    """Return the digest of all that decides where the camera sees plate and finger: of no light, and of no contact.

    Parameters
    ----------
    scene : Scene
    """
    data = scene.table("finger")
    finger = {k: data[k] for k in ("position_mm", "tip_radius_mm", "diameter_mm", "length_mm")}
    return digest([sight_digest(scene), finger])


def sight_digest(scene: Scene) -> str:
    """Return the digest of all that decides where the camera sees the plate.

    Parameters
    ----------
    scene : Scene
    """
    camera = {k: v for k, v in scene.table("camera").items() if k not in _NOT_GEOMETRY}
    return digest(
        [camera, {"thickness_mm": scene.plate.thickness_mm, "refractive_index": scene.plate.refractive_index}]
    )
