"""Curves of the solved presses and slides of the mechanics study, as plain data."""

from __future__ import annotations

from typing import Any

import numpy as np

from evanesce.contact.fem.library import library_press, library_slide
from evanesce.contact.fem.stored import LibrarySlide
from evanesce.studies.mechanics.runs import BONES, MATERIALS, SLIDES, solved_slide


def press_curves() -> dict[str, dict[str, dict[str, list[float]]]]:
    """Return area [mm^2] and depth [mm] against force [N] by material and bone.

    Returns
    -------
    dict
    """
    curves: dict[str, dict[str, dict[str, list[float]]]] = {}
    for name in MATERIALS:
        curves[name] = {}
        for bone in BONES:
            press = library_press(name, bone)
            curves[name][bone] = {
                "force_N": press.force.tolist(),
                "area_mm2": (np.pi * press.contact_radius**2).tolist(),
                "depth_mm": press.depth.tolist(),
            }
    return curves


def slide_curves() -> dict[str, dict[str, Any]]:
    """Return forces [N] and area [mm^2, and over that of the press] against displacement [mm], by slide.

    Returns
    -------
    dict
    """
    found = {case.name: solved_slide(case) for case in SLIDES}
    found["silskin_0_none_mu067_force_library"] = library_slide("silskin_0_mu067")
    return {name: _slide_curve(one) for name, one in found.items()}


def _slide_curve(found: LibrarySlide) -> dict[str, Any]:
    area, pressure = found.scalars["area"], np.asarray(found.fields["pressure"], dtype=float)
    touching, slipping = found.fields["touching"].astype(bool), found.fields["slipping"].astype(bool)
    last = touching[-1]
    return {
        "friction": float(found.inputs["glass"]["friction"]),
        "bone_radius_mm": float(found.inputs["shape"]["bone_radius"]),
        "held": str(found.inputs["goals"][-1]["hold"]),
        "element_mm": float(found.inputs["mesh"]["contact"]),
        "slide_mm": found.scalars["slide"].tolist(),
        "normal_force_N": found.scalars["normal_force"].tolist(),
        "tangential_force_N": found.scalars["tangential_force"].tolist(),
        "area_mm2": area.tolist(),
        "area_ratio": (area / area[0]).tolist(),
        "peak_pressure_MPa": pressure.max(axis=1).tolist(),
        "slips_as_a_whole": bool(slipping[-1][last].all()),
    }
