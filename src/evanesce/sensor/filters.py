"""Spectral sensitivity of a colour sensor's red, green and blue pixels, and what each makes of a spectrum.

IMX477, 400 to 700 nm: the curves of Sony's data sheet, digitised by cpixip, who also measured the transmittance
of the HQ camera's infrared cut filter, a Hoya CM500 (github.com/raspberrypi/picamera2, issue 462, 2023;
numbers as in github.com/cgobat/astro-instruments, AstroHQ/spectral_response.npy, commit 1bb41182). Read as quantum
efficiencies they give the white points of libcamera's tuning of that camera within 6 % in red and 14 % in blue; read as
responses to equal power, within 13 and 26 % (docs/validation/led-spectrum.md).

Beyond 700 nm nothing is published as numbers. Sensitivity: the estimate for the IMX219, of the same maker and kind, by
comparison with similar sensors (github.com/bluegreen-labs/raspberry_pi_camera_responses, commit cb6d4e51), times what
joins the two at 700 nm, fading by 800 nm to one factor for all three; uncertain by a quarter. Filter: the measured
curve continued with its slope down to 0.1 %, assumed from there on.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike, NDArray

from evanesce.optics.spectrum import Spectrum

Array = NDArray[np.float64]

_WAVELENGTH_NM = np.arange(400.0, 1001.0, 10.0)


@dataclass(frozen=True, eq=False)
class ColourSensor:
    """Published curves of one sensor, 400 to 1000 nm in steps of 10 nm.

    Attributes
    ----------
    sensitivity : ndarray (61, 3)
        Quantum efficiency of red, green and blue pixels, over the highest of them [1].
    infrared_cut : ndarray (61,)
        Transmittance of the infrared cut filter that its camera has [1].
    """

    sensitivity: Array
    infrared_cut: Array


_RED = np.array(
    [
        *(0.090, 0.060, 0.040, 0.030, 0.029, 0.012, 0.005, 0.012, 0.030, 0.029, 0.040, 0.050),
        *(0.069, 0.083, 0.070, 0.053, 0.059, 0.152, 0.443, 0.774, 0.889, 0.859, 0.829, 0.809),
        *(0.803, 0.774, 0.721, 0.671, 0.621, 0.600, 0.587, 0.580, 0.570, 0.558, 0.542, 0.523),
        *(0.505, 0.490, 0.473, 0.452, 0.427, 0.400, 0.372, 0.354, 0.331, 0.302, 0.274, 0.253),
        *(0.234, 0.216, 0.199, 0.181, 0.164, 0.147, 0.130, 0.113, 0.099, 0.086, 0.073, 0.059),
        *(0.049,),
    ]
)
_GREEN = np.array(
    [
        *(0.091, 0.071, 0.051, 0.044, 0.059, 0.065, 0.111, 0.279, 0.551, 0.797, 0.927, 0.978),
        *(0.999, 0.999, 0.979, 0.930, 0.878, 0.818, 0.727, 0.617, 0.481, 0.351, 0.250, 0.197),
        *(0.168, 0.150, 0.140, 0.150, 0.179, 0.222, 0.248, 0.258, 0.255, 0.249, 0.253, 0.266),
        *(0.289, 0.315, 0.339, 0.355, 0.359, 0.356, 0.349, 0.335, 0.317, 0.294, 0.268, 0.249),
        *(0.231, 0.212, 0.194, 0.176, 0.159, 0.143, 0.126, 0.109, 0.094, 0.081, 0.068, 0.055),
        *(0.045,),
    ]
)
_BLUE = np.array(
    [
        *(0.483, 0.587, 0.678, 0.758, 0.829, 0.879, 0.886, 0.841, 0.755, 0.634, 0.502, 0.369),
        *(0.261, 0.180, 0.141, 0.099, 0.070, 0.062, 0.048, 0.049, 0.040, 0.019, 0.010, 0.018),
        *(0.040, 0.050, 0.059, 0.059, 0.088, 0.114, 0.073, 0.080, 0.079, 0.076, 0.076, 0.081),
        *(0.096, 0.150, 0.214, 0.280, 0.331, 0.354, 0.359, 0.346, 0.319, 0.291, 0.269, 0.251),
        *(0.232, 0.213, 0.194, 0.175, 0.157, 0.139, 0.123, 0.106, 0.090, 0.076, 0.064, 0.052),
        *(0.042,),
    ]
)
_CM500 = np.array(
    [
        *(0.820, 0.832, 0.842, 0.852, 0.860, 0.866, 0.871, 0.876, 0.879, 0.881, 0.881, 0.880),
        *(0.875, 0.864, 0.844, 0.814, 0.772, 0.715, 0.643, 0.559, 0.468, 0.375, 0.287, 0.210),
        *(0.145, 0.096, 0.060, 0.036, 0.021, 0.012, 0.007, 0.004, 0.002, 0.001, 0.001, 0.001),
        *(0.001, 0.001, 0.001, 0.001, 0.001, 0.001, 0.001, 0.001, 0.001, 0.001, 0.001, 0.001),
        *(0.001, 0.001, 0.001, 0.001, 0.001, 0.001, 0.001, 0.001, 0.001, 0.001, 0.001, 0.001),
        *(0.001,),
    ]
)

SENSORS: Mapping[str, ColourSensor] = MappingProxyType(
    {"imx477": ColourSensor(np.stack([_RED, _GREEN, _BLUE], axis=1) / max(_GREEN), _CM500)}
)


def relative_sensitivity(wavelength: ArrayLike, sensor: str = "imx477", infrared_cut: bool = True) -> Array:
    """Return the quantum efficiency of red, green and blue pixels over the highest of the bare sensor's.

    Parameters
    ----------
    wavelength : array_like (...)
        [nm]; 0 outside 400 to 1000 nm, where nothing is known.
    sensor : str
        Key of :data:`SENSORS`.
    infrared_cut : bool
        Whether light passes the filter that the camera is sold with (the HQ camera has one, NoIR cameras none).

    Returns
    -------
    ndarray (..., 3)
        [1].

    Raises
    ------
    ValueError
        If the sensor is not known.
    """
    if sensor not in SENSORS:
        raise ValueError(f"sensor {sensor!r} is not known; known: {', '.join(SENSORS)}")
    curves = SENSORS[sensor]
    at = np.asarray(wavelength, float)
    found = np.stack(
        [np.interp(at, _WAVELENGTH_NM, curve, left=0.0, right=0.0) for curve in curves.sensitivity.T], axis=-1
    )
    if infrared_cut:
        found = found * np.interp(at, _WAVELENGTH_NM, curves.infrared_cut)[..., None]
    return np.asarray(found)


def filter_response(
    spectrum: Spectrum, sensor: str = "imx477", infrared_cut: bool = True
) -> tuple[float, float, float]:
    """Return the mean response of red, green and blue pixels to the photons of a spectrum.

    Relative to the highest sensitivity of any pixel of the bare sensor at any wavelength, which a camera's
    ``pixel.quantum_efficiency`` is where colour is modelled.

    Parameters
    ----------
    spectrum : Spectrum
    sensor : str
        Key of :data:`SENSORS`.
    infrared_cut : bool
        As for :func:`relative_sensitivity`.

    Returns
    -------
    red, green, blue : float
        0 to 1 [1].

    Raises
    ------
    ValueError
        If the sensor is not known.
    """

    def of(k: int) -> float:
        return spectrum.photon_mean(lambda w: relative_sensitivity(w, sensor, infrared_cut)[:, k])

    return of(0), of(1), of(2)
