"""The friction programme: timing, forces, angle, reversal, labels of a whole run."""

from __future__ import annotations

import numpy as np
import pytest

from evanesce.contact.analytic.xydas_kao import xydas_kao_contact
from evanesce.contact.sliding.programme import SlideProgramme, press_and_slide
from evanesce.core.errors import InputError
from evanesce.core.states import PlateGrid, SurfaceState
from evanesce.materials.friction import coulomb, interface_of
from evanesce.materials.tables import material

GRID = PlateGrid((96, 200), 0.11, (2.1, 0.2))
SOFT = material("silskin_0")


def test_programme_times_and_corners():
    time, force, drive = SlideProgramme(1.3, 0.1, 0.5, 0.25, 4.0, 3.0, True, 40.0).sample()
    assert time[-1] <= 0.75 + 1.5 < time[-1] + 1 / 40
    assert force[0] == 0.1
    assert np.all(force[time >= 0.5] == 1.3)
    assert np.all(drive[time <= 0.75] == 0)
    assert drive.max() == pytest.approx(3.0, abs=4.0 / 40)
    assert drive[-1] == pytest.approx(0.0, abs=4.0 / 40)
    np.testing.assert_allclose(np.abs(np.diff(drive[time > 0.78]))[:20], 0.1)


def test_regions_of_the_thesis_in_order():
    """Preload, full stick while pressing, rising shear with a stick circle, gross slip."""
    programme = SlideProgramme(normal_force=1.0, press_time=0.5, speed=2.0, distance=4.0)
    states = press_and_slide(GRID, SOFT, interface_of("silskin_0"), programme, shaft_stiffness=(30.0, 2.0))
    stick = np.array([s.parameters["stick_ratio"] for s in states])
    time = np.array([s.time for s in states])
    assert np.all(stick[time < 0.5] == 1.0)
    assert stick[-1] == 0.0
    rising = np.diff(stick[(time > 0.55)])
    assert np.all(rising <= 1e-9)
    last = states[-1]
    assert SurfaceState.STICK not in last.state
    mu = last.tangential_force[0] / last.normal_force
    assert mu == pytest.approx(0.0606 * last.nominal_contact_area + 0.2324, rel=1e-9)
    assert last.parameters["tip_displacement_mm"] == pytest.approx(4.0 - last.tangential_force[0] / 2.0, abs=0.08)


def test_reversal_turns_the_force_and_returns():
    programme = SlideProgramme(press_time=0.3, speed=5.0, distance=3.0, reciprocate=True)
    states = press_and_slide(GRID, SOFT, coulomb(0.67), programme)
    q = np.array([s.tangential_force[0] for s in states])
    assert q.max() == pytest.approx(0.67, rel=1e-6)
    assert q.min() == pytest.approx(-0.67, rel=1e-6)


def test_a_tilted_finger_is_stiffer_along_the_slide_when_its_shaft_is_slender():
    programme = SlideProgramme(press_time=0.3, speed=1.0, distance=0.3)
    q = [
        press_and_slide(
            GRID, SOFT, coulomb(1.13), programme, shaft_stiffness=(30.0, 1.5), contact_angle=np.radians(angle)
        )[-1].tangential_force[0]
        for angle in (0.0, 30.0, 45.0)
    ]
    assert q[0] < q[1] < q[2]


def test_any_axisymmetric_law_slides():
    programme = SlideProgramme(press_time=0.3, speed=5.0, distance=2.0)
    states = press_and_slide(
        GRID, SOFT, coulomb(0.82), programme, contact_law=lambda f: xydas_kao_contact(f, 7.5, 2.0, 0.2, k=4.0)
    )
    assert states[-1].nominal_contact_area == pytest.approx(np.pi * 4.0)
    assert states[-1].tangential_force[0] == pytest.approx(0.82, rel=1e-6)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"speed": 0.0}, "speed"),
        ({"distance": float("nan")}, "distance"),
        ({"preload": -1.0}, "preload"),
        ({"frame_rate": 1e6}, "frames"),
        ({"distance": 60.0, "speed": 60.0}, "does not fit"),
    ],
)
def test_bad_programmes(change, message):
    with pytest.raises(InputError, match=message):
        press_and_slide(GRID, SOFT, coulomb(0.5), SlideProgramme(**change))
