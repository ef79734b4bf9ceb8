"""What ridges do to a smooth contact that finite elements have solved: each furrow closed by a half-space.

The smooth macroscopic contact stands (:func:`evanesce.contact.halfspace.resolved.pressed_profile`); the ridges lie on
it and feel a half-space of the silicone's small-strain modulus. Pitch, position and direction of the ridges are not
published: every ratio is a list over what they may be.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from evanesce.contact.fem.library import library_state
from evanesce.contact.fem.state import surface_state
from evanesce.contact.fem.stored import LibrarySlide
from evanesce.contact.halfspace.resolved import contact_area, pressed_profile
from evanesce.contact.halfspace.solver import HalfspaceSolution, press_height_map
from evanesce.contact.ridges.heightmap import RidgeRow
from evanesce.core.states import ContactState, PlateGrid

Floats = NDArray[np.float64]

GRID = PlateGrid(shape=(256, 256), pitch=9.0 / 256)
WIDTH, HEIGHT = 0.5011, 0.04767  # thesis, section 3.5.1, table 4: as moulded [mm]
# Crest to crest: furrows as wide as the ridges; half as wide, or twice [mm]. Not printed.
LIKELY_PITCH = 2 * WIDTH
PITCHES = (LIKELY_PITCH, 1.5 * WIDTH, 3 * WIDTH)


@dataclass(frozen=True)
class Ridging:
    """One guess at what is not published: pitch [mm], a crest or a furrow at the tip, direction [rad]."""

    pitch: float
    furrow_at_tip: bool
    direction: float

    def heights(self, height: float = HEIGHT) -> Floats:
        """Return the depth below the crests on :data:`GRID` [mm].

        Parameters
        ----------
        height : float
            Of the ridges [mm].

        Returns
        -------
        ndarray (rows, cols)
        """
        row = RidgeRow("parallel", self.pitch, WIDTH, height, self.direction)
        shift = 0.5 * self.pitch if self.furrow_at_tip else 0.0
        # moved across the ridges, so that the tip meets a furrow instead of a crest
        dx, dy = -shift * np.sin(self.direction), shift * np.cos(self.direction)
        return row.heights(GRID.x[None, :] + dx, GRID.y[:, None] + dy)


def ridgings(directions: Sequence[float] = (0.0,)) -> Iterator[Ridging]:
    """Yield every guess, the likely pitch first.

    Parameters
    ----------
    directions : sequence of float
        [rad].

    Yields
    ------
    Ridging
    """
    for pitch in PITCHES:
        for direction in directions:
            for furrow in (False, True):
                yield Ridging(pitch, furrow, direction)


def ridged_press(smooth: ContactState, modulus: float, ridges: Floats) -> HalfspaceSolution:
    """Return the press of a smooth contact when ridges [mm, (rows, cols)] lie on its skin.

    Parameters
    ----------
    smooth : ContactState
        On :data:`GRID`.
    modulus : float
        E* at the ridges [MPa].
    ridges : ndarray (rows, cols)
        Depth below the crests [mm]; zeros give the smooth area as this solver has it.

    Returns
    -------
    HalfspaceSolution
    """
    pressure, gap = np.asarray(smooth.pressure, dtype=float), np.asarray(smooth.gap, dtype=float)
    heights = pressed_profile(pressure, gap, ridges, GRID.pitch, modulus)
    return press_height_map(heights, GRID.pitch, modulus, smooth.normal_force)


def ridged_area(smooth: ContactState, modulus: float, ridges: Floats) -> float:
    """Return the area [mm^2] of :func:`ridged_press`."""
    return contact_area(ridged_press(smooth, modulus, ridges).pressure > 0, GRID.pitch)


def pressed(bone: str, force: float) -> ContactState:
    """Return the library's press of Silskin 0 % on :data:`GRID`.

    Parameters
    ----------
    bone : {"none", "half"}
    force : float
        [N].

    Returns
    -------
    ContactState
    """
    return library_state("silskin_0", force, GRID, bone=bone)


def slid(found: LibrarySlide, way: float) -> ContactState:
    """Return a slide's contact at a displacement [mm] on :data:`GRID`, moved to its middle.

    Parameters
    ----------
    found : LibrarySlide
    way : float
        Displacement of the finger [mm].

    Returns
    -------
    ContactState
    """
    print_ = found.footprint(way)
    middle = float(print_.place[print_.touching, 0].mean())
    return surface_state(
        GRID,
        (-middle, 0.0),
        print_,
        depth=found.scalar("depth", way),
        normal_force=found.scalar("normal_force", way),
        tangential_force=found.scalar("tangential_force", way),
        beyond=float(found.inputs["shape"]["length"]),
        parameters={},
    )


def press_ratios(bone: str, modulus: float, force: float = 1.0, *, height: float = HEIGHT) -> Floats:
    """Return ridged over smooth area of a press for every guess; the likely pitch makes the first two.

    Parameters
    ----------
    bone : {"none", "half"}
    modulus : float
        E* at the ridges [MPa].
    force : float
        [N].
    height : float
        Of the ridges [mm]; as moulded by default.

    Returns
    -------
    ndarray (guesses,)
        [1].
    """
    smooth = pressed(bone, force)
    plain = ridged_area(smooth, modulus, np.zeros(GRID.shape))
    return np.array([ridged_area(smooth, modulus, ridging.heights(height)) / plain for ridging in ridgings()])


def slide_ratios(found: LibrarySlide, modulus: float) -> Floats:
    """Return ridged area at a slide's end over that before the slide; the likely pitch makes the first four.

    Parameters
    ----------
    found : LibrarySlide
    modulus : float
        E* at the ridges [MPa].

    Returns
    -------
    ndarray (guesses,)
        [1].
    """
    before, after = slid(found, 0.0), slid(found, float(found.scalars["slide"][-1]))
    guesses = [ridging.heights() for ridging in ridgings((0.0, 0.5 * np.pi))]
    return np.array([ridged_area(after, modulus, h) / ridged_area(before, modulus, h) for h in guesses])
