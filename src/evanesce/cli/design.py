"""``evanesce design``: search for the rig with the smallest predicted area error."""

from __future__ import annotations

import contextlib
import functools
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.table import Table

from evanesce.cli.common import (
    JsonOption,
    OutOption,
    check_json_target,
    console,
    handles_errors,
    out_dir,
    progress,
    write_bytes,
    write_json,
    write_text,
)
from evanesce.cli.render import parse_overrides
from evanesce.core.errors import WorkError
from evanesce.core.extras import require

if TYPE_CHECKING:
    from evanesce.design.assessment import Assessment, Chosen
    from evanesce.design.search import Plan, Trial


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command()(handles_errors(design))


def design(
    question: Annotated[str, typer.Argument(help="Question file (TOML), or the name of a shipped one: same_cost.")],
    settings: Annotated[
        list[str] | None,
        typer.Option("--set", help="Override a key of the question file, e.g. search.trials=40 (repeatable)."),
    ] = None,
    workers: Annotated[int, typer.Option("--workers", min=0, max=4096, help="Processes; 0: this one.")] = 0,
    scheduler: Annotated[str, typer.Option("--scheduler", help="A running Dask scheduler, tcp://HOST:PORT.")] = "",
    json_file: JsonOption = None,
    out: OutOption = None,
) -> None:
    """Search designs by the predicted 95 % area error of the whole measurement and by further objectives.

    An interrupted search resumes from its output folder; with more trials than before, a finished one continues.
    """
    check_json_target(json_file)
    require("design", "a search", "optuna")
    if workers or scheduler:
        require("design", "work in several processes (--workers above 0)", "dask", "distributed")
    from evanesce.design.question_file import read_question

    plan, assessment = read_question(question, parse_overrides(settings))
    if assessment.trajectories:
        require("design", "sensitivity of the best (winners.trajectories above 0)", "SALib")
    folder = out_dir(out, f"design-{Path(question).stem}")
    _run(plan, assessment, folder, workers, scheduler, json_file)


def _run(
    plan: Plan, assessment: Assessment, folder: Path, workers: int, scheduler: str, json_file: Path | None
) -> None:
    from evanesce.core import provenance
    from evanesce.design.assessment import choose, study
    from evanesce.design.search import run

    started = time.monotonic()
    with _client(workers, scheduler) as client, progress() as bar:
        trials = run(plan, folder, client, functools.partial(bar.report, "designs"))
        chosen = choose(plan, trials, assessment.designs)
        found = study(plan, chosen, folder, assessment, client, functools.partial(bar.report, "winners"))
    origin = dict(provenance.record(seed=plan.question.seed, config=plan.job))
    origin["search"] = {
        "trials": len(trials), "variables": [vars(v) for v in plan.variables], "sampler": plan.sampler,
        "seconds_of_this_run": time.monotonic() - started,
    }  # fmt: skip
    result = {
        "objectives": list(plan.objectives),
        "trials": [vars(t) | {"feasible": t.feasible} for t in trials],
        "chosen": {c.name: found[c.name] for c in chosen},
        "provenance": origin,
    }
    report = _write(plan, folder, trials, chosen, found, origin)
    write_json(folder / "result.json", result)
    write_json(json_file, result)
    _show(plan, chosen, found)
    console.print(f"{time.monotonic() - started:.0f} s. Report: {report}", highlight=False, soft_wrap=True)


@contextlib.contextmanager
def _client(workers: int, scheduler: str) -> Iterator[Any]:
    if workers == 0 and not scheduler:
        yield None
        return
    from evanesce.dataset.cluster import cluster_client

    with cluster_client(workers, scheduler) as client:
        yield client


def _write(
    plan: Plan, folder: Path, trials: Sequence[Trial], chosen: Sequence[Chosen], found: Any, origin: dict[str, Any]
) -> Path:
    """Write the pages, the scenes and the pictures."""
    from evanesce.design.page import scene_text, search_page, winner_page
    from evanesce.design.picture import shot
    from evanesce.design.plots import pareto_figure
    from evanesce.design.uncertainty import uncertainty_of
    from evanesce.report.html import image_png, write

    job = plan.job
    for c in chosen:
        write_text(folder / f"{c.name}.toml", scene_text(plan, c))
        shots = [shot(job, c.values, k) for k in sorted({0, len(plan.question.cases) - 1})]
        write_bytes(folder / f"{c.name}.png", image_png(shots[-1].frame))
        write(folder / f"{c.name}.html", winner_page(plan, c, found, shots, origin))
    base_figures = found["base"]["searched"]
    if "figures" not in base_figures:
        raise WorkError(f"the scene as given cannot be measured: {base_figures['reason']}")
    figure = pareto_figure(plan, trials, chosen, base_figures["figures"])
    for suffix in ("png", "svg"):
        part = folder / f".pareto.part.{suffix}"
        figure.savefig(part, dpi=110, facecolor="white")
        part.replace(folder / f"pareto.{suffix}")
    uncertainty = uncertainty_of(plan.base.scene, plan.question.standard_deviations)
    page = search_page(plan, trials, chosen, found, uncertainty, base_figures["figures"], origin)
    return write(folder / "report.html", page)


def _show(plan: Plan, chosen: Sequence[Chosen], found: Any) -> None:
    from evanesce.design.page import half_or_not, number
    from evanesce.design.plots import label

    names = list(dict.fromkeys(["exposure", *(n for n in plan.objectives if n != "area_error")]))
    table = Table(title="Winners on rigs drawn anew")
    headings = ("design", "95 % area error [%]", *(label(n, plan) for n in names), *(v.key for v in plan.variables))
    for heading in headings:
        table.add_column(heading, justify="left" if heading == "design" else "right", overflow="fold")
    for c in chosen:
        own = found[c.name]["assessed"]
        values = [number(c.values[v.key]) if v.key in c.values else "as given" for v in plan.variables]
        error = f"{own['error_percent']:.1f} ± {own['standard_percent']:.1f}"
        table.add_row(c.name, error, *(number(own["figures"][n]) for n in names), *values)
    console.print(table)
    console.print(half_or_not(plan, chosen, found), highlight=False)
