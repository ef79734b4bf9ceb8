"""A ridged finger that is pressed and then sheared until it slips: frames beside the stick and slip of every pixel.

The ridges are open, 130 um high at 1.5 N, so that the camera sees each of them: they stay on the glass where the
contact sticks, and bend and move where it slips, from the rim inwards.
"""

from __future__ import annotations

import io
import math
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from evanesce.chain.fast import FastCamera
from evanesce.contact.laws import smooth_contact
from evanesce.contact.ridges.ridged import with_ridges
from evanesce.contact.solve import contact_grid, contact_sequence, ridge_row
from evanesce.core.states import ContactState, SurfaceState
from evanesce.dataset.labels import FrameLabeller
from evanesce.dataset.trial import FrameTruth
from evanesce.rig import load_scene

FORCE_N = 1.5
DIRECTION_DEG = 20.0
# A small field at the thesis's scale: 440 pixels at 58.37 px/mm show 7.5 mm.
_VIEW = {
    "press.forces_N": [FORCE_N], "press.frame_rate_hz": 20.0, "finger.position_mm": [-0.5, -0.1], "grid.size_mm": 13.0,
    "grid.samples": 780, "camera.resolution_px": [440, 360], "camera.exposure_ms": 8.0,
}  # fmt: skip
_RIDGES = {
    "finger.ridges.height_um": 130.0, "finger.ridges.width_um": 330.0, "finger.ridges.pitch_um": 620.0,
    "finger.ridges.orientation_deg": 75.0,
}  # fmt: skip
_SLIDE = {
    "contact": {"law": "hertz"}, "slide.speed_mm_per_s": 4.0, "slide.distance_mm": 12.5,
    "slide.friction_coefficient": 0.7,
    "slide.direction_deg": DIRECTION_DEG, "slide.preload_N": 0.1, "slide.press_time_s": 0.6, "slide.hold_time_s": 0.2,
}  # fmt: skip

STICK_COLOUR, SLIP_COLOUR = (70, 150, 215), (235, 62, 40)
"""RGB [DN]."""


@dataclass(frozen=True, kw_only=True)
class SlipSequence:
    """Frames of the press and the slide, with their labels.

    Attributes
    ----------
    frames : ndarray of uint8 (n, rows, cols)
        As the camera takes them [DN].
    states : ndarray of uint8 (n, rows, cols)
        :class:`~evanesce.core.states.SurfaceState` of what each pixel sees.
    time_s, normal_N, tangential_N : ndarray (n,)
        Time [s] and the finger's forces on the glass [N].
    """

    frames: NDArray[np.uint8]
    states: NDArray[np.uint8]
    time_s: NDArray[np.float64]
    normal_N: NDArray[np.float64]
    tangential_N: NDArray[np.float64]

    def slipping(self) -> NDArray[np.float64]:
        """Return the share of the contact's pixels that slip, per frame (n,)."""
        slip = (self.states == SurfaceState.SLIP).sum(axis=(1, 2))
        return np.asarray(slip / np.maximum(slip + (self.states == SurfaceState.STICK).sum(axis=(1, 2)), 1))


def slip_sequence(seed: int = 1, *, every: int = 1) -> SlipSequence:
    """Simulate the sequence with the fast renderer.

    Parameters
    ----------
    seed : int
        Of the sensor's noise.
    every : int
        Takes each frame of so many.
    """
    smooth = load_scene("thesis_slide", _VIEW | _SLIDE)
    ridged = load_scene("thesis_ridged", _VIEW | _RIDGES)
    ridges, modulus = ridge_row(ridged), smooth_contact(ridged, FORCE_N)[1]
    assert ridges is not None  # the scene has them
    camera, labeller = FastCamera(ridged), FrameLabeller(ridged, contact_grid(ridged))
    angle = math.radians(DIRECTION_DEG)
    along = np.array([math.cos(angle), math.sin(angle)])
    frames, labels, states = [], [], []
    for index, state in enumerate(contact_sequence(smooth)[::every]):
        carried, rim = _carried_to_the_rim(state, along)
        state = with_ridges(
            carried, ridges, modulus, origin=smooth.finger.position_mm, outer_slip=(rim * along[0], rim * along[1])
        )
        frames.append(camera.frame(state, seed=seed, index=index).data)
        labels.append(labeller.labels(FrameTruth(state, {}), 0.5).whole("state").astype(np.uint8))
        states.append(state)
    return SlipSequence(
        frames=np.stack(frames),
        states=np.stack(labels),
        time_s=np.array([s.time for s in states]),
        normal_N=np.array([s.normal_force for s in states]),
        tangential_N=np.array([math.hypot(*s.tangential_force) for s in states]),
    )


def _carried_to_the_rim(state: ContactState, along: NDArray[np.float64]) -> tuple[ContactState, float]:
    """Return the state with the rim's slip in cells that the contact covers in part, and that slip [mm]."""
    assert state.slip is not None
    amount = np.tensordot(along, np.asarray(state.slip), 1)
    covered = np.asarray(state.contact_mask) > 0
    rim = float(amount[covered].max()) if covered.any() else 0.0
    partly = covered & (amount == 0.0) & (np.asarray(state.contact_mask) < 1.0)
    return replace(state, slip=np.where(partly, rim * along[:, None, None], state.slip)), rim


def _panel(sequence: SlipSequence, i: int) -> NDArray[np.uint8]:
    """Return a frame and, to its right, the same with its labels (rows, 2 cols, 3)."""
    grey = np.repeat(sequence.frames[i][..., None], 3, axis=2)
    drawn = (grey * 0.35).astype(np.uint8)
    drawn[sequence.states[i] == SurfaceState.STICK] = STICK_COLOUR
    drawn[sequence.states[i] == SurfaceState.SLIP] = SLIP_COLOUR
    return np.hstack([grey, drawn])


def slip_animation(sequence: SlipSequence, *, width_px: int = 880) -> bytes:
    """Return the sequence as an animated WebP: frames on the left, stick (blue) and slip (red) on the right.

    Parameters
    ----------
    sequence : SlipSequence
    width_px : int
        Of the picture [px].
    """
    pictures = [_captioned(sequence, i, width_px) for i in range(len(sequence.frames))]
    hold = [100] * len(pictures)
    hold[-1] = 1500
    stream = io.BytesIO()
    pictures[0].save(
        stream, format="WEBP", save_all=True, append_images=pictures[1:], duration=hold, loop=0, quality=60, method=4
    )
    return stream.getvalue()


def _captioned(sequence: SlipSequence, i: int, width_px: int) -> Image.Image:
    panel = _panel(sequence, i)
    height = round(panel.shape[0] * width_px / panel.shape[1])
    small = cv2.resize(panel, (width_px, height), interpolation=cv2.INTER_AREA)
    text = (
        f"t = {sequence.time_s[i]:.2f} s   normal {sequence.normal_N[i]:.1f} N   tangential"
        f" {sequence.tangential_N[i]:.2f} N   slipping {100 * sequence.slipping()[i]:.0f} %"
    )
    cv2.putText(small, text, (12, height - 12), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (200, 200, 200), 1, cv2.LINE_AA)
    for word, colour, x in (("stick", STICK_COLOUR, width_px - 110), ("slip", SLIP_COLOUR, width_px - 55)):
        cv2.putText(small, word, (x, 24), cv2.FONT_HERSHEY_SIMPLEX, 0.55, colour, 1, cv2.LINE_AA)
    return Image.fromarray(small)


def slip_strip(sequence: SlipSequence, count: int = 6, *, width_px: int = 1500) -> NDArray[np.uint8]:
    """Return a still picture: frames above, their labels below, from full stick to near full slip (rows, cols, 3).

    Parameters
    ----------
    sequence : SlipSequence
    count : int
        Columns.
    width_px : int
        Of the picture [px].
    """
    share = sequence.slipping()
    held = np.flatnonzero(sequence.normal_N >= sequence.normal_N.max() - 1e-6)
    wanted = np.linspace(0.0, 0.75, count)
    chosen = [int(held[np.abs(share[held] - level).argmin()]) for level in wanted]
    rows, cols = sequence.frames.shape[1:]
    half = min(rows, cols) // 2
    columns = []
    for i in chosen:
        panel = _panel(sequence, i)
        part = (slice(rows // 2 - half, rows // 2 + half), slice(cols // 2 - half, cols // 2 + half))
        columns.append(np.vstack([panel[:, :cols][part], panel[:, cols:][part]]))
    strip = np.hstack(columns)
    size = (width_px, round(strip.shape[0] * width_px / strip.shape[1]))
    return np.asarray(cv2.resize(strip, size, interpolation=cv2.INTER_AREA), np.uint8)
