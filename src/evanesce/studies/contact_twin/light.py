"""Light of a contact frame by cause, on the plate: each part as the renderer gives it for its cause alone."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from evanesce.contact.solve import contact_state
from evanesce.core.errors import InputError
from evanesce.core.states import ContactState
from evanesce.optics.seen import seen_at
from evanesce.render.fast.transport import render_fast
from evanesce.rig import Backdrop, Distortion, Haze, Scene, Spill, Surroundings

Array = NDArray[np.float64]
Image = NDArray[np.float32]

PX_PER_MM = 10.0
"""Of the rendered parts: four samples on a pixel of a fit in which the finger is 28 px wide."""
WIDE = 3.0
"""Side of the rendered view over the finger's diameter."""
SPILL_HEIGHT_MM, HAZE_SHARE = 1.0, 0.01
BACKDROP = Backdrop(reflectance=0.05, distance_mm=50.0)
"""A dark cloth; its level is free, only the light's fall from side to side is taken from here."""
FORCES_N = 0.05, 200.0
_STEP = 0.4  # of the force's logarithm

PARTS = ("contact", "flank", "spill", "haze", "backdrop")


@dataclass(frozen=True)
class PressLight:
    """Light of one press by cause, over the contact's mean, on a square of the plate about the finger's axis.

    Attributes
    ----------
    parts : dict of ndarray of float32 (n, n)
        ``contact``: light coupled out there. ``flank``: light that the contact scatters onto the finger beside it.
        ``spill``: what the strips spill onto the finger, for as much power as they send into the plate. ``haze``: of a
        hundredth of the guided light at the top face. ``backdrop``: a dark plane above, lit by the same spill [1].
    px_per_mm : float
    state : ContactState
    """

    parts: dict[str, Image]
    px_per_mm: float
    state: ContactState

    @property
    def contact_mm(self) -> float:
        """Radius of a disc of the contact's area [mm]."""
        return float(np.sqrt(self.state.nominal_contact_area / np.pi))

    @property
    def rim_mm(self) -> float:
        """Where the finger seems to end, on the plate [mm]: its flank lies above, farther from the camera."""
        spill = self.parts["spill"]
        rows, cols = np.indices(spill.shape) - (np.array(spill.shape) - 1)[:, None, None] / 2
        radius = np.hypot(rows, cols)
        rings = np.arange(1, spill.shape[0] // 2)
        mean = np.array([spill[np.abs(radius - r) <= 0.5].mean() for r in rings])
        outer = np.flatnonzero(mean > 0.5 * mean.max())
        return float(rings[outer[-1]] + 0.5) / self.px_per_mm if outer.size else float("nan")


def press_of(scene: Scene, ratio: float, name: str = "scene") -> tuple[float, PressLight]:
    """Return the force [N] under which the contact's radius is ``ratio`` of the finger's as it is seen, and its light.

    Parameters
    ----------
    scene : Scene
    ratio : float
        [1].
    name : str
        For errors.

    Returns
    -------
    force_N : float
    light : PressLight

    Raises
    ------
    InputError
        If no force from 0.05 to 200 N does.
    """
    rim = 0.85 * scene.finger.diameter_mm / 2
    # The rim moves little with the force: twice is enough.
    for _ in range(2):
        force = _force_for(scene, float(np.pi * (ratio * rim) ** 2), name)
        light = press_light(scene, force)
        rim = light.rim_mm
    return force, light


def _force_for(scene: Scene, area: float, name: str) -> float:
    """Return the force [N] that makes a contact of an area [mm^2]."""

    def excess(log_force: float) -> float:
        return contact_state(scene, float(np.exp(log_force))).nominal_contact_area - area

    low = float(np.log(FORCES_N[0]))
    while low < np.log(FORCES_N[1]):
        # A law may refuse a force whose contact leaves its grid or its range: go up in small steps.
        if excess(low + _STEP) >= 0:
            return float(np.exp(brentq(excess, low, low + _STEP, xtol=1e-3)))
        low += _STEP
    raise InputError(
        f"no force gives a contact of {area:.1f} mm^2 on this finger", file=name, key="finger",
        allowed=f"a contact that {FORCES_N[0]:g} to {FORCES_N[1]:g} N make",
    )  # fmt: skip


def press_light(scene: Scene, force_N: float) -> PressLight:
    """Return the light of a press by cause.

    Parameters
    ----------
    scene : Scene
        Its surroundings and effects are left out, and of its camera all but its distance: the view is straight down,
        without a lens.
    force_N : float
        [N].

    Returns
    -------
    PressLight
    """
    return _press_light(_Key(scene), round(float(force_N), 4))


class _Key:
    """A scene by what the light depends on."""

    def __init__(self, scene: Scene) -> None:
        side, camera = round(WIDE * scene.finger.diameter_mm * PX_PER_MM), scene.camera
        # Pixels that are larger by as much as the scale is smaller: the camera stays where it is.
        pixel = camera.pixel.model_copy(update={"pitch_um": camera.pixel.pitch_um * camera.scale_px_per_mm / PX_PER_MM})
        lens = camera.lens.model_copy(update={"distortion": Distortion()})
        view = {"resolution_px": (side, side), "scale_px_per_mm": PX_PER_MM, "centre_mm": scene.finger.position_mm}
        level = {"tilt_x_deg": 0.0, "tilt_y_deg": 0.0, "roll_deg": 0.0, "principal_point_offset_px": (0.0, 0.0)}
        other = {"pixel": pixel, "lens": lens, "colour": None, "auto_exposure": None}
        plain = camera.model_copy(update={**view, **level, **other})
        self.scene = seen_at(scene.model_copy(update={"camera": plain, "effects": {}, "surroundings": None}))
        self._text = repr(self.scene.as_dict())

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Key) and other._text == self._text

    def __hash__(self) -> int:
        return hash(self._text)


@lru_cache(maxsize=16)
def _press_light(key: _Key, force_N: float) -> PressLight:
    scene = key.scene
    state = contact_state(scene, force_N)
    plain, spill = _radiance(scene, state), Spill(share=1.0, height_mm=SPILL_HEIGHT_MM)
    surroundings = {
        "spill": Surroundings(spill=spill),
        "haze": Surroundings(haze=Haze(top_share=HAZE_SHARE, contrast=0.0)),
        "backdrop": Surroundings(spill=spill, backdrop=BACKDROP),
    }
    lit = {
        name: _radiance(scene.model_copy(update={"surroundings": around}), state) - plain
        for name, around in surroundings.items()
    }
    lit["backdrop"] = lit["backdrop"] - lit["spill"]
    touching = _on_view(state, scene)
    parts = {"contact": plain * (touching > 0.5), "flank": plain * (touching <= 0.5), **lit}
    level = float(plain[touching > 0.99].mean())
    images = {name: np.maximum(parts[name] / level, 0.0).astype(np.float32) for name in PARTS}
    return PressLight(images, PX_PER_MM, state)


def _radiance(scene: Scene, state: ContactState) -> Array:
    """Return the radiance on the view itself; the renderer gives a margin for the lens around it."""
    found, side = np.asarray(render_fast(scene, state).radiance, np.float64), scene.camera.resolution_px[0]
    margin = (found.shape[0] - side) // 2
    return found[margin : margin + side, margin : margin + side]


def _on_view(state: ContactState, scene: Scene) -> Array:
    """Return the share of each pixel of the view that is in contact."""
    side = scene.camera.resolution_px[0]
    middle = (np.arange(side) - (side - 1) / 2) / PX_PER_MM
    centre = scene.finger.position_mm
    x, y = np.meshgrid(middle + centre[0], middle + centre[1])
    row, col = state.grid.index(x, y)
    mask: Any = np.asarray(state.contact_mask, np.float32)
    return np.asarray(cv2.remap(mask, col.astype(np.float32), row.astype(np.float32), cv2.INTER_LINEAR), np.float64)
