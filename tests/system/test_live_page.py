"""The live page in a real browser: sliders by mouse and keyboard, figures, pictures, files in and out."""

from __future__ import annotations

import contextlib
import functools
import io
import math
import os
import queue
import re
import shutil
import subprocess
import sys
import threading
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from PIL import Image as PillowImage
from typer.testing import CliRunner

from evanesce.cli.app import app
from evanesce.evaluation.perfect_view import PerfectView
from evanesce.live import pictures
from evanesce.live.controls import controls_of, led_names, scene_of
from evanesce.live.engine import window_around
from evanesce.measurement.reference.segment import Chain, segment
from evanesce.rig import load_scene
from evanesce.rig.coarser import coarser_camera
from support.live_rig import RIG, Expected, expected, rig

CHROMIUM = next((found for name in ("chromium", "chromium-browser", "google-chrome", "chrome")
                 if (found := shutil.which(name))), None)  # fmt: skip
FLAGS = ["--headless", "--no-sandbox", "--disable-gpu", "--no-first-run", "--disable-background-networking",
         "--disable-component-update", "--disable-sync"]  # fmt: skip
PATIENCE_MS = 180_000


@functools.cache
def start() -> Expected:
    return expected(2.0)


pytestmark = [
    pytest.mark.system,
    pytest.mark.xdist_group("live_page"),
    pytest.mark.skipif(CHROMIUM is None, reason="no Chromium is installed"),
]


@contextlib.contextmanager
def served(*options: str) -> Iterator[str]:
    """Serve the rig as the command does, on a free port."""
    pytest.importorskip("nicegui", reason="the extra 'page' is not installed")
    settings = [part for key, value in RIG.items() for part in ("--set", f"{key}={value!r}")]
    command = [sys.executable, "-m", "evanesce.cli", "serve", "thesis_ridged", "--port", "0", "--mm2-per-px", "0.0031"]
    server = subprocess.Popen(
        [*command, *settings, *options],
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env=os.environ | {"PYTHONUNBUFFERED": "1"},
    )  # fmt: skip
    lines: queue.Queue[str] = queue.Queue()
    assert server.stdout is not None
    reader = threading.Thread(target=lambda out=server.stdout: [lines.put(line) for line in out], daemon=True)
    reader.start()
    try:
        first = lines.get(timeout=180)
        found = re.match(r"(http://127\.0\.0\.1:\d+/)", first)
        assert found is not None, first
        yield found[1]
    finally:
        server.terminate()
        server.wait(20)
        reader.join(5)
        server.stdout.close()
    said = "".join(lines.queue)
    assert "Traceback" not in said, said


@pytest.fixture(scope="module")
def address() -> Iterator[str]:
    with served() as found:
        yield found


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    playwright = pytest.importorskip("playwright.sync_api", reason="Playwright is not installed")
    with playwright.sync_playwright() as started:
        found = started.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        yield found
        found.close()


@pytest.fixture(scope="module")
def opened(browser: Any, address: str) -> Iterator[Any]:
    """Open the page at 1280 pixels, with its first picture there."""
    found = browser.new_page(viewport={"width": 1280, "height": 900})
    troubles: list[str] = []
    found.on("pageerror", lambda error: troubles.append(str(error)))
    found.on("request", lambda r: None if r.url.startswith((address, "data:", "blob:")) else troubles.append(r.url))
    found.goto(address, timeout=PATIENCE_MS)
    found.wait_for_selector("#figure-area_mm2", timeout=PATIENCE_MS)
    yield found
    found.close()
    # Neither an error in a script, nor a request to anybody but the server.
    assert not troubles


@pytest.fixture
def page(opened: Any) -> Any:
    """Start each test from the scene as it was opened."""
    opened.set_viewport_size({"width": 1280, "height": 900})
    opened.get_by_role("button", name="Reset").click()
    wait_for(opened, "area_mm2", start().area_mm2)
    # Where nothing had changed, that says nothing: the answer to Reset may still be on its way, and would move a
    # slider back under the keys of the test.
    opened.locator('[data-knob="threshold"] input[type="number"]').fill("0.29")
    wait_for(opened, "area_mm2", expected(2.0, threshold=0.29).area_mm2)
    opened.get_by_role("button", name="Reset").click()
    wait_for(opened, "area_mm2", start().area_mm2)
    opened.locator("#error").wait_for(state="hidden", timeout=PATIENCE_MS)
    return opened


def figure(page: Any, name: str) -> float:
    return float(page.get_attribute(f"#figure-{name}", "data-value"))


def wait_for(page: Any, name: str, value: float) -> None:
    """Wait until a figure is a value, to the last digit that a float's text carries."""
    until = time.monotonic() + 60
    while (found := figure(page, name)) != pytest.approx(value, rel=1e-12):
        assert time.monotonic() < until, f"{name} is {found}, not {value}: {page.inner_text('#status')}"
        time.sleep(0.03)


def slider(page: Any, name: str) -> Any:
    return page.locator(f'[data-knob="{name}"] input[type="range"]')


def value_of(page: Any, name: str) -> float:
    return float(slider(page, name).input_value())


def test_first_figures_are_the_librarys(page: Any) -> None:
    library = start()
    wait_for(page, "area_mm2", library.area_mm2)
    assert figure(page, "true_mm2") == library.true_mm2
    assert figure(page, "error_percent") == pytest.approx(100 * (library.area_mm2 / library.true_mm2 - 1), rel=1e-9)
    assert page.inner_text("#figure-area_mm2") == f"{library.area_mm2:.3f} mm²"
    assert page.inner_text("#status").startswith("ready")
    assert page.title() == "evanesce, live"


def test_arrow_keys_move_the_threshold(page: Any) -> None:
    handle = slider(page, "threshold")
    handle.focus()
    for _ in range(36):
        page.keyboard.press("ArrowRight")
    page.keyboard.press("ArrowLeft")
    wait_for(page, "area_mm2", expected(2.0, threshold=0.2375).area_mm2)
    assert value_of(page, "threshold") == pytest.approx(0.15 + 35 * 0.0025)
    assert "threshold 0.2375" in page.inner_text("#slot-histogram")
    # the number beside it follows, and can be typed
    number = page.locator('[data-knob="threshold"] input[type="number"]')
    assert number.input_value() == "0.2375"
    number.fill("0.31")
    wait_for(page, "area_mm2", expected(2.0, threshold=0.31).area_mm2)
    assert value_of(page, "threshold") == pytest.approx(0.31)


@pytest.mark.parametrize(
    ("name", "share", "key"), [("voltage_V", 0.62, "leds.voltage_V"), ("defocus_um", 0.83, "camera.lens.defocus_um")]
)
def test_mouse_moves_sliders_of_the_rig(page: Any, name: str, share: float, key: str) -> None:
    before = figure(page, "area_mm2")
    box = slider(page, name).bounding_box()
    page.mouse.move(box["x"] + 0.5 * box["width"], box["y"] + box["height"] / 2)
    page.mouse.down()
    page.mouse.move(box["x"] + share * box["width"], box["y"] + box["height"] / 2, steps=6)
    page.mouse.up()
    value = value_of(page, name)
    library = expected(2.0, **{key: round(value, 6)})
    wait_for(page, "area_mm2", library.area_mm2)
    assert figure(page, "brightest_DN") == library.view.max()
    assert library.area_mm2 != before


def test_force_and_minimum_blob_size(page: Any) -> None:
    slider(page, "force_N").focus()
    for _ in range(4):
        page.keyboard.press("ArrowLeft")
    library = expected(1.8)
    wait_for(page, "true_mm2", library.true_mm2)
    wait_for(page, "area_mm2", library.area_mm2)
    page.locator('[data-knob="min_blob_px"] input[type="number"]').fill("20000")
    empty = expected(1.8, min_blob_px=20000)
    wait_for(page, "area_mm2", empty.area_mm2)
    assert figure(page, "blobs") == (1 if empty.area_mm2 else 0)


def test_ridge_height_changes_contact_and_area(page: Any) -> None:
    slider(page, "ridge_height_um").focus()
    for _ in range(9):
        page.keyboard.press("ArrowLeft")
    height = value_of(page, "ridge_height_um")
    assert height == round(rig().finger.ridges.height_um) - 9  # the slider's own steps are whole micrometres
    library = expected(2.0, **{"finger.ridges.height_um": height})
    wait_for(page, "true_mm2", library.true_mm2)
    wait_for(page, "area_mm2", library.area_mm2)
    assert value_of(page, "ridge_height_um") == height
    # Lower ridges: more of the skin between them is in contact.
    assert library.true_mm2 > start().true_mm2
    assert page.locator('[data-knob="ridge_height_um"] input[type="number"]').input_value() == f"{height:.1f}"


def drawn_profile(page: Any) -> tuple[np.ndarray, np.ndarray]:
    """Return distance from the tip [mm] and grey level of the drawn profile, read off by its own axes."""
    lines, labels, path = page.evaluate(
        """(() => {
          const slot = document.querySelector('#slot-profile');
          const all = selector => [...slot.querySelectorAll(selector)];
          return [all('path.grid').map(e => e.getAttribute('d')),
                  all('text[text-anchor="middle"]:not(.title)').map(e => [e.textContent, e.getAttribute('x')]),
                  slot.querySelector('path.grey').getAttribute('d')];
        })()"""
    )

    def numbers(text: str) -> list[float]:
        return [float(n) for n in re.findall(r"-?[\d.]+", text)]

    zero, one = numbers(lines[0])[1], numbers(lines[-1])[1]
    ticks = {text: float(x) for text, x in labels}
    x, y = np.array(numbers(path)).reshape(-1, 2).T
    return (x - ticks["0"]) / (ticks["1"] - ticks["0"]), (y - zero) / (one - zero)


@pytest.mark.parametrize("along", ["x", "y"])
def test_the_profile_line_is_moved_and_read_where_it_lies(page: Any, along: str) -> None:
    """The library's view, blurred by half a pixel, along the row or column that lies 1.05 mm from the tip."""
    library, scene = start(), coarser_camera(rig(), 2)
    view = PerfectView.of(scene)
    row, col = view.to_view(*scene.finger.position_mm)
    mm = view.mm2_per_px**0.5
    grey = cv2.GaussianBlur(library.view.astype(float), (0, 0), 0.5) / 255
    page.locator("[role=radio]").nth(0 if along == "x" else 1).click()
    slider(page, "line_mm").focus()
    for _ in range(21):
        page.keyboard.press("ArrowRight")
    wanted = grey[round(row + 1.05 / mm)] if along == "x" else grey[:, round(col + 1.05 / mm)]
    position = (np.arange(wanted.size) - (col if along == "x" else row)) * mm
    until = time.monotonic() + 60
    while True:
        at, level = drawn_profile(page)
        off = np.abs(level - np.interp(at, position, wanted))
        if off.max() < 0.02 or time.monotonic() > until:
            break
        time.sleep(0.1)
    assert value_of(page, "line_mm") == pytest.approx(1.05)
    # Coordinates of the drawing have one decimal, a pixel at half a thousandth; its rims are as steep as 0.2 a pixel.
    assert off.max() < 0.02
    assert np.ptp(level) > 0.3
    neighbour = grey[round(row)] if along == "x" else grey[:, round(col)]
    assert np.abs(level - np.interp(at, position, neighbour)).max() > 0.1
    assert f"{along} from the finger's tip" in page.text_content("#slot-profile")
    # The dashed line in the picture lies 21 steps from the tip as well; a threshold's change leaves it there.
    marks = page.locator("#picture-overlay .annotations line")
    assert marks.count() == 1
    ends = [float(marks.get_attribute(k)) for k in ("x1", "y1", "x2", "y2")]
    window = window_around(view, library.true_mm2)
    middle = (row - window.r0 if along == "x" else col - window.c0) + 0.5 + 1.05 / mm
    across = (ends[1], ends[3]) if along == "x" else (ends[0], ends[2])
    assert across == (pytest.approx(middle, abs=1.0), pytest.approx(middle, abs=1.0))


def test_leds_are_switched_by_keyboard_and_mouse(page: Any) -> None:
    names = led_names(rig())
    first = page.locator('[role="switch"]').first
    first.focus()
    page.keyboard.press("Space")
    page.keyboard.press("ArrowRight")
    page.keyboard.press("ArrowRight")
    page.keyboard.press("Enter")
    page.locator('[role="switch"]').nth(7).click()
    off = {0, 2, 7}
    # The page draws a click when it next draws: a busy machine is still at it when the click has been sent.
    page.wait_for_function(
        "off => [...document.querySelectorAll('[role=\"switch\"]')]"
        ".every((b, i) => b.getAttribute('aria-checked') === String(!off.includes(i)))",
        arg=sorted(off),
    )
    checked = [b.get_attribute("aria-checked") for b in page.locator('[role="switch"]').all()]
    slider(page, "led_power").focus()
    page.keyboard.press("ArrowRight")
    page.keyboard.press("ArrowRight")
    powers = [0.1 if i == 7 else 0.0 if i in off else 1.0 for i in range(len(names))]
    changes = {}
    for edge in dict.fromkeys(edge for edge, _ in names):
        changes[f"leds.edge.{edge}.relative_power"] = [p for p, (e, _) in zip(powers, names, strict=True) if e == edge]
    wait_for(page, "area_mm2", expected(2.0, **changes).area_mm2)
    assert [i for i, state in enumerate(checked) if state == "false"] == sorted(off)
    assert first.get_attribute("aria-label") == f"LED {names[0][0]} 1, 0 %"


def test_material_by_keyboard_and_reset(page: Any) -> None:
    page.get_by_role("combobox", name="Material").focus()
    page.keyboard.press("Enter")
    page.get_by_role("option", name="silskin_10").click()
    wait_for(page, "true_mm2", expected(2.0, **{"finger.material": "silskin_10"}).true_mm2)
    page.get_by_role("button", name="Reset").click()
    wait_for(page, "area_mm2", start().area_mm2)


def test_an_impossible_setting_is_one_line_and_the_page_goes_on(page: Any) -> None:
    number = page.locator('[data-knob="force_N"] input[type="number"]')
    number.fill("900")
    error = page.locator("#error")
    error.wait_for(state="visible", timeout=PATIENCE_MS)
    assert error.get_attribute("role") == "alert"
    assert "\n" not in error.inner_text().strip()
    assert re.search(r"press\.forces_N|grid\.size_mm", error.inner_text())
    assert page.locator("#picture-frame img").is_visible()
    number.fill("1.35")
    wait_for(page, "area_mm2", expected(1.35).area_mm2)
    error.wait_for(state="hidden", timeout=PATIENCE_MS)


def shot(page: Any, selector: str) -> tuple[np.ndarray, tuple[int, int, int, int]]:
    """Take what the screen shows of a picture, without the marks over it; and where in that the picture lies.

    A picture need not begin at a whole pixel of the screen: it is taken with all pixels that it covers, and the
    outermost show the page, too. The box is (left, top, width, height) [px].
    """
    element = page.locator(selector)
    data = element.screenshot(style=".annotations { visibility: hidden }")
    box = element.bounding_box()
    x0, y0 = round(box["x"]), round(box["y"])  # the browser draws pictures onto whole pixels
    x1, y1 = round(box["x"] + box["width"]), round(box["y"] + box["height"])
    where = x0 - math.floor(box["x"]), y0 - math.floor(box["y"]), x1 - x0, y1 - y0
    return np.asarray(PillowImage.open(io.BytesIO(data)).convert("RGB")), where


def on_screen(image: np.ndarray, shape: tuple[int, ...], box: tuple[int, int, int, int]) -> np.ndarray:
    """Draw an image where :func:`shot` found it; smoothed first where the screen has fewer pixels than it."""
    left, top, width, height = box
    rows, cols = image.shape[:2]
    fewer = cols / width
    smooth = cv2.GaussianBlur(image, (0, 0), 0.5 * fewer) if fewer > 1.2 else image
    x = ((np.arange(shape[1]) + 0.5 - left) * (cols / width) - 0.5).astype(np.float32)
    y = ((np.arange(shape[0]) + 0.5 - top) * (rows / height) - 0.5).astype(np.float32)
    found = cv2.remap(smooth, *np.meshgrid(x, y), cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return found.astype(float)


INSIDE = np.s_[2:-2, 2:-2]
"""Of a picture on the screen: without the pixels that show the page, too."""


def test_the_pictures_on_the_screen_are_the_rendered_ones(page: Any) -> None:
    """Against the library's frame, shrunk as the screen does; a frame shifted by a few pixels is recognised."""
    library = start()
    wait_for(page, "area_mm2", library.area_mm2)
    page.wait_for_function("[...document.images].every(i => i.complete)")
    seen, box = shot(page, "#picture-frame img")
    wanted = on_screen(library.frame, seen.shape, box)
    seen, wanted = seen.astype(float).mean(axis=2)[INSIDE], wanted[INSIDE]
    assert wanted.max() > 100
    lit = wanted > 40
    error, shifted = np.abs(seen - wanted), np.abs(seen - np.roll(wanted, (4, -4), (0, 1)))
    assert error.mean() < 1.5
    assert error[lit].mean() < 6
    assert shifted[lit].mean() > 3 * error[lit].mean()

    perfect = PerfectView.of(coarser_camera(rig(), 2))
    window = window_around(perfect, library.true_mm2)
    laid = pictures.overlay(*(window.apply(a) for a in (library.view, library.mask, library.truth >= 0.5)))
    seen, box = shot(page, "#picture-overlay img")
    wanted = on_screen(laid, seen.shape, box)[INSIDE]
    both = window.apply(library.mask & (library.truth >= 0.5)).astype(np.uint8)
    core = cv2.erode((on_screen(both, seen.shape, box)[INSIDE] >= 0.5).astype(np.uint8), np.ones((9, 9))) > 0
    seen = seen.astype(float)[INSIDE]
    assert np.abs(seen - wanted)[core].mean() < 4
    assert np.abs(seen - wanted).mean() < 3
    # the agreeing part is blue
    assert (seen[core][:, 2] > seen[core][:, 0] + 40).mean() > 0.99


@pytest.mark.parametrize("width", [1280, 1440])
def test_nothing_is_wider_than_the_window(page: Any, width: int) -> None:
    page.set_viewport_size({"width": width, "height": 800})
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    cut = page.evaluate(
        "[...document.querySelectorAll('.result, .knob, .choice, .knob-label, td, th, button, .figures')]"
        ".filter(e => e.offsetParent && e.scrollWidth > e.clientWidth + 1 && getComputedStyle(e).display != 'inline')"
        ".map(e => e.className + ': ' + e.innerText.slice(0, 40))"
    )
    assert cut == []
    small = page.evaluate(
        "[...document.querySelectorAll('.knob-label, td, th, .hint')]"
        ".filter(e => parseFloat(getComputedStyle(e).fontSize) < 12).length"
    )
    assert small == 0


def test_tab_goes_through_everything_in_order_and_everything_has_a_name(page: Any) -> None:
    names: list[str] = []
    page.reload()
    page.wait_for_selector("#figure-area_mm2", timeout=PATIENCE_MS)
    for _ in range(40):
        page.keyboard.press("Tab")
        name = page.evaluate(
            "(() => { const e = document.activeElement; return e === document.body ? '' :"
            " e.getAttribute('aria-label') || e.innerText.trim()"
            " || e.closest('[aria-label]')?.getAttribute('aria-label') })()"
        )
        if not name or (names and name == names[0]):
            break
        names.append(name)
    wanted = [
        "Reset", "Save as scene", "Threshold", "Threshold, as a number", "Minimum blob size [px]", "Profile line [mm]",
        "x", "LED voltage [V]", "Force [N]", "Ridge height [µm]", "Defocus [µm]",
        "Material", "Resolution", "LED left 1, 100 %", "All on", "All off", "Open a frame …",
    ]  # fmt: skip
    order = [next((i for i, name in enumerate(names) if name == w), None) for w in wanted]
    assert None not in order, (names, [w for w, at in zip(wanted, order, strict=True) if at is None])
    assert order == sorted(order), names
    # one stop for all LEDs
    assert sum(name.startswith("LED left") or name.startswith("LED top") for name in names) == 1


def test_saved_scene_is_the_setting_and_renders(page: Any, tmp_path: Path) -> None:
    slider(page, "voltage_V").focus()
    page.keyboard.press("ArrowLeft")
    slider(page, "ridge_height_um").focus()
    page.keyboard.press("ArrowRight")
    voltage, ridge = value_of(page, "voltage_V"), value_of(page, "ridge_height_um")
    with page.expect_download() as waited:
        page.get_by_role("button", name="Save as scene").click()
    path = tmp_path / "scene.toml"
    waited.value.save_as(path)
    assert waited.value.suggested_filename == "scene.toml"
    saved = load_scene(path)
    controls = controls_of(rig()).changed(voltage_V=round(voltage, 6), ridge_height_um=ridge)
    assert saved.leds.voltage_V == pytest.approx(8.95)
    assert saved == scene_of(rig(), controls)
    done = CliRunner().invoke(app, ["render", str(path), "--fast", "--no-exr", "--out", str(tmp_path / "out")])
    assert done.exit_code == 0, done.output
    frame = cv2.imread(str(tmp_path / "out" / "frame_000000.png"), cv2.IMREAD_UNCHANGED)
    assert frame.shape == (500, 668)
    assert frame.max() > 60


def test_own_frame_stands_beside_with_its_own_area(page: Any, tmp_path: Path) -> None:
    image = np.full((300, 410), 12, np.uint8)
    cv2.circle(image, (170, 140), 61, 120, -1)
    path = tmp_path / "..our frame.png"
    cv2.imwrite(str(path), image)
    page.set_input_files('input[type="file"]', str(path))
    page.wait_for_selector("#figure-own_area_mm2", timeout=PATIENCE_MS)
    pixels = segment(image, Chain(threshold=0.15)).pixels
    assert pixels > 10_000
    assert figure(page, "own_pixels") == pixels
    assert figure(page, "own_area_mm2") == pytest.approx(pixels * 0.0031, rel=1e-12)
    assert page.locator("#picture-own-mask img").is_visible()
    # the same threshold serves both
    page.locator('[data-knob="threshold"] input[type="number"]').fill("0.6")
    wait_for(page, "own_pixels", 0.0)
    # a slider of the rig leaves it as it is
    slider(page, "voltage_V").focus()
    page.keyboard.press("End")
    wait_for(page, "area_mm2", expected(2.0, threshold=0.6, **{"leds.voltage_V": 12.0}).area_mm2)
    assert figure(page, "own_pixels") == 0
    path.write_bytes(b"<html>")
    page.set_input_files('input[type="file"]', str(path))
    page.locator("#error").wait_for(state="visible", timeout=PATIENCE_MS)
    assert "own frame" in page.inner_text("#error")
    page.get_by_role("button", name="Close the own frame").click()
    page.locator("#picture-own img").wait_for(state="hidden", timeout=PATIENCE_MS)


@pytest.mark.slow  # a browser and a film: 9 s
def test_a_film_from_the_command_line_and_no_broken_picture(browser: Any, tmp_path: Path) -> None:
    """Own film from the start, at its largest contact; a picture is drawn, or the place says it is in preparation."""
    radii = (0, 20, 45, 61, 30)
    for k, radius in enumerate(radii):
        image = np.full((300, 410), 12, np.uint8)
        cv2.circle(image, (170, 140), radius, 120, -1)
        cv2.imwrite(str(tmp_path / f"{k}.jpg"), image)
    pixels = [segment(cv2.imread(str(tmp_path / f"{k}.jpg"), -1), Chain(threshold=0.15)).pixels for k in range(5)]
    broken = """() => [...document.querySelectorAll('.picture')].filter(p => {
        const i = p.querySelector('img'), said = getComputedStyle(p, '::after').content;
        return i.hasAttribute('src') ? i.complete && i.naturalWidth === 0 : !said.includes('in preparation');
    }).length"""
    with served("--frame", str(tmp_path)) as address:
        page = browser.new_page(viewport={"width": 1280, "height": 900})
        page.goto(address, timeout=PATIENCE_MS)
        page.wait_for_selector("#picture-frame", state="attached", timeout=PATIENCE_MS)
        looks = 0
        until = time.monotonic() + 60
        while page.locator("#figure-area_mm2").count() == 0:
            assert page.evaluate(broken) == 0
            assert time.monotonic() < until
            looks += 1
        assert looks > 0
        page.wait_for_selector("#figure-own_pixels", timeout=PATIENCE_MS)
        assert figure(page, "own_pixels") == pixels[3]
        assert "frame 3" in page.inner_text("#slot-own")
        page.get_by_label("frame of the film").fill("1")
        wait_for(page, "own_pixels", pixels[1])
        assert page.evaluate(broken) == 0
        # a picture that the server no longer keeps leaves the place in preparation, not a broken image
        page.evaluate("document.querySelector('#picture-frame img').src = '/pictures/gone.jpg'")
        page.wait_for_selector("#picture-frame img:not([src])", state="attached", timeout=PATIENCE_MS)
        page.close()


def test_half_and_full_resolution(page: Any) -> None:
    page.get_by_role("combobox", name="Resolution").click()
    page.get_by_role("option", name="668 × 500 px").click()
    wait_for(page, "area_mm2", expected(2.0, coarser=1).area_mm2)


def test_server_answers_nothing_else(address: str) -> None:
    def status(path: str, **options: Any) -> int:
        try:
            with urllib.request.urlopen(urllib.request.Request(address + path, **options), timeout=30) as answer:
                return int(answer.status)
        except urllib.error.HTTPError as error:
            with error:
                return error.code

    assert status("") == 200
    assert status("picture/..%2f..%2f..%2fetc%2fpasswd") == 404
    assert status("docs") == 404
    assert status("", headers={"Host": "evil.example"}) == 400
    assert status("_nicegui/client/x/upload/1", data=b"x", headers={"Content-Length": "99000000000"}) == 413
