"""Frames of a slide as contact states on the plate's grid, each made when it is indexed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, overload

import numpy as np
from numpy.typing import NDArray

from evanesce.contact.coverage import half_plane_share
from evanesce.contact.patch import require_fit
from evanesce.contact.sliding.solver import Slide, SlideFrame
from evanesce.core.states import ContactState, PlateGrid, SurfaceState

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class SlideView:
    """Where and how a slide is seen.

    Attributes
    ----------
    centre : tuple of float
        Contact centre (x, y) before the slide [mm].
    direction : float
        Of the finger over the glass [rad], from x towards y.
    follows : bool
        True where glass and camera stand and the finger travels; False where the glass is drawn away under both.
    trailing_share : float
        Share of the area loss that is taken from the trailing edge; the rest from the leading one. The thesis sees the
        patch shrink asymmetrically and gives no figure: 1 is an assumption.
    near_gap : float
        Gap below which a surface counts as near [mm].
    """

    centre: tuple[float, float] = (0.0, 0.0)
    direction: float = 0.0
    follows: bool = True
    trailing_share: float = 1.0
    near_gap: float = 0.01


@dataclass(frozen=True)
class _Ellipse:
    """Contact outline: a circle shortened along the slide."""

    centre: tuple[float, float]
    radius: float
    shortening: float
    direction: float


class SlideStates(Sequence[ContactState]):
    """The contact states of a slide; each is computed when it is indexed, so that long slides need no memory.

    Parameters
    ----------
    slide : Slide
    grid : PlateGrid
    view : SlideView
    law : str
        Name of the normal law.
    parameters : mapping, optional
        Recorded in each state.
    rates : sequence of ndarray (springs,), optional
        Of each frame the speed of its springs over the glass [mm/s]; states have a slip velocity then.

    Raises
    ------
    InputError
        If the contact leaves the grid in any frame.
    """

    def __init__(
        self,
        slide: Slide,
        grid: PlateGrid,
        view: SlideView | None = None,
        *,
        law: str = "sliding",
        parameters: Mapping[str, Any] | None = None,
        rates: Sequence[Floats] | None = None,
    ) -> None:
        self._slide, self._grid, self._view, self._rates = slide, grid, view or SlideView(), rates
        self._law, self._parameters = law, dict(parameters or {})
        for frame in slide:
            outline = self._outline(frame)
            require_fit(grid, outline.centre, outline.radius)
        # Tractions are means over annuli as wide as a cell, as pressures are; narrower ones would show the springs.
        width = max(grid.pitch, 6.0 * float(slide.edges[1]))
        reach = float(slide.edges[-1]) + width
        self._radii = np.linspace(0.0, reach, 1024)
        self._inner, self._outer = np.maximum(self._radii - width / 2, 0.0), self._radii + width / 2
        self._annulus_area = np.pi * (self._outer**2 - self._inner**2)
        within = force_within_matrix
        self._traction = (within(self._outer, slide.edges) - within(self._inner, slide.edges)) / self._annulus_area[
            :, None
        ]
        self._slip = surface_slip_matrix(np.minimum(self._radii, slide.edges[-1]), slide.edges)

    def __len__(self) -> int:
        return len(self._slide)

    @overload
    def __getitem__(self, index: int) -> ContactState: ...
    @overload
    def __getitem__(self, index: slice) -> list[ContactState]: ...
    def __getitem__(self, index: int | slice) -> ContactState | list[ContactState]:
        if isinstance(index, slice):
            return [self[i] for i in range(*index.indices(len(self)))]
        return self.on(self._grid, index)

    def on(self, grid: PlateGrid, index: int) -> ContactState:
        """Return the state of a frame on another grid of the same pitch, which holds the frame's contact.

        Parameters
        ----------
        grid : PlateGrid
        index : int
        """
        rates = None if self._rates is None else self._rates[index]
        return self.of(self._slide.frames[index], grid, rates)

    def centre(self, index: int) -> tuple[float, float]:
        """Return the middle (x, y) of a frame's contact [mm].

        Parameters
        ----------
        index : int

        Returns
        -------
        tuple of float
        """
        return self.centre_of(self._slide.frames[index])

    def centre_of(self, frame: SlideFrame) -> tuple[float, float]:
        """Return the middle (x, y) of the contact of any frame on the slide's springs [mm].

        Parameters
        ----------
        frame : SlideFrame
        """
        return self._outline(frame).centre

    def _outline(self, frame: SlideFrame) -> _Ellipse:
        """Return the outline: the lost area shortens the circle along the slide, about its leading edge."""
        view, a = self._view, frame.contact.contact_radius
        shortening = frame.area / (np.pi * a**2) if a > 0 else 1.0
        sense = np.sign(frame.tangential_force) or 1.0
        shift = sense * (2.0 * view.trailing_share - 1.0) * a * (1.0 - shortening)
        along = (frame.tip_displacement if view.follows else 0.0) + shift
        centre = (
            view.centre[0] + along * np.cos(view.direction),
            view.centre[1] + along * np.sin(view.direction),
        )
        return _Ellipse((float(centre[0]), float(centre[1])), a, float(shortening), view.direction)

    def of(self, frame: SlideFrame, grid: PlateGrid, rates: Floats | None = None) -> ContactState:
        """Return the state of any frame on the slide's springs, on a grid of the same pitch that holds its contact.

        Parameters
        ----------
        frame : SlideFrame
        grid : PlateGrid
        rates : ndarray (springs,), optional
            Speed of the springs over the glass [mm/s].
        """
        contact, outline = frame.contact, self._outline(frame)
        rho, normal_x, normal_y = _round_radius(grid, outline)
        gap = contact.gap(rho)
        mask = _coverage(grid, outline, rho, normal_x, normal_y)
        fields = self._fields(frame, rates, outline, rho, mask)
        cos, sin = np.cos(outline.direction), np.sin(outline.direction)
        touching = mask >= 0.5
        state = np.where(gap < self._view.near_gap, np.uint8(SurfaceState.NEAR), np.uint8(SurfaceState.NONE))
        state[touching] = SurfaceState.SLIP
        state[touching & (rho < frame.stick_radius)] = SurfaceState.STICK
        q = frame.tangential_force
        return ContactState(
            grid=grid,
            pressure=fields["pressure"],
            gap=gap,
            contact_mask=mask,
            normal_force=contact.normal_force,
            nominal_contact_area=frame.area,
            depth=contact.depth,
            traction=np.stack([fields["traction"] * cos, fields["traction"] * sin]),
            slip=np.stack([fields["slip"] * cos, fields["slip"] * sin]),
            slip_velocity=None if rates is None else np.stack([fields["speed"] * cos, fields["speed"] * sin]),
            strength=fields["strength"],
            state=state,
            tangential_force=(float(q * cos), float(q * sin)),
            time=frame.time,
            law=self._law,
            parameters={
                **self._parameters,
                "stick_ratio": frame.stick_ratio,
                "stick_radius_mm": frame.stick_radius,
                "tip_displacement_mm": frame.tip_displacement,
            },
        )

    def _fields(
        self, frame: SlideFrame, rates: Floats | None, outline: _Ellipse, rho: Floats, mask: Floats
    ) -> dict[str, Floats]:
        """Return pressure, traction, strength and slip on the grid; the stresses rise as the area shrinks."""
        contact = frame.contact
        pressure = (contact.force_within(self._outer) - contact.force_within(self._inner)) / self._annulus_area
        tables = {
            "pressure": (pressure / outline.shortening, contact.normal_force),
            "traction": (self._traction @ frame.force_density / outline.shortening, frame.tangential_force),
            "strength": (np.maximum(self._traction @ frame.limit_density / outline.shortening, 0.0), None),
            "slip": (self._slip @ self._continued(frame, frame.spring_slip), None),
        }
        if rates is not None:
            tables["speed"] = (self._slip @ self._continued(frame, rates), None)
        inside = np.flatnonzero(rho.ravel() < self._radii[-2])
        at = rho.ravel()[inside] / self._radii[1]
        cell = at.astype(np.int64)
        share = at - cell
        result = {}
        for name, (table, total) in tables.items():
            values = table[cell] + share * (table[cell + 1] - table[cell])
            if name in ("slip", "speed"):
                values[mask.ravel()[inside] <= 0.0] = 0.0
            elif total:
                carried = float(values.sum()) * self._grid.pitch**2
                if abs(carried) > 0.5 * abs(total):  # annuli on squares: below 0.1 % from 20 cells per radius on
                    values *= total / carried
            full = np.zeros(rho.size)
            full[inside] = values
            result[name] = full.reshape(rho.shape)
        return result

    def _continued(self, frame: SlideFrame, slips: Floats) -> Floats:
        """Return the springs' slips (or rates), the outermost one's continued outside, so that tables are smooth."""
        count = int(np.searchsorted(self._slide.edges[:-1], frame.contact.contact_radius))
        slips = slips.copy()
        if 0 < count < len(slips):
            slips[count:] = slips[count - 1]
        return slips


def force_within_matrix(radii: Floats, edges: Floats) -> Floats:
    """Return the matrix that turns spring force densities [N/mm] into the force inside radii [N], (len(radii), m).

    A spring density of 1 up to x = b is a rigid punch of radius b, which carries 2 (b - sqrt(b^2 - r^2)) within r.

    Parameters
    ----------
    radii : ndarray (n,)
        [mm].
    edges : ndarray (m + 1,)
        Borders of the springs, from 0 [mm].

    Returns
    -------
    ndarray (n, m)
    """
    chord = np.sqrt(np.clip(edges[None, :] ** 2 - radii[:, None] ** 2, 0.0, None))
    return 2.0 * (np.diff(edges)[None, :] - np.diff(chord, axis=1))


def surface_slip_matrix(radii: Floats, edges: Floats) -> Floats:
    """Return the matrix that turns spring slips [mm] into surface slips at radii [mm]: (2/pi) of an arcsine's steps.

    Parameters
    ----------
    radii : ndarray (n,)
        [mm].
    edges : ndarray (m + 1,)
        Borders of the springs, from 0 [mm].

    Returns
    -------
    ndarray (n, m)
    """
    matrix = np.empty((len(radii), len(edges) - 1))
    for i, r in enumerate(radii):
        if r <= edges[1]:
            matrix[i], matrix[i, 0] = 0.0, 1.0
        else:
            matrix[i] = 2.0 / np.pi * np.diff(np.arcsin(np.clip(edges / r, 0.0, 1.0)))
    return matrix


def _round_radius(grid: PlateGrid, outline: _Ellipse) -> tuple[Floats, Floats, Floats]:
    """Return the radius in the unshortened circle [mm] and its gradient times that radius, each (rows, cols)."""
    x, y = grid.x[None, :] - outline.centre[0], grid.y[:, None] - outline.centre[1]
    cos, sin = np.cos(outline.direction), np.sin(outline.direction)
    along, across = (x * cos + y * sin) / outline.shortening, y * cos - x * sin
    rho = np.sqrt(along**2 + across**2)
    g = along / outline.shortening
    return rho, g * cos - across * sin, g * sin + across * cos


def _coverage(grid: PlateGrid, outline: _Ellipse, rho: Floats, gx: Floats, gy: Floats) -> Floats:
    """Return the share of each cell inside the outline; a border cell is cut by the outline's tangent.

    The sagitta left out is pitch^2/(8 radius), so the summed area is good to about (pitch/radius)^2/24.
    """
    if outline.radius <= 0:
        return np.zeros(grid.shape)
    mask = (rho < outline.radius).astype(float)
    band = np.flatnonzero(np.abs(rho - outline.radius) < 1.5 * grid.pitch / outline.shortening)
    r = rho.ravel()[band]
    slope_x, slope_y = gx.ravel()[band] / r, gy.ravel()[band] / r  # gradient of rho
    steep = np.hypot(slope_x, slope_y)
    distance = (outline.radius - r) / steep / grid.pitch
    mask.ravel()[band] = half_plane_share(distance, np.abs(slope_x / steep), np.abs(slope_y / steep))
    return mask
