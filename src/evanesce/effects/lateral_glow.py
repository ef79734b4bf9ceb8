"""Silicone that lets light wander: what enters at a contact leaves sideways and lights the grooves beside it."""

from __future__ import annotations

from evanesce.effects.protocol import Context, Effect, Stage
from evanesce.quantities import Strict, field
from evanesce.rig import Scene


class Parameters(Strict):
    """How far light wanders."""

    length_mm: float = field(
        0.0,
        unit="mm",
        bounds=(0.0, 3.0),
        null=0.0,
        source="PDMS phantoms scatter with 0.5 to 2 /mm (reduced), that is 0.5 to 2 mm",
        doc="transport mean free path in the silicone, 1/(sigma_s' + sigma_a)",
    )


def apply(scene: Scene, parameters: Parameters, context: Context) -> Scene:
    """Set the finger's scattering length, which adds to one that it has; its reflectance stays what it is."""
    total = min(scene.finger.scattering_length_mm + parameters.length_mm, 5.0)
    return scene.model_copy(update={"finger": scene.finger.model_copy(update={"scattering_length_mm": total})})


EFFECT = Effect(
    id="lateral_glow",
    stage=Stage.RIG,
    parameters=Parameters,
    amplitudes=("length_mm",),
    apply=apply,
    # PDMS phantoms have 0.5 to 2 mm; a clearer or a milkier silicone lies on either side.
    fitted={"length_mm": 0.7},
    scaling="follows LED power and contact: a halo about the patch and filled grooves, the wider the longer the path",
    # At first only the contact's very edge changes, below a pixel.
    start={"length_mm": (0.3, 1.0)},
)
