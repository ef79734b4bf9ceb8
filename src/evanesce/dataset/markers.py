"""Marker layer: dots printed on the skin, drawn in the frames, with their positions and displacements as labels.

Ink absorbs a share of the light that the skin under it would scatter. It shows where the skin touches the glass: beside
the contact there is no light.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import model_validator

from evanesce.core.quantities import Strict, field
from evanesce.core.states import ContactState, PlateGrid
from evanesce.optics.projection import Projection
from evanesce.rig import Scene

Floats = NDArray[np.float64]

CELLS_A_DOT = 4.0
"""Least cells of the label grid across a dot."""
LEAST_TOUCHING = 0.01
"""Share of a dot that must touch for it to be listed: less than a cell of it rounds to none."""
NEWTON_STEPS = 4
"""From the nearest cell to a marker's place, to a thousandth of a cell."""


class Markers(Strict):
    """Square grid of round dots printed on the skin, one of them on the tip; without ``pitch_mm`` there is none."""

    pitch_mm: float = field(0.0, unit="mm", bounds=(0.0, 20.0), doc="between neighbours; 0: no markers")
    diameter_mm: float = field(0.4, unit="mm", bounds=(0.02, 10.0))
    absorbed: float = field(0.8, unit="1", bounds=(0.05, 1.0), doc="share of the light that ink takes")

    @model_validator(mode="after")
    def _apart(self) -> Self:
        if self.pitch_mm and self.diameter_mm > 0.8 * self.pitch_mm:
            raise ValueError(
                f"markers.diameter_mm = {self.diameter_mm:g} (allowed: at most 0.8 markers.pitch_mm,"
                f" {0.8 * self.pitch_mm:g} mm)"
            )
        return self

    def require_resolved(self, cell_mm: float) -> None:
        """Refuse dots of less than :data:`CELLS_A_DOT` cells of the label grid [mm].

        Raises
        ------
        ValueError
        """
        if self.pitch_mm and self.diameter_mm < CELLS_A_DOT * cell_mm:
            raise ValueError(
                f"markers.diameter_mm = {self.diameter_mm:g} on labels of {cell_mm:.3g} mm a sample"
                f" (allowed: at least {CELLS_A_DOT * cell_mm:.3g} mm, or more labels.grid_samples)"
            )


@dataclass(frozen=True)
class MarkedSkin:
    """Where each piece of a finger's skin is.

    Attributes
    ----------
    grid : PlateGrid
    origin : tuple of float
        Plate point (x, y) of the tip at rest [mm].
    skin : ndarray (2, rows, cols)
        How far the piece of skin above each cell is from its place at rest [mm].
    """

    grid: PlateGrid
    origin: tuple[float, float]
    skin: Floats

    @property
    def own(self) -> Floats:
        """Place of each cell's skin on the finger, from its tip [mm], (2, rows, cols)."""
        grid, (x0, y0) = self.grid, self.origin
        return np.stack([grid.x[None, :] - x0 - self.skin[0], grid.y[:, None] - y0 - self.skin[1]])


def ink_cover(marked: MarkedSkin, markers: Markers) -> Floats:
    """Return the share of each cell that ink covers, (rows, cols)."""
    pitch = markers.pitch_mm
    distance = np.hypot(*((marked.own + 0.5 * pitch) % pitch - 0.5 * pitch))
    return np.asarray(np.clip(0.5 + (0.5 * markers.diameter_mm - distance) / marked.grid.pitch, 0.0, 1.0))


def inked(state: ContactState, cover: Floats, markers: Markers) -> ContactState:
    """Return a contact as light sees it: ink takes a share of the light."""
    real = 1.0 if state.real_contact_fraction is None else np.asarray(state.real_contact_fraction, dtype=float)
    return replace(state, real_contact_fraction=real * (1.0 - markers.absorbed * cover))


def marker_labels(marked: MarkedSkin, markers: Markers, state: ContactState, scene: Scene) -> list[dict[str, Any]]:
    """Return the markers whose dots touch the glass.

    Parameters
    ----------
    marked : MarkedSkin
    markers : Markers
    state : ContactState
        On the same cells; effects may have moved its grid.
    scene : Scene
        Of the camera.

    Returns
    -------
    list of dict
        ``col``, ``row`` on the finger, from the tip; ``x_mm``, ``y_mm`` on the plate; ``u_px``, ``v_px`` in the
        distorted frame (integer: pixel centre); ``dx_mm``, ``dy_mm`` from where the resting finger had it;
        ``touching``: share of the dot in contact.
    """
    own, grid = marked.own, marked.grid
    pitch = markers.pitch_mm
    col, row = (np.arange(math.ceil(o.min() / pitch), math.floor(o.max() / pitch) + 1) for o in own)
    wanted = np.stack(np.meshgrid(col, row), axis=-1).reshape(-1, 2)
    mask = np.asarray(state.contact_mask, dtype=float)
    moved = np.subtract(state.grid.centre, grid.centre)
    projection, found = Projection.of(scene.camera, scene.plate), []
    for number in wanted:
        place = _place(own, pitch * number, grid)
        if place is None:
            continue
        touching = _touching(place, 0.5 * markers.diameter_mm, grid, mask)
        if touching < LEAST_TOUCHING:
            continue
        x, y = place + moved
        u, v = projection.to_image(np.array([x]), np.array([y]))
        dx, dy = place - np.array(marked.origin) - pitch * number
        numbers = {
            "x_mm": x, "y_mm": y, "u_px": u[0], "v_px": v[0], "dx_mm": dx, "dy_mm": dy, "touching": touching,
        }  # fmt: skip
        rounded = {name: round(float(value), 6) for name, value in numbers.items()}
        found.append({"col": int(number[0]), "row": int(number[1]), **rounded})
    return found


def _place(own: Floats, wanted: Floats, grid: PlateGrid) -> Floats | None:
    """Return the plate point [mm] above which a piece of skin is; None beyond the grid."""
    off = np.hypot(own[0] - wanted[0], own[1] - wanted[1])
    row, col = np.unravel_index(int(np.argmin(off)), off.shape)
    at, step = np.array([float(col), float(row)]), 1.0
    if off[row, col] > 2.0 * grid.pitch:
        return None
    for _ in range(NEWTON_STEPS):
        here = _sampled(own, at)
        slope = np.stack([_sampled(own, at + step * e) - _sampled(own, at - step * e) for e in np.eye(2)], axis=1)
        at = at + np.linalg.lstsq(slope / (2.0 * step), wanted - here, rcond=None)[0]
    if not (0.0 <= at[0] <= off.shape[1] - 1 and 0.0 <= at[1] <= off.shape[0] - 1):
        return None
    return np.array([grid.x[0], grid.y[0]]) + grid.pitch * at


def _sampled(fields: Floats, at: Floats) -> Floats:
    """Return fields (n, rows, cols) at fractional (col, row), bilinear in double precision."""
    col, row = np.clip(at, 0.0, np.array(fields.shape[:0:-1]) - 1.000001)
    c, r = int(col), int(row)
    right, down = col - c, row - r
    top = (1 - right) * fields[:, r, c] + right * fields[:, r, c + 1]
    bottom = (1 - right) * fields[:, r + 1, c] + right * fields[:, r + 1, c + 1]
    return np.asarray((1 - down) * top + down * bottom)


def _touching(place: Floats, radius: float, grid: PlateGrid, mask: Floats) -> float:
    """Return the share of a dot's cells that touch."""
    inside = np.hypot(grid.x[None, :] - place[0], grid.y[:, None] - place[1]) <= radius
    return float(mask[inside].mean()) if inside.any() else 0.0
