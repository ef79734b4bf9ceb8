"""``evanesce compare``: measure rendered frames and compare the result with their ground truth."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich import box
from rich.table import Table

from evanesce.cli.common import (
    JsonOption,
    OutOption,
    check_json_target,
    console,
    handles_errors,
    messages,
    out_dir,
    progress,
    write_json,
)
from evanesce.core.errors import InputError

if TYPE_CHECKING:
    from evanesce.evaluation.evaluate import Evaluation


def register(app: typer.Typer) -> None:
    """Add the command."""

    @app.command()
    @handles_errors
    def compare(
        rendered: Annotated[Path, typer.Argument(help="Folder written by `evanesce render`.")],
        calibration: Annotated[
            Path | None, typer.Option("--calibration", help="JSON of `evanesce calibrate`, with a square card.")
        ] = None,
        mm2_per_px: Annotated[
            float | None, typer.Option("--mm2-per-px", help="Area of a pixel in mm², instead of the calibration's.")
        ] = None,
        threshold: Annotated[float, typer.Option("--threshold", help="Grey level, 0 to 1.")] = 0.15,
        min_blob: Annotated[int, typer.Option("--min-blob", help="Minimum size of a dilated blob in px.")] = 2000,
        blur: Annotated[float, typer.Option("--blur", help="Standard deviation of the Gaussian in px.")] = 1.0,
        parts: Annotated[bool, typer.Option("--split/--no-split", help="Split the error by source.")] = True,
        json_file: JsonOption = None,
        out: OutOption = None,
    ) -> None:
        """Measure rendered frames by the reference segmentation and compare with the truth.

        Area error, mask overlap, boundary displacement, and the error split into scale, distortion, blur, threshold and
        noise, each switched off in turn.
        """
        from evanesce.evaluation.evaluate import Camera, evaluate
        from evanesce.evaluation.rendered import read_rendered
        from evanesce.measurement.calibration.model import load_calibration
        from evanesce.measurement.reference.segment import Chain

        check_json_target(json_file)
        chain = Chain(threshold=threshold, min_blob=min_blob, blur=blur)
        loaded = None if calibration is None else load_calibration(calibration)
        scale = mm2_per_px if mm2_per_px is not None else None if loaded is None else loaded.mm2_per_px
        if scale is None:
            read_rendered(rendered)  # a folder that is not there is the first thing to say
            key = "--mm2-per-px" if loaded is None else "mm2_per_px"
            raise InputError(
                "the area of a pixel is not known", file=calibration, key=key,
                allowed="--mm2-per-px X, or a calibration made with --square",
            )  # fmt: skip
        if not 1e-12 < scale < 1e6:
            raise InputError(f"{scale:g}", key="--mm2-per-px", allowed="1e-12 to 1e6 mm²")
        job = read_rendered(rendered)
        if parts and not job.has_light:
            messages.print("note: the folder has no linear light (light_*.exr), so that the error is not split")
            parts = False
        camera = Camera.of(job.true_scene(), loaded, scale)
        rows = []
        with progress() as bar:
            task = bar.add_task("frames", total=len(job.frames))
            for entry, shot in zip(job.frames, job.shots(), strict=True):
                found = evaluate(shot, chain, camera, seed=job.seed, parts=parts)
                row: dict[str, Any] = {"index": entry.index, "time_s": entry.time_s, "force_N": entry.force_N}
                row |= spoilt(found, camera.mm2_per_px)
                rows.append(row | found.row())
                bar.advance(task)
        result = {"frames": rows, "settings": {"threshold": threshold, "min_blob": min_blob, "mm2_per_px": scale}}
        if out is not None:
            write_json(out_dir(out, "compare") / "result.json", result)
        write_json(json_file, result)
        console.print(comparison_table(rows, ("index", "force_N")))
        for text in causes(rows, threshold):
            messages.print(text, style="yellow", markup=False, highlight=False, soft_wrap=True)


MOST_ERROR_PERCENT = 5.0
"""Error from which its cause is named."""

NAMED_SHARE = 0.25
"""Share of the error from which light beside the contact is named among its causes: a choice."""


def spoilt(found: Evaluation, mm2_per_px: float) -> dict[str, float]:
    """Return what may spoil an area: counted pixels at full scale, light beside the contact.

    Parameters
    ----------
    found : Evaluation
    mm2_per_px : float
        [mm^2].

    Returns
    -------
    dict
        ``saturated_percent`` of the counted pixels; ``flank_percent``: area counted farther than ``FLANK_PX`` outside
        the true contact, in percent of the true area.
    """
    import cv2
    import numpy as np

    mask, true = found.measured.estimate.mask, found.labels.mask > 0.5
    out = cv2.distanceTransform((~true).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    flank = np.count_nonzero(mask & (out > FLANK_PX)) * mm2_per_px
    return {
        "saturated_percent": 100.0 * found.measured.figures.saturated_pixels / max(found.measured.estimate.pixels, 1),
        "flank_percent": 100.0 * float(flank) / found.comparison.true_area_mm2,
    }


FLANK_PX = 4.0
"""Beyond this distance from the contact blur leaves nothing: what is counted there is light on the finger's flank
or scattered in it."""


def causes(rows: list[dict[str, Any]], threshold: float) -> list[str]:
    """Return a line for each frame whose large error saturation or light beside the contact causes."""
    found = []
    for row in rows:
        if abs(row["error_percent"]) < MOST_ERROR_PERCENT:
            continue
        parts = []
        if row["flank_percent"] > NAMED_SHARE * abs(row["error_percent"]):
            parts.append(
                f"light beside the contact, on the finger's flank or scattered in the silicone, is above the threshold "
                f"{threshold:g}: farther out than {FLANK_PX:g} px it counts {row['flank_percent']:+.1f} %"
            )
        if row["saturated_percent"] > 1.0:
            parts.append(f"{row['saturated_percent']:.1f} % of the counted pixels are at full scale (saturation)")
        if parts:
            cure = "lower the LEDs' voltage or expose less, or raise the threshold"
            found.append(f"frame {row['index']}: {row['error_percent']:+.1f} %: {'; '.join(parts)}; {cure}")
    return found


# Short, so that the table fits a terminal of 80 columns.
LEADING = {"index": "frame\n", "force_N": "force\n[N]", "finger": "finger\n"}
PARTS = {
    "scale": "scale",
    "distortion": "dist.",
    "blur": "blur",
    "threshold": "thr.",
    "noise": "noise",
    "residual": "rest",
    "interaction": "joint",
}
CAPTION = """Error and its parts in percent of the true area, each part by switching its source off: scale of the
square card, lens distortion, blur, threshold, noise; rest: with all of them off; joint: only together."""


def comparison_table(rows: list[dict[str, Any]], leading: tuple[str, ...]) -> Table:
    """Return the table of compared frames; ``leading`` names the columns that identify a frame."""
    parts = list(rows[0].get("split_percent", {}))
    table = Table(
        title="Contact area by the reference segmentation against the truth",
        caption=CAPTION.replace("\n", " ") if parts else None,
        box=box.SIMPLE_HEAD,
        padding=0,
    )
    for key in leading:
        table.add_column(LEADING[key], justify="left" if key == "finger" else "right", no_wrap=True)
    for heading in ("true\n[mm²]", "meas.\n[mm²]", "error\n[%]", *(f"{PARTS[part]}\n[%]" for part in parts)):
        table.add_column(heading, justify="right", no_wrap=True)
    for row in rows:
        table.add_row(
            *(f"{row[key]:g}" if isinstance(row[key], float) else str(row[key]) for key in leading),
            f"{row['true_area_mm2']:.2f}",
            f"{row['measured_area_mm2']:.2f}",
            f"{row['error_percent']:+.2f}",
            *(f"{row['split_percent'][part]:+.2f}" for part in parts),
        )
    return table
