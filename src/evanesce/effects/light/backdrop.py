"""A cloth, a ceiling or a room above the plate, seen beside the finger in the light that leaves strips and plate."""

from __future__ import annotations

from evanesce.effects.protocol import Context, Effect, Stage
from evanesce.rig import Backdrop, Scene
from evanesce.rig.surroundings import surrounded


def apply(scene: Scene, parameters: Backdrop, context: Context) -> Scene:
    """Set the scene's ``surroundings.backdrop``.

    Parameters
    ----------
    scene : Scene
    parameters : Backdrop
    context : Context

    Returns
    -------
    Scene
    """
    return scene if parameters.reflectance == 0.0 else surrounded(scene, backdrop=parameters)


EFFECT = Effect(
    id="backdrop",
    stage=Stage.RIG,
    parameters=Backdrop,
    amplitudes=("reflectance",),
    apply=apply,
    # Assumed: something between a black cloth and a grey wall.
    fitted={"reflectance": 0.1, "distance_mm": 30.0},
    scaling="follows LED power: a smooth ground beside the finger, the darker the farther it is; there without contact",
)
