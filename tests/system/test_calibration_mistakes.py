"""Mistakes that a lab makes when it calibrates, planted one at a time in a drawn lab, and what the program says.

The lab: a camera with barrel distortion, six pictures of a board of 13 x 10 squares of 2 mm, the first flat on the
glass 45 mm from the lens, the others held in the air, and a white card of 15 mm on the glass. `MISTAKES` is the table.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from evanesce.cli import calibrate as command
from evanesce.cli import measure as measure_command
from evanesce.measurement.calibration import board_images
from evanesce.measurement.calibration.model import load_calibration
from support.lab_boards import Board, Lens, Look, draw, draw_card, flat, pose_of

pytestmark = pytest.mark.system

SIZE = (480, 360)
LENS = Lens(SIZE, 520.0, 520.0, 248.0, 173.0, -0.2, 0.04)
BOARD, GLASS, CARD = Board(13, 10, 2.0), 45.0, 15.0
SEARCHED: dict[bytes, Any] = {}
LOOK = Look(bright=180.0, surround=180.0)


class Lab:
    """Pictures in a folder, drawn when asked for."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.rng = folder, np.random.default_rng(9)
        self.poses = [flat(GLASS), *(pose_of(self.rng, LENS, BOARD) for _ in range(5))]

    def board(self, k: int, board: Board = BOARD, look: Look = LOOK, lens: Lens = LENS) -> np.ndarray:
        return draw(lens, board, self.poses[k], look, self.rng)

    def save(self, name: str, picture: np.ndarray) -> Path:
        assert cv2.imwrite(str(self.folder / name), picture)
        return self.folder / name


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Lab:
    lab = Lab(tmp_path_factory.mktemp("lab"))
    for k in range(6):
        lab.save(f"b{k}.png", lab.board(k))
    lab.save("card.png", draw_card(LENS, CARD, flat(GLASS, 0.4, -0.3), LOOK, lab.rng))
    return lab


@pytest.fixture(autouse=True)
def searched_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """The corners of a picture that several mistakes share are searched once."""

    def search(picture: np.ndarray) -> Any:
        key = picture.tobytes()
        if key not in SEARCHED:
            SEARCHED[key] = original(picture)
        return SEARCHED[key]

    original = board_images._searched
    monkeypatch.setattr(board_images, "_searched", search)


@pytest.fixture(scope="module")
def app() -> typer.Typer:
    app = typer.Typer()
    command.register(app)
    measure_command.register(app)
    return app


def run(app: typer.Typer, *args: Any) -> Any:
    return CliRunner().invoke(app, [*map(str, args)])


ALL = ["--checkerboard", *(f"b{k}.png" for k in range(6))]
CARD_TOO = [*ALL, "--square", "card.png", "--square-mm", "2"]


def squeezed(lab: Lab) -> None:
    for k in range(6):
        wide = cv2.resize(lab.board(k), (SIZE[0], SIZE[1] * 9 // 10), interpolation=cv2.INTER_AREA)
        lab.save(f"squeezed{k}.png", wide)


def bowed(lab: Lab) -> None:
    """A card held by its ends: the middle of each row of pixels moves by up to 2 px, a bow of its own in each view."""
    v, u = np.indices(SIZE[::-1]).astype(np.float32)
    for k in range(6):
        bow = (2.0 * (-1) ** k * (1 - ((u - 240) / 160) ** 2)).astype(np.float32)
        lab.save(f"bowed{k}.png", cv2.remap(lab.board(k), u, v + bow, cv2.INTER_CUBIC))


def refocused(lab: Lab) -> None:
    other = replace(LENS, fx=600.0, fy=600.0, k1=-0.12)
    for k in (3, 4, 5):
        lab.save(f"refocused{k}.png", lab.board(k, lens=other))


def moved_card(lab: Lab) -> None:
    lab.save("moved.png", draw_card(LENS, CARD, flat(1.04 * GLASS), LOOK, lab.rng))


def swapped_points(lab: Lab) -> None:
    rows = ["view,world_x_mm,world_y_mm,image_x_px,image_y_px"]
    for k, pose in enumerate(lab.poses):
        for (x, y), (u, v) in zip(BOARD.corners(), LENS.project(pose.place(BOARD.corners())), strict=True):
            rows.append(f"{k},{x:.6f},{y:.6f},{v:.4f},{u:.4f}")
    (lab.folder / "swapped.csv").write_text("\n".join(rows) + "\n")


def empty(lab: Lab) -> np.ndarray:
    return lab.rng.integers(90, 110, SIZE[::-1]).astype(np.uint8)


def halved(picture: np.ndarray) -> np.ndarray:
    return cv2.resize(picture, (240, 180), interpolation=cv2.INTER_AREA)


def nothing(lab: Lab) -> None:
    pass


def picture(name: str, make: Callable[[Lab], np.ndarray]) -> Callable[[Lab], None]:
    def save(lab: Lab) -> None:
        lab.save(name, make(lab))

    return save


def saved(lab: Lab, name: str) -> np.ndarray:
    found = cv2.imread(str(lab.folder / name), cv2.IMREAD_GRAYSCALE)
    assert found is not None
    return np.asarray(found)


PLUS = ["--square-mm", "2"]
OTHER_BOARD = Board(12, 10, 2.0)
# mistake, what it adds to the lab, arguments, exit code, what the program says
MISTAKES: list[tuple[str, Callable[[Lab], None], list[str], int, tuple[str, ...]]] = [
    ("none", nothing, [*CARD_TOO, "--on-glass", "b0.png"], 0, ()),
    ("none, and nothing said of the glass", nothing, CARD_TOO, 0, ()),
    ("--square-mm forgotten", nothing, [*ALL, "--square", "card.png"], 2,
     ("--square-mm", "likely --square-mm 2, not 1")),
    ("--square-mm forgotten, one view", nothing, ["--checkerboard", "b0.png", "--square", "card.png"], 2,
     ("likely --square-mm 2, not 1",)),
    ("wrong --square-mm, view on the glass stated", nothing,
     [*ALL, "--square", "card.png", "--square-mm", "2.1", "--on-glass", "b0.png"], 2,
     ("likely --square-mm 2, not 2.1",)),
    ("wrong --square-mm, nothing said of the glass", nothing, [*ALL, "--square", "card.png", "--square-mm", "2.1"], 0,
     ("board_and_card_at_odds", "likely --square-mm 2, not 2.1", "--on-glass")),
    ("card of 20 mm taken for 15", nothing, [*CARD_TOO, "--side-mm", "20", "--on-glass", "b0.png"], 2,
     ("--side-mm 15, not 20",)),
    ("a board in the air stated to lie on the glass", nothing, [*CARD_TOO, "--on-glass", "b1.png"], 2,
     ("--on-glass none",)),
    ("a name that is no picture", nothing, [*CARD_TOO, "--on-glass", "b9.png"], 2, ("--on-glass", "b0.png")),
    ("camera moved between board and card", moved_card,
     [*ALL, *PLUS, "--square", "moved.png", "--on-glass", "b0.png"], 2, ("likely --square-mm 2.1, not 2",)),
    ("refocused between the views", refocused,
     ["--checkerboard", "b0.png", "b1.png", "b2.png", *(f"refocused{k}.png" for k in (3, 4, 5)), *PLUS], 0,
     ("grid_rms_high",)),
    ("another board in one view", picture("other.png", lambda lab: lab.board(1, OTHER_BOARD)),
     [*ALL, "other.png", *PLUS], 0, ("unlike_counts", "other.png has 99 on 11 x 9 lines")),
    ("one view repeated", picture("again.png", lambda lab: saved(lab, "b2.png")), [*ALL, "again.png", *PLUS], 0,
     ("identical_views", "b2.png, again.png")),
    ("a picture of another resolution", picture("half.png", lambda lab: halved(lab.board(1))),
     [*ALL, "half.png", *PLUS], 0, ("changed_resolution", "half.png is 240 x 180")),
    ("a card of another resolution", picture("halfcard.png", lambda lab: halved(saved(lab, "card.png"))),
     [*ALL, *PLUS, "--square", "halfcard.png"], 2, ("changed resolution", "allowed: 480 x 360")),
    ("pictures squeezed", squeezed, ["--checkerboard", *(f"squeezed{k}.png" for k in range(6)), *PLUS], 0,
     ("anisotropic_scale",)),
    ("one picture out of focus", picture("soft.png", lambda lab: lab.board(4, look=replace(LOOK, blur=2.6))),
     [*ALL, "soft.png", *PLUS], 0, ("out_of_focus", "soft.png")),
    ("all out of focus", picture("softer.png", lambda lab: lab.board(0, look=replace(LOOK, blur=3.5))),
     ["--checkerboard", "softer.png", *PLUS], 0, ("out_of_focus", "softer.png")),
    ("a picture without a board", picture("none.png", empty),
     [*ALL, "none.png", *PLUS], 0, ("no_board", "none.png")),
    ("no picture with a board", picture("none.png", empty),
     ["--checkerboard", "none.png", *PLUS], 1, ("no checkerboard found",)),
    ("the card among the boards", nothing, [*ALL, "card.png", *PLUS], 0, ("no_board", "card.png")),
    ("a board taken for the card", nothing, [*ALL, *PLUS, "--square", "b0.png"], 2, ("square card",)),
    ("the card's colour", nothing, [*CARD_TOO, "--square-colour", "black"], 2, ("square card",)),
    ("overexposed", picture("bright.png", lambda lab: lab.board(1, look=replace(LOOK, bright=300.0, surround=300.0))),
     [*ALL, "bright.png", *PLUS], 0, ("saturation", "bright.png")),
    ("a finger over the board", picture("finger.png", lambda lab: lab.board(5, look=replace(LOOK, finger=True))),
     [*ALL[:6], "finger.png", *PLUS], 0, ("unlike_counts", "finger.png has 100 on 12 x 9 lines")),
    ("the card bowed", bowed, ["--checkerboard", *(f"bowed{k}.png" for k in range(6)), *PLUS], 0, ("grid_rms_high",)),
    ("swapped axes in a list of corners", swapped_points, ["--points", "swapped.csv", "--image-size", "480x360"], 2,
     ("lies outside the frame",)),
    ("only tilted alike", nothing, ["--checkerboard", "b0.png", *PLUS], 0, ("views_too_alike",)),
]  # fmt: skip


@pytest.mark.parametrize(("mistake", "plant", "args", "code", "says"), MISTAKES, ids=[row[0] for row in MISTAKES])
def test_no_wrong_answer_without_a_word(
    app: typer.Typer, lab: Lab, mistake: str, plant: Callable[[Lab], None], args: list[str], code: int,
    says: tuple[str, ...], monkeypatch: pytest.MonkeyPatch, tmp_path: Path,
) -> None:  # fmt: skip
    plant(lab)
    monkeypatch.chdir(lab.folder)
    result = run(app, "calibrate", *args, "--json", tmp_path / "c.json")
    assert result.exit_code == code, result.output
    spoken = [line for line in result.stderr.splitlines() if line.startswith(("warning:", "error:"))]
    print("\n".join(spoken))
    for word in says:
        assert any(word in line for line in spoken), spoken
    if code:
        assert len([line for line in spoken if line.startswith("error:")]) == 1
        assert not (tmp_path / "c.json").exists(), "nothing half-written"
    if not says:
        assert spoken == [], "no false alarm"


def test_a_film_of_another_resolution(
    app: typer.Typer, lab: Lab, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(lab.folder)
    assert run(app, "calibrate", *CARD_TOO, "--json", tmp_path / "c.json").exit_code == 0
    film = lab.save("film.png", halved(saved(lab, "card.png")))
    result = run(
        app, "measure", film, "--calibration", tmp_path / "c.json", "--threshold", 0.3, "--out", tmp_path / "o"
    )
    assert result.exit_code == 2
    assert "240 x 180" in result.stderr
    assert "480 x 360" in result.stderr


def test_no_board_on_the_glass_leaves_the_scale_to_the_card(
    app: typer.Typer, lab: Lab, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    from evanesce.measurement.refined.plate import PlateMap

    monkeypatch.chdir(lab.folder)
    areas = {}
    for said in ("none", "b0.png"):
        args = [*CARD_TOO, "--on-glass", said, "--json", tmp_path / "c.json"]
        assert run(app, "calibrate", *args).exit_code == 0
        stored = load_calibration(tmp_path / "c.json")
        plate = PlateMap.of(stored)
        assert plate.view == {"none": None, "b0.png": 1}[said]
        areas[said] = plate.middle_area
    true = (GLASS / LENS.fx) ** 2
    # the card: 170 px wide, its border good to 0.1 px a side; the board's corners to some hundredths over 310 px
    assert areas["none"] == pytest.approx(true, rel=4 * 0.1 / 170)
    assert areas["b0.png"] == pytest.approx(true, rel=2e-3)


def test_one_picture_mirrored_is_no_wrong_answer(
    app: typer.Typer, lab: Lab, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """A board has no left and right: a mirrored picture is one by a camera of mirrored centre, which widens errors."""
    monkeypatch.chdir(lab.folder)
    lab.save("mirror.png", saved(lab, "b3.png")[:, ::-1])
    files = ["--checkerboard", "b0.png", "b1.png", "b2.png", "b4.png", "b5.png"]
    stored = {}
    for name, more in (("right", ["b3.png"]), ("mirrored", ["mirror.png"])):
        assert run(app, "calibrate", *files, *more, *PLUS, "--json", tmp_path / f"{name}.json").exit_code == 0
        stored[name] = load_calibration(tmp_path / f"{name}.json")
    wide, fine = (stored[name].details["standard_errors"] for name in ("mirrored", "right"))
    assert wide["cx"] > 3 * fine["cx"]
    true = {"fx": LENS.fx, "fy": LENS.fy, "cx": LENS.cx, "cy": LENS.cy, "k1": LENS.k1, "k2": LENS.k2}
    matrix, k = stored["mirrored"].camera_matrix, stored["mirrored"].distortion
    found = {"fx": matrix[0, 0], "fy": matrix[1, 1], "cx": matrix[0, 2], "cy": matrix[1, 2], "k1": k[0], "k2": k[1]}
    for key, value in true.items():
        assert abs(found[key] - value) < 3 * wide[key], key


def test_every_view_stands_in_table_and_page(
    app: typer.Typer, lab: Lab, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(lab.folder)
    lab.save("finger.png", lab.board(5, look=replace(LOOK, finger=True)))
    names = ["b0.png", "b1.png", "b2.png", "b3.png", "b4.png", "finger.png"]
    result = run(app, "calibrate", "--checkerboard", *names, *PLUS, "--out", tmp_path)
    assert result.exit_code == 0
    page = (tmp_path / "calibration.html").read_text()
    views = load_calibration(tmp_path / "calibration.json").details["views"]
    assert [view["name"] for view in views] == names
    for view in views:
        assert view["rms_px"] < 0.1
        row = [view["name"], str(view["corners"]), f"{view['rms_px']:.3f}"]
        assert any(all(cell in line for cell in row) for line in result.stdout.splitlines())
        assert all(cell in page for cell in row)
    assert views[0]["corners"] == 108
    assert views[0]["lines"] == [12, 9]
    assert "found in" in result.stderr
