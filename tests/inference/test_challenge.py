"""The challenge itself: who hides causes shares nothing with who looks for them, and strengths are as stated."""

from __future__ import annotations

import ast
import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy import optimize

from challenge import families_camera, families_light
from challenge.camera import Developed, Electronics, binned, filled, noisy_frame, true_curve
from challenge.cases import CaseSpec, cases, slice_of
from challenge.chain import curve_of, expose, rig_of
from challenge.codec import by_video
from challenge.hidden import Hidden
from challenge.library import NAMED, NOT_IN_LIBRARY, NOT_INJECTED, make_cause
from challenge.make import oracle_gain, pictures, prepare, write_case
from challenge.rig import KNOT, BaseLight, View, believed
from challenge.run import main, run, strip_pixels
from challenge.score import Rate, covered, summary, top, wilson
from challenge.strength import departure, means, ruler
from challenge.told import told
from evanesce.bundle import read_bundle
from evanesce.effects import all_effects
from evanesce.effects.readout.saturation import softened
from evanesce.effects.readout.tone_curve import departed

FOLDER = Path(__file__).parent / "challenge"
FORBIDDEN = (
    "evanesce.effects",
    "evanesce.criticism",
    "evanesce.chain.simulate",
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


# --- nothing shared --------------------------------------------------------------------------------------------------


def test_no_module_of_the_challenge_imports_effects_or_critic() -> None:
    modules = sorted(FOLDER.glob("*.py"))
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
        "for m in pkgutil.iter_modules(challenge.__path__): importlib.import_module('challenge.' + m.name)\n"
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
    assert len(NOT_IN_LIBRARY) >= 6


# --- cases -----------------------------------------------------------------------------------------------------------


def test_case_lists_hold_what_they_promise() -> None:
    for name in ("dev", "scored"):
        every = cases(name)
        assert len({c.id for c in every}) == len(every)
        nulls = [c for c in every if c.group == "null"]
        assert sum(c.noise not in ("plain", "lowpass") for c in nulls) * 2 == len(nulls)
        singles = {(c.causes[0], c.strengths[0]) for c in every if c.group == "single"}
        assert len(singles) == 6 * len(NAMED)
        assert any(c.cancelling for c in every)
    assert not {c.seed for c in cases("dev")} & {c.seed for c in cases("scored")}
    assert {c.group for c in slice_of()} == {c.group for c in cases("dev")}


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
def rig():
    return rig_of("dev", 0)


@pytest.mark.whole_case
@pytest.mark.parametrize("name", [*NAMED, *NOT_IN_LIBRARY])
def test_nothing_is_changed_at_amplitude_zero(rig, name: str) -> None:
    some = replace(rig, views=tuple(rig.views[k] for k in (0, 12, 18, 20, 21)))
    cause = make_cause(name, some, 4, 1)
    for view in some.views:
        one, other = expose(some, view, [(cause, 0.0)], _none()), expose(some, view, (), _none())
        np.testing.assert_array_equal(one.charge_e, other.charge_e)
        np.testing.assert_array_equal(
            one.offset_DN + np.zeros_like(one.charge_e), other.offset_DN + np.zeros_like(one.charge_e)
        )
    np.testing.assert_allclose(curve_of(some, [(cause, 0.0)]), curve_of(some, ()), atol=1e-8)


def _none():
    from challenge.chain import Nuisances

    return Nuisances()


@pytest.mark.parametrize(
    ("name", "strength"),
    [pytest.param("vignetting", 7.0, marks=pytest.mark.slow), ("black_level", 20.0), ("modulus", 10.0)],
)
@pytest.mark.slow  # draws of the whole rig: 30 s
def test_strength_is_the_norm_that_noise_gives(name: str, strength: float) -> None:
    """The matched filter's output on drawn frames has mean s and deviation 1: s is a signal-to-noise ratio."""
    spec = CaseSpec(set="dev", group="single", causes=(name,), strengths=(strength,))
    object.__setattr__(spec, "number", next(n for n in range(50) if replace(spec, number=n).pose == 0))
    made, measure = prepare(spec), ruler("dev", 0)
    assert made.truth["strength_together"] == pytest.approx(strength, rel=0.015)
    change = means(made.rig, made.causes) - measure.base
    made = replace(made, nuisances=_none())
    outputs = []
    for seed in range(6):
        frames = pictures(made, "plain", seed)
        seen = np.array([np.mean([binned(f.astype(float)) for f in frames[k]], axis=0) for k in frames])
        outputs.append(measure.inner(change, seen - measure.base) / strength)
    # Six outputs of deviation 1; the marginalised filter's own variance is below 1.
    assert abs(np.mean(outputs) - strength) < 4 / np.sqrt(6) + 0.03 * strength
    assert np.std(outputs, ddof=1) < 2.2


@pytest.mark.whole_case
def test_nuisances_hide_what_they_can_absorb(rig) -> None:
    measure = ruler("dev", 0)
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


@pytest.mark.whole_case
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


@pytest.mark.whole_case
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


@pytest.mark.whole_case
def test_mask_is_no_parabola(rig) -> None:
    for form in (0, 1):
        cause = families_camera.Vignetting(np.random.default_rng(2), rig, form)
        free = cause.free(0.6)
        r2 = ((rig.at.u - cause.centre[0]) ** 2 + (rig.at.v - cause.centre[1]) ** 2).ravel()[::97]
        assert _misfit(free.ravel()[::97], lambda k, r2=r2: 1 - k * r2, [0.1]) > 0.05


@pytest.mark.whole_case
def test_glow_is_two_gaussians_and_no_exponential(rig) -> None:
    cause = families_light.LateralGlow(np.random.default_rng(3), rig, 0)
    r = np.linspace(0, 60, 300)
    profile = sum(share * np.exp(-0.5 * (r / s) ** 2) / s**2 for share, s in cause.parts)
    profile = profile / profile[0]
    assert _misfit(profile, lambda a, b: a * np.exp(-r / abs(b)), [1.0, 10.0]) > 0.1


# --- bundles ---------------------------------------------------------------------------------------------------------


def test_a_case_is_a_bundle_that_tells_nothing(tmp_path: Path) -> None:
    spec = next(c for c in cases("dev") if c.group == "double" and c.pose == 0)
    path, truth = write_case(spec, tmp_path / "one")
    again, _ = write_case(spec, tmp_path / "two")
    assert path.name != again.name
    bundle = read_bundle(path)
    assert bundle.scene == believed("dev")
    assert bundle.available >= {"press", "force", "voltage", "time", "replicates", "lens_cap", "square"}
    words = {*NAMED, *NOT_IN_LIBRARY, spec.id, "seed", "truth"} - {"saturation"}
    for file in sorted(p for p in path.rglob("*") if p.is_file()):
        other = again / file.relative_to(path)
        assert file.read_bytes() == other.read_bytes()
        if file.suffix == ".png":
            assert cv2.imread(str(file), cv2.IMREAD_UNCHANGED).shape == (300, 400)
            chunks = file.read_bytes()
            assert b"tEXt" not in chunks
            assert b"tIME" not in chunks
        elif file.name != "scene.toml":
            assert not [w for w in words if w in file.read_text(encoding="utf-8")]
    assert bundle.scene.effects == {}
    assert truth["causes"] == spec.causes


def test_stripping_takes_the_picture_away(tmp_path: Path) -> None:
    path, _ = write_case(next(c for c in cases("dev") if c.group == "null" and c.pose == 0), tmp_path)
    before = read_bundle(path).press
    whole = read_bundle(path).frame(before[5]).astype(float)
    strip_pixels(path, "shuffle")
    shuffled = read_bundle(path).frame(before[5]).astype(float)
    np.testing.assert_array_equal(np.sort(whole, axis=None), np.sort(shuffled, axis=None))
    assert abs(np.corrcoef(whole.ravel(), shuffled.ravel())[0, 1]) < 0.02
    strip_pixels(path, "flat")
    assert len(np.unique(read_bundle(path).frame(before[5]))) == 1


# --- scores ----------------------------------------------------------------------------------------------------------


def test_wilson_intervals_cover() -> None:
    # Exact figures: Newcombe, Stat. Med. 17 (1998) 857, table I: 81/263 and 15/148, 0/20, 1/29.
    for hits, count, low, high in (
        (81, 263, 0.2553, 0.3662),
        (15, 148, 0.0624, 0.1605),
        (0, 20, 0.0, 0.1611),
        (1, 29, 0.0061, 0.1718),
    ):
        found = wilson(hits, count)
        assert found == pytest.approx((low, high), abs=6e-5)


def record(cause: str, answer: dict, group: str = "single", strength: float = 20.0, **more: object) -> dict:
    truth = {"id": cause + str(more), "group": group, "causes": [cause] if cause else [], "strengths": [strength],
             "noise": "plain", "drop": [], "decoy": "", "cancelling": False, "oracle_gain": 10.0} | more  # fmt: skip
    return {"truth": truth, "answer": answer, "seconds": 1.0}


def named(cause: str, p: float = 0.9, **more: object) -> dict:
    return {"verdict": "named", "probabilities": {cause: p, "none": 1 - p}, "effects": [{"id": cause}]} | more


def test_an_interval_is_scored_where_form_and_library_share_a_number() -> None:
    """A square whose drawn logarithm of the side is 0.01 must be called exp(+-0.01) - 1, by the sign that was drawn."""
    scored = [c for c in cases("scored") if c.group == "single" and c.causes == ("square_size",)]
    signs, held = set(), []
    for spec in scored:
        truth = spec.as_dict() | {"amplitudes": [0.01], "oracle_gain": 1.0}
        known = told(truth)
        assert known is not None
        assert known[0] == "square"
        assert np.log1p(known[1]) == pytest.approx(0.01 * np.sign(known[1]))
        cause = make_cause("square_size", None, spec.seed, 1)  # type: ignore[arg-type]
        assert np.sign(known[1]) == cause.sign
        signs.add(cause.sign)
        for centre in (known[1], -known[1]):
            answer = named("square_size")
            answer["effects"][0]["parameters"] = {
                "square": {"value": centre, "lo": centre - 0.008, "hi": centre + 0.008}
            }
            found = covered({"truth": truth, "answer": answer})
            assert found is not None
            held.append(found[0])
    assert signs == {-1.0, 1.0}
    assert held == [True, False] * len(scored)
    assert covered(record("specks", named("specks"))) is None
    assert told(record("vignetting", {})["truth"]) is None


def test_a_case_that_breaks_counts_as_answered_wrongly() -> None:
    broken = {"error": "ValueError: no"}
    single, null = ({**record(c, {}, group=g), **broken} for c, g in (("vignetting", "single"), ("", "null")))
    for one in (single, null):
        del one["answer"], one["seconds"]
    found = summary([single, null, record("vignetting", named("vignetting"), number=2)])
    assert found["detection"]["20"]["hits"] == 1
    assert found["detection"]["20"]["cases"] == 2
    assert found["false_alarms"]["all"]["hits"] == 1
    assert found["top1_all"]["20"]["cases"] == 2
    assert found["in_set"]["hits"] == 1
    assert found["confusion"]["none"] == {"error": 1}


def test_scores_of_made_up_answers() -> None:
    silent = {"verdict": "none", "probabilities": {"none": 0.9, "vignetting": 0.1}, "effects": []}
    doubt = {"verdict": "ambiguous", "probabilities": {"defocus": 0.5, "lateral_glow": 0.5},
             "effects": [{"id": "defocus"}], "ambiguous_with": ["lateral_glow"],
             "next_measurement": {"what": "checkerboard"}}  # fmt: skip
    found = summary(
        [
            record("vignetting", named("vignetting", gain={"log_score": [9.0, 5.0, 12.0]})),
            record("vignetting", named("defocus"), number=1),
            record("vignetting", silent, strength=4.0),
            record("", silent, group="null"),
            record("", named("specks", gain={"log_score": [3.0, 1.0, 5.0]}), group="null", noise="h264"),
            record("", named("compression"), group="null", noise="h264", number=2),
            record("lateral_glow", doubt, group="decoy", drop=["checkerboard"], decoy="defocus"),
            record("moire", {"verdict": "unknown", "probabilities": {"unknown": 0.8}, "effects": []}, group="unknown"),
            {"truth": record("x", {})["truth"], "error": "broke"},
        ]
    )
    assert found["detection"]["20"]["hits"] == 2
    assert found["detection"]["4"]["hits"] == 0
    # The one that broke among them.
    assert found["top1_all"]["20"] == Rate(1, 3).as_dict()
    assert found["false_alarms"]["all"]["hits"] == 1
    assert found["false_alarms"]["h264"]["cases"] == 2
    assert found["decoys"]["answered_as_set_without_the_shot"]["hits"] == 1
    assert found["decoys"]["right_shot_advised"]["hits"] == 1
    assert found["unknown"]["unknown"]["called_unknown"]["hits"] == 1
    assert found["gain"]["named"]["median"] == pytest.approx(0.9)
    assert found["gain"]["null_interval_above_0"]["hits"] == 1
    assert found["failed"] == {"x{}": "broke"}
    assert found["confusion"]["vignetting"] == {"vignetting": 1, "defocus": 1, "none": 1}
    # Said 0.9 and right twice of four (named right, named wrong, two nulls: one right), said 0.8 and right once.
    assert 0 < found["calibration"]["error"] < 1
    # It is written to disk at the end of a run that took hours.
    assert json.loads(json.dumps(found))["calibration"]["cases"] == found["calibration"]["cases"]


def test_the_score_itself_gives_chance_where_truths_are_shuffled() -> None:
    """Of the score alone."""
    rng, names = np.random.default_rng(1), list(NAMED)
    answers = [record(c, named(c), number=k) for k, c in enumerate(names * 20)]
    order = rng.permutation(len(answers))
    shuffled = [
        a | {"truth": a["truth"] | {"causes": answers[o]["truth"]["causes"]}}
        for a, o in zip(answers, order, strict=True)
    ]
    right = np.mean([top(r) == r["truth"]["causes"][0] for r in shuffled])
    assert np.mean([top(r) == r["truth"]["causes"][0] for r in answers]) == 1.0
    chance = 1 / len(names)
    assert abs(right - chance) < 4 * np.sqrt(chance / len(answers))


def test_a_slice_that_answers_wrongly_fails(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    wrong = {"verdict": "named", "probabilities": {"scratch": 1.0}, "effects": [{"id": "scratch"}]}

    def judged(answered: bool) -> list[dict]:
        found = []
        for spec in slice_of():
            right = {"null": "none", "unknown": "unknown", "removed": "unknown"}.get(spec.group)
            answer = wrong if not answered else named(spec.causes[0]) if right is None else {
                "verdict": right, "probabilities": {right: 1.0}, "effects": []}  # fmt: skip
            found.append(
                {"truth": spec.as_dict() | {"oracle_gain": 1.0, "amplitudes": [0.01]}, "answer": answer, "seconds": 1.0}
            )
        return found

    monkeypatch.setattr("challenge.run.CACHE", tmp_path)
    for answered, code in ((True, 0), (False, 1)):
        monkeypatch.setattr("challenge.run.run", lambda *a, answered=answered, **k: judged(answered))
        assert main(["--set", "slice"]) == code


def test_what_an_exposure_hides_is_no_strength() -> None:
    """Rationale: a plate that takes a fifth of the light had a strength of 20 by the tone curve's bend along exposure.

    Two fifths less light is nothing once the exposure is fitted; taken as a straight line it is a great deal.
    """

    class Dimmer(Hidden):
        id, unit, start, limit = "dimmer", "1", 0.01, 1.0

        def light(self, fine: np.ndarray, view: View, a: float) -> np.ndarray:
            return fine * (1.0 - a) if view.touches else fine

    rig, measure = rig_of("dev", 0), ruler("dev", 0)
    dimmer = Dimmer(np.random.default_rng(1), rig, 0)
    straight = measure.norm(means(rig, [(dimmer, 0.4)]) - measure.base)
    assert straight > 10.0
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
    out = tmp_path / "run.jsonl"
    count = len(slice_of())
    assert run("slice", out, workers=0, budget_s=0.0, show=lambda text: None) == []
    first = run("slice", out, workers=0, show=lambda text: None)
    assert len(first) == count == len(begun)
    out.write_text(out.read_text()[:-7])  # killed while it wrote
    again = run("slice", out, workers=0, show=lambda text: None)
    # The case that broke and the one that was cut off are done once more; what failed stays on record.
    assert len(begun) == count + 2
    assert len({record["truth"]["id"] for record in again if "answer" in record}) == count
    assert sum("error" in record for record in again) == 1
    # A scored run is one critic's.
    monkeypatch.setattr(runner, "commit", lambda: "other")
    with pytest.raises(runner.MixedRun, match="begun by the code of"):
        run("scored", out, workers=0, show=lambda text: None)
    # Cases that somebody has looked at are left out of another run.
    spent = {record["truth"]["id"] for record in first[:5]}
    fresh = run("slice", tmp_path / "fresh.jsonl", workers=0, spent=spent, show=lambda text: None)
    assert len(fresh) == count - 5
    assert not spent & {record["truth"]["id"] for record in fresh}


@pytest.mark.slow
@pytest.mark.system
def test_a_run_goes_on_where_it_stopped_and_beats_no_stripped_pixels(tmp_path: Path, monkeypatch) -> None:
    """Nearest signature finds most loud causes; with the pixels shuffled it is at chance, and names say nothing."""
    import challenge.run as runner

    # One loud case of each of some causes, whose shapes are not drawn anew at random places.
    some = ("black_level", "tone_curve", "defocus", "led_warmup", "modulus", "creep", "square_size", "card_offset")
    loud = [c for c in cases("dev") if c.group == "single" and c.strengths == (40.0,) and c.causes[0] in some]
    monkeypatch.setattr(runner, "specs_of", lambda name: loud)
    out = tmp_path / "a.jsonl"
    first = run("dev", out, judge="nearest-signature", workers=1, budget_s=0.5, show=lambda text: None)
    assert 1 <= len(first) < len(loud)
    whole = run("dev", out, judge="nearest-signature", workers=1, show=lambda text: None)
    assert len(whole) == len(loud) == len(out.read_text().splitlines())
    right = sum(top(r) == r["truth"]["causes"][0] for r in whole)
    stripped = run(
        "dev", tmp_path / "b.jsonl", judge="nearest-signature", workers=1, strip="shuffle", show=lambda t: None
    )
    chance = sum(top(r) == r["truth"]["causes"][0] for r in stripped)
    assert right >= 5
    assert chance <= 2
    assert json.loads(out.read_text().splitlines()[0])["judge"] == "nearest-signature"


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
    rig, measure = rig_of("dev", 0), ruler("dev", 0)
    spec = next(c for c in cases("dev") if c.pose == 0)
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


@pytest.mark.whole_case
@pytest.mark.parametrize("form", [0, 1])
def test_every_scratch_is_a_number_everywhere(rig, form: int) -> None:
    """Rationale: the ends of an arc, where rounding made a cosine negative, once made one in some of them NaN."""
    for seed in range(12):
        assert np.isfinite(families_light.Scratch(np.random.default_rng(seed), rig, form).map).all()
