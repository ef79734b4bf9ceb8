"""Recipes of the contact: by how much another force would press alike."""

from __future__ import annotations

import numpy as np

from ..hidden import Hidden
from ..rig import View


class Pressing(Hidden):
    """A change of the logarithm of the force, in views in which the finger touches."""

    signs = (1,)

    def draw(self) -> None:
        self.sign = float(self.rng.choice(self.signs))
        self.shape()

    def shape(self) -> None:
        """Draw the law's figures."""

    def share(self, view: View) -> float:
        """Return the force over the largest."""
        return view.shot.force_N / max(self.rig.base.forces)

    def law(self, view: View, a: float) -> float:
        """Return the change of the logarithm of the force."""
        raise NotImplementedError

    def log_force(self, view: View, a: float) -> float:
        return float(self.law(view, a)) if view.touches else 0.0


class Modulus(Pressing):
    """A filled rubber whose modulus falls with strain from one plateau towards another.

    Kraus, J. Appl. Polym. Sci. Appl. Polym. Symp. 39 (1984) 75 (Payne effect): 1 / (1 + (strain/critical)^2m). Strain
    of a sphere goes as the contact's radius.
    """

    id, start, limit, signs = "modulus", 0.01, 0.5, (1, -1)

    def shape(self) -> None:
        self.critical, self.part = self.rng.uniform(0.4, 1.2), self.rng.uniform(0.1, 0.3)

    def softer(self, share: float) -> float:
        return 1 - self.part + self.part / (1 + share ** (1 / 3) / self.critical)

    def law(self, view: View, a: float) -> float:
        return self.sign * a * self.softer(self.share(view))

    def parameter(self, a: float) -> tuple[str, float]:
        mean = float(np.mean([self.softer(s) for s in np.linspace(1 / 6, 1, 6)]))
        return "relative", float(np.exp(-self.sign * a * mean) - 1)


class Adhesion(Pressing):
    """Between soft and stiff limits of adhesion: a^3 ~ F_ad (alpha + sqrt(1 + F/F_ad))^2.

    Carpick, Ogletree and Salmeron, J. Colloid Interface Sci. 211 (1999) 395, eq. 12a.
    """

    id, unit, start, limit = "adhesion", "N", 0.002, 0.5

    def shape(self) -> None:
        self.alpha = self.rng.uniform(0.2, 0.7)

    def law(self, view: View, a: float) -> float:
        force = view.shot.force_N
        return float(np.log((np.sqrt(a) * self.alpha + np.sqrt(a + force)) ** 2 / force))


class Creep(Pressing):
    """Compliance of a Prony series of two times.

    Ferry, Viscoelastic Properties of Polymers, 3rd ed. 1980, ch. 1 (retardation spectrum).
    """

    id, start, limit = "creep", 0.005, 0.5
    still = False

    def shape(self) -> None:
        self.times = self.rng.uniform(3, 10), self.rng.uniform(40, 120)
        self.first = self.rng.uniform(0.3, 0.7)

    def law(self, view: View, a: float) -> float:
        short, long = (1 - np.exp(-view.shot.held_s / t) for t in self.times)
        return float(np.log1p(a * (self.first * short + (1 - self.first) * long)))


class BoneStiffening(Pressing):
    """Tissue on a core: stiffness grows exponentially with the depth.

    Fung, Biomechanics: Mechanical Properties of Living Tissues, 2nd ed. 1993, sec. 7.5.
    """

    id, start, limit = "bone_stiffening", 0.01, 0.6

    def shape(self) -> None:
        self.rate = self.rng.uniform(1.5, 4.0)

    def law(self, view: View, a: float) -> float:
        return -a * float(np.expm1(self.rate * self.share(view) ** (2 / 3)) / np.expm1(self.rate))


class ForceOffset(Pressing):
    """A load cell's zero that returns exponentially after it was loaded.

    OIML R 60 (2017), secs 3.7 and 5.6 (minimum dead load output return).
    """

    id, unit, start, limit, signs = "force_offset", "N", 0.003, 0.3, (1, -1)
    still = False

    def shape(self) -> None:
        self.tau, self.part = self.rng.uniform(40, 120), self.rng.uniform(0.05, 0.2)

    def left(self, time_s: float) -> float:
        return float(1 - self.part * (1 - np.exp(-time_s / self.tau)))

    def law(self, view: View, a: float) -> float:
        return float(np.log(max(1 + self.sign * a * self.left(view.shot.time_s) / view.shot.force_N, 0.05)))

    def parameter(self, a: float) -> tuple[str, float]:
        return "offset_N", -self.sign * a * float(np.mean([self.left(t) for t in np.linspace(0, 150, 16)]))


class OffAxisLoad(Hidden):
    """A holder that bends as a cantilever once its play is taken up: straight in force beyond a threshold.

    Timoshenko, Strength of Materials, 1955, part I, sec. 40 (deflection of a cantilever).
    """

    id, unit, start, limit = "off_axis_load", "mm", 0.01, 1.5

    def draw(self) -> None:
        angle = self.rng.uniform(0, 2 * np.pi)
        self.way, self.play = (np.cos(angle), np.sin(angle)), self.rng.uniform(0.0, 0.15)

    def shift_mm(self, view: View, a: float) -> tuple[float, float]:
        if not view.touches:
            return 0.0, 0.0
        bent = a * max(view.shot.force_N / max(self.rig.base.forces) - self.play, 0.0) / (1 - self.play)
        return bent * self.way[0], bent * self.way[1]


CONTACT = (Modulus, Adhesion, Creep, BoneStiffening, ForceOffset, OffAxisLoad)
