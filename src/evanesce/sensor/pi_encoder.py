"""Bit rates and settings of the Raspberry Pi's H.264 encoders, as its camera library sets them by default."""

from __future__ import annotations

from typing import Literal

PiCodec = Literal["h264-pi4", "h264-pi5"]
PiQuality = Literal["very low", "low", "medium", "high", "very high"]

PI_CODECS: tuple[PiCodec, ...] = ("h264-pi4", "h264-pi5")

# Mb/s at 1920 x 1080, 30 frames a second.
_MEGABITS: dict[PiCodec, dict[PiQuality, float]] = {
    "h264-pi4": {"very low": 2.0, "low": 4.0, "medium": 6.0, "high": 9.0, "very high": 15.0},
    "h264-pi5": {"very low": 3.0, "low": 4.0, "medium": 7.0, "high": 10.0, "very high": 14.0},
}
_REFERENCE = 1920 * 1080 * 30
# Exponent of pixels a second: the hardware encoder's rate is in proportion to them, libx264's to their root.
_EXPONENT: dict[PiCodec, float] = {"h264-pi4": 1.0, "h264-pi5": 0.5}


def bit_rate(codec: PiCodec, shape: tuple[int, int], frame_rate_hz: float, quality: PiQuality = "medium") -> int:
    """Return the bit rate that a quality stands for [bit/s].

    Parameters
    ----------
    codec : {"h264-pi4", "h264-pi5"}
        Hardware encoder of a Pi up to 4, libx264 on a Pi 5.
    shape : tuple of int
        (rows, cols) [px].
    frame_rate_hz : float
        [Hz].
    quality : {"very low", "low", "medium", "high", "very high"}
        "medium" is what the library takes where none is given.

    Returns
    -------
    int

    References
    ----------
    raspberrypi/picamera2, commit 3e6dff09, ``picamera2/encoders/h264_encoder.py`` and ``libav_h264_encoder.py``.
    """
    share = shape[0] * shape[1] * frame_rate_hz / _REFERENCE
    return int(1e6 * _MEGABITS[codec][quality] * share ** _EXPONENT[codec])


def encoder_options(codec: PiCodec, rate: int) -> dict[str, str]:
    """Return the options of libx264 for such an encoder.

    Those of a Pi 5 are the library's own: it runs libx264 by ``ultrafast`` and ``zerolatency``. The hardware encoder of
    older ones is not libx264, and its rate control is not published: here libx264 of CABAC and deblocking without
    B-frames is held to the same rate over a second.

    Parameters
    ----------
    codec : {"h264-pi4", "h264-pi5"}
    rate : int
        [bit/s].
    """
    if codec == "h264-pi5":
        return {"preset": "ultrafast", "tune": "zerolatency", "deblock": "1"}
    return {"preset": "superfast", "bf": "0", "rc-lookahead": "0", "maxrate": str(rate), "bufsize": str(rate)}


KEY_FRAMES: dict[PiCodec, int] = {"h264-pi4": 60, "h264-pi5": 30}
"""Frames from one key frame to the next; the library leaves the hardware encoder its own, which is assumed."""
