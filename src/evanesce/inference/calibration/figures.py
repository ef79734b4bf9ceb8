"""Figures of a rig that a calibration fits: parameters of effects that are continuous, and how each is entered."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.core.errors import InputError
from evanesce.inference.causes import Cause
from evanesce.inference.joint_fit import Taken
from evanesce.inference.model import AnchoredModel

Array = NDArray[Any]
Tell = Callable[[str], None]

LEAST_SHOWN = 0.3
"""Whitened size of what a parameter's prior deviation changes, below which the data cannot determine it."""


@dataclass(frozen=True)
class Figure:
    """Parameters of an effect that are fitted.

    Attributes
    ----------
    names : tuple of str
        Of the parameters.
    begin : mapping of str to float
        Where the fit begins, where that is not the nominal value: there the effect has a derivative.
    what : str
        In a reader's words.
    """

    names: tuple[str, ...]
    what: str
    begin: Mapping[str, float] = field(default_factory=dict)


# Effects that are missing are defects with places of their own, which `evanesce criticise` seeks, or laws of time that
# need a protocol of their own. What has no derivative at nothing begins at a tenth to a third of its prior deviation.
FIGURES: Mapping[str, Figure] = {
    "modulus": Figure(("relative",), "stiffness of the finger"),
    "bone_stiffening": Figure(("per_N",), "stiffening with force"),
    "adhesion": Figure(("work_J_per_m2",), "work of adhesion"),
    "creep": Figure(("per_decade", "onset_s"), "creep of a held contact", {"per_decade": 0.01, "onset_s": 0.1}),
    "ridge_height": Figure(("relative",), "height of the ridges"),
    "force_offset": Figure(("offset_N",), "zero of the load cell"),
    "off_axis_load": Figure(
        ("shift_x_mm_per_N", "shift_y_mm_per_N", "oval_x_per_N", "oval_diagonal_per_N"), "load off the axis"
    ),
    "led_bin": Figure(("offset_V",), "forward voltage of the LEDs"),
    "led_droop": Figure(("droop",), "efficiency droop of the LEDs"),
    "supply_sag": Figure(("resistance_ohm_per_mm",), "resistance of the strips' rails"),
    "led_spill": Figure(("share",), "light above the plate"),
    "led_imbalance": Figure(("contrast_x", "contrast_y"), "one side brighter"),
    "glass_absorption": Figure(("absorption_per_mm",), "absorption of the plate"),
    "led_air_gap": Figure(("share",), "air film before the LEDs"),
    "plate_haze": Figure(("top_share", "bottom_share"), "haze on the plate's faces"),
    "backdrop": Figure(("reflectance",), "backdrop"),
    "ambient_light": Figure(("radiance_W_per_mm2_sr",), "light of the room"),
    "lateral_glow": Figure(("share", "length_mm"), "subsurface scattering", {"share": 0.05, "length_mm": 0.5}),
    "plate_tilt": Figure(("about_x_deg", "about_y_deg"), "tilt of the camera against the plate"),
    "distortion_drift": Figure(
        ("k1", "k2", "k3", "p1", "p2", "centre_x_um", "centre_y_um"), "distortion and axis of the lens"
    ),
    "defocus": Figure(("blur_um",), "defocus"),
    "vignetting": Figure(("k",), "vignetting", {"k": 0.01}),
    "card_offset": Figure(("height_mm",), "height of the calibration cards"),
    "square_size": Figure(("square", "checkerboard"), "size of the printed cards"),
    "black_level": Figure(("offset_DN",), "black level"),
    "tone_curve": Figure(("gamma", "contrast"), "tone curve"),
}


@dataclass(frozen=True)
class Entered:
    """Figures that take part in a fit.

    Attributes
    ----------
    taken : tuple of Taken
    begin : mapping of str to float
        Point to begin at.
    left_out : mapping of str to str
        Why others do not take part, by effect or parameter.
    rows : mapping of str to ndarray (bins,)
        Whitened derivatives by parameter, each about the nominal fit with its own effect begun.
    """

    taken: tuple[Taken, ...]
    begin: Mapping[str, float]
    left_out: Mapping[str, str]
    rows: Mapping[str, Array]


def entered(
    model: AnchoredModel, point: Mapping[str, float], causes: Sequence[Cause], without: Collection[str], tell: Tell
) -> Entered:
    """Return the figures that the data respond to at a point.

    Parameters
    ----------
    model : AnchoredModel
    point : mapping
        Of the nominal fit, with figures that some frames show at once.
    causes : sequence of Cause
        That the data can be asked for.
    without : collection of str
        Effects that are left out.
    tell : callable
        Told which figure is differentiated.

    Returns
    -------
    Entered
    """
    by_id = {cause.id: cause for cause in causes}
    left_out = {name: "left out by request" for name in FIGURES if name in without}
    asked = {name: by_id[name] for name in FIGURES if name in by_id and name not in without}
    at = {name: _begin(name, cause) for name, cause in asked.items()}
    free = [
        (name, p)
        for name, cause in asked.items()
        for p in cause.parameters
        if p.name.partition(":")[2] in FIGURES[name].names
    ]
    tell(f"responses to {len(free)} figures: {', '.join(FIGURES[name].what for name in asked)}")
    found = model.derivatives([({**point, **at[name]}, p) for name, p in free])
    rows: dict[str, Array] = {}
    for (_, p), row in zip(free, found, strict=True):
        if isinstance(row, InputError):
            left_out[p.name] = str(row)
        elif float(np.linalg.norm(row)) * p.deviation < LEAST_SHOWN:
            left_out[p.name] = "no view of the bundle responds to it"
        else:
            rows[p.name] = row
    taken, begin = [], dict(point)
    for name, cause in asked.items():
        own = tuple(p for n, p in free if n == name and p.name in rows)
        if own:
            taken.append(Taken(cause, own))
            begin |= {p.name: point.get(p.name, p.null) for p in own} | at[name]
    return Entered(tuple(taken), begin, left_out, rows)


def _begin(name: str, cause: Cause) -> dict[str, float]:
    """Return where a figure begins: at its null, or where that silences others, beside it."""
    figure = FIGURES[name]
    if not figure.begin:
        return {}
    nulls = {p.name: p.null for p in cause.parameters}
    if any(nulls[p] for p in cause.amplitudes if p in nulls):
        return nulls
    at = {p.name: p.coordinate.of(figure.begin.get(p.name.partition(":")[2], np.nan)) for p in cause.parameters}
    return {key: nulls[key] if np.isnan(value) else value for key, value in at.items()}
