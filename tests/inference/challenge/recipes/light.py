"""Recipes of LEDs, glass, and what lies on it."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from evanesce.optics.led import led_positions

from ..hidden import Hidden
from ..rig import View, power
from .camera import convolved


class Fans(Hidden):
    """LEDs of other powers, each a fan of guided light in one plane: cos / distance from its place on the edge.

    Light that a slab guides spreads in two dimensions, so that its flux per width falls with the distance: Snyder and
    Love, Optical Waveguide Theory, 1983, ch. 35.
    """

    def draw(self) -> None:
        self.shape()
        before, lost = 0.0, 0.0
        for edge, n, _, fan in self.fans():
            before = before + fan
            lost = lost + self.loss_of(edge, n) * fan
        self.loss = lost / before

    def fans(self):
        """Yield edge, place along it (0 to 1), distance [mm] and light at each pixel of every LED."""
        at, plate = self.rig.at, self.rig.scene.plate
        half = {"left": (-1, 0), "right": (1, 0), "top": (0, -1), "bottom": (0, 1)}
        width, height = plate.size_mm
        for edge, positions in led_positions(plate, self.rig.scene.leds).items():
            sx, sy = half[edge]
            for place in np.asarray(positions):
                x0, y0 = (sx * width / 2, place) if sx else (place, sy * height / 2)
                distance = np.hypot(at.x - x0, at.y - y0)
                inward = np.abs((at.x - x0) * sx + (at.y - y0) * sy)
                yield (
                    edge,
                    float((place - min(positions)) / max(np.ptp(positions), 1e-9)),
                    distance,
                    inward / (distance**2),
                )

    def shape(self) -> None:
        """Draw which LEDs."""

    def loss_of(self, edge: str, along: float) -> float:
        """Return the relative loss of an LED at a share of its edge's length."""
        raise NotImplementedError

    def strength(self, view: View) -> float:
        """Return by how much more the loss is than at the nominal voltage."""
        return 1.0

    def light(self, fine: np.ndarray, view: View, a: float) -> np.ndarray:
        return fine * (1 - a * self.strength(view) * self.loss) if view.lit_by_leds else fine


class LedDead(Fans):
    """One segment, two to four LEDs of an edge, out by the same share (strips are wired in segments)."""

    id, start, limit = "led_dead", 0.2, 1.0

    def shape(self) -> None:
        edges = led_positions(self.rig.scene.plate, self.rig.scene.leds)
        self.edge = str(self.rng.choice(sorted(edges)))
        count = len(edges[self.edge])
        wide = int(self.rng.integers(2, min(5, count)))
        first = int(self.rng.integers(0, count - wide + 1))
        self.span = (first - 0.5) / max(count - 1, 1), (first + wide - 0.5) / max(count - 1, 1)

    def loss_of(self, edge: str, along: float) -> float:
        return 1.0 if edge == self.edge and self.span[0] < along < self.span[1] else 0.0


class LedImbalance(Hidden):
    """Shading: a plane and a little of a saddle over the frame.

    Likar, Maintz, Viergever and Pernus, J. Microsc. 197 (2000) 285, eq. 3 (polynomials of second order).
    """

    id, start, limit = "led_imbalance", 0.02, 0.9

    def draw(self) -> None:
        angle, saddle = self.rng.uniform(0, 2 * np.pi), self.rng.uniform(-0.3, 0.3)
        at = self.rig.at
        self.map = at.u * np.cos(angle) + at.v * np.sin(angle) + saddle * at.u * at.v

    def light(self, fine: np.ndarray, view: View, a: float) -> np.ndarray:
        return fine * np.maximum(1 + a * self.map, 0) if view.lit_by_leds else fine


class SupplySag(Fans):
    """A strip fed at one end: a line of resistance with a load all along it, cosh((1 - s)/l) / cosh(1/l).

    Sunde, Earth Conduction Effects in Transmission Systems, 1949, ch. 8 (ladder of series and shunt resistance).
    """

    id, start, limit = "supply_sag", 0.05, 1.0

    def shape(self) -> None:
        self.length = self.rng.uniform(0.5, 1.2)

    def loss_of(self, edge: str, along: float) -> float:
        return float(1 - np.cosh((1 - along) / self.length) / np.cosh(1 / self.length))

    def strength(self, view: View) -> float:
        return power(self.rig.name, view.shot.voltage_V)


class LedWarmup(Hidden):
    """Light falls with the junction's and the board's temperature: two exponentials.

    JEDEC JESD51-14 (2010), annex (thermal time constants); Schubert, Light-Emitting Diodes, 2nd ed. 2006, sec. 5.5.
    """

    id, start, limit = "led_warmup", 0.01, 0.6
    still = False

    def draw(self) -> None:
        self.times, self.first = (self.rng.uniform(2, 8), self.rng.uniform(40, 120)), self.rng.uniform(0.2, 0.5)

    def light(self, fine: np.ndarray, view: View, a: float) -> np.ndarray:
        if not view.lit_by_leds:
            return fine
        short, long = (1 - np.exp(-view.shot.time_s / t) for t in self.times)
        return fine * (1 - a * (self.first * short + (1 - self.first) * long))


class GlassAbsorption(Fans):
    """Each LED's fan pays exp(-a d) for its own distance: Bouguer's law (Born and Wolf, Principles of Optics, 14.1)."""

    id, unit, start, limit = "glass_absorption", "1/mm", 1e-4, 0.05

    def draw(self) -> None:
        at = self.rig.at
        self.every = [(d[::8, ::8], fan[::8, ::8]) for _, _, d, fan in self.fans()]
        self.step = [np.arange(n) / 8 for n in at.u.shape]

    def light(self, fine: np.ndarray, view: View, a: float) -> np.ndarray:
        if not view.lit_by_leds:
            return fine
        kept = sum(f * np.exp(-a * d) for d, f in self.every) / sum(f for _, f in self.every)
        place = np.meshgrid(*self.step, indexing="ij")
        return fine * ndimage.map_coordinates(kept, place, order=1, mode="nearest")


class AmbientLight(Hidden):
    """A lamp to one side: its light falls as h^3 / (h^2 + d^2)^(3/2).

    Walsh, Photometry, 3rd ed. 1958, ch. 5 (cosine cubed law).
    """

    id, start, limit = "ambient_light", 1e-3, 0.5

    def draw(self) -> None:
        angle, away, height = self.rng.uniform(0, 2 * np.pi), self.rng.uniform(0.3, 1.5), self.rng.uniform(1.2, 3.0)
        at = self.rig.at
        d2 = (at.u - away * np.cos(angle)) ** 2 + (at.v - away * np.sin(angle)) ** 2
        veil = (1 + d2 / height**2) ** -1.5
        self.map = np.ones_like(at.u) if self.plain else veil / veil.mean()

    def light(self, fine: np.ndarray, view: View, a: float) -> np.ndarray:
        return fine if view.is_card else fine + a * self.rig.contact_level * self.map


class Marked(Hidden):
    """What scatters guided light on the glass."""

    mark = True

    def light(self, fine: np.ndarray, view: View, a: float) -> np.ndarray:
        if not view.lit_by_leds:
            return fine
        return fine + a * self.rig.contact_level * power(self.rig.name, view.shot.voltage_V) * self.map


class Specks(Marked):
    """Grains of log-normal diameters, as bright as their area, each as wide as it is.

    Hinds, Aerosol Technology, 2nd ed. 1999, ch. 4 (diameters); Bohren and Huffman, Absorption and Scattering of Light
    by Small Particles, 1983, sec. 4.4.3 (large grains scatter as their area).
    """

    id, start, limit = "specks", 0.5, 500.0

    def draw(self) -> None:
        shape = self.rig.at.u.shape
        self.map = np.zeros(shape)
        for _ in range(int(self.rng.integers(15, 50))):
            radius = self.rng.lognormal(0.0, 0.45)
            row, col = self.rng.integers(8, shape[0] - 8), self.rng.integers(8, shape[1] - 8)
            y, x = np.mgrid[-8:9, -8:9]
            blob = np.exp(-0.5 * (x * x + y * y) / (0.8 + radius**2))
            self.map[row - 8 : row + 9, col - 8 : col + 9] += 0.05 * radius**2 * blob / blob.sum() * 20


class Scratch(Marked):
    """A straight line of chips with gaps between them, as wide as one pixel, whose brightness wanders.

    MIL-PRF-13830B, appendix C, and Young, Appl. Opt. 25 (1986) 1922: what is seen of a scratch comes from its chips.
    """

    id, start, limit = "scratch", 0.05, 30.0

    def draw(self) -> None:
        shape = self.rig.at.u.shape
        x, y = shape[1] * self.rng.uniform(0.3, 0.7), shape[0] * self.rng.uniform(0.3, 0.7)
        angle, length = self.rng.uniform(0, np.pi), self.rng.uniform(0.25, 0.5) * shape[1]
        s = np.arange(-length / 2, length / 2, 0.5)
        bright = np.exp(ndimage.gaussian_filter1d(self.rng.standard_normal(s.size), 10) * 4)
        bright[ndimage.gaussian_filter1d(self.rng.standard_normal(s.size), 12) > 0.12] = 0.0
        row, col = (np.rint(v).astype(int) for v in (y + s * np.sin(angle), x + s * np.cos(angle)))
        inside = (row >= 0) & (row < shape[0]) & (col >= 0) & (col < shape[1])
        line = np.zeros(shape)
        np.add.at(line, (row[inside], col[inside]), bright[inside])
        self.map = ndimage.gaussian_filter(line, 0.9)


class ResidueFilm(Marked):
    """A smear whose thickness has a spectrum of power law, within a soft outline.

    Church, Appl. Opt. 27 (1988) 1518 (fractal surface finish).
    """

    id, start, limit = "residue_film", 0.005, 2.0

    def draw(self) -> None:
        at = self.rig.at
        shape, power_law = at.u.shape, self.rng.uniform(1.2, 2.0)
        f = np.hypot(np.fft.fftfreq(shape[0])[:, None], np.fft.rfftfreq(shape[1])[None, :])
        f[0, 0] = np.inf
        noise = self.rng.standard_normal(f.shape) + 1j * self.rng.standard_normal(f.shape)
        field = np.fft.irfft2(noise * f**-power_law, shape)
        field = 1 + 0.5 * field / field.std()
        x, y = self.rng.uniform(-5, 5, 2)
        wide, high = self.rng.uniform(3, 7, 2)
        self.map = np.maximum(field, 0) * np.exp(-((((at.x - x) / wide) ** 2 + ((at.y - y) / high) ** 2) ** 1.5))


class LateralGlow(Hidden):
    """Light that leaves the silicone beside where it entered: the dipole of diffusion.

    Farrell, Patterson and Wilson, Med. Phys. 19 (1992) 879, eq. 14: two sources at depths z and -(z + 2 zb).
    """

    id, start, limit = "lateral_glow", 0.005, 0.9

    def draw(self) -> None:
        free, effective = self.rng.uniform(0.15, 0.4), self.rng.uniform(0.6, 1.5)  # mm, 1/mm
        if self.plain:
            free, effective = 0.3 * free, 5.0 * effective
        mm = self.rig.at.mm_per_px
        reach = int(np.ceil(4.0 / effective / mm))
        x, y = np.meshgrid(*(np.arange(-reach, reach + 1) * mm,) * 2)
        total = 0.0
        for depth in (free, free * (1 + 4 / 3 * 2.5)):
            r = np.sqrt(x * x + y * y + depth**2)
            total = total + depth * (effective + 1 / r) * np.exp(-effective * r) / r**2
        self.kernel = total / np.sum(total)

    def light(self, fine: np.ndarray, view: View, a: float) -> np.ndarray:
        return fine + a * (convolved(fine, self.kernel) - fine) if view.touches else fine


class LedBin(Hidden):
    """Another forward voltage behind the same resistor: power goes as V - V0.

    Schubert, Light-Emitting Diodes, 2nd ed. 2006, sec. 4.3 (current of a diode behind a resistor).
    """

    id, start, limit, signs = "led_bin", 0.005, 0.5, (1, -1)

    def draw(self) -> None:
        self.sign = float(self.rng.choice(self.signs))
        self.threshold = self.rng.uniform(0.87, 0.90)

    def light(self, fine: np.ndarray, view: View, a: float) -> np.ndarray:
        if not view.lit_by_leds:
            return fine
        ratio = view.shot.voltage_V / self.rig.scene.leds.voltage_V
        other = self.threshold + self.sign * 0.05 * a
        return (
            fine * max((ratio - other) / (1 - other), 0.0) / max((ratio - self.threshold) / (1 - self.threshold), 1e-3)
        )


LIGHT = (
    LedDead, LedImbalance, SupplySag, LedWarmup, GlassAbsorption, AmbientLight, Specks, Scratch, ResidueFilm,
    LateralGlow, LedBin,
)  # fmt: skip
