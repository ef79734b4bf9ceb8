"""The comparison of benchmarks/calibrate_public.py on drawn boards whose camera is known."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path

import numpy as np
import pytest

BENCHMARKS = Path(__file__).resolve().parents[2] / "benchmarks"


@pytest.fixture
def benchmark(monkeypatch):
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    for name in ("calibrate", "calibrate_public"):
        monkeypatch.delitem(sys.modules, name, raising=False)
    return importlib.import_module("calibrate_public")


@pytest.mark.slow
def test_cameras_of_a_drawn_set_and_the_plumb_line(benchmark):
    pictures, size, shape, truth = benchmark.drawn_set()
    found = benchmark.compared("drawn", pictures[:5], size, shape)
    assert found["common_views"] == 5
    own = found["cameras"]["ours"]
    assert abs(own["fx"] - truth["fx"]) < 5 * own["standard_errors"]["fx"]
    assert own["k1"] == pytest.approx(truth["k1"], abs=0.005)
    assert own["held_out_rms_px"] < 0.03
    # Where undistortion moves a point, by the board's geometry and by straight lines alone.
    assert own["plumb_line"]["edge_shift_px"] == pytest.approx(own["edge_shift_px"], rel=0.05)
    for other in ("OpenCV sectors", "OpenCV classic"):
        assert 0 < found["cameras"][other]["corners_from_ours_px"]["rms"] < 0.2


def test_other_corners_are_not_matched(benchmark):
    grid = benchmark.places((4, 3))
    shifted = (10 * grid + [0.0, 11.0], grid)
    assert benchmark.matched((10 * grid, grid), shifted) is None
    turned = (10 * grid[::-1] + 0.5, grid[::-1])
    np.testing.assert_allclose(benchmark.matched((10 * grid, grid), turned)[0], 10 * grid + 0.5)
