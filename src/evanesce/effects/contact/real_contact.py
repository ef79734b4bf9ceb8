"""Roughness of the skin: real contact is a share of nominal contact, and rises with pressure."""

from __future__ import annotations

import math

from evanesce.core.quantities import Strict, field
from evanesce.effects.protocol import Context, Effect, Stage
from evanesce.rig import Scene


class Parameters(Strict):
    """Gradient of the roughness."""

    rms_slope: float = field(
        0.0,
        unit="1",
        bounds=(0.0, 3.0),
        null=0.0,
        source="Persson, J. Chem. Phys. 115 (2001) 3840; the finger's own roughness is not published",
        doc="root of the mean square of the surface's gradient",
    )


def apply(scene: Scene, parameters: Parameters, context: Context) -> Scene:
    """Add to the finger's roughness, from which the contact law computes the share; gradients add in squares.

    Parameters
    ----------
    scene : Scene
    parameters : Parameters
    context : Context

    Returns
    -------
    Scene
    """
    slope = math.hypot(scene.finger.roughness_rms_slope, parameters.rms_slope)
    return scene.model_copy(update={"finger": scene.finger.model_copy(update={"roughness_rms_slope": slope})})


EFFECT = Effect(
    id="real_contact",
    stage=Stage.RIG,
    parameters=Parameters,
    amplitudes=("rms_slope",),
    apply=apply,
    # Moulded skins have 0.1 to 1.
    fitted={"rms_slope": 0.3},
    scaling="falls with pressure: edge of contact and low forces darker, the patch no smaller",
    # Contact is complete to the last digit up to a finite slope.
    start={"rms_slope": (0.2, 0.5, 1.0)},
)
