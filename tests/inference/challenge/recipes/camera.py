"""Recipes of lens and sensor."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from ..hidden import Hidden
from ..rig import FINER, View


def resampled(image: np.ndarray, col: np.ndarray, row: np.ndarray) -> np.ndarray:
    """Return an image (rows, cols) at other places of itself [px], by cubic splines."""
    return ndimage.map_coordinates(image, [row, col], order=3, mode="nearest")


def grid(shape: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Return column and row of each pixel."""
    row, col = np.mgrid[: shape[0], : shape[1]].astype(float)
    return col, row


def convolved(image: np.ndarray, kernel: np.ndarray) -> np.ndarray:
    """Return an image convolved with a small kernel of odd side, its border repeated."""
    pad = kernel.shape[0] // 2
    wide = np.pad(image, pad, mode="edge")
    spectrum = np.fft.rfft2(wide) * np.fft.rfft2(kernel, wide.shape)
    return np.fft.irfft2(spectrum, wide.shape)[2 * pad :, 2 * pad :]


class BlackLevel(Hidden):
    """An offset that rises as the sensor warms up, and a glow of the output amplifier in one corner.

    Dark current and offset follow the sensor's temperature, which settles exponentially: Janesick, Scientific
    Charge-Coupled Devices, SPIE 2001, secs 7.1 and 7.2.
    """

    id, unit, start, limit, signs = "black_level", "DN", 1.0, 120.0, (1, -1)
    still = False

    def draw(self) -> None:
        self.sign = 1.0 if self.plain else float(self.rng.choice(self.signs))
        self.tau, self.rise = self.rng.uniform(30, 90), 0.0 if self.plain else self.rng.uniform(0.0, 0.15)
        corner, reach = self.rng.integers(0, 2, 2), self.rng.uniform(0.15, 0.35)
        col, row = grid(self.rig.shape)
        away = np.hypot(row / self.rig.shape[0] - corner[0], col / self.rig.shape[1] - corner[1])
        self.glow = (0.0 if self.plain else self.rng.uniform(0.0, 0.3)) * np.exp(-away / reach)

    def offset_DN(self, view: View, a: float) -> np.ndarray:
        warm = 1 - np.exp(-view.shot.time_s / self.tau) if view.touches else 0.0
        return self.sign * a * (1 + self.rise * warm + self.glow)

    def parameter(self, a: float) -> tuple[str, float]:
        return "offset_DN", self.sign * a * float(1 + 0.5 * self.rise + self.glow.mean())


class ToneCurve(Hidden):
    """A curve that saturates as photoreceptors do, v^n / (v^n + s^n).

    Naka and Rushton, J. Physiol. 185 (1966) 536; as a camera's curve in Reinhard and Devlin, IEEE Trans. Vis. Comput.
    Graph. 11 (2005) 13.
    """

    id, start, limit = "tone_curve", 0.01, 1.0

    def draw(self) -> None:
        self.power, self.half = self.rng.uniform(0.8, 1.6), self.rng.uniform(0.3, 1.2)

    def curve(self, curve: np.ndarray, a: float) -> np.ndarray:
        raised = curve**self.power
        bent = raised / (raised + self.half**self.power) * (1 + self.half**self.power)
        return np.clip(curve + a * (bent - curve), 0, 1)


class Vignetting(Hidden):
    """Off-axis falloff times a straight one by geometry: (1 - alpha r) / (1 + (r/f)^2)^2.

    Kang and Weiss, ECCV 2000, LNCS 1843, 640, eqs 1 to 3.
    """

    id, start, limit = "vignetting", 0.05, 1.0

    def draw(self) -> None:
        self.share = self.rng.uniform(0.3, 0.7)
        angle = self.rng.uniform(0, 2 * np.pi)
        self.centre = (0.35 if self.plain else self.rng.uniform(0.0, 0.1)) * np.array([np.cos(angle), np.sin(angle)])

    def light(self, fine: np.ndarray, view: View, a: float) -> np.ndarray:
        r = np.hypot(self.rig.at.u - self.centre[0], self.rig.at.v - self.centre[1])
        return fine * np.maximum(1 - 0.5 * a * self.share * r, 0) / (1 + a * (1 - self.share) * r * r) ** 2


class Defocus(Hidden):
    """Blur by Moffat's profile (1 + (r/s)^2)^-beta, weaker towards one side, as a sensor that is not parallel gives.

    Moffat, Astron. Astrophys. 3 (1969) 455; its wings are those of seeing and of stray light in lenses.
    """

    id, unit, start, limit = "defocus", "px^2", 0.02, 30.0

    def draw(self) -> None:
        beta, scale = self.rng.uniform(2.2, 3.5), self.rng.uniform(3.0, 5.0)
        angle, tilt = self.rng.uniform(0, 2 * np.pi), self.rng.uniform(0.0, 0.4)
        x, y = np.meshgrid(np.arange(-12, 13), np.arange(-12, 13))
        kernel = (1 + (x * x + y * y) / scale**2) ** -beta
        self.kernel = kernel / kernel.sum()
        self.variance = float((self.kernel * x * x).sum())
        self.side = 1 + tilt * (self.rig.at.u * np.cos(angle) + self.rig.at.v * np.sin(angle))

    def light(self, fine: np.ndarray, view: View, a: float) -> np.ndarray:
        share = np.clip(a * FINER**2 / self.variance * self.side, 0, 1)
        return fine + share * (convolved(fine, self.kernel) - fine)


class DistortionDrift(Hidden):
    """A radial part of third and fifth order of opposite signs, and decentring, as of an element that moved.

    Brown, Photogramm. Eng. 32 (1966) 444, eqs 4 and 10.
    """

    id, start, limit, signs = "distortion_drift", 1e-4, 0.05, (1, -1)

    def draw(self) -> None:
        self.sign, self.fifth = float(self.rng.choice(self.signs)), self.rng.uniform(0.2, 0.6)
        self.decentring = self.rng.uniform(-0.3, 0.3, 2)

    def light(self, fine: np.ndarray, view: View, a: float) -> np.ndarray:
        u, v = self.rig.at.u, self.rig.at.v
        half, r2 = np.hypot(*fine.shape) / 2, u * u + v * v
        radial = r2 - self.fifth * r2 * r2
        p, q = self.decentring
        du = u * radial + p * (r2 + 2 * u * u) + 2 * q * u * v
        dv = v * radial + q * (r2 + 2 * v * v) + 2 * p * u * v
        col, row = grid(fine.shape)
        return resampled(fine, col - self.sign * a * half * du, row - self.sign * a * half * dv)


class HotPixels(Hidden):
    """Pixels whose dark rates have an exponential tail, a third of which switch between two of them.

    Widenhorn et al., Proc. SPIE 4669 (2002) 193 (rates); Hopkins and Hopkinson, IEEE Trans. Nucl. Sci. 40 (1993) 1567
    (random telegraph signals).
    """

    id, unit, start, limit, mark = "hot_pixels", "e-", 20.0, 20000.0, True
    still = False

    def draw(self) -> None:
        count = int(self.rng.integers(10, 40))
        self.place = tuple(self.rng.integers(0, n, count) for n in self.rig.shape)
        self.rate = self.rng.exponential(0.4, count)
        self.switches, self.period = self.rng.random(count) < 1 / 3, self.rng.uniform(20, 60, count)

    def charge(self, charge_e: np.ndarray, view: View, a: float) -> np.ndarray:
        high = np.where(self.switches & (np.mod(view.shot.time_s, 2 * self.period) > self.period), 0.5, 1.0)
        changed = charge_e.copy()
        np.add.at(changed, self.place, a * self.rate * high)
        return changed


class RollingShutter(Hidden):
    """LEDs switched on and off at a duty cycle, gathered over each row's exposure: a wave with straight flanks.

    Liang, Chang and Chen, IEEE Trans. Image Process. 17 (2008) 1323 (rows in turn); a square wave through a window is a
    trapezium.
    """

    id, start, limit, mark = "rolling_shutter", 0.01, 0.9, True
    still = False

    def draw(self) -> None:
        self.cycles, self.rate = self.rng.uniform(2.0, 6.0), self.rng.uniform(70, 160)
        self.duty, self.window = self.rng.uniform(0.3, 0.7), self.rng.uniform(0.1, 0.25)

    def light(self, fine: np.ndarray, view: View, a: float) -> np.ndarray:
        if not view.lit_by_leds or view.frames > 1:
            return fine
        phase = np.mod(self.cycles * np.linspace(0, 1, fine.shape[0]) + self.rate * view.shot.time_s, 1.0)
        distance = np.abs(phase - 0.5)
        wave = np.clip(0.5 + (self.duty / 2 - distance) / self.window, 0, 1)
        return fine * (1 + a * (wave - wave.mean()))[:, None]


class Saturation(Hidden):
    """Pixels that are full early and spill part of the rest along their column, as without a drain.

    Janesick, Scientific Charge-Coupled Devices, SPIE 2001, sec. 4.2 (blooming).
    """

    id, start, limit = "saturation", 0.1, 0.85

    def draw(self) -> None:
        self.spilled, self.reach = self.rng.uniform(0.0, 0.3), self.rng.uniform(2.0, 8.0)

    def charge(self, charge_e: np.ndarray, view: View, a: float) -> np.ndarray:
        e = self.rig.electronics
        well = (1 - a) * (e.top_DN - e.black_DN) / e.DN_per_e
        excess = np.maximum(charge_e - well, 0.0)
        if a <= 0 or not excess.any():
            return charge_e
        over = ndimage.gaussian_filter1d(excess, self.reach, axis=0)
        return np.minimum(charge_e - excess + self.spilled * over, np.maximum(charge_e, well))


class SensorDust(Hidden):
    """Dust on the cover glass: losses of light in the shape of a Gaussian each.

    Dirik, Sencar and Memon, IEEE Trans. Inf. Forensics Secur. 3 (2008) 539, eq. 1.
    """

    id, start, limit, mark = "sensor_dust", 0.02, 1.0, True

    def draw(self) -> None:
        shape = self.rig.at.u.shape
        self.map, (col, row) = np.zeros(shape), grid(shape)
        for _ in range(int(self.rng.integers(8, 20))):
            # Where contacts are seen, or it would be seen on the targets alone.
            x, y = self.rng.uniform(0.3, 0.7) * shape[1], self.rng.uniform(0.25, 0.75) * shape[0]
            width, depth = self.rng.uniform(2.5, 9.0), self.rng.lognormal(-0.7, 0.5)
            self.map += depth * np.exp(-0.5 * ((col - x) ** 2 + (row - y) ** 2) / width**2)

    def light(self, fine: np.ndarray, view: View, a: float) -> np.ndarray:
        return fine * np.maximum(1 - a * self.map, 0)


class PlateTilt(Hidden):
    """Keystone: magnification that changes linearly along one direction.

    Hartley and Zisserman, Multiple View Geometry, 2nd ed. 2004, sec. 2.4 (projective part of a homography alone).
    """

    id, unit, start, limit = "plate_tilt", "rad", 1e-3, 0.3

    def draw(self) -> None:
        angle = self.rng.uniform(0, 2 * np.pi)
        self.way = np.cos(angle), np.sin(angle)

    def light(self, fine: np.ndarray, view: View, a: float) -> np.ndarray:
        at = self.rig.at
        scale = 1 / (1 - a * (self.way[0] * at.ray_x + self.way[1] * at.ray_y))
        return self.rig.seen_from(fine, *at.seen(at.ray_x * scale, at.ray_y * scale))


class SquareSize(Hidden):
    """Printed longer along the feed than across it, about its own middle: a wrong feed length of the printer.

    Printers state both directions apart: ISO/IEC 29112:2012 (scaling and geometric accuracy of monochrome printers).
    """

    id, start, limit = "square_size", 1e-3, 0.2

    def draw(self) -> None:
        self.sign, self.across = float(self.rng.choice((-1, 1))), self.rng.uniform(0.8, 1.0)
        self.middle = self.rig.at.middle_of(self.rig.base.cards["square"])

    def light(self, fine: np.ndarray, view: View, a: float) -> np.ndarray:
        if view.kind != "square":
            return fine
        at, (x, y), side = self.rig.at, self.middle, self.sign * a
        there = x + (at.x - x) * np.exp(-side), y + (at.y - y) * np.exp(-side * self.across)
        return self.rig.seen_from(fine, *at.seen_before(*there))

    def parameter(self, a: float) -> tuple[str, float]:
        return "square", float(np.exp(0.5 * self.sign * a * (1 + self.across)) - 1.0)


class CardOffset(Hidden):
    """Cards off the plane in focus: smaller, and blurred by the disc that goes with the distance.

    Pentland, IEEE Trans. Pattern Anal. Mach. Intell. 9 (1987) 523, eq. 3 (radius of the blur disc by thin lenses).
    """

    id, unit, start, limit = "card_offset", "mm", 0.05, 10.0

    def light(self, fine: np.ndarray, view: View, a: float) -> np.ndarray:
        if not view.is_card:
            return fine
        camera = self.rig.scene.camera
        focal, pitch = camera.lens.focal_length_mm, camera.pixel.pitch_um * 1e-3
        distance = focal / pitch / camera.scale_px_per_mm
        smaller = self.rig.seen_from(fine, *self.rig.at.raised(a))
        disc_px = 0.5 * focal / camera.lens.f_number * a / (distance + a) * camera.scale_px_per_mm * FINER
        return ndimage.gaussian_filter(smaller, 0.5 * disc_px)

    def parameter(self, a: float) -> tuple[str, float]:
        return "height_mm", a


CAMERA = (
    BlackLevel, ToneCurve, Vignetting, Defocus, DistortionDrift, HotPixels, RollingShutter, Saturation, SensorDust,
    PlateTilt, SquareSize, CardOffset,
)  # fmt: skip
