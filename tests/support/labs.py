"""Labs drawn with NumPy, OpenCV and PyAV alone: boards and card on the glass, a film of a finger, a force log.

Nothing here comes from the package. A pinhole with two radial terms looks at a plate that is tilted a little. A
contact is an outline (an ellipse), with straight or wavy ridges across it or not; its area is summed chord by chord,
its picture on 10 x 10 points in each pixel that an edge crosses. A film of air opens beside a Hertz contact (K. L.
Johnson, Contact Mechanics, 1985, eq. 3.42) and passes light by exp(-gap/depth). Light is scattered beside the contact
with a density that falls as exp(-r/length). Prints are longer than stated and lie above the plate.

Coordinates: plate [mm], x to the right and y down about the middle of the frame; integer pixels are centres.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
from numpy.typing import NDArray

from support.lab_boards import Board, Lens, Pose

Array = NDArray[np.float64]
WAYS = 10
RADIUS_MM = 9.0  # of the finger's tip
DEPTH_MM = 60e-6  # of the light in a film of air: 550 nm / (4 pi sqrt(n^2 sin^2 - 1)) at 65 degrees in glass


def bt709(light: Array) -> Array:
    """Grey levels 0 to 1 of linear light (ITU-R BT.709-6, item 1.2)."""
    light = np.clip(light, 0.0, 1.0)
    return np.where(light < 0.018, 4.5 * light, 1.099 * np.maximum(light, 0.018) ** 0.45 - 0.099)


@dataclass(frozen=True)
class Ridges:
    period: float  # mm
    part: float  # of it that is ridge
    sway: float = 0.0  # mm, of a wave along them
    wave: float = 3.0  # mm
    height: float = 0.1  # mm, of a sine profile

    @property
    def crest(self) -> float:
        """Radius of curvature of a crest [mm]."""
        return self.period**2 / (2 * np.pi**2 * self.height)


@dataclass(frozen=True)
class Colour:
    """A Bayer camera (RGGB) under red LEDs: filters, white balance, matrix, bilinear demosaicing."""

    shares: tuple[float, float, float] = (1.0, 0.12, 0.05)
    gains: tuple[float, float, float] = (1.7, 1.0, 1.6)
    matrix: tuple[tuple[float, ...], ...] = ((1.6, -0.5, -0.1), (-0.12, 1.32, -0.2), (0.02, -0.42, 1.4))
    full_e: float = 8000.0


@dataclass(frozen=True)
class Lab:
    """One lab. Lengths in mm, times in s, light of full scale, blur in px."""

    name: str
    size: tuple[int, int]  # cols, rows
    scale: float  # px/mm at the middle
    focal: float  # px
    k: tuple[float, float]
    board: Board
    white: bool  # paper around the board
    card: float
    blur: float
    rate: int
    frames: int
    free: int  # frames at the start without a finger
    force_rate: float
    later: float  # how much later the film's clock starts than the load cell's
    law: tuple[float, float]  # A = law[0] F^law[1]
    grow: tuple[float, float]  # half axis along x at the first and last frame with contact
    ratio: float = 1.0  # of the half axes
    ridges: Ridges | None = None
    air: bool = False
    glow: tuple[float, float] = (0.0, 0.6)  # share of the contact's light, length
    dust: int = 0
    step: float = 0.35
    ground: float = 0.012
    noise: float = 0.003  # at half scale
    print_error: float = 0.0  # printed over stated length, less one
    height: float = 0.0  # of the printed side over the plate
    tilt: tuple[float, float] = (0.006, -0.004)
    middle: tuple[float, float] = (0.0, 0.0)
    film: tuple[float, float] = (RADIUS_MM, DEPTH_MM)  # of the air: radius of the tip, depth of the light
    colour: Colour | None = None
    crf: int = 18
    seed: int = 1

    @property
    def lens(self) -> Lens:
        cols, rows = self.size
        middle = (cols - 1) / 2 + 0.011 * cols, (rows - 1) / 2 - 0.008 * rows
        return Lens(self.size, self.focal, self.focal * 1.0007, *middle,
                    *self.k)  # fmt: skip

    @property
    def distance(self) -> float:
        return self.focal / self.scale

    def pose(self, x: float = 0.0, y: float = 0.0, turn: float = 0.0, above: float = 0.0) -> Pose:
        """Something flat on the plate."""
        plate = cv2.Rodrigues(np.array([*self.tilt, 0.0]))[0]
        own = cv2.Rodrigues(np.array([0.0, 0.0, turn]))[0]
        return Pose(plate @ own, np.array([0.0, 0.0, self.distance]) + plate @ np.array([x, y, above]))

    def axes(self, k: float) -> tuple[float, float] | None:
        """Half axes of the outline in frame k; None without a finger."""
        if k < self.free:
            return None
        share = (k - self.free + 1) / (self.frames - self.free)
        a = self.grow[0] + (self.grow[1] - self.grow[0]) * share**0.6
        return a, self.ratio * a


def plate_xy(lens: Lens, pose: Pose) -> tuple[Array, Array]:
    """Plate coordinates of every pixel."""
    x, y = lens.rays()
    plane = np.column_stack([pose.rotation[:, 0], pose.rotation[:, 1], pose.shift])
    mapped = np.tensordot(np.linalg.inv(plane), np.stack([x, y, np.ones_like(x)]), 1)
    return mapped[0] / mapped[2], mapped[1] / mapped[2]


def true_area(axes: tuple[float, float], ridges: Ridges | None, angle: float = 0.3, lines: int = 4001) -> float:
    """Area of an outline with its grooves taken off: ridges lie across u, chords are summed over v."""
    a, b = axes
    if ridges is None:
        return float(np.pi * a * b)
    edges = np.linspace(-b, b, lines + 1)
    v = 0.5 * (edges[1:] + edges[:-1])
    half = a * np.sqrt(np.clip(1 - (v / b) ** 2, 0, None))
    away = ridges.sway * np.sin(2 * np.pi * v / ridges.wave)

    def covered(u: Array) -> Array:
        """Length of ridge from -inf to u, up to a constant."""
        whole = np.floor(u / ridges.period)
        return ridges.part * ridges.period * whole + np.minimum(u - whole * ridges.period, ridges.part * ridges.period)

    shift = ridges.part * ridges.period / 2
    return float((covered(half + away + shift) - covered(-half + away + shift)).sum() * (edges[1] - edges[0]))


def hertz_gap(d: Array, a: float, radius: float) -> Array:
    """Gap at a distance outside a Hertz contact of half width a (Johnson 1985, eq. 3.42a) [mm]."""
    s = 1 + np.maximum(d, 0) / a
    return a**2 / radius * (s**2 / 2 - 1 + ((2 - s**2) * np.arcsin(1 / s) + np.sqrt(s**2 - 1)) / np.pi)


class Contact:
    """Light of a contact at plate positions, 0 to 1."""

    def __init__(
        self, axes: tuple[float, float], ridges: Ridges | None, air: bool, angle: float = 0.3,
        film: tuple[float, float] = (RADIUS_MM, DEPTH_MM),
    ) -> None:  # fmt: skip
        self.axes, self.ridges, self.air, self.angle, self.film = axes, ridges, air, angle, film

    def outside(self, x: Array, y: Array) -> tuple[Array, Array]:
        """Distances outside outline and ridge, to first order near an edge."""
        c, s = np.cos(self.angle), np.sin(self.angle)
        u, v = x * c + y * s, y * c - x * s
        a, b = self.axes
        rho = np.hypot(u / a, v / b)
        slope = np.hypot(u / a**2, v / b**2) / np.maximum(rho, 1e-9)
        outline = (rho - 1) / np.maximum(slope, 1e-9)
        if self.ridges is None:
            return outline, np.full_like(outline, -1.0)
        r = self.ridges
        w = u + r.sway * np.sin(2 * np.pi * v / r.wave)
        steep = np.hypot(1.0, r.sway * 2 * np.pi / r.wave * np.cos(2 * np.pi * v / r.wave))
        return outline, (np.abs((w / r.period + 0.5) % 1 - 0.5) - r.part / 2) * r.period / steep

    def light(self, x: Array, y: Array) -> Array:
        outline, groove = self.outside(x, y)
        if not self.air:
            return ((outline < 0) & (groove < 0)).astype(np.float64)
        gap = hertz_gap(outline, float(np.sqrt(self.axes[0] * self.axes[1])), self.film[0])
        if self.ridges is not None:
            gap = np.maximum(gap, hertz_gap(groove, self.ridges.part * self.ridges.period / 2, self.ridges.crest))
        return np.exp(-gap / self.film[1])


def shares(x: Array, y: Array, contact: Contact) -> Array:
    """Mean light of each pixel: one point where an edge is far, 10 x 10 where it is near."""
    (xv, xu), (yv, yu) = np.gradient(x), np.gradient(y)
    outline, groove = contact.outside(x, y)
    far = np.maximum(outline, groove)
    pixel = float(np.hypot(xu, yu).max())
    found = (far < 0).astype(np.float64)
    near = np.abs(far) < 3 * pixel
    at = tuple(q[near] for q in (x, y, xu, xv, yu, yv))
    total = np.zeros(len(at[0]))
    fine = (np.arange(WAYS) + 0.5) / WAYS - 0.5
    for du in fine:
        for dv in fine:
            total += contact.light(at[0] + at[2] * du + at[3] * dv, at[1] + at[4] * du + at[5] * dv)
    found[near] = total / WAYS**2
    return found


def scattered(light: Array, length_px: float) -> Array:
    """Convolve with exp(-r/length)/(2 pi length^2)."""
    rows, cols = light.shape
    pad = int(6 * length_px)
    below, right = (cv2.getOptimalDFTSize(n + 2 * pad) - n - pad for n in (rows, cols))
    wide = np.pad(light.astype(np.float32), ((pad, below), (pad, right)))
    qy, qx = (2 * np.pi * np.fft.fftfreq(n) * length_px for n in wide.shape)
    spread = cv2.dft(wide, flags=cv2.DFT_COMPLEX_OUTPUT) / (1 + qy[:, None, None] ** 2 + qx[:, None] ** 2) ** 1.5
    found = cv2.idft(spread.astype(np.float32), flags=cv2.DFT_SCALE | cv2.DFT_REAL_OUTPUT)
    return found[pad : pad + rows, pad : pad + cols].astype(np.float64)


def bayer(light: Array, colour: Colour, rng: np.random.Generator) -> Array:
    """8-bit RGB of red light by level: 1 fills a raw red pixel."""
    rows, cols = light.shape
    at = np.zeros((rows, cols), int)
    at[::2, 1::2] = at[1::2, ::2] = 1
    at[1::2, 1::2] = 2
    raw = light * np.array(colour.shares)[at]
    raw = np.clip(raw + np.sqrt(np.maximum(raw, 0) / colour.full_e + 4e-7) * rng.standard_normal(raw.shape), 0, 1)
    raw = np.minimum(raw * np.array(colour.gains)[at], 1.0)
    cross = np.array([[1, 2, 1], [2, 4, 2], [1, 2, 1]]) / 4.0
    plus = np.array([[0, 1, 0], [1, 4, 1], [0, 1, 0]]) / 4.0
    channels = (np.where(at == c, raw, 0.0) for c in range(3))
    rgb = np.stack([cv2.filter2D(one, -1, kernel, borderType=cv2.BORDER_REFLECT_101)
                    for one, kernel in zip(channels, (cross, plus, cross), strict=True)], -1)  # fmt: skip
    return np.rint(255 * bt709(rgb @ np.array(colour.matrix).T)).astype(np.uint8)


class Rig:
    """A lab with what does not change from frame to frame."""

    def __init__(self, lab: Lab) -> None:
        self.lab, self.rng = lab, np.random.default_rng(lab.seed)
        self.x, self.y = plate_xy(lab.lens, lab.pose())
        rows, cols = self.x.shape
        v, u = np.indices((rows, cols))
        self.even = 1 + 0.12 * (u / cols - 0.5) - 0.07 * (v / rows - 0.5)
        self.specks = np.zeros((rows, cols))
        for _ in range(lab.dust):
            at = int(self.rng.integers(0, cols)), int(self.rng.integers(0, rows))
            cv2.circle(self.specks, at, int(self.rng.integers(1, 4)), float(lab.step * self.rng.uniform(0.1, 0.9)), -1)
        self.empty = cv2.GaussianBlur(lab.ground * self.even + self.specks, (0, 0), lab.blur)

    def light(self, axes: tuple[float, float] | None, middle: tuple[float, float] | None = None) -> Array:
        """Linear light on the sensor, blurred."""
        lab, found = self.lab, self.empty.copy()
        if axes is None:
            return found
        at = lab.middle if middle is None else middle
        x, y = self.x - at[0], self.y - at[1]
        reach = 1.1 * max(axes) + (16 * lab.blur + 8) / lab.scale
        rows, cols = (np.flatnonzero((np.hypot(x, y) < reach).any(axis=k)) for k in (1, 0))
        box = np.s_[rows[0] : rows[-1] + 1, cols[0] : cols[-1] + 1]
        share = shares(x[box], y[box], Contact(axes, lab.ridges, lab.air, film=lab.film)) * self.even[box]
        found[box] += cv2.GaussianBlur(lab.step * share, (0, 0), lab.blur)
        if lab.glow[0]:
            whole = np.zeros_like(found)
            whole[box] = share
            found += lab.glow[0] * lab.step * scattered(whole, lab.glow[1] * lab.scale)
        return found

    def shoot(self, light: Array) -> NDArray[np.uint8]:
        """An 8-bit frame, (rows, cols) or (rows, cols, 3)."""
        lab = self.lab
        if lab.colour is not None:
            return bayer(light, lab.colour, self.rng)
        noisy = light + lab.noise * np.sqrt(np.maximum(light, 0.01) / 0.5) * self.rng.standard_normal(light.shape)
        return np.rint(255 * bt709(noisy)).astype(np.uint8)

    def frame(self, k: int) -> NDArray[np.uint8]:
        return self.shoot(self.light(self.lab.axes(k)))

    def true(self, k: float) -> float:
        axes = self.lab.axes(k)
        return 0.0 if axes is None else true_area(axes, self.lab.ridges)

    def force(self, k: float) -> float:
        factor, power = self.lab.law
        return (self.true(k) / factor) ** (1 / power)

    def print_picture(self, side: float, pose: Pose, board: Board | None) -> NDArray[np.uint8]:
        """A board, or a white card of that side on black, under room light."""
        lab = self.lab
        x, y = plate_xy(lab.lens, pose)
        (xv, xu), (yv, yu) = np.gradient(x), np.gradient(y)
        light, ways = np.zeros(x.shape), 5
        fine = (np.arange(ways) + 0.5) / ways - 0.5
        for a in range(ways):
            for b in range(ways):
                du, dv = fine[a] + fine[b] / ways, fine[b] + fine[a] / ways
                light += self._ink(x + xu * du + xv * dv, y + yu * du + yv * dv, side, board) / ways**2
        light = cv2.GaussianBlur(light * self.even, (0, 0), lab.blur)
        noisy = light + lab.noise * np.sqrt(light / 0.5) * self.rng.standard_normal(light.shape)
        return np.rint(255 * bt709(noisy)).astype(np.uint8)

    def _ink(self, x: Array, y: Array, side: float, board: Board | None) -> Array:
        dark, bright = 0.025, 0.55
        if board is None:
            return np.where((np.abs(x) < side / 2) & (np.abs(y) < side / 2), bright, dark)
        i, j = x / side + board.nx / 2, y / side + board.ny / 2
        inside = (i > 0) & (i < board.nx) & (j > 0) & (j < board.ny)
        square = np.where((np.floor(i) + np.floor(j)) % 2 == 0, dark, bright)
        return np.where(inside, square, bright if self.lab.white else dark)

    def views(self, count: int = 6) -> list[NDArray[np.uint8]]:
        """Boards: the first on the glass, the others held before the lens."""
        lab = self.lab
        side = lab.board.side * (1 + lab.print_error)
        poses = [lab.pose(0.1, -0.15, 0.02, lab.height)]
        for _ in range(count - 1):
            turn = cv2.Rodrigues(np.array([*self.rng.uniform(-0.35, 0.35, 2), self.rng.uniform(-0.1, 0.1)]))[0]
            far = lab.distance * self.rng.uniform(1.0, 1.35)
            poses.append(Pose(turn, np.array([*(far * self.rng.uniform(-0.04, 0.04, 2)), far])))
        return [self.print_picture(side, pose, lab.board) for pose in poses]

    def card(self) -> NDArray[np.uint8]:
        return self.print_picture(
            self.lab.card * (1 + self.lab.print_error), self.lab.pose(0.2, 0.1, 0.03, self.lab.height), None
        )

    def force_log(self) -> str:
        """Times and forces at the load cell's own rate and clock; the force rises by straight lines between frames."""
        lab = self.lab
        times = np.arange(lab.frames) / lab.rate + lab.later
        log = np.arange(0.0, times[-1] + 0.5, 1 / lab.force_rate)
        fine = np.arange(8 * lab.frames - 7) / 8
        force = [self.force(k) if k >= lab.free else max(0.0, k - lab.free + 1) * self.force(lab.free) for k in fine]
        force = np.interp(log, fine / lab.rate + lab.later, force)
        force = force + 0.002 * np.random.default_rng(lab.seed).standard_normal(len(log))
        return "time_s,force_N\n" + "".join(f"{t:.4f},{f:.5f}\n" for t, f in zip(log, force, strict=True))

    def camera_table(self) -> str:
        """Developed colour of even patches by exposure time, as a lab measures it: level,red,green,blue."""
        assert self.lab.colour is not None
        rows = ["level,red,green,blue", "0,0,0,0"]
        for level in np.geomspace(2e-3, 60, 120):
            patch = bayer(np.full((64, 64), level), self.lab.colour, self.rng)[4:-4, 4:-4].mean(axis=(0, 1))
            rows.append(f"{level:.6g}," + ",".join(f"{value:.3f}" for value in patch))
        return "\n".join(rows) + "\n"

    def write(self, folder: Path) -> Array:
        """Write boards, card, film, forces; return the true areas of the frames [mm^2]."""
        folder.mkdir(parents=True, exist_ok=True)
        for k, view in enumerate(self.views()):
            assert cv2.imwrite(str(folder / f"board{k}.png"), view)
        assert cv2.imwrite(str(folder / "card.png"), self.card())
        write_film(folder / "film.mp4", (self.frame(k) for k in range(self.lab.frames)), self.lab.rate, self.lab.crf)
        (folder / "force.csv").write_text(self.force_log())
        if self.lab.colour is not None:
            (folder / "camera.csv").write_text(self.camera_table())
        return np.array([self.true(k) for k in range(self.lab.frames)])


def write_film(path, frames, rate: int, crf: int = 18, times=None) -> None:
    """H.264, 4:2:0, as a camera's recorder writes it; ``times`` [s] where they are not even."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=rate, options={"crf": str(crf), "preset": "veryfast"})
        stream.pix_fmt = "yuv420p"
        tick = Fraction(1, 1000) if times is not None else Fraction(1, rate)
        for k, image in enumerate(frames):
            if k == 0:
                stream.height, stream.width = image.shape[:2]
                stream.codec_context.time_base = tick
            picture = av.VideoFrame.from_ndarray(image, format="rgb24" if image.ndim == 3 else "gray")
            picture.time_base = tick
            picture.pts = k if times is None else round(1000 * times[k])
            container.mux(stream.encode(picture))
        container.mux(stream.encode())


LABS = (
    Lab(
        "smooth",
        (640, 480),
        31.0,
        1000.0,
        (-0.18, 0.05),
        Board(17, 13, 1.0),
        True,
        9.0,
        0.7,
        25,
        83,
        8,
        100.0,
        0.37,
        (5.2, 0.66),
        (1.1, 3.0),
        ratio=0.85,
        air=True,
        noise=0.004,
        middle=(0.6, -0.4),
        seed=11,
    ),
    Lab(
        "ridged",
        (1280, 960),
        44.0,
        1500.0,
        (-0.11, 0.03),
        Board(16, 12, 1.5),
        False,
        12.0,
        1.2,
        30,
        66,
        6,
        50.0,
        -0.2,
        (3.1, 0.8),
        (1.2, 4.1),
        ratio=0.7,
        ridges=Ridges(0.48, 0.62, 0.15, 4.0),
        air=True,
        glow=(0.08, 0.7),
        dust=40,
        middle=(-0.9, 0.7),
        seed=12,
    ),
    Lab(
        "large",
        (2000, 1500),
        58.0,
        2600.0,
        (0.06, -0.1),
        Board(20, 14, 1.25),
        True,
        15.0,
        2.0,
        50,
        46,
        6,
        200.0,
        0.11,
        (4.4, 0.7),
        (1.3, 4.4),
        ridges=Ridges(0.55, 0.55, 0.0),
        dust=60,
        noise=0.006,
        middle=(1.3, 0.8),
        crf=20,
        seed=13,
    ),
    Lab(
        "red",
        (1280, 960),
        40.0,
        1250.0,
        (-0.22, 0.08),
        Board(14, 10, 1.9),
        True,
        14.0,
        1.0,
        30,
        56,
        6,
        25.0,
        0.5,
        (6.0, 0.62),
        (0.9, 3.6),
        ratio=0.9,
        air=True,
        step=4.0,
        ground=0.02,
        middle=(0.4, 0.5),
        colour=Colour(),
        seed=14,
    ),
    Lab(
        "rough",
        (640, 480),
        33.0,
        900.0,
        (-0.09, -0.02),
        Board(16, 12, 1.1),
        False,
        8.0,
        0.9,
        50,
        85,
        10,
        80.0,
        0.9,
        (4.0, 0.75),
        (1.0, 3.4),
        ratio=0.75,
        ridges=Ridges(0.6, 0.6, 0.2, 5.0),
        glow=(0.05, 0.5),
        dust=15,
        noise=0.008,
        step=0.5,
        middle=(-0.5, 0.2),
        seed=15,
    ),
)
"""Grey cameras but one; prints exact: :func:`printed` gives them their errors."""


def another(lab: Lab, rng: np.random.Generator) -> Lab:
    """A lab like one of these with other numbers: nothing was tuned on it."""
    near = {name: getattr(lab, name) * float(rng.uniform(0.9, 1.1)) for name in ("scale", "blur", "noise", "step")}
    ridges = lab.ridges
    if ridges is not None:
        ridges = replace(
            ridges, period=ridges.period * float(rng.uniform(0.95, 1.2)), part=float(rng.uniform(0.5, 0.65)),
            sway=float(rng.uniform(0, 0.2)), wave=float(rng.uniform(3.5, 6)), height=float(rng.uniform(0.06, 0.12)),
        )  # fmt: skip
    x, y = rng.uniform(-0.6, 0.6, 2)
    return replace(
        lab, **near, ridges=ridges, ratio=float(rng.uniform(0.7, 0.95)), later=float(rng.uniform(-0.5, 0.9)),
        middle=(lab.middle[0] + float(x), lab.middle[1] + float(y)), seed=int(rng.integers(1000, 10**6)),
        film=(float(rng.uniform(6, 13)), float(rng.uniform(5e-5, 9e-5))),
        tilt=(float(rng.uniform(-0.01, 0.01)), float(rng.uniform(-0.01, 0.01))),
    )  # fmt: skip


def printed(lab: Lab, rng: np.random.Generator) -> Lab:
    """A lab whose prints are longer than stated by up to 0.2 % and lie up to 0.1 mm above the plate."""
    return replace(lab, print_error=float(rng.uniform(-0.002, 0.002)), height=float(rng.uniform(0, 0.1)))
