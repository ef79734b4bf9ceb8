"""LEDs as emitting faces in the plate's frame."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from evanesce.optics.led import emitter_radiance, led_positions
from evanesce.rig import Leds, Plate

Array = NDArray[np.float64]


@dataclass(frozen=True)
class LedTable:
    """Lit LEDs of a plate.

    Attributes
    ----------
    centre : ndarray (n, 2)
        (x, y) of each emitting face [mm]; all lie at mid-thickness.
    normal : ndarray (n, 2)
        Unit vector into the glass.
    radiance : ndarray (n,)
        [W mm^-2 sr^-1].
    width, height : float
        Of an emitting face, along its edge and across the thickness [mm].
    group : ndarray of int (n,)
        Number of the group that each LED belongs to; one group if not given.
    """

    centre: Array
    normal: Array
    radiance: Array
    width: float
    height: float
    group: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, np.int64))

    def __post_init__(self) -> None:
        if self.group.shape != self.radiance.shape:
            object.__setattr__(self, "group", np.zeros(self.radiance.shape, np.int64))


def led_table(
    plate: Plate, leds: Leds, powers: Mapping[str, ArrayLike], groups: Mapping[str, ArrayLike] | None = None
) -> LedTable:
    """Return the LEDs that emit.

    Parameters
    ----------
    plate : Plate
    leds : Leds
    powers : mapping
        Radiant power [W] by edge: of each LED there, or of every one.
    groups : mapping, optional
        Group's number by edge, likewise.
    """
    half_x, half_y = plate.size_mm[0] / 2, plate.size_mm[1] / 2
    side = {"left": (-half_x, 0.0), "right": (half_x, 0.0), "top": (0.0, -half_y), "bottom": (0.0, half_y)}
    centre, normal, radiance = [np.zeros((0, 2))], [np.zeros((0, 2))], [np.zeros(0)]
    group = [np.zeros(0, np.int64)]
    for edge, along in led_positions(plate, leds).items():
        power = np.broadcast_to(np.asarray(powers.get(edge, 0.0), float), along.shape)
        number = np.broadcast_to(np.asarray((groups or {}).get(edge, 0), np.int64), along.shape)
        group.append(number[power > 0])
        along, power = along[power > 0], power[power > 0]
        middle = np.array(side[edge])
        direction = np.array([0.0, 1.0] if edge in ("left", "right") else [1.0, 0.0])
        centre.append(middle + along[:, None] * direction)
        normal.append(np.tile(-np.sign(middle), (along.size, 1)))
        radiance.append(emitter_radiance(leds, 1.0) * power)
    return LedTable(
        np.concatenate(centre),
        np.concatenate(normal),
        np.concatenate(radiance),
        leds.emitting_width_mm,
        leds.emitting_height_mm,
        np.concatenate(group),
    )
