"""Discrepancy: what the model's forms may be off by, as low-rank covariance tied to the causes and the nominal light.

Kennedy and O'Hagan (2001) add a Gaussian process to a model's prediction. Here it is a product: each taken cause's own
change, or the nominal light, times a smooth random function over the frame (cosines of low frequency) and a random
factor for each view. What a strong cause leaves because its form is some per cent off is then covered by the
discrepancy, and asks for no further causes.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.core.errors import InputError
from evanesce.inference.constants import EXTRAPOLATED, OWN_LIGHT, TIED_SHARE, WAVES
from evanesce.inference.data import DataVector
from evanesce.inference.joint_fit import JointFit
from evanesce.inference.model import AnchoredModel
from evanesce.prediction.linear import CovarianceRows
from evanesce.prediction.views import binned

Array = NDArray[Any]
FormRows = Callable[[DataVector, Array, float], CovarianceRows]

MOST_SHARE = 0.2
"""A change that the coarse model has wrong by more than this is no measure of what the fine one has wrong."""


def cosines(shape: tuple[int, int], count: int) -> Array:
    """Return products of cosines (count^2, rows, cols), each of unit mean square, the constant first."""
    waves = []
    for size in shape:
        at = (np.arange(size) + 0.5) / size
        own = np.array([np.cos(np.pi * k * at) for k in range(count)])
        waves.append(own / np.sqrt(np.mean(own**2, axis=1, keepdims=True)))
    return np.einsum("ar,bc->abrc", *waves).reshape(-1, *shape)


def tied_rows(data: DataVector, change: Array, share: float, *, by_view: bool = True) -> CovarianceRows:
    """Return the rows of a change's discrepancy: their outer products add up to its covariance.

    Parameters
    ----------
    data : DataVector
    change : ndarray (views, rows, cols)
        [DN].
    share : float
        Standard deviation of the factor at each place, over all rows together.
    by_view : bool
        Whether the factor varies from view to view as well.
    """
    whitened = data.over_noise(np.nan_to_num(change))
    basis = cosines(change.shape[1:], WAVES)
    valid = data.valid[list(data.open)]
    smooth = np.array([(whitened * wave)[valid] for wave in basis]) * share / np.sqrt((1 + by_view) * len(basis))
    return CovarianceRows(
        smooth.astype(np.float32), rows_by_view(data, change, share / np.sqrt(2.0)) if by_view else {}
    )


def rows_by_view(data: DataVector, change: Array, share: float) -> dict[int, Array]:
    """Return the rows (1, bins of a view) of a change that is off in each view by itself, by their first place.

    Parameters
    ----------
    data : DataVector
    change : ndarray (views, rows, cols)
        [DN].
    share : float
        Standard deviation of the factor in each view.
    """
    whitened, start, found = data.over_noise(np.nan_to_num(change)) * share, 0, {}
    for own, valid in zip(whitened, data.valid[list(data.open)], strict=True):
        row = own[valid].astype(np.float32)
        if row.any():
            found[start] = row[None]
        start += row.size
    return found


class Discrepancy:
    """Rows of the discrepancy of a joint fit; each cause's own change is evaluated once per fit.

    Parameters
    ----------
    model : AnchoredModel
    rows : callable
        ``rows(data, change (views, rows, cols), share)``: those of a cause's change.
    """

    def __init__(self, model: AnchoredModel, rows: FormRows | None = None) -> None:
        self.model, self.rows = model, rows or tied_rows
        self.shares: dict[str, float] = {}
        self._changes: tuple[JointFit, dict[str, Array]] | None = None

    def light(self, fitted: JointFit) -> CovarianceRows:
        """Return the rows of the nominal light; that of single views is a nuisance by itself."""
        return tied_rows(self.model.data, self.model.cube(fitted.point), OWN_LIGHT, by_view=False)

    def tied(self, fitted: JointFit, fine: Array | None = None) -> dict[str, CovarianceRows]:
        """Return the rows of each cause by its name; at "" that of what extrapolation to finer pixels added.

        Parameters
        ----------
        fitted : JointFit
        fine : ndarray (views, rows, cols), optional
            Its fine prediction, where the shares are to be measured anew: by how much fine and coarse models differ
            about each cause's change.
        """
        data = self.model.data
        extrapolated = data.whitened(self.model.discretisation)[None] * EXTRAPOLATED
        found = {"": CovarianceRows(np.asarray(extrapolated, np.float32))}
        changes = self.changes(fitted)
        for taken in fitted.taken:
            if taken.id not in changes:
                continue
            change = changes[taken.id]
            if fine is not None and not taken.cause.costly:
                try:
                    self.shares[taken.id] = self._share(fine, fitted.without(taken.id), change)
                except InputError:
                    continue
            found[taken.id] = self.rows(data, change, self.shares.get(taken.id, TIED_SHARE))
        return found

    def changes(self, fitted: JointFit) -> dict[str, Array]:
        """Return what each cause changes (views, rows, cols) [DN], by its name; without those that a rig cannot lack.

        Parameters
        ----------
        fitted : JointFit
        """
        if self._changes is None or self._changes[0] is not fitted:
            whole = self.model.cube(fitted.point)
            cubes = self.model.cubes([fitted.without(taken.id) for taken in fitted.taken])
            pairs = zip(fitted.taken, cubes, strict=True)
            self._changes = fitted, {t.id: whole - cube for t, cube in pairs if not isinstance(cube, InputError)}
        return self._changes[1]

    def sizes(self, fitted: JointFit) -> dict[str, float]:
        """Return the norm of what each cause changes, by its name [standard deviations]."""
        data = self.model.data
        return {n: float(np.linalg.norm(data.whitened(np.nan_to_num(c)))) for n, c in self.changes(fitted).items()}

    def every_row(self, fitted: JointFit, fine: Array | None = None) -> CovarianceRows:
        """Return all rows."""
        return CovarianceRows.joined(self.light(fitted), *self.tied(fitted, fine).values())

    def _share(self, fine: Array, without: Mapping[str, float], change: Array) -> float:
        """Return the relative difference of a cause's change between the fine and the coarse model."""
        opened = list(self.model.data.open)
        opened = [k for k in opened if not self.model.data.views[k].is_card]
        there = binned(self.model.frames(without, opened)) + self.model.codec_bias[opened]
        off = fine[opened] - there - change[opened]
        size = np.sqrt(np.nanmean(off**2) / max(float(np.nanmean(change[opened] ** 2)), 1e-12))
        return float(np.clip(size, TIED_SHARE, MOST_SHARE))
