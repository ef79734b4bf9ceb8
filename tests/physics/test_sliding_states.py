"""Slides on the grid: forces carried, masks, labels, closed-form fields, speed."""

from __future__ import annotations

import numpy as np
import pytest

from evanesce.contact.analytic import partial_slip
from evanesce.contact.analytic.hertz import hertz_contact, hertz_gap, hertz_radius
from evanesce.contact.coverage import disc_coverage
from evanesce.contact.sliding.area_loss import area_loss_for
from evanesce.contact.sliding.solver import march
from evanesce.contact.sliding.states import SlideStates, SlideView
from evanesce.core.errors import InputError
from evanesce.core.states import PlateGrid, SurfaceState
from evanesce.materials.friction import coulomb, interface_of

E, R, N, MU = 0.64, 7.1, 1.2, 0.91
G = float(partial_slip.tangential_modulus(E, 0.5))
A = float(hertz_radius(N, R, E))
GRID = PlateGrid((300, 340), 0.031, (0.4, -0.3))
VIEW = SlideView(centre=(0.23, 0.11), direction=0.7)


def coulomb_slide(count=40, length=0.9):
    t = np.linspace(0, 1, count)
    return march([hertz_contact(N, R, E)] * count, t, length * t, coulomb(MU), G)


def centred_radius(state, view=VIEW):
    moved = state.parameters["tip_displacement_mm"]
    x = GRID.x[None, :] - view.centre[0] - moved * np.cos(view.direction)
    y = GRID.y[:, None] - view.centre[1] - moved * np.sin(view.direction)
    return np.hypot(x, y)


def test_fields_are_cattaneo_mindlin():
    states = SlideStates(coulomb_slide(), GRID, VIEW)
    state = states[17]
    q = float(np.hypot(*state.tangential_force))
    assert 0.3 * MU * N < q < 0.95 * MU * N
    r = centred_radius(state)
    along = state.traction[0] * np.cos(0.7) + state.traction[1] * np.sin(0.7)
    across = state.traction[1] * np.cos(0.7) - state.traction[0] * np.sin(0.7)
    np.testing.assert_allclose(across, 0, atol=1e-15)
    exact = partial_slip.traction(r, A, N, q, MU)
    peak = exact.max()
    c = state.parameters["stick_radius_mm"]
    kink = (np.abs(r - c) < 2 * GRID.pitch) | (np.abs(r - A) < 2 * GRID.pitch)
    # An annulus mean over a cell's width of a field that is smooth off the two circles: (pitch/a)^2 of the peak.
    assert np.abs(along - exact)[~kink].max() < 2e-3 * peak
    assert np.abs(along - exact).max() < 0.12 * peak  # the kinks are square roots: sqrt(2 pitch/a) times a mean's share
    slip = np.hypot(*state.slip)
    exact_slip = partial_slip.slip(r, A, N, q, MU, G)
    inside = r < A
    assert np.abs(slip - exact_slip)[inside].max() < 5e-3 * np.nanmax(exact_slip)
    assert np.all(slip[np.asarray(state.contact_mask) <= 0] == 0)


def test_forces_are_carried():
    friction = interface_of("silskin_0")
    loss = area_loss_for(np.pi * A**2, 0.8, 0.85)
    t = np.linspace(0, 1, 30)
    slide = march([hertz_contact(N, R, E)] * 30, t, t, friction, G, area_loss=loss)
    for state in SlideStates(slide, GRID, VIEW)[3::9]:
        cell = GRID.pitch**2
        assert state.pressure.sum() * cell == pytest.approx(N, rel=1e-9)
        np.testing.assert_allclose(state.traction.sum((1, 2)) * cell, state.tangential_force, rtol=1e-9)
        # Tangent cuts of border cells: (pitch/a)^2/24 of the area is left out, 1e-5.
        assert state.contact_mask.sum() * cell == pytest.approx(state.nominal_contact_area, rel=5e-5)


def test_shear_takes_the_area_from_the_trailing_edge():
    loss = area_loss_for(np.pi * A**2, MU * N, 0.75)
    t = np.linspace(0, 1, 30)
    slide = march([hertz_contact(N, R, E)] * 30, t, 1.5 * t, coulomb(MU), G, area_loss=loss)
    view = SlideView(centre=(0.2, 0.1), direction=0.0, follows=False)
    first, last = SlideStates(slide, GRID, view)[0], SlideStates(slide, GRID, view)[-1]
    assert last.nominal_contact_area == pytest.approx(0.75 * first.nominal_contact_area, rel=1e-9)

    def extent(state, axis):
        touched = np.flatnonzero((state.contact_mask > 0.5).any(axis))
        return touched[0], touched[-1]

    (left0, right0), (left1, right1) = extent(first, 0), extent(last, 0)
    assert right1 == right0  # the leading edge stays
    assert (left1 - left0) * GRID.pitch == pytest.approx(0.25 * 2 * A, abs=1.5 * GRID.pitch)
    assert extent(first, 1) == extent(last, 1)  # the width across the slide stays


def test_a_round_mask_equals_the_exact_one():
    state = SlideStates(coulomb_slide(), GRID, VIEW)[25]
    moved = state.parameters["tip_displacement_mm"]
    centre = (0.23 + moved * np.cos(0.7), 0.11 + moved * np.sin(0.7))
    exact = disc_coverage(GRID, centre, A)
    # The sagitta of a border cell is pitch^2/(8 a), a share of pitch/(8 a) of the cell; corners see up to 2.5 of it.
    assert np.abs(state.contact_mask - exact).max() < 2.5 * GRID.pitch / (8 * A)


def test_labels_partition_the_plate():
    state = SlideStates(coulomb_slide(), GRID, VIEW)[17]
    r = centred_radius(state)
    c = state.parameters["stick_radius_mm"]
    labels = state.state
    assert labels[r < c - GRID.pitch].tolist() == [SurfaceState.STICK] * int((r < c - GRID.pitch).sum())
    annulus = (r > c + GRID.pitch) & (r < A - GRID.pitch)
    assert np.all(labels[annulus] == SurfaceState.SLIP)
    outside = r > A + GRID.pitch
    np.testing.assert_array_equal(labels[outside] == SurfaceState.NEAR, hertz_gap(r[outside], A, R) < 0.01)
    counted = np.isin(labels, (SurfaceState.STICK, SurfaceState.SLIP)).sum() * GRID.pitch**2
    assert counted == pytest.approx(state.nominal_contact_area, rel=0.01)
    assert (labels == SurfaceState.STICK).sum() * GRID.pitch**2 / counted == pytest.approx(
        state.parameters["stick_ratio"], abs=0.01
    )


def test_times_order_and_slices():
    slide = coulomb_slide(12)
    states = SlideStates(slide, GRID, VIEW)
    assert len(states) == 12
    assert [s.time for s in states[2:9:3]] == [slide.frames[i].time for i in (2, 5, 8)]
    assert states[-1].time == 1.0
    with pytest.raises(IndexError):
        states[12]


def test_a_slide_off_the_grid_is_refused_before_any_work():
    with pytest.raises(InputError, match="does not fit"):
        SlideStates(coulomb_slide(length=9.0), GRID, VIEW)
    SlideStates(coulomb_slide(length=9.0), GRID, SlideView(follows=False))


def test_two_hundred_frames_at_512_stay_within_the_grid():
    """A whole press and slide at the size of a dataset; how long it takes is measured by ``benchmarks/sliding.py``."""
    grid = PlateGrid((512, 512), 14 / 512)
    force = np.concatenate([np.linspace(0.05, N, 60), np.full(140, N)])
    contacts = [hertz_contact(f, R, E) for f in force[:60]]
    contacts += [contacts[-1]] * 140
    drive = np.concatenate([np.zeros(60), np.linspace(0, 2, 140)])
    slide = march(contacts, np.arange(200) / 30, drive, interface_of("silskin_0"), G, drive_stiffness=3.0)
    total = sum(float(state.contact_mask[0, 0]) for state in SlideStates(slide, grid))
    assert total == 0.0
