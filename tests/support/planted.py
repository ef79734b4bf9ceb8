"""Mistakes that a lab makes when it measures a film, planted one at a time in a drawn lab.

Each row: what is wrong, how its files differ, the options, the exit code, words of the line that says so. A row without
words is one of which nothing can be told from the files; ``why`` says why, or that the area stays right.
"""

from __future__ import annotations

import csv
import shutil
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path

import cv2
import numpy as np

from support.lab_boards import Board
from support.labs import Colour, Lab, Rig, write_film
from support.videos import cut, damage, write_video

SMALL = Lab("small", (480, 360), 24.0, 800.0, (-0.12, 0.03), Board(15, 11, 1.0), True, 8.0, 0.9, 30, 17, 4, 100.0, 0.25,
            (4.0, 0.7), (1.4, 2.9), ratio=0.9, noise=0.004, dust=12, middle=(0.3, -0.2), seed=21)  # fmt: skip
RED = replace(SMALL, name="red", colour=Colour(), step=4.0, ground=0.02, dust=0, seed=22)
ALWAYS = ("threshold_far_from_half",)
"""Warnings of a faultless measurement: of the published threshold, which the refined area does not use."""


@dataclass
class Made:
    """A lab in a folder: its own film and files, from which the mistakes are made."""

    folder: Path
    rig: Rig = field(default_factory=lambda: Rig(SMALL))
    frames: list[np.ndarray] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.rig.write(self.folder)
        self.frames = [self.rig.frame(k) for k in range(SMALL.frames)]

    def film(self, frames: Iterable[np.ndarray], name: str = "wrong.mp4", **options: object) -> None:
        write_film(self.folder / name, frames, SMALL.rate, **options)  # type: ignore[arg-type]

    def drawn(self, lab: Lab, name: str = "wrong.mp4", ks: Iterable[int] = range(SMALL.frames)) -> None:
        rig = Rig(lab)
        self.film([rig.frame(k) for k in ks], name)

    def forces(self, change: Callable[[float, float], tuple[float, float]], header: str = "time_s,force_N") -> None:
        rows = list(csv.reader((self.folder / "force.csv").read_text().splitlines()))[1:]
        lines = [",".join(f"{x:.12g}" for x in change(float(t), float(f))) for t, f in rows]
        (self.folder / "wrong.csv").write_text("\n".join([header, *lines]) + "\n")


@dataclass(frozen=True)
class Mistake:
    what: str
    plant: Callable[[Made], object]
    args: tuple[str, ...]
    code: int = 0
    says: tuple[str, ...] = ()
    why: str = ""
    quick: bool = False


def nothing(made: Made) -> None:
    pass


def measure(*options: str, film: str = "wrong.mp4", calibration: str = "cal.json") -> tuple[str, ...]:
    return ("measure", film, "--calibration", calibration, *options)


def scaled(gains: Iterable[float]) -> Callable[[Made], None]:
    """A film whose LEDs' light changes from frame to frame."""

    def plant(made: Made) -> None:
        found = []
        for k, gain in enumerate(gains):
            light = made.rig.light(SMALL.axes(k))
            found.append(made.rig.shoot(gain * light))
        made.film(found)

    return plant


def two_contacts(made: Made) -> None:
    rig, found = made.rig, []
    for k in range(SMALL.frames):
        axes = SMALL.axes(k)
        light = rig.light(axes)
        if axes is not None:
            light = light + rig.light((0.8, 0.7), middle=(-7.0, 4.0)) - rig.empty
        found.append(rig.shoot(light))
    made.film(found)


def glare(made: Made) -> None:
    rig, found = made.rig, []
    spot = np.zeros(rig.x.shape)
    cv2.circle(spot, (70, 300), 30, 0.5, -1)
    for k in range(SMALL.frames):
        found.append(rig.shoot(rig.light(SMALL.axes(k)) + (spot if k > 8 else 0)))
    made.film(found)


def dark_with_finger(made: Made) -> None:
    (made.folder / "darks").mkdir(exist_ok=True)
    for k in range(3):
        cv2.imwrite(str(made.folder / "darks" / f"{k}.png"), made.frames[10])


def folder_of(frames: Iterable[np.ndarray], name: str) -> Callable[[Made], None]:
    def plant(made: Made) -> None:
        (made.folder / name).mkdir(exist_ok=True)
        for k, image in enumerate(frames):
            cv2.imwrite(str(made.folder / name / f"f{k:03d}.png"), image)

    return plant


def sixteen(made: Made) -> None:
    folder_of([frame.astype(np.uint16) * 257 for frame in made.frames], "wide")(made)


def one_frame(made: Made) -> None:
    cv2.imwrite(str(made.folder / "one.png"), made.frames[-1])


def broken(made: Made) -> None:
    shutil.copy(made.folder / "film.mp4", made.folder / "wrong.mp4")
    damage(made.folder / "wrong.mp4", 0.5, 400)


def cut_off(made: Made) -> None:
    write_video(made.folder / "wrong.mkv", made.frames, "ffv1", "gray", SMALL.rate)
    cut(made.folder / "wrong.mkv", 0.6)


def colour_film(made: Made) -> None:
    rig = Rig(RED)
    made.film([rig.frame(k) for k in range(RED.frames)], "red.mp4")
    (made.folder / "camera.csv").write_text(rig.camera_table())
    other = Rig(replace(RED, colour=Colour(shares=(1.0, 0.3, 0.02), gains=(1.3, 1.0, 2.2))))
    (made.folder / "camera2.csv").write_text(other.camera_table())


def sharpened(image: np.ndarray) -> np.ndarray:
    soft = cv2.GaussianBlur(image.astype(np.float64), (0, 0), 1.5)
    return np.clip(np.rint(2.0 * image - soft), 0, 255).astype(np.uint8)


def crept(image: np.ndarray, scale: float) -> np.ndarray:
    rows, cols = image.shape
    x, y = 0.5 * (1 - scale) * (cols - 1), 0.5 * (1 - scale) * (rows - 1)
    return cv2.warpAffine(image, np.array([[scale, 0, x], [0, scale, y]]), (cols, rows))


def with_force(*options: str) -> tuple[str, ...]:
    return measure("--force", "wrong.csv", *options, film="film.mp4")


N = SMALL.frames
MISTAKES = (
    Mistake("none", nothing, measure("--force", "force.csv", film="film.mp4")),
    Mistake("none, red light with camera model", colour_film, measure("--camera-model", "camera.csv", film="red.mp4")),
    Mistake("no calibration", nothing, ("measure", "film.mp4"), 2, ("--calibration",), quick=True),
    Mistake("a film that is not there", nothing, measure(film="films.mp4"), 2, ("no such file",), quick=True),
    Mistake("25 for 30 Hz", nothing, measure("--fps", "25", film="film.mp4"), 0, ("frame_rate_at_odds", "30 Hz")),
    Mistake("crop that cuts the contact", nothing, measure("--crop", "0:170,:", film="film.mp4"), 0,
            ("mask_touches_border",), quick=True),
    Mistake("crop beside the contact", nothing, measure("--crop", "0:60,0:60", film="film.mp4"), 0,
            ("nothing_segmented",)),
    Mistake("film of another resolution", lambda made: made.film([f[::2, ::2] for f in made.frames]), measure(), 2,
            ("--calibration", "240 x 180"), quick=True),
    Mistake("axes swapped (film turned by 90 degrees)",
            lambda made: made.film([np.rot90(f).copy() for f in made.frames]), measure(), 2, ("360 x 480",)),
    Mistake("mirrored film", lambda made: made.film([f[:, ::-1].copy() for f in made.frames]), measure(),
            why="a contact has no left and right; the area stays right to the distortion's asymmetry"),
    Mistake("overexposed", lambda made: made.drawn(replace(SMALL, step=2.5)), measure(), 0, ("saturated_edge",)),
    Mistake("out of focus", lambda made: made.drawn(replace(SMALL, blur=3.0)), measure(), 0, ("focus_changed",)),
    Mistake("calibrated out of focus", lambda made: made.drawn(replace(SMALL, blur=0.5)), measure(),
            why="0.5 px and 0.9 px differ by less than a pixel shows; the area stays right"),
    Mistake("camera moved 4 % nearer after calibration",
            lambda made: made.drawn(replace(SMALL, scale=1.04 * SMALL.scale)), measure(),
            why="the film shows no length that is known: photograph the card again at the end"),
    Mistake("calibration of another camera of the same resolution", lambda made: made.drawn(
            replace(SMALL, scale=1.1 * SMALL.scale, focal=1.1 * SMALL.focal)), measure(),
            why="as above; if its focus differs, focus_changed says so"),
    Mistake("plate tilted by 2 degrees after calibration", lambda made: made.drawn(replace(SMALL, tilt=(0.04, 0.01))),
            measure(), why="the area stays right: it changes by the cosine and the distance across the contact"),
    Mistake("dusty plate", lambda made: made.drawn(replace(SMALL, dust=150)), measure(),
            why="the area stays right: dust is in the dark frame"),
    Mistake("dusty plate, no frame without a finger", lambda made: made.drawn(replace(SMALL, dust=150), ks=range(5, N)),
            measure(), why="the area stays right: specks are no contact"),
    Mistake("empty film", lambda made: made.drawn(replace(SMALL, dust=0), ks=[0] * N), measure(), 0,
            ("nothing_segmented", "17 of 17")),
    Mistake("lens cap", lambda made: made.film([np.zeros_like(f) for f in made.frames]), measure(), 0,
            ("nothing_segmented",)),
    Mistake("lens cap half way", scaled([1.0] * 9 + [0.0] * (N - 9)), measure(), 0, ("light_changes",)),
    Mistake("LEDs off half way", scaled([1.0] * 9 + [0.02] * (N - 9)), measure(), 0, ("light_changes",)),
    Mistake("flicker", scaled([1.0 + 0.2 * (-1) ** k for k in range(N)]), measure(), 0, ("light_changes",)),
    Mistake("frames repeated by the recorder", lambda made: write_video(
            made.folder / "wrong.mkv", [made.frames[k - k % 2] for k in range(N)], "ffv1", "gray", SMALL.rate),
            measure(film="wrong.mkv"), 0, ("repeated_frames",)),
    Mistake("frames dropped, stamps kept", lambda made: made.film(
            [f for k, f in enumerate(made.frames) if k not in (6, 7, 8)],
            times=[k / 30 for k in range(N) if k not in (6, 7, 8)]), measure(), 0, ("irregular_time_stamps",)),
    Mistake("frames dropped, stamps closed up", lambda made: made.film(
            [f for k, f in enumerate(made.frames) if k not in (6, 7, 8)]), measure(),
            why="areas stay right, times are wrong: compare the film's length with the log's"),
    Mistake("finger over the frame's border", lambda made: made.drawn(replace(SMALL, middle=(8.9, 0.0))), measure(), 0,
            ("mask_touches_border",)),
    Mistake("two contacts", two_contacts, measure(), 0, ("several_contacts",), quick=True),
    Mistake("glare that comes half way", glare, measure(), 0, ("several_contacts",)),
    Mistake("dark frames with the finger on", dark_with_finger, measure("--dark", "darks", film="film.mp4"), 0,
            ("dark_shows_contact",)),
    Mistake("one frame", one_frame, measure(film="one.png"), 0, ("frame_rate_missing",)),
    Mistake("16-bit frames", sixteen, measure(film="wide"), 0, ("bit_depth",)),
    Mistake("damaged file", broken, measure(), 1, ("unreadable",)),
    Mistake("file cut off", cut_off, measure(film="wrong.mkv"), 1, ("unreadable",)),
    Mistake("threshold far off", nothing, measure("--threshold", "0.9", film="film.mp4"),
            why="the refined area takes no threshold; threshold_far_from_half names it for the reference segmentation"),
    Mistake("--min-blob too large", nothing, measure("--min-blob", "100000", film="film.mp4"), 0,
            ("nothing_segmented", "too small to count")),
    Mistake("--finger smooth for a ridged one", nothing, measure("--finger", "smooth", film="film.mp4"),
            why="counts only where the edge is saturated or scattered"),
    Mistake("red light without a camera model", colour_film, measure(film="red.mp4"), 0, ("camera_model_missing",)),
    Mistake("camera model of another camera", colour_film, measure("--camera-model", "camera2.csv", film="red.mp4"),
            0, ("camera_model_at_odds",)),
    Mistake("force in grams, called newtons", lambda made: made.forces(lambda t, f: (t, f / 9.80665e-3)), with_force(),
            0, ("force_implausible", "grams")),
    Mistake("force with its sign turned", lambda made: made.forces(lambda t, f: (t, -f)), with_force(), 2,
            ("sign turned",)),
    Mistake("force of another press", lambda made: made.forces(lambda t, f: (t, 3 + 2 * np.sin(9 * t))), with_force(),
            0, ("area_force_at_odds",)),
    Mistake("force not tared by 1 N", lambda made: made.forces(lambda t, f: (t, f + 1)), with_force(), 0,
            ("force_not_tared",)),
    Mistake("exposure that halves by and by", scaled([1.0 - 0.5 * k / (N - 1) for k in range(N)]), measure(), 0,
            ("light_changes", "drifts")),
    Mistake("camera's sharpening switched on", lambda made: made.film([sharpened(f) for f in made.frames]), measure(),
            0, ("focus_changed",)),
    Mistake("another picture profile (grey levels to the power 0.7)", lambda made: made.film(
            [np.rint(255 * (f / 255.0) ** 0.7).astype(np.uint8) for f in made.frames]), measure(),
            why="the film hides its own tone curve; ridged areas grow by 4 %: one setting for all"),
    Mistake("zoom that creeps by 6 % during the film", lambda made: made.film(
            [crept(f, 1 + 0.06 * k / (N - 1)) for k, f in enumerate(made.frames)]), measure(),
            why="the film shows no length that is known: photograph the card again at the end"),
    Mistake("force log on another clock", lambda made: made.forces(lambda t, f: (t + 1.7e9, f)), with_force(),
            why="the offset is found: areas and forces belong together"),
    Mistake("force log in milliseconds, called seconds", lambda made: made.forces(lambda t, f: (1000 * t, f)),
            with_force(), 2, ("clock in seconds",)),
    Mistake("force and area columns swapped", lambda made: made.forces(lambda t, f: (f, t), "time_s,force_N"),
            with_force(), 2, ("does not rise",)),
)  # fmt: skip


def truth(made: Made) -> float:
    """Area of the last frame [mm^2]."""
    return made.rig.true(SMALL.frames - 1)
