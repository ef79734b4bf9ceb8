"""Whether a calibrated scene is good enough to stand for the rig, by what its errors come to."""

from __future__ import annotations

from evanesce.inference.calibration.fit import RigFit
from evanesce.inference.calibration.own_error import PRESSES
from evanesce.inference.gate import LEVEL

GOOD_PERCENT = 2.0
"""Mean error of held-out areas [%], and light that nothing explains over the contact's [%], up to which a calibrated
scene counts as good: a choice, no published figure."""
GOOD_RESIDUAL = 2.0
"""Residual over its standard deviation, root mean square of a kind of views, up to which it counts as good."""
FAR_AWAY = 3.0
"""Prior standard deviations from its nominal value beyond which a figure is doubted."""


def judged(found: RigFit) -> tuple[list[str], list[str]]:
    """Return why the calibrated scene is not good enough as a twin of the rig, and what is left without that.

    Parameters
    ----------
    found : RigFit

    Returns
    -------
    reasons, remarks : list of str
        No reason: it is good enough.
    """
    reasons, remarks = _of_areas(found), list[str]()
    for kind, size in found.by_kind.items():
        if size > GOOD_RESIDUAL:
            reasons.append(
                f"frames of kind {kind} are left with {size:.2g} standard deviations (good: up to {GOOD_RESIDUAL:g})"
            )
    for share, text in _left(found):
        (reasons if 100 * share > GOOD_PERCENT else remarks).append(text)
    far = {name: f for name, f in found.figures.items() if ":" in name and abs(f.away) > FAR_AWAY}
    for name, figure in far.items():
        if figure.told:
            key = name.replace(":", ".")
            remarks.append(
                f"{key} is {abs(figure.away):.1f} prior standard deviations from nominal: check it by itself"
            )
    stand_ins = [name.replace(":", ".") for name, figure in far.items() if not figure.told]
    if stand_ins:
        remarks.append(f"not determined, and yet far from nominal in place of what is missing: {', '.join(stand_ins)}")
    return reasons, remarks


def _of_areas(found: RigFit) -> list[str]:
    """Return what held-out areas say against the scene."""
    if found.gain is None:
        return ["no condition could be held out: nothing that the fit has not seen judges it; measure more forces"]
    reasons = []
    if found.gain.worse:
        reasons.append("areas of held-out conditions are farther off than by the nominal scene: keep that one")
    if not found.gain.area_percent[1] <= GOOD_PERCENT:
        reasons.append(
            f"areas of held-out conditions are off by {found.gain.area_percent[1]:.3g} % on average"
            f" (good: up to {GOOD_PERCENT:g} %)"
        )
    return reasons


def _left(found: RigFit) -> list[tuple[float, str]]:
    """Return what no figure stands for: its size over the contact's light, and words."""
    light_DN = next((line.measured for line in found.start.gate.lines if line.name == LEVEL), 0.0)
    if not light_DN > 0.0:
        light_DN = 255.0  # without a contact, of the scale
    said = []
    off = {group: error for group, error in found.own_error.items() if error}
    if off:
        words = "; ".join(error.sentence(group, light_DN) for group, error in off.items())
        share = off[PRESSES].share(light_DN) if PRESSES in off else 0.0  # a twin stands for presses
        said.append((share, f"what no figure stands for is left, and was allowed for as an error of the {words}"))
    left = found.left
    if left.found:
        share = left.size if left.follows == "light" else left.size / light_DN
        said.append((share, f"there is {left.sentence()}: `evanesce criticise` seeks its cause"))
    return said


def warnings_of(found: RigFit) -> list[str]:
    """Return what a reader has to know before believing figures and intervals.

    Parameters
    ----------
    found : RigFit
    """
    warnings = list(found.start.gate.odd)
    if not found.replicates:
        warnings.append("no replicate frames: noise is the camera model's, and intervals may be too narrow")
    kinds = {view.kind for view in found.start.model.data.views}
    for kind, what in (("lens_cap", "dark frame"), ("checkerboard", "picture of the checkerboard")):
        if kind not in kinds:
            warnings.append(f"no {what}: what it would determine has a wider interval or none")
    if "square_size" in found.left_out:
        side = found.start.observation.scene.card.checkerboard_side_mm
        warnings.append(
            f"lengths rest on the checkerboard's squares of {side:g} mm as stated: 1 % of that is 2 % of every area,"
            " in no interval (a second card, the square, would tell)"
        )
    return warnings + ([found.reading] if found.reading else [])


def first_line(found: RigFit, count: int, reasons: list[str]) -> str:
    """Return the sentence that a reader needs if they read no other.

    Parameters
    ----------
    found : RigFit
    count : int
        Of the figures that are determined.
    reasons : list of str
        Of :func:`judged`.
    """
    words = f"{count} figures of the rig are determined"
    if found.gain is not None:
        before, after = found.gain.area_percent
        words += f"; error of held-out areas {before:.3g} to {after:.3g} %"
    if not reasons:
        return f"{words}. The calibrated scene is good enough to stand for the rig."
    return f"{words}. NOT good enough to stand for the rig: {reasons[0]}."
