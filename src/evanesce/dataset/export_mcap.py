"""Export to MCAP with ROS 2 messages: images as ``CompressedImage``, forces as ``WrenchStamped``; a file a trial."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from mcap_ros2.writer import Writer

from evanesce.dataset.export import Advance
from evanesce.dataset.read import Dataset, Sample

NAME = "trial-{:06d}.mcap"
IMAGE, MASK, WRENCH, STICK = (
    "/tactile/image/compressed",
    "/tactile/state/compressed",
    "/tactile/wrench",
    "/tactile/stick",
)
"""Topics: frame [DN]; surface state (0 none, 1 near, 2 stick, 3 slip); of the finger on the glass, about the middle of
the contact [N, N m]; share of the contact that sticks [1]."""
FRAME_ID = "plate"
"""Origin in the middle of the top face; x right, y down in the image, z into the finger."""

_LINE = "=" * 80
_STAMPED = f"""{_LINE}
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
{_LINE}
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""
_COMPRESSED = f"std_msgs/Header header\nstring format\nuint8[] data\n{_STAMPED}"
_FORCES = f"""std_msgs/Header header
geometry_msgs/Wrench wrench
{_LINE}
MSG: geometry_msgs/Wrench
geometry_msgs/Vector3 force
geometry_msgs/Vector3 torque
{_LINE}
MSG: geometry_msgs/Vector3
float64 x
float64 y
float64 z
{_STAMPED}"""


def write(dataset: Dataset, folder: Path, advance: Advance) -> None:
    """Write each trial's frames, states, wrenches and stick ratios at their times from the trial's beginning."""
    for trial, indices in dataset.trials().items():
        with (folder / NAME.format(trial)).open("wb") as stream:
            writer = Writer(stream)
            kinds = {
                "image": writer.register_msgdef("sensor_msgs/msg/CompressedImage", _COMPRESSED),
                "wrench": writer.register_msgdef("geometry_msgs/msg/WrenchStamped", _FORCES),
                "number": writer.register_msgdef("std_msgs/msg/Float64", "float64 data\n"),
            }
            for number, i in enumerate(indices):
                sample = dataset[i]
                for topic, kind, message in _messages(sample):
                    at = round(1e9 * sample.scalars["time_s"])
                    writer.write_message(topic, kinds[kind], message, log_time=at, publish_time=at, sequence=number)
                advance(1)
            writer.finish()


def _messages(sample: Sample) -> list[tuple[str, str, dict[str, Any]]]:
    s = sample.scalars
    sec, nanosec = divmod(round(1e9 * s["time_s"]), 1_000_000_000)
    header = {"stamp": {"sec": sec, "nanosec": nanosec}, "frame_id": FRAME_ID}
    force = dict(zip("xyz", (s["Fx_N"], s["Fy_N"], -s["Fz_N"]), strict=True))  # z points from the glass to the finger
    torque = {"x": 0.0, "y": 0.0, "z": 1e-3 * s["torque_N_mm"]}
    return [
        (IMAGE, "image", {"header": header, "format": "png", "data": sample.bytes_of("frame.png")}),
        (MASK, "image", {"header": header, "format": "png", "data": sample.bytes_of("mask.png")}),
        (WRENCH, "wrench", {"header": header, "wrench": {"force": force, "torque": torque}}),
        (STICK, "number", {"data": s["stick_ratio"]}),
    ]
