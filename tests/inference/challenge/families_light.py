"""Hidden causes of the light and of the contact, each in a form of its own."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from evanesce.optics.led import led_positions
from evanesce.render.fast.defects import contact_radiance
from evanesce.rig import Scene
from evanesce.rig.leds import StripEdge

from .hidden import Hidden
from .rig import View, power


def blurred_points(shape: tuple[int, int], u: np.ndarray, v: np.ndarray, flux: np.ndarray, sigma: float) -> np.ndarray:
    """Return points of light on the fine frame, shared among pixels and softened."""
    image = np.zeros(shape)
    inside = (u >= 0) & (v >= 0) & (u < shape[1] - 1) & (v < shape[0] - 1)
    u, v, flux = u[inside], v[inside], flux[inside]
    iu, iv = u.astype(int), v.astype(int)
    fu, fv = u - iu, v - iv
    for dv, du, w in ((0, 0, (1 - fu) * (1 - fv)), (0, 1, fu * (1 - fv)), (1, 0, (1 - fu) * fv), (1, 1, fu * fv)):
        np.add.at(image, (iv + dv, iu + du), w * flux)
    return ndimage.gaussian_filter(image, sigma)


MIDDLE_S = 100.0
"""Middle of the ramp and its holds."""


class LightField(Hidden):
    """LEDs of other powers than believed: the guided light's share from each LED, by the rig's own plate."""

    STEP = 0.2

    def powers(self, edge: str, positions: np.ndarray) -> np.ndarray:
        """Return the relative loss of each LED of an edge."""
        raise NotImplementedError

    def draw(self) -> None:
        self.shape()
        scene = self.rig.scene
        changed = {}
        for edge, positions in led_positions(scene.plate, scene.leds).items():
            factor = 1 - self.STEP * self.powers(edge, np.asarray(positions))
            changed[edge] = {"relative_power": tuple(float(f) for f in factor)}
        leds = scene.leds.model_copy(update={"edge": {k: StripEdge(**v) for k, v in changed.items()}})
        self.loss = self.on_plate(scene.model_copy(update={"leds": leds}))

    def shape(self) -> None:
        """Draw which LEDs."""

    def on_plate(self, changed: Scene) -> np.ndarray:
        """Return the relative loss of light at each pixel's plate point per unit of amplitude, from a coarse mesh."""
        x, y = np.meshgrid(np.linspace(-22, 22, 23), np.linspace(-18, 18, 19))
        before = contact_radiance(self.rig.scene, x, y)
        loss = (1 - contact_radiance(changed, x, y) / before) / self.STEP
        at = self.rig.at
        place = np.array([(at.y + 18) / 2, (at.x + 22) / 2])
        return ndimage.map_coordinates(loss, place, order=3, mode="nearest")

    def light(self, fine: np.ndarray, view: View, a: float) -> np.ndarray:
        return fine * (1 - a * self.strength(view) * self.loss) if view.lit_by_leds else fine

    def strength(self, view: View) -> float:
        return 1.0


class LedDead(LightField):
    """A segment of neighbours that is fainter, the middle one most."""

    id, start, limit = "led_dead", 0.2, 1.0

    def shape(self) -> None:
        edges = list(led_positions(self.rig.scene.plate, self.rig.scene.leds).items())
        self.edge, positions = edges[int(self.rng.integers(len(edges)))]
        self.first = int(self.rng.integers(0, len(positions) - 2))
        self.weights = np.array([1.0, 1.0, 1.0] if self.form == 0 else [0.7, 1.0, 0.85])

    def powers(self, edge: str, positions: np.ndarray) -> np.ndarray:
        loss = np.zeros(positions.size)
        if edge == self.edge:
            loss[self.first : self.first + 3] = self.weights[: positions.size - self.first]
        return loss


class LedImbalance(LightField):
    """One side of the rig fainter than the other: a plane of power over the LEDs' places (form 1: a single edge)."""

    id, start, limit = "led_imbalance", 0.05, 1.0

    def shape(self) -> None:
        angle = self.rng.uniform(0, 2 * np.pi)
        self.way = np.cos(angle), np.sin(angle)
        self.edge = str(self.rng.choice(["left", "right", "top", "bottom"]))

    def powers(self, edge: str, positions: np.ndarray) -> np.ndarray:
        if self.form:
            return np.full(positions.size, 1.0 if edge == self.edge else 0.0)
        width, height = self.rig.scene.plate.size_mm
        side = {"left": (-1, 0), "right": (1, 0), "top": (0, -1), "bottom": (0, 1)}[edge]
        along = positions / (height / 2 if side[0] else width / 2)
        x, y = (side[0], along) if side[0] else (along, side[1])
        return 0.5 * (self.way[0] * x + self.way[1] * y) * np.ones(positions.size)


class SupplySag(LightField):
    """Power falls along the strips as 1 - s (2 - s), the more the more current flows."""

    id, start, limit = "supply_sag", 0.05, 1.0

    def powers(self, edge: str, positions: np.ndarray) -> np.ndarray:
        s = (positions - positions.min()) / max(float(np.ptp(positions)), 1e-9)
        return s * (2 - s) if self.form == 0 else 1 - np.exp(-2.5 * s)

    def strength(self, view: View) -> float:
        return power(self.rig.name, view.shot.voltage_V)


class LedWarmup(Hidden):
    """LEDs lose light as they warm: with the logarithm of time (form 1: a stretched exponential)."""

    id, start, limit = "led_warmup", 0.01, 0.6
    still = False

    def draw(self) -> None:
        self.tau = self.rng.uniform(15, 50)

    def light(self, fine: np.ndarray, view: View, a: float) -> np.ndarray:
        if not view.lit_by_leds:
            return fine
        t = view.shot.time_s / self.tau
        fall = np.log1p(t) / 2 if self.form == 0 else 1 - np.exp(-(t**0.6))
        return fine * (1 - a * fall * power(self.rig.name, view.shot.voltage_V) ** 0.5)


class GlassAbsorption(Hidden):
    """Each edge's light pays for the straight way to where it is seen (form 1: for 1.3 times it)."""

    id, unit, start, limit = "glass_absorption", "1/mm", 1e-4, 0.05

    def light(self, fine: np.ndarray, view: View, a: float) -> np.ndarray:
        if not view.lit_by_leds:
            return fine
        at, (width, height) = self.rig.at, self.rig.scene.plate.size_mm
        ways = [at.x + width / 2, width / 2 - at.x, at.y + height / 2, height / 2 - at.y]
        longer = 1.0 if self.form == 0 else 1.3
        return fine * np.mean([np.exp(-a * longer * np.maximum(way, 0)) for way in ways], axis=0)


class AmbientLight(Hidden):
    """Room light with a bow over the frame as well as a slope."""

    id, start, limit = "ambient_light", 1e-3, 0.5

    def draw(self) -> None:
        self.slope = self.rng.uniform(-0.5, 0.5, 2)
        self.bow = self.rng.uniform(-0.3, 0.3) if self.form == 0 else self.rng.uniform(0.2, 0.5)
        if self.plain:
            self.slope, self.bow = np.zeros(2), 0.0

    def light(self, fine: np.ndarray, view: View, a: float) -> np.ndarray:
        if view.is_card:
            return fine
        at = self.rig.at
        veil = 1 + self.slope[0] * at.u + self.slope[1] * at.v + self.bow * (at.u**2 + at.v**2)
        return fine + a * self.rig.contact_level * np.maximum(veil, 0)


class Marked(Hidden):
    """Marks on the glass that scatter guided light: follow LED power, whether or not the finger is there."""

    def pattern(self) -> np.ndarray:
        """Return the pattern over a contact's irradiance [1]."""
        raise NotImplementedError

    def draw(self) -> None:
        self.map = self.pattern()

    def light(self, fine: np.ndarray, view: View, a: float) -> np.ndarray:
        if not view.lit_by_leds:
            return fine
        return fine + a * self.rig.contact_level * power(self.rig.name, view.shot.voltage_V) * self.map


class Specks(Marked):
    """Points with power-law brightness (form 1: two sizes)."""

    id, start, limit, mark = "specks", 0.5, 500.0, True

    def pattern(self) -> np.ndarray:
        count = int(self.rng.integers(25, 60))
        shape = self.rig.at.u.shape
        flux = (1 - self.rng.random(count)) ** (-0.7) if self.form == 0 else self.rng.choice([1.0, 4.0], count)
        u, v = self.rng.uniform(0, shape[1], count), self.rng.uniform(0, shape[0], count)
        return blurred_points(shape, u, v, flux, 0.9)


class Scratch(Marked):
    """A scratch that bends: part of a circle, fading at its ends (form 1: two of them)."""

    id, start, limit, mark = "scratch", 0.05, 30.0, True

    def pattern(self) -> np.ndarray:
        shape = self.rig.at.u.shape
        total = np.zeros(shape)
        for _ in range(1 + self.form):
            x, y = shape[1] * self.rng.uniform(0.3, 0.7), shape[0] * self.rng.uniform(0.3, 0.7)
            turn, length = self.rng.uniform(0, 2 * np.pi), self.rng.uniform(100, 260)
            bend = self.rng.uniform(-1, 1) / 600
            s = np.linspace(-length / 2, length / 2, 1500)
            angle = turn + bend * s
            step = s[1] - s[0]
            u, v = x + np.cumsum(np.cos(angle)) * step, y + np.cumsum(np.sin(angle)) * step
            total += blurred_points(shape, u, v, np.maximum(np.cos(np.pi * s / length), 0.0) ** 0.5 * step, 0.8)
        return total


class ResidueFilm(Marked):
    """A haze whose brightness falls as a Lorentzian, oval (form 1: with a hole in its middle)."""

    id, start, limit, mark = "residue_film", 0.005, 2.0, True

    def pattern(self) -> np.ndarray:
        at = self.rig.at
        x, y = self.rng.uniform(-6, 6, 2)
        wide, high, turn = *self.rng.uniform(2.5, 6, 2), self.rng.uniform(0, np.pi)
        dx, dy = at.x - x, at.y - y
        r2 = ((dx * np.cos(turn) + dy * np.sin(turn)) / wide) ** 2 + (
            (dy * np.cos(turn) - dx * np.sin(turn)) / high
        ) ** 2
        return 1 / (1 + r2) ** 1.5 * (1 if self.form == 0 else r2 / (0.3 + r2))


class LateralGlow(Hidden):
    """Light wanders in the silicone: part of it is spread by two Gaussians."""

    id, start, limit = "lateral_glow", 0.005, 0.9

    def draw(self) -> None:
        narrow, wide = (self.rng.uniform(0.2, 0.35), self.rng.uniform(0.7, 1.1))
        if self.plain:
            narrow, wide = 0.3 * narrow, 0.15 * wide
        share = 0.6 if self.form == 0 else 0.4
        mm = self.rig.at.mm_per_px
        self.parts = ((share, narrow / mm), (1 - share, wide / mm))

    def light(self, fine: np.ndarray, view: View, a: float) -> np.ndarray:
        if not view.touches:
            return fine
        # Wide kernels on every fourth pixel: what they leave is smoother than that by far.
        spread = np.zeros_like(fine, dtype=float)
        for share, sigma in self.parts:
            spread += share * ndimage.gaussian_filter(fine, sigma, truncate=3.0)
        return fine + a * (spread - fine)


class Pressing(Hidden):
    """A change of the contact's size, as if another force pressed."""

    def light(self, fine: np.ndarray, view: View, a: float) -> np.ndarray:
        return fine


class Modulus(Pressing):
    """The silicone is softer or harder than believed, and hardens a little with load (form 1: softens)."""

    id, start, limit, signs = "modulus", 0.01, 0.5, (1, -1)

    def draw(self) -> None:
        self.sign = float(self.rng.choice(self.signs))

    def log_force(self, view: View, a: float) -> float:
        if not view.touches:
            return 0.0
        strain = (view.shot.force_N / max(self.rig.base.forces)) ** (1 / 3)
        return self.sign * a * (1 + (-0.2 if self.form == 0 else 0.2) * strain)

    def parameter(self, a: float) -> tuple[str, float]:
        strain = float(np.mean(np.linspace(1 / 6, 1, 6) ** (1 / 3)))
        return "relative", float(np.exp(-self.sign * a * (1.0 + (-0.2 if self.form == 0 else 0.2) * strain)) - 1.0)


class Adhesion(Pressing):
    """Attraction adds to the load a part that is constant and a part that goes with the contact's radius."""

    id, unit, start, limit = "adhesion", "N", 0.005, 0.5

    def log_force(self, view: View, a: float) -> float:
        if not view.touches:
            return 0.0
        force = view.shot.force_N
        grown = force ** (1 / 2) if self.form == 0 else force ** (2 / 5)
        return float(np.log1p(a * (0.35 + grown) / force))


class Creep(Pressing):
    """The contact grows as a power of the time that the load has been held (form 1: a stretched exponential)."""

    id, start, limit = "creep", 0.005, 0.5
    still = False

    def draw(self) -> None:
        self.exponent, self.tau = self.rng.uniform(0.15, 0.4), self.rng.uniform(4, 12)

    def log_force(self, view: View, a: float) -> float:
        if not view.touches:
            return 0.0
        t = view.shot.held_s / self.tau
        # By the logarithm of time it goes nearly as a line, then as one that bends down; a logarithm is the library's.
        return a * ((1 + t) ** self.exponent - 1 if self.form == 0 else 1.2 * (1 - np.exp(-((t / 4) ** 0.6))))


class BoneStiffening(Pressing):
    """The bone is felt as the tip flattens: stiffness rises with the depth squared (form 1: to the power 1.5)."""

    id, start, limit = "bone_stiffening", 0.01, 0.6

    def log_force(self, view: View, a: float) -> float:
        if not view.touches:
            return 0.0
        depth = (view.shot.force_N / max(self.rig.base.forces)) ** (2 / 3)
        return -a * depth ** (2.0 if self.form == 0 else 1.5)


class ForceOffset(Pressing):
    """The load cell's zero is off, and drifts back a little with time."""

    id, unit, start, limit, signs = "force_offset", "N", 0.003, 0.3, (1, -1)
    still = False

    def draw(self) -> None:
        self.sign = float(self.rng.choice(self.signs))

    def log_force(self, view: View, a: float) -> float:
        if not view.touches:
            return 0.0
        return float(np.log(max(1 + self.sign * a * self.drift(view.shot.time_s) / view.shot.force_N, 0.05)))

    def drift(self, time_s: float) -> float:
        """Return the share of the offset that is left."""
        return 1.0 - (0.1 if self.form == 0 else 0.2) * time_s / 200.0

    def parameter(self, a: float) -> tuple[str, float]:
        return "offset_N", -self.sign * a * self.drift(MIDDLE_S)


class LedBin(Hidden):
    """LED power against voltage is steeper or flatter than believed: a parabola of its logarithm."""

    id, start, limit, signs = "led_bin", 0.005, 0.5, (1, -1)

    def draw(self) -> None:
        self.sign = float(self.rng.choice(self.signs))

    def light(self, fine: np.ndarray, view: View, a: float) -> np.ndarray:
        if not view.lit_by_leds:
            return fine
        x = np.log(power(self.rig.name, view.shot.voltage_V))
        return fine * np.exp(self.sign * a * (x + (0.25 if self.form == 0 else -0.25) * x * x))


LIGHT = (
    LedDead, LedImbalance, SupplySag, LedWarmup, GlassAbsorption, AmbientLight, Specks, Scratch, ResidueFilm,
    LateralGlow, LedBin, Modulus, Adhesion, Creep, BoneStiffening, ForceOffset,
)  # fmt: skip

__all__ = ["LIGHT", "blurred_points"]
