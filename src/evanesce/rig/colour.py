"""A colour camera's filters and image processor, and automatic exposure, as data.

Published settings are those of the tuning files of the IMX477 in the libcamera sources
(github.com/raspberrypi/libcamera, commit 26bfadc66e8d7f727a993fe58174217b8a96f7f9).
"""

from __future__ import annotations

from typing import Literal

from evanesce.core.quantities import Strict, field

Mosaic = Literal["RGGB", "BGGR", "GRBG", "GBRG"]
Demosaicing = Literal["bilinear", "edge-aware"]


class Colour(Strict):
    """Filter mosaic and image processor of a colour camera: ``[camera.colour]``.

    ``pixel.quantum_efficiency`` is then that of the most sensitive filter at its best wavelength.
    """

    mosaic: Mosaic = "RGGB"
    """First 2 x 2 pixels, row by row; the IMX477's without mirroring."""
    response: tuple[float, float, float] | None = field(
        None,
        unit="1",
        bounds=(0.0, 1.0),
        doc="share of the quantum efficiency that red, green and blue pixels have for the LEDs' light;"
        " left out: from the sensor's curves and the LEDs' spectrum",
    )
    infrared_cut: bool = True
    """Whether the sensor stands behind the camera's infrared cut filter; a NoIR camera has none."""
    white_balance: Literal["fixed", "automatic"] = "fixed"
    temperature_K: float = field(
        2850.0,
        unit="K",
        bounds=(2360.0, 9505.0),
        source="ends of the tuning's curve; 2850 K: the lowest with a matrix of its own",
        doc="white balance and colour matrix of the tuning are taken at this colour temperature",
    )
    red_gain: float | None = field(None, unit="1", bounds=(0.1, 32.0), doc="in place of the tuning's, over green")
    blue_gain: float | None = field(None, unit="1", bounds=(0.1, 32.0), doc="in place of the tuning's, over green")
    demosaicing: Demosaicing = "bilinear"
    contrast_enhancement: bool = False
    """Whether the tone curve is stretched by the frame's histogram, as the tuning has it."""
    sharpening: float = field(
        0.0, unit="1", bounds=(0.0, 16.0), null=0.0, doc="strength; 1: the tuning's; kernel assumed"
    )
    denoising: float = field(
        0.0, unit="1", bounds=(0.0, 16.0), null=0.0, doc="strength on the raw mosaic; the processor's filter is unknown"
    )


class AutoExposure(Strict):
    """Automatic exposure and gain: ``[camera.auto_exposure]``. Each frame is exposed as the settled control would."""

    metering: Literal["centre-weighted", "spot", "matrix"] = "centre-weighted"
    mode: Literal["normal", "short", "long"] = "normal"
    """How exposure and gain share the work: the tuning's exposure modes."""
    compensation: float = field(1.0, unit="1", bounds=(0.01, 100.0), doc="factor on the targets (2: one stop brighter)")
