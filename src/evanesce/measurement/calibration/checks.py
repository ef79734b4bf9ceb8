"""What a calibration says of itself: figures at odds with the drawing, and views that miss the fit or one another."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from evanesce.measurement.calibration.pinhole import PinholeFit
from evanesce.measurement.calibration.planar import BoardFit
from evanesce.measurement.calibration.points import BoardView
from evanesce.measurement.warnings import Warning

Array = NDArray[np.float64]

MAX_DEVIATION = 0.05
"""Relative deviation of focal length or distance from the rig's drawing above which a warning says so."""

ANISOTROPY = 0.01
"""Relative difference of the scales along two directions above which an area or a length is wrong by that much."""

MAX_RMS_PX = 0.1
"""RMS of left-out corners above which a warning says so: a sharp picture's corners are good to some hundredths."""

FAR_ABOVE = 3.0
"""Times the median view's RMS, above which a view is named."""

FAR_ABOVE_PX = 0.05
"""RMS below which no view is named, however good the others are [px]."""


def lines(view: BoardView) -> tuple[int, int]:
    """Return how many grid lines the corners of a view span, the longer side first.

    Parameters
    ----------
    view : BoardView

    Returns
    -------
    tuple of int
    """
    counts = sorted(len(np.unique(view.world[:, axis])) for axis in (0, 1))
    return counts[1], counts[0]


def view_warnings(
    fit: BoardFit,
    image_size: tuple[int, int],
    views: Sequence[BoardView],
    rms_px: Sequence[float],
    outliers: Sequence[NDArray[np.bool_]],
) -> list[Warning]:
    """Warn of views that miss the fit, that hold outliers, or that show unlike boards.

    Parameters
    ----------
    fit : BoardFit
    image_size : tuple of int
        (cols, rows).
    views : sequence of BoardView
        The distinct ones, with all their corners.
    rms_px : sequence of float
        Of each view's left-out corners [px].
    outliers : sequence of ndarray of bool (n,)
        Which corners of each view the fit leaves out; those that miss by less than ``MAX_RMS_PX`` are not reported.

    Returns
    -------
    list of Warning
    """
    found = []
    total = float(np.sqrt(np.average(np.square(rms_px), weights=[len(v) for v in views])))
    worst = int(np.argmax(rms_px))
    if total > MAX_RMS_PX:
        text = (
            f"the grid misses its corners by {total:.3f} px RMS (a sharp, flat board leaves some hundredths; limit "
            f"{MAX_RMS_PX} px), worst in view {views[worst].name} with {rms_px[worst]:.3f} px"
        )
        found.append(Warning("grid_rms_high", text))
    usual = float(np.median(rms_px))
    far = (
        [k for k, value in enumerate(rms_px) if value > max(FAR_ABOVE * usual, FAR_ABOVE_PX)] if len(views) > 2 else []
    )
    if far:
        named = ", ".join(f"{views[k].name} ({rms_px[k]:.3f} px)" for k in far)
        text = f"RMS far above that of the other views ({usual:.3f} px): {named}; look at these pictures"
        found.append(Warning("view_rms_high", text))
    gross = [
        int(np.count_nonzero(np.linalg.norm((view.image - fit.predict(k, view.world))[out], axis=1) > MAX_RMS_PX))
        for k, (view, out) in enumerate(zip(views, outliers, strict=True))
    ]
    if any(gross):
        named = ", ".join(f"{n} in {view.name}" for n, view in zip(gross, views, strict=True) if n)
        text = (
            f"{sum(gross)} corners miss the fit by more than {MAX_RMS_PX} px and 6 standard deviations of their view, "
            f"and are left out of it: {named} (a finger's edge, glare or a speck)"
        )
        found.append(Warning("outlying_corners", text))
    return found + _unlike_counts(fit, image_size, views)


def _unlike_counts(fit: BoardFit, image_size: tuple[int, int], views: Sequence[BoardView]) -> list[Warning]:
    """Compare the counts of the views in which the whole board is in sight: its border lies within the frame."""
    whole = [k for k, view in enumerate(views) if _whole(fit, image_size, k, view)]
    seen = [(lines(views[k]), len(views[k])) for k in whole]
    if len(set(seen)) < 2:
        return []
    (usual, most), _ = Counter(seen).most_common(1)[0]
    if all(side == usual for side, _ in seen):
        most = usual[0] * usual[1]  # a hidden corner is no reason to name the complete ones
    unlike = [
        f"{views[k].name} has {count} on {side[0]} x {side[1]} lines"
        for k, (side, count) in zip(whole, seen, strict=True)
        if (side, count) != (usual, most)
    ]
    if not unlike:
        return []
    text = (
        f"unlike counts between views of one board, {most} corners on {usual[0]} x {usual[1]} lines: "
        f"{', '.join(unlike)}; the board is covered there, in glare or out of focus, or it is another board"
    )
    return [Warning("unlike_counts", text)]


def _whole(fit: BoardFit, image_size: tuple[int, int], number: int, view: BoardView) -> bool:
    """Return whether a board one square larger than the corners all around would lie in the frame."""
    low, high = view.world.min(axis=0), view.world.max(axis=0)
    sides = np.array([np.median(np.diff(np.unique(view.world[:, axis]))) for axis in (0, 1)])
    low, high = low - sides, high + sides
    part = np.linspace(0, 1, 9)[:, None]
    ends = [low, np.array([high[0], low[1]]), high, np.array([low[0], high[1]])]
    edge = np.concatenate([a + part * (b - a) for a, b in zip(ends, [*ends[1:], ends[0]], strict=True)])
    place = fit.predict(number, edge)
    cols, rows = image_size
    return bool((place > 0).all() and (place < [cols - 1, rows - 1]).all())


def deviations(fit: BoardFit, focal_px: float | None, distance_mm: float | None) -> list[Warning]:
    """Compare focal length and distance with the rig's drawing.

    Parameters
    ----------
    fit : BoardFit
    focal_px, distance_mm : float or None
        Of the drawing [px, mm].

    Returns
    -------
    list of Warning
    """
    found = []
    if not isinstance(fit, PinholeFit):
        if distance_mm is not None:
            scale = np.sqrt(abs(np.linalg.det(jacobian(fit, 0))))
            implied = fit.camera_matrix[0, 0] / scale
            if abs(implied / distance_mm - 1) > MAX_DEVIATION:
                text = (
                    f"with the assumed focal length of {fit.camera_matrix[0, 0]:g} px the scale of {scale:.4g} px/mm "
                    f"puts the board at {implied:.4g} mm, the rig says {distance_mm:g} mm"
                )
                found.append(Warning("distance_at_odds", text))
        return found
    for name, i in (("fx", 0), ("fy", 1)):
        value, error = fit.camera_matrix[i, i], fit.standard_errors[name]
        if focal_px is not None and abs(value / focal_px - 1) > MAX_DEVIATION:
            text = (
                f"{name} = {value:.1f} +- {error:.1f} px, the rig says {focal_px:g} px "
                f"({100 * (value / focal_px - 1):+.1f} %)"
            )
            found.append(Warning("focal_length_at_odds", text))
            break
    far = float(np.median(fit.distances))
    if distance_mm is not None and abs(far / distance_mm - 1) > MAX_DEVIATION:
        text = (
            f"the boards lie at a median distance of {far:.4g} mm, the rig says {distance_mm:g} mm "
            f"({100 * (far / distance_mm - 1):+.1f} %)"
        )
        found.append(Warning("distance_at_odds", text))
    return found


def jacobian(fit: BoardFit, view: int) -> Array:
    """Return d(undistorted px)/d(mm) of a view at the principal point.

    Parameters
    ----------
    fit : BoardFit
    view : int
        Number of the view, from 0.

    Returns
    -------
    ndarray (2, 2)
        [px/mm]
    """
    homography = fit.homographies[view]
    at = np.linalg.solve(homography, [*fit.camera_matrix[:2, 2], 1.0])
    at = at[:2] / at[2]
    w = homography[2, :2] @ at + homography[2, 2]
    position = (homography[:2, :2] @ at + homography[:2, 2]) / w
    return np.asarray((homography[:2, :2] - np.outer(position, homography[2, :2])) / w)


def anisotropy(fit: BoardFit, view: BoardView) -> list[Warning]:
    """Warn where a millimetre is longer in one direction than in another, at the middle of the undistorted picture.

    Parameters
    ----------
    fit : BoardFit
    view : BoardView
        The first.

    Returns
    -------
    list of Warning
    """
    found = []
    fx, fy = fit.camera_matrix[0, 0], fit.camera_matrix[1, 1]
    if abs(fx / fy - 1) > ANISOTROPY:
        found.append(
            Warning(
                "anisotropic_scale", f"fx = {fx:.1f} px and fy = {fy:.1f} px differ by {100 * (fx / fy - 1):+.2f} %"
            )
        )
    if isinstance(fit, PinholeFit):
        return found  # a calibration board may be tilted by any angle
    high, low = np.linalg.svd(jacobian(fit, 0), compute_uv=False)
    if high / low - 1 > ANISOTROPY:
        along = np.linalg.norm(jacobian(fit, 0), axis=0)
        text = (
            f"view {view.name}: {high:.3f} px/mm along one direction, {low:.3f} px/mm across it "
            f"({100 * (high / low - 1):.2f} % apart; {along[0]:.3f} and {along[1]:.3f} px/mm along the board's axes): "
            "the camera is tilted, the print is stretched or pixels are not square"
        )
        found.append(Warning("anisotropic_scale", text))
    return found
