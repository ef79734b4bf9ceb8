"""Questions of ``evanesce init``, and how their answers are read."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import typer

from evanesce.api.own_answers import FINGERS
from evanesce.core.errors import InputError
from evanesce.rig.catalogue import CAMERAS, MATERIALS, PACKAGES
from evanesce.rig.leds import SPECTRA


@dataclass(frozen=True)
class Asked:
    """What is known after the questions.

    Attributes
    ----------
    preset : str
    given : dict
        Arguments of :class:`evanesce.api.own_rig.RigAnswers`.
    pictures : list of Path
        Of the checkerboard.
    """

    preset: str
    given: dict[str, Any]
    pictures: list[Path]


def numbers(text: str | None, key: str, count: int | None, *, whole: bool = False) -> tuple[Any, ...] | None:
    """Return the numbers of a text such as 120x80 or 1,2,5; None for none.

    Parameters
    ----------
    text : str or None
    key : str
        Named in errors.
    count : int or None
        How many there have to be.
    whole : bool

    Raises
    ------
    InputError
    """
    if text is None:
        return None
    try:
        found = tuple(float(part) for part in re.split(r"[x×,;\s]+", text.strip()))
    except ValueError:
        found = ()
    good = found and all(math.isfinite(v) and (not whole or v == int(v)) for v in found)
    if not good or (count is not None and len(found) != count):
        kind = "whole numbers" if whole else "numbers"
        allowed = f"{count} {kind}, e.g. 120x80" if count is not None else f"{kind} with commas, e.g. 1,2,5"
        raise InputError(f"'{text}'", key=key, allowed=allowed)
    return tuple(int(v) for v in found) if whole else found


def words(text: str | None) -> tuple[str, ...] | None:
    """Return the words of a text such as left,right; None for none."""
    return None if text is None else tuple(part for part in re.split(r"[,;\s]+", text.strip()) if part)


def number(text: str) -> float:
    """Return a finite number.

    Raises
    ------
    InputError
    """
    found = numbers(text, "answer", 1)
    assert found is not None
    return float(found[0])


Reader = Callable[[str], Any]


@dataclass(frozen=True)
class OneOf:
    """Reads one of some names."""

    names: tuple[str, ...]

    def __call__(self, text: str) -> str:
        """Return the name.

        Raises
        ------
        InputError
        """
        if text.strip() not in self.names:
            raise InputError(f"'{text}'", key="answer", allowed=", ".join(self.names))
        return text.strip()


def one_of(*names: str) -> OneOf:
    """Return a reader of one of some names."""
    return OneOf(names)


QUESTIONS: tuple[tuple[str, str, Reader], ...] = (
    ("plate_size_mm", "plate, width x height [mm]", lambda t: numbers(t, "answer", 2)),
    ("thickness_mm", "plate, thickness [mm]", number),
    ("material", "plate", one_of(*MATERIALS)),
    ("index", "plate, refractive index if measured", number),
    ("absorption_per_mm", "plate, absorption if measured [1/mm]", number),
    ("spectrum", "LEDs", one_of(*SPECTRA)),
    ("led_pitch_mm", "LED to LED [mm]", number),
    ("package", "LED package", one_of(*PACKAGES)),
    ("edges", "lit edges, e.g. left,right,top,bottom", words),
    ("voltage_V", "supply of the LEDs [V]", number),
    ("camera", "camera", one_of(*CAMERAS)),
    ("resolution_px", "frames, width x height [px]", lambda t: numbers(t, "answer", 2, whole=True)),
    ("pixel_um", "pixel pitch [um]", number),
    ("focal_mm", "lens, focal length [mm]", number),
    ("f_number", "lens, f-number", number),
    ("field_mm", "width of the frame on the plate [mm]", number),
    ("finger", "finger", one_of(*FINGERS)),
    ("ridge_height_um", "ridges, from furrow to crest [um]", number),
    ("ridge_width_um", "ridges, width at half height [um]", number),
    ("ridge_pitch_um", "ridges, from crest to crest [um]", number),
    ("tip_radius_mm", "radius of the tip, or of a ball [mm]", number),
    ("modulus_MPa", "Young's modulus of the finger [MPa]", number),
    ("forces_N", "forces, e.g. 1,2,5 [N]", lambda t: numbers(t, "answer", None)),
)


def ask(preset: str, given: Mapping[str, Any]) -> Asked:
    """Ask for everything that is not given; an empty answer leaves the preset's.

    Parameters
    ----------
    preset : str
    given : mapping

    Returns
    -------
    Asked
    """
    from evanesce.api.own_rig import PRESETS, preset_heading

    typer.echo("An empty answer takes what the preset has.", err=True)
    while True:
        preset = str(_prompt(f"preset: {', '.join(PRESETS)}", default=preset))
        try:
            preset_heading(preset)
            break
        except InputError as error:
            typer.echo(str(error), err=True)
    found, pictures = dict(given), _pictures()
    while pictures and found["board_square_mm"] is None:
        found["board_square_mm"] = _answer("side of the board's squares [mm]", number)
    for name, question, read in QUESTIONS:
        beside = {
            "field_mm": ("scale_px_per_mm", "distance_mm"),
            "voltage_V": ("current_mA",),
            "modulus_MPa": ("silicone",),
        }
        if found[name] is not None or any(found[other] is not None for other in beside.get(name, ())):
            continue
        if pictures and name in ("field_mm", "resolution_px"):
            continue
        if name.startswith("ridge_") and found["finger"] != "ridged":
            continue
        more = f": {', '.join(read.names)}" if isinstance(read, OneOf) else ""
        found[name] = _answer(question + more, read)
    return Asked(preset, found, pictures)


def _pictures() -> list[Path]:
    while True:
        text = str(_prompt("pictures of the checkerboard on the glass: a file or folder", default=""))
        if not text or Path(text).exists():
            return [Path(text)] if text else []
        typer.echo(f"{text}: no such file or folder", err=True)


def _answer(question: str, read: Reader) -> Any:
    while True:
        text = str(_prompt(question, default=""))
        if not text.strip():
            return None
        try:
            return read(text)
        except InputError as error:
            typer.echo(str(error), err=True)


def _prompt(question: str, *, default: str) -> Any:
    return typer.prompt(question, default=default, show_default=bool(default), err=True)
