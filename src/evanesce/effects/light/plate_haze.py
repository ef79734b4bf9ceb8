"""Haze of fine dust and grease on the plate's faces, which scatters guided light out everywhere, cloudily."""

from __future__ import annotations

from evanesce.effects.protocol import Context, Effect, Stage
from evanesce.rig import Haze, Scene
from evanesce.rig.surroundings import HazeShares, surrounded


def apply(scene: Scene, parameters: HazeShares, context: Context) -> Scene:
    """Set the scene's ``surroundings.haze``, its pattern drawn from the run's seed.

    Parameters
    ----------
    scene : Scene
    parameters : HazeShares
    context : Context

    Returns
    -------
    Scene
    """
    if parameters.top_share == 0.0 and parameters.bottom_share == 0.0:
        return scene
    pattern = int(context.generator("plate_haze", per_frame=False).integers(2**31))
    return surrounded(scene, haze=Haze(**parameters.model_dump(), pattern=pattern))


EFFECT = Effect(
    id="plate_haze",
    stage=Stage.RIG,
    parameters=HazeShares,
    amplitudes=("top_share", "bottom_share"),
    null_when="all",
    apply=apply,
    # Assumed: a per cent of the ground of a contact.
    fitted={"top_share": 0.005, "bottom_share": 0.005},
    scaling="follows LED power, fixed on the plate: a cloudy ground, there without contact, and light on the flank",
)
