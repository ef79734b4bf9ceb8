"""Write shards atomically: uncompressed tar files in WebDataset's layout, with an index of their members."""

from __future__ import annotations

import contextlib
import hashlib
import io
import os
import tarfile
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import IO, Any

from evanesce.dataset import layout
from evanesce.dataset.produce import Record


@dataclass(frozen=True)
class Member:
    """A member of a shard: offset and size of its bytes in the tar file, and their SHA-256."""

    frame: int
    name: str
    offset: int
    size: int
    sha256: str


@dataclass
class ShardIndex:
    """Index of a shard.

    Attributes
    ----------
    shard : int
    file : str
    size : int
        [bytes].
    sha256 : str
    frames : list of dict
        Rows of the manifest.
    members : list of Member
    quarantined : list of dict
        ``frame``, ``trial`` and ``reason`` of frames that could not be made.
    """

    shard: int
    file: str = ""
    size: int = 0
    sha256: str = ""
    frames: list[dict[str, Any]] = field(default_factory=list)
    members: list[Member] = field(default_factory=list)
    quarantined: list[dict[str, Any]] = field(default_factory=list)

    def as_dict(self) -> dict[str, Any]:
        """Return JSON-able data."""
        return asdict(self)

    @classmethod
    def from_dict(cls, data: dict[str, Any]) -> ShardIndex:
        """Return the index of :meth:`as_dict`."""
        return cls(**{**data, "members": [Member(**m) for m in data["members"]]})


class _Hashed:
    """A binary file that hashes the bytes written to it."""

    def __init__(self, stream: IO[bytes]) -> None:
        self._stream, self.digest, self._at = stream, hashlib.sha256(), 0

    def write(self, data: bytes) -> int:
        self.digest.update(data)
        self._at += len(data)
        return self._stream.write(data)

    def tell(self) -> int:
        return self._at


class ShardWriter:
    """Write one shard; :meth:`publish` gives it its name.

    Parameters
    ----------
    folder : Path
        The dataset's.
    shard : int
    """

    def __init__(self, folder: Path, shard: int) -> None:
        self._folder, self.index = folder, ShardIndex(shard, layout.shard_name(shard))
        self._part = folder / layout.WORK / f"{self.index.file}.{os.getpid()}.part"

    def __enter__(self) -> ShardWriter:
        self._stream = self._part.open("wb")
        self._hashed = _Hashed(self._stream)
        self._tar = tarfile.open(fileobj=self._hashed, mode="w", format=tarfile.USTAR_FORMAT)  # type: ignore[call-overload]
        return self

    def add(self, record: Record) -> None:
        """Append a frame's members; names, times and owners are the same on every machine."""
        key = layout.frame_key(record.frame)
        for extension, data in record.members.items():
            info = tarfile.TarInfo(f"{key}.{extension}")
            info.size, info.mode, info.mtime = len(data), 0o644, 0
            offset = self._hashed.tell() + tarfile.BLOCKSIZE
            self._tar.addfile(info, io.BytesIO(data))
            digest = hashlib.sha256(data).hexdigest()
            self.index.members.append(Member(record.frame, extension, offset, len(data), digest))
        self.index.frames.append({"frame": record.frame, "key": key, "trial": record.trial, **record.row})

    def quarantine(self, frame: int, trial: int, reason: str) -> None:
        """Record a frame that could not be made."""
        self.index.quarantined.append({"frame": frame, "trial": trial, "reason": " ".join(reason.split())[:500]})

    def publish(self) -> ShardIndex:
        """Finish and rename the file; then write its index for the manifest."""
        self._tar.close()
        self._stream.flush()
        os.fsync(self._stream.fileno())
        self._stream.close()
        self.index.size, self.index.sha256 = self._part.stat().st_size, self._hashed.digest.hexdigest()
        target = layout.shard_path(self._folder, self.index.shard)
        os.replace(self._part, target)
        layout.fsync_folder(target.parent)
        layout.write_json(index_path(self._folder, self.index.shard), self.index.as_dict())
        return self.index

    def __exit__(self, *_: object) -> None:
        with contextlib.suppress(OSError):  # flushing may fail again on a full disk
            self._stream.close()
        self._part.unlink(missing_ok=True)


def index_path(folder: Path, shard: int) -> Path:
    """Return the path of a finished shard's index."""
    return folder / layout.WORK / f"{layout.shard_name(shard)}.json"


def file_sha256(path: Path) -> str:
    """Return the SHA-256 of a file."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()
