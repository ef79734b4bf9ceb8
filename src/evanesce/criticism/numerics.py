"""What the critic's own computation leaves undecided, as directions that every fit may use and no cause may claim.

A discretised edge of contact is coherent over all bins and frames, so that a variance could not stand for it: what
finer pixels change (:mod:`evanesce.prediction.fine`) is put right, and a share of it stays a nuisance with an amplitude
of its own. So is the place of the edge to half a micrometre, where a film too thin to be resolved couples light.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from evanesce.contact.solve import contact_state
from evanesce.core.errors import InputError
from evanesce.prediction.frozen import FROZEN
from evanesce.prediction.parameters import Parameter
from evanesce.prediction.views import View
from evanesce.rig import Scene

Array = NDArray[Any]

RESOLUTION, EDGE = "@resolution", "@edge"
"""Names of the nuisances."""


def leftover_variance(change: Array) -> Array:
    """Return the variance [DN^2] of what a change of resolution leaves beside its own direction."""
    return np.asarray((FROZEN.nuisances["fine_left"] * ndimage.maximum_filter(np.abs(change), size=(1, 3, 3))) ** 2)


def quick_variance(level: Array) -> Array:
    """Return the variance [DN^2] of a prediction that no finer pixels have put right: a share of the step within a bin.

    Parameters
    ----------
    level : ndarray (views, rows, cols)
        Predicted [DN].
    """
    steps = np.stack([np.hypot(*np.gradient(one)) for one in level])
    return np.asarray((FROZEN.nuisances["quick"] * steps) ** 2)


def numerics_parameters(
    views: Sequence[View], change: Array, edge: Array, *, silent: bool = False
) -> tuple[Parameter, ...]:
    """Return the nuisances of computation.

    Parameters
    ----------
    views : sequence of View
    change : ndarray (views, rows, cols)
        What finer pixels change [DN].
    edge : ndarray (views, rows, cols)
        :func:`edge_template`.
    silent : bool
        Whether frames came through a codec that left no noise: it moves an edge by more than computation does.
    """
    known = FROZEN.nuisances
    found = []
    groups: dict[str, list[int]] = {}
    for k, view in enumerate(views):
        groups.setdefault(view.kind if view.is_card else "contact" if view.touches else "", []).append(k)
    for name, members in groups.items():
        if name:
            template = np.zeros_like(change)
            template[members] = change[members]
            found.append(_template(f"{RESOLUTION}[{name}]", "1", known["resolution"], template, members))
    if "contact" in groups:
        found.append(_template(EDGE, "mm", known["codec_edge_mm" if silent else "edge_mm"], edge, groups["contact"]))
    return tuple(p for p in found if p.template is not None and np.any(p.template))


def is_numerics(parameter: Parameter) -> bool:
    """Tell whether a nuisance stands for computation."""
    return parameter.name.startswith((RESOLUTION, EDGE))


def _template(name: str, unit: str, deviation: float, template: Array, views: Sequence[int]) -> Parameter:
    return Parameter(
        name=name, unit=unit, deviation=deviation, step=deviation, views=tuple(views), linear=True, template=template
    )


def edge_template(scene: Scene, views: Sequence[View], by_force: Sequence[Array | None]) -> Array:
    """Return the derivative by the edge's place (views, rows, cols) [DN/mm], from that by the force's logarithm.

    Parameters
    ----------
    scene : Scene
    views : sequence of View
    by_force : sequence of ndarray (rows, cols), optional
        Derivative by the logarithm of the force, None where nothing touches.
    """
    shape = next((b.shape for b in by_force if b is not None), (1, 1))
    found = np.zeros((len(views), *shape))
    for k, (view, by) in enumerate(zip(views, by_force, strict=True)):
        if by is not None and view.force_N is not None:
            found[k] = by * _log_force_per_mm(scene, view.force_N)
    return found


def _log_force_per_mm(scene: Scene, force_N: float, step: float = 0.05) -> float:
    """Return by how much the logarithm of the force has to rise for 1 mm of mean contact radius; 0 without contact."""
    try:
        radii = [np.sqrt(contact_state(scene, force_N * np.exp(s)).nominal_contact_area / np.pi) for s in (-step, step)]
    except InputError:
        return 0.0
    grown = float(radii[1] - radii[0])
    return 2 * step / grown if grown > 0 else 0.0
