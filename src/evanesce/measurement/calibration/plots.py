"""Pictures of a calibration: corners on the picture, residuals as arrows, the map of the local scale."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from evanesce.measurement.calibration.fit import Calibrated, rms
from evanesce.measurement.calibration.local_scale import ScaleMap


def _frame_axes(result: Calibrated, title: str) -> tuple[Figure, Any]:
    """Return axes over the frame, y down, pixel centres at whole numbers."""
    cols, rows = result.calibration.image_size
    figure = Figure(figsize=(9.0, 7.8 * rows / cols + 0.6), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    axes.set_title(title, fontsize=10)
    axes.set_xlabel("x [px]")
    axes.set_ylabel("y [px]")
    axes.set_xlim(-0.5, cols - 0.5)
    axes.set_ylim(rows - 0.5, -0.5)
    axes.set_aspect("equal")
    return figure, axes


def _worst_axes(result: Calibrated, title: str, picture: NDArray[np.uint8] | None) -> tuple[Figure, Any]:
    """Return axes over the picture of the view with the greatest RMS."""
    view, count = result.distinct[result.worst], len(result.distinct)
    which = f"view {view.name}" if count == 1 else f"view {view.name}, the worst of {count}"
    figure, axes = _frame_axes(result, f"{title}; {which}")
    if picture is not None:
        axes.imshow(picture, cmap="gray" if picture.ndim == 2 else None, vmin=0, vmax=255)
        axes.set_xlim(-0.5, result.calibration.image_size[0] - 0.5)
        axes.set_ylim(result.calibration.image_size[1] - 0.5, -0.5)
    outliers = result.outliers[result.worst]
    if len(outliers):
        axes.plot(*outliers.T, "x", color="#d55e00", markersize=7, markeredgewidth=1.6, label="left out of the fit")
        axes.legend(loc="upper right", fontsize=8)
    return figure, axes


def corners_figure(result: Calibrated, picture: NDArray[np.uint8] | None = None) -> Figure:
    """Return the corners of the view with the greatest RMS, coloured by the parity of their index.

    Parameters
    ----------
    result : Calibrated
    picture : ndarray of uint8, optional
        Of that view.

    Returns
    -------
    Figure
    """
    view = result.distinct[result.worst]
    figure, axes = _worst_axes(result, f"{len(view)} corners", picture)
    ranks = [np.unique(view.world[:, k], return_inverse=True)[1] for k in (0, 1)]
    parity = (ranks[0] + ranks[1]) % 2
    for value, colour in ((0, "#00d5ff"), (1, "#ff3df2")):
        axes.plot(*view.image[parity == value].T, ".", color=colour, markersize=3.5)
    return figure


def residual_figure(result: Calibrated, picture: NDArray[np.uint8] | None = None) -> Figure:
    """Return the misses of left-out corners of the view with the greatest RMS as arrows, enlarged.

    Parameters
    ----------
    result : Calibrated
    picture : ndarray of uint8, optional
        Of that view.

    Returns
    -------
    Figure
    """
    view, miss = result.distinct[result.worst], result.held_out[result.worst]
    length = np.linalg.norm(miss, axis=1)
    # nine in ten arrows shorter than a fortieth of the frame, enlarged by 1, 2 or 5 times a power of ten
    wanted = result.calibration.image_size[0] / 40 / max(float(np.percentile(length, 90)), 1e-6)
    power = 10 ** np.floor(np.log10(wanted))
    times = float(power * max(step for step in (1, 2, 5) if step * power <= wanted))
    title = f"corner found minus predicted without it, {times:g} times; RMS {rms(miss):.3f} px"
    figure, axes = _worst_axes(result, title, picture)
    arrows = axes.quiver(
        *view.image.T, *(times * miss).T, length, angles="xy", scale_units="xy", scale=1, width=0.0022, cmap="plasma"
    )
    figure.colorbar(arrows, ax=axes, label="miss [px]", shrink=0.8)
    return figure


def scale_figure(scale: ScaleMap, result: Calibrated, title: str) -> Figure:
    """Return the local scale of each cell as coloured dots over the frame.

    Parameters
    ----------
    scale : ScaleMap
    result : Calibrated
    title : str

    Returns
    -------
    Figure
    """
    figure, axes = _frame_axes(result, title)
    shown = axes.scatter(*scale.centre.T, c=scale.px_per_mm2, s=26, marker="s", cmap="viridis")
    figure.colorbar(shown, ax=axes, label="local scale [px/mm²]", shrink=0.8)
    low, high = scale.centre.min(axis=0, initial=np.inf), scale.centre.max(axis=0, initial=-np.inf)
    if len(scale.centre):
        axes.set_xlim(low[0] - 20, high[0] + 20)
        axes.set_ylim(high[1] + 20, low[1] - 20)
    return figure
