"""A scene's colour camera as the table that the refined estimator reads levels with."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from evanesce.core.errors import InputError
from evanesce.measurement.refined.colour import CameraModel
from evanesce.measurement.refined.raw import RawModel
from evanesce.rig import Scene, load_scene
from evanesce.sensor.automatic import is_automatic
from evanesce.sensor.colour import ImageProcessor
from evanesce.sensor.pixel import photon_count
from evanesce.sensor.response import led_response
from evanesce.sensor.tone import CURVES, Curve

Floats = NDArray[np.float64]

HIGHEST = 100.0
"""Highest level of the table; blue of the weakest share that the real frame allows is full there [raw red full]."""

LEVELS = 2000

MOSAICS = ("RGGB", "GRBG", "GBRG", "BGGR")

TABLE_NOISE_DN = 2.0
"""Standard deviation assumed of a pixel where a table states none [DN]."""


def tone_values(curve: Curve) -> Floats:
    """Return the linear light of each 8-bit value, by inverting a camera's curve.

    Parameters
    ----------
    curve : {"linear", "bt709", "srgb", "libcamera"}

    Returns
    -------
    ndarray (256,)
        0 to 1.
    """
    light = np.linspace(0.0, 1.0, 65536)
    return np.interp(np.arange(256) / 255.0, CURVES[curve](light), light)


def red_level(scene: Scene, irradiance_W_per_mm2: float) -> float:
    """Return the light's level of an irradiance: 1 fills the raw value of a pixel whose filter has response 1.

    Parameters
    ----------
    scene : Scene
    irradiance_W_per_mm2 : float
        On the sensor, of the LEDs' light.

    Returns
    -------
    float
    """
    camera, pixel = scene.camera, scene.camera.pixel
    photons = photon_count(
        np.array([irradiance_W_per_mm2]), pitch_um=pixel.pitch_um, fill_factor=pixel.fill_factor,
        exposure_s=camera.exposure_ms * 1e-3, wavelength_nm=camera.wavelength_nm,
    )  # fmt: skip
    return float(photons[0]) * pixel.quantum_efficiency / _full_e(scene)


def camera_model(
    scene: Scene, processor: ImageProcessor | None = None, response: tuple[float, float, float] | None = None
) -> CameraModel:
    """Return what a scene's colour camera makes of its LEDs' light, level by level.

    Parameters
    ----------
    scene : Scene
        With a table ``camera.colour``; white balance fixed, no contrast enhancement.
    processor : ImageProcessor, optional
        In place of the scene's.
    response : tuple of float, optional
        Of red, green and blue pixels to the LEDs' light, in place of the scene's [1].

    Returns
    -------
    CameraModel
        Level 1 fills the raw value of a pixel whose filter has response 1. Noise is shot and read noise of one pixel,
        clipped where the mosaic clips, through white balance and colour matrix.

    Raises
    ------
    InputError
        If the camera is monochrome, or its colours depend on the whole frame.
    """
    camera = scene.camera
    response = led_response(scene) if response is None else response
    if camera.colour is None or response is None:
        raise InputError("is a monochrome camera", key="camera.colour", allowed="a scene with a table [camera.colour]")
    if is_automatic(camera) or camera.colour.contrast_enhancement:
        raise InputError(
            "depends on the whole frame", key="camera.colour",
            allowed="fixed exposure and white balance, contrast_enhancement = false",
        )  # fmt: skip
    processor, full_e = processor or ImageProcessor.of(camera), _full_e(scene)
    levels = np.concatenate([[0.0], np.geomspace(1e-4, HIGHEST, LEVELS)])
    mean = levels[:, None] * np.asarray(response)
    deviation = np.sqrt(mean * full_e + camera.pixel.read_noise_e**2 + 1e-12) / full_e
    value, spread = clipped_normal(mean, deviation, 1.0 / np.maximum(processor.gains, 1.0))
    matrix = np.array(processor.matrix)
    return CameraModel(
        levels=levels, output=(value * processor.gains) @ matrix.T,
        noise=np.sqrt((spread * processor.gains) ** 2 @ (matrix**2).T), tone=tone_values(camera.tone_curve),
        balanced=value * processor.gains, matrix=matrix,
    )  # fmt: skip


def raw_model(scene: Scene | str | Path, mosaic: str | None = None) -> RawModel:
    """Return what a scene's raw pixels make of its LEDs' light.

    Parameters
    ----------
    scene : Scene, str or Path
        A scene, its name or file, with a table ``camera.colour``; exposure, gain and white balance do not matter.
    mosaic : {"RGGB", "GRBG", "GBRG", "BGGR"}, optional
        First 2 x 2 pixels, row by row, in place of the scene's.

    Returns
    -------
    RawModel

    Raises
    ------
    InputError
        If the camera is monochrome, or the mosaic is none of these.
    """
    if mosaic not in (None, *MOSAICS):
        raise InputError(f"{mosaic!r}", key="mosaic", allowed=", ".join(MOSAICS))
    file = None if isinstance(scene, Scene) else scene
    scene = scene if isinstance(scene, Scene) else load_scene(scene)
    camera, response = scene.camera, led_response(scene)
    if camera.colour is None or response is None:
        raise InputError(
            "is a monochrome camera", file=file, key="camera.colour", allowed="a scene with a table [camera.colour]"
        )
    pixel = camera.pixel
    return RawModel(
        mosaic=mosaic or camera.colour.mosaic,
        response=response,
        black_DN=pixel.black_level_DN,
        full_DN=2**pixel.bits - 1,
    )


def read_camera_model(source: Scene | str | Path) -> CameraModel:
    """Return the camera model of a scene, or of a measured table.

    Parameters
    ----------
    source : Scene, str or Path
        A scene, its name or TOML file; or a CSV with columns level, red, green, blue: 8-bit means of an even patch [DN]
        by the light's level, for instance by exposure time. Levels rise from 0, in any unit.

    Returns
    -------
    CameraModel

    Raises
    ------
    InputError
        If the file is not readable, a value is out of range, or the scene's camera is not in colour.
    """
    if isinstance(source, Scene):
        return camera_model(source)
    path = Path(source)
    if path.suffix.lower() != ".csv":
        return camera_model(load_scene(source))
    allowed = "columns level,red,green,blue: at least 3 rows, levels rising from 0, colours from 0 to 255 DN"
    try:
        lines = path.read_text(encoding="utf-8").split()
        table = np.array([[float(cell) for cell in line.split(",")] for line in lines[1:]])
    except (OSError, ValueError) as error:
        raise InputError(f"cannot be read: {error}", file=path, allowed=allowed) from None
    shaped = table.ndim == 2 and table.shape[1] == 4 and len(table) >= 3 and lines[0] == "level,red,green,blue"
    if not shaped or not np.isfinite(table).all():
        raise InputError("is no such table", file=path, allowed=allowed)
    levels, colours = table[:, 0], table[:, 1:]
    if levels[0] != 0 or (np.diff(levels) <= 0).any() or colours.min() < 0 or colours.max() > 255:
        raise InputError("has values out of range", file=path, allowed=allowed)
    return CameraModel(
        levels=levels, output=colours / 255.0, noise=np.full(colours.shape, TABLE_NOISE_DN / 255.0),
        tone=np.arange(256) / 255.0,
    )  # fmt: skip


def clipped_normal(mean: Floats, deviation: Floats, end: Floats | float) -> tuple[Floats, Floats]:
    """Return mean and standard deviation of min(X, end) of normal X, in closed form.

    Parameters
    ----------
    mean, deviation : ndarray
        Of X.
    end : ndarray or float

    Returns
    -------
    mean, deviation : ndarray
    """
    z = (end - mean) / deviation
    below, density = ndtr(z), np.exp(-0.5 * z**2) / math.sqrt(2 * math.pi)
    first = mean * below - deviation * density + end * (1 - below)
    second = (mean**2 + deviation**2) * below - deviation * (mean + end) * density + end**2 * (1 - below)
    return first, np.sqrt(np.maximum(second - first**2, 0.0))


def _full_e(scene: Scene) -> float:
    """Return the charge that fills the raw range [e-]."""
    pixel = scene.camera.pixel
    span_DN = 2**pixel.bits - 1 - pixel.black_level_DN
    return span_DN * pixel.conversion_gain_e_per_DN / scene.camera.analogue_gain
