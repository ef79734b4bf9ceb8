"""Press and slide in time: partial slip with its whole history, on a grid, fast enough for datasets.

An axisymmetric contact without coupling of normal and tangential tractions is equivalent to a row of independent
springs: a spring at distance x from the middle carries the Abel transform of the pressure, sticks with stiffness G* per
unit length, and slips at the Abel transform of the local shear strength. Abel's inversion returns the traction and the
slip on the surface. This gives Cattaneo and Mindlin exactly, and Jaeger's and Ciavarella's generalisation to any
axisymmetric pressure, for any history of normal force and displacement, reversals included, as long as the strength
falls from the middle outwards.

References: V. L. Popov and M. Hess, Method of Dimensionality Reduction in Contact Mechanics and Friction (2015),
chapters 2, 5 and appendix; J. Jaeger, Arch. Appl. Mech. 65 (1995) 478; M. Ciavarella, Int. J. Solids Struct. 35 (1998)
2349.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import brentq

from evanesce.contact.patch import AxisymmetricContact
from evanesce.contact.sliding.shear_area import Share
from evanesce.materials.friction import InterfaceFriction

Floats = NDArray[np.float64]

# Sahli's law is a fit; beyond this share of the area it has never been seen, and the patch must not vanish.
MIN_AREA_SHARE = 0.3


@dataclass(frozen=True)
class SlideFrame:
    """One instant of a slide, in the axisymmetric frame of the contact.

    Attributes
    ----------
    time : float
        [s].
    contact : AxisymmetricContact
        Normal contact without shear.
    tangential_force : float
        Of the finger on the glass, along the slide [N].
    area : float
        Nominal contact area left under shear [mm^2].
    stick_radius : float
        Of the circle that did not slip in the last step [mm], before the area loss deforms it.
    stick_ratio : float
        Sticking share of the contact area.
    tip_displacement : float
        Of the finger's tip over the glass [mm].
    force_density : ndarray (m,)
        Tangential force per unit length of the springs [N/mm].
    spring_slip : ndarray (m,)
        Slip of the springs since contact [mm].
    limit_density : ndarray (m,)
        Force density at which the springs slip, weakened by their slip as it is [N/mm].
    speed_factor : float
        Strength at the drive's speed over that at the reference speed.
    """

    time: float
    contact: AxisymmetricContact
    tangential_force: float
    area: float
    stick_radius: float
    stick_ratio: float
    tip_displacement: float
    force_density: Floats = field(repr=False)
    spring_slip: Floats = field(repr=False)
    limit_density: Floats = field(repr=False)
    speed_factor: float = 1.0


@dataclass(frozen=True)
class Slide:
    """A whole slide and the springs it was computed on.

    Attributes
    ----------
    frames : tuple of SlideFrame
    edges : ndarray (m + 1,)
        Borders of the springs [mm].
    """

    frames: tuple[SlideFrame, ...]
    edges: Floats

    def __len__(self) -> int:
        return len(self.frames)

    def __iter__(self) -> Iterator[SlideFrame]:
        return iter(self.frames)

    def series(self, name: str) -> Floats:
        """Return one scalar of every frame.

        Parameters
        ----------
        name : str
            Attribute of :class:`SlideFrame`.

        Returns
        -------
        ndarray (frames,)
        """
        return np.array([getattr(frame, name) for frame in self.frames])


def spring_load(contact: AxisymmetricContact, edges: Floats, annuli: int = 384) -> Floats:
    """Return the normal force density of the springs [N/mm], shape (m,): the Abel transform of the pressure.

    The pressure is taken constant over each of ``annuli`` annuli, with the annulus's exact force; the rest is exact, so
    that the sum over all springs and both sides is the normal force. Tension at an adhesive edge is cut off: it adds
    no friction.

    Parameters
    ----------
    contact : AxisymmetricContact
    edges : ndarray (m + 1,)
        Borders of the springs, from 0 [mm].
    annuli : int

    Returns
    -------
    ndarray (m,)
        [N/mm].
    """
    a = contact.contact_radius
    if a <= 0:
        return np.zeros(len(edges) - 1)
    # Sine spacing: the pressure falls as a square root at the edge.
    r = a * np.sin(np.linspace(0.0, np.pi / 2, annuli + 1))
    pressure = np.diff(contact.force_within(r)) / (np.pi * np.diff(r**2))
    # A disc of radius r under unit pressure is felt by the springs as 2 sqrt(r^2 - x^2); p is a sum of such discs.
    discs = -np.diff(np.append(pressure, 0.0))
    cumulative = np.empty(len(edges))
    for start in range(0, len(edges), 128):  # blocks that stay in the cache
        x = np.minimum(edges[start : start + 128, None], r[None, 1:])
        cumulative[start : start + 128] = (x * np.sqrt(r[1:] ** 2 - x**2) + r[1:] ** 2 * np.arcsin(x / r[1:])) @ discs
    return np.maximum(np.diff(cumulative) / np.diff(edges), 0.0)


def spring_strength(radius: float, edges: Floats) -> Floats:
    """Return the Abel transform of unit strength on a disc [mm], 2 sqrt(a^2 - x^2), averaged over each spring.

    Parameters
    ----------
    radius : float
        Of contact [mm].
    edges : ndarray (m + 1,)
        Borders of the springs, from 0 [mm].

    Returns
    -------
    ndarray (m,)
        [mm].
    """
    if radius <= 0:
        return np.zeros(len(edges) - 1)
    u = np.clip(edges / radius, 0.0, 1.0)
    whole = radius**2 * (u * np.sqrt(1.0 - u**2) + np.arcsin(u))
    return np.diff(whole) / np.diff(edges)


@dataclass
class _Springs:
    """State of the row of springs while it is marched: mutable, private."""

    edges: Floats
    density: Floats
    slipped: Floats
    since_rest: Floats
    limit: Floats
    displacement: float = 0.0

    def advance(self, limit: Floats, modulus: float, move: float) -> tuple[Floats, Floats]:
        """Return the force density after a move, and the slip in it."""
        trial = self.density + modulus * move
        held = np.clip(trial, -limit, limit)
        return held, (trial - held) / modulus

    def leap(self, force: float, left: float, modulus: float, stiffness: float) -> float:
        """Let the whole contact slip at a standing drive until a share of the force is left; return that force [N]."""
        moved = (1.0 - left) * force / stiffness
        self.slipped = np.where(self.limit > 0.0, self.slipped + moved + (1.0 - left) * self.density / modulus, 0.0)
        self.density = left * self.density
        self.displacement += moved
        self.since_rest = np.zeros_like(self.since_rest)
        return left * force


def march(
    contacts: Sequence[AxisymmetricContact],
    time: ArrayLike,
    displacement: ArrayLike,
    friction: InterfaceFriction,
    tangential_modulus: ArrayLike,
    *,
    drive_stiffness: float = float("inf"),
    area_loss: ArrayLike = 0.0,
    shares: Sequence[Share] | None = None,
    stick_slip_drop: float = 0.0,
    speeds: ArrayLike | None = None,
    springs: int = 1024,
    substeps: int = 4,
) -> Slide:
    """March a press and slide through time.

    Parameters
    ----------
    contacts : sequence of AxisymmetricContact (n,)
        Normal contact at each time, from any law.
    time : array_like (n,)
        [s], ascending.
    displacement : array_like (n,)
        Of the drive along the slide [mm]; may reverse.
    friction : InterfaceFriction
    tangential_modulus : array_like, scalar or (n,)
        G* [MPa], see :func:`evanesce.contact.analytic.partial_slip.tangential_modulus`.
    drive_stiffness : float
        Of shaft and drive in series with the contact, along the slide [N/mm].
    area_loss : array_like, scalar or (n,)
        Sahli's alpha_A [mm^2/N^2]; 0 is none.
    shares : sequence of callable (n,), optional
        Share of each contact's area that is left under a tangential force [N], besides Sahli's law
        (:mod:`evanesce.contact.sliding.shear_area`).
    stick_slip_drop : float
        Share of friction that is lost once the whole contact slips, below a half: the finger leaps until twice as much
        of the force is gone, and sticks again. Needs a drive that gives way.
    speeds : array_like (n,), optional
        Of the drive while it moves in the time up to each [mm/s]; by default its way since the time before over that
        time, which is less where it turns back or comes to rest in between.
    springs, substeps : int
        Springs over the largest contact radius; displacement steps between two frames.

    Returns
    -------
    Slide

    Raises
    ------
    ValueError
        For sequences of different length, time that does not ascend, or a contact that never touches.

    Notes
    -----
    Normal loads are interpolated between frames spring by spring. With area loss the interface keeps its shear strength
    tau0 on the area that is left, and the pressure rises to carry the same normal force; force and area are solved
    together. Weakening acts from one step to the next, so a drop of strength takes a few steps. A leap of stick-slip
    takes no time and overshoots as a mass on a spring without damping does: for leaps that are short beside a step.
    """
    t, drive = np.asarray(time, dtype=float), np.asarray(displacement, dtype=float)
    _check(contacts, t, drive, springs, substeps)
    modulus = np.broadcast_to(np.asarray(tangential_modulus, dtype=float), t.shape)
    loss = np.broadcast_to(np.asarray(area_loss, dtype=float), t.shape)
    if stick_slip_drop > 0.0 and not (stick_slip_drop < 0.5 and np.isfinite(drive_stiffness)):
        raise ValueError("stick-slip needs a drop below a half and a drive of finite stiffness")
    if modulus.min() <= 0 or loss.min() < 0 or drive_stiffness <= 0:
        raise ValueError("tangential modulus and drive stiffness must be positive, the area loss not negative")
    edges = np.linspace(0.0, max(c.contact_radius for c in contacts), springs + 1)
    load, strength = spring_load(contacts[0], edges), spring_strength(contacts[0].contact_radius, edges)
    at_rest = friction.alpha * load + friction.tau0 * strength
    row = _Springs(edges, np.zeros(springs), np.zeros(springs), np.zeros(springs), at_rest)
    shares = [_whole] * len(t) if shares is None else shares
    frames = [_rest_frame(contacts[0], float(t[0]), row)]
    moving = np.append(0.0, np.abs(np.diff(drive)) / np.diff(t)) if speeds is None else np.asarray(speeds, dtype=float)
    force, factor, leaps = 0.0, 1.0, False
    for i in range(1, len(t)):
        dt = float(t[i] - t[i - 1]) / substeps
        if moving[i] > 0:  # a resting interface keeps the strength it was last probed at
            factor = float(friction.speed_factor(float(moving[i])))
        if contacts[i] is contacts[i - 1]:  # a hold
            next_load, next_strength = load, strength
        else:
            next_load = spring_load(contacts[i], edges)
            next_strength = spring_strength(contacts[i].contact_radius, edges)
        area = np.pi * contacts[i].contact_radius ** 2
        moved = np.zeros(springs)
        if leaps:
            force = row.leap(force, 1.0 - 2.0 * stick_slip_drop, float(modulus[i]), drive_stiffness)
        for k in range(1, substeps + 1):
            s = k / substeps
            now_load, now_strength = load + s * (next_load - load), strength + s * (next_strength - strength)
            here = drive[i - 1] + s * (drive[i] - drive[i - 1])
            force, moved = _step(
                row, now_load, now_strength, friction, factor, float(modulus[i]), float(here), drive_stiffness,
                float(loss[i]), area, dt, force, shares[i],
            )  # fmt: skip
        load, strength = next_load, next_strength
        leaps = stick_slip_drop > 0.0 and bool(np.all(np.abs(moved[strength > 0.0]) > 1e-12))
        frame = _frame(
            contacts[i], float(t[i]), row, force, float(loss[i]), moved, float(drive[i]), drive_stiffness, shares[i]
        )
        frames.append(replace(frame, speed_factor=factor))
    return Slide(tuple(frames), edges)


def _check(contacts: Sequence[AxisymmetricContact], t: Floats, drive: Floats, springs: int, substeps: int) -> None:
    if not len(contacts) == len(t) == len(drive) or len(t) < 2:
        raise ValueError(f"{len(contacts)} contacts, {len(t)} times, {len(drive)} displacements; at least 2 of each")
    if np.any(np.diff(t) <= 0) or not np.isfinite(drive).all():
        raise ValueError("time must ascend and displacement be finite")
    if max(c.contact_radius for c in contacts) <= 0:
        raise ValueError("the finger never touches the glass")
    if springs < 16 or substeps < 1:
        raise ValueError("at least 16 springs and 1 substep are needed")


def _whole(force: float) -> float:
    """Return the share of a contact that shear does not change."""
    return 1.0


def _left(area: float, loss: float, force: float, share: Share) -> float:
    """Return the area left under shear [mm^2], within the range of the data that the law fits."""
    return max(share(force) * area - loss * force**2, MIN_AREA_SHARE * area)


def _step(
    row: _Springs,
    load: Floats,
    strength: Floats,
    friction: InterfaceFriction,
    factor: float,
    modulus: float,
    drive: float,
    stiffness: float,
    loss: float,
    area: float,
    dt: float,
    force: float,
    left: Share = _whole,
) -> tuple[float, Floats]:
    """Find the tangential force at which springs, area and drive agree; move the springs; return (force, slip)."""
    width = np.diff(row.edges)
    weak = friction.weakening(row.since_rest) * factor
    inside = strength > 0.0

    def limit(q: float) -> Floats:
        share = _left(area, loss, q, left) / area if area > 0 else 1.0
        return weak * (friction.alpha * load + friction.tau0 * share * strength)

    def excess(q: float) -> float:
        held, _ = row.advance(limit(q), modulus, drive - q / stiffness - row.displacement)
        return 2.0 * float(held @ width) - q

    bound = 2.0 * float(limit(0.0) @ width)
    if bound <= 0.0:
        force = 0.0
    else:
        # Strictly falling in q: more force leaves less displacement at the tip, and less area.
        force = float(brentq(excess, -1.001 * bound - 1e-9, 1.001 * bound + 1e-9, xtol=1e-12 * max(1.0, bound)))
    tip = drive - force / stiffness
    row.limit = limit(force)
    row.density, moved = row.advance(row.limit, modulus, tip - row.displacement)
    row.displacement = tip
    row.density[~inside] = 0.0
    moved[~inside] = 0.0
    row.slipped = np.where(inside, row.slipped + moved, 0.0)
    # A spring that rests heals; one that slides counts its path.
    row.since_rest = np.where(
        np.abs(moved) > 1e-12, row.since_rest + np.abs(moved), row.since_rest * np.exp(-dt / friction.healing_time)
    )
    row.since_rest[~inside] = 0.0
    return force, moved


def _frame(
    contact: AxisymmetricContact,
    time: float,
    row: _Springs,
    force: float,
    loss: float,
    moved: Floats,
    drive: float,
    stiffness: float,
    share: Share = _whole,
) -> SlideFrame:
    a = contact.contact_radius
    area = _left(np.pi * a**2, loss, force, share)
    # A surface point slips as soon as any spring nearer to the middle does.
    slipping = np.flatnonzero(np.abs(moved) > 1e-12)
    stick = min(float(row.edges[slipping[0]]), a) if len(slipping) else a
    return SlideFrame(
        time=time,
        contact=contact,
        tangential_force=force,
        area=area,
        stick_radius=stick,
        stick_ratio=(stick / a) ** 2 if a > 0 else 0.0,
        tip_displacement=drive - force / stiffness,
        force_density=row.density.copy(),
        spring_slip=row.slipped.copy(),
        limit_density=row.limit.copy(),
    )


def _rest_frame(contact: AxisymmetricContact, time: float, row: _Springs) -> SlideFrame:
    return _frame(contact, time, row, 0.0, 0.0, np.zeros_like(row.density), 0.0, 1.0)
