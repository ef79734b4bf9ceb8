"""Light that the strips spill above the plate: it lights the finger's flank, and what stands above, from the side."""

from __future__ import annotations

from evanesce.core.quantities import Strict, field
from evanesce.effects.protocol import Context, Effect, Stage
from evanesce.rig import Scene, Spill, Surroundings


class Parameters(Strict):
    """Share of the power, and how high the strips stand."""

    share: float = field(
        0.0,
        unit="1",
        bounds=(0.0, 10.0),
        null=0.0,
        doc="power that each LED sends above the plate, over what it sends into the plate; not published",
    )
    height_mm: float = field(
        1.0,
        unit="mm",
        bounds=(0.05, 20.0),
        source="a strip 8 mm wide, centred on an edge of 6 mm, stands over it by 1 mm; one of 10 mm by 2 mm",
        doc="upper end of the lit band above the top face",
    )


def apply(scene: Scene, parameters: Parameters, context: Context) -> Scene:
    """Set the scene's ``surroundings.spill``.

    Parameters
    ----------
    scene : Scene
    parameters : Parameters
    context : Context

    Returns
    -------
    Scene
    """
    if parameters.share == 0.0:
        return scene
    spill = Spill(share=parameters.share, height_mm=parameters.height_mm)
    return scene.model_copy(
        update={"surroundings": (scene.surroundings or Surroundings()).model_copy(update={"spill": spill})}
    )


EFFECT = Effect(
    id="led_spill",
    stage=Stage.RIG,
    parameters=Parameters,
    amplitudes=("share",),
    apply=apply,
    # Assumed: some per cent of the light pass the edge of a strip wider than the plate is thick.
    fitted={"share": 0.05},
    scaling="follows LED power: lights the finger's flank out to its full diameter, never the contact",
)
