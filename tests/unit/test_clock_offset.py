"""Offset of a force log's clock: its stated interval holds the true one as often as it says.

Presses are drawn here: forces by programmes that rise, rest, fall or sway; areas by a power law whose exponent drifts
with the force (no finger obeys one exactly), with white noise and noise that stays for some frames, as a codec's does.
"""

from __future__ import annotations

import numpy as np
import pytest

from evanesce.measurement.force import area_force
from evanesce.measurement.io.force import ForceLog
from evanesce.measurement.reference.area import AreaRow

KINDS = ("ramp", "eased", "steps", "up and down", "sway")


def force_programme(kind: str, most: float, length: float, rng: np.random.Generator):
    """Force [N] against time since the finger touches [s]."""
    if kind == "ramp":
        return lambda t: most * np.clip(t / length, 0, 1)
    if kind == "eased":
        return lambda t: most * np.sin(0.5 * np.pi * np.clip(t / length, 0, 1)) ** 2
    if kind == "steps":
        rises = np.sort(rng.uniform(0, length, 3))
        return lambda t: sum(most / 4 * np.clip((t - r) / 0.15, 0, 1) for r in (0.0, *rises))
    if kind == "up and down":
        return lambda t: most * np.clip(1 - np.abs(t / length - 0.6) / 0.6, 0, 1)
    rate = rng.uniform(1.0, 3.0)
    return lambda t: most * np.clip(t / 0.3, 0, 1) * (0.6 + 0.3 * np.sin(2 * np.pi * rate * np.maximum(t, 0)))


def drawn(number: int) -> tuple[list[AreaRow], ForceLog, float]:
    """Areas, forces and the true offset of one press."""
    rng = np.random.default_rng([7, number])
    rate, log_rate = rng.choice([25.0, 30.0, 50.0]), rng.choice([25.0, 50.0, 100.0, 200.0])
    frames = int(rng.integers(40, 160))
    free = int(rng.integers(3, 12)) - 0.5 + rng.uniform(-0.5, 0.5)
    most, offset = rng.uniform(1.0, 6.0), rng.uniform(-1.0, 1.0)
    force = force_programme(KINDS[number % len(KINDS)], most, (frames - free) / rate, rng)
    time = np.arange(frames) / rate
    true = force(time - free / rate)
    power, drift = rng.uniform(0.5, 0.8), rng.uniform(-0.03, 0.03)
    area = np.zeros(frames)
    on = true > 0
    area[on] = rng.uniform(3, 7) * true[on] ** (power + drift * np.log(true[on]))
    keep = np.exp(-1 / rng.uniform(1.0, 8.0))
    slow = np.zeros(frames)
    for k in range(1, frames):
        slow[k] = keep * slow[k - 1] + np.sqrt(1 - keep**2) * rng.standard_normal()
    area *= 1 + rng.uniform(0.001, 0.006) * slow + rng.uniform(0.001, 0.004) * rng.standard_normal(frames)
    log_time = np.arange(time[0] + offset - 0.5, time[-1] + offset + 0.5, 1 / log_rate)
    measured = force(log_time - offset - free / rate) + 0.002 * rng.standard_normal(len(log_time))
    rows = [AreaRow(index=k, time_s=t, area_mm2=a, pixels=0, blobs=1, area_low_mm2=0.98 * a, area_high_mm2=1.02 * a)
            for k, (t, a) in enumerate(zip(time, area, strict=True))]  # fmt: skip
    return rows, ForceLog(log_time - log_time[0], measured), offset - log_time[0]


def covered(numbers: range) -> tuple[float, float]:
    """Share of presses whose interval holds the truth; median of its half-width [s]."""
    inside, wide = [], []
    for number in numbers:
        rows, log, true = drawn(number)
        found = area_force(rows, log)
        low, high = found.offset_interval_s
        inside.append(low <= true <= high)
        wide.append(0.5 * (high - low))
    return float(np.mean(inside)), float(np.median(wide))


@pytest.mark.slow  # half a minute
def test_the_interval_of_the_offset_holds() -> None:
    share, half_width = covered(range(1000, 1100))
    assert 0.88 <= share <= 0.99
    assert half_width < 0.04, "a frame lasts 0.02 to 0.04 s"


def test_the_interval_of_the_offset_holds_in_some() -> None:
    share, _ = covered(range(10))
    assert share >= 0.7  # 0.95 each: 1e-3 to fail


def test_a_given_offset_has_no_interval() -> None:
    rows, log, true = drawn(0)
    assert area_force(rows, log, true).offset_interval_s == (true, true)


def test_forces_that_were_not_tared_are_named() -> None:
    rows, log, _ = drawn(1004)
    codes = [warning.code for warning in area_force(rows, log).warnings()]
    assert "force_not_tared" not in codes
    shifted = ForceLog(log.time_s, log.force_N + 0.1 * log.force_N.max())
    assert [warning.code for warning in area_force(rows, shifted).warnings()] == ["force_not_tared"]
