"""Labels: area, force and place are carried into the image without loss, in the frame and in any rectified view."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from evanesce.core.states import ContactState, PlateGrid, SurfaceState
from evanesce.evaluation.labels import RectifiedView, label, view_geometry
from evanesce.optics.projection import Projection
from evanesce.rig import Camera, Distortion, Plate
from evanesce.rig.camera import Lens

CENTRE = (1.7, -0.9)
RADIUS = 3.3
FORCE = 2.4


def projection(index: float = 1.48, **camera: float) -> Projection:
    values = {"tilt_x_deg": 3.0, "tilt_y_deg": -2.0, "roll_deg": 17.0} | camera
    cam = Camera(
        resolution_px=(402, 311),
        scale_px_per_mm=21.3,
        centre_mm=(0.8, -0.3),
        principal_point_offset_px=(6.0, -11.0),
        lens=Lens(focal_length_mm=2.6, distortion=Distortion(k1=-0.22, k2=0.03, p1=0.002)),
        **values,
    )
    plate = Plate(size_mm=(90.0, 70.0), thickness_mm=5.3, refractive_index=index)
    return Projection.of(cam, plate)


def hertz(pitch: float = 0.031, radius: float = RADIUS) -> ContactState:
    """A Hertz contact on a grid that is neither square nor centred on it."""
    grid = PlateGrid((260, 300), pitch, (1.1, -0.4))
    r = np.hypot(grid.x[None, :] - CENTRE[0], grid.y[:, None] - CENTRE[1])
    peak = 1.5 * FORCE / (np.pi * radius**2)
    return ContactState(
        grid=grid,
        pressure=peak * np.sqrt(np.clip(1 - (r / radius) ** 2, 0, None)),
        gap=0.02 + 0.003 * grid.x[None, :] - 0.001 * grid.y[:, None],
        contact_mask=np.clip((radius - r) / grid.pitch + 0.5, 0, 1),
        state=np.where(grid.x[None, :] + 0 * r > 1.3, SurfaceState.SLIP, SurfaceState.STICK).astype(np.uint8),
        normal_force=FORCE,
        nominal_contact_area=np.pi * radius**2,
        law="hertz",
    )


def test_area_force_and_place_survive_the_camera() -> None:
    p = projection()
    labels = label(hertz(), view_geometry(p))
    assert labels.area == pytest.approx(np.pi * RADIUS**2)
    # Mask: the grid's own sum is off by (pitch/radius)^2 / 12 = 7e-6; 1/32 steps of remap by 0.5 um at random on 8,000
    # rim samples. Together below 1e-4.
    assert labels.visible_area == pytest.approx(labels.area, rel=1e-4)
    # Pressure falls as a square root at the rim: a grid sum misses of order (pitch/radius)^1.5 = 1e-3.
    assert (labels.pressure * labels.pixel_area).sum() == pytest.approx(FORCE, rel=1e-3)
    v, u = np.indices(labels.mask.shape)
    weight = labels.mask * labels.pixel_area
    x, y = p.to_plate(u, v)
    place = ((x * weight).sum() / weight.sum(), (y * weight).sum() / weight.sum())
    assert place == pytest.approx(CENTRE, abs=1e-3)


def test_pixels_tile_the_plate() -> None:
    """Sum of pixel areas is the area of the frame's outline, by Green's theorem along its border."""
    p = projection()
    geometry = view_geometry(p)
    rows, cols = p.shape
    u = np.concatenate([np.arange(cols), np.full(rows, cols), np.arange(cols, 0, -1), np.zeros(rows)]) - 0.5
    v = np.concatenate([np.zeros(cols), np.arange(rows), np.full(cols, rows), np.arange(rows, 0, -1)]) - 0.5
    x, y = p.to_plate(u, v)
    outline = abs((x * np.roll(y, -1) - y * np.roll(x, -1)).sum()) / 2
    assert geometry.pixel_area.sum() == pytest.approx(outline, rel=1e-10)


def test_pixel_area_on_the_axis_is_the_scale_squared() -> None:
    p = projection(tilt_x_deg=0.0, tilt_y_deg=0.0)
    cx, cy = p.principal_point
    at = view_geometry(p).pixel_area[round(cy), round(cx)]
    # The nearest pixel is up to half a pixel off the axis: distortion (0.7/840)^2.
    assert at == pytest.approx(21.3**-2, rel=1e-5)


def test_perfect_calibration_without_glass_sees_one_scale_everywhere() -> None:
    """A pinhole that looks straight down and is rectified by its own coefficients is a similarity."""
    p = projection(index=1.0, tilt_x_deg=0.0, tilt_y_deg=0.0)
    view = RectifiedView(p.matrix, np.array(p.distortion), p.matrix, (251, 333), origin=(23, 31))
    geometry = view_geometry(p, view)
    # Inverse distortion stops at 1e-12 of the focal length.
    np.testing.assert_allclose(geometry.pixel_area, 21.3**-2, rtol=1e-7)
    labels = label(hertz(), geometry)
    assert labels.mask.sum() / 21.3**2 == pytest.approx(np.pi * RADIUS**2, rel=2e-4)


def test_rectified_view_is_opencvs() -> None:
    p = projection()
    wrong = np.array([-0.3, 0.1, 0.001, -0.002, 0.01])
    matrix = p.matrix * np.array([[1.1, 1, 1], [1, 1.05, 1], [1, 1, 1]])
    new = matrix.copy()
    new[0, 2] -= 12.0
    new[1, 2] -= 9.0
    view = RectifiedView(matrix, wrong, new, (280, 350))
    expected = cv2.initUndistortRectifyMap(matrix, wrong, np.eye(3), new, (350, 280), cv2.CV_32FC1)
    for got, wanted in zip(view.maps(), expected, strict=True):
        np.testing.assert_allclose(got, wanted, atol=1e-3)  # single precision at 400 px, OpenCV sums along the row
    cropped = RectifiedView(matrix, wrong, new, (100, 200), origin=(50, 77))
    np.testing.assert_allclose(cropped.maps()[0], view.maps()[0][50:150, 77:277], atol=1e-4)


def test_rectified_labels_follow_the_pixels_of_the_frame() -> None:
    """Labels made in a rectified view equal frame labels resampled by the same maps, even with wrong coefficients."""
    p = projection()
    view = RectifiedView(p.matrix, (-0.17, 0.0), p.matrix, (250, 330), origin=(30, 35))
    direct = label(hertz(), view_geometry(p, view))
    frame = label(hertz(), view_geometry(p))
    resampled = cv2.remap(frame.pressure, *view.maps(), cv2.INTER_LINEAR)
    inside = cv2.erode((direct.mask > 0.999).astype(np.uint8), np.ones((9, 9), np.uint8)).astype(bool)
    np.testing.assert_allclose(direct.pressure[inside], resampled[inside], rtol=5e-3)
    assert direct.visible_area == pytest.approx(frame.visible_area, rel=1e-4)


def test_gap_is_a_mean_over_the_pixel_and_unknown_beyond_the_grid() -> None:
    p = projection()
    state = hertz(pitch=0.02)
    labels = label(state, view_geometry(p))
    v, u = np.indices(labels.gap.shape)
    x, y = p.to_plate(u, v)
    plane = 0.02 + 0.003 * x - 0.001 * y
    x_min, x_max, y_min, y_max = state.grid.extent
    well_inside = (x > x_min + 0.1) & (x < x_max - 0.1) & (y > y_min + 0.1) & (y < y_max - 0.1)
    # A plane's mean is its centre's value; positions are rounded to 1/32 of a cell of 0.02 mm, slope 0.003.
    np.testing.assert_allclose(labels.gap[well_inside], plane[well_inside], atol=3e-6)
    beyond = (x < x_min - 0.05) | (x > x_max + 0.05) | (y < y_min - 0.05) | (y > y_max + 0.05)
    assert beyond.any()
    assert np.isnan(labels.gap[beyond]).all()
    assert not labels.mask[beyond].any()


def test_surface_states_are_those_at_the_pixels_centres() -> None:
    p = projection()
    labels = label(hertz(), view_geometry(p))
    assert labels.surface_state is not None
    v, u = np.indices(labels.mask.shape)
    x, _ = p.to_plate(u, v)
    inside = np.isfinite(labels.gap) & (np.abs(x - 1.3) > 0.04)
    expected = np.where(x > 1.3, SurfaceState.SLIP, SurfaceState.STICK)
    inside = cv2.erode(inside.astype(np.uint8), np.ones((3, 3), np.uint8)).astype(bool)
    np.testing.assert_array_equal(labels.surface_state[inside], expected[inside])


def test_a_contact_outside_the_view_has_area_but_no_pixels() -> None:
    p = projection()
    view = RectifiedView(p.matrix, np.zeros(5), p.matrix, (20, 30))
    labels = label(hertz(), view_geometry(p, view))
    assert labels.visible_area == 0.0
    assert labels.area == pytest.approx(np.pi * RADIUS**2)


def test_nothing_touches() -> None:
    labels = label(None, view_geometry(projection()))
    assert (labels.area, labels.normal_force, labels.visible_area) == (0.0, 0.0, 0.0)
    assert labels.surface_state is None


@settings(deadline=None, max_examples=15)
@given(tilt=st.floats(-12, 12), roll=st.floats(-180, 180), index=st.floats(1.0, 1.9), radius=st.floats(0.3, RADIUS))
def test_any_camera_keeps_area(tilt: float, roll: float, index: float, radius: float) -> None:
    state = hertz(radius=radius)
    labels = label(state, view_geometry(projection(index=index, tilt_x_deg=tilt, roll_deg=roll)))
    grid_sum = state.contact_mask.sum() * state.grid.pitch**2
    # Positions are rounded to 1/32 of a cell of 0.031 mm; where grid and pixels are parallel that does not average
    # out, and displaces the rim by up to 0.5 um.
    assert labels.visible_area == pytest.approx(grid_sum, rel=2 * 0.0005 / radius)
