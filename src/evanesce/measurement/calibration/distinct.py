"""Views of a board that did not move: repeated pictures count once."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial import KDTree

from evanesce.measurement.calibration.points import BoardView
from evanesce.measurement.warnings import Warning

STILL_PX = 0.1
"""RMS difference of corners below which two views show the same scene: more than noise moves those of a still board."""


def distinct_views(views: Sequence[BoardView]) -> tuple[list[BoardView], list[Warning]]:
    """Return one of each set of views that show the same scene, and a warning that names the sets.

    Parameters
    ----------
    views : sequence of BoardView

    Returns
    -------
    distinct : list of BoardView
    warnings : list of Warning
    """
    groups: list[list[BoardView]] = []
    worst = 0.0
    for view in views:
        for group in groups:
            difference = _still(group[0], view)
            if difference < STILL_PX:
                group.append(view)
                worst = max(worst, difference)
                break
        else:
            groups.append([view])
    if len(groups) == len(views):
        return [group[0] for group in groups], []
    repeated = [group for group in groups if len(group) > 1]
    sets = "; ".join(_listed([v.name for v in group]) for group in repeated)
    text = (
        f"{len(views)} views are {len(groups)}: the corners of views {sets} differ by at most {worst:.2g} px RMS "
        f"(limit {STILL_PX} px), so repeated pictures of a board that did not move count once"
    )
    return [group[0] for group in groups], [Warning("identical_views", text)]


def _listed(names: list[str]) -> str:
    return ", ".join(names if len(names) <= 4 else [*names[:2], "...", names[-1]])


def _still(one: BoardView, other: BoardView) -> float:
    """Return the RMS distance [px] of the corners two views share; infinite unless nine in ten coincide to 1 px."""
    distance, _ = KDTree(one.image).query(other.image, distance_upper_bound=1.0)
    near = distance[np.isfinite(distance)]
    if len(near) < 0.9 * max(len(one), len(other)):
        return float("inf")
    return float(np.sqrt((near**2).mean()))
