"""Ridges, first model: one ridge against Westergaard and quadrature, the finger against balance, limits, monotony."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad

from evanesce.contact.analytic.hertz import hertz_contact, scaled_hertz_contact
from evanesce.contact.analytic.jkr import jkr_contact
from evanesce.contact.patch import axisymmetric_state
from evanesce.contact.ridges.heightmap import RidgeRow
from evanesce.contact.ridges.profile import (
    closure_pressure,
    contact_edge,
    profile_exponent,
    ridge_gap,
    ridge_pressure,
)
from evanesce.contact.ridges.ridged import ridged_state
from evanesce.core.errors import InputError
from evanesce.core.states import PlateGrid

E, PITCH, HEIGHT = 0.61, 0.83, 0.052  # MPa, mm, mm


def test_a_ridge_of_half_the_pitch_is_westergaards_sinusoid() -> None:
    assert profile_exponent(0.5 * PITCH, PITCH) == pytest.approx(2.0, rel=1e-14)
    closure = closure_pressure(E, HEIGHT, PITCH)
    amplitude = HEIGHT / 2
    assert closure == pytest.approx(np.pi * E * amplitude / PITCH, rel=1e-14)
    mean = 0.37 * closure
    half = PITCH / np.pi * np.arcsin(np.sqrt(mean / closure))
    assert float(contact_edge(mean, closure)) == pytest.approx(np.sin(np.pi * half / PITCH), rel=1e-14)
    x = np.array([-0.9, -0.4, 0.1, 0.7]) * half
    sin2 = np.sin(np.pi * half / PITCH) ** 2
    published = 2 * mean / sin2 * np.cos(np.pi * x / PITCH) * np.sqrt(sin2 - np.sin(np.pi * x / PITCH) ** 2)
    assert ridge_pressure(x, mean, PITCH, closure) == pytest.approx(published, rel=1e-6)  # table: 1e-6


@given(width=st.floats(0.2, 0.85), load=st.floats(0.01, 1.6))
@settings(max_examples=40, deadline=None)
def test_a_ridge_carries_its_mean_pressure(width: float, load: float) -> None:
    exponent = profile_exponent(width, 1.0)
    closure = closure_pressure(E, HEIGHT, 1.0, exponent)
    mean = load * closure
    edge = float(contact_edge(mean, closure, exponent))
    half = np.arcsin(edge) / np.pi
    # Midpoint rule; x = half sin(t) takes the root at the edge out, t ~ v^4 the algebraic crest of thin ridges.
    v = (np.arange(20000) + 0.5) / 20000
    t = np.pi / 2 * v**4
    weight = np.pi / 2 * 4 * v**3 / v.size * half * np.cos(t)
    # both halves of the ridge are equal
    carried = 2 * (ridge_pressure(half * np.sin(t), mean, 1.0, closure, exponent) * weight).sum()
    # table interpolation 1e-6, near the algebraic crest about 1e-5
    assert carried == pytest.approx(mean, rel=1e-4)


@pytest.mark.parametrize(("width", "load"), [(0.5, 0.31), (0.37, 0.6), (0.71, 0.12)])
def test_gap_and_pressure_of_a_ridge_solve_the_elastic_half_plane(width: float, load: float) -> None:
    # Independent: plane-strain displacement of a periodic half-plane, u_k = 2 p_k/(E* |k|) for k != 0, by FFT.
    # Where the ridge touches, h + u - const = 0; elsewhere it is the gap.
    exponent = profile_exponent(width, PITCH)
    closure = closure_pressure(E, HEIGHT, PITCH, exponent)
    mean = load * closure
    n = 16384
    x = ((np.arange(n) + 0.5) / n - 0.5) * PITCH
    p = ridge_pressure(x, mean, PITCH, closure, exponent)
    k = 2 * np.pi * np.fft.rfftfreq(n, PITCH / n)
    spectrum = np.fft.rfft(p)
    spectrum[1:] *= 2 / (E * k[1:])
    spectrum[0] = 0
    moved = np.fft.irfft(spectrum, n)
    shape = HEIGHT * np.abs(np.sin(np.pi * x / PITCH)) ** exponent
    gap = shape + moved
    gap -= gap[n // 2]
    expected = ridge_gap(x, mean, PITCH, HEIGHT, closure, exponent)
    # sampling a root of the distance at n points errs by about n^(-3/2) in the integral; 1e-4 of the height is ample
    assert np.abs(gap - expected).max() < 1e-4 * HEIGHT
    assert expected.max() <= HEIGHT
    assert expected.min() == 0.0


def test_the_ridge_has_its_width_at_half_height() -> None:
    for width in (0.2, 0.41, 0.66):
        exponent = profile_exponent(width, PITCH)
        height = float(ridge_gap(width / 2, 0.0, PITCH, HEIGHT, 1.0, exponent))
        assert height == pytest.approx(HEIGHT / 2, rel=1e-6)


def test_the_furrow_is_whole_without_load_and_gone_at_closure() -> None:
    closure = closure_pressure(E, HEIGHT, PITCH)
    assert float(ridge_gap(PITCH / 2, 0.0, PITCH, HEIGHT, closure)) == pytest.approx(HEIGHT, rel=1e-6)
    assert float(ridge_gap(PITCH / 2, closure, PITCH, HEIGHT, closure)) == 0.0
    high = ridge_pressure(np.linspace(-0.4, 0.4, 9) * PITCH, 1.7 * closure, PITCH, closure)
    assert high.min() >= 0.7 * closure * (1 - 1e-12)


# --- the finger


GRID = PlateGrid((300, 330), 0.033, (0.7, -0.4))
CENTRE = (0.81, -0.33)


def finger(force: float, row: RidgeRow, *, grid: PlateGrid = GRID, tip: float = 6.7):
    return ridged_state(grid, CENTRE, hertz_contact(force, tip, E), row, E, law="hertz+ridges")


ROWS = [
    RidgeRow("parallel", 0.91, 0.4, 0.11, np.deg2rad(23.0)),
    RidgeRow("concentric", 0.77, 0.45, 0.09),
]


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row.pattern)
def test_the_ridges_together_carry_the_force(row: RidgeRow) -> None:
    state = finger(2.1, row)
    assert state.pressure.sum() * GRID.pitch**2 == pytest.approx(2.1, rel=1e-9)
    assert state.pressure.min() >= 0


def test_each_parallel_ridge_carries_the_pressure_on_its_strip() -> None:
    row = ROWS[0]
    state = finger(2.1, row)
    a, force = float(np.sqrt(hertz_contact(2.1, 6.7, E).contact_radius ** 2)), 2.1
    across = -(GRID.x[None, :] - CENTRE[0]) * np.sin(row.orientation) + (GRID.y[:, None] - CENTRE[1]) * np.cos(
        row.orientation
    )
    for number in (-1, 0, 1):
        lo, hi = (number - 0.5) * row.pitch, (number + 0.5) * row.pitch
        # Hertz's pressure integrated along chords: F 3/(4a) (1 - u^2/a^2)
        share = quad(lambda u: force * 0.75 / a * max(0.0, 1 - (u / a) ** 2), lo, hi)[0]
        strip = (across >= lo) & (across < hi)
        got = state.pressure[strip].sum() * GRID.pitch**2
        # the strip's border cuts cells: up to half a cell of the pressure there on either side
        assert got == pytest.approx(share, rel=2 * 0.5 * GRID.pitch / row.pitch)


@pytest.mark.parametrize("angle", [0.0, 0.2, 0.9])
def test_slivers_at_the_rim_are_not_asked_to_carry_what_they_cannot(angle: float) -> None:
    # Tall ridges whose outermost crests just touch: no peak may exceed the middle ridge's by more than its overload.
    row = RidgeRow("parallel", 0.91, 0.45, 0.2, angle)
    state = finger(0.9, row)
    peak = float(state.pressure.max())
    middle = np.hypot(GRID.x[None, :] - CENTRE[0], GRID.y[:, None] - CENTRE[1]) < 0.5
    assert state.pressure[middle].max() >= peak / 1.25
    assert state.pressure.sum() * GRID.pitch**2 == pytest.approx(0.9, rel=1e-9)


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row.pattern)
@pytest.mark.parametrize("force", [0.3, 1.1, 4.0])
def test_mask_agrees_with_the_area_by_quadrature(row: RidgeRow, force: float) -> None:
    state = finger(force, row)
    assert state.contact_mask.sum() * GRID.pitch**2 == pytest.approx(state.nominal_contact_area, rel=1e-3)
    smooth = hertz_contact(force, 6.7, E)
    assert 0 < state.nominal_contact_area < np.pi * smooth.contact_radius**2


@given(x=st.floats(-0.5, 0.5), y=st.floats(-0.5, 0.5), angle=st.floats(-3.0, 3.0), pitch=st.floats(0.5, 1.3))
@settings(max_examples=15, deadline=None)
def test_mask_agrees_with_the_area_wherever_and_however_it_lies(x: float, y: float, angle: float, pitch: float) -> None:
    row = RidgeRow("parallel", pitch, 0.46 * pitch, 0.1 * pitch, angle)
    grid = PlateGrid((240, 220), 0.03, (0.0, 0.0))
    state = ridged_state(grid, (x, y), hertz_contact(0.9, 6.7, E), row, E, law="hertz+ridges")
    assert state.contact_mask.sum() * grid.pitch**2 == pytest.approx(state.nominal_contact_area, rel=1e-3)


@pytest.mark.parametrize("pattern", ["parallel", "concentric"])
def test_ridges_without_height_are_the_smooth_finger(pattern: str) -> None:
    row = RidgeRow(pattern, 0.7, 0.3, 1e-9, 0.4)
    state = finger(1.3, row)
    smooth = axisymmetric_state(GRID, CENTRE, hertz_contact(1.3, 6.7, E), law="hertz")
    assert state.nominal_contact_area == pytest.approx(smooth.nominal_contact_area, rel=1e-4)
    assert state.contact_mask == pytest.approx(smooth.contact_mask, abs=0.02)  # straight edges for arcs in rim cells
    assert state.gap == pytest.approx(smooth.gap, abs=2e-9)
    inner = smooth.contact_mask == 1.0
    # sharing by strips rescales by the rim's placing error, about pitch/a squared
    np.testing.assert_allclose(
        state.pressure[inner], smooth.pressure[inner], rtol=0.01, atol=0.02 * smooth.pressure.max()
    )


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row.pattern)
def test_area_grows_with_force_and_shrinks_with_height(row: RidgeRow) -> None:
    areas = [finger(f, row).nominal_contact_area for f in (0.2, 0.7, 1.9, 4.1)]
    assert areas == sorted(areas)
    assert len(set(areas)) == 4
    heights = (0.02, 0.06, 0.11, 0.19)
    taller = [
        finger(1.9, RidgeRow(row.pattern, row.pitch, row.width, h, row.orientation)).nominal_contact_area
        for h in heights
    ]
    assert taller == sorted(taller, reverse=True)
    assert len(set(taller)) == 4


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row.pattern)
def test_gap_is_zero_in_contact_and_no_deeper_than_furrow_and_sphere(row: RidgeRow) -> None:
    state = finger(2.1, row)
    smooth = hertz_contact(2.1, 6.7, E)
    r = np.hypot(GRID.x[None, :] - CENTRE[0], GRID.y[:, None] - CENTRE[1])
    assert state.gap[state.contact_mask == 1.0].max() == 0.0
    assert (state.gap <= smooth.gap(r) + row.height * (1 + 1e-9)).all()
    assert (state.gap[state.contact_mask == 0.0] > 0).mean() > 0.999


def test_orientation_turns_from_x_towards_y() -> None:
    # Ridges along +30 deg: walking along the crest through the tip stays in contact, walking across leaves it.
    angle = np.deg2rad(30.0)
    state = finger(2.1, RidgeRow("parallel", 0.91, 0.3, 0.5, angle))
    radius = 0.5 * hertz_contact(2.1, 6.7, E).contact_radius

    def touch(direction: float, distance: float) -> float:
        row, col = GRID.index(
            np.array(CENTRE[0] + distance * np.cos(direction)), np.array(CENTRE[1] + distance * np.sin(direction))
        )
        return float(state.contact_mask[round(float(row)), round(float(col))])

    assert all(touch(angle, d) == 1.0 for d in np.linspace(-radius, radius, 7))
    assert touch(angle + np.pi / 2, 0.455) == 0.0
    assert touch(-angle, 0.455 / np.sin(2 * angle)) == 0.0


def test_rings_have_their_crests_half_a_pitch_out() -> None:
    state = finger(2.1, RidgeRow("concentric", 0.77, 0.4, 0.2))
    row, col = (round(float(v)) for v in GRID.index(np.array(CENTRE[0]), np.array(CENTRE[1])))
    along = state.contact_mask[row, col:]
    r = GRID.x[col:] - CENTRE[0]
    assert along[0] == 0.0
    assert along[np.argmin(np.abs(r - 0.385))] == 1.0
    assert along[np.argmin(np.abs(r - 0.77))] == 0.0


def test_without_force_the_crests_hang_over_the_glass() -> None:
    state = finger(0.0, ROWS[0])
    assert not state.contact_mask.any()
    assert not state.pressure.any()
    assert state.nominal_contact_area == 0.0
    assert state.gap.min() >= 0.0


def test_a_coarse_grid_and_an_adhesive_law_are_refused() -> None:
    with pytest.raises(InputError, match=r"grid\.samples"):
        finger(1.0, RidgeRow("parallel", 0.2, 0.1, 0.02), grid=PlateGrid((60, 60), 0.12, CENTRE))
    with pytest.raises(ValueError, match="adhesion"):
        ridged_state(GRID, CENTRE, jkr_contact(1.0, 6.7, E, 1e-3), ROWS[0], E, law="jkr+ridges")
    with pytest.raises(ValueError, match="furrow"):
        profile_exponent(0.5, 0.5)
    with pytest.raises(ValueError, match="height"):
        closure_pressure(E, -0.1, 1.0)


def test_a_scaled_finger_ridges_as_well() -> None:
    smooth = scaled_hertz_contact(1.0, 6.7, E, 1.66)
    state = ridged_state(GRID, CENTRE, smooth, ROWS[0], E, law="scaled_hertz+ridges")
    assert state.pressure.sum() * GRID.pitch**2 == pytest.approx(1.0, rel=1e-9)
    assert state.nominal_contact_area < np.pi * smooth.contact_radius**2
