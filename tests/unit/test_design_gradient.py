"""The gradient of benchmarks/design_gradient.py, whose figures stand in docs/howto/design.md, by finite differences."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import numpy as np
import pytest

from evanesce.rig import load_scene
from support.rigs import need

SCRIPT = Path(__file__).resolve().parents[2] / "benchmarks" / "design_gradient.py"


def test_the_gradient_is_that_of_finite_differences():
    """Along random directions of powers, positions and absorption, at a point where nothing is equal."""
    need("llvm")
    spec = importlib.util.spec_from_file_location("design_gradient", SCRIPT)
    benchmark = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(benchmark)
    even = benchmark.Evenness(load_scene("thesis", {"leds.edges": ["left", "top"]}))
    k, draws = even.count, np.random.default_rng(6)
    width = np.concatenate([np.full(k, 1.8), np.full(k, 6.0), [2e-3]])
    at = np.concatenate([draws.uniform(0.6, 1.5, k), draws.uniform(-1.3, 1.1, k), [7e-4]])
    value, slope = even.value_and_gradient(at)
    assert value == pytest.approx(even.value(at), rel=1e-12)
    for _ in range(3):
        way = width * draws.normal(size=at.size)
        found = [(even.value(at + h * way) - even.value(at - h * way)) / (2 * h) for h in (2e-3, 1e-3)]
        assert found[1] == pytest.approx(slope @ way, abs=2e-3 * np.linalg.norm(slope * width))
        assert abs(found[1]) > 0.05 * np.linalg.norm(slope * width)
