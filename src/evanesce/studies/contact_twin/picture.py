"""A contact frame as the twin's fit takes it: in blocks of pixels, halves of the frame for fitting and for judging."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from evanesce.core.errors import InputError

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

MOST_COLUMNS = 64
"""Columns that the fit works on: what a contact's outline, its flank and a cloudy ground need; the time of a fit grows
with their square."""
LEAST_SIDE = 16
BLOCK = 5
"""Side of the blocks that are fitted and held out by turns [px of the fit]: wider than the frame's blur."""
BRIGHT_DN = 200.0
"""A channel above this is bright: between what is seen of flank and contact (green 0 and 254) any level does."""
DARK_DN = 30.0
LEAST_PIXELS = 12
"""Fewer pixels of contact or flank than this give no outline to start from."""
LUMA = np.array([0.2125, 0.7154, 0.0721])
"""Weights of the published grey image."""


@dataclass(frozen=True)
class Picture:
    """Mean colours of blocks of a frame's pixels.

    Attributes
    ----------
    data : ndarray (rows, cols, 3)
        Red, green, blue [DN].
    held_out : ndarray of bool (rows, cols)
        Pixels that no fit may see.
    bin_px : int
        Pixels of the frame along a side of one of these.
    """

    data: Array
    held_out: Mask
    bin_px: int

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, cols)."""
        rows, cols = self.held_out.shape
        return rows, cols

    @property
    def grey(self) -> Array:
        """Grey of the published chain (rows, cols) [1]."""
        return np.asarray(self.data @ LUMA / 255.0)


def picture_of(frame: NDArray[np.uint8], name: str = "frame") -> Picture:
    """Return a frame in blocks that the fit works on.

    Parameters
    ----------
    frame : ndarray of uint8 (rows, cols, 3)
        Of a colour camera [DN].
    name : str
        For errors.

    Returns
    -------
    Picture

    Raises
    ------
    InputError
        If the frame is grey or too small.
    """
    if frame.ndim != 3 or frame.shape[2] != 3:
        raise InputError("a grey picture", file=name, allowed="red, green and blue: the frame of a colour camera")
    if min(frame.shape[:2]) < LEAST_SIDE:
        raise InputError(
            f"{frame.shape[1]} x {frame.shape[0]} pixels", file=name, allowed=f"sides from {LEAST_SIDE} px"
        )
    step = max(1, -(-frame.shape[1] // MOST_COLUMNS))
    rows, cols = (n // step for n in frame.shape[:2])
    cut = frame[: rows * step, : cols * step].astype(np.float64)
    data = cut.reshape(rows, step, cols, step, 3).mean(axis=(1, 3))
    row, col = np.indices((rows, cols)) // BLOCK
    return Picture(data, (row + col) % 2 == 1, step)


@dataclass(frozen=True)
class Outline:
    """Discs of contact and finger, found by colour: where a fit starts.

    Attributes
    ----------
    centre : tuple of float
        (x, y) of both, integer coordinates are pixel centres [px].
    contact_radius, finger_radius : float
        [px].
    """

    centre: tuple[float, float]
    contact_radius: float
    finger_radius: float


def outline_of(picture: Picture, name: str = "frame") -> Outline:
    """Return the discs of contact and finger.

    The contact is where green is bright, the flank where only red is: the largest connected part of each. A flank that
    is nowhere bright gets one and a half times the contact's radius.

    Parameters
    ----------
    picture : Picture
    name : str
        For errors.

    Returns
    -------
    Outline

    Raises
    ------
    InputError
        If no contact is bright.
    """
    red, green = picture.data[..., 0], picture.data[..., 1]
    contact = _largest(green > BRIGHT_DN)
    if contact.sum() < LEAST_PIXELS:
        contact = _largest(picture.grey > 0.5 * picture.grey.max())
    if contact.sum() < LEAST_PIXELS:
        raise InputError("no contact that is brighter than its surroundings", file=name)
    # By half of its own level, so that pixels on the edge count by what they hold.
    level = green if green[contact].mean() > DARK_DN else picture.grey
    contact = _largest(level > 0.5 * np.median(level[contact]))
    rows, cols = np.nonzero(contact)
    centre = float(cols.mean()), float(rows.mean())
    radius = float(np.sqrt(contact.sum() / np.pi))
    lit = _largest((red > BRIGHT_DN) | contact)
    # The finger is round about the contact: what lies farther out than most of it is a streak or the border.
    distance = np.hypot(*(np.indices(lit.shape) - np.array([centre[1], centre[0]])[:, None, None]))
    rings = np.arange(1, int(distance.max()))
    share = np.array([lit[np.abs(distance - r) <= 0.5].mean() for r in rings])
    beyond = rings[(rings > radius) & (share < 0.5)]
    finger = float(beyond[0]) - 0.5 if beyond.size and beyond[0] > radius + 2 else 1.5 * radius
    return Outline(centre, radius, finger)


def _largest(mask: Mask) -> Mask:
    """Return the largest connected part of a mask."""
    labels, count = ndimage.label(mask)
    if count == 0:
        return mask
    return np.asarray(labels == 1 + np.argmax(ndimage.sum_labels(mask, labels, np.arange(1, count + 1))))


def regions(data: Array) -> dict[str, Mask]:
    """Return masks of contact, ring and ground by colour; pixels between them are in none.

    Parameters
    ----------
    data : ndarray (rows, cols, 3)
        [DN].

    Returns
    -------
    dict of ndarray of bool (rows, cols)
    """
    red, green = data[..., 0], data[..., 1]
    return {
        "contact": green > BRIGHT_DN,
        "ring": (red > BRIGHT_DN) & (green < DARK_DN),
        "ground": (red <= BRIGHT_DN) & (green < DARK_DN),
    }
