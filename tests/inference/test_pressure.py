"""Pressure from light against Hertz's closed form under a rough skin."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import erf

from evanesce.core.errors import InputError
from evanesce.measurement.pressure import PressureCurve, pressure_map, reference_map

PIXEL_MM2 = 0.02**2
STEEP = 7.3
"""sqrt(2)/(E* h') [1/MPa]."""


def hertz(force: float = 1.7, radius: float = 2.1) -> np.ndarray:
    """Return Hertz's pressure on a grid [MPa]."""
    y, x = np.mgrid[-120:121, -130:131] * 0.02
    r2 = (x - 0.13) ** 2 + (y + 0.21) ** 2
    return 1.5 * force / (np.pi * radius**2) * np.sqrt(np.clip(1 - r2 / radius**2, 0, None))


def curve(end: float = 1.2) -> PressureCurve:
    p = np.linspace(0, end, 3000)
    return PressureCurve(p, erf(STEEP * p))


@pytest.mark.parametrize("exposure", [0.11, 0.93])
def test_hertz_comes_back_whatever_the_exposure(exposure):
    """The force alone sets the scale: any brightness gives the same map. The rim is smoothed, so 2 % of the peak."""
    p = hertz()
    light = exposure * erf(STEEP * p)
    found = pressure_map(light, np.zeros(p.shape, bool), PIXEL_MM2, float(p.sum() * PIXEL_MM2), curve())
    assert found.factor == 1.0
    assert found.complete_light == pytest.approx(exposure, rel=0.01)
    assert found.pressure.sum() * PIXEL_MM2 == pytest.approx(1.7, rel=2e-3)
    assert np.sqrt(np.mean((found.pressure - p)[p > 0] ** 2)) < 0.02 * p.max()


def test_a_flat_top_is_no_pressure():
    """Where light is cut off, all that can be known is a least pressure: the map says where."""
    p = hertz()
    light = 2.0 * erf(STEEP * p)
    full = light >= 1
    found = pressure_map(np.minimum(light, 1), full, PIXEL_MM2, 1.7, curve())
    assert (found.unknown == full).all()
    assert found.pressure[full].std() < 0.5 * p[full].std()


def test_a_force_beyond_the_curve_is_scaled_and_said():
    """A curve that ends at half the peak cannot carry the force of a bright frame."""
    p = hertz()
    short = curve(0.02)
    found = pressure_map(np.where(p > 0, 0.4, 0.0), np.zeros(p.shape, bool), PIXEL_MM2, 1.7, short)
    assert found.factor > 1
    assert found.pressure.sum() * PIXEL_MM2 == pytest.approx(1.7, rel=1e-6)


def test_the_thesis_map_puts_force_beside_the_contact():
    """Scattered light under a dilated mask carries force: here an annulus of known share."""
    level = np.zeros((50, 60))
    level[10:30, 10:40], level[30:36, 10:40] = 0.5, 0.1
    pressure = reference_map(level, level > 0, PIXEL_MM2, 2.0)
    assert pressure.sum() * PIXEL_MM2 == pytest.approx(2.0, rel=1e-12)
    assert pressure[30:36].sum() * PIXEL_MM2 == pytest.approx(2.0 * 6 * 0.1 / (6 * 0.1 + 20 * 0.5), rel=1e-12)


@pytest.mark.parametrize(
    ("make", "part"),
    [
        (lambda: PressureCurve(np.array([0.0, 1.0]), np.array([0.0, 1.0])), "pressure curve"),
        (lambda: PressureCurve(np.array([0.0, 1.0, 2.0]), np.array([0.0, 0.7, 0.6])), "pressure curve"),
        (lambda: PressureCurve(np.array([0.1, 1.0, 2.0]), np.array([0.0, 0.7, 0.8])), "pressure curve"),
        (lambda: pressure_map(np.ones((4, 4)), np.zeros((4, 4), bool), 1.0, 0.0, curve()), "force"),
        (lambda: pressure_map(np.zeros((4, 4)), np.zeros((4, 4), bool), 1.0, 1.0, curve()), "frame"),
    ],
)
def test_bad_input_names_its_key(make, part):
    with pytest.raises(InputError, match=part):
        make()
