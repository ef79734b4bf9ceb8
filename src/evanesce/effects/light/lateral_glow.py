"""Subsurface scattering in the silicone: light that enters at a contact leaves beside it and fills the grooves."""

from __future__ import annotations

from evanesce.core.quantities import Strict, field
from evanesce.effects.protocol import Context, Effect, Stage
from evanesce.rig import Scene


class Parameters(Strict):
    """Subsurface scattering length, and the share of light that it concerns."""

    length_mm: float = field(
        0.0,
        unit="mm",
        bounds=(0.0, 3.0),
        null=0.0,
        source="PDMS phantoms scatter with 0.5 to 2 /mm (reduced), that is 0.5 to 2 mm",
        doc="transport mean free path in the silicone, 1/(sigma_s' + sigma_a)",
    )
    share: float = field(
        1.0,
        unit="1",
        bounds=(0.0, 1.0),
        null=0.0,
        doc="of the returned light, the part scattered below the surface; below 1 where the skin scatters more",
    )


def apply(scene: Scene, parameters: Parameters, context: Context) -> Scene:
    """Set the finger's scattering length, which adds to one that it has; its reflectance is kept.

    Parameters
    ----------
    scene : Scene
    parameters : Parameters
    context : Context

    Returns
    -------
    Scene
    """
    if parameters.length_mm == 0.0 or parameters.share == 0.0:
        return scene
    finger = scene.finger
    total = min(finger.scattering_length_mm + parameters.length_mm, 5.0)
    share = finger.scattering_share if finger.scattering_length_mm > 0 else parameters.share
    update = {"scattering_length_mm": total, "scattering_share": share}
    return scene.model_copy(update={"finger": finger.model_copy(update=update)})


EFFECT = Effect(
    id="lateral_glow",
    stage=Stage.RIG,
    parameters=Parameters,
    amplitudes=("share", "length_mm"),
    apply=apply,
    # PDMS phantoms have 0.5 to 2 mm; a clearer or a milkier silicone lies on either side.
    fitted={"share": 0.3, "length_mm": 0.7},
    scaling="follows LED power and contact: a halo about the patch and filled grooves, the wider the longer the path",
    # Without a length no share has a derivative; a short one changes the contact's very edge only, below a pixel.
    start={"share": 0.1, "length_mm": (0.3, 1.0)},
)
