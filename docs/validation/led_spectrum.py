"""Figures and picture of led-spectrum.md: emission, sensitivities, glass by wavelength, white points, one press.

Run: python docs/validation/led_spectrum.py [--picture FILE.png] (about half a minute)
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np

from evanesce.chain.simulate import simulate
from evanesce.optics.glass import soda_lime_absorption
from evanesce.optics.illuminants import black_body, daylight
from evanesce.optics.seen import seen_at
from evanesce.optics.spectrum import LINES, Line, Spectrum, led_line, pdms_index, soda_lime_index, spectrum_of
from evanesce.render.fast.transport import render_fast
from evanesce.rig import Leds, load_scene
from evanesce.sensor.colour import _WHITE_IMX477
from evanesce.sensor.filters import filter_response, relative_sensitivity

KINDS = ("white", "red", "infrared")
COARSE = {
    "camera.resolution_px": [500, 375],
    "camera.scale_px_per_mm": 14.6,
    "camera.pixel.pitch_um": 12.4,
    "camera.exposure_ms": 0.4,
    "grid.samples": 512,
}
INKS = {"red": "#c1272d", "green": "#2e8b57", "blue": "#2f5fb3", "white": "#555555", "infrared": "#7b3f00"}


def spectrum(kind: str, warming: float = 0.0) -> Spectrum:
    """Return the spectrum of an LED type."""
    strip: dict[str, Any] = {"pitch_mm": 10.0, "emitting_width_mm": 3.0, "emitting_height_mm": 3.0}
    return spectrum_of(Leds(**strip, spectrum=kind, circuit={"warming_K": warming}))  # type: ignore[arg-type]


def white_points(power: bool = False) -> np.ndarray:
    """Return temperature, red and blue over green of a white card by the curves, and by libcamera's tuning.

    ``power`` reads the curves as responses to equal power, not to equal photons: light of less energetic photons has
    more of them.
    """
    rows = []
    for kelvin, red, blue in _WHITE_IMX477:
        card = daylight(kelvin) if kelvin > 4000 else black_body(kelvin)
        if power:
            card = Spectrum(card.wavelength_nm, card.power / card.wavelength_nm)
        r, g, b = filter_response(card)
        rows.append((kelvin, r / g, b / g, red, blue))
    return np.array(rows)


def show_light() -> None:
    """Print what each LED type's light is to glass, silicone and the colour camera."""
    for kind in KINDS:
        found = spectrum(kind)
        at = found.mean_wavelength_nm
        bare, cut = (np.array(filter_response(found, infrared_cut=c)) for c in (False, True))
        shares = f"green/red {cut[1] / cut[0]:.3f}, blue/red {cut[2] / cut[0]:.3f}"
        print(
            f"{kind}: mean {at:.1f} nm; glass {float(soda_lime_index(at)):.4f}, PDMS {float(pdms_index(at)):.4f},"
            f" absorption {float(soda_lime_absorption(at)):.2f} of that at 550 nm; pixels without filter"
            f" {bare.round(3)}, with it {cut.round(4)}; {shares}"
        )
    for peak in (615.0, 625.0, 634.0, 645.0):
        line = Line(peak, LINES["red"].width_nm, 0.0)
        w = np.arange(peak - 80, peak + 80, 0.5)
        r, g, b = filter_response(Spectrum(w, led_line(w, peak, line.width_nm)))
        print(f"red with its peak at {peak:.0f} nm: red {r:.3f}, green/red {g / r:.3f}, blue/red {b / r:.3f}")
    points = white_points()
    off = points[:, 1:3] / points[:, 3:] - 1
    for row, (red, blue) in zip(points, 100 * off, strict=True):
        print(f"{row[0]:.0f} K: red/green {row[1]:.3f} ({red:+.1f} %), blue/green {row[2]:.3f} ({blue:+.1f} %)")
    for name, rows in (("quantum efficiencies", points), ("responses to power", white_points(power=True))):
        red, blue = 100 * np.abs(rows[:, 1:3] / rows[:, 3:] - 1).max(axis=0)
        print(f"largest difference, curves read as {name}: red {red:.1f} %, blue {blue:.1f} %")


def show_press() -> None:
    """Print what one press of the thesis's finger shows at equal radiant power of each LED type."""
    base = load_scene("thesis", COARSE | {"plate.absorption_coefficient_per_mm": 0.002})
    first = None
    for kind in KINDS:
        # the white strip's circuit and power: the light alone differs
        scene = base.model_copy(update={"leds": base.leds.model_copy(update={"spectrum": kind})})
        shot = simulate(scene, 2.0, seed=1, render=render_fast)
        seen, radiance = seen_at(scene), np.asarray(shot.plate_light.radiance)
        bright = radiance > 0.5 * radiance.max()
        level = float(radiance[bright].mean()), float(shot.sensor_light.irradiance.sum() * seen.camera.wavelength_nm)
        first = first or level
        plate, scale = seen.plate, seen.camera.scale_px_per_mm
        print(
            f"{kind}: index {plate.refractive_index:.4f}, absorption {plate.absorption_coefficient_per_mm:.4f}/mm,"
            f" scale {scale:.4f} px/mm; radiance of the contact {level[0] / first[0]:.3f},"
            f" photons in the frame {level[1] / first[1]:.3f} of white light's"
        )


def draw(path: Path) -> None:
    """Draw emission, sensitivities, glass and white points."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(2, 2, figsize=(11.0, 7.6), layout="constrained")
    emission, pixels, glass, card = axes.ravel()
    for kind in KINDS:
        found = spectrum(kind)
        emission.plot(found.wavelength_nm, found.power / found.power.max(), color=INKS[kind], label=kind)
    warm = spectrum("red", 40.0)
    emission.plot(warm.wavelength_nm, warm.power, "--", color=INKS["red"], label="red, junction 40 K warmer")
    emission.set(
        xlabel="wavelength [nm]", ylabel="radiant power per nm, relative [1]", xlim=(400, 1000), ylim=(-0.05, 1.4)
    )
    emission.set_title("LED light")
    w = np.arange(400.0, 1001.0, 2.0)
    for k, name in enumerate(("red", "green", "blue")):
        bare = relative_sensitivity(w, infrared_cut=False)[:, k]
        known = w <= 700
        pixels.plot(w[known], bare[known], color=INKS[name], label=f"{name} pixels")
        pixels.plot(w[~known], bare[~known], ":", color=INKS[name])
        pixels.plot(w, relative_sensitivity(w)[:, k], "--", color=INKS[name])
    pixels.plot([], [], "--", color="k", label="with infrared cut filter")
    pixels.plot([], [], ":", color="k", label="estimated")
    pixels.set(xlabel="wavelength [nm]", ylabel="quantum efficiency over the highest [1]", xlim=(400, 1000))
    pixels.set_title("IMX477")
    glass.plot(w, soda_lime_index(w), color="k", label="soda-lime glass, index")
    glass.plot(w, pdms_index(w) + 0.1, color=INKS["blue"], label="PDMS, index + 0.1")
    glass.set(xlabel="wavelength [nm]", ylabel="refractive index [1]", xlim=(400, 1000))
    other = glass.twinx()
    other.plot(w, soda_lime_absorption(w), "--", color=INKS["green"], label="absorption (right)")
    other.set_ylabel("absorption over that at 550 nm [1]")
    glass.set_title("Plate and finger")
    for line in LINES.values():
        glass.axvline(line.peak_nm, color="0.7", lw=0.8, zorder=0)
    handles = [h for a in (glass, other) for h in a.get_legend_handles_labels()[0]]
    glass.legend(handles=handles, loc="upper center", fontsize=8)
    points = white_points()
    for k, name in enumerate(("red", "blue")):
        card.plot(points[:, 0], points[:, 1 + k], color=INKS[name], label=f"{name}/green, these curves")
        card.plot(points[:, 0], points[:, 3 + k], "o", color=INKS[name], label=f"{name}/green, libcamera's tuning")
    card.set(xlabel="colour temperature of the light [K]", ylabel="raw value of a white card over green [1]")
    card.set_ylim(0.0, 1.0)
    card.set_title("White card: not fitted")
    emission.legend(fontsize=8, ncols=2, loc="upper center")
    for axis in (pixels, card):
        axis.legend(fontsize=8)
    figure.savefig(path, dpi=110)


def main() -> None:
    """Print the figures; draw the picture where a file is given."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--picture", type=Path)
    arguments = parser.parse_args()
    show_light()
    show_press()
    if arguments.picture is not None:
        draw(arguments.picture)


if __name__ == "__main__":
    main()
