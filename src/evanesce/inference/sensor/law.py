"""Rows of variance, the terms that a sensor model may have, and the variance that they predict."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from copy import copy
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from evanesce.core.arrhenius import rate_factor
from evanesce.rig.camera import Pixel
from evanesce.sensor.variance import frame_variance

Array = NDArray[np.float64]
Kind = Literal["transfer", "dark"]


@dataclass(frozen=True)
class VarianceSeries:
    """Variances of one kind of pixels under one condition.

    Attributes
    ----------
    name : str
        Of the series.
    pixels : str
        Of the kind of pixels: series of one kind share what their pixels have.
    x : ndarray (n,)
        Signal above the black level [DN] of a photon transfer, exposure [s] of a dark series; ascending.
    variance_DN2 : ndarray (n,)
        [DN^2].
    analogue_gain, temperature_C : float
    """

    name: str
    pixels: str
    x: Array
    variance_DN2: Array
    analogue_gain: float = 1.0
    temperature_C: float = 20.0


@dataclass(frozen=True)
class Term:
    """A term of the sensor model.

    Attributes
    ----------
    id : str
    kind : {"transfer", "dark"}
        Of rows in which it shows.
    words : str
        What it is.
    key : str
        In ``[camera.pixel]``; empty where the sensor model has no such term.
    base : float
        Median of its prior.
    deviation : float
        Of the prior, in the logarithm of the value (of the value itself for ``curvature``).
    per : {"sensor", "pixels", "series"}
        Whether one value holds for all, or each kind of pixels or series has its own.
    needs : tuple of str
        Terms of which one must be there.
    """

    id: str
    kind: Kind
    words: str
    key: str
    base: float
    deviation: float
    per: Literal["sensor", "pixels", "series"] = "sensor"
    needs: tuple[str, ...] = ()


def terms_of(pixel: Pixel, kind: Kind) -> tuple[Term, ...]:
    """Return the terms that may show in rows of one kind, with priors about a nominal pixel.

    Parameters
    ----------
    pixel : Pixel
    kind : {"transfer", "dark"}
    """
    gain, read = pixel.conversion_gain_e_per_DN, max(pixel.read_noise_e, 0.1)
    rates = ("dark_current", "dark_nonuniformity")
    every = (
        Term("gain", "transfer", "another conversion gain", "conversion_gain_e_per_DN", gain, 0.15),
        Term("read_noise", "transfer", "another read noise", "read_noise_e", read, 0.5),
        Term("prnu", "transfer", "a quadratic term: PRNU, or light that varies over the region", "prnu", 0.01, 1.0),
        Term("dsnu", "transfer", "variance without light, by kind of pixels", "dsnu_e", 2.0, 1.0, "pixels"),
        Term("gain_each", "transfer", "a gain that differs between series", "", 1.0, 0.05, "series"),
        Term("prnu_each", "transfer", "a quadratic term by series", "", 1.0, 0.3, "series", ("prnu",)),
        Term("curvature", "transfer", "a gain that changes with the signal", "", 0.0, 0.1),
        Term("read_noise", "dark", "another read noise", "read_noise_e", read, 0.5),
        Term("dark_current", "dark", "shot noise of a dark current", "dark_current_e_per_s", 0.3, 1.5),
        Term("dark_nonuniformity", "dark", "dark current that varies over the pixels", "dark_nonuniformity_e_per_s",
             0.03, 1.5),
        Term("temperature_law", "dark", "Arrhenius' law of the dark current", "dark_activation_energy_eV", 0.6, 0.5,
             "sensor", rates),
        Term("dark_each", "dark", "dark current by kind of pixels", "", 1.0, 0.7, "pixels", rates),
        Term("energy_each", "dark", "an activation energy by kind of pixels", "", 1.0, 0.3, "pixels",
             ("temperature_law",)),
        Term("hot_pixel_limit", "dark", "excess variance that levels off: hot pixels that saturate or are corrected",
             "", 60.0, 1.0, "pixels", rates),
    )  # fmt: skip
    return tuple(term for term in every if term.kind == kind)


class VarianceLaw:
    """Log variance of series by a set of terms.

    Parameters
    ----------
    series : sequence of VarianceSeries
    kind : {"transfer", "dark"}
    pixel : Pixel
        Nominal: what it has is held where no term frees it.
    terms : collection of str
    """

    def __init__(self, series: Sequence[VarianceSeries], kind: Kind, pixel: Pixel, terms: Collection[str]) -> None:
        self.series, self.kind, self.pixel = tuple(series), kind, pixel
        self.terms = tuple(term for term in terms_of(pixel, kind) if term.id in terms)
        self.owners: list[tuple[Term, str]] = []
        for term in self.terms:
            names = {"sensor": [""], "pixels": [s.pixels for s in series], "series": [s.name for s in series]}[term.per]
            self.owners += [(term, name) for name in dict.fromkeys(names)]
        self._place = {(term.id, name): i for i, (term, name) in enumerate(self.owners)}
        ends = np.cumsum([0, *(one.x.size for one in series)])
        self.rows = tuple(slice(int(a), int(b)) for a, b in pairwise(ends))
        self.deviation = np.array([term.deviation for term, _ in self.owners])

    def log_variance(self, values: Array) -> Array:
        """Return the logarithm of the predicted variances of all rows.

        Parameters
        ----------
        values : ndarray (k,)
            Of the parameters: logarithm over the prior's median.

        Returns
        -------
        ndarray (rows,)
        """
        return np.concatenate([self._log(one, values) for one in self.series])

    def slopes(self, values: Array, step: float = 1e-4) -> Array:
        """Return the derivative of :meth:`log_variance` by each value (rows, k), by central differences.

        Parameters
        ----------
        values : ndarray (k,)
        step : float
        """
        found = np.zeros((self.rows[-1].stop, values.size))
        for i, (_, name) in enumerate(self.owners):
            change = np.zeros_like(values)
            change[i] = step
            for one, rows in zip(self.series, self.rows, strict=True):
                if name in ("", one.pixels, one.name):
                    found[rows, i] = (self._log(one, values + change) - self._log(one, values - change)) / (2.0 * step)
        return found

    def _log(self, one: VarianceSeries, values: Array) -> Array:
        return np.log(self._transfer(one, values) if self.kind == "transfer" else self._dark(one, values))

    def of_series(self, one: VarianceSeries) -> VarianceLaw:
        """Return the law with the same parameters for one series of names and pixels that it has.

        Parameters
        ----------
        one : VarianceSeries
        """
        other = copy(self)
        other.series, other.rows = (one,), (slice(0, one.x.size),)
        return other

    def found(self, values: Array) -> Mapping[str, Mapping[str, float]]:
        """Return each term's values in its own unit, by kind of pixels or series (by "" where one holds for all).

        Parameters
        ----------
        values : ndarray (k,)
        """
        result: dict[str, dict[str, float]] = {}
        for (term, name), value in zip(self.owners, values, strict=True):
            own = float(value) if term.id == "curvature" else float(term.base * np.exp(value))
            result.setdefault(term.id, {})[name] = own
        return result

    def _value(self, term: str, one: VarianceSeries, values: Array, absent: float) -> float:
        for name in ("", one.pixels, one.name):
            if (place := self._place.get((term, name))) is not None:
                return float(self.owners[place][0].base * np.exp(values[place]))
        return absent

    def _transfer(self, one: VarianceSeries, values: Array) -> Array:
        pixel = self.pixel
        gain = self._value("gain", one, values, pixel.conversion_gain_e_per_DN)
        gain *= self._value("gain_each", one, values, 1.0)
        prnu = self._value("prnu", one, values, pixel.prnu) * self._value("prnu_each", one, values, 1.0)
        bend = values[self._place["curvature", ""]] if ("curvature", "") in self._place else 0.0
        scale = gain * np.exp(bend * one.x / 2**pixel.bits)
        return frame_variance(
            np.maximum(one.x, 0.0) * scale / one.analogue_gain, exposure_s=0.0, conversion_gain_e_per_DN=scale,
            analogue_gain=one.analogue_gain, read_noise_e=self._value("read_noise", one, values, pixel.read_noise_e),
            prnu=prnu, dsnu_e=self._value("dsnu", one, values, pixel.dsnu_e), dark_current_e_per_s=0.0,
            dark_nonuniformity_e_per_s=0.0,
        )  # fmt: skip

    def _dark(self, one: VarianceSeries, values: Array) -> Array:
        pixel = self.pixel
        energy = self._value("temperature_law", one, values, pixel.dark_activation_energy_eV)
        energy *= self._value("energy_each", one, values, 1.0)
        rate = rate_factor(energy, pixel.dark_reference_C, one.temperature_C)
        rate *= self._value("dark_each", one, values, 1.0)
        common = {
            "conversion_gain_e_per_DN": pixel.conversion_gain_e_per_DN, "analogue_gain": one.analogue_gain,
            "read_noise_e": self._value("read_noise", one, values, pixel.read_noise_e), "prnu": 0.0,
            "dsnu_e": pixel.dsnu_e,
            "dark_current_e_per_s": rate * self._value("dark_current", one, values, pixel.dark_current_e_per_s),
            "dark_nonuniformity_e_per_s": rate
            * self._value("dark_nonuniformity", one, values, pixel.dark_nonuniformity_e_per_s),
        }  # fmt: skip
        whole = frame_variance(0.0, exposure_s=one.x, **common)
        limit = self._value("hot_pixel_limit", one, values, np.inf)
        still = frame_variance(0.0, exposure_s=0.0, **common)
        return np.asarray(still + (whole - still) / (1.0 + (whole - still) / limit))
