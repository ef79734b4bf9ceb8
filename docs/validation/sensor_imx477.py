"""Predict what was not measured of one HQ camera's sensor from its photon transfer and dark tables, with intervals.

    python docs/validation/sensor_imx477.py FOLDER [PREDICTIONS.csv]

``FOLDER`` holds ``ptc_{white,green,red}_gain1.csv``, ``ptc_white_gain2.csv`` and ``dark_variance_{1,17}C.csv`` with
headings mean_DN, variance_DN2, bayer_class and exposure_s, variance_*_DN2, made from ``datosCalibracion`` of
LAMBDA-DF/muPi. Prints the tables of sensor-imx477.md, and writes every prediction as a row of the second file.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy import stats

from evanesce.bench.photon_transfer import fit_photon_transfer
from evanesce.bench.sensor import of_table
from evanesce.bench.sensor_tables import read_dark, read_transfer
from evanesce.inference.sensor.compare import Fitted, fit, predicted
from evanesce.inference.sensor.law import VarianceSeries
from evanesce.rig.camera import Pixel

BLACK_DN, FULL_DN = 256.0, 4095.0
# Class 1 is blue, 4 red: the red screen lights class 4 most, the green one 2 and 3.
BRIGHT = {"white": "1234", "green": "23", "red": "4", "blue": "1"}
TRANSFER_TERMS = {"gain", "gain_each", "read_noise", "dsnu", "prnu", "prnu_each"}
DARK_TERMS = {
    "dark_current", "dark_nonuniformity", "temperature_law", "dark_each", "energy_each", "hot_pixel_limit",
}  # fmt: skip
SIGNALS = np.array([50.0, 200.0, 500.0, 1000.0, 2000.0, 2500.0])
TEMPERATURES = (-10.0, -5.0, 5.0, 10.0, 25.0, 30.0)
EXPOSURES = np.array([60.0, 120.0, 300.0, 480.0])
FINE_SIGNALS = np.array([20.0, 50, 100, 200, 300, 500, 700, 1000, 1500, 2000, 2500])
FINE_TEMPERATURES = np.arange(-20.0, 41.0, 1.0)
FINE_EXPOSURES = np.array([10.0, 30, 60, 120, 200, 300, 400, 480, 600])
Rows = list[str]
KINDS = ("all", "blue", "green1", "green2", "red")


def transfer_series(folder: Path, screen: str, gain: int = 1) -> list[VarianceSeries]:
    """Return the rows below 70 % of saturation of a screen, by Bayer class."""
    found = []
    for name, table in read_transfer(folder / f"ptc_{screen}_gain{gain}.csv", FULL_DN).items():
        one = of_table(table, BLACK_DN)
        order = np.argsort(one.signal_DN)
        used = order[one.signal_DN[order] <= one.fit.limit_DN]
        found.append(VarianceSeries(f"{screen} {name}", name, one.signal_DN[used], one.variance_DN2[used], gain))
    return found


def bright(one: VarianceSeries) -> bool:
    """Return whether a screen is of the colour of a class."""
    screen, name = one.name.split()
    return name in BRIGHT[screen]


def with_unmeasured(known: Sequence[VarianceSeries], new: VarianceSeries) -> Fitted:
    """Fit the series that lit their classes alike together with one of which nothing is known.

    How much the quadratic term of series differs is estimated by them, with Student's factor for so few.
    """
    nothing = np.zeros(0)
    alike = [one for one in known if bright(one) == bright(new)]
    others = [
        VarianceSeries(one.name, one.pixels, one.x[:3], one.variance_DN2[:3]) for one in known if one not in alike
    ]
    rows = [*alike, *(one for one in others if one.pixels == new.pixels)]  # a class's foot is the same in any light
    first = fit(rows, "transfer", Pixel(), TRANSFER_TERMS)
    each = np.log([first.law.found(first.values)["prnu_each"][one.name] for one in alike])
    factor = stats.t.ppf(0.95, each.size - 1) / stats.norm.ppf(0.95) * np.sqrt(1.0 + 1.0 / each.size)
    spread = {"prnu_each": float(factor * each.std(ddof=1))}
    return fit(
        [*rows, VarianceSeries(new.name, new.pixels, nothing, nothing)], "transfer", Pixel(), TRANSFER_TERMS, spread
    )


def share_inside(fitted: Fitted, one: VarianceSeries) -> float:
    """Return the share of a series' rows that lies in its 90 % intervals."""
    _, low, high = predicted(fitted, one)
    return float(np.mean((one.variance_DN2 >= low) & (one.variance_DN2 <= high)))


def cells(fitted: Fitted, one: VarianceSeries) -> str:
    """Return medians and 90 % intervals as cells of a table."""
    return " | ".join(f"{m:.3g} ({a:.3g} to {b:.3g})" for m, a, b in zip(*predicted(fitted, one), strict=True))


def rows_of(fitted: Fitted, one: VarianceSeries, what: str) -> Rows:
    """Return medians and 90 % intervals as lines of a CSV file."""
    found = zip(one.x, *predicted(fitted, one), strict=True)
    return [f"{what},{x:g},{m:.4g},{low:.4g},{high:.4g}" for x, m, low, high in found]


def coefficients(known: Sequence[VarianceSeries]) -> None:
    """Print 90 % prediction intervals of a new series' gain and quadratic term, by Student's t over those measured."""
    fits = [(bright(one), fit_photon_transfer(one.x, one.variance_DN2, limit_DN=np.inf)) for one in known]
    sets = {
        "K of any class [e-/DN]": [np.log(f.gain_e_per_DN) for _, f in fits],
        "quadratic term of a class that the screen lights most [%]": [np.log(100 * f.prnu) for b, f in fits if b],
        "quadratic term of another class [%]": [np.log(100 * f.prnu) for b, f in fits if not b],
    }
    for name, values in sets.items():
        n = len(values)
        reach = stats.t.ppf(0.95, n - 1) * np.std(values, ddof=1) * np.sqrt(1.0 + 1.0 / n)
        low, middle, high = np.exp(np.mean(values) + reach * np.array([-1.0, 0.0, 1.0]))
        print(f"  {name}: {middle:.3g} ({low:.3g} to {high:.3g}), {n} series")


def screens(folder: Path) -> Rows:
    """Print coverage on screens left out, then the predictions for a blue one."""
    series = {screen: transfer_series(folder, screen) for screen in ("white", "green", "red")}
    print("90 % intervals for a screen that was left out: share of rows inside, Bayer classes 1 to 4")
    for screen, own in series.items():
        rest = [s for other in series if other != screen for s in series[other]]
        shares = [share_inside(with_unmeasured(rest, one), one) for one in own]
        print(f"  {screen}: " + ", ".join(f"{share:.2f}" for share in shares))
    known = [s for own in series.values() for s in own]
    rest = series["green"] + series["red"]
    shares = [share_inside(with_unmeasured(rest, one), one) for one in transfer_series(folder, "white", 2)]
    print("  white at gain 2: " + ", ".join(f"{share:.2f}" for share in shares))
    print("blue screen, gain 1, 30 s, 19 degC: variance [DN2] (90 %) against signal above the black level [DN]")
    print("  class", *(f"{m:g}" for m in SIGNALS), sep=" | ")
    for name in "1234":
        new = VarianceSeries(f"blue {name}", name, SIGNALS, SIGNALS)
        print(f"  {name} | {cells(with_unmeasured(known, new), new)}")
    coefficients(known)
    rows = []
    for screen, gain in (("blue", 1.0), ("blue", 2.0), ("green", 2.0), ("red", 2.0)):
        for name in "1234":
            new = VarianceSeries(f"{screen} {name}", name, FINE_SIGNALS, FINE_SIGNALS, gain)
            rest = [one for one in known if one.name != new.name]  # the new series bears the same name at gain 1
            rows += rows_of(with_unmeasured(rest, new), new, f"{screen} screen gain {gain:g},class {name},signal_DN")
    return rows


def dark(folder: Path) -> Rows:
    """Print predictions of covered frames at other temperatures."""
    rows: Rows = []
    tables = [s for at in (1.0, 17.0) for s in read_dark(folder / f"dark_variance_{at:g}C.csv", at)]
    for kind in KINDS:
        own = [
            VarianceSeries(f"{s.name} {s.temperature_C:g}", s.name, s.exposure_s, s.variance_DN2, 1.0, s.temperature_C)
            for s in tables
            if (s.name == "all") == (kind == "all")
        ]
        fitted = fit(own, "dark", Pixel(), DARK_TERMS)
        found = fitted.law.found(fitted.values)
        energy = found["temperature_law"][""] * found["energy_each"][kind]
        inside = [share_inside(fitted, one) for one in own if one.pixels == kind]
        print(f"covered, {kind}: {energy:.3f} eV; rows inside at 1, 17 degC: {inside[0]:.2f}, {inside[1]:.2f}")
        print("  degC", *(f"{t:g} s" for t in EXPOSURES), sep=" | ")
        for at in TEMPERATURES:
            new = VarianceSeries("new", kind, EXPOSURES, EXPOSURES, 1.0, at)
            print(f"  {at:g} | {cells(fitted, new)}")
        for at in FINE_TEMPERATURES:
            new = VarianceSeries("new", kind, FINE_EXPOSURES, FINE_EXPOSURES, 1.0, float(at))
            rows += rows_of(fitted, new, f"covered {at:g} degC,{kind},exposure_s")
    return rows


if __name__ == "__main__":
    lines = screens(Path(sys.argv[1])) + dark(Path(sys.argv[1]))
    if len(sys.argv) > 2:
        heading = "condition,pixels,abscissa,value,variance_DN2,low_90_DN2,high_90_DN2"
        Path(sys.argv[2]).write_text("\n".join([heading, *lines]) + "\n", encoding="utf-8")
