"""A first look through a recording: which frames show no finger, and which the largest contact.

Light beside the contact that does not move (dust, scratches, reflections of the LEDs) is in frames without a finger as
well; their mean is the dark frame of the refined estimator. Frames count as without a finger where no place is brighter
than the darkest it ever is by more than noise explains, and where their mean shows nothing that is both as large as the
minimum size of a blob and half as bright as the contact.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from evanesce.core.states import Frame
from evanesce.measurement.levels import luma_light
from evanesce.measurement.reference.blobs import large_blobs

Floats = NDArray[np.float64]
Image = NDArray[np.uint8]

BLOCKS = 96
"""Blocks along the longer side in which frames are compared."""

MOST_FRAMES = 600
"""Frames that are looked at; of longer recordings every n-th."""

LEAST_FREE = 3
"""A dark frame is the mean of at least so many."""

MOST_FREE = 64
"""With more the noise of their mean is below the resolution of 8 bits."""

NOISE_FACTOR = 1.6
"""Greatest excess of a frame without a finger over the smallest excess of any: both are maxima of noise over blocks."""

STEP_SHARE = 0.05
"""Share of the contact's step by which a block may be brighter at most in a frame without a finger."""

CLEAR_CONTACT = 4.0
"""Excess of the brightest frame over that of the darkest from which there is a contact at all."""


@dataclass
class Survey:
    """Comparison of a recording's frames, block by block.

    Parameters
    ----------
    tone : ndarray (256,)
        Linear light of each grey level.
    every : int
        Every how many-th frame is looked at.
    """

    tone: Floats
    every: int = 1
    indices: list[int] = field(default_factory=list)
    blocks: list[NDArray[np.float32]] = field(default_factory=list)

    def add(self, frame: Frame) -> None:
        """Look at a frame."""
        light = luma_light(frame.data, self.tone)
        rows, cols = light.shape
        size = max(1, round(max(rows, cols) / BLOCKS))
        shape = max(1, cols // size), max(1, rows // size)
        self.blocks.append(cv2.resize(light, shape, interpolation=cv2.INTER_AREA).astype(np.float32))
        self.indices.append(frame.index)

    @property
    def excess(self) -> Floats:
        """Greatest excess of each frame over the darkest light of each block [of full scale]."""
        stack = np.stack(self.blocks)
        return np.asarray((stack - stack.min(axis=0)).max(axis=(1, 2)), np.float64)

    @property
    def brightest(self) -> int:
        """Index of the frame with the most light over the darkest of each block."""
        stack = np.stack(self.blocks)
        return self.indices[int((stack - stack.min(axis=0)).sum(axis=(1, 2)).argmax())]

    def free(self) -> tuple[int, ...]:
        """Return the indices of the frames that may be without a finger; :func:`is_free` of their mean decides."""
        if len(self.indices) < LEAST_FREE + 1:
            return ()
        excess = self.excess
        least, most = float(excess.min()), float(excess.max())
        if not most > CLEAR_CONTACT * least:  # frames that are black throughout as well
            return ()
        near = excess <= max(NOISE_FACTOR * least, STEP_SHARE * most)
        found = [index for index, free in zip(self.indices, near, strict=True) if free]
        if len(found) < LEAST_FREE:
            return ()
        step = -(-len(found) // MOST_FREE)
        return tuple(found[::step])


def is_free(dark: Image | Floats, bright: Image, tone: Floats, *, radius: int, min_blob: int) -> bool:
    """Return whether a mean frame shows no contact as bright as half that of another frame.

    Parameters
    ----------
    dark : ndarray (rows, cols)
        Mean linear light of the frames that may be without a finger.
    bright : ndarray of uint8, (rows, cols) or (rows, cols, 3)
        Frame of a contact [DN].
    tone : ndarray (256,)
    radius, min_blob : int
        Of the dilating disk, and minimum size of a dilated blob [px].

    Returns
    -------
    bool
    """
    light = cv2.GaussianBlur(luma_light(bright, tone), (0, 0), 2.0)
    ground = float(np.median(dark))
    step = light - dark
    risen = step > max(0.5 * float(np.percentile(step, 99.9)), 0.0)
    if not risen.any():
        return False
    top = float(np.median(step[risen]))
    mask = cv2.GaussianBlur(np.asarray(dark, np.float64), (0, 0), 2.0) - ground > 0.5 * top
    return large_blobs(mask, radius, max(min_blob, 1)).kept == 0


@dataclass(frozen=True)
class Scene:
    """What a survey found.

    Attributes
    ----------
    free : tuple of int
        Indices of frames without a finger; empty where there are too few.
    dark : list of ndarray of uint8
        Those frames [DN].
    brightest : Frame
        Of the largest contact.
    """

    free: tuple[int, ...]
    dark: list[Image]
    brightest: Frame


def look_through(
    frames: Callable[[], Iterable[Frame]],
    tone: Floats,
    *,
    count: int | None,
    radius: int,
    min_blob: int,
    tick: Callable[[], None] = lambda: None,
) -> Scene | None:
    """Look through a recording twice: compare its frames, then fetch those that are needed.

    Parameters
    ----------
    frames : callable
        Opens the recording anew and yields its frames.
    tone : ndarray (256,)
    count : int, optional
        Number of frames it states.
    radius, min_blob : int
        As for :func:`is_free`.
    tick : callable
        Called after each frame.

    Returns
    -------
    Scene, or None
        None of no readable frame.
    """
    survey = Survey(tone, max(1, -(-(count or 1) // MOST_FRAMES)))
    for number, frame in enumerate(frames()):
        if number % survey.every == 0:
            survey.add(frame)
        tick()
    if not survey.indices:
        return None
    free, brightest = survey.free(), survey.brightest
    kept: dict[int, Frame] = {}
    wanted = {*free, brightest}
    for frame in frames():
        if frame.index in wanted:
            kept[frame.index] = frame
            if len(kept) == len(wanted):
                break
    bright = kept[brightest]
    dark = [kept[index].data for index in free]
    if dark:
        mean = np.mean([luma_light(image, tone) for image in dark], axis=0)
        if not is_free(mean, bright.data, tone, radius=radius, min_blob=min_blob):
            free, dark = (), []
    return Scene(free, dark, bright)
