"""Numbers of a frame: their names, units and meanings, and those that follow from a contact's maps."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from evanesce.core.states import ContactState, SurfaceState

SLIP_SPEED_MM_PER_S = 1e-3
"""A surface element slips where its mean speed since the frame before is at least this; a pixel is 50,000 times as
large as the way it then makes between two frames."""

SCALARS: dict[str, str] = {
    "time_s": "s",
    "Fx_N": "N",
    "Fy_N": "N",
    "Fz_N": "N",
    "torque_N_mm": "N mm",
    "nominal_area_mm2": "mm^2",
    "real_area_mm2": "mm^2",
    "centre_x_mm": "mm",
    "centre_y_mm": "mm",
    "stick_ratio": "1",
    "friction_coefficient": "1",
    "margin": "1",
    "drive_mm": "mm",
    "tip_displacement_mm": "mm",
    "rotation_deg": "deg",
}
"""Numbers of each frame and their units. Forces are those of the finger on the glass."""

MEANINGS = {
    "torque_N_mm": "of the finger on the glass about the contact's centre, from x towards y",
    "centre_x_mm": "middle of the contact's outline on the plate",
    "centre_y_mm": "middle of the contact's outline on the plate",
    "Fz_N": "0: the finger is lifted, and forces, areas, friction coefficient and margin are 0",
    "stick_ratio": "share of the contact that sticks; 1 where the finger is lifted (Fz_N = 0): nothing slips",
    "rotation_deg": "of the finger about its normal since it was put down, from x towards y",
    "friction_coefficient": "static, in the direction of the force and at the drive's speed",
    "margin": "|Ft| / (mu Fn), mu the friction coefficient, and the same of the torque, by their ellipse: gross slip"
    " is 1 to 1.06; 0 where the finger is lifted",
}
"""Meanings of numbers beyond their names."""


def slip_labelled(state: ContactState) -> ContactState:
    """Return a contact whose touching cells are labelled slip where the skin moves, else stick."""
    if state.state is None or state.slip_velocity is None:
        return state
    surface = np.array(state.state)
    touching = surface >= SurfaceState.STICK
    moves = np.hypot(*np.asarray(state.slip_velocity)) >= SLIP_SPEED_MM_PER_S
    surface[touching] = np.where(moves[touching], np.uint8(SurfaceState.SLIP), np.uint8(SurfaceState.STICK))
    return replace(state, state=surface)


def measured(state: ContactState, centre: tuple[float, float]) -> dict[str, float]:
    """Return the numbers that are those of a contact's maps, by their names among the scalars.

    Parameters
    ----------
    state : ContactState
    centre : tuple of float
        Point (x, y) about which the torque is taken [mm].
    """
    grid = state.grid
    nominal = real = float(state.nominal_contact_area)
    if state.real_contact_fraction is not None:
        fraction = np.asarray(state.contact_mask) * np.asarray(state.real_contact_fraction)
        real = float(fraction.sum()) * grid.pitch**2
    torque, ratio = 0.0, 1.0
    if state.traction is not None:
        x, y = grid.x[None, :] - centre[0], grid.y[:, None] - centre[1]
        torque = float((x * state.traction[1] - y * state.traction[0]).sum()) * grid.pitch**2
    if state.state is not None:
        stick, slip = (int(np.count_nonzero(state.state == s)) for s in (SurfaceState.STICK, SurfaceState.SLIP))
        ratio = stick / (stick + slip) if stick + slip else 1.0
    return {"nominal_area_mm2": nominal, "real_area_mm2": real, "torque_N_mm": torque, "stick_ratio": ratio}
