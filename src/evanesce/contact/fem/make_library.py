"""Solve the presses of the library and write their files: ``python -m evanesce.contact.fem.make_library [FOLDER]``.

Takes some minutes a press on one core; a second call finds the runs in the cache.
"""

from __future__ import annotations

import sys
from pathlib import Path

from evanesce.contact.fem.library import (
    BONES,
    FAR_SLIDES,
    FOLDER,
    SLIDES,
    save_library_press,
    save_library_slide,
)
from evanesce.contact.fem.material import carried_on, rubber
from evanesce.contact.fem.mesh import FingerShape, MeshSize
from evanesce.contact.fem.programme import press, slide
from evanesce.contact.fem.result import SolvedRun
from evanesce.contact.fem.runs import cache_folder
from evanesce.contact.fem.steps import LimitReached
from evanesce.materials.tables import material as silicone

FORCES = (0.1, 0.15, 0.22, 0.33, 0.5, 0.7, 1.0, 1.4, 2.0, 2.5, 3.0, 3.5, 4.0, 4.5, 5.0)
SIZE = MeshSize(contact=0.06, fine_extent=5.8)
FAR_SIZE = MeshSize(contact=1.1, growth=1.5, coarsest=4.0)
"""Of slides by 20 mm, unless a finer one is named."""
MATERIALS = ("silskin_0", "silskin_20")


def library_run(material: str, bone: str) -> SolvedRun:
    """Solve one press of the library: the thesis's smooth finger with its static friction on glass.

    Parameters
    ----------
    material, bone : str
        Name in ``BONES``.

    Returns
    -------
    SolvedRun
    """
    friction = silicone(material).friction
    assert friction is not None  # both materials have one in the tables
    shape = FingerShape(bone_radius=BONES[bone])
    mu = friction.static_coefficient_smooth
    return press(shape, rubber(material), forces=FORCES, friction=mu, size=SIZE, cache=cache_folder())


def library_slide_run() -> SolvedRun:
    """Solve the slide of the library: Silskin 0 %, 1 N held, mu 0.67, 10 mm.

    Returns
    -------
    SolvedRun
    """
    size = MeshSize(contact=0.7, growth=1.4, coarsest=3.0)
    shape, chosen = FingerShape(), rubber("silskin_0")
    return slide(shape, chosen, force=1.0, distances=(10.0,), friction=0.67, size=size, cache=cache_folder())


def far_slide(material: str, bone: str) -> SolvedRun:
    """Solve a slide at 1 N held and the largest friction of the thesis's slides, by 20 mm or as far as it goes.

    The material is carried on beyond where its fit loses stability.

    Parameters
    ----------
    material, bone : str
        Key of ``FAR_SLIDES``.

    Returns
    -------
    SolvedRun
    """
    _, friction, contact = FAR_SLIDES[material, bone]
    size = FAR_SIZE if contact == FAR_SIZE.contact else MeshSize(contact, growth=1.4, coarsest=4.0)
    try:
        return slide(
            FingerShape(bone_radius=BONES[bone]), carried_on(rubber(material)), force=1.0, distances=(20.0,),
            friction=friction, size=size, cache=cache_folder(),
        )  # fmt: skip
    except LimitReached as error:
        if error.run is None or not error.run.reached():
            raise
        print(f"{material} {bone}: {error}", flush=True)
        return error.run


def main(folder: Path = FOLDER) -> None:
    """Write every file of the library.

    Parameters
    ----------
    folder : Path
        Where the files are written.
    """
    for material in MATERIALS:
        for bone in BONES:
            run = library_run(material, bone)
            save_library_press(folder / f"{material}_{bone}.npz", run)
            for index in run.reached():
                row = run.row(index)
                print(
                    f"{material} {bone} {row['normal_force_N']:.2f} N  depth {row['depth_mm']:.3f} mm  "
                    f"area {row['area_mm2']:.2f} mm^2  E* {row['reduced_modulus_MPa']:.4f} MPa",
                    flush=True,
                )
    save_library_slide(folder / SLIDES.name / "silskin_0_mu067.npz", library_slide_run())
    for (material, bone), (name, _, _) in FAR_SLIDES.items():
        save_library_slide(folder / SLIDES.name / f"{name}.npz", far_slide(material, bone))


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else FOLDER)
