"""Development rigs of the joint fit: nominal scenes of their own, hidden causes on top, written as bundles.

None is the thesis's rig: plate, finger, lens, resolution and LEDs differ. The hidden causes are the library's own
effects at figures that laboratories meet, plus fringes that are in no library; so a joint fit that misses them misses
what it could have named, and one that names them well has shown no more than that its algebra holds.

Run as a program it writes them: ``python tests/inference/development_rigs.py FOLDER [NAME ...]``.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.bundle.folder import new_folder, write_frame, write_shots
from evanesce.bundle.layout import conditions
from evanesce.bundle.protocol import Protocol, default_protocol
from evanesce.bundle.write import RAYS, write_bundle
from evanesce.core.states import PlateLight
from evanesce.optics.projection import Projection
from evanesce.render.fast.transport import render_fast
from evanesce.rig import Scene, dump_scene, load_scene

FINER = 4
"""Pixels at which light is sampled along each of the camera's: more than any prediction has."""

COMMON: Mapping[str, Any] = {
    "camera.pixel.pitch_um": 15.5,
    "camera.pixel.fill_factor": 0.05,
    "camera.principal_point_offset_px": [3.0, -2.0],
    "camera.lens.distortion.k1": -0.11,
    "camera.lens.distortion.k2": 0.02,
    "card.checkerboard_squares": [9, 7],
    "card.checkerboard_side_mm": 3.0,
}


@dataclass(frozen=True)
class DevelopmentRig:
    """A nominal scene and what is really there.

    Attributes
    ----------
    nominal : mapping
        Over the thesis's scene.
    hidden : mapping of str to mapping
        Effects of the true rig.
    fringes : float
        Relative amplitude of fringes over the plate, which no effect makes.
    """

    nominal: Mapping[str, Any]
    hidden: Mapping[str, Mapping[str, Any]]
    fringes: float = 0.0
    protocol: Mapping[str, int] = field(default_factory=dict)
    finer: int = FINER

    def scene(self) -> Scene:
        """Return the nominal scene."""
        return load_scene("thesis", {**COMMON, **self.nominal})


RIGS: Mapping[str, DevelopmentRig] = {
    "one": DevelopmentRig(
        {
            "plate.size_mm": [104.0, 84.0],
            "plate.thickness_mm": 5.0,
            "leds.pitch_mm": 13.1,
            "finger.tip_radius_mm": 8.6,
            "finger.position_mm": [1.3, -0.9],
            "camera.resolution_px": [208, 156],
            "camera.scale_px_per_mm": 6.8,
            "camera.exposure_ms": 1.9,
            "camera.lens.f_number": 4.0,
            "camera.lens.defocus_um": 90.0,
            "press.forces_N": [5.0],
        },
        {
            "modulus": {"relative": 0.15},
            "lateral_glow": {"share": 0.3, "length_mm": 0.8},
            "black_level": {"offset_DN": 7.0},
            "led_imbalance": {"contrast_x": 0.077, "contrast_y": 0.043},
            "vignetting": {"k": 0.12, "exponent": 2.0},
        },
    ),
    "two": DevelopmentRig(
        {
            "plate.size_mm": [96.0, 78.0],
            "plate.thickness_mm": 8.0,
            "leds.edges": ["left", "right", "top"],
            "leds.pitch_mm": 11.0,
            "finger.tip_radius_mm": 6.7,
            "finger.position_mm": [-1.1, 0.7],
            "camera.resolution_px": [184, 136],
            "camera.scale_px_per_mm": 7.4,
            "camera.exposure_ms": 6.0,
            "camera.lens.focal_length_mm": 8.0,
            "camera.lens.defocus_um": 110.0,
            "press.forces_N": [6.0],
        },
        {
            "force_offset": {"offset_N": 0.12},
            "led_droop": {"droop": 0.12},
            "off_axis_load": {"shift_x_mm_per_N": 0.03, "oval_x_per_N": 0.012},
            "defocus": {"corner_blur_um": 25.0},
            "plate_tilt": {"about_x_deg": 1.2, "about_y_deg": -0.7},
            "ambient_light": {"radiance_W_per_mm2_sr": 6e-8, "gradient": [0.3, 0.1]},
            "tone_curve": {"gamma": 0.06},
            "specks": {"per_cm2": 40.0},
        },
    ),
    "three": DevelopmentRig(
        {
            "plate.size_mm": [124.0, 92.0],
            "plate.thickness_mm": 6.0,
            "leds.edges": ["left", "right", "bottom"],
            "finger.tip_radius_mm": 9.7,
            "camera.resolution_px": [200, 148],
            "camera.scale_px_per_mm": 6.3,
            "camera.exposure_ms": 7.0,
            "camera.lens.f_number": 8.0,
            "camera.lens.defocus_um": -70.0,
            "press.forces_N": [4.0],
        },
        {
            "modulus": {"relative": -0.12},
            "creep": {"per_decade": 0.05},
            "led_imbalance": {"contrast_x": 0.05, "contrast_y": -0.1},
            "lateral_glow": {"share": 0.25, "length_mm": 0.6},
            "black_level": {"offset_DN": -6.0},
        },
        fringes=0.015,
    ),
    "tiny": DevelopmentRig(
        {
            "plate.size_mm": [90.0, 70.0],
            "finger.tip_radius_mm": 8.0,
            "finger.position_mm": [0.6, 0.4],
            "camera.resolution_px": [120, 88],
            "camera.scale_px_per_mm": 6.0,
            "camera.exposure_ms": 4.5,
            "camera.lens.defocus_um": 60.0,
            "press.forces_N": [5.0],
        },
        {"modulus": {"relative": 0.15}, "black_level": {"offset_DN": 8.0}, "led_droop": {"droop": 0.15}},
        protocol={"replicates": 6, "led_off": 3, "lens_cap": 3, "checkerboard": 0, "square": 0},
        finer=4,
    ),
    # Red light and a colour camera.
    "red": DevelopmentRig(
        {
            "plate.size_mm": [90.0, 70.0],
            "leds.spectrum": "red",
            "leds.circuit.forward_voltage_V": 2.05,
            "leds.circuit.efficacy_W_per_A": 1.9,
            "finger.tip_radius_mm": 8.0,
            "finger.position_mm": [0.6, 0.4],
            "camera.resolution_px": [120, 88],
            "camera.scale_px_per_mm": 6.0,
            "camera.exposure_ms": 5.0,
            "camera.analogue_gain": 2.0,
            "camera.tone_curve": "libcamera",
            "camera.colour.temperature_K": 3250.0,
            "camera.lens.defocus_um": 60.0,
            "press.forces_N": [5.0],
        },
        {"modulus": {"relative": 0.15}, "black_level": {"offset_DN": 8.0}, "vignetting": {"k": 0.2}},
        protocol={"replicates": 8, "led_off": 3, "lens_cap": 3},
        finer=3,
    ),
    # Frames proportional to light, for tests that add to them.
    "linear": DevelopmentRig(
        {
            "plate.size_mm": [90.0, 70.0],
            "finger.tip_radius_mm": 8.0,
            "finger.position_mm": [0.6, 0.4],
            "camera.resolution_px": [120, 88],
            "camera.scale_px_per_mm": 6.0,
            "camera.exposure_ms": 6.0,
            "camera.tone_curve": "linear",
            "camera.lens.defocus_um": 60.0,
            "press.forces_N": [5.0],
        },
        {},
        protocol={"replicates": 6, "led_off": 3, "lens_cap": 3, "checkerboard": 0, "square": 0},
        finer=4,
    ),
}


def write_rig(name: str, folder: Path, seed: int = 11) -> None:
    """Write the bundle of a development rig.

    Parameters
    ----------
    name : str
        Of :data:`RIGS`.
    folder : Path
        Must not exist.
    seed : int
    """
    rig = RIGS[name]
    nominal = rig.scene()
    x, y = nominal.finger.position_mm
    # Nobody lowers a finger where the scene says.
    finger = nominal.finger.model_copy(update={"position_mm": (x + 0.11, y - 0.07)})
    true = nominal.model_copy(update={"effects": dict(rig.hidden), "finger": finger})

    def fringed(scene: Scene, state: Any, *, seed: int) -> PlateLight:

        view = Projection.of(scene.camera, scene.plate).ideal_view().finer(RAYS)
        light = render_fast(scene, state, seed=seed, view=view)
        rows, cols = light.radiance.shape
        y, x = np.mgrid[0:rows, 0:cols] / cols
        pattern = 1.0 + rig.fringes * np.sin(2 * np.pi * (17.0 * x + 6.0 * y + 3.0 * x * y))
        return replace(light, radiance=(light.radiance * pattern).astype(np.float32))

    protocol = replace(default_protocol(nominal), **rig.protocol)
    render = fringed if rig.fringes else None
    write_bundle(folder, true, seed=seed, nominal=nominal, protocol=protocol, render=render, finer=rig.finer)


def write_other_finger(folder: Path, name: str = "one", seed: int = 5) -> None:
    """Write a bundle drawn with NumPy alone: an elliptical contact, smaller than the nominal scene's, on a dim ground.

    The nominal scene is that of a development rig. Nothing of the program's optics, contact or camera takes part:
    ellipses of constant level with a soft edge, areas that follow F^(2/3), grey noise.

    Parameters
    ----------
    folder : Path
        Must not exist.
    name : str
        Of :data:`RIGS`.
    seed : int
    """
    rng = np.random.default_rng(seed)
    nominal = RIGS[name].scene()
    cols, rows = nominal.camera.resolution_px
    scale = nominal.camera.scale_px_per_mm
    protocol = _few_shots(nominal)
    y, x = np.mgrid[0:rows, 0:cols].astype(float)

    def frame(force_N: float, light: float) -> NDArray[np.uint8]:
        area = 49.0 * (force_N / 5.0) ** (2 / 3)
        long = np.sqrt(area / np.pi * 1.45) * scale
        short = np.sqrt(area / np.pi / 1.45) * scale
        u, v = x - cols / 2 - 6.0, y - rows / 2 + 4.0
        turn = np.radians(24.0)
        u, v = u * np.cos(turn) + v * np.sin(turn), -u * np.sin(turn) + v * np.cos(turn)
        inside = 1.0 / (1.0 + np.exp((np.hypot(u / long, v / short) - 1.0) * 40.0))
        level = 9.0 + 120.0 * np.sqrt(light) * inside
        return np.clip(np.round(level + 1.5 * rng.standard_normal(level.shape)), 0, 255).astype(np.uint8)

    with new_folder(folder) as part:
        (part / "scene.toml").write_text(dump_scene(nominal), encoding="utf-8")
        (part / "measurement.toml").write_text('schema_version = 1\nscene = "scene.toml"\n', encoding="utf-8")
        write_shots(part / "press.csv", protocol.press)
        for shot in protocol.press:
            write_frame(part, "press", shot.index, frame(shot.force_N, 1.0))


def _few_shots(nominal: Scene) -> Protocol:
    """Return the ramp alone, without hold, sweep or auxiliary shots."""
    whole = default_protocol(nominal)
    return replace(whole, press=conditions(list(whole.press[:6])), replicates=0, led_off=0, lens_cap=0)


def main() -> None:
    """Write the named rigs, or all of them."""
    target, *names = sys.argv[1:]
    Path(target).mkdir(parents=True, exist_ok=True)
    for name in names or [*RIGS, "other"]:
        folder = Path(target) / name
        write_other_finger(folder) if name == "other" else write_rig(name, folder)
        print(folder)


if __name__ == "__main__":
    main()
