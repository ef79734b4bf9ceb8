"""Dynamic mechanical analysis: a lab's CSV or the thesis's published ranges -> Prony series and shift."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from evanesce.bench.prony_fit import fit_prony
from evanesce.core.columns import Column, read_columns
from evanesce.core.errors import InputError
from evanesce.materials.prony import PronySeries
from evanesce.materials.tables import DmaRange, material, material_names

Floats = NDArray[np.float64]

COLUMNS = (
    Column("frequency", ("freq", "f"), "frequency"),
    Column("temperature", ("temp", "t"), "temperature", required=False),
    Column("storage_modulus", ("storage", "e_prime", "e1"), "stress"),
    Column("loss_factor", ("tan_delta", "tandelta", "tan_d"), "ratio", required=False),
    Column("loss_modulus", ("loss", "e_double_prime", "e2"), "stress", required=False),
)

# A rubber's storage modulus and a DMA's band; outside, a unit is off by 1000 rather than the material unusual.
PLAUSIBLE_STORAGE_MPa = (1e-4, 1e4)
PLAUSIBLE_FREQUENCY_hz = (1e-5, 1e5)
PLAUSIBLE_TEMPERATURE_C = (-150.0, 400.0)


@dataclass(frozen=True)
class DmaTable:
    """A sweep: one row per frequency and temperature.

    Attributes
    ----------
    frequency : ndarray (n,)
        [Hz].
    temperature : ndarray (n,)
        [degC].
    storage : ndarray (n,)
        E' [MPa].
    loss_factor : ndarray (n,)
        tan(delta).
    """

    frequency: Floats
    temperature: Floats
    storage: Floats
    loss_factor: Floats

    def at(self, temperature: float) -> DmaTable:
        """Return the rows of the measured temperature nearest to one [degC].

        Parameters
        ----------
        temperature : float
            [degC].

        Returns
        -------
        DmaTable
        """
        nearest = self.temperature[np.argmin(np.abs(self.temperature - temperature))]
        rows = self.temperature == nearest
        return DmaTable(self.frequency[rows], self.temperature[rows], self.storage[rows], self.loss_factor[rows])


def read_dma(path: Path, default_temperature: float = 20.0) -> DmaTable:
    """Read a sweep from a CSV file with units in its headings.

    Wanted: ``frequency_Hz`` (or rad/s), ``storage_modulus_MPa`` (Pa, kPa, GPa), and either ``loss_factor`` or
    ``loss_modulus_MPa``; ``temperature_C`` (or K) optional.

    Parameters
    ----------
    path : Path
    default_temperature : float
        Where the file has none [degC].

    Returns
    -------
    DmaTable

    Raises
    ------
    InputError
        For a missing column or unit, a non-positive or implausible figure (row and allowed range named).
    """
    data = read_columns(path, COLUMNS)
    if "loss_factor" in data:
        tan = data["loss_factor"]
    elif "loss_modulus" in data:
        with np.errstate(divide="ignore", invalid="ignore"):
            tan = data["loss_modulus"] / data["storage_modulus"]
    else:
        raise InputError("no column 'loss_factor' or 'loss_modulus'", file=path, allowed="one of the two")
    temperature = data.get("temperature", np.full(len(tan), default_temperature))
    checks: Mapping[str, tuple[Floats, tuple[float, float], str]] = {
        "frequency": (data["frequency"], PLAUSIBLE_FREQUENCY_hz, "Hz"),
        "temperature": (temperature, PLAUSIBLE_TEMPERATURE_C, "degC"),
        "storage_modulus": (data["storage_modulus"], PLAUSIBLE_STORAGE_MPa, "MPa"),
        "loss_factor": (tan, (1e-6, 100.0), "(ratio)"),
    }
    for name, (values, (low, high), unit) in checks.items():
        bad = np.flatnonzero(~((values >= low) & (values <= high)))
        if len(bad):
            raise InputError(
                f"row {bad[0] + 2}: {values[bad[0]]:g} {unit} is implausible; is the unit right?",
                file=path,
                key=name,
                allowed=f"{low:g} to {high:g} {unit}",
            )
    if len(tan) < 2:
        raise InputError("one row only", file=path, allowed="at least 2 frequencies")
    return DmaTable(data["frequency"], temperature, data["storage_modulus"], tan)


def from_range(published: DmaRange, temperature: float, points: int = 21) -> DmaTable:
    """Return the simplest sweep that has the published extremes.

    The thesis prints extremes over 1 to 100 Hz and 0 to 50 degC and no curves (section 3.2). E' is taken as a power of
    frequency, falling linearly with temperature by the published drop, largest at 100 Hz and 0 degC, smallest at 1 Hz
    and 50 degC; the loss factor runs through its range evenly in log frequency. That fixes the exponent; the rise from
    1 to 80 Hz then follows and lies above the printed bound for both materials (39 % for "over 30 %", 112 % for "over
    65 %").

    Parameters
    ----------
    published : DmaRange
    temperature : float
        [degC], 0 to 50.
    points : int
        Frequencies from 1 to 100 Hz.

    Returns
    -------
    DmaTable
    """
    if not 0.0 <= temperature <= 50.0:
        raise ValueError(f"{temperature:g} degC is outside the published sweep of 0 to 50 degC")
    low, high = published.storage_modulus_MPa
    exponent = np.log(high * (1.0 - published.drop_0_to_50_C_at_80_hz) / low) / np.log(100.0)
    frequency = np.logspace(0.0, 2.0, points)
    storage = high * (frequency / 100.0) ** exponent * (1.0 - published.drop_0_to_50_C_at_80_hz * temperature / 50.0)
    share = np.log(frequency) / np.log(100.0)
    tan = (1.0 - share) * published.loss_factor[0] + share * published.loss_factor[1]
    return DmaTable(frequency, np.full(points, float(temperature)), storage, tan)


def loss_from_slope(table: DmaTable) -> Floats:
    """Return the loss factor that causality asks for, tan(delta) = (pi/2) d ln E'/d ln omega, at one temperature.

    A check on a sweep: where it is far from the measured loss factor, storage and loss were not measured at the same
    strain or temperature, or a unit is wrong. The local form is an approximation, good for broad spectra.

    Parameters
    ----------
    table : DmaTable
        At one temperature.

    Returns
    -------
    ndarray (n,)

    References
    ----------
    H. C. Booij and G. P. J. M. Thoone, Rheol. Acta 21 (1982) 15 (local Kramers-Kronig relations).
    """
    order = np.argsort(table.frequency)
    slope = np.gradient(np.log(table.storage[order]), np.log(table.frequency[order]))
    result = np.empty_like(slope)
    result[order] = np.pi / 2.0 * slope
    return result


def prony_of(name: str, temperature: float = 20.0) -> PronySeries:
    """Return the Prony series of a thesis material from its published DMA ranges [MPa, s].

    Parameters
    ----------
    name : str
        Material.
    temperature : float
        [degC], 0 to 50.

    Returns
    -------
    PronySeries

    Raises
    ------
    InputError
        For a material without published dynamic data.
    """
    published = material(name).dma
    if published is None:
        known = ", ".join(n for n in material_names() if material(n).dma is not None)
        raise InputError(f"no dynamic data for {name!r}", key="material", allowed=known)
    table = from_range(published, temperature)
    return fit_prony(table.frequency, table.storage, table.loss_factor).series
