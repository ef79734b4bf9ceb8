"""Preview a dataset: a contact sheet of frames with labels overlaid, and a video of one trial."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from evanesce.core.errors import InputError
from evanesce.core.states import Frame, SurfaceState
from evanesce.dataset.read import Dataset, Sample
from evanesce.sensor.codec import VideoWriter, write_png

Picture = NDArray[np.uint8]

COLOURS = {SurfaceState.NEAR: (80, 80, 160), SurfaceState.STICK: (40, 170, 90), SurfaceState.SLIP: (230, 90, 40)}
"""Colours of the surface states [RGB]."""
TILE = 260
MAX_SIDE = 720
SHOWN_HZ = 30.0
"""Frames a second of a video at most: more are not seen."""


def overlay(sample: Sample, height: int, cut: tuple[slice, slice]) -> Picture:
    """Return part of a frame, the same with its states overlaid, two lines of its numbers, and the colours' meaning.

    Parameters
    ----------
    sample : Sample
    height : int
        Of the picture [px].
    cut : tuple of slice
        Rows and columns, from :func:`around`.
    """
    frame, state = sample.frame, sample.state
    grey = np.repeat(frame[..., None], 3, axis=2) if frame.ndim == 2 else frame
    tinted = grey.astype(np.float32)
    for value, colour in COLOURS.items():
        where = state == value
        tinted[where] = 0.45 * tinted[where] + 0.55 * np.array(colour, np.float32)
    pair = np.concatenate([grey[cut], tinted[cut].astype(np.uint8)], axis=1)
    text = 34
    scale = (height - text) / pair.shape[0]
    wide = 2 * round(scale * pair.shape[1] / 2)
    how = cv2.INTER_AREA if scale < 1 else cv2.INTER_NEAREST
    small = cv2.resize(np.ascontiguousarray(pair), (wide, height - text), interpolation=how)
    band = np.zeros((text, wide, 3), np.uint8)
    s, meta = sample.scalars, sample.meta
    lines = (
        f"{sample.key} {meta['kind']} t={s['time_s']:.2f} s",
        f"Fz={s['Fz_N']:.2f} N |Ft|={np.hypot(s['Fx_N'], s['Fy_N']):.2f} N stick={s['stick_ratio']:.2f}",
    )
    for i, line in enumerate(lines):
        cv2.putText(band, line, (3, 13 + 15 * i), cv2.FONT_HERSHEY_SIMPLEX, 0.36, (255, 255, 255), 1, cv2.LINE_AA)
    for i, (value, colour) in enumerate(COLOURS.items()):
        bright = tuple(min(255, int(1.4 * c)) for c in colour)
        place = (wide - 116 + 38 * i, 13)
        cv2.putText(band, value.name.lower(), place, cv2.FONT_HERSHEY_SIMPLEX, 0.36, bright, 1, cv2.LINE_AA)
    return np.concatenate([band, small], axis=0)


def around(samples: Sequence[Sample], margin: float = 0.25) -> tuple[slice, slice]:
    """Return rows and columns of the smallest square around all contacts of some frames, with a margin.

    Parameters
    ----------
    samples : sequence of Sample
        Of one size.
    margin : float
        Share of the square's side on each side.
    """
    rows, cols = samples[0].frame.shape[:2]
    in_contact = np.zeros((rows, cols), bool)
    for sample in samples:
        in_contact |= sample.state >= SurfaceState.STICK
    if not in_contact.any():
        in_contact[:] = True
    middle, half = [], 0.0
    for axis in (1, 0):
        there = np.flatnonzero(in_contact.any(axis=axis))
        middle.append(0.5 * float(there[0] + there[-1] + 1))
        half = max(half, (0.5 + margin) * float(there[-1] + 1 - there[0]))
    side = min(max(8, math.ceil(2 * half)), rows, cols)
    first = [min(max(0, round(m - side / 2)), size - side) for m, size in zip(middle, (rows, cols), strict=True)]
    return slice(first[0], first[0] + side), slice(first[1], first[1] + side)


def contact_sheet(dataset: Dataset, columns: int = 3, rows: int = 6) -> Picture:
    """Return a sheet of equally spaced frames of the dataset."""
    count = min(columns * rows, len(dataset))
    chosen = np.linspace(0, len(dataset) - 1, count).round().astype(int)
    samples = [dataset[int(i)] for i in chosen]
    cut = around(samples)
    tiles = [overlay(sample, TILE, cut) for sample in samples]
    wide = max(tile.shape[1] for tile in tiles)
    blank = np.full((TILE, wide, 3), 24, np.uint8)
    filled = []
    for tile in tiles:
        padded = blank.copy()
        padded[:, : tile.shape[1]] = tile
        filled.append(padded)
    filled += [blank] * (-len(filled) % columns)
    lines = [np.concatenate(filled[i : i + columns], axis=1) for i in range(0, len(filled), columns)]
    return np.concatenate(lines, axis=0)


def preview(folder: Path, out: Path, *, trial: int | None = None) -> tuple[Path, Path]:
    """Write ``contact_sheet.png`` and ``trial.mp4`` into a folder; return their paths.

    Parameters
    ----------
    folder, out : Path
    trial : int, optional
        The first slide by default.

    Raises
    ------
    InputError
        If there is no such trial, or no frame.
    """
    with Dataset(folder, check=True) as dataset:
        if not len(dataset):
            raise InputError("no frames", file=folder)
        trials = dataset.trials()
        if trial is None:
            slides = [row["trial"] for row in dataset.rows() if row["kind"] == "slide"]
            trial = slides[0] if slides else next(iter(trials))
        if trial not in trials:
            raise InputError(f"{trial}", key="--trial", allowed=f"{min(trials)} to {max(trials)}")
        sheet, film = out / "contact_sheet.png", out / "trial.mp4"
        write_png(sheet, contact_sheet(dataset))
        rate = min(dataset.job.config.trial.frame_rate_hz, SHOWN_HZ)  # slower than life where that is faster
        with VideoWriter(film, frame_rate_hz=rate) as video:
            samples = [dataset[i] for i in trials[trial]]
            cut = around(samples)
            for index, sample in enumerate(samples):
                picture = overlay(sample, MAX_SIDE, cut)
                even = picture[: picture.shape[0] // 2 * 2, : picture.shape[1] // 2 * 2]
                video.add(Frame(data=np.ascontiguousarray(even), time=index / rate, index=index))
    return sheet, film
