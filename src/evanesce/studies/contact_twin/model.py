"""From light by cause to the colours of a frame: geometry, levels, camera; every number a fit may vary, by cause."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import expit

from evanesce.rig import Camera
from evanesce.sensor.colour import ImageProcessor, exact_colour_of_level
from evanesce.sensor.tone import CURVES
from evanesce.studies.contact_twin.light import PressLight
from evanesce.studies.contact_twin.picture import Outline, Picture

Array = NDArray[np.float64]

FINER = 3
"""Samples along a pixel of the fit: the contact's edge is then placed to a few hundredths of a pixel."""
LEVELS = np.concatenate([[0.0], np.geomspace(1e-4, 1e4, 4000)])
KELVIN = float(np.log(2360.0) + 1e-9), float(np.log(9505.0) - 1e-9)
"""Ends of the tuning's curve of white points, as logarithms [K]."""
CLOUD_MODES = 5
"""Cosines along a side of the frame that make haze uneven: nothing finer than the held-out blocks is judged."""


@dataclass(frozen=True)
class Parameter:
    """A number that a fit may vary.

    Attributes
    ----------
    cause : str
        What it belongs to; :data:`CAUSES`.
    null : float
        Value without its cause.
    start : float
        Where a fit begins.
    scale : float
        A step that is small for it.
    unit : str
    low, high : float
        Bounds.
    doc : str
    also : str
        Another cause without which it does nothing.
    """

    cause: str
    null: float
    start: float
    scale: float
    unit: str
    low: float
    high: float
    doc: str
    also: str = ""

    def acts(self, causes: Collection[str]) -> bool:
        """Return whether it is free where these causes act."""
        return self.cause in causes and (not self.also or self.also in causes)


CAUSES: dict[str, str] = {
    "place": "where contact and finger lie in the frame",
    "exposure": "another exposure than believed",
    "colour": "red light on a colour camera, by the sensor's published curves",
    "response": "other filters and white balance than the published ones",
    "led_spill": "light of the strips on the finger's flank",
    "plate_haze": "haze on the plate",
    "backdrop": "something dark above the plate, lit by the strips",
    "led_imbalance": "light that differs from side to side",
    "clouds": "haze that is uneven",
    "led_edge_reflections": "LEDs reflected along the frame's left and right border",
    "streak": "an LED reflected as a streak away from the finger",
}
"""What may light the frame or shape it, in the order in which it is tried."""


@dataclass(frozen=True)
class Believed:
    """The camera that is believed.

    Attributes
    ----------
    camera : Camera
    response : tuple of float
        Of the red, green and blue filters to the light, over the red one's [1].
    level : float
        Of the contact, believed: over what fills the raw red value of a pixel [1].
    """

    camera: Camera
    response: tuple[float, float, float]
    level: float


def parameters(outline: Outline, shape: tuple[int, int], believed: Believed) -> dict[str, Parameter]:
    """Return every number that a fit may vary.

    Parameters
    ----------
    outline : Outline
        Where contact and finger are at first.
    shape : tuple of int
        (rows, cols) of the picture.
    believed : Believed

    Returns
    -------
    dict of Parameter
        By name.
    """
    (x, y), rows, cols = outline.centre, *shape
    wide = outline.finger_radius
    red, green, blue = (float(np.log(max(share, 1e-4))) for share in believed.response)
    colour = believed.camera.colour
    kelvin = float(np.log(colour.temperature_K if colour else 2850.0))
    found = {
        "x": Parameter("place", x, x, 0.1, "px", x - wide, x + wide, "of the finger's axis"),
        "y": Parameter("place", y, y, 0.1, "px", y - wide, y + wide, "of the finger's axis"),
        "rim_px": Parameter("place", wide, wide, 0.1, "px", 0.8 * wide, 1.25 * wide, "radius at which the finger ends"),
        "contact_size": Parameter(
            "place", 0.0, 0.0, 0.01, "1", -0.3, 0.3, "logarithm of the contact's radius over the press's"
        ),
        "contact_x": Parameter("place", 0.0, 0.0, 0.1, "px", -0.3 * wide, 0.3 * wide, "of the contact from the axis"),
        "contact_y": Parameter("place", 0.0, 0.0, 0.1, "px", -0.3 * wide, 0.3 * wide, "of the contact from the axis"),
        "blur": Parameter("place", 0.5, 0.5, 0.05, "px", 0.05, 4.0, "standard deviation of the frame's blur"),
        "exposure": Parameter("exposure", 0.0, 0.0, 0.05, "1", -5.0, 7.0, "logarithm of contact over believed level"),
        "green": _share("green", green - red),
        "blue": _share("blue", blue - red),
        "temperature": Parameter("response", kelvin, kelvin, 0.03, "1", *KELVIN, "logarithm of colour temperature [K]"),
        "spill": Parameter("led_spill", -12.0, -1.0, 0.05, "1", -12.0, 4.0, "logarithm of spilled over guided power"),
        "haze": Parameter("plate_haze", -12.0, -1.0, 0.05, "1", -12.0, 5.0, "logarithm of haze over one of 1 %"),
        "backdrop": Parameter("backdrop", -12.0, -2.0, 0.05, "1", -12.0, 5.0, "logarithm of backdrop over one of 5 %"),
        "contact_right": _tilt("of contact and haze towards the right edge"),
        "contact_down": _tilt("of contact and haze towards the lower edge"),
        "spill_right": _tilt("of spill towards the right edge", "led_spill"),
        "spill_down": _tilt("of spill towards the lower edge", "led_spill"),
    }
    for side, at in (("left", 0.0), ("right", cols - 1.0)):
        found |= {
            f"{side}_level": Parameter("led_edge_reflections", -12.0, -4.0, 0.1, "1", -12.0, 3.0, "logarithm of light"),
            f"{side}_at": Parameter("led_edge_reflections", at, at, 0.2, "px", at - 8, at + 8, "middle of the band"),
            f"{side}_width": Parameter("led_edge_reflections", 1.5, 1.5, 0.1, "px", 0.3, 0.2 * cols, "of the band"),
        }
    below = y + 1.2 * wide
    found |= {
        "streak_level": Parameter("streak", -12.0, -3.0, 0.1, "1", -12.0, 4.0, "logarithm of light"),
        "streak_x": Parameter("streak", x, x + 0.6 * wide, 0.2, "px", -cols, 2 * cols, "at its foot"),
        "streak_y": Parameter("streak", below, below, 0.2, "px", 0.0, 1.5 * rows, "of its foot"),
        "streak_angle": Parameter("streak", 1.2, 1.1, 0.03, "rad", -0.1, 6.3832, "from the rows"),
        "streak_width": Parameter("streak", 0.8, 0.8, 0.05, "px", 0.2, 6.0, "standard deviation"),
    }
    for i in range(CLOUD_MODES):
        for j in range(CLOUD_MODES):
            if i or j:
                found[f"cloud_{i}_{j}"] = Parameter(
                    "clouds", 0.0, 0.0, 0.05, "1", -3.0, 3.0, "cosine of haze's logarithm", "plate_haze"
                )
    return found


def _share(name: str, at: float) -> Parameter:
    low, high = min(at, -5.0), max(at, 0.0)
    return Parameter("response", at, at, 0.05, "1", low, high, f"logarithm of the {name} filter's share over the red's")


def _tilt(doc: str, also: str = "") -> Parameter:
    return Parameter("led_imbalance", 0.0, 0.0, 0.03, "1", -2.0, 2.0, f"logarithm of light {doc}", also)


class Model:
    """The colours that a press gives.

    Parameters
    ----------
    picture : Picture
    light : PressLight
    believed : Believed
    outline : Outline
    """

    def __init__(self, picture: Picture, light: PressLight, believed: Believed, outline: Outline) -> None:
        self.picture, self.light, self.believed = picture, light, believed
        self.table = parameters(outline, picture.shape, believed)
        rows, cols = picture.shape
        fine = [(np.arange(n * FINER) + 0.5) / FINER - 0.5 for n in (cols, rows)]
        self._x, self._y = (a.astype(np.float32) for a in np.meshgrid(*fine))
        self._rim_mm = light.rim_mm
        self._modes = [_cosines(n * FINER) for n in (rows, cols)]

    def values(self, given: Mapping[str, float], causes: Collection[str]) -> dict[str, float]:
        """Return every number: as given, or without its cause."""
        return {
            name: given.get(name, p.start) if p.cause in causes else p.null for name, p in self.table.items()
        }  # fmt: skip

    def level(self, value: Mapping[str, float], causes: Collection[str]) -> Array:
        """Return the light's level on the finer grid: 1 fills the raw red value [1]."""
        scale = self._rim_mm / value["rim_px"] * self.light.px_per_mm
        middle = (self.light.parts["contact"].shape[0] - 1) / 2
        x, y = self._x - np.float32(value["x"]), self._y - np.float32(value["y"])

        def part(name: str) -> Array:
            dx, dy, size = x, y, scale
            if name == "contact":
                dx, dy = x - np.float32(value["contact_x"]), y - np.float32(value["contact_y"])
                size = scale * np.exp(-value["contact_size"])
            u, v = (a * np.float32(size) + np.float32(middle) for a in (dx, dy))
            border = cv2.BORDER_REPLICATE if name in ("haze", "backdrop") else cv2.BORDER_CONSTANT
            return np.asarray(cv2.remap(self.light.parts[name], u, v, cv2.INTER_LINEAR, borderMode=border), np.float64)

        rows, cols = self.picture.shape
        right, down = 2 * x / cols, 2 * y / rows
        guided = np.exp(value["contact_right"] * right + value["contact_down"] * down)
        total = part("contact") * guided + part("flank")
        if "led_spill" in causes:
            spilled = np.exp(value["spill"] + value["spill_right"] * right + value["spill_down"] * down)
            total += part("spill") * spilled
        if "plate_haze" in causes:
            cloudy = self._clouds(value) if "clouds" in causes else 0.0
            total += part("haze") * guided * np.exp(value["haze"] + cloudy)
        if "backdrop" in causes:
            total += part("backdrop") * np.exp(value["backdrop"])
        if "led_edge_reflections" in causes:
            total += self._bands(value)
        if "streak" in causes:
            total += self._streak(value)
        return total * (self.believed.level * np.exp(value["exposure"]))

    def predict(self, value: Mapping[str, float], causes: Collection[str]) -> Array:
        """Return the picture (rows, cols, 3) [DN]."""
        level = self.level(value, causes)
        curve = self.curve(value, "colour" in causes)
        shown = np.stack([np.interp(level, LEVELS, channel) for channel in curve.T], axis=-1)
        sigma = FINER * value["blur"]
        shown = np.asarray(cv2.GaussianBlur(shown, (0, 0), sigma, borderType=cv2.BORDER_REPLICATE))
        rows, cols = self.picture.shape
        return np.asarray(shown.reshape(rows, FINER, cols, FINER, 3).mean(axis=(1, 3)))

    def settings(self, value: Mapping[str, float]) -> tuple[tuple[float, float, float], float]:
        """Return the response of the filters over the red one's, and the colour temperature [K]."""
        response = 1.0, float(np.exp(value["green"])), float(np.exp(value["blue"]))
        return response, float(np.exp(value["temperature"]))

    def curve(self, value: Mapping[str, float], colour: bool = True) -> Array:
        """Return the colour of each of :data:`LEVELS` (n, 3) [DN]."""
        tone = CURVES[self.believed.camera.tone_curve]
        if not colour:
            return np.repeat(255.0 * tone(np.minimum(LEVELS, 1.0))[:, None], 3, axis=1)
        response, kelvin = self.settings(value)
        return exact_colour_of_level(
            LEVELS, response, ImageProcessor.imx477(kelvin, curve=self.believed.camera.tone_curve)
        )

    def _clouds(self, value: Mapping[str, float]) -> Array:
        weights = np.array([[value.get(f"cloud_{i}_{j}", 0.0) for j in range(CLOUD_MODES)] for i in range(CLOUD_MODES)])
        down, across = self._modes
        return np.asarray(down @ weights @ across.T)

    def _bands(self, value: Mapping[str, float]) -> Array:
        total = np.zeros(self._x.shape)
        for side in ("left", "right"):
            away = (self._x - value[f"{side}_at"]) / value[f"{side}_width"]
            total += np.exp(value[f"{side}_level"] - 0.5 * away**2)
        return total

    def _streak(self, value: Mapping[str, float]) -> Array:
        across = np.array([np.sin(value["streak_angle"]), -np.cos(value["streak_angle"])])
        dx, dy = self._x - value["streak_x"], self._y - value["streak_y"]
        away = (dx * across[0] + dy * across[1]) / value["streak_width"]
        along = dx * np.cos(value["streak_angle"]) + dy * np.sin(value["streak_angle"])
        return np.asarray(np.exp(value["streak_level"] - 0.5 * away**2) * expit(2.0 * along))


def _cosines(count: int) -> Array:
    at = (np.arange(count) + 0.5) / count
    return np.asarray(np.cos(np.pi * at[:, None] * np.arange(CLOUD_MODES)))
