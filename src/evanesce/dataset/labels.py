"""Per-pixel ground truth of a frame: in the distorted frame, and on the undistorted plate plane."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from evanesce.core.states import ContactState, PlateGrid
from evanesce.dataset.config import CHANNELS
from evanesce.dataset.trial import FrameTruth
from evanesce.optics.projection import Projection
from evanesce.rig import Scene

Image = NDArray[np.float32]

_MEANS = ("contact_mask", "pressure", "gap", "traction.x", "traction.y", "strength")
_POINTS = ("slip.x", "slip.y", "slip_velocity.x", "slip_velocity.y")


@dataclass(frozen=True)
class LabelBox:
    """Labels within a box; outside it there is no contact.

    Attributes
    ----------
    row, col : int
        Of the box's first sample.
    shape : tuple of int
        (rows, cols) of the whole frame or grid.
    channels : dict of ndarray (rows, cols)
        Some of :data:`~evanesce.dataset.config.CHANNELS`; of size 0 without any contact.
    """

    row: int
    col: int
    shape: tuple[int, int]
    channels: dict[str, Image]

    def whole(self, name: str) -> Image:
        """Return a channel over the whole frame: 0 beyond the box, for the gap NaN."""
        found = np.full(self.shape, np.nan if name == "gap" else 0.0, np.float32)
        box = self.channels[name]
        found[self.row : self.row + box.shape[0], self.col : self.col + box.shape[1]] = box
        return found


def empty_box(shape: tuple[int, int], names: Sequence[str] = tuple(CHANNELS)) -> LabelBox:
    """Return the labels of a frame without contact."""
    return LabelBox(0, 0, shape, {name: np.zeros((0, 0), np.float32) for name in names})


def offset(part: PlateGrid, grid: PlateGrid) -> tuple[float, float]:
    """Return row and column, on a grid, of the first sample of another one of the same pitch.

    Raises
    ------
    ValueError
        If the pitch is another one.
    """
    if abs(part.pitch / grid.pitch - 1.0) > 1e-12:
        raise ValueError("the state is on a grid of another pitch")
    return (part.y[0] - grid.y[0]) / grid.pitch, (part.x[0] - grid.x[0]) / grid.pitch


def plate_labels(
    truth: FrameTruth, grid: PlateGrid, margin_mm: float, names: Sequence[str] = tuple(CHANNELS)
) -> LabelBox:
    """Return the labels on the plate's grid, of which the state is a part: the contact and a margin around it."""
    state = truth.state
    box = None if state is None else _contact_box(state, margin_mm)
    if state is None or box is None:
        return empty_box(grid.shape, names)
    fields = _fields(state)
    channels = {name: np.ascontiguousarray(fields[name][box], np.float32) for name in names}
    down, right = (round(n) for n in offset(state.grid, grid))
    return LabelBox(box[0].start + down, box[1].start + right, grid.shape, channels)


def _contact_box(state: ContactState, margin_mm: float) -> tuple[slice, slice] | None:
    in_contact = np.asarray(state.contact_mask) > 0
    rows, cols = np.flatnonzero(in_contact.any(axis=1)), np.flatnonzero(in_contact.any(axis=0))
    if rows.size == 0:
        return None
    margin = math.ceil(margin_mm / state.grid.pitch)
    (high, wide) = state.grid.shape
    return (
        slice(max(int(rows[0]) - margin, 0), min(int(rows[-1]) + 1 + margin, high)),
        slice(max(int(cols[0]) - margin, 0), min(int(cols[-1]) + 1 + margin, wide)),
    )


def _fields(state: ContactState) -> dict[str, NDArray[np.floating]]:
    nothing = np.zeros((2, *state.grid.shape))
    traction = nothing if state.traction is None else state.traction
    slip = nothing if state.slip is None else state.slip
    velocity = nothing if state.slip_velocity is None else state.slip_velocity
    surface = np.zeros(state.grid.shape, np.uint8) if state.state is None else state.state
    return {
        "contact_mask": np.asarray(state.contact_mask),
        "state": np.asarray(surface, np.float32),
        "pressure": np.asarray(state.pressure),
        "gap": np.asarray(state.gap),
        "traction.x": traction[0],
        "traction.y": traction[1],
        "strength": nothing[0] if state.strength is None else np.asarray(state.strength),
        "slip.x": slip[0],
        "slip.y": slip[1],
        "slip_velocity.x": velocity[0],
        "slip_velocity.y": velocity[1],
    }


class FrameLabeller:
    """Map contact states of one grid to the pixels of one camera.

    Parameters
    ----------
    scene : Scene
    grid : PlateGrid

    Notes
    -----
    Mask, pressure, gap, traction and strength are means over each pixel, by the same sampling as
    :func:`evanesce.evaluation.labels.label`; slip and its velocity are interpolated at the pixel's centre, the state
    is that of the nearest sample there.
    """

    def __init__(self, scene: Scene, grid: PlateGrid) -> None:
        projection = Projection.of(scene.camera, scene.plate)
        self.shape, self.grid = projection.shape, grid
        x_min, x_max, y_min, y_max = grid.extent
        side = np.linspace(0.0, 1.0, 65)
        x, y = x_min + (x_max - x_min) * side, y_min + (y_max - y_min) * side
        u, v = projection.to_image(
            np.concatenate([x, x, np.full(65, x_min), np.full(65, x_max)]),
            np.concatenate([np.full(65, y_min), np.full(65, y_max), y, y]),
        )
        rows, cols = self.shape
        self.row, self.col = max(0, math.floor(v.min()) - 1), max(0, math.floor(u.min()) - 1)
        end_row, end_col = min(rows, math.ceil(v.max()) + 2), min(cols, math.ceil(u.max()) + 2)
        self.high, self.wide = max(0, end_row - self.row), max(0, end_col - self.col)
        u, v = np.meshgrid(self.col + np.arange(self.wide + 1) - 0.5, self.row + np.arange(self.high + 1) - 0.5)
        if self.high and self.wide:
            at_row, at_col = grid.index(*projection.to_plate(u, v))
        else:  # the contact grid is outside the frame
            at_row, at_col = v * 0.0, u * 0.0
        self._row, self._col = at_row.astype(np.float32), at_col.astype(np.float32)
        self._centre = _within(self._row, 0.5, 0.5), _within(self._col, 0.5, 0.5)
        pixel = float(np.abs(np.diff(self._col, axis=1)).max()) if self.high and self.wide else 1.0
        self.supersample = int(np.clip(math.ceil(2.0 * pixel), 2, 8))

    def labels(self, truth: FrameTruth, margin_mm: float, names: Sequence[str] = tuple(CHANNELS)) -> LabelBox:
        """Return the labels in the distorted frame."""
        state = truth.state
        box = None if state is None else _contact_box(state, margin_mm)
        if state is None or box is None or not (self.high and self.wide):
            return empty_box(self.shape, names)
        shift = self._shift(state)
        part = self._pixels(box, shift)
        if part is None:
            return empty_box(self.shape, names)
        rows, cols = part
        fields = _fields(state)
        channels = self._means(fields, rows, cols, shift, [name for name in _MEANS if name in names])
        centre = self._centre[1][part] - shift[1], self._centre[0][part] - shift[0]
        if points := [name for name in _POINTS if name in names]:
            stacked = np.dstack([fields[name] for name in points]).astype(np.float32)
            sampled = cv2.remap(stacked, *centre, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=0)
            channels |= dict(zip(points, np.atleast_3d(sampled).transpose(2, 0, 1), strict=True))
        if "state" in names:
            channels["state"] = cv2.remap(
                fields["state"], *centre, cv2.INTER_NEAREST, borderMode=cv2.BORDER_CONSTANT, borderValue=0
            )
        ordered = {name: np.ascontiguousarray(channels[name], np.float32) for name in names}
        return LabelBox(self.row + rows.start, self.col + cols.start, self.shape, ordered)

    def _shift(self, state: ContactState) -> tuple[np.float32, np.float32]:
        """Return the offset (rows, cols) in samples of a state's grid from that of the maps."""
        down, across = offset(state.grid, self.grid)
        return np.float32(down), np.float32(across)

    def _pixels(self, box: tuple[slice, slice], shift: tuple[np.float32, np.float32]) -> tuple[slice, slice] | None:
        """Return the part of the window whose pixel centres lie in a box of the state's grid."""
        row, col = self._centre
        (top, bottom), (left, right) = (
            (part.start - 0.5 + off, part.stop - 0.5 + off) for part, off in zip(box, shift, strict=True)
        )
        inside = cv2.inRange(row, float(top), float(bottom))
        inside &= cv2.inRange(col, float(left), float(right))
        x, y, wide, high = cv2.boundingRect(inside)
        return (slice(y, y + high), slice(x, x + wide)) if wide else None

    def _means(
        self,
        fields: dict[str, NDArray[np.floating]],
        rows: slice,
        cols: slice,
        shift: tuple[np.float32, np.float32],
        names: list[str],
    ) -> dict[str, Image]:
        if not names:
            return {}
        corners = np.s_[rows.start : rows.stop + 1, cols.start : cols.stop + 1]
        at_row, at_col = self._row[corners] - shift[0], self._col[corners] - shift[1]
        # OpenCV remaps at most four channels at once.
        parts = [names[k : k + 4] for k in range(0, len(names), 4)]
        layers = [np.dstack([fields[name] for name in part]).astype(np.float32) for part in parts]
        shape = rows.stop - rows.start, cols.stop - cols.start
        sums = [np.zeros((*shape, layer.shape[2]), np.float32) for layer in layers]
        fractions = (np.arange(self.supersample) + 0.5) / self.supersample
        for down in fractions:
            for right in fractions:
                y, x = _within(at_row, down, right), _within(at_col, down, right)
                for total, layer in zip(sums, layers, strict=True):
                    found = cv2.remap(layer, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
                    total += found.reshape(total.shape)
        means = np.dstack(sums) * np.float32(1.0 / self.supersample**2)
        result = {name: means[..., i] for i, name in enumerate(names)}
        if "contact_mask" in result:
            result["contact_mask"] = np.clip(result["contact_mask"], 0.0, 1.0)
        return result


def _within(corners: Image, down: float, right: float) -> Image:
    """Interpolate between the four corners of each pixel."""
    top = (1 - right) * corners[:-1, :-1] + right * corners[:-1, 1:]
    bottom = (1 - right) * corners[1:, :-1] + right * corners[1:, 1:]
    return np.asarray((1 - down) * top + down * bottom, np.float32)
