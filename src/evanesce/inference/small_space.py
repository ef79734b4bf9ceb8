"""Inner products of everything that a judgement weighs, computed once: after that nothing is as large as the data."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

Array = NDArray[Any]

CHUNK = 16_384
"""Bins at a time: sums of squares of loud rows need double precision, the rows themselves do not."""


class SmallSpace:
    """Named blocks of whitened rows, and some data vectors, by their inner products.

    Parameters
    ----------
    blocks : mapping of str to ndarray (k, bins)
    vectors : ndarray (n, bins)
    """

    def __init__(self, blocks: Mapping[str, Array], vectors: Array) -> None:
        sizes = [len(block) for block in blocks.values()]
        ends = np.cumsum(sizes)
        self.places = {name: slice(int(e) - n, int(e)) for name, e, n in zip(blocks, ends, sizes, strict=True)}
        total = int(ends[-1])
        self.gram = np.zeros((total, total))
        self.along = np.zeros((len(vectors), total))
        for start in range(0, vectors.shape[1], CHUNK):
            part = slice(start, start + CHUNK)
            rows = np.concatenate([block[:, part] for block in blocks.values()]).astype(float)
            self.gram += rows @ rows.T
            self.along += vectors[:, part] @ rows.T

    def of(self, names: Sequence[str]) -> NDArray[np.int_]:
        """Return the places of the rows of some blocks, one after the other."""
        return np.concatenate([np.arange(self.places[n].start, self.places[n].stop) for n in names]).astype(int)

    def marginalised(self, marginal: Sequence[str], kept: Sequence[str], vector: int) -> tuple[Array, Array]:
        """Return inner products of blocks once others, with standard normal weights, are marginalised.

        Parameters
        ----------
        marginal : sequence of str
            Blocks whose rows, each times an independent standard normal number, are in the data.
        kept : sequence of str
        vector : int
            Number of the data vector.

        Returns
        -------
        gram : ndarray (k, k)
            Of the kept rows in the metric (1 + M'M)^-1, M the marginal rows.
        along : ndarray (k,)
            Of the kept rows with the vector.
        """
        out, own = self.of(marginal), self.of(kept)
        factor = linalg.cho_factor(np.eye(len(out)) + self.gram[np.ix_(out, out)], lower=True)
        cross = self.gram[np.ix_(out, own)]
        gram = self.gram[np.ix_(own, own)] - cross.T @ linalg.cho_solve(factor, cross)
        along = self.along[vector, own] - linalg.cho_solve(factor, self.along[vector, out]) @ cross
        return np.asarray((gram + gram.T) / 2), np.asarray(along)
