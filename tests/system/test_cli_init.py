"""``evanesce init`` and ``evanesce scene explain`` as a stranger uses them; the board is drawn here by NumPy."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from evanesce.api.own_answers import FINGERS
from evanesce.cli.app import app
from evanesce.rig import load_scene
from support import lab_boards
from support.drawn_lab import on_plate

runner = CliRunner()
WIDTH, HEIGHT, FOCAL_PX, THICKNESS, INDEX, CLEAR, K1 = 640, 480, 4.0e3 / 4.5, 8.0, 1.4905, 60.0, -0.2


def drawn_board() -> np.ndarray:
    """A board of 1 mm squares through a plate and a lens with distortion: Snell's law and Brown's formula by hand."""
    fine = 3
    across, down = on_plate((HEIGHT, WIDTH), fine, FOCAL_PX, K1, CLEAR, THICKNESS, INDEX)
    a, b = across * np.cos(0.02) + down * np.sin(0.02) + 0.3, down * np.cos(0.02) - across * np.sin(0.02) - 0.2
    print_ = (abs(a) < 21) & (abs(b) < 15.5)
    squares = np.where((np.floor(a) + np.floor(b + 0.5)) % 2 == 0, 200.0, 30.0)
    grey = np.where(print_, squares, 205.0).reshape(HEIGHT, fine, WIDTH, fine).mean(axis=(1, 3))
    blurred = cv2.GaussianBlur(grey, (0, 0), 0.7) + np.random.default_rng(1).normal(0, 1, grey.shape)
    return np.clip(blurred, 0, 255).astype(np.uint8)


def test_options_make_a_commented_scene_and_figures(tmp_path: Path) -> None:
    scene, figures = tmp_path / "mine.toml", tmp_path / "mine.json"
    done = runner.invoke(app, [
        "init", str(scene), "--preset", "gripper", "--thickness-mm", "4", "--plate-mm", "60x40", "--material", "pc",
        "--edges", "left,top", "--voltage-V", "9.2", "--resolution", "320x240", "--field-mm", "25",
        "--finger", "ridged", "--radius-mm", "7", "--forces-N", "0.5,2", "--json", str(figures),
    ])  # fmt: skip
    assert done.exit_code == 0, done.output
    loaded = load_scene(scene)
    assert loaded.plate.size_mm == (60.0, 40.0)
    assert loaded.plate.refractive_index == pytest.approx(1.5846, abs=1e-3)
    assert loaded.leds.edges == ("left", "top")
    assert loaded.finger.ridges is not None
    found = json.loads(figures.read_text(encoding="utf-8"))
    assert found["field_mm"] == pytest.approx([25.0, 18.75], rel=1e-3)
    assert 0.4 < found["level"] < 0.6
    text = scene.read_text(encoding="utf-8")
    assert "# mm, 0.1 to 50" in text
    assert "given" in loaded.sources["plate.thickness_mm"]
    assert "field of view" in done.output


def test_scale_and_distortion_come_from_one_picture(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "board.png"), drawn_board())
    scene = tmp_path / "mine.toml"
    done = runner.invoke(app, [
        "init", str(scene), "--preset", "gripper", "--thickness-mm", "8", "--material", "pmma", "--pixel-um", "4.5",
        "--focal-mm", "4", "--checkerboard", str(tmp_path / "board.png"), "--board-square-mm", "1",
        "--exposure-ms", "1",
    ])  # fmt: skip
    assert done.exit_code == 0, done.output
    camera = load_scene(scene).camera
    assert camera.resolution_px == (WIDTH, HEIGHT)
    assert camera.scale_px_per_mm == pytest.approx(FOCAL_PX / (CLEAR + THICKNESS / INDEX), rel=1e-3)
    assert camera.lens.distortion.k1 == pytest.approx(K1, abs=0.01)


@pytest.mark.parametrize("black", [False, True])
def test_the_board_of_the_picture_is_the_scenes(black: bool, tmp_path: Path) -> None:
    board = np.kron((np.indices((9, 13)).sum(axis=0) % 2 == black).astype(np.uint8), np.ones((30, 30), np.uint8))
    picture = np.pad(30 + 180 * board, 40, constant_values=210)
    cv2.imwrite(str(tmp_path / "board.png"), cv2.GaussianBlur(picture.astype(np.uint8), (0, 0), 1.0))
    scene = tmp_path / "mine.toml"
    done = runner.invoke(app, [
        "init", str(scene), "--preset", "gripper", "--checkerboard", str(tmp_path / "board.png"), "--board", "13x9",
        "--board-square-mm", "1.5", "--exposure-ms", "1",
    ])  # fmt: skip
    assert done.exit_code == 0, done.output
    card = load_scene(scene).card
    assert (card.checkerboard_squares, card.checkerboard_inverted) == ((13, 9), black)
    assert ("upper left is black" in done.output) == black


def test_questions_take_an_empty_answer_for_the_presets_figure(tmp_path: Path) -> None:
    scene = tmp_path / "mine.toml"
    lines = ["no", "gripper", "", "50x30", "wide", "5", *[""] * 14, "toe", "", "x", "", "", "0.4"]
    done = runner.invoke(
        app, ["init", str(scene), "--ask", "--set", "camera.exposure_ms=1"], input="\n".join(lines) + "\n"
    )
    assert done.exit_code == 0, done.output
    loaded = load_scene(scene)
    assert loaded.plate.size_mm == (50.0, 30.0)
    assert loaded.plate.thickness_mm == 5.0
    assert loaded.leds.pitch_mm == load_scene("gripper").leds.pitch_mm
    assert loaded.press.forces_N == (0.4,)


def test_a_board_without_its_squares_side_is_refused_or_asked(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "board.png"), drawn_board())
    picture, scene = str(tmp_path / "board.png"), tmp_path / "mine.toml"
    done = runner.invoke(app, ["init", str(scene), "--checkerboard", picture])
    assert done.exit_code == 2
    assert "--board-square-mm" in done.stderr
    assert not scene.exists()
    lines = ["gripper", picture, "", "2", *[""] * 30]
    done = runner.invoke(
        app, ["init", str(scene), "--ask", "--set", "camera.exposure_ms=1"], input="\n".join(lines) + "\n"
    )
    assert done.exit_code == 0, done.output
    assert load_scene(scene).card.checkerboard_side_mm == 2.0


def test_what_is_kept_of_the_preset_is_told(tmp_path: Path) -> None:
    scene = tmp_path / "mine.toml"
    done = runner.invoke(
        app,
        ["init", str(scene), "--thickness-mm", "8", "--camera", "usb", "--resolution", "960x540", "--field-mm", "30",
         "--finger", "ball", "--radius-mm", "6", "--exposure-ms", "1"],
    )  # fmt: skip
    assert done.exit_code == 0, done.output
    assert "leds.voltage_V = 9 (--voltage-V)" in done.stderr
    assert "finger.material = silskin_0 (--silicone)" in done.stderr
    assert "plate.thickness_mm" not in done.stderr
    assert "960 x 540 px" in done.stderr
    assert "--pixel-um 6" in done.stderr
    assert "of the tip's" in done.stderr  # 5 N on a ball of 6 mm
    loaded = load_scene(scene)
    assert loaded.sources["plate.thickness_mm"] == "given"
    assert loaded.sources["leds.voltage_V"].startswith("of the preset thesis: ")


def test_presets_are_listed() -> None:
    done = runner.invoke(app, ["init", "x.toml", "--presets"])
    assert done.exit_code == 0
    assert "pmma_infrared" in done.output
    assert "NOT simulated" in done.output


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["mine.json"], ["mine.json", ".toml"]),
        (["no/folder/mine.toml"], ["no/folder", "folder"]),
        (["mine.toml", "--plate-mm", "80"], ["--plate-mm", "80", "120x80"]),
        (["mine.toml", "--forces-N", "a,b"], ["--forces-N", "a,b"]),
        (["mine.toml", "--resolution", "640x480.5"], ["--resolution", "whole"]),
        (["mine.toml", "--thickness-mm", "80"], ["--thickness-mm", "80", "0.1 to 50 mm"]),
        (["mine.toml", "--preset", "none"], ["--preset", "gripper"]),
        (["mine.toml", "--calibration", "none.json"], ["none.json", "evanesce calibrate"]),
        (["mine.toml", "--checkerboard", "none.png"], ["none.png", "--checkerboard"]),
        (["mine.toml", "--silicone", "jelly"], ["--silicone", "jelly", "silskin_0"]),
        (["mine.toml", "--set", "effects.led_ded.loss=1.0"], ["effects.led_ded", "led_dead"]),
        (["mine.toml", "--pixel-um", "0"], ["--pixel-um", "0.5 to 50 um"]),
        (["mine.toml", "--index", "0.9"], ["--index", "1 to 2.5"]),
        (["mine.toml", "--camera", "pi_3", "--resolution", "0x9"], ["--resolution", "8 to 20000 px"]),
        (["mine.toml", "--field-mm", "1e-3"], ["--field-mm", "mm"]),
        (["mine.toml", "--focal-mm", "0", "--distance-mm", "30"], ["--focal-mm", "0.5 to 200 mm"]),
        (["mine.toml", "--spectrum", "none.csv"], ["--spectrum", "'none.csv'", "existing"]),
        (["mine.toml", "--voltage-V", "0"], ["--voltage-V", "8.85 V", "in series"]),
        (["mine.toml", "--on-glass", "a.png"], ["--on-glass", "--checkerboard"]),
    ],
)
def test_bad_options_are_one_line_and_nothing_is_written(
    options: list[str], words: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    done = runner.invoke(app, ["init", *options])
    assert done.exit_code == 2, done.output
    line = done.stderr.strip().splitlines()[-1]
    assert line.startswith("error:")
    assert all(word in line for word in words), line
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("finger", FINGERS)
def test_every_finger_fits_a_rig(finger: str, tmp_path: Path) -> None:
    scene = tmp_path / "mine.toml"
    done = runner.invoke(app, ["init", str(scene), "--preset", "gripper", "--finger", finger, "--exposure-ms", "1"])
    assert done.exit_code == 0, done.output
    assert load_scene(scene).finger.tip_radius_mm > 0


def seen_by_a_lens(folder: Path, flat_last: bool) -> None:
    """Six pictures of a board, 13 x 9 squares of 2 mm, one flat at 12 px/mm, five tilted; another size beside them."""
    rng = np.random.default_rng(3)
    lens = lab_boards.Lens((480, 360), 720.0, 720.0, 239.5, 179.5, -0.1, 0.0)
    board = lab_boards.Board(13, 9, 2.0)
    poses = [lab_boards.flat(60.0), *(lab_boards.pose_of(rng, lens, board) for _ in range(5))]
    folder.mkdir()
    for k, pose in enumerate(reversed(poses) if flat_last else poses):
        cv2.imwrite(str(folder / f"{k}.png"), lab_boards.draw(lens, board, pose, lab_boards.Look(), rng))
    cv2.imwrite(str(folder / "9.png"), np.full((200, 300), 90, np.uint8))


@pytest.mark.parametrize("flat_last", [False, True])
def test_the_scale_is_of_the_picture_on_the_glass_wherever_it_stands(flat_last: bool, tmp_path: Path) -> None:
    seen_by_a_lens(tmp_path / "boards", flat_last)
    scene, told = tmp_path / "mine.toml", tmp_path / "mine.json"
    options = [
        "init", str(scene), "--preset", "gripper", "--board-square-mm", "2", "--checkerboard", str(tmp_path / "boards"),
        "--exposure-ms", "1", "--json", str(told), "--overwrite",
    ]  # fmt: skip
    done = runner.invoke(app, options)
    assert done.exit_code == 0, done.output
    found = load_scene(scene)
    assert found.camera.scale_px_per_mm == pytest.approx(12.0, rel=3e-3)
    assert found.card.checkerboard_squares == (13, 9)
    name = "5.png" if flat_last else "0.png"
    assert f"scale from {name}, the flattest of 6 pictures" in done.stderr
    assert "6 picture(s)" in found.sources["camera.scale_px_per_mm"]
    (left_out,) = (w for w in json.loads(told.read_text(encoding="utf-8"))["warnings"] if "changed_resolution" in w)
    assert "9.png is 300 x 200" in left_out
    assert "changed_resolution" in done.stderr
    # another is stated: its scale is taken, as it is told to be
    tilted = runner.invoke(app, [*options, "--on-glass", "2.png"])
    assert tilted.exit_code == 0, tilted.output
    assert "scale from 2.png, stated of 6 pictures" in tilted.stderr
    assert abs(load_scene(scene).camera.scale_px_per_mm / 12.0 - 1) > 0.02
    # a board that has fewer squares than are seen is none of these
    other = runner.invoke(app, [*options, "--board", "12x9"])
    assert other.exit_code == 2
    assert "--board" in other.stderr.splitlines()[-1]
    assert "13 x 9 squares" in other.stderr


def test_a_calibration_file_gives_the_board_and_tells_of_which_picture_its_scale_is(tmp_path: Path) -> None:
    seen_by_a_lens(tmp_path / "boards", flat_last=True)
    file, scene = tmp_path / "cal.json", tmp_path / "mine.toml"
    made = ["calibrate", "--checkerboard", str(tmp_path / "boards"), "--square-mm", "2", "--json", str(file)]
    assert runner.invoke(app, made).exit_code == 0
    options = ["init", str(scene), "--preset", "gripper", "--calibration", str(file), "--exposure-ms", "1"]
    done = runner.invoke(app, options)
    assert done.exit_code == 0, done.output
    assert load_scene(scene).camera.scale_px_per_mm == pytest.approx(12.0, rel=3e-3)
    assert load_scene(scene).card.checkerboard_side_mm == 2.0
    assert "scale from 5.png, the flattest of 6" in done.stderr
    wrong = runner.invoke(app, [*options, "--overwrite", "--board-square-mm", "1.5"])
    assert wrong.exit_code == 2
    assert "--board-square-mm: 1.5, but the calibration was made with squares of 2 mm" in wrong.stderr
    # a file of an earlier version has the first picture's scale
    old = json.loads(file.read_text(encoding="utf-8"))
    del old["flat_view"], old["flat_view_depth_spread"]
    file.write_text(json.dumps(old), encoding="utf-8")
    done = runner.invoke(app, [*options, "--overwrite"])
    assert done.exit_code == 0, done.output
    assert "scale from 0.png, the first of 6 pictures" in done.stderr


def test_pictures_without_a_board_are_named_with_their_folder(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "noise.png"), np.random.default_rng(0).integers(0, 255, (120, 160), np.uint8))
    done = runner.invoke(
        app, ["init", str(tmp_path / "m.toml"), "--checkerboard", str(tmp_path / "noise.png"), "--board-square-mm", "1"]
    )
    assert done.exit_code == 2
    assert str(tmp_path / "noise.png") in done.stderr
    assert "no checkerboard found" in done.stderr


def test_an_existing_file_is_left(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text("mine", encoding="utf-8")
    assert runner.invoke(app, ["init", str(path)]).exit_code == 2
    assert path.read_text(encoding="utf-8") == "mine"


def test_explain_key_table_effect_and_change(tmp_path: Path) -> None:
    one = runner.invoke(app, ["scene", "explain", "leds.voltage_V", "--scene", "gripper"])
    assert one.exit_code == 0
    assert all(word in one.output for word in ("0 to 60", "thesis, chapter 5", "Brightness", "9"))
    words = runner.invoke(app, ["scene", "explain", "contact.law"])
    assert "hertz, scaled_hertz, jkr, xydas_kao, halfspace, fem" in words.output
    table = runner.invoke(app, ["scene", "explain", "camera.lens.distortion"])
    assert "k1" in table.output
    assert "pincushion" in table.output
    effect = runner.invoke(app, ["scene", "explain", "effects.led_dead.loss"])
    assert effect.exit_code == 0
    assert "0 to 1" in effect.output
    out = tmp_path / "change.json"
    args = ["scene", "explain", "camera.exposure_ms", "--scene", "gripper", "--simulate", "--json", str(out)]
    assert runner.invoke(app, args).exit_code == 0
    change = json.loads(out.read_text(encoding="utf-8"))["change"]
    assert change["contact"][1] / change["contact"][0] == pytest.approx(1.1, abs=0.02)


@pytest.mark.parametrize(
    "options",
    [["nothing"], ["effects.none"], ["effects.led_dead.none"], ["plate", "--simulate"],
     ["leds", "--scene", "thesis", "--simulate"], ["leds.edges", "--scene", "thesis", "--simulate"]],
)  # fmt: skip
def test_bad_keys_are_one_line(options: list[str]) -> None:
    done = runner.invoke(app, ["scene", "explain", *options])
    assert done.exit_code == 2
    assert len(done.stderr.strip().splitlines()) == 1
