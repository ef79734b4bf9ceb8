"""The camera below the plate: geometry, lens, pixel, readout and colour as data."""

from __future__ import annotations

from typing import Literal

from pydantic import model_validator

from evanesce.core.arrhenius import rate_factor
from evanesce.core.quantities import Strict, field
from evanesce.rig.colour import AutoExposure, Colour


class Distortion(Strict):
    """OpenCV's distortion coefficients on normalised coordinates (divided by the focal length in pixels)."""

    k1: float = field(0.0, unit="1", bounds=(-2.0, 2.0), null=0.0)
    k2: float = field(0.0, unit="1", bounds=(-5.0, 5.0), null=0.0)
    p1: float = field(0.0, unit="1", bounds=(-0.5, 0.5), null=0.0)
    p2: float = field(0.0, unit="1", bounds=(-0.5, 0.5), null=0.0)
    k3: float = field(0.0, unit="1", bounds=(-10.0, 10.0), null=0.0)

    @property
    def coefficients(self) -> tuple[float, float, float, float, float]:
        """(k1, k2, p1, p2, k3), OpenCV's order."""
        return self.k1, self.k2, self.p1, self.p2, self.k3


class Lens(Strict):
    """Thin lens behind a pinhole model of its perspective."""

    focal_length_mm: float = field(6.0, unit="mm", bounds=(0.5, 200.0), doc="focal length; not published")
    f_number: float = field(2.8, unit="1", bounds=(0.7, 64.0), doc="focal length over aperture; not published")
    transmittance: float = field(0.9, unit="1", bounds=(0.01, 1.0))
    defocus_um: float = field(
        0.0, unit="um", bounds=(-2000.0, 2000.0), null=0.0, doc="sensor plane behind best focus, on the axis"
    )
    field_curvature_um: float = field(
        0.0, unit="um", bounds=(-2000.0, 2000.0), null=0.0, doc="further defocus at the frame's corner, growing as r^2"
    )
    vignetting_k: float = field(
        0.0, unit="1", bounds=(0.0, 0.95), null=0.0, doc="loss at the frame's corner beyond cos^4, growing as r^2"
    )
    distortion: Distortion = Distortion()


class Pixel(Strict):
    """One pixel's electronics (IMX477; 2 x 2 binned in the 2028 x 1520 mode)."""

    pitch_um: float = field(3.1, unit="um", bounds=(0.5, 50.0), doc="after binning")
    quantum_efficiency: float = field(
        0.6, unit="1", bounds=(0.01, 1.0), doc="mean over the LED spectrum; in colour: peak"
    )
    fill_factor: float = field(1.0, unit="1", bounds=(0.05, 1.0))
    full_well_capacity_e: float = field(8180.0, unit="e", bounds=(100.0, 1e7))
    conversion_gain_e_per_DN: float = field(2.13, unit="e_per_DN", bounds=(0.01, 1000.0), doc="at analogue gain 1")
    read_noise_e: float = field(3.0, unit="e", bounds=(0.0, 1000.0), null=0.0)
    dark_current_e_per_s: float = field(
        0.0, unit="e_per_s", bounds=(0.0, 1e6), null=0.0, doc="mean over the pixels at dark_reference_C"
    )
    dark_nonuniformity_e_per_s: float = field(
        0.0, unit="e_per_s", bounds=(0.0, 1e6), null=0.0, doc="standard deviation of dark current over the pixels"
    )
    dark_activation_energy_eV: float = field(
        0.0, unit="eV", bounds=(0.0, 1.5), null=0.0, doc="of dark current; 0: the same at any temperature"
    )
    dark_reference_C: float = field(20.0, unit="C", bounds=(-80.0, 120.0), doc="temperature of the dark current above")
    temperature_C: float = field(20.0, unit="C", bounds=(-80.0, 120.0), doc="of the sensor")
    prnu: float = field(0.0, unit="1", bounds=(0.0, 0.5), null=0.0, doc="relative standard deviation of sensitivity")
    dsnu_e: float = field(0.0, unit="e", bounds=(0.0, 1000.0), null=0.0, doc="standard deviation of dark signal")
    black_level_DN: float = field(256.0, unit="DN", bounds=(0.0, 2048.0))
    bits: int = field(12, unit="1", bounds=(8, 16))

    @model_validator(mode="after")
    def _dark(self) -> Pixel:
        if self.dark_nonuniformity_e_per_s > 0.0 and self.dark_current_e_per_s == 0.0:
            raise ValueError("dark_nonuniformity_e_per_s is 0 where dark_current_e_per_s is 0 (allowed: both above 0)")
        return self

    @property
    def dark_rate_e_per_s(self) -> float:
        """Mean dark current at the sensor's temperature [e-/s]."""
        if self.dark_activation_energy_eV == 0.0:
            return self.dark_current_e_per_s
        change = rate_factor(self.dark_activation_energy_eV, self.dark_reference_C, self.temperature_C)
        return self.dark_current_e_per_s * change

    @property
    def dark_spread(self) -> float:
        """Relative standard deviation of dark current over the pixels [1]."""
        return self.dark_nonuniformity_e_per_s / self.dark_current_e_per_s if self.dark_current_e_per_s else 0.0


class Camera(Strict):
    """Camera on the plate's normal through ``centre_mm``, tilted about it, looking up along +z.

    Its distance follows from ``scale_px_per_mm``, the scale at the optical axis before distortion.
    """

    resolution_px: tuple[int, int] = field(
        (2000, 1500), unit="px", bounds=(8, 20000), source="thesis, chapter 5: 3407 px/mm^2", doc="columns, rows"
    )
    scale_px_per_mm: float = field(58.37, unit="px/mm", bounds=(0.5, 1000.0), source="thesis, chapter 5")
    centre_mm: tuple[float, float] = field((0.0, 0.0), unit="mm", bounds=(-500.0, 500.0), doc="plate point on the axis")
    principal_point_offset_px: tuple[float, float] = field(
        (0.0, 0.0), unit="px", bounds=(-2000.0, 2000.0), doc="optical axis from the frame's middle, (x, y)"
    )
    tilt_x_deg: float = field(0.0, unit="deg", bounds=(-30.0, 30.0), null=0.0, doc="rotation about the plate's x")
    tilt_y_deg: float = field(0.0, unit="deg", bounds=(-30.0, 30.0), null=0.0, doc="rotation about the plate's y")
    roll_deg: float = field(0.0, unit="deg", bounds=(-180.0, 180.0), null=0.0, doc="rotation about the optical axis")
    exposure_ms: float = field(10.0, unit="ms", bounds=(0.001, 10000.0))
    analogue_gain: float = field(1.0, unit="1", bounds=(1.0, 64.0))
    tone_curve: Literal["linear", "bt709", "srgb", "libcamera"] = "bt709"
    wavelength_nm: float = field(550.0, unit="nm", bounds=(300.0, 1100.0), doc="of the diffraction blur and photons")
    lens: Lens = Lens()
    pixel: Pixel = Pixel()
    colour: Colour | None = None
    """Filters and image processor; left out: a monochrome camera."""
    auto_exposure: AutoExposure | None = None
    """Left out: ``exposure_ms`` and ``analogue_gain`` hold for all frames."""
