"""A photographed checkerboard: corners, the geometry fitted to half of them, the print drawn through it, and blocks.

Everything is in the frame's own pixels (or whole bins of them). Blocks of two by two squares are alternately open to
fits and held out.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from evanesce.core.errors import WorkError
from evanesce.core.states import PlateLight
from evanesce.evaluation.board_geometry import FittedRig, bright_even, fit_rig
from evanesce.evaluation.board_light import BLOCK, block_mask, held_out_block, smooth_field
from evanesce.measurement.calibration.corners import CornerGrid, find_corners, grey
from evanesce.measurement.calibration.points import BoardView
from evanesce.optics.projection import Projection
from evanesce.rig import Camera, Scene
from evanesce.sensor.lens import form_image, prepared_lens
from evanesce.sensor.tone import Curve

Array = NDArray[np.float64]

WORKING_COLS = 512
"""A wider frame is averaged over whole bins down to about this: four numbers in a bin tell little more than one."""

MIN_CORNERS = 60
"""Half of them are fitted, by some ten figures of geometry: three corners to each."""
INK_STEP_MM, SHIFT_STEP_PX = 0.01, 0.1
"""Steps of derivatives: a tenth of a pixel of usual photographs, over which edges are straight."""


@dataclass(frozen=True)
class Print:
    """The printed board as the simulation draws it: on its pinhole view and through its lens, without blur.

    What resampling does to an edge is then no difference between photograph and prediction.

    Attributes
    ----------
    rig : FittedRig
    base : Scene
    bend : tuple of ndarray (full rows, full cols)
        Smooth displacement that the fitted lens leaves (x, y) [px].
    bin_px : int
    """

    rig: FittedRig
    base: Scene
    bend: tuple[Array, Array]
    bin_px: int

    def drawn(self, ink_mm: float) -> tuple[Array, dict[str, Array]]:
        """Return the share of bright print in each bin and its slopes, see :class:`Photograph`."""
        step = SHIFT_STEP_PX
        along = [
            (self._share(ink_mm, *d) - self._share(ink_mm, -d[0], -d[1])) / (2 * step)
            for d in ((step, 0.0), (0.0, step))
        ]
        # What the lens model leaves of the corners is less than the width of an edge: slopes say what it does.
        bent = self._share(ink_mm) + sum(b * slope for b, slope in zip(self.bend, along, strict=True))
        ends = [self._share(ink_mm + side * INK_STEP_MM) for side in (1, -1)]
        slopes = {"ink": (ends[0] - ends[1]) / (2 * INK_STEP_MM)}
        slopes |= {axis: self.bin_px * slope for axis, slope in zip("xy", along, strict=True)}
        return binned_mean(bent, self.bin_px), {name: binned_mean(x, self.bin_px) for name, x in slopes.items()}

    def _share(self, ink_mm: float, dx: float = 0.0, dy: float = 0.0) -> Array:
        """Return the share in each pixel with the print moved in the frame [px]."""
        x, y = self.rig.camera.principal_point_offset_px
        camera = self.rig.camera.model_copy(update={"principal_point_offset_px": (x + dx, y + dy)})
        projection = Projection.of(camera, self.base.plate)
        view = projection.ideal_view()
        cx, cy = view.principal_point
        u, v = np.meshgrid(np.arange(view.shape[1]) - cx, np.arange(view.shape[0]) - cy)
        place = projection.ray_to_plate(u / view.focal_px, v / view.focal_px)
        share = replace(self.rig.board, ink_mm=ink_mm).bright_share(*place, 1.0 / camera.scale_px_per_mm)
        lit, flat = (
            PlateLight(radiance=r, variance=0.0 * r, focal_px=view.focal_px, principal_point=view.principal_point)
            for r in (share, np.ones(view.shape))
        )
        seen, even = (form_image(one, camera, self.base.plate, blurred=False).irradiance for one in (lit, flat))
        return np.asarray(seen / even)


@dataclass(frozen=True)
class Photograph:
    """A photographed board, and its nominal model.

    Attributes
    ----------
    full : ndarray (full rows, full cols)
        The picture as it came [DN].
    data : ndarray (rows, cols)
        The same, averaged over bins [DN].
    bin_px : int
        Side of a bin.
    grid : CornerGrid
        Corners of the full picture.
    rig : FittedRig
        Camera and print, fitted to the corners of open blocks.
    scene : Scene
        With the fitted camera, its pixels as large as a bin.
    curve : str
        Nominal tone curve.
    printed : Print
        Draws the share of bright print in each bin, by a lens without blur; slopes are its derivatives by the ink's
        reach [1/mm] and by a shift of the print in the frame, ``x`` and ``y`` [1/bin].
    share : ndarray (rows, cols)
        The same with ink that does not spread.
    gain : ndarray (rows, cols)
        Light of the nominal lens, 1 where most [1].
    block : ndarray of int (rows, cols)
        Number of the block of two by two squares; -1: none.
    locked : ndarray of bool (rows, cols)
    corner_error_px : float
        Robust deviation, per axis, of a corner from where the others put it [bins].
    """

    full: Array
    data: Array
    bin_px: int
    grid: CornerGrid
    rig: FittedRig
    scene: Scene
    curve: Curve
    printed: Print
    share: Array
    gain: Array
    block: NDArray[np.int64]
    locked: NDArray[np.bool_]
    corner_error_px: float

    @property
    def opened(self) -> NDArray[np.bool_]:
        """Bins that may be fitted."""
        return (self.block >= 0) & ~self.locked


def read_photograph(picture: NDArray[np.uint8], base: Scene, curve: Curve) -> Photograph:
    """Find the board, fit its geometry on alternate blocks, and draw the print.

    Parameters
    ----------
    picture : ndarray of uint8 (rows, cols) or (rows, cols, 3)
    base : Scene
        Nominal plate, focal length and readout.
    curve : str

    Raises
    ------
    WorkError
        If there is no board, or too little of it.
    """
    grid = find_corners(picture)
    if len(grid) < MIN_CORNERS:
        raise WorkError(f"{len(grid)} corners found, half of which would be fitted (needed: {MIN_CORNERS})")
    return prepare(grey(picture), grid, base, curve)


def prepare(full: Array, grid: CornerGrid, base: Scene, curve: Curve) -> Photograph:
    """Return the photograph with its geometry, from corners that have been found."""
    size = (full.shape[1], full.shape[0])
    fitted = ~held_out_block(grid.index)
    half = BoardView("open blocks", grid.index[fitted].astype(np.float64), grid.fit.position[fitted])
    camera = base.camera.model_copy(update={"tone_curve": curve})
    rig = fit_rig(half, size, camera, base.plate, even_is_bright=bright_even(grid))
    miss = grid.fit.position - rig.predict(base.plate, grid.index.astype(np.float64))
    bend, error = _bend(grid, miss, fitted, full.shape)
    n = max(1, round(size[0] / WORKING_COLS))
    binned = _coarse_camera(rig.camera, n)
    scene = base.model_copy(update={"camera": binned, "effects": {}})
    printed = Print(rig, base, bend, n)
    block, locked = _blocks(grid, full.shape, n)
    projection = Projection.of(binned, base.plate)
    gain = prepared_lens(binned, base.plate, projection.ideal_view()).gain
    return Photograph(
        full,
        binned_mean(full, n),
        n,
        grid,
        rig,
        scene,
        curve,
        printed,
        printed.drawn(0.0)[0],
        gain / gain.max(),
        block,
        locked,
        error / n,
    )


def binned_mean(image: Array, n: int) -> Array:
    """Return means over bins of n by n pixels; what is over at right and bottom is left out."""
    rows, cols = image.shape[0] // n, image.shape[1] // n
    return np.asarray(image[: rows * n, : cols * n].reshape(rows, n, cols, n).mean(axis=(1, 3)))


def _coarse_camera(camera: Camera, n: int) -> Camera:
    cols, rows = camera.resolution_px
    kept = (cols // n, rows // n)
    dx, dy = camera.principal_point_offset_px
    # rows and columns that do not fill a bin are cut off at right and bottom: the frame's middle moves
    offset = ((dx + (cols - kept[0] * n) / 2) / n, (dy + (rows - kept[1] * n) / 2) / n)
    pixel = camera.pixel.model_copy(update={"pitch_um": camera.pixel.pitch_um * n})
    return camera.model_copy(
        update={
            "resolution_px": kept,
            "scale_px_per_mm": camera.scale_px_per_mm / n,
            "principal_point_offset_px": offset,
            "pixel": pixel,
        }
    )


def _bend(grid: CornerGrid, miss: Array, fitted: NDArray[np.bool_], shape: Any) -> tuple[tuple[Array, Array], float]:
    """Return the smooth displacement that the fitted lens leaves [px], and the deviation of corners from it."""
    at = grid.fit.position
    field_x, field_y = (smooth_field(at[fitted], miss[fitted, k], shape) for k in (0, 1))
    halves = fitted & ((grid.index // (2 * BLOCK)).sum(axis=1) % 2 == 0)
    others = fitted & ~halves
    left: list[Array] = []
    for k in (0, 1):
        part = smooth_field(at[halves], miss[halves, k], shape)
        left.append(miss[others, k] - ndimage.map_coordinates(part, at[others].T[::-1], order=1, mode="nearest"))
    return (field_x, field_y), float(1.4826 * np.median(np.abs(np.concatenate(left))))


def _blocks(grid: CornerGrid, shape: Any, n: int) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Return each bin's block and whether that is locked; a bin counts only if it lies in one block wholly."""
    number = np.full(grid.index.max(axis=0) + 1, -1)
    number[tuple(grid.index.T)] = np.arange(len(grid))
    corners = np.stack([number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]], axis=-1)
    cells = np.argwhere((corners >= 0).all(axis=-1))
    blocks = cells // BLOCK
    names = blocks[:, 0] * (blocks[:, 1].max() + 1) + blocks[:, 1]
    drawn = np.full(shape, -1, dtype=np.int32)
    outlines = np.rint(grid.fit.position[corners[tuple(cells.T)]] * 16).astype(np.int32)
    for outline, name in zip(outlines, names, strict=True):
        cv2.fillConvexPoly(drawn, outline, int(name), shift=4)
    locked, opened = (block_mask(grid, shape, held_out=judged) for judged in (True, False))
    rows, cols = shape[0] // n, shape[1] // n
    tiles = drawn[: rows * n, : cols * n].reshape(rows, n, cols, n)
    whole = tiles.min(axis=(1, 3)) == tiles.max(axis=(1, 3))
    all_locked = binned_mean(locked.astype(np.float64), n) == 1.0
    counted = whole & (all_locked | (binned_mean(opened.astype(np.float64), n) == 1.0))
    return np.where(counted, tiles[:, 0, :, 0], -1).astype(np.int64), all_locked
