"""What a change of one key of a scene does to its frame, by simulation."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from evanesce.api.camera import Camera, Shot
from evanesce.api.own_exposure import coarse_grey, largest_force
from evanesce.core.errors import InputError
from evanesce.rig import Scene
from evanesce.rig.change import changed
from evanesce.rig.explain import explained

STEP = 0.1
"""Relative change of a key."""
STEP_OF_RANGE = 0.01
"""Change of a key that is 0, over its range."""


@dataclass(frozen=True)
class KeyChange:
    """What happened.

    Attributes
    ----------
    key, unit : str
    before, after : float
        Values of the key.
    force_N : float
    area_mm2 : tuple of float
        True contact area before and after [mm^2].
    contact, beside : tuple of float
        Mean raw signal over black, in the contact and beside it, before and after [DN].
    full : bool
        Whether the contact is full in one of the two frames, so that its level says less.
    """

    key: str
    unit: str
    before: float
    after: float
    force_N: float
    area_mm2: tuple[float, float]
    contact: tuple[float, float]
    beside: tuple[float, float]
    full: bool

    def as_dict(self) -> dict[str, Any]:
        """Return JSON-able data."""
        return asdict(self)

    def sentence(self) -> str:
        """Return it in words."""
        unit = "" if self.unit == "1" else f" {self.unit}"
        more = " (full: shorten the exposure to see more)" if self.full else ""
        return (
            f"{self.key} from {self.before:g} to {self.after:g}{unit}, at {self.force_N:g} N: contact area "
            f"{self.area_mm2[0]:.3f} to {self.area_mm2[1]:.3f} mm^2 ({_percent(self.area_mm2)}), signal of the contact "
            f"{self.contact[0]:.1f} to {self.contact[1]:.1f} DN ({_percent(self.contact)}){more}, beside it "
            f"{self.beside[0]:.2f} to {self.beside[1]:.2f} DN"
        )


def _percent(pair: tuple[float, float]) -> str:
    return f"{100 * (pair[1] / pair[0] - 1):+.1f} %" if pair[0] > 0 else "from 0"


def value_at(scene: Scene, key: str) -> Any:
    """Return the value of a dotted key; None where the scene has none.

    Parameters
    ----------
    scene : Scene
    key : str
    """
    value: Any = scene.as_dict()
    for part in key.split("."):
        value = value.get(part) if isinstance(value, dict) else None
    return value


def change_of(scene: Scene, key: str) -> KeyChange:
    """Change a numeric key by a tenth and expose the scene's largest force before and after.

    Parameters
    ----------
    scene : Scene
    key : str
        Dotted.

    Returns
    -------
    KeyChange

    Raises
    ------
    InputError
        If the key is not one number, or the scene lacks it or refuses its change.
    """
    quantity = explained(key)[0].quantity
    value = value_at(scene, key)
    if quantity is None or isinstance(value, bool) or not isinstance(value, int | float):
        raise InputError("is not one number in this scene", key=key, allowed="a numeric key that the scene has")
    low, high = quantity.bounds
    step = STEP * abs(value) if value else STEP_OF_RANGE * (high - low)
    after: float = value + step if value + step <= high else value - step
    if isinstance(value, int):
        after = round(after) if round(after) != value else value + 1
    # the coarse frame's camera has other pixels: a change of the camera is made before them
    shots = [_shot(scene), _shot(changed(scene, {key: after}, file="--simulate"))]
    pairs = [_levels(shot) for shot in shots]
    return KeyChange(
        key, quantity.unit, value, after, largest_force(scene), _pair([s.truth.area_mm2 for s in shots]),
        _pair([p[0] for p in pairs]), _pair([p[1] for p in pairs]), any(p[2] for p in pairs),
    )  # fmt: skip


def _shot(scene: Scene) -> Shot:
    return Camera(coarse_grey(scene)).shoot(largest_force(scene), seed=1)


def _levels(shot: Shot) -> tuple[float, float, bool]:
    pixel = shot.scene.camera.pixel
    raw, mask = shot.raw.astype(float) - pixel.black_level_DN, shot.truth.mask
    most = 2.0**pixel.bits - 1.0 - pixel.black_level_DN
    inside = raw[mask]
    full = bool(inside.size and np.mean(inside >= 0.99 * most) > 0.01)
    return (float(inside.mean()) if inside.size else 0.0), float(raw[~mask].mean()), full


def _pair(values: list[float]) -> tuple[float, float]:
    return float(values[0]), float(values[1])
