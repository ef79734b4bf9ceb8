"""Area error of the refined estimator on colour frames, with and without a camera model.

    python docs/validation/colour_estimator.py [--forces 1,2,5] [--fingers ridged,smooth] [--wrong] [--json FILE]

Frames of thesis_ridged_red by the fast renderer, exposed so that the contact's light is so many times what fills a raw
red pixel; filter shares and colour temperature at the middle and at the ends of what the real frame allows.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import replace

import numpy as np

from evanesce.chain.simulate import solve_contact
from evanesce.core import rng
from evanesce.core.states import SensorLight
from evanesce.evaluation.calibrated_rig import calibrated
from evanesce.evaluation.camera_model import camera_model, raw_model, red_level
from evanesce.measurement.refined.estimator import Estimator
from evanesce.measurement.refined.light import Radiometry
from evanesce.measurement.uncertainty.area import refined_uncertainty
from evanesce.render.fast.transport import render_fast
from evanesce.rig import Scene, load_scene
from evanesce.sensor.expose import charge_of, frame_of, signal_of
from evanesce.sensor.lens import form_image
from evanesce.sensor.response import led_response

SETTINGS = {
    "middle": (3250.0, (1.0, 0.15, 0.05)),
    "low": (2400.0, (1.0, 0.04, 0.01)),
    "high": (5800.0, (1.0, 0.3, 0.15)),
}
BLUR_PX = 1.33
"""Of the scene's lens and pixels, 1.13 px, with the 0.5 px^2 that bilinear demosaicing adds: stated."""

RAW_BLUR_PX = 1.13
"""The same without demosaicing."""
CLIPPING = (1.0, 2.0, 5.0, 8.0, 12.0, 24.0)


def scene_of(setting: str, finger: str) -> Scene:
    """Return the scene with a colour setting and a finger."""
    kelvin, response = SETTINGS[setting]
    changes = {"camera.colour.temperature_K": kelvin, "camera.colour.response": list(response)}
    scene = load_scene("thesis_ridged_red", changes)
    if finger == "ridged":
        return scene
    smooth = load_scene("thesis").finger.ridges
    return scene.model_copy(update={"finger": scene.finger.model_copy(update={"ridges": smooth})})


def estimators(setting: str, models: list[str]) -> dict[str, Estimator]:
    """Return the estimator without a camera model, with the right one, and with those of the other settings."""
    scene = scene_of(setting, "ridged")
    calibration = calibrated(scene, rng.generator(1, "corners"))
    plain = Radiometry.of(calibration.details)
    found = {"grey": Estimator.of(calibration, plain)}
    for name in models or [setting]:
        model = camera_model(scene_of(name, "ridged"))
        label = "colour" if name == setting else f"model {name}"
        found[label] = Estimator.of(calibration, replace(plain, camera=model), blur_px=BLUR_PX)
    found["raw"] = Estimator.of(calibration, replace(plain, raw=raw_model(scene)), blur_px=RAW_BLUR_PX)
    return found


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--forces", default="2")
    parser.add_argument("--fingers", default="ridged,smooth")
    parser.add_argument("--settings", default=",".join(SETTINGS))
    parser.add_argument("--wrong", action="store_true", help="measure by the other settings' models, too")
    parser.add_argument("--json")
    options = parser.parse_args()
    tools = {
        setting: estimators(setting, list(SETTINGS) if options.wrong else []) for setting in options.settings.split(",")
    }
    rows = []
    for finger in options.fingers.split(","):
        for force in map(float, options.forces.split(",")):
            rig, state = solve_contact(scene_of("middle", finger), force, seed=1)
            assert state is not None
            light = form_image(render_fast(rig, state), rig.camera, rig.plate).irradiance.astype(float)
            contact = float(np.median(light[light > 0.5 * light.max()]))
            for setting, own in tools.items():
                scene = scene_of(setting, finger)
                for clipping in CLIPPING:
                    lit = SensorLight(irradiance=light * clipping / red_level(scene, contact))
                    charge = charge_of(lit, scene.camera, None, led_response(scene))
                    frame = frame_of(signal_of(charge, scene.camera, np.random.default_rng(len(rows))), scene.camera)
                    row = {"finger": finger, "force_N": force, "setting": setting, "clipping": clipping}
                    for name, estimator in own.items():
                        found = estimator.area(frame.raw if name == "raw" else frame.data)
                        row[name] = round(100 * (found.area_mm2 / state.nominal_contact_area - 1), 3)
                        if name in ("colour", "raw"):
                            known = refined_uncertainty(found, estimator, np.random.default_rng(0), cards=())
                            low, high = known.interval_mm2
                            row |= {
                                f"{name} unseen": found.unseen,
                                f"{name} half_width": round(50 * (high - low) / state.nominal_contact_area, 2),
                                f"{name} covered": bool(low <= state.nominal_contact_area <= high),
                            }
                    rows.append(row)
                    print(row, flush=True)
    for name in ("grey", "colour", "raw"):
        errors = np.array([row[name] for row in rows])
        covered = sum(row.get(f"{name} covered", False) for row in rows)
        worst = errors[np.abs(errors).argmax()]
        print(f"{name}: RMS {np.sqrt((errors**2).mean()):.2f} %, worst {worst:+.2f} %", end="")
        print("" if name == "grey" else f", {covered} of {len(rows)} intervals hold the truth")
    if options.json:
        with open(options.json, "w", encoding="utf-8") as file:
            json.dump(rows, file, indent=1)


if __name__ == "__main__":
    main()
