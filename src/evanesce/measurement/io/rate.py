"""How much of its pictures a video file holds."""

from __future__ import annotations

from itertools import islice
from typing import Any

import av

KEY_PACKETS = 300
"""Packets of a video among which key frames are looked for."""


def key_bits(container: Any, stream: Any) -> float | None:
    """Return the bits per pixel of a video's first key frames, from its packets, without decoding.

    Other frames hold differences only: their size says more of what moves than of what is left out.

    Parameters
    ----------
    container, stream : av.container.InputContainer, av.video.VideoStream
        Open at its beginning.

    Returns
    -------
    float or None
        None where there is no key frame, or the file is damaged.
    """
    try:
        sizes = [p.size for p in islice(container.demux(stream), KEY_PACKETS) if p.size and p.is_keyframe]
    except (av.FFmpegError, ValueError):
        return None
    pixels = stream.width * stream.height
    return 8.0 * sum(sizes) / len(sizes) / pixels if sizes and pixels else None
