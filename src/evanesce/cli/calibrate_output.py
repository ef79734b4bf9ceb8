"""What `evanesce calibrate` shows: a table of the fit, one of the views, warnings, and a page with pictures."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

from evanesce.cli.common import console, messages

if TYPE_CHECKING:
    from evanesce.api.calibrate import CalibrationFit
    from evanesce.measurement.calibration.model import Calibration

VIEW_COLUMNS = ("view", "corners", "lines", "left out", "RMS px")


def draw(folder: Path, fit: CalibrationFit) -> None:
    """Write the pictures of the worst view and of the scale, and the page that shows them.

    Parameters
    ----------
    folder : Path
    fit : CalibrationFit
    """
    from evanesce.measurement.calibration import plots
    from evanesce.measurement.plots import save_figure
    from evanesce.report.html import Page, Picture, Section, Table, write

    boards, pictures = fit.boards, fit.pictures
    picture = None if pictures is None else pictures.frames[boards.numbers[boards.worst]]
    figures = {
        "residuals": (
            plots.residual_figure(boards, picture),
            "The view with the greatest RMS: arrows are corners found minus predicted without them.",
        ),
        "corners": (plots.corners_figure(boards, picture), "Corners of that view, coloured as on a checkerboard."),
        "scale": (
            plots.scale_figure(boards.scale, boards, "local scale of the picture"),
            f"Local scale of view {boards.distinct[boards.flat].name}, that on the glass or the flattest.",
        ),
        "scale_undistorted": (
            plots.scale_figure(boards.scale_undistorted, boards, "local scale after undistortion"),
            "The same after undistortion.",
        ),
    }
    shown = []
    for name, (figure, caption) in figures.items():
        path = folder / f"{name}.png"
        save_figure(figure, path)
        shown.append(Picture(path.read_bytes(), caption, alt=caption))
    details = fit.calibration.details
    page = Page("Calibration", "The camera by the corners of a checkerboard: what was found, and how well it fits.")
    page.sections = [
        Section(
            "Result",
            [f"{warning['code']}: {warning['text']}" for warning in details["warnings"]],
            tables=[Table(("quantity", "value"), figures_of(fit.calibration))],
        ),
        Section("Views", tables=[Table(VIEW_COLUMNS, view_rows(details))]),
        Section("Pictures", pictures=shown),
    ]
    write(folder / "calibration.html", page)


def show(calibration: Calibration, saved_to: Path | None) -> None:
    """Print the tables and the warnings.

    Parameters
    ----------
    calibration : Calibration
    saved_to : Path or None
    """
    from rich.table import Table
    from rich.text import Text

    details = calibration.details
    table = Table(title="Calibration", show_header=False)
    for row in figures_of(calibration):
        table.add_row(*map(Text, row))
    console.print(table)
    views = Table(*VIEW_COLUMNS, title="Views")
    for cells in view_rows(details):
        views.add_row(*map(Text, cells))
    console.print(views)
    for warning in details["warnings"]:
        messages.print(f"warning: {warning['code']}: {warning['text']}", highlight=False, markup=False, soft_wrap=True)
    if saved_to is None:
        messages.print("not saved: give --json FILE or --out DIR to save the calibration", soft_wrap=True)


def figures_of(calibration: Calibration) -> list[tuple[str, str]]:
    """Return name and value of each figure of a calibration.

    Parameters
    ----------
    calibration : Calibration

    Returns
    -------
    list of tuple of str
    """
    details, matrix, k = calibration.details, calibration.camera_matrix, calibration.distortion
    errors = details["standard_errors"]

    def value(number: float, name: str, digits: int) -> str:
        error = errors.get(name)
        assumed = " (assumed)" if name in ("fx", "fy") and error is None else ""
        return f"{number:.{digits}f}" + (assumed if error is None else f" ± {error:.{digits}f}")

    flat = details["flat_view"]
    rows = [
        ("views, of which distinct", f"{len(details['views'])}, {len(details['distinct_views'])}"),
        ("corners", f"{len(details['corners'])}"),
        ("fx, fy [px]", f"{value(matrix[0, 0], 'fx', 2)}, {value(matrix[1, 1], 'fy', 2)}"),
        ("cx, cy [px]", f"{value(matrix[0, 2], 'cx', 2)}, {value(matrix[1, 2], 'cy', 2)}"),
        *((n, value(k[i], n, 4)) for i, n in enumerate(("k1", "k2", "p1", "p2", "k3")) if n in errors),
        ("grid RMS on corners left out [px]", f"{details['grid_rms_px']:.3f}"),
        ("the same after undistortion [px]", f"{details['grid_rms_undistorted_px']:.3f}"),
        (f"local scale of view {flat}, median (min to max) [px/mm²]", _range(details["scale_px_per_mm2"])),
        ("the same after undistortion [px/mm²]", _range(details["scale_undistorted_px_per_mm2"])),
    ]
    if calibration.mm2_per_px is not None:
        rows.append(("area of a pixel [mm²]", f"{calibration.mm2_per_px:.7f}"))
        rows.append(("scale by the card [px/mm²]", f"{1 / calibration.mm2_per_px:.1f}"))
    return rows


def view_rows(details: Any) -> list[tuple[str, ...]]:
    """Return the table's row of each view: name, corners, lines, corners left out, RMS.

    Parameters
    ----------
    details : mapping
        Of the calibration.

    Returns
    -------
    list of tuple of str
    """
    return [
        (
            view["name"],
            str(view["corners"]),
            f"{view['lines'][0]} x {view['lines'][1]}",
            "repeated" if view["repeated"] else str(view["left_out"]),
            "" if view["repeated"] else f"{view['rms_px']:.3f}",
        )
        for view in details["views"]
    ]


def _range(scale: dict[str, float]) -> str:
    if math.isnan(scale["median"]):
        return "no complete cell"
    return f"{scale['median']:.1f} ({scale['min']:.1f} to {scale['max']:.1f})"
