"""Frames of a contact that slides, turns and twists (:mod:`evanesce.contact.sliding.planar`), on the plate's grid."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from evanesce.contact.patch import axisymmetric_state
from evanesce.contact.sliding.planar import PlanarFrame
from evanesce.core.states import ContactState, PlateGrid, SurfaceState
from evanesce.materials.friction import InterfaceFriction

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class PlanarState:
    """A contact on the plate's grid, and its skin also where nothing touches.

    Attributes
    ----------
    state : ContactState
        Its tangential force is that of the traction on the grid.
    skin : ndarray (2, rows, cols)
        How far the piece of skin above each cell is from where the resting finger had it [mm].
    speed : ndarray (2, rows, cols)
        Of that skin over the glass; beyond the contact that of its rim [mm/s].
    """

    state: ContactState
    skin: Floats
    speed: Floats


def planar_state(
    frame: PlanarFrame,
    cells: PlateGrid,
    grid: PlateGrid,
    origin: tuple[float, float],
    friction: InterfaceFriction,
    *,
    near_gap: float = 0.01,
) -> PlanarState:
    """Put a frame on the plate's grid.

    Parameters
    ----------
    frame : PlanarFrame
    cells : PlateGrid
        On which its fields stand.
    grid : PlateGrid
    origin : tuple of float
        Plate point (x, y) of the tip before it moved [mm].
    friction : InterfaceFriction
        Of the frame's solver.
    near_gap : float
        Gap below which a surface counts as near [mm].

    Returns
    -------
    PlanarState

    Raises
    ------
    InputError
        If the contact leaves the grid.
    """
    centre = origin[0] + frame.tip[0], origin[1] + frame.tip[1]
    state = axisymmetric_state(grid, centre, frame.contact, law="hertz+planar", time=frame.time)
    mask = np.asarray(state.contact_mask, dtype=float)
    cos, sin = math.cos(frame.rotation), math.sin(frame.rotation)
    x, y = np.meshgrid(grid.x - centre[0], grid.y - centre[1])
    own_x, own_y = cos * x + sin * y, cos * y - sin * x
    row, col = (a.astype(np.float32) for a in cells.index(own_x, own_y))

    def sampled(*fields: Floats) -> Floats:
        layers = np.dstack(fields).astype(np.float32)  # at most four
        found = cv2.remap(layers, col, row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        return np.asarray(np.atleast_3d(found).transpose(2, 0, 1), dtype=float)

    ratio_x, ratio_y, weakened, stick = sampled(*frame.ratio, frame.weakened, frame.stick)
    skin_x, skin_y, *slip = sampled(*frame.skin, *frame.slip)
    velocity = sampled(*frame.velocity)
    strength = weakened * (friction.tau0 * mask + friction.alpha * np.maximum(np.asarray(state.pressure), 0.0))
    traction = strength * np.stack([cos * ratio_x - sin * ratio_y, sin * ratio_x + cos * ratio_y])
    # a piece of skin rested at its place on the finger: here, less the finger's way, plus what the glass holds it back
    skin = np.stack([x + frame.tip[0] - own_x - skin_x, y + frame.tip[1] - own_y - skin_y])
    touched, moves = mask > 0.0, stick <= 0.0
    surface = np.where(np.asarray(state.gap) < near_gap, np.uint8(SurfaceState.NEAR), np.uint8(SurfaceState.NONE))
    touching = mask >= 0.5
    surface[touching] = np.where(moves[touching], np.uint8(SurfaceState.SLIP), np.uint8(SurfaceState.STICK))
    force = traction.sum(axis=(1, 2)) * grid.pitch**2
    made = replace(
        state, traction=traction, strength=strength, slip=np.stack(slip) * touched,
        slip_velocity=velocity * (touched & moves), state=surface, tangential_force=(float(force[0]), float(force[1])),
    )  # fmt: skip
    return PlanarState(made, skin, velocity)
