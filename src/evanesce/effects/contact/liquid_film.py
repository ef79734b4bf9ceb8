"""Sweat, water or a lubricant about the contact: it couples light where nothing touches."""

from __future__ import annotations

from evanesce.core.quantities import Strict, field
from evanesce.effects.protocol import Context, Effect, Stage
from evanesce.rig import Scene
from evanesce.rig.liquid import Liquid


class Parameters(Strict):
    """Volume and index of the liquid."""

    volume_uL: float = field(
        0.0, unit="uL", bounds=(0.0, 100.0), null=0.0, doc="beside that of the scene's own [liquid]"
    )
    refractive_index: float = field(1.333, unit="1", bounds=(1.3, 1.5), doc="where the scene has no [liquid]")


def apply(scene: Scene, parameters: Parameters, context: Context) -> Scene:
    """Add to the scene's liquid, or bring some.

    Parameters
    ----------
    scene : Scene
    parameters : Parameters
    context : Context

    Returns
    -------
    Scene
    """
    if parameters.volume_uL == 0.0:
        return scene
    liquid = scene.liquid or Liquid(volume_uL=0.0, refractive_index=parameters.refractive_index)
    more = liquid.model_copy(update={"volume_uL": liquid.volume_uL + parameters.volume_uL})
    return scene.model_copy(update={"liquid": more})


EFFECT = Effect(
    id="liquid_film",
    stage=Stage.RIG,
    parameters=Parameters,
    amplitudes=("volume_uL",),
    apply=apply,
    # Sweat on a fingertip is some tenths of a microlitre per square centimetre.
    fitted={"volume_uL": 0.2},
    # The rim's area goes as the root of the volume at first: no finite slope at null.
    start={"volume_uL": 0.2},
    needs=("press",),
    scaling="a rim about the contact, as the root of its volume; the same at every voltage",
)
