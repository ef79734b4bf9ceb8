"""A printed card on the glass without path tracing: paper, ink and two faces of glass under even illumination.

Each pixel's share of paper comes in closed form where the card lies flat: the pixel's footprint is taken as a rectangle
along the card's axes, so that a checkerboard's mean over it is a product of two means of square waves. A tilted card's
is counted by sub-rays. Fresnel's equations give the light that the glass reflects and transmits. The path tracer's
:func:`evanesce.render.cards.render_card` is the reference.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from evanesce.core.states import PlateLight
from evanesce.optics.interface import fresnel_reflectance
from evanesce.optics.projection import IdealView, Projection
from evanesce.render.cards import Card, Illumination, Pose
from evanesce.rig import Scene

Array = NDArray[np.float64]

SUB_RAYS = 8
"""Sub-rays along a pixel's side."""

FRESNEL_NODES = 4096
"""Angles at which Fresnel's equations are solved; between them the curve is a line to 1e-8."""


def card_light(
    scene: Scene,
    card: Card,
    pose: Pose | None = None,
    *,
    illumination: Illumination | None = None,
    view: IdealView | None = None,
    points: tuple[Array, Array, Array] | None = None,
    soft: bool = False,
) -> PlateLight:
    """Return the light of a card under even illumination, LEDs off.

    Parameters
    ----------
    scene : Scene
        Plate and camera are used.
    card : Card
    pose : Pose, optional
        Flat on the glass at the origin if not given.
    illumination : Illumination, optional
        Its radiance; a gradient is not modelled here.
    view : IdealView, optional
        Pinhole grid; the one that covers the frame by default.
    points : tuple of ndarray, optional
        :func:`plane_points` of that view and the card's height, where they are known.
    soft : bool
        Weigh each pixel's footprint by a triangle that reaches to its neighbours' middles instead of evenly: what a
        pixel shows then has a derivative by where an edge lies that changes with no step.

    Returns
    -------
    PlateLight
        With zero variance.

    Raises
    ------
    ValueError
        If the illumination has a gradient.
    """
    pose, illumination = pose or Pose(), illumination or Illumination()
    if any(illumination.gradient):
        raise ValueError("only even illumination is modelled; use render_card")
    projection = Projection.of(scene.camera, scene.plate)
    view = projection.ideal_view() if view is None else view
    x, y, cosine = points or plane_points(projection, view, pose.height)
    if pose.tilt_x_deg == 0.0 and pose.tilt_y_deg == 0.0:
        albedo = mean_reflectance(card, *_on_card(pose, x, y), soft=soft)
    else:
        albedo = _counted(projection, card, pose, view)
    seen = illumination.radiance * through_glass(scene, albedo, cosine, _mean_albedo(card))
    return PlateLight(
        radiance=seen,
        variance=np.zeros_like(seen),
        focal_px=view.focal_px,
        principal_point=view.principal_point,
        samples=0,
    )


def plane_points(projection: Projection, view: IdealView, height_mm: float) -> tuple[Array, Array, Array]:
    """Return where the pixels of a view meet a plane above the glass, and their cosine to it.

    Parameters
    ----------
    projection : Projection
    view : IdealView
    height_mm : float
        Of the plane above the glass [mm].

    Returns
    -------
    x, y : ndarray (rows, cols)
        [mm].
    cosine : ndarray (rows, cols)
        [1].
    """
    rows, cols = view.shape
    px, py = view.principal_point
    u, v = (np.arange(cols) - px) / view.focal_px, (np.arange(rows)[:, None] - py) / view.focal_px
    tan_x, tan_y = projection.tangents(u, v)
    reach = projection.clearance + projection.thickness * projection.bend(tan_x, tan_y) + height_mm
    x, y = projection.pinhole[0] + reach * tan_x, projection.pinhole[1] + reach * tan_y
    return x, y, _cosine(tan_x, tan_y)


def _on_card(pose: Pose, x: Array, y: Array) -> tuple[Array, Array]:
    """Return the card's own coordinates [mm] of points of its plane, for a card without tilt."""
    turn = np.deg2rad(pose.rotation_deg)
    dx, dy = x - pose.shift[0], y - pose.shift[1]
    return np.cos(turn) * dx + np.sin(turn) * dy, np.cos(turn) * dy - np.sin(turn) * dx


def mean_reflectance(card: Card, x: Array, y: Array, *, soft: bool = False) -> Array:
    """Return the mean reflectance of each pixel.

    Parameters
    ----------
    card : Card
    x, y : ndarray (rows, cols)
        Card coordinates of the pixels' middles [mm].
    soft : bool
        See :func:`card_light`.

    Returns
    -------
    ndarray (rows, cols)
        [1].
    """
    wide, high = np.abs(np.gradient(x, axis=1)), np.abs(np.gradient(y, axis=0))
    width, height = card.size
    mean = _softly if soft else _evenly

    def covered(half_x: float, half_y: float) -> Array:
        return mean(_Window(half_x), x, wide) * mean(_Window(half_y), y, high)

    inside, whole = covered(width / 2, height / 2), covered(width / 2 + card.margin, height / 2 + card.margin)
    if card.squares is None:
        field, border = (card.black, card.white) if card.inverted else (card.white, card.black)
        return np.asarray(field * inside + border * (whole - inside))
    # White where column and row have the same parity, if not inverted: the product of two square waves is +1 there.
    waves = mean(_SquareWave(width / 2, card.side), x, wide) * mean(_SquareWave(height / 2, card.side), y, high)
    grey, half = (card.white + card.black) / 2, (-1 if card.inverted else 1) * (card.white - card.black) / 2
    return np.asarray(grey * inside + half * waves + card.white * (whole - inside))


class _Window:
    """What is 1 within +-half and 0 beyond."""

    def __init__(self, half: float) -> None:
        self.half = half

    def once(self, t: Array) -> Array:
        """Return its integral up to t."""
        return np.asarray(np.clip(t, -self.half, self.half) + self.half)

    def twice(self, t: Array) -> Array:
        """Return its integral's integral."""
        inside = self.once(t)
        return np.asarray(0.5 * inside**2 + 2 * self.half * np.maximum(t - self.half, 0.0))


class _SquareWave:
    """What starts at -half with +1, turns after each side, and is 0 beyond half."""

    def __init__(self, half: float, side: float) -> None:
        self.half, self.side = half, side

    def once(self, t: Array) -> Array:
        """Return its integral up to t."""
        along = np.clip(t, -self.half, self.half) + self.half
        return np.asarray(self.side - np.abs(np.mod(along, 2 * self.side) - self.side))

    def twice(self, t: Array) -> Array:
        """Return its integral's integral."""
        along = np.clip(t, -self.half, self.half) + self.half
        whole, part = np.divmod(along, 2 * self.side)
        rest = np.where(part < self.side, 0.5 * part**2, self.side**2 - 0.5 * (2 * self.side - part) ** 2)
        beyond = self.once(np.asarray(self.half)) * np.maximum(t - self.half, 0.0)
        return np.asarray(whole * self.side**2 + rest + beyond)


def _evenly(pattern: _Window | _SquareWave, place: Array, width: Array) -> Array:
    """Return a pattern's mean over [place - width/2, place + width/2]."""
    return np.asarray((pattern.once(place + width / 2) - pattern.once(place - width / 2)) / width)


def _softly(pattern: _Window | _SquareWave, place: Array, width: Array) -> Array:
    """Return a pattern's mean over [place - width, place + width], weighed by a triangle."""
    ends = pattern.twice(place + width) + pattern.twice(place - width)
    return np.asarray((ends - 2 * pattern.twice(place)) / width**2)


def _counted(projection: Projection, card: Card, pose: Pose, view: IdealView) -> Array:
    """Return the mean reflectance of each pixel of a view by sub-rays."""
    rows, cols = view.shape
    px, py = view.principal_point
    albedo, offset = np.zeros(view.shape), (np.arange(SUB_RAYS) + 0.5) / SUB_RAYS - 0.5
    for dv in offset:
        for du in offset:
            u, v = np.meshgrid((np.arange(cols) + du - px) / view.focal_px, (np.arange(rows) + dv - py) / view.focal_px)
            albedo += reflectance_seen(projection, card, pose, u, v)
    return albedo / SUB_RAYS**2


def reflectance_seen(projection: Projection, card: Card, pose: Pose, u: Array, v: Array) -> Array:
    """Return the diffuse reflectance [1] that directions (u, v, 1) meet; 0 beside the card.

    Parameters
    ----------
    projection : Projection
    card : Card
    pose : Pose
    u, v : ndarray
        Undistorted normalised directions.

    Returns
    -------
    ndarray
        [1].
    """
    x, y = projection.ray_to_plate(u, v)
    tan_x, tan_y = projection.tangents(u, v)
    # The ray leaves the glass as steep as it entered; it meets the card's plane somewhat above.
    corners = pose.to_plate(np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]))
    middle, across, down = corners[0], corners[1] - corners[0], corners[2] - corners[0]
    normal = np.cross(across, down)
    way = normal @ middle - normal[0] * x - normal[1] * y
    s = way / (normal[0] * tan_x + normal[1] * tan_y + normal[2])
    away = np.stack([x + s * tan_x - middle[0], y + s * tan_y - middle[1], s - middle[2]])
    return _print(card, np.tensordot(across, away, 1), np.tensordot(down, away, 1))


def _print(card: Card, x: Array, y: Array) -> Array:
    """Return the card's reflectance at its own coordinates [mm]."""
    (width, height), (cols, rows) = card.size, card.squares or (1, 1)
    inside = (np.abs(x) < width / 2) & (np.abs(y) < height / 2)
    near = (np.abs(x) < width / 2 + card.margin) & (np.abs(y) < height / 2 + card.margin)
    if card.squares is None:
        field, border = (card.black, card.white) if card.inverted else (card.white, card.black)
        return np.where(inside, field, np.where(near, border, 0.0))
    col = np.clip(np.floor((x + width / 2) / card.side), 0, cols - 1)
    row = np.clip(np.floor((y + height / 2) / card.side), 0, rows - 1)
    return np.where(
        inside, np.where((col + row + card.inverted) % 2 == 1, card.black, card.white), np.where(near, card.white, 0.0)
    )


def _mean_albedo(card: Card) -> float:
    """Return the mean reflectance of the printed face."""
    return 0.5 * (card.white + card.black)


def _cosine(tan_x: Array, tan_y: Array) -> Array:
    return np.asarray(1.0 / np.sqrt(1.0 + tan_x**2 + tan_y**2))


def through_glass(scene: Scene, albedo: Array, cosine: Array, mean_albedo: float) -> Array:
    """Return radiance over that of the illumination: what the plate mirrors, and what paper behind it sends back.

    Parameters
    ----------
    scene : Scene
        Its plate is used.
    albedo : ndarray
        Reflectance of the paper [1].
    cosine : ndarray
        Of the viewing angle in air.
    mean_albedo : float
        Of the paper around, for light that the far face reflects beside where it left [1].

    Returns
    -------
    ndarray
        [1].
    """
    n = scene.plate.refractive_index
    absorbed = np.exp(-2 * scene.plate.absorption_coefficient_per_mm * scene.plate.thickness_mm)
    nodes, weights = np.polynomial.legendre.leggauss(64)
    mu, weight = (nodes + 1) / 2, weights / 2
    face = fresnel_reflectance(mu, 1.0, n)
    near = float(2 * np.sum(weight * mu * face))  # hemispherical reflectance of one face, of the slab
    slab = float(2 * np.sum(weight * mu * 2 * face / (1 + face)))
    # A table: pixels are millions, and the curve is smooth.
    steps = np.linspace(float(np.min(cosine)), float(np.max(cosine)), FRESNEL_NODES)
    seen = np.interp(cosine, steps, fresnel_reflectance(steps, 1.0, n))
    mirrored, passed = 2 * seen / (1 + seen), (1 - seen) / (1 + seen)
    returned = 1 - near * albedo - (slab - near) * mean_albedo
    return np.asarray(mirrored + passed * (1 - slab) * absorbed * albedo / returned)
