"""The voltage study from end to end: one scene in full, then what is not published about it, then the best setting."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.chain.simulate import Render
from evanesce.contact.solve import contact_state
from evanesce.core import provenance
from evanesce.core.errors import InputError
from evanesce.core.extras import require
from evanesce.effects import Context, Stage, active_effects, apply_stage
from evanesce.measurement.reference.segment import Chain
from evanesce.render.fast.transport import render_fast
from evanesce.rig import Scene
from evanesce.studies.voltage.analysis import (
    BestSetting,
    Claims,
    best_setting,
    claims,
    converged,
    held_from,
    onset,
    sensitivity,
    up_to,
    where_it_holds,
)
from evanesce.studies.voltage.colour_rig import FLANK, SAMPLED, ColourRig
from evanesce.studies.voltage.colour_unknowns import WHITE_LEDS, colour_unknowns
from evanesce.studies.voltage.curve import Excess, voltage_curve
from evanesce.studies.voltage.grooves import Grooves, grooves
from evanesce.studies.voltage.in_colour import InColour, agreement, flank_share, in_colour
from evanesce.studies.voltage.press import Press
from evanesce.studies.voltage.reduced_rig import LitPresses, ReducedRig
from evanesce.studies.voltage.samples import run_samples
from evanesce.studies.voltage.sources import study_scene
from evanesce.studies.voltage.unknowns import THRESHOLDS, UNKNOWNS, Plan, Samples

Array = NDArray[np.float64]
Tick = Callable[[str, int, int], None]

BINS_V = (2.8, 2.9, 2.95, 3.0, 3.1, 3.2, 3.3)
SHOWN_V = (7.5, 8.0, 8.5, 9.0, 10.0, 12.0)
EXPOSURE_CONTROL_V = 9.0


@dataclass(frozen=True, kw_only=True)
class VoltageStudy:
    """All that the study found; see :meth:`as_dict` for the JSON.

    Attributes
    ----------
    scene : Scene
    notes : list of str
        What was added to the scene.
    forces, voltages : tuple of float
    threshold : float
    curves : dict of list of Excess
        By force.
    frames : dict of ndarray of uint8
        Windows of frames at the first force, by voltage.
    error_map : ndarray (voltages, thresholds)
        Relative area error of the scene, RMS over the forces, by the full chain.
    reduced_difference : tuple of float
        Largest difference between reduced and full chain over the forces, over the larger of estimate and truth: at
        voltages up to 9 V, and at all.
    bins : list of dict
        Onset and convergence by the LEDs' bin, else as the scene.
    grooves : list of Grooves
    samples : Samples
    readings : dict of Claims
        As computed; ending at 10 V; with exposure control from 9 V.
    indices : dict of list of dict
        Sobol' indices by output.
    holds : dict of list of dict
        Of :func:`where_it_holds`, by reading.
    best : BestSetting
    colour : InColour or None
        Of a scene with a colour camera.
    """

    scene: Scene
    notes: list[str]
    forces: tuple[float, ...]
    voltages: tuple[float, ...]
    threshold: float
    curves: dict[float, list[Excess]]
    frames: dict[float, NDArray[np.uint8]]
    error_map: Array
    reduced_difference: tuple[float, float]
    bins: list[dict[str, Any]]
    grooves: list[Grooves]
    samples: Samples
    readings: dict[str, Claims]
    indices: dict[str, list[dict[str, Any]]]
    holds: dict[str, list[dict[str, Any]]]
    best: BestSetting
    provenance: Mapping[str, Any]
    colour: InColour | None = None

    @property
    def main(self) -> str:
        """Name of the reading that the sensitivities belong to."""
        return next(iter(self.readings))

    @property
    def scene_best(self) -> tuple[float, float, float]:
        """Voltage [V], threshold and relative error of the scene's own smallest error."""
        i, j = np.unravel_index(int(self.error_map.argmin()), self.error_map.shape)
        return self.voltages[i], THRESHOLDS[j], float(self.error_map[i, j])

    def scene_voltages(self, force: float) -> tuple[float, float]:
        """Return onset and convergence [V] of the scene at a force.

        Parameters
        ----------
        force : float
            [N].

        Returns
        -------
        onset, convergence : float
            [V].
        """
        area = np.array([row.area_mm2 for row in self.curves[force]])
        truth = np.array(self.curves[force][0].true_area_mm2)
        return float(onset(self.voltages, area, truth)), float(converged(self.voltages, area))

    def as_dict(self) -> dict[str, Any]:
        """Return the JSON result, units in the keys.

        Returns
        -------
        dict
        """
        volts, level, error = self.scene_best
        return {
            "threshold": self.threshold,
            "notes": self.notes,
            "curves": [row.row() for rows in self.curves.values() for row in rows],
            "scene": [
                {"force_N": f, "onset_V": a, "converged_V": b}
                for f, (a, b) in ((f, self.scene_voltages(f)) for f in self.forces)
            ],
            "scene_best": {"voltage_V": volts, "threshold": level, "relative_error": error},
            "reduced_over_full_max_difference": self.reduced_difference,
            "bins": self.bins,
            "grooves": [asdict(g) for g in self.grooves],
            "unknowns": [asdict(u) for u in self.samples.plan.unknowns],
            "samples": len(self.samples.values),
            "open_middle_share": dict(
                zip(map(str, self.forces), self.samples.open_middle[self.samples.independent].mean(axis=0), strict=True)
            ),
            "readings": {name: self.shares(name) for name in self.readings},
            "sensitivity": self.indices,
            "where_it_holds": self.holds,
            "best_setting": asdict(self.best),
            **({} if self.colour is None else {"colour": self.colour.as_dict()}),
            "provenance": dict(self.provenance),
        }

    def shares(self, reading: str) -> dict[str, float]:
        """Return the share of independent rigs that show each part of the thesis's observation.

        Parameters
        ----------
        reading : str
            Key of ``readings``.

        Returns
        -------
        dict of str to float
            [1].
        """
        c, some = self.readings[reading], self.samples.independent
        parts = {"vanishes": c.vanishes, "rises": c.rises, "settles": c.settles, "all": c.all}
        return {name: float(np.mean(value[some])) for name, value in parts.items()}


def scene_values(scene: Scene, threshold: float) -> Array:
    """Return the scene's own figures in the order of the unknowns.

    Parameters
    ----------
    scene : Scene
    threshold : float
        Of the reference segmentation, 0 to 1.

    Returns
    -------
    ndarray (unknowns,)

    Raises
    ------
    InputError
        If the finger has no ridges, or the law no modulus.
    """
    rig: Scene = apply_stage(Stage.RIG, scene, active_effects(scene), Context(scene, 0))
    if rig.finger.ridges is None:
        raise InputError("the finger has no ridges", key="finger.ridges", allowed="a ridged finger")
    modulus = contact_state(rig, 1.0).parameters.get("reduced_modulus_MPa")
    if modulus is None:
        raise InputError(f"law {rig.contact.law}", key="contact.law", allowed="a law with a reduced modulus")
    camera = rig.camera
    exposure = camera.exposure_ms * (1.0 if camera.colour is None else camera.analogue_gain)
    values = [
        rig.finger.scattering_length_mm, 1e-3 * rig.finger.ridges.pitch_um, float(modulus),
        rig.leds.circuit.forward_voltage_V, exposure, threshold,
    ]  # fmt: skip
    if camera.colour is not None:  # its own filters; flank and ground are not sampled but rendered
        values += [-1.0, 0.0, 0.0, float(camera.auto_exposure is not None), camera.lens.f_number]
    return np.array(values)


def run_study(
    scene: Scene,
    forces: Sequence[float],
    voltages: Sequence[float],
    *,
    threshold: float = 0.15,
    base: int = 64,
    seed: int = 1,
    keep: Path | None = None,
    render: Render | None = None,
    renderer: Mapping[str, Any] | None = None,
    tick: Tick = lambda what, done, total: None,
) -> VoltageStudy:
    """Run the whole study.

    Parameters
    ----------
    scene : Scene
        Ridged.
    forces, voltages : sequence of float
        [N], [V] ascending.
    threshold : float
        Of the reference segmentation, fixed over all voltages.
    base : int
        N of the Saltelli sample, a power of two.
    seed : int
    keep : Path, optional
        See :func:`run_samples`.
    render : Render, optional
        For the scene in full; the fast renderer if not given. The sampled rigs always use the fast renderer's fields.
    renderer : mapping, optional
        What provenance says of ``render``.
    tick : callable
        ``tick(what, done, total)``.

    Returns
    -------
    VoltageStudy

    Raises
    ------
    InputError
        If the scene cannot be studied.
    """
    require("design", "the study of voltage", "SALib")
    render = render_fast if render is None else render
    scene, notes = study_scene(scene)
    own = scene_values(scene, threshold)
    volts, loads = tuple(voltages), tuple(forces)
    curves = _curves(scene, loads, volts, threshold, seed, render, tick)
    presses = [Press.of(scene, force, seed=seed, render=render) for force in loads]
    areas = _full_areas(presses, volts, tick)
    truth = np.array([press.true_area_mm2 for press in presses])
    error_map = np.sqrt(((areas / truth[:, None, None] - 1.0) ** 2).mean(axis=0))
    plan = Plan(loads, volts, base, seed, UNKNOWNS if scene.camera.colour is None else colour_unknowns(scene))
    rig = ReducedRig(scene, plan) if scene.camera.colour is None else ColourRig(scene, plan)
    lit = rig.light(own)
    if scene.camera.colour is not None:
        own[FLANK.start] = flank_share(presses[0])
    by_threshold = rig.areas(lit, own)
    full = np.array([[row.area_mm2 for row in curves[f]] for f in loads])
    samples = run_samples(scene, plan, keep=keep, tick=lambda d, n: tick("samples", d, n))
    readings, colour = readings_of(samples), None
    if scene.camera.colour is not None:
        colour = in_colour(samples, readings, agreement(by_threshold[..., :-1], areas, lit.true_area, volts))
    plain = next(iter(readings.values()))
    outputs = {"onset_V": plain.onset, "converged_V": plain.settled, "excess_at_9V": np.log(2.0 + plain.excess)}
    return VoltageStudy(
        scene=scene, notes=notes, forces=loads, voltages=volts, threshold=threshold, curves=curves,
        frames={v: np.asarray(presses[0].levels(v)) for v in SHOWN_V},
        error_map=error_map,
        reduced_difference=_differences(by_threshold[..., -1], full, lit.true_area, np.array(volts) <= 9.0),
        bins=_bins(rig, lit, own),
        grooves=[grooves(scene, force) for force in loads],
        samples=samples, readings=readings,
        indices={name: sensitivity(output, seed, plan.unknowns) for name, output in outputs.items()},
        holds={name: where_it_holds(samples, found.all) for name, found in readings.items()}
        | {part: where_it_holds(samples, getattr(plain, part)) for part in ("vanishes", "settles")},
        best=best_setting(samples, np.ones(len(samples.values), bool), seed=seed), colour=colour,
        provenance=provenance.record(seed=seed, config=scene.as_dict(), **(renderer or {"renderer": "transport"})),
    )  # fmt: skip


def _curves(
    scene: Scene, loads: tuple[float, ...], volts: tuple[float, ...], threshold: float, seed: int, render: Render,
    tick: Tick,
) -> dict[float, list[Excess]]:  # fmt: skip
    """Return area and excess at each voltage, by force."""
    counter, total = itertools.count(1), len(loads) * len(volts)

    def step() -> None:
        tick("voltages", next(counter), total)

    chain = Chain(threshold=threshold)
    return {force: voltage_curve(scene, force, volts, chain, seed=seed, render=render, tick=step) for force in loads}


def readings_of(samples: Samples) -> dict[str, Claims]:
    """Return the claims by reading; the first is that of the samples themselves."""
    if samples.contact is None:
        return {
            "as computed": claims(samples),
            "ending at 10 V": claims(up_to(samples, 10.0)),
            "exposure control from 9 V": claims(held_from(samples, EXPOSURE_CONTROL_V)),
        }
    other = {name: claims(replace(samples, own=own)) for name, own in samples.other.items()}
    return {SAMPLED.name: claims(samples)} | other


def _full_areas(presses: Sequence[Press], volts: tuple[float, ...], tick: Tick) -> Array:
    """Return the full chain's areas by force, voltage and threshold [mm^2]."""
    chains = [Chain(threshold=t) for t in THRESHOLDS]
    found = []
    for press in presses:
        found.append([press.areas(v, chains) for v in volts])
        tick("thresholds", len(found), len(presses))
    return np.array(found)


def _differences(reduced: Array, full: Array, true_area: Array, low: NDArray[np.bool_]) -> tuple[float, float]:
    """Return the largest relative difference at the voltages in ``low``, and at all."""
    apart = np.abs(reduced - full) / np.maximum(full, true_area[:, None])
    return float(apart[:, low].max(initial=0.0)), float(apart.max())


def _bins(rig: ReducedRig, lit: LitPresses, own: Array) -> list[dict[str, Any]]:
    """Return what each bin of the LEDs would have shown, all else as in the scene."""
    found, v = [], rig.plan.voltages
    for white in BINS_V:
        values = own.copy()
        values[3] = forward = white * WHITE_LEDS / rig.scene.leds.circuit.leds_per_segment
        area = rig.areas(lit, values)[..., -1]
        found.append(
            {
                "forward_voltage_V": forward,
                "onset_V": onset(v, area, lit.true_area).tolist(),
                "converged_V": converged(v, area).tolist(),
                "area_over_true": (area / lit.true_area[:, None]).tolist(),
            }
        )
    return found
