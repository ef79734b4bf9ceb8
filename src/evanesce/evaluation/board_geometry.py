"""The simulated camera and the printed board fitted to a photograph's corners."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError
from scipy.optimize import least_squares

from evanesce.core.errors import WorkError
from evanesce.measurement.calibration.board_lines import BoardLines, fit_lines
from evanesce.measurement.calibration.corners import CornerGrid
from evanesce.measurement.calibration.points import BoardView
from evanesce.optics.projection import Projection
from evanesce.rig import Camera, Plate

Array = NDArray[np.float64]

SENSOR_WIDTH_UM = 4056 * 1.55
"""Of the IMX477: a photograph of the whole field has this divided by its columns as pixel pitch."""

SPARE_LINES = 8
"""Lines added at each side of the corners found: the board goes on beyond the frame."""

_PARAMETERS = ("scale", "x", "y", "cx", "cy", "roll", "tilt_x", "tilt_y", "k1", "k2", "stretch", "shear")
_TYPICAL = np.array([30.0, 1.0, 1.0, 10.0, 10.0, 1.0, 1.0, 1.0, 0.1, 0.1, 0.01, 0.01])


@dataclass(frozen=True)
class PrintedBoard:
    """A checkerboard lying on the plate, with the printer's displacement of its lines.

    Attributes
    ----------
    lines : BoardLines
        Of the grid's own coordinates [mm].
    middle : ndarray (2,)
        Grid coordinates of the plate's origin [mm].
    stretch : float
        Length of a millimetre of the print's second axis over that of its first.
    shear : float
        Shear of the print's second axis along its first [1].
    bright_even : bool
        Whether the square between lines 0 and 1 of both axes is bright.
    ink_mm : float
        Spread of the dark print over each edge [mm].
    """

    lines: BoardLines
    middle: Array
    stretch: float
    shear: float
    bright_even: bool
    ink_mm: float = 0.0

    def to_plate(self, world: Array) -> Array:
        """Return plate coordinates (n, 2) [mm] of corners given by their nominal position [mm].

        Parameters
        ----------
        world : ndarray (n, 2)
            Nominal corners [mm].

        Returns
        -------
        ndarray (n, 2)
            [mm].
        """
        placed = self.lines.place(world) - self.middle
        return np.stack([placed[:, 0] + self.shear * placed[:, 1], self.stretch * placed[:, 1]], axis=-1)

    def bright_share(self, x: Array, y: Array, footprint_mm: float) -> Array:
        """Return the share of bright print in a square footprint around plate points (any shape) [mm].

        Bright squares are products of two stripes, so that their mean over a rectangle along the lines is a product of
        two means. A footprint turned against the lines is taken as one along them: same second moment.

        Parameters
        ----------
        x, y : ndarray
            Plate coordinates [mm], any shape.
        footprint_mm : float
            Side of the square footprint [mm].

        Returns
        -------
        ndarray
            0 to 1, of the same shape.
        """
        shares: list[list[Array]] = [[], []]
        along = y / self.stretch
        for axis, (points, size) in enumerate(((x - self.shear * along, 1.0), (along, self.stretch))):
            at, half = points + self.middle[axis], footprint_mm / size / 2
            for parity in (0, 1):
                knots, total = self._stripes(axis, parity)
                part = np.interp(at + half, knots, total) - np.interp(at - half, knots, total)
                shares[axis].append(part / (2 * half))
        pairs = ((0, 0), (1, 1)) if self.bright_even else ((0, 1), (1, 0))
        return np.clip(sum(shares[0][i] * shares[1][j] for i, j in pairs), 0.0, 1.0)

    def _stripes(self, axis: int, parity: int) -> tuple[Array, Array]:
        """Return knots and running integral of the bright stripes that begin at a line of that parity."""
        nominal, offset = self.lines.nominal[axis], self.lines.offset[axis]
        pitch = float(np.median(np.diff(nominal)))
        spare = pitch * np.arange(1, SPARE_LINES + 1)
        placed = np.concatenate([nominal[0] - spare[::-1], nominal + offset, nominal[-1] + spare])
        number = np.rint(np.concatenate([nominal[0] - spare[::-1], nominal, nominal[-1] + spare]) / pitch)
        begins = np.flatnonzero(np.mod(number[:-1], 2) == parity)
        edges = np.stack([placed[begins] + self.ink_mm, placed[begins + 1] - self.ink_mm], axis=-1)
        widths = np.maximum(edges[:, 1] - edges[:, 0], 0.0)
        total = np.concatenate([[0.0], np.cumsum(widths)])
        return edges.ravel(), np.stack([total[:-1], total[1:]], axis=-1).ravel()


@dataclass(frozen=True)
class FittedRig:
    """Camera and board fitted to corners.

    Attributes
    ----------
    camera : Camera
    board : PrintedBoard
    """

    camera: Camera
    board: PrintedBoard

    def predict(self, plate: Plate, world: Array) -> Array:
        """Return where nominal corners (n, 2) [mm] appear, (x, y) [px].

        Parameters
        ----------
        plate : Plate
        world : ndarray (n, 2)
            Nominal corners [mm].

        Returns
        -------
        ndarray (n, 2)
            (x, y) [px].
        """
        placed = self.board.to_plate(world)
        u, v = Projection.of(self.camera, plate).to_image(placed[:, 0], placed[:, 1])
        return np.stack([u, v], axis=-1)


def bright_even(grid: CornerGrid) -> bool:
    """Return whether the square between lines 0 and 1 of both axes is bright, by the corners' contrasts.

    Parameters
    ----------
    grid : CornerGrid

    Returns
    -------
    bool
    """
    return bool(np.median(np.sign(grid.fit.contrast) * (1 - 2 * (grid.index.sum(axis=1) % 2))) > 0)


def fit_rig(
    view: BoardView, image_size: tuple[int, int], base: Camera, plate: Plate, *, even_is_bright: bool
) -> FittedRig:
    """Fit camera, two radial terms, the print's stretch, shear and lines to corners seen through the glass.

    A flat board does not determine the focal length; the base camera's is kept, with the pixel pitch of its sensor in a
    photograph of the whole field.

    Parameters
    ----------
    view : BoardView
        Corners to fit; world coordinates are whole multiples of the square.
    image_size : tuple of int
        (cols, rows).
    base : Camera
        Lens and readout to keep.
    plate : Plate
    even_is_bright : bool
        See :class:`PrintedBoard`.

    Returns
    -------
    FittedRig

    Raises
    ------
    WorkError
        If the corners determine no fit.
    """
    assumed = base.lens.focal_length_mm * 1e3 / (SENSOR_WIDTH_UM / image_size[0])
    lines, flat = fit_lines(view, image_size, assumed)
    middle = view.world.mean(axis=0)
    homography = flat.homographies[0]
    at = np.linalg.inv(homography) @ np.append(flat.camera_matrix[:2, 2], 1.0)
    axis_mm = at[:2] / at[2] - middle
    w = homography[2, :2] @ (axis_mm + middle) + homography[2, 2]
    along = (homography[:2, :2] - np.outer(flat.camera_matrix[:2, 2], homography[2, :2])) / w
    offset = flat.camera_matrix[:2, 2] - (np.array(image_size) - 1) / 2
    scale, turn = np.sqrt(abs(np.linalg.det(along))), -np.rad2deg(np.arctan2(along[1, 0], along[0, 0]))
    start = np.array([scale, *axis_mm, *offset, turn, 0.0, 0.0, *flat.distortion[:2], 1.0, 0.0])

    def rig(theta: Array) -> FittedRig:
        board = PrintedBoard(lines, middle, float(theta[-2]), float(theta[-1]), even_is_bright)
        return FittedRig(_camera(theta, base, image_size), board)

    def miss(theta: Array) -> Array:
        return (rig(theta).predict(plate, view.world) - view.image).ravel()

    solved = least_squares(miss, start, x_scale=_TYPICAL, max_nfev=60)
    if not np.isfinite(solved.x).all() or not solved.success:
        raise WorkError(f"the rig does not fit the corners: {solved.message}")
    return rig(solved.x)


def _camera(theta: Array, base: Camera, image_size: tuple[int, int]) -> Camera:
    """Return the base camera at the fitted position.

    Raises
    ------
    WorkError
        If that is outside the limits of a camera.
    """
    p = dict(zip(_PARAMETERS, (float(t) for t in theta), strict=True))
    data = base.model_dump()
    data |= {
        "resolution_px": image_size,
        "scale_px_per_mm": p["scale"],
        "centre_mm": (p["x"], p["y"]),
        "principal_point_offset_px": (p["cx"], p["cy"]),
        "roll_deg": p["roll"],
        "tilt_x_deg": p["tilt_x"],
        "tilt_y_deg": p["tilt_y"],
    }
    data["lens"]["distortion"] = {"k1": p["k1"], "k2": p["k2"], "p1": 0.0, "p2": 0.0, "k3": 0.0}
    data["pixel"]["pitch_um"] = SENSOR_WIDTH_UM / image_size[0]
    try:
        return Camera.model_validate(data)
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(map(str, first["loc"]))
        raise WorkError(f"no camera of this rig fits the corners: {where}: {first['msg']}") from None
