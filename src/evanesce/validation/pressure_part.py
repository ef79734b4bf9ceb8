"""The pressure study as a part of ``evanesce study all``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from evanesce.rig import Scene
from evanesce.validation.pressure_study import FORCES, SLOPES, VOLTAGES, run_study
from evanesce.validation.studies import Findings, Ledger, Listing, Part, Progress, Shown
from evanesce.validation.study_scenes import Finger, check_studied


def run(scene: Scene, out: Path, progress: Progress, *, quick: bool = False, seed: int = 1) -> Findings:
    """Do the study; see :class:`evanesce.validation.studies.Study`."""
    check_studied(scene)
    smooth = Finger(scene.finger.material, ridged=False, glowing=False).on(scene)
    ledger = Ledger(out / "pressure.jsonl", {"scene": scene.as_dict(), "seed": seed, "quick": quick})
    path = out / "pressure-maps.npy"
    if not len(ledger):  # the picture belongs to the rows
        path.unlink(missing_ok=True)

    def show(maps: Mapping[str, NDArray[np.float64]]) -> None:
        if not path.is_file():
            temporary = path.with_name(f".{path.name}")
            with temporary.open("wb") as stream:
                np.save(stream, np.stack([maps[name] for name in ("true", "model", "author")]), allow_pickle=False)
            temporary.replace(path)

    found = run_study(
        smooth, slopes=SLOPES[:1] if quick else SLOPES, forces=FORCES[:1] if quick else FORCES, voltages=VOLTAGES,
        seed=seed, tick=partial(progress, "pressure: frames"), keep=ledger.row, show=show,
    )  # fmt: skip
    maps = np.load(path, allow_pickle=False) if path.is_file() else None
    return findings([asdict(row) for row in found.rows], maps)


def findings(rows: Sequence[Mapping[str, Any]], maps: NDArray[np.float64] | None = None) -> Findings:
    """Return table, picture and verdict from rows and the maps (true, model, author) of one frame [MPa]."""
    clear = [r for r in rows if r["saturated_share"] == 0]
    lost = [r for r in rows if r["saturated_share"] > 0.5]
    verdict = []
    if clear:
        ours, theirs = ([r[key] for r in clear] for key in ("rms_percent", "author_rms_percent"))
        verdict.append(
            f"Without saturation the roughness model turned round finds the pressure to {min(ours):.1f} to"
            f" {max(ours):.1f} % of its peak (RMS); the author's map, scaled to the force, errs by {min(theirs):.0f} to"
            f" {max(theirs):.0f} %."
        )
        verdict.append(
            "The halo of the dilated mask carries"
            f" {min(r['author_halo_percent'] for r in clear):.1f} to"
            f" {max(r['author_halo_percent'] for r in clear):.1f} % of the force in the author's map, where nothing"
            " touches."
        )
    if lost:
        verdict.append(
            f"Where more than half of the contact is at full scale ({len(lost)} of {len(rows)} frames) the model errs"
            f" by {min(r['rms_percent'] for r in lost):.0f} to {max(r['rms_percent'] for r in lost):.0f} %: the"
            " pressure there is lost."
        )
    pictures = [] if maps is None else [_picture(maps)]
    return Findings(
        verdict=verdict or ["No frame."], pictures=pictures, tables=[_table(rows)], data={"rows": list(rows)}
    )


def _picture(maps: NDArray[np.float64]) -> Shown:
    top = float(maps[0].max())
    panels = [
        cv2.cvtColor(
            cv2.applyColorMap(np.rint(255 * np.clip(m / top, 0, 1)).astype(np.uint8), cv2.COLORMAP_VIRIDIS),
            cv2.COLOR_BGR2RGB,
        )
        for m in maps
    ]
    gap = np.full((panels[0].shape[0], 8, 3), 255, np.uint8)
    return Shown(
        image=np.concatenate([panels[0], gap, panels[1], gap, panels[2]], axis=1),
        caption=f"Pressure of one frame, from 0 to {top:.2f} MPa: true, by the roughness model, and the author's map.",
    )


def _table(rows: Sequence[Mapping[str, Any]]) -> Listing:
    def number(value: float | None, form: str) -> str:
        return "none" if value is None else format(value, form)

    return Listing(
        columns=("RMS slope [1]", "force [N]", "voltage [V]", "true peak [MPa]", "at full scale [%]", "model RMS [%]",
                 "author RMS [%]", "model correlation", "author correlation", "model halo [%]", "author halo [%]"),
        rows=[
            (
                f"{r['rms_slope']:g}", f"{r['force_N']:g}", f"{r['voltage_V']:g}", f"{r['peak_MPa']:.3f}",
                f"{100 * r['saturated_share']:.0f}", number(r["rms_percent"], ".1f"),
                number(r["author_rms_percent"], ".1f"), number(r["correlation"], ".3f"),
                number(r["author_correlation"], ".3f"), number(r["halo_percent"], ".1f"),
                number(r["author_halo_percent"], ".1f"),
            )
            for r in rows
        ],
        caption="Errors over the true contact's pixels, in per cent of the true peak; halo: force that a map puts where"
        " nothing touches.",
    )  # fmt: skip


STUDY = Part("pressure", "Pressure from grey levels", 40, run)
