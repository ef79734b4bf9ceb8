"""Checkerboards as a lab photographs them, drawn with NumPy and OpenCV's blur and JPEG alone: a pinhole with two radial
terms, a board of so many squares in the air, white or black paper around it, glare, a finger over it, blur, noise.

Integer coordinates are pixel centres. Nothing of the package is used.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Lens:
    size: tuple[int, int]  # cols, rows
    fx: float
    fy: float
    cx: float
    cy: float
    k1: float
    k2: float

    def project(self, points: Array) -> Array:
        """Camera coordinates (..., 3) to pixels."""
        x, y = points[..., 0] / points[..., 2], points[..., 1] / points[..., 2]
        r2 = x * x + y * y
        radial = 1 + r2 * (self.k1 + r2 * self.k2)
        return np.stack([self.fx * x * radial + self.cx, self.fy * y * radial + self.cy], axis=-1)

    def rays(self) -> tuple[Array, Array]:
        """Undistorted (x/z, y/z) of every pixel, by Newton's rule for the radius."""
        v, u = np.indices((self.size[1], self.size[0])).astype(float)
        xd, yd = (u - self.cx) / self.fx, (v - self.cy) / self.fy
        far = np.hypot(xd, yd)
        r = far.copy()
        for _ in range(12):
            r2 = r * r
            slope = 1 + r2 * (3 * self.k1 + 5 * self.k2 * r2)
            r = np.maximum(r - (r * (1 + r2 * (self.k1 + r2 * self.k2)) - far) / np.maximum(slope, 0.1), 0)
        scale = np.where(far > 0, r / np.maximum(far, 1e-12), 1.0)
        return xd * scale, yd * scale


@dataclass(frozen=True)
class Board:
    nx: int  # squares
    ny: int
    side: float  # mm

    def corners(self) -> Array:
        """Inner corners (n, 2) [mm] from the middle of the board."""
        i, j = np.meshgrid(np.arange(1, self.nx), np.arange(1, self.ny), indexing="ij")
        return self.side * np.stack([i.ravel() - self.nx / 2, j.ravel() - self.ny / 2], axis=-1)

    def outline(self) -> Array:
        w, h = self.nx * self.side / 2, self.ny * self.side / 2
        t = np.linspace(-1, 1, 9)
        one = np.ones_like(t)
        return np.concatenate([np.stack([w * a, h * b], -1) for a, b in ((t, one), (t, -one), (one, t), (-one, t))])


@dataclass(frozen=True)
class Pose:
    rotation: Array
    shift: Array

    def place(self, board: Array) -> Array:
        return board @ self.rotation[:, :2].T + self.shift


@dataclass(frozen=True)
class Look:
    surround: float = 200.0
    dark: float = 30.0
    bright: float = 200.0
    blur: float = 0.9
    noise: float = 2.0
    glare: float = 0.0  # grey levels at its middle
    glare_at: tuple[float, float] = (0.5, 0.5)  # share of the frame
    finger: bool = False  # over the first corner of the board
    jpeg: int | None = 90


def lens_of(rng: np.random.Generator, size: tuple[int, int] = (640, 480), **given: float) -> Lens:
    """A made-up camera of that size."""
    cols, rows = size
    fx = cols * rng.uniform(0.85, 1.3)
    values = {
        "fx": fx, "fy": fx * rng.uniform(0.998, 1.002), "cx": (cols - 1) / 2 + cols * rng.uniform(-0.02, 0.02),
        "cy": (rows - 1) / 2 + rows * rng.uniform(-0.02, 0.02), "k1": rng.uniform(-0.25, 0.08),
        "k2": rng.uniform(-0.04, 0.08),
    }  # fmt: skip
    return Lens(size, **(values | given))


def pose_of(rng: np.random.Generator, lens: Lens, board: Board, tilt: float = 0.35) -> Pose:
    """A pose in which the whole board is in sight and fills half to nine tenths of the frame's width or height."""
    cols, rows = lens.size
    while True:
        axis = np.array([*rng.uniform(-tilt, tilt, 2), rng.uniform(-0.25, 0.25)])
        rotation = cv2.Rodrigues(axis)[0]
        fill = rng.uniform(0.55, 0.9)
        far = max(board.nx * board.side * lens.fx / cols, board.ny * board.side * lens.fy / rows) / fill
        shift = np.array([*(far * rng.uniform(-0.12, 0.12, 2)), far])
        pose = Pose(rotation, shift)
        edge = lens.project(pose.place(board.outline()))
        if (edge > 8).all() and (edge < [cols - 9, rows - 9]).all():
            return pose


def draw(lens: Lens, board: Board, pose: Pose, look: Look, rng: np.random.Generator) -> NDArray[np.uint8]:
    """The 8-bit picture of a board."""

    def paint(x: Array, y: Array) -> Array:
        i, j = x / board.side + board.nx / 2, y / board.side + board.ny / 2
        inside = (i > 0) & (i < board.nx) & (j > 0) & (j < board.ny)
        square = np.where((np.floor(i) + np.floor(j)) % 2 == 0, look.dark, look.bright)
        return np.where(inside, square, look.surround)

    tip = board.side * np.array([[0.8 - board.nx / 2, 0.8 - board.ny / 2]])
    return _picture(lens, pose, paint, look, rng, lens.project(pose.place(tip))[0])


def draw_card(lens: Lens, side: float, pose: Pose, look: Look, rng: np.random.Generator) -> NDArray[np.uint8]:
    """The 8-bit picture of a white square of that side [mm] on black."""

    def paint(x: Array, y: Array) -> Array:
        return np.where((np.abs(x) < side / 2) & (np.abs(y) < side / 2), look.bright, look.dark)

    return _picture(lens, pose, paint, look, rng, None)


def _picture(
    lens: Lens, pose: Pose, paint: Callable[[Array, Array], Array], look: Look, rng: np.random.Generator,
    tip: Array | None,
) -> NDArray[np.uint8]:  # fmt: skip
    x, y = lens.rays()
    plane = np.column_stack([pose.rotation[:, 0], pose.rotation[:, 1], pose.shift])
    mapped = np.tensordot(np.linalg.inv(plane), np.stack([x, y, np.ones_like(x)]), 1)
    bx, by = mapped[0] / mapped[2], mapped[1] / mapped[2]
    (bx_v, bx_u), (by_v, by_u) = np.gradient(bx), np.gradient(by)
    light, ways = np.zeros(x.shape), 5
    fine = (np.arange(ways) + 0.5) / ways - 0.5
    for a in range(ways):  # sheared, so that an edge along the pixels meets 25 places, not 5
        for b in range(ways):
            du, dv = fine[a] + fine[b] / ways, fine[b] + fine[a] / ways
            light += paint(bx + bx_u * du + bx_v * dv, by + by_u * du + by_v * dv) / ways**2
    rows, cols = light.shape
    v, u = np.indices(light.shape)
    light = light * (1 + 0.15 * (u / cols - 0.5) - 0.1 * (v / rows - 0.5))
    if look.finger and tip is not None:
        near = np.hypot((u - tip[0]) / (0.16 * cols), (v - tip[1]) / (0.13 * rows))
        light = np.where(near < 1, 120 + 25 * np.cos(3 * near), light)
    light = cv2.GaussianBlur(light, (0, 0), look.blur)
    if look.glare:
        at = look.glare_at[0] * cols, look.glare_at[1] * rows
        light = light + look.glare * np.exp(-((u - at[0]) ** 2 + (v - at[1]) ** 2) / (2 * (0.06 * cols) ** 2))
    picture = np.clip(np.rint(light + rng.normal(0, look.noise, light.shape)), 0, 255).astype(np.uint8)
    if look.jpeg is None:
        return picture
    _, packed = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, look.jpeg])
    return np.asarray(cv2.imdecode(packed, cv2.IMREAD_GRAYSCALE))


def flat(distance: float, x: float = 0.0, y: float = 0.0, turn: float = 0.04) -> Pose:
    """Parallel to the sensor at that distance [mm]."""
    return Pose(cv2.Rodrigues(np.array([0.0, 0.0, turn]))[0], np.array([x, y, distance]))


def look_of(rng: np.random.Generator, **given: float) -> Look:
    """Light, blur and noise of one set: paper around it white, grey or black."""
    return replace(
        Look(
            surround=float(rng.choice([200.0, 110.0, 30.0])), dark=rng.uniform(20, 50), bright=rng.uniform(150, 220),
            blur=rng.uniform(0.6, 1.4), noise=rng.uniform(0.5, 4), jpeg=None if rng.random() < 0.3 else 90,
        ),
        **given,
    )  # fmt: skip


def view_look(look: Look, rng: np.random.Generator) -> Look:
    """One view of a set: three in ten with glare, three in ten with a finger over a corner of the board."""
    return replace(
        look, glare=float(rng.uniform(40, 250)) if rng.random() < 0.3 else 0.0,
        glare_at=(rng.uniform(0.2, 0.8), rng.uniform(0.2, 0.8)), finger=bool(rng.random() < 0.3),
        blur=look.blur * rng.uniform(0.9, 1.3),
    )  # fmt: skip
