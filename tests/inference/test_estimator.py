"""The refined estimator against closed forms: ellipses of known area, blurred, uneven, scattering, saturated."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy.integrate import quad
from scipy.special import j0, ndtr

from evanesce.core.errors import InputError
from evanesce.core.states import Frame
from evanesce.measurement.calibration.model import Calibration
from evanesce.measurement.io.frames import open_frames
from evanesce.measurement.refined.edge import Boundary, edge_spread, half_contours
from evanesce.measurement.refined.estimator import Estimator, refined_measured
from evanesce.measurement.refined.light import Radiometry, tone_table
from evanesce.measurement.refined.plate import PlateMap
from evanesce.measurement.refined.subsurface import Scattering, entered, find_scattering, profile_transform, spread
from evanesce.measurement.uncertainty.area import refined_uncertainty
from evanesce.measurement.warnings import EdgeLog
from evanesce.optics.subsurface import profile_kernel, profile_scale
from evanesce.sensor.codec import VideoWriter
from evanesce.sensor.tone import CURVES, undevelop

SHAPE = (331, 412)
SCALE_PX_PER_MM = 41.3
BLUR_PX = 1.17


def uniform_calibration(**details) -> Calibration:
    """Return a camera without distortion."""
    rows, cols = SHAPE
    return Calibration(
        image_size=(cols, rows),
        camera_matrix=np.array([[900.0, 0, cols / 2], [0, 900.0, rows / 2], [0, 0, 1]]),
        distortion=np.zeros(5),
        mm2_per_px=SCALE_PX_PER_MM**-2,
        details={"tone_curve": "bt709"} | details,
    )


def ellipse(a: float, b: float, middle: tuple[float, float], turn: float, fine: int = 8) -> np.ndarray:
    """Return the share of each pixel inside an ellipse with half-axes [px], by sub-sampling."""
    rows, cols = SHAPE
    offset = (np.arange(fine) + 0.5) / fine - 0.5
    y = (np.arange(rows)[:, None] + offset).ravel()[:, None] - middle[1]
    x = (np.arange(cols)[:, None] + offset).ravel()[None, :] - middle[0]
    along, across = x * np.cos(turn) + y * np.sin(turn), y * np.cos(turn) - x * np.sin(turn)
    inside = ((along / a) ** 2 + (across / b) ** 2 < 1).astype(np.float32)
    return cv2.resize(inside, (cols, rows), interpolation=cv2.INTER_AREA).astype(float)


def developed(light: np.ndarray, seed: int, noise: float = 0.006) -> np.ndarray:
    """Return an 8-bit frame of linear light."""
    rng = np.random.default_rng(seed)
    noisy = np.clip(light + noise * rng.standard_normal(light.shape) * np.sqrt(np.clip(light, 0, 1) + 0.01), 0, 1)
    return np.floor(255 * CURVES["bt709"](noisy) + 0.5).astype(np.uint8)


def sloping(share: np.ndarray, inside: float, outside: float) -> np.ndarray:
    """Return blurred light with a level that changes by a third over the frame, inside and beside the contact."""
    rows, cols = SHAPE
    field = 1 + 0.33 * (np.arange(cols)[None, :] / cols - 0.5) - 0.1 * (np.arange(rows)[:, None] / rows - 0.5)
    return cv2.GaussianBlur(field * (outside + (inside - outside) * share), (0, 0), BLUR_PX)


@pytest.mark.parametrize("level", [0.06, 0.45])
def test_area_of_a_blurred_unevenly_lit_ellipse(level):
    """Rationale: blur, level and slope must not move the boundary. A 0.02 px error of it is 0.05 % here."""
    a, b = 93.4, 61.7
    frame = developed(sloping(ellipse(a, b, (187.3, 151.8), 0.4), level, 0.04 * level), 3, noise=0.004)
    found = Estimator.of(uniform_calibration()).area(frame)
    true = np.pi * a * b / SCALE_PX_PER_MM**2
    assert found.area_mm2 == pytest.approx(true, rel=1e-3)
    perimeter = 4 * a * quad(lambda t: np.sqrt(1 - (1 - (b / a) ** 2) * np.sin(t) ** 2), 0, np.pi / 2)[0]
    assert found.perimeter_mm == pytest.approx(perimeter / SCALE_PX_PER_MM, rel=0.03)
    assert found.islands == 1
    assert found.saturated_pixels == 0


def test_holes_are_taken_off_and_specks_dropped():
    """An annulus and a speck: only the annulus counts."""
    ring = ellipse(90.2, 80.4, (170.6, 160.2), 0.0) - ellipse(40.3, 31.1, (181.4, 150.7), 0.9)
    speck = ellipse(4.1, 3.7, (350.2, 300.9), 0.0)
    found = Estimator.of(uniform_calibration()).area(developed(sloping(ring + speck, 0.4, 0.01), 5))
    true = np.pi * (90.2 * 80.4 - 40.3 * 31.1) / SCALE_PX_PER_MM**2
    assert found.area_mm2 == pytest.approx(true, rel=2e-3)
    assert found.dropped == 1


@pytest.mark.parametrize("over", [1.3, 2.3])
def test_saturated_contact(over):
    """What is over the top is cut off; its foot must tell the edge to a quarter of a pixel, 0.6 % of this area."""
    share = ellipse(93.4, 71.7, (187.3, 151.8), 0.4)
    light = cv2.GaussianBlur(over * share, (0, 0), BLUR_PX)
    found = Estimator.of(uniform_calibration(), blur_px=BLUR_PX).area(developed(light, 7, noise=0.003))
    assert found.saturated_pixels > 15_000
    assert found.area_mm2 == pytest.approx(np.pi * 93.4 * 71.7 / SCALE_PX_PER_MM**2, rel=6e-3)


def test_nothing_in_touch():
    """A dark frame has no area, and so has one with a few specks."""
    estimator = Estimator.of(uniform_calibration())
    assert estimator.area(developed(np.full(SHAPE, 0.002), 1)).area_mm2 == 0.0
    assert estimator.area(developed(0.5 * ellipse(3.2, 2.7, (77.7, 190.2), 0.3), 2)).area_mm2 == 0.0


def test_transform_of_the_profile_is_its_hankel_transform():
    """The closed form against numerical integration of the profile itself."""
    d = 3.7

    def ring(r: float, q: float) -> float:
        return (np.exp(-r / d) + np.exp(-r / (3 * d))) / (4 * d) * j0(q * r)

    for q in (0.03, 0.2, 1.1):
        numeric = quad(ring, 0, 60 * d, args=(q,), limit=800)[0]
        assert profile_transform(np.array(q), d) == pytest.approx(numeric, rel=1e-6)


def test_entered_and_spread_are_inverse():
    share = ellipse(60.2, 40.4, (170.6, 160.2), 0.2)
    scattering = Scattering(9.0, 0.3)
    there = spread(share, scattering, 0.0)
    assert there[160, 280] > 0.01  # it does spread
    np.testing.assert_allclose(entered(there, scattering, 0.0), share, atol=0.02)


def test_contact_is_separated_from_scattered_light():
    """Rationale: light by a kernel in real space; two ridges 20 px wide with a bright groove between."""
    length, albedo, cell = 0.4, 0.6, 1 / SCALE_PX_PER_MM
    ridges = ellipse(70.3, 10.6, (190.2, 140.4), 0.25) + ellipse(80.8, 11.3, (196.7, 170.9), 0.25)
    kernel = profile_kernel(albedo, length, cell, 150)
    light = np.zeros(SHAPE)
    for _ in range(25):  # an open surface returns 0.55 inside, contact 0.05
        inside = 0.05 * ridges + 0.55 * (1 - ridges)
        light = cv2.filter2D(ridges + inside * light, cv2.CV_64F, kernel, borderType=cv2.BORDER_CONSTANT)
    frame = developed(cv2.GaussianBlur(0.6 * light / light.max(), (0, 0), BLUR_PX), 11, noise=0.004)
    found = Estimator.of(uniform_calibration()).area(frame)
    true = np.pi * (70.3 * 10.6 + 80.8 * 11.3) / SCALE_PX_PER_MM**2
    assert found.area_mm2 == pytest.approx(true, rel=0.03)
    # length and return trade against each other in so small a field; the order of magnitude is what they must have
    assert 0.4 < found.scattering.length_px / (profile_scale(albedo, length) / cell) < 2.5
    plain = Estimator.of(uniform_calibration(), scattering=Scattering()).area(frame)
    assert abs(plain.area_mm2 / true - 1) > 0.05


def test_scattering_that_is_found_is_the_least_across_the_valley():
    """Length and return trade against each other: no pair of a grid leaves less light than that found."""
    true, shape, radius = Scattering(25.2, 0.08), (641, 667), 63.4  # so wide that the light has died away at the border
    rng = np.random.default_rng(5)
    y, x = np.mgrid[: shape[0], : shape[1]]
    outside = np.hypot(x - 331.3, y - 318.8) - radius
    light = 0.3 * spread(np.clip(0.5 - outside, 0.0, 1.0), true, BLUR_PX) + rng.normal(0.0, 0.0015, shape)
    found = find_scattering(light, outside < 0, reach_px=200.0)
    around, within = (outside > 8) & (outside < 190), outside < -6

    def left(scattering: Scattering) -> float:
        source = entered(light, scattering, 4.0)
        return float(np.sqrt((source[around] ** 2).mean()) / source[within].mean())

    least = min(
        left(Scattering(length, back)) for length in (17.0, 20.0, 23.0, 26.0) for back in (0.0, 0.1, 0.2, 0.3, 0.4)
    )
    assert left(found) < 1.06 * least  # the search itself sees a reduced frame, whose noise weighs a little otherwise
    assert left(found) < 0.2 * left(Scattering())


def test_saturated_area_under_scattered_light_states_what_it_cannot_see():
    """What saturation hides is reported, and its interval is wider and holds the truth."""
    share, scattering = ellipse(93.4, 81.7, (171.3, 158.8), 0.4), Scattering(6.2, 0.08)
    light = spread(share, scattering, BLUR_PX)
    estimator = Estimator.of(uniform_calibration(), scattering=scattering)
    true = np.pi * 93.4 * 81.7 / SCALE_PX_PER_MM**2
    widths = {}
    for over, unseen in ((0.5, ""), (4.0, "modelled")):
        found = estimator.area(developed(over * light / light.max(), 3, noise=0.003))
        assert found.unseen == unseen
        low, high = refined_uncertainty(found, estimator, np.random.default_rng(1), finger="smooth").interval_mm2
        assert low < true < high
        widths[unseen] = high - low
    assert widths["modelled"] > 1.3 * widths[""]


@pytest.mark.parametrize("curve", ["linear", "bt709", "srgb"])
def test_tone_tables_undo_the_sensors_curves(curve):
    np.testing.assert_allclose(tone_table(curve), undevelop(np.arange(256, dtype=np.uint8), curve=curve), atol=3e-5)


def test_dark_and_flat_shots():
    """Radiometry gives back the light that was put in."""
    rng = np.random.default_rng(4)
    light = rng.uniform(0.1, 0.4, (20, 30))
    dark, flat = np.full((20, 30), 0.02), np.tile(np.linspace(0.7, 1.3, 30), (20, 1))
    shot = np.floor(255 * (light * flat + dark) + 0.5).astype(np.uint8)
    shots = [np.floor(255 * x + 0.5).astype(np.uint8) for x in (dark, 0.5 * flat + dark)]
    radiometry = Radiometry.of({"tone_curve": "linear"}, shots[:1], shots[1:])
    np.testing.assert_allclose(radiometry.light(shot)[0], light, atol=0.02)


@pytest.mark.parametrize(
    ("make", "part"),
    [
        (lambda: tone_table("film"), "tone_curve"),
        (lambda: tone_table([0.0, 1.0]), "tone_curve"),
        (lambda: tone_table(list(np.linspace(1, 0, 256))), "tone_curve"),
        (lambda: Radiometry.of({}, [np.zeros((3, 4), np.uint8), np.zeros((4, 4), np.uint8)]), "dark"),
        (lambda: Radiometry.of({}, [], [np.zeros((3, 4), np.uint8)]), "flat"),
        (lambda: Estimator.of(uniform_calibration()).area(np.zeros((9, 9), np.uint8)), "--calibration"),
        (lambda: PlateMap.of(uniform_calibration(corners=[{"view": 1}])), "corners"),
    ],
)
def test_bad_input_names_its_key(make, part):
    with pytest.raises(InputError, match=part):
        make()


def test_crop_and_colour_leave_the_area():
    share = ellipse(60.4, 51.7, (180.3, 150.8), 0.4)
    frame = developed(sloping(share, 0.4, 0.01), 3)
    plain = Estimator.of(uniform_calibration())
    coloured = np.repeat(frame[..., None], 3, axis=2)
    assert plain.area(coloured).area_mm2 == pytest.approx(plain.area(frame).area_mm2, rel=1e-9)
    found = plain.area(frame)
    measured = refined_measured(Frame(data=frame, index=4), found, plain)
    assert measured.estimate.area == found.area_mm2
    assert measured.estimate.pixels == pytest.approx(np.pi * 60.4 * 51.7, rel=0.01)


def test_width_of_an_edge_that_is_softer_on_one_side():
    """Closed form: one edge of a square is softer, so that the mean width exceeds the median by a quarter of the
    difference, whatever the blur that all edges share. Edges run through pixels' centres, where a slope is the
    difference of the neighbours, ndtr(1 / sigma) - ndtr(-1 / sigma) over two pixels."""
    rows, cols, half = 261, 277, 70
    y, x = np.mgrid[:rows, :cols] - np.array([131, 138])[:, None, None]
    for sharp, soft in ((1.1, 1.9), (1.4, 2.0)):
        sigma = np.where(x > half - 20, soft, sharp)
        level = ndtr((half - np.abs(x)) / sigma) * ndtr((half - np.abs(y)) / sharp)
        found = edge_spread(Boundary(contours=half_contours(level), level=level, step=np.ones_like(level)))
        narrow, wide = (2 / (ndtr(1 / s) - ndtr(-1 / s)) for s in (sharp, soft))
        assert found == pytest.approx(0.25 * (wide - narrow), rel=0.05)  # corners
    even = ndtr((half - np.hypot(x, y)) / 1.3)
    assert (
        abs(edge_spread(Boundary(contours=half_contours(even), level=even, step=np.ones_like(even)))) < 0.05
    )  # of 3.3 px


def test_frames_whose_edge_saturation_hides_are_named():
    """Two of four frames, one of them under scattered light; none, no warning."""
    log = EdgeLog()
    for index, unseen in ((3, ""), (4, "top"), (5, "modelled"), (6, "")):
        log.add(index, unseen)
    (found,) = log.warnings(4)
    assert found.code == "saturated_edge"
    assert "2 of 4 frame(s), first 4, in 1 of them under scattered light" in found.text
    assert EdgeLog().warnings(4) == []
    blind = EdgeLog(blur_known=False)
    assert blind.warnings(4) == []
    blind.add(7, "top")
    assert [warning.code for warning in blind.warnings(4)] == ["saturated_edge", "blur_not_known"]


@pytest.mark.parametrize(
    "quality", [pytest.param(18, marks=pytest.mark.slow), 28, pytest.param(33, marks=pytest.mark.slow)]
)
def test_a_codec_moves_the_boundary_by_less_than_the_budget_allows(quality, tmp_path):
    """H.264 of six frames with noise of their own, 0.1 px allowed: the mean over the frames, to a few thousandths."""
    shape = (332, 412)  # H.264 takes even sizes only
    share = np.vstack([ellipse(93.4, 71.7, (187.3, 151.8), 0.4), np.zeros((1, 412))])
    light = cv2.GaussianBlur(0.03 + 0.5 * share, (0, 0), BLUR_PX)
    frames = [developed(light, seed, noise=0.01) for seed in range(6)]
    with VideoWriter(tmp_path / "film.mp4", codec="h264", quality=quality) as film:
        for k, frame in enumerate(frames):
            film.add(Frame(data=frame, time=k / 30.0, index=k))
    decoded = [frame.data for frame in open_frames(tmp_path / "film.mp4")]
    assert len(decoded) == 6
    calibration = replace(uniform_calibration(), image_size=shape[::-1])
    estimator = Estimator.of(calibration)
    found = [[estimator.area(image) for image in images] for images in (frames, decoded)]
    # the boundary's own area: what the search loses of a sharp contact is corrected afterwards
    before, after = (np.mean([f.area_mm2 * (1 + f.shape_gain) for f in some]) for some in found)
    perimeter = np.mean([f.perimeter_mm for f in found[0]])
    assert abs(after - before) / perimeter * SCALE_PX_PER_MM < 0.1
