"""Immutable values passed from package to package.

Conventions: arrays are ``[row, col]``; integer coordinates are pixel centres; x points right and y down, on the plate
as in the image. The plate frame has its origin at the middle of the contact region on the glass's top face (z = 0)
and z pointing from the glass into the finger, so that a camera below that looks up along +z has OpenCV's axes and
nothing is mirrored.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import IntEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

FloatMap = NDArray[np.floating[Any]]


def _frozen(array: NDArray[Any]) -> NDArray[Any]:
    """Return a read-only view, so that a state passed on cannot be changed."""
    view = np.asarray(array).view()
    view.flags.writeable = False
    return view


def _centred(count: int) -> NDArray[np.float64]:
    """Return count indices with their mean taken off."""
    return np.arange(count, dtype=np.float64) - (count - 1) / 2


class SurfaceState(IntEnum):
    """State of a surface element, as the labels store it."""

    NONE = 0
    NEAR = 1
    STICK = 2
    SLIP = 3


@dataclass(frozen=True)
class PlateGrid:
    """Regular sampling of the contact plane.

    Attributes
    ----------
    shape : tuple of int
        (rows, cols).
    pitch : float
        Distance of neighbouring samples [mm], the same in x and y.
    centre : tuple of float
        Plate coordinates (x, y) of the grid's middle [mm].
    """

    shape: tuple[int, int]
    pitch: float
    centre: tuple[float, float] = (0.0, 0.0)

    @property
    def x(self) -> NDArray[np.float64]:
        """Plate x of each column [mm], shape (cols,)."""
        return self.centre[0] + _centred(self.shape[1]) * self.pitch

    @property
    def y(self) -> NDArray[np.float64]:
        """Plate y of each row [mm], shape (rows,)."""
        return self.centre[1] + _centred(self.shape[0]) * self.pitch

    @property
    def extent(self) -> tuple[float, float, float, float]:
        """Outer borders (x_min, x_max, y_min, y_max) of the sampled cells [mm]."""
        half = self.pitch / 2
        return self.x[0] - half, self.x[-1] + half, self.y[0] - half, self.y[-1] + half

    def index(self, x: FloatMap, y: FloatMap) -> tuple[FloatMap, FloatMap]:
        """Return fractional (row, col) of plate points [mm].

        Parameters
        ----------
        x : ndarray
            [mm].
        y : ndarray
            [mm], of the same shape.

        Returns
        -------
        tuple of ndarray
            Row and column of each point, integers at cells' middles.
        """
        return (y - self.y[0]) / self.pitch, (x - self.x[0]) / self.pitch


_FIELDS = (
    "pressure",
    "gap",
    "contact_mask",
    "state",
    "real_contact_fraction",
    "traction",
    "slip",
    "slip_velocity",
    "strength",
    "wetted",
)


@dataclass(frozen=True, kw_only=True)
class ContactState:
    """Contact of the finger with the glass at one instant: the ground truth.

    Attributes
    ----------
    grid : PlateGrid
    pressure : ndarray (rows, cols)
        Normal pressure [MPa]; negative where adhesion pulls.
    gap : ndarray (rows, cols)
        Air gap between glass and silicone [mm]; 0 in contact.
    contact_mask : ndarray (rows, cols)
        Share of each cell that is in nominal contact, 0 to 1: the mask at sub-pixel resolution.
    normal_force : float
        [N].
    nominal_contact_area : float
        Exact area of nominal contact [mm^2], not counted from the mask.
    depth : float
        Approach of the finger [mm]; NaN where the law has none.
    traction, slip : ndarray (2, rows, cols), optional
        Tangential traction (x, y) [MPa] and slip displacement [mm].
    slip_velocity : ndarray (2, rows, cols), optional
        Of the skin over the glass (x, y) [mm/s].
    strength : ndarray (rows, cols), optional
        Shear strength: the traction at which a cell slips [MPa].
    wetted : ndarray (rows, cols), optional
        Share of each cell where glass and silicone touch, or a liquid bridges them; the liquid's index stands in
        ``parameters``.
    state : ndarray of uint8 (rows, cols), optional
        :class:`SurfaceState` of each cell.
    real_contact_fraction : ndarray (rows, cols), optional
        Share of nominal contact that is in contact on the scale of roughness.
    tangential_force : tuple of float
        (x, y) [N].
    time : float
        [s].
    law : str
        Name of the law or solver that made it.
    parameters : mapping
        Its parameters, units in the keys.
    """

    grid: PlateGrid
    pressure: FloatMap
    gap: FloatMap
    contact_mask: FloatMap
    normal_force: float
    nominal_contact_area: float
    law: str
    depth: float = float("nan")
    traction: FloatMap | None = None
    slip: FloatMap | None = None
    slip_velocity: FloatMap | None = None
    strength: FloatMap | None = None
    wetted: FloatMap | None = None
    state: NDArray[np.uint8] | None = None
    real_contact_fraction: FloatMap | None = None
    tangential_force: tuple[float, float] = (0.0, 0.0)
    time: float = 0.0
    parameters: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name in _FIELDS:
            array = getattr(self, name)
            if array is None:
                continue
            if array.shape[-2:] != self.grid.shape:
                raise ValueError(f"ContactState.{name} has shape {array.shape}, the grid {self.grid.shape}")
            object.__setattr__(self, name, _frozen(array))


def embedded(state: ContactState, grid: PlateGrid) -> ContactState:
    """Return a state of a part of a grid on all of it: beyond the part nothing touches.

    Parameters
    ----------
    state : ContactState
        The sides of its grid lie within the other one's, and its gap at them is too wide for light to pass.
    grid : PlateGrid
        Of the same pitch; where the state's samples lie between its samples, the whole is shifted by so much.

    Returns
    -------
    ContactState
        The gap is at least as wide as anywhere in the part.
    """
    if state.grid.shape == grid.shape:
        return state
    part = state.grid
    at = [(a[0] - b[0]) / grid.pitch for a, b in ((part.y, grid.y), (part.x, grid.x))]
    row, col = (round(n) for n in at)
    centre = (grid.centre[0] + (at[1] - col) * grid.pitch, grid.centre[1] + (at[0] - row) * grid.pitch)
    here = np.s_[..., row : row + part.shape[0], col : col + part.shape[1]]
    changes: dict[str, Any] = {}
    for name in _FIELDS:
        array = getattr(state, name)
        if array is not None:
            beyond = array.max() if name == "gap" else 1.0 if name == "real_contact_fraction" else 0
            changes[name] = np.full((*array.shape[:-2], *grid.shape), beyond, array.dtype)
            changes[name][here] = array
    return replace(state, grid=PlateGrid(grid.shape, grid.pitch, centre), **changes)


@dataclass(frozen=True, kw_only=True)
class PlateLight:
    """Light that leaves the plate towards the lens, as an ideal (distortion-free) pinhole sees it.

    Attributes
    ----------
    radiance : ndarray (rows, cols)
        Mean radiance over each pixel's box [W mm^-2 sr^-1].
    variance : ndarray (rows, cols)
        Variance of that mean, estimated from independent passes [(W mm^-2 sr^-1)^2].
    focal_px : float
        Focal length of the pinhole [px].
    principal_point : tuple of float
        (x, y) of the optical axis [px], integer = pixel centre.
    samples : int
        Paths per pixel in all.
    """

    radiance: FloatMap
    variance: FloatMap
    focal_px: float
    principal_point: tuple[float, float]
    samples: int = 0

    def __post_init__(self) -> None:
        object.__setattr__(self, "radiance", _frozen(self.radiance))
        object.__setattr__(self, "variance", _frozen(self.variance))


@dataclass(frozen=True, kw_only=True)
class SensorLight:
    """Irradiance on the sensor, after lens and distortion.

    Attributes
    ----------
    irradiance : ndarray (rows, cols)
        Mean over each pixel [W mm^-2].
    """

    irradiance: FloatMap

    def __post_init__(self) -> None:
        object.__setattr__(self, "irradiance", _frozen(self.irradiance))


@dataclass(frozen=True, kw_only=True)
class Frame:
    """A digital image as the pipeline reads it.

    Attributes
    ----------
    data : ndarray of uint8, (rows, cols) or (rows, cols, 3)
        8-bit grey or RGB [DN].
    time : float
        Mid-exposure time since the first frame [s].
    index : int
    raw : ndarray of uint16 (rows, cols), optional
        12-bit values before the tone curve [DN]; of a colour camera the mosaic.
    exposure_ms, analogue_gain : float, optional
        [ms], [1]; given where the camera chose them itself.
    balance : tuple of float, optional
        White balance of red and blue over green, likewise [1].
    """

    data: NDArray[np.uint8]
    time: float = 0.0
    index: int = 0
    raw: NDArray[np.uint16] | None = None
    exposure_ms: float | None = None
    analogue_gain: float | None = None
    balance: tuple[float, float] | None = None

    @property
    def chosen(self) -> dict[str, float]:
        """What the camera chose itself: ``exposure_ms``, ``analogue_gain``, ``red_gain``, ``blue_gain``."""
        red, blue = self.balance or (None, None)
        found = {
            "exposure_ms": self.exposure_ms, "analogue_gain": self.analogue_gain, "red_gain": red, "blue_gain": blue,
        }  # fmt: skip
        return {name: value for name, value in found.items() if value is not None}


@dataclass(frozen=True, kw_only=True)
class Estimate:
    """Result of the measurement for one frame.

    Attributes
    ----------
    mask : ndarray of bool (rows, cols)
        Segmented contact in the rectified, cropped frame.
    pixels : int
        Count of True.
    area : float
        [mm^2].
    time : float
        [s].
    index : int
    """

    mask: NDArray[np.bool_]
    pixels: int
    area: float
    time: float = 0.0
    index: int = 0
