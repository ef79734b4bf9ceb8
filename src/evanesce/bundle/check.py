"""Contents of a bundle, and the effects that its measurements cannot identify."""

from __future__ import annotations

import math
from typing import Any

from evanesce.bundle.bundle import Bundle
from evanesce.bundle.layout import (
    AUXILIARY,
    CHOSEN,
    MIN_REPLICATES,
    OBSERVABLES,
    PRESS_FOLDER,
    PRESS_TABLE,
    REPLICATES_FOLDER,
    SERIES_FOLDER,
)
from evanesce.effects import all_effects

MISSING = {
    "press": "frames of presses",
    "voltage": "press frames at two LED voltages or more",
    "force": "press frames at two forces or more",
    "time": "a hold of at least 10 s",
    "motion": "press frames at most 0.5 s apart while the force changes",
    "displacement": "displacement_mm in press.csv",
    "replicates": f"{MIN_REPLICATES} frames of a held state: without them the false-alarm rate is not controlled",
    "led_off": "frames with the LEDs off",
    "lens_cap": "frames with the lens covered",
    "checkerboard": "a shot of the checkerboard",
    "square": "a shot of the square",
    "series": "a scalar series",
}


def contents(bundle: Bundle) -> dict[str, Any]:
    """Return the contents of a bundle, what is missing, and the effects that cannot be identified without it.

    Parameters
    ----------
    bundle : Bundle

    Returns
    -------
    dict
        JSON-able, units in the keys.
    """
    press = bundle.press
    missing = [name for name in OBSERVABLES if name not in bundle.available]
    unidentifiable = {
        name: [need for need in effect.needs if need not in bundle.testable]
        for name, effect in all_effects().items()
        if not set(effect.needs) <= bundle.testable
    }
    rows, cols = bundle.shape
    return {
        "path": str(bundle.path),
        "title": bundle.title,
        "doubts": bundle.doubts,
        "resolution_px": [cols, rows],
        "frames": {kind: bundle.count(kind) for kind in ("press", "replicates", *AUXILIARY)},
        "press": {
            "conditions": len({shot.condition for shot in press}),
            "sessions": len({shot.session for shot in press}),
            "force_N": _range([shot.force_N for shot in press]),
            "voltage_V": _range([shot.voltage_V for shot in press]),
            "time_s": _range([shot.time_s for shot in press]),
            "chosen_by_camera": {
                name: _range([getattr(shot, name) for shot in press])
                for name in CHOSEN
                if press and all(math.isfinite(getattr(shot, name)) for shot in press)
            },
            "longest_hold_s": max((shot.held_s for shot in press), default=0.0),
        },
        "series": {
            name: {"x": f"{s.x_name} [{s.x_unit}]", "y": f"{s.y_name} [{s.y_unit}]", "points": len(s)}
            for name, s in bundle.series.items()
        },
        "available": [name for name in OBSERVABLES if name in bundle.available],
        "missing": missing,
        "cannot_be_named": unidentifiable,
        "not_read": unread(bundle),
    }


def unread(bundle: Bundle) -> list[str]:
    """Return folders and tables that nothing reads, by name: a misspelt one would otherwise go unnoticed.

    Parameters
    ----------
    bundle : Bundle

    Returns
    -------
    list of str
    """
    known = {PRESS_FOLDER, REPLICATES_FOLDER, SERIES_FOLDER, *AUXILIARY, PRESS_TABLE}
    found = [p for p in bundle.path.iterdir() if not p.name.startswith(".") and (p.is_dir() or p.suffix == ".csv")]
    return sorted(p.name for p in found if p.name not in known)


def _range(values: list[float]) -> list[float]:
    return [min(values), max(values)] if values else []
