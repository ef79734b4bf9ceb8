"""The camera's geometry against Snell in vector form, Fermat's principle and OpenCV. Nothing is centred or equal."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize

from evanesce.optics.projection import Projection
from evanesce.rig import Camera, Distortion, Plate
from evanesce.rig.camera import Lens

PLATE = Plate(size_mm=(120.0, 80.0), thickness_mm=5.3, refractive_index=1.471)


def ugly_camera(**lens: float) -> Camera:
    return Camera(
        resolution_px=(640, 410),
        scale_px_per_mm=17.3,
        centre_mm=(2.1, -1.4),
        principal_point_offset_px=(13.0, -7.5),
        tilt_x_deg=7.0,
        tilt_y_deg=-4.0,
        roll_deg=23.0,
        lens=Lens(focal_length_mm=4.4, distortion=Distortion(k1=-0.31, k2=0.09, p1=0.004, p2=-0.003, k3=0.02), **lens),
    )


def projection(plate: Plate = PLATE) -> Projection:
    return Projection.of(ugly_camera(), plate)


def pixels(p: Projection, count: int = 400) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(5)
    return rng.uniform(0, p.shape[1] - 1, count), rng.uniform(0, p.shape[0] - 1, count)


def test_without_refraction_it_is_opencvs_camera() -> None:
    # n = 1: no port. cv2.projectPoints has its own pose, projection and distortion.
    p = projection(PLATE.model_copy(update={"refractive_index": 1.0}))
    u, v = pixels(p)
    x, y = p.to_plate(u, v)
    rotation = p.axes.T
    points = np.stack([x, y, np.zeros_like(x)], axis=-1)
    seen, _ = cv2.projectPoints(
        points, cv2.Rodrigues(rotation)[0], -rotation @ p.pinhole, p.matrix, np.array(p.distortion)
    )
    # OpenCV's undistortion stops at 1e-12 in normalised units: 1e-9 px; 1e-7 leaves room for its conditioning.
    np.testing.assert_allclose(seen[:, 0], np.stack([u, v], axis=-1), atol=1e-7)


def test_ray_obeys_snells_law_in_vector_form() -> None:
    p = projection()
    u, v = pixels(p)
    flat = np.stack([u, v], axis=-1)[:, None]
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 200, 1e-13)
    bent = cv2.undistortPoints(flat, p.matrix, np.array(p.distortion), None, None, None, criteria)[:, 0]
    d = np.column_stack([bent, np.ones(len(u))]) @ p.axes.T
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    entry = p.pinhole + d * ((-PLATE.thickness_mm - p.pinhole[2]) / d[:, 2:])
    # t = eta d + (eta cos_i - cos_t)(-z), here with the normal against the light: -z
    eta = 1 / PLATE.refractive_index
    cos_i = d[:, 2:]
    inside = eta * d + (np.sqrt(1 - eta**2 * (1 - cos_i**2)) - eta * cos_i) * np.array([0.0, 0.0, 1.0])
    hit = entry + inside * (PLATE.thickness_mm / inside[:, 2:])
    x, y = p.to_plate(u, v)
    np.testing.assert_allclose(np.column_stack([x, y]), hit[:, :2], atol=1e-9)


def test_light_takes_the_shortest_optical_path() -> None:
    # Fermat: the direction in which a plate point is seen is that of the stationary optical path.
    p = projection()
    for x, y in [(7.3, -3.1), (-9.0, 5.5), (2.1, -1.4)]:

        def path(at: np.ndarray, x: float = x, y: float = y) -> float:
            air = np.linalg.norm([*at - p.pinhole[:2], p.clearance])
            glass = np.linalg.norm([x - at[0], y - at[1], PLATE.thickness_mm])
            return float(air + PLATE.refractive_index * glass)

        best = minimize(path, [x, y], method="BFGS", options={"gtol": 1e-10}).x
        d = np.array([*best - p.pinhole[:2], p.clearance]) @ p.axes
        seen = p.plate_to_ray(np.array([x]), np.array([y]))
        # BFGS with numerical gradients leaves about sqrt(1e-16) of the path's curvature: 1e-6.
        np.testing.assert_allclose([seen[0][0], seen[1][0]], d[:2] / d[2], atol=3e-6)


@settings(deadline=None, max_examples=60)
@given(u=st.floats(0, 639), v=st.floats(0, 409), n=st.floats(1.0, 2.5), t=st.floats(0.1, 20.0))
def test_image_and_plate_are_inverse(u: float, v: float, n: float, t: float) -> None:
    plate = PLATE.model_copy(update={"refractive_index": n, "thickness_mm": t})
    p = Projection.of(ugly_camera(), plate)
    back = p.to_image(*p.to_plate(np.array([u]), np.array([v])))
    np.testing.assert_allclose([back[0][0], back[1][0]], [u, v], atol=1e-6)


def test_scale_on_the_axis_is_the_one_asked_for() -> None:
    camera = ugly_camera().model_copy(update={"tilt_x_deg": 0.0, "tilt_y_deg": 0.0})
    p = Projection.of(camera, PLATE)
    cx, cy = p.principal_point
    (x0, x1), (y0, y1) = p.to_plate(np.array([cx - 0.5, cx + 0.5]), np.array([cy, cy]))
    # Distortion and port add relative (0.5/f)^2 = 1e-7.
    assert 1 / np.hypot(x1 - x0, y1 - y0) == pytest.approx(17.3, rel=1e-6)
    assert ((x0 + x1) / 2, (y0 + y1) / 2) == pytest.approx(camera.centre_mm, abs=1e-3)


def test_ideal_view_covers_the_frame_and_maps_lead_to_the_same_plate_points() -> None:
    p = projection()
    view = p.ideal_view()
    map_x, map_y = p.ideal_maps(view)
    assert map_x.min() >= 1
    assert map_y.min() >= 1
    assert map_x.max() <= view.shape[1] - 2
    assert map_y.max() <= view.shape[0] - 2
    u, v = np.meshgrid(np.arange(p.shape[1]), np.arange(p.shape[0]))
    px, py = view.principal_point
    ideal = p.ray_to_plate((map_x - px) / view.focal_px, (map_y - py) / view.focal_px)
    direct = p.to_plate(u, v)
    # Maps are float32: 2^-15 px at 600 px, over 17.3 px/mm.
    np.testing.assert_allclose(ideal, direct, atol=2**-14 / 10)


def test_nothing_is_mirrored() -> None:
    p = Projection.of(Camera(scale_px_per_mm=20.0, resolution_px=(300, 200)), PLATE)
    x, y = p.to_plate(np.array([10.0, 200.0]), np.array([30.0, 150.0]))
    assert x[1] > x[0]
    assert y[1] > y[0]
