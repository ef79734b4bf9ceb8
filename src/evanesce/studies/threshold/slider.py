"""The threshold slider of the report: frames with their truth as data URIs, the reference segmentation as a script."""

from __future__ import annotations

import base64
import json
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import resources
from typing import Any

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from evanesce.chain.fast import FastCamera
from evanesce.chain.simulate import solve_contact
from evanesce.evaluation.perfect_view import PerfectView
from evanesce.measurement.reference.segment import Chain, segment
from evanesce.report.html import ENVIRONMENT, image_png
from evanesce.rig import Scene
from evanesce.studies.scenes import Finger
from evanesce.studies.voltage.grey import GREY

HALF_MM = 6.5
CURVE = tuple(round(0.02 * k, 2) for k in range(1, 45))
SHOWN = (
    (Finger("silskin_0", ridged=False, scattering=False), 2.0),
    (Finger("silskin_0", ridged=True, scattering=False), 0.5),
    (Finger("silskin_0", ridged=True, scattering=True), 1.0),
)


@dataclass(frozen=True)
class SliderFrame:
    """One frame of the slider.

    Attributes
    ----------
    title : str
    image : ndarray of uint8 (rows, cols)
        Undistorted crop [DN].
    truth : ndarray of uint8 (rows, cols)
        Share of each pixel in contact times 255.
    true_area_mm2, mm2_per_px : float
    chain : Chain
        Blur, radius and minimum blob size; its threshold is where the slider starts.
    curve : tuple of tuple of float
        (threshold, area error [%]).
    """

    title: str
    image: NDArray[np.uint8]
    truth: NDArray[np.uint8]
    true_area_mm2: float
    mm2_per_px: float
    chain: Chain
    curve: tuple[tuple[float, float], ...]


def slider_frame(finger: Finger, scene: Scene, force: float, *, seed: int = 1) -> SliderFrame:
    """Return a frame of a finger pressed on a scene's rig.

    Parameters
    ----------
    finger : Finger
    scene : Scene
    force : float
        [N].
    seed : int

    Returns
    -------
    SliderFrame
    """
    pressed = finger.on(scene)
    view = PerfectView.of(pressed)
    _, state = solve_contact(pressed, force, seed=seed)
    assert state is not None  # a force was given
    crop = view.window(HALF_MM)
    image = np.ascontiguousarray(crop.apply(view.straight(FastCamera(pressed).press(force, seed=seed).data)))
    if image.ndim == 3:  # the slider shows, and cuts, the chain's grey in whole DN
        image = np.rint(image @ GREY).astype(np.uint8)
    truth = np.rint(255 * np.asarray(view.labels(state, crop).mask)).astype(np.uint8)
    area, scale = state.nominal_contact_area, view.mm2_per_px
    curve = tuple((t, 100 * (segment(image, Chain(threshold=t)).pixels * scale / area - 1)) for t in CURVE)
    title = f"{finger.material.replace('silskin_', 'Silskin ')} %, {finger.name}, {force:g} N"
    return SliderFrame(title, image, truth, area, scale, Chain(threshold=0.15), curve)


def slider_frames(scene: Scene, *, seed: int = 1) -> list[SliderFrame]:
    """Return the frames that the page shows.

    Parameters
    ----------
    scene : Scene
    seed : int

    Returns
    -------
    list of SliderFrame
    """
    return [slider_frame(finger, scene, force, seed=seed) for finger, force in SHOWN]


def slider(frames: Sequence[SliderFrame]) -> Markup:
    """Return the slider as HTML for :attr:`evanesce.report.html.Section.widget`.

    Parameters
    ----------
    frames : sequence of SliderFrame

    Returns
    -------
    Markup
    """
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
