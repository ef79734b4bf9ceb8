"""Silicone stiffer or softer than its material: another batch, cure or share of deadener."""

from __future__ import annotations

from evanesce.core.errors import InputError
from evanesce.core.quantities import Strict, field, quantity_of
from evanesce.effects.protocol import Context, Effect, Stage
from evanesce.rig import Finger, Scene


class Parameters(Strict):
    """Departure of the modulus."""

    relative: float = field(
        0.0,
        unit="1",
        bounds=(-0.9, 4.0),
        null=0.0,
        doc="real over nominal modulus, less 1",
    )


def stiffer(scene: Scene, factor: float, key: str) -> Scene:
    """Multiply the finger's stiffness.

    Parameters
    ----------
    scene : Scene
    factor : float
        [1].
    key : str
        Named in errors.

    Returns
    -------
    Scene

    Raises
    ------
    InputError
        If the finger would leave what a rig allows.
    """
    total = scene.finger.modulus_factor * factor
    allowed = quantity_of(Finger.model_fields["modulus_factor"])
    if allowed is not None and not allowed.bounds[0] <= total <= allowed.bounds[1]:
        raise InputError(f"finger.modulus_factor becomes {total:.4g}", key=key, allowed=str(allowed))
    return scene.model_copy(update={"finger": scene.finger.model_copy(update={"modulus_factor": total})})


def apply(scene: Scene, parameters: Parameters, context: Context) -> Scene:
    """Multiply the finger's stiffness by 1 + relative, under every contact law.

    Parameters
    ----------
    scene : Scene
    parameters : Parameters
    context : Context

    Returns
    -------
    Scene
    """
    if parameters.relative == 0.0:
        return scene
    return stiffer(scene, 1.0 + parameters.relative, "effects.modulus.relative")


EFFECT = Effect(
    id="modulus",
    stage=Stage.RIG,
    parameters=Parameters,
    amplitudes=("relative",),
    apply=apply,
    fitted={"relative": 0.2},
    needs=("press",),
    scaling="area as the power -2/3 of the modulus at every force (Hertz); the same at every voltage and time",
)
