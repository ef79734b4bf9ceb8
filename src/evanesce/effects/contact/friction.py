"""Friction of a sliding finger higher or lower than its material's: another surface, dust, humidity."""

from __future__ import annotations

from evanesce.core.errors import InputError
from evanesce.core.quantities import Strict, field, quantity_of
from evanesce.effects.protocol import Context, Effect, Stage
from evanesce.rig import Scene
from evanesce.rig.programme import Slide


class Parameters(Strict):
    """Departure of friction."""

    relative: float = field(0.0, unit="1", bounds=(-0.9, 4.0), null=0.0, doc="real over nominal friction, less 1")


def apply(scene: Scene, parameters: Parameters, context: Context) -> Scene:
    """Multiply shear strength and coefficient of the slide's friction by 1 + relative; a press has none.

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
        If friction would leave what a rig allows.
    """
    if parameters.relative == 0.0 or scene.slide is None:
        return scene
    factor = (scene.slide.friction_factor or 1.0) * (1.0 + parameters.relative)
    allowed = quantity_of(Slide.model_fields["friction_factor"])
    if allowed is not None and not allowed.bounds[0] <= factor <= allowed.bounds[1]:
        raise InputError(
            f"slide.friction_factor becomes {factor:.4g}", key="effects.friction.relative", allowed=str(allowed)
        )
    return scene.model_copy(update={"slide": scene.slide.model_copy(update={"friction_factor": factor})})


EFFECT = Effect(
    id="friction",
    stage=Stage.RIG,
    parameters=Parameters,
    amplitudes=("relative",),
    apply=apply,
    fitted={"relative": 0.3},
    needs=("motion",),
    scaling="force of gross slip in proportion; below it the stick core is larger and shear spreads by its square root",
)
