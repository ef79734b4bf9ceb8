"""The joint fit on bundles of the development rigs: first look, answer, and command line."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import development_rigs as rigs
import numpy as np
import pytest
from typer.testing import CliRunner

from evanesce.bundle.card_light import mean_reflectance
from evanesce.bundle.read import read_bundle
from evanesce.cli.app import app
from evanesce.core.errors import InputError, WorkError
from evanesce.effects import all_effects
from evanesce.inference.card_start import board_inverted, card_start, on_prints
from evanesce.inference.causes import causes_of
from evanesce.inference.constants import CERTAIN
from evanesce.inference.critic import criticise_frames
from evanesce.inference.data import data_vector
from evanesce.inference.gate import _board_lines, gate_of
from evanesce.inference.laws import all_laws
from evanesce.inference.model import AnchoredModel
from evanesce.inference.next_shot import doubtful, next_shot
from evanesce.inference.patch import PlateReader
from evanesce.inference.posterior import Weights
from evanesce.inference.shape_picture import mean_and_variation, shape_figure
from evanesce.inference.shapes import FormBank
from evanesce.inference.single_effects import NONE, Place
from evanesce.optics.projection import Projection
from evanesce.prediction.observe import observe
from evanesce.prediction.parameters import Parameter
from evanesce.prediction.predict import Predictor
from evanesce.prediction.processes import KEEP, present, processes, shares
from evanesce.prediction.views import BIN_PX, View
from evanesce.render.cards import checkerboard_of, square_of
from evanesce.rig import Cards, load_scene

runner = CliRunner()

CONSIDERED = ("modulus", "black_level", "led_droop", "tone_curve")


@pytest.fixture(scope="session")
def tiny(tmp_path_factory: Any) -> Path:
    folder: Path = tmp_path_factory.mktemp("rigs") / "tiny"
    rigs.write_rig("tiny", folder)
    return folder


def test_a_drawn_ellipse_is_read_on_the_plate():
    """Area to 1 %, axes to 1 %, centre to a tenth of a pixel, through distortion and an offset axis."""
    scene = rigs.RIGS["one"].scene()
    projection = Projection.of(scene.camera, scene.plate)
    cols, rows = scene.camera.resolution_px
    total = np.zeros((rows, cols))
    for dy in (-0.375, -0.125, 0.125, 0.375):
        for dx in (-0.375, -0.125, 0.125, 0.375):
            u, v = np.meshgrid(np.arange(cols) + dx, np.arange(rows) + dy)
            x, y = projection.to_plate(u, v)
            total += np.hypot((x - 2.1) / 5.0, (y + 1.3) / 3.2) < 1
    patch = PlateReader(scene).patch(12.0 + 150.0 * total / 16)
    assert patch is not None
    assert patch.area_mm2 == pytest.approx(np.pi * 5.0 * 3.2, rel=0.01)
    assert patch.axes == pytest.approx(5.0 / 3.2, rel=0.01)
    assert patch.centre_mm == pytest.approx((2.1, -1.3), abs=0.1 / scene.camera.scale_px_per_mm)
    assert PlateReader(scene).patch(np.full((rows, cols), 12.0)) is None


def test_another_finger_is_told_before_anything_is_fitted(tmp_path):
    """An ellipse drawn with NumPy where the scene has a round contact: exit code 1, one line, JSON all the same."""
    folder, answer = tmp_path / "other", tmp_path / "answer.json"
    rigs.write_other_finger(folder, "tiny")
    result = runner.invoke(app, ["criticise", str(folder), "--json", str(answer)])
    assert result.exit_code == 1
    said = json.loads(answer.read_text(encoding="utf-8"))
    assert "elliptic" in said["first_line"]
    assert "round" in said["first_line"]
    assert said["causes"] == []
    assert said["version"] == 1
    measured = {line["name"]: line for line in said["gate"]}
    assert measured["ratio of the contact's axes"]["measured"] == pytest.approx(1.45, rel=0.05)
    assert measured["contact area"]["measured"] == pytest.approx(49.0, rel=0.05)


@pytest.mark.whole_case
def test_causes_are_named_with_what_they_do_to_the_area(tiny):
    """Modulus, black level and droop, which takes a thousandth of what they do, and may be told as without effect."""
    exclude = set(all_effects()) - set(CONSIDERED)
    criticism = criticise_frames(read_bundle(tiny), exclude=exclude)
    result, scene = criticism.result, criticism.scene
    found = {cause["id"]: cause for cause in result["causes"]}
    assert set(found) | {"led_droop"} == {"modulus", "black_level", "led_droop"}
    assert "led_droop" in result["first_line"]
    assert all(c["probability"] == pytest.approx(CERTAIN, abs=0.01) for c in result["causes"])
    assert all(c["credible_set"] == [c["id"]] for c in result["causes"])
    assert result["verdict"] == "causes"
    assert {one["id"] for one in result["not_judged"]} | set(found) == {*CONSIDERED}
    assert sum(c["misfit_share"] for c in result["causes"]) > 0.9
    modulus = found["modulus"]["parameters"]["relative"]
    assert modulus["lo"] < 0.15 < modulus["hi"]
    assert modulus["hi"] - modulus["lo"] < 0.05
    # Hertz: the area goes as the modulus to the power of -2/3.
    at_most = min(found["modulus"]["area"]["percent"])
    assert at_most == pytest.approx(100 * (1.15 ** (-2 / 3) - 1), abs=2.5)
    assert result["misfit"]["removed_share"] > 0.98
    dark = next(line for line in result["gate"] if line["name"] == "level with the lens covered")
    assert dark["measured"] - dark["predicted"] == pytest.approx(
        4.5 * 8 / 16, abs=0.2
    )  # slope near black, 12 bits to 8
    held_out = result["held_out"]
    assert held_out["rms_DN"][1] < 0.3 * held_out["rms_DN"][0]
    assert held_out["area_error_percent"][1] < held_out["area_error_percent"][0]
    assert not held_out["area_worse"]
    # Each strong cause by itself predicts frames that no fit saw.
    assert all(found[name]["held_out_nats"][1] > 10.0 for name in ("modulus", "black_level"))
    assert "modulus" in scene


def test_forms_are_kept_and_every_effect_has_some(tiny, tmp_path, monkeypatch):
    """A second reading of the bundle takes forms from disk; effects that no file of laws names have forms as well."""
    monkeypatch.setenv("EVANESCE_CACHE", str(tmp_path))
    observation = observe(read_bundle(tiny))
    model = AnchoredModel(observation, data_vector(observation))
    causes, _ = causes_of(observation, set(all_effects()) - {"modulus", "vignetting", "black_level"})
    told: list[str] = []
    first = FormBank(model.coarse, {}, told.append).of(causes)
    again = FormBank(model.coarse, {}, told.append).of(causes)
    assert len(told) == 3
    for one, other in zip(first, again, strict=True):
        assert one.names == other.names
        np.testing.assert_array_equal(one.changes, other.changes)
    by_id = {forms.id: forms for forms in first}
    assert set(by_id["vignetting"].names) == {"", "natural fall-off", "clipped pupil", "hood"}
    assert set(by_id["modulus"].names) == set(by_id["black_level"].names) == {""}
    assert "modulus" not in all_laws()
    bright = np.abs(by_id["modulus"].changes.astype(float)).max(axis=0)
    assert bright.max() > 1.0


def test_a_picture_of_no_known_kind_is_refused_before_anything_is_read(tiny, tmp_path):
    target = tmp_path / "shapes.xyz"
    result = runner.invoke(app, ["criticise", str(tiny), "--shapes", str(target)])
    assert result.exit_code == 2
    assert ".png" in result.output
    assert not target.exists()


def test_picture_of_forms_shows_each_cause_where_it_shows(tiny):
    """Two panels a cause; the glow about a contact changes most what is beside it, absorption what is in it."""
    observation = observe(read_bundle(tiny))
    data = data_vector(observation)
    model = AnchoredModel(observation, data)
    causes, _ = causes_of(observation, set(all_effects()) - {"vignetting", "led_droop", "modulus"})
    every = FormBank(model.coarse, {}).of(causes)
    by_id = {forms.id: mean_and_variation(forms, data) for forms in every}
    view, mean, deviation = by_id["led_droop"]
    lit = data.cube[data.open[view]] > 100
    assert np.abs(mean[lit]).mean() > 3 * np.abs(mean[~lit]).mean()
    # Droop has one form up to its size at one voltage; fall-off has many.
    assert deviation.max() < 0.5 * np.abs(mean).max()
    assert by_id["vignetting"][2].max() > 0.1 * np.abs(by_id["vignetting"][1]).max()
    figure = shape_figure(every, data)
    titles = [axis.get_title() for axis in figure.axes if axis.get_title()]
    assert {"vignetting", "led_droop", "modulus"} <= set(titles)


def test_noise_beside_an_edge_goes_by_its_own_level(tiny):
    """A contact that is predicted a bin aside leaves tens of DN along its rim; the dark bins there stay as noisy."""
    observation = observe(read_bundle(tiny))
    cube = observation.cube
    right = data_vector(observation, cube)
    touching = np.array([view.touches for view in observation.views])[:, None, None]
    dark = touching & (cube < 6.0)
    for axis in (1, 2):
        predicted = np.roll(cube, 1, axis=axis)
        assert np.abs(predicted - cube)[dark].max() > 30.0
        ratio = data_vector(observation, predicted).sd[dark] / right.sd[dark]
        assert np.quantile(ratio, 0.001) > 0.55
        assert np.quantile(ratio, 0.999) < 2.7


def test_weights_do_not_follow_the_noise_that_they_weigh(tiny):
    """Where variance rises with the level, bins that are low by chance would weigh more, and darkness come out low."""
    observation = observe(read_bundle(tiny))
    touching = np.array([view.touches for view in observation.views])[:, None, None]
    still = np.where(touching, 2.0, observation.cube)
    drawn = np.random.default_rng(3).normal(0.0, 0.8, still.shape) * touching
    images = np.kron(still + drawn, np.ones((BIN_PX, BIN_PX))).astype(np.float32)
    found = data_vector(replace(observation, images=images), still)
    seen = np.broadcast_to(touching, still.shape)
    related = float(np.corrcoef(found.sd[seen], drawn[seen])[0, 1])
    assert abs(related) < 4.0 / np.sqrt(seen.sum())


def test_noise_of_single_frames_goes_by_the_level_that_many_share(tiny):
    """Darkness half a DN above what was predicted is a tenth noisier; no bin's surroundings show it in one frame."""
    observation = observe(read_bundle(tiny))
    touching = np.array([view.touches for view in observation.views])[:, None, None]
    still = np.where(touching, 2.0, observation.cube)
    drawn = np.random.default_rng(4).normal(0.0, 0.8, still.shape) * touching
    images = np.kron(still + drawn, np.ones((BIN_PX, BIN_PX))).astype(np.float32)
    seen = np.broadcast_to(touching, still.shape)
    told = data_vector(replace(observation, images=images), np.where(touching, 1.5, still)).sd[seen]
    right = data_vector(replace(observation, images=images), still).sd[seen]
    wrong = data_vector(
        replace(observation, images=images - 0.5 * seen.repeat(BIN_PX, 1).repeat(BIN_PX, 2)), still - 0.5 * seen
    ).sd[seen]
    assert np.median(right) > 1.03 * np.median(wrong)
    assert abs(np.median(told) / np.median(right) - 1.0) < 0.01


def test_next_shot_is_one_that_tells_rivals_apart(tiny):
    """Droop and a shifted bin differ by voltage: a further voltage is worth most, a board in room light nothing."""
    observation = observe(read_bundle(tiny))
    model = AnchoredModel(observation, data_vector(observation))
    causes, _ = causes_of(observation, set(all_effects()) - {"led_droop", "led_bin"})
    bank = FormBank(model.coarse, {})
    rng = np.random.default_rng(0)
    forms = {f.id: len(f.changes) for f in bank.of(causes)}
    # What the data are taken to have left open: which of two, and 5 % of the light either way.
    weights = {n: Weights(k, 0.3 * rng.standard_normal(k), 0.1 * np.eye(k)) for n, k in forms.items()}
    place = Place({}, {NONE: 0.0, "led_droop": 0.5, "led_bin": 0.5})
    found = next_shot(model, bank, causes, place, weights)
    gains = {row["what"]: row["gain_nats"] for row in found["menu"]}
    assert set(found["between"]) == {"led_droop", "led_bin"}
    assert found["entropy_nats"] == pytest.approx(np.log(2))
    assert all(0.0 <= gain <= np.log(2) + 1e-9 for gain in gains.values())
    assert gains["a checkerboard"] < 0.01
    best = max(gains, key=lambda name: gains[name])
    assert best.startswith("press at")
    assert gains[best] > 0.2
    assert found["what"] is not None
    assert doubtful({"led_droop": place, "other": Place({}, {NONE: 0.0, "x": 1.0})}) == "led_droop"
    assert doubtful({"other": Place({}, {NONE: 0.0, "x": 1.0})}) == ""


@pytest.mark.whole_case
def test_the_command_writes_answer_and_scene(tiny, tmp_path):
    """All causes of the library; the extended scene loads and carries what was named. Two minutes."""
    answer = tmp_path / "answer.json"
    page = tmp_path / "page.html"
    result = runner.invoke(app, ["criticise", str(tiny), "--json", str(answer), "--report", str(page)])
    assert result.exit_code == 0, result.output
    html = page.read_text(encoding="utf-8")
    assert html.count("data:image/png") == 3
    said = json.loads(answer.read_text(encoding="utf-8"))
    assert said["first_line"] in html.replace("&#39;", "'")
    scene = load_scene(said["extended_scene"])
    assert set(scene.effects) == {cause["id"] for cause in said["causes"]}
    assert scene.effects["modulus"]["relative"] == pytest.approx(0.15, abs=0.02)


@pytest.mark.slow  # 15 s: a process starts
def test_two_processes_predict_what_one_does(tiny):
    """Coarse and fine, to the last bit; what the rig cannot have is said by either, and then all goes on."""
    observation = observe(read_bundle(tiny))
    model = AnchoredModel(observation, data_vector(observation))
    points = [{"modulus:relative": 0.1}, {"vignetting:k": 0.2}, {"defocus:blur_um": 9.0}]
    alone = [model.coarse.cube(point) for point in points]
    fine = model.fine(points[0]).cube()
    with processes(2):
        assert present() is not None
        for point, one in zip(points, alone, strict=True):
            np.testing.assert_array_equal(model.coarse.cube(point), one)
        with pytest.raises(InputError, match=r"effects\.modulus"):
            model.coarse.cube({"modulus:relative": 1e6})
        np.testing.assert_array_equal(model.coarse.cube(points[1]), alone[1])
        for number in range(2 * KEEP):
            model.fine({"@light": 0.01 * number}).cube()
        np.testing.assert_array_equal(model.fine(points[0]).cube(), fine)
        np.testing.assert_array_equal(model.coarse.cube(points[2]), alone[2])
        names = ("modulus:relative", "vignetting:k")
        free = [Parameter(name=name, deviation=0.1, step=0.01, bounds=(0.0, 0.9)) for name in names]
        asked = [*((points[0], parameter) for parameter in free), ({"modulus:relative": 1e6}, free[0])]
        asked.append(asked[0])
        made = model.derivatives(asked)
        assert isinstance(made[2], InputError)
        for k in (0, 1, 3):
            np.testing.assert_array_equal(made[k], model.derivative(*asked[k]))
        for process in present()._running:
            process.kill()
        with pytest.raises(WorkError, match="has ended"):
            model.coarse.cube(points[0])
    assert present() is None


def test_each_process_has_states_of_a_force_for_its_own(tiny):
    views = observe(read_bundle(tiny)).views
    for count in (1, 2, 3):
        parts = shares(views, count)
        assert sorted(k for part in parts for k in part) == list(range(len(views)))
        for one in parts:
            for other in parts:
                if one is not other:
                    assert not {views[k].force_N for k in one if views[k].touches} & {
                        views[k].force_N for k in other if views[k].touches
                    }


def test_processes_have_as_many_states_each_and_cards_apart():
    """Twelve frames of one force are one state: a process that has them takes about as many others as the rest."""
    forces = [0.4, 1.0, 1.8, 3.0, 4.0, *[5.0] * 12]
    presses = [View(kind="press", force_N=force, time_s=float(k), index=k) for k, force in enumerate(forces)]
    cards = [View(kind=kind) for kind in ("checkerboard", "square")]
    parts = shares([*presses, *cards], 2)
    states = [{forces[k] for k in part if k < len(forces)} for part in parts]
    assert sorted(map(len, states)) == [3, 3]
    assert [sum(k >= len(forces) for k in part) for part in parts] == [1, 1]
    # A step of a fit asks for no locked one: two of four open states each.
    views = [replace(view, locked=view.force_N in (1.0, 3.0)) for view in presses] + cards
    opened = [{views[k].force_N for k in part if views[k].touches and not views[k].locked} for part in shares(views, 2)]
    assert [len(one) for one in opened] == [2, 2]


def test_one_image_serves_all_levels_of_the_leds(tiny):
    """With light that LEDs bring, light that effects scatter of it, and light that no LED brings."""
    observation = observe(read_bundle(tiny))
    point = {
        "led_warmup:warming_K": 3.0, "residue_film:relative_radiance": 0.04, "vignetting:k": 0.1,
        "led_spill:share": 0.1, "ambient_light:radiance_W_per_mm2_sr": 5e-8, "specks:per_cm2": 60.0,
    }  # fmt: skip
    together = Predictor(observation.scene, observation.views)
    found = together.cube(point)
    touching = [k for k, view in enumerate(observation.views) if view.touches]
    assert len(together._images._values) < len(touching)
    for k in touching:
        alone = Predictor(observation.scene, observation.views).bins_at(point, [k])[k]
        np.testing.assert_allclose(found[k], alone, atol=1e-3)


@pytest.mark.parametrize(("light", "x", "y"), [(-1.5, 0.0, 0.0), (-0.8, 1.9, -1.2), (0.4, -2.4, 0.7)])
def test_a_card_is_looked_for_before_it_is_fitted(tiny, light, x, y):
    """In a room that makes the predicted card white all over, or beside its place by most of a square."""
    observation = observe(read_bundle(tiny))
    view = replace(observation.views[0], kind="checkerboard", force_N=None)
    coarse = Predictor(observation.scene, [view])
    there = {"light": light, "pose_x": x, "pose_y": y}
    point = {f"@{'card_light' if name == 'light' else name}[checkerboard]": value for name, value in there.items()}
    shown = replace(observation, views=(view,), images=coarse.image(point, 0)[None])
    found = card_start(shown, coarse)
    before, after = (float(np.mean((coarse.image(one, 0) - shown.images[0]) ** 2)) for one in ({}, found))
    # A pixel aside is left to the fit, a bright square where a dark one lies is not.
    assert after < 0.1 * before
    assert found["@card_light[checkerboard]"] == pytest.approx(light, abs=0.1)


@pytest.mark.parametrize("curve", ["bt709", "linear"])
@pytest.mark.parametrize("side", [2.0, 5.0])
@pytest.mark.parametrize("inverted", [False, True])
def test_a_board_printed_the_other_way_round_is_told(tiny, inverted, side, curve):
    """Half of all boards begin with a black square; the fit would look for the white one a square aside.

    Also where the camera's tone curve is another one than believed.
    """
    observation = observe(read_bundle(tiny))
    view = replace(observation.views[0], kind="checkerboard", force_N=None)
    sizes = {"checkerboard_squares": (8, 6), "checkerboard_side_mm": side, "checkerboard_inverted": inverted}
    cards = observation.scene.card.model_copy(update=sizes)
    real = observation.scene.model_copy(update={"card": cards})
    point = {"@card_light[checkerboard]": -0.5, "@pose_x[checkerboard]": 0.9}
    believed = real.model_copy(update={"card": cards.model_copy(update={"checkerboard_inverted": False})})
    taken = real.model_copy(update={"camera": real.camera.model_copy(update={"tone_curve": curve})})
    frame = Predictor(taken, [view]).image(point, 0)
    shown = replace(observation, scene=believed, views=(view,), images=frame[None])
    assert board_inverted(shown) is inverted


@pytest.mark.parametrize(("believed", "gross"), [((8, 6), False), ((6, 6), True), ((14, 11), True)])
def test_a_board_of_other_squares_is_another_rig(tiny, believed, gross):
    """More squares than believed, or, of a board seen whole, over two fewer."""
    observation = observe(read_bundle(tiny))
    view = replace(observation.views[0], kind="checkerboard", force_N=None)
    sizes = {"checkerboard_squares": (8, 6), "checkerboard_side_mm": 1.2}
    real = observation.scene.model_copy(update={"card": observation.scene.card.model_copy(update=sizes)})
    frame = Predictor(real, [view]).image({}, 0)
    card = real.card.model_copy(update={"checkerboard_squares": believed})
    shown = replace(observation, scene=real.model_copy(update={"card": card}), views=(view,), images=frame[None])
    lines = _board_lines(shown, Predictor(shown.scene, [view]))
    counts = {line.measured: line.gross for line in lines if "squares" in line.name}
    assert counts == {8.0: gross, 6.0: gross}


@pytest.mark.parametrize(("wider", "gross"), [(1.02, False), (1.09, True), (0.92, True)])
def test_another_field_of_view_is_another_rig(tiny, wider, gross):
    """A lens that sees more or less of the plate than stated; what its board shows is the true one."""
    observation = observe(read_bundle(tiny))
    view = replace(observation.views[0], kind="checkerboard", force_N=None)
    sizes = {"checkerboard_squares": (8, 6), "checkerboard_side_mm": 1.6}
    believed = observation.scene.model_copy(update={"card": observation.scene.card.model_copy(update=sizes)})
    scale = believed.camera.scale_px_per_mm / wider
    real = believed.model_copy(update={"camera": believed.camera.model_copy(update={"scale_px_per_mm": scale})})
    shown = replace(observation, scene=believed, views=(view,), images=Predictor(real, [view]).image({}, 0)[None])
    (line,) = (one for one in _board_lines(shown, Predictor(believed, [view])) if one.name == "field of view")
    assert line.gross is gross
    assert line.measured / line.predicted == pytest.approx(wider, rel=0.005)


@pytest.mark.parametrize("level", [0.0, 12.0])
def test_frames_without_a_contact_are_told_before_anything_is_fitted(tiny, level):
    """Frames of one level where the scene has a finger at 5 N: a shutter that was shut, LEDs that were off."""
    observation = observe(read_bundle(tiny))
    images = np.where(np.array([v.touches for v in observation.views])[:, None, None], level, observation.images)
    blank = replace(observation, images=images.astype(np.float32))
    gate = gate_of(blank, AnchoredModel(observation, data_vector(observation)).coarse)
    (line,) = (one for one in gate.lines if one.gross)
    assert line.name == "frames that show a contact"
    assert line.measured == 0.0
    assert line.predicted >= 1.0


def test_an_inverted_board_is_black_where_the_other_is_white():
    """By its squares' middles: ink in the corner, as many squares of either kind, paper around."""
    card = checkerboard_of(Cards(checkerboard_squares=(8, 6), checkerboard_side_mm=2.0, checkerboard_inverted=True))
    x, y = np.meshgrid(2.0 * np.arange(8) - 7.0, 2.0 * np.arange(6) - 5.0)
    found = mean_reflectance(card, x, y)
    assert found[0, 0] == pytest.approx(card.black)
    assert found[0, 1] == found[1, 0] == pytest.approx(card.white)
    assert found.mean() == pytest.approx((card.black + card.white) / 2)


@pytest.mark.parametrize("inverted", [False, True])
def test_soft_pixels_are_means_by_a_triangle(inverted):
    """Against a sum over 400 sub-pixels a side, at the print's edges and corners, and beyond the paper."""
    card = checkerboard_of(Cards(checkerboard_squares=(5, 4), checkerboard_side_mm=2.0, checkerboard_inverted=inverted))
    pixel = 0.31
    x, y = np.meshgrid(pixel * np.arange(-34, 35) + 0.07, pixel * np.arange(-30, 31) - 0.05)
    found = mean_reflectance(card, x, y, soft=True)
    t = (np.arange(400) + 0.5) / 200 - 1.0
    weight = (1.0 - np.abs(t)) / np.sum(1.0 - np.abs(t))
    for k, i in ((30, 34), (17, 18), (4, 34), (30, 17), (0, 0), (43, 51)):
        points = mean_reflectance(card, *np.meshgrid(x[k, i] + pixel * t, y[k, i] + pixel * t))
        assert found[k, i] == pytest.approx(weight @ points @ weight, abs=1e-3)


def test_soft_pixels_change_with_an_edges_place_by_a_slope_without_steps():
    """A tenth of a pixel on, the slope of a hard pixel's share of paper jumps from nothing to all; that of a soft one
    changes by a tenth."""
    card = square_of(Cards(square_side_mm=10.0))
    x, y = np.meshgrid(np.arange(-8.0, 9.0), np.arange(-1.0, 2.0))

    def slopes(soft):
        shares = np.array([mean_reflectance(card, x + s, y, soft=soft)[1] for s in np.arange(0.0, 1.0, 0.02)])
        return np.abs(np.diff(shares, n=2, axis=0)).max() / np.abs(np.diff(shares, axis=0)).max()

    assert slopes(False) > 0.4
    assert slopes(True) < 0.03


def test_paper_beyond_the_middle_of_its_margin_does_not_count(tiny):
    """An 8 mm square with 2 mm of margin, 0.8 mm to the right: bins within 5 mm of its middle count, presses whole."""
    observation = observe(read_bundle(tiny))
    square = replace(observation.views[0], kind="square", force_N=None)
    images = np.repeat(observation.images[:1], 2, axis=0)
    scene = observation.scene.model_copy(update={"card": Cards(square_side_mm=8.0, square_margin_mm=2.0)})
    shown = replace(observation, scene=scene, views=(observation.views[0], square), images=images)
    press, card = on_prints(shown, {"@pose_x[square]": 0.8})
    assert press.all()
    rows, cols = card.shape
    projection = Projection.of(scene.camera, scene.plate)
    x, y = projection.to_plate(*np.meshgrid(4 * np.arange(cols) + 1.5, 4 * np.arange(rows) + 1.5))
    np.testing.assert_array_equal(card, (np.abs(x - 0.8) < 5.0) & (np.abs(y) < 5.0))
    assert 0 < card.sum() < card.size
