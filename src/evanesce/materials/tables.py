"""Published values of the silicones, read strictly from ``silicones.toml``; every value keeps its source."""

from __future__ import annotations

import tomllib
from functools import lru_cache
from pathlib import Path
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field, model_validator

from evanesce.core.errors import InputError
from evanesce.core.quantities import Strict, field
from evanesce.rig.finger import OWN, Finger, ForceModulus
from evanesce.rig.load import validate

TABLES = Path(__file__).resolve().parent / "silicones.toml"


class Sourced(Strict):
    """Published values with their source and a caution."""

    source: str = Field(min_length=1)
    caution: str = ""


class Figure(Sourced):
    """One pure number."""

    value: float = field(unit="1", bounds=(0.0, 100.0))


class Deviation(Figure):
    """A relative deviation at one force."""

    force_N: float = field(unit="N", bounds=(0.0, 1000.0))


class DeadenerSweep(Sourced):
    """Young's modulus against deadener."""

    deadener_percent: tuple[int, ...] = field(unit="%", bounds=(0, 100), min_length=2)
    modulus_MPa: tuple[float, ...] = field(unit="MPa", bounds=(1e-5, 1e5), min_length=2)

    @model_validator(mode="after")
    def _pairs(self) -> Self:
        if len(self.deadener_percent) != len(self.modulus_MPa):
            raise ValueError("deadener_percent and modulus_MPa differ in length")
        if any(b <= a for a, b in zip(self.deadener_percent, self.deadener_percent[1:], strict=False)):
            raise ValueError("deadener_percent must increase")
        return self


class MooneyRivlin(Sourced):
    """Three-parameter Mooney-Rivlin, incompressible: W = C10 (I1-3) + C01 (I2-3) + C11 (I1-3)(I2-3)."""

    C10_Pa: float = field(unit="Pa", bounds=(-1e9, 1e9))
    C01_Pa: float = field(unit="Pa", bounds=(-1e9, 1e9))
    C11_Pa: float = field(unit="Pa", bounds=(-1e9, 1e9))

    @property
    def shear_modulus_MPa(self) -> float:
        """Small-strain shear modulus 2 (C10 + C01) [MPa]."""
        return 2e-6 * (self.C10_Pa + self.C01_Pa)

    @property
    def youngs_modulus_MPa(self) -> float:
        """Small-strain Young's modulus of the incompressible material, three times the shear modulus [MPa]."""
        return 3.0 * self.shear_modulus_MPa


class DmaRange(Sourced):
    """Ranges of a dynamic mechanical analysis; (lowest, highest)."""

    storage_modulus_MPa: tuple[float, float] = field(unit="MPa", bounds=(1e-5, 1e5))
    loss_factor: tuple[float, float] = field(unit="1", bounds=(0.0, 10.0))
    rise_1_to_80_hz: float = field(unit="1", bounds=(0.0, 100.0), doc="relative rise of the storage modulus")
    drop_0_to_50_C_at_80_hz: float = field(unit="1", bounds=(0.0, 1.0), doc="relative drop of the storage modulus")


class LinearModulus(Sourced):
    """Reduced modulus E*(F) = intercept + slope F."""

    intercept_MPa: float = field(unit="MPa", bounds=(1e-5, 1e5))
    slope_MPa_per_N: float = field(0.0, unit="MPa/N", bounds=(-10.0, 10.0))


class MeasuredArea(Sourced):
    """Two power laws A = scale F^exponent, one on either side of ``break_N``."""

    break_N: float = field(unit="N", bounds=(0.0, 1000.0))
    below_scale_mm2: float = field(unit="mm^2", bounds=(0.0, 1e4))
    below_exponent: float = field(unit="1", bounds=(0.0, 2.0))
    above_scale_mm2: float = field(unit="mm^2", bounds=(0.0, 1e4))
    above_exponent: float = field(unit="1", bounds=(0.0, 2.0))

    def area(self, force: ArrayLike) -> NDArray[np.float64]:
        """Return the measured area [mm^2] at a normal force [N].

        Parameters
        ----------
        force : array_like
            [N].

        Returns
        -------
        ndarray
            [mm^2].
        """
        force = np.asarray(force, dtype=float)
        below = self.below_scale_mm2 * force**self.below_exponent
        above = self.above_scale_mm2 * force**self.above_exponent
        return np.where(force < self.break_N, below, above)


class Friction(Sourced):
    """Friction on glass: static coefficients and interfacial rheology mu_s = tau0/p + alpha."""

    static_coefficient_smooth: float = field(unit="1", bounds=(0.0, 100.0), doc="at 1 N, 1 mm/s")
    static_coefficient_ridged: float | None = field(None, unit="1", bounds=(0.0, 100.0), doc="at 1 N, 1 mm/s")
    tau0_MPa: float = field(unit="MPa", bounds=(0.0, 100.0))
    alpha: float = field(unit="1", bounds=(0.0, 100.0))


class _Entry(Strict):
    """What the tables hold of one silicone beside its Young's modulus."""

    mooney_rivlin: MooneyRivlin
    dma: DmaRange
    flat_reduced_modulus: LinearModulus
    indenter_reduced_modulus: LinearModulus
    friction: Friction
    hertz_area_scale: Figure | None = None
    fe_area_scale: Figure | None = None
    area_deviation: Deviation | None = None
    measured_area: MeasuredArea | None = None


class _Tables(Strict):
    schema_version: int = Field(ge=1, le=1)
    poisson_ratio: Figure
    youngs_modulus: dict[str, DeadenerSweep]
    silskin_0: _Entry
    silskin_20: _Entry


class Material(Strict):
    """One silicone.

    Attributes
    ----------
    name : str
        Rubber and deadener, e.g. ``"silskin_20"`` for Silskin 10 with 20 % deadener.
    deadener_percent : int
    youngs_modulus_MPa : float
        Small-strain Young's modulus [MPa] at 10 Hz.
    poisson_ratio : float
    flat_reduced_modulus : LinearModulus
        E*(F) of the finger on flat glass: as published, or E/(1 - nu^2) where the thesis measured no such curve.
    source : str
        Of the Young's modulus.
    mooney_rivlin, dma, indenter_reduced_modulus, friction, hertz_area_scale, fe_area_scale, area_deviation, \
measured_area : optional
        None where the thesis gives nothing.
    by_force : ForceModulus or None
        E*(F) of a finger of its own, in place of ``flat_reduced_modulus``.
    """

    name: str
    deadener_percent: int
    youngs_modulus_MPa: float
    poisson_ratio: float
    flat_reduced_modulus: LinearModulus
    source: str
    mooney_rivlin: MooneyRivlin | None = None
    dma: DmaRange | None = None
    indenter_reduced_modulus: LinearModulus | None = None
    friction: Friction | None = None
    hertz_area_scale: Figure | None = None
    fe_area_scale: Figure | None = None
    area_deviation: Deviation | None = None
    measured_area: MeasuredArea | None = None
    by_force: ForceModulus | None = None

    def reduced_modulus(self, force: ArrayLike) -> NDArray[np.float64]:
        """Return E* [MPa] on flat rigid glass at a normal force [N].

        Parameters
        ----------
        force : array_like
            [N].

        Returns
        -------
        ndarray
            [MPa].
        """
        if self.by_force is not None:
            return np.interp(np.asarray(force, dtype=float), self.by_force.force_N, self.by_force.modulus_MPa)
        law = self.flat_reduced_modulus
        return law.intercept_MPa + law.slope_MPa_per_N * np.asarray(force, dtype=float)


def read_tables(path: Path = TABLES) -> _Tables:
    """Read and check a table file.

    Parameters
    ----------
    path : Path
        TOML.

    Returns
    -------
    object
        The tables, checked.

    Raises
    ------
    InputError
        Naming file and key of the first thing wrong.
    """
    try:
        data = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise InputError(f"not a readable table of materials: {error}", file=path) from None
    return validate(_Tables, data, path)


@lru_cache(maxsize=1)
def _library() -> dict[str, Material]:
    tables = read_tables()
    nu = tables.poisson_ratio.value
    library = {}
    for rubber, sweep in tables.youngs_modulus.items():
        for percent, modulus in zip(sweep.deadener_percent, sweep.modulus_MPa, strict=True):
            name = f"{rubber}_{percent}"
            entry = getattr(tables, name, None)
            known = {} if entry is None else {key: getattr(entry, key) for key in type(entry).model_fields}
            plane = LinearModulus(
                intercept_MPa=modulus / (1 - nu**2), source=f"E/(1 - nu^2) with {sweep.source}", caution=sweep.caution
            )
            library[name] = Material.model_validate(
                {
                    "name": name,
                    "deadener_percent": percent,
                    "youngs_modulus_MPa": modulus,
                    "poisson_ratio": nu,
                    "source": sweep.source,
                    "flat_reduced_modulus": plane,
                    **known,
                }
            )
    return library


def material_names() -> tuple[str, ...]:
    """Return the names of all materials.

    Returns
    -------
    tuple of str
    """
    return tuple(_library())


def material(name: str) -> Material:
    """Return a silicone by name.

    Parameters
    ----------
    name : str

    Returns
    -------
    Material

    Raises
    ------
    InputError
        If the tables do not hold it.
    """
    library = _library()
    if name not in library:
        raise InputError(f"{name!r} is not a known material", key="finger.material", allowed=", ".join(library))
    return library[name]


def silicone_of(finger: Finger) -> Material:
    """Return a finger's silicone: the named one, or that of its own figures.

    Own figures give E* on flat glass: E/(1 - nu^2) of ``modulus_MPa`` with the silicones' Poisson's ratio, the columns
    as they are, or 4 G with G = 2 (C10 + C01) of an incompressible Mooney-Rivlin solid at small strain.

    Parameters
    ----------
    finger : Finger

    Returns
    -------
    Material

    Raises
    ------
    InputError
        If the tables do not hold the name.
    """
    if finger.material != OWN:
        return material(finger.material)
    nu = read_tables().poisson_ratio.value
    fit, columns, where = None, finger.reduced_modulus, "the scene"
    if finger.mooney_rivlin is not None:
        nu, fit = 0.5, MooneyRivlin(**finger.mooney_rivlin.model_dump(), source=where)
        plane = 4.0 * fit.shear_modulus_MPa
    elif columns is not None:
        plane = columns.modulus_MPa[0]
    else:
        assert finger.modulus_MPa is not None  # checked by Finger
        plane = finger.modulus_MPa / (1 - nu**2)
    return Material(
        name=OWN, deadener_percent=0, youngs_modulus_MPa=plane * (1 - nu**2), poisson_ratio=nu, source=where,
        flat_reduced_modulus=LinearModulus(intercept_MPa=plane, source=where), mooney_rivlin=fit, by_force=columns,
    )  # fmt: skip
