"""A lab's own rig, measured: presses of a ball on an acrylic plate, drawn with NumPy and OpenCV alone.

Nothing here comes from the package: Snell's law, Brown's formula, Hertz's radius and BT.709 are written out. The plate
is 8 mm thick, the ball silicone of 10 mm radius, the camera has 400 x 300 pixels, all unlike the thesis's rig.
"""

from __future__ import annotations

import csv
from pathlib import Path

import cv2
import numpy as np

from support.drawn_lab import bt709, on_plate

WIDTH, HEIGHT, PITCH_UM, FOCAL_MM = 400, 300, 9.0, 8.0
FOCAL_PX = FOCAL_MM * 1e3 / PITCH_UM
CLEAR_MM, THICKNESS_MM, INDEX = 64.0, 8.0, 1.49
K1 = -0.12
RADIUS_MM, MODULUS_MPA, POISSON = 10.0, 0.345, 0.49
"""Of the ball; a lab would say 0.3 MPa from a Shore hardness."""
MIDDLE_MM = (0.45, -0.3)
SQUARE_MM, BOARD = 1.5, (15, 11)
FORCES_N = np.round(np.linspace(0.4, 4.0, 20), 3)
CONTACT, GROUND, AMBIENT = 0.42, 0.012, 0.006
"""Linear light of the contact in the middle of the plate, beside it, and of the room, over full scale."""
FALL_MM = 30.0
"""Length on which light decays from the lit edges."""
BLUR_PX, ELECTRONS, READ_E = 0.9, 9000.0, 6.0
BLACK = 0.004
FINER = 4


def exposed(light: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return an 8-bit frame of linear light on fine pixels: lens, vignetting, noise, tone curve."""
    mean = light.reshape(HEIGHT, FINER, WIDTH, FINER).mean(axis=(1, 3))
    mean = cv2.GaussianBlur(mean, (0, 0), BLUR_PX)
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    angle = np.arctan(np.hypot(x - (WIDTH - 1) / 2, y - (HEIGHT - 1) / 2) / FOCAL_PX)
    mean = mean * np.cos(angle) ** 4
    electrons = rng.poisson(ELECTRONS * mean) + rng.normal(0.0, READ_E, mean.shape)
    return np.clip(np.rint(255.0 * bt709(electrons / ELECTRONS + BLACK)), 0, 255).astype(np.uint8)


def contact_radius(force_N: float) -> float:
    """Return Hertz's radius [mm]."""
    reduced = MODULUS_MPA / (1.0 - POISSON**2)
    return float(np.cbrt(0.75 * force_N * RADIUS_MM / reduced))


def press(x: np.ndarray, y: np.ndarray, force_N: float, rng: np.random.Generator) -> np.ndarray:
    """Return a press: light from the left and right edges, frustrated where the ball touches."""
    inside = np.hypot(x - MIDDLE_MM[0], y - MIDDLE_MM[1]) < contact_radius(force_N)
    light = CONTACT * np.cosh(x / FALL_MM)
    return exposed(np.where(inside, light, GROUND * np.cosh(x / FALL_MM)) + AMBIENT, rng)


def board(x: np.ndarray, y: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return the board on the glass, black at the upper left, in even light of the room."""
    a, b = x * np.cos(0.02) + y * np.sin(0.02) + 0.1, y * np.cos(0.02) - x * np.sin(0.02) - 0.15
    col, row = np.floor(a / SQUARE_MM + BOARD[0] / 2), np.floor(b / SQUARE_MM + BOARD[1] / 2)
    printed = (col >= 0) & (col < BOARD[0]) & (row >= 0) & (row < BOARD[1])
    return exposed(np.where(printed & ((col + row) % 2 == 0), 0.03, 0.55), rng)


def measure(folder: Path, seed: int = 5) -> None:
    """Write a bundle's frames and tables, all but its scene: twenty presses, two frames of each dark, one board."""
    rng = np.random.default_rng(seed)
    x, y = on_plate((HEIGHT, WIDTH), FINER, FOCAL_PX, K1, CLEAR_MM, THICKNESS_MM, INDEX)
    for name in ("press", "lens_cap", "led_off", "checkerboard"):
        (folder / name).mkdir(parents=True)
    for k, force in enumerate(FORCES_N):
        cv2.imwrite(str(folder / "press" / f"{k:04d}.png"), press(x, y, float(force), rng))
    for k in range(2):
        cv2.imwrite(str(folder / "lens_cap" / f"{k}.png"), exposed(np.zeros(x.shape), rng))
        cv2.imwrite(str(folder / "led_off" / f"{k}.png"), exposed(np.full(x.shape, AMBIENT), rng))
    cv2.imwrite(str(folder / "checkerboard" / "0.png"), board(x, y, rng))
    with (folder / "press.csv").open("w", newline="") as stream:
        rows = csv.writer(stream)
        rows.writerow(["index", "time_s", "force_N"])
        rows.writerows((k, f"{2.0 * k:.1f}", f"{force:g}") for k, force in enumerate(FORCES_N))
    (folder / "measurement.toml").write_text('scene = "scene.toml"\ntitle = "A ball on acrylic"\n')
