"""Warnings of a measurement, with the figures behind them."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field

SATURATED_SHARE = 0.01
"""Share of the mask at full scale above which brightness carries no information any more [1]."""

RATE_TOLERANCE = 0.01
"""Relative difference of two frame rates that still counts as the same: 29.97 against 30 is 0.1 %, 25 is 17 %."""

SCALE_TOLERANCE = 0.01
"""Relative difference of two areas per pixel that still counts as the same."""


@dataclass(frozen=True)
class Warning:
    """One warning.

    Attributes
    ----------
    code : str
        Stable name for scripts, for instance ``"saturation"``.
    text : str
        One sentence with the figures in it.
    """

    code: str
    text: str


@dataclass(frozen=True)
class FrameFigures:
    """Figures of one segmented frame, for :class:`FrameLog`.

    Attributes
    ----------
    index : int
    pixels : int
        Pixels of the mask.
    saturated_pixels : int
        Those of them with a channel at full scale (255).
    border_pixels : int
        Those of them that lie in the outermost rows and columns of the crop.
    dropped_blobs : int
        Dilated blobs below the minimum size.
    grey_range : tuple of float
        Smallest and greatest blurred grey level of the crop, 0 to 1.
    """

    index: int
    pixels: int
    saturated_pixels: int
    border_pixels: int
    dropped_blobs: int
    grey_range: tuple[float, float]


@dataclass
class _Worst:
    """Count of the frames that show something, with the first and the worst of them."""

    count: int = 0
    first: int = -1
    worst: int = -1
    figure: float = -math.inf

    def add(self, index: int, figure: float) -> None:
        if self.count == 0:
            self.first = index
        self.count += 1
        if figure > self.figure:
            self.worst, self.figure = index, figure


@dataclass
class FrameLog:
    """Collects figures frame by frame and sums them up in one warning per kind.

    Parameters
    ----------
    threshold : float or None
        The grey level that was used, 0 to 1; None of an estimator that uses none.
    """

    threshold: float | None
    frames: int = 0
    _saturated: _Worst = field(default_factory=_Worst)
    _border: _Worst = field(default_factory=_Worst)
    _empty: _Worst = field(default_factory=_Worst)
    _smallest: float = math.inf
    _greatest: float = -math.inf
    _dropped: int = 0

    def add(self, figures: FrameFigures) -> None:
        """Add one frame.

        Parameters
        ----------
        figures : FrameFigures
        """
        self.frames += 1
        if figures.pixels == 0:
            self._empty.add(figures.index, 0.0)
            self._dropped += figures.dropped_blobs
        else:
            share = figures.saturated_pixels / figures.pixels
            if share > SATURATED_SHARE:
                self._saturated.add(figures.index, share)
        if figures.border_pixels:
            self._border.add(figures.index, figures.border_pixels)
        self._smallest = min(self._smallest, figures.grey_range[0])
        self._greatest = max(self._greatest, figures.grey_range[1])

    def warnings(self) -> list[Warning]:
        """Return the warnings about the frames so far.

        Returns
        -------
        list of Warning
        """
        if not self.frames:
            return []
        found = [*self._threshold_warning()]
        if self._empty.count:
            at = "" if self.threshold is None else f" at threshold {self.threshold:g}"
            small = f"; {self._dropped} blob(s) were too small to count" if self._dropped else ""
            found.append(
                Warning(
                    "nothing_segmented",
                    f"no contact in {self._of_frames(self._empty)}{at}{small}",
                )
            )
        if self._saturated.count:
            found.append(
                Warning(
                    "saturation",
                    f"saturated pixels in {self._of_frames(self._saturated)}: "
                    f"{100 * self._saturated.figure:.1f} % of the mask at 255 in frame {self._saturated.worst} "
                    f"(more than {100 * SATURATED_SHARE:g} %)",
                )
            )
        if self._border.count:
            found.append(
                Warning(
                    "mask_touches_border",
                    f"the mask touches the border of the crop in {self._of_frames(self._border)}: "
                    f"{self._border.figure:.0f} border pixels in frame {self._border.worst}; the area is cut off there",
                )
            )
        return found

    def _of_frames(self, worst: _Worst) -> str:
        return f"{worst.count} of {self.frames} frame(s), first {worst.first}"

    def _threshold_warning(self) -> Iterable[Warning]:
        if self.threshold is None or self._smallest < self.threshold < self._greatest:
            return
        if self.threshold >= self._greatest:
            where = "no pixel is brighter"
        else:
            where = "every pixel is brighter"
        yield Warning(
            "threshold_outside_histogram",
            f"threshold {self.threshold:g} lies outside the grey levels of all frames, "
            f"{self._smallest:.4f} to {self._greatest:.4f}: {where}",
        )


@dataclass
class EdgeLog:
    """Counts the frames in which saturation hides the edge from the refined estimator.

    ``blur_known`` says whether the calibration holds the camera's blur.
    """

    blur_known: bool = True
    count: int = 0
    modelled: int = 0
    first: int = -1
    coloured: int = 0
    merged: int = 0

    def add(self, index: int, unseen: str, colour_unread: bool = False, unresolved: bool = False) -> None:
        """Add one frame; see :class:`~evanesce.measurement.refined.result.RefinedArea` for ``unseen``.

        Parameters
        ----------
        index : int
            Number of the frame.
        unseen : str
        colour_unread, unresolved : bool
        """
        self.coloured += colour_unread
        self.merged += unresolved
        if not unseen:
            return
        if self.count == 0:
            self.first = index
        self.count += 1
        self.modelled += unseen == "modelled"

    def warnings(self, frames: int) -> list[Warning]:
        """Return the warnings about so many frames.

        Parameters
        ----------
        frames : int

        Returns
        -------
        list of Warning
        """
        found = []
        if self.coloured:
            text = (
                f"one channel is clipped and others are not in {self.coloured} of {frames} frame(s), and nothing says "
                "what the others show: give --camera-model SCENE.toml or a CSV level,red,green,blue"
            )
            found.append(Warning("camera_model_missing", text))
        if self.merged:
            text = (
                f"ridges or grooves are narrower than the blur resolves in {self.merged} of {frames} frame(s): their "
                "areas may be wrong by far; focus, or come closer"
            )
            found.append(Warning("ridges_not_resolved", text))
        if not self.count:
            return found
        scattered = (
            f", in {self.modelled} of them under scattered light as well, where a model fills it in"
            if self.modelled
            else ""
        )
        text = (
            f"the contact's edge is at full scale in {self.count} of {frames} frame(s), first {self.first}{scattered}: "
            f"its interval is wider; expose less"
        )
        found.append(Warning("saturated_edge", text))
        if not self.blur_known:
            found.append(
                Warning(
                    "blur_not_known",
                    "the calibration holds no blur of the camera, which a saturated edge needs: a nominal one is used "
                    "and intervals are wider; calibrate from pictures of the board, or state blur_px in the file",
                )
            )
        return found


def frame_rate_warning(stated: float | None, given: float | None, where: str) -> Warning | None:
    """Compare the frame rate a file states with the one the user gives.

    Parameters
    ----------
    stated : float or None
        Of the file [Hz]; None where it states none.
    given : float or None
        Of the command line [Hz].
    where : str
        Name of the file or folder.

    Returns
    -------
    Warning or None
    """
    if stated is None and given is None:
        return Warning("frame_rate_missing", f"{where} states no frame rate and none was given: times are unknown")
    if stated is None or given is None or abs(stated / given - 1) <= RATE_TOLERANCE:
        return None
    return Warning(
        "frame_rate_at_odds",
        f"{where} states {stated:g} Hz, the command line {given:g} Hz: the command line is used, "
        f"and by the file's own time stamps every time would be {given / stated:.3f} times as long",
    )


def scale_warning(stored: float | None, given: float | None) -> Warning | None:
    """Compare the area of a pixel in a calibration with the one the user gives [mm^2]; the latter is used.

    Parameters
    ----------
    stored, given : float or None
        Area of a pixel [mm^2].

    Returns
    -------
    Warning or None
    """
    if stored is None or given is None or abs(stored / given - 1) <= SCALE_TOLERANCE:
        return None
    return Warning(
        "scale_at_odds",
        f"the calibration states {stored:g} mm^2 per pixel, the command line {given:g}: "
        f"the command line is used ({100 * (given / stored - 1):+.1f} % in area)",
    )
