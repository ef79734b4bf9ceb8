"""Calibration targets, printed cards, through the glass and lens of a contact: checkerboard and square, any pose."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.core.errors import InputError
from evanesce.core.states import PlateLight
from evanesce.optics.projection import IdealView, Projection, rotation
from evanesce.render.reference.passes import Until, pass_samples, trace
from evanesce.render.reference.path import integrator_for
from evanesce.render.reference.scene import camera_dict, card_mesh, plate_scene
from evanesce.render.variant import select
from evanesce.rig import Cards, Scene

Array = NDArray[np.float64]

AIR_FILM = 0.05
"""Distance of paper that lies on the glass [mm]: no optical contact, so no guided light couples into it."""

SOURCE_DISTANCE = 400.0
SOURCE_HALF_SIZE = 4000.0


@dataclass(frozen=True, kw_only=True)
class Card:
    """A printed card; what lies on the glass is its printed face.

    Attributes
    ----------
    squares : tuple of int, optional
        Columns and rows of a checkerboard; None for one plain square.
    side : float
        Side of one square [mm].
    margin : float
        Blank border around the print [mm].
    white, black : float
        Diffuse reflectance of paper and ink [1].
    inverted : bool
        A black square on white instead of a white one on black; a checkerboard that begins with a black square.
    """

    squares: tuple[int, int] | None = None
    side: float = 15.0
    margin: float = 5.0
    white: float = 0.8
    black: float = 0.05
    inverted: bool = False

    @property
    def size(self) -> tuple[float, float]:
        """Printed extent (x, y) without the margin [mm]."""
        cols, rows = self.squares or (1, 1)
        return cols * self.side, rows * self.side

    def corners(self) -> Array:
        """Inner corners of a checkerboard on the card, x fastest, shape (n, 2) [mm]; the outer four of a square."""
        cols, rows = self.squares or (1, 1)
        x = (np.arange(1, cols) if self.squares else np.arange(2)) * self.side - cols * self.side / 2
        y = (np.arange(1, rows) if self.squares else np.arange(2)) * self.side - rows * self.side / 2
        return np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)


def checkerboard_of(cards: Cards) -> Card:
    """Return the checkerboard that a rig's ``[card]`` table describes.

    Parameters
    ----------
    cards : Cards
    """
    return Card(
        squares=cards.checkerboard_squares,
        side=cards.checkerboard_side_mm,
        margin=cards.checkerboard_margin_mm,
        white=cards.white_reflectance,
        black=cards.black_reflectance,
        inverted=cards.checkerboard_inverted,
    )


def square_of(cards: Cards) -> Card:
    """Return the plain square that a rig's ``[card]`` table describes.

    Parameters
    ----------
    cards : Cards
    """
    return Card(
        side=cards.square_side_mm,
        margin=cards.square_margin_mm,
        white=cards.white_reflectance,
        black=cards.black_reflectance,
        inverted=cards.square_inverted,
    )


CHECKERBOARD = checkerboard_of(Cards())
SQUARE = square_of(Cards())


@dataclass(frozen=True, kw_only=True)
class Pose:
    """Position and orientation of a card: tilted, rotated, then shifted; flat on the glass at the origin by default.

    Attributes
    ----------
    shift : tuple of float
        (x, y) of its middle on the plate [mm].
    height : float
        Of its middle above the glass [mm]; at least what the tilt needs to clear the glass.
    rotation_deg, tilt_x_deg, tilt_y_deg : float
        About the plate's normal, x and y [deg].
    """

    shift: tuple[float, float] = (0.0, 0.0)
    height: float = AIR_FILM
    rotation_deg: float = 0.0
    tilt_x_deg: float = 0.0
    tilt_y_deg: float = 0.0

    def to_plate(self, points: Array) -> Array:
        """Return card points (n, 2) in plate coordinates (n, 3) [mm]."""
        turn = rotation(*np.deg2rad([self.tilt_x_deg, self.tilt_y_deg, self.rotation_deg]))
        flat = np.column_stack([points, np.zeros(len(points))])
        return flat @ turn.T + [self.shift[0], self.shift[1], self.height]


def pose_of(cards: Cards, pose: Pose | None = None) -> Pose:
    """Return where a card's printed side really is: as far above its intended pose as it stands off when lying.

    Parameters
    ----------
    cards : Cards
    pose : Pose, optional
        Intended; flat on the glass at the origin if not given.
    """
    intended = pose or Pose()
    return replace(intended, height=intended.height + (cards.height_mm - AIR_FILM))


@dataclass(frozen=True, kw_only=True)
class Illumination:
    """Illumination of a card from below: a wide surface whose radiance may rise to one side.

    Attributes
    ----------
    radiance : float
        Straight below the plate's middle [W mm^-2 sr^-1].
    gradient : tuple of float
        Relative rise of radiance per unit tangent of direction towards +x and +y.
    """

    radiance: float = 3.0e-6
    gradient: tuple[float, float] = (0.0, 0.0)

    def shape(self) -> dict[str, Any]:
        """Return the light as a Mitsuba shape."""
        import mitsuba as mi

        steps = 64
        tangent = (np.arange(steps) - (steps - 1) / 2) / steps * 2 * SOURCE_HALF_SIZE / SOURCE_DISTANCE
        level = 1.0 + self.gradient[0] * np.tanh(tangent)[None, :] + self.gradient[1] * np.tanh(tangent)[:, None]
        # The bitmap's first row lies at v = 0, the rectangle's lowest y; its own normal is +z.
        picture = np.ascontiguousarray((self.radiance * np.clip(level, 0.0, None))[:, :, None].astype(np.float32))
        position = (
            mi.ScalarTransform4f().translate([0, 0, -SOURCE_DISTANCE]).scale([SOURCE_HALF_SIZE, SOURCE_HALF_SIZE, 1])
        )
        texture = {"type": "bitmap", "bitmap": mi.Bitmap(picture), "raw": True, "wrap_mode": "clamp"}
        return {"type": "rectangle", "to_world": position, "emitter": {"type": "area", "radiance": texture}}


def _card_shapes(card: Card, pose: Pose) -> dict[str, Any]:
    """Return the printed face as tiles of paper and tiles of ink, facing down."""
    half_x, half_y = card.size[0] / 2, card.size[1] / 2
    outer_x, outer_y = half_x + card.margin, half_y + card.margin
    frame = [
        (-outer_x, -half_x, -outer_y, outer_y),
        (half_x, outer_x, -outer_y, outer_y),
        (-half_x, half_x, -outer_y, -half_y),
        (-half_x, half_x, half_y, outer_y),
    ]
    white: list[tuple[float, float, float, float]] = []
    black: list[tuple[float, float, float, float]] = []
    cols, rows = card.squares or (1, 1)
    for col in range(cols):
        for row in range(rows):
            tile = (
                -half_x + col * card.side,
                -half_x + (col + 1) * card.side,
                -half_y + row * card.side,
                -half_y + (row + 1) * card.side,
            )
            (black if (col + row + card.inverted) % 2 else white).append(tile)
    if card.squares is None:
        (white if card.inverted else black).extend(frame if card.margin > 0 else [])
        if card.inverted:
            white, black = [t for t in white if t in frame], [tile]
    else:
        white += frame if card.margin > 0 else []
    tiles = {"paper": (white, card.white), "ink": (black, card.black)}
    return {name: card_mesh(name, t, pose.to_plate, level) for name, (t, level) in tiles.items() if t}


def require_above_glass(card: Card, pose: Pose) -> None:
    """Refuse a pose in which a corner of the card would reach into the glass.

    Raises
    ------
    InputError
    """
    reach = np.array([[sx * (s + 2 * card.margin) / 2 for sx, s in zip(sign, card.size, strict=True)]
                      for sign in ((-1, -1), (-1, 1), (1, -1), (1, 1))])  # fmt: skip
    lowest = float(pose.to_plate(reach)[:, 2].min())
    if lowest <= 0:
        raise InputError(
            f"the card reaches {-lowest:.3g} mm into the glass",
            key="height",
            allowed=f"at least {pose.height - lowest + AIR_FILM:.3g} mm for this tilt",
        )


def render_card(
    scene: Scene,
    card: Card,
    pose: Pose | None = None,
    *,
    illumination: Illumination | None = None,
    variant: str = "auto",
    samples_per_pixel: int = 16,
    passes: int = 4,
    seed: int = 0,
    view: IdealView | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> PlateLight:
    """Path trace a card through the plate, LEDs off.

    Parameters
    ----------
    scene : Scene
        Plate and camera are used.
    card : Card
    pose : Pose, optional
        Flat on the glass at the origin if not given.
    illumination : Illumination, optional
    variant, samples_per_pixel, passes, seed, view, progress
        As for :func:`evanesce.render.reference.path.render`.

    Returns
    -------
    PlateLight

    Raises
    ------
    InputError
        If the card would reach into the glass.
    """
    pose, illumination = pose or Pose(), illumination or Illumination()
    require_above_glass(card, pose)
    projection = Projection.of(scene.camera, scene.plate)
    view = projection.ideal_view() if view is None else view
    info = select(variant)
    shapes = (
        plate_scene(scene, None, {}, info.is_jit).shapes | _card_shapes(card, pose) | {"source": illumination.shape()}
    )
    sums = trace(
        shapes,
        camera_dict(projection, view),
        integrator_for(scene, info, None, {}),
        samples=pass_samples(samples_per_pixel, passes),
        until=Until(passes),
        seed=seed,
        name="card",
        tick=progress or (lambda done, total: None),
    )
    return PlateLight(
        radiance=sums.mean[..., 0],
        variance=sums.variance_of_mean[..., 0],
        focal_px=view.focal_px,
        principal_point=view.principal_point,
        samples=pass_samples(samples_per_pixel, passes) * passes,
    )
