"""The challenge itself: who hides causes shares nothing with who looks for them, and strengths are as stated."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy import optimize

from challenge import families_camera, families_light, recipes
from challenge import rig as rigs
from challenge.baselines import matched_filters
from challenge.camera import Developed, Electronics, binned, filled, noisy_frame, true_curve
from challenge.cases import CaseSpec, cases
from challenge.chain import Nuisances, curve_of, expose, rig_of
from challenge.codec import by_video
from challenge.consequence import consequences
from challenge.hidden import Hidden
from challenge.library import MARKS, NAMED, NOT_IN_LIBRARY, NOT_INJECTED, make_cause
from challenge.make import oracle_gain, pictures, prepare, strength_behind, write_case
from challenge.rig import KNOT, BaseLight, View, believed
from challenge.run import GROSS, judge_of, run, strip_pixels
from challenge.strength import (
    amplitude_for,
    base_levels,
    departure,
    levels,
    means,
    ruler,
    strength_of,
    variances,
    within_bins,
)
from evanesce.bundle import read_bundle
from evanesce.bundle.card_light import card_light
from evanesce.bundle.layout import Shot
from evanesce.effects import Context, Stage, active_effects, all_effects, apply_stage
from evanesce.effects.readout.saturation import softened
from evanesce.effects.readout.tone_curve import departed
from evanesce.optics.projection import Projection
from evanesce.render.cards import pose_of, square_of

FOLDER = Path(__file__).parent / "challenge"
FORBIDDEN = (
    "evanesce.effects",
    "evanesce.inference",
    "evanesce.prediction",
    "evanesce.chain",
    "evanesce.studies",
    "evanesce.evaluation",
)
PROMISED = {
    "black_level",
    "tone_curve",
    "vignetting",
    "defocus",
    "distortion_drift",
    "hot_pixels",
    "rolling_shutter",
    "saturation",
    "sensor_dust",
    "frame_rate",
    "compression",
    "ambient_light",
    "led_dead",
    "led_imbalance",
    "supply_sag",
    "led_warmup",
    "glass_absorption",
    "specks",
    "scratch",
    "residue_film",
    "lateral_glow",
    "plate_tilt",
    "square_size",
    "card_offset",
    "off_axis_load",
    "modulus",
    "adhesion",
    "creep",
    "ridge_height",
    "bone_stiffening",
    "shear_area_loss",
    "force_offset",
}


TINY = {
    "camera.resolution_px": [80, 60],
    "camera.scale_px_per_mm": 2.6,
    "card.checkerboard_squares": [6, 4],
}
"""A rig that is rendered in seconds."""


@pytest.fixture(scope="module", autouse=True)
def tiny(tmp_path_factory):
    """Let cases be made of a tiny rig, its light kept in a folder of this test."""
    patch = pytest.MonkeyPatch()
    patch.setitem(rigs.BELIEVED, "tiny", TINY)
    patch.setattr(rigs, "CACHE", tmp_path_factory.mktemp("light"))
    patch.setattr("challenge.baselines.CACHE", tmp_path_factory.mktemp("bank"))
    yield
    patch.undo()


def case(**given) -> CaseSpec:
    """Return a case of the tiny rig at pose 0."""
    every = (CaseSpec(set="dev", rig="tiny", **{"number": n, **given}) for n in range(40))
    return next(spec for spec in every if spec.pose == 0)


# --- nothing shared --------------------------------------------------------------------------------------------------


def test_no_module_of_the_challenge_imports_effects_or_critic() -> None:
    modules = sorted(FOLDER.rglob("*.py"))
    assert len(modules) > 10
    for path in modules:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names: list[str] = []
            if isinstance(node, ast.Import):
                names = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom) and node.level == 0:
                names = [f"{node.module}.{alias.name}" for alias in node.names]
            for name in names:
                assert not name.startswith(FORBIDDEN), f"{path.name} imports {name}"


def test_nor_does_anything_that_they_import() -> None:
    program = (
        "import sys, pkgutil, importlib, challenge\n"
        "for m in pkgutil.walk_packages(challenge.__path__, 'challenge.'): importlib.import_module(m.name)\n"
        f"print([m for m in sys.modules if m.startswith({FORBIDDEN!r})])"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, cwd=FOLDER.parent, check=True
    )
    assert done.stdout.strip() == "[]"


def test_every_promised_effect_is_hidden_or_said_not_to_be() -> None:
    assert set(NAMED) | set(NOT_INJECTED) >= PROMISED
    assert not set(NAMED) & set(NOT_INJECTED)
    assert not set(NOT_IN_LIBRARY) & set(all_effects())
    assert len(NOT_IN_LIBRARY) == 15


def test_every_cause_has_a_recipe_with_its_source_and_nothing_of_the_families() -> None:
    assert set(recipes.RECIPES) == set(NAMED)
    for name, recipe in recipes.RECIPES.items():
        assert re.search(r"(19|20)\d\d", " ".join(_lineage_docs(recipe))), f"{name} names no source"
        assert recipe.unit == NAMED[name].unit, name
        assert recipe.mark is NAMED[name].mark, name
    for path in (FOLDER / "recipes").glob("*.py"):
        lines = path.read_text(encoding="utf-8").splitlines()
        assert not [line for line in lines if "import" in line and ("families" in line or "unknown" in line)]


def _lineage_docs(kind: type) -> list[str]:
    return [c.__doc__ or "" for c in kind.__mro__ if c.__module__.startswith("challenge.recipes")]


# --- cases -----------------------------------------------------------------------------------------------------------


def test_case_lists_hold_what_they_promise() -> None:
    for name, least in (("dev", 200), ("scored", 300)):
        every = cases(name)
        assert len({c.id for c in every}) == len(every) >= least
        nulls = [c.noise for c in every if c.group == "null"]
        assert len(set(nulls)) == 5
        assert len({nulls.count(noise) for noise in nulls}) == 1
        singles = {(c.causes[0], c.strengths[0]) for c in every if c.group == "single"}
        assert len(singles) == 5 * len(NAMED)
        assert {c for spec in every if spec.group == "unknown" for c in spec.causes} == set(NOT_IN_LIBRARY)
        assert any(c.cancelling for c in every)
        recipe = [c.recipe(k) for c in every for k in range(len(c.causes))]
        assert 0.4 < np.mean(recipe) < 0.6
        many = [c for c in every if c.group == "rig"]
        assert all(5 <= len(c.causes) <= 10 and min(c.strengths) >= 30 and max(c.strengths) <= 300 for c in many)
        assert sum(c.causes[-1] in NOT_IN_LIBRARY for c in many) * 2 == len(many)
    assert len({c.rig for c in many}) == 3
    assert len(many) == 60
    assert not {c.seed for c in cases("dev")} & {c.seed for c in cases("scored")}
    # Any beginning is a fair sample: groups come as often in the first half as in the second.
    groups = [c.group for c in cases("scored")]
    half = len(groups) // 2
    assert abs(groups[:half].count("single") - groups[half:].count("single")) < 4 * np.sqrt(half / 4)


# --- camera ----------------------------------------------------------------------------------------------------------


def test_mean_and_variance_are_those_of_drawn_frames() -> None:
    electronics = Electronics.of(believed("dev"))
    curve = true_curve(electronics.curve, electronics.black_DN, electronics.top_DN)
    table, rng = Developed(electronics, curve), np.random.default_rng(8)
    for charge in (0.0, 3.0, 17.0, 160.0, 330.0):
        for offset in (0.0, 11.3):
            drawn = noisy_frame(electronics, np.full((500, 800), charge), offset, curve, rng).astype(float)
            at, spread = np.array(charge), float(table.spread(np.array(charge)))
            assert abs(drawn.mean() - float(table.level(at, offset))) < 4 * np.sqrt(drawn.var() / drawn.size) + 2e-3
            if offset == 0.0:
                assert drawn.var() == pytest.approx(spread, rel=0.02)


def test_video_keeps_levels_and_loses_detail() -> None:
    rng = np.random.default_rng(5)
    y, x = np.mgrid[:300, :400]
    scene = 90 + 60 * np.sin(x / 31.0) * np.cos(y / 17.0)
    frames = [np.clip(np.round(scene + rng.normal(0, 6, scene.shape)), 0, 255).astype(np.uint8) for _ in range(5)]
    back = by_video(frames, 23)
    difference = np.array(back).astype(float) - frames
    assert -0.6 < difference.mean() < -0.3  # what the way to RGB takes
    assert 0.5 < difference.std() < 6.5


# --- the injector against itself -------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def rig(tiny):
    return rig_of("tiny", 0)


@pytest.mark.parametrize("recipe", [False, True])
@pytest.mark.parametrize("name", [*NAMED, *NOT_IN_LIBRARY])
def test_nothing_is_changed_at_amplitude_zero(rig, name: str, recipe: bool) -> None:
    some = replace(rig, views=tuple(rig.views[k] for k in (0, 12, 18, 20, 21)))
    cause = make_cause(name, rig, 4, 1, recipe=recipe)
    for view in some.views:
        one, other = expose(some, view, [(cause, 0.0)], Nuisances()), expose(some, view, (), Nuisances())
        np.testing.assert_allclose(one.charge_e, other.charge_e, rtol=1e-9, atol=1e-9)
        np.testing.assert_array_equal(one.offset_DN + 0.0 * one.charge_e, other.offset_DN + 0.0 * other.charge_e)
    np.testing.assert_allclose(curve_of(some, [(cause, 0.0)]), curve_of(some, ()), atol=1e-8)


@pytest.mark.parametrize("recipe", [False, True])
@pytest.mark.parametrize("name", [*NAMED, *NOT_IN_LIBRARY])
def test_every_cause_shows_and_is_a_number_everywhere(rig, name: str, recipe: bool) -> None:
    cause = make_cause(name, rig, 7, 1, recipe=recipe)
    change = means(rig, [(cause, min(5 * cause.start, 0.5 * cause.limit))]) - ruler("tiny", 0).base
    assert np.isfinite(change).all()
    assert ruler("tiny", 0).norm(change) > 0.01


def test_pixels_see_the_points_of_the_plate_that_the_rig_projects_them_to(rig) -> None:
    """Snell's law and a polynomial on one side, the project's projection on the other; back and forth."""
    at = rig.at
    reach = at.distance_mm + at.thickness_mm * at.in_glass(at.ray_x**2 + at.ray_y**2)
    np.testing.assert_allclose([at.ray_x * reach, at.ray_y * reach], [at.x, at.y], atol=1e-8)
    for u, v in (at.seen_before(at.x, at.y), at.raised(0.0), at.leaning(0.0, (0.6, 0.8))):
        np.testing.assert_allclose([u, v], [at.u, at.v], atol=1e-12)


def test_a_plate_that_leans_is_seen_as_the_effect_tilts_it(rig) -> None:
    """The effect's rotation, glass and lens: but for the point about which the plate turns they agree to 1e-3 px."""
    at, fine = rig.at, rigs.fine_scene(rig.scene)
    scene = fine.model_copy(update={"effects": {"plate_tilt": {"about_x_deg": 0.0, "about_y_deg": 3.0}}})
    real = apply_stage(Stage.RIG, scene, active_effects(scene), Context(scene, 0))
    rows, cols = at.u.shape
    x, y = Projection.of(real.camera, real.plate).to_plate(*np.meshgrid(np.arange(float(cols)), np.arange(float(rows))))
    u, v = at.leaning(np.deg2rad(3.0), (1.0, 0.0))
    half = np.hypot(rows, cols) / 2

    def apart(where: np.ndarray) -> np.ndarray:
        there = at.seen_before((x + where[0]) * (1.0 + where[2]), (y + where[1]) * (1.0 + where[2]))
        return half * (np.array(there) - [u, v])[:, ::10, ::10].ravel()

    assert np.abs(half * (u - at.u)).max() > 0.4
    assert np.abs(optimize.least_squares(apart, np.zeros(3)).fun).max() < 1e-3


@pytest.mark.parametrize(("name", "recipe"), [("card_offset", False), ("square_size", False), ("square_size", True)])
def test_a_card_that_lies_or_is_printed_otherwise_is_the_picture_of_such_a_card(rig, name: str, recipe: bool) -> None:
    """Rendered anew, a card 0.4 mm higher or printed 2 % larger is what its first picture was made into.

    But for the edge of its paper, which a print of another size does not move, and for a print of another shape.
    """
    amplitude = {"card_offset": 0.4, "square_size": 0.02}[name]
    cause, square = (
        make_cause(name, rig, 4, 1, recipe=recipe),
        View("square", Shot(index=0, time_s=0.0, force_N=0.0, voltage_V=9.0)),
    )
    made = cause.light(rig.base.cards["square"].astype(float), square, amplitude)
    lying = pose_of(rig.scene.card, rigs.pose_of_case("tiny", 0)[1])
    fine, printed = rigs._fine_at(rig.scene, (0.0, 0.0)), square_of(rig.scene.card)
    if name == "card_offset":
        lying = replace(lying, height=lying.height + amplitude)
    else:
        printed = replace(printed, side=printed.side * (1.0 + cause.parameter(amplitude)[1]))
    anew = rigs.irradiance(fine, card_light(fine, printed, lying, view=rigs.fine_view(fine)))
    shown = np.hypot(rig.at.x, rig.at.y) < 0.5 * printed.side + 0.4 * printed.margin
    change, wrong = (np.abs(one - anew)[shown].sum() for one in (rig.base.cards["square"], made))
    assert wrong < 0.12 * change  # pixels of this rig are coarse: on four times as fine ones a hundredth


@pytest.mark.parametrize(("name", "recipe"), [("black_level", False), ("modulus", True)])
def test_strength_is_the_norm_that_noise_gives(rig, name: str, recipe: bool) -> None:
    """The matched filter's output on drawn frames has mean s and deviation 1: s is a signal-to-noise ratio."""
    measure, strength = ruler("tiny", 0), 10.0
    cause = make_cause(name, rig, 3, 0, recipe=recipe)
    a = amplitude_for(rig, measure, cause, strength)
    made, change = _bare(rig, [(cause, a)]), means(rig, [(cause, a)]) - measure.base
    outputs = []
    for seed in range(12):
        frames = pictures(made, "plain", seed)
        seen = np.array([np.mean([binned(f.astype(float)) for f in frames[k]], axis=0) for k in frames])
        outputs.append(measure.inner(change, seen - measure.base) / strength)
    # Twelve outputs of deviation 1; the marginalised filter's own variance is below 1.
    assert abs(np.mean(outputs) - strength) < 4 / np.sqrt(12) + 0.03 * strength
    assert np.std(outputs, ddof=1) < 1.8


def _bare(rig, causes):
    """Return a case without nuisances."""
    return replace(prepare(case(group="null")), rig=rig, causes=tuple(causes), nuisances=Nuisances())


@pytest.mark.parametrize("noise", ["plain", "lowpass"])
def test_strength_of_marks_is_that_of_a_matched_filter_on_pixels(rig, noise: str) -> None:
    """What hot pixels change within bins: the whitened filter on drawn frames has that mean and deviation 1."""
    measure = ruler("tiny", 0)
    cause = make_cause("hot_pixels", rig, 2, 0)
    a = amplitude_for(rig, measure, cause, 12.0, noise=noise)
    assert strength_of(rig, measure, [(cause, a)], noise) == pytest.approx(12.0, rel=0.02)
    whole, made, outputs = levels(rig, [(cause, a)]) - base_levels("tiny", 0), _bare(rig, [(cause, a)]), []
    expected = within_bins(rig, measure, whole, noise)
    assert expected > 0.5 * 12.0**2
    for seed in range(10):
        frames = pictures(made, noise, seed)
        seen = np.array([np.mean(frames[k], axis=0) for k in range(len(rig.views))]) - base_levels("tiny", 0)
        # The filter is bilinear: 2 <a, b> = |a + b|^2 - |a|^2 - |b|^2 of the same whitened norm.
        both = within_bins(rig, measure, whole + seen, noise) - within_bins(rig, measure, seen, noise)
        outputs.append(0.5 * (both - expected) / np.sqrt(expected))
    assert abs(np.mean(outputs) - np.sqrt(expected)) < 4 / np.sqrt(10) + 0.05 * np.sqrt(expected)
    assert np.std(outputs, ddof=1) < 1.9


def test_a_codec_leaves_less_of_a_cause_and_none_leaves_all(rig) -> None:
    measure = ruler("tiny", 0)
    cause = make_cause("hot_pixels", rig, 2, 0)
    pair = (cause, amplitude_for(rig, measure, cause, 20.0))
    untouched = strength_behind(rig, measure, pair, "plain")
    # Two sets of four outputs give their scatter to 29 %: a thousandth of all sets to a quarter or to twice of it.
    assert 20.0 / 2.0 < untouched < 20.0 / 0.25
    assert strength_behind(rig, measure, pair, "h264-strong") < 0.5 * untouched


def test_consequence_is_what_the_force_law_says(rig) -> None:
    """A softer finger's area grows as the force to 2/3 (Hertz); what the lens cap alone shows moves no area."""
    softer, level = make_cause("modulus", rig, 3, 0), make_cause("square_size", rig, 3, 0)
    grown = 0.3
    found = consequences(rig, [(softer, grown), (level, 0.05)], Nuisances())
    strongest = found[0]["percent"][-1]
    law = 100 * (np.exp(2 / 3 * softer.sign * grown * 0.8) - 1)
    assert strongest == pytest.approx(law, abs=6.0)
    assert found[0]["largest"] >= abs(strongest) / 100 - 1e-12
    assert found[1]["largest"] == 0.0


def test_truth_of_a_rig_holds_many_causes_at_their_strengths(rig) -> None:
    spec = case(group="rig", causes=("card_offset", "vignetting", "modulus", "square_size", "moire"),
                strengths=(60.0, 40.0, 90.0, 30.0, 50.0))  # fmt: skip
    truth = prepare(spec).truth
    assert truth["outside"] == ["moire"]
    assert len(truth["causes"]) == 5
    np.testing.assert_allclose(truth["strengths_made"], spec.strengths, rtol=0.06)
    assert truth["parameters"][0] == ("height_mm", truth["amplitudes"][0])
    assert truth["parameters"][1] is None
    assert truth["unknown_DN2"] > 0.0 == prepare(case(group="null")).truth["unknown_DN2"]


def test_nuisances_hide_what_they_can_absorb(rig) -> None:
    measure = ruler("tiny", 0)
    brighter = make_cause("led_bin", rig, 1, 0)  # any cause: only its change is replaced
    change = means(rig, [(brighter, 1e-9)]) - measure.base
    assert measure.norm(change) < 1e-3
    for places, columns in (measure.columns[3],):
        for place, column in zip(places, columns, strict=True):
            own = np.zeros_like(measure.base)
            own[3] = column
            raw = float(np.sqrt((measure.weight * own * own).sum()))
            if measure.names[place].startswith("flicker"):
                # Marginalising a direction of prior width w leaves a norm of at most 1/w.
                assert measure.norm(own) <= min(raw, 1 / 0.002) * 1.001
    everywhere = np.zeros_like(measure.base)
    for k, (places, columns) in enumerate(measure.columns):
        if 0 in places:
            everywhere[k] = columns[places.index(0)]
    assert measure.norm(everywhere) <= 1 / 0.3 * 1.001


# --- another functional form than the library's ----------------------------------------------------------------------


def _misfit(values: np.ndarray, model, start) -> float:
    """Return what a model's best fit leaves of values, relative."""
    found = optimize.least_squares(lambda p: model(*p) - values, start)
    return float(np.sqrt(np.mean(found.fun**2) / np.mean((values - values.mean()) ** 2)))


def test_tone_table_is_no_gamma_and_contrast(rig) -> None:
    for seed in range(3):
        for form in (0, 1):
            cause = families_camera.ToneCurve(np.random.default_rng(seed), rig, form)
            v = np.linspace(0.02, 0.98, 200)
            push = cause.curve(v, 0.1) - v
            assert _misfit(push, lambda g, c, v=v: departed(v, g, c) - v, [0.01, 0.01]) > 0.03


def test_knees_are_no_p_norm() -> None:
    """The library's saturation approaches its ceiling by a p-norm; neither hidden form is one, whatever its knee."""
    x = np.linspace(0.0, 2000.0, 400)
    for knee in ((1000.0, 0.05, 0), (1000.0, 0.15, 1)):
        lost = x - filled(x, knee)
        assert lost[0] == pytest.approx(0.0, abs=1e-6)
        assert filled(x, knee)[-1] == pytest.approx(1000.0, rel=1e-3)
        slope = np.diff(filled(x, knee)) / np.diff(x)
        assert np.all((slope > -1e-9) & (slope < 1 + 1e-9))
        # Beside a hard ceiling: what the knee itself is.
        bend = np.minimum(x, 1000.0) - filled(x, knee)
        left = _misfit(bend, lambda w, k: np.minimum(x, 1000.0) - softened(x, abs(w), abs(k) + 1e-3), [1000.0, 0.05])
        assert left > 0.05


def test_hidden_creep_is_no_logarithm(rig) -> None:
    """The library's grows with the logarithm of time since an onset: here both forms bend away from one."""
    held = np.linspace(0.0, 130.0, 200)

    def logarithm(rise: float, onset: float) -> np.ndarray:
        # An onset that is not later than the frames are apart.
        return np.log(1 + abs(rise) * np.log10(1 + held / np.clip(abs(onset), 1e-3, 1.0)))

    for form in (0, 1):
        cause = families_light.Creep(np.random.default_rng(5), rig, form)
        view = next(v for v in rig.views if v.touches)
        grown = np.array([cause.log_force(replace(view, shot=replace(view.shot, held_s=t)), 0.1) for t in held])
        assert _misfit(grown, logarithm, [0.1, 0.5]) > 0.05


def test_mask_is_no_parabola(rig) -> None:
    for form in (0, 1):
        cause = families_camera.Vignetting(np.random.default_rng(2), rig, form)
        free = cause.free(0.6)
        r2 = ((rig.at.u - cause.centre[0]) ** 2 + (rig.at.v - cause.centre[1]) ** 2).ravel()[::17]
        assert _misfit(free.ravel()[::17], lambda k, r2=r2: 1 - k * r2, [0.1]) > 0.05


def test_glow_is_two_gaussians_and_no_exponential(rig) -> None:
    cause = families_light.LateralGlow(np.random.default_rng(3), rig, 0)
    r = np.linspace(0, 60, 300)
    profile = sum(share * np.exp(-0.5 * (r / s) ** 2) / s**2 for share, s in cause.parts)
    profile = profile / profile[0]
    assert _misfit(profile, lambda a, b: a * np.exp(-r / abs(b)), [1.0, 10.0]) > 0.1


# --- bundles ---------------------------------------------------------------------------------------------------------


def test_a_case_is_a_bundle_that_tells_nothing(tmp_path: Path) -> None:
    spec = case(group="double", causes=("vignetting", "defocus"), strengths=(10.0, 10.0))
    path, truth = write_case(spec, tmp_path / "one")
    again, _ = write_case(spec, tmp_path / "two")
    assert path.name != again.name
    bundle = read_bundle(path)
    assert bundle.scene == believed("tiny")
    assert bundle.available >= {"press", "force", "voltage", "time", "replicates", "lens_cap", "square"}
    words = {*NAMED, *NOT_IN_LIBRARY, spec.id, "seed", "truth"} - {"saturation"}
    for file in sorted(p for p in path.rglob("*") if p.is_file()):
        other = again / file.relative_to(path)
        assert file.read_bytes() == other.read_bytes()
        if file.suffix == ".png":
            assert cv2.imread(str(file), cv2.IMREAD_UNCHANGED).shape == (60, 80)
            chunks = file.read_bytes()
            assert b"tEXt" not in chunks
            assert b"tIME" not in chunks
        elif file.name != "scene.toml":
            assert not [w for w in words if w in file.read_text(encoding="utf-8")]
    assert bundle.scene.effects == {}
    assert truth["causes"] == list(spec.causes)


def test_what_nothing_explains_of_a_rig_is_the_noise_of_its_own_frames(tmp_path: Path) -> None:
    """With nothing hidden it is what the camera's table says; a brighter darkness is noisier."""
    specs = [CaseSpec(set="dev", rig="tiny", group="null", number=n) for n in range(40)]
    specs = [spec for spec in specs if spec.pose == 0][:6]
    # The exposure of each is drawn: 8 % of noise.
    left = np.mean([write_case(s, tmp_path / f"null{s.number}")[1]["unexplainable_DN2"] for s in specs])
    spare = [k for k, view in enumerate(rig_of("tiny", 0).views) if view.spare]
    assert left == pytest.approx(variances("tiny", 0)[spare].mean(), rel=0.1)
    lit = case(group="single", causes=("ambient_light",), strengths=(300.0,))
    _, brighter = write_case(lit, tmp_path / "lit")
    assert brighter["unexplainable_DN2"] > 1.02 * left


def test_stripping_takes_the_picture_away(tmp_path: Path) -> None:
    path, _ = write_case(case(group="null"), tmp_path)
    before = read_bundle(path).press
    whole = read_bundle(path).frame(before[5]).astype(float)
    strip_pixels(path, "shuffle")
    shuffled = read_bundle(path).frame(before[5]).astype(float)
    np.testing.assert_array_equal(np.sort(whole, axis=None), np.sort(shuffled, axis=None))
    assert abs(np.corrcoef(whole.ravel(), shuffled.ravel())[0, 1]) < 0.06
    strip_pixels(path, "flat")
    assert len(np.unique(read_bundle(path).frame(before[5]))) == 1


# --- exposure, force, what is held back ------------------------------------------------------------------------------


def test_what_an_exposure_hides_is_no_strength() -> None:
    """Rationale: a plate that takes a fifth of the light had a strength of 20 by the tone curve's bend along exposure.

    Two fifths less light is nothing once the exposure is fitted; taken as a straight line it is a great deal.
    """

    class Dimmer(Hidden):
        id, unit, start, limit = "dimmer", "1", 0.01, 1.0

        def light(self, fine: np.ndarray, view: View, a: float) -> np.ndarray:
            return fine * (1.0 - a) if view.touches else fine

    rig, measure = rig_of("tiny", 0), ruler("tiny", 0)
    dimmer = Dimmer(np.random.default_rng(1), rig, 0)
    straight = measure.norm(means(rig, [(dimmer, 0.4)]) - measure.base)
    assert straight > 5.0
    assert measure.norm(departure(rig, measure, [(dimmer, 0.4)])) < 0.05 * straight
    # What is not nearly all exposure is left alone.
    level = make_cause("black_level", rig, 3, 0)
    plain = means(rig, [(level, 0.5)]) - measure.base
    np.testing.assert_array_equal(departure(rig, measure, [(level, 0.5)]), plain)


def test_a_run_keeps_every_outcome_and_does_none_twice(tmp_path: Path, monkeypatch) -> None:
    import challenge.run as runner

    begun: list[str] = []

    def outcome(spec: CaseSpec, judge: str, strip: str, keep: Path | None, beside: tuple) -> dict:
        begun.append(spec.id)
        record = {"truth": spec.as_dict()}
        return record | ({"error": "broke"} if len(begun) == 2 else {"answer": {"verdict": "none"}, "seconds": 0.1})

    monkeypatch.setattr(runner, "one_case", outcome)
    out, told = tmp_path / "run.jsonl", []
    some = {"workers": 0, "groups": ["double"], "show": told.append}
    count = sum(c.group == "double" for c in cases("dev"))
    assert run("dev", out, budget_s=0.0, **some) == []
    assert len(run("dev", out, limit=3, **some)) == 3
    assert "min left" in told[-1]
    first = run("dev", out, **some)
    # The one that broke among the first three is tried again.
    assert len(first) == count + 1 == len(begun)
    out.write_text(out.read_text()[:-7])  # killed while it wrote
    again = run("dev", out, **some)
    assert len(begun) == count + 2
    assert len({record["truth"]["id"] for record in again if "answer" in record}) == count
    assert sum("error" in record for record in again) == 1
    assert [record["truth"]["id"] for record in again[:3]] == [c.id for c in cases("dev") if c.group == "double"][:3]
    # A scored run is one critic's.
    monkeypatch.setattr(runner, "commit", lambda: "other")
    with pytest.raises(runner.MixedRun, match="begun by the code of"):
        run("scored", out, workers=0, show=lambda text: None)
    # Cases that somebody has looked at are left out of another run.
    spent = {record["truth"]["id"] for record in first[:5]}
    fresh = run("dev", tmp_path / "fresh.jsonl", spent=spent, **some)
    assert len(fresh) == count - len(spent)
    assert not spent & {record["truth"]["id"] for record in fresh}


def test_an_answer_that_another_rig_was_measured_is_an_answer(tmp_path: Path, monkeypatch) -> None:
    class AnotherRig(Exception):
        def as_dict(self) -> dict:
            return {"causes": []}

    def critic(path: Path, exclude: tuple = ()) -> dict:
        if exclude:
            raise ValueError("broken")
        raise AnotherRig

    monkeypatch.setattr("challenge.baselines.critic", critic, raising=False)
    judge = judge_of("challenge.baselines:critic")
    assert judge(tmp_path) == {"verdict": GROSS, "causes": []}
    with pytest.raises(ValueError, match="broken"):
        judge(tmp_path, exclude=("specks",))


@pytest.mark.whole_case
def test_matched_filters_find_strong_causes_and_nothing_in_shuffled_ones(tmp_path: Path, monkeypatch) -> None:
    """The baseline names most strong causes of the tiny rig, says none of a null, and has no name for noise."""
    monkeypatch.setattr("challenge.baselines.POSES", 1)
    some = ("black_level", "tone_curve", "defocus", "led_warmup", "modulus", "creep", "square_size", "card_offset")
    right, shuffled = 0, 0
    for name in some:
        path, _ = write_case(
            case(
                group="single",
                causes=(name,),
                strengths=(40.0,),
            ),
            tmp_path,
        )
        said = matched_filters(path)
        right += said["verdict"] == "causes" and said["causes"][0]["id"] == name
        assert sum(said["posterior"]["inclusion"].values()) <= 1 + 1e-9
        strip_pixels(path, "shuffle")
        said = matched_filters(path)
        shuffled += said["verdict"] == "causes" and said["causes"][0]["id"] == name
    assert right >= 5
    assert shuffled <= 2


def test_an_edge_moves_with_the_force_and_is_no_share_of_a_slope() -> None:
    """A disc whose radius grows as the cube root of the force, at a force 13 % higher, against the disc itself."""
    y, x = np.mgrid[:300, :300] - 150.0

    def disc(force: float) -> np.ndarray:
        # As wide an edge as the lens of the rig draws.
        return 1.0 / (1.0 + np.exp((np.hypot(x, y) - 110.0 * force ** (1 / 3)) / 2.0))

    slope = (disc(np.exp(0.01)) - disc(np.exp(-0.01))) / 0.02
    base = BaseLight((1.0,), disc(1.0)[None], slope[None], {}, (0.0, 0.0), lambda k, n: disc(float(np.exp(n * KNOT))))
    # Half-way between pictures, where a straight line is worst.
    grown = 6.5 * KNOT
    true, line = disc(float(np.exp(grown))), disc(1.0) + grown * slope
    assert np.abs(base.pressed(0, grown) - true).max() < 0.01
    assert np.abs(line - true).max() > 0.1
    assert np.array_equal(base.pressed(0, 0.0), disc(1.0))
    assert np.abs(base.pressed(0, -grown) - disc(float(np.exp(-grown)))).max() < 0.01


def test_knowing_what_fitted_nuisances_take_gains_nothing_on_frames_held_back() -> None:
    rig, measure = rig_of("tiny", 0), ruler("tiny", 0)
    spec = case(group="null")
    seen = {name for places, _ in measure.columns for name in (measure.names[p] for p in places)}
    assert {"black", "light"} <= seen
    black = np.zeros_like(measure.base)
    for k, (places, own) in enumerate(measure.columns):
        black[k] = own[[measure.names[p] for p in places].index("black")]
    # Eight times what is believed possible, and all frames but those held back say so.
    taken = oracle_gain(spec, rig, measure, 2.4 * black)
    spare = np.array([view.spare for view in rig.views])
    unseen = oracle_gain(spec, rig, measure, 2.4 * black * spare[:, None, None])
    assert taken < 0.01 * unseen
    assert unseen > 10.0


def test_marks_are_those_that_issue_and_page_list() -> None:
    assert {"specks", "hot_pixels", "sensor_dust", "scratch", "residue_film", "rolling_shutter"} == MARKS
