"""The fingers that the studies press on one scene's rig: both materials, smooth and ridged, clear and glowing."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from evanesce.core.errors import InputError
from evanesce.rig import Scene, load_scene
from evanesce.studies.voltage.curve import study_scene

MATERIALS = ("silskin_0", "silskin_20")


@dataclass(frozen=True)
class Finger:
    """Which finger.

    Attributes
    ----------
    material : str
    ridged : bool
    glowing : bool
        With what the thesis does not state and its photographs show: light that wanders in the silicone, and specks on
        the glass (:func:`evanesce.studies.voltage.curve.study_scene`).
    """

    material: str
    ridged: bool
    glowing: bool

    @property
    def name(self) -> str:
        """For tables."""
        return ("ridged" if self.ridged else "smooth") + (", glow and specks" if self.glowing else "")

    def on(self, scene: Scene) -> Scene:
        """Return a scene with this finger, that is pressed and does not slide."""
        ridges = (scene.finger.ridges or load_scene("thesis_ridged").finger.ridges) if self.ridged else None
        finger = scene.finger.model_copy(update={"material": self.material, "ridges": ridges})
        # sources and assumptions speak of the scene's own finger
        found = scene.model_copy(update={"finger": finger, "slide": None, "sources": {}, "assumptions": {}})
        return study_scene(found)[0] if self.glowing else found


def every_finger() -> Iterator[Finger]:
    """Yield each finger of the studies."""
    for material in MATERIALS:
        for ridged in (False, True):
            for glowing in (False, True):
                yield Finger(material, ridged, glowing)


def check_studied(scene: Scene) -> None:
    """Refuse a scene whose effects or finger the studies would have to change.

    Raises
    ------
    InputError
        If it has effects or a slide.
    """
    if scene.effects:
        raise InputError(
            f"{', '.join(sorted(scene.effects))}", key="effects", allowed="none: the studies switch their own on"
        )
    if scene.slide is not None:
        raise InputError("the scene slides", key="slide", allowed="a scene that presses; the time study slides it")
