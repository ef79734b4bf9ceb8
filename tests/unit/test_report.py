"""Reports stand alone and never run what they show."""

from __future__ import annotations

import base64
import io
import re
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from PIL import Image

from evanesce.report.html import Page, Picture, Section, Table, figure_png, image_png, write


def test_page_needs_no_other_file_and_escapes_what_it_shows(tmp_path: Path) -> None:
    figure = Figure(figsize=(2, 1))
    figure.subplots().plot([0, 1], [0, 2])
    section = Section(
        "Areas <b>",
        ["one & two"],
        [Picture(figure_png(figure), "a line")],
        [Table(["force [N]"], [["<script>alert(1)</script>"]])],
    )
    path = write(tmp_path / "r.html", Page("T", "lead", [section], {"seed": 3}))
    text = path.read_text(encoding="utf-8")
    assert "<script>" not in text
    assert "&lt;script&gt;" in text
    assert re.findall(r'(?:src|href)="(?!data:)', text) == []
    encoded = re.search(r"base64,([A-Za-z0-9+/=]+)", text)
    assert encoded is not None
    assert Image.open(io.BytesIO(base64.b64decode(encoded.group(1)))).width > 50
    assert [p.name for p in tmp_path.iterdir()] == ["r.html"]


def test_image_is_kept_or_reduced_by_area() -> None:
    image = np.zeros((40, 60), np.uint8)
    image[:, 30:] = 200
    back = np.asarray(Image.open(io.BytesIO(image_png(image))))
    np.testing.assert_array_equal(back, image)
    small = np.asarray(Image.open(io.BytesIO(image_png(image, max_width=20))))
    assert small.shape == (13, 20)
    assert abs(float(small.mean()) - float(image.mean())) < 6
