"""Views of a calibration that are one and the same picture: told, and what such a view leaves unknown."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import optimize

from evanesce.measurement.calibration.corners import CornerGrid
from evanesce.measurement.calibration.distinct import STILL_PX
from evanesce.measurement.calibration.planar import fit_planar
from evanesce.measurement.calibration.points import BoardView
from evanesce.measurement.calibration.saddle import SaddleFit

Array = NDArray[np.float64]

NAMES = ("focal length", "cx", "cy", "k1", "k2", "turn x", "turn y", "turn z", "place x", "place y", "distance")
FOCAL_FACTORS = (0.6, 0.8, 1.0, 1.25, 1.6)
UNDETERMINED = 1e-10
"""Of the largest singular value: what double precision leaves of zero, six digits to spare."""


def judge_views(
    views: Sequence[BoardView], image_size: tuple[int, int], focal_px: float, noise_px: float
) -> dict[str, Any]:
    """Tell which views are one picture, and what a single flat view cannot identify.

    Parameters
    ----------
    views : sequence of BoardView
    image_size : tuple of int
        (cols, rows).
    focal_px : float
        Assumed where none can be found [px].
    noise_px : float
        Of an independently detected corner, per axis [px].

    Returns
    -------
    dict
        ``views``, ``distinct``, ``verdict`` ("identical", "still", "different" or "one"), ``largest_difference_px``,
        ``expected_difference_px`` (RMS per axis between two detections with that noise), ``single_view``.
    """
    groups = _groups(views)
    largest = max(_difference(views[0], view) for view in views)
    count = len(views)
    if count == 1:
        verdict = "one"
    elif len(groups) < count:
        verdict = "identical" if all(_difference(views[g[0]], views[v]) == 0.0 for g in groups for v in g) else "still"
    else:
        verdict = "different"
    return {
        "views": count,
        "distinct": len(groups),
        "verdict": verdict,
        "groups": [[views[v].name for v in group] for group in groups],
        "largest_difference_px": None if np.isinf(largest) else largest,
        "expected_difference_px": float(np.sqrt(2.0) * noise_px),
        "corner_noise_px": noise_px,
        "single_view": single_view(views[0], image_size, focal_px, noise_px) if len(groups) == 1 else None,
    }


def photographed_views(
    grid: CornerGrid, image_size: tuple[int, int], focal_px: float, views: Sequence[BoardView], noise_DN: float
) -> dict[str, Any]:
    """Judge views of a calibration by the noise that a photograph of the same board shows.

    Parameters
    ----------
    grid : CornerGrid
        Corners of the photograph.
    image_size : tuple of int
        (cols, rows).
    focal_px : float
        Assumed where none can be found [px].
    views : sequence of BoardView
    noise_DN : float
        Of a pixel.

    Returns
    -------
    dict
        See :func:`judge_views`.
    """
    return judge_views(views, image_size, focal_px, corner_noise(grid.fit, grid.lattice, noise_DN))


def _groups(views: Sequence[BoardView]) -> list[list[int]]:
    groups: list[list[int]] = []
    for number, view in enumerate(views):
        for group in groups:
            if _difference(views[group[0]], view) < STILL_PX:
                group.append(number)
                break
        else:
            groups.append([number])
    return groups


def _difference(one: BoardView, other: BoardView) -> float:
    """Return the largest difference of the corners of two views [px]; infinite where they hold others."""
    if one.world.shape != other.world.shape or not np.array_equal(one.world, other.world):
        return float("inf")
    return float(np.abs(one.image - other.image).max())


def single_view(view: BoardView, image_size: tuple[int, int], focal_px: float, noise_px: float) -> dict[str, Any]:
    """Show by the Jacobian and by a profile what one view tells of focal length, distance and tilt.

    Parameters
    ----------
    view, image_size, focal_px, noise_px
        See :func:`judge_views`.

    Returns
    -------
    dict
        ``singular_values`` of the Jacobian, each parameter in units of what moves the corners by 1 px RMS when it alone
        changes; ``condition``; ``weakest`` (name -> share of the least determined direction, or of all directions that
        rounding alone tells from undetermined ones); ``profile``: focal
        lengths tried, each with the RMS left, the distance and the tilt with it; ``rectification_rms_px``.
    """
    theta = _profiled(view, _start(view, image_size, focal_px), focal_px)
    _, slopes = _project(view, theta)
    size = np.sqrt((slopes**2).mean(axis=0))
    _, values, directions = np.linalg.svd(slopes / size, full_matrices=False)
    # Directions of a null space are any turn of each other: which one rounding puts last says nothing.
    undetermined = directions[values < UNDETERMINED * values[0]]
    weakest = directions[-1] if len(undetermined) < 2 else np.sqrt((undetermined**2).sum(axis=0))
    values = values / np.sqrt(len(slopes))
    # parameters scaled by their own effect; back through it, the standard errors that noise of a corner leaves
    covariance = (directions.T / values**2) @ directions / len(slopes) * noise_px**2
    errors = np.sqrt(np.diag(covariance)) / size
    profile = [_figures(view, _profiled(view, theta, factor * focal_px)) for factor in FOCAL_FACTORS]
    flat = fit_planar([view], image_size, focal_px)
    left = view.image - flat.predict(0, view.world)
    return {
        "parameters": list(NAMES),
        "singular_values": values.tolist(),
        "condition": float(values[0] / values[-1]),
        "weakest": {n: float(s) for n, s in zip(NAMES, weakest, strict=True) if abs(s) > 0.1},
        "standard_errors_by_noise": {n: float(e) for n, e in zip(NAMES, errors, strict=True)},
        "at": {n: float(t) for n, t in zip(NAMES, theta, strict=True)},
        "profile": profile,
        "rectification_rms_px": float(np.sqrt((left**2).sum(axis=1).mean())),
    }


def _start(view: BoardView, image_size: tuple[int, int], focal_px: float) -> Array:
    fit = fit_planar([view], image_size, focal_px)
    pose = np.linalg.inv(fit.camera_matrix) @ fit.homographies[0]
    pose /= np.sqrt(np.linalg.norm(pose[:, 0]) * np.linalg.norm(pose[:, 1])) * np.sign(pose[2, 2])
    turn = np.column_stack([pose[:, 0], pose[:, 1], np.cross(pose[:, 0], pose[:, 1])])
    u, _, v = np.linalg.svd(turn)
    rotation, _ = cv2.Rodrigues(u @ v)
    matrix = fit.camera_matrix
    return np.array([matrix[0, 0], matrix[0, 2], matrix[1, 2], *fit.distortion[:2], *rotation.ravel(), *pose[:, 2]])


def _sizes(theta: Array) -> Array:
    return np.array([theta[0], 50.0, 50.0, 0.1, 0.1, 0.05, 0.05, 0.05, 1.0, 1.0, abs(theta[-1])])


def _project(view: BoardView, theta: Array) -> tuple[Array, Array]:
    """Return projected corners (2n,) [px] and their slopes (2n, 11)."""
    f, cx, cy, k1, k2 = theta[:5]
    world = np.column_stack([view.world, np.zeros(len(view))])
    matrix = np.array([[f, 0, cx], [0, f, cy], [0, 0, 1.0]])
    found, slopes = cv2.projectPoints(world, theta[5:8], theta[8:], matrix, np.array([k1, k2, 0.0, 0.0]))
    # OpenCV's order: rotation, translation, fx, fy, cx, cy, k1, k2, ...
    ours = np.column_stack([slopes[:, 6] + slopes[:, 7], slopes[:, 8:12], slopes[:, :6]])
    return found.reshape(-1), ours


def _profiled(view: BoardView, theta: Array, focal_px: float) -> Array:
    """Return the parameters (11,) with everything fitted but the focal length, which is held."""
    factor = focal_px / theta[0]
    start = theta[1:].copy()
    start[2:4] *= (factor**2, factor**4)
    start[-1] *= factor

    def miss(rest: Array) -> Array:
        return _project(view, np.array([focal_px, *rest]))[0] - view.image.ravel()

    solved = optimize.least_squares(miss, start, x_scale=_sizes(theta)[1:], max_nfev=60)
    return np.array([focal_px, *solved.x])


def _figures(view: BoardView, theta: Array) -> dict[str, float]:
    left = _project(view, theta)[0] - view.image.ravel()
    rotation, _ = cv2.Rodrigues(theta[5:8])
    return {
        "focal_px": float(theta[0]),
        "rms_px": float(np.sqrt((left**2).sum() / len(view))),
        "distance_mm": float(theta[-1]),
        "tilt_deg": float(np.degrees(np.arccos(np.clip(abs(rotation[2, 2]), 0.0, 1.0)))),
    }


def corner_noise(fit: SaddleFit, lattice: Array, noise_DN: float) -> float:
    """Return the deviation per axis [px] that pixel noise gives to an independently detected corner, the median.

    Parameters
    ----------
    fit : SaddleFit
        Corners: contrast [DN] and blur [px].
    lattice : ndarray (n, 2, 2)
    noise_DN : float
        Of a pixel.

    Notes
    -----
    Cramer and Rao's bound for a shift along one axis: an edge of length L, a step 2a blurred by s, holds the
    information L 2 a^2/(sqrt(pi) s). L is the window's width, 0.84 squares and at most 26 px, less the sqrt(8/pi)
    sqrt(2) s near the corner where the other edge takes its contrast.
    """
    length = np.minimum(0.84 * np.sqrt(np.abs(np.linalg.det(lattice))), 26.0)
    sigma = fit.sigma.mean(axis=1)
    length = np.maximum(length - 4.0 / np.sqrt(np.pi) * sigma, 1.0)
    information = length * 2.0 * fit.contrast**2 / (np.sqrt(np.pi) * sigma)
    return float(noise_DN / np.sqrt(np.median(information)))
