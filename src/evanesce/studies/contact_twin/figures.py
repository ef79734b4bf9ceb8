"""What a fitted contact frame says, in the words and units of a rig: figures with their standard errors."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from evanesce.studies.contact_twin.light import BACKDROP, HAZE_SHARE
from evanesce.studies.contact_twin.study import ContactTwin

MIDWAY = 0.25, 0.75
"""Part of the way from contact to rim whose light stands for the flank's."""
NINETY = 1.645
"""Standard errors on either side of a 90 % interval of a normal distribution."""


@dataclass(frozen=True)
class Figure:
    """One number that a frame gives.

    Attributes
    ----------
    name, unit, doc : str
    value, low, high : float
        Estimate and 90 % interval; NaN where the number was not fitted.
    """

    name: str
    unit: str
    value: float
    low: float
    high: float
    doc: str


def _disc(twin: ContactTwin) -> Figure:
    """Return the light of the finger's uncovered flank over the contact's: median midway from contact to rim."""
    light, fit = twin.light, twin.final.fit
    rows, cols = np.indices(light.parts["flank"].shape) - (np.array(light.parts["flank"].shape) - 1)[:, None, None] / 2
    radius = np.hypot(rows, cols) / light.px_per_mm
    share = (radius - light.contact_mm) / (light.rim_mm - light.contact_mm)
    here = (share > MIDWAY[0]) & (share < MIDWAY[1])
    total = light.parts["flank"][here].astype(float)
    for cause, part, name in (("led_spill", "spill", "spill"), ("plate_haze", "haze", "haze")):
        if cause in fit.causes:
            total += light.parts[part][here] * np.exp(fit.value[name])
    nan = float("nan")
    return Figure("flank over contact", "1", float(np.median(total)), nan, nan, "light midway from contact to rim")


def figures(twin: ContactTwin) -> list[Figure]:
    """Return what the twin's final fit says of rig and camera.

    Parameters
    ----------
    twin : ContactTwin

    Returns
    -------
    list of Figure
    """
    fit, believed = twin.final.fit, twin.model.believed
    error = dict(zip(fit.free, np.sqrt(np.diag(fit.covariance)).tolist(), strict=True))
    rim_mm, contact_mm, bin_px = twin.light.rim_mm, twin.light.contact_mm, twin.picture.bin_px
    diameter = twin.scene.finger.diameter_mm

    def of(name: str, unit: str, parameter: str, change: Callable[[float], float], doc: str) -> Figure:
        value, wide = fit.value[parameter], NINETY * error.get(parameter, float("nan"))
        bounds = twin.model.table[parameter]
        ends = sorted(change(float(np.clip(v, bounds.low, bounds.high))) for v in (value - wide, value + wide))
        return Figure(name, unit, change(value), ends[0], ends[1], doc)

    def area(log_size: float) -> float:
        return float(np.pi * (contact_mm * np.exp(log_size)) ** 2)

    found = [
        of("contact level", "1", "exposure", lambda v: believed.level * float(np.exp(v)), "1 fills the raw red value"),
        of(
            "scale", "px/mm", "rim_px", lambda v: v * bin_px / rim_mm,
            f"on the plate, if the finger is {diameter:g} mm wide and seems {2 * rim_mm:.1f} mm; pixels as given",
        ),
        of("contact area", "mm²", "contact_size", area, "at that scale"),
        of("blur", "px", "blur", lambda v: v * bin_px, "standard deviation, pixels of the frame as given"),
    ]  # fmt: skip
    found.append(_disc(twin))
    if "response" in fit.causes:
        (_, green, blue), kelvin = twin.model.settings(fit.value)
        nan = float("nan")
        found += [
            Figure("green over red response", "1", green, nan, nan, "of the filters to the LEDs' light"),
            Figure("blue over red response", "1", blue, nan, nan, "of the filters to the LEDs' light"),
            Figure("colour temperature", "K", kelvin, nan, nan, "of white balance and matrix"),
        ]
    if "led_spill" in fit.causes:
        found.append(of("spilled power", "1", "spill", lambda v: float(np.exp(v)), "over what enters the plate"))
    if "plate_haze" in fit.causes:
        found.append(
            of("haze", "1", "haze", lambda v: HAZE_SHARE * float(np.exp(v)), "of the guided light, at the top face")
        )
    if "backdrop" in fit.causes:
        found.append(
            of(
                "backdrop", "1", "backdrop", lambda v: BACKDROP.reflectance * float(np.exp(v)),
                f"reflectance times spilled power, at {BACKDROP.distance_mm:g} mm",
            )
        )  # fmt: skip
    return found
