"""The half-space solver against tamaas, ContactMechanics and ASPHER: areas and pressures within 1 %.

Left out of ``make test``: none of them is a dependency (``pip install tamaas ContactMechanics aspher``; ASPHER is
built from source). tamaas is AGPL-3: each runs in a process of its own that imports nothing of the project. Boundaries
are the same on either side: nothing loaded outside the map, or a map that repeats. ``pytest -rP`` prints the figures.
"""

from __future__ import annotations

import importlib
import importlib.util
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

BENCHMARKS = Path(__file__).resolve().parents[2] / "benchmarks"
SHAPES = ("sphere", "ellipsoid", "ridged pad", "rough pad", "rough, periodic")

pytestmark = [pytest.mark.second_program, pytest.mark.slow]


@pytest.fixture(scope="module")
def others() -> ModuleType:
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(BENCHMARKS))
        return importlib.import_module("halfspace_others")


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("program", ["tamaas", "ContactMechanics", "aspher"])
def test_areas_and_pressures_agree(others: ModuleType, program: str, shape: str) -> None:
    if importlib.util.find_spec(program) is None:
        pytest.skip(f"{program} is not installed")
    for force in (0.05, 0.3, 1.5):
        problem = others.maps(256, [force])[f"{shape}, {force:g} N"]
        own, _ = others.solve_own(problem, 1e-6)
        other, _ = others.solve_other(program, problem, 1e-6)
        area = np.count_nonzero(own) / np.count_nonzero(other) - 1.0
        rms = float(np.sqrt(np.mean((own - other)[(own > 0) | (other > 0)] ** 2)) / other.max())
        print(f"{program} {shape} {force:g} N: area {100 * area:+.3f} %, pressure {100 * rms:.4f} % of the peak")
        assert np.count_nonzero(other) > 500
        assert abs(area) < 0.01
        assert rms < 0.01
        assert other.sum() * problem.pitch**2 == pytest.approx(force, rel=1e-6)
