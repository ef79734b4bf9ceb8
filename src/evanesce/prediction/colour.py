"""A colour camera's frame as the segmentation reads it: grey, of what filters and image processor make of light.

What a frame in colour tells of light of one spectrum, its grey tells: of a red LED's light the processor's matrix
leaves green and blue at nothing until red is full. So the data stay one number a pixel, not rounded, weighted as the
segmentation weighs red, green and blue.
"""

from __future__ import annotations

import functools
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from skimage.filters import threshold_otsu

from evanesce.bundle.area import AreaReading, contact_area
from evanesce.bundle.bundle import Bundle
from evanesce.core.errors import InputError
from evanesce.prediction.colour_noise import GREY, expected_colour
from evanesce.prediction.development import filled, light_levels
from evanesce.prediction.tone import ExpectedTone, expected_tone
from evanesce.prediction.views import BIN_PX
from evanesce.rig import Camera, Scene
from evanesce.sensor.automatic import LUMA, is_automatic
from evanesce.sensor.response import Response, card_response, led_response

Array = NDArray[np.float64]

CLEAR_SHARE = 0.15
"""Of the step from ground to contact, by which a threshold stands clear of either."""
LEAST_STEP = 5.0 / 255.0
"""From ground to contact, over a full pixel's level, below which no contact is seen: as the first look has it."""


def grey_of(frame: NDArray[np.uint8]) -> NDArray[Any]:
    """Return a frame as the segmentation reads it, (rows, cols) [DN]; a grey one as it is."""
    return frame if frame.ndim == 2 else np.asarray(frame @ GREY.astype(np.float32), np.float32)


def luma_of(frame: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return what a codec keeps of a frame as its brightness, (rows, cols) [DN]; a grey one as it is."""
    return frame if frame.ndim == 2 else np.floor(frame @ LUMA + 0.5).astype(np.uint8)


def require_predictable(bundle: Bundle) -> None:
    """Refuse frames of a camera whose settings follow what it sees, which no prediction of single pixels can.

    Raises
    ------
    InputError
    """
    camera, file = bundle.scene.camera, bundle.path / "scene.toml"
    if is_automatic(camera):
        key = "camera.auto_exposure" if camera.auto_exposure is not None else "camera.colour.white_balance"
        raise InputError(
            "frames of automatic settings cannot be fitted or criticised", file=file, key=key,
            allowed="a fixed exposure and a fixed white balance",
        )  # fmt: skip
    if camera.colour is not None and (camera.colour.contrast_enhancement or camera.colour.sharpening > 0.0):
        key = "contrast_enhancement" if camera.colour.contrast_enhancement else "sharpening"
        raise InputError(
            "frames that were enhanced cannot be fitted or criticised", file=file, key=f"camera.colour.{key}",
            allowed="an image processor that leaves them as they are",
        )  # fmt: skip


def expected_grey(scene: Scene, noise_scale: float = 1.0, *, card: bool = False, pixels: int = 1) -> ExpectedTone:
    """Return the moments of a pixel's grey under a scene's light, by the signal of a pixel that lets all of it through.

    Of a monochrome camera it is :func:`evanesce.prediction.tone.expected_tone`.

    Parameters
    ----------
    scene : Scene
    noise_scale : float
        Real over modelled standard deviation before the image processor.
    card : bool
        Whether a white lamp shines, not the LEDs.
    pixels : int
        By how much frames are averaged down for the model camera, per side.
    """
    response = card_response(scene.camera) if card else led_response(scene)
    if response is None:
        tone = expected_tone(scene.camera, noise_scale)
        return tone if pixels == 1 else replace(tone, pixels=pixels)
    return _grey_tone(scene.camera, response, round(noise_scale, 5), pixels)


@functools.lru_cache(maxsize=16)
def _grey_tone(camera: Camera, response: Response, scale: float, pixels: int) -> ExpectedTone:
    black, full = camera.pixel.black_level_DN, filled(camera, response)
    light = np.concatenate([np.linspace(-0.1 * full, 0.0, 50, endpoint=False), light_levels(camera, response)])
    signals = black + np.multiply.outer(np.array(response), light)[:, None]
    colour = expected_colour(camera, scale)
    mean, (variance, together) = (
        (colour.mean_of(signals) @ GREY)[0],
        (part[0] for part in colour.grey_noise(signals, BIN_PX * pixels)),
    )
    return ExpectedTone(
        black + light, np.maximum.accumulate(mean), variance, black, together / variance,
        step_DN=float(GREY[int(np.argmax(response))]), full_DN=float(np.interp(full, light, mean)), pixels=pixels,
    )  # fmt: skip


def reading_of(frame: Array, scene: Scene) -> AreaReading | None:
    """Return how areas are read where the usual threshold stands not clear of ground and contact; None where it does.

    Half-way between them then, as an eye would pick it from the histogram (Otsu, IEEE Trans. SMC 9:62, 1979, tells
    one from the other).

    Parameters
    ----------
    frame : ndarray (rows, cols)
        With a contact [DN].
    scene : Scene
        Nominal.
    """
    full, bright = expected_grey(scene).full_DN, frame > threshold_otsu(frame)
    if not bright.any():
        return None
    ground, contact = float(frame[~bright].mean()), float(frame[bright].mean())
    if contact - ground < LEAST_STEP * full:  # noise alone: there is nothing to read
        return None
    share = (AreaReading().threshold * full - ground) / (contact - ground)
    if CLEAR_SHARE < share < 1.0 - CLEAR_SHARE:
        return None
    return AreaReading(threshold=0.5 * (ground + contact) / 255.0)


def area_in(picture: Array, scene: Scene, reading: AreaReading | None = None) -> float:
    """Return the area of contact that the reference segmentation reads in a mean frame [mm^2].

    Parameters
    ----------
    picture : ndarray (rows, cols)
        Grey [DN].
    scene : Scene
        Nominal.
    reading : AreaReading, optional
        By default the usual one, its threshold a share of what a full pixel shows.
    """
    # Counted in steps as fine as those of a monochrome frame.
    finer = 255.0 / expected_grey(scene).full_DN
    reading = AreaReading() if reading is None else replace(reading, threshold=min(reading.threshold * finer, 1.0))
    return contact_area(np.floor(np.clip(picture * finer, 0, 255) + 0.5).astype(np.uint8), scene, reading)
