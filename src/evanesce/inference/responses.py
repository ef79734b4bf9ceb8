"""Matched filters of localised defects: maps over views summed along behaviours, responses to atoms, and peaks."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from evanesce.inference.atoms import DIRECTIONS, LINES_PX, Atom
from evanesce.inference.data import DataVector

Array = NDArray[Any]

TURNS = 7
"""Directions about the best one that are tried."""
LEAST_INFORMATION = 1e-3
"""Of the largest: elsewhere a defect shows too little to be sought."""
ROBUST = 1.4826
"""Standard deviation over median absolute deviation of normal numbers."""
GROUPS: Mapping[str, str] = {
    "press": "=contact", "replicate": "=contact", "led_off": "=dark", "lens_cap": "=dark",
    "checkerboard": "=card", "square": "=card",
}  # fmt: skip
"""Kinds of views in which what behaves like no cause has an amplitude of its own."""


@dataclass
class Maps:
    """Data and behaviours summed over views.

    Attributes
    ----------
    names : tuple of str
        Effects whose behaviours they are, then groups of views.
    product : ndarray of float32 (kinds, rows, cols)
        With the data.
    information : ndarray of float32 (kinds, kinds, rows, cols)
        Of each two.
    """

    names: tuple[str, ...]
    product: Array
    information: Array

    @classmethod
    def of(cls, behaviours: Mapping[str, Array], whitened: Array, weight: Array, data: DataVector) -> Maps:
        """Return the maps of whitened data (views, rows, cols) and weights, one over the noise."""
        groups = [GROUPS[data.views[k].kind] for k in data.open]
        rows = {name: behaviour * weight for name, behaviour in behaviours.items()}
        for group in dict.fromkeys(groups):
            rows[group] = weight * np.array([g == group for g in groups])[:, None, None]
        product = np.array([np.einsum("vrc,vrc->rc", row, whitened) for row in rows.values()], np.float32)
        pairs = [[np.einsum("vrc,vrc->rc", a, b) for b in rows.values()] for a in rows.values()]
        return cls(tuple(rows), product, np.array(pairs, np.float32))

    def noise(self, fields: Array) -> Array:
        """Return products (kinds, rows, cols) with noise, from one field of unit variance for each kind."""
        if not hasattr(self, "_root"):
            gram = np.moveaxis(self.information, (0, 1), (2, 3)).astype(float)
            size = np.sqrt(np.maximum(np.einsum("rckk->rck", gram), 1e-12))
            alike = gram / (size[..., :, None] * size[..., None, :])
            factor = np.linalg.cholesky(alike + 1e-4 * np.eye(len(self.names)))
            self._root = (size[..., None] * factor).astype(np.float32)
        return np.einsum("rckl,lrc->krc", self._root, fields)

    def own(self, kind: str) -> Array:
        """Return a kind's information with itself (rows, cols)."""
        k = self.names.index(kind)
        return np.asarray(self.information[k, k])


@dataclass(frozen=True, eq=False)
class Peak:
    """A local maximum of a response.

    Attributes
    ----------
    atom : Atom
    kind : str
        Whose response it is.
    row, col : float
        Of its middle [px].
    z : float
        Over the standard deviation.
    amounts : mapping of str to float
        By behaviour, in the unit of its effect's list.
    """

    atom: Atom
    kind: str
    row: float
    col: float
    z: float
    amounts: Mapping[str, float]


def _best_interval(product: Array, information: Array) -> tuple[float, int, int, float]:
    """Return the largest squared significance of an interval, its first and last + 1, and the amount per pixel."""
    above, below = (np.concatenate([[0.0], np.cumsum(part, dtype=float)]) for part in (product, information))
    total, size = above[None, :] - above[:, None], below[None, :] - below[:, None]
    # Shorter ones are points.
    first, last = np.indices(total.shape)
    allowed = (last - first >= LINES_PX[0] / 2) & (total > 0) & (size > 0)
    square = np.where(allowed, total**2 / np.where(size > 0, size, 1.0), 0.0)
    i, j = np.unravel_index(int(np.argmax(square)), square.shape)
    return float(square[i, j]), int(i), int(j), float(total[i, j] / size[i, j]) if square[i, j] > 0 else 0.0


def _top(values: Array, at: int) -> float:
    """Return where a parabola through three values has its top, from the middle one [px]."""
    if not 0 < at < len(values) - 1:
        return 0.0
    below, own, above = (float(v) for v in values[at - 1 : at + 2])
    bend = 2.0 * own - below - above
    return float(np.clip(0.5 * (above - below) / bend, -0.5, 0.5)) if bend > 0 else 0.0


class Responses:
    """Matched filters of maps.

    Parameters
    ----------
    maps : Maps
    atoms : sequence of Atom
    """

    def __init__(self, maps: Maps, atoms: Sequence[Atom]) -> None:
        self.maps, self.atoms = maps, list(atoms)
        rows, cols = maps.product.shape[1:]
        self.trials = float(sum(rows * cols / atom.area for atom in atoms)) * max(len(maps.names), 1)
        """Places and forms that could be told apart."""
        self._below: dict[tuple[Atom, str], Array] = {}
        self._scatter: dict[tuple[Atom, str], float] = {}
        for atom, kind in self._pairs():
            z = self._z(self.maps.product, atom, kind)
            seen = z[z != 0.0]
            spread = ROBUST * float(np.median(np.abs(seen))) if seen.size else 1.0
            self._scatter[atom, kind] = max(1.0, spread)

    def _pairs(self) -> Iterator[tuple[Atom, str]]:
        groups = [name for name in self.maps.names if name.startswith("=")]
        for atom in self.atoms:
            # What is no point and behaves like no cause is left to the unknown field.
            own = groups if atom.kind == "point" else []
            yield from ((atom, kind) for kind in [*dict.fromkeys(atom.causes.values()), *own])

    def largest(self, noise: Array | None = None) -> float:
        """Return the largest response to the data, or to products (kinds, rows, cols) with noise."""
        if noise is not None:
            return max(float(self._z(noise, atom, kind).max()) for atom, kind in self._pairs())
        own = self.maps.product
        return max(float(self._z(own, atom, kind).max()) / self._scatter[atom, kind] for atom, kind in self._pairs())

    def wrong_side(self, most: int) -> list[tuple[float, float, float]]:
        """Return size, row and column of the largest responses of the sign that no cause can make, of each atom.

        Parameters
        ----------
        most : int
            Of each atom and kind.
        """
        own, found = self.maps.product, []
        for atom, kind in self._pairs():
            if kind.startswith("="):
                continue
            z = -self._z(own, atom, kind) / self._scatter[atom, kind]
            high = np.argwhere((z > 0) & (z >= cv2.dilate(z, np.ones((5, 5), np.uint8))))
            sizes = z[high[:, 0], high[:, 1]]
            for k in np.argsort(-sizes)[:most]:
                found.append((float(sizes[k]), *self._turned_back(atom, float(high[k, 0]), float(high[k, 1]))))
        return found

    def peaks(self, least: float) -> list[Peak]:
        """Return the local maxima above a size."""
        found = []
        for atom, kind in self._pairs():
            z = self._z(self.maps.product, atom, kind) / self._scatter[atom, kind]
            high = np.argwhere((z > least) & (z >= cv2.dilate(z, np.ones((5, 5), np.uint8))))
            if not len(high):
                continue
            amounts = {like: self._amounts(atom, like) for like in dict.fromkeys(atom.causes.values())}
            for row, col in high:
                at = self._turned_back(atom, row + _top(z[:, col], row), col + _top(z[row], col))
                own = {like: float(amount[row, col]) for like, amount in amounts.items()}
                found.append(Peak(atom, kind, *at, float(z[row, col]), own))
        return found

    def refined(self, peak: Peak) -> Peak:
        """Return a line with the ends and direction that explain most; anything else as it is."""
        if peak.atom.kind != "line":
            return peak
        k, profile = self.maps.names.index(peak.kind), next(iter(peak.atom.kernels.values())).astype(np.float32)
        best: tuple[float, Peak] | None = None
        for turn in np.linspace(-0.5, 0.5, TURNS) * np.pi / DIRECTIONS:
            atom = replace(peak.atom, angle=peak.atom.angle + float(turn))
            affine, size = self._turn(atom)
            at = affine @ np.array([peak.col, peak.row, 1.0])
            along = [
                cv2.filter2D(cv2.warpAffine(image, affine, size), -1, power[:, None], borderType=cv2.BORDER_CONSTANT)
                for image, power in ((self.maps.product[k], profile), (self.maps.own(peak.kind), profile**2))
            ]
            for row in range(max(round(at[1]) - 2, 0), min(round(at[1]) + 3, size[1])):
                square, first, last, amount = _best_interval(along[0][row], along[1][row])
                if best is None or square > best[0]:
                    line = replace(atom, size_px=float(last - first))
                    middle = self._turned_back(line, float(row), 0.5 * (first + last - 1))
                    best = (
                        square,
                        replace(
                            peak, atom=line, row=middle[0], col=middle[1], amounts={peak.kind: amount * (last - first)}
                        ),
                    )
        assert best is not None
        return best[1]

    def _amounts(self, atom: Atom, kind: str) -> Array:
        above = self._filtered(self.maps.product[self.maps.names.index(kind)], atom, kind)
        below = self._information(atom, kind)
        return np.asarray(above / np.where(below > 0, below, np.inf))

    def hide(self, pixels: NDArray[np.bool_]) -> None:
        """Take pixels (rows, cols) out of the data."""
        self.maps.product[:, pixels] = 0.0
        self.maps.information[:, :, pixels] = 0.0
        self._below.clear()

    def _information(self, atom: Atom, kind: str) -> Array:
        if (atom, kind) not in self._below:
            self._below[atom, kind] = self._filtered(self.maps.own(kind), atom, kind, squared=True)
        return self._below[atom, kind]

    def _z(self, product: Array, atom: Atom, kind: str) -> Array:
        above = self._filtered(product[self.maps.names.index(kind)], atom, kind)
        below = self._information(atom, kind)
        seen = below > LEAST_INFORMATION * float(below.max()) + 1e-12
        z = np.where(seen, above / np.sqrt(np.where(seen, below, 1.0)), 0.0)
        # What behaves like no cause may be dark as well as bright.
        return np.asarray(np.abs(z) if kind.startswith("=") else z)

    def _filtered(self, image: Array, atom: Atom, kind: str, *, squared: bool = False) -> Array:
        power = 2 if squared else 1
        if atom.kind == "blob":
            # The square of a Gaussian of unit sum is one that is narrower by the root of 2, of sum 1 / (4 pi s^2).
            size = atom.size_px / np.sqrt(power)
            share = 1.0 / (4.0 * np.pi * atom.size_px**2) if squared else 1.0
            return np.asarray(share * cv2.GaussianBlur(image, (0, 0), size, borderType=cv2.BORDER_CONSTANT))
        kernel = atom.kernels.get(kind, next(iter(atom.kernels.values()))).astype(np.float32) ** power
        if atom.kind == "point":
            return np.asarray(cv2.filter2D(image, -1, kernel, borderType=cv2.BORDER_CONSTANT))
        turned = cv2.warpAffine(image, *self._turn(atom))
        along = np.ones(round(atom.size_px) // 2 * 2 + 1, np.float32)
        along /= along.size**power
        return np.asarray(cv2.sepFilter2D(turned, -1, along, kernel, borderType=cv2.BORDER_CONSTANT))

    def _turn(self, atom: Atom) -> tuple[Array, tuple[int, int]]:
        """Return the affine map that lays a line's direction along the columns, and the size of what it makes."""
        rows, cols = self.maps.product.shape[1:]
        c, s = np.cos(atom.angle), np.sin(atom.angle)
        width, height = int(np.ceil(cols * abs(c) + rows * abs(s))), int(np.ceil(cols * abs(s) + rows * abs(c)))
        turn = np.array([[c, s, 0.0], [-s, c, 0.0]])
        middle = turn[:, :2] @ np.array([(cols - 1) / 2, (rows - 1) / 2])
        turn[:, 2] = np.array([(width - 1) / 2, (height - 1) / 2]) - middle
        return turn, (width, height)

    def _turned_back(self, atom: Atom, row: float, col: float) -> tuple[float, float]:
        if atom.kind != "line":
            return row, col
        turn = self._turn(atom)[0]
        x, y = np.linalg.solve(turn[:, :2], np.array([col, row]) - turn[:, 2])
        return float(y), float(x)
