"""The twin of a photograph: what is put into a made-up photograph comes back out of the fit, on the half not seen."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from evanesce.cli import twin as command
from evanesce.evaluation.board_geometry import SENSOR_WIDTH_UM, FittedRig, PrintedBoard, bright_even, fit_rig
from evanesce.evaluation.board_light import block_mask, held_out_block, smooth_field, squares
from evanesce.measurement.calibration.board_lines import BoardLines, fit_lines
from evanesce.measurement.calibration.points import BoardView
from evanesce.optics.projection import Projection
from evanesce.rig import Camera, load_scene
from evanesce.studies.twin.residuals import causes, twin_residuals
from evanesce.studies.twin.study import Light, Twin, _Studio, make_twin
from support.boards import draw, warp

SIZE = (400, 300)
DOT = 25.4 / 600


def printed_lines(first: int, last: int, phase: float) -> BoardLines:
    """Lines of 1 mm on whole dots of a 600-dpi printer, the mean spacing and smooth trend left as they fall."""
    nominal = np.arange(first, last + 1, dtype=float)
    offset = np.rint((nominal + phase) / DOT) * DOT - phase - nominal
    return BoardLines((nominal, nominal), (offset, offset[::-1].copy()))


def made_up_camera() -> Camera:
    base = load_scene("thesis").camera
    data = base.model_dump()
    data |= {
        "resolution_px": SIZE,
        "scale_px_per_mm": 18.3,
        "centre_mm": (0.3, -0.2),
        "principal_point_offset_px": (3.7, -5.2),
        "tilt_x_deg": 0.6,
        "tilt_y_deg": -0.4,
        "roll_deg": 3.1,
    }
    data["lens"]["distortion"] = {"k1": -0.36, "k2": 0.11, "p1": 0.0, "p2": 0.0, "k3": 0.0}
    pitch = SENSOR_WIDTH_UM / SIZE[0]
    disc = pitch * data["lens"]["f_number"]
    data["lens"] |= {"defocus_um": 1.0 * disc, "field_curvature_um": 5.0 * disc}
    data["pixel"]["pitch_um"] = pitch
    return Camera.model_validate(data | {"tone_curve": "libcamera"})


@pytest.fixture(scope="module")
def truth() -> FittedRig:
    board = PrintedBoard(printed_lines(-14, 14, 0.013), np.zeros(2), 1.0015, 0.002, True, ink_mm=0.03)
    return FittedRig(made_up_camera(), board)


def uneven_light() -> Light:
    y, x = np.mgrid[0 : SIZE[1], 0 : SIZE[0]] / 300.0
    bright = 0.16 + 0.04 * x - 0.03 * y * x
    return Light(bright=bright, dark=0.02 + 0.004 * x * y)


@pytest.fixture(scope="module")
def made(truth: FittedRig) -> tuple[Twin, np.ndarray]:
    """A photograph simulated from a known rig, and its twin."""
    from evanesce.chain.simulate import expose

    base = load_scene("thesis")
    studio = _Studio(base, truth)
    scene = base.model_copy(update={"camera": truth.camera, "assumptions": {}, "sources": {}})
    light = studio.radiance(uneven_light(), truth.board)
    photo = expose(scene, light, seed=5)[1].data
    clean = expose(scene, light, seed=5, without=("noise",))[1].data
    return make_twin(photo, base, seed=9), clean.astype(float)


def test_bright_share_is_the_mean_of_drawn_squares(truth: FittedRig) -> None:
    """Against 60 x 60 point samples of the squares, ink and uneven lines drawn one by one."""
    board = truth.board
    x, y = np.array([0.51, -2.02, 5.03, 3.0]), np.array([0.48, 0.96, -2.96, 2.49])
    size = 0.055
    inner = (np.arange(60) + 0.5) / 60 - 0.5
    py = (y[:, None, None] + size * inner) / board.stretch
    px = x[:, None, None] + size * inner[:, None] - board.shear * py
    bright = np.zeros((4, 60, 60))
    lines = [n + o for n, o in zip(board.lines.nominal, board.lines.offset, strict=True)]
    for i in range(28):
        for j in range(28):
            if (i - 14 + j - 14) % 2 == 0:
                in_x = (px > lines[0][i] + 0.03) & (px < lines[0][i + 1] - 0.03)
                bright += in_x & (py > lines[1][j] + 0.03) & (py < lines[1][j + 1] - 0.03)
    # a straight edge through 60 samples a side is placed to half a sample: 1/120, two edges at most
    np.testing.assert_allclose(board.bright_share(x, y, size), bright.mean(axis=(1, 2)), atol=1 / 60)
    assert np.ptp(bright.mean(axis=(1, 2))) > 0.5, "the points do not test anything"


def test_rig_comes_back_from_its_corners(truth: FittedRig) -> None:
    plate = load_scene("thesis").plate
    index = np.array([(i, j) for i in range(-14, 15) for j in range(-14, 15)], dtype=float)
    image = truth.predict(plate, index)
    inside = ((image > 2) & (image < np.array(SIZE) - 3)).all(axis=1)
    shift = index[inside].min(axis=0)
    view = BoardView("v", index[inside] - shift, image[inside])
    start = made_up_camera().model_copy(update={"scale_px_per_mm": 58.0, "roll_deg": 0.0})
    fit = fit_rig(view, SIZE, start, plate, even_is_bright=True)
    # what is left of the lines' offsets of up to 21 um (0.39 px): lines with fewer than three corners, and the share of
    # 28 offsets that a cubic takes (4/28 of their variance of 0.22^2 px^2: 0.08 px) but for what the lens gives back
    miss = np.linalg.norm(fit.predict(plate, view.world) - view.image, axis=1)
    assert np.sqrt((miss**2).mean()) < 0.05
    camera = fit.camera
    assert camera.scale_px_per_mm == pytest.approx(18.3, rel=2e-3)
    assert camera.roll_deg == pytest.approx(3.1, abs=0.02)
    assert camera.tilt_x_deg == pytest.approx(0.6, abs=0.15)
    assert camera.tilt_y_deg == pytest.approx(-0.4, abs=0.15)
    assert camera.lens.distortion.k1 == pytest.approx(-0.36, abs=0.01)
    widths = np.concatenate(fit.board.lines.spacings_um)
    near = np.minimum(abs(widths - (23 * DOT * 1e3 - 1000)), abs(widths - (24 * DOT * 1e3 - 1000)))
    assert np.median(near) < 2.0, "squares of 23 and 24 dots do not show"


def test_lines_need_enough_corners_and_leave_smooth_trends_to_the_lens() -> None:
    world = np.array([(i, j) for i in range(12) for j in range(9)], dtype=float)
    bent = world + 0.03 * ((world / 6 - 1) ** 3)
    image = bent @ np.array([[30.0, 1.0], [-1.2, 30.5]]) + [40, 30]
    lines, _ = fit_lines(BoardView("v", world, image), (440, 330), 400.0)
    assert max(np.abs(o).max() for o in lines.offset) < 2e-3  # a cubic trend of 30 um is not called uneven print
    jump = bent.copy()
    jump[world[:, 0] == 5, 0] += 0.04
    moved, _ = fit_lines(
        BoardView("v", world, jump @ np.array([[30.0, 1.0], [-1.2, 30.5]]) + [40, 30]), (440, 330), 400.0
    )
    assert moved.offset[0][5] - moved.offset[0][[4, 6]].mean() == pytest.approx(0.04, rel=0.1)


def test_twin_of_a_simulated_photograph(made: tuple[Twin, np.ndarray], truth: FittedRig) -> None:
    """Known rig -> photograph -> fit: the held-out half shows the noise that was put in, and little else."""
    twin, clean = made
    residuals = twin_residuals(twin)
    assert residuals.corner_rms_px < 0.1
    noise = float((twin.photo - clean)[twin.held_out].std())
    difference = residuals.grey_rms**2 - noise**2
    # What the twin misses beside noise: geometry of 0.05 px on edges of 2.5 px and 80 DN (1.5 DN on a third of the
    # pixels), light between squares to 1 %, of 100 DN: below 2.5 DN together, in a picture that scatters by 40.
    assert difference < 2.5**2
    assert residuals.photo_deviation > 10 * 2.5
    assert twin.rig.board.ink_mm == pytest.approx(0.03, abs=0.008)
    for zone in residuals.zones:
        assert zone.edge_twin_px == pytest.approx(zone.edge_photo_px, rel=0.08)
        assert zone.bright_twin == pytest.approx(zone.bright_photo, abs=4.0)
    assert sum(c.energy for c in residuals.causes) == pytest.approx(1.0)
    assert sum(c.pixels for c in residuals.causes) == pytest.approx(1.0)


def test_halves_do_not_meet(made: tuple[Twin, np.ndarray]) -> None:
    twin, _ = made
    overlap = (twin.held_out & twin.fitted).sum()
    assert overlap < 0.05 * twin.held_out.sum()  # pixels cut by the border of two blocks count in both outlines
    assert 0.4 < twin.corners_held_out.mean() < 0.6
    grid = twin.grid
    even = bright_even(grid)
    before = squares(twin.photo, grid, even)
    spoiled = np.where(block_mask(grid, twin.photo.shape, held_out=True), 255.0, twin.photo)
    after = squares(spoiled, grid, even)
    np.testing.assert_array_equal(before.value[~before.held_out], after.value[~before.held_out])
    assert (after.value[before.held_out] > before.value[before.held_out] + 50).all()


def test_blocks_alternate() -> None:
    index = np.array([[0, 0], [1, 1], [2, 0], [3, 3], [0, 2], [4, 1]])
    assert held_out_block(index).tolist() == [False, False, True, False, True, False]


def test_smooth_field_ignores_a_reflection() -> None:
    rng = np.random.default_rng(3)
    centre = rng.uniform(0, 300, (150, 2))
    value = 0.2 + 3e-4 * centre[:, 0] - 1e-6 * centre[:, 1] ** 2
    spoiled = value.copy()
    spoiled[:3] += 0.5
    field = smooth_field(centre, spoiled, (300, 300))
    inner = ((centre > 20) & (centre < 280)).all(axis=1) & (np.arange(150) >= 3)
    at = np.floor(centre[inner]).astype(int)
    # a pixel of rounding times the slope of 6e-4 per px, twice, and the spline's smoothing of the quadratic term
    np.testing.assert_allclose(field[at[:, 1], at[:, 0]], value[inner], atol=2e-3)


def test_causes_find_what_was_planted() -> None:
    rng = np.random.default_rng(1)
    mean = np.where(np.indices((200, 240)).sum(axis=0) // 40 % 2, 100.0, 20.0)
    difference = rng.normal(0, 2.0, mean.shape)
    difference[20:180:23, 15:230:31] += 60.0  # specks
    difference[60:110, 150:200] += 25.0  # a reflection
    found = {c.name: c for c in causes(difference, mean, np.ones(mean.shape, dtype=bool))}
    reflected = 50 * 50 * 25.0**2 / (difference**2).sum()
    specks = 7 * 7 * 60.0**2 / (difference**2).sum()
    assert found["reflections, light"].energy == pytest.approx(reflected, rel=0.35)  # edges inside it count as its own
    assert found["specks and scratches"].energy > 0.6 * specks
    assert found["even print, noise"].rms == pytest.approx(2.0, rel=0.2)


def test_twin_of_a_board_drawn_elsewhere(tmp_path: Path) -> None:
    """A picture that the simulation did not make: Gaussian blur, its own distortion law, its own light."""
    shape = (300, 400)
    picture = draw(shape, warp(shape, 22.0, 5.0, barrel=0.08), np.random.default_rng(4), blur=1.0, corner_blur=2.0)
    residuals = twin_residuals(make_twin(picture, load_scene("thesis"), seed=1))
    assert residuals.corner_rms_px < 0.1
    # noise of 1.5 DN; disc for Gaussian and one distortion law for another leave a few DN at the edges of 110 DN
    assert residuals.grey_rms < 6.0
    assert residuals.photo_deviation > 35.0


@pytest.fixture(scope="module")
def app() -> typer.Typer:
    app = typer.Typer()
    command.register(app)
    app.command("other")(lambda: None)
    return app


def run(app: typer.Typer, *args: Any) -> Any:
    return CliRunner().invoke(app, ["twin", *map(str, args)])


def test_command_writes_a_self_contained_report(app: typer.Typer, tmp_path: Path) -> None:
    shape = (240, 320)
    picture = draw(shape, warp(shape, 20.0, 4.0, barrel=0.06), np.random.default_rng(7))
    cv2.imwrite(str(tmp_path / "p.png"), picture)
    result = run(app, tmp_path / "p.png", "--out", tmp_path / "out", "--json", tmp_path / "t.json", "--curve", "linear")
    assert result.exit_code == 0, result.output
    names = {"report.html", "photo_grey.png", "twin.png", "difference.png", "twin_scene.toml"}
    assert {p.name for p in (tmp_path / "out").iterdir()} == names
    page = (tmp_path / "out" / "report.html").read_text()
    assert page.count("data:image/png;base64,") >= 6
    assert not re.search(r"(src|href)=[\"']https?:", page)
    data = json.loads((tmp_path / "t.json").read_text())
    assert data["geometric_rms_px"] < 0.1
    assert data["grey_rms_DN"] < 8.0
    # the scene that was written is one the simulation reads
    scene = load_scene(tmp_path / "out" / "twin_scene.toml")
    assert scene.camera.resolution_px == (320, 240)
    Projection.of(scene.camera, scene.plate)


def test_command_refuses_bad_input(app: typer.Typer, tmp_path: Path) -> None:
    flat = tmp_path / "flat.png"
    cv2.imwrite(str(flat), np.full((100, 120), 90, np.uint8))
    for args, code, what in (
        ((tmp_path / "none.png",), 2, "no such file"),
        ((flat, "--curve", "cubic"), 2, "--curve"),
        ((flat, "--scene", "nowhere"), 2, "no such scene"),
        ((flat, "--out", tmp_path / "o"), 1, "no checkerboard found"),
    ):
        result = run(app, *args)
        assert result.exit_code == code, result.output
        assert what in result.stderr
        assert "Traceback" not in result.output


@pytest.mark.slow
def test_the_real_photograph(rig_photo: Path) -> None:
    """Corners to 0.45 px, grey to 9 DN, edges to 15 % in each zone; squares of 23 and 24 dots."""
    picture = cv2.imread(str(rig_photo / "checkerboard_1mm.png"))[..., ::-1]
    twin = make_twin(np.ascontiguousarray(picture), load_scene("thesis"), seed=1)
    residuals = twin_residuals(twin)
    assert residuals.corner_rms_px < 0.45
    assert residuals.grey_rms < 9.0
    for zone in residuals.zones:
        assert zone.edge_twin_px == pytest.approx(zone.edge_photo_px, rel=0.15)
    assert residuals.spacing_narrow_um == pytest.approx(23 * DOT * 1e3 - 1000, abs=4)
    assert residuals.spacing_wide_um == pytest.approx(24 * DOT * 1e3 - 1000, abs=4)
