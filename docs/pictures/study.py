"""Take the pictures of the page on the measurement's study from a report's folder.

``evanesce study all scenes/thesis.toml --out OUT`` first, then ``python docs/pictures/study.py OUT``; the threshold
slider is captured by Chromium, where that is installed.
"""

from __future__ import annotations

import io
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image

HERE = Path(__file__).resolve().parent
PICTURES = {
    "threshold-1": "study-threshold",
    "estimator-1": "measurement-estimator",
    "budget-1": "measurement-budget",
    "pressure-1": "measurement-pressure",
    "pressure-2": "measurement-pressure-lost",
    "time-1": "study-time",
    "time-2": "study-time-area",
    "thesis-1": "study-area",
    "thesis-3": "study-slide",
}
CHROMIUM = ("chromium", "chromium-browser", "google-chrome")
SLIDER = "frame=2&threshold=0.3"
LOW, HIGH = 110, 1010
"""Rows of the window that show the slider."""


def slider(report: Path) -> bytes | None:
    """Return the slider as a browser shows it; None where there is no browser."""
    browser = next((found for name in CHROMIUM if (found := shutil.which(name))), None)
    if browser is None:
        return None
    with tempfile.TemporaryDirectory() as folder:
        shot = Path(folder) / "slider.png"
        subprocess.run(
            [browser, "--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", "--window-size=1240,1150",
             "--virtual-time-budget=30000", f"--screenshot={shot}", f"{report.resolve().as_uri()}#{SLIDER}"],
            check=True, capture_output=True, timeout=300,
        )  # fmt: skip
        buffer = io.BytesIO()
        with Image.open(shot) as picture:
            picture.convert("RGB").crop((0, LOW, 1240, HIGH)).save(buffer, format="PNG", optimize=True)
    return buffer.getvalue()


def main() -> None:
    """Copy the figures and capture the slider."""
    source = Path(sys.argv[1])
    for name, target in PICTURES.items():
        if (source / f"{name}.png").is_file():
            shutil.copyfile(source / f"{name}.png", HERE / f"{target}.png")
    shot = slider(source / "report.html")
    if shot is None:
        print("no Chromium: study-slider.png stays as it is")
    else:
        (HERE / "study-slider.png").write_bytes(shot)


if __name__ == "__main__":
    main()
