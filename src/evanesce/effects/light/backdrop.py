"""A cloth, a ceiling or a room above the plate, seen beside the finger in the light that leaves strips and plate."""

from __future__ import annotations

from evanesce.core.quantities import Strict, field
from evanesce.effects.protocol import Context, Effect, Stage
from evanesce.rig import Backdrop, Scene, Surroundings


class Parameters(Strict):
    """Reflectance and distance."""

    reflectance: float = field(
        0.0, unit="1", bounds=(0.0, 1.0), null=0.0, doc="diffuse; a black cloth has 0.01 to 0.05, a wall 0.5 to 0.8"
    )
    distance_mm: float = field(50.0, unit="mm", bounds=(1.0, 5000.0), doc="above the plate's top face")


def apply(scene: Scene, parameters: Parameters, context: Context) -> Scene:
    """Set the scene's ``surroundings.backdrop``.

    Parameters
    ----------
    scene : Scene
    parameters : Parameters
    context : Context

    Returns
    -------
    Scene
    """
    if parameters.reflectance == 0.0:
        return scene
    backdrop = Backdrop(**parameters.model_dump())
    return scene.model_copy(
        update={"surroundings": (scene.surroundings or Surroundings()).model_copy(update={"backdrop": backdrop})}
    )


EFFECT = Effect(
    id="backdrop",
    stage=Stage.RIG,
    parameters=Parameters,
    amplitudes=("reflectance",),
    apply=apply,
    # Assumed: something between a black cloth and a grey wall.
    fitted={"reflectance": 0.1, "distance_mm": 30.0},
    scaling="follows LED power: a smooth ground beside the finger, the darker the farther it is; there without contact",
)
