"""Absorption of the glass: light from far LEDs, and at steep angles, loses more along its longer path."""

from __future__ import annotations

from evanesce.core.quantities import Strict, field
from evanesce.effects.inference_hints import saturating
from evanesce.effects.protocol import Context, Effect, Stage
from evanesce.rig import Scene


class Parameters(Strict):
    """Absorption beyond the nominal one."""

    absorption_per_mm: float = field(
        0.0,
        unit="1/mm",
        bounds=(0.0, 0.1),
        null=0.0,
        source="clear float glass 0.0005 to 0.002 in the visible: Rubin, Solar Energy Materials 12 (1985) 275",
        doc="added to the plate's absorption coefficient",
    )


def apply(scene: Scene, parameters: Parameters, context: Context) -> Scene:
    """Add to the plate's absorption coefficient (Beer and Lambert along each path).

    Parameters
    ----------
    scene : Scene
    parameters : Parameters
    context : Context

    Returns
    -------
    Scene
    """
    total = scene.plate.absorption_coefficient_per_mm + parameters.absorption_per_mm
    plate = scene.plate.model_copy(update={"absorption_coefficient_per_mm": total})
    return scene.model_copy(update={"plate": plate})


EFFECT = Effect(
    id="glass_absorption",
    stage=Stage.RIG,
    parameters=Parameters,
    amplitudes=("absorption_per_mm",),
    apply=apply,
    # From low-iron to common float glass: 0.0005 to 0.002 per mm.
    fitted={"absorption_per_mm": 0.001},
    # exp(-a L) = 1 - L a + L^2 a^2 / 2 over paths L of some 70 mm, from the edges of the thesis's plate to its middle.
    coordinates={"absorption_per_mm": saturating(0.03)},
    scaling="a share of the light by its path in the glass: the same at every voltage and force",
)
