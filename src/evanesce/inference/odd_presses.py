"""Presses that contradict each other, whatever the rig: forces of other frames, mirrored frames, other units.

No model takes part but that a contact grows with its force and stays where it is: what breaks that is a mistake of the
tables, which a fit would spread over all its figures.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from evanesce.inference.patch import Patch
from evanesce.prediction.views import View

SMALLER = 0.8
"""Area over that at a smaller force, below which the two contradict: a choice, beyond what unloading adds (assumed)."""
JUMP = 0.25
"""Of the contact's radius, from one force to the next, beyond which a contact has not stayed: a choice."""


def odd_presses(views: Sequence[View], patches: Sequence[Patch]) -> list[str]:
    """Return in words which presses contradict each other.

    Parameters
    ----------
    views : sequence of View
        Presses.
    patches : sequence of Patch
        Contact of each.
    """
    said = []
    states: dict[tuple[int, float, int], list[tuple[View, Patch]]] = {}
    for view, patch in zip(views, patches, strict=True):
        states.setdefault((view.session, view.voltage_V, view.condition), []).append((view, patch))
    for group in sorted({key[:2] for key in states}):
        presses = [_press(held) for key, held in states.items() if key[:2] == group]
        ordered = sorted(presses, key=lambda press: press.force_N)
        said += [*_shrinking(ordered), *_jumping(ordered)]
    return said


@dataclass(frozen=True)
class _Press:
    """The frames of one held force: medians, as a slide moves and a hold creeps."""

    force_N: float
    area_mm2: float
    centre_mm: tuple[float, float]

    def __str__(self) -> str:
        return f"{self.force_N:g} N"


def _press(held: Sequence[tuple[View, Patch]]) -> _Press:
    x, y = np.median([patch.centre_mm for _, patch in held], axis=0)
    area = float(np.median([patch.area_mm2 for _, patch in held]))
    return _Press(float(held[0][0].force_N or 0.0), area, (float(x), float(y)))


def _shrinking(ordered: Sequence[_Press]) -> list[str]:
    """Return the two presses whose areas contradict their forces most."""
    pairs = [(press, other) for k, press in enumerate(ordered) for other in ordered[:k]]
    press, other = min(pairs, key=lambda pair: pair[0].area_mm2 / pair[1].area_mm2, default=(None, None))
    if press is None or other is None or press.area_mm2 >= SMALLER * other.area_mm2:
        return []
    return [
        f"the contact at {press} ({press.area_mm2:.3g} mm^2) is smaller than that at {other}"
        f" ({other.area_mm2:.3g} mm^2): is each frame noted with its own force?"
    ]


def _jumping(ordered: Sequence[_Press]) -> list[str]:
    """Return the two neighbouring forces between which the contact moves farthest."""
    worst, found = JUMP, ""
    for press, after in pairwise(ordered):
        moved = float(np.hypot(*np.subtract(after.centre_mm, press.centre_mm)))
        share = moved / np.sqrt(max(press.area_mm2, after.area_mm2) / np.pi)
        if share > worst:
            worst = share
            found = (
                f"the contact jumps by {moved:.3g} mm between {press} and {after}: are some frames mirrored, or was the"
                " finger set anew (then another session)?"
            )
    return [found] if found else []
