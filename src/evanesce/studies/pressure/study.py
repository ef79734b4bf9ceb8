"""Pressure from grey levels, by the inverted roughness model and by the thesis's map, against the true pressure."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.contact.analytic.roughness import persson_contact_fraction
from evanesce.contact.solve import contact_state
from evanesce.core import provenance, rng
from evanesce.evaluation.labels import label, view_geometry
from evanesce.measurement.pressure import PressureCurve, pressure_map, reference_map
from evanesce.measurement.reference.segment import Chain, segment
from evanesce.measurement.refined.light import Radiometry, tone_table
from evanesce.optics.projection import Projection
from evanesce.rig import Scene
from evanesce.studies.estimator.study import LitPress
from evanesce.studies.ledger import Keep, not_kept

Floats = NDArray[np.float64]

SLOPES = (0.3, 0.6)
FORCES = (1.0, 3.0)
VOLTAGES = (8.5, 9.0, 12.0)
CURVE_POINTS = 2001
MARGIN_PX = 25


@dataclass(frozen=True, kw_only=True)
class Row:
    """One frame; errors over the true contact's pixels.

    Attributes
    ----------
    rms_slope, force_N, voltage_V : float
    peak_MPa : float
        True.
    rms_percent, reference_rms_percent : float
        RMS error of the pressure [% of the true peak].
    correlation, reference_correlation : float or None
        With the true pressure; None where a map is flat.
    saturated_share : float
        Of the contact.
    halo_percent, reference_halo_percent : float
        Force that a map puts outside the contact [% of the force].
    factor : float
        See :class:`~evanesce.measurement.pressure.PressureMap`.
    """

    rms_slope: float
    force_N: float
    voltage_V: float
    peak_MPa: float
    rms_percent: float
    reference_rms_percent: float
    correlation: float | None
    reference_correlation: float | None
    saturated_share: float
    halo_percent: float
    reference_halo_percent: float
    factor: float


@dataclass(frozen=True, kw_only=True)
class PressureStudy:
    """All rows, and the maps of one frame for the picture.

    Attributes
    ----------
    rows : list of Row
    maps : dict of ndarray
        ``true``, ``model`` and ``reference`` pressure [MPa] of the first frame that does not saturate, and ``full``, 1
        where a pixel is at full scale.
    provenance : dict
    """

    rows: list[Row]
    maps: dict[str, Floats]
    provenance: dict[str, Any]

    def as_dict(self) -> dict[str, Any]:
        """Return the JSON result.

        Returns
        -------
        dict
        """
        return {"rows": [asdict(r) for r in self.rows], "provenance": self.provenance}


def roughness_curve(modulus: float, slope: float, peak_MPa: float) -> PressureCurve:
    """Return light against pressure of a rough skin: the share in real contact, after Persson.

    Parameters
    ----------
    modulus : float
        E* [MPa].
    slope : float
        RMS slope of the roughness [1].
    peak_MPa : float
        End of the table [MPa].

    Returns
    -------
    PressureCurve
    """
    pressure = np.linspace(0.0, peak_MPa, CURVE_POINTS)
    return PressureCurve(pressure, persson_contact_fraction(pressure, modulus, slope))


def rough(scene: Scene, slope: float) -> Scene:
    """Return a scene whose skin has an RMS slope.

    Parameters
    ----------
    scene : Scene
    slope : float
        RMS slope [1].

    Returns
    -------
    Scene
    """
    return scene.model_copy(update={"finger": scene.finger.model_copy(update={"roughness_rms_slope": slope})})


def run_study(
    scene: Scene,
    *,
    slopes: Sequence[float] = SLOPES,
    forces: Sequence[float] = FORCES,
    voltages: Sequence[float] = VOLTAGES,
    threshold: float = 0.15,
    seed: int = 1,
    tick: Callable[[int, int], None] = lambda done, total: None,
    keep: Keep = not_kept,
    show: Callable[[dict[str, Floats], Row], None] = lambda maps, row: None,
) -> PressureStudy:
    """Run the study.

    Parameters
    ----------
    scene : Scene
        Smooth; its skin gets the slopes.
    slopes, forces, voltages : sequence of float
        [1], [N], [V].
    threshold : float
        Of the reference segmentation.
    seed : int
    tick : callable
        ``tick(done, total)``.
    keep : callable
        Keeps the rows of a press, so that an interrupted run goes on; see :data:`~evanesce.studies.ledger.Keep`.
    show : callable
        ``show(maps, row)`` gets every frame's maps, before the rows of its press are kept.

    Returns
    -------
    PressureStudy
    """
    rows: list[Row] = []
    maps: dict[str, Floats] = {}

    def each(found: dict[str, Floats], row: Row) -> None:
        show(found, row)
        if not maps and row.saturated_share == 0:
            maps.update(found)

    for slope in slopes:
        for force in forces:
            make = partial(_press, rough(scene, slope), slope, force, voltages, threshold, seed, each)
            rows += [Row(**row) for row in keep(f"slope {slope:g}, {force:g} N", make)["rows"]]
            tick(len(rows), len(slopes) * len(forces) * len(voltages))
    return PressureStudy(
        rows=rows, maps=maps, provenance=dict(provenance.record(seed=seed, config=scene.as_dict()))
    )  # fmt: skip


def _press(
    rig: Scene, slope: float, force: float, voltages: Sequence[float], threshold: float, seed: int,
    show: Callable[[dict[str, Floats], Row], None],
) -> dict[str, Any]:  # fmt: skip
    """Return the rows of one press as plain data."""
    press, state = LitPress.of(rig, force, seed), contact_state(rig, force)
    truth = label(state, view_geometry(Projection.of(press.scene.camera, press.scene.plate)), supersample=2)
    curve = roughness_curve(float(state.parameters["reduced_modulus_MPa"]), slope, 4.0 * float(state.pressure.max()))
    rows = []
    for voltage in voltages:
        frame = press.frame(voltage, rng.integer_seed(seed, "pressure", f"{slope:g} {force:g}"))
        row, maps = _compare(frame.data, truth, curve, threshold, (slope, force, voltage, rig.camera.tone_curve))
        rows.append(asdict(row))
        show(maps, row)
    return {"rows": rows}


def _compare(
    image: NDArray[np.uint8], truth: Any, curve: PressureCurve, threshold: float, case: tuple[float, float, float, str]
) -> tuple[Row, dict[str, Floats]]:
    slope, force, voltage, tone = case
    at_rows, at_cols = np.nonzero(truth.mask > 0)
    box = np.s_[
        max(0, at_rows.min() - MARGIN_PX) : at_rows.max() + MARGIN_PX + 1,
        max(0, at_cols.min() - MARGIN_PX) : at_cols.max() + MARGIN_PX + 1,
    ]
    true, inside, area = truth.pressure[box].astype(float), truth.mask[box] > 0.5, truth.pixel_area[box]
    light, full = Radiometry(tone_table(tone)).light(image[box])
    found = pressure_map(light - float(np.median(light[truth.mask[box] == 0])), full, area, force, curve)
    thesis = reference_map(image[box] / 255.0, segment(image, Chain(threshold=threshold)).dilated[box], area, force)
    peak = float(true.max())

    def scores(pressure: Floats) -> tuple[float, float | None, float]:
        error = (pressure - true)[inside]
        halo = float((pressure * area)[truth.mask[box] == 0].sum()) / force
        flat = pressure[inside].std() == 0
        alike = None if flat else float(np.corrcoef(pressure[inside], true[inside])[0, 1])
        return 100 * float(np.sqrt((error**2).mean())) / peak, alike, 100 * halo

    model, reference = scores(found.pressure), scores(thesis)
    row = Row(
        rms_slope=slope, force_N=force, voltage_V=voltage, peak_MPa=peak, rms_percent=model[0],
        reference_rms_percent=reference[0], correlation=model[1], reference_correlation=reference[1],
        saturated_share=float((full & inside).sum() / inside.sum()), halo_percent=model[2],
        reference_halo_percent=reference[2], factor=found.factor,
    )  # fmt: skip
    return row, {"true": true, "model": found.pressure, "reference": thesis, "full": (full & inside).astype(float)}
