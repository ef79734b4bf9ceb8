"""Solved runs, and the file in which they are kept (NPZ without objects: nothing is ever unpickled)."""

from __future__ import annotations

import json
import os
import tempfile
import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.contact.fem.mesh import SolidMesh
from evanesce.contact.fem.newton import Equilibrium
from evanesce.contact.fem.plane import Anchors, PlaneForces
from evanesce.contact.fem.steps import History, Step
from evanesce.contact.fem.surface import Footprint, footprint
from evanesce.core.errors import InputError, WorkError
from evanesce.core.extras import require

Floats = NDArray[np.float64]
SCHEMA = 1
# what a file that is cut short, altered or another file altogether can raise while it is read
DAMAGED = (OSError, ValueError, KeyError, TypeError, IndexError, EOFError, zipfile.BadZipFile, zlib.error)


@dataclass(frozen=True)
class SolvedRun:
    """A programme of presses and slides as far as it was solved.

    Attributes
    ----------
    mesh : SolidMesh
    inputs : mapping
        Everything the result depends on, JSON-able; units in the keys where they are not mm, N, MPa.
    history : History
    limit : str
        Why the run ended early; empty otherwise.
    """

    mesh: SolidMesh
    inputs: Mapping[str, Any]
    history: History
    limit: str = ""

    def __len__(self) -> int:
        return len(self.history.steps)

    def footprint(self, index: int) -> Footprint:
        """Return the footprint of a step (from 0; negative from the end).

        Parameters
        ----------
        index : int

        Returns
        -------
        Footprint
        """
        state = self.history.steps[index].state
        memory = state.contact.anchors
        slip = memory.place - memory.touchdown
        return footprint(
            self.mesh, state.displacement, state.depth, state.contact.force, state.contact.touching,
            state.contact.slipping, slip,
        )  # fmt: skip

    def reached(self) -> list[int]:
        """Return the indices of the steps that end a goal.

        Returns
        -------
        list of int
        """
        return [i for i, step in enumerate(self.history.steps) if step.reached]

    def row(self, index: int) -> dict[str, float]:
        """Return the results of one step: depth, slide and stretches, forces [N], area [mm^2], penetration [mm].

        Parameters
        ----------
        index : int

        Returns
        -------
        dict of str to float
            Units in the keys.
        """
        step = self.history.steps[index]
        state, print_ = step.state, self.footprint(index)
        heights = (
            self.mesh.points[self.mesh.candidates, -1] + state.displacement[self.mesh.candidates, -1] - state.depth
        )
        sliding = float(state.contact.force[print_.touching & ~print_.slipping, -1].sum())
        total = float(state.contact.force[:, -1].sum())
        radius = self.inputs["shape"]["tip_radius"]
        return {
            "step": index + 1,
            "depth_mm": state.depth,
            "slide_mm": state.slide,
            "normal_force_N": state.normal_force,
            "tangential_force_N": state.tangential_force,
            "area_mm2": print_.area,
            "reduced_modulus_MPa": 0.75 * state.normal_force / (np.sqrt(radius) * state.depth**1.5)
            if state.depth > 0
            else np.nan,
            "peak_pressure_MPa": float(print_.pressure.max(initial=0.0)),
            "stick_force_share": sliding / total if total > 0 else np.nan,
            "stretch_min": step.stretch_min,
            "stretch_max": step.stretch_max,
            "penetration_mm": float(max(0.0, -heights.min())),
            "iterations": state.iterations,
        }


def save_run(path: Path, run: SolvedRun) -> None:
    """Write a run whole or not at all.

    The NPZ holds: ``meta`` (JSON: schema, inputs, complete, limit), the mesh (``points``, ``cells``, ``facets``,
    ``candidates``, ``clamped``, ``mirror``), and by step (first axis) ``depth``, ``slide``, ``normal_force``,
    ``tangential_force``, ``iterations``, ``stretches`` (min, max), ``goal``, ``reached``, ``next_size``,
    ``displacement`` (steps, nodes, d), ``contact_force`` (steps, candidates, d) on the finger, ``touching``,
    ``slipping``, and the anchors of friction ``place`` and ``touchdown`` (steps, candidates, d - 1). Lengths in mm,
    forces in N; coordinates (r, z) or (x, y, z).

    Parameters
    ----------
    path : Path
    run : SolvedRun

    Raises
    ------
    WorkError
        If the file cannot be written.
    """
    steps, mesh = run.history.steps, run.mesh
    meta = {"schema": SCHEMA, "inputs": dict(run.inputs), "complete": run.history.complete, "limit": run.limit}
    dim, n, k = mesh.dim, len(mesh.points), mesh.candidates.size

    def stack(values: list[Any], shape: tuple[int, ...], kind: Any = float) -> NDArray[Any]:
        return np.array(values, dtype=kind).reshape(len(steps), *shape)

    arrays = {
        "meta": np.array(json.dumps(meta, sort_keys=True)),
        **{key: getattr(mesh, key) for key in ("points", "cells", "facets", "candidates", "clamped", "mirror")},
        "depth": stack([s.state.depth for s in steps], ()),
        "slide": stack([s.state.slide for s in steps], ()),
        "normal_force": stack([s.state.normal_force for s in steps], ()),
        "tangential_force": stack([s.state.tangential_force for s in steps], ()),
        "iterations": stack([s.state.iterations for s in steps], (), int),
        "stretches": stack([(s.stretch_min, s.stretch_max) for s in steps], (2,)),
        "goal": stack([s.goal for s in steps], (), int),
        "reached": stack([s.reached for s in steps], (), bool),
        "next_size": stack([s.next_size for s in steps], ()),
        "displacement": stack([s.state.displacement for s in steps], (n, dim)),
        "contact_force": stack([s.state.contact.force for s in steps], (k, dim)),
        "touching": stack([s.state.contact.touching for s in steps], (k,), bool),
        "slipping": stack([s.state.contact.slipping for s in steps], (k,), bool),
        "place": stack([s.state.contact.anchors.place for s in steps], (k, dim - 1)),
        "touchdown": stack([s.state.contact.anchors.touchdown for s in steps], (k, dim - 1)),
    }
    write_npz(path, arrays)


def write_npz(path: Path, arrays: Mapping[str, NDArray[Any]], *, compressed: bool = False) -> None:
    """Write arrays to an NPZ beside its place and rename it there, so that a kill leaves either file whole.

    Parameters
    ----------
    path : Path
    arrays : mapping of str to ndarray
    compressed : bool
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(dir=path.parent, prefix="." + path.name, suffix=".tmp")
        try:
            with os.fdopen(handle, "wb") as stream:
                (np.savez_compressed if compressed else np.savez)(stream, **arrays)  # type: ignore[arg-type]
                stream.flush()
                os.fsync(stream.fileno())
            umask = os.umask(0)
            os.umask(umask)
            os.chmod(name, 0o666 & ~umask)
            os.replace(name, path)
        except BaseException:
            os.unlink(name)
            raise
    except OSError as error:
        raise WorkError(f"{path}: cannot write: {error.strerror}") from None


def load_run(path: Path) -> SolvedRun:
    """Read what :func:`save_run` wrote; needs no finite-element library.

    Parameters
    ----------
    path : Path

    Returns
    -------
    SolvedRun

    Raises
    ------
    InputError
        If the file is missing, damaged or of another schema.
    """
    try:
        with path.open("rb") as stream, np.load(stream, allow_pickle=False) as data:
            arrays = {key: data[key] for key in data.files}
        meta = json.loads(str(arrays["meta"]))
        if meta["schema"] != SCHEMA:
            raise InputError(f"schema {meta['schema']}", file=path, key="meta", allowed=str(SCHEMA))
        return _run_of(arrays, meta)
    except InputError:
        raise
    except DAMAGED as error:
        raise InputError(f"not a solved run: {error}", file=path, allowed="an NPZ written by `evanesce fem`") from None


def _run_of(arrays: Mapping[str, NDArray[Any]], meta: Mapping[str, Any]) -> SolvedRun:
    """Build the run; positions relative to the glass follow from displacement, depth and slide."""
    mesh = SolidMesh(**{key: arrays[key] for key in ("points", "cells", "facets", "candidates", "clamped", "mirror")})
    steps = []
    for i in range(len(arrays["depth"])):
        offset = np.zeros(mesh.dim)
        offset[-1] = arrays["depth"][i]
        if mesh.dim == 3:
            offset[0] = -arrays["slide"][i]
        moved = arrays["displacement"][i]
        touching = arrays["touching"][i]
        last = mesh.points[mesh.candidates] + moved[mesh.candidates] - offset
        memory = Anchors(touching, arrays["place"][i], arrays["touchdown"][i], last)
        force = arrays["contact_force"][i]
        contact = PlaneForces(force, np.zeros((*force.shape, mesh.dim)), arrays["slipping"][i], touching, memory)
        state = Equilibrium(
            moved, float(arrays["depth"][i]), float(arrays["slide"][i]), contact, float(arrays["normal_force"][i]),
            float(arrays["tangential_force"][i]), int(arrays["iterations"][i]),
        )  # fmt: skip
        low, high = arrays["stretches"][i]
        reached, size = bool(arrays["reached"][i]), float(arrays["next_size"][i])
        steps.append(Step(state, float(low), float(high), int(arrays["goal"][i]), reached, size))
    return SolvedRun(mesh, meta["inputs"], History(steps, bool(meta["complete"])), str(meta["limit"]))


def write_vtk(path: Path, run: SolvedRun, index: int) -> None:
    """Write one step as VTK (any form meshio knows by its suffix, e.g. ``.vtu``) with displacement and contact force.

    Parameters
    ----------
    path : Path
    run : SolvedRun
    index : int

    Raises
    ------
    InputError
        Without the extra ``fem``, or for a suffix that meshio does not support.
    """
    require("fem", "writing VTK", "meshio")
    import meshio

    mesh, state, print_ = run.mesh, run.history.steps[index].state, run.footprint(index)

    def spread(values: Floats, width: int) -> Floats:
        out = np.zeros((len(mesh.points), width))
        out[mesh.candidates] = values.reshape(-1, width) if values.ndim > 1 else values[:, None]
        return out

    def in_space(values: Floats) -> Floats:
        return values if mesh.dim == 3 else np.column_stack([values[:, 0], np.zeros(len(values)), values[:, 1]])

    data = {
        "displacement_mm": in_space(state.displacement),
        "contact_force_N": in_space(spread(state.contact.force, mesh.dim)),
        "pressure_MPa": spread(print_.pressure, 1)[:, 0],
        "gap_mm": spread(print_.gap, 1)[:, 0],
    }
    kind = "quad" if mesh.dim == 2 else "hexahedron"
    grid = meshio.Mesh(in_space(mesh.points), [(kind, mesh.cells)], point_data=data)
    temporary = path.with_name("." + path.name.removesuffix(path.suffix) + ".tmp" + path.suffix)
    try:
        grid.write(temporary)
        os.replace(temporary, path)
    except OSError as error:
        raise WorkError(f"{path}: cannot write: {error.strerror}") from None
    except (meshio.WriteError, meshio.ReadError, SystemExit, KeyError) as error:
        raise InputError(f"{path.suffix!r}: {error}", file=path, allowed=".vtu, .vtk, .xdmf") from None
