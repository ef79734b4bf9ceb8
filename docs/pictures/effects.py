"""One sheet with what effects of light and plate do to a frame: the difference, on the ridged rig of the thesis.

Fast renderer, 1 N, 9 V, no noise, half the camera's resolution; differences of the 12-bit raw frame. Each picture has
its own scale, written below it. Effects that act on the contact alone are shown at its place, 5 mm wide.

Run: python docs/pictures/effects.py [--out FILE]
"""

from __future__ import annotations

import argparse
import io
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from PIL import Image

from evanesce.chain.simulate import expose
from evanesce.contact.solve import contact_state
from evanesce.effects import Context, Stage, active_effects, all_effects, apply_stage
from evanesce.render.fast.transport import render_fast
from evanesce.rig import Scene, load_scene

HALF_RESOLUTION = {
    "camera.resolution_px": [1000, 750],
    "camera.scale_px_per_mm": 29.185,
    "camera.pixel": {"pitch_um": 6.2, "full_well_capacity_e": 32720.0, "conversion_gain_e_per_DN": 8.52},
    "contact": {"law": "hertz", "reduced_modulus_MPa": 4.0},  # so that grooves stay open
    "finger.position_mm": [1.7, -1.1],
}
TIME_S = 60.0
SHOWN: dict[str, dict[str, object]] = {
    "ambient_light": {"radiance_W_per_mm2_sr": 2e-8, "gradient": [0.6, -0.4]},
    "black_level": {"offset_DN": 8.0},
    "edge_finish": {"share": 0.3, "polish": 0.0, "reflectance": 0.85},
    "glass_absorption": {"absorption_per_mm": 0.001},
    "glass_dispersion": {"strength": 1.0},
    "hot_pixels": {"fraction": 2e-4, "rate_e_per_s": 2e6},
    "lateral_glow": {"length_mm": 0.5},
    "led_air_gap": {"share": 1.0},
    "led_bin": {"offset_V": 0.05},
    "led_dead": {"loss": 1.0, "first": 1, "count": 3},
    "led_droop": {"droop": 0.1},
    "led_edge_reflections": {"relative_radiance": 0.13},
    "led_imbalance": {"contrast_x": 0.41, "contrast_y": 0.09},
    "led_spread": {"spread": 0.3},
    "led_warmup": {"warming_K": 30.0},
    "real_contact": {"rms_slope": 1.0},
    "residue_film": {"relative_radiance": 0.05, "middle_mm": [-6.0, 4.0], "radius_mm": 3.0},
    "scratch": {"relative_radiance": 1.0, "middle_mm": [-5.0, -5.0], "length_mm": 12.0, "width_um": 30.0},
    "specks": {"per_cm2": 418.0},
    "supply_sag": {"resistance_ohm_per_mm": 0.02},
    "vignetting": {"k": 0.3, "centre_offset_px": [-60.0, 40.0]},
}
COLUMNS = 4
# Around the finger's tip: 1.7 mm right of and 1.1 mm above the frame's middle.
ZOOM = (slice(288, 398), slice(477, 623))


def levels(scene: Scene) -> np.ndarray:
    """Return the noise-free raw frame [DN] of a scene, its effects applied at every stage."""
    effects = active_effects(scene)
    scene = apply_stage(Stage.RIG, scene, effects, Context(scene, 1, TIME_S))
    state = apply_stage(Stage.CONTACT, contact_state(scene, 1.0), effects, Context(scene, 1, TIME_S))
    _, frame = expose(scene, render_fast(scene, state), seed=1, time_s=TIME_S, without=("noise",))
    if frame.raw is None:
        raise ValueError("the camera kept no raw frame")
    return frame.raw.astype(float)


def sheet(out: Path) -> None:
    """Draw the sheet."""
    plain = levels(load_scene("thesis_ridged", HALF_RESOLUTION))
    effects = [effect for name, effect in all_effects().items() if name in SHOWN]
    rows = -(-(len(effects) + 1) // COLUMNS)
    figure, axes = plt.subplots(rows, COLUMNS, figsize=(2.9 * COLUMNS, 2.62 * rows), dpi=82, squeeze=False)
    for axis in axes.ravel():
        axis.axis("off")
    axes[0, 0].imshow(plain[ZOOM], cmap="gray", interpolation="nearest")
    axes[0, 0].set_title("without effects, 5 mm wide", fontsize=8)
    for axis, effect in zip(axes.ravel()[1:], effects, strict=False):
        values = SHOWN[effect.id]
        scene = load_scene("thesis_ridged", HALF_RESOLUTION).model_copy(update={"effects": {effect.id: values}})
        change = levels(scene) - plain
        if effect.stage in (Stage.RIG, Stage.CONTACT):
            picture = change[ZOOM]
        else:
            # Small defects would vanish in a reduced picture: keep each block's largest change.
            blocks = change[:748, :1000].reshape(187, 4, 250, 4).transpose(0, 2, 1, 3).reshape(187, 250, 16)
            picture = np.take_along_axis(blocks, np.abs(blocks).argmax(axis=2)[:, :, None], axis=2)[:, :, 0]
        # A few specks or hot pixels must not leave the rest white.
        scale = max(float(np.percentile(np.abs(picture), 99.7)), 1.0)
        axis.imshow(picture, cmap="RdBu_r", vmin=-scale, vmax=scale, interpolation="nearest")
        figures = ", ".join(f"{k.split('_')[0]} {v:g}" for k, v in values.items() if isinstance(v, int | float))
        axis.set_title(f"{effect.id}\n{figures}", fontsize=8)
        axis.text(
            0.5,
            -0.07,
            f"\u00b1{scale:.0f} DN, mean {change.mean():+.2f}",
            transform=axis.transAxes,
            fontsize=7,
            ha="center",
        )
        print(f"{effect.id}: largest change {np.abs(change).max():.0f} DN, mean {change.mean():+.3f} DN", flush=True)
    figure.tight_layout(pad=0.6)
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png")
    buffer.seek(0)
    part = out.with_suffix(".part.png")
    Image.open(buffer).convert("RGB").quantize(96).save(part, optimize=True)
    part.replace(out)
    print(f"{out}: {out.stat().st_size / 1000:.0f} kB")


def main() -> None:
    """Read the command line."""
    parser = argparse.ArgumentParser(description="Sheet of what each effect does to a frame.")
    parser.add_argument("--out", type=Path, default=Path(__file__).with_suffix(".png"))
    sheet(parser.parse_args().out)


if __name__ == "__main__":
    main()
