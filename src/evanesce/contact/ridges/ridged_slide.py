"""Ridges on a sliding contact: two scales, the ridges carried along by the slip of the surface.

Pressure, traction and slip of the smooth finger are the means over a ridge's pitch; within a pitch the pressure is that
of one ridge of a periodic row (:mod:`evanesce.contact.ridges.profile`) and traction follows pressure. A ridge belongs
to the finger's skin: it stands where its piece of skin first touched, plus the slip since then. So ridges stay on the
glass where the contact sticks and move where it slips, which is what a camera sees of incipient slip. Limits as for
:mod:`evanesce.contact.ridges.ridged`; whether a ridge slips is decided on the scale of the whole contact.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from evanesce.contact.ridges.heightmap import RidgeRow, furrow_depth
from evanesce.contact.ridges.profile import closure_pressure, contact_edge, profile_exponent, ridge_gap, ridge_pressure
from evanesce.core.states import ContactState, SurfaceState

Floats = NDArray[np.float64]


def with_ridges(
    smooth: ContactState,
    ridges: RidgeRow,
    modulus: float,
    *,
    origin: tuple[float, float],
    outer_slip: tuple[float, float] = (0.0, 0.0),
    near_gap: float = 0.01,
) -> ContactState:
    """Return the state of a finger with ridges whose smooth twin is given.

    Parameters
    ----------
    smooth : ContactState
        With pressure and gap; slip, traction and state where it slides.
    ridges : RidgeRow
    modulus : float
        E* at the scale of the ridges [MPa].
    origin : tuple of float
        Plate point (x, y) on which the finger's tip first rested [mm].
    outer_slip : tuple of float
        Displacement (x, y) of the skin outside the contact [mm].
    near_gap : float
        Gap below which a surface counts as near [mm].

    Returns
    -------
    ContactState
        Carries the same forces; ``nominal_contact_area`` is that of the ridges' contact, counted from the mask.
    """
    grid, law = smooth.grid, f"{smooth.law}+ridges"
    exponent = profile_exponent(ridges.width, ridges.pitch)
    closure = closure_pressure(modulus, ridges.height, ridges.pitch, exponent)
    whole = np.asarray(smooth.contact_mask, dtype=float)
    touched = whole > 0
    shape = grid.shape
    drift = np.empty((2, *shape))
    for axis in (0, 1):
        drift[axis] = (
            outer_slip[axis] if smooth.slip is None else np.where(touched, smooth.slip[axis], outer_slip[axis])
        )
    x, y = grid.x[None, :] - origin[0] - drift[0], grid.y[:, None] - origin[1] - drift[1]
    distance = ridges.locate(x, y)[1]
    furrow = furrow_depth(distance, ridges.pitch, ridges.width, ridges.height)
    mask, pressure = np.zeros(shape), np.zeros(shape)
    factor = np.zeros(shape)
    if touched.any():
        mean = np.asarray(smooth.pressure, dtype=float)[touched]
        d = distance[touched]
        local = ridge_pressure(d, mean, ridges.pitch, closure, exponent)
        furrow[touched] = ridge_gap(d, mean, ridges.pitch, ridges.height, closure, exponent)
        mask[touched] = whole[touched] * _coverage(d, mean, ridges, closure, exponent, grid.pitch)
        local = np.where(mask[touched] > 0, local, 0.0)
        pressure[touched] = local * _scale(float(mean.sum()), float(local.sum()))
        factor[touched] = np.divide(pressure[touched], mean, out=np.zeros_like(mean), where=mean > 0)
    gap = np.where(mask >= 1.0, 0.0, np.asarray(smooth.gap) + furrow)
    changes: dict[str, object] = {}
    if smooth.traction is not None:
        changes["traction"] = _carried(np.asarray(smooth.traction, dtype=float), factor)
    if smooth.slip is not None:
        changes["slip"] = np.asarray(smooth.slip) * (mask > 0)
    if smooth.state is not None:
        state = np.where(gap < near_gap, np.uint8(SurfaceState.NEAR), np.uint8(SurfaceState.NONE))
        held = mask >= 0.5
        state[held] = np.maximum(np.asarray(smooth.state)[held], np.uint8(SurfaceState.STICK))
        changes["state"] = state
    named = {
        **smooth.parameters,
        "ridge_pattern": ridges.pattern,
        "ridge_pitch_mm": ridges.pitch,
        "ridge_width_mm": ridges.width,
        "ridge_height_mm": ridges.height,
        "ridge_orientation_rad": ridges.orientation,
    }
    return replace(
        smooth,
        pressure=pressure,
        gap=gap,
        contact_mask=mask,
        nominal_contact_area=float(mask.sum()) * grid.pitch**2,
        law=law,
        parameters=named,
        **changes,  # type: ignore[arg-type]
    )


def _scale(wanted: float, found: float) -> float:
    return wanted / found if found > 0 else 0.0


def _coverage(distance: Floats, mean: Floats, ridges: RidgeRow, closure: float, exponent: float, cell: float) -> Floats:
    """Return the share of each cell within the half width of its ridge's contact, the border cut as a straight edge."""
    half = ridges.pitch / np.pi * np.arcsin(contact_edge(mean, closure, exponent))
    share = np.clip(0.5 + (half - np.abs(distance)) / cell, 0.0, 1.0)
    return np.where(half >= 0.5 * ridges.pitch, 1.0, np.where(half > 0, share, 0.0))


def _carried(traction: Floats, factor: Floats) -> Floats:
    """Let traction follow pressure within a pitch, with its resultant kept for both directions."""
    found = traction * factor
    for axis in (0, 1):
        wanted, got = float(traction[axis].sum()), float(found[axis].sum())
        size = float(np.abs(traction[axis]).sum())
        # A twist's resultant is nothing: a factor would divide by rounding.
        if abs(wanted) > 0.05 * size and got * wanted > 0:
            found[axis] *= wanted / got
    return found
