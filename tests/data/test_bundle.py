"""Bundles: what is written is read back, what is broken is refused by its exact location."""

from __future__ import annotations

import csv
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from evanesce.bundle import read_bundle, scene_at
from evanesce.bundle.area import AreaReading, contact_area
from evanesce.bundle.check import contents
from evanesce.bundle.folder import new_folder
from evanesce.bundle.layout import Shot, conditions
from evanesce.bundle.protocol import LIGHT, Protocol, default_protocol, sweep_voltages
from evanesce.bundle.write import Rig, fine_enough, write_bundle
from evanesce.chain.simulate import expose, solve_contact
from evanesce.cli.app import app
from evanesce.core.errors import InputError
from evanesce.core.states import Frame
from evanesce.optics.led import led_radiances
from evanesce.optics.projection import Projection
from evanesce.render.fast.transport import render_fast
from evanesce.rig import Scene, dump_scene, load_scene
from evanesce.rig.coarser import coarser_camera, finer_pixels
from evanesce.rig.colour import AutoExposure
from evanesce.sensor.codec import VideoWriter, write_png

COLS, ROWS = 96, 70
CAMERA = {
    "camera.resolution_px": [COLS, ROWS],
    "camera.scale_px_per_mm": 3.65,
    "camera.pixel.pitch_um": 49.6,
    "camera.pixel.full_well_capacity_e": 2.1e6,
    "camera.pixel.conversion_gain_e_per_DN": 545.0,
    "camera.lens.distortion": {"k1": -0.3, "k2": 0.05},
    "grid.samples": 128,
    "finger.position_mm": [1.7, -0.9],
}
FORCES = (0.7, 2.3, 2.31)


@pytest.fixture(scope="module")
def scene() -> Scene:
    return load_scene("thesis", CAMERA)


@pytest.fixture
def hand(tmp_path: Path, scene: Scene) -> Path:
    """A bundle as a lab would fill it: press frames, replicates, a series."""
    root = tmp_path / "hand"
    (root / "press").mkdir(parents=True)
    (root / "replicates").mkdir()
    (root / "series").mkdir()
    (root / "scene.toml").write_text(dump_scene(scene))
    (root / "measurement.toml").write_text('scene = "scene.toml"\n[replicates]\npress_index = 9\n')
    lines = ["index,time_s,force_N,voltage_V,displacement_mm"]
    for index, time, force, voltage in (
        (2, 0.5, 0.7, 9.0),
        (5, 3.25, 2.3, 9.0),
        (9, 17.5, 2.31, 9.02),
        (11, 20, 2.3, 9.4),
    ):
        lines.append(f"{index},{time},{force},{voltage},{0.1 * force}")
        write_png(root / "press" / f"{index:04d}.png", picture(index))
    (root / "press.csv").write_text("\n".join(lines) + "\n")
    for k in range(3):
        write_png(root / "replicates" / f"{k}.png", picture(9))
    (root / "series" / "a.csv").write_text("force_N,area_mm2,sigma_mm2\n1.0,12.5,0.3\n2.5,20.25,0.3\n")
    return root


def picture(level: int) -> np.ndarray:
    image = np.full((ROWS, COLS), level, np.uint8)
    image[3, 7] = 200
    return image


def change(path: Path, old: str, new: str) -> None:
    text = path.read_text()
    assert text.count(old) == 1
    path.write_text(text.replace(old, new))


def refusal(root: Path) -> str:
    with pytest.raises(InputError) as caught:
        read_bundle(root)
    return str(caught.value)


def test_a_bundle_filled_by_hand_is_read(hand: Path) -> None:
    bundle = read_bundle(hand)
    assert [s.index for s in bundle.press] == [2, 5, 9, 11]
    assert [s.condition for s in bundle.press] == [0, 1, 1, 2]
    assert [s.held_s for s in bundle.press] == [0.0, 0.0, 14.25, 16.75]
    assert bundle.press[2].displacement_mm == pytest.approx(0.231)
    np.testing.assert_array_equal(bundle.frame(bundle.press[3]), picture(11))
    assert len(bundle.replicates) == 3
    assert bundle.replicates.shots[0].voltage_V == 9.02
    series = bundle.series["a"]
    assert (series.x_name, series.x_unit, series.y_name, series.y_unit) == ("force", "N", "area", "mm2")
    assert series.sigma is not None
    assert bundle.available == {"press", "voltage", "force", "time", "displacement", "replicates", "series"}
    assert scene_at(bundle.scene, bundle.press[3]).leds.voltage_V == 9.4


def test_a_finger_on_its_way_is_seen_by_frames_that_follow_at_once(hand: Path) -> None:
    """Of a hold a steady velocity would make nonsense; what needs motion is not checked there."""
    table = hand / "press.csv"
    lines = table.read_text().splitlines()
    assert "rolling_skew" in contents(read_bundle(hand))["cannot_be_named"]
    first, second = (line.split(",") for line in lines[1:3])
    assert first[2] != second[2]
    second[1] = str(float(first[1]) + 0.25)
    table.write_text("\n".join([*lines[:2], ",".join(second), *lines[3:]]) + "\n")
    assert "motion" in read_bundle(hand).available


def test_of_series_alone_the_check_does_not_promise_what_they_may_not_feel() -> None:
    thesis = Path(__file__).parents[2] / "bundles" / "thesis_silskin_20"
    found = CliRunner().invoke(app, ["bundle", "check", str(thesis)])
    assert found.exit_code == 0
    assert "series alone" in found.output


def test_two_frames_of_a_held_state_measure_no_noise(hand: Path) -> None:
    assert "replicates" not in contents(read_bundle(hand))["missing"]
    last = sorted((hand / "replicates").glob("*.png"))[-1]
    last.unlink()
    if (table := hand / "replicates" / "replicates.csv").exists():
        table.write_text("\n".join(table.read_text().splitlines()[:-1]) + "\n")
    assert "replicates" in contents(read_bundle(hand))["missing"]


def test_a_misspelt_folder_is_told(hand: Path) -> None:
    assert contents(read_bundle(hand))["not_read"] == []
    (hand / "leds_off").mkdir()
    assert contents(read_bundle(hand))["not_read"] == ["leds_off"]
    found = CliRunner().invoke(app, ["bundle", "check", str(hand)])
    assert found.exit_code == 0
    assert "not read: leds_off" in found.output


def test_a_table_of_replicates_beside_that_of_the_press_is_sent_to_its_place(hand: Path) -> None:
    (hand / "replicates.csv").write_text("index,time_s,force_N,voltage_V\n")
    found = CliRunner().invoke(app, ["bundle", "check", str(hand)])
    assert "not read: replicates.csv (its place is replicates/replicates.csv)" in " ".join(found.output.split())


def test_without_voltage_and_displacement_the_scene_speaks_and_they_are_not_available(hand: Path) -> None:
    rows = list(csv.reader((hand / "press.csv").read_text().splitlines()))
    (hand / "press.csv").write_text("".join(",".join(row[:3]) + "\n" for row in rows))
    bundle = read_bundle(hand)
    assert {s.voltage_V for s in bundle.press} == {bundle.scene.leds.voltage_V}
    assert not {"voltage", "displacement"} & bundle.available
    assert "displacement" in contents(bundle)["missing"]


def test_one_force_and_a_short_hold_are_neither_force_nor_time() -> None:
    shots = conditions([Shot(index=k, time_s=3.0 * k, force_N=2.0 + 0.005 * k, voltage_V=9.0) for k in range(4)])
    assert {s.condition for s in shots} == {0}
    assert shots[-1].held_s == 9.0


def test_a_lifted_finger_ends_the_hold() -> None:
    shots = conditions(
        [Shot(index=k, time_s=20.0 * k, force_N=2.0, voltage_V=9.0, session=s) for k, s in enumerate((0, 0, 1))]
    )
    assert [s.held_s for s in shots] == [0.0, 20.0, 0.0]
    assert [s.condition for s in shots] == [0, 0, 1]


@pytest.mark.parametrize(
    ("old", "new", "where"),
    [
        ("5,3.25,2.3,9.0", "5,3.25,nan,9.0", "press.csv: line 3, column force_N: 'nan'"),
        ("5,3.25,2.3,9.0", "5,3.25,,9.0", "press.csv: line 3, column force_N: is empty"),
        ("5,3.25,2.3,9.0", "5,3.25,2.3,inf", "press.csv: line 3, column voltage_V: 'inf'"),
        ("5,3.25,2.3,9.0", "5,3.25,-2.3,9.0", "press.csv: line 3, column force_N: '-2.3'"),
        ("5,3.25,2.3,9.0", "5.5,3.25,2.3,9.0", "press.csv: line 3, column index: '5.5'"),
        ("5,3.25,2.3,9.0", "5,3.25,2.3", "press.csv: line 3: 4 cells"),
        ("5,3.25,2.3,9.0", "5,0.25,2.3,9.0", "press.csv: line 3, column time_s: 0.25 comes after 0.5"),
        ("5,3.25,2.3,9.0", "5,0.5,2.3,9.0", "press.csv: line 3, column time_s: 0.5 comes after 0.5"),
        ("5,3.25,2.3,9.0", "2,3.25,2.3,9.0", "press.csv: line 3, column index: 2 comes after 2"),
        ("5,3.25,2.3,9.0", "6,3.25,2.3,9.0", "press.csv: line 3, column index: frame 6 is missing"),
        ("time_s", "time_ms", "press.csv: line 1: unknown column 'time_ms'; nearest: time_s"),
        ("time_s,force_N", "time_s,time_s", "press.csv: line 1: column time_s stands there twice"),
        (",0.231", ",", "press.csv: line 4, column displacement_mm: is empty"),
    ],
)  # fmt: skip
def test_a_broken_table_is_refused_with_line_and_column(hand: Path, old: str, new: str, where: str) -> None:
    text = (hand / "press.csv").read_text()
    (hand / "press.csv").write_text(text.replace(old, new, 1))
    assert where in refusal(hand)


def test_frames_and_lines_must_match(hand: Path) -> None:
    write_png(hand / "press" / "0012.png", picture(1))
    assert "press/0012.png: has no line in press.csv: 5 frames, 4 lines" in refusal(hand)
    (hand / "press" / "0012.png").unlink()
    (hand / "press" / "0005.png").unlink()
    assert "line 3, column index: frame 5 is missing: no press/0005.png" in refusal(hand)
    shutil.rmtree(hand / "press")
    assert "frame 2 is missing" in refusal(hand)


def test_another_resolution_is_refused(hand: Path) -> None:
    write_png(hand / "replicates" / "1.png", picture(3)[:, :-1])
    assert f"1.png: {COLS - 1} x {ROWS} pixels" in refusal(hand)


def test_damaged_and_deep_images_are_refused(hand: Path) -> None:
    path = hand / "press" / "0009.png"
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    assert "0009.png" in refusal(hand)
    write_png(path, picture(9).astype(np.uint16) * 257)
    assert "0009.png: 16-bit samples" in refusal(hand)


@pytest.mark.parametrize(
    "name", ["../scene.toml", "/etc/hostname", "a/../../scene.toml", "file:scene.toml", "..\\scene.toml"]
)
def test_names_that_lead_out_are_refused(hand: Path, name: str) -> None:
    shutil.copy(hand / "scene.toml", hand.parent / "scene.toml")
    (hand / "measurement.toml").write_text(f"scene = {name!r}\n")
    assert "measurement.toml: scene" in refusal(hand)
    (hand / "measurement.toml").write_text(f"scene = 'scene.toml'\n[press]\nvideo = {name!r}\n")
    assert "measurement.toml: press.video" in refusal(hand)


def test_links_that_lead_out_are_refused(hand: Path) -> None:
    outside = hand.parent / "outside.png"
    (hand / "press" / "0005.png").rename(outside)
    (hand / "press" / "0005.png").symlink_to(outside)
    assert "0005.png: is a link that leads out" in refusal(hand)
    (hand / "press" / "0005.png").unlink()
    outside.rename(hand / "press" / "0005.png")
    (hand / "led_off").symlink_to(hand.parent)
    assert "led_off: is a link that leads out" in refusal(hand)


def test_what_measurement_toml_says_must_be_true(hand: Path) -> None:
    path = hand / "measurement.toml"
    change(path, "press_index = 9", "press_index = 8")
    assert "replicates.press_index: 8 is no frame of press.csv" in refusal(hand)
    path.write_text('scene = "scene.toml"\n[series.b]\nforce_N = 1.0\n')
    assert "series.b: no series/b.csv" in refusal(hand)
    path.write_text('scene = "scene.toml"\n[series.a]\nforce = 1.0\n')
    assert "series.a: unknown key 'force'" in refusal(hand)
    path.write_text('scene = "scene.toml"\ncamera = 1\n')
    assert "measurement.toml: camera: unknown key" in refusal(hand)
    path.write_text('scene = "no_such_rig"\n')
    assert "no shipped scene" in refusal(hand)
    path.unlink()
    assert "measurement.toml: is missing" in refusal(hand)


def test_replicates_count_against_their_table(hand: Path) -> None:
    (hand / "measurement.toml").write_text('scene = "scene.toml"\n')
    assert read_bundle(hand).replicates.shots == ()
    (hand / "replicates" / "replicates.csv").write_text("index,time_s,force_N\n0,1,2\n1,2,2\n")
    assert "replicates.csv: 2 lines, but 3 frames" in refusal(hand)


@pytest.mark.parametrize(
    ("lines", "says"),
    [
        ("0,30,2,9\n1,31,2,9\n2,32,2.9,9", "line 4, column force_N: 2.9 after 2"),
        ("0,30,2,9\n1,31,2,9.5\n2,32,2,9", "line 3, column voltage_V: 9.5 after 9"),
        ("0,3,2.3,9\n1,10,2.3,9\n2,32,2.3,9", "column time_s: frame 11 of press.csv has 2.3 N and 9.4 V at 20 s"),
    ],
)
def test_replicates_are_of_one_held_state(hand: Path, lines: str, says: str) -> None:
    """Rationale: frames of a ramp taken for replicates are noise of 2.6 DN a bin, and nothing is found any more."""
    (hand / "measurement.toml").write_text('scene = "scene.toml"\n')
    (hand / "replicates" / "replicates.csv").write_text(f"index,time_s,force_N,voltage_V\n{lines}\n")
    assert f"replicates.csv: {says}" in refusal(hand)


def test_series_are_checked(hand: Path) -> None:
    path = hand / "series" / "a.csv"
    path.write_text("force_N,area_mm2\n1.0,nan\n")
    assert "a.csv: line 2, column area_mm2: 'nan'" in refusal(hand)
    path.write_text("time_s,area_mm2\n1.0,3\n\n0.5,4\n")
    assert "a.csv: line 4, column time_s: 0.5 comes after 1" in refusal(hand)
    path.write_text("area_mm2,force_N\n1.0,3\n")
    assert "a.csv: line 1: columns area_mm2, force_N" in refusal(hand)
    path.write_text("force_N,area_mm2,sigma_N\n1.0,3,1\n")
    assert "a.csv: line 1: third column 'sigma_N'" in refusal(hand)
    path.write_text("slide_mm,tangential_force_N\n0.5,0.1\n1.0,2000\n")
    assert "a.csv: line 3, column tangential_force_N: '2000' (allowed: -1000 to 1000 N)" in refusal(hand)
    path.write_text("slide_mm,torque_Nmm\n1e4,0.1\n")
    assert "a.csv: line 2, column slide_mm: '1e4' (allowed: -1000 to 1000 mm)" in refusal(hand)
    path.write_text("slide_mm,tangential_force_N,sigma_Nmm\n0.5,0.1,0.01\n")
    assert "a.csv: line 1: third column 'sigma_Nmm' (allowed: sigma_N)" in refusal(hand)
    path.write_text("tangential_force_N,slide_mm\n0.1,0.5\n")
    assert "a.csv: line 1: columns tangential_force_N, slide_mm" in refusal(hand)
    path.write_text("force_N,area_mm2\n1.0,3\n")
    path.with_suffix(".CSV").write_text("force_N,area_mm2\n1.0,4\n")
    assert "a.csv: is there twice" in refusal(hand)


def test_a_video_takes_the_place_of_the_folder(hand: Path) -> None:
    shutil.rmtree(hand / "press")
    with VideoWriter(hand / "press.mkv", codec="ffv1", frame_rate_hz=10) as video:
        for k in range(13):
            video.add(Frame(data=picture(k), time=0.1 * k, index=k))
    (hand / "measurement.toml").write_text('scene = "scene.toml"\n[press]\nvideo = "press.mkv"\n')
    bundle = read_bundle(hand)
    for shot in bundle.press:
        np.testing.assert_array_equal(bundle.frame(shot), picture(shot.index))
    change(hand / "press.csv", "11,20", "13,20")
    assert "press.csv: column index: frame 13 is named, but the video holds 13" in refusal(hand)


def test_written_bundle_is_what_was_simulated(tmp_path: Path, scene: Scene) -> None:
    shots = conditions(
        [
            Shot(index=k, time_s=2.0 * k, force_N=f, voltage_V=v)
            for k, (f, v) in enumerate(((0.7, 9), (2.3, 9), (2.3, 9.4)))
        ]
    )
    protocol = Protocol(press=shots, replicates=3, led_off=1, lens_cap=1)
    for name in ("one", "two"):
        write_bundle(tmp_path / name, scene, seed=5, protocol=protocol)
    bundle, again = read_bundle(tmp_path / "one"), read_bundle(tmp_path / "two")
    assert bundle.scene == scene
    assert [(s.force_N, s.voltage_V, s.time_s) for s in bundle.press] == [
        (s.force_N, s.voltage_V, s.time_s) for s in shots
    ]
    for kind in ("press", "replicates", "led_off", "lens_cap", "checkerboard", "square"):
        frames = bundle.frames(kind)
        assert frames
        np.testing.assert_array_equal(frames, again.frames(kind))
    small, large, brighter = (frame.astype(float) for frame in bundle.frames("press"))
    assert (large > 40).sum() > 1.5 * (small > 40).sum()
    assert brighter[large > 40].mean() > 1.1 * large[large > 40].mean()
    rows, cols = np.nonzero(large > 40)
    u, v = Projection.of(scene.camera, scene.plate).to_image(1.7, -0.9)
    assert abs(cols.mean() - u) < 0.5
    assert abs(rows.mean() - v) < 0.5
    assert bundle.led_off[0].max() <= 1
    assert bundle.lens_cap[0].max() <= 1
    first, second, _ = bundle.replicate_frames
    assert np.any(first != second)
    assert np.abs(first.astype(int) - second)[large < 100].max() <= 3
    assert bundle.available == {
        "press", "voltage", "force", "displacement", "replicates", "led_off", "lens_cap", "checkerboard", "square",
        "series",
    }  # fmt: skip


def test_what_the_camera_chose_stands_in_the_tables_and_makes_the_same_frames(tmp_path: Path, scene: Scene) -> None:
    """A camera set by hand to the exposure and gain of a line takes that line's frame, byte by byte."""
    camera = scene.camera.model_copy(update={"auto_exposure": AutoExposure(metering="spot")})
    controlled = scene.model_copy(update={"camera": camera})
    shots = conditions([Shot(index=k, time_s=2.0 * k, force_N=2.3, voltage_V=v) for k, v in enumerate((8.6, 9.4))])
    write_bundle(tmp_path / "b", controlled, seed=5, protocol=Protocol(press=shots, replicates=1, led_off=1))
    bundle = read_bundle(tmp_path / "b")
    for shot in bundle.press:
        fixed = scene.camera.model_copy(update={"exposure_ms": shot.exposure_ms, "analogue_gain": shot.analogue_gain})
        rig = Rig(scene.model_copy(update={"camera": fixed}), 5, finer=fine_enough(scene))
        found = rig.press(shot)[0]
        # the table has nine digits of an exposure: a grey level in a million may round the other way
        assert np.mean(found != bundle.frame(shot)) < 1e-4
    first, second = (shot.exposure_ms * shot.analogue_gain for shot in bundle.press)
    assert second < 0.95 * first
    assert bundle.replicates.shots[0].exposure_ms > 0
    assert np.isnan(bundle.press[0].red_gain)
    told = CliRunner().invoke(app, ["bundle", "check", str(tmp_path / "b"), "--json", str(tmp_path / "c.json")])
    assert "exposure [ms], chosen by the camera" in told.output
    chosen = json.loads((tmp_path / "c.json").read_text())["press"]["chosen_by_camera"]
    assert set(chosen) == {"exposure_ms", "analogue_gain"}
    change(tmp_path / "b" / "press.csv", "exposure_ms", "exposure_s")
    assert "nearest: exposure_ms" in refusal(tmp_path / "b")


def test_balance_that_the_camera_chose_is_written(tmp_path: Path) -> None:
    changes = {"camera.colour.white_balance": "automatic", "camera.resolution_px": [320, 240],
               "camera.scale_px_per_mm": 9.3, "camera.lens.focal_length_mm": 1.0}  # fmt: skip
    scene = load_scene("thesis_ridged_red", changes | {"camera.lens.distortion": {"k1": 0.0, "k2": 0.0}})
    shots = conditions([Shot(index=4, time_s=0.0, force_N=2.3, voltage_V=9.0)])
    write_bundle(tmp_path / "b", scene, seed=5, protocol=Protocol(press=shots, replicates=0))
    (shot,) = read_bundle(tmp_path / "b").press
    frame = Rig(scene, 5).taken(shot)[0]
    assert frame.balance == pytest.approx((shot.red_gain, shot.blue_gain), rel=1e-8)
    assert np.isnan(shot.exposure_ms)


def test_larger_pixels_add_up_the_light_of_smaller_ones() -> None:
    """A disc of blur smaller than a pixel: on the coarse pixels themselves an edge comes out another one."""
    fine = load_scene("thesis", {"camera.resolution_px": [300, 240], "camera.principal_point_offset_px": [7.0, -4.0]})
    coarse = coarser_camera(fine, 5)
    assert finer_pixels(coarse, 5).camera.resolution_px == (300, 240)
    shot = Shot(index=0, time_s=0.0, force_N=1.3, voltage_V=9.0)
    rig, state = solve_contact(scene_at(fine, shot), shot.force_N, seed=1)
    whole = expose(rig, render_fast(rig, state, seed=1), seed=1)[0].irradiance
    expected = whole.reshape(48, 5, 60, 5).mean(axis=(1, 3))
    rig = solve_contact(scene_at(coarse, shot), shot.force_N, seed=1)[0]
    found = expose(rig, render_fast(finer_pixels(rig, 5), state, seed=1), seed=1, finer=5)[0].irradiance
    np.testing.assert_allclose(found, expected, rtol=1e-9)
    on_its_own = expose(rig, render_fast(rig, state, seed=1), seed=1)[0].irradiance
    assert np.abs(on_its_own - expected).max() > 0.01 * expected.max()


def test_a_bundle_of_few_pixels_per_mm_shows_an_edge_as_fine_ones_do(tmp_path: Path) -> None:
    """Rationale: by the camera's own pixels it was some DN off, which means of many frames show."""
    few = {
        "camera.resolution_px": [200, 160],
        "camera.scale_px_per_mm": 12.0,
        "camera.pixel.pitch_um": 15.0,
        "camera.exposure_ms": 0.6,
        "grid.samples": 512,
    }
    scene = load_scene("thesis", few)
    shots = conditions([Shot(index=0, time_s=0.0, force_N=3.0, voltage_V=9.0)])
    protocol = Protocol(press=shots, replicates=4)
    means = []
    for name, finer in (("own", 1), ("default", None), ("fine", 6)):
        write_bundle(tmp_path / name, scene, seed=5, protocol=protocol, finer=finer)
        means.append(np.mean([f.astype(float) for f in read_bundle(tmp_path / name).replicate_frames], axis=0))
    own, default, fine = means
    # The same noise is drawn of each.
    edge = np.hypot(*np.gradient(fine)) > 20.0
    off = [float(np.sqrt(np.mean((one - fine)[edge] ** 2))) for one in (own, default)]
    assert off[1] < 0.35 * off[0]


def test_area_of_a_drawn_disc_is_its_area(scene: Scene) -> None:
    projection = Projection.of(scene.camera, scene.plate)
    fine = 8
    u, v = np.meshgrid((np.arange(COLS * fine) + 0.5) / fine - 0.5, (np.arange(ROWS * fine) + 0.5) / fine - 0.5)
    x, y = projection.to_plate(u, v)
    radius = 5.3
    disc = (np.hypot(x + 3.1, y - 2.2) < radius).astype(float)
    frame = np.round(200 * disc.reshape(ROWS, fine, COLS, fine).mean(axis=(1, 3))).astype(np.uint8)
    # At half of the disc's level blur moves a straight edge not at all; a pixel's box and the curve leave per cents.
    found = contact_area(frame, scene, AreaReading(threshold=100 / 255, blur_px=1.0))
    rim_px = 2 * np.pi * radius * scene.camera.scale_px_per_mm
    tolerance = (1.0 + np.sqrt(rim_px)) / scene.camera.scale_px_per_mm**2  # one pixel in each of the rim's at random
    assert found == pytest.approx(np.pi * radius**2, abs=3 * tolerance)


def test_the_sweep_gives_the_light_it_is_asked_for(scene: Scene) -> None:
    def power(voltage: float) -> float:
        leds = scene.leds.model_copy(update={"voltage_V": voltage})
        return float(np.mean(np.concatenate(list(led_radiances(scene.plate, leds).values()))))

    voltages = sweep_voltages(scene)
    found = [power(v) / power(9.0) for v in voltages]
    # A step of 0.05 V is at most 0.05 d(ln P)/dV; half of it is what rounding may do.
    for share, voltage, asked in zip(found, voltages, LIGHT, strict=True):
        step = abs(power(voltage + 0.05) - power(voltage - 0.05)) / power(9.0) / 2
        assert abs(share - asked) <= 0.55 * step
    protocol = default_protocol(scene)
    assert np.all(np.diff([s.time_s for s in protocol.press]) > 0)
    assert np.all(np.diff([s.force_N for s in protocol.press]) >= 0)
    assert max(s.held_s for s in protocol.press) > 100


def test_nothing_is_left_behind_when_the_work_breaks(tmp_path: Path) -> None:
    def broken() -> None:
        with new_folder(tmp_path / "b") as part:
            (part / "x").write_text("x")
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        broken()
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "b").mkdir()
    (tmp_path / "b" / "mine").write_text("x")
    with pytest.raises(InputError, match="not empty"), new_folder(tmp_path / "b"):
        pass
    assert (tmp_path / "b" / "mine").read_text() == "x"


@pytest.mark.system
def test_commands_check_and_refuse(hand: Path, tmp_path: Path) -> None:
    run = CliRunner().invoke
    found = run(app, ["bundle", "check", str(hand), "--json", str(tmp_path / "c.json")])
    assert found.exit_code == 0
    assert "lens_cap" in (tmp_path / "c.json").read_text()
    assert "force [N]" in found.output
    (hand / "press" / "0005.png").unlink()
    found = run(app, ["bundle", "check", str(hand)])
    assert found.exit_code == 2
    assert found.output.count("\n") == 1
    found = run(app, ["simulate", "thesis", "--bundle", str(hand), "--camera-coarser", "50"])
    assert found.exit_code == 2
    found = run(app, ["simulate", "thesis", "--bundle", str(tmp_path / "n"), "--camera-coarser", "7"])
    assert found.exit_code == 2
    assert "common divisor" in found.output
    assert not (tmp_path / "n").exists()
