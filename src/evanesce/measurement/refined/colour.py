"""Level of the light in a colour frame, from the channels that are neither clipped nor cut.

Light of one narrow spectrum reaches a camera's filters in fixed shares, so that the developed colour is a function of
one number, the light's level. Each channel determines it over a part of its range: red below the level that clips it,
green and blue above the level where a colour matrix no longer cuts them to 0. A :class:`CameraModel` holds the three
curves; the level of a pixel is the mean of its posterior distribution under an even prior, a clipped or cut channel
counting as the bound that it is.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import log_ndtr

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

GRID = 1200
"""Levels of the grid on which the posterior is summed: steps of a hundredth, a third of one pixel's shot noise."""

DARKEST = 1e-4
"""Lowest level of the grid above 0, of the highest that the frame can show."""

BEYOND = 1.5
"""Where the even prior ends, in the highest level that the frame can show."""

MODEL_DN = 1.0
"""Standard deviation of what the model leaves out [DN]: colours that demosaicing or a codec mixed."""

CLIPPED_DN = 254
"""Value from which a channel is at most known to be clipped: a codec leaves a clipped one at 254."""

BLIND = 0.2
"""Relative standard deviation of one pixel's level from which its colour is not taken for a measurement."""

BLIND_STEPS = 200

FOOT_REACHES = 5.0
"""Contact over full scale up to which the foot of its edge determines the boundary better than blind colours."""

MIXED_PX = 0.1
"""Half-width of what demosaicing does to an edge whose top is clipped on some pixels of a neighbourhood [px]: errors of
up to 0.15 % of 17.9 mm^2 in frames of docs/validation/colour_estimator.py."""

RING_PX = (4, 12)
"""Distances from the contact at which the light beside it is read [px]."""

BRIGHTEST = 1000
"""Contact covers at least so many pixels."""

BLOCK = 2048
"""Colours whose posterior is summed at a time: 16 MB."""


@dataclass(frozen=True, kw_only=True)
class CameraModel:
    """Colour that a camera makes of light of one spectrum, by the light's level.

    Attributes
    ----------
    levels : ndarray (n,)
        Rising from 0; in any unit, such as the level that fills a raw red pixel.
    output : ndarray (n, 3)
        Linear output of red, green and blue before it is cut to 0 to 1 [1].
    noise : ndarray (n, 3)
        Standard deviation of the same in one pixel [1].
    tone : ndarray (256,)
        Linear output of each 8-bit value, rising from 0 to 1.
    balanced : ndarray (n, 3), optional
        Red, green and blue as they are demosaiced, before the colour matrix [1]; not known of a measured table.
    matrix : ndarray (3, 3), optional
        Makes ``output`` of them.
    """

    levels: Floats
    output: Floats
    noise: Floats
    tone: Floats
    balanced: Floats | None = None
    matrix: Floats | None = None

    @cached_property
    def top(self) -> float:
        """Highest level that a frame can show: above it every channel is clipped or cut."""
        clipped = self.tone[CLIPPED_DN]
        seen = ((self.output > 0) & (self.output < clipped)).any(axis=1)
        last = int(np.flatnonzero(seen)[-1])
        if last + 1 == len(self.levels):
            return float(self.levels[last])
        # the channel that clips between two levels of the table, read along its straight line
        low, high = self.output[last], self.output[last + 1]
        rising = (low > 0) & (low < clipped) & (high > low)
        share = ((clipped - low[rising]) / (high - low)[rising]).max() if rising.any() else 1.0
        return float(self.levels[last] + min(share, 1.0) * (self.levels[last + 1] - self.levels[last]))

    @cached_property
    def first(self) -> float:
        """Level at which the first channel is full."""
        clipped = self.tone[CLIPPED_DN]
        reached = [np.interp(clipped, self.output[: k.argmax() + 1, c], self.levels[: k.argmax() + 1])
                   for c, k in enumerate((self.output >= clipped).T) if k.any()]  # fmt: skip
        return float(min(reached, default=self.top))

    @cached_property
    def blind(self) -> tuple[float, float]:
        """Levels between which a pixel's colour hardly changes: one channel is full, the next still cut."""
        levels = np.geomspace(self.first, self.top, BLIND_STEPS)
        output = np.stack([np.interp(levels, self.levels, self.output[:, c]) for c in range(3)], axis=1)
        colours = np.interp(np.clip(output, 0.0, 1.0), self.tone, np.arange(256.0))
        _, deviation, _ = self.read(np.rint(colours).astype(np.uint8)[None])
        unsure = np.flatnonzero(deviation[0] > BLIND * levels)
        # the part from the first full channel on; near the top all pixels are unsure
        ends = np.flatnonzero(deviation[0] <= BLIND * levels)
        if not unsure.size or not ends.size or unsure[0] > ends[0] + BLIND_STEPS // 10:
            return self.first, self.first
        after = ends[ends > unsure[0]]
        return float(levels[unsure[0]]), float(levels[after[0] if after.size else -1])

    @cached_property
    def _grid(self) -> Floats:
        fine = np.geomspace(DARKEST * self.top, BEYOND * self.top, GRID - 1)
        return np.concatenate([[0.0], fine])

    @cached_property
    def _likelihoods(self) -> list[NDArray[np.float32]]:
        """Logarithm of the probability of each 8-bit value at each level of the grid, a channel each (256, GRID)."""
        middle = self.tone
        edges = np.concatenate([[-np.inf], 0.5 * (middle[1:] + middle[:-1]), [np.inf]])
        width = np.gradient(middle)
        found = []
        for channel in range(3):
            mean = np.interp(self._grid, self.levels, self.output[:, channel])
            noise = np.interp(self._grid, self.levels, self.noise[:, channel])
            # the step of one value at the expected output: rounding, and what the model leaves out
            step = np.interp(mean, middle, width)
            variance = noise**2 + (1 / 12 + MODEL_DN**2) * step**2
            deviation = np.sqrt(variance)
            log = -0.5 * ((middle[:, None] - mean) / deviation) ** 2 - np.log(deviation) + np.log(width[:, None])
            log -= 0.5 * np.log(2 * np.pi)
            log[0] = log_ndtr((edges[1] - mean) / deviation)
            log[CLIPPED_DN:] = log_ndtr((mean - edges[CLIPPED_DN]) / deviation)
            found.append(log.astype(np.float32))
        return found

    def read(self, image: NDArray[np.uint8]) -> tuple[Floats, Floats, Mask]:
        """Return level, its standard deviation, and where a frame shows no more than that the level is above the top.

        Parameters
        ----------
        image : ndarray of uint8 (rows, cols, 3)
            Red, green, blue [DN].

        Returns
        -------
        level, deviation : ndarray (rows, cols)
            In the unit of ``levels``; the level is at most :attr:`top`.
        above : ndarray of bool (rows, cols)
        """
        packed = (image[..., 0].astype(np.int32) << 16) | (image[..., 1].astype(np.int32) << 8) | image[..., 2]
        seen = np.zeros(1 << 24, np.bool_)
        seen[packed] = True
        colours = np.flatnonzero(seen)
        place = np.zeros(1 << 24, np.int32)
        place[colours] = np.arange(len(colours))
        found = np.concatenate([self._posterior(colours[k : k + BLOCK]) for k in range(0, len(colours), BLOCK)], axis=1)
        level, deviation, share = found[:, place[packed]]
        above = share > 0.5
        return np.where(above, self.top, np.minimum(level, self.top)), deviation, above

    def light(self, image: NDArray[np.uint8], dark: Floats | float = 0.0) -> tuple[Floats, Mask]:
        """Return light relative to the highest level that shows in a frame, and where it is at least that.

        Where the contact's light lies between the first channel's end and the next one's beginning, colour does not
        show where half of it is passed: the first channel's end is then full scale, if the foot of the edge below it is
        enough.

        Parameters
        ----------
        image : ndarray of uint8 (rows, cols, 3)
            Red, green, blue [DN].
        dark : ndarray (rows, cols) or float
            Level of the light without contact, which is taken off.

        Returns
        -------
        light : ndarray (rows, cols)
            Up to 1.
        full : ndarray of bool (rows, cols)
        """
        level, _, above = self.read(image)
        count = min(BRIGHTEST, level.size)
        bright = float(np.partition(level, level.size - count, axis=None)[level.size - count])
        contact = float(np.median(level[level >= 0.5 * bright]))
        if self.blind[0] < contact < min(self.blind[1], FOOT_REACHES * self.blind[0]):
            return (np.minimum(level, self.blind[0]) - dark) / self.blind[0], level >= self.blind[0]
        return (level - dark) / self.top, above

    def sides(self, image: NDArray[np.uint8], mask: Mask) -> tuple[float, float]:
        """Return the median levels of a contact and of what is beside it.

        Parameters
        ----------
        image : ndarray of uint8 (rows, cols, 3)
            [DN].
        mask : ndarray of bool (rows, cols)
            Contact.

        Returns
        -------
        contact, beside : float
        """
        level, _, _ = self.read(image)
        near, far = (cv2.dilate(mask.astype(np.uint8), _disk(reach)) > 0 for reach in RING_PX)
        inside, beside = (float(np.median(level[part])) if part.any() else 0.0 for part in (mask, far & ~near))
        return inside, beside

    def edge_uncertainty(self, image: NDArray[np.uint8], mask: Mask, blur_px: float, *, seen: bool) -> float:
        """Return how far a boundary half-way between two levels may lie from the true one by its colours [px].

        Where contact or surroundings lie between two channels' ranges their levels are uncertain alike in all pixels; a
        Gaussian edge's half-way point moves by sqrt(2 pi) blur for each step's height of it.

        Parameters
        ----------
        image : ndarray of uint8 (rows, cols, 3)
            [DN].
        mask : ndarray of bool (rows, cols)
            Contact.
        blur_px : float
            Standard deviation of the camera's blur [px].
        seen : bool
            Whether the contact's own level counts: False for an edge that was read from its foot.

        Returns
        -------
        float
        """
        level, deviation, _ = self.read(image)
        near, far = (cv2.dilate(mask.astype(np.uint8), _disk(reach)) > 0 for reach in RING_PX)
        levels, unsure = [], []
        for part in (mask, far & ~near):
            middle = float(np.median(level[part])) if part.any() else 0.0
            # noise of single pixels does not move an edge; what no channel shows is common to all of them
            spread = float(np.median(deviation[part])) if part.any() else 0.0
            levels.append(middle)
            # an even range of levels ends sqrt(3) standard deviations from its middle
            unsure.append(np.sqrt(3.0) * spread if middle > self.first and spread > BLIND * middle else 0.0)
        inside, outside = unsure[0] if seen else 0.0, unsure[1]
        step = max(levels[0] - levels[1], 1e-9)
        return MIXED_PX + 0.5 * np.sqrt(2 * np.pi) * blur_px * float(np.hypot(inside, outside)) / step

    def misfit(self, image: NDArray[np.uint8], mask: Mask) -> float | None:
        """Return how far the colours of a contact lie from this camera's at the levels that were read from them.

        Parameters
        ----------
        image : ndarray of uint8 (rows, cols, 3)
            [DN].
        mask : ndarray of bool (rows, cols)
            Contact; its rim, where demosaicing mixes colours, is left out.

        Returns
        -------
        float, or None
            Median over pixels of the greatest difference of a channel [DN]; None of a contact too small for it.
        """
        deep = cv2.erode(mask.astype(np.uint8), _disk(RING_PX[0])) > 0
        if deep.sum() < BRIGHTEST:
            return None
        seen = image[deep]
        level, _, _ = self.read(seen[None])
        output = np.stack([np.interp(level[0], self.levels, self.output[:, c]) for c in range(3)], axis=1)
        expected = np.interp(np.clip(output, 0.0, 1.0), self.tone, np.arange(256.0))
        return float(np.median(np.abs(seen - expected).max(axis=1)))

    def _posterior(self, colours: NDArray[np.intp]) -> Floats:
        """Return mean, standard deviation and share above the top of packed colours (3, n)."""
        red, green, blue = self._likelihoods
        log = red[colours >> 16] + green[(colours >> 8) & 255] + blue[colours & 255]
        weight = np.exp(log - log.max(axis=1, keepdims=True)) * np.gradient(self._grid).astype(np.float32)
        weight /= weight.sum(axis=1, keepdims=True)
        mean = weight @ self._grid
        square = weight @ self._grid**2
        above = weight[:, self._grid > self.top].sum(axis=1)
        return np.stack([mean, np.sqrt(np.maximum(square - mean**2, 0.0)), above])


def _disk(radius: int) -> NDArray[np.uint8]:
    return np.asarray(cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1, 2 * radius + 1)), np.uint8)
