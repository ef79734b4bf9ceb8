"""``evanesce bundle make`` of a film and pictures drawn with NumPy alone, and what it refuses."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from evanesce.api.calibrate import calibrate
from evanesce.bundle import read_bundle
from evanesce.bundle.board import SeenBoard, calibrated_boards, nominal_plane, other_card, seen_board
from evanesce.bundle.make import Recording, chosen
from evanesce.cli.app import app
from evanesce.measurement.calibration.model import Calibration, save_calibration
from evanesce.rig import dump_scene, load_scene
from evanesce.rig.card import Cards
from support import drawn_lab, lab_boards
from support.videos import write_video

SHAPE, PX_PER_MM, RATE, FREE, FRAMES = (240, 320), 24.0, 10, 4, 20
LATER_S, FACTOR = 0.37, 5.0
"""How much later the film's clock starts than the load cell's; area is FACTOR F^(2/3)."""

BOARD = lab_boards.Board(9, 7, 1.2)
FOCAL_PX, FAR_MM = 600.0, 25.0
CAMERA = {"camera.resolution_px": [320, 240], "camera.scale_px_per_mm": 24.0}
CARD = {"card.checkerboard_squares": [9, 7], "card.checkerboard_side_mm": 1.2}


def scene_file(path, *overrides):
    path.write_text(dump_scene(load_scene("thesis", {k: v for one in overrides for k, v in one.items()})))


def force_at(time_s):
    return np.clip((np.asarray(time_s) - (FREE - 0.5) / RATE) * 3.0, 0.0, None)


def colour(grey):
    """Red light: green a third, blue a tenth."""
    return np.stack([grey, (grey / 3).astype(np.uint8), (grey / 10).astype(np.uint8)], axis=-1)


@pytest.fixture(scope="module")
def lab(tmp_path_factory):
    folder = tmp_path_factory.mktemp("lab")
    rng = np.random.default_rng(8)
    (folder / "film").mkdir()
    frames = []
    for k in range(FRAMES):
        a = np.sqrt(FACTOR * float(force_at(k / RATE)) ** (2 / 3) * PX_PER_MM**2 / np.pi / 0.8)
        share = drawn_lab.contact(SHAPE, (163.0, 118.0), (a, 0.8 * a)) if a > 0 else np.zeros(SHAPE)
        frames.append(drawn_lab.frame(share, rng))
        cv2.imwrite(str(folder / "film" / f"f{k}.jpg"), frames[-1], [cv2.IMWRITE_JPEG_QUALITY, 95])
    write_video(folder / "film.mkv", frames, rate=RATE)
    lens = lab_boards.Lens((320, 240), FOCAL_PX, FOCAL_PX, 159.5, 119.5, 0.0, 0.0)
    board = lab_boards.draw(lens, BOARD, lab_boards.flat(FAR_MM), lab_boards.Look(), rng)
    for kind, image in (("lens_cap", frames[0] // 20), ("led_off", frames[0] // 10), ("checkerboard", board)):
        (folder / kind).mkdir()
        cv2.imwrite(str(folder / kind / "IMG_7.JPG"), image)
    save_calibration(
        folder / "cal.json",
        Calibration(
            image_size=SHAPE[::-1], camera_matrix=np.array([[FOCAL_PX, 0, 159.5], [0, FOCAL_PX, 119.5], [0, 0, 1]]),
            distortion=np.zeros(5), mm2_per_px=PX_PER_MM**-2, square_side_mm=15.0,
        ),
    )  # fmt: skip
    times = np.arange(0.0, FRAMES / RATE + 1, 0.02)
    lines = [f"{t:.3f},{f:.5f}" for t, f in zip(times, force_at(times - LATER_S), strict=True)]
    (folder / "force.csv").write_text("time_s,force_N\n" + "\n".join(lines) + "\n")
    scene_file(folder / "scene.toml", CAMERA, CARD)
    return folder


def made(lab, out, source="film.mkv", **options):
    given = {"force": lab / "force.csv", "calibration": lab / "cal.json", "scene": lab / "scene.toml", "out": out}
    words = [str(w) for name, value in (given | options).items() for w in (f"--{name.replace('_', '-')}", value)]
    return CliRunner().invoke(app, ["bundle", "make", str(lab / source), *words])


def test_a_film_and_its_forces_become_a_valid_bundle(lab, tmp_path):
    out = tmp_path / "mine"
    pictures = {kind: lab / kind for kind in ("lens_cap", "led_off", "checkerboard")}
    done = made(lab, out, json=tmp_path / "o.json", frames=8, **pictures)
    assert done.exit_code == 0, done.output
    said = json.loads((tmp_path / "o.json").read_text())
    assert abs(said["offset_s"] - LATER_S) < 2 * said["offset_standard_s"] < 0.1  # of frames 0.1 s apart
    assert "the load cell's clock is the frames' +0.3" in done.stdout
    bundle = read_bundle(out)
    assert len(bundle.press) == 8
    for shot in bundle.press:
        assert shot.force_N == pytest.approx(float(force_at(shot.index / RATE)), abs=0.1)
        assert bundle.frame(shot).shape == SHAPE
    assert bundle.press[-1].index == FRAMES - 1
    assert (out / "press.mkv").read_bytes() == (lab / "film.mkv").read_bytes()
    assert (out / "lens_cap" / "0000.jpg").read_bytes() == (lab / "lens_cap" / "IMG_7.JPG").read_bytes()
    checked = CliRunner().invoke(app, ["bundle", "check", str(out)])
    assert checked.exit_code == 0, checked.output
    assert "no checkerboard" not in checked.stdout


def test_a_folder_of_jpegs_with_a_given_offset(lab, tmp_path):
    out = tmp_path / "mine"
    done = made(lab, out, "film", offset_s=LATER_S, fps=RATE, frames="all", voltage_V=7.5, replicates=lab / "film.mkv")
    assert done.exit_code == 0, done.output
    bundle = read_bundle(out)
    assert [s.index for s in bundle.press] == list(range(FREE, FRAMES))
    assert [s.force_N for s in bundle.press] == pytest.approx(force_at(np.arange(FREE, FRAMES) / RATE), abs=1e-4)
    assert {s.voltage_V for s in bundle.press} == {7.5}
    assert len(bundle.replicates) == FRAMES  # of a video, as pictures
    named = cv2.imread(str(lab / "film" / "f7.jpg"), cv2.IMREAD_UNCHANGED)
    assert (bundle.frame(bundle.press[7 - FREE]) == named).all()


def test_a_colour_camera_keeps_its_colour(lab, tmp_path):
    """A monochrome scene reads the same files in grey."""
    (tmp_path / "film").mkdir()
    shown = [colour(cv2.imread(str(lab / "film" / f"f{k}.jpg"), cv2.IMREAD_UNCHANGED)) for k in range(FRAMES)]
    for k, image in enumerate(shown):
        cv2.imwrite(str(tmp_path / "film" / f"{k}.png"), image[..., ::-1])
    scene_file(tmp_path / "scene.toml", CAMERA, CARD, {"camera.colour": {}})
    common = {"offset_s": LATER_S, "frames": 3, "fps": RATE, "scene": tmp_path / "scene.toml"}
    done = made(lab, tmp_path / "pictures", tmp_path / "film", **common)
    assert done.exit_code == 0, done.output
    bundle = read_bundle(tmp_path / "pictures")
    for shot in bundle.press:
        np.testing.assert_array_equal(bundle.frame(shot), shown[shot.index])
    done = made(lab, tmp_path / "grey", tmp_path / "film", **(common | {"scene": lab / "scene.toml"}))
    assert done.exit_code == 0, done.output
    bundle = read_bundle(tmp_path / "grey")
    red = shown[bundle.press[-1].index].astype(float)
    luma = red @ [0.2125, 0.7154, 0.0721]  # Rec. 709 as the reference segmentation rounds it
    assert np.abs(bundle.frame(bundle.press[-1]) - luma).max() < 1.0


def test_another_board_is_refused_and_leaves_nothing(lab, tmp_path):
    """The board has 9 x 7 squares of 1.2 mm: the thesis's card of 42 x 31 and 1 mm is another."""
    scene_file(tmp_path / "scene.toml", CAMERA)
    out = tmp_path / "mine"
    done = made(lab, out, offset_s=LATER_S, checkerboard=lab / "checkerboard", scene=tmp_path / "scene.toml")
    assert done.exit_code == 2
    assert "9 x 7 squares of 1.2 mm" in done.stderr
    assert "42 x 31 of 1 mm" in done.stderr
    assert done.stderr.count("\n") == 1
    assert sorted(p.name for p in tmp_path.iterdir()) == ["scene.toml"]


def test_the_check_compares_boards_of_bundles_made_by_hand(lab, tmp_path):
    out = tmp_path / "mine"
    assert made(lab, out, offset_s=LATER_S, checkerboard=lab / "checkerboard").exit_code == 0
    text = (out / "scene.toml").read_text()
    assert text.count("checkerboard_side_mm = 1.2") == 1
    (out / "scene.toml").write_text(text.replace("checkerboard_side_mm = 1.2", "checkerboard_side_mm = 2.4"))
    done = CliRunner().invoke(app, ["bundle", "check", str(out)])
    assert done.exit_code == 2
    assert "squares of 1.2 mm" in done.output


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"force": "nothing.csv"}, "nothing.csv"),
        ({"offset_s": 1000}, "--offset-s"),
        ({"offset_s": "soon"}, "'soon'"),
        ({"frames": "few"}, "--frames"),
        ({"lens_cap": "nowhere"}, "--lens-cap"),
        ({"scene": "thesis"}, "image_size"),
    ],
)
def test_what_does_not_fit_is_refused_and_leaves_nothing(lab, tmp_path, change, says):
    done = made(lab, tmp_path / "mine", **({"offset_s": LATER_S} | change))
    assert done.exit_code == 2
    assert says in done.stderr
    assert not list(tmp_path.iterdir())


def test_a_film_without_a_finger_needs_an_offset(lab, tmp_path):
    (tmp_path / "film").mkdir()
    for k in range(4):
        cv2.imwrite(str(tmp_path / "film" / f"{k}.png"), np.full(SHAPE, 9, np.uint8))
    done = made(lab, tmp_path / "mine", tmp_path / "film", fps=RATE)
    assert done.exit_code == 2
    assert "film: --offset-s: no contact shows" in done.stderr
    assert sorted(p.name for p in tmp_path.iterdir()) == ["film"]


def test_a_deep_picture_is_refused_by_its_own_name(lab, tmp_path):
    (tmp_path / "cap").mkdir()
    cv2.imwrite(str(tmp_path / "cap" / "a.tif"), np.zeros(SHAPE, np.uint16))
    done = made(lab, tmp_path / "mine", offset_s=LATER_S, lens_cap=tmp_path / "cap")
    assert done.exit_code == 2
    assert "lens_cap/0000.tif: 16-bit samples" in done.stderr
    assert sorted(p.name for p in tmp_path.iterdir()) == ["cap"]


def test_seventeen_by_thirteen_of_two_millimetres_against_the_thesis_card():
    """The case of a lab: the board seen whole by a camera of 12 px/mm."""
    rng = np.random.default_rng(5)
    camera = {"camera.resolution_px": [640, 480], "camera.scale_px_per_mm": 12.0, "camera.lens.distortion": {"k1": 0.0}}
    scene = load_scene("thesis", camera)
    lens = lab_boards.Lens((640, 480), 1200.0, 1200.0, 319.5, 239.5, 0.0, 0.0)
    picture = lab_boards.draw(lens, lab_boards.Board(17, 13, 2.0), lab_boards.flat(100.0), lab_boards.Look(), rng)
    found = seen_board(picture, "a.jpg", nominal_plane(scene))
    assert found is not None
    assert found.corners == (16, 12)
    assert found.side_mm == pytest.approx(2.0, rel=0.01)
    assert found.whole
    assert other_card([found], Cards(checkerboard_squares=(17, 13), checkerboard_side_mm=2.0)) is None
    assert "17 x 13 squares of 2 mm" in str(other_card([found], scene.card))
    # rim lines may be lost; another board that is seen whole has fewer by more
    assert other_card([SeenBoard("b", (15, 10), 1.0, True)], Cards(checkerboard_squares=(17, 13))) is None
    assert other_card([SeenBoard("b", (13, 12), 1.0, True)], Cards(checkerboard_squares=(17, 13))) is not None
    # a part of the right board is the right board; a part with more lines than it has is not
    assert other_card([SeenBoard("b", (20, 11), 1.0)], scene.card) is None
    assert other_card([SeenBoard("b", (42, 11), 1.0)], scene.card) is not None


def test_the_board_of_a_calibration_must_be_the_card(lab, tmp_path):
    """Corners as a calibration lists them, of the board as stated to it: 17 x 13 squares of 2 mm."""
    rng = np.random.default_rng(6)
    lens = lab_boards.Lens((320, 240), 600.0, 600.0, 159.5, 119.5, 0.0, 0.0)
    boards = [lab_boards.draw(lens, lab_boards.Board(17, 13, 2.0), lab_boards.flat(85.0), lab_boards.Look(), rng)]
    square = lab_boards.draw_card(lens, 20.0, lab_boards.flat(85.0), lab_boards.Look(), rng)
    calibration = calibrate(boards, checker_side_mm=2.0, square=square, square_side_mm=20.0)
    (found,) = calibrated_boards(calibration)
    assert found.corners == (16, 12)
    assert found.side_mm == pytest.approx(2.0)
    save_calibration(tmp_path / "cal.json", calibration)
    done = made(lab, tmp_path / "mine", offset_s=LATER_S, calibration=tmp_path / "cal.json")
    assert done.exit_code == 2
    assert "17 x 13 squares of 2 mm; the scene's card has 9 x 7 of 1.2 mm" in done.stderr
    assert sorted(p.name for p in tmp_path.iterdir()) == ["cal.json"]
    scene_file(tmp_path / "s.toml", CAMERA, {"card.checkerboard_squares": [17, 13], "card.checkerboard_side_mm": 2.0})
    done = made(lab, tmp_path / "mine", offset_s=LATER_S, calibration=tmp_path / "cal.json", scene=tmp_path / "s.toml")
    assert done.exit_code == 2
    assert "square card is 20 mm wide; the scene's 15 mm" in done.stderr
    scene_file(tmp_path / "s.toml", CAMERA, {
        "card.checkerboard_squares": [17, 13], "card.checkerboard_side_mm": 2.0, "card.square_side_mm": 20.0,
    })  # fmt: skip
    done = made(lab, tmp_path / "mine", offset_s=LATER_S, calibration=tmp_path / "cal.json", scene=tmp_path / "s.toml")
    assert done.exit_code == 0, done.output
    assert "scale_of_scene" in done.stderr  # 600/85 = 7.1 px/mm, the scene has 24


def test_frames_are_spread_over_ramp_hold_and_release():
    """Closed form: a ramp of 10 s, a hold of 20 s, a release of 10 s."""
    time = np.arange(0.0, 40.0, 0.1)
    force = np.interp(time, [0, 10, 30, 40], [0.5, 4.5, 4.5, 0.5])
    recording = Recording(path=Path("x"), index=np.arange(len(time)), time_s=time, force_N=force)
    at = time[chosen(recording, 60)]
    # lengths: ramp 1 + 1/4, hold 1/2, release 1 + 1/4
    counts = np.histogram(at, [0, 10, 30, 40])[0] / 60
    assert counts == pytest.approx([1.25 / 3, 0.5 / 3, 1.25 / 3], abs=0.03)
    assert len(chosen(recording, None)) == len(time)
