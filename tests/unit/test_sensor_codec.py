"""Files: what is written comes back, with its times, or nothing is left behind."""

from __future__ import annotations

import csv
import subprocess
import sys
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from evanesce.core.errors import InputError, WorkError
from evanesce.core.states import Frame
from evanesce.sensor.codec import VideoCodec, VideoWriter, write_frames, write_png, write_video
from evanesce.sensor.pi_encoder import bit_rate

TIMES = [0.05, 0.0837, 0.1, 0.4, 0.401, 2.0]


def frames(times: list[float] = TIMES, shape: tuple[int, int] = (62, 98)) -> list[Frame]:
    rng = np.random.default_rng(8)
    smooth = cv2.GaussianBlur(rng.uniform(0, 255, (len(times), *shape)).transpose(1, 2, 0), (0, 0), 5).reshape(
        *shape, -1
    )
    smooth = (smooth - smooth.min()) / np.ptp(smooth) * 255
    return [
        Frame(
            data=smooth[..., i].astype(np.uint8),
            raw=rng.integers(0, 4096, shape, dtype=np.uint16),
            time=t,
            index=i,
        )
        for i, t in enumerate(times)
    ]


def decode(path: Path) -> tuple[list[float], list[np.ndarray]]:
    with av.open(str(path)) as container:
        decoded = [
            (float((f.pts or 0) * Fraction(f.time_base or 0)), f.to_ndarray(format="rgb24"))
            for f in container.decode(video=0)
        ]
    return [t for t, _ in decoded], [image for _, image in decoded]


@settings(deadline=None, max_examples=20)
@given(st.sampled_from([np.uint8, np.uint16]), st.sampled_from([None, 3]), st.integers(1, 40), st.integers(1, 40))
def test_png_comes_back_to_the_bit(
    tmp_path_factory: pytest.TempPathFactory, kind: type, channels: int | None, rows: int, cols: int
) -> None:
    rng = np.random.default_rng(rows * 100 + cols)
    shape = (rows, cols) if channels is None else (rows, cols, channels)
    image = rng.integers(0, np.iinfo(kind).max + 1, shape).astype(kind)
    path = tmp_path_factory.mktemp("png") / "a.png"
    write_png(path, image)
    back = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    assert back is not None
    np.testing.assert_array_equal(back if channels is None else back[..., ::-1], image)
    assert [p.name for p in path.parent.iterdir()] == ["a.png"]


def test_png_of_floats_is_refused(tmp_path: Path) -> None:
    with pytest.raises(TypeError, match="float64"):
        write_png(tmp_path / "a.png", np.zeros((4, 4)))


def test_folder_holds_frames_and_their_times(tmp_path: Path) -> None:
    written = write_frames(tmp_path / "new" / "folder", frames())
    with (tmp_path / "new" / "folder" / "times.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    assert [row["file"] for row in rows] == [path.name for path in written]
    assert [float(row["time_s"]) for row in rows] == TIMES
    raw = write_frames(tmp_path / "raw", frames(), raw=True)
    for path, frame in zip(raw, frames(), strict=True):
        np.testing.assert_array_equal(cv2.imread(str(path), cv2.IMREAD_UNCHANGED), frame.raw)


def test_ffv1_is_lossless_and_keeps_uneven_times(tmp_path: Path) -> None:
    path = tmp_path / "a.mkv"
    write_video(path, frames(), codec="ffv1")
    times, images = decode(path)
    assert times == pytest.approx(TIMES, abs=0.5e-3)  # Matroska counts milliseconds
    for image, frame in zip(images, frames(), strict=True):
        np.testing.assert_array_equal(image, np.repeat(frame.data[..., None], 3, axis=2))


@pytest.mark.parametrize("suffix", [".mp4", ".mov", ".mkv"])
def test_h264_keeps_uneven_times_and_nearly_the_frame(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"a{suffix}"
    write_video(path, frames(), codec="h264", quality=10)
    times, images = decode(path)
    assert times == pytest.approx(TIMES, abs=0.5e-3 if suffix == ".mkv" else 0.5 / 90_000)
    for image, frame in zip(images, frames(), strict=True):
        assert np.sqrt(np.mean((image[..., 1].astype(float) - frame.data) ** 2)) < 2.0
        assert np.ptp(image.astype(int), axis=2).max() <= 2  # grey stays grey


def test_opencv_reads_the_video_at_its_rate(tmp_path: Path) -> None:
    path = tmp_path / "a.mp4"
    write_video(path, frames([i / 30 for i in range(9)]), codec="h264", frame_rate_hz=30.0)
    video = cv2.VideoCapture(str(path))
    assert video.get(cv2.CAP_PROP_FRAME_COUNT) == 9
    assert video.get(cv2.CAP_PROP_FPS) == pytest.approx(30.0, rel=1e-3)
    video.release()


@pytest.mark.parametrize(
    ("times", "word"), [([0.0, 0.1, 0.1], "rise"), ([0.0, 0.2, 0.1], "rise"), ([-0.1, 0.1], "from 0")]
)
def test_times_that_do_not_rise_are_refused_and_leave_nothing(tmp_path: Path, times: list[float], word: str) -> None:
    with pytest.raises(InputError, match=word):
        write_video(tmp_path / "a.mkv", frames(times), codec="ffv1")
    assert list(tmp_path.iterdir()) == []


def test_wrong_container_odd_size_and_no_frame_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="does not hold ffv1"):
        VideoWriter(tmp_path / "a.mp4", codec="ffv1")
    with pytest.raises(InputError, match="even sides"):
        write_video(tmp_path / "a.mp4", frames(shape=(61, 98)), codec="h264")
    with pytest.raises(InputError, match="no frame"):
        write_video(tmp_path / "a.mp4", [], codec="h264")
    with pytest.raises(InputError, match="shape"):
        write_video(tmp_path / "a.mkv", [*frames([0.0]), *frames([1.0], (60, 98))], codec="ffv1")
    assert list(tmp_path.iterdir()) == []


def test_a_failure_halfway_leaves_the_old_file(tmp_path: Path) -> None:
    path = tmp_path / "a.mkv"
    write_video(path, frames(), codec="ffv1")
    before = path.read_bytes()

    def broken() -> object:
        yield from frames()[:3]
        raise RuntimeError("the chain broke")

    with pytest.raises(RuntimeError, match="broke"):
        write_video(path, broken(), codec="ffv1")  # type: ignore[arg-type]
    assert path.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["a.mkv"]


def test_missing_folder_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(WorkError, match="cannot write"):
        write_png(tmp_path / "no" / "a.png", np.zeros((4, 4), np.uint8))
    with pytest.raises(WorkError, match="cannot write"):
        write_video(tmp_path / "no" / "a.mkv", frames(), codec="ffv1")


_FULL_DISK = """
import resource, sys
from pathlib import Path
import numpy as np
from evanesce.core.errors import WorkError
from evanesce.sensor.codec import write_png, write_video
from evanesce.core.states import Frame
resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000))  # the system refuses to let a file grow beyond this
folder, kind = Path(sys.argv[1]), sys.argv[2]
rng = np.random.default_rng(0)
noise = [Frame(data=rng.integers(0, 256, (200, 300), dtype=np.uint8), time=i / 30, index=i) for i in range(5)]
try:
    if kind == "png":
        write_png(folder / "a.png", noise[0].data)
    else:
        write_video(folder / ("a.mkv" if kind == "ffv1" else "a.mp4"), noise, codec=kind)
except WorkError as error:
    print("WorkError", error)
"""


@pytest.mark.parametrize("kind", ["png", "ffv1", "h264"])
def test_a_full_disk_is_reported_and_leaves_nothing(tmp_path: Path, kind: str) -> None:
    done = subprocess.run(
        [sys.executable, "-c", _FULL_DISK, str(tmp_path), kind], capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("WorkError")
    assert list(tmp_path.iterdir()) == []


def test_h264_keeps_even_colours_and_halves_the_resolution_of_colour_alone(tmp_path: Path) -> None:
    # Colours of the published contact frame: contact, ring and ground. The edges lie within a cell of chroma.
    image = np.zeros((64, 96, 3), np.uint8)
    image[:] = (254, 0, 20)
    image[:, 33:63] = (254, 254, 200)
    image[:, 81:] = (90, 0, 0)
    path = tmp_path / "film.mp4"
    write_video(path, [Frame(data=image, time=i / 30, index=i) for i in range(3)], quality=0)
    container = av.open(str(path))
    found = [picture.to_ndarray(format="rgb24") for picture in container.decode(video=0)][-1].astype(int)
    for columns in (slice(0, 30), slice(36, 60), slice(66, 78), slice(84, 96)):
        np.testing.assert_allclose(found[:, columns], image[:, columns], atol=3)
    luma, expected = (a @ np.array([0.299, 0.587, 0.114]) for a in (found, image.astype(float)))
    # The cell that the edge crosses shares one colour; its luma stays sharp but for what leaves 0 to 255.
    assert np.abs(found[:, 32:34, 1] - image[:, 32:34, 1]).max() > 40
    assert np.abs(luma - expected)[:, [31, 34]].max() < 4


# --- the Raspberry Pi's encoders


def test_the_same_frames_make_the_same_video(tmp_path: Path) -> None:
    noisy = np.random.default_rng(5).normal(90.0, 4.0, (12, 160, 208, 3)).clip(0, 255).astype(np.uint8)
    film = [Frame(data=data, time=k / 30, index=k) for k, data in enumerate(noisy)]
    videos = set()
    for _ in range(12):
        write_video(tmp_path / "again.mp4", film, codec="h264", quality=24)
        videos.add((tmp_path / "again.mp4").read_bytes())
    assert len(videos) == 1


def test_bit_rates_of_the_pis_encoders() -> None:
    """Medium quality: 6 Mb/s in proportion to pixels a second on a Pi 4, 7 Mb/s by their root on a Pi 5."""
    assert bit_rate("h264-pi4", (1080, 1920), 30.0) == 6_000_000
    assert bit_rate("h264-pi4", (540, 960), 15.0) == 750_000
    assert bit_rate("h264-pi4", (1080, 1920), 30.0, "very high") == 15_000_000
    assert bit_rate("h264-pi5", (1080, 1920), 30.0) == 7_000_000
    assert bit_rate("h264-pi5", (540, 960), 30.0) == 3_500_000


def noisy(count: int, noise: float, shape: tuple[int, int] = (240, 320), rate: float = 30.0) -> list[Frame]:
    rng = np.random.default_rng(4)
    y, x = np.mgrid[: shape[0], : shape[1]]
    base = 60 + 120 * ((x - 160) ** 2 / 3 + (y - 120) ** 2 < 4000)
    return [
        Frame(data=np.clip(base + noise * rng.normal(size=shape), 0, 255).astype(np.uint8), time=k / rate, index=k)
        for k in range(count)
    ]


@pytest.mark.parametrize("codec", ["h264-pi4", "h264-pi5"])
def test_the_pis_encoders_hold_their_rate_where_a_rate_factor_does_not(tmp_path: Path, codec: VideoCodec) -> None:
    wanted = bit_rate(codec, (240, 320), 30.0)
    left = {}
    for noise in (2.0, 8.0):
        path = tmp_path / f"{noise:g}.mp4"
        write_video(path, noisy(90, noise), codec=codec)
        with av.open(str(path)) as container:
            sizes = [packet.size for packet in container.demux(video=0) if packet.pts is not None]
        # After a second in which the control settles.
        assert 8 * sum(sizes[30:]) / 2.0 == pytest.approx(wanted, rel=0.15)
        times, images = decode(path)
        assert times == pytest.approx([k / 30 for k in range(90)], abs=0.5 / 90_000)
        left[noise] = np.std(np.array(images[30:], np.float32)[..., 1], axis=0).mean() / noise
    assert left[8.0] < 0.7  # four times the noise at the same rate: much of it is gone
    write_video(tmp_path / "crf.mp4", noisy(90, 8.0), codec="h264")
    assert (tmp_path / "crf.mp4").stat().st_size > 2 * (tmp_path / "8.mp4").stat().st_size
