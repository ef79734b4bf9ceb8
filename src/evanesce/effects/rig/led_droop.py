"""Efficiency droop: LED light is not proportional to current; best efficiency at a few milliamperes."""

from __future__ import annotations

from evanesce.core.quantities import Strict, field
from evanesce.effects.inference_hints import saturating
from evanesce.effects.protocol import Context, Effect, Stage
from evanesce.rig import Scene


class Parameters(Strict):
    """Strength of the droop, and current of the best efficiency."""

    droop: float = field(
        0.0,
        unit="1",
        bounds=(0.0, 1.0),
        null=0.0,
        source="Karpov, Opt. Quantum Electron. 47 (2015) 1293",
        doc="1/Q of the ABC model; good blue LEDs have about 0.1",
    )
    peak_current_mA: float = field(
        2.0, unit="mA", bounds=(0.001, 1000.0), doc="segment current of the best efficiency; not published"
    )


def apply(scene: Scene, parameters: Parameters, context: Context) -> Scene:
    """Set the circuit's droop; :func:`evanesce.optics.led_circuit.relative_efficiency` applies it.

    Parameters
    ----------
    scene : Scene
    parameters : Parameters
    context : Context

    Returns
    -------
    Scene
    """
    if parameters.droop == 0.0:
        return scene
    changes = {"droop": parameters.droop, "peak_current_mA": parameters.peak_current_mA}
    circuit = scene.leds.circuit.model_copy(update=changes)
    return scene.model_copy(update={"leds": scene.leds.model_copy(update={"circuit": circuit})})


EFFECT = Effect(
    id="led_droop",
    stage=Stage.RIG,
    parameters=Parameters,
    amplitudes=("droop",),
    apply=apply,
    # Good LEDs have 0.1, poor ones twice that; the best current is certain to a factor of two.
    fitted={"droop": 0.1, "peak_current_mA": 2.0},
    # Light goes as 1/(1 + d (s + 1/s)), and s + 1/s is about 4 at the currents of the thesis's strips.
    coordinates={"droop": saturating(0.25)},
    needs=("press", "voltage"),
    scaling="all light by one factor that bends with voltage, 1 at the rated one",
)
