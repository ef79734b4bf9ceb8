"""Datasets made by real processes: same bytes from any count of workers, kills, poison, full disks, command line."""

from __future__ import annotations

import contextlib
import json
import math
import os
import re
import resource
import signal
import subprocess
import sys
import textwrap
import time
from dataclasses import replace
from pathlib import Path

import cv2
import h5py
import numpy as np
import pytest
import tomli_w
from typer.testing import CliRunner

import evanesce.dataset as dataset
from evanesce.cli.app import app
from evanesce.dataset.audit import audit
from evanesce.dataset.estimate import estimate
from evanesce.dataset.export import export
from evanesce.dataset.job import save_job
from evanesce.dataset.produce import Producer
from evanesce.dataset.run import make
from evanesce.dataset.verify import verify
from evanesce.rig import dump_scene
from support.dataset_kills import campaign, environment
from support.datasets import contents, tiny_config, tiny_job
from support.rigs import small_rig

TESTS = Path(__file__).resolve().parents[1]
runner = CliRunner()


@pytest.fixture(scope="module")
def real(tmp_path_factory) -> Path:
    """Simulated frames, made in this process; not to be changed."""
    folder = tmp_path_factory.mktemp("real") / "d"
    make(folder, tiny_job())
    return folder


def python(code: str, **environment: str) -> subprocess.Popen:
    """Run code with the tests' helpers at hand; paper frames unless it says otherwise."""
    paths = os.pathsep.join([str(TESTS), os.environ.get("PYTHONPATH", "")])
    return subprocess.Popen(
        [sys.executable, "-c", textwrap.dedent(code)],
        env={**os.environ, "PYTHONPATH": paths, **environment},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


PAPER = """
    import sys
    from pathlib import Path
    from support.datasets import tiny_job, use_paper
    from evanesce.dataset.run import make, resume
    from evanesce.core.errors import EvanesceError
    use_paper()
    folder = Path({folder!r})
    try:
        {call}
    except EvanesceError as error:
        print(error)
        sys.exit(error.exit_code)
"""


def test_frames_hold_what_was_asked_for(real):
    with dataset.open(real, check=True) as data:
        assert len(data) == 24
        kinds = {data[i[0]].meta["kind"] for i in data.trials().values()}
        assert "slide" in kinds
        for sample in data:
            assert sample.frame.shape == sample.state.shape == sample.labels.shape == (48, 64)
            assert sample.plate.shape == (96, 96)
            if sample.scalars["Fz_N"] > 0.2:
                lit = float(np.median(sample.frame[sample.labels.whole("contact_mask") > 0.7]))
                dark = float(np.median(sample.frame[sample.labels.whole("contact_mask") == 0]))
                assert lit > dark + 20  # contacts are what shines
    assert verify(real).good


def test_the_audit_finds_nothing_wrong_in_simulated_frames(real):
    wrong = {f.name: (f.value, f.examples) for f in audit(real) if f.verdict == "wrong"}
    assert wrong == {}


def test_the_estimate_is_of_the_size_that_is_written(real):
    written = sum(path.stat().st_size for path in real.rglob("*") if path.is_file())
    assert written / 3 < estimate(tiny_job(), 2).size < written * 3


def test_subsurface_scattering_is_estimated_to_take_longer():
    def seconds(frames, *only):
        drawn = {"probability": 1.0 if only else 0.0, "only": only}
        return estimate(tiny_job(frames=frames, rig={"count": 2, "draw": {}}, randomisation=drawn), 1).seconds

    made = {only: seconds(600, *only) - seconds(60, *only) for only in ((), ("scratch",), ("lateral_glow",))}
    assert made["scratch",] == made[()]  # drawn once for a rig; its frames are as quick
    assert made["lateral_glow",] > 2 * made[()]


@pytest.mark.parametrize("per_shard", [3, 4])
def test_members_do_not_depend_on_the_size_of_shards(real, tmp_path, per_shard):
    make(tmp_path / "d", tiny_job(trials_per_shard=per_shard))
    with dataset.open(real) as one, dataset.open(tmp_path / "d") as other:
        assert {row["shard"] for row in other.rows()} == set(range(math.ceil(4 / per_shard)))
        assert len(one) == len(other) == 24
        for a, b in zip(one, other, strict=True):
            assert a.members == b.members
            for name in a.members:
                assert a.bytes_of(name) == b.bytes_of(name), (a.key, name)


LATE = ("black_level", "compression", "hot_pixels", "saturation", "tone_curve")
"""Effects that need no light fields of their own."""


@pytest.mark.parametrize(("only", "minimum"), [(LATE, 1), pytest.param((), 4, marks=pytest.mark.slow)])
def test_with_effects_members_do_not_depend_on_shards_and_order(tmp_path, only, minimum):
    """Rigs with effects, some of which are drawn anew for each frame; the second time frames are made backwards, by a
    new producer for each trial, as if each had a worker of its own."""
    drawn = {"probability": 0.4, "only": only}
    job = tiny_job(frames=12, randomisation=drawn, rig={"trials_in_a_row": 1})
    make(tmp_path / "d", replace(job, config=job.config.model_copy(update={"trials_per_shard": 2})))
    with dataset.open(tmp_path / "d", check=True) as data:
        on = [set(data[i].meta["rig"]["effects"]) - set(data[i].meta["rig"]["left_out"]) for i in (0, 6)]
        assert on[0] != on[1]
        assert min(map(len, on)) >= minimum
        for trial in (1, 0):
            producer = Producer(job)
            for frame in reversed(job.frames_of(trial)):
                again = producer.record(frame).members
                for name in data[frame].members:
                    assert data[frame].bytes_of(name) == again[name], (frame, name)


def test_raw_frames_are_twelve_bits_of_the_same_exposure(tmp_path):
    """Raw numbers are the mosaic over its black level; averaged over blocks they are the frame's, and finer. HDF5 gives
    them back."""

    def blocks(image):
        return image.astype(float).reshape(12, 4, 16, 4).mean(axis=(1, 3)).ravel()

    make(tmp_path / "d", tiny_job(frames=6, labels={"raw": True}))
    export(tmp_path / "d", tmp_path / "h", "hdf5")
    with dataset.open(tmp_path / "d", check=True) as data, h5py.File(tmp_path / "h" / "dataset.h5") as file:
        pairs, levels = [], set()
        for i, sample in enumerate(data):
            assert sample.raw.dtype == np.uint16
            assert sample.raw.shape == sample.frame.shape
            levels |= set(sample.raw.ravel().tolist())
            dull = blocks(sample.frame) < 200  # above, the frame is clipped
            pairs.append(np.stack([blocks(sample.frame), blocks(sample.raw)])[:, dull])
            np.testing.assert_array_equal(file["raw"][i], sample.raw)
    assert np.corrcoef(np.concatenate(pairs, axis=1))[0, 1] > 0.95  # not 1: clipping inside blocks, tone curve
    assert max(levels) <= 4095
    assert len(levels) > 256


@pytest.mark.slow
@pytest.mark.system
def test_two_workers_make_the_same_bytes(real, tmp_path):
    code = f"""
        from pathlib import Path
        from support.datasets import tiny_job
        from evanesce.dataset.run import Engine, make
        if __name__ == "__main__":
            make(Path({str(tmp_path / "d")!r}), tiny_job(), Engine(workers=2))
    """
    done = python(code)
    _, errors = done.communicate()
    assert done.returncode == 0, errors
    assert contents(tmp_path / "d") == contents(real)


@pytest.mark.slow
def test_a_killed_driver_resumes_to_the_same_bytes(tmp_path):
    reference = tmp_path / "reference"
    done = python(PAPER.format(folder=str(reference), call="make(folder, tiny_job(frames=60))"))
    assert done.wait() == 0, done.communicate()
    done.communicate()
    target = tmp_path / "target"
    for call, shards in (("make(folder, tiny_job(frames=60))", 2), ("resume(folder)", 6)):
        run = python(PAPER.format(folder=str(target), call=call), PAPER_PAUSE_S="0.02")
        deadline = time.monotonic() + 60
        while len(list((target / "shards").glob("*.tar"))) < shards and time.monotonic() < deadline:
            time.sleep(0.01)
        run.send_signal(signal.SIGKILL)
        run.communicate()
        assert run.returncode == -signal.SIGKILL
        assert not (target / "SHA256SUMS").exists()
    done = python(PAPER.format(folder=str(target), call="resume(folder)"))
    assert done.wait() == 0, done.communicate()
    done.communicate()
    assert contents(target) == contents(reference)


@pytest.mark.slow
def test_a_poison_frame_is_found_by_dying_of_it(tmp_path):
    target = tmp_path / "d"
    # The probe's process has to die of it, too: it runs what the interpreter's start-up makes of the worker.
    (tmp_path / "site").mkdir()
    (tmp_path / "site" / "sitecustomize.py").write_text(
        "import evanesce.dataset.worker, support.datasets\nsupport.datasets.use_paper()\n"
    )
    environment = {"PAPER_POISON": "8", "PYTHONPATH": os.pathsep.join([str(tmp_path / "site"), str(TESTS), *sys.path])}
    code = textwrap.dedent(PAPER.format(folder=str(target), call="make(folder, tiny_job())"))
    again = textwrap.dedent(PAPER.format(folder=str(target), call="resume(folder)"))
    codes = []
    for script in (code, again, again):
        done = subprocess.run([sys.executable, "-c", script], env={**os.environ, **environment}, check=False,
                              capture_output=True)  # fmt: skip
        codes.append(done.returncode)
    assert codes == [-signal.SIGABRT, -signal.SIGABRT, 0]
    report = verify(target)
    assert report.good
    assert [(q["frame"], "SIGABRT" in q["reason"]) for q in report.quarantined] == [(8, True)]
    assert report.frames == 23


@pytest.mark.slow
@pytest.mark.system
def test_a_probe_ends_with_its_driver(tmp_path):
    """Killed drivers leave no processes behind: a probe whose frame takes ten minutes is gone within seconds."""
    folder, (given, code) = tmp_path / "d", (environment(tmp_path, PAPER_PAUSE_S="600"), "probe(Path({!r}), 3)")
    folder.mkdir()
    save_job(folder, tiny_job(frames=6))
    script = "from pathlib import Path; from evanesce.dataset.worker import probe; " + code.format(str(folder))
    driver = subprocess.Popen([sys.executable, "-c", script], env=given)
    children = Path(f"/proc/{driver.pid}/task/{driver.pid}/children")
    until = time.monotonic() + 60.0
    while not (those := children.read_text().split()):
        assert time.monotonic() < until, "no probe was started"
        time.sleep(0.05)
    time.sleep(1.0)
    assert driver.poll() is None
    driver.kill()
    driver.wait()
    while Path(f"/proc/{those[0]}").exists():
        assert time.monotonic() < until + 60.0, "the probe outlives its driver"
        time.sleep(0.1)


@pytest.mark.slow
@pytest.mark.system
def test_a_poison_frame_among_the_clusters_workers(tmp_path):
    """The frame kills each worker that makes it: the others' shards are made, it is named, the rest is byte for byte
    what one process makes that cannot make this frame."""
    (tmp_path / "site").mkdir()
    (tmp_path / "site" / "sitecustomize.py").write_text(
        "import evanesce.dataset.worker, support.datasets\nsupport.datasets.use_paper()\n"
    )
    target = tmp_path / "d"
    script = tmp_path / "make.py"  # workers that are spawned read it again
    script.write_text(
        textwrap.dedent(f"""
            import sys
            from pathlib import Path
            from support.datasets import tiny_job
            from evanesce.dataset.run import Engine, make
            if __name__ == "__main__":
                outcome = make(Path({str(target)!r}), tiny_job(frames=36), Engine(workers=2))
                sys.exit(0 if outcome.complete else 1)
        """)
    )
    environment = {"PAPER_POISON": "8", "PYTHONPATH": os.pathsep.join([str(tmp_path / "site"), str(TESTS), *sys.path])}
    done = subprocess.run([sys.executable, str(script)], env={**os.environ, **environment}, check=False,
                          capture_output=True, text=True, timeout=300)  # fmt: skip
    assert done.returncode == 0, done.stderr
    report = verify(target)
    assert report.good
    assert [(q["frame"], "SIGABRT" in q["reason"]) for q in report.quarantined] == [(8, True)]
    assert report.frames == 35
    whole = tmp_path / "whole"
    run = python(PAPER.format(folder=str(whole), call="make(folder, tiny_job(frames=36))"))
    assert run.wait() == 0, run.communicate()
    run.communicate()
    ours, theirs = contents(target), contents(whole)
    shards = [f"shards/shard-{k:06d}.tar" for k in (0, 2, 3, 4, 5)]
    assert {name: ours[name] for name in shards} == {name: theirs[name] for name in shards}


@pytest.mark.slow
@pytest.mark.system
def test_poison_and_random_kills_together_end_with_all_other_frames(tmp_path):
    """A frame that kills its workers while others kill them at random, on a busy machine mostly while they start: more
    deaths than a shard is allowed in a row, though not in a row, and no kill costs more than one shard."""
    found = campaign(tmp_path, frames=36, kills=10, mean_s=4.0, seed=5, pause_s=0.15, poison="8", most=11)
    assert found.statuses[-1] == 0, found
    assert found.workers >= 5, found
    assert found.worst <= 1
    report = verify(tmp_path / "d")
    assert report.good
    assert [(q["frame"], "SIGABRT" in q["reason"]) for q in report.quarantined] == [(8, True)]
    assert report.frames == 35


@pytest.mark.slow
@pytest.mark.system
def test_a_trial_all_of_whose_frames_kill_does_not_stop_the_others(tmp_path):
    """Twelve deaths at six frames of one shard, four allowed at each: the shard is named, the others are there."""
    poison = ",".join(str(frame) for frame in range(6, 12))
    found = campaign(tmp_path, frames=24, kills=0, mean_s=1.0, seed=5, pause_s=0.0, poison=poison, most=4)
    assert found.statuses == [1], found
    assert "one shard missing" in found.said
    assert "shard-000001.tar: no frame could be made: the process that makes it dies of SIGABRT" in found.said
    assert sorted(p.name for p in (tmp_path / "d" / "shards").iterdir()) == [
        f"shard-{i:06d}.tar" for i in (0, 2, 3)
    ]  # fmt: skip
    healed = subprocess.run([sys.executable, str(tmp_path / "drive.py")], env=environment(tmp_path), check=False)
    assert healed.returncode == 0
    assert verify(tmp_path / "d").good
    assert verify(tmp_path / "d").frames == 24


@pytest.mark.slow
@pytest.mark.system
def test_killed_workers_and_drivers_cost_a_shard_each(tmp_path):
    """At random times, whatever they do: the same bytes, at most one shard of each killed worker made again, none of
    those that lived."""
    found = campaign(tmp_path, frames=90, kills=8, mean_s=3.0, seed=2, pause_s=0.5, driver_share=0.25)
    assert found.statuses[-1] == 0, found
    assert found.workers + found.drivers >= 4, found  # the making may be over before the last of them
    assert found.worst <= 1
    assert found.for_nothing == 0
    done = python(PAPER.format(folder=str(tmp_path / "whole"), call="make(folder, tiny_job(frames=90))"))
    assert done.wait() == 0, done.communicate()
    done.communicate()
    assert contents(tmp_path / "d") == contents(tmp_path / "whole")


@pytest.mark.slow  # 13 s each: processes start, and are left to end
@pytest.mark.system
@pytest.mark.parametrize("sent", [signal.SIGINT, signal.SIGTERM])
def test_a_stop_from_outside_is_quiet_and_leaves_nothing_behind(tmp_path, sent):
    """Ctrl-C reaches all processes of a terminal, SIGTERM the driver: no traceback of anyone, no process left."""
    target, script = tmp_path / "d", tmp_path / "make.py"
    script.write_text(
        textwrap.dedent(f"""
            import sys
            from pathlib import Path
            from support.datasets import tiny_job
            from evanesce.dataset.run import Engine, make
            if __name__ == "__main__":
                try:
                    make(Path({str(target)!r}), tiny_job(frames=6000), Engine(workers=2))
                except KeyboardInterrupt:
                    sys.exit(130)
        """)
    )
    paths = os.pathsep.join([str(TESTS), *sys.path])
    # A shell that runs the tests in the background ignores Ctrl-C, and its children inherit that.
    run = subprocess.Popen([sys.executable, str(script)], env={**os.environ, "PYTHONPATH": paths}, text=True,
                           stdout=subprocess.PIPE, stderr=subprocess.PIPE, start_new_session=True,
                           preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL))  # fmt: skip
    try:
        end = time.monotonic() + 120
        while not list((target / ".work").glob("*.at")) and time.monotonic() < end:
            assert run.poll() is None
            time.sleep(0.1)
        if sent == signal.SIGINT:
            os.killpg(run.pid, sent)
        else:
            os.kill(run.pid, sent)
        out, err = run.communicate(timeout=60)  # pipes that end: nobody holds them any more
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(run.pid, signal.SIGKILL)
    assert (run.returncode, out, err) == (128 + sent, "", "")


@pytest.mark.slow  # 13 s: processes start
def test_a_full_disk_publishes_nothing_half(tmp_path):
    target = tmp_path / "d"
    whole = tmp_path / "whole"
    done = python(PAPER.format(folder=str(whole), call="make(folder, tiny_job())"))
    assert done.wait() == 0
    done.communicate()
    size = (whole / "shards" / "shard-000000.tar").stat().st_size
    call = f"resource.setrlimit(resource.RLIMIT_FSIZE, ({size - 5000}, {size - 5000})); make(folder, tiny_job())"
    code = "import resource, signal\nsignal.signal(signal.SIGXFSZ, signal.SIG_IGN)\n" + textwrap.dedent(
        PAPER.format(folder=str(target), call=call)
    )
    run = python(code)
    out, _ = run.communicate()
    assert run.returncode == 1
    assert "cannot write: File too large" in out
    assert list((target / "shards").iterdir()) == []
    assert list((target / ".work").glob("*.part")) == []
    done = python(PAPER.format(folder=str(target), call="resume(folder)"))
    done.communicate()
    assert done.returncode == 0
    assert contents(target) == contents(whole)
    assert resource.getrlimit(resource.RLIMIT_FSIZE)[0] != size - 5000


def test_a_place_that_cannot_be_written_is_one_line():
    done = python(PAPER.format(folder="/proc/nowhere/d", call="make(folder, tiny_job())"))
    out, _ = done.communicate()
    assert done.returncode == 1
    assert out.startswith("/proc/nowhere/d: cannot write:")


# --- the command line -------------------------------------------------------------------------------------------------


@pytest.fixture
def asked(tmp_path) -> list[str]:
    (tmp_path / "rig.toml").write_text(dump_scene(small_rig()))
    (tmp_path / "d.toml").write_text(tomli_w.dumps(tiny_config().as_dict()))
    return [
        "dataset", "make", str(tmp_path / "rig.toml"), "--config", str(tmp_path / "d.toml"), "--n", "24",
        "--seed", "11", "--workers", "0",
    ]  # fmt: skip


@pytest.mark.system
def test_commands_from_make_to_export(asked, real, tmp_path):
    target = tmp_path / "made"
    report = tmp_path / "report.json"
    done = runner.invoke(app, [*asked, "--out", str(target), "--json", str(report)])
    assert done.exit_code == 0, done.output
    assert "24 frames in 4 trials, 4 shards; about" in done.output
    assert json.loads(report.read_text())["complete"] is True
    assert contents(target) == contents(real)
    assert runner.invoke(app, ["dataset", "verify", str(target)]).exit_code == 0
    assert runner.invoke(app, ["dataset", "resume", str(target), "--workers", "0"]).exit_code == 0
    done = runner.invoke(app, ["dataset", "info", str(target), "--json", str(report)])
    assert done.exit_code == 0
    assert json.loads(report.read_text())["frames"] == 24
    out = tmp_path / "p"
    assert runner.invoke(app, ["dataset", "export", str(target), "--to", "parquet", "--out", str(out)]).exit_code == 0
    assert (out / "frames.parquet").is_file()
    assert runner.invoke(app, ["dataset", "export", str(target), "--to", "parquet"]).exit_code == 0
    assert target.with_name(f"{target.name}-parquet").joinpath("frames.parquet").is_file()
    looked = runner.invoke(app, ["dataset", "preview", str(target), "--out", str(tmp_path / "look")])
    assert looked.exit_code == 0, looked.output
    sheet = cv2.imread(str(tmp_path / "look" / "contact_sheet.png"))
    assert sheet.shape[0] == 6 * 260
    assert (tmp_path / "look" / "trial.mp4").stat().st_size > 1000
    # the state is laid over in colour, in the right half of each tile
    assert (np.ptp(sheet.astype(int), axis=2) > 60).any()
    path = target / "shards" / "shard-000002.tar"
    data = bytearray(path.read_bytes())
    with dataset.open(target) as opened:
        data[opened._frames[13].members["frame.png"].offset + 40] ^= 1
    path.write_bytes(data)
    bad = runner.invoke(app, ["dataset", "verify", str(target)])
    assert bad.exit_code == 1
    assert "bad frame 000000013" in bad.output


@pytest.mark.parametrize(
    ("extra", "says"),
    [
        (["--n", "1000000000"], "1000000000 frames"),
        (["--seed", "-1"], "--seed"),
        (["--workers", "-2"], "--workers"),
        (["--shard", "4/3"], "--shard"),
        (["--shard", "a/b"], "i/n"),
        (["--scheduler", "here"], "tcp://HOST:PORT"),
        (["--config", "nowhere.toml"], "nowhere.toml"),
        (["--set", "camera.resolution_px=[10000,10000]"], "GB"),
    ],
)
def test_bad_requests_end_in_one_line(asked, tmp_path, extra, says):
    done = runner.invoke(app, [*asked, "--out", str(tmp_path / "x"), *extra])
    assert done.exit_code == 2, done.output
    assert says in done.output
    assert "Traceback" not in done.output
    assert not (tmp_path / "x").exists()


@pytest.mark.parametrize(
    "extra", [["--n", "1000000000"], ["--set", "camera.resolution_px=[40000,40000]"], ["--config", "wide.toml"]]
)
def test_absurd_requests_are_refused_before_anything_is_made(tmp_path, extra):
    """A process of its own, ended where it would begin to render."""
    (tmp_path / "wide.toml").write_text("[labels]\ngrid_samples = 8192\n")
    command = [Path(sys.executable).with_name("evanesce"), "dataset", "make", "thesis", "--out", "x", *extra]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False, timeout=60)
    assert done.returncode == 2, done.stderr
    assert re.fullmatch(r"error: .*(1000000000 frames|needs 112 GB|needs 21\.\d GB).*allowed: .*\n", done.stderr)
    assert not (tmp_path / "x").exists()


def test_a_dry_run_only_tells(asked, tmp_path):
    done = runner.invoke(app, [*asked, "--out", str(tmp_path / "x"), "--dry-run"])
    assert done.exit_code == 0
    assert not (tmp_path / "x").exists()


def test_parts_and_what_gathers_them(asked, real, tmp_path):
    target = tmp_path / "parts"
    for i in (1, 2):
        done = runner.invoke(app, [*asked, "--out", str(target), "--shard", f"{i}/2"])
        assert done.exit_code == 0, done.output
        assert "resume" in done.output
    assert runner.invoke(app, ["dataset", "resume", str(target), "--workers", "0"]).exit_code == 0
    assert contents(target) == contents(real)


def test_making_in_one_process_takes_one_thread(tmp_path):
    """Rationale: with ``--workers 0`` BLAS took a thread for each core, and twice the processor time."""
    import threadpoolctl

    with threadpoolctl.threadpool_limits(2):
        make(tmp_path / "d", tiny_job(6))
        pools = threadpoolctl.threadpool_info()
        assert {pool["num_threads"] for pool in pools} == {1}
        assert any(pool["user_api"] == "blas" for pool in pools)
