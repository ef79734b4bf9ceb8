"""Bone inside the finger: its stiffness rises with normal force, as the glass comes closer to the bone."""

from __future__ import annotations

from evanesce.core.errors import InputError
from evanesce.core.quantities import Strict, field, quantity_of
from evanesce.effects.protocol import Context, Effect, Stage
from evanesce.rig import Finger, Scene


class Parameters(Strict):
    """Rise of stiffness."""

    per_N: float = field(
        0.0,
        unit="1/N",
        bounds=(0.0, 3.0),
        null=0.0,
        source="area of solved fingers, bone of half the radius: 0.08 to 0.1 (Silskin 0 %), 0.6 to 1.4 (20 %)",
        doc="relative rise of the finger's stiffness with normal force",
    )


def apply(scene: Scene, parameters: Parameters, context: Context) -> Scene:
    """Add to the finger's stiffening: under a force F it is 1 + per_N F times as stiff, under every contact law.

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
        If the finger would leave what a rig allows.
    """
    if parameters.per_N == 0.0:
        return scene
    total = scene.finger.stiffening_per_N + parameters.per_N
    allowed = quantity_of(Finger.model_fields["stiffening_per_N"])
    if allowed is not None and not allowed.bounds[0] <= total <= allowed.bounds[1]:
        raise InputError(
            f"finger.stiffening_per_N becomes {total:.4g}", key="effects.bone_stiffening.per_N", allowed=str(allowed)
        )
    return scene.model_copy(update={"finger": scene.finger.model_copy(update={"stiffening_per_N": total})})


EFFECT = Effect(
    id="bone_stiffening",
    stage=Stage.RIG,
    parameters=Parameters,
    amplitudes=("per_N",),
    apply=apply,
    fitted={"per_N": 0.08},
    needs=("press", "force"),
    scaling="takes area away, the more the larger the force; the same at every voltage and time",
)
