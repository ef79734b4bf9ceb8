"""The silicone finger and its nominal contact law."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from evanesce.core.quantities import Strict, field


class Ridges(Strict):
    """Moulded ridges: heights and widths are those of the cast, not of the drawing."""

    pattern: Literal["parallel", "concentric", "loop", "whorl"] = "parallel"
    height_um: float = field(47.67, unit="um", bounds=(0.1, 5000.0), source="thesis, section 3.5.1, table 4, moulded")
    width_um: float = field(501.1, unit="um", bounds=(1.0, 20000.0), source="thesis, section 3.5.1, table 4, moulded")
    pitch_um: float = field(unit="um", bounds=(2.0, 50000.0), doc="distance of neighbouring ridges; not published")
    orientation_deg: float = field(0.0, unit="deg", bounds=(-180.0, 180.0), doc="direction along parallel ridges")
    rounding_um: float | None = field(
        None,
        unit="um",
        bounds=(0.1, 5000.0),
        doc="Gaussian rounding of a flat-topped ridge; none: a ridge without flats",
    )
    core_length_mm: float = field(2.0, unit="mm", bounds=(0.0, 100.0), doc="segment that a whorl's ridges enclose")


class ScannedSkin(Strict):
    """Surface of the finger as a lab measured it, instead of designed ridges; read by :mod:`evanesce.bench`.

    Columns of the map run along +x of the plate and rows along +y, as the camera sees the finger through the glass;
    its middle lies on the tip unless ``offset_mm`` says otherwise. A profile repeats itself without end.
    """

    file: str = Field(
        min_length=1, max_length=4096, description="npz (of `evanesce bench profile`), csv, tif, exr; beside the scene"
    )
    pitch_um: float | None = field(
        None, unit="um", bounds=(0.01, 1000.0), doc="sample distance of a map that does not carry its own"
    )
    height_unit: Literal["nm", "um", "mm", "m"] | None = Field(None, description="of a csv, tif or exr map's values")
    form_degree: int = Field(1, ge=1, le=2, description="taken off: 1 a plane, 2 a scanned tip's roundness")
    offset_mm: tuple[float, float] = field(
        (0.0, 0.0), unit="mm", bounds=(-100.0, 100.0), doc="middle of the scan from the tip, (x, y)"
    )
    orientation_deg: float = field(
        0.0, unit="deg", bounds=(-180.0, 180.0), doc="by which the scan is turned, from x towards y"
    )
    sha256: str | None = Field(
        None, pattern="^[0-9a-f]{64}$", description="of the file; filled in on reading, and checked where it is given"
    )


class Fingerprint(Strict):
    """A human print that is grown, not scanned: pattern, ridges and pores."""

    pattern: Literal["arch", "loop", "whorl"] = "loop"
    ridge_period_um: float = field(
        460.0, unit="um", bounds=(100.0, 2000.0), source="Cummins and Midlo (1943): 20.7 and 23.4 ridges a cm in adults"
    )
    ridge_height_um: float = field(60.0, unit="um", bounds=(1.0, 500.0), doc="crest over furrow; not of one finger")
    pore_spacing_um: float = field(
        800.0, unit="um", bounds=(0.0, 10000.0), null=0.0, doc="nearest distance along a ridge; 0: no pores"
    )
    pore_diameter_um: float = field(150.0, unit="um", bounds=(10.0, 500.0), source="Locard (1912): 88 to 220 um")
    orientation_deg: float = field(0.0, unit="deg", bounds=(-180.0, 180.0), doc="by which the print is turned")
    size_mm: float = field(20.0, unit="mm", bounds=(2.0, 60.0), doc="side of the grown skin")
    seed: int = field(0, unit="1", bounds=(0, 2**62))


OWN = "own"
"""Name of the material of a finger whose stiffness stands in the scene itself."""

OWN_FIGURES = ("modulus_MPa", "reduced_modulus", "mooney_rivlin")
"""Keys of a finger of which one stands in place of a named material."""


class ForceModulus(Strict):
    """Reduced modulus E*(F) on flat glass: two columns, straight lines between, constant below the first."""

    force_N: tuple[float, ...] = field(unit="N", bounds=(0.0, 1000.0), min_length=2, max_length=10_000, doc="rises")
    modulus_MPa: tuple[float, ...] = field(unit="MPa", bounds=(1e-5, 1e5), min_length=2, max_length=10_000)

    @model_validator(mode="after")
    def _columns(self) -> Self:
        if len(self.force_N) != len(self.modulus_MPa):
            raise ValueError(
                f"finger.reduced_modulus: {len(self.force_N)} forces and {len(self.modulus_MPa)} moduli"
                " (allowed: one modulus to each force)"
            )
        if any(b <= a for a, b in zip(self.force_N, self.force_N[1:], strict=False)):
            raise ValueError("finger.reduced_modulus.force_N does not rise (allowed: each force larger than the last)")
        return self


class OwnMooneyRivlin(Strict):
    """Mooney-Rivlin figures of a compression test, as ``evanesce bench stiffness --test compression`` gives them."""

    C10_Pa: float = field(unit="Pa", bounds=(-1e9, 1e9))
    C01_Pa: float = field(unit="Pa", bounds=(-1e9, 1e9))
    C11_Pa: float = field(0.0, unit="Pa", bounds=(-1e9, 1e9))

    @model_validator(mode="after")
    def _stiff(self) -> Self:
        if self.C10_Pa + self.C01_Pa <= 0:
            raise ValueError(
                f"finger.mooney_rivlin: C10_Pa + C01_Pa = {self.C10_Pa + self.C01_Pa:g} (allowed: above 0 Pa, or the"
                " undeformed silicone has no stiffness)"
            )
        return self


class Finger(Strict):
    """Cylinder with a hemispherical tip, pressed along the plate's normal.

    Its stiffness is that of a named material, or of one of :data:`OWN_FIGURES`.
    """

    tip_radius_mm: float = field(7.5, unit="mm", bounds=(0.5, 100.0), source="thesis, chapter 3")
    diameter_mm: float = field(15.0, unit="mm", bounds=(0.5, 200.0), source="thesis, chapter 3")
    length_mm: float = field(25.0, unit="mm", bounds=(0.5, 500.0), source="thesis, chapter 3")
    position_mm: tuple[float, float] = field(
        (0.0, 0.0), unit="mm", bounds=(-500.0, 500.0), doc="tip on the plate, (x, y)"
    )
    material: str = "silskin_0"
    modulus_MPa: float | None = field(None, unit="MPa", bounds=(1e-4, 1e5), doc="Young's modulus of an own silicone")
    reduced_modulus: ForceModulus | None = None
    mooney_rivlin: OwnMooneyRivlin | None = None
    refractive_index: float = field(1.41, unit="1", bounds=(1.0, 2.5), doc="silicone; published 1.395 to 1.432")
    diffuse_reflectance: float = field(0.6, unit="1", bounds=(0.0, 1.0), doc="of the silicone body; not published")
    scattering_length_mm: float = field(
        0.0,
        unit="mm",
        bounds=(0.0, 5.0),
        null=0.0,
        doc="transport mean free path inside the silicone; 0: light leaves where it entered",
    )
    scattering_share: float = field(
        1.0,
        unit="1",
        bounds=(0.0, 1.0),
        null=1.0,
        doc="of the light that the silicone returns, the part scattered below the surface; the rest leaves at once",
    )
    scattering_power: float = field(
        0.0,
        unit="1",
        bounds=(0.0, 4.0),
        null=0.0,
        doc="reduced scattering goes as wavelength^-power: 4 for the finest particles, 0 for coarse; not published",
    )
    absorption_power: float = field(
        0.0, unit="1", bounds=(-12.0, 12.0), null=0.0, doc="absorption goes as wavelength^-power; not published"
    )
    roughness_rms_slope: float = field(
        0.0, unit="1", bounds=(0.0, 10.0), null=0.0, doc="rms gradient of the skin's roughness; sets real contact"
    )
    modulus_factor: float = field(
        1.0, unit="1", bounds=(0.05, 20.0), null=1.0, doc="stiffness of the silicone over that of its material"
    )
    stiffening_per_N: float = field(
        0.0, unit="1/N", bounds=(0.0, 5.0), null=0.0, doc="relative rise of the finger's stiffness with normal force"
    )
    work_of_adhesion_N_per_mm: float = field(
        0.0, unit="N/mm", bounds=(0.0, 0.1), null=0.0, doc="beside what the contact law has; 0.001 N/mm is 1 J/m^2"
    )
    ridges: Ridges | None = None
    height_map: ScannedSkin | None = None
    fingerprint: Fingerprint | None = None

    @model_validator(mode="after")
    def _one_stiffness(self) -> Self:
        given = [key for key in OWN_FIGURES if getattr(self, key) is not None]
        if given and "material" not in self.model_fields_set:  # figures alone need no name; the object is frozen
            object.__setattr__(self, "material", OWN)
            self.model_fields_set.add("material")
        if len(given) > 1 or bool(given) != (self.material == OWN):
            named = [] if self.material == OWN else [f"finger.material = '{self.material}'"]
            found = " and ".join([*named, *(f"finger.{key}" for key in given)]) or f"finger.material = '{OWN}' alone"
            raise ValueError(
                f"{found} (allowed: a named material, or material '{OWN}' with one of {', '.join(OWN_FIGURES)})"
            )
        return self

    @property
    def is_smooth(self) -> bool:
        """Whether the tip carries neither ridges nor a height map nor a print."""
        return self.ridges is None and self.height_map is None and self.fingerprint is None


class Tilted(Strict):
    """How the finger stands on the glass, whatever the law."""

    tilt_deg: float | None = field(
        None, unit="deg", bounds=(0.0, 60.0), null=0.0, doc="of the finger's axis from the plate's normal; of a press"
    )
    tilt_direction_deg: float | None = field(
        None, unit="deg", bounds=(-180.0, 180.0), doc="to which the finger's top leans, from x towards y; none: x"
    )


class HertzLaw(Tilted):
    """Hertz with E* = intercept + slope F; both from the material unless given here."""

    law: Literal["hertz"]
    reduced_modulus_MPa: float | None = field(None, unit="MPa", bounds=(1e-5, 1e5))
    reduced_modulus_slope_MPa_per_N: float | None = field(None, unit="MPa/N", bounds=(-10.0, 10.0))


class ScaledHertzLaw(Tilted):
    """Hertz whose area is multiplied by a factor (thesis, section 5.5.1: 1.66 for Silskin 20 %)."""

    law: Literal["scaled_hertz"]
    area_scale: float = field(unit="1", bounds=(0.01, 100.0))
    reduced_modulus_MPa: float | None = field(None, unit="MPa", bounds=(1e-5, 1e5))
    reduced_modulus_slope_MPa_per_N: float | None = field(None, unit="MPa/N", bounds=(-10.0, 10.0))


class JkrLaw(Tilted):
    """Johnson, Kendall and Roberts: Hertz with adhesion. 0.001 N/mm is 1 J/m^2."""

    law: Literal["jkr"]
    work_of_adhesion_N_per_mm: float = field(unit="N/mm", bounds=(0.0, 0.1), null=0.0)
    reduced_modulus_MPa: float | None = field(None, unit="MPa", bounds=(1e-5, 1e5))
    reduced_modulus_slope_MPa_per_N: float | None = field(None, unit="MPa/N", bounds=(-10.0, 10.0))


class XydasKaoLaw(Tilted):
    """Power law a = c N^gamma of Xydas and Kao for soft fingers."""

    law: Literal["xydas_kao"]
    c_mm: float = field(unit="mm", bounds=(0.01, 100.0), doc="contact radius at 1 N")
    gamma: float = field(unit="1", bounds=(0.0, 1.0 / 3.0))


class HalfspaceLaw(Tilted):
    """Elastic half-space carrying tip and ridges as a height map, solved on the contact grid."""

    law: Literal["halfspace"]
    work_of_adhesion_N_per_mm: float = field(0.0, unit="N/mm", bounds=(0.0, 0.1), null=0.0)
    layer_mm: float | None = field(
        None, unit="mm", bounds=(0.05, 100.0), doc="incompressible tissue of this thickness on bone; none: endless"
    )
    skin_modulus_MPa: float | None = field(
        None,
        unit="MPa",
        bounds=(1e-4, 1e5),
        doc="E* at the relief, of a stiffer skin over layer_mm; none: the tissue's",
    )
    cohesive_stress_MPa: float | None = field(
        None, unit="MPa", bounds=(1e-6, 1e3), doc="Dugdale's tension; none: as large as the grid resolves"
    )
    reduced_modulus_MPa: float | None = field(None, unit="MPa", bounds=(1e-5, 1e5))
    reduced_modulus_slope_MPa_per_N: float | None = field(None, unit="MPa/N", bounds=(-10.0, 10.0))


class FemLaw(Tilted):
    """Finite elements: the solved press of the thesis's finger that ships with the project, ridges by a half-space.

    The thesis cast a bone in and does not print its size: half the tip's radius is assumed, none is a solid finger.
    """

    law: Literal["fem"]
    bone: Literal["none", "half"] = "half"
    reduced_modulus_MPa: float | None = field(
        None, unit="MPa", bounds=(1e-5, 1e5), doc="at the ridges and the roughness; none: 4 G of the material"
    )


Contact = Annotated[
    HertzLaw | ScaledHertzLaw | JkrLaw | XydasKaoLaw | HalfspaceLaw | FemLaw, Field(discriminator="law")
]
