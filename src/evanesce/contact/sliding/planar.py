"""Partial slip of a contact that slides, changes direction and turns about its normal at once, in time.

The finger is a half-space whose skin is displaced by u = C q under the tractions q of the glass (Cerruti; Love's
cells). In each step the finger moves rigidly by d, and of all tractions within the strength, |q| <= s, those act that
minimise q.C q/2 - q.(u_before + d): where |q| < s the skin stays on the glass, elsewhere it slips along its traction
(Kalker's variational principle, which allows any direction and torsion; stick-slip: a drop of the strength). Where
friction along the finger's ridges is another than across them, tractions within the strength are an ellipse, q = M p
with |p| <= s: the same problem in p, in which the skin slips along the normal of that ellipse.

Cells stand on the finger and turn with it. No inertia; the area is that without shear.

References: J. J. Kalker, Three-Dimensional Elastic Bodies in Rolling Contact (1990), chapter 4; K. L. Johnson, Contact
Mechanics (1985), section 3.6 (Cerruti); F. P. Bowden and L. Leben, Proc. R. Soc. A 169 (1939) 371 (stick-slip);
A. Beck and M. Teboulle, SIAM J. Imaging Sciences 2 (2009) 183 (accelerated projected gradients).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from evanesce.contact.patch import AxisymmetricContact, cell_pressure, radii
from evanesce.contact.sliding.friction_ellipse import FrictionEllipse
from evanesce.core.states import PlateGrid
from evanesce.materials.friction import InterfaceFriction

Floats = NDArray[np.float64]

CELLS = 32
"""Across the largest contact: stiffness and stick radius to about 2 %."""
MARGIN = 5
"""Cells about it in which the skin's displacement is known."""
TOLERANCE = 1e-2
"""Largest displacement left to a sticking cell, over the step's."""
MAX_ITERATIONS = 400
LEAST_SPEED = 1e-3
"""At which a power law of speed ends [mm/s]: the centre of a spin has none."""
ALL_SLIPS = 0.01
"""Sticking share of the cells below which a contact slides: the middle cell is the last to slip."""


@dataclass(frozen=True)
class PlanarPath:
    """Rigid motion of a finger's drive, sampled at frames.

    Attributes
    ----------
    time : ndarray (n,)
        [s], ascending.
    x, y : ndarray (n,)
        Displacement of the drive [mm].
    rotation : ndarray (n,)
        Of the finger about its normal, from x towards y [rad].
    speed : ndarray (n,), optional
        Of the drive while it moves in the time up to each [mm/s]; by default its way over that time, which is less
        where it turns in between.
    """

    time: Floats
    x: Floats
    y: Floats
    rotation: Floats
    speed: Floats | None = None


@dataclass(frozen=True)
class PlanarFrame:
    """A contact at one instant; fields on the finger's cells, (rows, cols).

    Attributes
    ----------
    time : float
        [s].
    contact : AxisymmetricContact
    tip : tuple of float
        Displacement (x, y) of the tip over the glass [mm].
    rotation : float
        Of the finger [rad].
    ratio : ndarray (2, rows, cols)
        Traction over strength, in the finger's axes; its magnitude is at most 1.
    weakened : ndarray
        Strength in the traction's direction over static strength across the ridges: by direction, slip, speed, and in
        a jump of stick-slip.
    skin : ndarray (2, rows, cols)
        Displacement of the skin against the finger's motion, in its axes [mm].
    slip : ndarray (2, rows, cols)
        Of the skin over the glass since it touched, in the plate's axes [mm].
    velocity : ndarray (2, rows, cols)
        Mean over the time since the frame before, of the skin over the glass, in the plate's axes [mm/s].
    stick : ndarray
        Above 0 where the skin stuck since the frame before: what is left to the strength, over it; negative: by how
        much it was surpassed.
    force : tuple of float
        Of the finger on the glass (x, y) [N].
    speed_factor : float
        Mean strength at the finger's speed over that at the reference speed.
    """

    time: float
    contact: AxisymmetricContact
    tip: tuple[float, float]
    rotation: float
    ratio: Floats = field(repr=False)
    weakened: Floats = field(repr=False)
    skin: Floats = field(repr=False)
    slip: Floats = field(repr=False)
    velocity: Floats = field(repr=False)
    stick: Floats = field(repr=False)
    force: tuple[float, float] = (0.0, 0.0)
    speed_factor: float = 1.0


def cerruti_influence(reach: int, pitch: float, shear_modulus: float, poisson: float) -> Floats:
    """Return the tangential displacement at cells' distance from a cell under unit traction, (3, reach, reach).

    Parameters
    ----------
    reach : int
        Number of cells along x and y, from 0.
    pitch : float
        Side of a square cell [mm].
    shear_modulus : float
        G [MPa].
    poisson : float

    Returns
    -------
    ndarray (3, reach, reach)
        [mm/MPa]: along x and along y under traction along x, and along y under traction along y; [row, col].
    """
    x = (np.arange(reach + 1) - 0.5)[None, :] * pitch
    y = (np.arange(reach + 1) - 0.5)[:, None] * pitch
    r = np.hypot(x, y)
    along = y * np.arcsinh(x / np.abs(y)) + 0.0 * r
    across = x * np.arcsinh(y / np.abs(x)) + 0.0 * r
    corners = np.stack([along + (1.0 - poisson) * across, -poisson * r, (1.0 - poisson) * along + across])
    return np.diff(np.diff(corners, axis=1), axis=2) / (2.0 * np.pi * shear_modulus)


class _HalfSpace:
    """Tangential displacements of a half-space from tractions on the middle cells of a square grid."""

    def __init__(self, cells: int, around: int, pitch: float, shear_modulus: float, poisson: float) -> None:
        self.cells, self.size = cells, cells + 2 * around
        self._padded = fft.next_fast_len(2 * (cells + around), real=True)
        lag = np.minimum(np.arange(self._padded), self._padded - np.arange(self._padded))
        sign = np.where(np.arange(self._padded) > self._padded // 2, -1.0, 1.0)
        quadrant = cerruti_influence(self._padded // 2 + 1, pitch, shear_modulus, poisson)
        whole = quadrant[:, lag][:, :, lag]
        whole[1] *= sign[:, None] * sign[None, :]
        self._xx, self._xy, self._yy = fft.rfft2(whole).real.copy()
        self._part = slice(0, self.size)
        self._around = around

    def __call__(self, traction: Floats) -> Floats:
        """Return the displacement [mm], (2, size, size), under traction [MPa] (2, cells, cells)."""
        given = np.zeros((2, self._padded, self._padded))
        inner = slice(self._around, self._around + self.cells)
        given[:, inner, inner] = traction
        x, y = fft.rfft2(given)
        waves = np.stack([self._xx * x + self._xy * y, self._xy * x + self._yy * y])
        found = fft.irfft2(waves, (self._padded, self._padded))
        return np.asarray(found[:, self._part, self._part])


class PlanarSolver:
    """The cells of a finger's contact, marched through time.

    Parameters
    ----------
    radius : float
        Largest contact radius [mm].
    shear_modulus : float
        G [MPa].
    poisson : float
    friction : InterfaceFriction
    drive_stiffness : float
        Of shaft and drive in series with the contact, in any direction [N/mm].
    drop : float
        Share of the strength that is lost in a jump of stick-slip once the whole contact slips, and is back after it;
        0: none, the strength weakens and heals as ``friction`` says.
    ridges : tuple of float
        Friction along the finger's ridges over that across them, and the ridges' angle on the finger [rad].
    cells : int
        Across the contact.

    Attributes
    ----------
    grid : PlateGrid
        The cells, about the contact's middle in the finger's axes, with a margin.
    """

    def __init__(
        self,
        radius: float,
        shear_modulus: float,
        poisson: float,
        friction: InterfaceFriction,
        *,
        drive_stiffness: float = math.inf,
        drop: float = 0.0,
        ridges: tuple[float, float] = (1.0, 0.0),
        cells: int = CELLS,
    ) -> None:
        pitch = 2.0 * radius / cells
        self._inner = PlateGrid((cells, cells), pitch)
        self.grid = PlateGrid((cells + 2 * MARGIN,) * 2, pitch)
        self._space = _HalfSpace(cells, 0, pitch, shear_modulus, poisson)
        self._around = _HalfSpace(cells, MARGIN, pitch, shear_modulus, poisson)
        self._friction, self._drop, self._ellipse = friction, drop, FrictionEllipse(*ridges)
        self._compliance = pitch**2 / drive_stiffness
        self._x, self._y = np.meshgrid(self._inner.x, self._inner.y)
        self._radius = radii(self._inner, (0.0, 0.0))
        self._bound = 1.02 * self._largest()
        zero = np.zeros((2, cells, cells))
        self._traction, self._target = zero, zero.copy()
        self._slip, self._path, self._weak = zero.copy(), np.zeros((cells, cells)), np.ones((cells, cells))
        self._drive, self._rotation, self._speed = np.zeros(2), 0.0, np.ones_like(self._path)

    def _largest(self) -> float:
        """Return the largest eigenvalue of the compliance [mm/MPa], by power iteration."""
        v, size = np.ones_like(np.stack([self._x, self._y])), 1.0
        v[1] = 0.3
        for _ in range(20):
            v = self._compliant(v / np.linalg.norm(v))
            size = float(np.linalg.norm(v))
        return size

    def _compliant(self, traction: Floats) -> Floats:
        return self._space(traction) + self._compliance * traction.sum(axis=(1, 2))[:, None, None]

    def march(self, contacts: Sequence[AxisymmetricContact], path: PlanarPath) -> list[PlanarFrame]:
        """Return a frame at each time; a finger that is lifted starts anew where it is put down.

        Parameters
        ----------
        contacts : sequence of AxisymmetricContact (n,)
            Normal contact at each time; of radius 0 where nothing touches.
        path : PlanarPath

        Returns
        -------
        list of PlanarFrame
        """
        at = np.stack([path.x, path.y])
        self._rest(at[:, 0], float(path.rotation[0]))
        nothing = np.zeros_like(self._target)
        frames = [self._frame(contacts[0], float(path.time[0]), nothing, np.ones_like(self._path))]
        for i in range(1, len(contacts)):
            elapsed = float(path.time[i] - path.time[i - 1])
            if contacts[i].contact_radius <= 0.0:
                self._rest(at[:, i], float(path.rotation[i]))
                frames.append(self._frame(contacts[i], float(path.time[i]), nothing, np.ones_like(self._path)))
                continue
            static = self._static(contacts[i])
            speed = None if path.speed is None else float(path.speed[i])
            slip, stick = self._step(static, at[:, i], float(path.rotation[i]), elapsed, speed)
            frames.append(self._frame(contacts[i], float(path.time[i]), slip / elapsed, stick))
        return frames

    def _rest(self, drive: Floats, rotation: float) -> None:
        self._traction, self._target = np.zeros_like(self._traction), np.zeros_like(self._target)
        self._slip, self._path = np.zeros_like(self._slip), np.zeros_like(self._path)
        self._weak = np.ones_like(self._path)
        self._drive, self._rotation = drive.copy(), rotation

    def _static(self, contact: AxisymmetricContact) -> Floats:
        """Return the static strength of each cell [MPa]."""
        if contact.contact_radius <= 0.0:
            return np.zeros_like(self._path)
        pressure = np.maximum(cell_pressure(self._inner, (0.0, 0.0), contact), 0.0)
        inside = self._radius < contact.contact_radius
        return np.asarray(np.where(inside, self._friction.tau0 + self._friction.alpha * pressure, 0.0))

    def _step(
        self, static: Floats, drive: Floats, rotation: float, elapsed: float, speed: float | None
    ) -> tuple[Floats, Floats]:
        """Move the drive; return the slip in the plate's axes [mm] and what was left to the strength, over it."""
        turn = rotation - self._rotation
        # Traction is that at the step's end: along the motion in the finger's axes as they then are.
        move = _turned(drive - self._drive, -rotation)
        # The shaft stretches by its force's change alone, in the finger's axes.
        pull = self._compliance * self._traction.sum(axis=(1, 2))
        rigid = move[:, None, None] + turn * np.stack([-self._y, self._x])
        goal = _turned(self._target, -turn) + rigid
        self._weak = self._factor(move, turn, elapsed, speed)
        strength = static * self._weak
        touching = strength > 0.0
        size = float(np.abs(rigid).max())
        wanted = goal + _turned(pull, -turn)[:, None, None]
        self._traction = _turned(self._traction, -turn)
        traction, left = self._solve(strength, wanted, size)
        if self._drop > 0.0 and float((left > 0.0)[touching].mean()) < ALL_SLIPS:
            self._weak *= 1.0 - self._drop
            traction, left = self._solve(static * self._weak, wanted, size)
        shaft = self._compliance * traction.sum(axis=(1, 2)) - _turned(pull, -turn)
        goal -= shaft[:, None, None]
        slips = touching & (left <= 0.0)
        slip = np.where(slips, goal - self._space(traction), 0.0)
        # beside the contact the skin follows its elastic displacement
        free = self._space(traction)
        self._target = np.where(touching, goal - slip, free)
        self._traction, self._drive, self._rotation = traction, drive.copy(), rotation
        way = np.hypot(*slip)
        rested = self._path * math.exp(-elapsed / self._friction.healing_time)
        self._path = np.where(slips, self._path + way, np.where(touching, rested, 0.0))
        moved = _turned(slip, rotation)
        self._slip = np.where(touching, self._slip + moved, 0.0)
        return moved, np.where(touching, left, -1.0)

    def _factor(self, move: Floats, turn: float, elapsed: float, speed: float | None) -> Floats:
        """Return the strength over its static one: each cell's by the speed of the rigid finger there."""
        way = math.hypot(*move)
        along = move * ((way / elapsed if speed is None else speed) / way) if way > 0.0 else np.zeros(2)
        spin = turn / elapsed
        local = np.hypot(along[0] - spin * self._y, along[1] + spin * self._x)
        if local.max() > 0.0:  # a resting interface keeps the strength it was last probed at
            self._speed = self._friction.speed_factor(np.maximum(local, LEAST_SPEED))
        return self._speed * (np.ones_like(self._path) if self._drop > 0.0 else self._friction.weakening(self._path))

    def _solve(self, strength: Floats, wanted: Floats, size: float) -> tuple[Floats, Floats]:
        """Return the tractions [MPa], and what is left to the strength, over it.

        Accelerated projected gradients, restarted where they overshoot.
        """
        allowed, ellipse = np.maximum(strength, 1e-300), self._ellipse
        bound, before = ellipse.widest**2 * self._bound, ellipse.rounded(self._traction)
        q = _within(before, allowed)[0] * (strength > 0.0)
        ahead, weight = q, 1.0
        clipped = float(np.abs(q - before).max()) * bound
        enough = TOLERANCE * max(size, clipped, 1e-9) / bound
        left = np.ones_like(strength)
        for _ in range(MAX_ITERATIONS):
            gradient = ellipse.stretched(self._compliant(ellipse.stretched(ahead)) - wanted)
            found, left = _within(ahead - gradient / bound, allowed)
            found *= strength > 0.0
            change, rest = found - q, ahead - found
            if float((change * rest).sum()) > 0.0:
                ahead, weight = found, 1.0
            else:
                after = 0.5 * (1.0 + math.sqrt(1.0 + 4.0 * weight**2))
                ahead, weight = found + (weight - 1.0) / after * change, after
            q = found
            if float(np.abs(rest).max()) < enough:
                break
        return ellipse.stretched(q), left

    def _frame(self, contact: AxisymmetricContact, time: float, velocity: Floats, stick: Floats) -> PlanarFrame:
        q, cells = self._traction, self._inner.shape[0]
        static = self._static(contact)
        weakened = self._weak * self._ellipse.strength(q)
        now = static * weakened
        ratio = np.divide(q, now, out=np.zeros_like(q), where=now > 0.0)
        ratio /= np.maximum(np.hypot(*ratio), 1.0)
        skin = self._around(q)
        inner = slice(MARGIN, MARGIN + cells)
        skin[:, inner, inner] = np.where(static > 0.0, self._target, skin[:, inner, inner])
        tip = self._drive - _turned(self._compliance * q.sum(axis=(1, 2)), self._rotation)
        force = _turned(q.sum(axis=(1, 2)) * self._inner.pitch**2, self._rotation)
        fields = self._continued(
            contact.contact_radius, np.concatenate([ratio, velocity, self._slip, [weakened, stick]])
        )
        return PlanarFrame(
            time, contact, (float(tip[0]), float(tip[1])), self._rotation, ratio=fields[0:2], velocity=fields[2:4],
            slip=fields[4:6], weakened=fields[6], stick=fields[7], skin=skin, force=(float(force[0]), float(force[1])),
            speed_factor=float((static * self._speed).sum() / static.sum()) if static.any() else 1.0,
        )  # fmt: skip

    def _continued(self, radius: float, fields: Floats) -> Floats:
        """Return fields with the rim's values beyond the contact, on the grid with its margin."""
        x, y = np.meshgrid(self.grid.x, self.grid.y)
        distance = np.maximum(np.hypot(x, y), 1e-12)
        inwards = np.where(distance < radius, 1.0, max(radius - self.grid.pitch, 0.0) / distance)
        row, col = self._inner.index(x * inwards, y * inwards)
        return np.asarray(fields[:, np.rint(row).astype(int), np.rint(col).astype(int)], dtype=np.float32)


def _within(traction: Floats, strength: Floats) -> tuple[Floats, Floats]:
    """Return tractions cut to the strength, and what was left to it before, over it."""
    over = np.hypot(*traction) / strength
    return traction / np.maximum(over, 1.0), 1.0 - over


def _turned(vector: Floats, angle: float) -> Floats:
    """Return a vector (2, ...) turned from x towards y by an angle [rad]."""
    cos, sin = math.cos(angle), math.sin(angle)
    return np.stack([cos * vector[0] - sin * vector[1], sin * vector[0] + cos * vector[1]])
