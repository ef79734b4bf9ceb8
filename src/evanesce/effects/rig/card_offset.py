"""Card whose printed side lies off the contact plane: thick lamination, a curl, print on the upper side."""

from __future__ import annotations

from evanesce.core.errors import InputError
from evanesce.core.quantities import Strict, field, quantity_of
from evanesce.effects.protocol import Context, Effect, Stage
from evanesce.rig import Cards, Scene


class Parameters(Strict):
    """Height of the printed side."""

    height_mm: float = field(
        0.0, unit="mm", bounds=(-0.049, 5.0), null=0.0, doc="printed side above its nominal height, off the glass"
    )


def apply(scene: Scene, parameters: Parameters, context: Context) -> Scene:
    """Add to the height of the printed side.

    Parameters
    ----------
    scene : Scene
    parameters : Parameters
    context : Context

    Returns
    -------
    Scene

    Raises
    ------
    InputError
        If the card would reach into the glass.
    """
    if parameters.height_mm == 0.0:
        return scene
    height, allowed = scene.card.height_mm + parameters.height_mm, quantity_of(Cards.model_fields["height_mm"])
    if allowed is not None and not allowed.bounds[0] <= height <= allowed.bounds[1]:
        raise InputError(
            f"card.height_mm becomes {height:.4g}", key="effects.card_offset.height_mm", allowed=str(allowed)
        )
    return scene.model_copy(update={"card": scene.card.model_copy(update={"height_mm": height})})


EFFECT = Effect(
    id="card_offset",
    stage=Stage.RIG,
    parameters=Parameters,
    amplitudes=("height_mm",),
    apply=apply,
    fitted={"height_mm": 0.3},
    needs=("square",),
    scaling="only on shots of cards: they shrink by 1/(1 + height/distance of the lens), and blur a little",
)
