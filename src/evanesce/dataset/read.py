"""Read a dataset: random access by number, decoded on demand. Nothing is unpickled, no archive path is used."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, cast, overload

import numpy as np
from numpy.typing import NDArray

from evanesce.core.errors import InputError
from evanesce.dataset import layout
from evanesce.dataset.archive import header_fault, open_shard
from evanesce.dataset.config import CHANNELS
from evanesce.dataset.encode import decode_exr, decode_png
from evanesce.dataset.job import Job, load_job
from evanesce.dataset.labels import LabelBox
from evanesce.dataset.manifest import Manifest
from evanesce.dataset.produce import Made, Producer
from evanesce.dataset.shard import Member

MAX_MEMBER_BYTES = 2_000_000_000


class Sample:
    """One frame; each part is read and decoded on first access.

    Parameters
    ----------
    row : dict
        The frame's row of the manifest.
    members : mapping
        By name, whatever ``read`` takes: places in a shard (:class:`~evanesce.dataset.shard.Member`), or the bytes.
    read : callable
        ``read(member) -> bytes``.
    compute : callable, optional
        ``compute() -> Made``: the labels of the frame, where they are not stored.

    Attributes
    ----------
    row : dict
    key : str
    """

    def __init__(
        self,
        row: dict[str, Any],
        members: Mapping[str, Any],
        read: Callable[[Any], bytes],
        compute: Callable[[], Made] | None = None,
    ) -> None:
        self.row, self.key, self._members, self._read, self._compute = row, str(row["key"]), members, read, compute

    def bytes_of(self, name: str) -> bytes:
        """Return a member's bytes, e.g. of ``frame.png``.

        Raises
        ------
        KeyError
            If the frame has no such member.
        """
        return self._read(self._members[name])

    @property
    def members(self) -> tuple[str, ...]:
        """Names of the members."""
        return tuple(self._members)

    @cached_property
    def frame(self) -> NDArray[np.uint8]:
        """8-bit frame (rows, cols), of a colour camera (rows, cols, 3) [DN]."""
        return decode_png(self.bytes_of("frame.png"))

    @cached_property
    def raw(self) -> NDArray[np.uint16] | None:
        """Raw frame (rows, cols) [DN]; None where it was not stored."""
        return decode_png(self.bytes_of("raw.png")) if "raw.png" in self._members else None

    @cached_property
    def state(self) -> NDArray[np.uint8]:
        """Surface state of each pixel (rows, cols): 0 none, 1 near, 2 stick, 3 slip."""
        return decode_png(self.bytes_of("mask.png"))

    @cached_property
    def labels(self) -> LabelBox:
        """Labels in the distorted frame: as they are stored, all of them, or computed again."""
        stored = self._stored("labels.exr")
        return stored[0] if stored else self._made.seen

    @cached_property
    def plate(self) -> LabelBox:
        """Labels on the undistorted plate plane: as they are stored, all of them, or computed again."""
        stored = self._stored("plate.exr")
        return stored[0] if stored else self._made.plate

    @property
    def plate_geometry(self) -> tuple[float, float, float]:
        """Pitch of the grid of :attr:`plate`, x and y of its first sample [mm]."""
        stored = self._stored("plate.exr")
        if stored is None:
            grid = self._made.plate_grid
            return grid.pitch, float(grid.x[0]), float(grid.y[0])
        geometry = stored[1]["geometry"]
        return float(geometry["pitch_mm"]), float(geometry["x0_mm"]), float(geometry["y0_mm"])

    def _stored(self, name: str) -> tuple[LabelBox, dict[str, Any]] | None:
        """Return stored labels and their header; None where some channel is not stored."""
        if name not in self._members:
            return None
        found = decode_exr(self.bytes_of(name))
        return found if found[0].channels.keys() == CHANNELS.keys() or self._compute is None else None

    @cached_property
    def _made(self) -> Made:
        if self._compute is None:
            raise InputError("labels that are not stored, in a frame without its data set", key=self.key)
        return self._compute()

    @cached_property
    def meta(self) -> dict[str, Any]:
        """All numbers of the frame and its trial."""
        found: dict[str, Any] = json.loads(self.bytes_of("json"))
        return found

    @property
    def scalars(self) -> dict[str, float]:
        """The frame's numbers, units in the keys."""
        found: dict[str, float] = self.meta["scalars"]
        return found


@dataclass(frozen=True)
class _Frame:
    row: dict[str, Any]
    members: dict[str, Member]


class Dataset(Sequence[Sample]):
    """The finished frames of a dataset, in order.

    Parameters
    ----------
    folder : Path
    split : str, optional
        Only ``train``, ``validation`` or ``test``.
    check : bool
        Compare each member with its SHA-256 when it is read.
    any_versions : bool
        Make labels that are not stored again although packages changed, so that they may differ.

    Attributes
    ----------
    complete : bool
        Whether all shards are there and the manifest is sealed.
    quarantined : int
        Frames of the whole dataset that could not be made.

    Raises
    ------
    InputError
        If the folder holds no dataset.
    """

    def __init__(
        self, folder: Path, *, split: str | None = None, check: bool = False, any_versions: bool = False
    ) -> None:
        if split not in (None, "train", "validation", "test"):
            raise InputError(f"{split!r}", key="split", allowed="train, validation, test")
        self.folder, self.split, self.check, self.any_versions = folder, split, check, any_versions
        self.job: Job = load_job(folder)
        manifest = Manifest.open(folder / layout.MANIFEST)
        try:
            self._files = {shard: _shard_file(folder, row["file"]) for shard, row in manifest.shards().items()}
            rows = [row for row in manifest.frames() if split is None or row["split"] == split]
            members = manifest.all_members()
            self.complete = manifest.meta().get("sealed") == "1"
            self.quarantined = len(manifest.quarantined())
        finally:
            manifest.close()
        if wrong := [row["key"] for row in rows if row["key"] != layout.frame_key(row["frame"])]:
            raise InputError(f"names the frame {wrong[0]!r}", file=folder / layout.MANIFEST, allowed="nine digits")
        self._frames = [_Frame(row, members.get(row["frame"], {})) for row in rows]
        self._handles: dict[int, int] = {}
        self._owner, self._producer = os.getpid(), cast(Producer | None, None)

    def __len__(self) -> int:
        return len(self._frames)

    @overload
    def __getitem__(self, index: int) -> Sample: ...
    @overload
    def __getitem__(self, index: slice) -> list[Sample]: ...
    def __getitem__(self, index: int | slice) -> Sample | list[Sample]:
        if isinstance(index, slice):
            return [self[i] for i in range(*index.indices(len(self)))]
        entry = self._frames[index]
        number = int(entry.row["frame"])
        return Sample(
            entry.row, entry.members, lambda m: self._read(entry.row["shard"], m), lambda: self.computed(number)
        )

    def computed(self, frame: int) -> Made:
        """Return the labels of a frame, made again from the data set's description.

        Raises
        ------
        InputError
            If the data set is of other versions, whose labels may be others.
        """
        if self._producer is None:
            self._producer = Producer(load_job(self.folder, check_versions=not self.any_versions))
        return self._producer.make(frame, exposed=False)

    def trials(self) -> dict[int, list[int]]:
        """Return the indices of each trial's frames, in order of time."""
        found: dict[int, list[int]] = {}
        for i, entry in enumerate(self._frames):
            found.setdefault(entry.row["trial"], []).append(i)
        return found

    def rows(self) -> list[dict[str, Any]]:
        """Return the manifest's rows of the frames."""
        return [dict(entry.row) for entry in self._frames]

    def _read(self, shard: int, member: Member) -> bytes:
        if not 0 <= member.size <= MAX_MEMBER_BYTES:
            raise InputError(f"a member of {member.size} bytes", file=self._files[shard])
        if self._owner != os.getpid():  # another process must not share the file position
            self._handles, self._owner = {}, os.getpid()
        if shard not in self._handles:
            try:
                self._handles[shard] = open_shard(self.folder, self._files[shard].name)
            except OSError as error:
                raise InputError(f"cannot read: {error.strerror}", file=self._files[shard]) from None
        if fault := header_fault(self._handles[shard], member):
            raise InputError(f"refused: {fault}", file=self._files[shard])
        data = os.pread(self._handles[shard], member.size, member.offset)
        broken = len(data) < member.size or (self.check and hashlib.sha256(data).hexdigest() != member.sha256)
        if broken:
            name = f"{layout.frame_key(member.frame)}.{member.name}"
            raise InputError("does not match the manifest", file=self._files[shard], key=name)
        return data

    def close(self) -> None:
        """Close the shards."""
        for handle in self._handles.values():
            os.close(handle)
        self._handles = {}

    def __enter__(self) -> Dataset:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_handles": {}, "_producer": None}


def open(path: str | Path, *, split: str | None = None, check: bool = False) -> Dataset:
    """Open a dataset; see :class:`Dataset`."""
    return Dataset(Path(path), split=split, check=check)


def _shard_file(folder: Path, name: str) -> Path:
    if not layout.is_shard_name(name):
        raise InputError(f"names the shard {name!r}", file=folder / layout.MANIFEST, allowed="shard-NNNNNN.tar")
    return folder / layout.SHARDS / name
