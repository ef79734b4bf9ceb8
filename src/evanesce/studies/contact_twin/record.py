"""The twin of a contact frame as plain data, and as a scene to simulate with."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from evanesce.chain.fast_optics import charge_per_irradiance
from evanesce.chain.simulate import solve_contact
from evanesce.render.fast.transport import render_fast
from evanesce.rig import Backdrop, Haze, Scene, Spill, Surroundings
from evanesce.rig.colour import AutoExposure
from evanesce.rig.scene import LEAST_AUTOMATIC_PX
from evanesce.sensor.automatic import settle
from evanesce.sensor.colour import mosaic
from evanesce.sensor.lens import form_image
from evanesce.sensor.response import led_response
from evanesce.studies.contact_twin.figures import figures
from evanesce.studies.contact_twin.light import BACKDROP, HAZE_SHARE, SPILL_HEIGHT_MM
from evanesce.studies.contact_twin.model import FINER
from evanesce.studies.contact_twin.picture import LUMA
from evanesce.studies.contact_twin.study import ContactTwin, Step, medians, peaks, within_contact

WINDOW_PX = 128
"""Side of the middle of a contact whose level is taken [px]."""
EXPOSURE_MS = 0.001, 10000.0
LARGE_DN = 20.0
"""A residual above this in any channel is named in a note: the twin is then a sketch of the frame."""


def record(twin: ContactTwin) -> dict[str, Any]:
    """Return the twin as JSON-able data.

    Parameters
    ----------
    twin : ContactTwin

    Returns
    -------
    dict
        Models with residuals and gains, figures with 90 % intervals, medians of the regions, peaks of the grey
        histogram, grey within the contact, and notes on what the twin does not do.
    """
    simulated = twin.final.fit.predicted
    return {
        "bin_px": twin.picture.bin_px,
        "force_N": twin.force_N,
        "added": [_model(step) for step in twin.added],
        "without": [_model(step) for step in twin.without],
        "final": {**_model(twin.final), "causes": list(twin.final.fit.causes)},
        "figures": [
            {
                "name": f.name,
                "unit": f.unit,
                "value": f.value,
                "low": _number(f.low),
                "high": _number(f.high),
                "meaning": f.doc,
            }
            for f in figures(twin)
        ],
        "medians_DN": {name: {"frame": a.tolist(), "simulated": b.tolist()} for name, (a, b) in medians(twin).items()},
        "grey_peaks": {"frame": peaks(twin.picture.grey), "simulated": peaks(simulated @ LUMA / 255.0)},
        "grey_within_contact": within_contact(twin),
        "place_px": {name: (twin.final.fit.value[name] + 0.5) * twin.picture.bin_px - 0.5 for name in ("x", "y")},
        "simulated": simulated.round(2).tolist(),
        "automatic_level": automatic_levels(twin),
        "notes": notes(twin),
    }


def automatic_levels(twin: ContactTwin) -> dict[str, float]:
    """Return the contact's level on which libcamera's automatic exposure would settle in this frame, by metering.

    Parameters
    ----------
    twin : ContactTwin

    Returns
    -------
    dict of float
        1 fills the raw value of a red pixel; the longest exposure is not reached. Empty for a frame too small for the
        control's statistics.
    """
    rows, cols = twin.picture.shape
    if min(rows, cols) * FINER < LEAST_AUTOMATIC_PX:
        return {}
    fit = twin.final.fit
    level = twin.model.level(fit.value, fit.causes)
    (red, green, blue), _ = twin.model.settings(fit.value)
    believed = twin.model.believed.camera
    assert believed.colour is not None
    full_e = (2**believed.pixel.bits - 1 - believed.pixel.black_level_DN) * believed.pixel.conversion_gain_e_per_DN
    charge = mosaic(level * full_e, (red, green, blue), believed.colour.mosaic)
    contact = twin.model.believed.level * float(np.exp(fit.value["exposure"]))
    found = {}
    for metering in ("centre-weighted", "matrix", "spot"):
        control = AutoExposure(metering=metering)
        camera = believed.model_copy(update={"exposure_ms": 1.0, "analogue_gain": 1.0, "auto_exposure": control})
        settled, _ = settle(charge, camera)
        found[metering] = contact * settled.exposure_ms * settled.analogue_gain
    return found


def notes(twin: ContactTwin) -> list[str]:
    """Return what a reader must know before the figures are used.

    Parameters
    ----------
    twin : ContactTwin

    Returns
    -------
    list of str
    """
    found = []
    large = {c: v for c, v in zip(("red", "green", "blue"), twin.final.rms_DN.tolist(), strict=True) if v > LARGE_DN}
    if large:
        found.append("the twin misses held-out blocks by " + ", ".join(f"{v:.0f} DN in {c}" for c, v in large.items()))
    for one in figures(twin):
        if not math.isnan(one.low) and one.low <= 0.2 * one.value and one.high >= 5 * one.value:
            found.append(f"{one.name} is not determined by this frame")
    if twin.final.gain < 2 * twin.final.gain_error:
        found.append("no cause makes the frame better predicted than the believed rig does")
    return found


def calibrated_scene(twin: ContactTwin) -> Scene:
    """Return the believed scene with what the frame gives: press, light beside the contact, filters, scale, exposure.

    The exposure is set so that the contact has the level that was found. Contact law, finger and plate stay as
    believed; light that differs from side to side and reflections are left out, and haze is uneven by as much as was
    found, in a pattern of its own.

    Parameters
    ----------
    twin : ContactTwin

    Returns
    -------
    Scene
    """
    fit, scene = twin.final.fit, twin.scene
    spill = float(np.exp(fit.value["spill"])) if "led_spill" in fit.causes else 0.0
    haze = HAZE_SHARE * float(np.exp(fit.value["haze"])) if "plate_haze" in fit.causes else 0.0
    cloth = BACKDROP.reflectance * float(np.exp(fit.value["backdrop"])) if "backdrop" in fit.causes else 0.0
    surroundings = Surroundings(
        spill=Spill(share=min(spill, 10.0), height_mm=SPILL_HEIGHT_MM),
        haze=Haze(top_share=min(haze, 0.5), contrast=_contrast(twin)),
        backdrop=Backdrop(reflectance=min(cloth / spill, 1.0) if spill > 0 else 0.0, distance_mm=BACKDROP.distance_mm),
    )
    scale = fit.value["rim_px"] * twin.picture.bin_px / twin.light.rim_mm
    camera = scene.camera.model_copy(update={"scale_px_per_mm": scale}) if twin.picture.bin_px > 1 else scene.camera
    if camera.colour is not None and "response" in fit.causes:
        response, kelvin = twin.model.settings(fit.value)
        top = max(twin.model.believed.response)
        shares = tuple(min(1.0, share * top) for share in response)
        colour = camera.colour.model_copy(update={"response": shares, "temperature_K": kelvin})
        camera = camera.model_copy(update={"colour": colour})
    press = scene.press.model_copy(update={"forces_N": (round(twin.force_N, 3),), "ramp": None})
    kept = {key: text for key, text in scene.sources.items() if not key.startswith(("camera.colour", "press"))}
    assumed = {key: text for key, text in scene.assumptions.items() if not key.startswith(("camera.colour", "press"))}
    found = scene.model_copy(
        update={
            "surroundings": surroundings, "camera": camera, "press": press, "sources": kept, "assumptions": assumed,
            "title": f"{scene.title}, as a contact frame gives it",
        }
    )  # fmt: skip
    wanted = twin.model.believed.level * float(np.exp(fit.value["exposure"]))
    exposure = float(np.clip(found.camera.exposure_ms * wanted / contact_level(found, twin.force_N), *EXPOSURE_MS))
    return found.model_copy(update={"camera": found.camera.model_copy(update={"exposure_ms": exposure})})


def contact_level(scene: Scene, force_N: float) -> float:
    """Return the level of a contact in a scene: 1 fills the raw value of a pixel of the most sensitive filter.

    Parameters
    ----------
    scene : Scene
        With a colour camera.
    force_N : float
        [N].

    Returns
    -------
    float
        Median over the contact [1].
    """
    view = {"resolution_px": (WINDOW_PX, WINDOW_PX), "centre_mm": scene.finger.position_mm}
    near = scene.model_copy(update={"camera": scene.camera.model_copy(update=view)})
    rig, state = solve_contact(near, force_N, seed=0)
    irradiance = form_image(render_fast(rig, state), rig.camera, rig.plate).irradiance
    bright = irradiance[irradiance > 0.5 * irradiance.max()]
    camera, pixel = rig.camera, rig.camera.pixel
    charge = float(np.median(bright)) * charge_per_irradiance(rig) * max(led_response(rig) or (1.0,))
    top = 2**pixel.bits - 1 - pixel.black_level_DN
    return charge * camera.analogue_gain / pixel.conversion_gain_e_per_DN / top


def _contrast(twin: ContactTwin) -> float:
    """Return the standard deviation of the haze over its mean."""
    fit = twin.final.fit
    modes = [value for name, value in fit.value.items() if name.startswith("cloud_")] if "clouds" in fit.causes else []
    # A cosine along one side has half its square as mean, one along both a quarter.
    squares = [
        value**2 * (0.25 if name.split("_")[1] != "0" and name.split("_")[2] != "0" else 0.5)
        for name, value in fit.value.items()
        if name.startswith("cloud_")
    ]
    return min(3.0, math.sqrt(math.exp(min(sum(squares), 2.0)) - 1.0)) if modes else 0.0


def _model(step: Step) -> dict[str, Any]:
    return {
        "cause": step.cause,
        "rms_DN": step.rms_DN.tolist(),
        "log_score_nat": step.score,
        "gain_nat": step.gain,
        "gain_error_nat": step.gain_error,
    }


def _number(value: float) -> float | None:
    return None if math.isnan(value) else value
