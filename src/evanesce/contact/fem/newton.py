"""Newton's method for a rubber body against a moving glass, with the depth or the normal force prescribed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from evanesce.contact.fem.mesh import SolidMesh, nodal_areas
from evanesce.contact.fem.plane import Glass, PlaneForces, free_anchors, plane_forces

Floats = NDArray[np.float64]

GRIP = 1e9  # coefficient of friction that nothing slips on
NOISE = 2e-10  # [N]: rounding of internal forces, bulk modulus times section times machine epsilon, summed over nodes


class Solid(Protocol):
    """Interface of a body to the solver; the adapter to the finite-element library implements it."""

    def inverted(self, displacement: Floats) -> bool:
        """Return whether an element is inverted.

        Parameters
        ----------
        displacement : ndarray (n, d)
            [mm].

        Returns
        -------
        bool
        """

    def energy(self, displacement: Floats) -> float:
        """Return the energy [N mm]; infinite where an element is inverted.

        Parameters
        ----------
        displacement : ndarray (n, d)
            [mm].

        Returns
        -------
        float
        """

    def forces(self, displacement: Floats) -> Floats:
        """Return internal forces [N].

        Parameters
        ----------
        displacement : ndarray (n, d)
            [mm].

        Returns
        -------
        ndarray (n, d)
            [N].
        """

    def tangent(self) -> Any:
        """Return the tangent at the last forces [N/mm].

        Returns
        -------
        sparse matrix (n d, n d)
            [N/mm].
        """

    def stretches(self, displacement: Floats) -> Floats:
        """Return principal stretches (points, 3).

        Parameters
        ----------
        displacement : ndarray (n, d)
            [mm].

        Returns
        -------
        ndarray (points, 3)
        """


@dataclass(frozen=True)
class Equilibrium:
    """A solved instant.

    Attributes
    ----------
    displacement : ndarray (n, d)
        [mm].
    depth, slide : float
        The glass is raised by ``depth`` and moved by ``slide`` along -x: the finger slides over it along +x [mm].
    contact : PlaneForces
        Of the candidate nodes.
    normal_force, tangential_force : float
        Of the whole finger on the glass, both halves [N]; the tangential along x, the direction of the slide.
    iterations : int
    """

    displacement: Floats
    depth: float
    slide: float
    contact: PlaneForces
    normal_force: float
    tangential_force: float
    iterations: int


class StepFailed(Exception):
    """A step did not converge; the step control takes a smaller one."""


@dataclass(frozen=True)
class Model:
    """A body, its supports and its glass.

    Attributes
    ----------
    mesh : SolidMesh
    solid : Solid
    glass : Glass
    solve : callable
        Linear solver: (sparse matrix, right-hand sides) -> solutions.
    """

    mesh: SolidMesh
    solid: Solid
    glass: Glass
    solve: Callable[[Any, Floats], Floats]

    @property
    def turn(self) -> float:
        """Whole finger over what is meshed: 1 for a section (a full turn), 2 for a half body."""
        return 1.0 if self.mesh.dim == 2 else 2.0

    @property
    def free(self) -> NDArray[np.int64]:
        """Unknowns that are not held."""
        held = np.zeros(self.mesh.points.shape, dtype=bool)
        held[self.mesh.clamped] = True
        held[self.mesh.mirror, 0 if self.mesh.dim == 2 else 1] = True
        return np.flatnonzero(~held.ravel())

    @property
    def areas(self) -> Floats:
        """Undeformed area of each candidate node [mm^2]."""
        return nodal_areas(self.mesh.points, self.mesh.facets)[self.mesh.candidates]

    def relative(self, displacement: Floats, depth: float, slide: float) -> Floats:
        """Return candidate positions in the glass's coordinates [mm].

        Parameters
        ----------
        displacement : ndarray (n, d)
            [mm].
        depth, slide : float
            Of the glass [mm].

        Returns
        -------
        ndarray (k, d)
            [mm].
        """
        chosen = self.mesh.candidates
        offset = np.zeros(self.mesh.dim)
        offset[-1] = depth
        if self.mesh.dim == 3:
            offset[0] = -slide
        return self.mesh.points[chosen] + displacement[chosen] - offset

    def start(self) -> Equilibrium:
        """Return the undeformed finger with the glass at its apex.

        Returns
        -------
        Equilibrium
        """
        rest = np.zeros(self.mesh.points.shape)
        relative = self.relative(rest, 0.0, 0.0)
        memory = free_anchors(relative)
        contact = plane_forces(np.maximum(relative, 0.0), self.areas, self.glass, memory)
        return Equilibrium(rest, 0.0, 0.0, contact, 0.0, 0.0, 0)


@dataclass(frozen=True)
class Target:
    """Slide of the glass, and either its depth or the normal force.

    Attributes
    ----------
    slide : float
        [mm].
    depth, normal_force : float or None
        One of the two [mm], [N].
    """

    slide: float = 0.0
    depth: float | None = None
    normal_force: float | None = None


def equilibrium(
    model: Model,
    before: Equilibrium,
    target: Target,
    *,
    guess: Equilibrium | None = None,
    max_iterations: int = 30,
    tolerance: float = 1e-8,
) -> Equilibrium:
    """Solve one step from the last accepted one.

    The residual must fall below ``tolerance`` times the contact force, or :data:`NOISE` where contact is almost none.
    An iterate with an inverted element or a number that is not finite is shortened, at most five times.

    Parameters
    ----------
    model : Model
    before : Equilibrium
        Last accepted state.
    target : Target
    guess : Equilibrium, optional
        First guess.
    max_iterations : int
        Of Newton's method.
    tolerance : float
        Of the residual, over the contact force.

    Returns
    -------
    Equilibrium

    Raises
    ------
    StepFailed
    """
    points, free = model.mesh.points, model.free
    dim, force_control = model.mesh.dim, target.normal_force is not None
    u = (guess or before).displacement.copy()
    depth = before.depth if target.depth is None else target.depth
    areas, anchors = model.areas, before.contact.anchors
    gripping = replace(model.glass, friction=GRIP)
    best, previous = np.inf, np.inf
    for iteration in range(max_iterations):
        # a cantilever as soft as a finger springs back far beyond the glass's small move if its first iterate may
        # slip, and then slips the other way for ever: so the skin follows the glass first
        glass = gripping if iteration == 0 and guess is None and target.slide != before.slide else model.glass
        contact = plane_forces(model.relative(u, depth, target.slide), areas, glass, anchors)
        residual = model.solid.forces(u)
        residual[model.mesh.candidates] -= contact.force
        normal = float(contact.force[:, -1].sum()) * model.turn
        error = float(np.linalg.norm(residual.ravel()[free]))
        missing = (target.normal_force - normal) / model.turn if target.normal_force is not None else 0.0
        scale = float(np.linalg.norm(contact.force))
        if not np.isfinite(error):
            raise StepFailed
        if iteration > 0 and error + abs(missing) <= tolerance * scale + NOISE:
            tangential = -float(contact.force[:, 0].sum()) * model.turn if dim == 3 else 0.0
            return Equilibrium(u, depth, target.slide, contact, normal, tangential, iteration)
        if iteration > 12 and error > 1e3 * max(best, 1e-9):
            raise StepFailed
        share = 0.5 if iteration > 7 and error > 0.5 * previous else 1.0
        best, previous = min(best, error), error
        matrix = model.solid.tangent() + contact_matrix(model, contact, points.size)
        step, raise_by = newton_step(model, matrix, residual, contact, free, missing, force_control)
        u, depth = _shortened(model, u, depth, share * step, share * raise_by)
    raise StepFailed


def contact_matrix(model: Model, contact: PlaneForces, size: int) -> Any:
    """Assemble the contact's stiffness blocks."""
    dim = model.mesh.dim
    unknown = model.mesh.candidates[:, None] * dim + np.arange(dim)
    rows = np.broadcast_to(unknown[:, :, None], contact.stiffness.shape)
    cols = np.broadcast_to(unknown[:, None, :], contact.stiffness.shape)
    kept = contact.touching
    entries = (contact.stiffness[kept].ravel(), (rows[kept].ravel(), cols[kept].ravel()))
    return sparse.coo_matrix(entries, shape=(size, size)).tocsr()


def newton_step(
    model: Model,
    matrix: Any,
    residual: Floats,
    contact: PlaneForces,
    free: NDArray[np.int64],
    missing: float,
    rise: bool,
) -> tuple[Floats, float]:
    """Return the correction of displacements and, under force control, of the depth."""
    system = matrix[free][:, free]
    rhs = -residual.ravel()[free][:, None]
    if rise:
        # raising the glass by one loads each node by its column of the contact stiffness (last component)
        by_depth = np.zeros(residual.shape)
        by_depth[model.mesh.candidates] = contact.stiffness[:, :, -1]
        rhs = np.column_stack([rhs, by_depth.ravel()[free]])
    solution = model.solve(system, rhs)
    if not np.isfinite(solution).all():
        raise StepFailed
    solution = solution.reshape(free.size, -1)
    change = solution[:, 0]
    raise_by = 0.0
    if rise:
        row = np.zeros(residual.shape)
        row[model.mesh.candidates, -1] = contact.stiffness[:, -1, -1]
        grip = row.ravel()[free]
        stiffness = float(contact.stiffness[:, -1, -1].sum() - grip @ solution[:, 1])
        if stiffness <= 0:
            raise StepFailed
        raise_by = (missing + float(grip @ change)) / stiffness
        change = change + raise_by * solution[:, 1]
    step = np.zeros(residual.size)
    step[free] = change
    return step.reshape(residual.shape), raise_by


def _shortened(model: Model, u: Floats, depth: float, step: Floats, raise_by: float) -> tuple[Floats, float]:
    """Return the next iterate: the full step, or less of it where that would invert an element."""
    share = 1.0
    for _ in range(6):
        trial = u + share * step
        if not model.solid.inverted(trial):
            return trial, depth + share * raise_by
        share *= 0.5
    raise StepFailed


def extrapolated(before: Equilibrium, last: Equilibrium, share: float) -> Equilibrium:
    """Extrapolate two accepted states, as a first guess of the next.

    Parameters
    ----------
    before, last : Equilibrium
        Two accepted states in turn.
    share : float
        Length of the next step over the last one's.

    Returns
    -------
    Equilibrium
    """
    guess = last.displacement + share * (last.displacement - before.displacement)
    return Equilibrium(guess, last.depth, last.slide, last.contact, last.normal_force, last.tangential_force, 0)
