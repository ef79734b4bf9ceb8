"""A step by descent of energy, where Newton's method does not converge: skin that springs from stick to slip.

With the limits of friction given, what the glass does to the skin has an energy, as rubber has: its least value is
sought by steps that are shortened until it falls. The limits are those of the pressures a moment ago (Li et al., ACM
Trans. Graph. 39 (2020) 49, lag friction so): the glass is moved, and held until the skin has come to rest under them.
Nothing drives it meanwhile and friction takes energy, so it does come to rest, also where a part of the contact has
sprung off and no state near the last one is an equilibrium.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from evanesce.contact.fem.newton import (
    NOISE,
    Equilibrium,
    Model,
    StepFailed,
    Target,
    contact_matrix,
    newton_step,
)
from evanesce.contact.fem.plane import Anchors, Glass, PlaneForces, plane_forces

Floats = NDArray[np.float64]

ROUNDS = 200
"""Of friction by the pressures of the round before."""
BALANCED = 1e-5
"""Residual over the contact force, friction by the pressures that came out, at which a step is accepted."""
ITERATES = 60
"""Of each descent."""
SETTLED = 1e-9
"""Gradient over the contact force at which a descent ends."""
ROUNDING = 1e-14
"""Share of the energy: a step that promises less cannot be seen to fall."""
LONGEST_MM = 1.0
"""Farthest that a node moves from one iterate to the next."""
SHORTEST = 1e-7
"""Share of a step below which the energy's rounding decides."""
FALLS = 1e-4
"""Least share of what the slope promises by which the energy has to fall."""


@dataclass(frozen=True)
class Lagged:
    """The glass with friction's limits given.

    Attributes
    ----------
    glass : Glass
    areas : ndarray (k,)
        Of the nodes that may touch [mm^2].
    origin : ndarray (k, d - 1)
        From where each is pulled, in the glass's coordinates [mm].
    limit : ndarray (k,)
        Largest friction [N].
    """

    glass: Glass
    areas: Floats
    origin: Floats
    limit: Floats

    def energy(self, relative: Floats) -> float:
        """Return the energy [N mm] at positions relative to the glass (k, d) [mm]."""
        depth, soft = np.maximum(-relative[:, -1], 0.0), self.glass.softness
        beyond = soft**2 / 6 + 0.5 * (depth**2 - soft**2) - 0.5 * soft * (depth - soft)
        pressed = self.glass.penalty * self.areas * np.where(depth < soft, depth**3 / (6 * soft), beyond)
        pull, way = self._pull(relative)
        held = pull <= self.limit
        stick = np.maximum(self._stick, 1e-300)
        rubbed = np.where(held, 0.5 * pull * way, self.limit * way - 0.5 * self.limit**2 / stick)
        return float(pressed.sum() + rubbed.sum())

    def forces(self, relative: Floats) -> PlaneForces:
        """Return forces at positions relative to the glass (k, d) [mm], and how they change: a symmetric matrix."""
        bare = Glass(0.0, self.glass.penalty, self.glass.tangential_ratio, self.glass.softness)
        nothing = np.zeros(len(relative), bool)
        found = plane_forces(relative, self.areas, bare, Anchors(nothing, self.origin, self.origin, relative))
        pull, way = self._pull(relative)
        held = pull <= self.limit
        along = (relative[:, :-1] - self.origin) / np.maximum(way, 1e-300)[:, None]
        size = np.where(held, pull, self.limit)
        by_way = np.where(held, self._stick, self.limit / np.maximum(way, 1e-300))
        outer = along[:, :, None] * along[:, None, :]
        block = by_way[:, None, None] * (np.eye(along.shape[1]) - np.where(held, 0.0, 1.0)[:, None, None] * outer)
        force, stiffness = found.force.copy(), found.stiffness.copy()
        force[:, :-1] = -size[:, None] * along
        stiffness[:, :-1, :-1] = np.where((self.limit > 0)[:, None, None], block, 0.0)
        return PlaneForces(force, stiffness, ~held, found.touching | (self.limit > 0), found.anchors)

    @property
    def _stick(self) -> Floats:
        return self.glass.tangential_ratio * self.glass.penalty * self.areas

    def _pull(self, relative: Floats) -> tuple[Floats, Floats]:
        """Return the trial friction [N] and the way from the origin [mm] (k,)."""
        way = np.linalg.norm(relative[:, :-1] - self.origin, axis=1)
        return np.asarray(self._stick * way), np.asarray(way)


def descended(model: Model, before: Equilibrium, target: Target, *, guess: Equilibrium | None = None) -> Equilibrium:
    """Solve one step from the last accepted one by descent of energy.

    Parameters
    ----------
    model : Model
    before : Equilibrium
        Last accepted state.
    target : Target
    guess : Equilibrium, optional

    Returns
    -------
    Equilibrium
        Balanced to :data:`BALANCED`.

    Raises
    ------
    StepFailed
        If the energy cannot fall, or the skin does not come to rest.
    """
    u = (guess or before).displacement.copy()
    depth = before.depth if target.depth is None else target.depth
    memory, pressures, solved = before.contact.anchors, before.contact.force[:, -1], 0
    stick = np.maximum(model.glass.tangential_ratio * model.glass.penalty * model.areas, 1e-300)
    for _ in range(ROUNDS):
        lagged = Lagged(model.glass, model.areas, memory.place, model.glass.friction * pressures)
        u, depth, iterates = _least(model, lagged, target, u, depth)
        solved += iterates
        relative = model.relative(u, depth, target.slide)
        there = plane_forces(relative, model.areas, model.glass, memory)
        back = lagged.forces(relative).force[:, :-1] / stick[:, None]
        place = relative[:, :-1] + np.where(there.touching[:, None], back, 0.0)
        memory = Anchors(there.touching, place, there.anchors.touchdown, relative)
        contact = plane_forces(relative, model.areas, model.glass, memory)
        residual = model.solid.forces(u)
        residual[model.mesh.candidates] -= contact.force
        error = float(np.linalg.norm(residual.ravel()[model.free]))
        if error <= BALANCED * float(np.linalg.norm(contact.force)) + NOISE:
            normal, tangential = (model.turn * float(contact.force[:, k].sum()) for k in (-1, 0))
            return Equilibrium(u, depth, target.slide, contact, normal, -tangential, solved)
        pressures = contact.force[:, -1]
    raise StepFailed


def _least(model: Model, lagged: Lagged, target: Target, u: Floats, depth: float) -> tuple[Floats, float, int]:
    """Return where the energy is least, displacements and the glass's depth, and how many systems were solved."""
    wanted = None if target.normal_force is None else target.normal_force / model.turn

    def energy(u: Floats, depth: float) -> float:
        own = model.solid.energy(u) + lagged.energy(model.relative(u, depth, target.slide))
        return own - (0.0 if wanted is None else wanted * depth)

    value = energy(u, depth)
    for iterate in range(ITERATES):
        contact = lagged.forces(model.relative(u, depth, target.slide))
        residual = model.solid.forces(u)
        residual[model.mesh.candidates] -= contact.force
        missing = 0.0 if wanted is None else wanted - float(contact.force[:, -1].sum())
        left = float(np.linalg.norm(residual.ravel()[model.free])) + abs(missing)
        if left <= SETTLED * float(np.linalg.norm(contact.force)) + NOISE:
            return u, depth, iterate
        step, rise, slope = _downhill(model, contact, residual, missing, wanted is not None)
        if -slope < ROUNDING * abs(value):
            return u, depth, iterate
        share = min(1.0, LONGEST_MM / max(float(np.abs(step).max()), abs(rise), 1e-12))
        while (there := energy(u + share * step, depth + share * rise)) > value + FALLS * share * slope:
            share *= 0.5
            if share < SHORTEST:
                return u, depth, iterate
        u, depth, value = u + share * step, depth + share * rise, there
    raise StepFailed


def _downhill(
    model: Model, contact: PlaneForces, residual: Floats, missing: float, free_glass: bool
) -> tuple[Floats, float, float]:
    """Return Newton's step, made stiffer until it goes downhill, the glass's rise and the energy's slope along both."""
    matrix = model.solid.tangent() + contact_matrix(model, contact, residual.size)
    usual = float(np.abs(matrix.diagonal()).mean())
    for stiffer in (0.0, *(usual * 4.0 ** np.arange(-5, 7))):
        own = matrix + sparse.identity(residual.size, format="csr") * stiffer if stiffer else matrix
        try:
            step, rise = newton_step(model, own, residual, contact, model.free, missing, free_glass)
        except StepFailed:
            continue
        slope = float((residual * step).sum()) - missing * rise
        if slope < 0:
            return step, rise, slope
    raise StepFailed
