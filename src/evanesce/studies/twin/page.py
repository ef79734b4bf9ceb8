"""The page of ``evanesce twin``: photograph and twin side by side, their difference, and what is in it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from evanesce.report.html import Page, Picture, Section, Table, figure_png, image_png
from evanesce.studies.twin.residuals import DOT_600_DPI_UM, TwinResiduals, edge_width, radius, spacings
from evanesce.studies.twin.study import Twin

DIFFERENCE_DN = 50.0


def page(twin: Twin, residuals: TwinResiduals, name: str, provenance: Mapping[str, Any]) -> Page:
    """Return the report of one photograph and its twin.

    Parameters
    ----------
    twin : Twin
    residuals : TwinResiduals
    name : str
        Of the photograph.
    provenance : mapping

    Returns
    -------
    Page
    """
    lead = (
        f"The simulated rig, lens, board and light were fitted to one half of {name} and evaluated on the other: "
        f"corners agree within {residuals.corner_rms_px:.2f} px RMS, grey values within "
        f"{residuals.grey_rms:.1f} DN RMS (median {residuals.grey_median_abs:.1f} DN), in a picture whose grey values "
        f"scatter by {residuals.photo_deviation:.0f} DN."
    )
    sections = [_side_by_side(twin), _difference(twin, residuals), _geometry(twin, residuals), _blur(twin, residuals)]
    return Page(f"Twin of {name}", lead, [*sections, _fitted(twin)], provenance)


def difference_png(twin: Twin) -> bytes:
    """Return photograph minus twin in colour: red where the photograph is brighter, blue where it is darker.

    Parameters
    ----------
    twin : Twin

    Returns
    -------
    bytes
    """
    return _picture(twin.photo - twin.mean, "RdBu_r", -DIFFERENCE_DN, DIFFERENCE_DN, "photograph − twin [DN]")


def _figure(width: float = 8.0, height: float = 4.0) -> tuple[Figure, Any]:
    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure, figure.add_subplot()


def _picture(image: NDArray[Any], cmap: str, low: float, high: float, label: str) -> bytes:
    rows, cols = image.shape
    figure, axes = _figure(10.0, 8.2 * rows / cols + 0.4)
    shown = axes.imshow(image, cmap=cmap, vmin=low, vmax=high, interpolation="nearest")
    axes.set_xlabel("x [px]")
    axes.set_ylabel("y [px]")
    figure.colorbar(shown, ax=axes, label=label, shrink=0.85)
    return figure_png(figure)


def _side_by_side(twin: Twin) -> Section:
    photo = np.clip(np.rint(twin.photo), 0, 255).astype(np.uint8)
    gap = np.full((photo.shape[0], 12), 255, dtype=np.uint8)
    both = np.hstack([photo, gap, twin.simulated])
    rows, cols = photo.shape
    # the middle, and the corner of the frame where the lens blurs most: four times enlarged
    crops = []
    for r, c in ((rows // 2, cols // 2), (rows // 8, cols // 9)):
        cut = np.s_[max(r - 48, 0) : r + 48, max(c - 64, 0) : c + 64]
        crops.append(np.hstack([photo[cut], gap[: photo[cut].shape[0]], twin.simulated[cut]]).repeat(4, 0).repeat(4, 1))
    return Section(
        "Side by side",
        pictures=[
            Picture(image_png(both), "Photograph (left, grey) and simulated twin with sensor noise (right)."),
            Picture(image_png(crops[0]), "The middle of the frame, four times enlarged: photograph left, twin right."),
            Picture(image_png(crops[1]), "Near the upper left corner, where the lens blurs most."),
        ],
    )


def _difference(twin: Twin, residuals: TwinResiduals) -> Section:
    difference = (twin.photo - twin.mean)[twin.held_out]
    figure, axes = _figure()
    bins = np.arange(-80, 121, 1.0)
    axes.hist(np.clip(difference, bins[0], bins[-1]), bins=bins, log=True, color="0.45", label="held-out blocks")
    spread = 1.4826 * residuals.grey_median_abs
    bell = difference.size * np.exp(-0.5 * (bins / spread) ** 2) / (spread * np.sqrt(2 * np.pi))
    axes.plot(bins[bell > 0.5], bell[bell > 0.5], color="tab:red", label=f"normal law of {spread:.1f} DN")
    axes.set_xlabel("photograph − twin [DN]; beyond the axis counted at its ends")
    axes.set_ylabel("pixels per DN")
    axes.legend()
    rows = [
        (c.name, f"{100 * c.pixels:.1f}", f"{100 * c.energy:.1f}", f"{c.rms:.1f}")
        for c in residuals.causes
        if c.pixels > 0
    ]
    return Section(
        "Difference",
        paragraphs=[
            "Three things the twin does not have: dust and scratches on the glass scatter guided light and show as "
            "specks; the edge LEDs are mirrored in the paper as bright patches; the paper's fibres and the toner's "
            "density mottle the squares. The table sorts the held-out pixels by the first of its rows that applies.",
        ],
        pictures=[
            Picture(difference_png(twin), "Red: the photograph is brighter than its twin; blue: darker."),
            Picture(figure_png(figure), "Differences on the held-out blocks; the tail to the right is specks."),
        ],
        tables=[
            Table(
                ("kind of pixel", "share of pixels [%]", "share of squared difference [%]", "RMS [DN]"),
                rows,
                f"All held-out pixels: {residuals.grey_rms:.2f} DN RMS; fitted: {residuals.grey_rms_fitted:.2f} DN.",
            )
        ],
    )


def _geometry(twin: Twin, residuals: TwinResiduals) -> Section:
    widths = spacings(twin)
    figure, axes = _figure()
    axes.hist(widths, bins=np.arange(-60, 61, 4.0), color="0.45", label=f"{widths.size} columns and rows of squares")
    for dots in (23, 24):
        at = dots * DOT_600_DPI_UM - 1000.0
        axes.axvline(at, color="tab:red", linestyle="--")
        axes.text(at, axes.get_ylim()[1] * 0.94, f" {dots} dots", color="tab:red")
    axes.set_xlabel("width of a square minus 1 mm [µm]")
    axes.set_ylabel("columns and rows")
    axes.legend(loc="upper center")
    miss = twin.corner_miss
    arrows, quiver_axes = _figure(9.0, 7.0)
    some = twin.corners_held_out
    quiver_axes.quiver(
        *twin.grid.fit.position[some].T, *(25 * miss[some]).T, angles="xy", scale_units="xy", scale=1, width=0.0016
    )
    quiver_axes.set_aspect("equal")
    quiver_axes.invert_yaxis()
    quiver_axes.set_xlabel("x [px]")
    quiver_axes.set_ylabel("y [px]")
    text = (
        f"Narrow squares are {residuals.spacing_narrow_um:+.1f} µm, wide ones {residuals.spacing_wide_um:+.1f} µm "
        "off 1 mm. A printer of 600 dots per inch makes them 23 or 24 dots wide, "
        f"{23 * DOT_600_DPI_UM - 1000:+.1f} or {24 * DOT_600_DPI_UM - 1000:+.1f} µm: where the two agree, the print "
        "is the larger part of what a smooth lens model leaves, and the twin has the same uneven lines."
    )
    return Section(
        "Geometry",
        paragraphs=[text],
        pictures=[
            Picture(figure_png(figure), "Fitted widths of the squares; dashed, whole dots of a 600-dpi printer."),
            Picture(figure_png(arrows), "Held-out corners: found minus predicted, 25 times enlarged."),
        ],
    )


def _blur(twin: Twin, residuals: TwinResiduals) -> Section:
    figure, axes = _figure()
    some = twin.corners_held_out
    r = radius(twin.grid.fit.position, twin.photo.shape)[some]
    for fit, label, colour in ((twin.grid.fit, "photograph", "tab:red"), (twin.own, "twin", "tab:blue")):
        axes.plot(r, edge_width(fit.sigma[some]), ".", markersize=3, color=colour, label=label, alpha=0.6)
    axes.set_xlabel("distance from the middle of the frame [px]")
    axes.set_ylabel("edge width, 10 to 90 % [px]")
    axes.set_ylim(bottom=0)
    axes.legend()
    rows = [
        (
            f"{z.inner_px:.0f} to {z.outer_px:.0f}",
            f"{z.corners}",
            f"{z.corner_rms_px:.3f}",
            f"{z.edge_photo_px:.2f}",
            f"{z.edge_twin_px:.2f}",
            f"{z.bright_photo:.0f} / {z.bright_twin:.0f}",
            f"{z.dark_photo:.0f} / {z.dark_twin:.0f}",
            f"{z.grey_rms:.1f}",
        )
        for z in residuals.zones
    ]
    columns = (
        "distance from the middle [px]",
        "held-out corners",
        "corner RMS [px]",
        "edge width, photograph [px]",
        "edge width, twin [px]",
        "bright, photograph / twin [DN]",
        "dark, photograph / twin [DN]",
        "grey RMS [DN]",
    )
    return Section(
        "Blur and light by zone",
        pictures=[Picture(figure_png(figure), "Edge widths at the held-out corners, by the same corner fit in both.")],
        tables=[Table(columns, rows)],
    )


def _fitted(twin: Twin) -> Section:
    camera, board = twin.rig.camera, twin.rig.board
    lens = camera.lens
    rows = [
        ("scale on the axis [px/mm]", f"{camera.scale_px_per_mm:.4f}"),
        ("optical axis on the plate, x, y [mm]", f"{camera.centre_mm[0]:.3f}, {camera.centre_mm[1]:.3f}"),
        (
            "optical axis from the frame's middle, x, y [px]",
            f"{camera.principal_point_offset_px[0]:.2f}, {camera.principal_point_offset_px[1]:.2f}",
        ),
        ("tilt about x, y; roll [deg]", f"{camera.tilt_x_deg:.3f}, {camera.tilt_y_deg:.3f}; {camera.roll_deg:.3f}"),
        ("k1, k2", f"{lens.distortion.k1:.4f}, {lens.distortion.k2:.4f}"),
        ("defocus on the axis, further at the corner [µm]", f"{lens.defocus_um:.1f}, {lens.field_curvature_um:.1f}"),
        ("ink beyond each edge [µm]", f"{1e3 * board.ink_mm:.1f}"),
        ("print's second axis over its first; lean", f"{board.stretch:.5f}; {board.shear:.5f}"),
        ("focal length (assumed) [mm]", f"{lens.focal_length_mm:g}"),
        (
            "glass (assumed): thickness [mm], index",
            f"{twin.scene.plate.thickness_mm:g}, {twin.scene.plate.refractive_index:g}",
        ),
        ("tone curve (assumed)", camera.tone_curve),
    ]
    return Section(
        "What was fitted, and what assumed",
        paragraphs=[
            "Fitted on alternate blocks of two by two squares: the camera's position and the lens's two radial terms, "
            "through the refracting glass; the printed lines; smooth light for bright and for dark squares; defocus on "
            "the axis, its growth to the corner and the reach of the ink. The picture then goes through the same lens, "
            "pixel, readout and tone curve as every simulated frame. Not in the twin: specks, reflections, mottled "
            "paper, an astigmatic lens, colour, the printer's seams. Ink and tone curve act alike on the edges and "
            "cannot be separated from one picture; a flat board does not determine the focal length.",
        ],
        tables=[Table(("quantity", "value"), rows)],
    )
