"""Round trips through the codecs that a lab's camera puts between the sensor and the file."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path

import av
import cv2
import numpy as np

from evanesce.sensor.codec import VideoWriter
from evanesce.states import Frame

FILMED = 3
"""Frames filmed of a state for each that is taken from the video."""


def by_video(frames: Sequence[np.ndarray], quality: int) -> list[np.ndarray]:
    """Return frames after H.264 in 4:2:0; all are one video, in order."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "film.mp4"
        with VideoWriter(path, codec="h264", quality=quality) as film:
            for k, frame in enumerate(frames):
                film.add(Frame(data=frame, time=k / 30.0, index=k))
        with av.open(str(path)) as container:
            # Green of equal R, G and B: luma brought back to full range.
            found = [picture.to_ndarray(format="rgb24")[..., 1] for picture in container.decode(video=0)]
    if len(found) != len(frames):
        raise RuntimeError(f"{len(found)} of {len(frames)} frames came back")
    return [np.ascontiguousarray(frame) for frame in found]


def by_jpeg(frame: np.ndarray, quality: int) -> np.ndarray:
    """Return a frame after JPEG."""
    ok, data = cv2.imencode(".jpg", frame, [cv2.IMWRITE_JPEG_QUALITY, quality])
    if not ok:
        raise RuntimeError("JPEG could not be encoded")
    return cv2.imdecode(data, cv2.IMREAD_GRAYSCALE)
