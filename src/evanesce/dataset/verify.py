"""Verify a dataset against its manifest byte by byte; names every bad frame, reads each shard once."""

from __future__ import annotations

import hashlib
import mmap
import os
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from evanesce.dataset import layout
from evanesce.dataset.archive import archive_faults, open_shard
from evanesce.dataset.job import Job, load_job
from evanesce.dataset.manifest import Manifest
from evanesce.dataset.shard import file_sha256

CHUNK = 8 << 20


@dataclass(frozen=True)
class Fault:
    """A fault of a dataset.

    Attributes
    ----------
    file : str
        Relative to the dataset.
    what : str
    frames : tuple of str
        Keys of the frames that cannot be trusted; empty where no frame is affected.
    """

    file: str
    what: str
    frames: tuple[str, ...] = ()


@dataclass
class Report:
    """Result of a verification."""

    faults: list[Fault] = field(default_factory=list)
    quarantined: list[dict[str, Any]] = field(default_factory=list)
    frames: int = 0
    shards: int = 0
    size: int = 0
    seconds: float = 0.0

    @property
    def good(self) -> bool:
        """Whether there is no fault."""
        return not self.faults

    @property
    def bad_frames(self) -> list[str]:
        """Keys of all frames that cannot be trusted, in order."""
        return sorted({key for fault in self.faults for key in fault.frames})


def verify(folder: Path, *, threads: int = 2, on_shard: Callable[[int], None] | None = None) -> Report:
    """Check a finished dataset.

    Every shard is compared with its SHA-256 in the manifest, and each member if the shard differs; the manifest is
    checked by SQLite and against the description, the other files by their checksums.

    Parameters
    ----------
    folder : Path
    threads : int
        Number of shards hashed in parallel.
    on_shard : callable, optional
        Called with the size of each verified shard [bytes].

    Raises
    ------
    InputError
        If description or manifest cannot be read.
    """
    start = time.perf_counter()
    job = load_job(folder)
    manifest = Manifest.open(folder / layout.MANIFEST)
    report = Report()
    try:
        report.faults += _manifest_faults(folder, job, manifest)
        rows = manifest.shards()
        report.quarantined = manifest.quarantined()
        frames = manifest.frames()
        report.frames, report.shards = len(frames), len(rows)
        keys: dict[int, list[str]] = {}
        for frame in frames:
            keys.setdefault(frame["shard"], []).append(frame["key"])
        todo = [(row, keys.get(shard, [])) for shard, row in rows.items()]
        with ThreadPoolExecutor(threads) as pool:
            for (row, mine), good in zip(todo, pool.map(lambda t: _fits(folder, t[0]), todo), strict=True):
                report.size += row["size"]
                if good is not None:
                    report.faults += _name_frames(folder, manifest, row, mine, good)
                report.faults += _archive(folder, manifest, row)
                if on_shard:
                    on_shard(row["size"])
        report.faults += _strays(folder, rows)
        report.faults += _side_files(folder, manifest)
    finally:
        manifest.close()
    report.seconds = time.perf_counter() - start
    return report


def _fits(folder: Path, row: dict[str, Any]) -> str | None:
    """Return the fault of a shard as a file; None if there is none."""
    path = folder / layout.SHARDS / row["file"]
    if not layout.is_shard_name(row["file"]):
        return "the manifest names no shard"
    try:
        if not path.is_file() or path.is_symlink():
            return "missing"
        digest = hashlib.sha256()
        with os.fdopen(open_shard(folder, row["file"]), "rb", buffering=0) as stream:
            if (size := os.fstat(stream.fileno()).st_size) != row["size"]:
                return f"{size} bytes instead of {row['size']}"
            buffer = memoryview(bytearray(CHUNK))
            while count := stream.readinto(buffer):
                digest.update(buffer[:count])
    except OSError as error:
        return f"cannot be read: {error.strerror}"
    return None if digest.hexdigest() == row["sha256"] else "its SHA-256 differs"


def _name_frames(folder: Path, manifest: Manifest, row: dict[str, Any], keys: list[str], what: str) -> Iterator[Fault]:
    """Yield the fault of a shard with its bad frames, or with all frames if it cannot be read."""
    name = f"{layout.SHARDS}/{row['file']}"
    bad = set()
    try:
        with (
            os.fdopen(open_shard(folder, row["file"]), "rb") as stream,
            mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as data,
        ):
            for member in manifest.members_of_shard(row["shard"]):
                part = data[member.offset : member.offset + member.size]
                if hashlib.sha256(part).hexdigest() != member.sha256:
                    bad.add(layout.frame_key(member.frame))
    except (OSError, ValueError):
        bad = set(keys)
    yield Fault(
        name, what if bad else f"{what}, but every member matches: the tar structure differs", tuple(sorted(bad))
    )


def _archive(folder: Path, manifest: Manifest, row: dict[str, Any]) -> Iterator[Fault]:
    """Yield the members of a shard whose tar headers differ from the manifest; checksums alone could be forged."""
    if not layout.is_shard_name(row["file"]):
        return  # reported already
    try:
        handle = open_shard(folder, row["file"])
    except OSError:
        return  # reported already
    try:
        for member, what in archive_faults(handle, manifest.members_of_shard(row["shard"]), row["size"]):
            key = () if member is None else (layout.frame_key(member.frame),)
            yield Fault(f"{layout.SHARDS}/{row['file']}", f"archive refused: {what}", key)
    finally:
        os.close(handle)


def _manifest_faults(folder: Path, job: Job, manifest: Manifest) -> Iterator[Fault]:
    """Yield the faults of the manifest."""
    if fault := manifest.fault():
        yield Fault(layout.MANIFEST, fault)
    meta = manifest.meta()
    if (meta.get("config_sha256"), meta.get("request_sha256")) != (job.digest, job.request):
        yield Fault(layout.MANIFEST, "belongs to another description")
    if meta.get("sealed") != "1":
        yield Fault(layout.MANIFEST, "not finished: `resume` finishes it")
        return
    if meta.get("content_sha256") != manifest.content_digest():
        yield Fault(layout.MANIFEST, "its rows differ from those that were sealed")
    for row in manifest.frames():
        if row["key"] != layout.frame_key(row["frame"]):
            yield Fault(layout.MANIFEST, f"names the frame {row['key'][:80]!r}", (layout.frame_key(row["frame"]),))
    there = {row["frame"] for row in manifest.frames()} | {row["frame"] for row in manifest.quarantined()}
    missing = [layout.frame_key(frame) for frame in range(job.frames) if frame not in there]
    if missing or len(there) != job.frames:
        yield Fault(layout.MANIFEST, f"{len(there)} of {job.frames} frames", tuple(missing[:1000]))


def _strays(folder: Path, rows: dict[int, dict[str, Any]]) -> Iterator[Fault]:
    """Yield files among the shards that are not in the manifest."""
    known = {row["file"] for row in rows.values()}
    for path in sorted((folder / layout.SHARDS).iterdir()) if (folder / layout.SHARDS).is_dir() else []:
        if path.name not in known:
            yield Fault(f"{layout.SHARDS}/{path.name}", "not in the manifest")


def _side_files(folder: Path, manifest: Manifest) -> Iterator[Fault]:
    """Yield the faults of the files beside the manifest, by their checksums."""
    if manifest.meta().get("sealed") != "1":
        return
    try:
        found = (folder / layout.SUMS).read_bytes()
        wanted = checksums(folder, manifest)
    except OSError as error:
        yield Fault(layout.SUMS, f"a file is missing or cannot be read: {error.filename}")
        return
    if found != wanted:
        yield Fault(layout.SUMS, "does not match: it, the description, the manifest, schema or data card was changed")


def checksums(folder: Path, manifest: Manifest) -> bytes:
    """Return the content of ``SHA256SUMS``: small files as they are on disk, shards by the manifest."""
    small = (layout.DATA_CARD, layout.DESCRIPTION, layout.MANIFEST, layout.SCHEMA)
    lines = [f"{file_sha256(folder / name)}  {name}\n" for name in small]
    lines += [f"{row['sha256']}  {layout.SHARDS}/{row['file']}\n" for row in manifest.shards().values()]
    return "".join(lines).encode()
