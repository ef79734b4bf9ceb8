"""Inner products of everything that a judgement weighs, computed once: after that nothing is as large as the data."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import linalg

Array = NDArray[Any]

MOST = 6e4
"""Of a row, which half precision can hold: where nothing scatters a bin is no better known than that."""
CHUNK = 16_384
"""Bins at a time: products of rows of a thousand standard deviations, which are nearly alike, need double precision,
the rows themselves do not."""


def products(left: Array, right: Array) -> Array:
    """Return inner products (n, m) of rows (n, bins) and (m, bins) in double precision."""
    total = np.zeros((len(left), len(right)))
    for start in range(0, left.shape[1], CHUNK):
        part = slice(start, start + CHUNK)
        one = left[:, part].astype(float)
        # NumPy makes half of a product with an array's own transpose, which is symmetric.
        total += one @ (one if right is left else right[:, part].astype(float)).T
    return total


class SmallSpace:
    """Named blocks of whitened rows, and some data vectors, by their inner products.

    Parameters
    ----------
    blocks : mapping of str to ndarray (k, bins)
    vectors : ndarray (n, bins)
        May be none.
    coarse : bool
        Whether to keep the rows in half precision: forms are known worse than to a thousandth, and there are hundreds.
    """

    def __init__(self, blocks: Mapping[str, Array], vectors: Array, *, coarse: bool = False) -> None:
        self.places = _places(blocks, 0)
        count = sum(len(block) for block in blocks.values())
        self.rows = np.empty((count, vectors.shape[1]), np.float16 if coarse else np.float32)
        for name, place in self.places.items():
            self.rows[place] = np.clip(blocks[name], -MOST, MOST)
        self.gram = products(self.rows, self.rows)
        self.along = products(vectors, self.rows)

    def joined(self, blocks: Mapping[str, Array], vectors: Array) -> SmallSpace:
        """Return a space with further blocks, and other vectors; what is known of the present blocks is not made anew.

        Nothing can be joined to what is returned.

        A block whose name is there already has its rows added to it.
        """
        more = SmallSpace(blocks, vectors)
        both = SmallSpace.__new__(SmallSpace)
        cross = products(self.rows, more.rows)
        both.rows = more.rows  # the others stay where they are: hundreds of megabytes
        both.gram = np.block([[self.gram, cross], [cross.T, more.gram]])
        both.along = np.concatenate([products(vectors, self.rows), more.along], axis=1)
        both.places = dict(self.places)
        for name, own in _places(blocks, len(self.rows)).items():
            both.places[name] = np.concatenate([both.places.get(name, np.zeros(0, int)), own])
        return both

    def scale(self, names: Sequence[str], factor: float) -> None:
        """Multiply the rows of some blocks, in place."""
        own = self.of(names)
        self.rows[own] = np.clip(self.rows[own].astype(np.float32) * factor, -MOST, MOST)
        each = np.ones(len(self.gram))
        each[own] = factor
        self.gram *= np.outer(each, each)
        self.along *= each

    def of(self, names: Sequence[str]) -> NDArray[np.int_]:
        """Return the places of the rows of some blocks, one after the other."""
        return np.concatenate([np.zeros(0, int), *(self.places[n] for n in names)])

    def combined(self, factors: Array, names: Sequence[str]) -> Array:
        """Return sums (n, bins) of the rows of some blocks, times factors (n, rows)."""
        own = self.of(names)
        parts = [
            factors.astype(np.float32) @ self.rows[own, start : start + CHUNK].astype(np.float32)
            for start in range(0, self.rows.shape[1], CHUNK)
        ]
        return np.concatenate(parts, axis=1)

    def marginalised(
        self, marginal: Mapping[str, float | Array], kept: Sequence[str], vector: int | None
    ) -> tuple[Array, Array]:
        """Return inner products of blocks once others are marginalised.

        Parameters
        ----------
        marginal : mapping of str to float or ndarray
            Blocks whose rows, each times an independent normal number of the given standard deviation, are in the data.
        kept : sequence of str
        vector : int, optional
            Number of the data vector; None: data that are nothing.

        Returns
        -------
        gram : ndarray (k, k)
            Of the kept rows in the metric (1 + M'M)^-1, M the marginal rows.
        along : ndarray (k,)
            Of the kept rows with the vector.
        """
        out, own = self.of(list(marginal)), self.of(kept)
        size = np.concatenate([np.broadcast_to(s, len(self.places[n])) for n, s in marginal.items()])
        inner = np.eye(len(out)) + size[:, None] * self.gram[np.ix_(out, out)] * size
        factor = linalg.cho_factor(inner, lower=True)
        cross = size[:, None] * self.gram[np.ix_(out, own)]
        gram = self.gram[np.ix_(own, own)] - cross.T @ linalg.cho_solve(factor, cross)
        data = np.zeros(self.gram.shape[0]) if vector is None else self.along[vector]
        along = data[own] - linalg.cho_solve(factor, size * data[out]) @ cross
        return np.asarray((gram + gram.T) / 2), np.asarray(along)

    def log_bayes(self, marginal: Mapping[str, float | Array], name: str, vector: int) -> float:
        """Return the log Bayes factor of a block, of unit amplitudes, over none of it [nats].

        Parameters
        ----------
        marginal : mapping of str to float
            As for :meth:`marginalised`.
        name : str
        vector : int
        """
        gram, along = self.marginalised(marginal, [name], vector)
        inner = np.eye(len(gram)) + gram
        return float(0.5 * along @ np.linalg.solve(inner, along) - 0.5 * np.linalg.slogdet(inner)[1])


def _places(blocks: Mapping[str, Array], first: int) -> dict[str, NDArray[np.int_]]:
    found, start = {}, first
    for name, block in blocks.items():
        found[name] = np.arange(start, start + len(block))
        start += len(block)
    return found
