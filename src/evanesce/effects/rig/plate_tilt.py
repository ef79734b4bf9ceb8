"""Tilt of the plate to the camera: foreshortening, and scale that changes across the image."""

from __future__ import annotations

import numpy as np

from evanesce.core.errors import InputError
from evanesce.core.quantities import Strict, field, quantity_of
from evanesce.effects.protocol import Context, Effect, Stage
from evanesce.optics.projection import rotation
from evanesce.rig import Camera, Scene


class Parameters(Strict):
    """Tilt about the plate's axes."""

    about_x_deg: float = field(0.0, unit="deg", bounds=(-10.0, 10.0), null=0.0, doc="of the plate about its own x")
    about_y_deg: float = field(0.0, unit="deg", bounds=(-10.0, 10.0), null=0.0, doc="of the plate about its own y")


def angles_of(axes: np.ndarray) -> tuple[float, float, float]:
    """Return tilt_x, tilt_y and roll [rad] of camera axes (3, 3): the inverse of optics.projection.rotation.

    Parameters
    ----------
    axes : ndarray (3, 3)
        Camera axes as rows.

    Returns
    -------
    tuple of float
        [rad].
    """
    tilt_y = np.arcsin(np.clip(-axes[2, 0], -1.0, 1.0))
    return float(np.arctan2(axes[2, 1], axes[2, 2])), float(tilt_y), float(np.arctan2(axes[1, 0], axes[0, 0]))


def apply(scene: Scene, parameters: Parameters, context: Context) -> Scene:
    """Turn the plate about the point that the camera looks at; seen from the plate, the camera turns the other way.

    Parameters
    ----------
    scene : Scene
    parameters : Parameters
    context : Context

    Returns
    -------
    Scene

    Raises
    ------
    InputError
        If the camera would be tilted further than a rig allows.
    """
    if parameters.about_x_deg == 0.0 and parameters.about_y_deg == 0.0:
        return scene
    camera = scene.camera
    before = rotation(*np.deg2rad([camera.tilt_x_deg, camera.tilt_y_deg, camera.roll_deg]))
    plate = rotation(*np.deg2rad([parameters.about_x_deg, parameters.about_y_deg, 0.0]))
    tilt_x, tilt_y, roll = np.rad2deg(angles_of(plate.T @ before))
    tilts = {"tilt_x_deg": float(tilt_x), "tilt_y_deg": float(tilt_y), "roll_deg": float(roll)}
    for name in ("tilt_x_deg", "tilt_y_deg"):
        allowed = quantity_of(Camera.model_fields[name])
        if allowed is not None and not allowed.bounds[0] <= tilts[name] <= allowed.bounds[1]:
            raise InputError(f"camera.{name} becomes {tilts[name]:.4g}", key="effects.plate_tilt", allowed=str(allowed))
    return scene.model_copy(update={"camera": camera.model_copy(update=tilts)})


EFFECT = Effect(
    id="plate_tilt",
    stage=Stage.RIG,
    parameters=Parameters,
    amplitudes=("about_x_deg", "about_y_deg"),
    apply=apply,
    null_when="all",
    fitted={"about_x_deg": 1.0, "about_y_deg": 1.0},
    needs=("press",),
    scaling="moves edges, not levels: the same displacement field at every voltage, force and time",
)
