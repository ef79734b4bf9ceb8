"""Encode results for a browser: JPEG bytes, SVG and HTML text, figures with their units."""

from __future__ import annotations

import html
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from evanesce.live import pictures
from evanesce.live.charts import histogram_svg, profile_svg
from evanesce.live.engine import Shown
from evanesce.live.own import OwnMeasured

FRAME_COLS = 720
"""Width of the pictures that are sent [px]: on a page of 1680 px they are displayed 560 px wide."""


@dataclass(frozen=True)
class Presented:
    """Content for the browser.

    Attributes
    ----------
    images : dict of bytes
        JPEG by name: ``frame`` and ``overlay``, or ``own`` and ``own_mask``.
    markup : dict of str
        SVG or HTML by the name of its element.
    note : str
        Why it took long; else empty.
    """

    images: dict[str, bytes]
    markup: dict[str, str]
    note: str


def present(shown: Shown, own: OwnMeasured | None = None) -> Presented:
    """Return pictures, charts and figures of a setting, with the histogram of an own frame."""
    window, along = shown.window, shown.controls.along
    view, mask, truth = (
        pictures.crop_of(window, image) for image in (shown.view, shown.mask, shown.truth >= np.float32(0.5))
    )
    images = {
        "frame": pictures.jpeg(pictures.shrunk(shown.frame, FRAME_COLS)),
        "overlay": pictures.jpeg(pictures.shrunk(pictures.overlay(view, mask, truth), FRAME_COLS)),
    }
    rows, cols = pictures.size_of(window)
    reach = 0.5 * (cols if along == "x" else rows) * shown.mm_per_px
    markup = {
        "frame": pictures.frame_svg(shown.frame.shape, _border(shown), 1.0 / shown.scene.camera.scale_px_per_mm),
        "overlay": pictures.window_svg(window, shown.profile.line_px, along, shown.mm_per_px),
        "histogram": histogram_svg(shown.histogram, shown.controls.threshold, own.histogram if own else None),
        "profile": profile_svg(shown.profile, shown.controls.threshold, reach),
        "figures": figures_html(shown),
    }
    return Presented(images, markup, shown.note)


def present_own(own: OwnMeasured) -> Presented:
    """Return pictures and figures of an own frame."""
    laid = pictures.overlay(own.frame.view, own.mask, own.mask)
    images = {
        "own": pictures.jpeg(pictures.shrunk(own.frame.view, FRAME_COLS)),
        "own_mask": pictures.jpeg(pictures.shrunk(laid, FRAME_COLS)),
    }
    return Presented(images, {"own": own_html(own)}, "")


def _border(shown: Shown) -> NDArray[np.float64]:
    """Return the enlarged window's border in the frame, (x, y) [px], with lens distortion."""
    window = shown.window
    rows, cols = pictures.size_of(window)
    side = np.linspace(0.0, 1.0, 9)
    around_x = np.concatenate([side, np.ones(9), side[::-1], np.zeros(9)]) * cols + window.c0
    around_y = np.concatenate([np.zeros(9), side, np.ones(9), side[::-1]]) * rows + window.r0
    u, v = shown.rectified.to_frame(around_x, around_y)
    return np.stack([u, v], axis=-1)


# --- figures ---------------------------------------------------------------------------------------------------------


def figures_html(shown: Shown) -> str:
    """Return the table of figures; ``data-value`` holds each value with all its digits."""
    f = shown.figures
    percent = "not defined: no contact" if math.isnan(f.error_percent) else f"{_signed(f.error_percent, 2)} %"
    rows = [
        ("Area", "measured", "area_mm2", f.area_mm2, f"{f.area_mm2:.3f} mm²"),
        ("", "true", "true_mm2", f.true_mm2, f"{f.true_mm2:.3f} mm²"),
        ("", "error", "error_mm2", f.error_mm2, f"{_signed(f.error_mm2, 3)} mm²"),
        ("", "", "error_percent", f.error_percent, percent),
        ("Mask", "agrees", "agree_mm2", f.agree_mm2, f"{f.agree_mm2:.3f} mm²"),
        ("", "missed", "missed_mm2", f.missed_mm2, f"{f.missed_mm2:.3f} mm²"),
        ("", "false", "false_mm2", f.false_mm2, f"{f.false_mm2:.3f} mm²"),
        ("", "overlap", "overlap", 100 * f.overlap, f"{100 * f.overlap:.1f} %"),
        ("Frame", "brightest", "brightest_DN", f.brightest_DN, f"{f.brightest_DN} DN"),
        ("", "saturated", "saturated_percent", f.saturated_percent, f"{f.saturated_percent:.1f} %"),
        ("", "blobs", "blobs", f.blobs, f"{f.blobs}"),
    ]
    return _table(rows)


def own_html(own: OwnMeasured) -> str:
    """Return the table of figures of an own frame."""
    rows_px, cols_px = own.mask.shape
    area = "needs the area of a pixel" if own.area_mm2 is None else f"{own.area_mm2:.3f} mm²"
    rows: list[tuple[str, str, str, float | None, str]] = [
        ("", "area", "own_area_mm2", own.area_mm2, area),
        ("", "pixels", "own_pixels", own.pixels, f"{own.pixels} px"),
        ("", "blobs", "own_blobs", own.blobs, f"{own.blobs}"),
        ("", "size", "own_size", None, f"{cols_px} x {rows_px} px"),
    ]
    notes = "".join(f'<p class="note">{html.escape(note)}</p>' for note in own.frame.notes)
    return f'<p class="name">{html.escape(own.frame.name)}</p>{_table(rows)}{notes}'


def _table(rows: Sequence[tuple[str, str, str, float | None, str]]) -> str:
    parts = []
    for group, name, key, value, text in rows:
        lead = ' class="lead"' if group else ""
        data = "" if value is None else f' data-value="{float(value)!r}"'
        parts.append(f'<tr{lead}><th scope="row">{group} {name}</th><td id="figure-{key}"{data}>{text}</td></tr>')
    return f"<table><tbody>{''.join(parts)}</tbody></table>"


def _signed(value: float, digits: int) -> str:
    """Return a number with its sign, a minus sign for a hyphen."""
    return f"{value:+.{digits}f}".replace("-", "−")
