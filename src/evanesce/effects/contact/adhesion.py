"""Adhesion of silicone to glass: more contact than without it, relatively most at small force."""

from __future__ import annotations

from evanesce.core.errors import InputError
from evanesce.core.quantities import Strict, field, quantity_of
from evanesce.effects.inference_hints import ROOT
from evanesce.effects.protocol import Context, Effect, Stage
from evanesce.rig import Finger, Scene

J_PER_M2_IN_N_PER_MM = 1e-3


class Parameters(Strict):
    """Work of adhesion."""

    work_J_per_m2: float = field(
        0.0,
        unit="J/m^2",
        bounds=(0.0, 5.0),
        null=0.0,
        source="silicone on silicone: about 0.045 J/m^2, Chaudhury and Whitesides, Langmuir 7 (1991) 1013",
        doc="work of adhesion",
    )


def apply(scene: Scene, parameters: Parameters, context: Context) -> Scene:
    """Add to the finger's work of adhesion; each contact law includes it in its own way.

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
        If the finger would leave what a rig allows.
    """
    if parameters.work_J_per_m2 == 0.0:
        return scene
    total = scene.finger.work_of_adhesion_N_per_mm + J_PER_M2_IN_N_PER_MM * parameters.work_J_per_m2
    allowed = quantity_of(Finger.model_fields["work_of_adhesion_N_per_mm"])
    if allowed is not None and not allowed.bounds[0] <= total <= allowed.bounds[1]:
        raise InputError(
            f"finger.work_of_adhesion_N_per_mm becomes {total:.4g}",
            key="effects.adhesion.work_J_per_m2",
            allowed=str(allowed),
        )
    return scene.model_copy(update={"finger": scene.finger.model_copy(update={"work_of_adhesion_N_per_mm": total})})


EFFECT = Effect(
    id="adhesion",
    stage=Stage.RIG,
    parameters=Parameters,
    amplitudes=("work_J_per_m2",),
    apply=apply,
    fitted={"work_J_per_m2": 0.05},
    coordinates={"work_J_per_m2": ROOT},  # area goes as the root of the work at first: no finite slope at null
    needs=("press",),
    scaling="adds area as the root of the work; relatively most at small force; the same at every voltage and time",
)
