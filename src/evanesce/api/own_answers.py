"""Answers about one's own rig, and the keys of a scene that they change."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any

from evanesce.core.errors import InputError
from evanesce.measurement.calibration.model import Calibration
from evanesce.rig.explain import scene_keys

GIVEN = "given"
FINGERS = ("smooth", "ball", "ridged", "print", "pad")


def is_given(answer: Any) -> bool:
    """Return whether an answer is one: 0 is, an empty text or a flag that is not set is none."""
    return answer is not None and answer is not False and answer != "" and answer != {}


def check_number(key: str, value: Any) -> None:
    """Refuse a number outside the range of a scene's key.

    Parameters
    ----------
    key : str
        Dotted.
    value : object
        What is no number is left to the scene.

    Raises
    ------
    InputError
    """
    known = scene_keys().get(key)
    if known is None or known.quantity is None:
        return
    low, high = known.quantity.bounds
    for one in value if isinstance(value, list | tuple) else (value,):
        if isinstance(one, int | float) and not low <= one <= high:
            raise InputError(f"{one:g} is out of range", file="init", key=key, allowed=str(known.quantity))


@dataclass(frozen=True, kw_only=True)
class RigAnswers:
    """What is known of a rig; None leaves the preset's.

    Attributes
    ----------
    plate_size_mm : tuple of float
        Along x and y [mm].
    thickness_mm, index, absorption_per_mm : float
        Of the plate [mm], [1], [1/mm].
    material : str
        Key of :data:`evanesce.rig.catalogue.MATERIALS`.
    spectrum : str
        white, red, infrared, or a CSV file.
    led_pitch_mm : float
    package : str
        Key of :data:`evanesce.rig.catalogue.PACKAGES`.
    edges : tuple of str
    voltage_V : float
        Of the supply.
    current_mA : float
        Of one segment of the strip, in place of the voltage.
    camera : str
        Key of :data:`evanesce.rig.catalogue.CAMERAS`.
    resolution_px : tuple of int
        Columns, rows.
    pixel_um, focal_mm, f_number : float
        Pixel pitch [um], focal length [mm], f-number.
    scale_px_per_mm, field_mm, distance_mm : float
        One of: scale on the contact plane, width of the field of view, lens to the plate's lower face.
    exposure_ms : float
        None: found by simulation.
    colour, noir : bool
        Whether frames are in colour, and whether the colour camera lacks its infrared cut filter.
    finger : str
        One of :data:`FINGERS`.
    tip_radius_mm, modulus_MPa : float
        Of the finger; Young's modulus in place of a named silicone.
    silicone : str
        Name of a material.
    ridge_height_um, ridge_width_um, ridge_pitch_um : float
    forces_N : tuple of float
    board_squares : tuple of int
        Of the checkerboard, columns and rows.
    board_square_mm, square_mm : float
        Sides of the checkerboard's squares and of the square card [mm].
    board_inverted : bool
        Whether the board's square at the upper left of a picture is black.
    calibration : Calibration
        Of the camera: scale, distortion and axis come from it.
    calibration_name : str
        Named as their source.
    title : str
    settings : mapping
        Dotted keys of the scene, which win.
    """

    plate_size_mm: tuple[float, float] | None = None
    thickness_mm: float | None = None
    material: str | None = None
    index: float | None = None
    absorption_per_mm: float | None = None
    spectrum: str | None = None
    led_pitch_mm: float | None = None
    package: str | None = None
    edges: tuple[str, ...] | None = None
    voltage_V: float | None = None
    current_mA: float | None = None
    camera: str | None = None
    resolution_px: tuple[int, int] | None = None
    pixel_um: float | None = None
    focal_mm: float | None = None
    f_number: float | None = None
    scale_px_per_mm: float | None = None
    field_mm: float | None = None
    distance_mm: float | None = None
    exposure_ms: float | None = None
    colour: bool = False
    noir: bool = False
    finger: str | None = None
    tip_radius_mm: float | None = None
    modulus_MPa: float | None = None
    silicone: str | None = None
    ridge_height_um: float | None = None
    ridge_width_um: float | None = None
    ridge_pitch_um: float | None = None
    forces_N: tuple[float, ...] | None = None
    board_squares: tuple[int, int] | None = None
    board_square_mm: float | None = None
    square_mm: float | None = None
    board_inverted: bool | None = None
    calibration: Calibration | None = None
    calibration_name: str = ""
    title: str | None = None
    settings: Mapping[str, Any] = field(default_factory=dict)

    @property
    def is_empty(self) -> bool:
        """Whether nothing is known, so that the preset stays as it is."""
        return not any(is_given(getattr(self, f.name)) for f in fields(self))


@dataclass
class Changes:
    """Keys to replace, with the sentence that says where each figure comes from.

    Attributes
    ----------
    values : dict
        By dotted key.
    sources, assumptions : dict
        By dotted key.
    notes : list of str
        What a user has to know.
    """

    values: dict[str, Any] = field(default_factory=dict)
    sources: dict[str, str] = field(default_factory=dict)
    assumptions: dict[str, str] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)

    def known(self, key: str, value: Any, source: str = GIVEN) -> None:
        """Replace a key by a figure that is given or published, and check it: others may be computed from it."""
        if value is not None:
            check_number(key, value)
            self.values[key], self.sources[key] = value, source

    def assumed(self, key: str, value: Any, why: str) -> None:
        """Replace a key by a figure that is not known."""
        self.values[key], self.assumptions[key] = value, why
