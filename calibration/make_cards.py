"""Draw the two calibration cards at true scale, as SVG and PDF: ``python calibration/make_cards.py [FOLDER]``.

Both formats are written by hand, a few lines each, so that every length in the file is the millimetre it stands for and
the same input gives the same bytes.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

PAGE = (210.0, 297.0)  # A4 [mm]
POINTS_PER_MM = 72.0 / 25.4
NOTE = (
    "Print at 100 % (no 'fit to page'), on matt paper. Check the 50 mm bar with a ruler before use.",
    "Lay the printed face on the glass. Do not wet it: paper in optical contact would glow.",
)

Rectangle = tuple[float, float, float, float]
Label = tuple[float, float, float, str]


@dataclass(frozen=True)
class Drawing:
    """Black rectangles (x, y, width, height) and labels (x, y, size, text) on a page, in mm from its upper left."""

    title: str
    rectangles: list[Rectangle]
    labels: list[Label]

    def svg(self) -> str:
        """Return the page as SVG, one user unit a millimetre."""
        width, height = PAGE
        lines = [
            f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:g}mm" height="{height:g}mm"'
            f' viewBox="0 0 {width:g} {height:g}">',
            f"<title>{self.title}</title>",
            f'<rect width="{width:g}" height="{height:g}" fill="#ffffff"/>',
            '<g fill="#000000" shape-rendering="crispEdges">',
        ]
        lines += [f'<rect x="{x:g}" y="{y:g}" width="{w:g}" height="{h:g}"/>' for x, y, w, h in self.rectangles]
        lines += ["</g>", '<g fill="#000000" font-family="Helvetica, Arial, sans-serif">']
        lines += [f'<text x="{x:g}" y="{y:g}" font-size="{size:g}">{text}</text>' for x, y, size, text in self.labels]
        return "\n".join([*lines, "</g>", "</svg>", ""])

    def pdf(self) -> bytes:
        """Return the page as PDF 1.4 with one built-in font; the content's unit is the millimetre, y downwards."""
        k, (width, height) = POINTS_PER_MM, PAGE
        content = [f"{k:.9f} 0 0 {-k:.9f} 0 {height * k:.6f} cm", "0 g"]
        content += [f"{x:g} {y:g} {w:g} {h:g} re" for x, y, w, h in self.rectangles]
        content.append("f")
        for x, y, size, text in self.labels:
            escaped = text.replace("\\", r"\\").replace("(", r"\(").replace(")", r"\)")
            # The text matrix turns letters upright again in the downward frame.
            content.append(f"BT /F1 {size:g} Tf 1 0 0 -1 {x:g} {y:g} Tm ({escaped}) Tj ET")
        stream = "\n".join(content).encode("ascii")
        box = f"[0 0 {width * k:.4f} {height * k:.4f}]"
        objects = [
            b"<< /Type /Catalog /Pages 2 0 R >>",
            b"<< /Type /Pages /Kids [3 0 R] /Count 1 >>",
            f"<< /Type /Page /Parent 2 0 R /MediaBox {box} /Contents 4 0 R"
            " /Resources << /Font << /F1 5 0 R >> >> >>".encode(),
            b"<< /Length " + str(len(stream)).encode() + b" >>\nstream\n" + stream + b"\nendstream",
            b"<< /Type /Font /Subtype /Type1 /BaseFont /Helvetica >>",
            f"<< /Title ({self.title.replace('(', '').replace(')', '')}) >>".encode(),
        ]
        out, places = bytearray(b"%PDF-1.4\n"), []
        for number, body in enumerate(objects, start=1):
            places.append(len(out))
            out += str(number).encode() + b" 0 obj\n" + body + b"\nendobj\n"
        start = len(out)
        out += f"xref\n0 {len(objects) + 1}\n0000000000 65535 f \n".encode()
        out += b"".join(f"{place:010d} 00000 n \n".encode() for place in places)
        out += f"trailer\n<< /Size {len(objects) + 1} /Root 1 0 R /Info 6 0 R >>\nstartxref\n{start}\n%%EOF\n".encode()
        return bytes(out)


def scale_bar(x: float, y: float, length: float = 50.0) -> list[Rectangle]:
    """Return a bar of ``length`` mm with a tick every 10 mm."""
    bar = [(x, y, length, 0.4)]
    ticks = [(x + k * 10.0 - (0.0 if k == 0 else 0.2), y - 2.0, 0.2, 2.0) for k in range(int(length // 10) + 1)]
    return bar + ticks


def page(title: str, marks: list[Rectangle], below: float) -> Drawing:
    """Return a card's page: its marks, title, scale bar and note."""
    y = below + 15.0
    labels: list[Label] = [(30.0, 30.0, 5.0, title), (82.0, y + 0.8, 3.5, "50 mm")]
    labels += [(30.0, y + 10.0 + 6.0 * k, 3.5, line) for k, line in enumerate(NOTE)]
    return Drawing(title, marks + scale_bar(30.0, y), labels)


def checkerboard(cols: int = 42, rows: int = 31, side: float = 1.0) -> Drawing:
    """Return a board whose first square, at the upper left, is paper."""
    x0, y0 = round((PAGE[0] - cols * side) / 2), 60.0
    marks = [
        (x0 + col * side, y0 + row * side, side, side) for row in range(rows) for col in range(cols) if (row + col) % 2
    ]
    return page(f"evanesce checkerboard, {cols} x {rows} squares of {side:g} mm", marks, y0 + rows * side)


def square(side: float = 15.0, frame: float = 10.0) -> Drawing:
    """Return a white square in a black frame."""
    x, y = round((PAGE[0] - side) / 2), 80.0
    outer = side + 2 * frame
    marks = [
        (x - frame, y - frame, outer, frame),
        (x - frame, y + side, outer, frame),
        (x - frame, y, frame, side),
        (x + side, y, frame, side),
    ]
    return page(f"evanesce square card, {side:g} x {side:g} mm", marks, y + side + frame)


def main(folder: Path) -> None:
    """Write the four files."""
    cards = {"checkerboard_1mm_42x31": checkerboard(), "square_15mm": square()}
    for name, drawing in cards.items():
        (folder / f"{name}.svg").write_text(drawing.svg(), encoding="ascii")
        (folder / f"{name}.pdf").write_bytes(drawing.pdf())


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).resolve().parent)
