"""Map from pixels to the plate, with the area of each pixel, from a checkerboard that lay on the glass.

The reference segmentation has one area per pixel for the whole undistorted view. Seen through thick glass the scale
changes over the view, and a tilted camera changes it as well. A board of known squares on the glass determines both
locally.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from evanesce.core.errors import InputError
from evanesce.measurement.calibration.model import Calibration
from evanesce.measurement.calibration.rectify import undistort_points

Floats = NDArray[np.float64]

DEGREE = 5
MIN_CORNERS = 80


@dataclass(frozen=True)
class PlateMap:
    """Map from the frame as taken to the plate.

    Attributes
    ----------
    calibration : Calibration
    middle : ndarray (2,)
        (x, y) about which powers are taken [px of the undistorted frame].
    reach : float
        Unit of the powers [px].
    powers : ndarray (terms, 2)
        Exponents of x and y.
    coefficients : ndarray (terms, 2)
        [mm].
    covariance : ndarray (terms, terms)
        Of the coefficients along one axis, from the corners' own scatter [mm^2].
    view : int, optional
        Number of the calibration's view that lay on the glass; None without corners.
    """

    calibration: Calibration
    middle: Floats
    reach: float
    powers: NDArray[np.int64]
    coefficients: Floats
    covariance: Floats
    view: int | None = None

    @classmethod
    def of(cls, calibration: Calibration) -> PlateMap:
        """Fit the corners that a calibration keeps; without corners, its one area per pixel.

        Of several views the one that is stated to have lain on the glass counts, else the one least tilted to the
        camera.

        Parameters
        ----------
        calibration : Calibration

        Returns
        -------
        PlateMap

        Raises
        ------
        InputError
            If the calibration holds neither corners nor an area per pixel.
        """
        found = _flattest(calibration)
        if found is None:
            return cls._uniform(calibration)
        view, world, at = found
        middle = (np.array(calibration.image_size, dtype=np.float64) - 1) / 2
        reach = float(max(calibration.image_size)) / 2
        powers = np.array([(i, j) for i in range(DEGREE + 1) for j in range(DEGREE + 1 - i)])
        terms = _terms((at - middle) / reach, powers)
        coefficients, *_ = np.linalg.lstsq(terms, world, rcond=None)
        residual = world - terms @ coefficients
        variance = float((residual**2).sum() / (2 * (len(world) - len(powers))))
        covariance = np.asarray(variance * np.linalg.inv(terms.T @ terms), np.float64)
        return cls(calibration, middle, reach, powers, np.asarray(coefficients, np.float64), covariance, view)

    @classmethod
    def _uniform(cls, calibration: Calibration) -> PlateMap:
        if calibration.mm2_per_px is None:
            raise InputError(
                "has neither corners nor an area per pixel", key="--calibration", allowed="one with either of them"
            )
        side = math.sqrt(calibration.mm2_per_px)
        coefficients = np.array([[0.0, 0.0], [side, 0.0], [0.0, side]])
        powers = np.array([(0, 0), (1, 0), (0, 1)])
        return cls(calibration, np.zeros(2), 1.0, powers, coefficients, np.zeros((3, 3)))

    def to_plate(self, points: Floats) -> Floats:
        """Return plate positions (n, 2) [mm] of points (x, y) in the frame as taken [px].

        Parameters
        ----------
        points : ndarray (n, 2)
            (x, y) in the frame as taken [px].

        Returns
        -------
        ndarray (n, 2)
            [mm].
        """
        straight = undistort_points(points, self.calibration.camera_matrix, self.calibration.distortion)
        return np.asarray(_terms((straight - self.middle) / self.reach, self.powers) @ self.coefficients)

    def pixel_area(self, points: Floats) -> Floats:
        """Return the area of the plate that a pixel sees [mm^2], (n,), at points (x, y) (n, 2) in the frame [px].

        Parameters
        ----------
        points : ndarray (n, 2)
            (x, y) in the frame as taken [px].

        Returns
        -------
        ndarray (n,)
            [mm^2].
        """
        right, below = np.array([0.5, 0.0]), np.array([0.0, 0.5])
        across = self.to_plate(points + right) - self.to_plate(points - right)
        down = self.to_plate(points + below) - self.to_plate(points - below)
        return np.asarray(np.abs(across[:, 0] * down[:, 1] - across[:, 1] * down[:, 0]))

    def area_standard(self, polygons: list[Floats]) -> float:
        """Return the standard uncertainty of :meth:`area` from the corners' scatter [mm^2].

        Parameters
        ----------
        polygons : list of ndarray (n, 2)
            As for :meth:`area`.

        Returns
        -------
        float
            [mm^2].
        """
        gradient = np.zeros((len(self.powers), 2))
        for polygon in polygons:
            straight = undistort_points(polygon, self.calibration.camera_matrix, self.calibration.distortion)
            terms = _terms((straight[:-1] - self.middle) / self.reach, self.powers)
            position = terms @ self.coefficients
            chord = 0.5 * (np.roll(position, -1, axis=0) - np.roll(position, 1, axis=0))
            gradient += np.stack([terms.T @ chord[:, 1], -terms.T @ chord[:, 0]], axis=-1)
        return float(np.sqrt(np.einsum("ik,ij,jk->", gradient, self.covariance, gradient)))

    @property
    def middle_area(self) -> float:
        """Area of the pixel in the frame's middle [mm^2]."""
        middle = (np.array(self.calibration.image_size, dtype=np.float64) - 1) / 2
        return float(self.pixel_area(middle[None, :])[0])

    def area(self, polygons: list[Floats]) -> float:
        """Return the area inside closed curves in the frame [mm^2]; curves that run the other way round are holes.

        Parameters
        ----------
        polygons : list of ndarray (n, 2)
            (x, y) of vertices, the last equal to the first [px].

        Returns
        -------
        float
            [mm^2].
        """
        return abs(sum(shoelace(self.to_plate(polygon)) for polygon in polygons))


def shoelace(polygon: Floats) -> float:
    """Return the signed area of a closed polygon (n, 2), the last vertex equal to the first.

    Parameters
    ----------
    polygon : ndarray (n, 2)

    Returns
    -------
    float
        In the unit squared.
    """
    x, y = (polygon - polygon.mean(axis=0)).T
    return float(0.5 * np.sum(x[:-1] * y[1:] - x[1:] * y[:-1]))


def _terms(points: Floats, powers: NDArray[np.int64]) -> Floats:
    return np.asarray(points[:, :1] ** powers[:, 0] * points[:, 1:] ** powers[:, 1])


def _flattest(calibration: Calibration) -> tuple[int, Floats, Floats] | None:
    """Return number, board [mm] and straight picture [px] of the view on the glass, if any.

    That is the calibration's ``on_glass_view`` (0: none), else the view whose scale changes least across it.
    """
    stated = calibration.details.get("on_glass_view")
    best: tuple[int, Floats, Floats] | None = None
    smallest = math.inf
    for number, world, image in _views(calibration.details):
        if isinstance(stated, int) and number != stated:
            continue
        straight = undistort_points(image, calibration.camera_matrix, calibration.distortion)
        homography, _ = cv2.findHomography(world, straight)
        if homography is None:
            continue
        depth = world @ homography[2, :2] + homography[2, 2]  # proportional to the corners' distance from the lens
        spread = float(depth.max() / depth.min()) if depth.min() > 0 else math.inf
        if spread < smallest:
            best, smallest = (number, world, straight), spread
    return best


def _views(details: Mapping[str, Any]) -> list[tuple[int, Floats, Floats]]:
    """Return number, board and picture positions of each view with enough corners."""
    rows = details.get("corners")
    if not isinstance(rows, list):
        return []
    keys = ("view", "world_x_mm", "world_y_mm", "image_x_px", "image_y_px")
    try:
        table = np.array([[float(row[key]) for key in keys] for row in rows], dtype=np.float64).reshape(-1, 5)
    except (KeyError, TypeError, ValueError):
        raise InputError("is damaged", key="corners", allowed=f"rows with {', '.join(keys)}") from None
    if not np.isfinite(table).all():
        raise InputError("holds numbers that are not finite", key="corners")
    views = [table[table[:, 0] == number] for number in np.unique(table[:, 0])]
    return [(int(v[0, 0]), v[:, 1:3], v[:, 3:5]) for v in views if len(v) >= MIN_CORNERS]
