"""``evanesce design``: search for the rig whose measurements will be nearest to the truth."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator, Sequence
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
    write_json,
    write_text,
)
from evanesce.cli.render import SetOption, parse_overrides
from evanesce.errors import InputError, WorkError
from evanesce.extras import require

if TYPE_CHECKING:
    from evanesce.design.finish import Chosen, Depth
    from evanesce.design.search import Plan, Trial

MAX_WINNERS = 8


def register(app: typer.Typer) -> None:
    """Add the command."""

    @app.command()
    @handles_errors
    def design(
        scene: Annotated[str, typer.Argument(help="Scene file or name of a shipped scene: the rig to start from.")],
        vary: Annotated[
            list[str] | None,
            typer.Option("--vary", help="KEY=LOW:HIGH[:STEP or :log], e.g. plate.thickness_mm=3:10 (repeatable)."),
        ] = None,
        objective: Annotated[
            list[str] | None, typer.Option("--objective", help="area_error, exposure, cost, ... (repeatable).")
        ] = None,
        limit: Annotated[
            list[str] | None, typer.Option("--limit", help="OBJECTIVE=FIGURE that no design may break (repeatable).")
        ] = None,
        trials: Annotated[int, typer.Option("--trials", help="Designs tried in all, earlier runs included.")] = 200,
        sampler: Annotated[str, typer.Option("--sampler", help="tpe or nsga2.")] = "tpe",
        workers: Annotated[int, typer.Option("--workers", min=0, max=4096, help="Processes; 0: this one.")] = 0,
        scheduler: Annotated[str, typer.Option("--scheduler", help="A running Dask scheduler, tcp://HOST:PORT.")] = "",
        estimator: Annotated[str, typer.Option("--estimator", help="author or refined.")] = "author",
        threshold: Annotated[
            float, typer.Option("--threshold", help="Of the author's chain, where not varied.")
        ] = 0.15,
        min_blob: Annotated[int, typer.Option("--min-blob", min=0, help="Of the author's chain [px].")] = 2000,
        force: Annotated[
            list[float] | None, typer.Option("--force", help="Normal force [N] (repeatable) (default: the scene's).")
        ] = None,
        place: Annotated[
            list[str] | None, typer.Option("--place", help="X,Y of the tip [mm] (repeatable) (default: the scene's).")
        ] = None,
        material: Annotated[
            list[str] | None, typer.Option("--material", help="Of the finger (repeatable) (default: the scene's).")
        ] = None,
        uncertainty: Annotated[
            Path | None,
            typer.Option(
                "--uncertainty", help="TOML of standard deviations (default: each effect's own, all of them)."
            ),
        ] = None,
        parts: Annotated[Path | None, typer.Option("--parts", help="TOML table of parts and prices.")] = None,
        rigs: Annotated[int, typer.Option("--rigs", help="Rigs drawn for each design.")] = 32,
        coarser: Annotated[int, typer.Option("--coarser", help="Pixels of the search, times the camera's.")] = 2,
        crop: Annotated[float, typer.Option("--crop", help="Half the side of the measured square [mm].")] = 7.5,
        speed: Annotated[float, typer.Option("--speed", help="Of a slide, for motion blur [mm/s].")] = 5.0,
        winners: Annotated[
            int, typer.Option("--winners", min=1, max=MAX_WINNERS, help="Designs looked at closely.")
        ] = 3,
        fresh: Annotated[int, typer.Option("--fresh-rigs", min=8, max=4096, help="Drawn anew for each winner.")] = 48,
        trajectories: Annotated[
            int, typer.Option("--trajectories", min=0, max=1000, help="Of the sensitivity of the best; 0: none.")
        ] = 4,
        renderings: Annotated[
            int, typer.Option("--renderings", min=0, max=1000, help="Of each winner's cases by the reference; 0: none.")
        ] = 2,
        samples: Annotated[int, typer.Option("--samples", min=2, max=65536, help="Paths per pixel of each.")] = 16,
        seed: Annotated[int, typer.Option("--seed", min=0)] = 1,
        settings: SetOption = None,
        json_file: JsonOption = None,
        out: OutOption = None,
    ) -> None:
        """Search designs by the predicted 95 % area error of the whole measurement, and by what else is named.

        A search that was interrupted or killed goes on from what its output folder keeps; asked for more trials it
        goes on, too.
        """
        check_json_target(json_file)
        from evanesce.design.finish import Depth
        from evanesce.design.question import Question, on_case
        from evanesce.design.search import Plan
        from evanesce.design.uncertainty import read_sizes
        from evanesce.rig import load_scene

        require("design", "a search", "optuna")
        if trajectories:
            require("design", "sensitivity of the best (--trajectories above 0)", "SALib")
        if workers or scheduler:
            require("design", "work in several processes (--workers above 0)", "dask", "distributed")
        loaded = load_scene(scene, parse_overrides(settings))
        if loaded.slide is not None:
            raise InputError("the scene slides", key="slide", allowed="a scene that presses")
        sizes = None if uncertainty is None else read_sizes(uncertainty)
        question = Question(
            forces_N=tuple(force or loaded.press.forces_N or (1.0,)),
            places_mm=_places(place) or (loaded.finger.position_mm,),
            materials=tuple(material or (loaded.finger.material,)),
            estimator=estimator,  # type: ignore[arg-type]  # checked there
            rigs=rigs,
            coarser=coarser,
            crop_mm=crop,
            speed_mm_per_s=speed,
            sizes=sizes,
            seed=seed,
        )
        for case in question.cases:  # a place off the plate is told before anything is written
            on_case(loaded, case)
        plan = _plan(loaded, question, vary, objective, limit, threshold, min_blob, parts, sampler, trials)
        assert isinstance(plan, Plan)
        depth = Depth(rigs=fresh, trajectories=trajectories, renderings=renderings, samples=samples)
        folder = out_dir(out, f"design-{Path(scene).stem}")
        _run(plan, folder, depth, winners, workers, scheduler, json_file)


def _places(texts: list[str] | None) -> tuple[tuple[float, float], ...]:
    found = []
    for text in texts or []:
        try:
            x, y = (float(part) for part in text.split(","))
        except ValueError:
            raise InputError(f"{text!r}", key="--place", allowed="X,Y in mm, e.g. 3.5,-2") from None
        if not (abs(x) <= 500 and abs(y) <= 500):
            raise InputError(f"{text!r}", key="--place", allowed="within ±500 mm")
        found.append((x, y))
    return tuple(found)


def _plan(
    loaded: Any, question: Any, vary: list[str] | None, objective: list[str] | None, limit: list[str] | None,
    threshold: float, min_blob: int, parts: Path | None, sampler: str, trials: int,
) -> Plan:  # fmt: skip
    from evanesce.design.parts import read_parts
    from evanesce.design.question import Design
    from evanesce.design.search import Plan
    from evanesce.design.vary import MEASUREMENT, parse

    low, high = MEASUREMENT["measurement.threshold"].bounds
    if not low <= threshold <= high:
        raise InputError(f"{threshold:g}", key="--threshold", allowed=f"{low:g} to {high:g}")
    return Plan(
        base=Design(scene=loaded, threshold=threshold, min_blob_px=min_blob),
        question=question,
        vary=parse(vary or [], loaded),
        objectives=tuple(objective or ["area_error"]),
        limits=_limits(limit),
        parts=None if parts is None else read_parts(parts, loaded),
        sampler=sampler,  # type: ignore[arg-type]  # checked there
        trials=trials,
    )


def _limits(texts: list[str] | None) -> tuple[Any, ...]:
    import math

    from evanesce.design.search import Limit

    found = []
    for text in texts or []:
        name, _, figure = text.partition("=")
        try:
            value = float(figure)
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            raise InputError(f"{text!r}", key="--limit", allowed="OBJECTIVE=FIGURE, e.g. cost=200")
        found.append(Limit(name.strip(), value))
    return tuple(found)


def _run(
    plan: Plan, folder: Path, depth: Depth, winners: int, workers: int, scheduler: str, json_file: Path | None
) -> None:
    from evanesce import provenance
    from evanesce.design.finish import choose, study
    from evanesce.design.search import run

    started = time.monotonic()
    with _client(workers, scheduler) as client, progress() as bar:

        def ticker(text: str) -> Callable[[int, int], None]:
            task = bar.add_task(text, total=None)
            return lambda done, total: bar.update(task, completed=done, total=total)

        trials = run(plan, folder, client, ticker("designs"))
        chosen = choose(plan, trials, winners)
        found = study(plan, chosen, folder, depth, client, ticker("winners"))
    origin = dict(provenance.record(seed=plan.question.seed, config=plan.job))
    origin["search"] = {"trials": len(trials), "vary": [vars(v) for v in plan.vary], "sampler": plan.sampler,
                        "seconds_of_this_run": time.monotonic() - started}  # fmt: skip
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
    from evanesce.design.picture import shot
    from evanesce.design.uncertainty import uncertainty_of
    from evanesce.report.design_page import scene_text, search_page, winner_page
    from evanesce.report.design_plots import pareto_figure
    from evanesce.report.html import image_png, write

    job = plan.job
    for c in chosen:
        write_text(folder / f"{c.name}.toml", scene_text(plan, c))
        shots = [shot(job, c.values, k) for k in sorted({0, len(plan.question.cases) - 1})]
        _replace(folder / f"{c.name}.png", image_png(shots[-1].frame))
        write(folder / f"{c.name}.html", winner_page(plan, c, found, shots, origin))
    base_figures = found["base"]["searched"]
    if "figures" not in base_figures:
        raise WorkError(f"the scene as given cannot be measured: {base_figures['reason']}")
    figure = pareto_figure(plan, trials, chosen, base_figures["figures"])
    for suffix in ("png", "svg"):
        part = folder / f".pareto.part.{suffix}"
        figure.savefig(part, dpi=110, facecolor="white")
        part.replace(folder / f"pareto.{suffix}")
    uncertainty = uncertainty_of(plan.base.scene, plan.question.sizes)
    page = search_page(plan, trials, chosen, found, uncertainty, base_figures["figures"], origin)
    return write(folder / "report.html", page)


def _replace(path: Path, content: bytes) -> None:
    temporary = path.with_name("." + path.name + ".part")
    temporary.write_bytes(content)
    temporary.replace(path)


def _show(plan: Plan, chosen: Sequence[Chosen], found: Any) -> None:
    from evanesce.report.design_page import half_or_not, number
    from evanesce.report.design_plots import label

    names = list(dict.fromkeys(["exposure", *(n for n in plan.objectives if n != "area_error")]))
    table = Table(title="Designs looked at closely, on rigs drawn anew")
    for heading in ("design", "95 % area error [%]", *(label(n, plan) for n in names), *(v.key for v in plan.vary)):
        table.add_column(heading, justify="left" if heading == "design" else "right", overflow="fold")
    for c in chosen:
        own = found[c.name]["assessed"]
        values = [number(c.values[v.key]) if v.key in c.values else "as given" for v in plan.vary]
        error = f"{own['error_percent']:.1f} ± {own['standard_percent']:.1f}"
        table.add_row(c.name, error, *(number(own["figures"][n]) for n in names), *values)
    console.print(table)
    console.print(half_or_not(plan, chosen, found), highlight=False)
