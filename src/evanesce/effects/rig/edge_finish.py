"""The plate's edge between the LEDs: ground, polished, or covered with tape."""

from __future__ import annotations

from evanesce.core.quantities import Strict, field
from evanesce.effects.protocol import Context, Effect, Stage
from evanesce.rig import Scene


class Parameters(Strict):
    """Share of the edge with another finish than nominal, and its reflectance."""

    share: float = field(0.0, unit="1", bounds=(0.0, 1.0), null=0.0, doc="share of the edge that has the other finish")
    polish: float = field(
        1.0,
        unit="1",
        bounds=(0.0, 1.0),
        doc="of it: share that reflects specularly as bare glass; 1 polished, 0 ground",
    )
    reflectance: float = field(
        0.0, unit="1", bounds=(0.0, 1.0), doc="diffuse reflectance of its rest; white tape about 0.85, black tape 0.05"
    )


def apply(scene: Scene, parameters: Parameters, context: Context) -> Scene:
    """Mix both finishes by area: specular reflectances add, and the diffuse parts take their mean reflectance.

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
    plate, share = scene.plate, parameters.share
    polish = (1.0 - share) * plate.edge_polish + share * parameters.polish
    old, new = (1.0 - share) * (1.0 - plate.edge_polish), share * (1.0 - parameters.polish)
    scattered = old * plate.edge_reflectance + new * parameters.reflectance
    reflectance = scattered / (old + new) if old + new > 0 else parameters.reflectance
    changes = {"edge_polish": min(polish, 1.0), "edge_reflectance": min(reflectance, 1.0)}
    return scene.model_copy(update={"plate": plate.model_copy(update=changes)})


EFFECT = Effect(
    id="edge_finish",
    stage=Stage.RIG,
    parameters=Parameters,
    amplitudes=("share",),
    apply=apply,
    # Neither finish nor tape is published: anything up to the whole edge.
    fitted={"share": 0.3, "polish": 0.5, "reflectance": 0.3},
    scaling="all light by nearly one factor, the same at every voltage and force",
    # The other finish has no derivative while its share is 0: polished, black tape, white tape.
    start={"share": (0.3,), "polish": (1.0, 0.0), "reflectance": (0.05, 0.85)},
)
