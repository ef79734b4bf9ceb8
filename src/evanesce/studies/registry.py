"""The parts of ``evanesce study all``: what a part is, what it finds, and the search that collects them.

Every folder of this package whose module ``page`` holds a :class:`Study` named ``STUDY`` is a part. Its module
``study`` computes, ``page`` makes the findings of it, :mod:`evanesce.studies.page` the report. Long parts keep finished
rows in a :class:`~evanesce.studies.ledger.Ledger`.
"""

from __future__ import annotations

import importlib
import importlib.util
import pkgutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from evanesce import studies as here
from evanesce.report.charts import CaptionedImage, Chart, Maps
from evanesce.report.html import Table
from evanesce.rig import Scene

Progress = Callable[[str, int, int], None]
"""``progress(what, done, total)``, called as work proceeds."""


@dataclass(frozen=True, kw_only=True)
class Findings:
    """What a part found.

    Attributes
    ----------
    verdict : sequence of str
        Sentences, the first of them the answer.
    charts, maps, pictures, tables : sequence
    data : mapping
        The numbers, JSON-able, units in the keys.
    """

    verdict: Sequence[str]
    charts: Sequence[Chart] = ()
    maps: Sequence[Maps] = ()
    pictures: Sequence[CaptionedImage] = ()
    tables: Sequence[Table] = ()
    data: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Study:
    """One part of ``evanesce study all``.

    Attributes
    ----------
    name : str
        As on the command line.
    title : str
        Heading on the page.
    order : int
        Position on the page, ascending.
    compute : callable
        See :meth:`run`.
    """

    name: str
    title: str
    order: int
    compute: Callable[..., Findings]

    def run(self, scene: Scene, out: Path, progress: Progress, *, quick: bool = False, seed: int = 1) -> Findings:
        """Compute the study of a scene.

        Parameters
        ----------
        scene : Scene
        out : Path
            Existing folder for finished rows.
        progress : callable
            ``progress(what, done, total)``.
        quick : bool
            Whether to take fewer samples.
        seed : int
            Of all random numbers.

        Returns
        -------
        Findings
        """
        return self.compute(scene, out, progress, quick=quick, seed=seed)


def studies() -> list[Study]:
    """Return every part, in the order of the page.

    Returns
    -------
    list of Study
    """
    found: list[Study] = []
    for folder in pkgutil.iter_modules(here.__path__):
        module = f"{here.__name__}.{folder.name}.page"
        if folder.ispkg and importlib.util.find_spec(module) is not None:
            study = getattr(importlib.import_module(module), "STUDY", None)
            if study is not None:
                found.append(study)
    return sorted(found, key=lambda study: (study.order, study.name))
