"""What is lit besides the contact: profiles of each cause over the flank, and the real contact frame's own.

First table: the thesis scene at the force at which the contact has the real frame's share of the ring (0.58 of its
radius): light of each cause over that of the contact, by distance from the axis over the silhouette's radius; how much
of the cause gives the ring that the frame has; the ground that comes with it. Second: level of the real frame's ring,
by side, best of the settings of ``real_frame_colour.py`` (range over those that are possible).

Run: python docs/validation/what_is_lit.py [FRAME_FOLDER] [--picture FILE.png]
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np
import real_frame_colour as colour

from evanesce.chain.simulate import solve_contact
from evanesce.core.states import PlateLight
from evanesce.effects import Context, Stage, active_effects, apply_stage
from evanesce.render.fast.defects import plate_points
from evanesce.render.fast.transport import render_fast
from evanesce.rig import Scene, load_scene
from evanesce.rig.coarser import coarser_camera

FORCE_N = 8.3
SILHOUETTE_MM = 6.76
"""Radius at which the finger's full diameter appears on the contact plane."""
RADII = (0.65, 0.7, 0.75, 0.8, 0.85, 0.9, 0.95)
RING, GROUND = (0.073, 0.046, 0.23), (0.0046, 0.0009, 0.0127)
"""Of the real frame, over its contact: best, lowest, highest (real_frame_colour.py)."""
SIDES = {"right": (-45, 45), "bottom": (45, 135), "left": (135, 225), "top": (225, 315)}

CASES: dict[str, tuple[dict[str, Any], float]] = {
    "light that leaves near the edges, and the contact's (in the model so far)": ({}, 0.0),
    "spill, as much as enters the plate, 1 mm high": ({"led_spill": {"share": 1.0}}, 1.0),
    "spill, 2 mm high": ({"led_spill": {"share": 1.0, "height_mm": 2.0}}, 1.0),
    "haze on the top face, 1 % of guided light": ({"plate_haze": {"top_share": 0.01, "contrast": 0.0}}, 0.01),
    "haze on the bottom face, 1 %": ({"plate_haze": {"bottom_share": 0.01, "contrast": 0.0}}, 0.01),
    "subsurface scattering, 0.5 mm": ({"lateral_glow": {"length_mm": 0.5}}, 0.0),
    "subsurface scattering, 1 mm": ({"lateral_glow": {"length_mm": 1.0}}, 0.0),
    "subsurface scattering, 3 mm": ({"lateral_glow": {"length_mm": 3.0}}, 0.0),
    "cloth of 0.05, 50 mm above, no spill": ({"backdrop": {"reflectance": 0.05}}, 0.0),
    "cloth of 0.05, 50 mm above, spill 0.25": ({"backdrop": {"reflectance": 0.05}, "led_spill": {"share": 0.25}}, 0.0),
}


def lit(scene: Scene, force_N: float = FORCE_N) -> tuple[PlateLight, Scene]:
    """Return the light of a press, effects of plate and rig in it, and the rig."""
    rig, state = solve_contact(scene, force_N, seed=1)
    light = render_fast(rig, state)
    return apply_stage(Stage.PLATE_LIGHT, light, active_effects(scene), Context(rig, 1)), rig


def polar(light: PlateLight, rig: Scene) -> tuple[np.ndarray, np.ndarray]:
    """Return distance from the finger's axis over the silhouette's radius, and azimuth [deg]."""
    x, y = (p - c for p, c in zip(plate_points(rig, light), rig.finger.position_mm, strict=True))
    return np.hypot(x, y) / SILHOUETTE_MM, np.rad2deg(np.arctan2(y, x)) % 360


def profile(light: PlateLight, rig: Scene) -> tuple[np.ndarray, float, float]:
    """Return light at ``RADII`` and just outside, over the contact's median, and the latter."""
    r, _ = polar(light, rig)
    contact = float(np.median(light.radiance[r < 0.4]))
    rings = np.array([light.radiance[np.abs(r - q) < 0.02].mean() for q in RADII])
    ground = float(light.radiance[(r > 1.15) & (r < 1.4)].mean())
    return rings / contact, ground / contact, contact


def real_profile(folder: Path) -> dict[str, list[tuple[float, float, float]]]:
    """Return best, lowest and highest level of the ring by side and ``RADII``, over the contact's."""
    found = colour.analyse(folder)
    frame = found["frame"]
    masks = colour.regions(frame)
    rows, cols = np.indices(frame.shape[:2])
    disc = masks["contact"] & (rows < 30)
    centre, radius = ring_circle(frame[..., 0].astype(float), (cols[disc].mean(), rows[disc].mean()))
    r = np.hypot(cols - centre[0], rows - centre[1]) / radius
    azimuth = np.rad2deg(np.arctan2(rows - centre[1], cols - centre[0])) % 360
    print(f"ring: centre {centre.round(1)}, radius {radius:.1f} thumbnail pixels; contact's radius over it: "
          f"{np.sqrt(disc.sum() / np.pi) / radius:.2f}")  # fmt: skip
    result: dict[str, list[tuple[float, float, float]]] = {side: [] for side in SIDES}
    levels = []
    for temperature, green, blue in found["possible"]:
        expected = colour.colour_of_level(colour.LEVELS, (1.0, green, blue), colour.ImageProcessor.imx477(temperature))
        level = colour.LEVELS[colour.nearest(frame, expected)[0]]
        levels.append(level / np.median(level[masks["contact"]]))
    for side, (low, high) in SIDES.items():
        sector = (azimuth - low) % 360 < high - low
        for q in RADII:
            here = sector & (np.abs(r - q) < 0.04)
            each = [float(np.median(level[here])) for level in levels]
            result[side].append((each[0], min(each), max(each)))
    return result


def ring_circle(red: np.ndarray, start: tuple[float, float]) -> tuple[np.ndarray, float]:
    """Return centre and radius of the circle through the steepest falls of red around a point [px]."""
    from scipy.ndimage import map_coordinates

    angles, steps = np.deg2rad(np.arange(0.0, 360.0, 10.0)), np.arange(11.0, 17.0, 0.1)
    edge = []
    for a in angles:
        along = (start[1] + steps * np.sin(a), start[0] + steps * np.cos(a))
        edge.append(steps[np.argmin(np.gradient(map_coordinates(red, along, order=1)))])
    x, y = start[0] + np.array(edge) * np.cos(angles), start[1] + np.array(edge) * np.sin(angles)
    keep = np.ones(x.size, bool)
    for _ in range(3):  # the streak and bright clouds are no part of the edge
        known = np.stack([2 * x[keep], 2 * y[keep], np.ones(keep.sum())], axis=1)
        cx, cy, c = np.linalg.lstsq(known, x[keep] ** 2 + y[keep] ** 2, rcond=None)[0]
        radius = float(np.sqrt(c + cx**2 + cy**2))
        keep = np.abs(np.hypot(x - cx, y - cy) - radius) < 0.8
    return np.array([cx, cy]), radius


def near_the_edge(place_mm: tuple[float, float]) -> Scene:
    """Return the thesis scene with the finger so far from the right and the top edge; inf leaves it midway."""
    right, top = place_mm
    place = [0.0 if np.isinf(right) else 60.0 - right, 0.0 if np.isinf(top) else top - 40.0]
    changes = {"finger.position_mm": place, "camera.centre_mm": place, "effects": {"plate_haze": HAZE}}
    return coarser_camera(load_scene("thesis", changes), 4, key="factor")


def by_side(light: PlateLight, rig: Scene) -> tuple[np.ndarray, float]:
    """Return mean light (sides, radii) [W mm^-2 sr^-1] and the contact's median."""
    r, azimuth = polar(light, rig)
    sectors = [(azimuth - low) % 360 < high - low for low, high in SIDES.values()]
    found = [[light.radiance[sector & (np.abs(r - q) < 0.02)].mean() for q in RADII] for sector in sectors]
    return np.array(found), float(np.median(light.radiance[r < 0.4]))


def fits(
    real: dict[str, list[tuple[float, float, float]]],
) -> list[tuple[float, tuple[float, float], float, float, np.ndarray]]:
    """Return RMS of ln(model/frame), place [mm], scattering length [mm], spill share and profiles, best first."""
    frame = np.array([[best for best, _, _ in real[side]] for side in SIDES])
    known = np.ones(frame.shape, bool)
    known[:, 0] = False  # the thumbnail's pixels there reach into the contact
    tried = []
    for place in PLACES_MM:
        scene = near_the_edge(place)
        for length in LENGTHS_MM:
            glow = {"lateral_glow": {"length_mm": length}} if length else {}
            dark, contact = by_side(*lit(scene.model_copy(update={"effects": scene.effects | glow})))
            spill = {"led_spill": {"share": 1.0}}
            full, _ = by_side(*lit(scene.model_copy(update={"effects": scene.effects | glow | spill})))
            for share in SHARES:
                model = (dark + share * (full - dark)) / contact
                rms = float(np.sqrt((np.log(model / frame)[known] ** 2).mean()))
                tried.append((rms, place, length, share, model))
    return sorted(tried, key=lambda one: one[0])


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, nargs="?", help="holds frame_thumbnail.png")
    parser.add_argument("--picture", type=Path)
    given = parser.parse_args()
    base = coarser_camera(load_scene("thesis"), 4, key="factor")
    plain, plain_ground, _ = profile(*lit(base))
    rows = {}
    print(f"thesis scene, {FORCE_N} N; light over the contact's at r over the silhouette's radius {RADII}")
    for name, (effects, unit) in CASES.items():
        rings, ground, _ = profile(*lit(base.model_copy(update={"effects": effects})))
        rows[name] = rings
        line = f"  {name}: " + " ".join(f"{v:.4f}" for v in rings) + f"; ground {ground:.5f}"
        if unit:
            # Over the whole ring by area; what is there without the cause comes off.
            per = float(np.mean((rings - plain)[:-1])) / unit
            need = [max(v - float(np.mean(plain[:-1])), 0) / per for v in RING]
            line += f"; ring needs {need[0]:.3g} ({need[1]:.3g} to {need[2]:.3g})"
            if ground - plain_ground > 1e-6:
                of_ground = [v * unit / (ground - plain_ground) for v in GROUND]
                line += f"; ground needs {of_ground[0]:.3g} ({of_ground[1]:.3g} to {of_ground[2]:.3g})"
        print(line, flush=True)
    real = real_profile(given.folder) if given.folder else {}
    for side, values in real.items():
        print(f"  real frame, {side}: " + " ".join(f"{b:.3f} ({lo:.3f}-{hi:.3f})" for b, lo, hi in values))
    if not real:
        return
    tried = fits(real)
    print("RMS of ln(model/frame), distance from right and top edge [mm], scattering length [mm], spill share")
    for rms, place, length, share, _ in tried[:5]:
        print(f"  best: {rms:.2f} {place} {length:g} {share:g}")
    for name, wanted in RIVALS.items():
        rms, place, length, share, model = next(one for one in tried if wanted(one))
        print(f"  {name}: {rms:.2f}, {place} mm, {length:g} mm, {share:g}")
        for side, values in zip(SIDES, model, strict=True):
            print(f"    {side}: " + " ".join(f"{v:.3f}" for v in values))
    if given.picture:
        _, place, length, share, model = tried[0]
        effects = near_the_edge(place).effects | BORDER
        effects |= {"led_spill": {"share": share}} if share else {}
        effects |= {"lateral_glow": {"length_mm": length}} if length else {}
        effects |= {"plate_haze": {**HAZE, "contrast": 0.4}, "backdrop": {"reflectance": 0.03}}
        simulated = lit(near_the_edge(place).model_copy(update={"effects": effects}))
        picture(rows, real, dict(zip(SIDES, model, strict=True)), simulated, given.picture)


HAZE = {"top_share": 0.0047, "contrast": 0.0}
"""The frame's ground over its contact, 0.0046."""
MIDWAY = np.inf
PLACES_MM = ((15.0, MIDWAY), (20.0, MIDWAY), (12.0, 12.0), (15.0, 15.0), (20.0, 20.0), (25.0, 25.0), (MIDWAY, MIDWAY))
LENGTHS_MM = (0.0, 0.1, 0.2, 0.35, 0.6)
SHARES = (0.0, 0.01, 0.02, 0.03, 0.05, 0.07, 0.1, 0.15, 0.2, 0.3, 0.5)
RIVALS = {
    "no spill, no scattering in the silicone": lambda one: one[2] == 0 and one[3] == 0,
    "no spill": lambda one: one[3] == 0,
    "no scattering in the silicone": lambda one: one[2] == 0,
    "finger in the middle": lambda one: one[1] == (MIDWAY, MIDWAY),
}
BORDER = {
    "led_edge_reflections": {
        "relative_radiance": 0.03, "sides": [0.0, 0.0, 0.0, 1.0], "along_mm": 0.5, "decay_mm": 5.0, "slant_deg": -24.0,
    }
}  # fmt: skip
"""Streaks from the LEDs of the lower edge."""


def picture(rows: Any, real: Any, sides: Any, simulated: tuple[PlateLight, Scene], path: Path) -> None:
    """Draw the causes' profiles, the frame's own by side beside the model's, and a simulated light map."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt
    from matplotlib.colors import LogNorm

    figure, (left, middle, right) = plt.subplots(1, 3, figsize=(14.5, 5.6), layout="constrained")
    for (name, values), style in zip(rows.items(), ("k:", "C0", "C0--", "C1", "C1--", "C2:", "C2--", "C2", "C3:", "C3"),
                                     strict=True):  # fmt: skip
        left.semilogy(RADII, np.maximum(values, 1e-5), style, label=name)
    left.axhspan(RING[1], RING[2], color="0.9", zorder=0)
    left.set(title="each cause, thesis scene", ylim=(1e-3, 1), ylabel="light over the contact's")
    left.legend(fontsize=7, loc="upper center", bbox_to_anchor=(0.5, -0.16))
    for k, (side, values) in enumerate(real.items()):
        best, low, high = np.array(values).T
        shift = np.array(RADII) + 0.004 * (k - 1.5)
        middle.errorbar(shift, best, [best - low, high - best], fmt="o", ms=3, color=f"C{k}", label=f"frame, {side}")
    for k, side in enumerate(SIDES):
        middle.semilogy(RADII, sides[side], color=f"C{k}")
    middle.set(title="real frame (points), best combination (lines)", ylim=(1e-3, 1))
    middle.legend(fontsize=7)
    for axis in (left, middle):
        axis.set_xlabel("r over the silhouette's radius")
    light, rig = simulated
    r, _ = polar(light, rig)
    shown = right.imshow(light.radiance / np.median(light.radiance[r < 0.4]), norm=LogNorm(1e-3, 1), cmap="magma")
    right.set(title="all causes: light over the contact's", xticks=[], yticks=[])
    figure.colorbar(shown, ax=right, shrink=0.8)
    figure.savefig(path, dpi=100)


if __name__ == "__main__":
    main()
