"""The page's threshold slider: frames as data URIs, the reference segmentation as a script, no server."""

from __future__ import annotations

import base64
import json
from collections.abc import Sequence
from importlib import resources
from typing import Any

from markupsafe import Markup

from evanesce.report.html import ENVIRONMENT, image_png
from evanesce.studies.threshold.slider_frames import SliderFrame


def slider(frames: Sequence[SliderFrame]) -> Markup:
    """Return the slider as HTML for :attr:`evanesce.report.html.Section.widget`."""
    # "<" may not end the script element that holds the data
    data = json.dumps([_plain(frame) for frame in frames]).replace("<", "\\u003c")
    script = (resources.files("evanesce.report") / "templates" / "slider.js").read_text(encoding="utf-8")
    template = ENVIRONMENT.get_template("slider.html.j2")
    return Markup(template.render(data=Markup(data), script=Markup(script)))  # both are this project's own


def _plain(frame: SliderFrame) -> dict[str, Any]:
    rows, cols = frame.image.shape

    def uri(png: bytes) -> str:
        return "data:image/png;base64," + base64.b64encode(png).decode("ascii")

    return {
        "title": frame.title,
        "rows": rows,
        "cols": cols,
        "image": uri(image_png(frame.image)),
        "truth": uri(image_png(frame.truth)),
        "true_area_mm2": frame.true_area_mm2,
        "mm2_per_px": frame.mm2_per_px,
        "threshold": frame.chain.threshold,
        "blur_px": frame.chain.blur,
        "radius_px": frame.chain.radius,
        "min_blob_px": frame.chain.min_blob,
        "curve": [[t, round(e, 3)] for t, e in frame.curve],
    }
