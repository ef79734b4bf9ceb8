"""Predict contact area and sliding from the thesis's inputs alone, with intervals; nothing is fitted.

Inputs: the shapes, Mooney-Rivlin coefficients (table 6), moulded ridges (table 4), coefficients of friction (chapter
6). A bone was cast in, but its size is not printed: none, or rigid with half the shaft's radius. Varied as well are
pitch, position and direction of the ridges, and whether a tip of 10 mm radius has a shaft of 15 or of 20 mm. The finite
elements' own error comes from second meshes and is added to both ends. A value without further word is that of the
solid finger.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.contact.fem.library import library_press
from evanesce.contact.fem.stored import LibraryPress, LibrarySlide
from evanesce.materials.hyperelastic import of_material
from evanesce.materials.tables import material
from evanesce.studies.mechanics.curves import press_curves, slide_curves
from evanesce.studies.mechanics.ridges import press_ratios, slide_ratios
from evanesce.studies.mechanics.runs import (
    BONES,
    FRICTIONS,
    Mesh,
    SlideCase,
    solved_press,
    solved_slide,
)

Floats = NDArray[np.float64]

FORCES = (0.5, 1.0, 2.0, 5.0)  # [N], at which measured area is compared with finite elements
RIDGED_FRICTION = 0.82  # thesis, chapter 6: static coefficient of the ridged Silskin 0 % on glass
MESHES: tuple[Mesh, Mesh] = ("", "check")
WINDOW = (0.65, 1.45)  # [N], around 1 N: forces whose areas are smoothed by a power law


@dataclass(frozen=True)
class Prediction:
    """A figure and the interval in which it is expected.

    Attributes
    ----------
    value, low, high : float
        low <= value <= high.
    basis : str
        What it is, how it was computed and what spans its interval.
    """

    value: float
    low: float
    high: float
    basis: str

    def as_list(self) -> list[float]:
        """Return [value, low, high].

        Returns
        -------
        list of float
        """
        return [self.value, self.low, self.high]


def spanned(value: float, others: Sequence[float] | Floats, error: float, basis: str) -> Prediction:
    """Return a prediction whose interval holds the value and all others, widened by an error on both sides.

    Parameters
    ----------
    value : float
    others : sequence of float
    error : float
        Added to both ends, in the same unit.
    basis : str

    Returns
    -------
    Prediction
    """
    every = [value, *(float(other) for other in others)]
    return Prediction(float(value), float(min(every) - error), float(max(every) + error), basis)


def power_law(force: Floats, area: Floats) -> tuple[float, float]:
    """Return the area at 1 N [mm^2] by a power law through areas around it, and the largest relative misfit.

    Where the edge of a contact lies among the nodes of a mesh scatters single areas by up to a percent.

    Parameters
    ----------
    force : ndarray (n,)
        [N].
    area : ndarray (n,)
        [mm^2].

    Returns
    -------
    area_at_1N : float
        [mm^2].
    misfit : float
        [1].
    """
    slope, intercept = np.polyfit(np.log(force), np.log(area), 1)
    misfit = area / np.exp(intercept + slope * np.log(force)) - 1.0
    return float(np.exp(intercept)), float(np.abs(misfit).max())


def area_at_1N(press: LibraryPress) -> tuple[float, float]:
    """Return the area of a press at 1 N [mm^2] and its scatter [1].

    Parameters
    ----------
    press : LibraryPress

    Returns
    -------
    area : float
        [mm^2].
    scatter : float
        [1].
    """
    near = (press.force > WINDOW[0]) & (press.force < WINDOW[1])
    return power_law(press.force[near], np.pi * press.contact_radius[near] ** 2)


def mesh_error(name: str) -> float:
    """Return the relative error of a material's area at 1 N: elements of 0.12 against 0.06 mm, and the scatter.

    Parameters
    ----------
    name : str
        Of the material.

    Returns
    -------
    float
        [1].
    """
    errors = []
    for bone in BONES:
        usual, scatter = area_at_1N(solved_press(name, "standard", bone))
        fine, fine_scatter = area_at_1N(library_press(name, bone))
        errors.append(abs(usual / fine - 1.0) + max(scatter, fine_scatter))
    return max(errors)


def area_change(name: str, tops: Sequence[str], bases: Sequence[str], basis: str) -> Prediction:
    """Return area at 1 N of one shape over another's, less 1; the first pair without a bone is the value.

    Parameters
    ----------
    name : str
        Of the material.
    tops, bases : sequence of str
        Keys of :data:`~evanesce.studies.mechanics.runs.SHAPES`, in pairs.
    basis : str

    Returns
    -------
    Prediction
    """
    changes = []
    for top, base in zip(tops, bases, strict=True):
        for bone in BONES:
            over, _ = area_at_1N(solved_press(name, top, bone))
            under, _ = area_at_1N(solved_press(name, base, bone))
            changes.append(over / under - 1.0)
    return spanned(changes[0], changes[1:], np.sqrt(2.0) * mesh_error(name), basis)


def bone_change(name: str) -> Prediction:
    """Return area at 1 N with a bone over that without, less 1.

    Parameters
    ----------
    name : str
        Of the material.

    Returns
    -------
    Prediction
    """
    fine = {bone: area_at_1N(library_press(name, bone))[0] for bone in BONES}
    usual = {bone: area_at_1N(solved_press(name, "standard", bone))[0] for bone in BONES}
    ratios = [areas["half"] / areas["none"] - 1.0 for areas in (fine, usual)]
    basis = (
        f"{_title(name)}, 1 N: area with a rigid bone of 3.75 mm radius over area without, less 1 (finite elements of"
        " 0.06 mm). Interval: from no bone (0) to this one, and the mesh."
    )
    return spanned(ratios[0], [0.0, ratios[1]], np.sqrt(2.0) * mesh_error(name), basis)


def measured_over_fe(name: str, force: float) -> Prediction:
    """Return the waveguide's area (published power laws) over the finite elements' at a force [N].

    Parameters
    ----------
    name : str
        Of the material.
    force : float
        [N].

    Returns
    -------
    Prediction
    """
    law = material(name).measured_area
    assert law is not None  # the caller names a material that was measured
    # at the break both laws hold, and they do not meet there exactly
    measured = [float(law.area(force))]
    if force == law.break_N:
        measured.append(law.below_scale_mm2 * force**law.below_exponent)
    ratios = [area / library_press(name, bone).area(force) for bone in BONES for area in measured]
    basis = (
        f"{_title(name)}, {force:g} N: the thesis's measured power law over the area by finite elements (0.06 mm,"
        " friction 1.75, length 25 mm). Value: no bone. Interval: no bone to a rigid one of half the radius, and the"
        " mesh."
    )
    return spanned(ratios[0], ratios[1:], mesh_error(name) * max(ratios), basis)


def modulus_at_ridges(name: str) -> float:
    """Return E* = 4 G of the incompressible material at small strain [MPa].

    Parameters
    ----------
    name : str
        Of the material.

    Returns
    -------
    float
        [MPa].
    """
    return 4.0 * of_material(name).shear_modulus


def ridged_press() -> Prediction:
    """Return ridged over smooth area at 1 N of Silskin 0 %.

    Returns
    -------
    Prediction
    """
    modulus = modulus_at_ridges("silskin_0")
    ratios = {bone: press_ratios(bone, modulus) for bone in BONES}
    value = float(ratios["none"][:2].mean())
    basis = (
        "Silskin 0 %, 1 N: area of the finger with moulded ridges over that of the smooth one. The finite elements'"
        " smooth contact, ridges of 48 um closed by a half-space of E* = 4 G. Value: pitch 1.0 mm (furrows as wide as"
        " ridges), mean of crest and furrow at the tip, no bone. Interval: pitch 0.75 to 1.5 mm, crest or furrow, bone."
    )
    return spanned(value, np.concatenate(list(ratios.values())), 0.0, basis)


def overshoot(found: LibrarySlide) -> float:
    """Return the largest deviation of the normal force from that of the press, with its sign, over its amount there.

    Parameters
    ----------
    found : LibrarySlide

    Returns
    -------
    float
        [1].
    """
    change = found.scalars["normal_force"] / found.scalars["normal_force"][0] - 1.0
    return float(change[np.argmax(np.abs(change))])


def normal_force_overshoot(friction: float) -> Prediction:
    """Return the deviation of the normal force while Silskin 0 % slides at the depth that 1 N pressed.

    Parameters
    ----------
    friction : float
        Coefficient [1].

    Returns
    -------
    Prediction
    """
    found = {bone: solved_slide(SlideCase(friction, bone, "depth")) for bone in BONES}
    # what the mesh does at 0.67 is taken to scale with the deviation itself
    at_067 = [[overshoot(solved_slide(SlideCase(0.67, bone, "depth", mesh))) for bone in BONES] for mesh in MESHES]
    relative = [abs(other / usual - 1.0) for usual, other in zip(*at_067, strict=True)]
    ends = {bone: overshoot(one) * np.array([1.0, 1.0 - off, 1.0 + off])
            for (bone, one), off in zip(found.items(), relative, strict=True)}  # fmt: skip
    ways = {bone: float(one.scalars["slide"][-1]) for bone, one in found.items()}
    basis = (
        f"Silskin 0 %, pressed to 1 N, depth then held, mu {friction:g}, slid by {ways['none']:.1f} mm"
        f" ({ways['half']:.1f} with the bone; below 10 mm the run met its material or step limit before gross slip):"
        " largest deviation of the normal force, signed, over 1 N; negative is a drop. Value: no bone. Interval: no"
        " bone to a rigid one of half the radius, each with its mesh error (mu 0.67: 0.8 against 0.6 mm)."
        " A bone turns the drop into an overshoot."
    )
    return spanned(ends["none"][0], np.concatenate(list(ends.values())), 0.0, basis)


def ridged_sliding() -> Prediction:
    """Return ridged area at the end of a slide over that before it, Silskin 0 % under 1 N.

    Returns
    -------
    Prediction
    """
    modulus = modulus_at_ridges("silskin_0")
    cases = {bone: solved_slide(SlideCase(RIDGED_FRICTION, bone, "force")) for bone in BONES}
    ratios = {bone: slide_ratios(found, modulus) for bone, found in cases.items()}
    smooth = [_end_over_start(solved_slide(SlideCase(RIDGED_FRICTION, "none", "force", mesh))) for mesh in MESHES]
    basis = (
        "Silskin 0 %, 1 N held, mu 0.82: ridged area after a slide of 10 mm over that of the press. The smooth slide"
        " by finite elements (0.8 mm), ridges closed by a half-space as for the press. Value: no bone, pitch 1.0 mm,"
        " mean of ridges along and across the slide, crest or furrow. Interval: pitch 0.75 to 1.5 mm, both directions,"
        " bone, and the mesh (0.8 against 0.6 mm). Bending and Coulomb friction alone: no loss of adhesive area by"
        " shear."
    )
    every = np.concatenate(list(ratios.values()))
    return spanned(float(ratios["none"][:4].mean()), every, abs(smooth[1] - smooth[0]), basis)


def _end_over_start(found: LibrarySlide) -> float:
    return float(found.scalars["area"][-1] / found.scalars["area"][0])


def _title(name: str) -> str:
    rubber, percent = name.split("_")
    return f"{rubber.capitalize()} {percent} %"


def shape_changes(name: str) -> dict[str, Prediction]:
    """Return what length, tip radius and bone do to a material's area at 1 N.

    Parameters
    ----------
    name : str
        Of the material.

    Returns
    -------
    dict of str to Prediction
    """
    length = (
        f"{_title(name)}, 1 N: area of the finger 25 mm long over that of the one of 7.5 mm, less 1 (finite elements"
        " of 0.12 mm). Value: no bone. Interval: bone, and the mesh."
    )
    radius = (
        f"{_title(name)}, 1 N: area at tip radius 10 mm over that at 7.5 mm, less 1 (finite elements of 0.12 mm)."
        " Value: a hemisphere on a shaft of 20 mm, no bone. Interval: shaft of 15 or 20 mm, bone, and the mesh."
    )
    return {
        "area_change_length_25_vs_7p5_1N": area_change(name, ["standard"], ["short"], length),
        "area_change_radius_10_vs_7p5_1N": area_change(name, ["large20", "large15"], ["standard", "standard"], radius),
        "area_change_bone_1N": bone_change(name),
    }


def predictions() -> dict[str, Prediction | dict[str, Prediction]]:
    """Return every prediction by its key; those that depend on force, friction or material by that one's text.

    Returns
    -------
    dict
    """
    return {
        "area_ratio_ridged_1N": ridged_press(),
        **shape_changes("silskin_0"),
        "silskin_20_measured_over_fe": {f"{force:g}": measured_over_fe("silskin_20", force) for force in FORCES},
        "normal_force_overshoot": {f"{mu:g}": normal_force_overshoot(mu) for mu in FRICTIONS},
        "steady_area_ratio_ridged_sliding": ridged_sliding(),
        "silskin_20": shape_changes("silskin_20"),
    }


def as_json(found: Mapping[str, Prediction | Mapping[str, Prediction]]) -> dict[str, Any]:
    """Return the predictions as ``{key: [value, low, high]}`` with the bases beside them, curves included.

    Parameters
    ----------
    found : mapping
        Of :func:`predictions`.

    Returns
    -------
    dict
    """
    result: dict[str, Any] = {}
    bases: dict[str, Any] = {}
    for key, one in found.items():
        if isinstance(one, Prediction):
            result[key], bases[key] = one.as_list(), one.basis
        else:
            result[key] = {sub: each.as_list() for sub, each in one.items()}
            bases[key] = {sub: each.basis for sub, each in one.items()}
    return result | {"basis": bases, "press": press_curves(), "slide": slide_curves()}
