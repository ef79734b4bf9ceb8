"""Take screenshots of the live page: ``python docs/pictures/live.py``.

Needs the extra ``page``, Playwright and a Chromium. What stands there as a lab's own frame is a rendered one.
"""

from __future__ import annotations

import io
import re
import shutil
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

from PIL import Image
from playwright.sync_api import sync_playwright

from evanesce.chain.fast import FastCamera
from evanesce.report.html import image_png
from evanesce.rig import load_scene

HERE = Path(__file__).resolve().parent
CHROMIUM = ("chromium", "chromium-browser", "google-chrome")
FLAGS = ["--headless", "--no-sandbox", "--disable-gpu", "--no-first-run", "--disable-background-networking"]
DARK = range(5)
"""Numbers of the LEDs that are switched off: all of the left edge."""


def settle(page: Any) -> None:
    """Wait until the page has shown nothing new for a while."""
    last, since = "", time.monotonic()
    while time.monotonic() - since < 2.0:
        now = page.get_attribute("#speed", "data-serial")
        if now != last:
            last, since = now, time.monotonic()
        time.sleep(0.1)
    page.wait_for_function("[...document.images].every(i => i.complete)")


def own_frame() -> bytes:
    """Return the frame of another finger as PNG."""
    scene = load_scene("thesis", {"finger.position_mm": [0.0, 0.0], "finger.material": "silskin_10"})
    return image_png(FastCamera(scene).press(2.4, seed=11).data)


def screenshot(address: str, chromium: str, own: bytes) -> bytes:
    """Set a voltage, a threshold and a focus; switch one edge off; take the page."""
    with sync_playwright() as started:
        browser = started.chromium.launch(executable_path=chromium, args=FLAGS)
        page = browser.new_page(viewport={"width": 1280, "height": 840})
        page.goto(address)
        page.wait_for_selector("#figure-area_mm2", timeout=120_000)
        for name, value in (("voltage_V", "8.70"), ("threshold", "0.3800"), ("defocus_um", "150"), ("force_N", "1.40")):
            page.locator(f'[data-knob="{name}"] input[type="number"]').fill(value)
        for number in DARK:
            page.locator('[role="switch"]').nth(number).click()
        page.set_input_files(
            'input[type="file"]', files=[{"name": "lab_frame.png", "mimeType": "image/png", "buffer": own}]
        )
        page.locator('.bring input[type="number"]').fill("0.0002935")
        page.locator('[data-knob="line_mm"] input[type="number"]').fill("0.9")
        settle(page)
        page.evaluate("document.activeElement.blur()")
        shot: bytes = page.screenshot(full_page=True)
        browser.close()
    return shot


def main() -> None:
    """Serve the ridged rig, take screenshots, keep the picture small."""
    chromium = next((found for name in CHROMIUM if (found := shutil.which(name))), None)
    if chromium is None:
        raise SystemExit("no Chromium is installed")
    server = subprocess.Popen(
        [sys.executable, "-m", "evanesce.cli", "serve", "thesis_ridged", "--port", "0"],
        stdout=subprocess.PIPE, text=True,
    )  # fmt: skip
    try:
        assert server.stdout is not None
        found = re.match(r"(http://\S+)", server.stdout.readline())
        assert found is not None
        shot = screenshot(found[1], chromium, own_frame())
    finally:
        server.terminate()
        server.wait()
    with Image.open(io.BytesIO(shot)) as picture:
        picture.convert("RGB").save(HERE / "live.png", optimize=True)


if __name__ == "__main__":
    main()
