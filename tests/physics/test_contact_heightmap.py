"""Ridge patterns and profiles: crests one pitch apart, along the orientation field, as wide as asked."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import brentq

from evanesce.contact.ridges.heightmap import RidgeRow, furrow_depth, grow_ridges
from evanesce.core.rng import generator

PATTERNS = ("parallel", "concentric", "loop", "whorl")


def row(pattern: str, **more) -> RidgeRow:
    return RidgeRow(pattern, 0.83, 0.37, 0.06, np.deg2rad(27.0), core_length=1.7, **more)


@pytest.mark.parametrize("pattern", PATTERNS)
def test_crests_are_one_pitch_apart_along_the_normal(pattern: str) -> None:
    ridges = row(pattern)
    rng = generator(2, pattern)
    x, y = rng.uniform(2.5, 6.0, 40) * rng.choice([-1, 1], 40), rng.uniform(2.5, 6.0, 40) * rng.choice([-1, 1], 40)
    normal = ridges.orientation_field(x, y) + np.pi / 2
    moved = ridges.locate(x + 0.83 * np.cos(normal), y + 0.83 * np.sin(normal))
    here = ridges.locate(x, y)
    assert moved[1] == pytest.approx(here[1], abs=1e-12)
    assert np.abs(moved[0] - here[0]) == pytest.approx(1)


@pytest.mark.parametrize("pattern", PATTERNS)
def test_orientation_field_is_where_the_height_does_not_change(pattern: str) -> None:
    ridges = row(pattern)
    rng = generator(4, pattern)
    x, y = rng.uniform(-5, 5, 60), rng.uniform(-5, 5, 60)
    step = 1e-5
    along = ridges.orientation_field(x, y)
    change = ridges.heights(x + step * np.cos(along), y + step * np.sin(along)) - ridges.heights(x, y)
    across = ridges.heights(x - step * np.sin(along), y + step * np.cos(along)) - ridges.heights(x, y)
    # along a crest heights change to second order only: step/radius of curvature against across
    assert np.abs(change).max() < 1e-3 * np.abs(across).max()


def test_cores() -> None:
    origin = np.array(0.0)
    assert row("parallel").heights(origin, origin) == pytest.approx(0.0)
    assert row("loop").heights(origin, origin) == pytest.approx(0.0)
    assert row("concentric").heights(origin, origin) == pytest.approx(0.06)
    assert row("whorl").heights(origin, origin) == pytest.approx(0.06)
    # a loop opens along its orientation: on that side its legs are parallel, on the other arches close it
    c, s = np.cos(np.deg2rad(27.0)), np.sin(np.deg2rad(27.0))
    legs = row("loop").orientation_field(np.array(4 * c - 2 * s), np.array(4 * s + 2 * c))
    assert float(legs) == pytest.approx(np.deg2rad(27.0))
    arch = row("loop").orientation_field(np.array(-4 * c), np.array(-4 * s))
    assert float(arch) == pytest.approx(np.deg2rad(117.0))


@pytest.mark.parametrize("rounding", [None, 0.01, 0.05, 0.12])
def test_a_ridge_is_as_high_and_as_wide_as_asked(rounding: float | None) -> None:
    def depth(d: float) -> float:
        return float(furrow_depth(np.array(d), 0.83, 0.37, 0.06, rounding))

    assert depth(0.0) == pytest.approx(0.0, abs=1e-15)
    assert depth(0.415) == pytest.approx(0.06, rel=1e-9)
    half = brentq(lambda d: depth(d) - 0.03, 0.0, 0.415)
    # blurring by a third of the width lets the neighbours' tails lift the furrow: a few per cent of the width
    assert 2 * half == pytest.approx(0.37, rel=1e-6 if rounding in (None, 0.01) else 0.06)
    assert depth(0.2) == pytest.approx(depth(-0.2), rel=1e-12)
    assert depth(0.3) == pytest.approx(depth(0.3 - 0.83), rel=1e-9)


def test_little_rounding_leaves_a_flat_top_and_much_a_sinusoid() -> None:
    assert float(furrow_depth(np.array(0.1), 0.83, 0.37, 0.06, 0.01)) < 1e-6
    d = np.linspace(-0.4, 0.4, 17)
    wave = 0.06 * np.sin(np.pi * d / 0.83) ** 2
    assert furrow_depth(d, 0.83, 0.37, 0.06, 0.3) == pytest.approx(wave, abs=0.06 * 0.01)


def test_impossible_profiles_are_refused() -> None:
    for width, rounding in ((0.9, None), (0.0, 0.1), (0.37, 0.0), (0.37, 0.82)):
        with pytest.raises(ValueError, match=r"width|rounding"):
            furrow_depth(np.array(0.1), 0.83, width, 0.06, rounding)


def test_grown_ridges_have_the_pitch_and_follow_the_field() -> None:
    n, spacing, pitch = 192, 0.05, 0.6
    x, y = (np.arange(n) * spacing)[None, :], (np.arange(n) * spacing)[:, None]
    field = np.deg2rad(20 + 6 * x + 2.5 * y)
    distance = grow_ridges(field, pitch, spacing, generator(9, "grow"))
    assert distance.min() >= 0
    assert distance.max() <= pitch / 2 * (1 + 1e-12)
    wave = np.cos(2 * np.pi * distance / pitch)
    # structure tensor on the middle part: its main direction is across the ridges
    gy, gx = np.gradient(wave)
    inner = slice(30, -30)
    angle = 0.5 * np.arctan2(2 * (gx * gy)[inner, inner].mean(), (gx**2 - gy**2)[inner, inner].mean())
    mean_field = field[inner, inner].mean()
    turned = np.angle(np.exp(2j * (angle + np.pi / 2 - mean_field))) / 2
    assert abs(turned) < np.deg2rad(4)  # a field that turns by 50 degrees in all; forks where it has divergence
    # mean square gradient of a unit wave is (2 pi/pitch)^2/2; forks raise it a little, the band-pass is 25 % wide
    mean_square = ((gx**2 + gy**2)[inner, inner]).mean() / spacing**2
    assert np.sqrt(2 * mean_square) == pytest.approx(2 * np.pi / pitch, rel=0.1)
    again = grow_ridges(field, pitch, spacing, generator(9, "grow"))
    assert np.array_equal(distance, again)
    with pytest.raises(ValueError, match="coarse"):
        grow_ridges(field, 0.15, spacing, generator(9, "grow"))
