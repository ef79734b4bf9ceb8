"""One exposure of a camera, without any departure from its data sheet: irradiance -> raw and 8-bit frame."""

from __future__ import annotations

import numpy as np

from evanesce.core.states import Frame, SensorLight
from evanesce.rig import Camera
from evanesce.sensor.colour import ImageProcessor, develop_colour, mosaic
from evanesce.sensor.pixel import FixedPattern, collect, mean_charge, photon_count
from evanesce.sensor.readout import amplify, quantise
from evanesce.sensor.tone import develop

Array = np.ndarray[tuple[int, ...], np.dtype[np.float64]]


def charge_of(
    light: SensorLight,
    camera: Camera,
    pattern: FixedPattern | None = None,
    response: tuple[float, float, float] | None = None,
) -> Array:
    """Return the mean charge of each pixel before shot noise [e-].

    Parameters
    ----------
    light : SensorLight
        Irradiance [W mm^-2].
    camera : Camera
    pattern : FixedPattern, optional
    response : tuple of float, optional
        Share of the quantum efficiency that red, green and blue pixels have for this light [1]
        (:func:`evanesce.sensor.response.led_response`); a colour camera needs it.

    Returns
    -------
    ndarray (rows, cols)
    """
    pixel, exposure_s = camera.pixel, camera.exposure_ms * 1e-3
    photons = photon_count(
        light.irradiance,
        pitch_um=pixel.pitch_um,
        fill_factor=pixel.fill_factor,
        exposure_s=exposure_s,
        wavelength_nm=camera.wavelength_nm,
    )
    if camera.colour is not None:
        if response is None:
            raise ValueError("a colour camera needs the response of its filters")
        photons = mosaic(photons, response, camera.colour.mosaic)
    return mean_charge(
        photons,
        quantum_efficiency=pixel.quantum_efficiency,
        dark_current_e_per_s=pixel.dark_rate_e_per_s,
        exposure_s=exposure_s,
        pattern=pattern,
    )


def signal_of(mean_e: Array, camera: Camera, rng: np.random.Generator | None) -> Array:
    """Return the signal before quantisation [DN]: shot noise, full well, read noise, gain, black level.

    Parameters
    ----------
    mean_e : ndarray (rows, cols)
        Mean charge [e-].
    camera : Camera
    rng : numpy.random.Generator or None
        None: without temporal noise.

    Returns
    -------
    ndarray (rows, cols)
    """
    pixel = camera.pixel
    return amplify(
        collect(mean_e, pixel.full_well_capacity_e, rng),
        conversion_gain_e_per_DN=pixel.conversion_gain_e_per_DN,
        analogue_gain=camera.analogue_gain,
        read_noise_e=pixel.read_noise_e,
        black_level_DN=pixel.black_level_DN,
        rng=rng,
    )


def frame_of(
    signal_DN: Array,
    camera: Camera,
    *,
    time_s: float = 0.0,
    index: int = 0,
    processor: ImageProcessor | None = None,
) -> Frame:
    """Return the frame of a signal [DN]: quantised raw, and 8 bits through tone curve or colour processor.

    Parameters
    ----------
    signal_DN : ndarray (rows, cols)
    camera : Camera
    time_s : float
        Mid-exposure time [s].
    index : int
    processor : ImageProcessor, optional
        Of a colour camera; by default its own with fixed white balance.
    """
    pixel = camera.pixel
    raw = quantise(signal_DN, pixel.bits)
    if camera.colour is None:
        data = develop(raw, black_level_DN=pixel.black_level_DN, bits=pixel.bits, curve=camera.tone_curve)
    else:
        processor = processor or ImageProcessor.of(camera)
        data = develop_colour(
            raw, processor, pattern=camera.colour.mosaic, black_level_DN=pixel.black_level_DN, bits=pixel.bits
        )
    return Frame(data=data, raw=raw, time=time_s, index=index)


def expose(
    light: SensorLight,
    camera: Camera,
    *,
    rng: np.random.Generator | None,
    pattern: FixedPattern | None = None,
    response: tuple[float, float, float] | None = None,
    time_s: float = 0.0,
    index: int = 0,
) -> Frame:
    """Expose one frame, exposure and white balance as they are set.

    Parameters
    ----------
    light : SensorLight
        Irradiance [W mm^-2].
    camera : Camera
    rng : numpy.random.Generator or None
        Stream of this frame; None gives the frame without temporal noise.
    pattern : FixedPattern, optional
        Of this sensor (:func:`evanesce.sensor.pixel.fixed_pattern`).
    response : tuple of float, optional
        As for :func:`charge_of`.
    time_s : float
        Mid-exposure time [s].
    index : int
    """
    return frame_of(
        signal_of(charge_of(light, camera, pattern, response), camera, rng), camera, time_s=time_s, index=index
    )
