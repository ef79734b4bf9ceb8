"""The demo's report page."""

from __future__ import annotations

import cv2
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from evanesce.report.html import Page, Picture, Section, Table, figure_png, image_png
from evanesce.studies.demo.run import MARGIN_PX, Demo, DemoFrame, RendererPair
from evanesce.studies.demo.slip import SlipSequence, slip_animation

TRUE_COLOUR, MEASURED_COLOUR = "#00b3ff", "#ff7f0e"


def demo_page(demo: Demo, slip: SlipSequence) -> Page:
    """Return the report of a demo run.

    Parameters
    ----------
    demo : Demo
    slip : SlipSequence
        Opens the page.
    """
    worst = max(demo.frames, key=lambda frame: abs(frame.evaluation.comparison.error_percent))
    error = worst.evaluation.comparison.error_percent
    lead = (
        f"The thesis's rig, simulated, and measured by the thesis's reference segmentation at a threshold of 0.15."
        f" The area is off by up to {error:+.1f} % ({worst.finger}, {worst.force_N:g} N)."
    )
    return Page(
        title="evanesce: the loop on the thesis's rig",
        lead=lead,
        sections=[_slip(slip), _areas(demo), _frames(demo), *_renderers(demo), _calibration(demo)],
        provenance=demo.provenance,
    )


def _slip(slip: SlipSequence) -> Section:
    last = slip.slipping()[-1]
    return Section(
        "What the camera sees of slip",
        pictures=[
            Picture(
                slip_animation(slip),
                f"Open ridges, 130 µm high, pressed to {slip.normal_N.max():g} N and sheared. Left: the frames. Right:"
                f" the labels that come with them, stick (blue) and slip (red): slip grows from the rim inwards, to"
                f" {100 * last:.0f} % of the contact in the last frame, and bends the ridges.",
                kind="webp",
            )
        ],
    )


def _renderers(demo: Demo) -> list[Section]:
    if not demo.pairs:
        return []
    rows = [pair.row() for pair in demo.pairs]
    table = Table(
        ["finger", "force [N]", "contact [DN]", "mean difference [DN]", "RMS difference [DN]"],
        [
            [r["finger"], f"{r['force_N']:g}", f"{r['contact_level_DN']:.1f}", f"{r['mean_difference_DN']:+.2f}",
             f"{r['rms_difference_DN']:.2f}"]
            for r in rows
        ],
        "Inside the true contact; the path tracer's own noise is part of the RMS.",
    )  # fmt: skip
    pictures = [
        Picture(
            _pair_figure(pair),
            f"{pair.finger} finger, {pair.force_N:g} N: fast renderer, path tracer, and their difference [DN].",
        )
        for pair in demo.pairs
    ]
    return [Section("The fast renderer beside the path tracer", pictures=pictures, tables=[table])]


def _pair_figure(pair: RendererPair) -> bytes:
    figure = Figure(figsize=(10.5, 3.6), layout="constrained")
    axes = figure.subplots(1, 3)
    for axis, image, title in ((axes[0], pair.fast, "fast renderer"), (axes[1], pair.reference, "path tracer")):
        axis.imshow(image, cmap="gray", vmin=0, vmax=255, interpolation="nearest")
        axis.set(title=title, xlabel="column [px]")
    top = max(4.0, float(np.quantile(np.abs(pair.difference), 0.995)))
    shown = axes[2].imshow(pair.difference, cmap="RdBu_r", vmin=-top, vmax=top, interpolation="nearest")
    axes[2].set(title="fast minus path traced", xlabel="column [px]")
    axes[0].set_ylabel("row [px]")
    figure.colorbar(shown, ax=axes[2], label="difference [DN]")
    return figure_png(figure)


def _areas(demo: Demo) -> Section:
    rows = [frame.row() for frame in demo.frames]
    parts = list(rows[0]["split_percent"])
    table = Table(
        ["finger", "force [N]", "true area [mm²]", "measured [mm²]", "error [mm²]", "error [%]", "mask IoU",
         "edge moved by [µm]", *(f"{part} [%]" for part in parts)],
        [
            [
                row["finger"], f"{row['force_N']:g}", f"{row['true_area_mm2']:.3f}", f"{row['measured_area_mm2']:.3f}",
                f"{row['error_mm2']:+.3f}", f"{row['error_percent']:+.2f}", f"{row['iou']:.4f}",
                f"{row['boundary_displacement_um']:+.1f}", *(f"{row['split_percent'][part]:+.2f}" for part in parts),
            ]
            for row in rows
        ],
        "Each part is the measured area minus the area measured with that source switched off; 'interaction' is what"
        " the sources do only together, so that the parts add up to the error.",
    )  # fmt: skip
    return Section(
        "Areas and where their errors come from", pictures=[_area_figure(demo), _split_figure(demo)], tables=[table]
    )


def _area_figure(demo: Demo) -> Picture:
    figure = Figure(figsize=(7.5, 4.0), layout="constrained")
    axes = figure.subplots()
    for finger, marker in (("smooth", "o"), ("ridged", "s")):
        frames = [frame for frame in demo.frames if frame.finger == finger]
        forces = [frame.force_N for frame in frames]
        axes.plot(
            forces,
            [f.evaluation.comparison.true_area_mm2 for f in frames],
            marker + "-",
            c=TRUE_COLOUR,
            label=f"{finger}, true",
        )
        axes.plot(
            forces, [f.evaluation.comparison.area_mm2 for f in frames], marker + "--", c=MEASURED_COLOUR, mfc="none",
            label=f"{finger}, measured",
        )  # fmt: skip
    axes.set(xlabel="normal force [N]", ylabel="contact area [mm²]", ylim=(0, None))
    axes.legend(frameon=False)
    axes.grid(alpha=0.3)
    errors = [frame.evaluation.comparison.error_percent for frame in demo.frames]
    return Picture(
        figure_png(figure),
        f"Measured against true area; the error runs from {min(errors):+.2f} to {max(errors):+.2f} % of the true area.",
    )


def _split_figure(demo: Demo) -> Picture:
    figure = Figure(figsize=(9.0, 3.8), layout="constrained")
    axes = figure.subplots()
    names = [f"{frame.finger}\n{frame.force_N:g} N" for frame in demo.frames]
    rows = [frame.row()["split_percent"] for frame in demo.frames]
    parts = list(rows[0])
    width = 0.8 / len(parts)
    for k, part in enumerate(parts):
        axes.bar(
            np.arange(len(names)) + (k - (len(parts) - 1) / 2) * width, [row[part] for row in rows], width, label=part
        )
    axes.axhline(0, c="k", lw=0.8)
    axes.set(xticks=range(len(names)), xticklabels=names, ylabel="share of the area error [% of true area]")
    axes.legend(frameon=False, ncols=len(parts), fontsize=8, loc="lower center", bbox_to_anchor=(0.5, 1.0))
    return Picture(figure_png(figure), "Which source makes the error, each switched off in turn.")


def _frames(demo: Demo) -> Section:
    pictures = [
        Picture(
            _crop_figure(frame),
            f"{frame.finger} finger, {frame.force_N:g} N: the undistorted frame with true (blue) and measured (orange)"
            " outline; right, the profile across the middle row with the threshold.",
        )
        for frame in demo.frames
    ]
    return Section("Frames", pictures=pictures)


def _crop_figure(frame: DemoFrame) -> bytes:
    rows, cols = _window(frame)
    view = frame.evaluation.measured.view
    grey = view if view.ndim == 2 else view[..., 1]
    crop = grey[rows, cols]
    figure = Figure(figsize=(10.5, 4.6), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(1.0, 1.1))
    left.imshow(crop, cmap="gray", vmin=0, vmax=255, interpolation="nearest")
    left.contour(frame.evaluation.labels.mask[rows, cols], [0.5], colors=TRUE_COLOUR, linewidths=0.9)
    left.contour(frame.evaluation.measured.estimate.mask[rows, cols], [0.5], colors=MEASURED_COLOUR, linewidths=0.9)
    left.set(xlabel="column [px]", ylabel="row [px]")
    middle = crop.shape[0] // 2
    right.plot(crop[middle], c="0.3", lw=0.9, label="frame")
    right.plot(
        255 * frame.evaluation.labels.mask[rows, cols][middle], c=TRUE_COLOUR, lw=1.0, label="true contact (0 or 255)"
    )
    right.axhline(255 * 0.15, c=MEASURED_COLOUR, ls="--", lw=1.0, label="threshold 0.15")
    right.set(xlabel="column [px]", ylabel="grey level [DN]", ylim=(0, 260))
    right.legend(frameon=False, fontsize=8)
    return figure_png(figure)


def _window(frame: DemoFrame) -> tuple[slice, slice]:
    both = (frame.evaluation.labels.mask > 0) | frame.evaluation.measured.estimate.mask
    if not both.any():
        return slice(None), slice(None)
    hit_rows, hit_cols = np.flatnonzero(both.any(axis=1)), np.flatnonzero(both.any(axis=0))
    return (
        slice(max(hit_rows[0] - MARGIN_PX, 0), hit_rows[-1] + MARGIN_PX),
        slice(max(hit_cols[0] - MARGIN_PX, 0), hit_cols[-1] + MARGIN_PX),
    )


def _calibration(demo: Demo) -> Section:
    rig = demo.rig
    shots = [_rgb(rig.pictures["checkerboard"]), _rgb(rig.pictures["square"])]
    side_by_side = image_png(
        np.hstack([cv2.resize(s, None, fx=0.3, fy=0.3, interpolation=cv2.INTER_AREA) for s in shots])
    )
    k1, k2 = rig.calibration.distortion[:2]
    text = (
        f"Undistorted corners lie on an even grid to {rig.result.grid_rms_px:.2f} px RMS (corners left out of the fit);"
        f" k1 = {k1:+.4f}, k2 = {k2:+.4f}; the 15 mm square gives {1 / rig.square.mm2_per_px:.1f} px/mm²"
        f" ({rig.square.mm2_per_px:.7f} mm²/px; the thesis: 3407 px/mm²)."
    )
    warnings = [f"Warning ({w.code}): {w.text}" for w in rig.result.warnings]
    return Section(
        "Calibration on rendered cards",
        paragraphs=[text, *warnings],
        pictures=[
            Picture(side_by_side, "Checkerboard of 1 mm and square of 15 mm as the camera sees them through the glass.")
        ],
    )


def _rgb(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    return np.repeat(image[..., None], 3, axis=2) if image.ndim == 2 else image
