"""Cards printed at another size than nominal: every scale taken from them is biased."""

from __future__ import annotations

from evanesce.core.errors import InputError
from evanesce.core.quantities import Strict, field, quantity_of
from evanesce.effects.protocol import Context, Effect, Stage
from evanesce.rig import Cards, Scene


class Parameters(Strict):
    """Relative size of each card; they may come from two prints."""

    square: float = field(
        0.0, unit="1", bounds=(-0.2, 0.2), null=0.0, doc="the square's side as printed over the nominal one, less 1"
    )
    checkerboard: float = field(
        0.0, unit="1", bounds=(-0.2, 0.2), null=0.0, doc="the board's squares as printed over the nominal ones, less 1"
    )


def apply(scene: Scene, parameters: Parameters, context: Context) -> Scene:
    """Scale the printed sides.

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
        If a side would leave what a rig allows.
    """
    changed = {}
    for name, share in (
        ("square_side_mm", parameters.square),
        ("checkerboard_side_mm", parameters.checkerboard),
    ):
        if share == 0.0:
            continue
        changed[name] = getattr(scene.card, name) * (1.0 + share)
        allowed = quantity_of(Cards.model_fields[name])
        if allowed is not None and not allowed.bounds[0] <= changed[name] <= allowed.bounds[1]:
            raise InputError(
                f"card.{name} becomes {changed[name]:.4g}", key="effects.square_size", allowed=str(allowed)
            )
    return scene.model_copy(update={"card": scene.card.model_copy(update=changed)}) if changed else scene


EFFECT = Effect(
    id="square_size",
    stage=Stage.RIG,
    parameters=Parameters,
    amplitudes=("square", "checkerboard"),
    apply=apply,
    null_when="all",
    fitted={"square": 0.01, "checkerboard": 0.01},
    needs=("square",),
    scaling="only on shots of cards; areas measured by their scale are off by its square, at every force alike",
)
