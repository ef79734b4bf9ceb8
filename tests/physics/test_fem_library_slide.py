"""The slide that ships with the project: Coulomb's limit, stick before slip, and what its frames carry."""

from __future__ import annotations

import numpy as np
import pytest

from evanesce.contact.fem.library import library_slide, library_slide_state, slide_names
from evanesce.core.errors import InputError
from evanesce.core.states import PlateGrid, SurfaceState

NAME = "silskin_0_mu067"
GRID = PlateGrid((140, 260), 0.08, (4.2, 0.3))


def test_the_library_knows_its_slides() -> None:
    assert NAME in slide_names()
    with pytest.raises(InputError, match=NAME):
        library_slide("silskin_99")


def test_force_is_held_and_friction_never_beyond_coulomb() -> None:
    slide = library_slide(NAME)
    np.testing.assert_allclose(slide.scalars["normal_force"], 1.0, rtol=1e-6)
    tangential = slide.scalars["tangential_force"]
    assert tangential.max() <= 0.67 * (1 + 1e-6)
    assert tangential[-1] == pytest.approx(0.67, rel=0.01)  # pulls differ in direction by the skin's sideways spread
    assert slide.scalars["slide"][-1] == pytest.approx(10.0)
    size = np.linalg.norm(slide.fields["traction"], axis=-1)
    assert (size <= 0.67 * slide.fields["pressure"] * (1 + 1e-5) + 1e-9).all()  # single precision


@pytest.mark.parametrize(("way", "label"), [(0.05, SurfaceState.STICK), (9.3, SurfaceState.SLIP)])
def test_frames(way: float, label: SurfaceState) -> None:
    state = library_slide_state(NAME, way, GRID, centre=(-0.4, 0.2))
    cell = GRID.pitch**2
    assert state.pressure.sum() * cell == pytest.approx(1.0, rel=1e-6)
    # polygons of facets 0.7 mm long, 16 points a cell
    assert state.contact_mask.sum() * cell == pytest.approx(state.nominal_contact_area, rel=0.02)
    inner = state.state[state.contact_mask == 1.0]
    assert (inner == label).mean() > 0.9
    x = (state.contact_mask * GRID.x).sum() / state.contact_mask.sum()
    assert -0.41 <= x <= way - 0.4 + 1e-6  # the skin lags behind the axis
    y = (state.contact_mask * GRID.y[:, None]).sum() / state.contact_mask.sum()
    assert y == pytest.approx(0.2, abs=GRID.pitch / 4)


def test_a_way_beyond_the_slide_is_refused() -> None:
    with pytest.raises(InputError, match="0 to 10 mm"):
        library_slide_state(NAME, 11.0, GRID)
