"""What an audit measures on each frame: how far its maps are from its numbers, and from the frame before."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from evanesce.core.states import SurfaceState
from evanesce.dataset.labels import LabelBox
from evanesce.dataset.read import Sample

Floats = NDArray[np.float64]

MOVING_MM_PER_S = (5e-4, 2e-3)
"""A cell labelled slip must be faster than the first, one labelled stick slower than the second [mm/s]: either side of
:data:`evanesce.dataset.numbers.SLIP_SPEED_MM_PER_S`, by more than half precision rounds."""
LEAST_SLIP_MM = 0.03
"""Added to the slip between two frames to which its error is related [mm], so that the tolerance of 0.15 allows 4.5 um:
half precision rounds slips of millimetres to one, and slip is kept in the outline, whose change of shape under shear
carries it along (4 um of slip between two frames at the most, of 3,087)."""
TEXTURED = 0.1
"""Share of the contact's inner half that must be open in a trial with texture."""
ROUNDING = 2.0**-9
"""Relative rounding of two channels at half precision."""


class AuditFrame:
    """A frame with its maps on the plate plane, stored or computed again; zero beyond the contact's box.

    Parameters
    ----------
    sample : Sample

    Raises
    ------
    ValueError
        If a member cannot be decoded.
    """

    def __init__(self, sample: Sample) -> None:
        self.row, self.key, self.meta = sample.row, sample.key, sample.meta
        self.scalars: dict[str, float] = self.meta["scalars"]
        self.box = sample.plate
        self.pitch, x0, y0 = sample.plate_geometry
        high, wide = self.map("state").shape
        self.x = x0 + (self.box.col + np.arange(wide)) * self.pitch
        self.y = y0 + (self.box.row + np.arange(high)) * self.pitch
        self.pixels, self.pixel_labels = sample.state, sample.labels

    def map(self, name: str) -> Floats:
        """Return a channel within the box, (rows, cols)."""
        return np.asarray(self.box.channels[name], dtype=float)

    def pair(self, name: str) -> Floats:
        """Return both components of a channel within the box, (2, rows, cols)."""
        return np.stack([self.map(f"{name}.x"), self.map(f"{name}.y")])

    @property
    def centre(self) -> tuple[float, float]:
        """Middle of the contact's outline on the plate [mm]."""
        return self.scalars["centre_x_mm"], self.scalars["centre_y_mm"]

    @cached_property
    def held(self) -> bool:
        """Whether anything touches."""
        return self.scalars["Fz_N"] > 0.0 and self.map("state").size > 0

    @cached_property
    def half_width(self) -> float:
        """Half of the longer side of the contact's extent [mm]."""
        touching = self.map("contact_mask") >= 0.5
        sides = [np.flatnonzero(touching.any(axis=axis)) for axis in (0, 1)]
        return 0.5 * self.pitch * max((int(s[-1] - s[0]) + 1 for s in sides if s.size), default=0)

    @cached_property
    def stick(self) -> NDArray[np.bool_]:
        """Cells labelled stick."""
        return np.asarray(self.map("state") == SurfaceState.STICK)

    @cached_property
    def slip(self) -> NDArray[np.bool_]:
        """Cells labelled slip."""
        return np.asarray(self.map("state") == SurfaceState.SLIP)

    @cached_property
    def speed(self) -> Floats:
        """Of the skin over the glass [mm/s]."""
        return np.asarray(np.hypot(*self.pair("slip_velocity")))


@dataclass(frozen=True)
class FrameCheck:
    """An identity of a frame.

    Attributes
    ----------
    name : str
    tolerance : float
        Largest error of a good frame.
    error : callable
        ``error(frame, before) -> float``: NaN where the identity does not apply; ``before`` is the frame before it in
        its trial, or None.
    """

    name: str
    tolerance: float
    error: Callable[[AuditFrame, AuditFrame | None], float]


def _normal_force(frame: AuditFrame, before: AuditFrame | None) -> float:
    carried = float(frame.map("pressure").sum()) * frame.pitch**2
    stated = frame.scalars["Fz_N"]
    return abs(carried / stated - 1.0) if stated > 0 else abs(carried)


def _all_traction(frame: AuditFrame) -> float:
    """Return the force that the tractions would carry if they were parallel [N]; of no traction NaN."""
    size = float(np.hypot(*frame.pair("traction")).sum()) * frame.pitch**2
    return size if size > 1e-4 * frame.scalars["Fz_N"] else math.nan


def _tangential_force(frame: AuditFrame, before: AuditFrame | None) -> float:
    stated = np.array([frame.scalars["Fx_N"], frame.scalars["Fy_N"]])
    carried = frame.pair("traction").sum(axis=(1, 2)) * frame.pitch**2
    size = _all_traction(frame)
    if math.isnan(size):
        return float(np.hypot(*stated)) / max(frame.scalars["Fz_N"], 1e-9)
    return float(np.hypot(*(carried - stated))) / size


def _torque(frame: AuditFrame, before: AuditFrame | None) -> float:
    traction, (x0, y0) = frame.pair("traction"), frame.centre
    x, y = frame.x[None, :] - x0, frame.y[:, None] - y0
    arm = float((np.hypot(x, y) * np.hypot(*traction)).sum()) * frame.pitch**2
    stated = frame.scalars["torque_N_mm"]
    if math.isnan(_all_traction(frame)):
        return abs(stated)
    carried = float((x * traction[1] - y * traction[0]).sum()) * frame.pitch**2
    return abs(carried - stated) / arm


def _area(frame: AuditFrame, before: AuditFrame | None) -> float:
    counted, stated = float(frame.map("contact_mask").sum()) * frame.pitch**2, frame.scalars["nominal_area_mm2"]
    return abs(counted / stated - 1.0) if stated > 0 else counted


def _stick_ratio(frame: AuditFrame, before: AuditFrame | None) -> float:
    touching = int(frame.stick.sum()) + int(frame.slip.sum())
    return abs(frame.scalars["stick_ratio"] - int(frame.stick.sum()) / touching) if touching else math.nan


def _strength(frame: AuditFrame, before: AuditFrame | None) -> float:
    traction, strength = np.hypot(*frame.pair("traction")), frame.map("strength")
    if not frame.stick.any():
        return math.nan
    limit = strength * (1.0 + ROUNDING) + 1e-3 * float(strength.max())
    return float((traction > limit)[frame.stick].mean())


def _slip_without_motion(frame: AuditFrame, before: AuditFrame | None) -> float:
    return float((frame.speed[frame.slip] < MOVING_MM_PER_S[0]).mean()) if frame.slip.any() else math.nan


def _motion_without_slip(frame: AuditFrame, before: AuditFrame | None) -> float:
    return float((frame.speed[frame.stick] > MOVING_MM_PER_S[1]).mean()) if frame.stick.any() else math.nan


def _displacement(frame: AuditFrame, before: AuditFrame | None) -> float:
    """Return how far slip gained in the contact's inner half is from velocity times time, over the larger of them."""
    if before is None or not before.held:
        return math.nan
    elapsed = frame.scalars["time_s"] - before.scalars["time_s"]
    (x1, y1), (x0, y0) = frame.centre, before.centre
    turned = math.radians(frame.scalars["rotation_deg"] - before.scalars["rotation_deg"])
    cos, sin = math.cos(turned), math.sin(turned)
    x, y = np.meshgrid(frame.x - x1, frame.y - y1)
    x, y = x0 + cos * x + sin * y, y0 + cos * y - sin * x
    # where the cells of this frame were in the contact one frame ago, as indices of that frame's box
    at_col, at_row = (
        np.ascontiguousarray((a - start) / frame.pitch, np.float32) for a, start in ((x, before.x[0]), (y, before.y[0]))
    )

    def earlier(values: Floats) -> Floats:
        return np.asarray(
            cv2.remap(values.astype(np.float32), at_col, at_row, cv2.INTER_LINEAR, borderValue=0), np.float64
        )

    # Under shear the contact loses area at its rim: there a cell was elsewhere in the outline, in its core hardly.
    core = np.hypot(frame.x[None, :] - x1, frame.y[:, None] - y1) < 0.5 * frame.half_width
    both = core & (frame.map("contact_mask") > 0.99) & (earlier(before.map("contact_mask")) > 0.99)
    if not both.any():
        return math.nan
    gained = np.stack([f - earlier(b) for f, b in zip(frame.pair("slip"), before.pair("slip"), strict=True)])
    moved = frame.pair("slip_velocity") * elapsed
    size = max(_rms(gained[:, both]), _rms(moved[:, both]))
    return _rms((gained - moved)[:, both]) / (size + LEAST_SLIP_MM)


def _rms(values: Floats) -> float:
    return float(np.sqrt((values**2).sum(axis=0).mean()))


def _pixels(frame: AuditFrame, before: AuditFrame | None) -> float:
    return float((frame.pixels != frame.pixel_labels.whole("state")).mean())


FRAME_CHECKS = (
    FrameCheck("normal force: map against Fz_N", 0.02, _normal_force),
    FrameCheck("tangential force: map against Fx_N, Fy_N", 0.02, _tangential_force),
    FrameCheck("torque: map against torque_N_mm", 0.02, _torque),
    FrameCheck("area: map against nominal_area_mm2", 0.02, _area),
    FrameCheck("stick_ratio: map against number", 0.02, _stick_ratio),
    FrameCheck("share of stick cells with traction above strength", 0.001, _strength),
    FrameCheck("share of slip cells without motion", 0.001, _slip_without_motion),
    FrameCheck("share of stick cells with motion", 0.001, _motion_without_slip),
    FrameCheck("slip gained in the inner half against slip_velocity", 0.15, _displacement),
    FrameCheck("pixels of mask.png that differ from the labels", 0.0, _pixels),
)
"""Identities of held frames; errors are relative."""


def open_core(frame: AuditFrame) -> float:
    """Return the share of cells without contact in the inner half of the contact's extent."""
    touching = frame.map("contact_mask") >= 0.5
    rows, cols = (np.flatnonzero(touching.any(axis=axis)) for axis in (1, 0))
    if rows.size == 0:
        return math.nan
    middle, half = (rows[0] + rows[-1]) / 2, max(rows[-1] - rows[0], cols[-1] - cols[0]) / 4
    y, x = np.arange(touching.shape[0])[:, None] - middle, np.arange(touching.shape[1]) - (cols[0] + cols[-1]) / 2
    return float(1.0 - touching[np.hypot(x, y) <= max(half, 1.0)].mean())


def contact_share(labels: LabelBox, pixels: NDArray[Any]) -> float:
    """Return the share of a frame's pixels within the convex outline of its contact."""
    points = cv2.findNonZero((pixels >= SurfaceState.STICK).astype(np.uint8))
    return 0.0 if points is None else float(cv2.contourArea(cv2.convexHull(points))) / pixels.size
