"""Two controllers of a grip: one constant force, and one that lets go until it sees the object move."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from evanesce.dataset.grip_model import GripTask

Image = NDArray[np.uint8]

WINDOW = 0.85
"""Width of the middle of the frame in which motion is looked for, over the frame's [1]."""


@dataclass(frozen=True)
class ConstantGrip:
    """One force, whatever is seen."""

    force_N: float

    def reset(self, frame: Image, force_N: float) -> None:
        """Begin an episode."""

    def act(self, frame: Image) -> float:
        """Return the force to ask for [N]."""
        return self.force_N


@dataclass
class SightGrip:
    """Let go slowly; where the picture moves, grip harder, and let go only to somewhat above where it moved.

    Attributes
    ----------
    task : GripTask
    moved_px : float
        Motion from one frame to the next that counts as slip [px]; of frames that differ in noise alone it is a third.
    release_per_s : float
        Share of the force that is let go a second [1/s].
    more, margin : float
        Factor of the force on slip, and of the force at which it last slipped, that is kept [1].
    forget_s : float
        Time in which the force that is kept falls to a third [s].
    changed_DN : float
        Mean change of the picture that counts as a slide too fast for its motion to be read [DN].
    rescue : float
        Factor of the force on such a slide [1].
    """

    task: GripTask
    moved_px: float = 0.06
    release_per_s: float = 0.35
    more: float = 1.3
    margin: float = 1.2
    forget_s: float = 6.0
    changed_DN: float = math.inf
    rescue: float = 2.0

    def reset(self, frame: Image, force_N: float) -> None:
        """Begin an episode with the first frame and the force at that time [N]."""
        self._before, self._force, self._floor = _even(frame), force_N, self.task.force_N[0]

    def act(self, frame: Image) -> float:
        """Return the force to ask for after a frame [N]."""
        now = _even(frame)
        moved = shift_px(self._before, now)
        changed = float(np.abs(now.astype(np.float32) - self._before).mean())
        self._before = now
        if changed > self.changed_DN:
            self._floor = max(self._floor, self.margin * self._force)
            self._force = max(self.rescue * self._force, self._floor)
        elif moved > self.moved_px:
            self._floor = max(self._floor, self.margin * self._force)
            self._force = max(self.more * self._force, self._floor)
        else:
            self._floor *= float(np.exp(-1.0 / (self.task.frame_rate_hz * self.forget_s)))
            slower = self._force * (1.0 - self.release_per_s / self.task.frame_rate_hz)
            self._force = max(slower, min(self._floor, self._force))
        self._force = float(np.clip(self._force, *self.task.force_N))
        return self._force


def shift_px(before: Image, now: Image, rounds: int = 4) -> float:
    """Return how far a picture moved downwards between two frames [px], by least squares on its gradients.

    Parameters
    ----------
    before, now : ndarray (rows, cols)
        [DN].
    rounds : int
        Each moves the later frame back by what was found; ways of a gradient's width and more are found too short.

    References
    ----------
    B. D. Lucas and T. Kanade, "An iterative image registration technique", Proc. IJCAI (1981) 674.
    """
    rows, cols = before.shape
    top, left = (round(0.5 * (1.0 - WINDOW) * n) for n in (rows, cols))
    part = np.s_[top : rows - top, left : cols - left]
    one, other = before.astype(np.float32), now.astype(np.float32)
    total = np.zeros(2)
    for _ in range(rounds):
        move = np.array([[1, 0, total[0]], [0, 1, total[1]]], np.float32)
        how = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        back = cv2.warpAffine(other, move, (cols, rows), flags=how, borderMode=cv2.BORDER_REPLICATE)
        mean = 0.5 * (one + back)
        slope = np.stack(
            [cv2.Sobel(mean, cv2.CV_32F, *order, ksize=3, scale=0.125)[part] for order in ((1, 0), (0, 1))]
        )
        normal = np.einsum("irc,jrc->ij", slope, slope) + 1e-6 * np.eye(2)
        total -= np.linalg.solve(normal, np.einsum("irc,rc->i", slope, (back - one)[part]))
    return float(total[1])


def _even(frame: Image) -> Image:
    return np.asarray(frame)[..., 0] if frame.ndim == 3 else frame
