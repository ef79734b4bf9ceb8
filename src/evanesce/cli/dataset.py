"""``evanesce dataset``: make, resume, verify, audit, score, baseline, export, info, preview."""

from __future__ import annotations

import math
import os
import re
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.table import Table

from evanesce.cli.common import JsonOption, check_json_target, console, handles_errors, messages, progress, write_json
from evanesce.cli.progress import duration
from evanesce.cli.render import SetOption, parse_overrides
from evanesce.core.errors import InputError, WorkError

if TYPE_CHECKING:
    from evanesce.dataset.run import Engine, Outcome
    from evanesce.dataset.score import SplitScore

FolderArgument = Annotated[Path, typer.Argument(help="Folder of a dataset.", show_default=False)]
WorkersOption = Annotated[
    int | None,
    typer.Option("--workers", help="Processes on this machine; 0: all in this process. Default: one for each core."),
]
SchedulerOption = Annotated[str, typer.Option("--scheduler", help="Dask scheduler to use instead, tcp://HOST:PORT.")]
ShardOption = Annotated[
    str, typer.Option("--shard", help="i/n, i from 1: only every n-th shard, for job arrays; `resume` gathers them.")
]
AnyVersionsOption = Annotated[
    bool, typer.Option("--any-versions", help="Continue although packages changed; frames or labels may then differ.")
]


def register(app: typer.Typer) -> None:
    """Add the group ``dataset``."""
    group = typer.Typer(help="Labelled sequences for slip detectors.", no_args_is_help=True)
    for command in (make, config, resume, verify, audit, score, baseline, export, info, preview):
        group.command()(handles_errors(command))
    app.add_typer(group, name="dataset")


def make(
    scene: Annotated[str, typer.Argument(help="Scene file, or the name of a shipped scene.", show_default=False)],
    out: Annotated[Path, typer.Option("--out", help="New folder.", show_default=False)],
    frames: Annotated[int, typer.Option("--n", help="Frames; rounded up to complete trials.")] = 2000,
    seed: Annotated[int, typer.Option("--seed", help="The one seed.")] = 0,
    config: Annotated[Path | None, typer.Option("--config", help="TOML of the declared distributions.")] = None,
    size: Annotated[
        str, typer.Option("--size", help="Frames of COLSxROWS, e.g. 320x240, of the region about the contacts.")
    ] = "",
    workers: WorkersOption = None,
    scheduler: SchedulerOption = "",
    shard: ShardOption = "",
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Check and estimate only.")] = False,
    override: SetOption = None,
    json_file: JsonOption = None,
) -> None:
    """Make a dataset: frames with per-pixel truth of presses and slides, in tar shards with a manifest."""
    check_json_target(json_file)
    from evanesce.dataset.limits import require_possible

    overrides = parse_overrides(override)
    require_possible(scene, config, overrides, frames)  # before anything large is imported
    from evanesce.dataset.config import load_config, with_size
    from evanesce.dataset.job import new_job
    from evanesce.rig import load_scene

    job = new_job(load_scene(scene, overrides), with_size(load_config(config), size), frames=frames, seed=seed)
    from evanesce.dataset.design import split_warning
    from evanesce.dataset.estimate import estimate, require_disk
    from evanesce.dataset.region import crop_warning
    from evanesce.dataset.rigs import replaced_warning
    from evanesce.dataset.run import require_workers

    engine = _engine(workers, scheduler, shard)
    if not dry_run:
        require_workers(engine)
    crop = crop_warning(job.scene, job.config, job.seed, job.trials)
    aside = replaced_warning(job.scene)
    for warning in filter(None, (aside, crop, split_warning(job.config, job.seed, job.trials))):
        messages.print(f"warning: {warning}", highlight=False, markup=False)
    guess = estimate(job, engine.workers)
    free = require_disk(out, guess.size // (engine.part[1] if engine.part else 1))
    messages.print(
        f"{job.frames} frames in {job.trials} trials, {job.shards} shards; about {guess.size / 1e9:.3g} GB"
        f" ({guess.frame_size / 1e6:.2g} MB a frame) of {free / 1e9:.3g} GB free, about {duration(guess.seconds)}"
    )
    if dry_run:
        write_json(json_file, {"frames": job.frames, "bytes": guess.size, "seconds": guess.seconds})
        return
    from evanesce.dataset.run import make as run

    with _Frames(job.frames) as bar:
        outcome = run(out, job, engine, bar)
    _report(out, outcome, json_file)


def config(
    out: Annotated[Path | None, typer.Option("--out", help="TOML file to write instead of printing.")] = None,
    given: Annotated[
        Path | None, typer.Option("--config", help="A declaration: printed with all that it leaves out.")
    ] = None,
    scene: Annotated[
        str, typer.Option("--scene", help="Scene file or name, about whose figures rigs and fingers are drawn.")
    ] = "thesis",
) -> None:
    """Print the default declaration of a dataset: every key with its range, as TOML that `make --config` reads."""
    from evanesce.core.files import write_text
    from evanesce.dataset.about import about
    from evanesce.dataset.config import load_config
    from evanesce.dataset.template import declaration
    from evanesce.rig import load_scene

    text = declaration(about(load_config(given), load_scene(scene)))
    if out is None:
        print(text, end="")
        return
    if out.exists():
        raise InputError("exists", file=out, key="--out", allowed="a new file")
    write_text(out, text)
    console.print(str(out), highlight=False)


def resume(
    folder: FolderArgument,
    workers: WorkersOption = None,
    scheduler: SchedulerOption = "",
    shard: ShardOption = "",
    any_versions: AnyVersionsOption = False,
    json_file: JsonOption = None,
) -> None:
    """Finish a dataset whose making ended early, or gather the shards of a job array."""
    check_json_target(json_file)
    from evanesce.dataset.estimate import estimate, require_disk
    from evanesce.dataset.job import load_job
    from evanesce.dataset.run import require_workers
    from evanesce.dataset.run import resume as run

    engine = _engine(workers, scheduler, shard)
    job = load_job(folder)
    # by count: an estimate less what is there would need space where nothing is left to make
    missing = max(job.shards - len(list((folder / "shards").glob("*.tar"))), 0)
    if missing:
        require_workers(engine)
    parts = engine.part[1] if engine.part else 1
    left = estimate(job, engine.workers).size * missing // (job.shards * parts)
    free = require_disk(folder, left)
    messages.print(f"about {left / 1e9:.3g} GB left to make, {free / 1e9:.3g} GB free")
    with _Frames(job.frames) as bar:
        outcome = run(folder, engine, bar, any_versions=any_versions)
    _report(folder, outcome, json_file)


def verify(folder: FolderArgument, json_file: JsonOption = None) -> None:
    """Check every byte against the manifest; name each bad frame. Exit code 1 if anything is wrong."""
    check_json_target(json_file)
    from evanesce.dataset.verify import verify as check

    # the size of a link itself: it may point nowhere, which `check` reports
    size = sum(tar.lstat().st_size for tar in (folder / "shards").glob("*.tar"))
    with progress() as bar:
        task = bar.add_task("verify [MB]", total=size / 1e6)
        report = check(folder, on_shard=lambda size: bar.advance(task, size / 1e6))
    rate = report.size / max(report.seconds, 1e-9) / 1e6
    result = {
        "good": report.good,
        "frames": report.frames,
        "shards": report.shards,
        "bytes": report.size,
        "seconds": report.seconds,
        "bad_frames": report.bad_frames,
        "faults": [vars(fault) for fault in report.faults],
        "quarantined": report.quarantined,
    }
    write_json(json_file, result)
    console.print(f"{report.frames} frames in {report.shards} shards, {report.size / 1e9:.3g} GB at {rate:.0f} MB/s")
    _name_quarantined(report.quarantined)
    for fault in report.faults:
        console.print(f"[red]{fault.file}[/red]: {fault.what}", highlight=False)
        for key in fault.frames:
            console.print(f"  bad frame {key}", highlight=False)
    if not report.good:
        raise WorkError(f"{folder}: {len(report.faults)} faults, {len(report.bad_frames)} bad frames")
    console.print("nothing wrong")


def audit(folder: FolderArgument, any_versions: AnyVersionsOption = False, json_file: JsonOption = None) -> None:
    """Check maps against numbers, labels against motion, splits, and composition. Exit code 1 if an identity fails."""
    check_json_target(json_file)
    from evanesce.dataset.audit import as_dict
    from evanesce.dataset.audit import audit as check
    from evanesce.dataset.job import load_job

    with _Frames(load_job(folder).frames) as bar:
        findings = check(folder, bar.advance, any_versions=any_versions)
    wrong = [finding for finding in findings if finding.verdict == "wrong"]
    write_json(json_file, {"good": not wrong, "findings": [as_dict(finding) for finding in findings]})
    table = Table(title=str(folder))
    for name in ("check", "value", "wanted", "verdict", "wrong", "of", "first"):
        table.add_column(name, justify="right" if name in ("value", "wrong", "of") else "left")
    colours = {"good": "green", "wrong": "red", "low": "yellow", "none": "dim"}
    for f in findings:
        verdict = f"[{colours[f.verdict]}]{f.verdict}[/{colours[f.verdict]}]"
        first = f.examples[0] if f.examples else ""
        wrong_of = "" if f.wanted.startswith(">=") else str(f.wrong)  # a share is no identity
        table.add_row(f.name, f"{f.value:.3g}", f.wanted, verdict, wrong_of, f"{f.of} {f.unit}", first)
    console.print(table)
    if wrong:
        raise WorkError(f"{folder}: {len(wrong)} identities fail, the first: {wrong[0].name}")


def export(
    folder: FolderArgument,
    to: Annotated[
        str, typer.Option("--to", help="hdf5, lerobot, coco, parquet, rrd, mcap or tiff.", show_default=False)
    ],
    out: Annotated[Path | None, typer.Option("--out", help="New folder; `FOLDER/../NAME-FORMAT` by default.")] = None,
    split: Annotated[str | None, typer.Option("--split", help="Only train, validation or test.")] = None,
    partial: Annotated[bool, typer.Option("--partial", help="The finished part of an unfinished dataset.")] = False,
    json_file: JsonOption = None,
) -> None:
    """Write a dataset in another format; each member is checked on the way."""
    check_json_target(json_file)
    from evanesce.dataset.export import export as write
    from evanesce.dataset.job import load_job
    from evanesce.dataset.read import Dataset

    target = out or folder.resolve().with_name(f"{folder.resolve().name}-{to}")
    with _Frames(load_job(folder).frames) as bar:
        count = write(folder, target, to, split=split, advance=bar.advance, partial=partial)
    with Dataset(folder) as whole:
        asked, bad = whole.job.frames, whole.quarantined
    write_json(json_file, {"frames": count, "of": asked, "quarantined": bad, "format": to, "folder": str(target)})
    lost = f"; {bad} are quarantined" if bad else ""
    part = f" ({split})" if split else ""
    console.print(f"{count} of {asked} frames{part} as {to} in {target}{lost}", highlight=False)


def score(
    folder: FolderArgument,
    predictions: Annotated[
        Path, typer.Argument(help="CSV file: key, and slip or stick_ratio or both.", show_default=False)
    ],
    threshold: Annotated[
        float | None, typer.Option("--threshold", help="Of `slip`; 0.5 by default, of 1 - stick_ratio 0.05.")
    ] = None,
    hold: Annotated[int, typer.Option("--hold", help="Frames above the threshold that an alarm needs.")] = 1,
    json_file: JsonOption = None,
) -> None:
    """Score a detector's predictions: onset of slip, false alarms, stick ratio, by split."""
    check_json_target(json_file)
    from evanesce.dataset.score import read_predictions
    from evanesce.dataset.score import score as judge

    rows = judge(folder, read_predictions(predictions), threshold=threshold, hold=hold, file=predictions)
    write_json(json_file, {"splits": [row.as_dict() for row in rows]})
    _print_scores(f"{predictions} on {folder}", rows)


def _print_scores(title: str, rows: list[SplitScore]) -> None:
    table = Table(title=title)
    for name in (
        "split", "trials", "slips found", "alarm after onset, median [ms]", "mean size [ms]", "false alarms [1/min]",
        "minutes without slip", "stick ratio, mean error",
    ):  # fmt: skip
        table.add_column(name, justify="left" if name == "split" else "right")
    for row in rows:
        table.add_row(
            row.split, str(row.trials), f"{row.found} of {row.slips}", _figure(row.onset_bias_ms, 0),
            _figure(row.onset_error_ms, 0), _figure(row.false_per_minute, 1), _figure(row.minutes, 2),
            " +- ".join(_figure(v, 3) for v in (row.stick_ratio_error, row.stick_ratio_se) if math.isfinite(v)) or "-",
        )  # fmt: skip
    console.print(table)


def _figure(value: float, digits: int) -> str:
    return f"{round(value, digits) + 0.0:.{digits}f}" if math.isfinite(value) else "-"


def baseline(
    folder: FolderArgument,
    out: Annotated[Path | None, typer.Option("--out", help="CSV of its predictions, as `score` reads them.")] = None,
    json_file: JsonOption = None,
) -> None:
    """Train a plain detector (gradient boosting on the frames) on the training split and score it."""
    check_json_target(json_file)
    from evanesce.dataset.job import load_job
    from evanesce.dataset.slip_baseline import HOLD, write_predictions
    from evanesce.dataset.slip_baseline import baseline as train

    with _Frames(load_job(folder).frames) as bar:
        found = train(folder, advance=bar.advance)
    if out is not None:
        write_predictions(out, found.predictions)
    rows = [row.as_dict() for row in found.scores]
    constant = None if math.isnan(found.constant_error) else found.constant_error
    write_json(json_file, {"threshold": found.threshold, "hold": HOLD, "splits": rows, "constant_error": constant})
    _print_scores(f"gradient boosting on frames of {folder}", found.scores)
    console.print(
        f"threshold {found.threshold:.3f}, {HOLD} frames; a constant stick ratio errs by {found.constant_error:.3f} in"
        " the test split",
        highlight=False,
    )


def info(folder: FolderArgument, json_file: JsonOption = None) -> None:
    """Print what a dataset holds."""
    check_json_target(json_file)
    from evanesce.dataset.info import describe

    found = describe(folder)
    write_json(json_file, found)
    table = Table(title=str(found["title"] or folder), show_header=False)
    for name, value in found.items():
        if name != "title":
            shown = ", ".join(f"{k} {v}" for k, v in value.items()) if isinstance(value, dict) else str(value)
            table.add_row(name.replace("_", " "), shown)
    console.print(table)


def preview(
    folder: FolderArgument,
    out: Annotated[Path | None, typer.Option("--out", help="Folder; `FOLDER/../NAME-preview` by default.")] = None,
    trial: Annotated[
        int | None, typer.Option("--trial", help="Trial of the video; the first slide by default.")
    ] = None,
) -> None:
    """Draw a contact sheet and a short video with the labels overlaid."""
    from evanesce.cli.common import out_dir
    from evanesce.dataset.preview import preview as draw

    target = out_dir(out or folder.resolve().with_name(f"{folder.resolve().name}-preview"), "preview")
    for path in draw(folder, target, trial=trial):
        console.print(str(path))


def _engine(workers: int | None, scheduler: str, shard: str) -> Engine:
    from evanesce.dataset.run import Engine

    part = None
    if shard:
        found = re.fullmatch(r"(\d{1,7})/(\d{1,7})", shard)
        if found is None:
            raise InputError(repr(shard), key="--shard", allowed="i/n with i from 1, e.g. 3/8")
        part = int(found.group(1)), int(found.group(2))
    if scheduler and re.match(r"(tcp|tls|ucx|ws|wss)://[^\s/]+", scheduler) is None:
        raise InputError(repr(scheduler), key="--scheduler", allowed="tcp://HOST:PORT")
    cores = len(os.sched_getaffinity(0))
    return Engine(cores if workers is None else workers, scheduler, part)


class _Frames:
    """Progress of the frames made, with their rate."""

    def __init__(self, frames: int) -> None:
        self._progress = progress()
        self._total, self._made = frames, 0

    def __enter__(self) -> _Frames:
        self._progress.start()
        self._task = self._progress.add_task("frames", total=self._total, rate="")
        return self

    def __call__(self, report: dict[str, Any]) -> None:
        """Take a report of the engine."""
        if report.get("failed"):
            messages.print(f"shard {report['shard']}: {report['failed']}", highlight=False, markup=False)
        if report["shard"] is None:
            self._progress.count_from(self._task, report["frames"])
        else:
            self._made += report["frames"]
        elapsed = self._progress.tasks[0].elapsed or 0.0
        rate = f"{self._made / elapsed:.2f} frames/s" if self._made and elapsed else ""
        self._progress.update(self._task, advance=report["frames"] + report["quarantined"], rate=rate)

    def advance(self, count: int) -> None:
        """Count frames."""
        self._progress.update(self._task, advance=count)

    def __exit__(self, *_: object) -> None:
        self._progress.stop()


def _report(folder: Path, outcome: Outcome, json_file: Path | None) -> None:
    write_json(json_file, vars(outcome))
    _name_quarantined(outcome.quarantined)
    rate = outcome.made / outcome.seconds if outcome.seconds > 0 else 0.0
    state = "complete" if outcome.complete else "this part is done; `resume` gathers the parts"
    console.print(
        f"{outcome.frames} frames, {outcome.size / 1e9:.3g} GB in {folder}: {state}"
        f" ({outcome.made} made in {duration(outcome.seconds)}, {rate:.2f} frames/s)",
        highlight=False,
    )


def _name_quarantined(rows: list[dict[str, Any]]) -> None:
    for row in rows:
        console.print(f"quarantined: frame {row['frame']:09d}: {row['reason']}", highlight=False)
