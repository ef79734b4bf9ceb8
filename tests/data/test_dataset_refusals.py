"""A system that refuses to write: full disks and I/O errors at every write, real ones where this machine allows."""

from __future__ import annotations

import contextlib
import errno
import os
import re
import shutil
import subprocess
import sys
import tempfile
import textwrap
from collections.abc import Iterator
from pathlib import Path

import pytest

from evanesce.core.errors import WorkError
from evanesce.dataset.info import describe
from evanesce.dataset.manifest import Manifest
from evanesce.dataset.read import Dataset
from evanesce.dataset.run import make, resume
from evanesce.dataset.verify import verify
from support.datasets import contents, paper_frames, tiny_job

TESTS = Path(__file__).resolve().parents[1]
FRAMES = 12
"""Two shards."""


paper = pytest.fixture(autouse=True)(paper_frames)


@pytest.fixture(scope="module")
def good(tmp_path_factory) -> dict[str, bytes]:
    """Every file of a dataset that nobody disturbed."""
    folder = tmp_path_factory.mktemp("good") / "d"
    with contextlib.contextmanager(paper_frames)():
        make(folder, tiny_job(frames=FRAMES))
    return contents(folder)


@pytest.fixture
def small_disk(tmp_path) -> Iterator[Path]:
    """A file system of its own in memory, to be made smaller and larger."""
    disk = tmp_path / "disk"
    disk.mkdir()
    if shutil.which("mount") is None:
        pytest.skip("no `mount` here")
    done = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=1m", "evanesce", disk], capture_output=True, text=True,
                          check=False)  # fmt: skip
    if done.returncode:
        pytest.skip(f"a tmpfs cannot be mounted here: {done.stderr.strip()}")
    try:
        yield disk
    finally:
        subprocess.run(["umount", "-l", disk], check=True)


@pytest.fixture
def memory(tmp_path) -> Iterator[Path]:
    """A folder in memory where there is one: hundreds of fsyncs of a disk take long, and fail alike."""
    shared = Path("/dev/shm")
    if not os.access(shared, os.W_OK):
        yield tmp_path
        return
    with tempfile.TemporaryDirectory(dir=shared, prefix="evanesce-") as folder:
        yield Path(folder)


def resize(disk: Path, kilobytes: int) -> None:
    subprocess.run(["mount", "-o", f"remount,size={kilobytes}k", disk], check=True)


def nothing_half(folder: Path, good: dict[str, bytes]) -> None:
    """Assert that what lies in a folder after a failure is whole: equal to the undisturbed, or not there."""
    found = contents(folder)
    assert not [name for name in found if name.endswith(".part")]
    published = ("shards/", "dataset.json", "schema.json", "croissant.json", "SHA256SUMS")
    assert {name: data for name, data in found.items() if name.startswith(published)}.items() <= good.items()
    if (folder / "manifest.sqlite").exists():
        manifest = Manifest.open(folder / "manifest.sqlite")
        assert manifest.fault() == ""
        manifest.close()


def test_a_disk_that_is_full_at_any_place(small_disk, good):
    """The disk holds less and less of a dataset; each time there is one line and nothing half-written, and more space
    lets `resume` end with the same bytes."""
    whole = sum(map(len, good.values())) // 1024
    refused = set()
    for space_kb in (0, 12, *range(32, 4 * whole, 36)):
        folder = small_disk / str(space_kb)
        resize(small_disk, max(space_kb, 4))
        try:
            assert make(folder, tiny_job(frames=FRAMES)).complete
        except WorkError as error:
            said = str(error)
            assert "\n" not in said
            assert re.search("cannot write: (No space left on device|database or disk is full|disk I/O error)", said)
            refused.add(said.split(": ")[0].removeprefix(f"{folder}"))
            resize(small_disk, 16 * 1024)
            if (folder / "dataset.json").exists():
                nothing_half(folder, good)
                assert resume(folder).complete
            else:
                make(folder, tiny_job(frames=FRAMES))
            assert contents(folder) == good
            shutil.rmtree(folder)
            continue
        break
    assert space_kb > whole // 2
    assert {"/dataset.json", "/shards/shard-000000.tar", "/shards/shard-000001.tar", "/manifest.sqlite"} <= refused


def test_a_read_only_folder_is_one_line_and_can_still_be_read(small_disk, good):
    """Made and resumed on a file system that was mounted anew, read-only: exit by one line, not a byte changed; what
    only reads goes on."""
    resize(small_disk, 16 * 1024)
    whole, half = small_disk / "whole", small_disk / "half"
    make(whole, tiny_job(frames=FRAMES))

    class Stop(Exception):
        pass

    def stop(report):
        raise Stop

    with pytest.raises(Stop):
        make(half, tiny_job(frames=FRAMES), on_shard=stop)
    before = contents(half)
    subprocess.run(["mount", "-o", "remount,ro", small_disk], check=True)
    try:
        for attempt in (lambda: make(small_disk / "new", tiny_job(frames=FRAMES)), lambda: resume(half)):
            with pytest.raises(WorkError, match=r"Read-only file system|readonly database") as caught:
                attempt()
            assert "\n" not in str(caught.value)
        assert contents(half) == before
        assert contents(whole) == good
        assert verify(whole).good
        with Dataset(whole, check=True) as data:
            assert len(data) == FRAMES
            assert data[3].frame.size
        assert describe(whole)["complete"]
    finally:
        subprocess.run(["mount", "-o", "remount,rw", small_disk], check=True)
    assert resume(half).complete
    assert contents(half) == good


@pytest.mark.parametrize("call", ["fsync", "replace"])
def test_an_input_output_error_at_any_place(memory, monkeypatch, good, call):
    """The device fails at the first, second, ... of all calls that make files last."""
    real, refused = getattr(os, call), set()
    for when in range(1, 200):
        folder, calls = memory / str(when), []

        def failing(*given, calls=calls, when=when, **more):
            calls.append(given)
            if len(calls) == when:
                raise OSError(errno.EIO, os.strerror(errno.EIO))
            return real(*given, **more)

        monkeypatch.setattr(os, call, failing)
        try:
            make(folder, tiny_job(frames=FRAMES))
        except WorkError as error:
            monkeypatch.setattr(os, call, real)
            said = str(error)
            assert said.endswith(": cannot write: Input/output error")
            refused.add(said.split(": ")[0].removeprefix(f"{folder}/"))
            nothing_half(folder, good)
            if (folder / "dataset.json").exists():
                assert resume(folder).complete
            else:
                make(folder, tiny_job(frames=FRAMES))
            assert contents(folder) == good
            continue
        break
    monkeypatch.setattr(os, call, real)
    assert len(calls) == when - 1 > 8  # the last went through
    assert refused >= {
        "dataset.json", "shards/shard-000001.tar", "manifest.sqlite", "schema.json", "croissant.json", "SHA256SUMS",
    }  # fmt: skip


@pytest.mark.slow
@pytest.mark.system
def test_the_kernel_refuses(tmp_path, good):
    """strace lets each fsync of the process fail, SQLite's own included, and the writes of its database."""
    if shutil.which("strace") is None:
        pytest.skip("no `strace` here")
    code = textwrap.dedent("""
        import sys
        from pathlib import Path
        from support.datasets import tiny_job, use_paper
        from evanesce.dataset.run import make, resume
        from evanesce.core.errors import EvanesceError
        use_paper()
        folder = Path(sys.argv[1])
        try:
            resume(folder) if (folder / "dataset.json").exists() else make(folder, tiny_job(frames=12))
        except EvanesceError as error:
            print(error)
            sys.exit(error.exit_code)
    """)
    given = {**os.environ, "PYTHONPATH": os.pathsep.join([str(TESTS), *(p for p in sys.path if p)])}
    seen = set()
    for call, error, counts in (("fsync,fdatasync", "EIO", range(1, 60, 3)), ("pwrite64", "ENOSPC", range(4, 90, 9))):
        for when in counts:
            folder = tmp_path / f"{call[:6]}-{when}"
            strace = ["strace", "-f", "--seccomp-bpf", "-o", os.devnull, "-e", f"trace={call}", "-e",
                      f"inject={call}:error={error}:when={when}"]  # fmt: skip
            done = subprocess.run([*strace, sys.executable, "-c", code, folder], env=given, capture_output=True,
                                  text=True, check=False)  # fmt: skip
            if "ptrace" in done.stderr:
                pytest.skip(f"strace may not trace here: {done.stderr.splitlines()[0]}")
            if done.returncode == 0:
                assert contents(folder) == good
                continue
            assert (done.returncode, done.stderr) == (1, ""), done.stderr
            assert re.fullmatch(r"\S+: cannot write: (Input/output error|No space left on device|disk I/O error|"
                                r"database or disk is full)\n", done.stdout)  # fmt: skip
            seen.add(done.stdout.split(": ")[-1].strip())
            nothing_half(folder, good)
            again = subprocess.run([sys.executable, "-c", code, folder], env=given, check=False, capture_output=True)
            assert again.returncode == 0, again.stderr
            assert contents(folder) == good
    assert "Input/output error" in seen
    assert seen & {"disk I/O error", "database or disk is full"}  # SQLite's own words
