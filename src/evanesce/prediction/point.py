"""A point of the joint model: what it changes of the believed scene, and what it says of each view's nuisances.

A departure is a point: a mapping of parameter names to values, where a missing name means "as believed". Parameters
of effects are named ``effect:parameter`` (``vignetting:k``, ``vignetting:centre_offset_px[0]``) and stand in the
coordinate in which a fit moves them (:class:`~evanesce.effects.inference_hints.Coordinate`); nuisances start with ``@``
(:mod:`evanesce.prediction.nuisance`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from evanesce.effects import all_effects
from evanesce.prediction.views import View
from evanesce.rig import Scene

Point = Mapping[str, float]


@dataclass(frozen=True)
class Nuisances:
    """What a lab does not know exactly of one view.

    Attributes
    ----------
    shift_mm : tuple of float
        Of the finger's tip from its believed place, (x, y) [mm]; of a card from the plate's middle.
    turn_deg : float
        Of a card [deg].
    log_light : float
        Logarithm of real over believed light: LEDs, exposure, the room for cards.
    slope : tuple of float
        Of a card's lighting over half the frame, along columns and rows [1].
    veil : float
        Light that ink sends besides what is believed, over a card's illumination: what the glass mirrors, and its
        reflectance [1].
    black_DN : float
        Real less believed black level [raw DN].
    log_force : float
        Logarithm of real over noted force.
    log_noise : float
        Logarithm of real noise before the tone curve over that of the predictor.
    """

    shift_mm: tuple[float, float] = (0.0, 0.0)
    turn_deg: float = 0.0
    log_light: float = 0.0
    slope: tuple[float, float] = (0.0, 0.0)
    veil: float = 0.0
    black_DN: float = 0.0
    log_force: float = 0.0
    log_noise: float = 0.0


def nuisances_of(point: Point, view: View, place: int) -> Nuisances:
    """Return what a point says of one view: names end in ``[session]`` for poses, ``[view]`` for the rest."""
    where = f"{view.kind}" if view.is_card else f"{view.session}"

    def get(name: str) -> float:
        return float(point.get(f"@{name}", 0.0))

    card = view.is_card
    return Nuisances(
        shift_mm=(get(f"pose_x[{where}]"), get(f"pose_y[{where}]")),
        turn_deg=get(f"turn[{where}]") if card else 0.0,
        log_light=get(f"card_light[{where}]") if card else get("light") + get(f"flicker[{place}]"),
        slope=(get(f"card_slope_x[{where}]"), get(f"card_slope_y[{where}]")) if card else (0.0, 0.0),
        veil=get(f"card_veil[{where}]") if card else 0.0,
        black_DN=get("black"),
        log_force=0.0 if card else get("force") + get(f"force[{place}]"),
        log_noise=get("noise"),
    )


def natural(name: str, coordinate: float) -> float:
    """Return the value of a point's number in its unit.

    Parameters
    ----------
    name : str
        Of the parameter, or of a nuisance, which stands for itself.
    coordinate : float
        As the point has it.
    """
    effect, colon, parameter = name.partition(":")
    known = all_effects()[effect].coordinates if colon and effect in all_effects() else {}
    if parameter not in known:
        return coordinate
    # Rounded: what a bound's coordinate stands for may not lie beyond the bound by its last digit.
    return float(f"{known[parameter].value(coordinate):.14g}")


def scene_with(scene: Scene, point: Point, fixed: Mapping[str, Mapping[str, Any]] | None = None) -> Scene:
    """Return the scene with a point's effects switched on; parameters that it does not name stay as believed.

    Parameters
    ----------
    scene : Scene
    point : mapping
    fixed : mapping, optional
        Settings of effects that the scene does not have, for when the point names them: places that data showed.
    """
    changes: dict[str, dict[str, float]] = {}
    for name, value in point.items():
        effect, colon, parameter = name.partition(":")
        if colon:
            changes.setdefault(effect, {})[parameter] = natural(name, value)
    tables = {name: dict(table) for name, table in scene.effects.items()}
    for effect, values in changes.items():
        believed: dict[str, Any] = {
            name: list(v) if isinstance(v, list | tuple) else v
            for name, v in tables.get(effect, (fixed or {}).get(effect, {})).items()
        }
        whole = all_effects()[effect].with_values(values).model_dump()
        named = {name.partition("[")[0] for name in values}
        table = believed | {name: value for name, value in whole.items() if name in named or name not in believed}
        for name in named & set(believed):
            if isinstance(believed[name], list):
                merged = list(believed[name])
                for full, value in values.items():
                    base, bracket, index = full.partition("[")
                    if bracket and base == name:
                        merged[int(index[:-1])] = float(value)
                table[name] = merged
        tables[effect] = {name: list(v) if isinstance(v, tuple) else v for name, v in table.items()}
    return scene.model_copy(update={"effects": tables})
