"""Figure of the mechanics study: area against force, forces and area against displacement."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from evanesce.materials.tables import material

COLOURS = {"silskin_0": "C0", "silskin_20": "C1"}
TITLES = {"silskin_0": "Silskin 0 %", "silskin_20": "Silskin 20 %"}


def mechanics_figure(result: Mapping[str, Any]) -> Figure:
    """Return three panels from what ``evanesce study mechanics`` writes.

    Parameters
    ----------
    result : mapping
        With ``press`` and ``slide`` of :func:`evanesce.studies.mechanics.study.as_json`.

    Returns
    -------
    Figure
    """
    figure = Figure(figsize=(15.5, 4.2), layout="constrained")
    left, middle, right = figure.subplots(1, 3)
    _areas(left, result["press"])
    for held, axis in (("normal_force_N", middle), ("area_ratio", right)):
        _slides(axis, result["slide"], held)
    middle.set(
        xlabel="displacement of the finger's top [mm]",
        ylabel="force [N]",
        title="Silskin 0 %, depth held at that of 1 N",
    )
    right.set(xlabel="displacement of the finger's top [mm]", ylabel="contact area over that of the press [1]")
    right.set_title("solid: depth held; dotted: 1 N held")
    middle.plot([], [], "0.5", label="normal force, solid")
    middle.plot([], [], "0.5", ls="--", label="tangential force, dashed")
    for axis in (left, middle, right):
        axis.grid(alpha=0.3)
        axis.legend(frameon=False, fontsize=8)
    return figure


def _areas(axis: Axes, curves: Mapping[str, Any]) -> None:
    for name, bones in curves.items():
        force = np.asarray(bones["none"]["force_N"])
        axis.plot(force, bones["none"]["area_mm2"], COLOURS[name], label=f"{TITLES[name]}, finite elements, no bone")
        axis.fill_between(
            force, bones["half"]["area_mm2"], bones["none"]["area_mm2"], color=COLOURS[name], alpha=0.2, lw=0,
            label="to a rigid bone of half the radius",
        )  # fmt: skip
        law = material(name).measured_area
        if law is not None:
            axis.plot(force, law.area(force), COLOURS[name], ls=":", label=f"{TITLES[name]}, measured (published fit)")
    axis.set(xlabel="normal force [N]", ylabel="contact area [mm$^2$]", title="pressing", ylim=(0, 160))


def _slides(axis: Axes, slides: Mapping[str, Any], what: str) -> None:
    colours = {0.67: "C2", 0.82: "C3", 1.13: "C4"}
    for one in slides.values():
        if one["element_mm"] != 0.8:  # the finer meshes are there for the intervals
            continue
        by_force = one["held"] == "force"
        if by_force and what != "area_ratio":
            continue
        bone = one["bone_radius_mm"] > 0
        label = f"mu {one['friction']:g}" + (", bone" if bone else "") + (", 1 N held" if by_force else "")
        colour, weight = colours[one["friction"]], 0.9 if bone else 1.8
        axis.plot(one["slide_mm"], one[what], colour, lw=weight, ls=":" if by_force else "-", label=label)
        if what == "normal_force_N":
            axis.plot(one["slide_mm"], one["tangential_force_N"], colour, lw=weight, ls="--")
