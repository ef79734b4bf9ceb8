"""Calibrate a camera from checkerboard corners, with warnings and held-out residuals.

Two fits are tried: the full camera where the boards are tilted enough to determine the focal length, else the planar
rectification with an assumed one. Either is evaluated on held-out corners.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.core import rng
from evanesce.core.errors import InputError, WorkError
from evanesce.measurement.calibration.checks import anisotropy, deviations, lines, view_warnings
from evanesce.measurement.calibration.distinct import distinct_views
from evanesce.measurement.calibration.local_scale import ScaleMap, local_scale
from evanesce.measurement.calibration.model import Calibration
from evanesce.measurement.calibration.outliers import chosen, without_outliers
from evanesce.measurement.calibration.pinhole import PinholeFit, fit_pinhole
from evanesce.measurement.calibration.planar import MODELS, BoardFit, fit_planar
from evanesce.measurement.calibration.points import BoardView
from evanesce.measurement.warnings import Warning

Array = NDArray[np.float64]

MIN_TILT_DEG = 5.0
"""Spread of the boards' normals below which the focal length is not accepted, whatever its standard error."""

MAX_FOCAL_ERROR = 0.05
"""Relative standard error of the focal length above which it is not accepted."""

MIN_CORNERS = 16
MIN_HELD_OUT = 24


@dataclass(frozen=True)
class Calibrated:
    """A calibration with its evidence.

    Attributes
    ----------
    calibration : Calibration
        Without the square card's area per pixel.
    fit : BoardFit
        From all corners of the distinct views.
    views : list of BoardView
        As given.
    distinct : list of BoardView
        Those that were used: one of each set of identical views, without outliers.
    numbers : list of int
        Of each distinct view, its number in ``views`` from 0.
    outliers : list of ndarray (n, 2)
        Of each distinct view: (x, y) of the corners left out [px]; see :mod:`.outliers`.
    held_out : list of ndarray (n, 2)
        Of each distinct view: corner found minus corner predicted by a fit without it [px of the picture].
    held_out_straight : list of ndarray (n, 2)
        The same after undistortion: corner minus straight, even grid [px of the undistorted picture].
    flat : int
        Number of the distinct view taken to lie on the glass: the one stated, else the one whose scale changes least
        across it.
    scale, scale_undistorted : ScaleMap
        Of that view, in the picture and after undistortion.
    focal_given : bool
        Whether the rig's drawing states a focal length.
    warnings : list of Warning
    """

    calibration: Calibration
    fit: BoardFit
    views: list[BoardView]
    distinct: list[BoardView]
    numbers: list[int]
    outliers: list[Array]
    held_out: list[Array]
    held_out_straight: list[Array]
    flat: int
    scale: ScaleMap
    scale_undistorted: ScaleMap
    focal_given: bool
    warnings: list[Warning]

    @property
    def grid_rms_px(self) -> float:
        """RMS distance of left-out corners from the fitted grid [px of the picture]."""
        return rms(np.concatenate(self.held_out))

    @property
    def straight_rms_px(self) -> float:
        """RMS distance of left-out corners from a straight, even grid [px of the undistorted picture]."""
        return rms(np.concatenate(self.held_out_straight))

    @property
    def view_rms_px(self) -> list[float]:
        """RMS distance of left-out corners from the fitted grid, of each distinct view [px of the picture]."""
        return [rms(residual) for residual in self.held_out]

    @property
    def worst(self) -> int:
        """Number of the distinct view with the greatest RMS, from 0."""
        return int(np.argmax(self.view_rms_px))


def rms(residual: Array) -> float:
    """Return the root-mean-square length of residual vectors (n, 2).

    Parameters
    ----------
    residual : ndarray (n, 2)

    Returns
    -------
    float
        In the same unit.
    """
    return float(np.sqrt((residual**2).sum(axis=1).mean()))


def calibrate(
    views: Sequence[BoardView],
    image_size: tuple[int, int],
    *,
    model: str = "radial2",
    expect_focal_px: float | None = None,
    expect_distance_mm: float | None = None,
    on_glass: int | None = None,
) -> Calibrated:
    """Calibrate a camera from views of a flat board.

    Parameters
    ----------
    views : sequence of BoardView
    image_size : tuple of int
        (cols, rows).
    model : {"radial2", "radial3", "full"}
        Two radial terms as in the thesis, three, or three with the tangential ones.
    expect_focal_px, expect_distance_mm : float, optional
        Figures of the rig's drawing, to compare with; the focal length is also the one assumed where none can be found
        (else the longer side of the frame).
    on_glass : int, optional
        Number of the view that lay on the glass, from 0.

    Returns
    -------
    Calibrated

    Raises
    ------
    InputError
        If corners lie outside the frame or are too few.
    WorkError
        If the corners determine no fit.
    """
    views = list(views)
    _check(views, image_size)
    assumed = expect_focal_px if expect_focal_px is not None else float(max(image_size))
    distinct, warnings = distinct_views(views)
    numbers = [next(k for k, view in enumerate(views) if view is one) for one in distinct]
    given = distinct
    fit, kept, found = _fit(given, image_size, model, assumed)
    distinct = [chosen(view, which) for view, which in zip(given, kept, strict=True)]
    warnings += found
    residuals, found = _left_out(distinct, fit, image_size, model, assumed)
    warnings += found
    warnings += [*deviations(fit, expect_focal_px, expect_distance_mm), *anisotropy(fit, distinct[0])]
    left_out = [~which for which in kept]
    warnings += view_warnings(fit, image_size, given, [rms(residual) for residual in residuals[0]], left_out)
    flat = _flat(fit, views, distinct, numbers, on_glass)
    straight = BoardView(distinct[flat].name, distinct[flat].world, fit.undistort(distinct[flat].image))
    return Calibrated(
        calibration=Calibration(image_size=image_size, camera_matrix=fit.camera_matrix, distortion=fit.distortion),
        fit=fit,
        views=views,
        distinct=distinct,
        numbers=numbers,
        outliers=[view.image[out] for view, out in zip(given, left_out, strict=True)],
        held_out=residuals[0],
        held_out_straight=residuals[1],
        flat=flat,
        scale=local_scale(distinct[flat]),
        scale_undistorted=local_scale(straight),
        focal_given=expect_focal_px is not None,
        warnings=warnings,
    )


def _flat(
    fit: BoardFit, views: list[BoardView], distinct: list[BoardView], numbers: list[int], on_glass: int | None
) -> int:
    """Return the number of the distinct view that lay on the glass, or is repeated by the one that did."""
    if on_glass is None:
        return int(np.argmin([fit.depth_spread(k, view.world) for k, view in enumerate(distinct)]))
    if on_glass in numbers:
        return numbers.index(on_glass)
    place = views[on_glass].image.mean(axis=0)
    return int(np.argmin([np.linalg.norm(views[k].image.mean(axis=0) - place) for k in numbers]))


def _check(views: list[BoardView], image_size: tuple[int, int]) -> None:
    if not views:
        raise InputError("no view of a board", allowed="at least one")
    cols, rows = image_size
    for view in views:
        if len(view) < MIN_CORNERS:
            raise InputError(f"{len(view)} corners", key=f"view {view.name}", allowed=f"at least {MIN_CORNERS}")
        outside = (view.image < -0.5).any(axis=1) | (view.image[:, 0] > cols - 0.5) | (view.image[:, 1] > rows - 0.5)
        if outside.any():
            x, y = view.image[np.argmax(outside)]
            raise InputError(
                f"corner at ({x:.1f}, {y:.1f}) px of view {view.name} lies outside the frame",
                key="image size",
                allowed=f"corners within {cols} x {rows} px: give the size of the pictures the corners were found in",
            )


def _fit(
    views: list[BoardView], image_size: tuple[int, int], model: str, assumed: float
) -> tuple[BoardFit, list[NDArray[np.bool_]], list[Warning]]:
    """Return the full fit if the views identify the focal length, else the planar one and why; which corners count."""
    if len(views) == 1:
        reason = "1 distinct view of a flat board"
    else:
        try:
            full, kept = without_outliers(views, lambda some: fit_pinhole(some, image_size, model))
        except WorkError as error:
            reason = f"{len(views)} distinct views ({error})"
        else:
            if full.tilt_spread_deg >= MIN_TILT_DEG and full.focal_error <= MAX_FOCAL_ERROR:
                return full, kept, []
            reason = (
                f"{len(views)} distinct views whose boards are tilted by at most {full.tilt_spread_deg:.2g} deg "
                f"against one another (needed: {MIN_TILT_DEG:g} deg), with a standard error of "
                f"{100 * full.focal_error:.2g} % of the focal length (allowed: {100 * MAX_FOCAL_ERROR:g} %)"
            )
    text = (
        f"{reason}: focal length, distance and tilt cannot be identified; the distortion is fitted with an assumed "
        f"focal length of {assumed:g} px, on which the undistorted picture does not depend"
    )
    planar, kept = without_outliers(views, lambda some: fit_planar(some, image_size, assumed, model))
    return planar, kept, [Warning("views_too_alike", text)]


def _residuals(views: list[BoardView], fit: BoardFit) -> tuple[list[Array], list[Array]]:
    """Return found minus predicted corners of each view, in the picture and in the undistorted one [px]."""
    raw = [v.image - fit.predict(k, v.world) for k, v in enumerate(views)]
    return raw, [fit.undistort(v.image) - fit.straight(k, v.world) for k, v in enumerate(views)]


def _left_out(
    views: list[BoardView], fit: BoardFit, image_size: tuple[int, int], model: str, assumed: float
) -> tuple[tuple[list[Array], list[Array]], list[Warning]]:
    """Return the residuals of corners left out of a fit, or the fit's own where there are too few, with a warning."""

    def refit(half: list[BoardView]) -> BoardFit:
        full = isinstance(fit, PinholeFit)
        return fit_pinhole(half, image_size, model) if full else fit_planar(half, image_size, assumed, model)

    residuals = _held_out(views, refit)
    if residuals is not None:
        return residuals, []
    text = f"{min(map(len, views))} corners in a view are too few to leave half out: residuals are the fit's own"
    return _residuals(views, fit), [Warning("few_corners", text)]


def _held_out(
    views: list[BoardView], refit: Callable[[list[BoardView]], BoardFit]
) -> tuple[list[Array], list[Array]] | None:
    """Fit each random half of the corners and evaluate it on the other; None where there are too few."""
    if min(map(len, views)) < MIN_HELD_OUT:
        return None
    halves = [rng.generator(0, "calibrate", "halves", k).permutation(len(v)) % 2 for k, v in enumerate(views)]
    raw = [np.empty((len(v), 2)) for v in views]
    straight = [np.empty((len(v), 2)) for v in views]
    for part in (0, 1):
        kept, left = ([(h == part) == used for h in halves] for used in (True, False))
        try:
            fit = refit([chosen(v, k) for v, k in zip(views, kept, strict=True)])
        except WorkError:
            return None
        own_raw, own_straight = _residuals([chosen(v, k) for v, k in zip(views, left, strict=True)], fit)
        for k, out in enumerate(left):
            raw[k][out], straight[k][out] = own_raw[k], own_straight[k]
    return raw, straight


def report(result: Calibrated) -> dict[str, Any]:
    """Return JSON-able figures of a calibration, for :attr:`Calibration.details`.

    Parameters
    ----------
    result : Calibrated

    Returns
    -------
    dict
        Units in the keys.
    """
    corners = [
        {
            "view": number,
            "world_x_mm": float(w[0]),
            "world_y_mm": float(w[1]),
            "image_x_px": float(p[0]),
            "image_y_px": float(p[1]),
        }
        for number, view in enumerate(result.views, start=1)
        for w, p in zip(view.world, view.image, strict=True)
    ]
    fit, straight = result.fit, result.scale_undistorted.summary()
    return {
        "model": next(m for m, names in MODELS.items() if set(names) == _free(fit)),
        "focal_length_identified": isinstance(fit, PinholeFit),
        "focal_length_given": result.focal_given,
        "standard_errors": fit.standard_errors,
        "grid_rms_px": result.grid_rms_px,
        "grid_rms_undistorted_px": result.straight_rms_px,
        "grid_rms_fit_px": rms(
            np.concatenate([fit.predict(k, v.world) - v.image for k, v in enumerate(result.distinct)])
        ),
        "flat_view": result.distinct[result.flat].name,
        "flat_view_depth_spread": fit.depth_spread(result.flat, result.distinct[result.flat].world),
        "scale_px_per_mm2": result.scale.summary(),
        "scale_undistorted_px_per_mm2": straight,
        "scale_spread_undistorted": (straight["max"] - straight["min"]) / (2 * straight["median"]),
        "views": _view_rows(result),
        "distinct_views": [view.name for view in result.distinct],
        "warnings": [{"code": w.code, "text": w.text} for w in result.warnings],
        "corners": corners,
    }


def _view_rows(result: Calibrated) -> list[dict[str, Any]]:
    """Return name, count, lines, corners left out and RMS [px] of each view; a repeated view has no RMS of its own."""
    rows: list[dict[str, Any]] = []
    for number, view in enumerate(result.views):
        row: dict[str, Any] = {"view": number + 1, "name": view.name, "corners": len(view), "lines": list(lines(view))}
        if number in result.numbers:
            k = result.numbers.index(number)
            row |= {"repeated": False, "left_out": len(result.outliers[k]), "rms_px": rms(result.held_out[k])}
        else:
            row |= {"repeated": True, "left_out": None, "rms_px": None}
        rows.append(row)
    return rows


def _free(fit: BoardFit) -> set[str]:
    return {name for name in fit.standard_errors if name[0] in "kp"}
