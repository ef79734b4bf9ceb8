"""Pictures of a measurement: mask on frame, grey level under the mask, area against time, histogram."""

from __future__ import annotations

import math
import os
import tempfile
from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import av
import cv2
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from evanesce.core.errors import WorkError
from evanesce.measurement.force import AreaForce
from evanesce.measurement.reference.area import AreaRow, Measured
from evanesce.measurement.reference.segment import blurred_grey, grey

CONTOUR_RGB = (255, 64, 32)
DOTS_PER_INCH = 110


def overlay(view: NDArray[np.uint8], mask: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """Return the frame in RGB with the mask's outline painted on its innermost pixels.

    Parameters
    ----------
    view : ndarray of uint8, (rows, cols) or (rows, cols, 3)
    mask : ndarray of bool (rows, cols)

    Returns
    -------
    ndarray of uint8 (rows, cols, 3)
    """
    painted = np.repeat(view[..., None], 3, axis=2) if view.ndim == 2 else view.copy()
    plain = mask.view(np.uint8)
    inner = cv2.erode(plain, np.ones((3, 3), np.uint8), borderType=cv2.BORDER_CONSTANT, borderValue=0)
    painted[(plain != 0) & (inner == 0)] = CONTOUR_RGB
    return painted


def intensity_map(measured: Measured) -> NDArray[np.float64]:
    """Return the grey level 0 to 1 under the surviving dilated blobs, NaN elsewhere.

    The thesis calls this pressure. It has no unit: no calibration from grey level to pressure exists.

    Parameters
    ----------
    measured : Measured

    Returns
    -------
    ndarray (rows, cols)
    """
    return np.where(measured.segmentation.dilated, grey(measured.view), np.nan)


def _axes(title: str, size: tuple[float, float] = (7.0, 5.0)) -> tuple[Figure, Any]:
    figure = Figure(figsize=size, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    axes.set_title(title, fontsize=10)
    return figure, axes


def _image_axes(measured: Measured, mm2_per_px: float, title: str) -> tuple[Figure, Any, tuple[float, ...]]:
    """Return axes in mm over the crop, y down, with the first pixel's corner at the origin."""
    rows, cols = measured.view.shape[:2]
    pitch = math.sqrt(mm2_per_px)
    figure, axes = _axes(title, (7.0, max(2.5, 7.0 * min(rows / cols, 1.4))))
    axes.set_xlabel("x [mm]")
    axes.set_ylabel("y [mm]")
    return figure, axes, (0, cols * pitch, rows * pitch, 0)


def _label(measured: Measured) -> str:
    e = measured.estimate
    time = "" if math.isnan(e.time) else f", {e.time:.3f} s"
    return f"frame {e.index}{time}: {e.area:.3f} mm² ({e.pixels} px)"


def overlay_figure(measured: Measured, mm2_per_px: float) -> Figure:
    """Return the frame with the mask's outline, axes in mm.

    Parameters
    ----------
    measured : Measured
    mm2_per_px : float
        [mm^2].

    Returns
    -------
    Figure
    """
    figure, axes, extent = _image_axes(measured, mm2_per_px, _label(measured))
    axes.imshow(overlay(measured.view, measured.segmentation.mask), extent=extent, interpolation="nearest")
    return figure


def intensity_figure(measured: Measured, mm2_per_px: float) -> Figure:
    """Return the intensity map with its colour bar, axes in mm.

    Parameters
    ----------
    measured : Measured
    mm2_per_px : float
        [mm^2].

    Returns
    -------
    Figure
    """
    figure, axes, extent = _image_axes(measured, mm2_per_px, "grey level under the dilated mask, " + _label(measured))
    axes.set_facecolor("black")
    shown = axes.imshow(intensity_map(measured), extent=extent, cmap="viridis", vmin=0, vmax=1, interpolation="nearest")
    figure.colorbar(shown, ax=axes, label="grey level [1]")
    return figure


def histogram_figure(measured: Measured, threshold: float, blur: float) -> Figure:
    """Return the histogram of blurred grey levels with the threshold, by which the thesis chose it.

    Parameters
    ----------
    measured : Measured
    threshold : float
        Grey level, 0 to 1.
    blur : float
        Standard deviation of the Gaussian [px].

    Returns
    -------
    Figure
    """
    figure, axes = _axes(f"blurred grey levels, {_label(measured)}")
    levels = blurred_grey(measured.view, blur)
    axes.hist(levels.ravel(), bins=256, range=(0, 1), log=True, color="0.45")
    axes.axvline(threshold, color="tab:red", label=f"threshold {threshold:g}")
    axes.set_xlabel("grey level [1]")
    axes.set_ylabel("pixels")
    axes.set_xlim(0, 1)
    axes.legend(loc="upper right")
    return figure


def area_figure(rows: Sequence[AreaRow], estimator: str = "reference segmentation") -> Figure:
    """Return area against time with its interval, or against the frame's index where times are unknown.

    Parameters
    ----------
    rows : sequence of AreaRow
    estimator : str
        Name of the one that made the areas.

    Returns
    -------
    Figure
    """
    figure, axes = _axes(f"contact area by the {estimator}", (7.0, 4.0))
    timed = not any(math.isnan(row.time_s) for row in rows)
    x = [row.time_s if timed else row.index for row in rows]
    axes.plot(x, [row.area_mm2 for row in rows], "o-", markersize=3, linewidth=1, label=estimator)
    low, high = ([getattr(row, name) for row in rows] for name in ("area_low_mm2", "area_high_mm2"))
    if not all(math.isnan(value) for value in low):
        axes.fill_between(x, low, high, alpha=0.25, linewidth=0, label="95 % interval of the contact's area")
    beside = [row.reference_mm2 for row in rows]
    if not all(math.isnan(value) for value in beside):
        axes.plot(x, beside, ":", color="0.4", linewidth=1.2, label="reference segmentation")
    axes.set_xlabel("time [s]" if timed else "frame index (frame rate unknown)")
    axes.set_ylabel("contact area [mm²]")
    axes.set_ylim(bottom=0)
    axes.grid(alpha=0.3)
    axes.legend(fontsize=8)
    return figure


def threshold_figure(curve: Sequence[dict[str, float]], used: float, half: float, index: int) -> Figure:
    """Return the area that the reference segmentation counts against its threshold, in one frame.

    Parameters
    ----------
    curve : sequence of dict
        Of :func:`~evanesce.measurement.levels.threshold_curve`.
    used, half : float
        Threshold that was used and the one half-way between ground and contact [1].
    index : int
        Of the frame.

    Returns
    -------
    Figure
    """
    figure, axes = _axes(f"area by the reference segmentation, frame {index}", (7.0, 4.0))
    axes.plot([point["threshold"] for point in curve], [point["area_mm2"] for point in curve], "o-", markersize=3)
    axes.axvline(used, color="tab:red", label=f"threshold {used:.3g}")
    axes.axvline(half, color="0.4", linestyle="--", label=f"half-way {half:.3f}")
    axes.set_xlabel("threshold, grey level [1]")
    axes.set_ylabel("contact area [mm²]")
    axes.grid(alpha=0.3)
    axes.legend(fontsize=8)
    return figure


def force_figure(joined: AreaForce, estimator: str) -> Figure:
    """Return area against force with intervals and both fitted laws.

    Parameters
    ----------
    joined : AreaForce
    estimator : str
        Name of the one that made the areas.

    Returns
    -------
    Figure
    """
    figure, axes = _axes(f"contact area by the {estimator} against force", (7.0, 4.5))
    area = np.array([row.area_mm2 for row in joined.rows])
    low, high = (np.array([getattr(row, name) for row in joined.rows]) for name in ("area_low_mm2", "area_high_mm2"))
    bars = np.clip(np.nan_to_num(np.stack([area - low, high - area])), 0.0, None)
    axes.errorbar(joined.force_N, area, yerr=bars, fmt=".", color="0.3", elinewidth=0.6, label="frames, 95 % interval")
    force = np.linspace(0.0, max(max(joined.force_N), 1e-9), 200)
    for fit, name, style in ((joined.hertz, "Hertz", "-"), (joined.power, "power law", "--")):
        text = f"{name}: {fit.factor:.3g} F^{fit.exponent:.3f}"
        axes.plot(force, fit.factor * force**fit.exponent, style, label=text)
    axes.set_xlabel("force [N]")
    axes.set_ylabel("contact area [mm²]")
    axes.grid(alpha=0.3)
    axes.legend(fontsize=8)
    return figure


def save_figure(figure: Figure, path: Path) -> None:
    """Write a figure as PNG, whole or not at all.

    Parameters
    ----------
    figure : Figure
    path : Path

    Raises
    ------
    WorkError
        If it cannot be written.
    """
    handle, name = _temporary(path)
    try:
        with os.fdopen(handle, "wb") as stream:
            figure.savefig(stream, format="png", dpi=DOTS_PER_INCH, metadata={"Software": "evanesce"})
        _publish(name, path)
    except OSError as error:
        raise WorkError(f"{path}: cannot write: {error.strerror}") from None
    finally:
        Path(name).unlink(missing_ok=True)


def _temporary(path: Path) -> tuple[int, str]:
    try:
        return tempfile.mkstemp(dir=path.parent, prefix="." + path.stem, suffix=path.suffix)
    except OSError as error:
        raise WorkError(f"{path}: cannot write: {error.strerror}") from None


def _publish(name: str, path: Path) -> None:
    umask = os.umask(0)
    os.umask(umask)
    os.chmod(name, 0o666 & ~umask)
    os.replace(name, path)


class OverlayVideo:
    """A video of overlays, written frame by frame; it appears under its name when it is whole.

    Parameters
    ----------
    path : Path
        Ends in .mp4 (H.264, as any player takes it; not for measuring again).
    frame_rate : float
        [Hz].
    """

    def __init__(self, path: Path, frame_rate: float) -> None:
        self.path, self.frame_rate = path, frame_rate
        handle, self._name = _temporary(path)
        os.close(handle)
        self._container: Any = None
        self._stream: Any = None

    def __enter__(self) -> Self:
        return self

    def add(self, picture: NDArray[np.uint8]) -> None:
        """Append an RGB picture (rows, cols, 3); an odd last row or column is left out, as H.264 needs even sizes.

        Parameters
        ----------
        picture : ndarray of uint8 (rows, cols, 3)
            RGB.
        """
        rows, cols = (max(n // 2 * 2, 2) for n in picture.shape[:2])
        if self._container is None:
            self._container = av.open(self._name, "w")
            rate = Fraction(self.frame_rate).limit_denominator(1001)  # holds 30000/1001 Hz and the like
            self._stream = self._container.add_stream("libx264", rate=rate, options={"preset": "veryfast"})
            self._stream.width, self._stream.height, self._stream.pix_fmt = cols, rows, "yuv420p"
        padded = np.pad(picture, ((0, max(rows - picture.shape[0], 0)), (0, max(cols - picture.shape[1], 0)), (0, 0)))
        frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(padded[:rows, :cols]), format="rgb24")
        self._container.mux(self._stream.encode(frame))

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            if self._container is not None:
                if kind is None:
                    self._container.mux(self._stream.encode())
                self._container.close()
                if kind is None:
                    _publish(self._name, self.path)
        except (av.FFmpegError, OSError) as failure:
            raise WorkError(f"{self.path}: cannot write: {failure.strerror}") from None
        finally:
            Path(self._name).unlink(missing_ok=True)
