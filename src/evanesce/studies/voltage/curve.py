"""Estimated area against LED voltage at a fixed threshold, and the sources of its excess over the true area.

Each frame is exposed and segmented at its voltage, with the noise, the saturation and the rounding that belong to it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from evanesce.chain.simulate import Render
from evanesce.core.errors import InputError
from evanesce.measurement.reference.segment import Chain
from evanesce.render.fast.transport import render_fast
from evanesce.rig import Scene
from evanesce.studies.voltage.press import Press, led_powers_of
from evanesce.studies.voltage.sources import NOTHING, SOURCES, Omitted, Source


@dataclass(frozen=True, kw_only=True)
class Excess:
    """One force at one voltage; ``sum(parts) + residual + interaction`` is estimate less truth.

    Attributes
    ----------
    force_N, voltage_V, area_mm2, true_area_mm2 : float
    parts_mm2 : dict of str to float
        What each source adds while all others are present [mm^2].
    residual_mm2 : float
        Error with all four left out: threshold, gaps narrower than a wavelength, counting [mm^2].
    interaction_mm2 : float
    """

    force_N: float
    voltage_V: float
    area_mm2: float
    true_area_mm2: float
    parts_mm2: dict[Source, float]
    residual_mm2: float
    interaction_mm2: float

    def row(self) -> dict[str, Any]:
        """Return plain data, units in the keys.

        Returns
        -------
        dict
        """
        return {
            "force_N": self.force_N,
            "voltage_V": self.voltage_V,
            "area_mm2": self.area_mm2,
            "true_area_mm2": self.true_area_mm2,
            "excess_mm2": self.area_mm2 - self.true_area_mm2,
            "parts_mm2": dict(self.parts_mm2),
            "residual_mm2": self.residual_mm2,
            "interaction_mm2": self.interaction_mm2,
        }


def excess_parts(area: Callable[[Omitted], float], true_area: float) -> tuple[dict[Source, float], float, float]:
    """Split the excess of a measured area over the true one by its sources.

    Parameters
    ----------
    area : callable
        ``area(omitted)`` [mm^2].
    true_area : float
        [mm^2].

    Returns
    -------
    parts : dict of str to float
        What each source adds while all others are present [mm^2].
    residual : float
        Excess with all sources omitted [mm^2].
    interaction : float
        Excess less residual and parts [mm^2].
    """
    full = area(NOTHING)
    parts: dict[Source, float] = {source: full - area(frozenset({source})) for source in SOURCES}
    residual = area(frozenset(SOURCES)) - true_area
    return parts, residual, full - true_area - residual - sum(parts.values())


def voltage_curve(
    scene: Scene,
    force: float,
    voltages: Sequence[float],
    chain: Chain,
    *,
    seed: int = 0,
    render: Render = render_fast,
    tick: Callable[[], None] = lambda: None,
) -> list[Excess]:
    """Return estimated area, true area and parts of the excess at each voltage, for one force.

    Parameters
    ----------
    scene : Scene
        From :func:`study_scene`.
    force : float
        [N].
    voltages : sequence of float
        [V].
    chain : Chain
        Fixed.
    seed : int
    render : Render
    tick : callable
        Called after each voltage.

    Returns
    -------
    list of Excess
        One per voltage.

    Raises
    ------
    InputError
        If the scene's own voltage leaves the LEDs dark, so that nothing could be scaled from it.
    """
    if not led_powers_of(scene).max(initial=0.0) > 0:
        raise InputError("no light at the scene's own voltage", key="leds.voltage_V", allowed="a voltage that lights")
    lit = {
        omitted: Press.of(scene, force, omitted - {"saturation"}, seed=seed, render=render)
        for omitted in (NOTHING, *(frozenset({s}) for s in SOURCES if s != "saturation"), frozenset(SOURCES))
    }
    lit[frozenset({"saturation"})] = lit[NOTHING]
    truth = lit[NOTHING].true_area_mm2
    rows = []
    for voltage in voltages:
        found = {omitted: press.area(voltage, chain, "saturation" not in omitted) for omitted, press in lit.items()}
        parts, residual, interaction = excess_parts(found.__getitem__, truth)
        rows.append(
            Excess(
                force_N=force, voltage_V=voltage, area_mm2=found[NOTHING], true_area_mm2=truth,
                parts_mm2=parts, residual_mm2=residual, interaction_mm2=interaction,
            )
        )  # fmt: skip
        tick()
    return rows
