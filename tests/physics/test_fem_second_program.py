"""The project's finite elements against other programs: CalculiX for a short slide, GetFEM for a press.

Left out of ``make test`` (minutes, and neither program comes with Python packages). On Debian:
``apt-get install calculix-ccx python3-getfem``, then ``pytest tests/physics/test_fem_second_program.py -rP`` prints
the figures that stand in docs/validation/contact-fem.md. Bounds: 2 % of force, 5 % of area.
"""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from support.calculix_deck import Slide
from support.calculix_deck import run as run_calculix

pytest.importorskip("felupe", reason="the optional extra 'fem' is not installed")

from evanesce.contact.fem.material import Rubber, rubber
from evanesce.contact.fem.mesh import FingerShape, MeshSize, finger_section
from evanesce.contact.fem.mesh_half import finger_half
from evanesce.contact.fem.programme import press, slide
from evanesce.contact.fem.surface import level_area, signed_opening

FORCE, AREA = 0.02, 0.05
SHAPE = FingerShape(tip_radius=7.5, diameter=15.0, length=15.0)
DEBIAN_PYTHON = "/usr/bin/python3"

pytestmark = [pytest.mark.second_program, pytest.mark.slow]


def _has_getfem() -> bool:
    if not Path(DEBIAN_PYTHON).is_file():
        return False
    return subprocess.run([DEBIAN_PYTHON, "-c", "import getfem"], capture_output=True, check=False).returncode == 0


def _compare(name: str, other: float, own: float, bound: float) -> None:
    print(f"{name:32s} other {other:9.4f}   own {own:9.4f}   own/other - 1 = {100 * (own / other - 1):+.2f} %")
    assert own == pytest.approx(other, rel=bound), name


@pytest.mark.parametrize(("name", "bone"), [("silskin_0", 0.0), ("silskin_20", 3.1)])
def test_press_by_getfem(name: str, bone: float, tmp_path: Path) -> None:
    if not _has_getfem():
        pytest.skip("GetFEM is not installed (Debian: python3-getfem)")
    shape, material = FingerShape(7.5, 15.0, 15.0, bone), rubber(name)
    depths, penalty = [0.3, 0.7], 5000 * material.shear_modulus
    mesh = finger_section(shape, MeshSize(contact=0.2, fine_extent=2.6, growth=1.5, coarsest=3.0))
    np.savez(
        tmp_path / "press.npz", points=mesh.points, cells=mesh.cells, clamped=mesh.clamped, cap=mesh.candidates,
        tip_radius=shape.tip_radius, penalty=penalty, depths=depths,
        coefficients=[material.c10, material.c01, material.c11, material.bulk_modulus],
    )  # fmt: skip
    script = Path(__file__).parents[1] / "support" / "getfem_press.py"
    command = [DEBIAN_PYTHON, str(script), str(tmp_path / "press.npz"), str(tmp_path / "press.json")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
    other = json.loads((tmp_path / "press.json").read_text(encoding="utf-8"))
    # another mesh than GetFEM's, of another element
    own = press(shape, material, depths=depths, penalty=penalty, size=MeshSize(0.1, 3.0, 1.3, 2.5))
    for instant, index in zip(other, own.reached(), strict=True):
        row = own.row(index)
        at = f"{name}, bone {bone:g}, {instant['depth']:g} mm"
        _compare(f"{at}: force [N]", instant["force"], row["normal_force_N"], FORCE)
        _compare(f"{at}: area [mm^2]", np.pi * instant["radius"] ** 2, row["area_mm2"], AREA)


def test_short_slide_by_calculix(tmp_path: Path) -> None:
    """Depth held, far into partial slip: 64 % of the normal force lies on slipping nodes at the end."""
    if shutil.which("ccx") is None:
        pytest.skip("CalculiX is not installed (Debian: calculix-ccx)")
    # what CalculiX can do bounds the case: K/G of 100 and a penalty of 30 MPa/mm, in both programs
    material: Rubber = rubber("silskin_0", bulk_ratio=100.0)
    depth, way, friction, penalty = 0.7, 1.5, 0.67, 30.0
    size = MeshSize(1.1, growth=1.4, coarsest=3.0)
    mesh = finger_half(SHAPE, size)
    candidates = set(mesh.candidates.tolist())
    skin = np.array([face for face in mesh.facets.tolist() if set(face) <= candidates])
    job = Slide(
        mesh.points, mesh.cells, mesh.clamped, mesh.mirror, skin, material.c10, material.c01, material.c11,
        material.bulk_modulus, friction, penalty, 0.5 * penalty, depth, way,
    )  # fmt: skip
    other = run_calculix(job, tmp_path)
    own = slide(SHAPE, material, depth=depth, distances=(way,), friction=friction, hold="depth", size=size,
                penalty=penalty)  # fmt: skip
    assert own.row(-1)["stick_force_share"] < 0.5
    number = np.full(len(mesh.points), -1)
    number[mesh.candidates] = np.arange(mesh.candidates.size)
    for step, index in enumerate(own.reached()):
        row, moved = own.row(index), np.zeros_like(mesh.points)
        moved[other.cap] = other.displacement[step]
        place = (mesh.points + moved)[mesh.candidates]
        gap = place[:, 2] - depth
        touching = gap < 0
        opening = signed_opening(place[:, :2], number[skin], np.where(touching, 0.0, gap), touching)
        area = 2 * level_area(place[:, :2], number[skin], opening)
        tangential, normal = other.force[np.flatnonzero(np.isclose(other.time, step + 1.0))[-1]]
        at = f"slide {row['slide_mm']:g} mm"
        _compare(f"{at}: normal force [N]", normal, row["normal_force_N"], FORCE)
        _compare(f"{at}: area [mm^2]", area, row["area_mm2"], AREA)
        if step == 1:
            _compare(f"{at}: tangential force [N]", -tangential, row["tangential_force_N"], FORCE)
