"""Haze of fine dust and grease on the plate's faces, which scatters guided light out everywhere, cloudily."""

from __future__ import annotations

from evanesce.core.quantities import Strict, field
from evanesce.effects.protocol import Context, Effect, Stage
from evanesce.rig import Haze, Scene, Surroundings


class Parameters(Strict):
    """Scattered shares of the guided light, and how cloudy the haze is."""

    top_share: float = field(
        0.0, unit="1", bounds=(0.0, 0.5), null=0.0, doc="of the guided irradiance, scattered by the top face"
    )
    bottom_share: float = field(
        0.0, unit="1", bounds=(0.0, 0.5), null=0.0, doc="of the guided irradiance, scattered by the bottom face"
    )
    contrast: float = field(
        0.4,
        unit="1",
        bounds=(0.0, 3.0),
        source="real contact frame: 0.37, ground of its thumbnail (what_is_lit.py)",
        doc="standard deviation of the haze over its mean: how cloudy it is",
    )
    correlation_mm: float = field(
        2.5, unit="mm", bounds=(0.2, 100.0), doc="distance over which its correlation falls to exp(-1/2)"
    )


def apply(scene: Scene, parameters: Parameters, context: Context) -> Scene:
    """Set the scene's ``surroundings.haze``, its pattern drawn from the run's seed.

    Parameters
    ----------
    scene : Scene
    parameters : Parameters
    context : Context

    Returns
    -------
    Scene
    """
    if parameters.top_share == 0.0 and parameters.bottom_share == 0.0:
        return scene
    pattern = int(context.generator("plate_haze", per_frame=False).integers(2**31))
    haze = Haze(**parameters.model_dump(), pattern=pattern)
    return scene.model_copy(
        update={"surroundings": (scene.surroundings or Surroundings()).model_copy(update={"haze": haze})}
    )


EFFECT = Effect(
    id="plate_haze",
    stage=Stage.RIG,
    parameters=Parameters,
    amplitudes=("top_share", "bottom_share"),
    null_when="all",
    apply=apply,
    # Assumed: a per cent of the ground of a contact.
    fitted={"top_share": 0.005, "bottom_share": 0.005},
    scaling="follows LED power, fixed on the plate: a cloudy ground, there without contact, and light on the flank",
)
