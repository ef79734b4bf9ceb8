"""Scores of baseline slip detectors by one run of ``benchmarks/baseline.py``, for the data card."""

from __future__ import annotations

import functools
import json
from pathlib import Path
from typing import Any

RECORD = Path(__file__).with_name("baseline.json")
"""Written by ``python benchmarks/baseline.py --json``."""

TESTS = {
    "seen": "friction and ridge pitch as in training",
    "unseen_friction": "unseen friction",
    "unseen_pitch": "unseen ridge pitch",
}


@functools.cache
def record() -> dict[str, Any]:
    """Return the record of the run."""
    found: dict[str, Any] = json.loads(RECORD.read_text(encoding="utf-8"))
    return found


def summary() -> str:
    """Return the baselines' scores in a few sentences."""
    run = record()
    learned, rigs, plain, force = (
        run["results"][name]
        for name in ("frames", "frames, rigs without effects", "frames, one plain rig", "force threshold")
    )
    sentences = [
        f"Baselines (not of this set, on frames of format {run['format_version']}: `make baseline`, {run['trials']}"
        " training trials of 200 x 150 px, rigs unseen"
        " in training): mean absolute error of the stick ratio by gradient boosting on frames alone; in brackets:"
        " trained on the same rigs without effects, on one plain rig, isotonic fit of a perfect force sensor's"
        " |Ft|/Fn, a constant."
    ]
    for test, name in TESTS.items():
        r, alarms = learned[test], force[test]
        sentences.append(
            f"{name.capitalize()}: {r['mae']:.3f} +- {r['mae_standard']:.3f} ({rigs[test]['mae']:.3f},"
            f" {plain[test]['mae']:.3f}, {alarms['mae']:.3f}, {run['constant_mae'][test]:.3f}); gross slip detected in"
            f" time in {100 * r['detected']:.0f} % of {r['slides']} slides, {r['false_per_minute']:.1f} false alarms a"
            f" minute (force threshold: {100 * alarms['detected']:.0f} %, {alarms['false_per_minute']:.1f})."
        )
    return " ".join(sentences)
