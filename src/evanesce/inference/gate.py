"""First look: is it the same rig at all? Board, field of view, contact and level, measured beside predicted.

A finger of another size, another calibration target, another lens are no causes of the library; whatever the joint fit
would name for them would be wrong. They are compared before anything is fitted, on figures read from the frames alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.bundle.board import board_of, other_card
from evanesce.core.errors import EvanesceError
from evanesce.inference.card_start import board_inverted, card_start
from evanesce.inference.constants import GROSS_AREA, GROSS_AXES, GROSS_FIELD
from evanesce.inference.odd_presses import odd_presses
from evanesce.inference.patch import Patch, PlateReader
from evanesce.measurement.calibration.corners import CornerGrid, find_corners
from evanesce.prediction.observe import Observation
from evanesce.prediction.predict import Predictor
from evanesce.prediction.views import View

Array = NDArray[Any]

VERSION = 1
"""Of the answer's form."""
CORNERS = "checkerboard with corner squares (0 white, 1 black: set card.checkerboard_inverted)"
AREA, AXES, LEVEL = "contact area", "ratio of the contact's axes", "level of the contact"
DARK = {"lens_cap": "level with the lens covered", "led_off": "level without LEDs"}


@dataclass(frozen=True)
class Line:
    """One figure, measured and predicted.

    Attributes
    ----------
    name, unit : str
    measured, predicted : float
    gross : bool
        Whether no plausible amount of any cause makes the difference.
    """

    name: str
    unit: str
    measured: float
    predicted: float
    gross: bool

    def as_dict(self) -> dict[str, Any]:
        """Return it in the answer's form."""
        return {
            "name": self.name, "unit": self.unit, "measured": self.measured, "predicted": self.predicted,
            "gross": self.gross,
        }  # fmt: skip


@dataclass(frozen=True)
class Gate:
    """The comparison.

    Attributes
    ----------
    lines : tuple of Line
    start : dict of str to float
        Where the finger and the cards really are and how bright the room is, for the fit to start from.
    """

    lines: tuple[Line, ...]
    start: dict[str, float]
    light: float = 1.0
    """Of the contact, measured over predicted [1]."""
    odd: tuple[str, ...] = ()
    """Presses that contradict each other, see :mod:`evanesce.inference.odd_presses`."""

    @property
    def gross(self) -> tuple[Line, ...]:
        """What is grossly different."""
        return tuple(line for line in self.lines if line.gross)

    def sentence(self) -> str:
        """Return one line that names what is grossly different; empty if nothing is."""
        if not self.gross:
            return ""
        words = [
            f"{x.name} {x.measured:.3g} instead of {x.predicted:.3g} {x.unit}".strip()
            for x in self.gross
            if x.name not in (AREA, AXES)
        ]
        known = {x.name: x for x in self.lines}
        if AREA in known and (known[AREA].gross or known[AXES].gross):
            area, axes = known[AREA], known[AXES]
            words.insert(
                0,
                f"your contact is {area.measured:.3g} mm^2 and {_form(axes.measured)}, the scene's"
                f" {area.predicted:.3g} and {_form(axes.predicted)}",
            )
        return "not the rig of the scene: " + "; ".join(words)


def _form(axes: float) -> str:
    return "round" if axes < np.sqrt(GROSS_AXES) else f"elliptic ({axes:.2f} : 1)"


class GrossDifference(EvanesceError):
    """The measured rig is another one than the scene's (exit code 1).

    Parameters
    ----------
    gate : Gate
    """

    exit_code = 1

    def __init__(self, gate: Gate) -> None:
        self.gate = gate
        super().__init__(gate.sentence())

    def as_dict(self) -> dict[str, Any]:
        """Return it in the answer's form."""
        return {
            "version": VERSION,
            "method": "joint",
            "first_line": str(self),
            "gate": [x.as_dict() for x in self.gate.lines],
            "causes": [],
        }


def gate_of(observation: Observation, coarse: Predictor) -> Gate:
    """Compare the frames with what the nominal model predicts.

    Parameters
    ----------
    observation : Observation
    coarse : Predictor
        Of the nominal model.

    Returns
    -------
    Gate
    """
    scene, views = observation.scene, observation.views
    plate = PlateReader(scene)
    pairs, numbers = [], []
    for k in _press_views(views):
        measured, predicted = plate.patch(observation.images[k]), plate.patch(coarse.image({}, k))
        if measured is not None and predicted is not None:
            pairs.append((measured, predicted))
            numbers.append(k)
    lines, start, light = _contact_lines(pairs)
    lines += _missing_contact(observation, plate, coarse)
    lines += _board_lines(observation, coarse) + _dark_lines(observation, coarse)
    if board_inverted(observation):
        believed = float(scene.card.checkerboard_inverted)
        lines.append(Line(CORNERS, "", 1.0 - believed, believed, gross=True))
    poses = {
        f"@pose_{axis}[{session}]": start[axis]
        for session in sorted({views[k].session for k in numbers})
        for axis in "xy"
        if axis in start
    }
    bright = {"@light": float(np.log(light))}
    odd = _odd(observation, plate)
    return Gate(tuple(lines), poses | bright | card_start(observation, coarse), light, tuple(odd))


def _odd(observation: Observation, plate: PlateReader) -> list[str]:
    """Return which presses contradict each other, those kept for the judgement too: nothing is chosen by it."""
    presses = [k for k, v in enumerate(observation.views) if v.kind == "press" and v.force_N]
    read = [(observation.views[k], plate.patch(observation.images[k])) for k in presses]
    shown = [(view, patch) for view, patch in read if patch is not None]
    return odd_presses([view for view, _ in shown], [patch for _, patch in shown])


def _press_views(views: Sequence[View]) -> list[int]:
    """Return the numbers of the open press views, the largest forces first, at most six of unlike states."""
    seen: dict[tuple[float, float], int] = {}
    for k, view in enumerate(views):
        if view.kind == "press" and not view.locked and view.force_N:
            seen.setdefault((view.force_N, view.voltage_V), k)
    return [k for _, k in sorted(seen.items(), reverse=True)][:6]


def _contact_lines(pairs: Sequence[tuple[Patch, Patch]]) -> tuple[list[Line], dict[str, float], float]:
    """Return lines, where the finger really is, and its light over the predicted one."""
    if not pairs:
        return [], {}, 1.0

    def both(of: Any) -> tuple[float, float]:
        """Return a figure of the largest force, measured and predicted."""
        return float(of(pairs[0][0])), float(of(pairs[0][1]))

    ratio = float(np.exp(np.median([np.log(m.area_mm2 / p.area_mm2) for m, p in pairs])))
    axes = float(np.median([m.axes / p.axes for m, p in pairs]))
    level = float(np.median([m.level_DN / p.level_DN for m, p in pairs]))
    lines = [
        Line(AREA, "mm^2", *both(lambda q: q.area_mm2), gross=_beyond(ratio, GROSS_AREA)),
        Line(AXES, "", *both(lambda q: q.axes), gross=axes > GROSS_AXES),
        Line(
            LEVEL,
            "DN",
            *both(lambda q: q.level_DN),
            gross=False,
        ),
    ]
    moved = {axis: float(np.median([m.centre_mm[i] - p.centre_mm[i] for m, p in pairs])) for i, axis in enumerate("xy")}
    return lines, moved, level


def _beyond(ratio: float, limit: float) -> bool:
    """Return whether a ratio lies beyond a limit or below its inverse."""
    return bool(abs(np.log(ratio)) > np.log(limit))


def _missing_contact(observation: Observation, plate: PlateReader, coarse: Predictor) -> list[Line]:
    """Return a line where the model shows a contact and no frame does."""
    numbers = _press_views(observation.views)
    if not numbers:
        return []
    seen = [plate.patch(observation.images[k]) is not None for k in numbers]
    expected = [plate.patch(coarse.image({}, k)) is not None for k in numbers]
    if any(seen) or not any(expected):
        return []
    return [Line("frames that show a contact", "", 0.0, float(sum(expected)), gross=True)]


def _dark_lines(observation: Observation, coarse: Predictor) -> list[Line]:
    """Return the mean levels of frames without LEDs."""
    lines = []
    for kind, name in DARK.items():
        place = next((k for k, v in enumerate(observation.views) if v.kind == kind), None)
        if place is not None:
            measured, predicted = np.mean(observation.images[place]), np.mean(coarse.image({}, place))
            lines.append(Line(name, "DN", float(measured), float(predicted), gross=False))
    return lines


def _board_lines(observation: Observation, coarse: Predictor) -> list[Line]:
    """Return the pitch of the checkerboard's corners in pixels, and the field of view it means."""
    place = next((k for k, v in enumerate(observation.views) if v.kind == "checkerboard"), None)
    if place is None:
        return []
    card = observation.scene.card
    side = card.checkerboard_side_mm
    cols = observation.scene.camera.resolution_px[0]
    grids = [_corners(image) for image in (observation.images[place], coarse.image({}, place))]
    if grids[0] is None or grids[1] is None:
        return []
    measured, predicted = (float(np.median(np.linalg.norm(grid.lattice, axis=1))) for grid in grids if grid is not None)
    gross = _beyond(measured / predicted, 1.0 + GROSS_FIELD)
    board = board_of(grids[0], observation.images[place].shape, "", side)
    counts = zip(("longer", "shorter"), board.corners, sorted(card.checkerboard_squares, reverse=True), strict=True)
    other = other_card([board], card) is not None
    return [
        Line("pitch of the checkerboard", "px", measured, predicted, gross=False),
        Line("field of view", "mm", cols * side / measured, cols * side / predicted, gross=gross),
        *(
            Line(f"squares on the checkerboard's {which} side", "", seen + 1.0, float(believed), gross=other)
            for which, seen, believed in counts
        ),
    ]


def _corners(image: Array) -> CornerGrid | None:
    """Return the checkerboard's corners; None where no board is found."""
    whole = np.clip(np.round(image), 0, 255).astype(np.uint8)
    try:
        return find_corners(whole)
    except EvanesceError:
        return None
