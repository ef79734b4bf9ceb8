"""What a calibration tells: figures with intervals, the calibrated scene, and whether it is good enough."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from evanesce.chain.simulate import solve_contact
from evanesce.core.errors import InputError
from evanesce.inference.answer import extended_scene
from evanesce.inference.calibration.figures import FIGURES
from evanesce.inference.calibration.fit import Areas, RigFit
from evanesce.inference.calibration.intervals import Interval
from evanesce.inference.calibration.judgement import first_line, judged, warnings_of
from evanesce.prediction.fine import in_pixels
from evanesce.prediction.views import View
from evanesce.rig import Scene
from evanesce.rig.change import changed

VERSION = 1
"""Of the answer's form."""

NUISANCES = {
    "@light": "light of LEDs, exposure and gain, logarithm of real over nominal",
    "@black": "black level within its rounding",
    "@noise": "noise before the tone curve, logarithm",
    "@pose_x": "place of {} along x",
    "@pose_y": "place of {} along y",
    "@turn": "turn of {}",
    "@card_light": "light on {}, logarithm of real over nominal",
    "@card_slope_x": "fall of the light across {} along x",
    "@card_slope_y": "fall of the light across {} along y",
}


def result_of(found: RigFit) -> dict[str, Any]:
    """Return the answer as JSON-able data.

    Parameters
    ----------
    found : RigFit
    """
    reasons, remarks = judged(found)
    rows = [_row(found, name, figure) for name, figure in found.figures.items()]
    rig = [row for row in rows if row["told"] and not row["nuisance"]]
    return {
        "version": VERSION,
        "method": "calibration",
        "first_line": first_line(found, len(rig), reasons),
        "good": not reasons,
        "reasons": reasons,
        "remarks": remarks,
        "figures": [row for row in rows if not row["nuisance"]],
        "nuisances": [row for row in rows if row["nuisance"]],
        "not_fitted": [{"figure": name, "why": why} for name, why in found.left_out.items()],
        "areas": areas_of(found.areas, calibrated_scene(found)),
        "held_out": None if found.gain is None else found.gain.as_dict(),
        "residual_sd": found.by_kind,
        "own_error": {group: error.as_dict() for group, error in found.own_error.items()},
        "left": found.left.as_dict(),
        "misfit": {
            "nominal": found.start.base.misfit, "calibrated": found.best.misfit, "bins": found.best.residual.size,
        },
        "gate": [line.as_dict() for line in found.start.gate.lines],
        "codec": found.start.codec or None,
        "warnings": warnings_of(found),
        "scene": None,
        "seconds": found.seconds,
    }  # fmt: skip


def _row(found: RigFit, name: str, figure: Interval) -> dict[str, Any]:
    effect, colon, own = name.partition(":")
    factor, p = found.start.model.factor, figure.parameter
    ends = (figure.low, figure.value, figure.high, p.null, p.null + p.deviation)
    low, value, high, null, away = (in_pixels({name: p.coordinate.value(v)}, factor)[name] for v in ends)
    if colon:
        what = FIGURES[effect].what
    else:
        nuisance, _, of = name.rstrip("]").partition("[")
        what = NUISANCES.get(nuisance, name).format("the finger" if of.isdigit() else f"the {of}")
    return {
        "key": f"effects.{effect}.{own}" if colon else name, "what": what, "told": figure.told,
        "nuisance": not colon, "value": value, "lo": low, "hi": high, "unit": p.unit,
        "nominal": null, "prior_sd": abs(away - null), "narrowing": figure.narrowing,
        "away_sd": figure.away,
    }  # fmt: skip


def areas_of(areas: Areas, scene: Scene) -> list[dict[str, Any]]:
    """Return area against force as rows: read from measured and simulated frames, and of the contact itself.

    Parameters
    ----------
    areas : Areas
    scene : Scene
        Calibrated.
    """
    return [
        {
            "force_N": view.force_N, "held_out": view.locked, "measured_mm2": float(measured),
            "nominal_mm2": float(nominal), "calibrated_mm2": float(calibrated),
            "contact_mm2": _contact_mm2(scene, view),
        }
        for view, measured, nominal, calibrated in zip(
            areas.views, areas.measured, areas.nominal, areas.calibrated, strict=True
        )
    ]  # fmt: skip


def _contact_mm2(scene: Scene, view: View) -> float | None:
    """Return the true area of a scene's contact under a view's force; None where the scene's law has no answer."""
    try:
        _, state = solve_contact(scene, float(view.force_N or 0.0), seed=0, time_s=view.time_s)
    except InputError:
        return None
    return None if state is None else float(state.nominal_contact_area)


def calibrated_scene(found: RigFit) -> Scene:
    """Return the scene with the figures that the bundle determines, light, black level and the finger's place in it.

    Parameters
    ----------
    found : RigFit

    Returns
    -------
    Scene
        ``sources`` names the 90 % interval of each, ``assumptions`` what the bundle does not determine.
    """
    base, point = found.start.observation.believed, found.best.point
    scene = extended_scene(found.start.model, found.best)
    changes: dict[str, Any] = {}
    light = float(point.get("@light", 0.0))
    changes["leds.circuit.efficacy_W_per_A"] = base.leds.circuit.efficacy_W_per_A * float(np.exp(light))
    x, y = base.finger.position_mm
    session = next(
        (name[len("@pose_x") :] for name in point if name.startswith("@pose_x[") and name[8:-1].isdigit()), ""
    )
    changes["finger.position_mm"] = [
        x + float(point.get(f"@pose_x{session}", 0.0)), y + float(point.get(f"@pose_y{session}", 0.0)),
    ]  # fmt: skip
    changes["camera.pixel.black_level_DN"] = max(
        base.camera.pixel.black_level_DN + float(point.get("@black", 0.0)), 0.0
    )
    own = changed(scene, changes, file="fit")
    said, unknown = _said(found)
    data = own.as_dict()
    for name in ("leds.circuit.efficacy_W_per_A", "finger.position_mm", "camera.pixel.black_level_DN"):
        data["assumptions"].pop(name, None)
    data["sources"] |= {key: text for key, text in said.items() if own._has(key)}
    data["assumptions"] |= {key: text for key, text in unknown.items() if own._has(key)}
    return Scene.from_dict(data)


def _said(found: RigFit) -> tuple[dict[str, str], dict[str, str]]:
    """Return the intervals of what is determined by scene key, and what is said of the rest."""
    said, unknown = {}, {}
    for name, figure in found.figures.items():
        row = _row(found, name, figure)
        unit = "" if figure.parameter.unit == "1" else f" {figure.parameter.unit}"
        text = f"evanesce fit: 90 % interval {row['lo']:.4g} to {row['hi']:.4g}{unit}"
        if ":" in name and figure.told:
            said[row["key"].partition("[")[0]] = text
        elif ":" in name:
            unknown[row["key"].partition("[")[0]] = "evanesce fit: not determined by the bundle; most probable value"
        elif name == "@light" and figure.told:
            low, high = (100 * float(np.expm1(v)) for v in (figure.low, figure.high))
            said["leds.circuit.efficacy_W_per_A"] = (
                f"evanesce fit: stands for LEDs, exposure and gain together; 90 % interval {low:+.2g} to {high:+.2g} %"
                " of the nominal light"
            )
        elif name.startswith("@pose_x[") and name[8:-1].isdigit():
            said.setdefault(
                "finger.position_mm", f"evanesce fit: 90 % interval along x {row['lo']:+.3f} to {row['hi']:+.3f} mm"
            )
        elif name == "@black":
            said["camera.pixel.black_level_DN"] = f"{text} about nominal"
    return said, unknown


def heading_of(found: RigFit, name: str, result: Mapping[str, Any]) -> str:
    """Return the first lines of the calibrated scene's file: how it judges itself, what is not determined.

    Parameters
    ----------
    found : RigFit
    name : str
        Of the bundle.
    result : mapping
        Of :func:`result_of`.
    """
    lines = [f"Calibrated by `evanesce fit` from the bundle {name}.", result["first_line"]]
    lines += [f"Reason: {reason}." for reason in result["reasons"][1:]]
    not_told = [row for row in result["figures"] if not row["told"]]
    if not_told:
        lines += [
            "",
            "Not determined by this bundle (most probable value stands), 90 % interval with what is known before:",
        ]
        lines += [
            f"  {r['key']}: {r['lo']:.4g} to {r['hi']:.4g} {'' if r['unit'] == '1' else r['unit']}" for r in not_told
        ]
    if found.left_out:
        lines += ["Not fitted:", *(f"  {key}: {why}" for key, why in found.left_out.items())]
    return "\n".join(lines)
