"""What of a view is rendered how finely: the window around a contact, and the coarser rest."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from evanesce.core.states import ContactState
from evanesce.optics.projection import IdealView, Projection
from evanesce.render.reference.passes import pass_samples
from evanesce.render.reference.scene import Window

Array = NDArray[np.float64]
# Around the contact's bounding box; wider than lens blur and dilation by the pipeline.
FOCUS_MARGIN_MM = 1.0
# Fraction of the samples outside that window, where there is little light.
BACKGROUND_SHARE = 0.125
MAX_BACKGROUND_FACTOR = 8


def scaled_view(view: IdealView, factor: float) -> IdealView:
    """Return a view of the same field with ``factor`` times as many pixels a side, for previews.

    Parameters
    ----------
    view : IdealView
    factor : float
        [1].

    Raises
    ------
    ValueError
        If the factor is not above 0.
    """
    if not factor > 0:
        raise ValueError(f"factor {factor} is not above 0")
    rows, cols = (max(1, round(n * factor)) for n in view.shape)
    # Outer borders of the pixels map onto each other: (p + 1/2) scales.
    px, py = ((p + 0.5) * factor - 0.5 for p in view.principal_point)
    return IdealView((rows, cols), view.focal_px * factor, (px, py))


def focus_window(projection: Projection, view: IdealView, state: ContactState, margin: float) -> Window | None:
    """Return the view's pixels around the contact (bounding box plus margin); None where none is in view.

    Parameters
    ----------
    projection : Projection
    view : IdealView
    state : ContactState
    margin : float
        [mm].
    """
    rows, cols = np.nonzero(np.asarray(state.contact_mask) > 0)
    if rows.size == 0:
        return None
    x, y = state.grid.x[cols], state.grid.y[rows]
    box_x, box_y = (x.min() - margin, x.max() + margin), (y.min() - margin, y.max() + margin)
    side = np.linspace(0.0, 1.0, 33)
    border_x = np.concatenate([np.interp(side, [0, 1], box_x)] * 2 + [np.full(33, v) for v in box_x])
    border_y = np.concatenate([np.full(33, v) for v in box_y] + [np.interp(side, [0, 1], box_y)] * 2)
    u, v = projection.plate_to_ray(border_x, border_y)
    u, v = u * view.focal_px + view.principal_point[0], v * view.focal_px + view.principal_point[1]
    row0, row1 = max(0, int(np.floor(v.min()))), min(view.shape[0], int(np.ceil(v.max())) + 1)
    col0, col1 = max(0, int(np.floor(u.min()))), min(view.shape[1], int(np.ceil(u.max())) + 1)
    return Window(row0, row1, col0, col1) if row1 > row0 and col1 > col0 else None


def background_factor(px_per_mm: float) -> int:
    """Return how many pixels a side share one sample region beside the contact: at least three such to the margin."""
    return int(np.clip(FOCUS_MARGIN_MM * px_per_mm / 3, 1, MAX_BACKGROUND_FACTOR))


def enlarged(image: Array, shape: tuple[int, int]) -> Array:
    """Return an image of the same field on more pixels, bilinear; the same array where the shape is the same.

    Parameters
    ----------
    image : ndarray (rows, cols)
    shape : tuple of int
        (rows, cols).
    """
    if image.shape == shape:
        return image
    return np.asarray(cv2.resize(image, (shape[1], shape[0]), interpolation=cv2.INTER_LINEAR))


@dataclass(frozen=True)
class SamplingRun:
    """One view (or a window of it) with its samples per pixel and pass."""

    name: str
    view: IdealView
    window: Window | None
    samples: int


def sampling_runs(view: IdealView, window: Window | None, samples: int, px_per_mm: float) -> list[SamplingRun]:
    """Return what to render: all of the view alike, or its window finely over a coarse whole.

    Parameters
    ----------
    view : IdealView
    window : Window or None
    samples : int
        Per pixel and pass in the window.
    px_per_mm : float
        Of the view on the contact plane [px/mm].
    """
    if window is None:
        return [SamplingRun("whole", view, None, samples)]
    coarse = background_factor(px_per_mm)
    background = pass_samples(round(samples * BACKGROUND_SHARE * coarse**2), 1)
    return [
        SamplingRun("whole", scaled_view(view, 1 / coarse), None, background),
        SamplingRun("focus", view, window, samples),
    ]
