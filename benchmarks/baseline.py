"""Is the dataset any good? Two baselines from frames alone, against a force threshold; what randomisation is worth.

Stick ratio by gradient boosting on plain features of the last frames, and slip onset from it, on trials with unseen
friction, unseen ridge pitch and unseen rigs. Frames are 200 x 150.

    python benchmarks/baseline.py [--trials N] [--out DIR] [--workers W] [--json FILE]
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import os
import time
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from sklearn.ensemble import HistGradientBoostingRegressor
from sklearn.isotonic import IsotonicRegression
from sklearn.metrics import mean_absolute_error, r2_score
from sklearn.model_selection import GroupKFold, cross_val_predict

import evanesce.dataset as dataset
from evanesce import provenance
from evanesce.dataset.config import DatasetConfig
from evanesce.dataset.job import new_job
from evanesce.dataset.run import Engine, make, resume
from evanesce.dataset.slip_scores import Series, choose_threshold, score
from evanesce.rig import load_scene

FRAMES = 40
EFFECTS = (
    "ambient_light", "black_level", "compression", "defocus", "hot_pixels", "led_imbalance", "modulus", "plate_tilt",
    "residue_film", "rolling_shutter", "sensor_dust", "specks", "tone_curve", "vignetting",
)  # fmt: skip
"""Drawn in the rigs: those that need no light fields of their own, so that the whole fits into half an hour."""
FALSE_ALARMS = 4.0
"""Budget on the training trials [1/min]."""
FRICTION, UNSEEN_FRICTION = (0.3, 0.9), (1.1, 1.8)
PITCH, UNSEEN_PITCH = (900.0, 1200.0), (500.0, 750.0)


def settings(
    *,
    friction: tuple[float, float] = FRICTION,
    pitch: tuple[float, float] = PITCH,
    rigs: int = 4,
    randomised: bool = True,
) -> DatasetConfig:
    """Return the declaration of one set."""
    return DatasetConfig.model_validate(
        {
            "trial": {"frames": FRAMES},
            "trials_per_shard": 4,
            "camera": {"scale": 0.1},
            "labels": {"grid_samples": 256},
            "programme": {
                "normal_force_N": {"uniform": (0.5, 1.5)},
                "press_time_s": {"uniform": (0.2, 0.35)},
                "hold_time_s": {"uniform": (0.05, 0.2)},
                "speed_mm_per_s": {"log_uniform": (2.0, 8.0)},
                # far enough to slide as a whole at the highest friction and the softest shaft
                "distance_mm": {"uniform": (3.0, 4.5)},
            },
            "friction": {"levels": 24, "friction_coefficient": {"uniform": friction}},
            "finger": {
                "count": 24,
                "ridged_share": 1.0,
                "ridge_pitch_um": {"uniform": pitch},
                "shaft_stiffness_N_per_mm": {"log_uniform": (2.5, 8.0)},
            },
            "rig": {"count": rigs if randomised else 1, "trials_in_a_row": 4} | ({} if randomised else {"draw": {}}),
            "randomisation": {"probability": 0.35 if randomised else 0.0, "only": EFFECTS},
        }
    )


def sets(trials: int) -> dict[str, tuple[DatasetConfig, int, int]]:
    """Return configuration, count of trials and seed of each set; tests share their rigs, paired."""
    few = max(8, trials // 2)
    return {
        "train": (settings(), trials, 101),
        "train_plain": (settings(randomised=False), trials, 202),
        "seen": (settings(), few, 303),
        "unseen_friction": (settings(friction=UNSEEN_FRICTION), few, 303),
        "unseen_pitch": (settings(pitch=UNSEEN_PITCH), few, 303),
    }


@dataclasses.dataclass
class Table:
    """Frames of a set: features, truth, and what a force sensor would say."""

    features: np.ndarray
    stick: np.ndarray
    force_ratio: np.ndarray
    trial: np.ndarray
    time: np.ndarray
    onsets: dict[int, tuple[float, float]]

    def part(self, count: int) -> Table:
        """Return the first trials."""
        keep = self.trial < count
        return dataclasses.replace(
            self, features=self.features[keep], stick=self.stick[keep], force_ratio=self.force_ratio[keep],
            trial=self.trial[keep], time=self.time[keep],
        )  # fmt: skip

    def series(self, evidence: np.ndarray) -> list[Series]:
        """Return each trial with a detector's evidence."""
        found = []
        for trial in np.unique(self.trial):
            here = self.trial == trial
            found.append(Series(self.time[here], evidence[here], self.stick[here], *self.onsets[int(trial)]))
        return found


def features_of(frames: list[np.ndarray]) -> np.ndarray:
    """Return features of every frame of a trial from it and the ones before, shape (n, k)."""
    images = [cv2.GaussianBlur(f.astype(np.float32) / 255.0, (0, 0), 0.8) for f in frames]
    patches = [_patch(image) for image in images]
    rows = []
    first = None
    for i, (image, (mask, centre, radius)) in enumerate(zip(images, patches, strict=True)):
        row = [
            radius,
            float(image[mask].mean()) if mask.any() else 0.0,
            float(image[mask].std()) if mask.any() else 0.0,
        ]
        if first is None and i >= 3 and mask.any():
            first = centre
        row += [float(np.hypot(*(centre - first))) if first is not None else 0.0]
        core, rim = _zones(image.shape, centre, radius)
        for lag in (1, 3, 6):
            before = images[max(i - lag, 0)]
            _, old_centre, old_radius = patches[max(i - lag, 0)]
            row += [float(np.hypot(*(centre - old_centre))), radius - old_radius]
            change = np.abs(image - before)
            row += [float(change[zone].mean()) if zone.any() else 0.0 for zone in (core, rim)]
            row += _flow(before, image, core, rim)
        rows.append(row)
    return np.array(rows)


def _patch(image: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    level = 0.5 * float(np.quantile(image, 0.995))
    mask = image > max(level, 0.04)
    count, labels, stats, centres = cv2.connectedComponentsWithStats(mask.astype(np.uint8))
    if count < 2:
        return np.zeros_like(mask), np.array(image.shape[::-1]) / 2.0, 0.0
    joined = cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_CLOSE, np.ones((9, 9), np.uint8))
    count, labels, stats, centres = cv2.connectedComponentsWithStats(joined)
    largest = 1 + int(np.argmax(stats[1:, cv2.CC_STAT_AREA]))
    return labels == largest, centres[largest], float(np.sqrt(stats[largest, cv2.CC_STAT_AREA] / np.pi))


def _zones(shape: tuple[int, ...], centre: np.ndarray, radius: float) -> tuple[np.ndarray, np.ndarray]:
    y, x = np.mgrid[: shape[0], : shape[1]]
    r = np.hypot(x - centre[0], y - centre[1])
    return r < 0.5 * radius, (r >= 0.7 * radius) & (r < 0.95 * radius)


def _flow(before: np.ndarray, now: np.ndarray, core: np.ndarray, rim: np.ndarray) -> list[float]:
    """Return how far the pattern moved in the core and at the rim [px]."""
    if not core.any() or not rim.any():
        return [0.0, 0.0]
    a, b = (np.clip(255 * image, 0, 255).astype(np.uint8) for image in (before, now))
    flow = cv2.calcOpticalFlowFarneback(a, b, None, 0.5, 2, 11, 3, 5, 1.1, 0)
    return [float(np.hypot(*np.median(flow[zone], axis=0))) for zone in (core, rim)]


def table_of(folder: Path, workers: int) -> Table:
    """Read a set and compute its features."""
    with dataset.open(folder) as data:
        trials = list(data.trials())
    rows: list[Any] = []
    onsets = {}
    with ProcessPoolExecutor(max(1, workers), mp_context=get_context("spawn")) as pool:
        for some in pool.map(_rows_of, [folder] * workers, [trials[k::workers] for k in range(workers)]):
            for found, onset, trial in some:
                rows += found
                onsets[trial] = onset
    rows.sort(key=lambda row: (row[3], row[4]))
    features, stick, ratio, numbers, times = (np.array(column) for column in zip(*rows, strict=True))
    return Table(features, stick, ratio, numbers, times, onsets)


def _rows_of(folder: Path, trials: list[int]) -> list[tuple[list[Any], tuple[float, float], int]]:
    """Return rows and onsets of some trials."""
    cv2.setNumThreads(1)
    made = []
    with dataset.open(folder) as data:
        indices = data.trials()
        for trial in trials:
            samples = [data[i] for i in indices[trial]]
            meta, rows = samples[0].meta, []
            first, gross = (
                float("nan") if meta[k] is None else meta[k] for k in ("onset_first_slip_s", "onset_gross_slip_s")
            )
            for s, f in zip(samples, features_of([s.frame for s in samples]), strict=True):
                v = s.scalars
                ratio = float(np.hypot(v["Fx_N"], v["Fy_N"]) / v["Fz_N"]) if v["Fz_N"] > 0 else 0.0
                stick = v["stick_ratio"] if v["Fz_N"] > 0 else 1.0  # nothing slips where nothing touches
                rows.append((f, stick, ratio, trial, v["time_s"]))
            made.append((rows, (first, gross), trial))
    return made


def model() -> HistGradientBoostingRegressor:
    return HistGradientBoostingRegressor(max_iter=200, learning_rate=0.06, max_leaf_nodes=15, random_state=0)


class Detector:
    """From a training table to evidence of slip, with a threshold within the budget of false alarms."""

    def __init__(self, train: Table, kind: str) -> None:
        self.kind = kind
        if kind == "force":
            self._fit: Any = IsotonicRegression(increasing=False, out_of_bounds="clip").fit(
                train.force_ratio, train.stick
            )
            held_out = train.force_ratio
        else:
            folds = GroupKFold(min(5, len(np.unique(train.trial))))
            held_out = 1.0 - cross_val_predict(model(), train.features, train.stick, groups=train.trial, cv=folds)
            self._fit = model().fit(train.features, train.stick)
        self.threshold = choose_threshold(train.series(held_out), FALSE_ALARMS)

    def stick(self, table: Table) -> np.ndarray:
        """Return the predicted stick ratio."""
        given = table.force_ratio if self.kind == "force" else table.features
        return np.clip(self._fit.predict(given), 0.0, 1.0)

    def evidence(self, table: Table) -> np.ndarray:
        return table.force_ratio if self.kind == "force" else 1.0 - self.stick(table)

    def judge(self, table: Table) -> dict[str, float]:
        """Return regression and detection figures."""
        found = self.stick(table)
        return {
            "mae": float(mean_absolute_error(table.stick, found)),
            "r2": float(r2_score(table.stick, found)),
            **dataclasses.asdict(score(table.series(self.evidence(table)), self.threshold)),
        }


def generate(out: Path, trials: int, workers: int) -> dict[str, float]:
    """Make what is not there yet; return seconds by set."""
    spent = {}
    for name, (config, count, seed) in sets(trials).items():
        folder, start = out / f"{name}-{trials}", time.perf_counter()
        engine = Engine(workers=workers)
        if (folder / "dataset.json").exists():
            outcome = resume(folder, engine)
        else:
            outcome = make(folder, new_job(load_scene("thesis"), config, frames=count * FRAMES, seed=seed), engine)
        spent[name] = time.perf_counter() - start
        print(f"{name}: {outcome.frames} frames, {outcome.made} made in {spent[name]:.0f} s", flush=True)
    return spent


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--trials", type=int, default=96)
    parser.add_argument("--out", type=Path, default=Path("outputs/baseline"))
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    start = time.perf_counter()
    spent = generate(given.out, given.trials, given.workers)
    seen = time.perf_counter()
    tables = {name: table_of(given.out / f"{name}-{given.trials}", max(1, given.workers)) for name in spent}
    print(f"features in {time.perf_counter() - seen:.0f} s", flush=True)
    tests = ("seen", "unseen_friction", "unseen_pitch")
    detectors = {
        "frames": Detector(tables["train"], "frames"),
        "frames, plain training": Detector(tables["train_plain"], "frames"),
        "force threshold": Detector(tables["train"], "force"),
    }
    results = {name: {test: detector.judge(tables[test]) for test in tests} for name, detector in detectors.items()}
    print(
        "\n| detector | test | MAE | R2 | detected | latency s | lead s | false alarms/min | slides |\n|" + "---|" * 9
    )
    for name, by_test in results.items():
        for test, r in by_test.items():
            print(
                f"| {name} | {test.replace('_', ' ')} | {r['mae']:.3f} | {r['r2']:.2f} | {100 * r['detected']:.0f} %"
                f" | {r['latency_s']:.3f} | {r['lead_s']:.3f} | {r['false_per_minute']:.1f} | {r['slides']:.0f} |"
            )
    curve = {}
    print("\n| training trials | " + " | ".join(f"MAE {t.replace('_', ' ')}" for t in tests) + " |\n|" + "---|" * 4)
    for share in (8, 4, 2, 1):
        count = max(5, given.trials // share)
        part = tables["train"].part(count)
        fit = model().fit(part.features, part.stick)
        curve[count] = {
            t: float(mean_absolute_error(tables[t].stick, np.clip(fit.predict(tables[t].features), 0, 1)))
            for t in tests
        }
        print(f"| {count} | " + " | ".join(f"{v:.3f}" for v in curve[count].values()) + " |")
    mean = float(tables["train"].stick.mean())
    constant = {t: float(mean_absolute_error(tables[t].stick, np.full_like(tables[t].stick, mean))) for t in tests}
    print(f"\nconstant guess: MAE {', '.join(f'{t} {v:.3f}' for t, v in constant.items())}")
    total = time.perf_counter() - start
    print(f"{total:.0f} s, load {os.getloadavg()[0]:.1f}")
    if given.json:
        result = {
            "trials": given.trials, "results": results, "curve": curve, "constant_mae": constant, "generated_s": spent,
            "total_s": total, "load": os.getloadavg()[0], "provenance": dict(provenance.record()),
        }  # fmt: skip
        given.json.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
