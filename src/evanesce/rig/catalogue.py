"""Parts that a rig is made of, as bought: plate materials, LED packages, cameras. Data with their sources."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import TypeVar

from evanesce.core.errors import InputError

Part = TypeVar("Part")


@dataclass(frozen=True, kw_only=True)
class PlateMaterial:
    """Transparent material of a plate.

    Attributes
    ----------
    sellmeier : tuple of tuple of float
        (strength [1], squared resonance [um^2]) of each term of n^2 = 1 + sum s L^2/(L^2 - r), L in um.
    absorption : mapping of float to float
        Absorption coefficient [1/mm] by vacuum wavelength [nm], rising; straight lines between.
    index_source, absorption_source : str
        Sentences for a scene.
    """

    sellmeier: tuple[tuple[float, float], ...]
    absorption: Mapping[float, float]
    index_source: str
    absorption_source: str

    def index(self, wavelength: float) -> float:
        """Return the refractive index [1] at a vacuum wavelength [nm], to four decimals."""
        um2 = (wavelength * 1e-3) ** 2
        return round(float((1.0 + sum(s * um2 / (um2 - r) for s, r in self.sellmeier)) ** 0.5), 4)

    def absorption_per_mm(self, wavelength: float) -> float:
        """Return the absorption coefficient [1/mm] at a vacuum wavelength [nm]; beyond the table, its end."""
        known = sorted(self.absorption.items())
        for (low, a), (high, b) in itertools.pairwise(known):
            if low <= wavelength <= high:
                return a + (b - a) * (wavelength - low) / (high - low)
        return known[0][1] if wavelength < known[0][0] else known[-1][1]


_SULTANOVA = "Sultanova, Kasarova and Nikolov, Acta Phys. Pol. A 116 (2009) 585"
_RUBIN = "Rubin, Solar Energy Materials 12 (1985) 275"
_FIBRES = "fibre at 650 nm, ISRN Optics 2013, 785162, table 1; sheet absorbs more: measure it"

# Soda-lime: one term fitted to Rubin's formula (optics/spectrum.py) from 450 to 950 nm, within 7e-4; absorption
# 4 pi k / L of Rubin's k (optics/glass.py).
MATERIALS: Mapping[str, PlateMaterial] = MappingProxyType(
    {
        "glass": PlateMaterial(
            sellmeier=((1.28099, 0.010176),),
            absorption=MappingProxyType({450.0: 0.0043, 550.0: 0.0040, 634.0: 0.0116, 850.0: 0.0374}),
            index_source=f"soda-lime float glass, {_RUBIN}",
            absorption_source=f"clear float glass of 0.1 % iron oxide, {_RUBIN}; low-iron glass has a tenth or less",
        ),
        "low_iron_glass": PlateMaterial(
            sellmeier=((1.28099, 0.010176),),
            absorption=MappingProxyType({450.0: 0.0002, 850.0: 0.0010}),
            index_source=f"soda-lime float glass, {_RUBIN}",
            absorption_source="assumed, as for the rig of the thesis: clear soda-lime; makers differ",
        ),
        "pmma": PlateMaterial(
            sellmeier=((1.1819, 0.011313),),
            absorption=MappingProxyType({650.0: 3.5e-5, 850.0: 5.0e-4}),
            index_source=f"PMMA, {_SULTANOVA}",
            absorption_source=f"0.15 dB/m, {_FIBRES}; 2 dB/m at 850 nm is assumed",
        ),
        "pc": PlateMaterial(
            sellmeier=((1.4182, 0.021304),),
            absorption=MappingProxyType({650.0: 1.2e-4, 850.0: 5.0e-4}),
            index_source=f"polycarbonate, {_SULTANOVA}",
            absorption_source=f"0.5 dB/m, {_FIBRES}; 2 dB/m at 850 nm is assumed",
        ),
    }
)


@dataclass(frozen=True, kw_only=True)
class Package:
    """LED package: the face that emits, as a rectangle of the same area.

    Attributes
    ----------
    width_mm, height_mm : float
        Along the strip and across it [mm].
    source : str
    """

    width_mm: float
    height_mm: float
    source: str


PACKAGES: Mapping[str, Package] = MappingProxyType(
    {
        "2835": Package(width_mm=3.0, height_mm=2.6, source="2835 package, body 3.5 x 2.8 mm; phosphor assumed"),
        "3528": Package(
            width_mm=2.1, height_mm=2.1, source="3528 package, body 3.5 x 2.8 mm; round cup of 2.4 mm assumed"
        ),
        "5050": Package(
            width_mm=3.5, height_mm=3.5, source="5050 package, body 5.0 x 5.0 mm; round cup of 4.0 mm assumed"
        ),
        "3014": Package(width_mm=2.5, height_mm=1.0, source="3014 package, body 3.0 x 1.4 mm; phosphor assumed"),
        "0805": Package(width_mm=1.3, height_mm=1.2, source="0805 package, body 2.0 x 1.25 mm; lens assumed"),
        "0603": Package(width_mm=1.0, height_mm=0.8, source="0603 package, body 1.6 x 0.8 mm; lens assumed"),
    }
)


@dataclass(frozen=True, kw_only=True)
class CameraPart:
    """Camera as bought, in the mode in which it films.

    Attributes
    ----------
    resolution_px : tuple of int
        (columns, rows) of that mode.
    pitch_um : float
        Of a pixel of that mode [um].
    full_well_capacity_e : float
        Of a pixel of that mode [e-].
    bits : int
        Of the raw numbers.
    tone_curve : str
    focal_length_mm, f_number : float
        Of the lens it is sold with, or the usual one.
    colour : bool
        Whether it has colour filters.
    source : str
        Of resolution, pitch and lens.
    """

    resolution_px: tuple[int, int]
    pitch_um: float
    full_well_capacity_e: float
    bits: int = 12
    tone_curve: str
    focal_length_mm: float
    f_number: float
    colour: bool = True
    source: str


_PI = "Raspberry Pi documentation, camera hardware"
_WELL_PER_UM2 = 8180.0 / 3.1**2
"""Full well of an IMX477 over a pixel's area [e-/um^2]: that of pixels whose well is not published."""


def _well(pitch: float) -> float:
    return float(round(_WELL_PER_UM2 * pitch**2, -1))


CAMERAS: Mapping[str, CameraPart] = MappingProxyType(
    {
        "pi_hq": CameraPart(
            resolution_px=(2028, 1520), pitch_um=3.1, full_well_capacity_e=8180.0, tone_curve="bt709",
            focal_length_mm=6.0, f_number=2.8, source=f"IMX477, binned 2 x 2 ({_PI}); 6 mm wide-angle lens",
        ),
        "pi_3": CameraPart(
            resolution_px=(2304, 1296), pitch_um=2.8, full_well_capacity_e=_well(2.8), tone_curve="bt709",
            focal_length_mm=4.74, f_number=1.8, source=f"Camera Module 3: IMX708, binned 2 x 2 ({_PI})",
        ),
        "pi_2": CameraPart(
            resolution_px=(1640, 1232), pitch_um=2.24, full_well_capacity_e=_well(2.24), bits=10, tone_curve="bt709",
            focal_length_mm=3.04, f_number=2.0, source=f"Camera Module 2: IMX219, binned 2 x 2 ({_PI})",
        ),
        "pi_gs": CameraPart(
            resolution_px=(1456, 1088), pitch_um=3.45, full_well_capacity_e=_well(3.45), bits=10, tone_curve="bt709",
            focal_length_mm=6.0, f_number=2.8, source=f"Global Shutter Camera: IMX296 ({_PI}); 6 mm wide-angle lens",
        ),
        "usb": CameraPart(
            resolution_px=(1920, 1080), pitch_um=3.0, full_well_capacity_e=_well(3.0), bits=10, tone_curve="srgb",
            focal_length_mm=3.6, f_number=2.0, source="OV2710, as in many USB cameras; M12 lens of 3.6 mm assumed",
        ),
        "machine_vision": CameraPart(
            resolution_px=(1440, 1080), pitch_um=3.45, full_well_capacity_e=10500.0, tone_curve="linear",
            focal_length_mm=8.0, f_number=2.8, colour=False, source="IMX273, monochrome; C-mount lens of 8 mm assumed",
        ),
    }
)  # fmt: skip


def chosen(parts: Mapping[str, Part], name: str, key: str) -> Part:
    """Return a part by its name.

    Parameters
    ----------
    parts : mapping
        :data:`MATERIALS`, :data:`PACKAGES` or :data:`CAMERAS`.
    name : str
    key : str
        Named in the error.

    Raises
    ------
    InputError
        If there is none of that name.
    """
    if name not in parts:
        raise InputError(f"'{name}' is not known", key=key, allowed=", ".join(parts))
    return parts[name]
