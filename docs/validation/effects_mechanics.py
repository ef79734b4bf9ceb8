"""Figures of the validation pages of effects on geometry and mechanics, on the shipped scenes.

Run: python docs/validation/effects_mechanics.py
"""

from __future__ import annotations

import time

import numpy as np
from scipy.optimize import brentq

from evanesce.chain.simulate import solve_contact
from evanesce.contact.fem.library import library_press
from evanesce.optics.projection import Projection
from evanesce.render.fast.transport import render_fast
from evanesce.rig import Scene, load_scene

GRID = {"grid.samples": 320, "grid.size_mm": 16.0}
LAWS: dict[str, dict[str, object]] = {
    "hertz": {"law": "hertz"},
    "scaled_hertz": {"law": "scaled_hertz", "area_scale": 1.3},
    "jkr": {"law": "jkr", "work_of_adhesion_N_per_mm": 2e-5},
    "xydas_kao": {"law": "xydas_kao", "c_mm": 2.1, "gamma": 0.29},
    "halfspace": {"law": "halfspace"},
    "fem": {"law": "fem", "bone": "none"},
}


def scene_of(law: str, name: str = "thesis", **effects: dict[str, float]) -> Scene:
    """Return a shipped scene under a contact law, with effects."""
    return load_scene(name, {**GRID, "contact": LAWS[law]}).model_copy(update={"effects": effects})


def area(scene: Scene, force: float, time_s: float = 0.0) -> float:
    """Return the nominal area of contact [mm^2]."""
    state = solve_contact(scene, force, seed=1, time_s=time_s)[1]
    assert state is not None
    return state.nominal_contact_area


def changes(name: str, **values: float) -> None:
    """Print the change of area [%] by law and force."""
    print(f"\n{name} {values}: change of contact area in percent at 0.5, 1, 2, 4 N")
    for law in LAWS:
        row = []
        for force in (0.5, 1.0, 2.0, 4.0):
            plain = area(scene_of(law), force)
            row.append(100 * (area(scene_of(law, **{name: values}), force) / plain - 1))
        print(f"  {law:13s}" + "".join(f"{value:9.2f}" for value in row))


def bone() -> None:
    """Print the stiffness factor at which the finger without bone has the area of the one with."""
    print("\nbone of half the tip radius: stiffness factor that gives its area, less 1, over force [1/N]; area; depth")
    for name in ("silskin_0", "silskin_20"):
        free, bone_press = library_press(name, "none"), library_press(name, "half")
        for force in (0.5, 1.0, 2.0, 3.0, 5.0):
            goal = bone_press.area(force)
            equal = brentq(lambda load, goal=goal, press=free: press.area(load) - goal, float(free.force[0]), force)
            share, depth = goal / free.area(force), bone_press.at(force).depth / free.at(force).depth
            print(f"  {name:11s}{force:5.1f} N  {(force / equal - 1) / force:7.3f}   {share:6.3f}   {depth:6.3f}")


def adhesion_on_ridges() -> None:
    """Print area with adhesion on a ridged finger by two routes, and the time it takes."""
    print("\nadhesion on the ridged finger at 1.3 N, 0.1 J/m^2: gain of area [mm^2] by law")
    for samples in (160, 320):
        for law in ("hertz", "halfspace", "fem"):
            scene = load_scene("thesis_ridged", {"grid.samples": samples, "grid.size_mm": 9.0, "contact": LAWS[law]})
            start = time.perf_counter()
            gain = area(scene.model_copy(update={"effects": {"adhesion": {"work_J_per_m2": 0.1}}}), 1.3)
            seconds = time.perf_counter() - start
            print(f"  {samples} samples, {law:10s}{gain - area(scene, 1.3):8.4f}   {seconds:.1f} s")


def tilt() -> None:
    """Print how far image points move for one degree of tilt."""
    scene = load_scene("thesis")
    x, y = np.meshgrid([-12.0, 0.0, 12.0], [-8.0, 0.0, 8.0])
    before = np.stack(Projection.of(scene.camera, scene.plate).to_image(x, y))
    rig, _ = solve_contact(scene.model_copy(update={"effects": {"plate_tilt": {"about_x_deg": 1.0}}}), None, seed=1)
    moved = np.stack(Projection.of(rig.camera, rig.plate).to_image(x, y)) - before
    print("\nplate tilted by 1 deg about x: image moves by [px], points at x = -12, 0, 12 and y = -8, 0, 8 mm")
    for dx, dy in zip(moved[0], moved[1], strict=True):
        print("  " + "".join(f"({a:7.2f}, {b:7.2f}) " for a, b in zip(dx, dy, strict=True)))


def moved() -> None:
    """Print how a displaced contact differs, in the fast renderer, from a finger that stands there."""
    view = {
        "camera.resolution_px": [400, 300],
        "camera.scale_px_per_mm": 20.0,
        "camera.lens.focal_length_mm": 2.0,
        "camera.lens.distortion": {"k1": 0.0},
        "grid.samples": 300,
        "grid.size_mm": 9.0,
    }
    values = {"shift_x_mm_per_N": 0.5, "shift_y_mm_per_N": -0.3}
    displaced = load_scene("thesis", view).model_copy(update={"effects": {"off_axis_load": values}})
    standing = load_scene("thesis", view | {"finger.position_mm": [0.75, -0.45]})
    one, two = (
        np.asarray(render_fast(*solve_contact(scene, 1.5, seed=1), seed=1).radiance) for scene in (displaced, standing)
    )
    print("\noff_axis_load: contact moved by (0.75, -0.45) mm against a finger that stands there, fast renderer")
    largest = 100 * np.abs(one - two).max() / two.max()
    print(f"  all light {100 * (one.sum() / two.sum() - 1):.2f} %, largest {largest:.2f} % of the brightest pixel")


def ridges() -> None:
    """Print the area of the ridged finger as its ridges grow."""
    print("\nridge_height 0.2: change of contact area of the ridged finger [%] at 0.5, 1, 2, 4 N")
    row = []
    for force in (0.5, 1.0, 2.0, 4.0):
        plain, high = (
            area(scene_of("hertz", "thesis_ridged", **e), force) for e in ({}, {"ridge_height": {"relative": 0.2}})
        )
        row.append(100 * (high / plain - 1))
    print("  " + "".join(f"{value:9.2f}" for value in row))


def main() -> None:
    """Print the tables."""
    changes("modulus", relative=0.2)
    changes("adhesion", work_J_per_m2=0.05)
    changes("bone_stiffening", per_N=0.083)
    changes("creep", per_decade=0.05, held_before_s=10.0)
    changes("force_offset", offset_N=0.1)
    changes("shear_area_loss", loss_mm2_per_N2=2.0)
    bone()
    ridges()
    adhesion_on_ridges()
    tilt()
    moved()


if __name__ == "__main__":
    main()
