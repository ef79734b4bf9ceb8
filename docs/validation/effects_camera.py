"""Figures of the validation pages of camera effects: what each does to a frame of the thesis rig, and what it costs.

Run: python docs/validation/effects_camera.py [PICTURE.png]
"""

from __future__ import annotations

import io
import os
import sys
import time
from pathlib import Path

import av
import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from scipy import ndimage

from evanesce.chain.simulate import expose
from evanesce.contact.solve import contact_state
from evanesce.effects import Context, Stage, all_effects
from evanesce.effects.readout.compression import quantised
from evanesce.render.fast.transport import render_fast
from evanesce.rig import load_scene
from evanesce.sensor.expose import charge_of, frame_of, signal_of
from evanesce.sensor.lens import form_image

FACTOR = 5
"""Pixels this many times as large as the thesis rig's, seeing the same field: 400 x 300."""

CAMERA = {
    "camera.resolution_px": [2000 // FACTOR, 1500 // FACTOR],
    "camera.scale_px_per_mm": 58.37 / FACTOR,
    "camera.pixel.pitch_um": 3.1 * FACTOR,
    "camera.pixel.full_well_capacity_e": 8180.0 * FACTOR**2,
    "camera.pixel.conversion_gain_e_per_DN": 2.13 * FACTOR**2,
}
CASES: dict[str, dict[str, float]] = {
    "black_level": {"offset_DN": 20.0},
    "tone_curve": {"gamma": 0.2, "contrast": 0.2},
    "vignetting": {"k": 0.3},
    "defocus": {"blur_um": 8.0, "corner_blur_um": 15.0},
    "distortion_drift": {"k1": 0.02, "k2": 0.05, "p1": 0.002, "centre_x_um": 30.0},
    "hot_pixels": {"fraction": 1e-3, "rate_e_per_s": 1e6},
    "rolling_shutter": {"ripple": 0.1},
    "saturation": {"well_loss": 0.65, "bloom": 0.5, "bloom_length_um": 60.0},
    "sensor_dust": {"per_cm2": 60.0},
    "compression": {"step_DN": 23.3},
}


def main(picture: Path | None) -> None:
    """Print change of the noise-free frame and cost of each effect; draw the changes."""
    state = contact_state(load_scene("thesis", CAMERA), 4.0)
    plain_scene = load_scene("thesis", CAMERA)
    light = render_fast(plain_scene, state)
    plain = expose(plain_scene, light, seed=1, without=("noise",))[1].data.astype(float)
    shots = {}
    print(f"{'effect':18s}   mean |change|   largest     contact    corner [DN of 255]")
    for name, values in CASES.items():
        scene = load_scene("thesis", {**CAMERA, "effects": {name: values}})
        shots[name] = expose(scene, light, seed=1, without=("noise",))[1].data.astype(float)
        change = shots[name] - plain
        middle, corner = change[140:160, 190:210].mean(), change[:20, :20].mean()
        worst = np.abs(change).max()
        print(f"{name:18s} {np.abs(change).mean():12.2f} {worst:12.0f} {middle:+11.2f} {corner:+9.2f}")
    costs(plain_scene, light)
    codec()
    if picture is not None:
        draw(plain, shots, picture)


def costs(scene, light) -> None:  # type: ignore[no-untyped-def]
    """Print the processor's time for one frame of 400 x 300, the least of several."""
    sensor_light = form_image(light, scene.camera, scene.plate)
    charge = charge_of(sensor_light, scene.camera)
    signal = signal_of(charge, scene.camera, None)
    frame = frame_of(signal, scene.camera, time_s=0.3)
    values = {Stage.SENSOR_LIGHT: sensor_light, Stage.CHARGE: charge, Stage.READOUT: signal, Stage.FRAME: frame}
    context = Context(scene, seed=1, time_s=0.3, index=9)
    print(f"Processor time of one call, least of 40 (load {os.getloadavg()[0]:.1f}):")
    for name, given in {**CASES, "frame_rate": {"departure": 0.2}}.items():
        effect = all_effects()[name]
        parameters, taken = effect.parameters(**given), []
        for _ in range(40):
            started = time.process_time()
            effect.apply(values[effect.stage], parameters, context)
            taken.append(time.process_time() - started)
        print(f"  {name:18s} {1e3 * min(taken):6.2f} ms")


def codec() -> None:
    """Print RMS error and noise left by the model and by libx264 (every frame intra) on a noisy patch."""
    v, u = np.mgrid[:304, :400]
    r = np.hypot(u - 220, v - 140) / 70
    clean = ndimage.gaussian_filter(40 + 120 * (r < 1) * (1 - 0.5 * r**2), 1.0) + 0.05 * u
    rng = np.random.default_rng(0)
    for noise in (2.0, 5.0):
        frame = np.clip(clean + noise * rng.standard_normal(clean.shape), 0, 255).astype(np.uint8)
        for quantiser in (18, 24, 30):
            model = quantised(frame, 0.625 * 2 ** (quantiser / 6) * 255 / 219, 8, 1 / 3)
            real = h264(frame, quantiser).astype(float)
            error = [np.std(made - frame) for made in (model, real)]
            left = [np.std((made - clean)[20:-20, 20:-20]) for made in (model, real)]
            print(
                f"noise {noise:g} DN, QP {quantiser}: error {error[0]:.2f} (libx264 {error[1]:.2f}) DN,"
                f" noise left {left[0]:.2f} ({left[1]:.2f}) DN"
            )


def h264(frame: np.ndarray, quantiser: int) -> np.ndarray:
    """Return a grey frame after libx264."""
    buffer = io.BytesIO()
    with av.open(buffer, "w", format="mp4") as container:
        stream = container.add_stream("libx264", rate=30)
        stream.height, stream.width = frame.shape
        stream.pix_fmt = "yuv420p"
        stream.options = {"qp": str(quantiser), "bf": "0", "x264-params": "keyint=1:ipratio=1"}
        rgb = np.repeat(frame[..., None], 3, axis=2)
        container.mux(stream.encode(av.VideoFrame.from_ndarray(rgb, format="rgb24")))
        container.mux(stream.encode(None))
    buffer.seek(0)
    with av.open(buffer) as container:
        (decoded,) = (f.to_ndarray(format="rgb24")[..., 1] for f in container.decode(video=0))
    return np.asarray(decoded)


def draw(plain: np.ndarray, shots: dict[str, np.ndarray], path: Path) -> None:
    """Draw the plain frame and each effect's change of it."""
    figure, axes = plt.subplots(3, 4, figsize=(13, 8.2), layout="constrained")
    frame = axes.flat[0].imshow(plain, cmap="gray", vmin=0, vmax=255)
    axes.flat[0].set_title("plain frame, 4 N, 9 V")
    figure.colorbar(frame, ax=axes.flat[0], label="DN of 255", shrink=0.8)
    for axis, (name, shot) in zip(axes.flat[1:], shots.items(), strict=False):
        change = shot - plain
        reach = max(2.0, float(np.percentile(np.abs(change), 99.7)))
        drawn = axis.imshow(change, cmap="RdBu_r", vmin=-reach, vmax=reach)
        axis.set_title(f"{name}: change")
        figure.colorbar(drawn, ax=axis, label="DN of 255", shrink=0.8)
    for axis in axes.flat:
        axis.set_xticks([])
        axis.set_yticks([])
    for axis in axes.flat[1 + len(shots) :]:
        axis.remove()
    figure.savefig(path, dpi=80)


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else None)
