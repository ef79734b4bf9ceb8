"""Question file of a design search: strict TOML, read into the search and into what is computed of its winners.

``scenes/questions/same_cost.toml`` is a documented example; ``docs/howto/design.md`` describes the keys.
"""

from __future__ import annotations

import tomllib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Literal, Self

from pydantic import Field, model_validator

from evanesce.core.errors import InputError
from evanesce.core.quantities import Strict, field
from evanesce.core.resources import resource
from evanesce.design.assessment import Assessment
from evanesce.design.parts import read_parts
from evanesce.design.question import Design, Question, on_case
from evanesce.design.search import Limit, Plan
from evanesce.design.uncertainty import read_standard_deviations
from evanesce.design.variables import MEASUREMENT, design_variables
from evanesce.rig import Scene, load_scene
from evanesce.rig.load import validate

MAX_BYTES = 1_000_000
FARTHEST_MM = 500.0
"""Largest coordinate of a position on a plate [mm]."""


class Range(Strict):
    """Range of one design variable, in the unit that its key carries."""

    low: float
    high: float
    step: float | None = None
    log: bool = False


class Loads(Strict):
    """What is measured: every combination of force, position and material; by default those of the scene."""

    forces_N: tuple[float, ...] | None = field(
        None, unit="N", bounds=(1e-3, 1e4), min_length=1, max_length=100, doc="normal forces"
    )
    positions_mm: tuple[tuple[float, float], ...] | None = Field(default=None, min_length=1, max_length=100)
    materials: tuple[str, ...] | None = Field(default=None, min_length=1, max_length=100)
    slide_speed_mm_per_s: float = field(5.0, unit="mm/s", bounds=(1e-3, 1e3), doc="of a slide, for motion blur")

    @model_validator(mode="after")
    def _near(self) -> Self:
        for x, y in self.positions_mm or ():
            if not (abs(x) <= FARTHEST_MM and abs(y) <= FARTHEST_MM):
                raise ValueError(f"positions_mm: [{x:g}, {y:g}] (allowed: within ±{FARTHEST_MM:g} mm)")
        return self


class Measurement(Strict):
    """How frames are measured; ``threshold`` and ``min_blob_px`` are of the reference segmentation."""

    estimator: Literal["reference", "refined"] = "reference"
    threshold: float = field(0.15, unit="1", bounds=MEASUREMENT["measurement.threshold"].bounds)
    min_blob_px: int = field(2000, unit="px", bounds=MEASUREMENT["measurement.min_blob_px"].bounds)
    crop_mm: float = field(7.5, unit="mm", bounds=(0.5, 500.0), doc="half the side of the measured square")


class Search(Strict):
    """How designs are searched for."""

    trials: int = field(200, unit="1", bounds=(1, 1_000_000), doc="designs evaluated in all, earlier runs included")
    sampler: Literal["tpe", "nsga2"] = "tpe"
    rigs: int = field(32, unit="1", bounds=(8, 4096), doc="rigs drawn for each design")
    pixel_factor: int = field(2, unit="1", bounds=(1, 8), doc="pixel pitch of the search over the camera's")
    seed: int = field(1, unit="1", bounds=(0, 2**63 - 1))


class Winners(Strict):
    """What is computed of the best designs after the search."""

    count: int = field(3, unit="1", bounds=(1, 8), doc="designs, the scene as given not counted")
    rigs: int = field(48, unit="1", bounds=(8, 4096), doc="rigs drawn anew for each")
    trajectories: int = field(4, unit="1", bounds=(0, 1000), doc="of Morris' plan about the best; 0: none")
    renderings: int = field(2, unit="1", bounds=(0, 1000), doc="by the path tracer; 0: none")
    samples_per_pixel: int = field(16, unit="1", bounds=(2, 65536), doc="of each rendering")


class QuestionFile(Strict):
    """A question as its file states it.

    Attributes
    ----------
    scene : str
        Shipped scene, or a file beside the question file: the rig to start from.
    overrides : mapping
        Dotted keys of the scene to replace.
    objectives : tuple of str
        :data:`evanesce.design.secondary.OBJECTIVES` to minimise (or maximise), the first one first.
    variables : mapping
        Dotted key of the scene or of the measurement -> its range.
    limits : mapping
        Objective -> figure that no design may exceed (or fall below).
    uncertainty : str, optional
        File of standard deviations; by default every effect's own.
    parts : str, optional
        File of parts and prices.
    loads, measurement, search, winners
    """

    scene: str
    overrides: dict[str, Any] = Field(default_factory=dict)
    objectives: tuple[str, ...] = Field(("area_error",), min_length=1, max_length=100)
    variables: dict[str, Range] = Field(default_factory=dict)
    limits: dict[str, float] = Field(default_factory=dict)
    uncertainty: str | None = None
    parts: str | None = None
    loads: Loads = Loads()
    measurement: Measurement = Measurement()
    search: Search = Search()
    winners: Winners = Winners()


def question_path(name: str | Path) -> Path:
    """Return the path of a question file, or of one that ships (``same_cost``).

    Raises
    ------
    InputError
        If neither exists.
    """
    path = Path(name)
    if path.is_file():
        return path
    folder = resource("scenes", "questions")
    if path.suffix == "" and path.parent == Path(".") and (folder / f"{path.name}.toml").is_file():
        return folder / f"{path.name}.toml"
    known = ", ".join(sorted(p.stem for p in folder.glob("*.toml")))
    raise InputError("no such question file", file=path, allowed=f"a TOML file, or a shipped question: {known}")


def read_question(name: str | Path, overrides: Mapping[str, Any] | None = None) -> tuple[Plan, Assessment]:
    """Read a question file.

    Parameters
    ----------
    name : str or Path
        File, or name of a shipped question.
    overrides : mapping, optional
        Dotted keys of the file to replace, e.g. ``{"search.trials": 40}``.

    Returns
    -------
    Plan
        The search.
    Assessment
        What is computed of its winners.

    Raises
    ------
    InputError
        With file, key, value and allowed range of the first thing wrong.
    """
    path = question_path(name)
    if path.stat().st_size > MAX_BYTES:
        raise InputError(f"{path.stat().st_size} bytes", file=path, allowed=f"at most {MAX_BYTES} bytes")
    try:
        data = tomllib.loads(path.read_text(encoding="utf-8"))
    except (ValueError, RecursionError) as error:
        raise InputError(f"not valid TOML: {error}", file=path) from None
    for dotted, value in (overrides or {}).items():
        _set(data, dotted, value, path)
    return _read(validate(QuestionFile, _with_dotted_keys(data), path), path)


def _set(data: dict[str, Any], dotted: str, value: Any, path: Path) -> None:
    *parents, last = dotted.split(".")
    table = data
    for part in parents:
        table = table.setdefault(part, {})
        if not isinstance(table, dict):
            raise InputError("is not a table", file=path, key=dotted)
    table[last] = value


def _with_dotted_keys(data: dict[str, Any]) -> dict[str, Any]:
    """Return a file's data with the keys of ``variables`` and ``overrides`` dotted, however the file nests them."""
    found = dict(data)
    if isinstance(data.get("variables"), dict):
        found["variables"] = dict(_flat(data["variables"], leaf=lambda table: "low" in table or "high" in table))
    if isinstance(data.get("overrides"), dict):
        found["overrides"] = dict(_flat(data["overrides"], leaf=lambda table: False))
    return found


def _flat(table: Mapping[str, Any], leaf: Any, at: str = "") -> Iterator[tuple[str, Any]]:
    for key, value in table.items():
        if isinstance(value, dict) and not leaf(value):
            yield from _flat(value, leaf, f"{at}{key}.")
        else:
            yield at + key, value


@contextmanager
def _in_file(path: Path) -> Iterator[None]:
    """Name the question file in errors that name no file."""
    try:
        yield
    except InputError as error:
        if error.file is not None:
            raise
        raise InputError(error.what, file=path, key=error.key, allowed=error.allowed) from None


def _read(asked: QuestionFile, path: Path) -> tuple[Plan, Assessment]:
    with _in_file(path):
        scene = load_scene(_beside(path, asked.scene, "scene"), asked.overrides)
        if scene.slide is not None:
            raise InputError("the scene slides", key="scene", allowed="a scene that presses")
        question = _question(asked, scene, path)
        for case in question.cases:  # a position off the plate is refused before anything is written
            on_case(scene, case)
        parts = None if asked.parts is None else read_parts(_beside(path, asked.parts, "parts"), scene)
        plan = Plan(
            base=Design(scene=scene, threshold=asked.measurement.threshold, min_blob_px=asked.measurement.min_blob_px),
            question=question,
            variables=design_variables({k: v.model_dump() for k, v in asked.variables.items()}, scene),
            objectives=asked.objectives,
            limits=tuple(Limit(name, value) for name, value in asked.limits.items()),
            parts=parts,
            sampler=asked.search.sampler,
            trials=asked.search.trials,
        )
    winners = asked.winners
    return plan, Assessment(
        designs=winners.count, rigs=winners.rigs, trajectories=winners.trajectories, renderings=winners.renderings,
        samples_per_pixel=winners.samples_per_pixel,
    )  # fmt: skip


def _question(asked: QuestionFile, scene: Scene, path: Path) -> Question:
    loads, deviations = asked.loads, None
    if asked.uncertainty is not None:
        deviations = read_standard_deviations(_beside(path, asked.uncertainty, "uncertainty"))
    return Question(
        forces_N=loads.forces_N or scene.press.forces_N or (1.0,),
        positions_mm=loads.positions_mm or (scene.finger.position_mm,),
        materials=loads.materials or (scene.finger.material,),
        estimator=asked.measurement.estimator,
        rigs=asked.search.rigs,
        pixel_factor=asked.search.pixel_factor,
        crop_mm=asked.measurement.crop_mm,
        speed_mm_per_s=loads.slide_speed_mm_per_s,
        standard_deviations=deviations,
        seed=asked.search.seed,
    )


def _beside(path: Path, name: str, key: str) -> Path:
    """Return a file named in a question file: relative to it, or for the scene the name of a shipped one."""
    found = path.parent / name
    if found.is_file():
        return found
    if key == "scene" and Path(name).suffix == "" and Path(name).parent == Path("."):
        return Path(name)
    raise InputError("no such file", file=path, key=key, allowed=f"a TOML file, here {found}")
