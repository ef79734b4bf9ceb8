"""The only file that imports FElupe (GPL-3, optional extra ``fem``): forces and tangent of a rubber body, solver.

FElupe gives the three-field element Q1P0 (mean dilatation; the pressure and volume are condensed per element) and the
assembly; the rubber's derivatives are closed forms, contact and step control the project's own.
"""

from __future__ import annotations

import importlib
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.contact.fem.material import Rubber, distortional_stress, distortional_tangent, energy
from evanesce.contact.fem.mesh import SolidMesh
from evanesce.core.extras import require

Floats = NDArray[np.float64]


def _felupe() -> Any:
    """Import FElupe when it is first needed, so that everything else works without the extra."""
    require("fem", "solving finite elements", "felupe")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return importlib.import_module("felupe")


class _DistortionalLaw:
    """The rubber's distortional energy as FElupe asks for it: derivatives by the deformation gradient (3, 3, q, c)."""

    def __init__(self, material: Rubber) -> None:
        self.material = material
        self.x = [np.eye(3), np.zeros(0)]  # shapes of the gradient and of the (absent) history

    def gradient(self, x: list[Any]) -> list[Any]:
        """Return first Piola-Kirchhoff stress [MPa] and the unchanged history."""
        return [distortional_stress(self.material, x[0]), x[1]]

    def hessian(self, x: list[Any]) -> list[Floats]:
        """Return the tangent [MPa], shape (3, 3, 3, 3, q, c)."""
        return [distortional_tangent(self.material, x[0])]


class Body:
    """A rubber solid whose internal forces and tangent stiffness follow from nodal displacements alone.

    Parameters
    ----------
    mesh : SolidMesh
        A section (treated as a full turn) or a half body.
    material : Rubber
    """

    def __init__(self, mesh: SolidMesh, material: Rubber) -> None:
        fem = _felupe()
        self._axisymmetric = mesh.dim == 2
        cells, points = mesh.cells, mesh.points
        if self._axisymmetric:  # FElupe turns its section about the first axis: (r, z) becomes (z, r)
            points, cells = points[:, ::-1], cells[:, ::-1]
        kind, region = ("quad", fem.RegionQuad) if self._axisymmetric else ("hexahedron", fem.RegionHexahedron)
        grid = region(fem.Mesh(np.ascontiguousarray(points), np.ascontiguousarray(cells), kind))
        field = fem.FieldAxisymmetric(grid, dim=2) if self._axisymmetric else fem.Field(grid, dim=3)
        self._field = fem.FieldContainer([field])
        law = _DistortionalLaw(material)
        self._material, self._bulk = material, material.bulk_modulus
        self._solid = fem.SolidBodyNearlyIncompressible(law, self._field, bulk=self._bulk)

    def _set(self, displacement: Floats) -> None:
        self._field[0].values[:] = displacement[:, ::-1] if self._axisymmetric else displacement

    def _natural(self, vector: Floats) -> Floats:
        values = vector.reshape(self._field[0].values.shape)
        return np.ascontiguousarray(values[:, ::-1]) if self._axisymmetric else values

    def inverted(self, displacement: Floats) -> bool:
        """Return whether an element's volume is not positive somewhere, or a displacement is not finite.

        Parameters
        ----------
        displacement : ndarray (n, d)
            [mm].

        Returns
        -------
        bool
        """
        if not np.isfinite(displacement).all():
            return True
        self._set(displacement)
        return bool(np.linalg.det(np.moveaxis(self._field.extract()[0], (0, 1), (-2, -1))).min() <= 0.0)

    def energy(self, displacement: Floats) -> float:
        """Return the energy [N mm] whose derivative :meth:`forces` are; infinite where an element is inverted.

        Parameters
        ----------
        displacement : ndarray (n, d)
            [mm].

        Returns
        -------
        float
        """
        if self.inverted(displacement):
            return float("inf")
        gradient, volumes = self._field.extract()[0], self._field.region.dV
        grown = np.linalg.det(np.moveaxis(gradient, (0, 1), (-2, -1))) * volumes
        whole = volumes.sum(axis=0)
        swelling = grown.sum(axis=0) / whole - 1.0
        return float((energy(self._material, gradient) * volumes).sum() + 0.5 * self._bulk * (swelling**2 @ whole))

    def forces(self, displacement: Floats) -> Floats:
        """Return internal nodal forces [N], shape (n, d), at displacements [mm] of that shape.

        Parameters
        ----------
        displacement : ndarray (n, d)
            [mm].

        Returns
        -------
        ndarray (n, d)
            [N].
        """
        self._set(displacement)
        vector = self._solid.assemble.vector(self._field)
        # FElupe's own pressure is linearised along the path of the iterations; it cancels from the forces but not
        # from the tangent, which is exact with the pressure of this very deformation
        state = self._solid.results.state
        state.J[:] = state.volume() / self._solid.V
        state.p[:] = self._bulk * (state.J - 1.0)
        return self._natural(vector.toarray()[:, 0])

    def tangent(self) -> Any:
        """Return the tangent stiffness (sparse CSR) at the displacements of the last :meth:`forces` [N/mm].

        Unknown d i + c is component c of node i, in the order of the mesh's coordinates.

        Returns
        -------
        sparse matrix (n d, n d)
            [N/mm].
        """
        matrix = self._solid.assemble.matrix(self._field).tocsr()
        if self._axisymmetric:
            turn = np.arange(matrix.shape[0]).reshape(-1, 2)[:, ::-1].ravel()
            matrix = matrix[turn][:, turn]
        return matrix

    def stretches(self, displacement: Floats) -> Floats:
        """Return the principal stretches at all integration points, largest first, shape (points, 3).

        Parameters
        ----------
        displacement : ndarray (n, d)
            [mm].

        Returns
        -------
        ndarray (points, 3)
        """
        self._set(displacement)
        gradient = np.moveaxis(self._field.extract()[0], (0, 1), (-2, -1))
        return np.asarray(np.linalg.svd(gradient, compute_uv=False).reshape(-1, 3))


def linear_solver() -> Callable[[Any, Floats], Floats]:
    """Return ``solve(matrix, right_hand_sides)``: PARDISO where pypardiso is installed, SuperLU otherwise.

    Returns
    -------
    callable
    """
    try:
        pardiso = importlib.import_module("pypardiso").PyPardisoSolver(mtype=11)
    except (ImportError, OSError):
        superlu = importlib.import_module("scipy.sparse.linalg").splu
        return lambda matrix, rhs: superlu(matrix.tocsc()).solve(rhs)

    def solve(matrix: Any, rhs: Floats) -> Floats:
        return np.asarray(pardiso.solve(matrix.tocsr(), np.asfortranarray(rhs)))

    return solve
