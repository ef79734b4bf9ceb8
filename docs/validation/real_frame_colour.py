"""Read the one public contact frame of the rig through a colour camera: one light level a pixel, one spectrum.

Method. A colour of three channels is drawn from one number a pixel, the light's level, through filters, white balance
and colour matrix of libcamera's published tuning. What the filters let through of the light (green and blue over red)
and the colour temperature of the tuning are sought on a grid, on every other block of 7 x 7 pixels; the other blocks
judge. Rivals: a monochrome camera (one level, red = green = blue), and white light in the same camera. A setting is
kept as possible if its RMS on the blocks that chose exceeds the best by at most 1 DN; figures are given as best (range
over the possible settings).

Run: python docs/validation/real_frame_colour.py FRAME_FOLDER [--picture FILE.png] [--json FILE]
"""

from __future__ import annotations

import argparse
import itertools
import json
from pathlib import Path
from typing import Any

import numpy as np

from evanesce.measurement.io.images import read_image
from evanesce.sensor.colour import ImageProcessor, colour_of_level, level_bounds

LUMA = np.array([0.2125, 0.7154, 0.0721])
TEMPERATURES_K = (2360, 2500, 2700, 2850, 3250, 3580, 4000, 4559, 5200, 5881)
GREEN = (0.04, 0.06, 0.08, 0.1, 0.12, 0.15, 0.2, 0.3)
BLUE = (0.01, 0.02, 0.03, 0.04, 0.05, 0.06, 0.08, 0.1, 0.15)
LEVELS = np.geomspace(1e-3, 1e2, 1200)
BLOCK_PX = 7
POSSIBLE_DN = 1.0
THRESHOLDS = (0.0375, 0.15, 0.35, 0.6)


def regions(frame: np.ndarray) -> dict[str, np.ndarray]:
    """Return masks of contact, ring and ground by their colour; edges between them are in none."""
    red, green = frame[..., 0], frame[..., 1]
    return {"contact": green > 200, "ring": (red > 200) & (green < 30), "ground": (red <= 200) & (green < 30)}


def nearest(frame: np.ndarray, expected: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the number of the nearest expected colour (rows, cols) and the difference to it (rows, cols, 3) [DN]."""
    distinct, back = np.unique(frame.reshape(-1, 3), axis=0, return_inverse=True)
    difference = distinct[:, None].astype(float) - expected[None].astype(float)
    best = (difference**2).sum(axis=2).argmin(axis=1)
    left = difference[np.arange(len(distinct)), best]
    return best[back.ravel()].reshape(frame.shape[:2]), left[back.ravel()].reshape(frame.shape)


def figures(frame: np.ndarray, expected: np.ndarray, chooses: np.ndarray) -> dict[str, Any]:
    """Return residual figures of one model, and each pixel's level."""
    best, left = nearest(frame, expected)
    rms = {name: float(np.sqrt((left[mask] ** 2).mean())) for name, mask in (("chosen", chooses), ("held", ~chooses))}
    return {"rms_DN": rms, "channel_rms_DN": np.sqrt((left[~chooses] ** 2).mean(axis=0)), "best": best, "left": left}


def analyse(folder: Path) -> dict[str, Any]:
    """Return the settings that explain the frame, what they say of its light, and the rivals' residuals."""
    frame = read_image(folder / "frame_thumbnail.png").data[..., :3]
    rows, cols = np.indices(frame.shape[:2]) // BLOCK_PX
    chooses = (rows + cols) % 2 == 0
    tried = []
    for temperature, green, blue in itertools.product(TEMPERATURES_K, GREEN, BLUE):
        expected = colour_of_level(LEVELS, (1.0, green, blue), ImageProcessor.imx477(temperature))
        tried.append((figures(frame, expected, chooses), (temperature, green, blue), expected))
    tried.sort(key=lambda one: one[0]["rms_DN"]["chosen"])
    limit = tried[0][0]["rms_DN"]["chosen"] + POSSIBLE_DN
    possible = [one for one in tried if one[0]["rms_DN"]["chosen"] <= limit]
    white = []
    for temperature in TEMPERATURES_K:
        processor = ImageProcessor.imx477(temperature)
        for lamp in TEMPERATURES_K:  # what a white card of another temperature gives
            card = 1.0 / ImageProcessor.imx477(lamp).gains
            white.append(figures(frame, colour_of_level(LEVELS, tuple(card), processor), chooses))
    mono = np.repeat(np.arange(256)[:, None], 3, axis=1)
    models = {
        "monochrome camera": figures(frame, mono, chooses),
        "white light, colour camera": min(white, key=lambda one: one["rms_DN"]["chosen"]),
        "red light, colour camera": tried[0][0],
    }
    return {
        "frame": frame,
        "best": tried[0],
        "possible": [one[1] for one in possible],
        "models": models,
        "light": light_of(possible, regions(frame)),
        "thresholds": threshold_levels(possible, regions(frame)),
    }


def light_of(possible: list[Any], masks: dict[str, np.ndarray]) -> dict[str, tuple[float, float, float]]:
    """Return median level of each region over the contact's: best, lowest, highest of the possible settings."""
    rows = []
    for found, _, _ in possible:
        median = {name: float(np.median(LEVELS[found["best"]][mask])) for name, mask in masks.items()}
        rows.append([median["ground"], median["contact"], *(median[k] / median["contact"] for k in ("ring", "ground"))])
    names = ("ground", "contact", "ring over contact", "ground over contact")
    return {name: _range([row[k] for row in rows]) for k, name in enumerate(names)}


def threshold_levels(possible: list[Any], masks: dict[str, np.ndarray]) -> dict[float, tuple[float, float, float]]:
    """Return the level, over the contact's median one, above which the grey image exceeds each threshold."""
    result = {}
    for threshold in THRESHOLDS:
        shares = []
        for found, _, expected in possible:
            grey = expected.astype(float) @ LUMA / 255.0
            contact = float(np.median(LEVELS[found["best"]][masks["contact"]]))
            shares.append(float(LEVELS[np.argmax(grey > threshold)]) / contact)
        result[threshold] = _range(shares)
    return result


def _range(values: list[float]) -> tuple[float, float, float]:
    return values[0], min(values), max(values)


def picture(found: dict[str, Any], path: Path) -> None:
    """Draw frame, reproduction, level and residual beside each other."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt
    from matplotlib.colors import LogNorm

    best, _, expected = found["best"]
    figure, grid = plt.subplots(2, 2, figsize=(9, 6.4), layout="constrained")
    axes = grid.ravel()
    for axis, image, title in (
        (axes[0], found["frame"], "real frame (thumbnail)"),
        (axes[1], expected[best["best"]], "one level a pixel, red light"),
    ):
        axis.imshow(image)
        axis.set_title(title)
    shown = axes[2].imshow(LEVELS[best["best"]], norm=LogNorm(0.01, 30), cmap="magma")
    axes[2].set_title("light level")
    figure.colorbar(shown, ax=axes[2], label="raw red full scale = 1")
    shown = axes[3].imshow(np.abs(best["left"]).max(axis=2), vmin=0, vmax=60, cmap="viridis")
    axes[3].set_title("largest residual")
    figure.colorbar(shown, ax=axes[3], label="DN")
    for axis in axes:
        axis.set(xlabel="x [thumbnail px]", ylabel="y [thumbnail px]")
    figure.savefig(path, dpi=100)


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="holds frame_thumbnail.png")
    parser.add_argument("--picture", type=Path)
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    found = analyse(given.folder)
    print("held-out blocks: RMS [DN] of red, green, blue, and of all")
    for name, model in found["models"].items():
        red, green, blue = model["channel_rms_DN"]
        print(f"  {name:28s} {red:6.1f} {green:6.1f} {blue:6.1f}   {model['rms_DN']['held']:6.1f}")
    print(f"best: temperature, green and blue share: {found['best'][1]}; {len(found['possible'])} settings possible")
    for k, name in enumerate(("temperature [K]", "green over red", "blue over red")):
        values = [one[k] for one in found["possible"]]
        print(f"  {name}: {min(values):g} to {max(values):g}")
    print("light, best (range over possible settings); ground and contact in units of the raw red full scale")
    for name, (best, low, high) in found["light"].items():
        print(f"  {name:20s} {best:8.4f} ({low:.4f} to {high:.4f})")
    print("level at which the grey image passes a threshold, over the contact's median level")
    for threshold, (best, low, high) in found["thresholds"].items():
        print(f"  {threshold:<8g} {best:8.4f} ({low:.4f} to {high:.4f})")
    contact = found["frame"][regions(found["frame"])["contact"]]
    print("share of the contact's pixels that one level explains to 12 DN in every channel")
    for temperature, shares in itertools.product((2360, 2850, 3600), ((0.08, 0.03), (0.12, 0.04), (0.15, 0.06))):
        processor = ImageProcessor.imx477(temperature)
        low, _ = level_bounds(contact, (1.0, *shares), processor, tolerance_DN=12.0, levels=LEVELS)
        print(f"  {temperature} K, green and blue share {shares}: {np.isfinite(low).mean():.2f}")
    if given.json:
        held = {name: model["rms_DN"]["held"] for name, model in found["models"].items()}
        kept = {"held_rms_DN": held, "best": found["best"][1], "possible": found["possible"]}
        given.json.write_text(
            json.dumps({**kept, "light": found["light"], "thresholds": found["thresholds"]}, indent=1)
        )
    if given.picture:
        picture(found, given.picture)


if __name__ == "__main__":
    main()
