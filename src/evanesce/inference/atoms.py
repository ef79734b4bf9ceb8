"""Atoms of localised defects: points, discs, lines and soft blobs, as their images and as kernels of filters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from evanesce.inference.causes import Cause

Array = NDArray[Any]

DISCS_PX = (0.0, 1.5, 3.0)
"""Radii of round atoms: a point, and shadows of grains above the sensor."""
LINES_PX = (24.0, 48.0, 96.0)
"""Lengths an octave apart: the nearest holds at least 0.7 of a scratch's length and 0.84 of its signal. Shorter ones
are points."""
DIRECTIONS = 24
"""Of lines: neighbours of the longest are 12 pixels apart at their ends, half as far as lengths differ."""
BLOBS_PX = (6.0, 12.0, 24.0)
"""Standard deviations of soft blobs: up to what smooth causes vary over."""
BLOB_REACH = 3.0
"""Smooth misfit of a blob varies over more than so many of its radii."""
LEAST_WIDTH = 5.0
"""Pixels to which a Gaussian's standard deviation may be brought by larger pixels: they change it by a hundredth."""
HALF_WIDTH_PX = 3
"""Of a point's footprint: what lies nearer belongs to the same defect."""

Kind = Literal["point", "line", "blob"]


@dataclass(frozen=True, eq=False)
class Atom:
    """A form of defect.

    Attributes
    ----------
    kind : {"point", "line", "blob"}
    size_px : float
        Radius of a disc, length of a line, standard deviation of a blob.
    angle : float
        Of a line, from +column towards +row [rad].
    causes : mapping of str to str
        Causes that look like it -> the effect whose behaviour each has.
    kernels : mapping of str to ndarray
        By behaviour: kernel of a point (rows, cols), or profile across a line (n,); sum 1. Empty for blobs.
    """

    kind: Kind
    size_px: float
    angle: float
    causes: Mapping[str, str]
    kernels: Mapping[str, Array]

    @property
    def area(self) -> float:
        """Pixels over which it can be moved without being another one."""
        return self.size_px * HALF_WIDTH_PX if self.kind == "line" else max(1.0, self.size_px) ** 2

    def image(self, row: float, col: float, shape: tuple[int, int], kind: str) -> Array:
        """Return its image (rows, cols), sum 1, seen by the behaviour of an effect."""
        blank = np.zeros(shape, np.float32)
        y, x = round(row), round(col)
        if self.kind == "line":
            count = 2 * round(self.size_px)
            along = (np.arange(count) + 0.5) / count * self.size_px - self.size_px / 2
            rows, cols = np.rint(row + along * np.sin(self.angle)), np.rint(col + along * np.cos(self.angle))
            inside = (rows >= 0) & (rows < shape[0]) & (cols >= 0) & (cols < shape[1])
            np.add.at(blank, (rows[inside].astype(int), cols[inside].astype(int)), 1.0 / count)
            profile = next(iter(self.kernels.values())).astype(np.float32)
            return np.asarray(cv2.sepFilter2D(blank, -1, profile, profile, borderType=cv2.BORDER_CONSTANT))
        if 0 <= y < shape[0] and 0 <= x < shape[1]:
            blank[y, x] = 1.0
        if self.kind == "blob":
            return np.asarray(cv2.GaussianBlur(blank, (0, 0), self.size_px, borderType=cv2.BORDER_CONSTANT))
        kernel = self.kernels.get(kind, next(iter(self.kernels.values()))).astype(np.float32)
        return np.asarray(cv2.filter2D(blank, -1, kernel[::-1, ::-1], borderType=cv2.BORDER_CONSTANT))

    def wide(self, least: float) -> float:
        """Return over how many pixels smooth misfit varies at least."""
        return BLOB_REACH * self.size_px if self.kind == "blob" else least

    def footprint(self, row: float, col: float, shape: tuple[int, int]) -> NDArray[np.bool_]:
        """Return the pixels that belong to it (rows, cols)."""
        y, x = np.ogrid[: shape[0], : shape[1]]
        if self.kind == "line":
            along = (x - col) * np.cos(self.angle) + (y - row) * np.sin(self.angle)
            across = -(x - col) * np.sin(self.angle) + (y - row) * np.cos(self.angle)
            return np.asarray((np.abs(along) <= self.size_px / 2 + 2) & (np.abs(across) <= HALF_WIDTH_PX))
        reach = 2.0 * self.size_px + HALF_WIDTH_PX
        return np.asarray((x - col) ** 2 + (y - row) ** 2 <= reach**2)


def disc_offsets(radius: float) -> Array:
    """Return points (n, 2) that stand for a disc: hexagonal rings about its middle, a pixel apart or less."""
    count = int(np.ceil(radius))
    found = [np.zeros((1, 2))]
    for ring in range(1, count + 1):
        angles = np.arange(6 * ring) * np.pi / (3 * ring)
        # Equal areas for all points: rings lie in the middle of theirs.
        found.append(radius * ring / (count + 0.5) * np.array([np.sin(angles), np.cos(angles)]).T)
    return np.concatenate(found)


def atoms_of(causes: Sequence[Cause], spread: Mapping[str, Array]) -> list[Atom]:
    """Return all atoms of some causes.

    Parameters
    ----------
    causes : sequence of Cause
    spread : mapping of str to ndarray (rows, cols)
        Image of a point by the effect whose behaviour it has, sum 1.
    """
    points = {c.id: c.id for c in causes if c.candidate.effect.marks is not None and c.id in spread}
    lines = {c.id: c.candidate.effect.line.like for c in causes if c.candidate.effect.line is not None}
    blobs = {c.id: c.candidate.effect.blot.like for c in causes if c.candidate.effect.blot is not None}
    found = [Atom("point", r, 0.0, points, {n: _disc(spread[n], r) for n in points}) for r in DISCS_PX if points]
    lines = {name: like for name, like in lines.items() if like in spread}
    if lines:
        across = {like: spread[like].sum(axis=1) for like in lines.values()}
        turns = np.arange(DIRECTIONS) * np.pi / DIRECTIONS
        found += [Atom("line", length, float(a), lines, across) for length in LINES_PX for a in turns]
    blobs = {name: like for name, like in blobs.items() if like in spread}
    return found + [Atom("blob", size, 0.0, blobs, {}) for size in BLOBS_PX if blobs]


def _disc(spread: Array, radius: float) -> Array:
    reach = int(np.ceil(radius))
    wide = np.pad(spread, reach).astype(np.float32)
    rows, cols = wide.shape
    total = np.zeros_like(wide)
    offsets = disc_offsets(radius)
    for down, right in offsets:
        total += cv2.warpAffine(wide, np.array([[1.0, 0.0, right], [0.0, 1.0, down]]), (cols, rows))
    return np.asarray(total / len(offsets))


def smoothed(image: Array, weight: Array, size: float) -> Array:
    """Return an image (rows, cols) averaged with weights over a Gaussian of a standard deviation [px]."""
    # A wide average needs no fine pixels.
    step = max(1, int(size / LEAST_WIDTH))
    rows, cols = image.shape
    small = (max(cols // step, 1), max(rows // step, 1))
    parts = []
    for part in (weight, weight * image):
        coarse = cv2.resize(part, small, interpolation=cv2.INTER_AREA) if step > 1 else part
        wide = cv2.GaussianBlur(coarse, (0, 0), size * small[0] / cols, borderType=cv2.BORDER_REFLECT)
        parts.append(cv2.resize(wide, (cols, rows), interpolation=cv2.INTER_LINEAR) if step > 1 else wide)
    below, above = parts
    return np.asarray(above / np.maximum(below, 1e-12 * float(weight.max()) + 1e-30))
