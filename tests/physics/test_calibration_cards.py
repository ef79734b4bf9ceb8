"""The printable cards are true to scale, and are what the generator draws."""

from __future__ import annotations

import re
import runpy
import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest

from conftest import ROOT
from evanesce.render.cards import CHECKERBOARD, SQUARE

FOLDER = ROOT / "calibration"
NAMES = ("checkerboard_1mm_42x31", "square_15mm")
SVG = "{http://www.w3.org/2000/svg}"


def marks(name):
    """Return page size [mm] and black rectangles of an SVG in mm, through its own viewBox."""
    root = ElementTree.parse(FOLDER / f"{name}.svg").getroot()
    size = [float(re.fullmatch(r"([\d.]+)mm", root.get(k)).group(1)) for k in ("width", "height")]
    box = [float(v) for v in root.get("viewBox").split()]
    scale = size[0] / box[2]
    assert scale == pytest.approx(size[1] / box[3])
    group = root.findall(f"{SVG}g")[0]
    return size, scale * np.array([[float(r.get(k)) for k in ("x", "y", "width", "height")] for r in group])


def pdf_rectangles(name):
    """Return the rectangles of a PDF's content in mm on paper."""
    text = (FOLDER / f"{name}.pdf").read_bytes().decode("latin-1")
    k = float(re.search(r"^([\d.]+) 0 0 -", text, re.MULTILINE).group(1)) * 25.4 / 72
    found = re.findall(r"^([\d.]+) ([\d.]+) ([\d.]+) ([\d.]+) re$", text, re.MULTILINE)
    return k * np.array(found, float)


def test_checkerboard_squares_are_one_millimetre():
    size, found = marks(NAMES[0])
    assert size == [210.0, 297.0]
    squares = found[(found[:, 2] == 1.0) & (found[:, 3] == 1.0)]
    assert len(squares) == 42 * 31 // 2
    corner = squares[:, :2].min(axis=0)
    index = np.round(squares[:, :2] - corner).astype(int)
    np.testing.assert_allclose(squares[:, :2] - corner, index, atol=1e-9)
    assert ((index.sum(axis=1) % 2) == 1).all()
    assert index.max(axis=0).tolist() == [41, 30]
    assert CHECKERBOARD.squares == (42, 31)
    assert CHECKERBOARD.side == 1.0


def test_square_is_fifteen_millimetres():
    _, found = marks(NAMES[1])
    frame = found[:4]
    inner_x = frame[3, 0] - (frame[2, 0] + frame[2, 2])
    inner_y = frame[1, 1] - (frame[0, 1] + frame[0, 3])
    assert (inner_x, inner_y) == pytest.approx((15.0, 15.0))
    assert SQUARE.side == 15.0


@pytest.mark.parametrize("name", NAMES)
def test_bar_is_fifty_millimetres(name):
    _, found = marks(name)
    bar = found[np.isclose(found[:, 3], 0.4)]
    assert bar[:, 2].tolist() == [50.0]
    text = (FOLDER / f"{name}.svg").read_text()
    assert "50 mm" in text
    assert "100 %" in text


@pytest.mark.parametrize("name", NAMES)
def test_pdf_and_svg_hold_the_same_lengths(name):
    _, found = marks(name)
    np.testing.assert_allclose(pdf_rectangles(name), found, atol=1e-6)
    data = (FOLDER / f"{name}.pdf").read_bytes()
    start = int(re.search(rb"startxref\n(\d+)", data).group(1))
    assert data[start : start + 4] == b"xref"
    assert b"/MediaBox [0 0 595.2756 841.8898]" in data  # A4 in points


def test_committed_files_are_what_the_generator_draws(tmp_path):
    runpy.run_path(str(FOLDER / "make_cards.py"))["main"](tmp_path)
    for name in NAMES:
        for suffix in ("svg", "pdf"):
            assert (tmp_path / f"{name}.{suffix}").read_bytes() == (FOLDER / f"{name}.{suffix}").read_bytes()
