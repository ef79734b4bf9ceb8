"""Summarise a dataset."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any

from evanesce.dataset import layout
from evanesce.dataset.config import Randomisation
from evanesce.dataset.job import load_job
from evanesce.dataset.manifest import Manifest


def describe(folder: Path) -> dict[str, Any]:
    """Return counts, sizes and settings of a dataset.

    Raises
    ------
    InputError
        If the folder holds no dataset.
    """
    job = load_job(folder)
    manifest = Manifest.open(folder / layout.MANIFEST)
    try:
        rows, shards = manifest.frames(), manifest.shards()
        meta, quarantined = manifest.meta(), manifest.quarantined()
    finally:
        manifest.close()
    trials = {row["trial"]: row for row in rows}
    size = sum(row["size"] for row in shards.values())
    cols, rows_px = job.resolution
    return {
        "title": job.config.title or job.scene.title,
        "complete": meta.get("sealed") == "1",
        "frames": len(rows),
        "frames_asked_for": job.frames,
        "quarantined": len(quarantined),
        "trials": len(trials),
        "trials_by_kind": dict(sorted(Counter(row["kind"] for row in trials.values()).items())),
        "trials_by_split": dict(sorted(Counter(row["split"] for row in trials.values()).items())),
        "split_by": job.config.split.by,
        "shards": len(shards),
        "bytes": size,
        "bytes_per_frame": round(size / len(rows)) if rows else 0,
        "resolution_px": f"{cols} x {rows_px}",
        "frame_rate_hz": job.config.trial.frame_rate_hz,
        "plate_pitch_mm": job.config.labels.grid_size_mm / job.config.labels.grid_samples,
        "precision": job.config.labels.precision,
        "raw": job.config.labels.raw,
        **effects(job.config.randomisation),
        "seed": job.seed,
        "config_sha256": job.digest,
        "evanesce": meta.get("evanesce", ""),
    }


def effects(options: Randomisation) -> dict[str, Any]:
    """Return which effects are drawn, in which share of the rigs, and which are not and why."""
    drawn = options.candidates
    return {
        "effects_drawn": ", ".join(drawn) or "none",
        "share_of_rigs_with_an_effect": options.probability if drawn else 0.0,
        "shares_of_their_own": {name: options.probability_of(name) for name in drawn if name in options.effects},
        "effects_not_drawn": options.left_out,
    }
