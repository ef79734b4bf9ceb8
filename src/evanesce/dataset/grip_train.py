"""Train a grip by sight: the figures of :class:`~evanesce.dataset.grip_control.SightGrip`, by their return.

Cross-entropy method: candidates are drawn about the best so far, and the distribution narrows to the better third of
them. Figures are positive; their logarithms are normal.

Reference: R. Y. Rubinstein and D. P. Kroese, The Cross-Entropy Method (2004).
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from evanesce.core import rng
from evanesce.dataset.grip_control import SightGrip
from evanesce.dataset.grip_model import GripTask

START = {
    "moved_px": 0.06, "release_per_s": 0.35, "more": 1.3, "margin": 1.2, "forget_s": 6.0, "changed_DN": 8.0,
    "rescue": 2.0,
}  # fmt: skip
"""Figures that are trained, and where training begins."""
FIGURES = tuple(START)
RECORD = Path(__file__).with_name("grip_trained.json")
"""Written by ``python benchmarks/grip.py --train --record``."""
SPREAD = 0.35
"""Of the logarithms at first [1]."""
LEAST_SPREAD = 0.03
"""Kept, so that later candidates still differ [1]."""
KEPT = 3
"""One of so many candidates is among the better."""


class Episodes(Protocol):
    """An environment of :class:`~evanesce.dataset.grip.GripEnv`'s interface."""

    def reset(self, *, seed: int | None = None) -> tuple[NDArray[np.uint8], dict[str, Any]]:
        """Begin an episode."""

    def step(self, action: NDArray[np.float32]) -> tuple[NDArray[np.uint8], float, bool, bool, dict[str, Any]]:
        """Ask for a force."""


def trained_grip(task: GripTask) -> SightGrip:
    """Return the grip that ships trained, for a task."""
    found = json.loads(RECORD.read_text(encoding="utf-8"))["figures"]
    return SightGrip(task, **{name: float(found[name]) for name in FIGURES})


def episode_return(env: Episodes, controller: Any, seed: int) -> tuple[float, dict[str, Any]]:
    """Return the sum of an episode's rewards, and its last ``info``, with the mean force as ``mean_force_N``."""
    frame, info = env.reset(seed=seed)
    controller.reset(frame, info["force_N"])
    total, forces, over = 0.0, [], False
    while not over:
        frame, reward, lost, late, info = env.step(np.array([controller.act(frame)], np.float32))
        total, over = total + reward, lost or late
        forces.append(info["force_N"])
    return total, {**info, "mean_force_N": float(np.mean(forces))}


def train(
    env: Episodes,
    task: GripTask,
    *,
    generations: int = 4,
    candidates: int = 7,
    episodes: Sequence[int] = range(12),
    seed: int = 0,
    report: Callable[[str], None] = lambda _: None,
) -> SightGrip:
    """Return the grip of the best mean return.

    Parameters
    ----------
    env : GripEnv
    task : GripTask
    generations, candidates : int
        Rounds, and grips in each; the best so far is always among them.
    episodes : sequence of int
        Of training; each grip has the same.
    seed : int
    report : callable
        Called with a line for each round.

    Returns
    -------
    SightGrip
    """
    best = SightGrip(task, **START)
    mean = np.log([getattr(best, name) for name in FIGURES])
    spread = np.full(len(FIGURES), SPREAD)
    generator, best_return = rng.generator(seed, "grip", "train"), -np.inf
    for generation in range(generations):
        points = [mean, *(mean + spread * generator.standard_normal((candidates - 1, len(FIGURES))))]
        returns = []
        for point in points:
            grip = replace(best, **dict(zip(FIGURES, np.exp(point).tolist(), strict=True)))
            returns.append(float(np.mean([episode_return(env, grip, k)[0] for k in episodes])))
            if returns[-1] > best_return:
                best, best_return, mean = grip, returns[-1], point
        better = np.array(points)[np.argsort(returns)[::-1][: max(2, candidates // KEPT)]]
        spread = np.maximum(better.std(axis=0, ddof=1), LEAST_SPREAD)
        report(f"round {generation + 1}: best return {best_return:.3f}, mean of the round {np.mean(returns):.3f}")
    return best


def record(grip: SightGrip, results: dict[str, Any], path: Path = RECORD) -> None:
    """Write a trained grip and what it was judged to be."""
    figures = {name: round(getattr(grip, name), 5) for name in FIGURES}
    path.write_text(json.dumps({"figures": figures, "results": results}, indent=1) + "\n", encoding="utf-8")
