"""What a colour camera's filters let through of the light in a frame: that of the LEDs, or of a lamp on a card."""

from __future__ import annotations

import numpy as np

from evanesce.optics.spectrum import spectrum_of
from evanesce.rig import Camera, Scene
from evanesce.sensor.filters import filter_response
from evanesce.sensor.tuning import white_imx477

Response = tuple[float, float, float]

CARD_LAMP_K = 4000.0
"""Colour temperature of the lamp on printed cards [K]: a white office lamp; not published."""


def led_response(scene: Scene) -> Response | None:
    """Return the share of the quantum efficiency that red, green and blue pixels have for the LEDs' light.

    Parameters
    ----------
    scene : Scene

    Returns
    -------
    tuple of float or None
        [1]; None for a monochrome camera.
    """
    colour = scene.camera.colour
    if colour is None:
        return None
    if colour.response is not None:
        return colour.response
    return filter_response(spectrum_of(scene.leds), infrared_cut=colour.infrared_cut)


def card_response(camera: Camera) -> Response | None:
    """Return the same for a printed card under a white lamp, by the white points of the published tuning.

    Parameters
    ----------
    camera : Camera

    Returns
    -------
    tuple of float or None
        [1], the largest 1; None for a monochrome camera.
    """
    if camera.colour is None:
        return None
    red, blue = white_imx477(CARD_LAMP_K)
    share = np.array([red, 1.0, blue])
    r, g, b = (float(s) for s in share / share.max())
    return r, g, b
