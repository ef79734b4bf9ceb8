"""Checkerboards drawn without the package: supersampled squares through a known warp, with the corners' true places."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Warp:
    """Picture -> board: radial polynomial about a centre, then an affine map with perspective."""

    centre: tuple[float, float]
    radius: float
    q1: float
    q2: float
    matrix: Array  # 3 x 3, pixels (after the polynomial) -> squares

    def to_board(self, points: Array) -> Array:
        offset = (points - self.centre) / self.radius
        r2 = (offset**2).sum(axis=-1, keepdims=True)
        straight = offset * (1 + r2 * (self.q1 + r2 * self.q2)) * self.radius + self.centre
        mapped = straight @ self.matrix[:, :2].T + self.matrix[:, 2]
        return mapped[..., :2] / mapped[..., 2:]

    def to_image(self, board: Array) -> Array:
        """Newton with differences; the map is smooth and starts from its inverse at the centre."""
        guess = np.tile(np.array(self.centre), (len(board), 1))
        for _ in range(60):
            error = self.to_board(guess) - board
            steps = 1e-4 * np.eye(2)
            columns = [(self.to_board(guess + d) - self.to_board(guess - d)) / 2e-4 for d in steps]
            move = np.linalg.solve(np.stack(columns, axis=-1), error[..., None])[..., 0]
            guess = guess - np.clip(move, -0.3 * self.radius, 0.3 * self.radius)
        assert np.abs(self.to_board(guess) - board).max() < 1e-8
        return guess


def warp(
    shape: tuple[int, int], pitch: float, rotation_deg: float, *, barrel: float = 0.0, keystone: float = 0.0
) -> Warp:
    """A board turned, off-centre and slightly sheared, its distortion centre not the middle of the frame."""
    rows, cols = shape
    centre = (0.48 * cols, 0.53 * rows)
    angle = np.deg2rad(rotation_deg)
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]]) @ [[1.0, 0.02], [0.0, 0.97]]
    linear = turn / pitch
    matrix = np.eye(3)
    matrix[:2, :2] = linear
    matrix[:2, 2] = -linear @ centre + [0.37, -0.21]
    matrix[2, :2] = keystone / np.array([cols, -1.7 * rows])
    matrix[2, 2] = 1 - matrix[2, :2] @ centre
    return Warp(centre, np.hypot(rows, cols) / 2, barrel, 0.4 * barrel**2, matrix)


def draw(
    shape: tuple[int, int],
    mapping: Warp,
    rng: np.random.Generator,
    *,
    blur: float = 1.0,
    corner_blur: float = 0.0,
    noise: float = 1.5,
    board: tuple[int, int, int, int] | None = None,
    specks: int = 0,
    dark: float = 20.0,
    bright: float = 130.0,
) -> NDArray[np.uint8]:
    """An 8-bit picture: squares, light falling off to one side, blur (growing to the corners), specks, noise.

    ``board`` bounds the squares (i0, i1, j0, j1); outside is white paper.
    """
    rows, cols = shape
    ways = 4
    fine = (np.arange(ways) + 0.5) / ways - 0.5
    picture = np.zeros(shape)
    y, x = np.mgrid[0:rows, 0:cols].astype(float)
    for dy in fine:
        for dx in fine:
            i, j = np.moveaxis(mapping.to_board(np.stack([x + dx, y + dy], axis=-1)), -1, 0)
            white = (np.floor(i) + np.floor(j)) % 2 == 0
            if board is not None:
                white |= (i < board[0]) | (i > board[1]) | (j < board[2]) | (j > board[3])
            picture += white / ways**2
    light = 1 + 0.25 * (x / cols - 0.5) + 0.3 * (y / rows - 0.4) ** 2
    value = (dark + (bright - dark) * picture) * light
    sharp = gaussian_filter(value, blur)
    if corner_blur:
        share = np.clip(((x - cols / 2) ** 2 + (y - rows / 2) ** 2) / ((cols**2 + rows**2) / 4), 0, 1)
        sharp = (1 - share) * sharp + share * gaussian_filter(value, corner_blur)
    for _ in range(specks):
        sharp[rng.integers(rows), rng.integers(cols)] += rng.uniform(40, 200)
    return np.clip(np.rint(sharp + rng.normal(0, noise, shape)), 0, 255).astype(np.uint8)


def corners_inside(
    shape: tuple[int, int], mapping: Warp, margin: float, board: tuple[int, int, int, int] | None = None
) -> tuple[NDArray[np.int64], Array]:
    """Index and place of every corner at least ``margin`` px inside the frame (and inside the board)."""
    rows, cols = shape
    border = np.array(
        [[x, y] for x in np.linspace(0, cols - 1, 50) for y in (0, rows - 1)]
        + [[x, y] for x in (0, cols - 1) for y in np.linspace(0, rows - 1, 50)]
    )
    reach = mapping.to_board(border.astype(float))
    low, high = np.floor(reach.min(axis=0)), np.ceil(reach.max(axis=0))
    if board is not None:  # the outermost lines have white on one side: no checkerboard corner there
        low, high = np.maximum(low, [board[0] + 1, board[2] + 1]), np.minimum(high, [board[1] - 1, board[3] - 1])
    index = np.array([(i, j) for i in np.arange(low[0], high[0] + 1) for j in np.arange(low[1], high[1] + 1)])
    place = mapping.to_image(index)
    inside = ((place >= margin) & (place <= np.array([cols - 1, rows - 1]) - margin)).all(axis=1)
    return index[inside].astype(np.int64), place[inside]
