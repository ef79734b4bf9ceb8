"""Findings and page of the pressure study: pressure maps by the roughness model and by the thesis's map."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.report.charts import Map, Maps
from evanesce.report.html import Page, Table
from evanesce.rig import Scene
from evanesce.studies import page as report
from evanesce.studies.ledger import Ledger
from evanesce.studies.pressure.colour import ColourPressure, run_colour
from evanesce.studies.pressure.page_colour import colour_findings
from evanesce.studies.pressure.study import FORCES, SLOPES, VOLTAGES, PressureStudy, Row, run_study
from evanesce.studies.registry import Findings, Progress, Study
from evanesce.studies.scenes import Finger, check_studied

Floats = NDArray[np.float64]

KEPT = ("true", "model", "reference", "full")
"""Maps of a frame that a run keeps."""

LOST = 0.5
"""Share of the contact at full scale from which on its pressure counts as lost."""


def run(scene: Scene, out: Path, progress: Progress, *, quick: bool = False, seed: int = 1) -> Findings:
    """Compute the study and return its findings.

    Parameters
    ----------
    scene, out, progress, quick, seed
        As for :meth:`evanesce.studies.registry.Study.run`.

    Returns
    -------
    Findings
    """
    check_studied(scene)
    smooth = Finger(scene.finger.material, ridged=False, scattering=False).on(scene)
    if scene.camera.colour is not None:
        return _run_colour(smooth, out, progress, quick, seed)
    ledger = Ledger(out / "pressure.jsonl", {"scene": scene.as_dict(), "seed": seed, "quick": quick, "maps": KEPT})
    paths = {name: out / f"pressure-{name}.npy" for name in ("clear", "lost")}
    if not len(ledger):  # the pictures belong to the rows
        for path in paths.values():
            path.unlink(missing_ok=True)

    def show(maps: Mapping[str, Floats], row: Row) -> None:
        for name, path in paths.items():
            if _wanted(name, row.saturated_share) and not path.is_file():
                temporary = path.with_name(f".{path.name}")
                with temporary.open("wb") as stream:
                    np.save(stream, np.stack([maps[kind] for kind in KEPT]), allow_pickle=False)
                temporary.replace(path)

    found = run_study(
        smooth, slopes=SLOPES[:1] if quick else SLOPES, forces=FORCES[:1] if quick else FORCES, voltages=VOLTAGES,
        seed=seed, tick=partial(progress, "pressure: frames"), keep=ledger.row, show=show,
    )  # fmt: skip
    maps = {name: np.load(path, allow_pickle=False) for name, path in paths.items() if path.is_file()}
    return findings([asdict(row) for row in found.rows], maps)


def _run_colour(smooth: Scene, out: Path, progress: Progress, quick: bool, seed: int) -> Findings:
    ledger = Ledger(out / "pressure-colour.jsonl", {"scene": smooth.as_dict(), "seed": seed, "quick": quick})
    found = run_colour(
        smooth, slopes=SLOPES[:1] if quick else SLOPES, forces=FORCES[:1] if quick else FORCES, seed=seed,
        tick=partial(progress, "pressure: maps"), keep=ledger.row,
    )  # fmt: skip
    return colour_findings(found)


def _wanted(name: str, saturated_share: float) -> bool:
    """Return whether a frame is one of those that "clear" or "lost" stands for."""
    return saturated_share == 0 if name == "clear" else saturated_share > LOST


def findings(rows: Sequence[Mapping[str, Any]], maps: Mapping[str, Floats] | None = None) -> Findings:
    """Return table, maps and verdict.

    Parameters
    ----------
    rows : sequence of mapping
    maps : mapping of ndarray (4, rows, cols), optional
        :data:`KEPT` [MPa] of the first frame without saturation (``clear``) and the first whose contact is mostly at
        full scale (``lost``).

    Returns
    -------
    Findings
    """
    clear = [r for r in rows if r["saturated_share"] == 0]
    lost = [r for r in rows if r["saturated_share"] > LOST]
    verdict = []
    if clear:
        model, reference = ([r[key] for r in clear] for key in ("rms_percent", "reference_rms_percent"))
        verdict.append(
            f"Without saturation the inverted roughness model finds the pressure to {min(model):.1f} to"
            f" {max(model):.1f} % of its peak (RMS); the thesis's map, scaled to the force, errs by"
            f" {min(reference):.0f} to {max(reference):.0f} %."
        )
        verdict.append(
            "The halo of the dilated mask carries"
            f" {min(r['reference_halo_percent'] for r in clear):.1f} to"
            f" {max(r['reference_halo_percent'] for r in clear):.1f} % of the force in the thesis's map, outside the"
            " contact."
        )
    if lost:
        verdict.append(
            f"Where more than half of the contact is at full scale ({len(lost)} of {len(rows)} frames) the model errs"
            f" by {min(r['rms_percent'] for r in lost):.0f} to {max(r['rms_percent'] for r in lost):.0f} %: the"
            " pressure there is lost."
        )
    shown, peaks = [], []
    for name in ("clear", "lost"):
        row = next((r for r in rows if _wanted(name, r["saturated_share"])), None)
        if maps and name in maps and row is not None:
            shown.append(_maps(name, maps[name], row))
            peaks.append(_peaks(name, maps[name]))
    return Findings(
        verdict=verdict or ["No frame."],
        maps=shown,
        tables=[_table(rows)],
        data={"rows": list(rows), "peaks": peaks},
    )


def _peaks(name: str, maps: Floats) -> dict[str, Any]:
    """Return how far each map lies off over the tenth of the contact that is pressed hardest [% of the mean there]."""
    true, model, reference, _ = maps
    hard = true >= np.quantile(true[true > 0], 0.9)
    over = {kind: 100 * (float(m[hard].mean() / true[hard].mean()) - 1) for kind, m in
            (("model_percent", model), ("reference_percent", reference))}  # fmt: skip
    greatest = 100 * (float(reference.max() / true.max()) - 1)
    return {"frame": name} | over | {"reference_greatest_pixel_percent": greatest}


def _maps(name: str, maps: Floats, row: Mapping[str, Any]) -> Maps:
    true, model, reference, full = maps
    top, off = float(true.max()), _peaks(name, maps)
    hidden = full > 0
    # three in a thousand pixels of the rim would hide the rest
    limit = float(np.quantile(np.abs(np.stack([model - true, reference - true]))[:, ~hidden & (true > 0)], 0.997))
    upper = [Map(title="true", values=true, top=top), Map(title="roughness model", values=model, top=top),
             Map(title="the thesis's map, scaled to the force", values=reference, top=top)]  # fmt: skip
    lower = [Map(title=f"{who} - true", values=m - true, top=limit, signed=True, unknown=hidden)
             for who, m in (("model", model), ("reference", reference))]  # fmt: skip
    where = f"RMS slope {row['rms_slope']:g}, {row['force_N']:g} N, {row['voltage_V']:g} V"
    if name == "clear":
        caption = (
            f"Where nothing saturates ({where}) the model errs by noise and at the rim only, {row['rms_percent']:.1f} %"
            f" of the peak (RMS), while the thesis's map is too flat: {off['reference_percent']:+.0f} % over the tenth"
            " of the contact that is pressed hardest, and too much at the rim."
        )
    else:
        caption = (
            f"Where light saturates (grey, {row['saturated_share']:.0%} of the contact; {where}) the pressure is lost"
            f" to both maps: the model then errs by {row['rms_percent']:.0f} % of the peak, the thesis's map by"
            f" {row['reference_rms_percent']:.0f} %."
        )
    return Maps(rows=[upper, lower], labels=["pressure [MPa]", "error [MPa]"], caption=caption)


def number(value: float | None, form: str = ".3f") -> str:
    """Return a number as text, ``none`` for None.

    Parameters
    ----------
    value : float or None
    form : str
        Format specification.

    Returns
    -------
    str
    """
    return "none" if value is None else format(value, form)


def _table(rows: Sequence[Mapping[str, Any]]) -> Table:
    return Table(
        columns=("RMS slope [1]", "force [N]", "voltage [V]", "true peak [MPa]", "at full scale [%]", "model RMS [%]",
                 "reference RMS [%]", "model correlation", "reference correlation", "model halo [%]",
                 "reference halo [%]"),
        rows=[
            (
                f"{r['rms_slope']:g}", f"{r['force_N']:g}", f"{r['voltage_V']:g}", f"{r['peak_MPa']:.3f}",
                f"{100 * r['saturated_share']:.0f}", number(r["rms_percent"], ".1f"),
                number(r["reference_rms_percent"], ".1f"), number(r["correlation"], ".3f"),
                number(r["reference_correlation"], ".3f"), number(r["halo_percent"], ".1f"),
                number(r["reference_halo_percent"], ".1f"),
            )
            for r in rows
        ],
        caption="Errors over the true contact's pixels, in per cent of the true peak; halo: force that a map puts"
        " outside the contact. The background, whose median light is subtracted, and the pixels' areas are true.",
    )  # fmt: skip


def page(study: PressureStudy) -> Page:
    """Return the report of ``evanesce study pressure``.

    Parameters
    ----------
    study : PressureStudy

    Returns
    -------
    Page
    """
    maps = {"clear": np.stack([study.maps[name] for name in KEPT])} if study.maps else None
    found = findings([asdict(row) for row in study.rows], maps)
    lead = (
        "The inverted roughness model, with the force as its scale, beside the thesis's map. The model is the "
        "simulation's own: what remains is noise, blur, uneven light and saturation. Light grows less than pressure "
        "does: read as pressure, grey levels are too flat, and the tone curve and the dilated rim make them flatter."
    )
    return report.page("Pressure from grey levels", [(STUDY, found)], study.provenance, lead=lead)


def page_in_colour(found: ColourPressure) -> Page:
    """Return the report of ``evanesce study pressure`` of a scene with a colour camera.

    Parameters
    ----------
    found : ColourPressure

    Returns
    -------
    Page
    """
    lead = (
        "Where red is full, the frame's grey says how strongly the light leaks into green and blue pixels, through a "
        "matrix that subtracts and a curve that saturates. Raw red follows the light itself as long as it is not full."
    )
    findings = colour_findings(found)
    return report.page("Pressure from a colour frame", [(STUDY, findings)], found.provenance, lead=lead)


STUDY = Study("pressure", "Pressure from grey levels", 40, run)
