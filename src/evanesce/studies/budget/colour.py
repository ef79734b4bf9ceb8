"""What is not known of a colour camera: change of the refined area where it is not as stated.

The refined estimator reads colours by a camera model. Each term deviates the model from the camera that took the frame,
by what a lab may be wrong about; the change of the area is its limit in the budget. A measurement of the study draws
the camera from the same distributions: to first order its area changes in proportion.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from evanesce.evaluation.camera_model import camera_model
from evanesce.measurement.calibration.model import Calibration
from evanesce.measurement.refined.estimator import Estimator
from evanesce.measurement.refined.light import Radiometry
from evanesce.measurement.refined.result import RefinedArea
from evanesce.measurement.uncertainty.budget import Component
from evanesce.rig import Scene
from evanesce.sensor.colour import ImageProcessor
from evanesce.sensor.response import led_response
from evanesce.studies.estimator.study import LitPress

RESPONSE_TOLERANCE = 0.1
"""Relative, of green and blue pixels' response to the LEDs' light over red ones': an LED's wavelength bin of 5 nm."""

TEMPERATURE_TOLERANCE_K = 100.0
"""Of the colour temperature at which white balance and matrix were taken, where the camera settled by itself [K]."""

DEMOSAICING = "demosaicing"
ORIGINS = {
    "green response": "response of green pixels to the LEDs' light, known to 10 %",
    "blue response": "response of blue pixels to the LEDs' light, known to 10 %",
    "white balance": "gains of the white balance, known to 100 K",
    "colour matrix": "colour matrix, known to 100 K",
    DEMOSAICING: "edge-aware in place of bilinear demosaicing: which one the processor has is not known",
}


def radiometry_of(scene: Scene, calibration: Calibration) -> Radiometry:
    """Return the way from a frame to light: a calibration's, with the camera model of a scene in colour.

    Parameters
    ----------
    scene : Scene
    calibration : Calibration

    Returns
    -------
    Radiometry
    """
    plain = Radiometry.of(calibration.details)
    return plain if scene.camera.colour is None else replace(plain, camera=camera_model(scene))


def deviations(press: LitPress, voltage: float, seed: int, estimator: Estimator, area_mm2: float) -> dict[str, float]:
    """Return the change of a frame's refined area by each deviation of the camera [%]; empty in monochrome.

    Parameters
    ----------
    press : LitPress
    voltage : float
        [V].
    seed : int
        Of the frame's noise, the same in all frames that are compared.
    estimator : Estimator
        With the camera's own model.
    area_mm2 : float
        That it finds.

    Returns
    -------
    dict of float
    """
    scene, response = press.scene, led_response(press.scene)
    colour = scene.camera.colour
    if colour is None or response is None or not area_mm2 > 0:
        return {}
    own = ImageProcessor.of(scene.camera)
    kelvin = min(colour.temperature_K + TEMPERATURE_TOLERANCE_K, 9505.0)
    other = ImageProcessor.imx477(kelvin, curve=own.curve)
    red, green, blue = response
    more = 1.0 + RESPONSE_TOLERANCE
    models = {
        "green response": camera_model(scene, own, (red, more * green, blue)),
        "blue response": camera_model(scene, own, (red, green, more * blue)),
        "white balance": camera_model(scene, replace(own, red_gain=other.red_gain, blue_gain=other.blue_gain)),
        "colour matrix": camera_model(scene, replace(own, matrix=other.matrix)),
    }
    image = press.frame(voltage, seed).data
    found = {
        name: replace(estimator, radiometry=replace(estimator.radiometry, camera=model)).area(image).area_mm2
        for name, model in models.items()
    }
    swapped = "bilinear" if colour.demosaicing == "edge-aware" else "edge-aware"
    camera = scene.camera.model_copy(update={"colour": colour.model_copy(update={"demosaicing": swapped})})
    developed = replace(press, scene=scene.model_copy(update={"camera": camera})).frame(voltage, seed).data
    found[DEMOSAICING] = estimator.area(developed).area_mm2
    return {name: 100.0 * (area / area_mm2 - 1.0) for name, area in found.items()}


def camera_components(percent: Mapping[str, float], found: RefinedArea) -> list[Component]:
    """Return what a frame's area owes to the camera model, as components of its budget.

    Parameters
    ----------
    percent : mapping
        Of :func:`deviations` [%].
    found : RefinedArea

    Returns
    -------
    list of Component
        Of the boundary [mm]: between the stated camera and the other one for demosaicing, both ways for the rest.
    """
    if not found.perimeter_mm > 0:
        return []
    parts = []
    for name, change in percent.items():
        moved = 0.01 * change * found.area_mm2 / found.perimeter_mm
        low, high = (min(0.0, moved), max(0.0, moved)) if name == DEMOSAICING else (-abs(moved), abs(moved))
        parts.append(
            Component(name=name, role="boundary", low=low, high=high, shape="rectangular", origin=ORIGINS[name])
        )
    return parts


def drawn_deviation(percent: Mapping[str, float], draws: np.random.Generator) -> float:
    """Draw a camera and return the relative change of the area that it makes [1].

    Parameters
    ----------
    percent : mapping
        Of :func:`deviations` [%].
    draws : numpy.random.Generator

    Returns
    -------
    float
    """
    shares = {name: draws.uniform(0.0 if name == DEMOSAICING else -1.0, 1.0) for name in percent}
    return 0.01 * float(sum(shares[name] * change for name, change in percent.items()))
