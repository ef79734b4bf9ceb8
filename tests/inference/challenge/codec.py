"""Round trips through the codecs that a lab's camera puts between the sensor and the file."""

from __future__ import annotations

import io
from collections.abc import Sequence

import av
import numpy as np
from PIL import Image

FILMED = 3
"""Frames filmed of a state for each that is taken from the video."""


def by_video(frames: Sequence[np.ndarray], quality: int) -> list[np.ndarray]:
    """Return frames after H.264 in 4:2:0 without B-frames; all are one video, in order."""
    packets = io.BytesIO()
    rows, cols = frames[0].shape
    with av.open(packets, "w", format="matroska") as film:
        stream = film.add_stream("libx264", rate=30, options={"crf": str(quality), "bf": "0", "threads": "4"})
        stream.width, stream.height, stream.pix_fmt = cols, rows, "yuv420p"
        for grey in frames:
            film.mux(stream.encode(av.VideoFrame.from_ndarray(grey, format="gray").reformat(format="yuv420p")))
        film.mux(stream.encode(None))
    packets.seek(0)
    with av.open(packets) as film:
        # As pictures in RGB, as labs take them out of a video; that conversion makes them 0.5 DN darker.
        found = [np.ascontiguousarray(p.reformat(format="rgb24").to_ndarray()[:, :, 1]) for p in film.decode(video=0)]
    if len(found) != len(frames):
        raise RuntimeError(f"{len(found)} of {len(frames)} frames came back")
    return found


def by_jpeg(frame: np.ndarray, quality: int) -> np.ndarray:
    """Return a frame after JPEG."""
    file = io.BytesIO()
    Image.fromarray(frame).save(file, "JPEG", quality=quality)
    with Image.open(file) as picture:
        return np.asarray(picture.convert("L"))
