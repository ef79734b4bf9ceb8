"""A view: one state of the rig, however many frames were taken of it; and how pixels are binned."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]

BIN_PX = 4
"""Side of a bin in pixels of the model camera; two bins are a JPEG block's 8 px, four a macroblock."""

CARDS = ("checkerboard", "square")


@dataclass(frozen=True, kw_only=True)
class View:
    """One state.

    Attributes
    ----------
    kind : str
        ``press``, ``replicate``, ``led_off``, ``lens_cap``, ``checkerboard`` or ``square``.
    force_N : float or None
        Noted normal force [N]; None where the finger is away.
    voltage_V : float
        Supply of the LEDs; 0 where they are off [V].
    time_s : float
        [s].
    index : int
        Number of its first frame.
    session, condition : int
        See :class:`evanesce.bundle.layout.Shot`.
    displacement_mm : float
        NaN where not noted [mm].
    frames : int
        How many frames its image is the mean of.
    locked : bool
        Kept from every fit and choice until the gain is measured.
    """

    kind: str
    force_N: float | None = None
    voltage_V: float = 0.0
    time_s: float = 0.0
    index: int = 0
    session: int = 0
    condition: int = 0
    displacement_mm: float = math.nan
    frames: int = 1
    locked: bool = False

    @property
    def is_card(self) -> bool:
        """Whether it shows a printed card."""
        return self.kind in CARDS

    @property
    def touches(self) -> bool:
        """Whether the finger is on the plate."""
        return self.force_N is not None


def binned(image: Array, side: int = BIN_PX) -> Array:
    """Return the means of ``side`` x ``side`` bins of the last two axes; what fills no bin is left out."""
    rows, cols = image.shape[-2] // side, image.shape[-1] // side
    whole = np.asarray(image[..., : rows * side, : cols * side], float)
    # Slice by slice: a mean over two short axes of an array of four takes four times as long.
    by_row = functools.reduce(np.add, [whole[..., k::side, :] for k in range(side)])
    return np.asarray(functools.reduce(np.add, [by_row[..., k::side] for k in range(side)]) / side**2)
