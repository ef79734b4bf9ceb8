"""Benchmark of the dataset: two baselines from frames alone, against a force threshold; what randomisation is worth.

Stick ratio by gradient boosting on plain features of the last frames, and slip onset from it, on trials with unseen
friction, unseen ridge pitch and unseen rigs. The same trials train thrice: on rigs with effects, on the same rigs
without, on one plain rig. Thresholds are chosen on training trials alone. Frames are 200 x 150.

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
from sklearn.metrics import r2_score

import evanesce.dataset as dataset
from evanesce.core import provenance
from evanesce.dataset.config import DatasetConfig
from evanesce.dataset.job import new_job
from evanesce.dataset.layout import FORMAT_VERSION
from evanesce.dataset.run import Engine, make, resume
from evanesce.dataset.slip_baseline import FALSE_ALARMS, HOLD, held_out
from evanesce.dataset.slip_features import frame_features
from evanesce.dataset.slip_scores import Series, choose_threshold, score
from evanesce.rig import load_scene

FRAMES = 40
EFFECTS = (
    "ambient_light", "black_level", "compression", "defocus", "hot_pixels", "led_imbalance", "modulus", "plate_tilt",
    "residue_film", "rolling_shutter", "sensor_dust", "specks", "tone_curve", "vignetting",
)  # fmt: skip
"""Drawn in the rigs: those that need no light fields of their own, so that the whole fits into half an hour."""
RIGS = 12
FRICTION, UNSEEN_FRICTION = (0.3, 0.9), (1.1, 1.8)
PITCH, UNSEEN_PITCH = (900.0, 1200.0), (500.0, 750.0)


def settings(
    *,
    friction: tuple[float, float] = FRICTION,
    pitch: tuple[float, float] = PITCH,
    drawn: bool = True,
    effects: bool = True,
) -> DatasetConfig:
    """Return the declaration of one set; rigs are drawn or one is as the scene says, and have effects or none."""
    return DatasetConfig.model_validate(
        {
            "trial": {"frames": FRAMES},
            "trials_per_shard": 4,
            "camera": {"scale": 0.1},
            "labels": {"grid_samples": 256, "grid_size_mm": 12.0},
            "programme": {
                "normal_force_N": {"uniform": (0.5, 1.5)},
                "press_time_s": {"uniform": (0.2, 0.35)},
                "hold_time_s": {"uniform": (0.05, 0.2)},
                "speed_mm_per_s": {"log_uniform": (2.0, 8.0)},
                "distance_mm": {"uniform": (0.8, 1.5)},
                "reversals": {"constant": 0.0},
            },
            "friction": {"levels": 24, "friction_coefficient": {"uniform": friction}},
            "finger": {
                "count": 24,
                "ridged_share": 1.0,
                "ridge_pitch_um": {"uniform": pitch},
                "shaft_stiffness_N_per_mm": {"log_uniform": (2.5, 8.0)},
            },
            "rig": {"count": RIGS if drawn else 1, "trials_in_a_row": 4} | ({} if drawn else {"draw": {}}),
            "randomisation": {"probability": 0.35 if effects else 0.0, "only": EFFECTS},
        }
    )


def sets(trials: int) -> dict[str, tuple[DatasetConfig, int, int]]:
    """Return configuration, count of trials and seed of each set.

    Training sets share their seed, and with it fingers, friction and programmes, trial by trial; the first two share
    the rigs' draws too. Tests share theirs.
    """
    few = max(8, 2 * trials // 3)  # of unseen friction more, so that its false alarms are counted to one a minute
    return {
        "train": (settings(), trials, 101),
        "train_rigs": (settings(effects=False), trials, 101),
        "train_plain": (settings(drawn=False, effects=False), trials, 101),
        "seen": (settings(), few, 303),
        "unseen_friction": (settings(friction=UNSEEN_FRICTION), 3 * few, 303),
        "unseen_pitch": (settings(pitch=UNSEEN_PITCH), few, 303),
    }


@dataclasses.dataclass
class Table:
    """Frames of a set: features, truth, and what a force sensor would say."""

    features: np.ndarray
    stick: np.ndarray
    force_ratio: np.ndarray
    trial: np.ndarray
    rig: np.ndarray
    time: np.ndarray
    friction: np.ndarray
    onsets: dict[int, tuple[float, float]]

    def part(self, count: int) -> Table:
        """Return the first trials."""
        keep = self.trial < count
        return dataclasses.replace(
            self, features=self.features[keep], stick=self.stick[keep], force_ratio=self.force_ratio[keep],
            trial=self.trial[keep], rig=self.rig[keep], time=self.time[keep], friction=self.friction[keep],
        )  # fmt: skip

    def series(self, evidence: np.ndarray) -> list[Series]:
        """Return each trial with a detector's evidence."""
        found = []
        for trial in np.unique(self.trial):
            here = self.trial == trial
            found.append(Series(self.time[here], evidence[here], self.stick[here], *self.onsets[int(trial)]))
        return found


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
    rows.sort(key=lambda row: (row[3], row[5]))
    features, stick, ratio, numbers, rigs, times, friction = (np.array(c) for c in zip(*rows, strict=True))
    return Table(features, stick, ratio, numbers, rigs, times, friction, onsets)


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
            for s, f in zip(samples, frame_features([s.frame for s in samples]), strict=True):
                v = s.scalars
                ratio = float(np.hypot(v["Fx_N"], v["Fy_N"]) / v["Fz_N"]) if v["Fz_N"] > 0 else 0.0
                friction = meta["friction"]["friction_coefficient"]
                rows.append((f, v["stick_ratio"], ratio, trial, meta["rig"]["index"], v["time_s"], friction))
            made.append((rows, (first, gross), trial))
    return made


def model() -> HistGradientBoostingRegressor:
    return HistGradientBoostingRegressor(max_iter=200, learning_rate=0.06, max_leaf_nodes=15, random_state=0)


class Detector:
    """From a training table to evidence of slip, with a threshold within the budget of false alarms.

    The threshold is chosen on training trials of friction and rigs that the model was not fitted to.
    """

    def __init__(self, train: Table, kind: str) -> None:
        self.kind = kind
        if kind == "force":
            self._fit: Any = IsotonicRegression(increasing=False, out_of_bounds="clip").fit(
                train.force_ratio, train.stick
            )
            evidence = train.force_ratio
        else:
            evidence = 1.0 - held_out(model(), train.features, train.stick, train.friction, train.rig, train.trial)
            self._fit = model().fit(train.features, train.stick)
        self.threshold = choose_threshold(train.series(evidence), FALSE_ALARMS, HOLD)
        chosen = score(train.series(evidence), self.threshold, HOLD)
        self.chosen_at = {"detected": chosen.detected, "false_per_minute": chosen.false_per_minute}

    def stick(self, table: Table) -> np.ndarray:
        """Return the predicted stick ratio."""
        given = table.force_ratio if self.kind == "force" else table.features
        return np.clip(self._fit.predict(given), 0.0, 1.0)

    def evidence(self, table: Table) -> np.ndarray:
        return table.force_ratio if self.kind == "force" else 1.0 - self.stick(table)

    def evaluate(self, table: Table) -> dict[str, Any]:
        """Return regression and detection figures."""
        found = self.stick(table)
        mean, standard = over_trials(np.abs(found - table.stick), table.trial)
        return {
            "mae": mean,
            "mae_standard": standard,
            "r2": float(r2_score(table.stick, found)),
            "threshold": self.threshold,
            "held_out": self.chosen_at,
            **dataclasses.asdict(score(table.series(self.evidence(table)), self.threshold, HOLD)),
        }


def over_trials(error: np.ndarray, trial: np.ndarray) -> tuple[float, float]:
    """Return the mean of frames' errors and its standard error; trials are independent, a trial's frames are not."""
    each = np.array([error[trial == t].mean() for t in np.unique(trial)])
    return float(error.mean()), float(each.std(ddof=1) / np.sqrt(each.size))


def generate(out: Path, trials: int, workers: int) -> dict[str, float]:
    """Make what is not there yet; return seconds by set, those of earlier runs that were stopped included."""
    kept = out / f"seconds-{trials}.json"
    seconds: dict[str, float] = json.loads(kept.read_text()) if kept.exists() else {}
    for name, (config, count, seed) in sets(trials).items():
        folder, start = out / f"{name}-{trials}", time.perf_counter()
        engine = Engine(workers=workers)
        if (folder / "dataset.json").exists():
            outcome = resume(folder, engine)
        else:
            outcome = make(folder, new_job(load_scene("thesis"), config, frames=count * FRAMES, seed=seed), engine)
        if outcome.made:
            seconds[name] = seconds.get(name, 0.0) + time.perf_counter() - start
            kept.write_text(json.dumps(seconds) + "\n")
        print(f"{name}: {outcome.frames} frames, made in {seconds.get(name, 0.0):.0f} s", flush=True)
    return seconds


TESTS = ("seen", "unseen_friction", "unseen_pitch")
TRAINING = {"train": "frames", "train_rigs": "frames, rigs without effects", "train_plain": "frames, one plain rig"}
"""Training sets, and what the detector from each is called."""
WORTH = {
    "effects": ("train_rigs", "train"),
    "rigs": ("train_plain", "train_rigs"),
    "both": ("train_plain", "train"),
}
"""What randomising something is worth: the error without it less the error with it."""


def evaluated(tables: dict[str, Table]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return figures by detector and test, and by what is randomised and test what that is worth."""
    frames = {training: Detector(tables[training], "frames") for training in TRAINING}
    detectors = {TRAINING[t]: frames[t] for t in TRAINING} | {"force threshold": Detector(tables["train"], "force")}
    found = {name: {test: detector.evaluate(tables[test]) for test in TESTS} for name, detector in detectors.items()}
    worth: dict[str, dict[str, Any]] = {name: {} for name in WORTH}
    for test in TESTS:
        table = tables[test]
        errors = {training: np.abs(detector.stick(table) - table.stick) for training, detector in frames.items()}
        for name, (without, given) in WORTH.items():
            # Paired: the same frames by both, so that what makes a trial hard falls out.
            less = errors[without] - errors[given]
            mean, standard = over_trials(less, table.trial)
            by_rig = [float(less[table.rig == rig].mean()) for rig in np.unique(table.rig)]
            worth[name][test] = {"mean": mean, "standard": standard, "by_rig": by_rig}
    return found, worth


def learning_curves(tables: dict[str, Table], trials: int) -> dict[str, dict[int, dict[str, float]]]:
    """Return the error of the stick ratio by training set, count of its trials and test."""
    curves: dict[str, dict[int, dict[str, float]]] = {}
    for name in TRAINING:
        curves[name] = {}
        for share in (8, 4, 2, 1):
            part = tables[name].part(max(5, trials // share))
            fit = model().fit(part.features, part.stick)
            curves[name][len(np.unique(part.trial))] = {
                t: float(np.abs(np.clip(fit.predict(tables[t].features), 0, 1) - tables[t].stick).mean()) for t in TESTS
            }
    return curves


def show(result: dict[str, Any]) -> None:
    """Print the tables."""
    print("\n| detector | test | MAE | R2 | detected | latency s | lead s | false alarms/min | slides |")
    print("|" + "---|" * 9)
    for name, by_test in result["results"].items():
        for test, r in by_test.items():
            print(
                f"| {name} | {test.replace('_', ' ')} | {r['mae']:.3f} +- {r['mae_standard']:.3f} | {r['r2']:.2f}"
                f" | {100 * r['detected']:.0f} % | {r['latency_s']:.3f} | {r['lead_s']:.3f}"
                f" | {r['false_per_minute']:.1f} | {r['slides']:.0f} |"
            )
    for name, by_test in result["worth"].items():
        for test, w in by_test.items():
            rigs = ", ".join(f"{v:+.3f}" for v in w["by_rig"])
            named = test.replace("_", " ")
            print(f"randomising {name} is worth {w['mean']:.3f} +- {w['standard']:.3f} on {named} (by rig: {rigs})")
    for name, curve in result["curves"].items():
        print(f"\n| trials of {name} | " + " | ".join(f"MAE {t.replace('_', ' ')}" for t in TESTS) + " |")
        print("|" + "---|" * 4)
        for count, errors in curve.items():
            print(f"| {count} | " + " | ".join(f"{v:.3f}" for v in errors.values()) + " |")
    print(f"\nconstant guess: MAE {', '.join(f'{t} {v:.3f}' for t, v in result['constant_mae'].items())}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--trials", type=int, default=96)
    parser.add_argument("--out", type=Path, default=Path("outputs/baseline"))
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    seconds = generate(given.out, given.trials, given.workers)
    seen = time.perf_counter()
    tables = {
        name: table_of(given.out / f"{name}-{given.trials}", max(1, given.workers)) for name in sets(given.trials)
    }
    print(f"features in {time.perf_counter() - seen:.0f} s", flush=True)
    mean = float(tables["train"].stick.mean())
    results, worth = evaluated(tables)
    result = {
        "trials": given.trials,
        "format_version": FORMAT_VERSION,
        "test_trials": {t: len(np.unique(tables[t].trial)) for t in TESTS},
        "frames": sum(len(table.stick) for table in tables.values()),
        "results": results,
        "worth": worth,
        "curves": learning_curves(tables, given.trials),
        "constant_mae": {t: float(np.abs(tables[t].stick - mean).mean()) for t in TESTS},
        "generated_s": seconds,
        "features_and_fits_s": time.perf_counter() - seen,
        "load": os.getloadavg()[0],
        "provenance": dict(provenance.record()),
    }
    show(result)
    print(
        f"frames {sum(seconds.values()):.0f} s, others {result['features_and_fits_s']:.0f} s, load {result['load']:.1f}"
    )
    if given.json:
        given.json.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
