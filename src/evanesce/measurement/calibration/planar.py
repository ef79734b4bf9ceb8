"""Planar rectification: a homography for each view, and the distortion that all views share.

One flat board, or several that lie in parallel planes, cannot determine the focal length: any focal length f can
be absorbed by the homographies. They do determine the distortion as a function of pixels from its centre. So f is
assumed, the coefficients are those that belong to it (k1/f^2 and k2/f^4 are what the picture holds), and the
undistorted picture does not depend on the choice.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from evanesce.core.errors import WorkError
from evanesce.measurement.calibration.errors import shared_errors
from evanesce.measurement.calibration.points import BoardView
from evanesce.measurement.calibration.rectify import distort_normalized, undistort_points

Array = NDArray[np.float64]

COEFFICIENTS = ("k1", "k2", "p1", "p2", "k3")  # OpenCV's order
MODELS: dict[str, tuple[str, ...]] = {
    "radial2": ("k1", "k2"),
    "radial3": ("k1", "k2", "k3"),
    "full": ("k1", "k2", "p1", "p2", "k3"),
}


@dataclass(frozen=True)
class BoardFit:
    """Shared camera and one homography for each view.

    Attributes
    ----------
    camera_matrix : ndarray (3, 3)
        [px]; its focal length may be an assumed one, then the principal point is the centre of distortion.
    distortion : ndarray (5,)
        k1, k2, p1, p2, k3 for that focal length.
    homographies : ndarray (views, 3, 3)
        Board [mm] to undistorted pixels.
    standard_errors : dict
        Of what was fitted (:mod:`evanesce.measurement.calibration.errors`): fx, fy, cx, cy [px], free coefficients.
    """

    camera_matrix: Array
    distortion: Array
    homographies: Array
    standard_errors: dict[str, float]

    def undistort(self, points: Array) -> Array:
        """Return where pixels (n, 2) lie in the undistorted picture [px].

        Parameters
        ----------
        points : ndarray (n, 2)
            (x, y) in the picture [px].

        Returns
        -------
        ndarray (n, 2)
            [px].
        """
        return undistort_points(points, self.camera_matrix, self.distortion)

    def straight(self, view: int, world: Array) -> Array:
        """Return where the grid of a view [mm] lies in the undistorted picture [px].

        Parameters
        ----------
        view : int
            Number of the view, from 0.
        world : ndarray (n, 2)
            On the board [mm].

        Returns
        -------
        ndarray (n, 2)
            [px].
        """
        return apply_homography(self.homographies[view], world)

    def predict(self, view: int, world: Array) -> Array:
        """Return where the grid of a view [mm] lies in the picture as taken [px].

        Parameters
        ----------
        view : int
            Number of the view, from 0.
        world : ndarray (n, 2)
            On the board [mm].

        Returns
        -------
        ndarray (n, 2)
            [px].
        """
        middle, focal = self.camera_matrix[:2, 2], np.diag(self.camera_matrix)[:2]
        bent = distort_normalized((self.straight(view, world) - middle) / focal, self.distortion)
        return np.asarray(bent * focal + middle)

    def depth_spread(self, view: int, world: Array) -> float:
        """Return the ratio of greatest to smallest distance of a view's corners from the lens [1].

        Parameters
        ----------
        view : int
            Number of the view, from 0.
        world : ndarray (n, 2)
            On the board [mm].

        Returns
        -------
        float
        """
        homography = self.homographies[view]
        depth = np.abs(world @ homography[2, :2] + homography[2, 2])
        return float(depth.max() / depth.min())


def apply_homography(homography: Array, points: Array) -> Array:
    """Map points by a homography.

    Parameters
    ----------
    homography : ndarray (3, 3)
    points : ndarray (n, 2)

    Returns
    -------
    ndarray (n, 2)
    """
    mapped = points @ homography[:, :2].T + homography[:, 2]
    return np.asarray(mapped[:, :2] / mapped[:, 2:])


def fit_planar(
    views: Sequence[BoardView], image_size: tuple[int, int], focal_px: float, model: str = "radial2"
) -> BoardFit:
    """Fit homographies, centre and coefficients of distortion by least squares on the corners' image positions.

    Parameters
    ----------
    views : sequence of BoardView
    image_size : tuple of int
        (cols, rows); the fit starts from its middle.
    focal_px : float
        Assumed focal length [px].
    model : str
        A key of ``MODELS``.

    Returns
    -------
    BoardFit

    Raises
    ------
    WorkError
        If the corners do not determine the fit, or it does not converge.
    """
    free = [COEFFICIENTS.index(name) for name in MODELS[model]]
    shared = 2 + len(free)
    middle = (np.array(image_size, dtype=np.float64) - 1) / 2
    boards = [_normaliser(view.world) for view in views]
    world = [(view.world - shift) / size for view, (shift, size) in zip(views, boards, strict=True)]
    image = [(view.image - middle) / focal_px for view in views]

    def predicted(v: int, common: Array, h: Array) -> Array:
        k = np.zeros(5)
        k[free] = common[2:]
        straight = apply_homography(np.append(h, 1.0).reshape(3, 3), world[v])
        return distort_normalized(straight - common[:2], k) + common[:2]

    def parts(theta: Array) -> tuple[Array, Array]:
        return theta[:shared], theta[shared:].reshape(-1, 8)

    def residuals(theta: Array) -> Array:
        common, homographies = parts(theta)
        return np.concatenate([(predicted(v, common, h) - image[v]).ravel() for v, h in enumerate(homographies)])

    def jacobian(theta: Array) -> Array:
        common, homographies = parts(theta)
        blocks = np.zeros((sum(2 * len(w) for w in world), len(theta)))
        row = 0
        for v, h in enumerate(homographies):
            rows = slice(row, row := row + 2 * len(world[v]))
            own = slice(shared + 8 * v, shared + 8 * v + 8)
            blocks[rows, :shared] = _difference(lambda c: predicted(v, c, h), common)  # noqa: B023
            blocks[rows, own] = _difference(lambda g: predicted(v, common, g), h)  # noqa: B023
        return blocks

    if 2 * sum(map(len, world)) <= shared + 8 * len(views):
        raise WorkError(f"{sum(map(len, world))} corners are too few for {shared + 8 * len(views)} parameters")
    start = _start(world, image, len(free), views)
    solved = least_squares(residuals, start, jac=jacobian, method="lm", x_scale="jac", max_nfev=500)
    if solved.status <= 0 or not np.isfinite(solved.x).all():
        raise WorkError(f"the planar fit did not converge: {solved.message}")
    sizes = [2 * len(w) for w in world]
    return _planar_fit(solved.x, solved.fun, jacobian(solved.x), sizes, free, middle, focal_px, boards)


def _start(world: list[Array], image: list[Array], coefficients: int, views: Sequence[BoardView]) -> Array:
    """Return the best of a few starts: without any distortion its centre would not show in the residuals at all."""
    far = max(float((points**2).sum(axis=1).max()) for points in image)
    best, best_cost = None, np.inf
    for strength in (-0.2, -0.05, 0.05, 0.2):  # share by which the farthest corner is displaced
        k1 = strength / far
        cost, homographies = 0.0, []
        for w, points, view in zip(world, image, views, strict=True):
            straight = points * (1 - k1 * (points**2).sum(axis=1, keepdims=True))
            h, _ = cv2.findHomography(w, straight, 0)
            if h is None or abs(h[2, 2]) < 1e-9:
                raise WorkError(f"view {view.name}: its corners do not span a plane")
            cost += float(((apply_homography(h, w) - straight) ** 2).sum())
            homographies.append((h / h[2, 2]).ravel()[:8])
        if cost < best_cost:
            best_cost, best = cost, np.concatenate([[0, 0, k1], np.zeros(coefficients - 1), *homographies])
    if best is None:
        raise WorkError("the corners are not finite")
    return best


def _planar_fit(
    theta: Array,
    residual: Array,
    jacobian: Array,
    sizes: list[int],
    free: list[int],
    middle: Array,
    focal_px: float,
    boards: list[tuple[Array, float]],
) -> BoardFit:
    """Turn the fit's own units into pixels and millimetres."""
    shared = 2 + len(free)
    ends = np.cumsum(sizes)
    rows = [slice(end - size, end) for end, size in zip(ends, sizes, strict=True)]
    errors = shared_errors(
        [jacobian[r, :shared] for r in rows],
        [jacobian[r, shared + 8 * v : shared + 8 * v + 8] for v, r in enumerate(rows)],
        [residual[r] for r in rows],
    )
    names = [COEFFICIENTS[i] for i in free]
    standard_errors = {"cx": float(errors[0] * focal_px), "cy": float(errors[1] * focal_px)}
    standard_errors |= {name: float(errors[2 + i]) for i, name in enumerate(names)}
    distortion = np.zeros(5)
    distortion[free] = theta[2:shared]
    centre = middle + focal_px * theta[:2]
    matrix = np.array([[focal_px, 0, centre[0]], [0, focal_px, centre[1]], [0, 0, 1.0]])
    to_pixels = np.array([[focal_px, 0, middle[0]], [0, focal_px, middle[1]], [0, 0, 1.0]])
    homographies = []
    for h, (shift, size) in zip(theta[shared:].reshape(-1, 8), boards, strict=True):
        from_board = np.array([[1, 0, -shift[0]], [0, 1, -shift[1]], [0, 0, size]]) / size
        homographies.append(to_pixels @ np.append(h, 1.0).reshape(3, 3) @ from_board)
    return BoardFit(matrix, distortion, np.array(homographies), standard_errors)


def _normaliser(world: Array) -> tuple[Array, float]:
    """Return the middle of the corners and their root-mean-square distance from it."""
    shift = world.mean(axis=0)
    return shift, float(np.sqrt(((world - shift) ** 2).sum(axis=1).mean()))


def _difference(function: Callable[[Array], Array], at: Array) -> Array:
    """Return central differences, (residuals, parameters)."""
    columns = []
    for i in range(len(at)):
        step = np.zeros(len(at))
        step[i] = 6e-6 * max(1.0, abs(at[i]))
        columns.append((function(at + step) - function(at - step)).ravel() / (2 * step[i]))
    return np.stack(columns, axis=-1)
