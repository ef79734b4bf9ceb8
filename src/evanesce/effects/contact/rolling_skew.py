"""Rolling shutter while the contact moves or grows: a patch that is skewed and stretched.

The chain has one contact state per frame. This effect moves each point of it to where it was when the row that sees it
was exposed, to first order: a steady velocity and a steady growth about the finger's tip.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from evanesce.core.quantities import Strict, field
from evanesce.core.states import ContactState, PlateGrid
from evanesce.effects.protocol import Context, Effect, Stage
from evanesce.optics.projection import Projection
from evanesce.rig import Scene


class Parameters(Strict):
    """Motion of the contact in view, and readout time."""

    velocity_x_mm_per_s: float = field(
        0.0, unit="mm/s", bounds=(-100.0, 100.0), null=0.0, doc="of the contact over the glass, to the image's right"
    )
    velocity_y_mm_per_s: float = field(0.0, unit="mm/s", bounds=(-100.0, 100.0), null=0.0, doc="downwards")
    growth_per_s: float = field(
        0.0, unit="1/s", bounds=(-10.0, 10.0), null=0.0, doc="of lengths about the tip; under Hertz a third of F'/F"
    )
    readout_ms: float = field(
        22.75,
        unit="ms",
        bounds=(0.0, 1000.0),
        source="IMX477, 2028 x 1520 mode: lines of 12740 clocks at 840 MHz, 1500 of them",
        doc="from the first row's exposure to the last row's; 0: a global shutter",
    )


AMPLITUDES = ("velocity_x_mm_per_s", "velocity_y_mm_per_s", "growth_per_s")


def apply(state: ContactState, parameters: Parameters, context: Context) -> ContactState:
    """Sample each point of the state where its material was at mid-frame; force and true area are kept.

    Parameters
    ----------
    state : ContactState
    parameters : Parameters
    context : Context

    Returns
    -------
    ContactState
    """
    if all(getattr(parameters, name) == 0.0 for name in AMPLITUDES) or parameters.readout_ms == 0.0:
        return state
    scene, grid = context.scene, state.grid
    late_s = lateness(scene, grid, parameters.readout_ms * 1e-3)
    shrink = 1.0 - parameters.growth_per_s * late_s
    tip_x, tip_y = scene.finger.position_mm
    x = tip_x + (grid.x[None, :] - tip_x) * shrink - parameters.velocity_x_mm_per_s * late_s
    y = tip_y + (grid.y[:, None] - tip_y) * shrink - parameters.velocity_y_mm_per_s * late_s
    row, col = (index.astype(np.float32) for index in grid.index(x, y))

    def moved(values: Any, how: int = cv2.INTER_LINEAR) -> NDArray[Any]:
        array = np.asarray(values)
        if array.ndim == 3:
            return np.stack([moved(part, how) for part in array])
        return cv2.remap(array, col, row, how, borderMode=cv2.BORDER_REPLICATE)

    found: dict[str, Any] = {name: moved(getattr(state, name)) for name in ("pressure", "gap", "contact_mask")}
    for name in ("traction", "slip", "real_contact_fraction", "wetted"):
        if getattr(state, name) is not None:
            found[name] = moved(getattr(state, name))
    if state.state is not None:
        found["state"] = moved(state.state, cv2.INTER_NEAREST)
    return replace(state, **found)


def lateness(scene: Scene, grid: PlateGrid, readout_s: float) -> NDArray[np.float64]:
    """Return how long after the frame's middle the row that sees each point of the grid is exposed [s].

    The camera's geometry at the grid's middle, straight from there: distortion bends rows by some per cent.

    Parameters
    ----------
    scene : Scene
    grid : PlateGrid
    readout_s : float
        From the first row's exposure to the last row's [s].

    Returns
    -------
    ndarray (rows, cols)
        [s].
    """
    projection, step = Projection.of(scene.camera, scene.plate), 0.1
    x0, y0 = grid.centre
    _, v = projection.to_image(np.array([x0, x0 + step, x0]), np.array([y0, y0, y0 + step]))
    rows = projection.shape[0]
    row = v[0] + (grid.x - x0)[None, :] * (v[1] - v[0]) / step + (grid.y - y0)[:, None] * (v[2] - v[0]) / step
    return np.asarray((row - (rows - 1) / 2) / rows * readout_s)


EFFECT = Effect(
    id="rolling_skew",
    stage=Stage.CONTACT,
    parameters=Parameters,
    amplitudes=AMPLITUDES,
    apply=apply,
    null_when="all",
    # The thesis slides at 1 to 25 mm/s and presses within some seconds.
    fitted={"velocity_x_mm_per_s": 5.0, "velocity_y_mm_per_s": 5.0, "growth_per_s": 0.3},
    # A steady velocity in frames of a finger that stands would carry it out of view.
    needs=("press", "motion"),
    scaling="shear and stretch of the patch that go with its speed; none at rest, none of what lies on the glass",
)
