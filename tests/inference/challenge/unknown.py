"""Causes that no library has: what a critic must not name."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from .families_camera import moved
from .hidden import Hidden
from .rig import View, power


class Moire(Hidden):
    """Fringes of two gratings: a fixed sinusoid that multiplies the light."""

    id, start = "moire", 0.01

    def draw(self) -> None:
        angle, period = self.rng.uniform(0, np.pi), self.rng.uniform(0.03, 0.07)
        at = self.rig.at
        phase = 2 * np.pi * (at.u * np.cos(angle) + at.v * np.sin(angle)) / period + self.rng.uniform(0, 6)
        self.map = np.sin(phase) if self.form == 0 else np.sign(np.sin(phase)) * 0.8

    def light(self, fine: np.ndarray, view: View, a: float) -> np.ndarray:
        return fine * (1 + a * self.map)


class DriftingSmear(Hidden):
    """A fingerprint on the glass whose stripes creep along with time."""

    id, start = "drifting_smear", 0.01
    still = False

    def draw(self) -> None:
        self.angle, self.period = self.rng.uniform(0, np.pi), self.rng.uniform(0.5, 0.9)
        self.speed = self.rng.uniform(0.004, 0.012) * self.rng.choice((-1, 1))
        self.place = self.rng.uniform(-3, 3, 2)

    def light(self, fine: np.ndarray, view: View, a: float) -> np.ndarray:
        if not view.lit_by_leds:
            return fine
        at = self.rig.at
        s = at.x * np.cos(self.angle) + at.y * np.sin(self.angle) + self.speed * view.shot.time_s
        r2 = (at.x - self.place[0]) ** 2 + (at.y - self.place[1]) ** 2
        stripes = (0.5 + 0.5 * np.sin(2 * np.pi * s / self.period)) * np.exp(-r2 / (2 * 4.0**2))
        return fine + a * self.rig.contact_level * power(self.rig.name, view.shot.voltage_V) * stripes


class GhostImage(Hidden):
    """A lens flare: the contact once more, mirrored through the optical axis, smaller and out of focus."""

    id, start = "ghost_image", 0.01

    def draw(self) -> None:
        self.scale = self.rng.uniform(1.4, 2.0)
        self.aside = self.rng.uniform(25, 60) * self.rng.choice((-1, 1), 2)

    def light(self, fine: np.ndarray, view: View, a: float) -> np.ndarray:
        rows, cols = fine.shape
        small = fine[::4, ::4]
        v, u = np.mgrid[: small.shape[0], : small.shape[1]].astype(float)
        cv, cu = (small.shape[0] - 1) / 2, (small.shape[1] - 1) / 2
        place = [cv - self.scale * (v - cv - self.aside[1] / 4), cu - self.scale * (u - cu - self.aside[0] / 4)]
        ghost = ndimage.gaussian_filter(ndimage.map_coordinates(small, place, order=1), 2.0)
        return fine + a * np.kron(ghost, np.ones((4, 4)))[:rows, :cols]


class RowBanding(Hidden):
    """Rows of the sensor with offsets of their own, in groups of eight."""

    id, unit, start = "row_banding", "DN", 1.0
    limit = 500.0

    def draw(self) -> None:
        count, cols = self.rig.shape
        rows = np.repeat(self.rng.standard_normal(-(-count // 8)), 8)[:count]
        self.map = (rows - rows.mean())[:, None] * np.ones((1, cols))

    def offset_DN(self, view: View, a: float) -> np.ndarray:
        return a * self.map


class FocusDrift(Hidden):
    """The lens warms up and its focus walks: blur that grows with time, along one direction more."""

    id, unit, start, limit = "focus_drift", "px^2", 0.05, 60.0
    still = False

    def draw(self) -> None:
        self.tau = self.rng.uniform(40, 90)
        self.along = self.rng.uniform(1.5, 2.5)

    def light(self, fine: np.ndarray, view: View, a: float) -> np.ndarray:
        if view.kind not in ("press", "replicate"):
            return fine
        share = min(a * (1 - np.exp(-view.shot.time_s / self.tau)), 1.0)
        wide = ndimage.gaussian_filter(fine, (2.0, 2.0 * self.along))
        return fine + share * (wide - fine)


class StrayReflection(Hidden):
    """Light off the press's own parts: a spot that walks over the frame as the load rises."""

    id, start = "stray_reflection", 0.01

    def draw(self) -> None:
        self.begin, self.way = self.rng.uniform(-0.5, 0.5, 2), self.rng.uniform(-0.5, 0.5, 2)
        self.width = self.rng.uniform(0.05, 0.12)

    def light(self, fine: np.ndarray, view: View, a: float) -> np.ndarray:
        if not view.touches:
            return fine
        at, share = self.rig.at, view.shot.force_N / max(self.rig.base.forces)
        x, y = self.begin + self.way * share
        r2 = ((at.u - x) / self.width) ** 2 + ((at.v - y) / (0.5 * self.width)) ** 2
        return fine + a * self.rig.contact_level * np.exp(-0.5 * r2)


class PlateBending(Hidden):
    """The plate sags under the load like a beam: the picture shrinks across it, the more the harder the press."""

    id, unit, start, limit = "plate_bending", "1", 1e-3, 0.2

    def draw(self) -> None:
        self.turn = self.rng.uniform(0, np.pi)

    def light(self, fine: np.ndarray, view: View, a: float) -> np.ndarray:
        if not view.touches:
            return fine
        at, half = self.rig.at, np.hypot(*fine.shape) / 2
        x, y = self.rig.finger_mm
        s = (at.x - x) * np.cos(self.turn) + (at.y - y) * np.sin(self.turn)
        push = a * view.shot.force_N / max(self.rig.base.forces) * half * s / 20.0
        return moved(fine, push * np.cos(self.turn), push * np.sin(self.turn))


class NewtonRings(Hidden):
    """Interference in a film of trapped air: rings about the contact's middle that grow with it."""

    id, start = "newton_rings", 0.01

    def draw(self) -> None:
        self.count, self.phase = self.rng.uniform(2.0, 4.0), self.rng.uniform(0, 2 * np.pi)

    def light(self, fine: np.ndarray, view: View, a: float) -> np.ndarray:
        if not view.touches:
            return fine
        return fine * (1 + a * self.kept(view.shot.force_N, lambda: self.rings(view.shot.force_N)))

    def rings(self, force_N: float) -> np.ndarray:
        at, (x, y) = self.rig.at, self.rig.finger_mm
        lit = self.rig.base.press[self.rig.base.force_index(force_N)] > 0.5 * self.rig.contact_level
        radius2 = lit.sum() / np.pi * at.mm_per_px**2
        r2 = ((at.x - x) ** 2 + (at.y - y) ** 2) / radius2
        return np.where(r2 < 1.5, np.cos(2 * np.pi * self.count * r2 + self.phase), 0.0)


class ColumnGain(Hidden):
    """Amplifiers of the columns, each of its own gain, in pairs (EMVA 1288, release 4.0, sec. 8: column patterns)."""

    id, start = "column_gain", 0.01

    def draw(self) -> None:
        rows, cols = self.rig.shape
        self.map = np.ones((rows, 1)) * np.repeat(self.rng.standard_normal(-(-cols // 2)), 2)[:cols]

    def charge(self, charge_e: np.ndarray, view: View, a: float) -> np.ndarray:
        return charge_e * (1 + a * self.map)


class ImageLag(Hidden):
    """A share of the frame before stays in the pixels: the contact of a smaller force, on top (Janesick 2001, 5.3)."""

    id, start, limit = "image_lag", 0.01, 0.9
    still = False

    def light(self, fine: np.ndarray, view: View, a: float) -> np.ndarray:
        if view.kind != "press" or view.shot.index == 0:
            return fine
        before = next(v for v in self.rig.views if v.kind == "press" and v.shot.index == view.shot.index - 1)
        base = self.rig.base
        older = base.press[base.force_index(before.shot.force_N)] * power(self.rig.name, before.shot.voltage_V)
        return fine + a * (older - fine)


class StressFringes(Hidden):
    """The loaded plate turns polarisation: light goes as sin^2 of a retardation that falls off around the contact.

    Frocht, Photoelasticity, 1941, vol. 1, ch. 4; the stress of a load on a surface falls as 1/(r^2 + c^2).
    """

    id, start = "stress_fringes", 0.01

    def draw(self) -> None:
        self.order, self.turn = self.rng.uniform(2.0, 4.0), self.rng.uniform(0, np.pi)

    def light(self, fine: np.ndarray, view: View, a: float) -> np.ndarray:
        if not view.touches:
            return fine
        return fine * (1 - a * self.kept(view.shot.force_N, lambda: self.fringes(view.shot.force_N)))

    def fringes(self, force_N: float) -> np.ndarray:
        at, (x, y) = self.rig.at, self.rig.finger_mm
        r2, angle = (at.x - x) ** 2 + (at.y - y) ** 2, np.arctan2(at.y - y, at.x - x)
        retardation = np.pi * self.order * force_N / max(self.rig.base.forces) * 16.0 / (r2 + 16.0)
        return np.sin(2 * (angle - self.turn)) ** 2 * np.sin(retardation) ** 2


class TrappedBubble(Hidden):
    """Air enclosed as the contact closes: a dark disc aside from its middle that shrinks as the pressure rises."""

    id, start, limit = "trapped_bubble", 0.02, 1.0

    def draw(self) -> None:
        angle = self.rng.uniform(0, 2 * np.pi)
        self.place = self.rng.uniform(0.5, 1.5) * np.array([np.cos(angle), np.sin(angle)])
        self.radius = self.rng.uniform(0.5, 1.0)

    def light(self, fine: np.ndarray, view: View, a: float) -> np.ndarray:
        if not view.touches:
            return fine
        at, (x, y) = self.rig.at, self.rig.finger_mm
        radius = self.radius * (1 + 4 * view.shot.force_N / max(self.rig.base.forces)) ** (-1 / 3)
        r = np.hypot(at.x - x - self.place[0], at.y - y - self.place[1])
        return fine * (1 - a / (1 + np.exp(np.clip((r - radius) / (1.5 * at.mm_per_px), -50, 50))))


class FrameTear(Hidden):
    """The buffer is swapped while it is read: rows below one that wanders still show the frame before."""

    id, start, limit = "frame_tear", 0.02, 1.0
    still = False

    def draw(self) -> None:
        self.first = self.rng.uniform(0.45, 0.7, 100)

    def light(self, fine: np.ndarray, view: View, a: float) -> np.ndarray:
        if view.kind != "press" or view.shot.index == 0:
            return fine
        before = next(v for v in self.rig.views if v.kind == "press" and v.shot.index == view.shot.index - 1)
        base = self.rig.base
        older = base.press[base.force_index(before.shot.force_N)] * power(self.rig.name, before.shot.voltage_V)
        torn, row = fine.copy(), round(self.first[view.shot.index % 100] * fine.shape[0])
        torn[row:] += a * (older - fine)[row:]
        return torn


class GlassStriae(Hidden):
    """Veins of another index in the plate: places seen through them are displaced along wavy bands (ISO 10110-18)."""

    id, unit, start, limit = "glass_striae", "px", 0.02, 12.0

    def draw(self) -> None:
        at = self.rig.at
        turn, period = self.rng.uniform(0, np.pi), self.rng.uniform(1.5, 4.0)
        along, across = (at.x * np.cos(turn) + at.y * np.sin(turn)), (at.y * np.cos(turn) - at.x * np.sin(turn))
        wave = np.sin(2 * np.pi * (across + 0.5 * np.sin(along / 3.0)) / period + self.rng.uniform(0, 6))
        self.push = -np.sin(turn) * wave, np.cos(turn) * wave

    def light(self, fine: np.ndarray, view: View, a: float) -> np.ndarray:
        return moved(fine, a * self.push[0], a * self.push[1])


class VideoEcho(Hidden):
    """A reflection on the cable: every row once more, delayed by some pixels and of the other sign."""

    id, start, limit = "video_echo", 0.01, 0.8

    def draw(self) -> None:
        self.delay, self.sign = int(self.rng.integers(12, 40)), float(self.rng.choice((-1, 1)))

    def charge(self, charge_e: np.ndarray, view: View, a: float) -> np.ndarray:
        echo = np.zeros_like(charge_e)
        echo[:, self.delay :] = charge_e[:, : -self.delay]
        return np.maximum(charge_e + self.sign * a * echo, 0.0)


UNKNOWN = (
    Moire, DriftingSmear, GhostImage, RowBanding, FocusDrift, StrayReflection, PlateBending, NewtonRings, ColumnGain,
    ImageLag, StressFringes, TrappedBubble, FrameTear, GlassStriae, VideoEcho,
)  # fmt: skip
