"""Open shards without trusting names: no link is followed, every tar header has to agree with the manifest."""

from __future__ import annotations

import errno
import os
import re
import stat
import tarfile
from collections.abc import Iterable, Iterator
from pathlib import Path

from evanesce.dataset import layout
from evanesce.dataset.shard import Member

BLOCK = tarfile.BLOCKSIZE
_MEMBER_NAME = re.compile(r"[0-9]{9}\.(frame\.png|raw\.png|labels\.exr|plate\.exr|mask\.png|json)")
_END = 2 * BLOCK + tarfile.RECORDSIZE
"""Maximum bytes after the last member: two empty blocks, padded to a full record."""


def open_shard(folder: Path, name: str) -> int:
    """Open a shard for reading and return its descriptor.

    Parameters
    ----------
    folder : Path
        The dataset's.
    name : str
        The shard's file.

    Raises
    ------
    OSError
        If it does not exist, if it or the folder of shards is a link, or if it is not a regular file.
    """
    for path in (folder / layout.SHARDS, folder / layout.SHARDS / name):
        if path.is_symlink():  # the flags below refuse it too, with a less clear message
            raise OSError(errno.ELOOP, "a link, which is not followed", str(path))
    directory = os.open(folder / layout.SHARDS, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
    try:
        # Without O_NONBLOCK opening a pipe instead of a shard would block.
        handle = os.open(name, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK, dir_fd=directory)
    finally:
        os.close(directory)
    if not stat.S_ISREG(os.fstat(handle).st_mode):
        os.close(handle)
        raise OSError(errno.EINVAL, "not a regular file")
    return handle


def header_fault(handle: int, member: Member) -> str:
    """Return what is wrong with the tar header before a member's bytes; empty if nothing.

    Parameters
    ----------
    handle : int
        Descriptor of the shard.
    member : Member
        Row of the manifest.
    """
    wanted = f"{layout.frame_key(member.frame)}.{member.name}"
    if _MEMBER_NAME.fullmatch(wanted) is None:
        return f"the manifest names the member {wanted[:80]!r}"
    if member.offset < BLOCK or member.offset % BLOCK:
        return f"the manifest puts {wanted} at {member.offset}"
    try:
        header = tarfile.TarInfo.frombuf(os.pread(handle, BLOCK, member.offset - BLOCK), "utf-8", "surrogateescape")
    except (tarfile.TarError, ValueError, OverflowError, OSError) as error:
        return f"no tar header before {wanted}: {error}"
    if header.type != tarfile.REGTYPE:
        return f"member {header.name[:80]!r} is not a regular file"
    if header.name != wanted:
        return f"member {header.name[:80]!r} instead of {wanted}"
    if header.size != member.size:
        return f"{wanted} has {header.size} bytes by its tar header, {member.size} by the manifest"
    return ""


def archive_faults(handle: int, members: Iterable[Member], size: int) -> Iterator[tuple[Member | None, str]]:
    """Check the tar headers of a shard; yield members that differ from the manifest, and bytes that it does not list.

    Parameters
    ----------
    handle : int
        Descriptor of the shard.
    members : iterable of Member
        All of the shard, by offset.
    size : int
        Of the shard [bytes].
    """
    end = 0
    for member in members:
        if member.offset != end + BLOCK:
            yield member, f"something else lies before {layout.frame_key(member.frame)}.{member.name}"
        if fault := header_fault(handle, member):
            yield member, fault
        end = member.offset + -(-member.size // BLOCK) * BLOCK
    if not 2 * BLOCK <= size - end <= _END or any(os.pread(handle, _END, end)):
        yield None, "something else follows the last member"
