"""The critic of one photographed board: hidden effects found by name, nothing found in nothing, copied views told.

Photographs come from the twin's own chain (renderer, lens with a round disc of defocus, pixel noise, tone curve); the
critic blurs by a Gaussian, shades by r^2 or by a plane, and knows neither light nor focus.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from evanesce.criticism.photograph import criticise_photograph
from evanesce.criticism.photograph_light import LightModel, Photograph, binned_mean, prepare, read_photograph
from evanesce.criticism.photograph_page import views_words
from evanesce.criticism.photograph_tails import Inverse, Seen, fit_tail, law_of, local_level, log_density, seen_of
from evanesce.criticism.photograph_views import corner_noise, judge_views, photographed_views
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter, minimum_filter
from scipy.special import erf

from evanesce.chain.simulate import expose as take
from evanesce.evaluation.board_geometry import SENSOR_WIDTH_UM, FittedRig, PrintedBoard
from evanesce.measurement.calibration.board_lines import BoardLines
from evanesce.measurement.calibration.corners import CornerGrid
from evanesce.measurement.calibration.points import BoardView, read_points
from evanesce.measurement.calibration.saddle import SaddleFit
from evanesce.measurement.io.images import read_image
from evanesce.rig import Camera, load_scene
from evanesce.studies.twin.study import Light, _Studio

Array = NDArray[np.float64]
SIZE = (300, 230)
CURVE = "libcamera"


def camera(curved: float = 0.0) -> Camera:
    data = load_scene("thesis").camera.model_dump()
    data |= {
        "resolution_px": SIZE,
        "scale_px_per_mm": 13.7,
        "centre_mm": (0.31, -0.23),
        "principal_point_offset_px": (3.7, -5.2),
        "tilt_x_deg": 0.6,
        "tilt_y_deg": -0.4,
        "roll_deg": 3.1,
    }
    data["lens"]["distortion"] = {"k1": -0.31, "k2": 0.09, "p1": 0.0, "p2": 0.0, "k3": 0.0}
    pitch = SENSOR_WIDTH_UM / SIZE[0]
    disc = pitch * data["lens"]["f_number"]
    data["lens"] |= {"defocus_um": 1.7 * disc, "field_curvature_um": curved * disc}
    data["pixel"]["pitch_um"] = pitch
    return Camera.model_validate(data | {"tone_curve": CURVE})


def shot(*, curved: float = 0.0, slope: float = 0.0, specks: float = 0.0, seed: int = 3) -> Photograph:
    """A simulated photograph; corners are handed over with the error that a finder would make."""
    base = load_scene("thesis")
    nominal = np.arange(-16.0, 17.0)
    lines = BoardLines((nominal, nominal), (np.zeros(33), np.zeros(33)))
    rig = FittedRig(camera(curved), PrintedBoard(lines, np.zeros(2), 1.0012, 0.002, True, ink_mm=0.021))
    studio = _Studio(base, rig)
    even = studio.response / studio.response.max()
    x = np.linspace(-1.0, 1.0, SIZE[0])[None, :]
    shade = even * (1.0 + slope * np.sin(1.3 * x + 0.2))
    effects = {"specks": {"per_cm2": specks, "median_light_mm2": 2e-3}} if specks else {}
    scene = base.model_copy(update={"camera": rig.camera, "sources": {}, "assumptions": {}, "effects": effects})
    light = studio.radiance(Light(bright=0.17 * shade, dark=0.021 * shade), rig.board)
    frame = take(scene, light, seed=seed)[1].data.astype(float)
    return prepare(frame, corner_grid(rig, seed), base, CURVE)


def corner_grid(rig: FittedRig, seed: int) -> CornerGrid:
    plate = load_scene("thesis").plate
    index = np.array([(i, j) for i in range(-14, 15) for j in range(-14, 15)])
    place = rig.predict(plate, index.astype(float))
    inside = ((place > 4) & (place < np.array(SIZE) - 5)).all(axis=1)
    index, place = index[inside], place[inside]
    moved = place + np.random.default_rng(seed).normal(0.0, 0.03, place.shape)
    step = [rig.predict(plate, index + np.array(d)) - place for d in ((1.0, 0.0), (0.0, 1.0))]
    n, ones = len(index), np.ones(len(index))
    # index 0 must stay even for the polarity to hold: shifted by an even number
    shifted = index - 2 * (index.min(axis=0) // 2)
    sign = np.where(shifted.sum(axis=1) % 2 == 0, 1.0, -1.0)
    fit = SaddleFit(moved, np.ones((n, 2)), 60 * ones, 45 * sign, 0 * ones, np.tile(np.eye(2), (n, 1, 1)), ones, ones)
    return CornerGrid(shifted, fit, np.stack(step, axis=-1))


def named(found: Photograph) -> tuple[list[str], dict]:
    answer = criticise_photograph(found, seed=1)[0].answer
    return [effect["id"] for effect in answer["effects"]], answer


SHARP_EDGES = pytest.mark.xfail(
    reason="the twin's edges are drawn by a small disc; what the critic's Gaussian leaves there a tone curve takes up",
    strict=True,
)


@pytest.mark.slow
def test_the_real_photograph_shows_its_four_known_departures(rig_photo: Path) -> None:
    """Specks, focus that falls off, uneven light and the edge LEDs' reflections, each of them worth its name there."""
    picture = read_image(rig_photo / "checkerboard_1mm.png")
    photograph = read_photograph(picture.data, load_scene("thesis"), CURVE)
    found, bench = criticise_photograph(photograph)
    answer = found.answer
    names = {effect["id"] for effect in answer["effects"]}
    assert {"specks", "defocus", "led_edge_reflections"} <= names
    assert names & {"ambient_light", "vignetting", "uneven_light"}
    for cause in ("specks", "defocus", "led_edge_reflections"):
        assert answer["dropped"][cause]["loss"][1] > 0, cause
    assert answer["gain"]["log_score"][1] > 0
    views = photographed_views(photograph, read_points(rig_photo / "corners.csv"), bench.pixel_noise_DN)
    assert "12 views are 1" in views_words(views)


@pytest.mark.slow
@SHARP_EDGES
def test_nothing_is_found_in_a_photograph_of_the_believed_rig() -> None:
    ids, answer = named(shot())
    assert ids == []
    assert answer["verdict"] == "none"
    assert len({trial["id"] for trial in answer["ranking"]}) >= 12, "every candidate has been tried"
    assert answer["gain"]["log_score"][0] == 0.0


@pytest.mark.slow
def test_defocus_towards_the_corners_and_uneven_light_are_found() -> None:
    ids, answer = named(shot(curved=9.0, slope=0.18))
    assert "defocus" in ids
    assert {"ambient_light", "uneven_light", "vignetting"} & set(ids)
    assert not {"hot_pixels", "sensor_dust", "specks"} & set(ids)
    value, low, high = answer["gain"]["log_score"]
    assert 0 < low < value < high
    assert answer["gain"]["rmse_dn"][1] < 0.6 * answer["gain"]["rmse_dn"][0]
    assert answer["dropped"]["defocus"]["loss"][1] > 0, "without it the locked blocks lose"
    assert any("180 degrees" in shot["what"] for shot in answer["next_measurement"])


@pytest.mark.slow
def test_specks_are_found_where_specks_are_hidden() -> None:
    ids, answer = named(shot(specks=350.0))
    assert "specks" in ids
    assert answer["dropped"]["specks"]["loss"][1] > 0
    assert not {"hot_pixels", "sensor_dust"} & set(ids)
    losses = {name: entry["loss"][0] for name, entry in answer["dropped"].items()}
    assert max(losses, key=lambda name: losses[name]) == "specks"


@pytest.mark.slow
@SHARP_EDGES
def test_specks_alone_are_found_alone() -> None:
    ids, _ = named(shot(specks=350.0))
    assert not {"defocus", "uneven_light"} & set(ids)


def test_a_smooth_misfit_is_no_point_and_a_point_stands_out() -> None:
    """A slope of light that no model has, and two points on it; a third lies where it must not be looked at."""
    rows, cols = np.mgrid[:40, :50].astype(float)
    residual = 30.0 * np.exp(cols / 40.0) + 5.0 * np.sin(rows / 9.0)
    points = {(11, 17): 60.0, (30, 8): 25.0}
    for place, height in points.items():
        residual[place] += height
    which = np.ones(residual.shape, bool)
    which[:, 40:] = False
    residual[5, 41] = 1e6
    left = residual - local_level(residual, which)
    for place, height in points.items():
        assert left[place] == pytest.approx(height, abs=1.0)
    quiet = which.copy()
    quiet[:, :3] = quiet[:, 37:] = quiet[:3] = quiet[-3:] = False
    for place in points:
        quiet[place] = False
    assert np.abs(left[quiet]).max() < 1.0
    assert (local_level(residual, np.zeros(residual.shape, bool)) == 0.0).all()


def test_bins_lie_in_one_block_and_never_in_both_halves() -> None:
    one = shot()
    assert not (one.opened & one.locked).any()
    for name in np.unique(one.block[one.block >= 0]):
        halves = np.unique(one.locked[one.block == name])
        assert halves.size == 1
    assert 0.4 < one.locked.sum() / (one.block >= 0).sum() < 0.6


def test_the_light_model_is_the_chains_own_where_nothing_is_wrong() -> None:
    """Against the simulated frame itself: what is left is its noise, as measured between two exposures."""
    one, again = shot(seed=3), shot(seed=4)
    from evanesce.criticism.photograph_fit import NUISANCES, Bench

    bench = Bench(one)
    fit = bench.fit((), NUISANCES, bench.start, ())
    mean = bench.model(fit.values)
    # away from edges, where the error of the corners adds
    even = one.opened & (maximum_filter(mean, 7) - minimum_filter(mean, 7) < 4.0)
    noise = (one.data - again.data)[even].std() / np.sqrt(2)
    left = (one.data - mean)[even]
    assert fit.values["light.bright"] == pytest.approx(0.17, rel=0.02)
    assert fit.values["light.dark"] == pytest.approx(0.021, rel=0.05)
    assert fit.values["print.ink_mm"] == pytest.approx(0.021, abs=0.006)
    assert even.sum() > 1000
    assert left.std() < 1.5 * noise


def test_binning_keeps_means() -> None:
    image = np.arange(7 * 11, dtype=float).reshape(7, 11) ** 1.3
    assert binned_mean(image, 3).shape == (2, 3)
    assert binned_mean(image, 3)[1, 2] == pytest.approx(image[3:6, 6:9].mean())


def toy(n: int, rng: np.random.Generator) -> tuple[Seen, Array]:
    """Pixels of one level under a linear curve, a known share of them with exponential extra light."""
    deviation, level, share, mean = 1.7, 40.0, 0.013, 0.11
    hit = rng.random(n) < share
    residual = deviation * rng.standard_t(4, n) + np.where(hit, 255 * mean * rng.standard_exponential(n), 0.0)
    data = (level + residual)[None]
    inverse = Inverse.of(np.clip(data, 0, 255), "linear")
    seen = seen_of(data, np.full_like(data, level), np.full_like(data, deviation), inverse, np.arange(n))
    return seen, np.array([share, mean])


def test_hot_pixels_come_back_with_their_share_and_strength() -> None:
    seen, (share, mean) = toy(60_000, np.random.default_rng(8))
    tail = fit_tail("hot_pixels", seen, (), {"hot_pixels": law_of("hot_pixels", None, {})})  # type: ignore[arg-type]
    weight = float(tail.weight(seen)[0])
    n_hit = 60_000 * share
    share *= np.exp(-3 * 1.7 / 255 / mean)  # those above the cut; the others are the core's
    assert weight == pytest.approx(share, abs=4 * share / np.sqrt(n_hit) + 0.05 * share)
    # faint ones below the cut count as none, so that the law comes out brighter than it is, never fainter
    assert 1 - 4 / np.sqrt(n_hit) < np.exp(tail.theta[2]) / mean < 1.2 + 4 / np.sqrt(n_hit)


def test_runs_of_departed_pixels_begin_somewhere() -> None:
    """Only the second pixel of each pair stands out by the law: the first ones may not be none for that."""
    rng = np.random.default_rng(4)
    n, deviation, level = 30_000, 1.7, 40.0
    residual = deviation * rng.standard_t(4, n)
    beside = np.zeros(n, bool)
    beside[rng.choice(n, 600, replace=False)] = True
    residual[beside] += 255 * 0.1
    inverse = Inverse.of(np.clip(level + residual, 0, 255)[None], "linear")
    seen = replace(
        seen_of((level + residual)[None], np.full((1, n), level), np.full((1, n), deviation), inverse, np.arange(n)),
        neighbour_high=beside,
    )

    def law(of: Seen, own: Array) -> Array:
        z = (np.log(np.maximum(of.excess, 1e-12)) - np.log(0.1)) / 0.2
        return np.where(of.excess > 0, np.exp(-0.5 * z * z) / (0.2 * np.sqrt(2 * np.pi)) / of.excess * of.slope, 0.0)

    first, second = (1.0 / (1.0 + np.exp(-t)) for t in fit_tail("specks", seen, (), {"specks": law}).theta[:2])
    assert second > 0.9
    # 600 that are beside another one, in runs of eight at most: 75 begin one.
    assert 70 / n < first < 200 / n


def test_a_density_with_a_tail_is_one_in_all() -> None:
    """Integrated over the grey values by the trapezium rule."""
    grey = np.linspace(0.02, 254.98, 40_001)
    n, level, deviation = grey.size, 40.0, 1.7
    inverse = Inverse.of(grey[None], "linear")
    flat = np.zeros(n, dtype=bool)
    seen = Seen(
        grey - level, np.full(n, deviation), (grey - level) / 255, np.full(n, level / 255), inverse.slope[0], flat, flat
    )
    from evanesce.criticism.photograph_tails import Tail

    tail = Tail("hot_pixels", np.array([-2.0, -2.0, np.log(0.05)]))
    density = np.exp(log_density(seen, (tail,), {"hot_pixels": law_of("hot_pixels", None, {})}))  # type: ignore[arg-type]
    lost = 1 / (1 + np.exp(2.0)) * (1 - np.exp(-3 * deviation / 255 / 0.05))  # below the cut the tail counts as nothing
    assert np.trapezoid(density, grey) == pytest.approx(1 - lost, abs=2e-3)


def views(noise: float, shift: float = 0.0) -> list[BoardView]:
    """Three views of one board by an exact pinhole that looks straight down, 41 mm away."""
    world = np.array([(i, j) for i in range(23) for j in range(17)], dtype=float)
    image = world * 612.0 / 41.0 + (37.0, 29.0)
    rng = np.random.default_rng(2)
    return [
        BoardView(str(k), world, image + k * shift + (rng.normal(0, noise, image.shape) if noise else 0.0))
        for k in range(3)
    ]


@pytest.mark.parametrize(
    ("noise", "shift", "verdict", "distinct"),
    [(0.0, 0.0, "identical", 1), (0.012, 0.0, "still", 1), (0.012, 3.1, "different", 3)],
)
def test_views_are_called_identical_only_where_they_are(
    noise: float, shift: float, verdict: str, distinct: int
) -> None:
    found = judge_views(views(noise, shift), (420, 320), 500.0, 0.012)
    assert (found["verdict"], found["distinct"]) == (verdict, distinct)


def test_one_straight_view_leaves_focal_length_and_distance_free() -> None:
    """A pinhole that looks straight down: f/Z is all that shows, so each focal length fits with its own distance."""
    single = judge_views(views(0.0), (420, 320), 500.0, 0.02)["single_view"]
    assert single["condition"] > 1e4
    assert {"focal length", "distance"} <= set(single["weakest"])
    for tried in single["profile"]:
        assert tried["rms_px"] < 1e-3
        assert tried["distance_mm"] == pytest.approx(tried["focal_px"] * 41.0 / 612.0, rel=1e-3)
    assert single["rectification_rms_px"] < 1e-3


def test_noise_of_a_corner_is_that_of_the_best_estimator() -> None:
    """Information of a shift, summed numerically over a window of two blurred edges."""
    a, sigma, half, noise = 43.0, 1.3, 11.0, 2.1
    fine = (np.arange(-440, 441) / 40.0)[:, None]

    def cross(dx: float) -> Array:
        return a * erf((fine.T - dx) / (np.sqrt(2) * sigma)) * erf(fine / (np.sqrt(2) * sigma))

    slope = (cross(0.01) - cross(-0.01)) / 0.02
    information = (slope**2).sum() / 40.0**2
    pitch = 2 * half / 0.84
    ones = np.ones(1)
    fit = SaddleFit(np.zeros((1, 2)), np.full((1, 2), sigma), 0 * ones, a * ones, 0 * ones, np.eye(2)[None], ones, ones)
    found = corner_noise(fit, pitch * np.eye(2)[None], noise)
    assert found == pytest.approx(noise / np.sqrt(information), rel=0.01)


def test_blur_towards_the_corners_leaves_the_axis_alone() -> None:
    one = shot()
    model = LightModel(replace(one))
    plain = {"light.bright": 0.15, "light.dark": 0.02, "lens.blur_px": 0.9, "print.ink_mm": 0.0}
    rows, cols = one.data.shape
    change = np.abs(model({**plain, "defocus.corner_blur_um": 30.0}) - model(plain))
    middle = change[rows // 2 - 8 : rows // 2 + 8, cols // 2 - 8 : cols // 2 + 8].max()
    assert middle < 0.1 * change[4:28, 4:28].max()
