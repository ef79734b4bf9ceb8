"""Height of moulded ridges that departs from the nominal one."""

from __future__ import annotations

from evanesce.core.errors import InputError
from evanesce.core.quantities import Strict, field, quantity_of
from evanesce.effects.protocol import Context, Effect, Stage
from evanesce.rig import Ridges, Scene


class Parameters(Strict):
    """Departure of the height."""

    relative: float = field(
        0.0,
        unit="1",
        bounds=(-0.95, 3.0),
        null=0.0,
        source="thesis, section 3.5.1, table 4: moulds change the height; 47.67 um is a moulded one",
        doc="real over nominal height, less 1",
    )


def apply(scene: Scene, parameters: Parameters, context: Context) -> Scene:
    """Scale the height of the ridges.

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
        For a smooth finger, or a height that a rig does not allow.
    """
    if parameters.relative == 0.0:
        return scene
    ridges = scene.finger.ridges
    if ridges is None:
        raise InputError("the finger has no ridges", key="effects.ridge_height", allowed="a scene with finger.ridges")
    height, allowed = ridges.height_um * (1.0 + parameters.relative), quantity_of(Ridges.model_fields["height_um"])
    if allowed is not None and not allowed.bounds[0] <= height <= allowed.bounds[1]:
        raise InputError(
            f"finger.ridges.height_um becomes {height:.4g}", key="effects.ridge_height.relative", allowed=str(allowed)
        )
    finger = scene.finger.model_copy(update={"ridges": ridges.model_copy(update={"height_um": height})})
    return scene.model_copy(update={"finger": finger})


EFFECT = Effect(
    id="ridge_height",
    stage=Stage.RIG,
    parameters=Parameters,
    amplitudes=("relative",),
    apply=apply,
    fitted={"relative": 0.15},
    needs=("press",),
    scaling="in the band of the ridges' pitch only: furrows close later; fades as force grows",
)
