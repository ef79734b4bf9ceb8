"""``evanesce criticise``: from a measurement bundle to what the simulation gets wrong about it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer
from rich import box
from rich.markup import escape
from rich.progress import Progress
from rich.table import Table

from evanesce.cli.common import (
    JsonOption,
    check_json_target,
    console,
    handles_errors,
    messages,
    progress,
    write_json,
    write_text,
)
from evanesce.core.errors import InputError

PICTURES = (".png", ".pdf", ".svg")


def register(app: typer.Typer) -> None:
    """Add the command."""

    @app.command()
    @handles_errors
    def criticise(
        folder: Annotated[Path, typer.Argument(help="The bundle, see docs/reference/bundle.md.", metavar="BUNDLE")],
        json_file: JsonOption = None,
        report: Annotated[Path | None, typer.Option("--report", help="Write an HTML page to this file.")] = None,
        scene: Annotated[
            Path | None, typer.Option("--scene", help="Write the extended scene here (default: beside the JSON).")
        ] = None,
        seed: Annotated[int, typer.Option("--seed", min=0, help="Seed of the draws of noise.")] = 0,
        joint: Annotated[
            bool, typer.Option("--joint", hidden=True, help="Experimental: fit all causes jointly.")
        ] = False,
        shapes: Annotated[
            Path | None, typer.Option("--shapes", hidden=True, help="Write a picture of every cause's forms and stop.")
        ] = None,
    ) -> None:
        """Find what a nominal model gets wrong about measured data: name causes, extend the scene, measure gain."""
        from evanesce.bundle import read_bundle
        from evanesce.criticism.critic import criticise as by_frames

        for target in (json_file, report, scene, shapes):
            check_json_target(target)
        if shapes is not None and shapes.suffix.lower() not in PICTURES:
            raise InputError(f"cannot write {shapes.suffix!r}", key="--shapes", allowed=", ".join(PICTURES))
        bundle = read_bundle(folder)
        if shapes is not None:
            _draw_shapes(bundle, shapes)
            return
        if joint or not bundle.has_frames:
            _jointly(bundle, json_file, report, scene)
            return
        with progress() as bar:
            result, evidence = by_frames(bundle, seed=seed, tick=_ticker(bar))
            bar.update(bar.task_ids[0], completed=100)
        target = scene or _beside(json_file or report)
        if target is not None:
            write_text(target, evidence.scene_after)
            result["extended_scene"] = str(target)
        write_json(json_file, result)
        if report is not None:
            _write_report(report, result, evidence, folder.name)
        _show(result)


def _jointly(bundle: Any, json_file: Path | None, report: Path | None, scene: Path | None) -> None:
    """Run the joint fit, tell its progress on standard error, write and show its answer."""
    from evanesce.core.provenance import record
    from evanesce.inference.critic import Criticism, criticise_jointly
    from evanesce.inference.gate import GrossDifference
    from evanesce.inference.page import page
    from evanesce.inference.series.critic import SeriesCriticism, criticise_series
    from evanesce.report.html import write
    from evanesce.rig import dump_scene

    try:
        run = criticise_jointly if bundle.has_frames else criticise_series
        found: Criticism | SeriesCriticism = run(bundle, tell=lambda line: messages.print(escape(line)))
    except GrossDifference as error:
        write_json(json_file, error.as_dict())
        raise
    target = scene or _beside(json_file or report)
    if target is not None:
        write_text(target, found.scene)
        found.result["extended_scene"] = str(target)
    write_json(json_file, found.result)
    if report is not None:
        scenes = (dump_scene(bundle.scene), found.scene)
        write(report, page(found.result, found.pictures, bundle.path.name, scenes, record(seed=0)))
    _show_jointly(found.result)


def _draw_shapes(bundle: Any, target: Path) -> None:
    """Write a picture of the forms of all causes."""
    from evanesce.inference.critic import shapes_of
    from evanesce.inference.shape_picture import shape_figure

    forms, data = shapes_of(bundle, tell=lambda line: messages.print(escape(line)))
    figure = shape_figure(forms, data)
    figure.savefig(target, dpi=110)
    console.print(f"forms of {len(forms)} causes: {escape(str(target))}")


def _show_jointly(result: dict[str, Any]) -> None:
    console.print(escape(result["first_line"]))
    for warning in result["warnings"]:
        messages.print(escape(f"warning: {warning}"))
    table = Table(title="Fitted, with 90 % intervals", box=box.SIMPLE_HEAD)
    for heading in ("cause", "parameter", "value", "from", "to", "unit", "area, mm^2", "area, %", "probability"):
        table.add_column(heading, justify="left" if heading in ("cause", "parameter", "unit") else "right")
    for cause in result["causes"]:
        area = cause["area"]
        largest = max(range(len(area["mm2"])), key=lambda k: abs(area["mm2"][k]), default=None)
        moved = ["", ""] if largest is None else [f"{area['mm2'][largest]:+.2f}", f"{area['percent'][largest]:+.1f}"]
        for number, (name, p) in enumerate(cause["parameters"].items()):
            own = [*moved, f"{cause['probability']:.2f}"] if number == 0 else ["", "", ""]
            values = [f"{p[key]:.4g}" for key in ("value", "lo", "hi")]
            table.add_row(cause["id"] if number == 0 else "", name, *values, p["unit"], *own)
    if result["causes"]:
        console.print(table)
    console.print(f"Not explained: {100 * result['misfit']['left_share']:.2g} % of the misfit.")
    advice = result["next_measurement"]
    if advice is not None and advice["what"] is not None:
        between = " or ".join(advice["between"])
        console.print(escape(f"Next: {advice['what']}, to tell whether it is {between}."))
    gain = result["held_out"]
    if gain is not None:
        unit, what = ("DN", "views") if "rms_DN" in gain else ("standard deviations", "rows")
        rms, rms_after = gain["rms_DN" if unit == "DN" else "rms_sd"]
        area = [f"{a:.2f}" for a in gain["area_error_percent"] if a is not None]
        more = f", error of the predicted area {' to '.join(area)} %" if area else ""
        console.print(f"Held out ({gain['views']} {what}): residual {rms:.2f} to {rms_after:.2f} {unit} RMS{more}")


SHARES = {
    "frames and noise": 0, "signatures of all candidates": 38, "score tests": 74, "battery": 75, "nested fits": 82,
    "what can be told from what": 97, "locked part": 98,
}  # fmt: skip
"""Per cent of the time that have passed when a step begins, as measured on a bundle with frames."""


def _ticker(bar: Progress) -> Callable[[str], None]:
    """Return what moves a bar on when a step begins; a step without a known share only changes its words."""
    from evanesce.effects import all_effects

    task = bar.add_task("criticise", total=100)
    each = (SHARES["score tests"] - SHARES["signatures of all candidates"]) / len(all_effects())

    def tick(step: str) -> None:
        if step in SHARES:
            bar.update(task, completed=SHARES[step])
        elif step.startswith("signature of "):
            bar.advance(task, each)
        bar.update(task, description=f"criticise: {step}")

    return tick


def _beside(target: Path | None) -> Path | None:
    """Return where the extended scene goes: beside the answer."""
    if target is None:
        return None
    if target.suffix == ".toml":
        raise InputError("is a scene's suffix", file=target, key="--json", allowed="a file that ends in .json")
    return target.with_name(target.stem + "_scene.toml")


def _write_report(target: Path, result: dict[str, Any], evidence: Any, name: str) -> None:
    from evanesce.core.provenance import record
    from evanesce.criticism.report_page import page
    from evanesce.report.html import write

    write(target, page(result, evidence, name, record(seed=result["seed"])))


def _show(result: dict[str, Any]) -> None:
    from evanesce.criticism.report_page import verdict_words

    console.print(escape(verdict_words(result)))
    if result["effects"]:
        table = Table(title="Fitted, with 90 % intervals", box=box.SIMPLE_HEAD)
        for heading in ("effect", "parameter", "value", "from", "to", "unit"):
            table.add_column(heading, justify="right" if heading in ("value", "from", "to") else "left")
        for effect in result["effects"]:
            for name, p in effect["parameters"].items():
                table.add_row(effect["id"], name, f"{p['value']:.4g}", f"{p['lo']:.4g}", f"{p['hi']:.4g}", p["unit"])
        console.print(table)
    probable = [(name, p) for name, p in result["probabilities"].items() if p >= 0.005]
    console.print("Probabilities: " + ", ".join(f"{escape(name)} {p:.2f}" for name, p in probable[:8]))
    if result["next_measurement"]:
        console.print(f"Next measurement: {escape(result['next_measurement']['what'])}")
    gain = result["gain"]
    if gain is not None:
        value, low, high = gain["log_score"]
        console.print(
            f"Log score gained on {gain['views']} held-out views: {value:.1f} nats, 95 % {low:.1f} to {high:.1f}"
        )
