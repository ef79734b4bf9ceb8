"""``evanesce criticise --shapes``: what every cause may look like in the frames of this bundle."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from evanesce.inference.data import DataVector
from evanesce.inference.shapes import Forms

Array = NDArray[Any]

ACROSS = 4
"""Causes in a row, each with two panels."""


def mean_and_variation(forms: Forms, data: DataVector) -> tuple[int, Array, Array]:
    """Return the open view that shows a cause most, and mean and standard deviation of its forms there (rows, cols).

    Forms are whitened, scaled to a norm of 1 over all open views, and turned to one sign.

    Parameters
    ----------
    forms : Forms
    data : DataVector
    """
    rows = forms.rows(data).astype(float)
    norms = np.linalg.norm(rows, axis=1, keepdims=True)
    rows = rows / np.where(norms > 0, norms, 1.0)
    first = np.linalg.svd(rows @ rows.T)[0][:, 0]
    rows = rows * np.where(first < 0, -1.0, 1.0)[:, None]
    mean = data.unwhitened(rows.mean(axis=0))
    deviation = data.unwhitened(rows.std(axis=0))
    view = int(np.argmax((mean**2).sum(axis=(1, 2))))
    return view, mean[view], deviation[view]


def shape_figure(every: Sequence[Forms], data: DataVector) -> Figure:
    """Return a picture of all causes: mean form, and how much forms vary about it.

    Parameters
    ----------
    every : sequence of Forms
    data : DataVector
    """
    down = -(-len(every) // ACROSS)
    rows, cols = data.cube.shape[1:]
    figure = Figure(figsize=(ACROSS * 3.3, down * (1.55 * rows / cols + 0.45)), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(down, 2 * ACROSS, squeeze=False)
    for panel in axes.ravel():
        panel.set_axis_off()
    for number, forms in enumerate(every):
        row, col = divmod(number, ACROSS)
        view, mean, deviation = mean_and_variation(forms, data)
        size = float(max(np.abs(mean).max(), deviation.max(), 1e-12))
        left, right = axes[row, 2 * col : 2 * col + 2]
        left.imshow(mean, cmap="RdBu_r", vmin=-size, vmax=size, interpolation="nearest")
        right.imshow(deviation, cmap="viridis", vmin=0, vmax=size, interpolation="nearest")
        shown = data.views[data.open[view]]
        where = f"{shown.force_N:g} N, {shown.voltage_V:g} V" if shown.force_N else shown.kind.replace("_", " ")
        left.set_title(forms.id, fontsize=8)
        right.set_title(f"{len(forms.changes)} forms; {where}", fontsize=7)
    figure.suptitle("Whitened change of the frames by each cause: mean of its forms, and their standard deviation")
    return figure
