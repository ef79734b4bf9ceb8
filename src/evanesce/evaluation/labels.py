"""True labels of a frame: the contact state mapped into the pixels of a frame or of a rectified view."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from evanesce.core.states import ContactState
from evanesce.optics.projection import Projection, distort

Array = NDArray[np.float64]


@dataclass(frozen=True)
class RectifiedView:
    """A measurement's view of a frame: undistorted by calibrated coefficients, then cropped.

    The coefficients are the measurement's own, right or wrong; the truth is mapped through the same ones.

    Attributes
    ----------
    camera_matrix : ndarray (3, 3)
        Calibrated, in OpenCV's form.
    distortion : array_like (up to 5,)
        Calibrated k1, k2, p1, p2, k3; missing ones are zero.
    camera_matrix_new : ndarray (3, 3)
        Camera matrix of the undistorted image.
    shape : tuple of int
        (rows, cols) of the view.
    origin : tuple of int
        (row, col) of the view's first pixel in the undistorted image: the crop.
    """

    camera_matrix: Array
    distortion: ArrayLike
    camera_matrix_new: Array
    shape: tuple[int, int]
    origin: tuple[int, int] = (0, 0)

    def to_frame(self, u: ArrayLike, v: ArrayLike) -> tuple[Array, Array]:
        """Return the frame's pixel position (u, v) that a position of this view shows.

        Parameters
        ----------
        u, v : array_like
            Column and row in this view [px].

        Returns
        -------
        u, v : ndarray
            In the frame [px].
        """
        inverse = np.linalg.inv(self.camera_matrix_new)
        u, v = np.asarray(u, float) + self.origin[1], np.asarray(v, float) + self.origin[0]
        k1, k2, p1, p2, k3 = (float(k) for k in np.resize(np.append(self.distortion, np.zeros(5)), 5))
        x, y = distort(
            inverse[0, 0] * u + inverse[0, 1] * v + inverse[0, 2],
            inverse[1, 1] * v + inverse[1, 2],
            (k1, k2, p1, p2, k3),
        )
        matrix = self.camera_matrix
        return matrix[0, 0] * x + matrix[0, 1] * y + matrix[0, 2], matrix[1, 1] * y + matrix[1, 2]

    def maps(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return the cv2.remap maps (x, y) from a frame into this view.

        Returns
        -------
        x, y : ndarray of float32 (rows, cols)
            [px].
        """
        u, v = np.meshgrid(np.arange(self.shape[1]), np.arange(self.shape[0]))
        x, y = self.to_frame(u, v)
        return x.astype(np.float32), y.astype(np.float32)


@dataclass(frozen=True)
class ViewGeometry:
    """Positions of a view's pixels on the plate; made once, used for every frame.

    Attributes
    ----------
    corner_x, corner_y : ndarray (rows + 1, cols + 1)
        Plate coordinates of the pixels' corners [mm].
    pixel_area : ndarray (rows, cols)
        Area of plate that each pixel sees [mm^2].
    """

    corner_x: Array
    corner_y: Array
    pixel_area: Array

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, cols) of the view."""
        rows, cols = self.pixel_area.shape
        return rows, cols


def view_geometry(projection: Projection, view: RectifiedView | None = None) -> ViewGeometry:
    """Map the pixel grid of the distorted frame, or of a rectified view, onto the plate.

    Parameters
    ----------
    projection : Projection
        True geometry of the camera.
    view : RectifiedView, optional
        None for the frame itself.

    Returns
    -------
    ViewGeometry
    """
    rows, cols = projection.shape if view is None else view.shape
    u, v = np.meshgrid(np.arange(cols + 1) - 0.5, np.arange(rows + 1) - 0.5)
    if view is not None:
        u, v = view.to_frame(u, v)
    x, y = projection.to_plate(u, v)
    # Half the cross product of the diagonals: the area of each quadrilateral. Neighbours share corners, so sums over
    # regions leave no gap and count nothing twice.
    forward = (x[1:, 1:] - x[:-1, :-1], y[1:, 1:] - y[:-1, :-1])
    backward = (x[1:, :-1] - x[:-1, 1:], y[1:, :-1] - y[:-1, 1:])
    return ViewGeometry(x, y, np.abs(forward[0] * backward[1] - forward[1] * backward[0]) / 2)


@dataclass(frozen=True, kw_only=True)
class FrameLabels:
    """Truth of one frame, pixel by pixel.

    Attributes
    ----------
    mask : ndarray of float32 (rows, cols)
        Share of each pixel in nominal contact, 0 to 1.
    pressure : ndarray of float32 (rows, cols)
        Mean normal pressure over each pixel [MPa].
    gap : ndarray of float32 (rows, cols)
        Mean gap over each pixel [mm]; NaN beyond the state's grid.
    surface_state : ndarray of uint8 (rows, cols), optional
        :class:`~evanesce.core.states.SurfaceState` at each pixel's centre, where the contact state has it.
    pixel_area : ndarray (rows, cols)
        Area of plate that each pixel sees [mm^2].
    area : float
        Exact nominal contact area of the state [mm^2], also of what lies outside the view.
    normal_force : float
        [N].
    """

    mask: NDArray[np.float32]
    pressure: NDArray[np.float32]
    gap: NDArray[np.float32]
    surface_state: NDArray[np.uint8] | None
    pixel_area: Array
    area: float
    normal_force: float

    @property
    def visible_area(self) -> float:
        """Contact area inside the view, summed over its pixels [mm^2]."""
        return float((self.mask * self.pixel_area).sum())


def label(state: ContactState | None, geometry: ViewGeometry, *, supersample: int = 4) -> FrameLabels:
    """Map a contact state into the pixels of a view.

    Parameters
    ----------
    state : ContactState or None
        None where there is no contact.
    geometry : ViewGeometry
    supersample : int
        Samples along each side of a pixel.

    Returns
    -------
    FrameLabels

    Notes
    -----
    Each sample interpolates the state's grid linearly. The mask's edge therefore spans about one cell of the grid and
    one pixel; areas and forces are kept, because interpolation weights sum to one everywhere.
    """
    shape = geometry.shape
    mask, pressure = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
    gap = np.full(shape, np.nan, np.float32)
    surface: NDArray[np.uint8] | None = None
    if state is not None:
        if state.state is not None:
            surface = np.zeros(shape, np.uint8)
        rows, cols = _window(state, geometry)
        if rows.stop > rows.start and cols.stop > cols.start:
            _fill(state, geometry, (rows, cols), supersample, (mask, pressure, gap, surface))
    return FrameLabels(
        mask=mask,
        pressure=pressure,
        gap=gap,
        surface_state=surface,
        pixel_area=geometry.pixel_area,
        area=0.0 if state is None else state.nominal_contact_area,
        normal_force=0.0 if state is None else state.normal_force,
    )


def _window(state: ContactState, geometry: ViewGeometry) -> tuple[slice, slice]:
    """Return the rows and columns of pixels that may see the state's grid."""
    x_min, x_max, y_min, y_max = state.grid.extent
    x, y = geometry.corner_x, geometry.corner_y
    inside = (x >= x_min) & (x <= x_max) & (y >= y_min) & (y <= y_max)
    hit_rows, hit_cols = np.flatnonzero(inside.any(axis=1)), np.flatnonzero(inside.any(axis=0))
    if hit_rows.size == 0:
        return slice(0, 0), slice(0, 0)
    rows, cols = geometry.shape
    return (
        slice(max(hit_rows[0] - 1, 0), min(hit_rows[-1] + 1, rows)),
        slice(max(hit_cols[0] - 1, 0), min(hit_cols[-1] + 1, cols)),
    )


def _fill(
    state: ContactState,
    geometry: ViewGeometry,
    window: tuple[slice, slice],
    supersample: int,
    into: tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32], NDArray[np.uint8] | None],
) -> None:
    """Sample the state over each pixel of the window."""
    rows, cols = window
    corners = np.s_[rows.start : rows.stop + 1, cols.start : cols.stop + 1]
    at_row, at_col = state.grid.index(geometry.corner_x[corners], geometry.corner_y[corners])
    contact = np.dstack([state.contact_mask, state.pressure]).astype(np.float32)
    gaps = np.asarray(state.gap, np.float32)
    sums = np.zeros((rows.stop - rows.start, cols.stop - cols.start, 3), np.float64)
    fractions = (np.arange(supersample) + 0.5) / supersample
    for down in fractions:
        for right in fractions:
            y, x = _within(at_row, down, right), _within(at_col, down, right)
            sums[..., :2] += cv2.remap(contact, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=0)
            sums[..., 2] += cv2.remap(gaps, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    sums /= supersample**2
    centre_row, centre_col = _within(at_row, 0.5, 0.5), _within(at_col, 0.5, 0.5)
    grid_rows, grid_cols = state.grid.shape
    known = (np.abs(centre_row - (grid_rows - 1) / 2) <= grid_rows / 2) & (
        np.abs(centre_col - (grid_cols - 1) / 2) <= grid_cols / 2
    )
    mask, pressure, gap, surface = into
    mask[window] = np.clip(sums[..., 0], 0.0, 1.0)
    pressure[window] = sums[..., 1]
    gap[window] = np.where(known, sums[..., 2], np.nan)
    if surface is not None and state.state is not None:
        surface[window] = cv2.remap(
            np.asarray(state.state), centre_col, centre_row, cv2.INTER_NEAREST, borderMode=cv2.BORDER_CONSTANT
        )


def _within(corners: NDArray[np.floating[Any]], down: float, right: float) -> NDArray[np.float32]:
    """Interpolate between the four corners of each pixel; the map bends by less than 1e-6 of a pixel inside one."""
    top = (1 - right) * corners[:-1, :-1] + right * corners[:-1, 1:]
    bottom = (1 - right) * corners[1:, :-1] + right * corners[1:, 1:]
    return np.asarray((1 - down) * top + down * bottom, np.float32)
