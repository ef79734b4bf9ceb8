"""Rate, dwell and temperature of a press: what they do to a finger's stiffness, by the silicone's Prony series.

A history of force F(s) that only rises presses a viscoelastic finger as far as an elastic one whose compliance is

    J(t) = integral of D(t - s) dF(s) / F(t),

D the creep compliance: exact for a small contact of a sphere or of any other power (Lee and Radok 1960; Ting 1966),
an assumption for the other laws, which take it as a stiffness (quasi-linear viscoelasticity, Fung 1981). Laws and
moduli of the thesis were measured at 5 mm/min; what acts is therefore D's mean over that history, over the present one.

Sliding over smooth glass moves the same silicone against new glass: nothing is loaded anew, so that speed acts through
friction, and the area through the time under load alone.
"""

from __future__ import annotations

import math
from functools import lru_cache

from scipy.special import hyp1f1

from evanesce.bench.dma import prony_of
from evanesce.contact.laws import apply_law
from evanesce.core.errors import InputError
from evanesce.materials.prony import CreepSeries
from evanesce.rig import Scene

REFERENCE_RATE_MM_PER_MIN = 5.0
"""At which the thesis compressed its silicones (table 6) and pressed its finger on glass (chapter 5)."""
REFERENCE_TEMPERATURE_C = 20.0
"""Of those tests; not printed: a laboratory's."""
EVEN_DEPTH = 1.5
"""Power of time with which force rises while the depth moves evenly, as on Hertz's sphere."""


def mean_compliance(creep: CreepSeries, rise_s: float, dwell_s: float, power: float) -> float:
    """Return the compliance that a force F (s/rise)^power, then held, has met: the mean of D over its history.

    Parameters
    ----------
    creep : CreepSeries
    rise_s : float
        Time in which the force rises [s], not negative.
    dwell_s : float
        Time for which it is then held [s].
    power : float
        1 for a force that moves evenly, :data:`EVEN_DEPTH` for a depth that does.

    Returns
    -------
    float
        [1/MPa].

    Notes
    -----
    The mean of exp(-(1 - u) k) with weight power u^(power - 1) on 0 to 1 is Kummer's M(1, power + 1, -k).
    """
    total = creep.instantaneous + creep.fluidity * (dwell_s + rise_s / (power + 1.0))
    for part, time in zip(creep.compliances, creep.times, strict=True):
        total += part * (1.0 - math.exp(-dwell_s / time) * float(hyp1f1(1.0, power + 1.0, -rise_s / time)))
    return total


def rate_factor(scene: Scene, force: float, time_s: float = 0.0) -> float:
    """Return by how much the scene's rate, dwell and temperature stiffen its finger: exactly 1 where it has none.

    Parameters
    ----------
    scene : Scene
    force : float
        [N].
    time_s : float
        Since the slide's programme began [s]; only a slide depends on it.

    Returns
    -------
    float
        1 at 5 mm/min and 20 degC.

    Raises
    ------
    InputError
        For a silicone without published dynamic data, or a law without depth.
    """
    press, environment = scene.press, scene.environment
    if (environment is None and press.rate_mm_per_min is None and press.dwell_s is None) or force <= 0:
        return 1.0
    temperature = REFERENCE_TEMPERATURE_C if environment is None else environment.temperature_C
    usual = 60.0 * _depth(scene, force) / REFERENCE_RATE_MM_PER_MIN
    rise, dwell, power = _history(scene, force, time_s, usual)
    then = mean_compliance(_creep(scene.finger.material, REFERENCE_TEMPERATURE_C), usual, 0.0, EVEN_DEPTH)
    return then / mean_compliance(_creep(scene.finger.material, temperature), rise, dwell, power)


def as_loaded(scene: Scene, force: float, time_s: float = 0.0) -> Scene:
    """Return the scene with its finger as stiff as its loading history makes it; the scene itself where it has none.

    Parameters
    ----------
    scene, force, time_s
        As for :func:`rate_factor`.

    Returns
    -------
    Scene
    """
    factor = rate_factor(scene, force, time_s)
    if factor == 1.0:
        return scene
    finger = scene.finger
    return scene.model_copy(
        update={"finger": finger.model_copy(update={"modulus_factor": factor * finger.modulus_factor})}
    )


def _history(scene: Scene, force: float, time_s: float, usual: float) -> tuple[float, float, float]:
    """Return rise [s], dwell [s] and the power of the rise."""
    press, slide = scene.press, scene.slide
    if slide is not None and press.forces_N is not None:
        # The ramp is that from 0 N which runs through the preload.
        rate = (press.forces_N[0] - slide.preload_N) / slide.press_time_s
        return force / rate, max(time_s - slide.press_time_s, 0.0), 1.0
    if press.ramp is not None:
        if press.ramp.stop_N < press.ramp.start_N:
            raise InputError(
                "the memory of a falling force is not solved", key="press.ramp.stop_N", allowed="above start_N"
            )
        if press.ramp.rate_N_per_s is not None:
            return force / press.ramp.rate_N_per_s, 0.0, 1.0
        share = REFERENCE_RATE_MM_PER_MIN / (press.ramp.rate_mm_per_min or REFERENCE_RATE_MM_PER_MIN)
        return usual * share, 0.0, EVEN_DEPTH
    share = REFERENCE_RATE_MM_PER_MIN / (press.rate_mm_per_min or REFERENCE_RATE_MM_PER_MIN)
    return usual * share, press.dwell_s or 0.0, EVEN_DEPTH


def _depth(scene: Scene, force: float) -> float:
    depth = apply_law(scene, force).contact.depth
    if not math.isfinite(depth):
        raise InputError(
            f"law {scene.contact.law} has no depth, from which the time of a press follows",
            key="contact.law",
            allowed="hertz, scaled_hertz, jkr, halfspace or fem with a rate or a temperature",
        )
    return max(depth, 0.0)


@lru_cache(maxsize=32)
def _creep(material: str, temperature: float) -> CreepSeries:
    try:
        return prony_of(material, temperature).creep()
    except InputError as error:
        raise InputError(
            str(error), key="finger.material", allowed="silskin_0 or silskin_20 with a rate, a dwell or a temperature"
        ) from None
