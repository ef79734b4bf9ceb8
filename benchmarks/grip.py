"""Hold slipping objects with the least force: the best constant grip against two by sight, one trained.

On friction as in training, and unseen.

python benchmarks/grip.py [--episodes 12] [--seed 1000] [--train] [--record] [--json FILE]
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from evanesce.dataset.grip import GripEnv
from evanesce.dataset.grip_control import ConstantGrip, SightGrip
from evanesce.dataset.grip_model import GripTask
from evanesce.dataset.grip_train import episode_return, record, train, trained_grip
from evanesce.dataset.worker import single_threaded

TASK = GripTask()
UNSEEN = {"lower": (0.3, 0.45), "higher": (0.9, 1.3)}


def episode(env: GripEnv, controller: Any, seed: int) -> dict[str, float]:
    """Return return, mean force [N], slide [mm] and loss of one episode."""
    total, info = episode_return(env, controller, seed)
    return {"return": total, "force_N": info["mean_force_N"], "slide_mm": info["slid_mm"], "lost": float(info["lost"])}


def judged(env: GripEnv, controller: Any, seeds: Sequence[int]) -> dict[str, float]:
    """Return the means over episodes, and the standard error of the return."""
    every = [episode(env, controller, seed) for seed in seeds]
    found = {name: float(np.mean([one[name] for one in every])) for name in every[0]}
    found["se"] = float(np.std([one["return"] for one in every], ddof=1) / np.sqrt(len(every)))
    return found


def best_constant(env: GripEnv, seeds: Sequence[int]) -> tuple[float, float]:
    """Return the constant force of the highest mean return on some episodes, and that return."""
    tried = {}
    for force in np.round(np.geomspace(*TASK.force_N, 12), 2):
        tried[float(force)] = judged(env, ConstantGrip(float(force)), seeds)["return"]
    best = max(tried, key=lambda force: tried[force])
    return best, tried[best]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--episodes", type=int, default=12)
    parser.add_argument("--seed", type=int, default=1000, help="of the first episode that is judged")
    parser.add_argument("--train", action="store_true", help="train anew, ten minutes of a core")
    parser.add_argument("--record", action="store_true", help="write the grip into the package")
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    single_threaded()
    start = time.process_time()
    seen = GripEnv(task=TASK)
    force, found = best_constant(seen, range(given.episodes))
    print(f"best constant grip on friction {TASK.friction[0]} to {TASK.friction[1]}: {force:.2f} N, return {found:.2f}")
    results: dict[str, Any] = {"constant_N": force}
    trained = train(seen, TASK, report=print) if given.train else trained_grip(TASK)
    print(trained)
    for name, friction in {"seen": TASK.friction, **UNSEEN}.items():
        env = GripEnv(task=replace(TASK, friction=friction))
        for label, controller in (
            ("constant", ConstantGrip(force)),
            ("by sight", SightGrip(TASK)),
            ("trained", trained),
        ):
            one = judged(env, controller, range(given.seed, given.seed + given.episodes))
            results[f"{name}, {label}"] = one
            print(
                f"{name:7s} {friction}: {label:9s} return {one['return']:6.2f} +- {one['se']:.2f}, force"
                f" {one['force_N']:.2f} N, slide {one['slide_mm']:.3f} mm, lost {100 * one['lost']:.0f} %"
            )
    print(f"{time.process_time() - start:.0f} s of a core")
    if given.record:
        record(trained, results)
    if given.json:
        given.json.write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
