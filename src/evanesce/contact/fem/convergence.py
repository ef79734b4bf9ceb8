"""Mesh convergence: one press on finer and finer meshes, as in the thesis from 3.75 mm down to 0.33 mm."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from evanesce.contact.fem.material import Rubber
from evanesce.contact.fem.mesh import FingerShape, MeshSize
from evanesce.contact.fem.programme import press
from evanesce.core.errors import InputError

THESIS_SIZES = (3.75, 2.5, 1.5, 1.0, 0.66, 0.5, 0.33)  # [mm], the same element all over the finger
FINER_SIZES = (0.24, 0.17, 0.12)  # [mm] at the contact, growing away from it


@dataclass(frozen=True)
class MeshResult:
    """Result on one mesh of the study.

    Attributes
    ----------
    element_size : float
        [mm].
    elements : int
    area, depth, reduced_modulus : float
        [mm^2], [mm], [MPa].
    """

    element_size: float
    elements: int
    area: float
    depth: float
    reduced_modulus: float


@dataclass(frozen=True)
class Convergence:
    """The study, coarse to fine.

    Attributes
    ----------
    force : float
        [N].
    meshes : tuple of MeshResult
    tolerance : float
        Relative difference of areas required.
    """

    force: float
    meshes: tuple[MeshResult, ...]
    tolerance: float = 0.01

    def deviation(self) -> np.ndarray:
        """Return each mesh's relative deviation of area from the finest one's.

        Returns
        -------
        ndarray (meshes,)
        """
        area = np.array([mesh.area for mesh in self.meshes])
        return area / area[-1] - 1.0

    @property
    def converged_at(self) -> float | None:
        """Largest size [mm] from which on all meshes, two at least, are within the tolerance of the finest; or None."""
        off = np.flatnonzero(np.abs(self.deviation()) > self.tolerance)
        first = int(off[-1]) + 1 if off.size else 0
        return self.meshes[first].element_size if first < len(self.meshes) - 1 else None


def mesh_of(size: float) -> MeshSize:
    """Return the mesh for an element size [mm]: even where the thesis's were, graded where finer.

    Parameters
    ----------
    size : float

    Returns
    -------
    MeshSize
    """
    if size >= min(THESIS_SIZES):
        return MeshSize(contact=size, fine_extent=1e3, coarsest=size)
    return MeshSize(contact=size)


def check_sizes(sizes: Sequence[float]) -> None:
    """Refuse fewer than two sizes, or sizes that do not fall.

    Parameters
    ----------
    sizes : sequence of float
        [mm].
    """
    if len(sizes) < 2 or any(b >= a for a, b in pairwise(sizes)):
        raise InputError(f"{list(sizes)}", key="sizes", allowed="two or more, each below the one before [mm]")
    for size in sizes:
        mesh_of(size)


def convergence(
    shape: FingerShape,
    material: Rubber,
    *,
    force: float = 1.0,
    sizes: Sequence[float] = THESIS_SIZES + FINER_SIZES,
    friction: float = 0.0,
    cache: Path | None = None,
    on_mesh: Callable[[MeshResult], None] | None = None,
) -> Convergence:
    """Press to one force on meshes of falling element size.

    Parameters
    ----------
    shape : FingerShape
    material : Rubber
    force : float
        [N].
    sizes : sequence of float
        [mm], falling.
    friction : float
        Coulomb's coefficient.
    cache : Path, optional
        Folder of solved runs.
    on_mesh : callable, optional
        Called with each result.

    Returns
    -------
    Convergence

    Raises
    ------
    InputError
        For fewer than two sizes, or sizes that do not fall.
    """
    check_sizes(sizes)
    results = []
    for size in sizes:
        run = press(shape, material, forces=(force,), friction=friction, size=mesh_of(size), cache=cache)
        row = run.row(-1)
        values = (row["area_mm2"], row["depth_mm"], row["reduced_modulus_MPa"])
        results.append(MeshResult(float(size), len(run.mesh.cells), *values))
        if on_mesh is not None:
            on_mesh(results[-1])
    return Convergence(force, tuple(results))
