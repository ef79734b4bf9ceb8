"""Zero offset of the load cell: the force that acts is not the force that is read."""

from __future__ import annotations

from evanesce.core.errors import InputError
from evanesce.core.quantities import Strict, field
from evanesce.effects.protocol import Context, Effect, Stage


class Parameters(Strict):
    """Offset of the reading."""

    offset_N: float = field(
        0.0, unit="N", bounds=(-5.0, 5.0), null=0.0, doc="reading less real force; tare with a finger resting: negative"
    )


def apply(force_N: float, parameters: Parameters, context: Context) -> float:
    """Return the real force: the reading less the offset, and nothing where that is a pull.

    Parameters
    ----------
    force_N : float
        [N].
    parameters : Parameters
    context : Context

    Returns
    -------
    float
        [N].

    Raises
    ------
    InputError
        In a scene with a slide, whose programme fixes the force.
    """
    if parameters.offset_N == 0.0:
        return force_N
    if context.scene.slide is not None:
        raise InputError(
            "a slide's programme fixes the force", key="effects.force_offset", allowed="a scene without a slide"
        )
    return max(force_N - parameters.offset_N, 0.0)


EFFECT = Effect(
    id="force_offset",
    stage=Stage.LOAD,
    parameters=Parameters,
    amplitudes=("offset_N",),
    apply=apply,
    fitted={"offset_N": 0.1},
    needs=("press", "force"),
    scaling="shifts the force axis: relatively most at small force; the same at every voltage and time",
)
