"""What a configuration leaves open, drawn about the scene's own figures."""

from __future__ import annotations

from evanesce.core.errors import InputError
from evanesce.dataset.config import DatasetConfig
from evanesce.dataset.distributions import Distribution, constant, uniform
from evanesce.rig import Scene
from evanesce.rig.change import merged
from evanesce.rig.finger import OWN
from evanesce.rig.load import validate

DRAWN_ABOUT: dict[str, tuple[float, float]] = {
    "leds.voltage_V": (8.6 / 9.0, 10.0 / 9.0),
    "camera.exposure_ms": (2.0 / 3.0, 4.0 / 3.0),
    "camera.pixel.read_noise_e": (2.0 / 3.0, 2.0),
    "camera.lens.distortion.k1": (0.42 / 0.398, 0.36 / 0.398),
}
"""Ends of what rigs draw by default, over the scene's figure: the thesis's LEDs from 8.6 V, where a contact is safely
seen, to 10 V; half a stop of light; read noise of low and high gain; a tenth of distortion."""


def about(config: DatasetConfig, scene: Scene) -> DatasetConfig:
    """Return a configuration whose rigs and fingers are the scene's where it does not name any.

    Parameters
    ----------
    config : DatasetConfig
        Keys that were given stay as they are.
    scene : Scene

    Returns
    -------
    DatasetConfig
    """
    finger, rig, own = config.finger, config.rig, scene.finger
    fingers: dict[str, Distribution] = {}
    if "tip_radius_mm" not in finger.model_fields_set:
        fingers["tip_radius_mm"] = constant(own.tip_radius_mm)
    if "material" not in finger.model_fields_set and own.material != OWN:
        fingers["material"] = constant(own.material)
    rigs = {} if "draw" in rig.model_fields_set else {"draw": _draw(scene)}
    return config.model_copy(update={"finger": finger.model_copy(update=fingers), "rig": rig.model_copy(update=rigs)})


def _draw(scene: Scene) -> dict[str, Distribution]:
    found = {}
    for key, shares in DRAWN_ABOUT.items():
        figure = _figure(scene, key)
        ends = sorted({float(f"{figure * share:.6g}") for share in shares if _possible(scene, key, figure * share)})
        if not figure or not ends:
            continue
        # An end that the scene's other figures do not allow gives way to the scene's own figure.
        low, high = min(ends[0], figure), max(ends[-1], figure)
        found[key] = uniform(low, high)
    return found


def _figure(scene: Scene, dotted: str) -> float:
    at: object = scene
    for name in dotted.split("."):
        at = getattr(at, name)
    assert isinstance(at, float | int)  # keys of the table are figures
    return float(at)


def _possible(scene: Scene, dotted: str, figure: float) -> bool:
    try:
        validate(Scene, merged(scene.as_dict(), {dotted: figure}, dotted), dotted)
    except InputError:
        return False
    return True
