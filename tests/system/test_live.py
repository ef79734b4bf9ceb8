"""The live page without a browser: settings, scenes, masks, figures, charts, a lab's own files, the server's limits."""

from __future__ import annotations

import io
import re
import socket
import struct
import sys
import warnings
import xml.etree.ElementTree as ElementTree
import zlib
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from PIL import Image as PillowImage
from skimage.color import deltaE_ciede2000, rgb2lab
from typer.testing import CliRunner

from evanesce.cli.app import app
from evanesce.contact.solve import contact_state
from evanesce.core.errors import InputError
from evanesce.evaluation.labels import label, view_geometry
from evanesce.evaluation.perfect_view import PerfectView
from evanesce.live import pictures
from evanesce.live.charts import histogram_svg, profile_svg
from evanesce.live.controls import SET_HERE, Controls, controls_of, knobs_of, led_names, scene_at_resolution, scene_of
from evanesce.live.engine import Engine
from evanesce.live.figures import figures_of, histogram_of, profile_of, single_grey
from evanesce.live.own import MAX_BYTES, is_film, measure_own, plain_name, read_film, read_own, read_own_file
from evanesce.live.present import present
from evanesce.live.saved import scene_text
from evanesce.live.truth_view import ContactShare
from evanesce.live.worker import Worker
from evanesce.measurement.reference.segment import Chain, Crop, blurred_grey, segment
from evanesce.rig import load_scene
from support.live_rig import expected, rig
from support.videos import write_video

# --- settings and scenes ---------------------------------------------------------------------------------------------


def changed(scene: Any, **values: Any) -> Controls:
    return controls_of(scene).changed(**values)


def some_leds(scene: Any) -> tuple[float, ...]:
    return tuple(0.0 if i % 5 == 1 else 1.0 + 0.01 * i for i in range(len(led_names(scene))))


def test_a_scene_left_alone_is_itself() -> None:
    scene = load_scene("thesis_ridged", {"press.forces_N": [2.3]})
    assert scene_of(scene, controls_of(scene)) == scene


@pytest.mark.parametrize("name", ["thesis", "thesis_ridged", "thesis_slide"])
def test_a_saved_setting_is_read_back_equal(name: str, tmp_path: Path) -> None:
    scene = load_scene(name)
    controls = changed(
        scene, voltage_V=8.35, led_power=some_leds(scene), force_N=0.85, material="silskin_20", ridge_height_um=31.5,
        defocus_um=-45.0, threshold=0.2125, min_blob_px=1250.0,
    )  # fmt: skip
    path = tmp_path / "scene.toml"
    path.write_text(scene_text(scene, controls), encoding="utf-8")
    found = load_scene(path)
    assert found == scene_of(scene, controls)
    assert found.leds.voltage_V == 8.35
    assert found.camera.lens.defocus_um == -45.0
    assert found.press.forces_N == (0.85,)
    assert found.finger.ridges is not None
    assert found.finger.ridges.height_um == 31.5
    assert found.slide is None
    powers = [p for edge in found.leds.edges for p in found.leds.edge[edge].relative_power]
    assert powers == list(some_leds(scene))
    # An old source does not vouch for a new figure.
    for key in ("leds.voltage_V", "press.forces_N", "finger.ridges.height_um", "leds.edge.top.relative_power"):
        assert found.assumptions[key] == SET_HERE
        assert key not in found.sources
    assert found.sources["plate.thickness_mm"] == scene.sources["plate.thickness_mm"]


def test_a_finger_without_ridges_names_none() -> None:
    found = scene_of(rig(), changed(rig(), ridge_height_um=0.0))
    assert found.finger.ridges is None
    assert not any("ridges" in key for key in {**found.sources, **found.assumptions})


@pytest.mark.parametrize(
    ("values", "says"),
    [
        ({"voltage_V": 61.0}, "leds.voltage_V"),
        ({"material": "rubber"}, "silskin_0"),
        ({"ridge_height_um": 0.01}, "finger.ridges.height_um"),
        ({"force_N": -1.0}, "press.forces_N"),
        ({"led_power": (1.0,)}, "LEDs"),
        ({"threshold": 1.5}, "--threshold"),
    ],
)
def test_an_impossible_setting_is_one_line(values: dict[str, Any], says: str) -> None:
    scene = rig()
    with pytest.raises(InputError, match=re.escape(says)) as caught:
        Engine(scene, backend="numpy").show(changed(scene, **values))
    assert "\n" not in str(caught.value)


def test_no_slider_takes_what_is_no_number() -> None:
    with pytest.raises(InputError, match="finite"):
        changed(rig(), voltage_V=float("nan"))


def test_sliders_hold_the_scenes_own_figures() -> None:
    scene = rig(**{"leds.voltage_V": 4.2, "camera.lens.defocus_um": 555.0})
    knobs = knobs_of(scene)
    for name, knob in knobs.items():
        assert knob.low <= getattr(controls_of(scene), name) <= knob.high
    assert (knobs["voltage_V"].low, knobs["defocus_um"].high) == (4.2, 555.0)


def test_half_resolution_sees_the_same_field_and_keeps_a_grid_that_ridges_need() -> None:
    scene = rig()
    half = scene_at_resolution(scene, 2)
    assert half.camera.resolution_px == (334, 250)
    assert half.camera.resolution_px[0] / half.camera.scale_px_per_mm == pytest.approx(668 / 19.4)
    assert half.grid.samples == 256
    fine = rig(**{"finger.ridges.pitch_um": 260.0, "finger.ridges.width_um": 130.0})
    assert scene_at_resolution(fine, 2).grid.samples == 512
    odd = rig(**{"camera.resolution_px": [667, 500]})
    assert controls_of(odd).coarser == 1


# --- engine ----------------------------------------------------------------------------------------------------------


def test_truth_in_the_view_is_that_of_the_labels() -> None:
    """The same samples by cached maps; OpenCV rounds positions to 1/32 cell, differently for one and two channels."""
    scene = scene_at_resolution(rig(), 2)
    perfect = PerfectView.of(scene)
    geometry = view_geometry(perfect.projection, perfect.view)
    states = [contact_state(scene, force) for force in (0.3, 4.1)]
    shares = ContactShare(geometry, states[0].grid, supersample=3)
    for state in states:
        assert shares.of(state) == pytest.approx(label(state, geometry, supersample=3).mask, abs=1 / 64)
    assert not shares.of(None).any()
    with pytest.raises(ValueError, match="grid"):
        shares.of(contact_state(rig(), 1.0))


def test_shown_is_what_the_library_says_whatever_was_shown_before() -> None:
    engine, scene = Engine(rig(), backend="auto"), rig()
    start = controls_of(scene)
    visited = [
        start,
        start.changed(voltage_V=9.45, threshold=0.22),
        start.changed(defocus_um=120.0, material="silskin_10"),
        start.changed(force_N=0.6, ridge_height_um=20.0, min_blob_px=400.0),
    ]
    first = [engine.show(controls) for controls in visited]
    again = engine.show(visited[1])
    assert (again.frame == first[1].frame).all()
    assert again.figures == first[1].figures
    said = [
        expected(2.0),
        expected(2.0, threshold=0.22, **{"leds.voltage_V": 9.45}),
        expected(2.0, **{"camera.lens.defocus_um": 120.0, "finger.material": "silskin_10"}),
        expected(0.6, min_blob_px=400, **{"finger.ridges.height_um": 20.0}),
    ]
    for shown, library in zip(first, said, strict=True):
        assert (shown.frame == library.frame).all()
        assert (shown.mask == library.mask).all()
        assert shown.figures.area_mm2 == pytest.approx(library.area_mm2, rel=1e-12)
        assert shown.figures.true_mm2 == library.true_mm2
        # Two samples a side against four: rims differ, sums hardly.
        assert np.mean((shown.truth >= 0.5) != (library.truth >= 0.5)) < 1e-3
    assert len({shown.figures.area_mm2 for shown in first}) == 4


def test_preparation_says_what_it_does_and_ends_in_the_first_picture() -> None:
    steps: list[str] = []
    first = Engine(rig(), backend="numpy").prepare(steps.append)
    assert [text.split()[0] for text in steps] == ["light", "fields", "maps"]
    assert first.controls == controls_of(rig())
    assert set(first.seconds) >= {"scene", "contact", "frame", "segment"}


def test_window_holds_the_contact_and_stands_still() -> None:
    engine, start = Engine(rig(), backend="numpy"), controls_of(rig())
    windows = []
    for force in (2.1, 2.13, 2.16, 7.0):
        shown = engine.show(start.changed(force_N=force))
        windows.append(shown.window)
        rows, cols = np.nonzero(shown.truth >= 0.5)
        rows_px, cols_px = pictures.size_of(shown.window)
        assert shown.window.r0 < rows.min()
        assert rows.max() < shown.window.r0 + rows_px - 1
        assert shown.window.c0 < cols.min()
        assert cols.max() < shown.window.c0 + cols_px - 1
        assert cols_px / rows_px == pytest.approx(4 / 3, rel=0.02)
    assert windows[0] == windows[1] == windows[2]


def test_a_scene_with_effects_goes_the_general_way_and_says_so() -> None:
    scene = rig(effects={"vignetting": {"k": 0.4}, "plate_tilt": {"about_x_deg": 1.5}})
    shown = Engine(scene, backend="numpy").show(controls_of(scene))
    assert "effects" in shown.note
    assert shown.figures.area_mm2 == pytest.approx(shown.figures.true_mm2, rel=0.2)
    # The truth is seen through the tilted plate as it is, and so covers the mask.
    assert shown.figures.overlap > 0.85


# --- figures, charts, pictures ---------------------------------------------------------------------------------------


def blobs() -> tuple[np.ndarray, np.ndarray]:
    """A bright patch and a truth that is shifted against it."""
    view = np.full((120, 170), 9, np.uint8)
    view[31:78, 40:101] = 143
    truth = np.zeros((120, 170), np.float32)
    truth[35:80, 47:104] = 1.0
    return view, truth


def test_figures_add_up() -> None:
    view, truth = blobs()
    found = segment(view, Chain(threshold=0.3, min_blob=50, blur=0.0, radius=3))
    f = figures_of(found, truth >= 0.5, view, 10.5, 0.004)
    both = (78 - 35) * (101 - 47)
    assert f.agree_mm2 == pytest.approx(both * 0.004)
    assert f.missed_mm2 == pytest.approx((45 * 57 - both) * 0.004)
    assert f.false_mm2 == pytest.approx((47 * 61 - both) * 0.004)
    assert f.area_mm2 == pytest.approx(47 * 61 * 0.004)
    assert f.error_percent == pytest.approx(100 * (47 * 61 * 0.004 / 10.5 - 1))
    assert f.overlap == pytest.approx(both / (47 * 61 + 45 * 57 - both))
    assert (f.brightest_DN, f.saturated_percent, f.blobs) == (143, 0.0, 1)
    nothing = figures_of(found, truth < 0, view, 0.0, 0.004)
    assert np.isnan(nothing.error_percent)


@pytest.mark.parametrize("colour", [False, True])
def test_grey_of_the_pictures_is_the_chains(colour: bool) -> None:
    rng = np.random.default_rng(5)
    image = rng.integers(0, 256, (41, 67, 3) if colour else (41, 67)).astype(np.uint8)
    for blur in (0.0, 0.5, 1.7):
        assert single_grey(image, blur) == pytest.approx(blurred_grey(image, blur), abs=3e-6)


def test_histogram_counts_every_pixel_once() -> None:
    rng = np.random.default_rng(6)
    grey = rng.random((57, 83)).astype(np.float32)
    grey[0, :2] = 0.0, 1.0
    in_contact = grey > 0.7
    found = histogram_of(grey, in_contact)
    assert found.inside.sum() == in_contact.sum()
    assert found.inside.sum() + found.outside.sum() == grey.size
    above = int(0.25 * found.inside.size)
    assert (found.inside + found.outside)[above:].sum() == np.count_nonzero(grey >= 0.25)


def test_profile_reads_the_line_it_says() -> None:
    rows, cols = np.mgrid[:60, :90]
    grey = (rows * 0.01 + cols * 0.001).astype(np.float32)
    truth = (cols > 50).astype(np.float32)
    along_x = profile_of(grey, truth, (30.4, 44.0), 0.05, "x", 0.5)
    assert along_x.line_px == 40
    assert along_x.grey == pytest.approx(0.4 + 0.001 * np.arange(90), abs=1e-6)
    assert along_x.position_mm[44] == 0.0
    assert along_x.position_mm[64] == pytest.approx(1.0)
    assert along_x.share[51] == 1
    assert along_x.share[50] == 0
    along_y = profile_of(grey, truth, (30.4, 44.0), 0.05, "y", -100.0)
    assert along_y.line_px == 0
    assert along_y.grey == pytest.approx(0.01 * np.arange(60), abs=1e-6)


def test_charts_are_drawn_to_scale() -> None:
    view, truth = blobs()
    grey = single_grey(view, 0.0)
    line = profile_of(grey, truth, (55.0, 70.0), 0.1, "x", 0.0)
    svg = ElementTree.fromstring(profile_svg(line, 0.4, 7.0))
    bands = [e for e in svg.iter("rect")]
    assert len(bands) == 1
    # 57 of the 140 pixels of 14 mm, on a chart 496 units wide
    assert float(bands[0].attrib["width"]) == pytest.approx(496 * 57 * 0.1 / 14, abs=0.11)
    own = histogram_of(grey)
    chart = ElementTree.fromstring(histogram_svg(histogram_of(grey, truth >= 0.5), 0.35, own))
    threshold = next(e for e in chart.iter("path") if e.attrib["class"] == "threshold")
    assert threshold.attrib["d"].startswith(f"M{52 + 496 * 0.35:.1f} ")
    assert "own" in {e.attrib.get("class") for e in chart.iter("path")}


def test_overlay_has_four_classes_and_keeps_the_frame_where_nothing_is() -> None:
    view, truth = blobs()
    mask = view > 100
    found = pictures.overlay(view, mask, truth >= 0.5)
    assert (found[:20] == 9).all()
    for colour, row, col in ((pictures.FALSE, 32, 42), (pictures.MISSED, 79, 102), (pictures.AGREE, 50, 70)):
        rgb = np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)])
        assert found[row, col] == pytest.approx(0.6 * rgb + 0.4 * view[row, col], abs=0.51)
    in_colour = pictures.overlay(np.dstack([view] * 3), mask, truth >= 0.5)
    assert np.abs(in_colour.astype(int) - found).max() <= 1


MACHADO = {
    "protanopia": [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]],
    "deuteranopia": [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]],
    "tritanopia": [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]],
}
"""Of linear RGB: G. M. Machado, M. M. Oliveira and L. Fernandes, IEEE TVCG 15 (2009) 1291, severity 1."""


@pytest.mark.parametrize("vision", [None, *MACHADO])
@pytest.mark.parametrize("grey", [0, 60, 140, 230])
def test_colours_of_the_mask_are_apart_for_every_vision(vision: str | None, grey: int) -> None:
    """On any frame the three differ from each other by far more than a just noticeable difference of about 2."""
    view = np.full((1, 3), grey, np.uint8)
    rgb = pictures.overlay(view, np.array([[True, True, False]]), np.array([[True, False, True]]))[0] / 255.0
    if vision is not None:
        linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
        seen = np.clip(linear @ np.array(MACHADO[vision]).T, 0.0, 1.0)
        rgb = np.where(seen <= 0.0031308, 12.92 * seen, 1.055 * seen ** (1 / 2.4) - 0.055)
    lab = rgb2lab(rgb)
    for a, b in ((0, 1), (0, 2), (1, 2)):
        assert deltaE_ciede2000(lab[a], lab[b]) > 12


def test_what_is_sent_is_the_picture() -> None:
    shown = Engine(rig(), backend="numpy").show(controls_of(rig()).changed(force_N=3.0))
    sent = present(shown)
    frame = cv2.imdecode(np.frombuffer(sent.images["frame"], np.uint8), cv2.IMREAD_GRAYSCALE)
    assert np.abs(frame.astype(int) - shown.frame).mean() < 1.5
    laid = cv2.imdecode(np.frombuffer(sent.images["overlay"], np.uint8), cv2.IMREAD_COLOR)
    assert laid.shape[:2] == pictures.size_of(shown.window)
    area = re.search(r'id="figure-area_mm2" data-value="([^"]+)">([^<]+) mm²<', sent.markup["figures"])
    assert area is not None
    assert float(area[1]) == shown.figures.area_mm2
    assert float(area[2]) == pytest.approx(shown.figures.area_mm2, abs=5.1e-4)
    for name in ("frame", "overlay", "histogram", "profile"):
        ElementTree.fromstring(sent.markup[name])


# --- a lab's own frame -----------------------------------------------------------------------------------------------


def png(image: np.ndarray) -> bytes:
    buffer = io.BytesIO()
    PillowImage.fromarray(image).save(buffer, format="PNG")
    return buffer.getvalue()


def test_own_frame_has_its_own_mask_and_area(tmp_path: Path) -> None:
    view, _ = blobs()
    chain = Chain(threshold=0.3, min_blob=100, blur=1.0, radius=10)
    buffer = io.BytesIO()
    PillowImage.fromarray(view).save(buffer, format="TIFF")
    path = tmp_path / "a frame.tif"
    path.write_bytes(buffer.getvalue())
    for frame in (read_own(png(view), "x.png"), read_own(buffer.getvalue(), "y.tif"), read_own_file(path)):
        own = measure_own(frame, chain, 0.0003)
        assert own.pixels == segment(view, chain).pixels
        assert own.area_mm2 == own.pixels * 0.0003
        assert own.histogram.outside.sum() == view.size
    assert measure_own(frame, chain, None).area_mm2 is None
    assert frame.name == "a frame.tif"


def test_own_film_starts_at_its_largest_contact(tmp_path: Path) -> None:
    """A lossless video of discs: the largest is found; every frame comes as it was written."""
    frames = []
    for radius in (0, 12, 40, 25):
        image = np.full((120, 160), 12, np.uint8)
        cv2.circle(image, (80, 60), radius, 150, -1)
        frames.append(image)
    path = tmp_path / "film.mkv"
    write_video(path, frames)
    ticks: list[tuple[int, int | None]] = []
    film = read_film(path, None, lambda done, total: ticks.append((done, total)))
    assert (film.count, film.largest) == (4, 2)
    assert [done for done, _ in ticks] == [1, 2, 3, 4]
    for number, image in enumerate(frames):
        np.testing.assert_array_equal(film.frame(number).view, image)
    assert film.frame(2).name == "film.mkv, frame 2"
    with pytest.raises(InputError, match="0 to 3"):
        film.frame(4)
    assert is_film(path)
    assert is_film(tmp_path)
    (tmp_path / "a.png").write_bytes(png(frames[1]))
    assert not is_film(tmp_path / "a.png")
    assert not is_film(tmp_path / "none.mp4")
    (tmp_path / "text.mp4").write_text("no film")
    with pytest.raises(InputError, match=r"text\.mp4: --frame: cannot be opened as a video"):
        read_film(tmp_path / "text.mp4", None, lambda done, total: None)


def huge_png() -> bytes:
    """A header that promises 60000 x 60000 pixels, and nothing behind it."""
    head = struct.pack(">IIBBBBB", 60_000, 60_000, 8, 0, 0, 0, 0)
    chunk = b"IHDR" + head
    return b"\x89PNG\r\n\x1a\n" + struct.pack(">I", 13) + chunk + struct.pack(">I", zlib.crc32(chunk)) + b"\0" * 64


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"", "0 bytes"),
        (b"\0" * (MAX_BYTES + 1), "bytes"),
        (b"no image at all", "not a readable image"),
        (b"<svg onload=alert(1)>", "not a readable image"),
        (huge_png(), "pixels"),
        (png(np.zeros((7000, 6000), np.uint8)), "7000"),
        (png(np.arange(2400, dtype=np.uint8).reshape(40, 60))[:-40], "own frame"),
    ],
)
def test_own_frame_that_cannot_be_read_is_one_line(content: bytes, says: str) -> None:
    with pytest.raises(InputError, match=says) as caught:
        read_own(content, "frame.png")
    assert "\n" not in str(caught.value)
    assert "megapixels" in str(caught.value)


def test_a_name_is_no_path() -> None:
    assert plain_name("../../etc/passwd") == "passwd"
    assert plain_name("C:\\x\\y.png") == "y.png"
    assert plain_name("a\nb\0c") == "abc"
    assert plain_name("///") == "frame"
    assert len(plain_name("x" * 999)) == 60


# --- thread, server, command -----------------------------------------------------------------------------------------


def test_worker_does_jobs_in_order_and_hands_errors_on() -> None:
    worker, done = Worker(), []
    jobs = [worker.submit(lambda i=i: done.append(i)) for i in range(20)]
    failed = worker.submit(lambda: 1 / 0)
    last = worker.submit(lambda: "still there")
    assert last.result(10) == "still there"
    assert [job.result(10) for job in jobs] == [None] * 20
    assert done == list(range(20))
    with pytest.raises(ZeroDivisionError):
        failed.result(10)


def test_server_takes_no_large_body_and_no_foreign_name() -> None:
    pytest.importorskip("nicegui", reason="the extra 'page' is not installed")
    from fastapi import FastAPI
    from starlette.requests import Request
    from starlette.responses import JSONResponse

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of the test client itself: which HTTP library it would rather have
        from starlette.testclient import TestClient

    from evanesce.live.server import FORM_BYTES, PictureStore, guard

    served = FastAPI()
    guard(served, "127.0.0.1", 1000)
    store = PictureStore()
    store.serve(served)
    address = store.put("abc.jpg", b"\xff\xd8")

    async def size(request: Request) -> JSONResponse:
        return JSONResponse(len(await request.body()))

    served.add_route("/size", size, methods=["POST"])

    limit = 1000 + FORM_BYTES
    with TestClient(served, base_url="http://127.0.0.1") as client:
        assert client.post("/size", content=b"x" * limit).json() == limit
        assert client.post("/size", content=b"x" * (limit + 1)).status_code == 413
        # Without a stated length, it is counted as it comes.
        assert client.post("/size", content=iter([b"x" * 50_000] * 3)).status_code == 413
        assert client.post("/size", content=iter([b"x" * 50_000] * 2)).json() == 100_000
        assert client.get(address).content == b"\xff\xd8"
        for elsewhere in ("/picture/abd.jpg", "/picture/..%2f..%2fpyproject.toml", "/picture/../server.py"):
            assert client.get(elsewhere).status_code == 404
        assert client.get(address, headers={"host": "evil.example"}).status_code == 400


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["nowhere.toml"], "nowhere.toml"),
        (["thesis", "--port", "70000"], "--port"),
        (["thesis", "--host", "no such host"], "--host"),
        (["thesis", "--host", "203.0.113.77", "--port", "0"], "203.0.113.77"),
        (["thesis", "--set", "leds.voltage_V=99"], "leds.voltage_V"),
        (["thesis", "--frame", "nothing.png"], "nothing.png"),
        (["thesis", "--mm2-per-px", "0"], "--mm2-per-px"),
        (["thesis", "--calibration", "nothing.json"], "nothing.json"),
    ],
)
def test_bad_input_of_the_command_is_one_line(arguments: list[str], says: str) -> None:
    pytest.importorskip("nicegui", reason="the extra 'page' is not installed")
    done = CliRunner().invoke(app, ["serve", *arguments])
    assert done.exit_code == 2
    assert says in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1


def test_a_taken_port_and_a_missing_extra_are_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("nicegui", reason="the extra 'page' is not installed")
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        done = CliRunner().invoke(app, ["serve", "thesis", "--port", str(taken.getsockname()[1])])
    assert (done.exit_code, len(done.stderr.strip().splitlines())) == (2, 1)
    assert "in use" in done.stderr
    monkeypatch.setitem(sys.modules, "nicegui", None)
    done = CliRunner().invoke(app, ["serve", "thesis"])
    assert done.exit_code == 2
    assert "evanesce[page]" in done.stderr


def test_whole_view_is_measured_not_the_window() -> None:
    """A speck far from the contact counts, as in the chain itself."""
    shown = Engine(rig(), backend="numpy").show(controls_of(rig()).changed(threshold=0.0, min_blob_px=0.0))
    assert shown.figures.pixels > pictures.size_of(shown.window)[0] * pictures.size_of(shown.window)[1]
    assert Crop().apply(shown.mask).sum() == shown.figures.pixels
