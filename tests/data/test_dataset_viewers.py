"""Data sets in the formats of viewers, each opened by its own library; skipped where that is not installed."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from evanesce import dataset
from evanesce.dataset.export import export
from evanesce.dataset.run import make
from support.datasets import tiny_job


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("viewers") / "d"
    make(folder, tiny_job(frames=12, labels={"frame": (), "plate": ()}))
    return folder


def test_a_tiff_stack_has_scale_and_interval(folder, tmp_path):
    tifffile = pytest.importorskip("tifffile")
    assert export(folder, tmp_path / "t", "tiff") == 12
    with dataset.open(folder) as data, tifffile.TiffFile(tmp_path / "t" / "trial-000001.tif") as file:
        assert file.is_imagej
        stack = file.asarray()
        np.testing.assert_array_equal(stack, np.stack([data[i].frame for i in range(6, 12)]))
        said = file.imagej_metadata
        assert (said["unit"], said["frames"]) == ("mm", 6)
        assert said["finterval"] == pytest.approx(1 / 8.0)
        numerator, denominator = file.pages[0].tags["XResolution"].value
        # 6 px/mm on the axis, less with the lens's own mapping beside it: here without distortion
        assert numerator / denominator == pytest.approx(6.0, rel=0.03)
        states = tifffile.imread(tmp_path / "t" / "trial-000001-state.tif")
        np.testing.assert_array_equal(states, np.stack([data[i].state for i in range(6, 12)]))


def test_mcap_holds_standard_images_and_wrenches(folder, tmp_path):
    pytest.importorskip("mcap")
    ros2 = pytest.importorskip("mcap_ros2.reader")
    assert export(folder, tmp_path / "m", "mcap") == 12
    with dataset.open(folder) as data:
        samples = [data[i] for i in range(6)]
        found = {}
        for message in ros2.read_ros2_messages(str(tmp_path / "m" / "trial-000000.mcap")):
            found.setdefault((message.channel.topic, message.schema.name), []).append(message)
        assert {key: len(those) for key, those in found.items()} == {
            ("/tactile/image/compressed", "sensor_msgs/msg/CompressedImage"): 6,
            ("/tactile/state/compressed", "sensor_msgs/msg/CompressedImage"): 6,
            ("/tactile/wrench", "geometry_msgs/msg/WrenchStamped"): 6,
            ("/tactile/stick", "std_msgs/msg/Float64"): 6,
        }
        by_topic = {topic: those for (topic, _), those in found.items()}
        for k, sample in enumerate(samples):
            image = by_topic["/tactile/image/compressed"][k].ros_msg
            assert (image.format, image.header.frame_id) == ("png", "plate")
            decoded = cv2.imdecode(np.frombuffer(bytes(image.data), np.uint8), cv2.IMREAD_UNCHANGED)
            np.testing.assert_array_equal(decoded, sample.frame)
            wrench = by_topic["/tactile/wrench"][k].ros_msg
            stamp = wrench.header.stamp
            assert stamp.sec + 1e-9 * stamp.nanosec == pytest.approx(k / 8.0)
            assert -wrench.wrench.force.z == pytest.approx(sample.scalars["Fz_N"])
            assert wrench.wrench.torque.z == pytest.approx(1e-3 * sample.scalars["torque_N_mm"])
            assert by_topic["/tactile/stick"][k].ros_msg.data == pytest.approx(sample.scalars["stick_ratio"])


def test_a_rerun_recording_reads_back(folder, tmp_path):
    pytest.importorskip("rerun")
    chunk = pytest.importorskip("rerun.chunk")
    assert export(folder, tmp_path / "r", "rrd") == 12
    rows: dict[str, list] = {}
    for part in chunk.RrdReader(str(tmp_path / "r" / "trial-000001.rrd")).stream().to_chunks():
        batch = part.to_record_batch()
        for name in batch.schema.names:
            rows.setdefault(f"{part.entity_path}:{name}", []).extend(batch.column(name).to_pylist())
    with dataset.open(folder) as data:
        forces = [data[i].scalars["Fz_N"] for i in range(6, 12)]
        np.testing.assert_allclose(np.ravel(rows["/numbers/Fz_N:Scalars:scalars"]), forces, rtol=1e-12)
        frames = [bytes(np.array(blob[0], np.uint8)) for blob in rows["/camera/frame:EncodedImage:blob"]]
        assert frames == [data[i].bytes_of("frame.png") for i in range(6, 12)]
    times = [time.total_seconds() for time in rows["/numbers/Fz_N:time"]]
    np.testing.assert_allclose(times, np.arange(6) / 8.0, atol=1e-6)
    assert len(rows["/camera/frame/state:SegmentationImage:buffer"]) == 6
