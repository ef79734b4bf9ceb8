"""Lines in the spectrum of friction: their false alarms on coloured noise, their power, and where they come from."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter
from typer.testing import CliRunner

from evanesce.bench.friction_lines import line_of, source_of
from evanesce.cli.app import app
from evanesce.contact.sliding.stick_slip import Slider, simulate_stick_slip

RATE, COUNT = 200.0, 2000
TIME = np.arange(COUNT) / RATE


def coloured(memory: float, white: float, seed: int, count: int = COUNT) -> np.ndarray:
    rng = np.random.default_rng(seed)
    red = lfilter([1.0], [1.0, -memory], rng.standard_normal(count + 500))[500:] * np.sqrt(1.0 - memory**2)
    return 0.01 * (red + white * rng.standard_normal(count))


@pytest.mark.parametrize(("memory", "white"), [(0.0, 0.0), (0.7, 0.0), (0.97, 0.3), (0.995, 0.05)])
def test_false_alarms_on_coloured_noise_are_as_rare_as_said(memory: float, white: float) -> None:
    short = TIME[:800]
    p = np.array([line_of(short, coloured(memory, white, seed, short.size)).p_value for seed in range(50)])
    # of 50 draws at 1 %: 0.5 expected, more than 4 has a probability of 2e-4; the fitted background adds some
    assert (p < 0.01).sum() <= 4
    assert 0.2 < np.median(p) < 0.8


def test_a_line_below_the_red_end_is_found_where_the_strongest_frequency_is_not_it() -> None:
    noise = coloured(0.995, 0.05, 3)
    line = line_of(TIME, noise + 0.0016 * np.sin(2 * np.pi * 17.3 * TIME + 0.4))
    assert line.found
    assert line.frequency == pytest.approx(17.3, abs=0.02)
    assert not line_of(TIME, noise).found


def test_of_a_line_and_its_harmonic_the_line_is_told() -> None:
    pull = 0.02 * np.sin(2 * np.pi * 2.2 * TIME) + 0.01 * np.sin(2 * np.pi * 22.0 * TIME) + coloured(0.995, 0.02, 5)
    line = line_of(TIME, pull)
    frequency = np.fft.rfftfreq(COUNT, 1 / RATE)
    near = [line.background[np.argmin(np.abs(frequency - f))] for f in (2.2, 22.0)]
    assert near[0] > 4 * near[1]  # so that the harmonic, a quarter as strong, stands farther out
    assert line.frequency == pytest.approx(2.2, abs=0.02)


def slides(speeds: list[float], own_hz: float = 0.0, seconds: float = 20.0) -> list[np.ndarray]:
    """Return coefficients at several speeds: a light finger that sticks and slips, or a machine that vibrates."""
    found = []
    for k, speed in enumerate(speeds):
        t = np.arange(int(seconds * RATE)) / RATE
        if own_hz:
            pull = 0.4 + 0.004 * np.sin(2 * np.pi * own_hz * t + k)
        else:
            slider = Slider(mass=0.002, stiffness=0.6, normal_force=1.0, static_friction=0.5, dynamic_friction=0.4)
            run = simulate_stick_slip(slider, speed, seconds, RATE)
            pull = run.spring_force[: t.size]
        found.append(pull + coloured(0.9, 0.3, k, t.size) * 0.3)
    return found


def test_stick_slip_goes_with_speed_and_a_machine_does_not() -> None:
    speeds, t = [1.0, 2.0, 3.5, 6.0], np.arange(int(20 * RATE)) / RATE
    late = t > 2.0
    for own, exponent, verdict in ((0.0, 1.0, "interface"), (12.7, 0.0, "machine")):
        lines = [line_of(t[late], one[late]) for one in slides(speeds, own)]
        assert all(line.found for line in lines)
        source = source_of(lines, speeds)
        assert source is not None
        assert source.exponent == pytest.approx(exponent, abs=0.1)
        assert source.verdict == verdict
    assert source_of(lines[:1], speeds[:1]) is None


def test_the_bench_tells_them_apart_and_refuses_speeds_of_other_files(tmp_path: Path) -> None:
    speeds, files = [1.0, 3.0, 6.0], []
    for speed, pull in zip(speeds, slides(speeds), strict=True):
        path = tmp_path / f"{speed:g}.csv"
        with path.open("w", newline="") as stream:
            write = csv.writer(stream)
            write.writerow(["time_s", "Fx_N", "Fz_N"])
            write.writerows((f"{k / RATE:.4f}", f"{q:.6f}", "1.0") for k, q in enumerate(pull))
        files.append(str(path))
    told = [piece for speed in speeds for piece in ("--speed-mm-per-s", f"{speed:g}")]
    done = CliRunner().invoke(app, ["bench", "friction", *files, *told, "--out", str(tmp_path / "out")])
    assert done.exit_code == 0, done.output
    found = json.loads((tmp_path / "out" / "result.json").read_text())
    assert found["line_source"]["verdict"] == "interface"
    assert all(slide["line"]["found"] for slide in found["slides"])
    assert "stick-slip of the interface" in done.output
    done = CliRunner().invoke(app, ["bench", "friction", *files, *told[:4], "--out", str(tmp_path / "none")])
    assert done.exit_code == 2
    assert "--speed-mm-per-s" in done.stderr
