"""Lens: relative illumination, diffraction, defocus and distortion against closed forms and conservation of light."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import brentq
from scipy.special import j0, j1, jn_zeros

from evanesce.core.states import PlateLight
from evanesce.optics.projection import Projection
from evanesce.rig import Camera, Distortion, Plate
from evanesce.rig.camera import Lens, Pixel
from evanesce.sensor import lens as model

PLATE = Plate(size_mm=(120.0, 80.0), thickness_mm=5.3, refractive_index=1.471)
BARREL = Distortion(k1=-0.33, k2=0.08, p1=0.002, p2=-0.003)


def camera(distortion: Distortion = BARREL, **lens: float) -> Camera:
    return Camera(
        resolution_px=(302, 211),
        scale_px_per_mm=12.7,
        centre_mm=(1.3, -0.8),
        principal_point_offset_px=(9.0, -5.0),
        lens=Lens(focal_length_mm=1.3, f_number=2.3, transmittance=0.83, distortion=distortion, **lens),
        pixel=Pixel(pitch_um=3.7),
    )


def light_of(cam: Camera, radiance: np.ndarray | None = None) -> PlateLight:
    view = Projection.of(cam, PLATE).ideal_view()
    image = np.ones(view.shape) if radiance is None else radiance
    return PlateLight(
        radiance=image, variance=np.zeros_like(image), focal_px=view.focal_px, principal_point=view.principal_point
    )


# --- relative illumination -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("tangent", [(0.0, 0.0), (0.31, -0.17), (-0.52, 0.44)])
def test_irradiance_is_the_pupils_light(tangent: tuple[float, float]) -> None:
    """E dA_image = L integral over the pupil of cos^2/r^2 dA_object: radiometry from the object's side, by sum."""
    f, number, m, transmittance = 6.0, 40.0, 0.18, 0.8
    distance = f * (1 + 1 / m)
    step = f / number / 400
    a = np.arange(-f / number / 2 + step / 2, f / number / 2, step)
    px, py = np.meshgrid(a, a)
    inside = np.hypot(px, py) < f / number / 2
    x, y = distance * tangent[0], distance * tangent[1]
    r2 = (x - px[inside]) ** 2 + (y - py[inside]) ** 2 + distance**2
    flux = np.sum(distance**2 / r2**2) * step**2  # cos at object and pupil are both distance / r
    expected = transmittance * flux / m**2
    got = model.irradiance_per_radiance(*tangent, f_number=number, magnification=m, transmittance=transmittance)
    # The closed form is for a small pupil: relative (D / 2 z)^2 = 4e-6; the disc's rim adds 1/400 of a cell: 1e-3.
    assert float(got) == pytest.approx(expected, rel=1e-3)


@settings(deadline=None, max_examples=50)
@given(
    x=st.floats(-0.7, 0.7),
    y=st.floats(-0.7, 0.7),
    k=st.tuples(*[st.floats(-0.4, 0.4)] * 2, *[st.floats(-0.02, 0.02)] * 2, st.floats(-0.1, 0.1)),
)
def test_jacobian_is_the_derivative_of_distortion(x: float, y: float, k: tuple[float, ...]) -> None:
    from dataclasses import replace

    p = replace(Projection.of(camera(), PLATE), distortion=k)
    h = 1e-5
    (xr, xl), (yr, yl) = p.distort(np.array([x + h, x - h]), np.array([y, y]))
    (xd, xu), (yd, yu) = p.distort(np.array([x, x]), np.array([y + h, y - h]))
    difference = ((xr - xl) * (yd - yu) - (xd - xu) * (yr - yl)) / (4 * h * h)
    # Central differences: h^2 of the third derivative, and 1e-16/h of rounding.
    assert float(model.distortion_jacobian(x, y, k)) == pytest.approx(difference, abs=1e-7)


def test_distortion_moves_light_and_keeps_it() -> None:
    """A compact spot carries the same power with and without distortion, cos^4 being that of its own direction."""
    cam = camera()
    view = Projection.of(cam, PLATE).ideal_view()
    rows, cols = np.indices(view.shape)
    spot = np.exp(-0.5 * ((cols - 52.3) ** 2 + (rows - 47.9) ** 2) / 6.0**2)
    light = light_of(cam, spot)
    bent = model.form_image(light, cam, PLATE, blurred=False).irradiance.sum()
    straight = model.form_image(light, cam, PLATE, distortion=False, blurred=False).irradiance.sum()
    # Sampling a spot of 6 px (about 4 px where squeezed) is exact to exp(-2 (pi sigma)^2); 1/32 px steps of cv2.remap
    # displace the samples by up to 1/64 px at random, relative 1/64/4 each, averaged over some hundred pixels.
    assert bent == pytest.approx(straight, rel=1e-3)


def test_distorted_spot_lands_where_the_geometry_says() -> None:
    cam = camera()
    p = Projection.of(cam, PLATE)
    view = p.ideal_view()
    rows, cols = np.indices(view.shape)
    at = (61.4, 140.2)
    spot = np.exp(-0.5 * ((cols - at[0]) ** 2 + (rows - at[1]) ** 2) / 1.5**2)
    frame = model.form_image(light_of(cam, spot), cam, PLATE, blurred=False).irradiance
    px, py = view.principal_point
    xd, yd = p.distort((at[0] - px) / view.focal_px, (at[1] - py) / view.focal_px)
    expected = (xd * p.focal_px + p.principal_point[0], yd * p.focal_px + p.principal_point[1])
    v, u = np.indices(frame.shape)
    centroid = ((u * frame).sum() / frame.sum(), (v * frame).sum() / frame.sum())
    # sigma^2 times the map's second derivatives (2e-3 per px) gives 0.01 px; bilinear weights broaden by f(1 - f) of
    # the fraction f, which drifts over the spot: up to 1/8 px^2 over sigma on its flank, 0.02 px after averaging.
    assert centroid == pytest.approx(expected, abs=0.03)


def test_without_distortion_and_blur_the_frame_is_the_view_times_the_gain() -> None:
    cam = camera(Distortion())
    rng = np.random.default_rng(3)
    view = Projection.of(cam, PLATE).ideal_view()
    light = light_of(cam, rng.uniform(0.5, 2.0, view.shape))
    seen = model.form_image(light, cam, PLATE, blurred=False).irradiance
    flat = model.form_image(light_of(cam), cam, PLATE, blurred=False).irradiance
    px, py = view.principal_point
    cx, cy = Projection.of(cam, PLATE).principal_point
    row, col = round(py - cy), round(px - cx)
    np.testing.assert_array_equal(seen, light.radiance[row : row + 211, col : col + 302] * flat)


def test_vignetting_takes_its_share_at_the_farthest_corner_only() -> None:
    plain = model.form_image(light_of(camera()), camera(), PLATE, blurred=False).irradiance
    cam = camera(vignetting_k=0.37)
    lost = model.form_image(light_of(cam), cam, PLATE, blurred=False).irradiance / plain
    # The axis is moved right and up, so the farthest corner is bottom left.
    assert lost[-1, 0] == pytest.approx(1 - 0.37)
    assert lost[0, -1] > 1 - 0.37 * 0.95
    cy, cx = 105 - 5, round(150.5 + 9)
    assert lost[cy, cx] == pytest.approx(1.0, abs=1e-4)


def test_light_that_does_not_cover_the_frame_is_refused() -> None:
    light = light_of(camera())
    small = PlateLight(
        radiance=light.radiance[:100],
        variance=light.variance[:100],
        focal_px=light.focal_px,
        principal_point=light.principal_point,
    )
    with pytest.raises(ValueError, match="covers"):
        model.form_image(small, camera(), PLATE)


# --- point spread function -------------------------------------------------------------------------------------------


def test_airy_pattern() -> None:
    """First dark annulus at 1.22 lambda N and 83.8 % of the light inside it, from a kernel finer than the pattern."""
    wavelength, number = 0.55, 5.0
    airy = wavelength * number
    pitch = airy / 40
    kernel = model.psf_kernel(pitch_um=pitch, wavelength_um=wavelength, f_number=number, disc_um=0.0)
    half = kernel.shape[0] // 2
    profile = kernel[half, half:]
    zero = jn_zeros(1, 1)[0] / np.pi * airy  # 1.2197 lambda N
    minimum = np.argmin(profile[: int(1.6 * airy / pitch)]) * pitch
    assert minimum == pytest.approx(zero, abs=pitch)
    offset = np.arange(-half, half + 1) * pitch
    radius = np.hypot(offset[:, None], offset)
    for factor in (0.5, 1.0, 2.0):
        v = np.pi * factor * zero / airy
        inside = 1 - j0(v) ** 2 - j1(v) ** 2  # Rayleigh's encircled energy
        # What lies beyond the kernel (2.5 %) is spread evenly within its reach of 8 lambda N.
        folded = 0.025 * (factor * zero) ** 2 / (8 * airy) ** 2
        assert kernel[radius < factor * zero].sum() == pytest.approx(inside, abs=0.006 + folded)


@settings(deadline=None, max_examples=25)
@given(
    pitch=st.floats(0.8, 9.0),
    wavelength=st.floats(0.4, 1.0),
    number=st.floats(0.9, 20.0),
    disc=st.floats(0.0, 80.0),
)
def test_kernel_keeps_light_and_symmetry(pitch: float, wavelength: float, number: float, disc: float) -> None:
    kernel = model.psf_kernel(pitch_um=pitch, wavelength_um=wavelength, f_number=number, disc_um=disc)
    assert kernel.sum() == pytest.approx(1.0, abs=1e-12)
    assert kernel.min() >= 0
    np.testing.assert_allclose(kernel, kernel.T, atol=1e-13)
    np.testing.assert_allclose(kernel, kernel[::-1, ::-1], atol=1e-13)


def edge_of_disc(x: np.ndarray, diameter: float) -> np.ndarray:
    """Edge spread of a uniform disc: the area of its segments."""
    s = np.clip(2 * x / diameter, -1, 1)
    return 0.5 + (np.arcsin(s) + s * np.sqrt(1 - s * s)) / np.pi


def test_defocused_edge_is_that_of_the_geometric_disc() -> None:
    """An edge on the axis, 120 um off focus: the sum of the disc's segments, edge by edge pixel."""
    cam = camera(Distortion(), defocus_um=120.0)
    view = Projection.of(cam, PLATE).ideal_view()
    edge = round(view.principal_point[0])
    image = np.zeros(view.shape)
    image[:, edge:] = 1.0
    seen = model.form_image(light_of(cam, image), cam, PLATE).irradiance
    flat = model.form_image(light_of(cam), cam, PLATE).irradiance
    centre_row = 100
    relative = seen[centre_row] / flat[centre_row]
    m = 12.7 * 3.7e-3
    diameter = 120.0 / (2.3 * (1 + m)) / 3.7  # px
    shift = round(view.principal_point[0] - Projection.of(cam, PLATE).principal_point[0])
    u = np.arange(302) - (edge - shift - 0.5)
    # A pixel receives the mean of the edge over its width; light is spread from pixel centres, a second such width.
    t = (np.arange(40) + 0.5) / 40 - 0.5
    boxes = edge_of_disc(u[:, None, None] + t[:, None] + t, diameter).mean(axis=(1, 2))
    # Diffraction (Airy radius 1.6 um beside a disc of 50 um) and cos^4 over the disc: about a hundredth.
    np.testing.assert_allclose(relative[100:220], boxes[100:220], atol=0.012)
    width = np.interp(0.9, relative[100:220], u[100:220]) - np.interp(0.1, relative[100:220], u[100:220])
    closed = 2 * brentq(lambda s: edge_of_disc(np.array(s), diameter) - 0.9, 0, diameter / 2)
    assert width == pytest.approx(closed, rel=0.02)


def test_blur_of_a_compact_image_keeps_its_light_and_has_each_positions_width() -> None:
    """Field curvature: points spread by the disc of their own position; total light stays."""
    disc = np.linspace(2.0, 11.0, 181)[None, :] * np.ones((160, 1))

    def kernel_of(diameter: float) -> np.ndarray:
        return model.psf_kernel(pitch_um=3.0, wavelength_um=0.05, f_number=1.0, disc_um=3.0 * diameter)

    spread = model.field_blur(disc, kernel_of)
    for col in (31, 77, 144):
        image = np.zeros(disc.shape)
        image[83, col] = 3.7
        out = model.blur(image, spread)
        assert out.sum() == pytest.approx(3.7, rel=1e-12)
        v = np.arange(160) - 83
        variance = (out.sum(axis=1) * v**2).sum() / 3.7
        # A disc of diameter c has c^2/16 per axis, a receiving pixel 1/12. Beyond that the dim Airy pattern's tail
        # of lambda N = 1/60 px brings lambda N R/pi^2 inside the kernel's reach R of 4 to 6 px and as much again from
        # what is spread evenly within it (0.02), and sampling the disc's sharp rim J1(pi c)/c / 10 (0.005).
        assert variance == pytest.approx(disc[0, col] ** 2 / 16 + 1 / 12, abs=0.025)


def test_a_flat_field_stays_flat_at_the_border() -> None:
    cam = camera(Distortion(), defocus_um=-60.0)
    sharp = model.form_image(light_of(cam), cam, PLATE, blurred=False).irradiance
    soft = model.form_image(light_of(cam), cam, PLATE).irradiance
    # cos^4 is curved by less than 1e-4 per px^2 here; border pixels see its first derivative replicated.
    np.testing.assert_allclose(soft, sharp, rtol=0.01)


def test_corners_blur_more_with_field_curvature() -> None:
    cam = camera(defocus_um=10.0, field_curvature_um=150.0)
    view = Projection.of(cam, PLATE).ideal_view()
    widths = []
    for col in (round(view.principal_point[0]), 30):
        image = np.zeros(view.shape)
        image[round(view.principal_point[1]), col] = 1.0
        out = model.form_image(light_of(cam, image), cam, PLATE).irradiance
        v = np.arange(out.shape[0])
        profile = out.sum(axis=1) / out.sum()
        widths.append(np.sqrt((profile * v**2).sum() - (profile * v).sum() ** 2))
    assert widths[1] > 2 * widths[0]
