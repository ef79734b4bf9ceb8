"""Picture of docs/criticism/index.md: the report of a rig with five hidden causes.

Run: python docs/pictures/critic_report.py (some minutes). Needs Playwright and a Chromium. The rig is ``one`` of
``tests/inference/development_rigs.py``.
"""

from __future__ import annotations

import io
import shutil
import sys
import tempfile
from pathlib import Path

from PIL import Image
from playwright.sync_api import sync_playwright

from evanesce.bundle.read import read_bundle
from evanesce.core.provenance import record
from evanesce.inference.critic import criticise_frames
from evanesce.inference.page import page
from evanesce.report.html import write
from evanesce.rig import dump_scene

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parents[1] / "tests" / "inference"))

from development_rigs import write_rig  # noqa: E402

RIG = "one"
CHROMIUM = ("chromium", "chromium-browser", "google-chrome")
FLAGS = ["--headless", "--no-sandbox", "--disable-gpu", "--no-first-run", "--disable-background-networking"]
WIDTH_PX = 1000
NOT_SHOWN = "What is not explained"
"""The section at which the picture ends."""


def main() -> None:
    """Write a bundle, criticise it and take its report."""
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / "report.html"
        write_rig(RIG, Path(folder) / RIG)
        bundle = read_bundle(Path(folder) / RIG)
        found = criticise_frames(bundle, tell=lambda line: print(line, flush=True))
        scenes = (dump_scene(bundle.scene), found.scene)
        write(target, page(found.result, found.pictures, bundle.path.name, scenes, record(seed=0)))
        print(found.result["first_line"])
        picture = screenshot(target.as_uri())
    whole = Image.open(io.BytesIO(picture)).convert("RGB")
    shown = whole.quantize(256, method=Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE)
    shown.save(HERE / "critic-report.png", optimize=True)


def screenshot(address: str) -> bytes:
    """Return the top of a report as PNG, down to what is not shown."""
    chromium = next(found for name in CHROMIUM if (found := shutil.which(name)))
    with sync_playwright() as started:
        browser = started.chromium.launch(executable_path=chromium, args=FLAGS)
        opened = browser.new_page(viewport={"width": WIDTH_PX, "height": 800})
        opened.goto(address)
        end = opened.get_by_role("heading", name=NOT_SHOWN).bounding_box()
        assert end is not None
        clip = {"x": 0, "y": 0, "width": WIDTH_PX, "height": end["y"] - 20}
        taken: bytes = opened.screenshot(full_page=True, clip=clip)
        browser.close()
    return taken


if __name__ == "__main__":
    main()
