"""Dispersion of the glass: the refractive index at the LEDs' wavelengths rather than at the sodium line."""

from __future__ import annotations

from evanesce.core.quantities import Strict, field
from evanesce.effects.protocol import Context, Effect, Stage
from evanesce.optics.spectrum import SODIUM_NM, mean_over_bands, soda_lime_index, spectrum_of
from evanesce.rig import Scene


class Parameters(Strict):
    """Dispersion over that of clear soda-lime glass."""

    strength: float = field(
        0.0, unit="1", bounds=(0.0, 3.0), null=0.0, doc="dispersion over that of clear soda-lime glass (Rubin 1985)"
    )


def apply(scene: Scene, parameters: Parameters, context: Context) -> Scene:
    """Add strength times (n averaged over the white LED's bands, by luminous weight, minus n at 589 nm).

    LEDs of another spectrum: n averaged over its photons. Such light sees the dispersion of clear soda-lime glass
    anyway (:func:`~evanesce.optics.seen.seen_at`): there strength is what the plate has beyond it.

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
    white = scene.leds.spectrum == "white"
    mean = mean_over_bands(soda_lime_index) if white else spectrum_of(scene.leds).photon_mean(soda_lime_index)
    shift = mean - float(soda_lime_index(SODIUM_NM))
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
