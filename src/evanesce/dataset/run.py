"""Make a dataset: hand out shards to processes, enter what they publish into the manifest, seal it at the end."""

from __future__ import annotations

import contextlib
import functools
import itertools
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from evanesce.dataset import layout
from evanesce.dataset.card import write_card
from evanesce.dataset.job import Job, load_job, save_job
from evanesce.dataset.manifest import Manifest
from evanesce.dataset.shard import ShardIndex, file_sha256, index_path
from evanesce.dataset.verify import checksums
from evanesce.dataset.worker import Trace, failed, make_shard
from evanesce.errors import InputError, WorkError

MAX_DEATHS = 50
"""Times in a row that a shard's worker may die at the same frame before the shard is given up. A frame that kills is
found after two; kills from outside hit different frames."""
NAMED = 5
"""Shards that an error names."""


@dataclass(frozen=True)
class Engine:
    """Who makes the shards.

    Attributes
    ----------
    workers : int
        Processes on this machine; 0 makes them in this process.
    scheduler : str
        Address of a running Dask scheduler, instead.
    part : tuple of int, optional
        (i, n), i from 1: only every n-th shard, for job arrays; the manifest is left to a later resume.
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
    """How it went.

    Attributes
    ----------
    frames : int
        In the dataset now.
    made : int
        Of them, in this run.
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
    """Begin a dataset and make it.

    Raises
    ------
    InputError
        If the folder holds something else.
    MissingExtraError
        If worker processes are asked for and the extra ``dataset`` is not installed.
    WorkError
        If the system refuses to write, or another generator is at work.
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
    with _refusals_told(folder), layout.generator_lock(folder, engine.part):
        save_job(folder, job)
        return _run(folder, job, engine, on_shard, any_versions=False)


def resume(
    folder: Path, engine: Engine | None = None, on_shard: Progress | None = None, *, any_versions: bool = False
) -> Outcome:
    """Go on where a run ended, however it ended; whole shards are kept.

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
    with _refusals_told(folder), layout.generator_lock(folder, engine.part):
        return _run(folder, job, engine, on_shard, any_versions=any_versions)


def require_workers(engine: Engine) -> None:
    """Check, before anything is written, that an engine of several processes has the package that it needs.

    Raises
    ------
    MissingExtraError
        If the extra ``dataset`` is not installed.
    """
    if engine.workers or engine.scheduler:
        from evanesce.dataset.cluster import require_cluster

        require_cluster()


@contextlib.contextmanager
def _refusals_told(folder: Path) -> Iterator[None]:
    """Turn what the system refuses into one line, wherever it does."""
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
        done = _adopt(folder, job, manifest)
        before = sum(len(job.frames_of(t)) for s in done for t in job.trials_of(s))
        if on_shard:
            on_shard({"shard": None, "frames": before, "quarantined": 0, "bytes": 0})
        made = 0
        todo = [s for s in range(job.shards) if s not in done]
        missing: dict[int, str] = {}
        for report in _hand_out(folder, todo, engine, task):
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
    """Name the shards that could not be made, after all others were."""
    if missing:
        told = "; ".join(f"{layout.shard_name(s)}: {missing[s]}" for s in sorted(missing)[:NAMED])
        more = f"; and {len(missing) - NAMED} more" if len(missing) > NAMED else ""
        count = "one shard" if len(missing) == 1 else f"{len(missing)} shards"
        raise WorkError(f"{folder}: {count} missing, which `resume` tries again: {told}{more}")


def _finish(folder: Path, job: Job, manifest: Manifest) -> None:
    """Write what stands beside a sealed manifest; the checksums come last, so that their presence tells the rest."""
    write_card(folder, job, manifest)
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
    for report in _hand_out(folder, todo, engine, task):
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


# --- what is there already --------------------------------------------------------------------------------------------


def _sweep(folder: Path) -> None:
    """Throw away what unfinished writes left."""
    for place in (folder, folder / layout.WORK):
        for pattern in ("*.part", ".*.part", f".{layout.MANIFEST}.*"):
            for path in place.glob(pattern):
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
    """Tell whether a shard lies there with an index that fits it."""
    path = layout.shard_path(folder, shard)
    try:
        index = _index(folder, shard)
        return path.stat().st_size == index.size and file_sha256(path) == index.sha256
    except (EvanesceMissing, OSError):
        return False


class EvanesceMissing(Exception):
    """An index is not there, or not readable: the shard is made again."""


def _index(folder: Path, shard: int) -> ShardIndex:
    try:
        return ShardIndex.from_dict(layout.read_json(index_path(folder, shard)))
    except (InputError, TypeError, KeyError) as error:
        raise EvanesceMissing(str(error)) from None


def _adopt(folder: Path, job: Job, manifest: Manifest) -> set[int]:
    """Return the finished shards, after entering those that a dead driver had no time for."""
    rows = manifest.shards()
    done = set()
    for shard in range(job.shards):
        path = layout.shard_path(folder, shard)
        if shard in rows:
            if path.is_file() and path.stat().st_size == rows[shard]["size"]:
                done.add(shard)
            else:
                raise WorkError(f"{path}: published, but missing or of another size; `verify` tells more")
        elif _published(folder, shard):
            manifest.add(_index(folder, shard))
            done.add(shard)
    return done


def _clean(folder: Path) -> None:
    """Remove what only the making needed; locks stay, or a second holder could lock another file."""
    for path in (folder / layout.WORK).iterdir():
        if not path.name.startswith("lock"):
            path.unlink(missing_ok=True)


# --- who makes them ---------------------------------------------------------------------------------------------------


def _hand_out(folder: Path, shards: list[int], engine: Engine, task: Task) -> Iterator[dict[str, Any]]:
    if not shards:
        return
    if engine.workers == 0 and not engine.scheduler:
        for shard in shards:
            yield task(str(folder), shard)
        return
    from evanesce.dataset.cluster import cluster_client

    with cluster_client(engine.workers, engine.scheduler) as client:
        least = 1 if engine.scheduler else engine.workers
        yield from _from_cluster(client, folder.resolve(), shards, task, least)


class Deaths:
    """Counts deaths of workers in a row at one place of a shard; one elsewhere begins anew."""

    def __init__(self) -> None:
        self._last: dict[int, tuple[str, int]] = {}

    def count(self, shard: int, place: str) -> int:
        """Enter a death; return how many there were at this place without one elsewhere in between."""
        before, times = self._last.get(shard, ("", 0))
        self._last[shard] = place, times + 1 if place == before else 1
        return self._last[shard][1]


def _from_cluster(client: Any, folder: Path, shards: list[int], task: Task, least: int) -> Iterator[dict[str, Any]]:
    """Keep every worker (at least so many) busy with one shard; a shard whose worker died is handed out again."""
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
        slots = max(least, sum(client.nthreads().values()))  # workers come and go
        for shard in itertools.islice(waiting, max(0, slots - len(futures))):
            submit(shard)

    keep_busy()
    for future in queue:
        shard = futures.pop(future)
        try:
            report = future.result()
        except KilledWorker:
            place = Trace(folder, shard).place()
            if deaths.count(shard, place) < MAX_DEATHS:
                submit(shard)
                continue
            where = f"at frame {place}" if place else "before its first frame or after its last"
            report = failed(shard, f"its worker died {MAX_DEATHS} times in a row {where}")
        future.release()
        keep_busy()
        yield report
