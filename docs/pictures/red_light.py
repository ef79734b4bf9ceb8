"""Figures and tables of docs/background/red-light.md: threshold, resolution and settings in red light.

Run: python docs/pictures/red_light.py [FOLDER with samples.npz of `evanesce study voltage thesis_ridged_red`]
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

import evanesce as ev
from evanesce.measurement.reference.segment import Chain
from evanesce.rig import load_scene
from evanesce.sensor.colour import ImageProcessor, mosaic
from evanesce.studies.mosaic import as_red, edge_transfer, narrowest_groove, pixel_transfer, red_transfer, sampled
from evanesce.studies.voltage.colour_rig import FILTERS, FLANK, ColourRig, Reading
from evanesce.studies.voltage.colour_unknowns import SETTINGS, colour_unknowns
from evanesce.studies.voltage.grey import GREY, GreyTable, bilinear
from evanesce.studies.voltage.press import Press
from evanesce.studies.voltage.reduced_rig import blur_mm
from evanesce.studies.voltage.sources import study_scene
from evanesce.studies.voltage.study import scene_values
from evanesce.studies.voltage.unknowns import THRESHOLDS, Plan

HERE = Path(__file__).resolve().parent
FLANK_LIGHT, GROUND_LIGHT, CONTACT_LEVEL = 0.072, 0.0046, 7.63
"""Of the real frame by its best setting (docs/validation/sensor-colour.md)."""
LEAST_RIGS = 10
"""Shares of fewer are not drawn."""
CUTS = (0.0375, 0.15, 0.35, 0.6)
OF_THE_FRAME = (3250, 0.15, 0.05)
"""Setting of filters and white balance nearest to the real frame."""


def rig_at(level: float) -> tuple[ColourRig, Any, Any, Any]:
    """Return rig, lights, values and true areas at 9 V with the contact at a light level (raw red full scale = 1)."""
    scene = study_scene(load_scene("thesis_ridged_red"))[0]
    plan = Plan((1.0, 5.0), (9.0,), 2, 1, colour_unknowns(scene))
    rig, values = ColourRig(scene, plan), scene_values(scene, 0.35)
    lit = rig.light(values)
    lights = rig.lights(lit)
    values[FLANK] = FLANK_LIGHT, GROUND_LIGHT
    values[FILTERS] = SETTINGS.index(OF_THE_FRAME)
    values[4] *= level / float(rig.read(lights, values, Reading("", control=False), (0.5,))[1][0, 0])
    return rig, lights, values, lit.true_area


def threshold_picture() -> None:
    """Draw and print the area error by threshold with and without ring and ground."""
    rig, lights, values, truth = rig_at(CONTACT_LEVEL)
    figure, axes = plt.subplots(1, 2, figsize=(9, 3.8), layout="constrained")
    print("area over truth by threshold; contact at", CONTACT_LEVEL)
    readings = {
        "colour, ring and ground": Reading("", control=False),
        "colour, black surroundings": Reading("", control=False, surroundings=False),
    }
    for label, reading in readings.items():
        area = rig.read(lights, values, reading, THRESHOLDS)[0][:, 0]
        for axis, row, true, force in zip(axes, area, truth, (1, 5), strict=True):
            axis.semilogy(THRESHOLDS, row / true, "-o", markersize=3, label=label)
            axis.set(xlabel="threshold", title=f"{force} N, true area {true:.1f} mm²", ylim=(0.5, 100))
        print(f"  {label:28s}", {t: np.round(area[:, THRESHOLDS.index(t)] / truth, 2).tolist() for t in CUTS})
    ratio = rig.by_ratio(lights, values)
    print("  raw red not clipped, cut at 0.65 of the contact's light", np.round(ratio[:, 12] / truth, 3))
    for axis in axes:
        axis.axhline(1.0, color="k", linestyle="--", linewidth=0.8)
    axes[0].set_ylabel("estimated over true area")
    axes[0].legend(fontsize=8)
    figure.savefig(HERE / "red-light-threshold.png", dpi=100)


def settings_table() -> None:
    """Print what each setting that the real frame allows does to the area, all else as in the scene."""
    rig, lights, values, truth = rig_at(CONTACT_LEVEL)
    for control in (False, True):
        areas = []
        for setting in range(len(SETTINGS)):
            values[FILTERS] = setting
            areas.append(rig.read(lights, values, Reading("", control=control), CUTS)[0][:, 0] / truth[:, None])
        found = np.array(areas)
        for k, cut in enumerate(CUTS):
            low, middle, high = np.percentile(found[:, :, k], (5, 50, 95), axis=0)
            print(
                f"  {'automatic' if control else 'fixed'} exposure, threshold {cut}: area over truth at 1 and 5 N,"
                f" 5 / 50 / 95 % of {len(SETTINGS)} settings: "
                + "; ".join(f"{a:.2f} / {b:.2f} / {c:.2f}" for a, b, c in zip(low, middle, high, strict=True))
            )
    print("finite differences of the area at 1 N, contact at", CONTACT_LEVEL, "[% of the area]")
    base = {"T": 3250.0, "g": 0.15, "b": 0.05, "matrix T": 3250.0}
    steps = {"T": 100.0, "g": 0.015, "b": 0.005, "matrix T": 100.0}
    image, contact = lights[0].with_flank(FLANK_LIGHT), lights[0].contact
    for name, step in steps.items():
        row = []
        for cut in (0.35, 0.6):
            ends = []
            for sign in (-1, 1):
                v = base | {name: base[name] + sign * step}
                processor = ImageProcessor.imx477(v["T"])
                if name == "matrix T":
                    own = ImageProcessor.imx477(base["T"])
                    processor = ImageProcessor.imx477(v[name], red_gain=own.red_gain, blue_gain=own.blue_gain)
                elif name == "T":
                    own = ImageProcessor.imx477(base["T"])
                    gains = {"red_gain": processor.red_gain, "blue_gain": processor.blue_gain}
                    processor = ImageProcessor.imx477(base["T"], **gains)
                table = GreyTable((1.0, v["g"], v["b"]), processor)
                ends.append(float(np.count_nonzero(table(image * (CONTACT_LEVEL / contact)) > cut)))
            row.append(100 * (ends[1] - ends[0]) / (ends[1] + ends[0]))
        what = {
            "T": "white balance, 100 K",
            "g": "green response, 10 %",
            "b": "blue response, 10 %",
            "matrix T": "matrix, 100 K",
        }[name]
        print(f"  {what:24s}", *(f"{value:+.2f}" for value in row), "at 0.35 and 0.6")


def demosaicing_table() -> None:
    """Print the full chain's area with one demosaicing and the other."""
    scene = study_scene(load_scene("thesis_ridged_red"))[0]
    colour = scene.camera.colour
    assert colour is not None
    areas = []
    for kind in ("bilinear", "edge-aware"):
        camera = scene.camera.model_copy(update={"colour": colour.model_copy(update={"demosaicing": kind})})
        press = Press.of(scene.model_copy(update={"camera": camera}), 1.0)
        areas.append(press.areas(9.0, [Chain(threshold=t) for t in (0.35, 0.6)]))
    change = 100 * (np.array(areas[1]) / np.array(areas[0]) - 1)
    print(f"  edge-aware in place of bilinear {change[0]:+.2f} {change[1]:+.2f} at 0.35 and 0.6 (full chain, 1 N)")


def resolution_picture() -> None:
    """Draw the modulation transfer; print limits and narrowest grooves."""
    scene = load_scene("thesis_ridged_red")
    scale = scene.camera.scale_px_per_mm
    f = np.linspace(0.0, 0.5, 101)
    figure, axes = plt.subplots(1, 2, figsize=(9, 3.8), layout="constrained")
    axes[0].plot(f * scale, pixel_transfer(f), "k", label="monochrome, closed form")
    axes[0].plot((f * scale)[f <= 0.25], red_transfer(f)[f <= 0.25], "tab:red", label="red of the mosaic, closed form")
    some = np.arange(0.02, 0.5, 0.03)
    axes[0].plot(some * scale, edge_transfer(some, red=False), "k.", label="simulated edge")
    axes[0].plot((some * scale)[some < 0.25], edge_transfer(some[some < 0.25], red=True), ".", color="tab:red")
    axes[0].set(xlabel="spatial frequency on the plate [1/mm]", ylabel="modulation transfer", ylim=(0, 1.05))
    axes[0].legend(fontsize=8)
    blur = float(np.sqrt((blur_mm(scene.camera) * scale) ** 2 - 1.0))  # without the chain's 1 px
    table = GreyTable((1.0, 0.15, 0.05), ImageProcessor.imx477(3250.0))
    widths = np.arange(0.1, 12.0, 0.1)
    response = (1.0, 0.15, 0.05)

    def clipped(light: np.ndarray) -> np.ndarray:
        filtered = mosaic(light * CONTACT_LEVEL, response, "RGGB")
        processor = ImageProcessor.imx477(3250.0)
        balanced = bilinear(np.minimum(filtered, 1.0), "RGGB") * processor.gains
        return processor.finished(np.minimum(balanced, 1.0)) @ GREY / 255.0

    rows = [
        ("monochrome, half of the contact's light", narrowest_groove(lambda m: m, 0.5, blur, widths)),
        ("raw red, half of the contact's light", narrowest_groove(as_red, 0.5, blur, widths)),
        ("clipped colour frame, 0.6", narrowest_groove(clipped, 0.6, blur, widths)),
        ("clipped colour frame, 0.35", narrowest_groove(clipped, 0.35, blur, widths)),
        ("clipped colour frame, 0.15", narrowest_groove(clipped, 0.15, blur, widths)),
    ]
    print(
        f"lens blur {blur:.2f} px; Nyquist {scale / 2:.1f} and {scale / 4:.1f} /mm; transfer there"
        f" {float(pixel_transfer(0.5)):.2f} and {float(red_transfer(0.25)):.2f}; light over contact at 0.35 and 0.6:"
        f" {table.crosses(0.35) / CONTACT_LEVEL:.2f}, {table.crosses(0.6) / CONTACT_LEVEL:.2f}"
    )
    for name, width in rows:
        print(f"  {name:42s} {width:.1f} px = {1e3 * width / scale:.0f} um")
    x = np.arange(32) - 16
    groove = sampled(lambda p: (np.abs(p - 0.5) > 1.5).astype(float), 32)
    axes[1].plot(x, groove[16], "k", drawstyle="steps-mid", label="monochrome")
    axes[1].plot(x, as_red(groove)[16], "tab:red", label="raw red, bilinear")
    axes[1].plot(x, clipped(groove)[16], "tab:orange", label="grey of a clipped colour frame")
    axes[1].set(xlabel="x [px]", ylabel="value over the contact's", title="groove of 3 px", xlim=(-8, 8))
    axes[1].legend(fontsize=8, loc="lower left")
    figure.savefig(HERE / "red-light-resolution.png", dpi=100)
    disc_areas(blur)


def disc_areas(blur: float) -> None:
    """Print bias and spread of a disc's area at half of its light, over positions, for both samplings."""
    import cv2

    random, radius, size, fine = np.random.default_rng(1), 60.0, 160, 4
    at = (np.arange(size * fine) + 0.5) / fine - size / 2
    errors: dict[str, list[float]] = {"monochrome": [], "raw red": []}
    for _ in range(24):
        dx, dy = random.uniform(-1, 1, 2)
        disc = (np.hypot(at[None, :] - dx, at[:, None] - dy) < radius).astype(np.float64)
        disc = cv2.GaussianBlur(disc, (0, 0), blur * fine)
        frame = disc.reshape(size, fine, size, fine).mean(axis=(1, 3))
        for name, seen in (("monochrome", frame), ("raw red", as_red(frame))):
            seen = cv2.GaussianBlur(seen, (0, 0), 1.0)
            errors[name].append(100 * (np.count_nonzero(seen > 0.5) / (np.pi * radius**2) - 1))
    for name, values in errors.items():
        print(f"  disc of {radius:g} px: {name:12s} area error {np.mean(values):+.3f} %, spread {np.std(values):.3f} %")


def voltage_pictures(folder: Path) -> None:
    """Draw shares of rigs by reading and states by voltage."""
    from evanesce.studies.voltage.in_colour import Share, in_colour
    from evanesce.studies.voltage.samples import run_samples
    from evanesce.studies.voltage.study import readings_of

    scene = study_scene(load_scene("thesis_ridged_red"))[0]
    volts = tuple(round(7 + 0.25 * k, 9) for k in range(21))
    samples = run_samples(scene, Plan((1.0, 5.0), volts, 64, 1, colour_unknowns(scene)), keep=folder / "samples.npz")
    found = in_colour(samples, readings_of(samples), [])
    figure, axes = plt.subplots(1, 2, figsize=(11, 3.8), layout="constrained")
    names = list(found.shares)[1:]
    for k, (key, colour) in enumerate((("all", "tab:blue"), ("all, usable", "tab:orange"))):
        shares = [found.shares[n][key] for n in names]
        shares = [s if s.rigs >= LEAST_RIGS else Share.of(np.zeros(0, bool)) for s in shares]
        middle = [100 * s.hits / s.rigs if s.rigs else float("nan") for s in shares]
        span = [
            [m - 100 * s.low for m, s in zip(middle, shares, strict=True)],
            [100 * s.high - m for m, s in zip(middle, shares, strict=True)],
        ]
        label = "of all rigs" if key == "all" else "of those usable at 9 V"
        axes[0].barh(np.arange(len(names)) + 0.2 - 0.4 * k, middle, 0.38, xerr=span, color=colour, label=label)
    axes[0].set_yticks(range(len(names)), [n.replace(", ", ",\n", 1) for n in names], fontsize=7)
    axes[0].invert_yaxis()
    axes[0].set(xlabel="rigs that show all three observations [%]")
    axes[0].legend(fontsize=8)
    keys = {
        "red_not_full": "red not full",
        "red_full": "red full, no green",
        "green_appears": "some green",
        "green_full": "green full",
    }
    mine = [r for r in found.states if r["exposure"] == "automatic"]
    base, place = np.zeros(len(mine)), np.arange(len(mine))
    for (key, label), colour in zip(keys.items(), ("#4a0000", "#e00000", "#e0a000", "#f0f060"), strict=True):
        part = np.array([100 * r[key] for r in mine])
        axes[1].bar(place, part, 0.8, bottom=base, color=colour, label=label)
        base += part
    axes[1].set_xticks(place, [f"{r['voltage_V']:g}" for r in mine])
    axes[1].set(xlabel="LED voltage [V]", ylabel="rigs [%]", title="contact, automatic exposure, 1 N")
    axes[1].legend(fontsize=8, loc="upper center", bbox_to_anchor=(0.5, -0.16), ncol=4)
    figure.savefig(HERE / "red-light-voltage.png", dpi=100)


def scene_table() -> None:
    """Print the areas of the shipped scene as it stands, by voltage: the full chain, pixels four times as large."""
    scene = ev.coarser(ev.load("thesis_ridged_red"), 4)
    print("shipped scene, no scattering: area [mm^2] at thresholds of 0.35 and 0.6")
    for force in (1.0, 5.0):
        for voltage in (8.0, 8.25, 8.5, 9.0, 9.5, 10.0, 11.0, 12.0):
            shot = ev.Camera(scene.with_(leds__voltage_V=voltage)).shoot(force_N=force, seed=1)
            areas = [
                ev.Pipeline(scale_mm2_per_px=shot.scale_mm2_per_px, threshold=cut, min_blob_px=125).measure(shot.frame)
                for cut in (0.35, 0.6)
            ]
            text = " ".join(f"{area.area_mm2:6.1f}" for area in areas)
            print(f"  {force:g} N {voltage:5.2f} V {text}  true {shot.truth.area_mm2:.1f}")


def main() -> None:
    """Print the tables and draw the pictures."""
    scene_table()
    threshold_picture()
    settings_table()
    demosaicing_table()
    resolution_picture()
    if len(sys.argv) > 1:
        voltage_pictures(Path(sys.argv[1]))


if __name__ == "__main__":
    main()
