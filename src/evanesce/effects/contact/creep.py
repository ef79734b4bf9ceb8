"""Creep of silicone under a held load: contact grows with the logarithm of time."""

from __future__ import annotations

import math

from evanesce.core.errors import InputError
from evanesce.core.quantities import Strict, field
from evanesce.effects.contact.modulus import stiffer
from evanesce.effects.inference_hints import LOG10
from evanesce.effects.protocol import Context, Effect, Stage
from evanesce.rig import Scene


class Parameters(Strict):
    """Rate and onset of creep."""

    per_decade: float = field(
        0.0,
        unit="1",
        bounds=(0.0, 1.0),
        null=0.0,
        doc="rise of the creep compliance a decade of time, over the compliance at first; not published",
    )
    onset_s: float = field(0.1, unit="s", bounds=(1e-4, 1e4), doc="time under load at which creep sets in")
    held_before_s: float = field(0.0, unit="s", bounds=(0.0, 1e6), doc="how long the load was on at time 0")


def compliance_rise(seconds: float, per_decade: float, onset_s: float) -> float:
    """Return J(t)/J(0) = 1 + per_decade log10(1 + t/onset).

    Parameters
    ----------
    seconds : float
        Time under load [s].
    per_decade : float
        Rise of the compliance a decade of time [1].
    onset_s : float
        [s].

    Returns
    -------
    float
    """
    return 1.0 + per_decade * math.log10(1.0 + max(seconds, 0.0) / onset_s)


def apply(scene: Scene, parameters: Parameters, context: Context) -> Scene:
    """Divide the finger's stiffness by the rise of its compliance since the load came on.

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
        In a scene with a slide, which is solved with one stiffness.
    """
    if parameters.per_decade == 0.0:
        return scene
    if scene.slide is not None:
        raise InputError("a slide is solved without creep", key="effects.creep", allowed="a scene without a slide")
    rise = compliance_rise(context.time_s + parameters.held_before_s, parameters.per_decade, parameters.onset_s)
    return stiffer(scene, 1.0 / rise, "effects.creep.per_decade")


EFFECT = Effect(
    id="creep",
    stage=Stage.RIG,
    parameters=Parameters,
    amplitudes=("per_decade",),
    apply=apply,
    fitted={"per_decade": 0.05, "onset_s": 1.0},
    coordinates={"onset_s": LOG10},
    needs=("press", "time"),
    scaling="area grows as log time under load to the power 2/3 of the compliance; the same at every voltage",
)
