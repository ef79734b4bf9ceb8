"""A scene's colour camera as the table that the refined estimator reads levels with."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

from evanesce.core.errors import InputError
from evanesce.measurement.refined.colour import CameraModel
from evanesce.rig import Scene
from evanesce.sensor.colour import ImageProcessor
from evanesce.sensor.response import led_response
from evanesce.sensor.tone import CURVES

Floats = NDArray[np.float64]

HIGHEST = 100.0
LEVELS = 4000


def tone_values(curve: str) -> Floats:
    """Return the linear light of each 8-bit value (256,), 0 to 1, by inverting a camera's curve."""
    light = np.linspace(0.0, 1.0, 65536)
    return np.interp(np.arange(256) / 255.0, CURVES[curve](light), light)


def camera_model(scene: Scene) -> CameraModel:
    camera = scene.camera
    response = np.asarray(led_response(scene))
    processor = ImageProcessor.of(camera)
    pixel = camera.pixel
    full_e = (2**pixel.bits - 1 - pixel.black_level_DN) * pixel.conversion_gain_e_per_DN / camera.analogue_gain
    levels = np.concatenate([[0.0], np.geomspace(1e-4, HIGHEST, LEVELS)])
    mean = levels[:, None] * response
    deviation = np.sqrt(mean * full_e + pixel.read_noise_e**2) / full_e
    end = 1.0 / np.maximum(processor.gains, 1.0)
    clipped, spread = clipped_normal(mean, deviation, end)
    balanced, noise = clipped * processor.gains, spread * processor.gains
    matrix = np.array(processor.matrix)
    return CameraModel(
        levels=levels, output=balanced @ matrix.T, noise=np.sqrt(noise**2 @ (matrix**2).T),
        tone=tone_values(camera.tone_curve),
    )


def clipped_normal(mean, deviation, end):
    """Mean and standard deviation of min(X, end), X normal."""
    z = (end - mean) / deviation
    below, density = norm.cdf(z), norm.pdf(z)
    m = mean * below - deviation * density + end * (1 - below)
    s = (mean**2 + deviation**2) * below - deviation * (mean + end) * density + end**2 * (1 - below)
    return m, np.sqrt(np.maximum(s - m**2, 0))
