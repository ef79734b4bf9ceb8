"""What a lossy codec does to means: weak contrasts vanish, dark noise settles at another level, noise outlives a frame.

None of it follows from the rig. Where the noise gives a codec away (:mod:`evanesce.prediction.noise_scale`), these join
the nuisances, and faint departures of their shape are given up.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from evanesce.criticism.problem import Fit, Problem
from evanesce.prediction.frozen import FROZEN
from evanesce.prediction.parameters import Parameter
from evanesce.prediction.views import View

Array = NDArray[Any]

DARK_DN = (3.0, 12.0)
"""Levels that noise can bring down to nothing, and that a codec's least step does."""

CLIPPED = 2.0

CHECKED = np.array([[1.0, -2.0, 1.0], [-2.0, 4.0, -2.0], [1.0, -2.0, 1.0]]) / 6.0
"""Second differences both ways, of unit variance for white noise: no smooth cause is seen by it."""


def codec_parameters(
    views: Sequence[View], level: Array, share: float = 1.0, bias: Array | None = None
) -> tuple[Parameter, ...]:
    """Return a codec's nuisances.

    Parameters
    ----------
    views : sequence of View
    level : ndarray (views, rows, cols)
        Predicted [DN].
    share : float
        Of what these shapes may amount to: less where a codec's changes are known from frames sent through one.
    bias : ndarray (views, rows, cols), optional
        Those known changes [DN], which may be off by a share (:func:`_off`).
    """
    known = FROZEN.nuisances
    darkest, dark = (np.exp(-level / scale) for scale in DARK_DN)
    soft = np.stack([ndimage.laplace(one, mode="nearest") for one in level])
    part = np.where(level > DARK_DN[1], level, 0.0) / 100.0
    every = tuple(range(len(views)))
    groups = {
        "lit": tuple(k for k in every if views[k].touches),
        "dark": tuple(k for k in every if not views[k].touches and not views[k].is_card),
        "card": tuple(k for k in every if views[k].is_card),
    }
    found = []
    for name, members in groups.items():
        for kind, shape, deviation, unit in (
            ("darkest", darkest, share * known["codec_dark_DN"], "DN"),
            ("dark", dark, share * known["codec_dark_DN"], "DN"),
            ("soft", soft, share * known["codec_soft"], "bin^2"),
            ("share", part, share * known["codec_share_DN"], "DN"),
        ):
            found.append(_shape(f"@codec_{kind}[{name}]", shape, members, deviation, unit))
    if bias is not None:
        found += _off(views, bias, groups, share)
    return tuple(p for p in found if p.template is not None and np.any(p.template))


def _off(views: Sequence[View], bias: Array, groups: Mapping[str, Sequence[int]], share: float) -> list[Parameter]:
    """Return the nuisances of changes that are known but for a share.

    Dark shots are known worse, and each kind by itself: a codec leaves next to nothing of them but one level, and that
    hangs on what was filmed before. A tenth of a step between two such levels would be light that leaks in.
    """
    found = []
    for name, members in groups.items():
        known = max(share, FROZEN.nuisances["codec_known_dark"]) if name == "dark" else share
        parts = {name: list(members)}
        if name == "dark":
            parts = {kind: [k for k in members if views[k].kind == kind] for kind in {views[k].kind for k in members}}
        for part, mine in sorted(parts.items()):
            found.append(_shape(f"@codec_bias[{part}]", bias, mine, known, "1"))
    return found


def _shape(name: str, shape: Array, members: Sequence[int], deviation: float, unit: str) -> Parameter:
    """Return a linear nuisance of some views by its shape (views, rows, cols)."""
    template = np.zeros_like(shape)
    template[list(members)] = shape[list(members)]
    return Parameter(
        name=name,
        unit=unit,
        deviation=deviation,
        step=deviation,
        views=tuple(members),
        linear=True,
        template=template,
    )


def codec_variance(level: Array) -> Array:
    """Return the variance [DN^2] of what a codec does to edges beside that: a share of the step within a bin."""
    steps = np.stack([np.hypot(*np.gradient(one)) for one in level])
    return np.asarray((FROZEN.nuisances["codec_edge"] * steps) ** 2 + FROZEN.noise["codec_floor_DN"] ** 2)


def noise_by_bins(problem: Problem, fitted: Fit) -> tuple[Array, Array]:
    """Return by how much the variance of each view exceeds what it is believed to be, at least 1: two of (views,).

    From second differences between neighbouring bins: their size, and the number of views that share them. What a
    codec once made of a place it hands on for as long as little changes there, so that many views are no more than one.
    """
    cube = problem.unwhitened(fitted.residual)
    found, of_all = np.ones(len(problem.predictor.views)), np.ones(len(problem.predictor.views))
    rough = {}
    for k, view in enumerate(problem.views):
        inner = ndimage.binary_erosion(problem.valid[view], np.ones((3, 3)))
        second = np.where(inner, ndimage.convolve(cube[k], CHECKED), np.nan)
        if inner.sum() > 50:
            found[view] = max(1.0, float(np.nanmean(second**2)))
            rough[view] = second
    pressed = [v for v in problem.views if problem.predictor.views[v].touches]
    for members in (pressed, [v for v in problem.views if v not in pressed]):
        alike = shared([rough[v] for v in members if v in rough])
        for view in members:
            of_all[view] = 1.0 + (len(members) - 1) * alike
    # Views that were kept from the fit are as loud as the others of their kind.
    for view in set(range(len(found))) - set(problem.views):
        found[view] = float(np.mean(found[pressed])) if pressed else 1.0
        of_all[view] = float(np.mean(of_all[pressed])) if pressed else 1.0
    return found, of_all


def shared(fields: Sequence[Array]) -> float:
    """Return the mean correlation between fields (rows, cols), at least 0; NaN where they are not known.

    Values beyond ``CLIPPED`` standard deviations count as so many: a few bright marks are no codec.
    """
    clipped = []
    for one in fields:
        size = 1.4826 * float(np.nanmedian(np.abs(one - np.nanmedian(one)))) or 1.0
        clipped.append(np.clip(one / size, -CLIPPED, CLIPPED))
    found = []
    for k, one in enumerate(clipped):
        for other in clipped[:k]:
            known = np.isfinite(one) & np.isfinite(other)
            # What is the same in every bin is like nothing.
            if known.sum() > 50 and np.ptp(one[known]) > 0 and np.ptp(other[known]) > 0:
                found.append(float(np.corrcoef(one[known], other[known])[0, 1]))
    return max(0.0, float(np.mean(found))) if found else 0.0
