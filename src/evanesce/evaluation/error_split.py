"""Split of an area error into scale, distortion, blur, threshold and noise, each switched off in turn.

Let A(S) be the area that the measurement reports when the sources S are absent. The share of a source is A(nothing left
out) - A(that source left out): what it adds in the presence of all others.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, get_args

import cv2
import numpy as np
from numpy.typing import NDArray

from evanesce.chain.simulate import Omission
from evanesce.core.states import Frame
from evanesce.evaluation.labels import RectifiedView, view_geometry
from evanesce.optics.projection import Projection

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

Source = Literal["scale", "distortion", "blur", "threshold", "noise"]
SOURCES: tuple[Source, ...] = get_args(Source)


@dataclass(frozen=True, kw_only=True)
class ErrorSplit:
    """An area error and its parts; ``sum(parts) + residual + interaction`` is the total.

    Attributes
    ----------
    true_area_mm2, total_mm2 : float
        Truth, and measured minus true area [mm^2].
    parts_mm2 : dict of str to float
        What each source adds while all others are present [mm^2].
    residual_mm2 : float
        Error that stays with every source left out: counting whole pixels, light that is not contact [mm^2].
    interaction_mm2 : float
        Joint effect of the sources: a low threshold displaces nothing without blur [mm^2].
    """

    true_area_mm2: float
    total_mm2: float
    parts_mm2: dict[Source, float]
    residual_mm2: float
    interaction_mm2: float

    def percent(self, value_mm2: float) -> float:
        """Return a part as percent of the true area, NaN where that is zero.

        Parameters
        ----------
        value_mm2 : float
            [mm^2].

        Returns
        -------
        float
            [%].
        """
        return 100.0 * value_mm2 / self.true_area_mm2 if self.true_area_mm2 > 0 else float("nan")

    def rows(self) -> list[tuple[str, float, float]]:
        """Return (name, mm^2, percent) of every part, then of the total.

        Returns
        -------
        list of tuple
        """
        named = [
            *self.parts_mm2.items(),
            ("residual", self.residual_mm2),
            ("interaction", self.interaction_mm2),
            ("total", self.total_mm2),
        ]
        return [(name, value, self.percent(value)) for name, value in named]


def split(measured_area: Callable[[frozenset[Source]], float], true_area_mm2: float) -> ErrorSplit:
    """Split an area error by leaving out each source in turn, and all at once.

    Parameters
    ----------
    measured_area : callable
        ``measured_area(without) -> mm^2``; :class:`MeasuredArea` makes one. Called seven times.
    true_area_mm2 : float
        [mm^2].

    Returns
    -------
    ErrorSplit
    """
    full = measured_area(frozenset())
    parts = {source: full - measured_area(frozenset({source})) for source in SOURCES}
    residual = measured_area(frozenset(SOURCES)) - true_area_mm2
    total = full - true_area_mm2
    return ErrorSplit(
        true_area_mm2=true_area_mm2,
        total_mm2=total,
        parts_mm2=parts,
        residual_mm2=residual,
        interaction_mm2=total - residual - sum(parts.values()),
    )


@dataclass(frozen=True)
class Viewing:
    """Mapping of frames into a measurement's view, with the true area of its pixels.

    Attributes
    ----------
    pixel_area : ndarray (rows, cols)
        True area of each pixel of the view [mm^2].
    maps : tuple of ndarray of float32, optional
        cv2.remap maps (x, y) from the frame into the view; None where the view is the frame.
    """

    pixel_area: Array
    maps: tuple[NDArray[np.float32], NDArray[np.float32]] | None = None

    @classmethod
    def of(cls, projection: Projection, view: RectifiedView | None = None) -> Viewing:
        """Return the viewing of a camera's frames through a rectified view, or as they are.

        Parameters
        ----------
        projection : Projection
            True geometry of the camera.
        view : RectifiedView, optional

        Returns
        -------
        Viewing
        """
        return cls(view_geometry(projection, view).pixel_area, None if view is None else view.maps())

    def look(self, image: NDArray[Any]) -> NDArray[Any]:
        """Return the view's picture of a frame's array.

        Parameters
        ----------
        image : ndarray
            Of the frame's size.

        Returns
        -------
        ndarray (rows, cols)
        """
        if self.maps is None:
            return image
        return np.asarray(cv2.remap(image, *self.maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE))


@dataclass(frozen=True, kw_only=True)
class MeasuredArea:
    """The area a measurement reports, with chosen sources of error left out.

    Attributes
    ----------
    expose : callable
        ``expose(without) -> Frame`` for any set of "distortion", "blur", "noise"
        (:func:`evanesce.chain.simulate.expose` with its plate light bound).
    segment : callable
        ``segment(image) -> mask``: the measurement's own segmentation of a view's 8-bit picture.
    mm2_per_px : float
        Calibrated scale [mm^2].
    viewing : Viewing
        By the measurement's own calibration.
    straight : Viewing
        Frames of the same camera without distortion, which need no undistortion.
    linear_light : callable, optional
        ``linear_light(frame) -> array`` proportional to irradiance, in which half a level is half the light; the raw
        numbers by default.
    """

    expose: Callable[[frozenset[Omission]], Frame]
    segment: Callable[[NDArray[np.uint8]], Mask]
    mm2_per_px: float
    viewing: Viewing
    straight: Viewing
    linear_light: Callable[[Frame], NDArray[Any]] | None = None

    def __call__(self, without: frozenset[Source]) -> float:
        """Return the area [mm^2]: scale left out counts true pixel areas, threshold left out takes the half level."""
        mask, viewing = self.mask(without)
        if "scale" in without:
            return float(viewing.pixel_area[mask].sum())
        return int(mask.sum()) * self.mm2_per_px

    def mask(self, without: frozenset[Source] = frozenset()) -> tuple[Mask, Viewing]:
        """Return the segmented mask and the view in which it lies.

        Parameters
        ----------
        without : frozenset of str
            Sources left out.

        Returns
        -------
        mask : ndarray of bool (rows, cols)
        viewing : Viewing
        """
        omitted: frozenset[Omission] = frozenset(part for part in get_args(Omission) if part in without)
        frame = self.expose(omitted)
        viewing = self.straight if "distortion" in without else self.viewing
        mask = self.segment(viewing.look(frame.data))
        if "threshold" in without:
            light = (self.linear_light or _raw)(frame)
            mask = half_level_mask(viewing.look(np.asarray(light, np.float32)), mask)
        return mask, viewing


def _raw(frame: Frame) -> NDArray[Any]:
    if frame.raw is None:
        raise ValueError("the half level needs linear light, and the frame carries no raw numbers")
    return frame.raw


def half_level_mask(
    light: NDArray[Any],
    mask: Mask,
    *,
    band_px: int = 8,
    window_px: int = 41,
    smooth_px: float = 1.0,
    passes: int = 2,
) -> Mask:
    """Move a mask's edge to where the light is halfway between the levels on its two sides.

    The edge of an even patch lies at half the level under any symmetric blur, so that a blur does not displace this
    threshold, even where the light is uneven.

    Parameters
    ----------
    light : ndarray (rows, cols)
        Linear in irradiance.
    mask : ndarray of bool (rows, cols)
        A first segmentation, its edge within ``band_px`` of the true one.
    band_px : int
        Half-width of the band around the edge that is decided anew; it must hold the blur.
    window_px : int
        Side of the window over which the levels inside and outside the band are averaged.
    smooth_px : float
        Standard deviation of a Gaussian against noise [px]; it moves no half level.
    passes : int
        Number of times that the band is decided, each time around the new edge.

    Returns
    -------
    ndarray of bool
        Unchanged where one side has no level in the window, as in a feature narrower than twice the band.
    """
    light = np.asarray(light, np.float64)
    if smooth_px > 0:
        light = cv2.GaussianBlur(light, (0, 0), smooth_px, borderType=cv2.BORDER_REPLICATE)
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * band_px + 1, 2 * band_px + 1))
    for _ in range(passes):
        inner = cv2.erode(mask.astype(np.uint8), disc, borderType=cv2.BORDER_REPLICATE).astype(bool)
        outer = ~cv2.dilate(mask.astype(np.uint8), disc, borderType=cv2.BORDER_REPLICATE).astype(bool)
        high, low = (_local_mean(light, side, window_px) for side in (inner, outer))
        halfway = (high + low) / 2
        decide = ~inner & ~outer & np.isfinite(halfway)
        mask = np.where(decide, light > halfway, mask)
    return mask


def _local_mean(light: Array, where: Mask, window_px: int) -> Array:
    """Return the mean of ``light`` over the True pixels of a window around each pixel; NaN where there is none."""
    weight = where.astype(np.float64)
    count = cv2.boxFilter(weight, cv2.CV_64F, (window_px, window_px), normalize=False)
    total = cv2.boxFilter(light * weight, cv2.CV_64F, (window_px, window_px), normalize=False)
    return np.divide(total, count, out=np.full(light.shape, np.nan), where=count > 0.5)
