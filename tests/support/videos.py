"""Videos written frame by frame with PyAV, and ways to damage a file."""

from __future__ import annotations

from fractions import Fraction

import av


def write_video(path, frames, codec="ffv1", pixels="gray", rate=30, times=None, options=None, format=None):
    options = options or ({"level": "3", "slicecrc": "1"} if codec == "ffv1" else {})
    with av.open(str(path), "w", format=format) as container:
        stream = container.add_stream(codec, rate=rate, options=options)
        stream.height, stream.width, stream.pix_fmt = *frames[0].shape[:2], pixels
        tick = Fraction(1, 1000) if times else Fraction(1, rate)
        stream.codec_context.time_base = tick
        for k, image in enumerate(frames):
            picture = av.VideoFrame.from_ndarray(image, format="rgb24" if image.ndim == 3 else "gray")
            picture.time_base = tick
            picture.pts = round(1000 * times[k]) if times else k
            container.mux(stream.encode(picture))
        container.mux(stream.encode())


def damage(path, at, length=40):
    content = bytearray(path.read_bytes())
    start = int(at * len(content))
    for k in range(start, start + length):
        content[k] ^= 0x5A
    path.write_bytes(content)


def cut(path, share):
    content = path.read_bytes()
    path.write_bytes(content[: int(share * len(content))])
