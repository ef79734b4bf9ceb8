"""Scale of the board beside that of the square card: a wrong side of the printed squares shows there.

The card lies on the glass; a board may have been held in the air, where its scale is another. Which view lay on the
glass is known if it is stated, or if there is only one. Else the one whose scale changes least across it counts, as
for :meth:`evanesce.measurement.refined.plate.PlateMap.of`, which takes every area from it; a difference is then a
warning, as it may be the board's height, and an error only where no height explains it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from evanesce.core.errors import InputError
from evanesce.measurement.calibration.checks import jacobian
from evanesce.measurement.calibration.fit import Calibrated
from evanesce.measurement.calibration.points import BoardView
from evanesce.measurement.warnings import Warning

NO_VIEW = "none"

MAX_LENGTH = 0.02
"""Relative difference of the two scales, in length, beyond which one of the two sides is wrong."""

NOTED_LENGTH = 0.01
"""Relative difference, in length, beyond which a warning says so: 2 % in area."""

MAX_HELD = 1.5
"""Times the card's distance at which a board may be held: a camera focused on the glass blurs it beyond."""


def stated_view(views: Sequence[BoardView], on_glass: str | None) -> int | None:
    """Return the number of the view that is said to lie on the glass, from 1; 0 if none is, None if nothing is said.

    Parameters
    ----------
    views : sequence of BoardView
    on_glass : str or None
        Name of a view, or ``"none"``.

    Returns
    -------
    int or None

    Raises
    ------
    InputError
        If there is no such view.
    """
    if on_glass is None:
        return None
    if on_glass == NO_VIEW:
        return 0
    names = [view.name for view in views]
    if on_glass not in names:
        raise InputError(f"'{on_glass}' is no view", key="on_glass", allowed=f"none, or one of {', '.join(names)}")
    return names.index(on_glass) + 1


def compare_scales(
    result: Calibrated, mm2_per_px: float, side_mm: float, on_glass: int | None
) -> tuple[dict[str, Any], list[Warning]]:
    """Compare the scale of the board with that of the card.

    Parameters
    ----------
    result : Calibrated
    mm2_per_px : float
        Area of an undistorted pixel by the card [mm^2].
    side_mm : float
        Stated side of the card's square [mm].
    on_glass : int or None
        Of :func:`stated_view`.

    Returns
    -------
    figures : dict
        ``view``: name of the view that was compared; ``length_ratio``: board's over card's px/mm.
    warnings : list of Warning

    Raises
    ------
    InputError
        If the two contradict by more than 2 % in length and it is known that the board lay on the glass, or if no
        height of the board explains the difference.
    """
    if on_glass == 0:
        return {}, []
    view = result.distinct[result.flat]
    ratio = float(np.sqrt(abs(np.linalg.det(jacobian(result.fit, result.flat))) * mm2_per_px))
    figures = {"view": view.name, "length_ratio": ratio}
    off = abs(np.log(ratio))
    if off <= np.log1p(NOTED_LENGTH):
        return figures, []
    board_mm = float(np.median(np.diff(np.unique(view.world[:, 0]))))
    card = 1 / np.sqrt(mm2_per_px)
    text = (
        f"the board of view {view.name} has {ratio * card:.4g} px/mm, the {side_mm:g} mm card {card:.4g} px/mm "
        f"({100 * (ratio - 1):+.1f} %): likely --square-mm {_neat(board_mm * ratio)}, not {board_mm:g} "
        f"(or --side-mm {_neat(side_mm / ratio)}, not {side_mm:g})"
    )
    known = on_glass is not None or len(result.distinct) == 1
    if off > np.log1p(MAX_LENGTH) and (known or off > np.log(MAX_HELD)):
        other = f"--on-glass NAME or --on-glass none if {view.name} did not lie on it"
        allowed = f"within {100 * MAX_LENGTH:g} % of the card; {other}"
        raise InputError(text, key="checker_side_mm", allowed=allowed)
    if not known:
        text += "; or no board lay on the glass (--on-glass none) or another one (--on-glass NAME)"
    return figures, [Warning("board_and_card_at_odds", text)]


def _neat(value: float) -> str:
    """Return a length with two digits where that is within 2 %, else with three: 1.98 is 2, 2.36 stays."""
    short = f"{value:.1g}"
    for digits in (1, 2):
        short = f"{float(f'{value:.{digits}g}'):g}"
        if abs(float(short) / value - 1) <= MAX_LENGTH / 2:
            return short
    return f"{value:.3g}"
