"""What is lit beside the contact: light that the strips spill above the plate, haze on its faces, a backdrop above."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from evanesce.core.quantities import Strict, field

if TYPE_CHECKING:
    from evanesce.rig.scene import Scene


class Spill(Strict):
    """Light of the strips that does not enter the plate: an upright band above each edge, in front of each LED."""

    share: float = field(
        0.0,
        unit="1",
        bounds=(0.0, 10.0),
        null=0.0,
        doc="power that each LED sends above the plate, over what it sends into the plate; not published",
    )
    height_mm: float = field(
        1.0,
        unit="mm",
        bounds=(0.05, 20.0),
        source="a strip 8 mm wide, centred on an edge of 6 mm, stands over it by 1 mm; one of 10 mm by 2 mm",
        doc="upper end of the band above the top face",
    )


class HazeShares(Strict):
    """Fine dust and grease on both faces, in optical contact with the glass: scattered shares, and how cloudy."""

    top_share: float = field(
        0.0, unit="1", bounds=(0.0, 0.5), null=0.0, doc="of the guided irradiance, scattered by the top face"
    )
    bottom_share: float = field(
        0.0, unit="1", bounds=(0.0, 0.5), null=0.0, doc="of the guided irradiance, scattered by the bottom face"
    )
    contrast: float = field(
        0.4, unit="1", bounds=(0.0, 3.0), doc="standard deviation of the haze over its mean: how cloudy it is; assumed"
    )
    correlation_mm: float = field(
        2.5, unit="mm", bounds=(0.2, 100.0), doc="distance over which its correlation falls to exp(-1/2)"
    )


class Haze(HazeShares):
    """Haze with its pattern."""

    pattern: int = field(0, unit="1", bounds=(0, 2**31), doc="number of the pattern that is drawn")


class Backdrop(Strict):
    """A plane parallel to the plate above it, such as a cloth or a ceiling, of diffuse reflectance."""

    reflectance: float = field(
        0.0, unit="1", bounds=(0.0, 1.0), null=0.0, doc="diffuse; a black cloth has 0.01 to 0.05, a wall 0.5 to 0.8"
    )
    distance_mm: float = field(50.0, unit="mm", bounds=(1.0, 5000.0), doc="above the top face")


class Surroundings(Strict):
    """Everything that is lit beside the contact."""

    spill: Spill = Spill()
    haze: Haze = Haze()
    backdrop: Backdrop = Backdrop()

    @property
    def lights_empty_plate(self) -> bool:
        """Whether the camera sees any of it where there is no finger."""
        return self.haze.top_share > 0 or self.haze.bottom_share > 0 or self.backdrop.reflectance > 0


def surrounded(scene: Scene, **parts: Any) -> Scene:
    """Return a scene with some parts of its surroundings replaced.

    Parameters
    ----------
    scene : Scene
    **parts
        ``spill``, ``haze``, ``backdrop``.

    Returns
    -------
    Scene
    """
    around = (scene.surroundings or Surroundings()).model_copy(update=parts)
    return scene.model_copy(update={"surroundings": around})
