"""The fingers that the studies press on a scene's rig: both materials, smooth and ridged, clear and scattering."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from evanesce.core.errors import InputError
from evanesce.rig import Scene, load_scene
from evanesce.studies.voltage.sources import study_scene

MATERIALS = ("silskin_0", "silskin_20")


@dataclass(frozen=True)
class Finger:
    """A finger of the studies.

    Attributes
    ----------
    material : str
    ridged : bool
    scattering : bool
        With what the thesis does not state and its photographs show: subsurface scattering in the silicone, and specks
        on the glass (:func:`evanesce.studies.voltage.sources.study_scene`).
    """

    material: str
    ridged: bool
    scattering: bool

    @property
    def name(self) -> str:
        """Surface and scattering in words, for tables."""
        return ("ridged" if self.ridged else "smooth") + (", scattering and specks" if self.scattering else "")

    def on(self, scene: Scene) -> Scene:
        """Return a scene with this finger, pressed without a slide.

        Parameters
        ----------
        scene : Scene

        Returns
        -------
        Scene
        """
        ridges = (scene.finger.ridges or load_scene("thesis_ridged").finger.ridges) if self.ridged else None
        finger = scene.finger.model_copy(update={"material": self.material, "ridges": ridges})
        # sources and assumptions concern the scene's own finger
        found = scene.model_copy(update={"finger": finger, "slide": None, "sources": {}, "assumptions": {}})
        return study_scene(found)[0] if self.scattering else found


def every_finger() -> Iterator[Finger]:
    """Yield each finger of the studies.

    Yields
    ------
    Finger
    """
    for material in MATERIALS:
        for ridged in (False, True):
            for scattering in (False, True):
                yield Finger(material, ridged, scattering)


def check_studied(scene: Scene) -> None:
    """Refuse a scene whose effects or finger the studies would have to change.

    Parameters
    ----------
    scene : Scene

    Raises
    ------
    InputError
        If it has effects or a slide.
    """
    if scene.effects:
        raise InputError(
            f"{', '.join(sorted(scene.effects))}", key="effects", allowed="none: the studies add their own"
        )
    if scene.slide is not None:
        raise InputError("the scene slides", key="slide", allowed="a scene that presses; the time study slides it")
