"""Hidden causes of lens, sensor and geometry, each in a form of its own."""

from __future__ import annotations

import numpy as np
from scipy import ndimage
from scipy.interpolate import PchipInterpolator

from .camera import Knee
from .hidden import Hidden
from .rig import FINER, View


def moved(fine: np.ndarray, du: np.ndarray, dv: np.ndarray) -> np.ndarray:
    """Return an image in which each pixel shows what was seen (du, dv) fine pixels before it, by cubic splines."""
    row, col = np.mgrid[: fine.shape[0], : fine.shape[1]].astype(float)
    return ndimage.map_coordinates(fine, [row - dv, col - du], order=3, mode="nearest")


class BlackLevel(Hidden):
    """The offset rises a little from the first row to the last (form 1: with the sensor's time as well)."""

    id, unit, start, limit, signs = "black_level", "DN", 1.0, 120.0, (1, -1)

    def draw(self) -> None:
        self.sign = float(self.rng.choice(self.signs))
        self.slope = 0.0 if self.plain else self.rng.uniform(0.0, 0.15)
        self.sign = 1.0 if self.plain else self.sign

    def offset_DN(self, view: View, a: float) -> np.ndarray:
        rows, cols = self.rig.shape
        row = np.linspace(-1, 1, rows)[:, None]
        return self.sign * a * (1 + self.slope * (row if self.form == 0 else row * row)) * np.ones((1, cols))

    def parameter(self, a: float) -> tuple[str, float]:
        return "offset_DN", self.sign * a * (1.0 + (0.0 if self.form == 0 else self.slope / 3.0))


class ToneCurve(Hidden):
    """A table: a few knots of the developed value pushed up or down, monotonic in between."""

    id, start, limit = "tone_curve", 0.01, 0.6

    def draw(self) -> None:
        count = 5 if self.form == 0 else 7
        self.at = np.linspace(0, 1, count + 2)
        bow = np.sin(np.pi * self.at) if self.rng.random() < 0.5 else np.sin(2 * np.pi * self.at)
        self.push = bow * self.rng.choice((-1, 1)) * (1 + 0.15 * self.rng.standard_normal(count + 2))
        self.push[[0, -1]] = 0.0

    def curve(self, curve: np.ndarray, a: float) -> np.ndarray:
        knots = np.maximum.accumulate(np.clip(self.at + 0.25 * a * self.push, 0, 1))
        return np.clip(PchipInterpolator(self.at, knots + 1e-9 * self.at)(curve), 0, 1)


class Vignetting(Hidden):
    """A round mask away from the stop: the share of the pupil that it leaves free, as two circles' common area."""

    id, start, limit = "vignetting", 0.35, 1.6

    def draw(self) -> None:
        self.ratio = self.rng.uniform(1.05, 1.3) if self.form == 0 else self.rng.uniform(0.92, 1.0)
        self.centre = self.rng.uniform(-0.08, 0.08, 2)
        if self.plain:
            angle, self.ratio = self.rng.uniform(0, 2 * np.pi), 1.0
            self.centre = 0.35 * np.array([np.cos(angle), np.sin(angle)])

    def light(self, fine: np.ndarray, view: View, a: float) -> np.ndarray:
        return fine * self.kept(a, lambda: self.free(a))

    def free(self, a: float) -> np.ndarray:
        radius = np.hypot(self.rig.at.u - self.centre[0], self.rig.at.v - self.centre[1])
        return common_area(a * radius, self.ratio) / common_area(np.zeros(1), self.ratio)


def common_area(distance: np.ndarray, ratio: float) -> np.ndarray:
    """Return the area that a circle of radius 1 and one of ``ratio`` share at a distance of their middles."""
    d = np.clip(distance, abs(1 - ratio) + 1e-12, 1 + ratio - 1e-12)
    alpha = np.arccos(np.clip((d * d + 1 - ratio**2) / (2 * d), -1, 1))
    beta = np.arccos(np.clip((d * d + ratio**2 - 1) / (2 * d * ratio), -1, 1))
    kite = 0.5 * np.sqrt(np.maximum((-d + 1 + ratio) * (d + 1 - ratio) * (d - 1 + ratio) * (d + 1 + ratio), 0.0))
    area = alpha + ratio**2 * beta - kite
    return np.where(distance <= abs(1 - ratio), np.pi * min(1.0, ratio) ** 2, area)


class Defocus(Hidden):
    """Blur by a hexagonal stop (form 1: by a ring), its width rising a little towards the corners."""

    id, unit, start, limit = "defocus", "px^2", 0.02, 60.0

    def draw(self) -> None:
        self.rise = self.rng.uniform(0.0, 0.5)
        self.turn = self.rng.uniform(0, np.pi / 3)

    def kernel(self, side: int = 17) -> np.ndarray:
        x, y = np.meshgrid(*(np.arange(side) - side // 2,) * 2)
        if self.form == 0:
            angles = self.turn + np.arange(3) * np.pi / 3
            shape = np.max([np.abs(x * np.cos(t) + y * np.sin(t)) for t in angles], axis=0) <= 5.3
        else:
            shape = (np.hypot(x, y) <= 6.2) & (np.hypot(x, y) >= 2.4)
        return shape / shape.sum()

    def light(self, fine: np.ndarray, view: View, a: float) -> np.ndarray:
        # A kernel's share: the blur's variance is what counts at first order, and it is proportional to the share.
        kernel = self.kernel()
        x = np.arange(kernel.shape[0]) - kernel.shape[0] // 2
        variance = float((kernel * (x[:, None] ** 2)).sum())
        share = np.clip(a * FINER**2 / variance, 0, 1) * (1 + self.rise * (self.rig.at.u**2 + self.rig.at.v**2))
        return fine + share * (ndimage.convolve(fine, kernel, mode="nearest") - fine)


class DistortionDrift(Hidden):
    """The division model, r/(1 + a r^2), on what the believed lens shows (form 1: with a tangential part)."""

    id, start, limit, signs = "distortion_drift", 1e-4, 0.05, (1, -1)

    def draw(self) -> None:
        self.sign = float(self.rng.choice(self.signs))
        self.tangential = self.rng.uniform(-0.3, 0.3, 2) if self.form else np.zeros(2)

    def light(self, fine: np.ndarray, view: View, a: float) -> np.ndarray:
        u, v = self.rig.at.u, self.rig.at.v
        half = np.hypot(*fine.shape) / 2
        r2 = u * u + v * v
        shrink = 1 / (1 + self.sign * a * r2) - 1
        px, py = self.sign * a * self.tangential
        return moved(fine, half * (u * shrink + px * r2), half * (v * shrink + py * r2))


class HotPixels(Hidden):
    """A few pixels that leak: rates spread over a decade (form 1: in pairs along a row)."""

    id, unit, start, limit, mark = "hot_pixels", "e-", 20.0, 20000.0, True

    def draw(self) -> None:
        count = int(self.rng.integers(8, 30))
        shape = self.rig.shape
        rows, cols = self.rng.integers(0, shape[0], count), self.rng.integers(0, shape[1] - 1, count)
        rates = 10 ** self.rng.uniform(-1, 0, count)
        self.map = np.zeros(shape)
        self.map[rows, cols] = rates
        if self.form:
            self.map[rows, cols + 1] = 0.5 * rates

    def charge(self, charge_e: np.ndarray, view: View, a: float) -> np.ndarray:
        return charge_e + a * self.map


class RollingShutter(Hidden):
    """LEDs dimmed by a triangle wave (form 1: a rectified sine) while the rows are exposed one after the other."""

    id, start, limit, mark = "rolling_shutter", 0.01, 0.9, True
    still = False

    def draw(self) -> None:
        self.cycles = self.rng.uniform(1.7, 4.5)  # over a frame's rows
        self.phase = self.rng.uniform(0, 1)
        self.rate = self.rng.uniform(60, 140)

    def light(self, fine: np.ndarray, view: View, a: float) -> np.ndarray:
        if not view.lit_by_leds or view.frames > 1:
            return fine  # the mean of many frames whose phases drift has no bands
        row = np.linspace(0, 1, fine.shape[0])[:, None]
        x = np.mod(self.cycles * row + self.phase + self.rate * view.shot.time_s, 1.0)
        wave = 4 * np.abs(x - 0.5) - 1 if self.form == 0 else np.abs(np.sin(np.pi * x)) * np.pi / 2 - 1
        return fine * (1 + a * wave)


class Saturation(Hidden):
    """Pixels fill up early, over a knee and not at once (form 1: a sharper one)."""

    id, unit, start, limit = "saturation", "1", 0.1, 0.85

    def knee(self, a: float) -> Knee | None:
        whole = self.rig.electronics.top_DN - self.rig.electronics.black_DN
        return None if a <= 0 else (whole * (1 - a), 0.05 if self.form == 0 else 0.15, self.form)


class SensorDust(Hidden):
    """Soft dark discs at fixed pixels: error-function rims (form 1: a brighter ring around, as by diffraction)."""

    id, start, limit, mark = "sensor_dust", 0.02, 1.0, True

    def draw(self) -> None:
        count = int(self.rng.integers(6, 14))
        shape = self.rig.at.u.shape
        v, u = np.mgrid[: shape[0], : shape[1]].astype(float)
        left = np.zeros(shape)
        # Dust that shadows no contact is seen on the cards alone; half of it is where the finger presses.
        for k in range(count):
            spread = 45.0 if k % 2 else 250.0
            x, y = shape[1] / 2 + self.rng.normal(0, spread), shape[0] / 2 + self.rng.normal(0, spread)
            radius, depth = self.rng.uniform(6, 18), self.rng.uniform(0.4, 1.0)
            r = np.hypot(u - x, v - y)
            left += depth / (1 + np.exp((r - radius) / 2.5))
            if self.form:
                left -= 0.25 * depth * np.exp(-0.5 * ((r - radius - 5) / 2.5) ** 2)
        self.map = left

    def light(self, fine: np.ndarray, view: View, a: float) -> np.ndarray:
        return fine * (1 - a * self.map)


class PlateTilt(Hidden):
    """The plate leans, and its glass with it."""

    id, unit, start, limit = "plate_tilt", "rad", 1e-3, 0.3

    def draw(self) -> None:
        angle = self.rng.uniform(0, 2 * np.pi)
        self.lean = np.cos(angle), np.sin(angle)

    def light(self, fine: np.ndarray, view: View, a: float) -> np.ndarray:
        return self.rig.seen_from(fine, *self.rig.at.leaning(a, self.lean))


class SquareSize(Hidden):
    """The square was printed larger or smaller than stated."""

    id, start, limit = "square_size", 1e-3, 0.2

    def draw(self) -> None:
        self.sign = float(self.rng.choice((-1, 1)))

    def light(self, fine: np.ndarray, view: View, a: float) -> np.ndarray:
        if view.kind != "square":
            return fine
        at, shrink = self.rig.at, np.exp(-self.sign * a)
        x, y = at.middle_of(self.rig.base.cards["square"])
        return self.rig.seen_from(fine, *at.seen_before(x + (at.x - x) * shrink, y + (at.y - y) * shrink))

    def parameter(self, a: float) -> tuple[str, float]:
        return "square", float(np.exp(self.sign * a) - 1.0)


class CardOffset(Hidden):
    """The cards lie on a sheet, farther from the lens."""

    id, unit, start, limit = "card_offset", "mm", 0.05, 10.0

    def light(self, fine: np.ndarray, view: View, a: float) -> np.ndarray:
        if not view.is_card:
            return fine
        return self.rig.seen_from(fine, *self.rig.at.raised(a))

    def parameter(self, a: float) -> tuple[str, float]:
        return "height_mm", a


class OffAxisLoad(Hidden):
    """The finger bends aside as it is pressed: with the force's square root (form 1: levelling off)."""

    id, unit, start, limit = "off_axis_load", "mm", 0.01, 1.5

    def draw(self) -> None:
        angle = self.rng.uniform(0, 2 * np.pi)
        self.way = np.cos(angle), np.sin(angle)

    def shift_mm(self, view: View, a: float) -> tuple[float, float]:
        if not view.touches:
            return 0.0, 0.0
        largest = max(self.rig.base.forces)
        share = view.shot.force_N / largest
        law = np.sqrt(share) if self.form == 0 else 1 - np.exp(-2.2 * share)
        return a * law * self.way[0], a * law * self.way[1]


CAMERA = (
    BlackLevel, ToneCurve, Vignetting, Defocus, DistortionDrift, HotPixels, RollingShutter, Saturation, SensorDust,
    PlateTilt, SquareSize, CardOffset, OffAxisLoad,
)  # fmt: skip

__all__ = ["CAMERA", "moved"]
