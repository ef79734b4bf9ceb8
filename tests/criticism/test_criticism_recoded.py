"""The codec that the data came through is found, and what it makes of the mean and the scatter of bins is drawn."""

from collections.abc import Iterator

import cv2
import numpy as np
import pytest
from scipy import ndimage, stats

from evanesce.criticism.codec import codec_parameters, noise_by_bins
from evanesce.criticism.isolability import nuisance_words
from evanesce.criticism.numerics import numerics_parameters
from evanesce.criticism.problem import fit
from evanesce.criticism.residuals import noise_draws
from evanesce.criticism.score import score_test
from evanesce.prediction.nuisance import nuisance_parameters
from evanesce.prediction.observe import pixel_scatter
from evanesce.prediction.recoded import Codec, Recoded, Shooting, codec_of, recoded
from evanesce.prediction.tone import expected_tone
from evanesce.prediction.views import View, binned
from evanesce.rig import load_scene
from test_criticism_fit import SHAPE, Toy, parameter, problem_of, signatures


@pytest.fixture
def toy() -> Toy:
    rng = np.random.default_rng(17)
    return Toy({name: ndimage.gaussian_filter(rng.standard_normal((4, *SHAPE)), 2) for name in ("a:x", "b:y", "@n")})


@pytest.fixture(scope="module")
def shooting() -> Shooting:
    """Of a dim rig: noise of some DN a pixel."""
    camera = load_scene("thesis").camera.model_copy(update={"analogue_gain": 16.0, "resolution_px": (208, 160)})
    return Shooting(camera, 1.0, 1)


@pytest.fixture(scope="module")
def level() -> np.ndarray:
    y, x = np.mgrid[0:160, 0:208]
    return np.where(np.hypot(y - 70, x - 121) < 37, 90.0, 0.0) + 4.0 + 0.03 * x


def shot(shooting: Shooting, codec: Codec, level: np.ndarray, count: int, seed: int) -> np.ndarray:
    """Return frames of one state after a codec."""
    noise = shooting.frames(level, np.random.default_rng(seed))
    film = (next(noise) for _ in range(count * codec.filmed))
    return np.array(list(codec.through(film)))


def test_frames_have_the_mean_and_the_scatter_that_were_asked_for(shooting: Shooting, level: np.ndarray) -> None:
    noise = shooting.frames(level, np.random.default_rng(3))
    frames = np.array([next(noise) for _ in range(300)])
    assert frames.dtype == np.uint8
    variance = expected_tone(shooting.camera).variance_at(level)
    away = (frames.mean(axis=0) - level) / np.sqrt(variance / 300)
    assert abs(away.mean()) < 5 / np.sqrt(away.size)
    assert np.mean(away**2) == pytest.approx(1.0, abs=0.06)


@pytest.mark.parametrize(("codec", "scale"), [(Codec("jpeg", 88), 1.0), (Codec("h264", 24, 3), 1.0)])
def test_the_codec_is_the_one_that_was_used(shooting: Shooting, level: np.ndarray, codec: Codec, scale: float) -> None:
    before = [0.6 * level, 0.8 * level]
    noise = np.random.default_rng(8)

    def film() -> Iterator[np.ndarray]:
        for state in [*before, *[level] * 12]:
            frames = shooting.frames(state, noise)
            for _ in range(codec.filmed):
                yield next(frames)

    frames = np.array(list(codec.through(film())))[-12:]
    held = binned(frames)
    made = [lambda state=state: state for state in before]
    found, size = codec_of(shooting, level, made, held, pixel_scatter(list(frames), 1), np.random.default_rng(1))
    assert found.kind == codec.kind
    assert abs(found.quality - codec.quality) <= 2
    assert size == pytest.approx(scale, abs=0.1)


def test_jpeg_is_that_of_the_library(shooting: Shooting, level: np.ndarray) -> None:
    frame = next(shooting.frames(level, np.random.default_rng(4)))
    ok, data = cv2.imencode(".jpg", frame, [cv2.IMWRITE_JPEG_QUALITY, 70])
    assert ok
    assert np.array_equal(next(Codec("jpeg", 70).through(iter([frame]))), cv2.imdecode(data, cv2.IMREAD_GRAYSCALE))


def test_a_film_gives_back_the_last_frame_of_each_state() -> None:
    """Odd sides, too; levels that no codec could mistake, the first two of each state others than the last."""
    levels = (170, 90, 40, 60, 220, 120, 20, 150, 200)
    back = list(Codec("h264", 18, 3).through(np.full((35, 51), value, np.uint8) for value in levels))
    assert [b.shape for b in back] == [(35, 51)] * 3
    assert [round(float(b.mean()), -1) for b in back] == [40, 120, 200]


@pytest.fixture(scope="module")
def made(shooting: Shooting, level: np.ndarray) -> tuple[Recoded, np.ndarray]:
    """Of two views, and what 60 frames of the first really are, of a film of its own."""
    codec, views = Codec("jpeg", 75), (View(kind="press", force_N=1.0), View(kind="replicate", force_N=1.0, frames=3))
    expected = np.array([binned(level), binned(0.5 * level)])
    found = recoded(shooting, lambda k: (level, 0.5 * level)[k], views, codec, expected, np.random.default_rng(6))
    return found, binned(shot(shooting, codec, level, 60, seed=77)) - expected[0]


def test_bias_and_scatter_are_those_of_frames_that_were_not_drawn(made: tuple[Recoded, np.ndarray]) -> None:
    found, real = made
    variance = real.var(axis=0, ddof=1)
    assert np.median(found.variance[0] / variance) == pytest.approx(1.0, abs=0.1)
    # Mean of three frames of another state: a third of the scatter or less.
    assert np.median(found.variance[1]) < 0.5 * np.median(found.variance[0])
    left = real.mean(axis=0) - found.bias[0]
    error = np.sqrt(variance / 60 + variance / len(found.fields))
    assert np.mean((left / error) ** 2) < 1.5
    assert abs(np.mean(left)) < 4 * np.sqrt(np.mean(error**2) / left.size) + 0.02
    # It says something: without it the same frames are farther off.
    assert np.mean(real.mean(axis=0) ** 2) > 1.5 * np.mean(left**2)


def test_draws_scatter_as_the_fields_do_with_tails_for_their_number() -> None:
    """Oracle: a sum of so few fields over its own scatter has Student's law."""
    rng = np.random.default_rng(2)
    fields = rng.standard_normal((9, 1, 1, 1)).astype(np.float32)
    coded = Recoded(Codec("jpeg", 75), np.zeros((1, 1, 1)), fields - fields.mean(), fields[:0], np.ones((1, 1, 1)))
    sums = coded.drawn(200_000, rng) @ coded.fields[:, 0, 0, 0]
    size = coded.fields.std(ddof=1)
    # Variance of Student's t of 8 degrees of freedom.
    assert np.var(sums / size) == pytest.approx(8 / 6, rel=0.05)
    assert np.mean(np.abs(sums / size) > stats.t(8).isf(0.0005)) == pytest.approx(0.001, rel=0.25)


def test_a_mean_change_may_be_off_by_a_share_from_place_to_place_alike_in_all_frames(
    made: tuple[Recoded, np.ndarray],
) -> None:
    """What it is off by is smooth over a macroblock and the same share in each view; its sum has the stated size."""
    found, _ = made
    maps = found.uneven.astype(float)
    share = 0.25 * np.sqrt(np.mean(found.bias**2))
    assert np.sqrt((maps**2).sum(axis=0).mean()) == pytest.approx(share, rel=0.15)
    known = np.abs(found.bias).min(axis=0) > 0.02
    first, second = (maps[:, k][:, known] / found.bias[k][known] for k in (0, 1))
    np.testing.assert_allclose(first, second, rtol=1e-3)
    amplitudes = found.drawn(4000, np.random.default_rng(3))[:, len(found.fields) :]
    assert amplitudes.shape[1] == len(maps)
    assert amplitudes.std() == pytest.approx(1.0, abs=0.02)
    beside = (maps[:, 0] / found.bias[0])[:, :, [0, 1, 9]]
    near, far = (np.corrcoef(beside[:, :, 0].ravel(), beside[:, :, k].ravel())[0, 1] for k in (1, 2))
    assert near > 0.8
    assert abs(far) < 0.4


def test_noise_that_a_codec_hands_on_alarms_at_its_level_where_it_is_drawn(toy: Toy) -> None:
    """Half of the noise is the same in all four views. Drawn view by view, as replicates are, it would ring.

    100 cases; 4 standard errors of a 5 % rate are 9 %.
    """
    rng = np.random.default_rng(4)
    toy.maps |= {name: np.broadcast_to(toy.maps[name].mean(axis=0), (4, *SHAPE)) for name in ("a:x", "b:y")}

    def noise(count: int) -> np.ndarray:
        common = ndimage.gaussian_filter(rng.standard_normal((count, 1, *SHAPE)), (0, 0, 1, 1), mode="wrap")
        return np.asarray((common / common.std() + rng.standard_normal((count, 4, *SHAPE))) / np.sqrt(2))

    alarms = {"coded": 0, "view by view": 0}
    for _ in range(100):
        drawn = noise(24)
        problem = problem_of(toy, toy.cube({}) + noise(1)[0], drawn[:, 0])
        fields = (drawn - drawn.mean(axis=0)).astype(np.float32)
        coded = Recoded(Codec("jpeg", 90), np.zeros((4, *SHAPE)), fields, fields[:0], fields.var(axis=0, ddof=1))
        for name, asked in (("view by view", problem), ("coded", problem.recoded(coded, np.zeros_like(problem.sd)))):
            base = fit(asked, [parameter("@n")], {}, rounds=2)
            alarms[name] += score_test(asked, base, signatures(asked, toy), draws=99, rng=rng).p <= 0.05
    assert 0 < alarms["coded"] < 14
    assert alarms["view by view"] > 20


def test_noise_that_is_louder_than_a_codec_was_seen_to_leave_widens_the_law(toy: Toy) -> None:
    """Real noise of thrice the drawn variance. Weights alone would shrink draws and data alike, and alarm by as much.

    100 cases at 5 %: 4 standard errors above are 14.
    """
    rng = np.random.default_rng(14)
    alarms = {"as drawn": 0, "louder": 0}
    for _ in range(100):
        fields = rng.standard_normal((24, 4, *SHAPE)).astype(np.float32)
        fields -= fields.mean(axis=0)
        problem = problem_of(toy, toy.cube({}) + np.sqrt(3.0) * rng.standard_normal((4, *SHAPE)), fields[:, 0])
        coded = Recoded(Codec("jpeg", 90), np.zeros((4, *SHAPE)), fields, fields[:0], np.ones((4, *SHAPE)))
        asked = problem.recoded(coded, np.full_like(problem.sd, 0.1))
        excess, shared = noise_by_bins(asked, fit(asked, [parameter("@n")], {}, rounds=2))
        assert np.all(excess > 1.3)
        assert np.all(shared < 1.2)
        for name, one in (("as drawn", asked), ("louder", asked.louder(excess, shared))):
            base = fit(one, [parameter("@n")], {}, rounds=2)
            alarms[name] += score_test(one, base, signatures(one, toy), draws=99, rng=rng).p <= 0.05
    assert alarms["louder"] < 14 < alarms["as drawn"], alarms


def test_draws_of_residuals_are_those_of_the_codec_and_of_numerics(toy: Toy) -> None:
    rng = np.random.default_rng(9)
    fields = rng.standard_normal((40, 4, *SHAPE)).astype(np.float32) * np.array([1, 2, 1, 1])[None, :, None, None]
    fields -= fields.mean(axis=0)
    problem = problem_of(toy, toy.cube({}), fields[:, 0])
    coded = Recoded(Codec("jpeg", 90), np.zeros((4, *SHAPE)), fields, fields[:0], fields.var(axis=0, ddof=1))
    problem = problem.recoded(coded, np.full_like(problem.sd, 3.0))
    base = fit(problem, [parameter("@n", deviation=1e-6)], {})
    cubes = np.concatenate([draws.cube for draws in noise_draws(problem, base, 1600, rng)])
    # Variance of Student's law of 39 degrees of freedom is 39/37 of that of the fields.
    share = coded.variance / (coded.variance + 3.0)
    assert np.mean(cubes**2) == pytest.approx(np.mean(share * 39 / 37 + 1 - share), rel=0.05)
    alike = np.mean(cubes[:, 0] * cubes[:, 1], axis=0)
    theirs = np.mean(fields[:, 0] * fields[:, 1], axis=0) / (problem.sd[0] * problem.sd[1])
    assert np.corrcoef(alike.ravel(), theirs.ravel())[0, 1] > 0.8


@pytest.mark.parametrize("share", [1.0, 0.25])
def test_where_a_codecs_work_is_known_its_shapes_are_held_to_a_share(share: float) -> None:
    level = np.full((4, 12, 16), 60.0)
    level[:, :, 8:] = 5.0
    views = [View(kind="press", force_N=1.0), View(kind="lens_cap"), View(kind="square"), View(kind="led_off")]
    bias = np.random.default_rng(1).standard_normal(level.shape)
    free = {p.name: p for p in codec_parameters(views, level)}
    held = {p.name: p for p in codec_parameters(views, level, share, bias)}
    # Dark shots each by themselves: a difference between them that a codec made would be light that leaks in.
    assert set(held) - set(free) == {f"@codec_bias[{name}]" for name in ("lit", "led_off", "lens_cap", "card")}
    for name, one in free.items():
        assert held[name].deviation == pytest.approx(share * one.deviation)
    template = held["@codec_bias[lens_cap]"].template
    assert template is not None
    assert np.array_equal(template[1], bias[1])
    assert not template[[0, 2, 3]].any()
    assert held["@codec_bias[lens_cap]"].deviation == max(share, 0.5)
    assert held["@codec_bias[lit]"].deviation == share


def test_every_nuisance_has_words_for_what_it_takes() -> None:
    """Reports say which nuisance hides an effect; none by its internal name."""
    views = [View(kind="press", force_N=1.4), View(kind="lens_cap"), View(kind="square"), View(kind="led_off")]
    level = np.full((4, 20, 24), 30.0)
    nuisances = (
        *nuisance_parameters(views, 0.002, noise=0.1),
        *numerics_parameters(views, level, level),
        *codec_parameters(views, level, 0.5, np.ones_like(level)),
    )
    assert len({p.name for p in nuisances}) > 15
    assert not [p.name for p in nuisances if nuisance_words(p.name).startswith("@")]
