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
    progress,
    write_json,
    write_text,
)
from evanesce.core.errors import InputError


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
    ) -> None:
        """Find what a nominal model gets wrong about measured data: name causes, extend the scene, measure gain."""
        from evanesce.bundle import read_bundle
        from evanesce.criticism.critic import criticise as by_frames
        from evanesce.criticism.scalar_critic import criticise_series

        for target in (json_file, report, scene):
            check_json_target(target)
        bundle = read_bundle(folder)
        run = by_frames if bundle.has_frames else criticise_series
        with progress() as bar:
            result, evidence = run(bundle, seed=seed, tick=_ticker(bar))
            bar.update(bar.task_ids[0], completed=100)
        target = scene or _beside(json_file or report)
        if target is not None:
            write_text(target, evidence.scene_after)
            result["extended_scene"] = str(target)
        write_json(json_file, result)
        if report is not None:
            _write_report(report, result, evidence, folder.name)
        _show(result)


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
