"""What a hidden cause is: places of the chain where it may change things, all absent at amplitude 0."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from evanesce.rig import Scene

from .camera import Electronics, Knee
from .rig import BaseLight, Geometry, View


@dataclass(frozen=True)
class Rig:
    """What a hidden cause may look at.

    Attributes
    ----------
    name : str
        Of the nominal rig.
    pose : int
        Of its pool.
    scene : Scene
        Believed, with the finger at its real pose.
    base : BaseLight
    at : Geometry
    electronics : Electronics
    views : tuple of View
    """

    name: str
    pose: int
    scene: Scene
    base: BaseLight
    at: Geometry
    electronics: Electronics
    views: tuple[View, ...]

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the frame [px]."""
        cols, rows = self.scene.camera.resolution_px
        return rows, cols

    @property
    def finger_mm(self) -> tuple[float, float]:
        """Place of the finger's tip on the plate [mm]."""
        x, y = self.scene.finger.position_mm
        return x + self.base.pose_mm[0], y + self.base.pose_mm[1]

    def seen_from(self, fine: np.ndarray, u: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return a picture in which each pixel shows what stood at (u, v), as bright as things are where it is now."""
        plain, half = self.base.cards["plain"], np.hypot(*fine.shape) / 2
        row, col = np.mgrid[: fine.shape[0], : fine.shape[1]].astype(float)
        place = [row + half * (v - self.at.v), col + half * (u - self.at.u)]
        return plain * ndimage.map_coordinates(fine / plain, place, order=3, mode="nearest")

    @property
    def contact_level(self) -> float:
        """Irradiance of a contact at the believed voltage [W mm^-2]."""
        return float(np.percentile(self.base.press[-1][self.base.press[-1] > 0.5 * self.base.press[-1].max()], 50))


class Hidden:
    """A cause; subclasses override the places at which they act.

    Parameters
    ----------
    rng : numpy.random.Generator
        Of the shape; the strength is set apart.
    rig : Rig
    form : int
        0 in development cases, 1 in scored ones: another functional family or another range. Recipes have one form.
    plain : bool
        Without what would give it away beside its decoy: ambient light even, glow narrow, a vignette with a slope.
    """

    id = ""
    unit = "1"
    start = 0.01
    limit = 1.0
    signs = (1,)
    still = True  # two views of one kind, force and voltage look alike whatever their time
    mark = False  # seen on single pixels: its strength is that of a matched filter on the full frame

    def __init__(self, rng: np.random.Generator, rig: Rig, form: int, plain: bool = False) -> None:
        self.rng, self.rig, self.form, self.plain = rng, rig, form, plain
        self._kept: dict[object, np.ndarray] = {}
        self.draw()

    def kept(self, key: object, make: Callable[[], np.ndarray]) -> np.ndarray:
        """Return a map that the last few calls have in common."""
        if key not in self._kept:
            if len(self._kept) > 12:
                self._kept.clear()
            self._kept[key] = make()
        return self._kept[key]

    def draw(self) -> None:
        """Draw the shape's parameters."""

    def parameter(self, a: float) -> tuple[str, float] | None:
        """Return the library's parameter that is this cause's own amount, and its value; None where there is none."""
        return None

    def log_force(self, view: View, a: float) -> float:
        """Return the change of the logarithm of the force that really presses."""
        return 0.0

    def shift_mm(self, view: View, a: float) -> tuple[float, float]:
        """Return the shift of the contact on the plate [mm]."""
        return 0.0, 0.0

    def light(self, fine: np.ndarray, view: View, a: float) -> np.ndarray:
        """Change the irradiance of the fine frame [W mm^-2]; not called where the lens is covered."""
        return fine

    def charge(self, charge_e: np.ndarray, view: View, a: float) -> np.ndarray:
        """Change the mean charge of the frame's pixels [e-]."""
        return charge_e

    def offset_DN(self, view: View, a: float) -> np.ndarray | float:
        """Return what is added to the raw numbers [DN]."""
        return 0.0

    def curve(self, curve: np.ndarray, a: float) -> np.ndarray:
        """Change the tone curve, 0 to 1 by raw number."""
        return curve

    def knee(self, a: float) -> Knee | None:
        """Return where and how sharply pixels fill up; None where they do as believed."""
        return None
