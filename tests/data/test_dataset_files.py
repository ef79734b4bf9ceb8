"""Shards, manifest, reader, verify and exports, on frames that are made of their numbers alone."""

from __future__ import annotations

import contextlib
import gc
import hashlib
import json
import logging
import shutil
import sqlite3
import subprocess
import tarfile
import threading
import warnings
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import cv2
import jsonschema
import numpy as np
import pytest
from distributed import LocalCluster
from typer.testing import CliRunner

import evanesce.dataset as dataset
from evanesce.cli.app import app
from evanesce.core import provenance
from evanesce.core.errors import InputError, WorkError
from evanesce.dataset import baselines, layout, run, worker
from evanesce.dataset.config import CHANNELS
from evanesce.dataset.data_card import _effects, schema
from evanesce.dataset.encode import decode_exr, decode_png, decoded, exr
from evanesce.dataset.export import FORMATS, export
from evanesce.dataset.info import describe, effects
from evanesce.dataset.labels import LabelBox
from evanesce.dataset.manifest import Manifest
from evanesce.dataset.numbers import SCALARS
from evanesce.dataset.randomisation import NOT_DRAWN
from evanesce.dataset.run import Deaths, Engine, make, resume
from evanesce.dataset.verify import checksums, verify
from support.datasets import PaperProducer, contents, paper_frames, paper_meta, tiny_job

paper = pytest.fixture(autouse=True)(paper_frames)


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> Path:
    """A finished dataset of 24 frames; not to be changed."""
    folder = tmp_path_factory.mktemp("whole") / "d"
    with contextlib.contextmanager(paper_frames)():
        outcome = make(folder, tiny_job())
    assert outcome.complete
    assert (outcome.frames, outcome.made) == (24, 24)
    return folder


def test_labels_come_back_from_exr():
    rng = np.random.default_rng(3)
    box = LabelBox(5, 2, (31, 17), {n: rng.standard_normal((9, 11)).astype(np.float32) for n in CHANNELS})
    for precision, relative in (("half", 2.0**-11), ("float", 0.0)):
        back, header = decode_exr(exr(box, precision, {"scalars": {"Fz_N": 1.25}}))
        assert (back.row, back.col, back.shape) == (5, 2, (31, 17))
        for name in CHANNELS:
            np.testing.assert_allclose(back.channels[name], box.channels[name], rtol=relative, atol=1e-7)
        assert header["units"] == CHANNELS
        assert header["scalars"] == {"Fz_N": 1.25}
    assert np.isnan(back.whole("gap")[0, 0])
    assert back.whole("pressure")[0, 0] == 0.0
    assert back.whole("slip.x")[5 + 3, 2 + 7] == back.channels["slip.x"][3, 7]


def test_shards_are_what_plain_tar_and_sqlite_tools_see(whole):
    listed = subprocess.run(["tar", "-tvf", layout.shard_path(whole, 1)], capture_output=True, text=True, check=True)
    names = [line.split()[-1] for line in listed.stdout.splitlines()]
    assert names[:2] == ["000000006.frame.png", "000000006.labels.exr"]
    assert len(names) == 6 * 5
    manifest = Manifest.open(whole / "manifest.sqlite")
    data = layout.shard_path(whole, 1).read_bytes()
    with tarfile.open(layout.shard_path(whole, 1)) as tar:
        for info in tar:
            member = manifest.members(int(info.name[:9]))[info.name[10:]]
            assert (member.offset, member.size) == (info.offset_data, info.size)
            assert data[member.offset : member.offset + member.size] == tar.extractfile(info).read()
            assert (info.mtime, info.uid, info.uname) == (0, 0, "")
    manifest.close()


def test_checksums_are_those_of_sha256sum(whole):
    done = subprocess.run(["sha256sum", "-c", "--quiet", "SHA256SUMS"], cwd=whole, capture_output=True, check=False)
    assert done.returncode == 0, done.stderr


def test_random_access_gives_what_was_made(whole):
    producer = PaperProducer(tiny_job())
    with dataset.open(whole, check=True) as data:
        assert len(data) == 24
        for i in (17, 0, 23, 5):
            record = producer.record(i)
            for name, value in record.members.items():
                assert data[i].bytes_of(name) == value
        assert data[-1].key == "000000023"
        assert data[3].raw is None
        np.testing.assert_array_equal(data[4].frame, decode_png(producer.record(4).members["frame.png"]))
        assert data[5].labels.channels["gap"].size == 0
        assert data[5].labels.whole("contact_mask").sum() == 0
        assert [len(v) for v in data.trials().values()] == [6, 6, 6, 6]
    with dataset.open(whole, split="test") as test:
        assert [row["trial"] for row in test.rows()] == [2] * 6


def test_meta_follows_the_schema(whole):
    assert json.loads((whole / "schema.json").read_text()) == schema()
    with dataset.open(whole) as data:
        for sample in data:
            jsonschema.validate(sample.meta, schema())
    broken = {**paper_meta(tiny_job(), 3, 0), "split": "frame"}
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate(broken, schema())


def test_the_data_card_names_every_shard(whole):
    card = json.loads((whole / "croissant.json").read_text())
    files = {f["@id"]: f for f in card["distribution"] if f["@type"] == "cr:FileObject"}
    assert all(name.startswith("http://mlcommons.org/croissant/") for name in card["conformsTo"])
    assert set(files) == {f"shard-{i:06d}.tar" for i in range(4)}
    for name, entry in files.items():
        assert (whole / entry["contentUrl"]).stat().st_size == int(entry["contentSize"].split()[0])
        assert name in (whole / "SHA256SUMS").read_text()
    fields = {
        f["name"].removeprefix("frames/"): f["source"]["transform"]["jsonPath"]
        for f in card["recordSet"][0]["field"] if "jsonPath" in f["source"].get("transform", {})
    }  # fmt: skip
    assert set(fields) == {*SCALARS, "index", "trial", "kind", "split"}
    with dataset.open(whole) as data:
        for path in fields.values():  # each leads somewhere in a frame's numbers
            value = data[7].meta
            for key in path.removeprefix("$.").split("."):
                value = value[key]
    assert "No effects are randomised." in card["description"]
    job = tiny_job(randomisation={"probability": 0.2, "without": ("specks",)})
    assert "in 20 % of the rigs: adhesion, ambient_light, " in _effects(job)
    drawn, not_drawn = _effects(job).split("Not drawn: ")
    for name in ("specks (by this configuration)", "square_size (not observable", "distortion_drift (labels would"):
        assert name in not_drawn
        assert name.split()[0] not in drawn
    assert effects(job.config.randomisation)["share_of_rigs_with_an_effect"] == 0.2
    assert set(effects(job.config.randomisation)["effects_not_drawn"]) == {*NOT_DRAWN, "specks"}


@pytest.mark.filterwarnings("ignore")  # of another library
def test_croissants_own_library_reads_the_card(whole, tmp_path, monkeypatch):
    """Its validator finds no error; keys, numbers and images that it reads out of the archives are ours."""
    monkeypatch.setenv("CROISSANT_CACHE", str(tmp_path))  # it knows archives by their relative names
    croissant = pytest.importorskip("mlcroissant", reason="mlcroissant is not among the project's dependencies")
    found = croissant.Dataset(jsonld=str(whole / "croissant.json"))
    assert not found.metadata.ctx.issues.errors
    records = {r["frames/key"]: r["frames/numbers"] for r in found.records("frames")}
    shown = {r["images/key"]: r["images/frame"] for r in found.records("images")}
    with dataset.open(whole) as data:
        for sample in data:
            key = sample.key.encode()
            assert json.loads(records.pop(key)) == sample.meta
            np.testing.assert_array_equal(np.asarray(shown.pop(key)), sample.frame)
    assert not records
    assert not shown


def test_card_and_page_tell_the_baselines_as_they_were_measured(whole):
    """Figures of one recorded run, in the data card and in the table of docs/reference/dataset.md."""
    card = json.loads((whole / "croissant.json").read_text())["rai:dataUseCases"]
    page = (Path(__file__).resolve().parents[2] / "docs" / "reference" / "dataset.md").read_text(encoding="utf-8")
    page = page.replace(" ± ", "±")
    run = json.loads(baselines.RECORD.read_text(encoding="utf-8"))
    for name, by_test in run["results"].items():
        for test, found in by_test.items():
            assert f"{found['mae']:.3f}" in card, (name, test)
            row = (
                f"| {found['mae']:.3f}±{found['mae_standard']:.3f} | {round(found['detected'] * found['slides'])} of"
                f" {found['slides']} | {found['latency_s']:.3f} | {found['false_per_minute']:.1f} |"
            )
            if name != "frames, rigs without effects":  # in the card only
                assert row in page, (name, test)
    assert f"{run['trials']} training trials" in card


def test_webdataset_reads_the_shards(whole):
    webdataset = pytest.importorskip("webdataset")
    urls = [str(layout.shard_path(whole, i)) for i in range(4)]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ResourceWarning)  # its reader leaves files to the collector
        found = list(webdataset.WebDataset(urls, shardshuffle=False))
        gc.collect()
    assert [sample["__key__"] for sample in found] == [f"{i:09d}" for i in range(24)]
    with dataset.open(whole) as data:
        for sample, mine in zip(found, data, strict=True):
            assert {k for k in sample if not k.startswith("__")} == set(mine.members)
            for name in mine.members:
                assert sample[name] == mine.bytes_of(name)


def test_webdataset_decodes_masks_and_labels_as_they_are(whole):
    webdataset = pytest.importorskip("webdataset")
    urls = [str(layout.shard_path(whole, i)) for i in range(2)]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ResourceWarning)  # its reader leaves files to the collector
        found = list(webdataset.WebDataset(urls, shardshuffle=False).decode(decoded))
        gc.collect()
    with dataset.open(whole) as data:
        for sample, mine in zip(found, data, strict=False):
            assert sample["mask.png"].dtype == np.uint8
            np.testing.assert_array_equal(sample["mask.png"], mine.state)
            np.testing.assert_array_equal(sample["frame.png"], mine.frame)
            for name, box in (("labels.exr", mine.labels), ("plate.exr", mine.plate)):
                for channel in CHANNELS:
                    np.testing.assert_array_equal(sample[name].whole(channel), box.whole(channel))
            assert sample["json"]["scalars"] == mine.scalars
    assert len(found) == 12


@pytest.mark.parametrize("workers", [0, pytest.param(2, marks=pytest.mark.slow)])
def test_torch_loads_it(whole, workers):
    torch = pytest.importorskip("torch", reason="torch is an extra of its own: pip install -e '.[torch]'")
    from torch.utils.data import DataLoader

    from evanesce.dataset.torch import FrameDataset, FrameStream

    torch.set_num_threads(1)
    more = {"multiprocessing_context": "spawn"} if workers else {}
    loader = DataLoader(FrameDataset(whole), batch_size=5, shuffle=False, num_workers=workers, **more)
    indices = torch.cat([batch["index"] for batch in loader]).tolist()
    assert indices == list(range(24))
    stream = DataLoader(FrameStream(whole), batch_size=None, num_workers=workers, **more)
    seen = [item["index"] for item in stream]
    assert sorted(seen) == list(range(24))
    item = FrameDataset(whole)[7]
    with dataset.open(whole) as data:
        np.testing.assert_array_equal(item["frame"][0].numpy(), data[7].frame)
        np.testing.assert_array_equal(item["labels"][2].numpy(), data[7].labels.whole("pressure"))
        np.testing.assert_array_equal(item["state"].numpy(), data[7].state)
    assert item["labels"].shape == (len(CHANNELS), 12, 17)


def test_torch_is_not_imported_without_need(whole):
    code = f"import sys, evanesce.dataset as d; d.open({str(whole)!r})[0].frame; print('torch' in sys.modules)"
    import sys

    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"


# --- again, elsewhere, after a stop -----------------------------------------------------------------------------------


def test_a_second_make_is_the_same_bytes(whole, tmp_path):
    make(tmp_path / "again", tiny_job())
    assert contents(tmp_path / "again") == contents(whole)


def test_a_running_scheduler_makes_the_same_bytes(whole, tmp_path):
    """``--scheduler``: the cluster was started elsewhere, goes on afterwards, and gets no arrays."""
    with LocalCluster(
        n_workers=1, threads_per_worker=1, processes=False, protocol="tcp", dashboard_address=None,
        scheduler_kwargs={"dashboard_address": "127.0.0.1:0"}, silence_logs=logging.ERROR,
    ) as cluster:  # fmt: skip
        outcome = make(tmp_path / "d", tiny_job(), Engine(scheduler=cluster.scheduler_address))
        assert len(cluster.scheduler.workers) == 1
    assert outcome.complete
    assert contents(tmp_path / "d") == contents(whole)


def test_threads_of_one_worker_share_no_producer(whole, tmp_path, monkeypatch):
    """A worker of an external scheduler may have several threads; two make their frames at the same moment here."""
    meet, used = threading.Barrier(2, timeout=30), set()

    class Watched(PaperProducer):
        def record(self, frame):
            used.add((threading.get_ident(), id(self)))
            meet.wait()
            return super().record(frame)

    make(tmp_path / "d", tiny_job(), Engine(part=(4, 4)))  # the folder and its last shard
    monkeypatch.setattr(worker, "Producer", Watched)
    with ThreadPoolExecutor(2) as pool:
        done = list(pool.map(lambda shard: worker.make_shard(str(tmp_path / "d"), shard), (0, 1)))
    assert [report["frames"] for report in done] == [6, 6]
    assert len({thread for thread, _ in used}) == len({producer for _, producer in used}) == len(used) == 2
    for shard in (0, 1):
        name = f"shards/{layout.shard_name(shard)}"
        assert (tmp_path / "d" / name).read_bytes() == (whole / name).read_bytes()


def test_a_worker_with_other_versions_is_refused(tmp_path, monkeypatch):
    """Tasks of this cluster run in threads of their own, and there numpy seems to be another one."""
    record = provenance.record

    def other_versions(**given):
        there = threading.current_thread() is not threading.main_thread()
        found = dict(record(**given))
        return {**found, "packages": {**found["packages"], "numpy": "1.0"}} if there else found

    monkeypatch.setattr(provenance, "record", other_versions)
    with LocalCluster(
        n_workers=1, threads_per_worker=1, processes=False, protocol="tcp", dashboard_address=None,
        scheduler_kwargs={"dashboard_address": "127.0.0.1:0"}, silence_logs=logging.ERROR,
    ) as cluster:  # fmt: skip
        engine = Engine(scheduler=cluster.scheduler_address)
        with pytest.raises(InputError, match=rf"begun with numpy {np.__version__} \(here 1\.0\)"):
            make(tmp_path / "d", tiny_job(frames=6), engine)
        assert list((tmp_path / "d" / "shards").iterdir()) == []
        assert resume(tmp_path / "d", engine, any_versions=True).complete


def test_parts_with_other_versions_or_another_request_do_not_join(tmp_path):
    folder = tmp_path / "d"
    make(folder, tiny_job(), Engine(part=(1, 2)))
    with pytest.raises(InputError, match=r"another dataset: config\.labels\.margin_mm differ"):
        make(folder, tiny_job(labels={"margin_mm": 0.7}), Engine(part=(2, 2)))
    text = (folder / "dataset.json").read_text()
    (folder / "dataset.json").write_text(text.replace(f'"numpy": "{np.__version__}"', '"numpy": "1.0"'))
    for refused in (lambda: make(folder, tiny_job(), Engine(part=(2, 2))), lambda: resume(folder)):
        with pytest.raises(InputError, match=rf"begun with numpy 1\.0 \(here {np.__version__}\)"):
            refused()
    assert [p.name for p in (folder / "shards").iterdir() if p.name == "shard-000001.tar"] == []


def test_a_part_of_a_finished_dataset_is_refused(whole, tmp_path):
    folder = copy(whole, tmp_path / "d")
    for refused in (
        lambda: make(folder, tiny_job(), Engine(part=(1, 2))), lambda: resume(folder, Engine(part=(2, 2))),
    ):  # fmt: skip
        with pytest.raises(InputError, match=r"--shard: the dataset is finished"):
            refused()
    assert contents(folder) == contents(whole)


def test_parts_of_a_job_array_are_the_same_bytes(whole, tmp_path):
    folder = tmp_path / "parts"
    for i in (3, 1, 2):
        outcome = make(folder, tiny_job(), Engine(part=(i, 3)))
        assert not outcome.complete
    assert not (folder / "manifest.sqlite").exists()
    assert resume(folder).made == 0
    assert contents(folder) == contents(whole)


class Stop(BaseException):
    """As a SIGKILL for one process: nothing is tidied that a finally does not tidy."""


@pytest.mark.parametrize("at", ["before shard 2", "row of shard 1", "index of shard 1", "seal", "data card"])
def test_resume_after_a_stop_is_byte_identical(whole, tmp_path, monkeypatch, at):
    folder, calls = tmp_path / "d", []
    module, name, when = {
        "before shard 2": (run, "make_shard", 3),
        "row of shard 1": (Manifest, "add", 2),
        "index of shard 1": (layout, "write_json", 3),
        "seal": (Manifest, "seal", 1),
        "data card": (run, "write_data_card", 1),
    }[at]
    real = getattr(module, name)

    def fake(*args, **kwargs):
        calls.append(name)
        if len(calls) == when:
            raise Stop
        return real(*args, **kwargs)

    monkeypatch.setattr(module, name, fake)
    with pytest.raises(Stop):
        make(folder, tiny_job())
    monkeypatch.setattr(module, name, real)
    if at != "data card":
        assert not (folder / "SHA256SUMS").exists()
    outcome = resume(folder)
    assert outcome.complete
    assert contents(folder) == contents(whole)


def test_a_finished_dataset_is_left_alone(whole):
    before = contents(whole)
    assert resume(whole).made == 0
    assert contents(whole) == before


def test_a_folder_with_something_else_is_refused(tmp_path, whole):
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(InputError, match=r"notes\.txt"):
        make(tmp_path, tiny_job())
    with pytest.raises(InputError, match="resume"):
        make(whole, tiny_job())
    with pytest.raises(InputError, match="no such file"):
        resume(tmp_path / "nothing")


def test_a_second_generator_is_refused(tmp_path):
    folder = tmp_path / "d"
    layout.make_folders(folder)
    with layout.generator_lock(folder), pytest.raises(WorkError, match="another generator"):
        make(folder, tiny_job())
    with layout.generator_lock(folder, (1, 2)):
        with pytest.raises(WorkError, match="another generator"):
            make(folder, tiny_job())
        with pytest.raises(WorkError, match="another generator"), layout.generator_lock(folder, (1, 2)):
            pass
        with layout.generator_lock(folder, (2, 2)):
            pass
    assert make(folder, tiny_job()).complete


def test_a_frame_that_raises_is_quarantined_and_the_others_finish(tmp_path, monkeypatch, whole):
    real = PaperProducer.record

    def sour(self, frame):
        if frame == 8:
            raise ValueError("the finger\nfolds")
        return real(self, frame)

    monkeypatch.setattr(PaperProducer, "record", sour)
    outcome = make(tmp_path / "d", tiny_job())
    assert [(q["frame"], q["reason"]) for q in outcome.quarantined] == [(8, "ValueError: the finger folds")]
    assert outcome.frames == 23
    report = verify(tmp_path / "d")
    assert report.good
    assert [q["frame"] for q in report.quarantined] == [8]
    there, here = contents(whole), contents(tmp_path / "d")
    assert all(here[f"shards/shard-{i:06d}.tar"] == there[f"shards/shard-{i:06d}.tar"] for i in (0, 2, 3))
    assert describe(tmp_path / "d")["quarantined"] == 1


@pytest.mark.parametrize("error", [ValueError("no light"), MemoryError()])
def test_a_shard_without_any_frame_is_named_and_the_others_finish(tmp_path, monkeypatch, whole, error):
    real, folder = PaperProducer.record, tmp_path / "d"

    def sour(self, frame):
        if frame // 6 == 1:
            raise error
        return real(self, frame)

    says = "no frame could be made: ValueError: no light" if error.args else "not enough memory for frame 000000006"
    there = contents(whole)
    monkeypatch.setattr(PaperProducer, "record", sour)
    reports: list[dict] = []
    for attempt in (lambda: make(folder, tiny_job(), on_shard=reports.append), lambda: resume(folder)):
        with pytest.raises(WorkError, match=rf"one shard missing.*`resume`.*: shard-000001\.tar: {says}$"):
            attempt()
        assert {n: d for n, d in contents(folder).items() if n.startswith("shards/")} == {
            f"shards/shard-{i:06d}.tar": there[f"shards/shard-{i:06d}.tar"] for i in (0, 2, 3)
        }
        assert not list((folder / ".work").glob("*.at"))  # nobody died
        assert not verify(folder).good
    assert [(r["shard"], bool(r["failed"])) for r in reports[1:]] == [(0, False), (1, True), (2, False), (3, False)]
    monkeypatch.setattr(PaperProducer, "record", real)
    assert resume(folder).made == 6
    assert contents(folder) == there


def test_a_part_without_any_frame_is_named_and_its_other_shards_finish(tmp_path, monkeypatch, whole):
    real, folder = PaperProducer.record, tmp_path / "d"

    def sour(self, frame):
        if frame < 6:
            raise ValueError("no light")
        return real(self, frame)

    monkeypatch.setattr(PaperProducer, "record", sour)
    with pytest.raises(WorkError, match=r"shard-000000\.tar: no frame could be made"):
        make(folder, tiny_job(), Engine(part=(1, 2)))
    assert [p.name for p in (folder / "shards").iterdir()] == ["shard-000002.tar"]
    monkeypatch.setattr(PaperProducer, "record", real)
    assert resume(folder).complete
    assert contents(folder) == contents(whole)


def test_only_deaths_in_a_row_at_one_frame_are_the_shards_own():
    deaths = Deaths()
    assert [deaths.count(3, frame) for frame in ("", "", "000000008", "000000008", "", "000000008")] == [
        1,
        2,
        1,
        2,
        1,
        1,
    ]
    assert [deaths.count(4, ""), deaths.count(3, "000000008")] == [1, 2]


def test_a_death_while_a_shard_is_published_is_no_frames(tmp_path, monkeypatch):
    """What a killed process leaves names the frame it made, and none once all are made."""
    folder, record, publish = tmp_path / "d", PaperProducer.record, worker.ShardWriter.publish
    made, published = [], []

    def seen_record(self, frame):
        made.append((frame, worker.Trace(folder, frame // 6).frame()))
        return record(self, frame)

    def seen_publish(self):
        published.append(worker.Trace(folder, len(published)).frame())
        return publish(self)

    monkeypatch.setattr(PaperProducer, "record", seen_record)
    monkeypatch.setattr(worker.ShardWriter, "publish", seen_publish)
    make(folder, tiny_job())
    assert made == [(frame, layout.frame_key(frame)) for frame in range(24)]
    assert published == ["", "", "", ""]


def test_frames_that_killed_are_doubted_where_none_is_left(tmp_path, monkeypatch, whole):
    """A shard all of whose frames kill their process is not made; `resume` tries each again, alone."""
    folder, deadly, probed = tmp_path / "d", set(range(6, 12)), []

    def probe(_folder, frame):
        probed.append(frame)
        return "the process that makes it dies of SIGSEGV" if frame in deadly else ""

    monkeypatch.setattr(worker, "probe", probe)
    layout.make_folders(folder)
    (folder / ".work" / "shard-000001.deaths").write_text(
        json.dumps({"deaths": {}, "fatal": {str(frame): "dies" for frame in deadly}})
    )
    with pytest.raises(WorkError, match=r"shard-000001\.tar: no frame could be made: dies$"):
        make(folder, tiny_job())
    assert probed == []
    with pytest.raises(WorkError, match=r"shard-000001\.tar: no frame could be made: the process.*SIGSEGV$"):
        resume(folder)
    assert sorted(probed) == sorted(deadly)
    deadly.clear()
    assert resume(folder).complete
    assert contents(folder) == contents(whole)


# --- damage -----------------------------------------------------------------------------------------------------------


def test_verify_finds_nothing_wrong(whole):
    report = verify(whole)
    assert report.good
    assert (report.frames, report.shards) == (24, 4)


def copy(whole: Path, folder: Path) -> Path:
    for name, data in contents(whole).items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(data)
    return folder


def damaged(folder: Path, rng: np.random.Generator) -> str:
    """Do one kind of damage; return what."""
    kind = rng.choice(["flip", "flip", "cut", "delete", "swap", "grow"])
    names = sorted(contents(folder))
    name = str(rng.choice(names))
    path = folder / name
    data = bytearray(path.read_bytes())
    if kind == "flip":
        data[rng.integers(len(data))] ^= 1 << int(rng.integers(8))
        path.write_bytes(data)
    elif kind == "cut":
        path.write_bytes(data[: rng.integers(len(data))])
    elif kind == "grow":
        path.write_bytes(data + b"\0")
    elif kind == "delete":
        path.unlink()
    else:
        a, b = (layout.shard_path(folder, int(i)) for i in rng.choice(4, 2, replace=False))
        first, second = a.read_bytes(), b.read_bytes()
        a.write_bytes(second)
        b.write_bytes(first)
    return f"{kind} {name}"


def noticed(folder: Path) -> bool:
    """Return whether ``verify`` reports a fault."""
    try:
        return not verify(folder, threads=1).good
    except InputError:
        return True


def test_no_damage_goes_unnoticed(whole, tmp_path):
    rng = np.random.default_rng(2024)
    good = contents(whole)
    folder = copy(whole, tmp_path / "d")
    unnoticed = []
    for _ in range(60):
        what = damaged(folder, rng)
        if contents(folder) != good and not noticed(folder):
            unnoticed.append(what)
        for name, data in good.items():
            if not (folder / name).is_file() or (folder / name).read_bytes() != data:
                (folder / name).write_bytes(data)
    assert unnoticed == []
    assert verify(folder).good


def test_verify_names_the_bad_frame(whole, tmp_path):
    folder = copy(whole, tmp_path / "d")
    manifest = Manifest.open(folder / "manifest.sqlite")
    member = manifest.members(15)["labels.exr"]
    manifest.close()
    path = layout.shard_path(folder, 2)
    data = bytearray(path.read_bytes())
    data[member.offset + member.size // 2] ^= 4
    path.write_bytes(data)
    report = verify(folder)
    assert report.bad_frames == ["000000015"]
    with dataset.open(folder, check=True) as opened:
        assert opened[14].meta["index"] == 14
        with pytest.raises(InputError, match=r"000000015\.labels\.exr"):
            _ = opened[15].labels
    path.unlink()
    assert verify(folder).bad_frames == [f"{i:09d}" for i in range(12, 18)]


def resealed(folder: Path, shard: int, data: bytes, **member: object) -> None:
    """Replace a shard and make every checksum match, as an attacker would;
    ``member`` changes columns of the manifest for the first frame's picture."""
    (folder / "SHA256SUMS").unlink()
    layout.shard_path(folder, shard).write_bytes(data)
    with contextlib.closing(sqlite3.connect(folder / "manifest.sqlite")) as db, db:
        digest = hashlib.sha256(data).hexdigest()
        db.execute("UPDATE shards SET size = ?, sha256 = ? WHERE shard = ?", (len(data), digest, shard))
        for column, value in member.items():
            db.execute(f"UPDATE members SET {column} = ? WHERE frame = 0 AND name = 'frame.png'", (value,))
    sealed_anew(folder)


def sealed_anew(folder: Path) -> None:
    manifest = Manifest.open(folder / "manifest.sqlite")
    content = manifest.content_digest()
    manifest.close()
    with contextlib.closing(sqlite3.connect(folder / "manifest.sqlite")) as db, db:
        db.execute("UPDATE meta SET value = ? WHERE name = 'content_sha256'", (content,))
    manifest = Manifest.open(folder / "manifest.sqlite")
    (folder / "SHA256SUMS").write_bytes(checksums(folder, manifest))
    manifest.close()


def with_header(data: bytes, **changes: object) -> bytes:
    """Return a shard whose first tar header is another, its own checksum included."""
    header = tarfile.TarInfo.frombuf(data[:512], "utf-8", "strict")
    for name, value in changes.items():
        setattr(header, name, value)
    return header.tobuf(tarfile.USTAR_FORMAT) + data[512:]


def refused(folder: Path, tmp_path: Path, frame: int | None = 0) -> None:
    """Assert that a dataset whose every checksum fits is refused by all that read it."""
    report = verify(folder)
    assert not report.good
    assert report.bad_frames == ([] if frame is None else [f"{frame:09d}"])
    assert all(fault.what.startswith("archive refused") for fault in report.faults), report.faults
    if frame is None:
        return
    with dataset.open(folder, check=True) as opened:
        assert opened[frame + 1].frame.shape == (12, 17)
        with pytest.raises(InputError, match="refused"):
            _ = opened[frame].frame
    for to in ("hdf5", "coco", "lerobot"):
        with pytest.raises(InputError, match="refused"):
            export(folder, tmp_path / to, to)
    assert [p.name for p in tmp_path.iterdir()] == [folder.name]


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        ("../../../tmp/evil.png", tarfile.REGTYPE),
        ("/tmp/000000000.frame.png", tarfile.REGTYPE),
        ("000000000.pickle", tarfile.REGTYPE),
        ("000000001.frame.png", tarfile.REGTYPE),
        ("000000000.frame.png", tarfile.SYMTYPE),
        ("000000000.frame.png", tarfile.LNKTYPE),
        ("000000000.frame.png", tarfile.FIFOTYPE),
    ],
)
def test_a_hostile_archive_is_refused(whole, tmp_path, name, kind):
    """A member is renamed or turned into a link, and all checksums are made to fit: only the name differs."""
    folder = copy(whole, tmp_path / "d")
    data = layout.shard_path(folder, 0).read_bytes()
    resealed(folder, 0, data)
    assert verify(folder).good
    resealed(folder, 0, with_header(data, name=name, type=kind, linkname="/etc/passwd"))
    refused(folder, tmp_path)


def test_a_size_that_the_archive_does_not_know_is_refused(whole, tmp_path):
    folder = copy(whole, tmp_path / "d")
    data = layout.shard_path(folder, 0).read_bytes()
    resealed(folder, 0, with_header(data, size=17))
    refused(folder, tmp_path)


def test_a_hostile_name_in_archive_and_manifest_is_refused(whole, tmp_path):
    folder = copy(whole, tmp_path / "d")
    data = layout.shard_path(folder, 0).read_bytes()
    resealed(folder, 0, with_header(data, name="000000000./../evil.png"), name="/../evil.png")
    assert verify(folder).bad_frames == ["000000000"]
    with dataset.open(folder) as opened, pytest.raises(InputError, match="the manifest names the member"):
        opened[0].bytes_of("/../evil.png")


def test_members_that_nobody_entered_are_refused(whole, tmp_path):
    """Behind the last member and between two: tar tools would unpack them, the manifest does not know them."""
    folder = copy(whole, tmp_path / "d")
    data = layout.shard_path(folder, 3).read_bytes()
    evil = tarfile.TarInfo("../evil.png").tobuf(tarfile.USTAR_FORMAT)
    manifest = Manifest.open(folder / "manifest.sqlite")
    last = manifest.members_of_shard(3)[-1]
    manifest.close()
    end = last.offset + -(-last.size // 512) * 512
    assert not any(data[end:])
    resealed(folder, 3, data[:end] + evil + data[end + 512 :])
    refused(folder, tmp_path, frame=None)
    folder = copy(whole, tmp_path / "e")
    data = layout.shard_path(folder, 0).read_bytes()
    resealed(folder, 0, evil + data)
    assert not verify(folder).good


def test_a_link_in_the_place_of_a_shard_is_refused(whole, tmp_path):
    folder, outside = copy(whole, tmp_path / "d"), tmp_path / "outside.tar"
    layout.shard_path(folder, 1).rename(outside)
    layout.shard_path(folder, 1).symlink_to(outside)
    assert verify(folder).bad_frames == [f"{i:09d}" for i in range(6, 12)]
    with dataset.open(folder) as opened:
        assert opened[5].frame.shape == (12, 17)
        with pytest.raises(InputError, match="a link, which is not followed"):
            _ = opened[6].frame
    with pytest.raises(InputError, match="not followed"):
        export(folder, tmp_path / "x", "coco")
    shards = copy(whole, tmp_path / "e") / "shards"
    shards.rename(tmp_path / "moved")
    shards.symlink_to(tmp_path / "moved")
    assert len(verify(tmp_path / "e").bad_frames) == 24
    with dataset.open(tmp_path / "e") as opened, pytest.raises(InputError, match="not followed"):
        _ = opened[0].frame


def test_a_frame_key_cannot_be_a_path(whole, tmp_path):
    """Exporters name files after keys."""
    folder = copy(whole, tmp_path / "d")
    with contextlib.closing(sqlite3.connect(folder / "manifest.sqlite")) as db, db:
        db.execute("UPDATE frames SET key = '../../evil' WHERE frame = 3")
    sealed_anew(folder)
    assert verify(folder).bad_frames == ["000000003"]
    with pytest.raises(InputError, match="allowed: nine digits"):
        dataset.open(folder)


def test_a_manifest_cannot_point_outside(whole, tmp_path):
    folder = copy(whole, tmp_path / "d")
    with sqlite3.connect(folder / "manifest.sqlite") as db:
        db.execute("UPDATE shards SET file = '../../secret.tar' WHERE shard = 0")
    db.close()
    with pytest.raises(InputError, match="allowed: shard-NNNNNN"):
        dataset.open(folder)


def test_a_cut_shard_is_an_error(whole, tmp_path):
    folder = copy(whole, tmp_path / "d")
    data = layout.shard_path(folder, 0).read_bytes()
    layout.shard_path(folder, 0).write_bytes(data[: len(data) // 2])
    with dataset.open(folder) as opened:
        assert opened[0].meta["index"] == 0
        with pytest.raises(InputError, match="refused"):
            _ = opened[5].meta


# --- other formats ----------------------------------------------------------------------------------------------------


def test_hdf5_reads_back_equal(whole, tmp_path):
    h5py = pytest.importorskip("h5py")
    assert export(whole, tmp_path / "x", "hdf5") == 24
    with h5py.File(tmp_path / "x" / "dataset.h5") as file, dataset.open(whole) as data:
        for i, sample in enumerate(data):
            np.testing.assert_array_equal(file["frame"][i], sample.frame)
            np.testing.assert_array_equal(file["state"][i], sample.state)
            for name in CHANNELS:
                np.testing.assert_array_equal(file[f"labels/{name}"][i], sample.labels.whole(name).astype(np.float16))
                np.testing.assert_array_equal(file[f"plate/{name}"][i], sample.plate.whole(name).astype(np.float16))
            assert json.loads(file["meta"][i]) == sample.meta
        assert file["labels/pressure"].attrs["unit"] == "MPa"
        assert file["scalars/Fz_N"][7] == data[7].scalars["Fz_N"]


def test_parquet_reads_back_equal(whole, tmp_path):
    pq = pytest.importorskip("pyarrow.parquet")
    export(whole, tmp_path / "x", "parquet")
    table = pq.read_table(tmp_path / "x" / "frames.parquet")
    rows = table.to_pylist()
    with dataset.open(whole) as data:
        for row, sample in zip(rows, data, strict=True):
            assert {name: row[name] for name in SCALARS} == sample.scalars
            assert (row["key"], row["onset_first_slip_s"], row["onset_gross_slip_s"]) == (sample.key, None, 0.25)
            assert row["friction.friction_coefficient"] == 0.7
    assert table.schema.field("Fz_N").metadata == {b"unit": b"N"}


@pytest.mark.filterwarnings("ignore::DeprecationWarning")  # of pycocotools
def test_coco_reads_back_equal(whole, tmp_path):
    masks = pytest.importorskip("pycocotools.mask")
    export(whole, tmp_path / "x", "coco", split="train")
    found = json.loads((tmp_path / "x" / "annotations.json").read_text())
    names = {c["id"]: c["name"] for c in found["categories"]}
    assert names == {1: "near", 2: "stick", 3: "slip"}
    with dataset.open(whole, split="train") as data:
        states = {row["frame"]: sample.state for row, sample in zip(data.rows(), data, strict=True)}
        for image in found["images"]:
            picture = cv2.imread(str(tmp_path / "x" / "images" / image["file_name"]), cv2.IMREAD_UNCHANGED)
            assert picture.shape == (image["height"], image["width"])
    seen = {i: np.zeros_like(s) for i, s in states.items()}
    for a in found["annotations"]:
        rle = masks.frPyObjects(a["segmentation"], *a["segmentation"]["size"])
        mask = masks.decode(rle).astype(bool)
        assert mask.sum() == a["area"] == masks.area(rle)
        np.testing.assert_array_equal(masks.toBbox(rle), a["bbox"])
        seen[a["image_id"]][mask] = a["category_id"]
    for i, state in states.items():
        np.testing.assert_array_equal(seen[i], state)


def test_lerobot_reads_back_equal(whole, tmp_path):
    pq = pytest.importorskip("pyarrow.parquet")
    from evanesce.dataset.export_lerobot import LABELS, STATE

    root = tmp_path / "x"
    export(whole, root, "lerobot")
    info = json.loads((root / "meta" / "info.json").read_text())
    assert (info["codebase_version"], info["total_frames"], info["total_episodes"]) == ("v3.0", 24, 4)
    episodes = pq.read_table(root / "meta/episodes/chunk-000/file-000.parquet").to_pylist()
    tasks = pq.read_table(root / "meta/tasks.parquet").to_pandas()
    assert list(tasks.index) == ["slide"]
    stats = json.loads((root / "meta" / "stats.json").read_text())
    with dataset.open(whole) as data:
        assert info["splits"] == {"train": "0:3", "test": "3:4"}
        assert [(e["trial"], e["split"]) for e in episodes] == [(0, "train"), (1, "train"), (3, "train"), (2, "test")]
        for e in episodes:
            path = info["data_path"].format(chunk_index=e["data/chunk_index"], file_index=e["data/file_index"])
            rows = pq.read_table(root / path).to_pylist()
            for i in range(e["dataset_from_index"], e["dataset_to_index"]):
                row, sample = rows[i], data[6 * e["trial"] + i % 6]
                assert sample.row["split"] == e["split"]
                assert (row["index"], row["episode_index"], row["frame_index"]) == (i, e["episode_index"], i % 6)
                image = decode_png(row["observation.images.tactile"]["bytes"])
                np.testing.assert_array_equal(image, np.repeat(sample.frame[..., None], 3, axis=2))
                mask = decode_png(row["labels.surface_state"]["bytes"])
                np.testing.assert_array_equal(mask, np.repeat(sample.state[..., None], 3, axis=2))
                labels = [np.float32(sample.scalars[name]) for name in LABELS]
                np.testing.assert_array_equal(np.float32(row["labels"]), labels)
                assert np.float32(row["observation.state"][0]) == np.float32(sample.scalars["drive_mm"])
                after = data[6 * e["trial"] + min(i % 6 + 1, 5)]
                assert np.float32(row["action"][0]) == np.float32(after.scalars["drive_mm"])
        every = np.array([[s.scalars[n] for n in LABELS] for s in data])
        np.testing.assert_allclose(stats["labels"]["mean"], every.mean(0), rtol=1e-9)
        np.testing.assert_allclose(stats["labels"]["std"], every.std(0), rtol=1e-6)
    assert set(info["features"]) <= set(rows[0])
    # what only the simulation knows is no observation
    assert STATE == ("drive_mm",)
    assert {name for name in info["features"] if name.startswith("observation")} == {
        "observation.images.tactile", "observation.state",
    }  # fmt: skip
    assert set(STATE) | set(LABELS) | {"time_s"} == set(SCALARS)


def test_lerobots_own_loader_reads_the_export(whole, tmp_path):
    loader = pytest.importorskip("lerobot.datasets.lerobot_dataset")
    export(whole, tmp_path / "x", "lerobot")
    found = loader.LeRobotDataset("local/x", root=tmp_path / "x")
    assert (found.num_episodes, found.num_frames) == (4, 24)
    item = found[7]
    with dataset.open(whole) as data:
        assert tuple(item["observation.images.tactile"].shape) == (3, *data[7].frame.shape)
        np.testing.assert_allclose(np.asarray(item["observation.images.tactile"])[0] * 255.0, data[7].frame, atol=1e-3)
        np.testing.assert_allclose(np.asarray(item["observation.state"]), [data[7].scalars["drive_mm"]], rtol=1e-6)


def test_a_damaged_member_is_not_exported(whole, tmp_path):
    """Rationale: one digit of a number changed on disk went into a format that has no checksums."""
    copy = tmp_path / "d"
    shutil.copytree(whole, copy)
    with dataset.open(copy) as data:
        entry = data._frames[7]
        path, member = data._files[entry.row["shard"]], entry.members["json"]
    content = bytearray(path.read_bytes())
    at = content.index(b"Fz_N", member.offset) + 7
    assert at < member.offset + member.size
    content[at] = ord("9") if content[at] != ord("9") else ord("8")
    path.write_bytes(content)
    for to in ("parquet", "hdf5", "lerobot"):
        with pytest.raises(InputError, match="does not match the manifest"):
            export(copy, tmp_path / "x", to)
        assert not (tmp_path / "x").exists()


def test_commands_look_at_shards_without_following_links(whole, tmp_path, monkeypatch):
    """Rationale: a bar's total followed a link that points nowhere, and `resume` of a finished dataset asked for the
    space that an estimate of its size leaves over."""
    copy = tmp_path / "d"
    shutil.copytree(whole, copy)
    usage = shutil.disk_usage(tmp_path)._replace(free=0)
    monkeypatch.setattr(shutil, "disk_usage", lambda path: usage)
    done = CliRunner().invoke(app, ["dataset", "resume", str(copy), "--workers", "0"])
    assert done.exit_code == 0, done.output + done.stderr
    shard = min((copy / "shards").glob("*.tar"))
    shard.unlink()
    shard.symlink_to(tmp_path / "nowhere")
    done = CliRunner().invoke(app, ["dataset", "verify", str(copy)])
    assert done.exit_code == 1
    assert shard.name in done.output
    assert isinstance(done.exception, SystemExit)


def test_an_unfinished_dataset_is_exported_only_on_demand(tmp_path):
    pq = pytest.importorskip("pyarrow.parquet")

    class Stop(Exception):
        pass

    seen = []

    def stop(report):
        seen.append(report)
        if len(seen) == 3:
            raise Stop

    with pytest.raises(Stop):
        make(tmp_path / "d", tiny_job(), on_shard=stop)
    with dataset.open(tmp_path / "d") as data:
        there = len(data)
        assert not data.complete
    assert 0 < there < 24
    with pytest.raises(InputError, match=f"not finished, {there} of 24 frames"):
        export(tmp_path / "d", tmp_path / "x", "parquet")
    assert export(tmp_path / "d", tmp_path / "x", "parquet", partial=True) == there
    assert pq.read_table(tmp_path / "x" / "frames.parquet").num_rows == there
    shown = CliRunner().invoke(app, ["dataset", "export", str(tmp_path / "d"), "--to", "hdf5"])
    assert shown.exit_code == 2
    assert "--partial" in shown.output + shown.stderr


def test_exports_refuse_what_they_cannot_do(whole, tmp_path):
    with pytest.raises(InputError, match="hdf5, lerobot, coco, parquet"):
        export(whole, tmp_path / "x", "tfrecord")
    with pytest.raises(InputError, match="exists"):
        export(whole, tmp_path, "parquet")
    assert FORMATS == ("hdf5", "lerobot", "coco", "parquet", "rrd", "mcap", "tiff")
    with pytest.raises(InputError, match="split that has some"):
        export(whole, tmp_path / "y", "parquet", split="validation")
    assert list(tmp_path.iterdir()) == []
