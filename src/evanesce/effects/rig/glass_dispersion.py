"""Dispersion of the glass: the refractive index at the LEDs' wavelengths rather than at the sodium line."""

from __future__ import annotations

from evanesce.core.quantities import Strict, field
from evanesce.effects.protocol import Context, Effect, Stage
from evanesce.optics.spectrum import SODIUM_NM, mean_over_bands, soda_lime_index
from evanesce.rig import Scene


class Parameters(Strict):
    """Dispersion over that of clear soda-lime glass."""

    strength: float = field(
        0.0, unit="1", bounds=(0.0, 3.0), null=0.0, doc="dispersion over that of clear soda-lime glass (Rubin 1985)"
    )


def apply(scene: Scene, parameters: Parameters, context: Context) -> Scene:
    """Add strength times (n averaged over the white LED's bands, by luminous weight, minus n at 589 nm).

    Parameters
    ----------
    scene : Scene
    parameters : Parameters
    context : Context

    Returns
    -------
    Scene
    """
    if parameters.strength == 0.0:
        return scene
    shift = mean_over_bands(soda_lime_index) - float(soda_lime_index(SODIUM_NM))
    index = scene.plate.refractive_index + parameters.strength * shift
    return scene.model_copy(update={"plate": scene.plate.model_copy(update={"refractive_index": index})})


EFFECT = Effect(
    id="glass_dispersion",
    stage=Stage.RIG,
    parameters=Parameters,
    amplitudes=("strength",),
    apply=apply,
    # All or nothing of a published curve.
    fitted={"strength": 0.5},
    scaling="a change of the critical angle: nearly one factor for all frames",
)
