"""Places that the data choose: which bins make a list, what the choice costs, and effects that carry such lists."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import fields
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from evanesce.core.errors import InputError
from evanesce.core.states import PlateLight, SensorLight
from evanesce.criticism.blots import MOVES, STRIPED, brightest_blot, left_of_spot
from evanesce.criticism.extend import Extension
from evanesce.criticism.lines import brightest_line
from evanesce.criticism.marks import BESIDE, cells, left_at_places, left_beside, standing_out, without_places
from evanesce.effects import Context, active_effects, all_effects
from evanesce.prediction.candidates import candidates_of
from evanesce.prediction.linear import Metric
from evanesce.prediction.predict import Predictor
from evanesce.prediction.views import BIN_PX, View, binned
from evanesce.render.fast.defects import contact_radiance, pixel_area, view_position
from evanesce.rig import Scene, load_scene

VIEWS, ROWS, COLS = 7, 41, 53


def scene(**more: object) -> Scene:
    tilted = {"camera.tilt_x_deg": 1.1, "camera.principal_point_offset_px": [7.3, -4.1]}
    return load_scene("thesis", {"camera.resolution_px": [208, 164], "camera.scale_px_per_mm": 7.3, **tilted, **more})


def acted(name: str, value: object, of: Scene, **parameters: object) -> object:
    effect = all_effects()[name]
    return effect.apply(value, effect.parameters(**parameters), Context(of, 3))


# --- which bins ------------------------------------------------------------------------------------------------------


def planted(rng: np.random.Generator, strength: float, places: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return unit noise with marks that go with a template, the template, and the numbers of the marked bins."""
    template = rng.uniform(0.05, 1.0, VIEWS)[:, None, None] * rng.uniform(0.5, 2.0, (1, ROWS, COLS))
    residual = rng.standard_normal((VIEWS, ROWS, COLS))
    bins = rng.choice(ROWS * COLS, places, replace=False)
    row, col = np.unravel_index(bins, (ROWS, COLS))
    own = template[:, row, col]
    residual[:, row, col] += strength * own / np.linalg.norm(own, axis=0)
    return residual, template, bins


def test_noise_alone_lists_hardly_ever_a_place() -> None:
    """A bin counts beyond 4.3 standard deviations: of 300 x 2173 bins 5 do in white noise; 14 is beyond 4 of 5."""
    rng, listed = np.random.default_rng(5), 0
    for _ in range(300):
        residual, template, _ = planted(rng, 0.0, 1)
        listed += standing_out(residual, template).bins.size
    assert listed <= 14


def test_marks_of_eight_deviations_are_listed_with_their_amounts() -> None:
    rng = np.random.default_rng(11)
    residual, template, bins = planted(rng, 8.0, 23)
    found = standing_out(residual, template)
    assert set(found.bins) <= set(bins)
    assert len(found.bins) >= 22
    row, col = np.unravel_index(found.bins, (ROWS, COLS))
    own = np.linalg.norm(template[:, row, col], axis=0)
    # One amount is known to one over its template's length.
    assert np.abs(found.amounts * own - 8.0).max() < 4.0
    # Each place costs the choice among all bins and an amount of its own size: log(2173) + log(1 + z^2)/2.
    square = np.square(found.amounts * own)
    assert found.penalty == pytest.approx(np.sum(math.log(ROWS * COLS) + 0.5 * np.log1p(square)), rel=1e-9)


def test_a_codecs_errors_which_stand_out_to_both_sides_are_no_marks() -> None:
    """The same heavy-tailed field in every view. Marks beyond it are still listed, and little else."""
    rng = np.random.default_rng(23)
    residual, template, _ = planted(rng, 0.0, 0)
    residual = residual + 2.0 * rng.standard_t(3.0, residual.shape[1:])[None]
    assert standing_out(residual, template).bins.size > 20
    assert standing_out(residual, template, codec=True).bins.size <= 2
    marked = rng.choice(template[0].size, 30, replace=False)
    size = 60.0 / np.sqrt((template**2).sum(axis=0)).ravel()[marked]
    extra = np.zeros(template[0].size)
    extra[marked] = size
    found = standing_out(residual + template * extra.reshape(template[0].shape), template, codec=True)
    assert np.isin(marked, found.bins).sum() >= 26
    assert (~np.isin(found.bins, marked)).sum() <= 4


def test_where_a_codec_left_no_noise_places_are_not_judged() -> None:
    """Rationale: blots that H.264 at a low rate makes stay; nulls were named ``sensor_dust`` with 33 nats."""
    found = without_places(candidates_of(load_scene("thesis"), {"press", "replicates", "led_off", "lens_cap"}))
    told = {c.id for c in found if "no noise" in c.unseen}
    assert told == {"specks", "hot_pixels", "sensor_dust", "scratch"}


def test_a_mark_of_another_kind_explains_less() -> None:
    """Rationale: what tells marks apart is how they go from view to view."""
    rng = np.random.default_rng(17)
    residual, template, bins = planted(rng, 12.0, 9)
    other = template[::-1] ** 2
    right, wrong = standing_out(residual, template), standing_out(residual, other)

    def explained(chosen: object, by: np.ndarray) -> float:
        row, col = np.unravel_index(chosen.bins, (ROWS, COLS))
        return float(sum(a**2 * (by[:, r, c] ** 2).sum() for a, r, c in zip(chosen.amounts, row, col, strict=True)))

    assert set(right.bins) == set(bins)
    assert explained(right, template) > 1.3 * explained(wrong, other)


def test_what_takes_away_light_is_no_mark_that_brings_it() -> None:
    rng = np.random.default_rng(23)
    residual, template, _ = planted(rng, -9.0, 12)
    assert standing_out(residual, template).bins.size == 0


# --- lines -----------------------------------------------------------------------------------------------------------


def drawn_line(ends: tuple[tuple[float, float], tuple[float, float]]) -> np.ndarray:
    """Return the share (rows, cols) of a line's points in each bin, by counting a great many of them."""
    (u0, v0), (u1, v1) = ends
    t = (np.arange(20000) + 0.5) / 20000
    bins = np.round(v0 + t * (v1 - v0)).astype(int) * COLS + np.round(u0 + t * (u1 - u0)).astype(int)
    return np.bincount(bins, minlength=ROWS * COLS).reshape(ROWS, COLS) / 20000


def smooth(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Return unit noise and a template as smooth as guided light is."""
    row, col = np.mgrid[:ROWS, :COLS]
    shape = 1.0 + 0.4 * np.sin(col / 17.0) + 0.2 * np.cos(row / 11.0)
    return rng.standard_normal((VIEWS, ROWS, COLS)), rng.uniform(0.05, 1.0, VIEWS)[:, None, None] * shape


@pytest.mark.parametrize(
    "ends", [((8.3, 5.1), (41.7, 22.9)), ((30.2, 36.4), (33.9, 9.8)), ((11.0, 30.6), (19.4, 31.1))]
)
def test_a_line_too_faint_bin_by_bin_is_found(ends: tuple[tuple[float, float], tuple[float, float]]) -> None:
    rng = np.random.default_rng(41)
    residual, template = smooth(rng)
    line = template * drawn_line(ends)
    # No bin by itself has more than about 3.2 standard deviations.
    amount = min(14.0, 3.2 * float(np.hypot(*np.subtract(*ends))) ** 0.5) / np.linalg.norm(line)
    residual = residual + amount * line
    found = brightest_line(residual, template)
    assert found is not None
    # Either end may come first. Its place along the line is known by what one bin more brings: a few bins of thirty.
    gaps = [
        np.hypot(*np.subtract(np.array(found.ends)[order], ends).T).max()
        for order in (slice(None), slice(None, None, -1))
    ]
    assert min(gaps) < 4.0
    direction = np.degrees(np.arctan2(*np.subtract(*found.ends)) - np.arctan2(*np.subtract(*ends)))
    assert abs((direction + 90) % 180 - 90) < 12.0
    assert found.amount == pytest.approx(amount, rel=0.3)
    assert standing_out(residual, template).bins.size <= 3


def test_no_line_is_found_in_noise() -> None:
    rng = np.random.default_rng(43)
    assert sum(brightest_line(*smooth(rng)) is not None for _ in range(5)) == 0


# --- where -----------------------------------------------------------------------------------------------------------


def test_a_speck_listed_at_a_bins_middle_lights_that_bin() -> None:
    rig = scene()
    cols, rows = rig.camera.resolution_px
    x, y, area = cells(rig, (rows // BIN_PX, cols // BIN_PX), "plate")
    effects = {"specks": {"marks": 1.0, "mark_x_mm": [x[777]], "mark_y_mm": [y[777]], "mark_light_mm2": [0.02]}}
    predictor = Predictor(rig, [View(kind="press", force_N=1.3, voltage_V=9.1)])
    plain = predictor.cube({})[0]
    lit = Predictor(rig.model_copy(update={"effects": effects}), predictor.views).cube({})[0]
    change = lit - plain
    assert np.argmax(change) == 777
    assert change.ravel()[777] > 0.7 * change.sum()
    assert area == pytest.approx((4 / 7.3) ** 2)


def test_a_sensor_place_is_the_bin_of_that_pixel() -> None:
    rig = scene()
    cols, rows = rig.camera.resolution_px
    shape = rows // BIN_PX, cols // BIN_PX
    x, y, area = cells(rig, shape, "sensor")
    found = acted(
        "hot_pixels", np.zeros((rows, cols)), rig, marks=2.0, mark_x_mm=(x[1303],), mark_y_mm=(y[1303],),
        mark_rate_e_per_s=(5e4,),
    )  # fmt: skip
    assert np.flatnonzero(binned(found)).tolist() == [1303]
    assert found.sum() == pytest.approx(2.0 * 5e4 * rig.camera.exposure_ms * 1e-3, rel=1e-12)
    assert area == pytest.approx((4 * rig.camera.pixel.pitch_um * 1e-3) ** 2)


# --- the effects' lists ----------------------------------------------------------------------------------------------


def test_listed_specks_send_the_light_of_so_much_contact() -> None:
    rig = scene()
    view = PlateLight(
        radiance=np.zeros((164, 208)), variance=np.zeros((164, 208)), focal_px=1900.0, principal_point=(101.0, 87.0)
    )
    x, y, light = (3.1, -6.2), (1.7, -2.9), (0.04, 0.11)
    found = acted("specks", view, rig, marks=0.5, mark_x_mm=x, mark_y_mm=y, mark_light_mm2=light)
    for one_x, one_y, size in zip(x, y, light, strict=True):
        u, v = view_position(rig, view, np.array([one_x]), np.array([one_y]))
        box = found.radiance[int(v[0]) : int(v[0]) + 2, int(u[0]) : int(u[0]) + 2]
        wanted = 0.5 * size * contact_radiance(rig, one_x, one_y) / pixel_area(rig, view, u, v)[0]
        assert box.sum() == pytest.approx(float(wanted), rel=1e-9)


def test_listed_dust_stops_light_by_its_area() -> None:
    rig = scene()
    light = SensorLight(irradiance=np.full((164, 208), 3.7))
    pitch = rig.camera.pixel.pitch_um * 1e-3
    found = acted(
        "sensor_dust", light, rig, marks=1.5, mark_x_mm=(31.4 * pitch, 120.2 * pitch),
        mark_y_mm=(80.7 * pitch, 22.3 * pitch), mark_area_mm2=(20 * pitch**2, 6 * pitch**2), height_mm=0.0,
    )  # fmt: skip
    stopped = (light.irradiance - found.irradiance).sum() / 3.7
    # twelve sub-samples across a pixel's edge
    assert stopped == pytest.approx(1.5 * 26, rel=0.02)


@pytest.mark.parametrize(
    ("name", "amount"),
    [("hot_pixels", "mark_rate_e_per_s"), ("specks", "mark_light_mm2"), ("sensor_dust", "mark_area_mm2")],
)
def test_lists_of_different_lengths_are_refused_by_name(name: str, amount: str) -> None:
    table = {"marks": 1.0, "mark_x_mm": [1.0, 2.0], "mark_y_mm": [1.0, 2.0], amount: [0.1]}
    with pytest.raises(InputError, match=f"{amount} 1"):
        active_effects(scene().model_copy(update={"effects": {name: table}}))


def test_a_list_that_is_too_long_is_refused_in_one_short_line() -> None:
    table = {"marks": 1.0, "mark_x_mm": [1.25] * 20001}
    with pytest.raises(InputError, match="at most 20000 entries") as caught:
        active_effects(scene().model_copy(update={"effects": {"specks": table}}))
    assert len(str(caught.value)) < 250


@pytest.mark.parametrize("name", ["hot_pixels", "specks", "sensor_dust"])
def test_a_list_alone_switches_the_effect_on_and_draws_nothing(name: str) -> None:
    effect = all_effects()[name]
    assert effect.marks is not None
    lists = {effect.marks.x: (1.0,), effect.marks.y: (1.0,), effect.marks.amount: (0.1,)}
    assert effect.is_null(effect.parameters(**lists))
    assert not effect.is_null(effect.parameters(marks=1.0, **lists))
    assert effect.marks.scale == "marks"


def test_places_tell_hot_pixels_from_specks_where_no_light_is_on() -> None:
    """Rationale: hot pixels that the library lacked were named specks, three times of three.

    Marks of another kind leave their light at the same places of the dark shots: 40 places of 1 deviation each in two
    shots are sqrt(40 * 2) there, and what the fit has explained leaves noise.
    """
    rng = np.random.default_rng(4)
    kinds = [View(kind=k, force_N=2.0) for k in ("press", "press", "lens_cap", "lens_cap", "checkerboard")]
    kinds[1] = View(kind="press", force_N=0.7, voltage_V=8.5)
    shape = (len(kinds), ROWS, COLS)
    problem = SimpleNamespace(
        kinds=kinds, views=tuple(range(5)), valid=np.ones(shape, bool), unwhitened=lambda row: row.reshape(shape)
    )
    footprint = np.zeros((ROWS, COLS))
    footprint.flat[rng.choice(ROWS * COLS, 40, replace=False)] = 1.0
    lit = np.array([1.0, 1.0, 0.0, 0.0, 0.0])[:, None, None] * footprint
    noise = rng.standard_normal(shape)
    specks = left_at_places(problem, lit.ravel(), noise.ravel())
    assert set(specks) == {"press at 2 N, 0 V", "press at 0.7 N, 8.5 V", "lens_cap", "checkerboard"}
    assert max(abs(z) for z in specks.values()) < 4.0
    dark = np.array([0.0, 0.0, 1.0, 1.0, 0.0])[:, None, None] * footprint
    hot = left_at_places(problem, lit.ravel(), (noise + dark).ravel())
    assert hot["lens_cap"] - specks["lens_cap"] == pytest.approx(np.sqrt(80), rel=1e-6)
    assert hot["press at 2 N, 0 V"] == pytest.approx(specks["press at 2 N, 0 V"])


def test_what_goes_on_beside_a_list_makes_it_the_middle_of_something_larger() -> None:
    """A spot of 5 bins about a line that was fitted leaves its rim; a line as the lens draws it leaves noise."""
    rng = np.random.default_rng(14)
    shape = (3, ROWS, COLS)
    problem = SimpleNamespace(views=(0, 1, 2), valid=np.ones(shape, bool), unwhitened=lambda row: row.reshape(shape))
    row, col = np.mgrid[0:ROWS, 0:COLS]
    line = np.where((np.abs(row - 19) < 0.5) & (np.abs(col - 23) < 9), 1.0, 0.0) * np.ones((3, 1, 1))
    spot = np.exp(-((row - 19.3) ** 2 + (col - 22.1) ** 2) / 50.0) * np.ones((3, 1, 1))
    spot *= 12.0 / np.linalg.norm(spot)
    noise = rng.standard_normal(shape)
    rim = spot - (spot * line).sum() / (line**2).sum() * line
    alone = left_beside(problem, line.ravel(), noise.ravel())
    assert max(abs(z) for z in alone.values()) < 4.0
    assert max(left_beside(problem, line.ravel(), (noise + rim).ravel()).values()) > 7.0


@pytest.mark.parametrize(
    ("at_places", "log_bayes", "alike"),
    [
        ({"press": 1.1, "led_off": -0.7, "lens_cap": 2.0}, 20.0, True),
        ({"press": 1.1, "led_off": 4.3, "lens_cap": 3.1}, 20.0, False),  # 29.3: 2e-6 of chi-square with 3 degrees
        ({"press": 1.1, "led_off": 4.3, "lens_cap": 3.1}, 600.0, True),  # 2.4 % of what the list explains
        ({"press": 0.1, f"{BESIDE} 4 bins": 6.4}, 20.0, False),
        ({"press": 0.1, f"{BESIDE} 4 bins": -6.4}, 900.0, True),
        ({"press": 0.1, f"{MOVES} right with force": -6.4}, 20.0, False),
        ({"press": 0.1, f"{MOVES} right with force": -6.4}, 900.0, True),
        ({"press": 0.1, STRIPED: 6.4}, 20.0, False),
        # 12.3: 0.002 of chi-square with 2 degrees, too much for a spot and not for a list.
        ({"press": 3.1, "led_off": -1.63}, 20.0, True),
        ({"press": 3.1, "led_off": -1.63, f"{MOVES} right with force": 0.1}, 20.0, False),
    ],
)
def test_a_list_goes_as_its_marks_do(at_places: dict[str, float], log_bayes: float, alike: bool) -> None:
    known = {f.name: None for f in fields(Extension)} | {"at_places": at_places, "log_bayes": log_bayes}
    assert Extension(**known).goes_as_its_marks_do is alike


# --- a spot ----------------------------------------------------------------------------------------------------------


def test_a_spot_has_its_place_size_and_amount() -> None:
    """Of 12 deviations: the place to its radius over 12, here twice that."""
    rng = np.random.default_rng(8)
    template = rng.uniform(0.2, 1.0, VIEWS)[:, None, None] * rng.uniform(0.5, 2.0, (1, ROWS, COLS))
    row, col = np.mgrid[0:ROWS, 0:COLS]
    shape = np.exp(-((row - 24.2) ** 2 + (col - 17.7) ** 2) / (2 * 6.0**2)) * template
    amount = 12.0 / np.linalg.norm(shape)
    found = brightest_blot(rng.standard_normal(template.shape) + amount * shape, template)
    assert found is not None
    assert np.hypot(found.middle[0] - 17.7, found.middle[1] - 24.2) < 2 * 2**0.5 * 6.0 / 12 + 0.5
    assert 4.2 <= found.radius <= 8.5
    assert found.amount == pytest.approx(amount, rel=0.35)


def _spot_case(rng: np.random.Generator) -> tuple[Any, Any, NDArray[Any], NDArray[Any], Callable[..., NDArray[Any]]]:
    """Return a problem of 24 frames whose power, force and time differ, two nuisances, a spot, noise, and any spot."""
    views, rows, cols = 24, 60, 70
    force, power = rng.uniform(0.4, 5.0, views), rng.uniform(0.4, 1.0, views)
    kinds = [
        View(kind="press", force_N=float(f), voltage_V=8.0 + 4.0 * float(p), time_s=3.0 * k)
        for k, (f, p) in enumerate(zip(force, power, strict=True))
    ]
    shape = (views, rows, cols)
    noise = rng.standard_normal(shape)
    row, col = np.mgrid[0:rows, 0:cols]

    def spot(row0: Any = 24.2, col0: Any = 40.7, wide: Any = 6.0) -> NDArray[Any]:
        at = [np.broadcast_to(value, views)[:, None, None] for value in (row0, col0, wide)]
        return np.asarray(np.exp(-((row - at[0]) ** 2 + (col - at[1]) ** 2) / (2 * at[2] ** 2)) * power[:, None, None])

    problem = SimpleNamespace(
        kinds=kinds,
        views=tuple(range(views)),
        valid=np.ones(shape, bool),
        sd=rng.uniform(0.8, 1.2, shape),
        unwhitened=lambda flat: flat.reshape(shape),
        noise=SimpleNamespace(fields=rng.standard_normal((12, rows, cols))),
    )
    nuisances = rng.standard_normal((2, noise.size))
    return problem, Metric.of(nuisances, np.ones(2)), 60.0 / np.linalg.norm(spot()) * spot(), noise, spot


def test_a_film_stays_where_it_is_and_has_no_stripes() -> None:
    """Rationale: a reflection that walked with the load, and a smear that crept, were named a film, three times of
    three. A film of another form, twice as long as wide, leaves the same in each frame, which is no motion."""
    rng = np.random.default_rng(21)
    problem, metric, film, noise, _ = _spot_case(rng)
    of_noise = left_of_spot(problem, metric, film.ravel(), noise.ravel())
    assert sum(name.startswith(MOVES) for name in of_noise) == 12
    assert max(abs(z) for z in of_noise.values()) < 4.0
    row, col = np.mgrid[0:60, 0:70]
    oval = np.exp(-((row - 24.2) ** 2 / 32.0 + (col - 40.7) ** 2 / 128.0))
    form = film.max(axis=(1, 2), keepdims=True) * oval - film
    left = left_of_spot(problem, metric, film.ravel(), (noise + form).ravel())
    assert np.linalg.norm(form) > 15.0
    assert max(abs(z) for z in left.values()) < 4.0


@pytest.mark.parametrize(
    ("what", "named"),
    [
        ("walks", f"{MOVES} right with force"),
        ("widens", "with time"),
        ("brightens", f"{MOVES} brighter with force"),
        ("striped", STRIPED),
    ],
)
def test_a_spot_that_is_no_film_is_found_out(what: str, named: str) -> None:
    rng = np.random.default_rng(22)
    problem, metric, film, noise, spot = _spot_case(rng)
    amount = film.max() / spot().max()
    force = np.array([v.force_N for v in problem.kinds])
    time = np.log1p([v.time_s for v in problem.kinds])
    col = np.arange(70)
    other = {
        "walks": lambda: amount * spot(col0=40.7 + 1.2 * (force - force.mean())),
        "widens": lambda: amount * spot(wide=6.0 + 0.9 * (time - time.mean())),
        "brightens": lambda: film * (1 + 0.14 * (force - force.mean()))[:, None, None],
        # Of which no frame shows the phase of another.
        "striped": lambda: film * (1 + 0.5 * np.sin(1.3 * col[None, None, :] + 2.1 * np.arange(24)[:, None, None])),
    }[what]()
    left = left_of_spot(problem, metric, film.ravel(), (noise + other - film).ravel())
    loudest = max(left, key=lambda name: abs(left[name]))
    assert loudest.endswith(named)
    assert abs(left[loudest]) > 6.0


def test_noise_and_what_takes_light_are_no_spots() -> None:
    rng = np.random.default_rng(9)
    template = rng.uniform(0.2, 1.0, VIEWS)[:, None, None] * rng.uniform(0.5, 2.0, (1, ROWS, COLS))
    named = sum(brightest_blot(rng.standard_normal(template.shape), template) is not None for _ in range(60))
    assert named <= 3
    row, col = np.mgrid[0:ROWS, 0:COLS]
    shade = np.exp(-((row - 24.2) ** 2 + (col - 17.7) ** 2) / (2 * 6.0**2)) * template
    assert brightest_blot(-12.0 / np.linalg.norm(shade) * shade, template) is None
