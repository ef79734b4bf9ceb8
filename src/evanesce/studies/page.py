"""The report of ``evanesce study all``: figures first, each with what it means; tables below; provenance last."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from markupsafe import Markup

from evanesce.report.charts import chart_figure, maps_figure
from evanesce.report.html import Page, Picture, Section, figure_png, image_png
from evanesce.studies.registry import Findings, Study

WIDTH_PX = 1150


def page(
    title: str,
    parts: Sequence[tuple[Study, Findings]],
    provenance: Mapping[str, Any],
    slider: Markup | None = None,
    lead: str = "",
) -> Page:
    """Return the report of some parts; :meth:`~evanesce.report.html.Page.render` gives HTML that needs no other file.

    Parameters
    ----------
    title : str
    parts : sequence of (Study, Findings)
    provenance : mapping
    slider : Markup, optional
        Of :func:`evanesce.studies.threshold.slider.slider`.
    lead : str
        One sentence under the title.

    Returns
    -------
    Page
    """
    sections = []
    if slider is not None:
        text = (
            "A rendered frame, undistorted without error. Move the threshold: orange is what the reference segmentation"
            " (blur 1 px, dilation 10 px, blobs of at least 2000 px) takes for contact, blue the true outline."
        )
        sections.append(Section("How wrong is the area at this threshold?", [text], widget=slider))
    sections += [_figures(study, found) for study, found in parts]
    sections += [_tables(study, found) for study, found in parts if found.tables]
    return Page(title, lead, sections, provenance)


def pictures(parts: Sequence[tuple[Study, Findings]]) -> dict[str, bytes]:
    """Return every figure of the page as PNG by a name, ``threshold-1`` and so on.

    Parameters
    ----------
    parts : sequence of (Study, Findings)

    Returns
    -------
    dict of str to bytes
    """
    found = {}
    for study, findings in parts:
        for k, picture in enumerate(_pictures(findings), start=1):
            found[f"{study.name}-{k}"] = picture.png
    return found


def _pictures(found: Findings) -> list[Picture]:
    charts = [Picture(figure_png(chart_figure(chart)), chart.caption) for chart in found.charts]
    charts += [Picture(figure_png(maps_figure(maps)), maps.caption) for maps in found.maps]
    return charts + [Picture(image_png(shown.image, WIDTH_PX), shown.caption) for shown in found.pictures]


def _figures(study: Study, found: Findings) -> Section:
    return Section(study.title, list(found.verdict), _pictures(found))


def _tables(study: Study, found: Findings) -> Section:
    return Section(f"Tables: {study.title[0].lower()}{study.title[1:]}", tables=list(found.tables))
