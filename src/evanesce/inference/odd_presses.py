"""Presses that contradict each other, whatever the rig: forces of other frames, mirrored frames, other units.

No model takes part but that a contact grows with its force and stays where it is: what breaks that is a mistake of the
tables, which a fit would spread over all its figures.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from evanesce.inference.patch import Patch
from evanesce.prediction.views import View

SMALLER = 0.8
"""Area over that at a smaller force, below which the two contradict: silicone that is unloaded keeps less than that."""
JUMP = 0.25
"""Of the contact's radius, from one force to the next, beyond which a contact has not stayed where it was."""


def odd_presses(views: Sequence[View], patches: Sequence[Patch]) -> list[str]:
    """Return in words which presses contradict each other.

    Parameters
    ----------
    views : sequence of View
        Open presses.
    patches : sequence of Patch
        Contact of each.
    """
    said = []
    for session in sorted({view.session for view in views}):
        own = [(v, p) for v, p in zip(views, patches, strict=True) if v.session == session]
        for volts in sorted({view.voltage_V for view, _ in own}):
            ordered = sorted((one for one in own if one[0].voltage_V == volts), key=lambda one: one[0].force_N or 0.0)
            said += [*_shrinking(ordered), *_jumping(ordered)]
    return said


def _shrinking(ordered: Sequence[tuple[View, Patch]]) -> list[str]:
    """Return the two presses whose areas contradict their forces most."""
    worst, found = SMALLER, ""
    for k, (view, patch) in enumerate(ordered):
        for other, larger in ordered[:k]:
            ratio = patch.area_mm2 / larger.area_mm2
            if ratio < worst and _name(view) != _name(other):
                worst = ratio
                found = (
                    f"the contact at {_name(view)} ({patch.area_mm2:.3g} mm^2) is smaller than that at {_name(other)}"
                    f" ({larger.area_mm2:.3g} mm^2): is each frame noted with its own force?"
                )
    return [found] if found else []


def _jumping(ordered: Sequence[tuple[View, Patch]]) -> list[str]:
    """Return the two neighbouring forces between which the contact moves farthest."""
    worst, found = JUMP, ""
    for (view, patch), (after, larger) in pairwise(ordered):
        moved = float(np.hypot(*np.subtract(larger.centre_mm, patch.centre_mm)))
        share = moved / np.sqrt(max(patch.area_mm2, larger.area_mm2) / np.pi)
        if share > worst:
            worst = share
            found = (
                f"the contact jumps by {moved:.3g} mm between {_name(view)} and {_name(after)}: are some frames"
                " mirrored, or was the finger set anew (then another session)?"
            )
    return [found] if found else []


def _name(view: View) -> str:
    return f"{view.force_N:g} N"
