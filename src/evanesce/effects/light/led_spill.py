"""Light that the strips spill above the plate: it lights the finger's flank, and what stands above, from the side."""

from __future__ import annotations

from evanesce.effects.protocol import Context, Effect, Stage
from evanesce.rig import Scene, Spill
from evanesce.rig.surroundings import surrounded


def apply(scene: Scene, parameters: Spill, context: Context) -> Scene:
    """Set the scene's ``surroundings.spill``.

    Parameters
    ----------
    scene : Scene
    parameters : Spill
    context : Context

    Returns
    -------
    Scene
    """
    return scene if parameters.share == 0.0 else surrounded(scene, spill=parameters)


EFFECT = Effect(
    id="led_spill",
    stage=Stage.RIG,
    parameters=Spill,
    amplitudes=("share",),
    apply=apply,
    # Assumed: some per cent of the light pass the edge of a strip wider than the plate is thick.
    fitted={"share": 0.05},
    scaling="follows LED power: lights the finger's flank out to its full diameter, never the contact",
)
