"""Frames of videos and folders: order, time stamps, and honesty about what is damaged.

Videos are written here with PyAV, images with OpenCV and Pillow; each frame carries its own number as a grey level.
"""

from __future__ import annotations

import math
import tracemalloc

import cv2
import numpy as np
import pytest
from PIL import Image as PillowImage

from evanesce.core.errors import InputError, WorkError
from evanesce.measurement.io.frames import natural_key, open_frames
from evanesce.measurement.io.images import read_image
from support.videos import cut, damage, write_video

ROWS, COLS = 90, 128


def numbered(index, colour=False, seed=0):
    """A frame whose upper left quarter has the grey level 3 index + 5, the rest noise, never free to a codec."""
    image = np.random.default_rng([seed, index]).integers(0, 256, (ROWS, COLS), dtype=np.uint8)
    image[: ROWS // 2, : COLS // 2] = 3 * index + 5
    return np.dstack([image, image // 2, 255 - image]) if colour else image


def read_all(path):
    stream = open_frames(path, 30)
    frames = list(stream)
    stream.finish()
    return frames


def codes(stream):
    return [warning.code for warning in stream.warnings]


def text_of(stream, code):
    return next(warning.text for warning in stream.warnings if warning.code == code)


def test_natural_order():
    names = ["f10.png", "f9.png", "F2b.png", "f2a.png", "10.png", "9.png", "f.png", "007.png"]
    ordered = ["007.png", "9.png", "10.png", "f2a.png", "F2b.png", "f9.png", "f10.png", "f.png"]
    assert sorted(names, key=natural_key) == ordered


def test_folder_in_natural_order_with_times(tmp_path):
    for k in (0, 1, 2, 9, 10, 11):
        cv2.imwrite(str(tmp_path / f"take{k}.png"), numbered(k))
    (tmp_path / "notes.txt").write_text("not an image")
    (tmp_path / "._take1.png").write_bytes(b"hidden")
    (tmp_path / "take3.png").mkdir()
    stream = open_frames(tmp_path, 30)
    frames = list(stream)
    stream.finish()
    assert [int(f.data[0, 0]) for f in frames] == [3 * k + 5 for k in (0, 1, 2, 9, 10, 11)]
    assert [f.index for f in frames] == list(range(6))
    assert [f.time for f in frames] == [k / 30 for k in range(6)]
    assert (stream.count, stream.shape, stream.warnings) == (6, (ROWS, COLS), [])


def test_folder_without_frame_rate_has_no_times(tmp_path):
    cv2.imwrite(str(tmp_path / "a.png"), numbered(0))
    stream = open_frames(tmp_path)
    assert math.isnan(next(iter(stream)).time)
    assert codes(stream) == ["frame_rate_missing"]


def test_folder_with_a_table_of_times(tmp_path):
    """Uneven times come from times.csv, in any order of lines; a contradicting frame rate wins, with a warning."""
    times = {"f2.png": 0.25, "f10.png": 1.0, "f11.png": 1.5}
    for name in times:
        cv2.imwrite(str(tmp_path / name), numbered(0))
    (tmp_path / "times.csv").write_text(
        "index,file,time_s\n" + "".join(f"0,{n},{t}\n" for n, t in reversed(times.items()))
    )
    stream = open_frames(tmp_path)
    assert [f.time for f in stream] == [0.0, 0.75, 1.25]
    assert stream.stated_rate == pytest.approx(2 / 1.25)
    assert codes(stream) == []  # 0.75 s is 1.2 mean steps, not a gap
    stated = open_frames(tmp_path, 30)
    assert [f.time for f in stated] == [0, 1 / 30, 2 / 30]
    assert codes(stated) == ["frame_rate_at_odds"]


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ("name,time\nf0.png,0\n", "line 2: no file and time_s"),
        ("file,time_s\nf0.png,nan\n", "line 2: time_s is nan"),
        ("file,time_s\nf0.png,0\n", "1 image.s. without a time, first f1.png"),
        ("file,time_s\nf0.png,0.5\nf1.png,0.5\n", "f1.png at 0.5 s comes after 0.5 s"),
        ("file,time_s\nf0.png\n", "line 2"),
    ],
)
def test_a_bad_table_of_times_is_refused(tmp_path, table, message):
    for k in range(2):
        cv2.imwrite(str(tmp_path / f"f{k}.png"), numbered(k))
    (tmp_path / "times.csv").write_text(table)
    with pytest.raises(InputError, match=message):
        open_frames(tmp_path, 30)


@pytest.mark.parametrize("suffix", ["png", "tif", "bmp"])
@pytest.mark.parametrize("colour", [False, True])
def test_lossless_images_come_back_to_the_bit(tmp_path, suffix, colour):
    image = numbered(7, colour)
    cv2.imwrite(str(tmp_path / f"x.{suffix}"), image[..., ::-1] if colour else image)
    np.testing.assert_array_equal(read_image(tmp_path / f"x.{suffix}").data, image)
    assert [f.data.shape for f in open_frames(tmp_path / f"x.{suffix}", 1)] == [
        image.shape
    ]  # a single image is one frame


def test_alpha_is_dropped_and_said(tmp_path):
    image = np.dstack([numbered(3, colour=True), np.full((ROWS, COLS), 255, np.uint8)])
    PillowImage.fromarray(image).save(tmp_path / "opaque.png")
    loaded = read_image(tmp_path / "opaque.png")
    np.testing.assert_array_equal(loaded.data, image[..., :3])
    assert loaded.notes == ()
    image[:9, :, 3] = 40  # 9 of 90 rows
    PillowImage.fromarray(image).save(tmp_path / "clear.png")
    loaded = read_image(tmp_path / "clear.png")
    np.testing.assert_array_equal(loaded.data, image[..., :3])
    assert [note.code for note in loaded.notes] == ["alpha_dropped"]
    assert "10.0 %" in loaded.notes[0].text


@pytest.mark.parametrize("suffix", ["png", "tif"])
def test_16_bits_are_scaled_and_said(tmp_path, suffix):
    deep = np.random.default_rng(1).integers(0, 65536, (20, 31), dtype=np.uint16)
    deep[0, :4] = [0, 128, 129, 65535]
    cv2.imwrite(str(tmp_path / f"x.{suffix}"), deep)
    stream = open_frames(tmp_path, 30)
    (frame,) = stream
    np.testing.assert_array_equal(frame.data, np.floor(deep / 65535 * 255 + 0.5))
    assert frame.data[0, :4].tolist() == [0, 0, 1, 255]
    assert "greatest 65535" in text_of(stream, "bit_depth")
    assert "x." in text_of(stream, "bit_depth")


def test_floats_and_pages_are_refused(tmp_path):
    PillowImage.fromarray(np.zeros((5, 6), np.float32)).save(tmp_path / "float.tif")
    page = PillowImage.fromarray(numbered(0))
    page.save(tmp_path / "pages.tif", save_all=True, append_images=[page, page])
    with pytest.raises(InputError, match="float32"):
        read_image(tmp_path / "float.tif")
    with pytest.raises(InputError, match="3 pages"):
        read_image(tmp_path / "pages.tif")


@pytest.mark.parametrize("suffix", ["png", "jpg", "tif", "bmp"])
@pytest.mark.parametrize("harm", ["cut", "empty", "junk"])
def test_a_damaged_image_is_left_out_and_named(tmp_path, suffix, harm, capfd):
    """The frames around it are measured, under their own index and time; the end is a failure that names the file."""
    for k in range(5):
        cv2.imwrite(str(tmp_path / f"f{k}.{suffix}"), numbered(k))
    victim = tmp_path / f"f2.{suffix}"
    cut(victim, 0.6) if harm == "cut" else victim.write_bytes(b"" if harm == "empty" else b"junk" * 99)
    stream = open_frames(tmp_path, 10)
    frames = list(stream)
    assert [f.index for f in frames] == [0, 1, 3, 4]
    assert [f.time for f in frames] == [0.0, 0.1, 0.3, 0.4]
    with pytest.raises(WorkError, match=rf"f2\.{suffix}: .*1 unreadable, 4 frame"):
        stream.finish()


def test_one_flipped_bit_in_a_png_is_noticed(tmp_path):
    path = tmp_path / "x.png"
    cv2.imwrite(str(path), numbered(0))
    damage(path, 0.5, length=1)
    with pytest.raises(InputError, match="checksum"):
        read_image(path)


def test_a_huge_png_is_refused_before_it_is_decoded(tmp_path):
    """A header that promises 40000 x 40000 pixels, with a right checksum, in 60 bytes."""
    import struct
    import zlib

    header = b"IHDR" + struct.pack(">IIBBBBB", 40_000, 40_000, 8, 0, 0, 0, 0)
    chunk = struct.pack(">I", 13) + header + struct.pack(">I", zlib.crc32(header))
    (tmp_path / "x.png").write_bytes(b"\x89PNG\r\n\x1a\n" + chunk)
    with pytest.raises(InputError, match="40000 x 40000"):
        read_image(tmp_path / "x.png")


def test_another_resolution_is_left_out_and_named(tmp_path):
    for k in range(4):
        cv2.imwrite(str(tmp_path / f"f{k}.png"), numbered(k) if k != 2 else numbered(k)[:50])
    stream = open_frames(tmp_path, 30)
    assert [f.index for f in stream] == [0, 1, 3]
    stream.finish()
    assert text_of(stream, "changed_resolution") == (
        "f2.png is 128 x 50, the first frame 128 x 90 pixels: 1 frame(s) of another size left out"
    )


@pytest.mark.parametrize(("container", "rate"), [("mkv", 30), ("mkv", 25), ("avi", 30), ("mp4", 24)])
def test_video_frames_and_times(tmp_path, container, rate):
    path = tmp_path / f"x.{container}"
    lossless = container != "mp4"
    images = [numbered(k) for k in range(12)]
    write_video(path, images, *(("ffv1", "gray") if lossless else ("libx264", "yuv420p")), rate=rate)
    stream = open_frames(path)
    frames = list(stream)
    stream.finish()
    assert stream.stated_rate == pytest.approx(rate, rel=1e-3)
    assert stream.count == 12
    assert stream.warnings == []
    for k, frame in enumerate(frames):
        assert frame.index == k
        assert frame.time == pytest.approx(k / rate, abs=1e-3)  # Matroska and this writer keep milliseconds
        if lossless:
            np.testing.assert_array_equal(frame.data, images[k])


def test_lossless_colour_video_is_exact(tmp_path):
    images = [numbered(k, colour=True) for k in range(4)]
    write_video(tmp_path / "x.mkv", images, "ffv1", "bgr0")
    for frame, image in zip(open_frames(tmp_path / "x.mkv"), images, strict=True):
        np.testing.assert_array_equal(frame.data, image)


def test_true_time_stamps_are_used_and_dropped_frames_told(tmp_path):
    """Frames 3 to 5 of 30 Hz are missing: times step over them, they do not close up."""
    kept = [0, 1, 2, 6, 7, 8, 9, 10, 11]
    path = tmp_path / "x.mkv"
    write_video(path, [numbered(k) for k in kept], times=[k / 30 for k in kept])
    stream = open_frames(path)
    times = [f.time for f in stream]
    np.testing.assert_allclose(times, np.array(kept) / 30, atol=1e-3)
    assert "1 step(s)" in text_of(stream, "irregular_time_stamps")
    assert "133.0 ms at 0.067 s" in text_of(stream, "irregular_time_stamps")


def test_25_against_30(tmp_path):
    """The file says 25 Hz, the user 30: the user wins, with both figures in the warning."""
    path = tmp_path / "x.mkv"
    write_video(path, [numbered(k) for k in range(8)], rate=25)
    stream = open_frames(path, 30)
    np.testing.assert_allclose([f.time for f in stream], np.arange(8) / 30, rtol=1e-12)
    text = text_of(stream, "frame_rate_at_odds")
    assert "25 Hz" in text
    assert "30 Hz" in text
    assert "1.200" in text
    agreed = open_frames(path, 25.02)
    list(agreed)
    assert agreed.warnings == []


def test_a_bare_stream_has_no_time_stamps(tmp_path):
    """FFmpeg reports 25 Hz for any bare H.264 stream; that figure must not become a time axis."""
    path = tmp_path / "x.h264"
    write_video(path, [numbered(k) for k in range(6)], "libx264", "yuv420p", format="h264")
    silent = open_frames(path)
    assert all(math.isnan(f.time) for f in silent)
    assert codes(silent) == ["frame_rate_missing"]
    stated = open_frames(path, 30)
    np.testing.assert_allclose([f.time for f in stated], np.arange(6) / 30)
    assert stated.warnings == []


@pytest.mark.parametrize("kind", ["ffv1.mkv", "libx264.mkv", "mjpeg.avi"])
def test_a_cut_video_gives_what_is_there_and_fails(tmp_path, kind):
    codec, _ = kind.split(".")
    path = tmp_path / kind
    images = [numbered(k) for k in range(30)]
    pixels = {"ffv1": "gray", "libx264": "yuv420p", "mjpeg": "yuvj420p"}[codec]
    write_video(path, images, codec, pixels)
    cut(path, 0.6)
    stream = open_frames(path)
    frames = list(stream)
    assert 10 <= len(frames) <= 20
    for frame in frames:
        level = np.asarray(frame.data)[10:20, 10:20].mean()
        assert level == pytest.approx(3 * frame.index + 5, abs=3)  # lossy codecs are off by a level or two
    with pytest.raises(WorkError, match=r"frame 1\d: .*(cut off|cannot be decoded)"):
        stream.finish()


def test_a_cut_mp4_is_bad_input(tmp_path):
    """Its table of contents stands at the end, so nothing of it can be read."""
    path = tmp_path / "x.mp4"
    write_video(path, [numbered(k) for k in range(9)], "libx264", "yuv420p")
    cut(path, 0.7)
    with pytest.raises(InputError, match="cannot be opened as a video"):
        open_frames(path)


@pytest.mark.parametrize("kind", ["ffv1.mkv", "libx264.mp4", "mjpeg.avi"])
def test_damage_in_the_middle_is_named_and_never_painted_over(tmp_path, kind):
    """Whatever still comes shows the level of its own number; at least one frame is missing; the first is named.

    FFV1 has a checksum, so 40 bytes will do; H.264 and JPEG have none and notice what breaks their syntax, so 1500 do.
    """
    codec, _ = kind.split(".")
    path = tmp_path / kind
    pixels = {"ffv1": "gray", "libx264": "yuv420p", "mjpeg": "yuvj420p"}[codec]
    options = {"g": "10", "bf": "0"} if codec == "libx264" else None
    write_video(path, [numbered(k) for k in range(30)], codec, pixels, options=options)
    damage(path, 0.42, length=40 if codec == "ffv1" else 1500)
    stream = open_frames(path)
    frames = list(stream)
    assert 15 <= len(frames) <= 29
    assert frames[-1].index == 29
    for frame in frames:
        assert np.asarray(frame.data)[10:20, 10:20].mean() == pytest.approx(3 * frame.index + 5, abs=3)
    with pytest.raises(WorkError, match=r"frame \d+: .*unreadable"):
        stream.finish()


def test_memory_does_not_grow_with_length(tmp_path):
    """Peak of Python's and numpy's memory over 240 frames stays within that over 24 plus three frames."""
    peaks = []
    for count in (24, 240):
        path = tmp_path / f"{count}.mkv"
        write_video(path, [numbered(k % 80) for k in range(count)])
        tracemalloc.start()
        for _ in open_frames(path):
            pass
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[1] <= peaks[0] + 3 * ROWS * COLS


@pytest.mark.parametrize("content", [b"", b"\x1b[2Jplain text\n" * 50, b"#EXTM3U\n#EXTINF:1,\n/etc/hostname\n"])
@pytest.mark.parametrize("name", ["x.mp4", "x.txt", "x.png"])
def test_no_video_no_image(tmp_path, content, name):
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(InputError, match=name):
        read_all(path)


def test_bad_paths_and_rates(tmp_path):
    with pytest.raises(InputError, match="no images"):
        open_frames(tmp_path, 30)
    with pytest.raises(InputError, match="no such"):
        open_frames(tmp_path / "absent.mp4")
    for rate in (0, -30, math.nan, math.inf):
        with pytest.raises(InputError, match="--fps"):
            open_frames(tmp_path, rate)
