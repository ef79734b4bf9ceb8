"""Make a dataset: distribute shards to processes, add published ones to the manifest, and seal it."""

from __future__ import annotations

import contextlib
import functools
import itertools
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from evanesce.core.errors import InputError, WorkError
from evanesce.dataset import layout
from evanesce.dataset.data_card import write_data_card
from evanesce.dataset.job import Job, load_job, save_job
from evanesce.dataset.manifest import Manifest
from evanesce.dataset.shard import ShardIndex, file_sha256, index_path
from evanesce.dataset.verify import checksums
from evanesce.dataset.worker import Trace, failed, make_shard

MAX_DEATHS = 50
"""Maximum number of consecutive deaths of a shard's worker at one frame. A fatal frame is identified after two; other
causes hit different frames."""
NAMED = 5
"""Maximum number of shards that an error names."""


@dataclass(frozen=True)
class Engine:
    """Processes that make the shards.

    Attributes
    ----------
    workers : int
        Processes on this machine; 0 makes them in this process.
    scheduler : str
        Address of a running Dask scheduler, instead.
    part : tuple of int, optional
        (i, n), i from 1: only every n-th shard, for job arrays; a later resume writes the manifest.
    """

    workers: int = 0
    scheduler: str = ""
    part: tuple[int, int] | None = None

    def __post_init__(self) -> None:
        if not 0 <= self.workers <= 4096:
            raise InputError(f"{self.workers}", key="--workers", allowed="0 to 4096")
        if self.part is not None and not 1 <= self.part[0] <= self.part[1] <= 1_000_000:
            raise InputError(f"{self.part[0]}/{self.part[1]}", key="--shard", allowed="i/n with 1 <= i <= n")


@dataclass(frozen=True)
class Outcome:
    """Result of a run.

    Attributes
    ----------
    frames : int
        In the dataset.
    made : int
        In this run.
    seconds : float
    size : int
        Of all shards [bytes].
    quarantined : list of dict
    complete : bool
        Whether all shards are there and the manifest is sealed.
    """

    frames: int
    made: int
    seconds: float
    size: int
    quarantined: list[dict[str, Any]]
    complete: bool


Progress = Callable[[dict[str, Any]], None]
Task = Callable[[str, int], dict[str, Any]]


def make(folder: Path, job: Job, engine: Engine | None = None, on_shard: Progress | None = None) -> Outcome:
    """Make a new dataset.

    Raises
    ------
    InputError
        If the folder holds something else, or no scheduler answers.
    MissingExtraError
        If worker processes are asked for and the extra ``dataset`` is not installed.
    WorkError
        If the system refuses to write, or another generator is running.
    """
    engine = engine or Engine()
    require_workers(engine)
    if (folder / layout.MANIFEST).exists() and engine.part is None:
        raise InputError("there is a dataset already", file=folder, key="--out", allowed="an empty folder, or `resume`")
    if folder.is_dir() and not (folder / layout.DESCRIPTION).exists():
        strange = [p.name for p in folder.iterdir() if p.name not in (layout.SHARDS, layout.WORK)]
        if strange:
            raise InputError(f"holds {strange[0]}", file=folder, key="--out", allowed="an empty or new folder")
    layout.make_folders(folder)
    with _write_errors(folder), layout.generator_lock(folder, engine.part):
        save_job(folder, job)
        return _run(folder, job, engine, on_shard, any_versions=False)


def resume(
    folder: Path, engine: Engine | None = None, on_shard: Progress | None = None, *, any_versions: bool = False
) -> Outcome:
    """Resume an interrupted run; complete shards are kept.

    Raises
    ------
    InputError
        If the folder holds no dataset, or one begun with other versions.
    WorkError
        As :func:`make`.
    """
    engine = engine or Engine()
    job = load_job(folder, check_versions=not any_versions)
    layout.make_folders(folder)
    with _write_errors(folder), layout.generator_lock(folder, engine.part):
        return _run(folder, job, engine, on_shard, any_versions=any_versions)


def require_workers(engine: Engine) -> None:
    """Check, before anything is written, that an engine of several processes has the package that it needs.

    Raises
    ------
    InputError
        If no scheduler answers.
    MissingExtraError
        If the extra ``dataset`` is not installed.
    """
    if engine.workers or engine.scheduler:
        from evanesce.dataset.cluster import require_cluster, require_scheduler

        require_cluster()
        if engine.scheduler:
            require_scheduler(engine.scheduler)


@contextlib.contextmanager
def _write_errors(folder: Path) -> Iterator[None]:
    """Convert errors of the system into one line."""
    try:
        yield
    except OSError as error:
        raise layout.cannot_write(Path(error.filename or folder), error) from None


def _run(folder: Path, job: Job, engine: Engine, on_shard: Progress | None, *, any_versions: bool) -> Outcome:
    start = time.perf_counter()
    task = functools.partial(make_shard, any_versions=any_versions)
    if engine.part is not None:
        return _run_part(folder, job, engine, on_shard, start, task)
    _sweep(folder)
    manifest = _manifest(folder, job)
    try:
        if manifest.meta().get("sealed") == "1":
            if not (folder / layout.SUMS).exists():
                _finish(folder, job, manifest)
            _clean(folder)
            return _outcome(manifest, 0, start)
        done = _add_published(folder, job, manifest)
        before = sum(len(job.frames_of(t)) for s in done for t in job.trials_of(s))
        if on_shard:
            on_shard({"shard": None, "frames": before, "quarantined": 0, "bytes": 0})
        made = 0
        todo = [s for s in range(job.shards) if s not in done]
        missing: dict[int, str] = {}
        for report in _distribute(folder, todo, engine, task):
            if report["failed"]:
                missing[report["shard"]] = report["failed"]
            else:
                manifest.add(_index(folder, report["shard"]))
                made += report["frames"]
            if on_shard:
                on_shard(report)
        _require_all(folder, missing)
        manifest.seal(folder / layout.MANIFEST)
        manifest = Manifest.open(folder / layout.MANIFEST)
        _finish(folder, job, manifest)
        _clean(folder)
        return _outcome(manifest, made, start)
    finally:
        manifest.close()


def _require_all(folder: Path, missing: dict[int, str]) -> None:
    """Raise an error that names the shards that could not be made."""
    if missing:
        named = "; ".join(f"{layout.shard_name(s)}: {missing[s]}" for s in sorted(missing)[:NAMED])
        more = f"; and {len(missing) - NAMED} more" if len(missing) > NAMED else ""
        count = "one shard" if len(missing) == 1 else f"{len(missing)} shards"
        raise WorkError(f"{folder}: {count} missing, which `resume` tries again: {named}{more}")


def _finish(folder: Path, job: Job, manifest: Manifest) -> None:
    """Write the files beside a sealed manifest; the checksums come last, as a sign of completeness."""
    write_data_card(folder, job, manifest)
    layout.write_whole(folder / layout.SUMS, checksums(folder, manifest))


def _run_part(folder: Path, job: Job, engine: Engine, on_shard: Progress | None, start: float, task: Task) -> Outcome:
    assert engine.part is not None
    if (folder / layout.SUMS).exists():  # its shards have been sealed; their indices are gone
        raise InputError("the dataset is finished", file=folder, key="--shard", allowed="a dataset still being made")
    i, n = engine.part
    mine = range(i - 1, job.shards, n)
    todo = [s for s in mine if not _published(folder, s)]
    frames = sum(len(job.frames_of(t)) for s in mine if s not in todo for t in job.trials_of(s))
    if on_shard:
        on_shard({"shard": None, "frames": frames, "quarantined": 0, "bytes": 0})
    made = size = 0
    missing: dict[int, str] = {}
    for report in _distribute(folder, todo, engine, task):
        if report["failed"]:
            missing[report["shard"]] = report["failed"]
        made, size = made + report["frames"], size + report["bytes"]
        if on_shard:
            on_shard(report)
    _require_all(folder, missing)
    quarantined = [q for s in mine for q in _index(folder, s).quarantined]
    return Outcome(frames + made, made, time.perf_counter() - start, size, quarantined, complete=False)


def _outcome(manifest: Manifest, made: int, start: float) -> Outcome:
    size = sum(row["size"] for row in manifest.shards().values())
    frames = len(manifest.frames())
    return Outcome(frames, made, time.perf_counter() - start, size, manifest.quarantined(), complete=True)


# --- existing files ---------------------------------------------------------------------------------------------------


def _sweep(folder: Path) -> None:
    """Delete the remains of interrupted writes."""
    for directory in (folder, folder / layout.WORK):
        for pattern in ("*.part", ".*.part", f".{layout.MANIFEST}.*"):
            for path in directory.glob(pattern):
                path.unlink(missing_ok=True)


def _manifest(folder: Path, job: Job) -> Manifest:
    path = folder / layout.MANIFEST
    if path.exists():
        manifest = Manifest.open(path, write=True)
        if manifest.meta().get("request_sha256") != job.request:
            raise InputError("manifest and description are of different datasets", file=path)
        return manifest
    provenance = job.describe()["provenance"]
    meta = {
        "config_sha256": job.digest,
        "request_sha256": job.request,
        "seed": str(job.seed),
        "evanesce": str(provenance["evanesce"]),
    }
    meta |= {f"package:{name}": value for name, value in provenance["packages"].items()}
    return Manifest.begin(path, meta)


def _published(folder: Path, shard: int) -> bool:
    """Return whether a shard exists with a matching index."""
    path = layout.shard_path(folder, shard)
    try:
        index = _index(folder, shard)
        return path.stat().st_size == index.size and file_sha256(path) == index.sha256
    except (MissingIndex, OSError):
        return False


class MissingIndex(Exception):
    """An index is absent or not readable: the shard is made again."""


def _index(folder: Path, shard: int) -> ShardIndex:
    try:
        return ShardIndex.from_dict(layout.read_json(index_path(folder, shard)))
    except (InputError, TypeError, KeyError) as error:
        raise MissingIndex(str(error)) from None


def _add_published(folder: Path, job: Job, manifest: Manifest) -> set[int]:
    """Return the finished shards, after adding those that an interrupted run had published but not added."""
    rows = manifest.shards()
    done = set()
    for shard in range(job.shards):
        path = layout.shard_path(folder, shard)
        if shard in rows:
            if path.is_file() and path.stat().st_size == rows[shard]["size"]:
                done.add(shard)
            else:
                raise WorkError(f"{path}: published, but missing or of another size; see `verify`")
        elif _published(folder, shard):
            manifest.add(_index(folder, shard))
            done.add(shard)
    return done


def _clean(folder: Path) -> None:
    """Remove what only the making needed; locks stay, or a second holder could lock another file."""
    for path in (folder / layout.WORK).iterdir():
        if not path.name.startswith("lock"):
            path.unlink(missing_ok=True)


# --- distribution -----------------------------------------------------------------------------------------------------


def _distribute(folder: Path, shards: list[int], engine: Engine, task: Task) -> Iterator[dict[str, Any]]:
    if not shards:
        return
    if engine.workers == 0 and not engine.scheduler:
        for shard in shards:
            yield task(str(folder), shard)
        return
    from evanesce.dataset.cluster import cluster_client

    with cluster_client(engine.workers, engine.scheduler) as client:
        slots = 1 if engine.scheduler else engine.workers
        yield from _from_cluster(client, folder.resolve(), shards, task, slots)


class Deaths:
    """Count consecutive deaths of workers at one frame of a shard; a death at another frame resets the count."""

    def __init__(self) -> None:
        self._last: dict[int, tuple[str, int]] = {}

    def count(self, shard: int, frame: str) -> int:
        """Record a death; return the number of consecutive ones at this frame."""
        before, times = self._last.get(shard, ("", 0))
        self._last[shard] = frame, times + 1 if frame == before else 1
        return self._last[shard][1]


def _from_cluster(
    client: Any, folder: Path, shards: list[int], task: Task, minimum_slots: int
) -> Iterator[dict[str, Any]]:
    """Keep every worker busy with one shard; a shard whose worker died is submitted again."""
    from distributed import as_completed
    from distributed.scheduler import KilledWorker

    waiting, attempts, deaths = iter(shards), dict.fromkeys(shards, 0), Deaths()
    futures: dict[Any, int] = {}
    queue = as_completed(loop=client.loop)

    def submit(shard: int) -> None:
        attempts[shard] += 1
        key = f"shard-{shard:06d}-{attempts[shard]}"
        future = client.submit(task, str(folder), shard, key=key, pure=False)
        futures[future] = shard
        queue.add(future)

    def keep_busy() -> None:
        slots = max(minimum_slots, sum(client.nthreads().values()))  # workers come and go
        for shard in itertools.islice(waiting, max(0, slots - len(futures))):
            submit(shard)

    keep_busy()
    for future in queue:
        shard = futures.pop(future)
        try:
            report = future.result()
        except KilledWorker:
            frame = Trace(folder, shard).frame()
            if deaths.count(shard, frame) < MAX_DEATHS:
                submit(shard)
                continue
            where = f"at frame {frame}" if frame else "before its first frame or after its last"
            report = failed(shard, f"its worker died {MAX_DEATHS} times in a row {where}")
        future.release()
        keep_busy()
        yield report
