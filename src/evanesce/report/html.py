"""Self-contained HTML pages: figures first, each with a sentence that says what it means, tables, provenance last."""

from __future__ import annotations

import base64
import io
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import jinja2
import numpy as np
from markupsafe import Markup
from matplotlib.figure import Figure
from numpy.typing import NDArray
from PIL import Image

ENVIRONMENT = jinja2.Environment(
    loader=jinja2.PackageLoader("evanesce.report", "templates"),
    autoescape=True,
    trim_blocks=True,
    lstrip_blocks=True,
    undefined=jinja2.StrictUndefined,
)


@dataclass(frozen=True)
class Picture:
    """A picture with the sentence that says what it means; ``kind`` is the format of its bytes, png or webp."""

    png: bytes
    caption: str
    alt: str = ""
    kind: str = "png"

    @property
    def uri(self) -> str:
        """The picture as a data URI."""
        return f"data:image/{self.kind};base64," + base64.b64encode(self.png).decode("ascii")


@dataclass(frozen=True)
class Table:
    """Rows of text under headings that carry their units."""

    columns: Sequence[str]
    rows: Sequence[Sequence[str]]
    caption: str = ""


@dataclass
class Section:
    """A heading, paragraphs, a widget (trusted HTML of this package), pictures and tables, in that order."""

    heading: str
    paragraphs: list[str] = field(default_factory=list)
    pictures: list[Picture] = field(default_factory=list)
    tables: list[Table] = field(default_factory=list)
    widget: Markup | None = None


@dataclass
class Page:
    """One report."""

    title: str
    lead: str
    sections: list[Section] = field(default_factory=list)
    provenance: Mapping[str, Any] = field(default_factory=dict)

    def render(self) -> str:
        """Return the page as HTML text that needs no other file and no network.

        Returns
        -------
        str
        """
        return ENVIRONMENT.get_template("page.html.j2").render(
            page=self, provenance=json.dumps(self.provenance, indent=2, default=str, ensure_ascii=False)
        )


def figure_png(figure: Figure, dpi: int = 110) -> bytes:
    """Return a Matplotlib figure as PNG bytes.

    Parameters
    ----------
    figure : Figure
    dpi : int
        Dots per inch.

    Returns
    -------
    bytes
    """
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=dpi, bbox_inches="tight", facecolor="white")
    return buffer.getvalue()


def image_png(image: NDArray[np.uint8], max_width: int | None = None) -> bytes:
    """Return an 8-bit grey or RGB array as PNG bytes, box-reduced to ``max_width`` pixels if it is wider.

    Parameters
    ----------
    image : ndarray of uint8 (rows, cols) or (rows, cols, 3)
    max_width : int, optional
        [px].

    Returns
    -------
    bytes
    """
    picture = Image.fromarray(np.ascontiguousarray(image))
    if max_width is not None and picture.width > max_width:
        picture = picture.resize((max_width, round(picture.height * max_width / picture.width)), Image.Resampling.BOX)
    buffer = io.BytesIO()
    picture.save(buffer, format="PNG", optimize=True)
    return buffer.getvalue()


def write(path: Path, page: Page) -> Path:
    """Write a page, whole or not at all; return its path.

    Parameters
    ----------
    path : Path
    page : Page

    Returns
    -------
    Path
    """
    temporary = path.with_name("." + path.name + ".part")
    temporary.write_text(page.render(), encoding="utf-8")
    temporary.replace(path)
    return path
