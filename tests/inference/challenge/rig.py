"""The believed rigs, what is photographed, and their light at twice the resolution, kept on disk.

Light is linear in LED power and changes smoothly with pose and force, so a rig's light is rendered once for a few poses
and the six forces of the protocol, and for forces between them, at small steps of their logarithm, when a case first
asks for it. Frames of a case are made of these fields.
"""

from __future__ import annotations

import functools
import hashlib
import json
import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

import evanesce
from evanesce.bundle.card_light import card_light
from evanesce.bundle.layout import Shot
from evanesce.bundle.protocol import default_protocol
from evanesce.contact.solve import contact_state
from evanesce.core.states import PlateLight
from evanesce.optics.led import led_radiances
from evanesce.optics.projection import IdealView, Projection
from evanesce.render.cards import Pose, checkerboard_of, pose_of, square_of
from evanesce.render.fast.transport import render_fast
from evanesce.rig import Scene, load_scene
from evanesce.sensor.lens import form_image

FINER = 2
LENS_FINER = 2  # pixels on which the lens blurs, along each of the fine frame's: a sharp lens asks for them
VIEW_FINER = 2  # of the pinhole view over those: the lens's remapping then blurs next to nothing
FORCE_STEP = 0.02
KNOT, KNOTS = 0.02, 16  # of the force's logarithm, between pictures and how many to each side: an edge moves by a pixel
POSES = 3
REPLICATES, DARKS = 12, 4
CACHE = Path(os.environ.get("EVANESCE_CHALLENGE", "outputs/challenge"))
VERSION = 3

# The thesis's sensor at a sixteenth of its light and 400 x 300 pixels of it: a dim rig, so that noise, not the
# fineness of somebody's mesh, decides what can be seen.
DIM_CAMERA = {
    "camera.resolution_px": [400, 300],
    "camera.scale_px_per_mm": 58.37 / 5,
    "camera.pixel.pitch_um": 15.5,
    "camera.pixel.fill_factor": 0.05,
    "camera.pixel.full_well_capacity_e": 8180.0,
    "camera.pixel.conversion_gain_e_per_DN": 2.13,
    "camera.analogue_gain": 16.0,
    "camera.exposure_ms": 0.3,
    "camera.lens.defocus_um": 140.0,
    "press.forces_N": [5.0],
    "card.checkerboard_squares": [10, 8],
    "card.checkerboard_side_mm": 4.0,
}

BELIEVED: dict[str, dict[str, object]] = {
    "dev": {},
    "scored": {
        "leds.pitch_mm": 14.3,
        "finger.tip_radius_mm": 8.2,
        "plate.size_mm": [112.0, 86.0],
        "camera.lens.defocus_um": 165.0,
    },
    "soft": {
        "plate.size_mm": [104.0, 84.0],
        "plate.thickness_mm": 4.0,
        "plate.refractive_index": 1.49,
        "leds.pitch_mm": 12.4,
        "finger.tip_radius_mm": 6.4,
        "finger.material": "own",
        "finger.modulus_MPa": 0.11,
        "camera.resolution_px": [320, 240],
        "camera.scale_px_per_mm": 9.6,
        "camera.lens.focal_length_mm": 8.0,
        "camera.lens.defocus_um": 170.0,
        "camera.exposure_ms": 0.14,
        "press.forces_N": [3.0],
    },
    "thick": {
        "plate.size_mm": [126.0, 96.0],
        "plate.thickness_mm": 8.0,
        "plate.refractive_index": 1.517,
        "leds.pitch_mm": 15.1,
        "finger.tip_radius_mm": 10.0,
        "finger.material": "own",
        "finger.modulus_MPa": 0.2,
        "camera.resolution_px": [360, 272],
        "camera.scale_px_per_mm": 10.4,
        "camera.lens.defocus_um": 150.0,
        "press.forces_N": [6.0],
    },
    "thin": {
        "plate.size_mm": [110.0, 90.0],
        "plate.thickness_mm": 5.0,
        "leds.pitch_mm": 13.7,
        "finger.tip_radius_mm": 7.0,
        "camera.resolution_px": [320, 240],
        "camera.scale_px_per_mm": 9.2,
        "camera.lens.f_number": 5.0,
        "camera.lens.defocus_um": 155.0,
        "camera.exposure_ms": 0.16,
    },
    "wide": {
        "plate.size_mm": [132.0, 88.0],
        "leds.edges": ["left", "right", "top"],
        "leds.pitch_mm": 11.0,
        "finger.tip_radius_mm": 8.8,
        "finger.material": "own",
        "finger.modulus_MPa": 0.17,
        "camera.resolution_px": [384, 288],
        "camera.scale_px_per_mm": 10.9,
        "camera.lens.focal_length_mm": 5.0,
        "camera.lens.defocus_um": 140.0,
        "press.forces_N": [4.0],
    },
}
"""What cases believe, over the thesis's rig and :data:`DIM_CAMERA`; ``dev`` and ``scored`` come first in the alphabet,
so that the poses of theirs stay as they are when another is added."""


@dataclass(frozen=True)
class View:
    """One picture of the protocol, or the mean of several equal ones.

    Attributes
    ----------
    kind : str
        ``press``, ``replicate``, ``led_off``, ``lens_cap``, ``checkerboard``, ``square``.
    shot : Shot
        Of a press; of an auxiliary shot its time alone counts.
    frames : int
    spare : bool
        Left out of the strength: about a quarter of the press conditions, which a critic holds back.
    """

    kind: str
    shot: Shot
    frames: int = 1
    spare: bool = False

    @property
    def touches(self) -> bool:
        return self.kind in ("press", "replicate")

    @property
    def lit_by_leds(self) -> bool:
        return self.touches

    @property
    def is_card(self) -> bool:
        return self.kind in ("checkerboard", "square")


@functools.cache
def believed(name: str) -> Scene:
    """Return the rig that cases of a set believe in."""
    return load_scene("thesis", DIM_CAMERA | BELIEVED[name])


@functools.cache
def views(name: str) -> tuple[View, ...]:
    """Return what is photographed."""
    scene = believed(name)
    shots = default_protocol(scene).press
    spare = _spare(shots)
    found = [View("press", shot, spare=shot.condition in spare) for shot in shots]
    last = shots[-1]
    held = replace(shots[len(shots) - 6], time_s=last.time_s + 10.0, index=1000, held_s=last.held_s + 10.0)
    assert held.voltage_V == scene.leds.voltage_V
    found.append(View("replicate", held, frames=REPLICATES))
    for k, (kind, frames) in enumerate(
        (("led_off", DARKS), ("lens_cap", DARKS), ("checkerboard", 1), ("square", 1)), start=2
    ):
        shot = Shot(index=1000 * k, time_s=0.0, force_N=0.0, voltage_V=scene.leds.voltage_V)
        found.append(View(kind, shot, frames=frames))
    return tuple(found)


def _spare(shots: tuple[Shot, ...]) -> set[int]:
    """Return the conditions that a critic holds back: about a quarter, spread, none at an end of a range and no hold.

    A critic's own rule cannot be imported here; ``tests/inference/test_challenge_split.py`` compares.
    """
    members: dict[int, list[Shot]] = {}
    for shot in shots:
        members.setdefault(shot.condition, []).append(shot)
    ends_f = {f(s.force_N for s in shots) for f in (min, max)}
    ends_v = {f(s.voltage_V for s in shots) for f in (min, max)}
    inner = sorted(
        (own[0].force_N, own[0].voltage_V, condition)
        for condition, own in members.items()
        if len(own) == 1 and own[0].force_N not in ends_f and own[0].voltage_V not in ends_v
    )
    count = min(round(len(members) / 4), len(inner) // 2)
    return {inner[round((k + 0.5) * len(inner) / count - 0.5)][2] for k in range(count)}


@functools.cache
def power(name: str, voltage_V: float) -> float:
    """Return LED power over that at the believed voltage [1]."""
    scene = believed(name)

    def total(volts: float) -> float:
        leds = scene.leds.model_copy(update={"voltage_V": volts})
        return float(np.mean(np.concatenate(list(led_radiances(scene.plate, leds).values()))))

    return total(voltage_V) / total(scene.leds.voltage_V)


def fine_scene(scene: Scene, finer_px: int = FINER) -> Scene:
    """Return the rig seen with pixels half as large, or smaller still; only its optics count."""
    camera = scene.camera
    pixel = camera.pixel.model_copy(update={"pitch_um": camera.pixel.pitch_um / finer_px})
    finer = camera.model_copy(
        update={
            "resolution_px": (camera.resolution_px[0] * finer_px, camera.resolution_px[1] * finer_px),
            "scale_px_per_mm": camera.scale_px_per_mm * finer_px,
            "pixel": pixel,
        }
    )
    grid = scene.grid.model_copy(update={"samples": 1024})
    return scene.model_copy(update={"camera": finer, "grid": grid})


def fine_view(scene: Scene) -> IdealView:
    """Return a pinhole view finer than the fine frame."""
    view = Projection.of(scene.camera, scene.plate).ideal_view()
    (rows, cols), (px, py), k = view.shape, view.principal_point, VIEW_FINER
    return IdealView((rows * k, cols * k), view.focal_px * k, ((px + 0.5) * k - 0.5, (py + 0.5) * k - 0.5))


def irradiance(scene: Scene, light: PlateLight) -> np.ndarray:
    """Return a fine frame's irradiance [W mm^-2], float32 (FINER rows, FINER cols)."""
    lens = form_image(light, scene.camera, scene.plate).irradiance
    rows, cols = (n // LENS_FINER for n in lens.shape)
    return lens.reshape(rows, LENS_FINER, cols, LENS_FINER).mean(axis=(1, 3)).astype(np.float32)


@dataclass(frozen=True)
class BaseLight:
    """Light of a rig at one pose.

    Attributes
    ----------
    forces : tuple of float
        [N].
    press : ndarray (forces, fine rows, fine cols)
        At the believed voltage [W mm^-2].
    by_log_force : ndarray (forces, fine rows, fine cols)
        Its derivative.
    cards : dict
        ``checkerboard``, ``square``, and ``plain``: a card without print.
    pose_mm : tuple of float
        Of the finger beside its believed place.
    harder : callable
        Takes the number of a force and how many ``KNOT`` its logarithm is larger; returns ``press`` there.
    """

    forces: tuple[float, ...]
    press: np.ndarray
    by_log_force: np.ndarray
    cards: dict[str, np.ndarray]
    pose_mm: tuple[float, float]
    harder: Callable[[int, int], np.ndarray]

    def force_index(self, force_N: float) -> int:
        return int(np.argmin(np.abs(np.array(self.forces) - force_N)))

    def pressed(self, k: int, log_force: float) -> np.ndarray:
        """Return the light at a force whose logarithm is larger by so much, float64 (fine rows, fine cols).

        Between two pictures that were rendered: an edge that moves is not its first picture and a share of a slope.
        Beyond the last of them along the last two.
        """
        if log_force == 0.0:
            return self.press[k].astype(np.float64)
        steps = abs(log_force) / KNOT
        low = min(int(steps), KNOTS - 1)
        sign = 1 if log_force > 0 else -1
        near, far = (self.harder(k, sign * n) if n else self.press[k] for n in (low, low + 1))
        return np.asarray(np.maximum(near + (steps - low) * (far.astype(np.float64) - near), 0.0))


def pose_of_case(name: str, pose: int) -> tuple[tuple[float, float], Pose]:
    """Return finger and card poses of a set's pool; the pool differs from set to set."""
    rng = np.random.default_rng([20, sorted(BELIEVED).index(name), pose])
    finger = tuple(float(v) for v in rng.uniform(-0.4, 0.4, 2))
    x, y, turn = rng.uniform(-1, 1, 3) * (0.5, 0.5, 0.8)
    return (finger[0], finger[1]), Pose(shift=(float(x), float(y)), rotation_deg=float(turn))


@functools.lru_cache(maxsize=3)
def base_light(name: str, pose: int) -> BaseLight:
    """Return a rig's light at one of its poses; rendered on first use (about a minute), then read from disk."""
    scene = believed(name)
    recipe = [VERSION, _code(), scene.as_dict(), pose, FORCE_STEP]
    key = hashlib.sha256(json.dumps(recipe, sort_keys=True).encode()).hexdigest()
    path = CACHE / "base" / f"{key[:24]}.npz"
    forces = tuple(sorted({shot.shot.force_N for shot in views(name) if shot.touches}))
    finger, card = pose_of_case(name, pose)
    if not path.is_file():
        made = _render(scene, forces, finger, card)
        path.parent.mkdir(parents=True, exist_ok=True)
        part = path.with_suffix(f".{os.getpid()}.npz")
        np.savez(part, **made)
        os.replace(part, path)
    with np.load(path) as kept:
        cards = {kind: kept[kind] for kind in ("checkerboard", "square")}
        base = kept["press"], kept["by_log_force"]

    cards["plain"] = _plain(path, scene)

    @functools.lru_cache(maxsize=60)
    def harder(k: int, knots: int) -> np.ndarray:
        own = path.with_name(f"{path.stem}-{k}-{knots}.npz")
        if not own.is_file():
            picture = presser(scene, finger)(forces[k] * float(np.exp(knots * KNOT)))
            part = own.with_suffix(f".{os.getpid()}.npz")
            np.savez(part, picture=picture)
            os.replace(part, own)
        with np.load(own) as one:
            return np.asarray(one["picture"])

    return BaseLight(forces, *base, cards, finger, harder)


def _plain(path: Path, scene: Scene) -> np.ndarray:
    """Return the light of a card without print, rendered on first use."""
    own = path.with_name(f"{path.stem}-plain.npz")
    if not own.is_file():
        fine = _fine_at(scene, (0.0, 0.0))
        plain = replace(square_of(fine.card), side=400.0)
        part = own.with_suffix(f".{os.getpid()}.npz")
        np.savez(part, picture=irradiance(fine, card_light(fine, plain, Pose(), view=fine_view(fine))))
        os.replace(part, own)
    with np.load(own) as one:
        return np.asarray(one["picture"])


@functools.cache
def _code() -> str:
    """Return a digest of the code that makes light: light made by other code is made anew."""
    digest = hashlib.sha256()
    for name in ("contact", "optics", "render", "sensor/lens.py"):
        place = Path(evanesce.__file__).parent / name
        for file in sorted(place.rglob("*.py")) if place.is_dir() else [place]:
            digest.update(file.read_bytes())
    return digest.hexdigest()


def _fine_at(scene: Scene, finger: tuple[float, float]) -> Scene:
    x, y = scene.finger.position_mm
    place = scene.finger.model_copy(update={"position_mm": (x + finger[0], y + finger[1])})
    return fine_scene(scene.model_copy(update={"finger": place}), FINER * LENS_FINER)


def presser(scene: Scene, finger: tuple[float, float]) -> Callable[[float], np.ndarray]:
    """Return what makes the light at a force [N]."""
    fine = _fine_at(scene, finger)
    view = fine_view(fine)
    return lambda force: irradiance(fine, render_fast(fine, contact_state(fine, force), view=view))


def _render(scene: Scene, forces: tuple[float, ...], finger: tuple[float, float], card: Pose) -> dict[str, np.ndarray]:
    fine, press = _fine_at(scene, finger), presser(scene, finger)
    view = fine_view(fine)
    base, slope = [], []
    for force in forces:
        low, high = press(force * np.exp(-FORCE_STEP)), press(force * np.exp(FORCE_STEP))
        base.append(press(force))
        slope.append((high - low) / (2 * FORCE_STEP))
    lying = pose_of(fine.card, card)
    return {
        "press": np.array(base),
        "by_log_force": np.array(slope),
        "checkerboard": irradiance(fine, card_light(fine, checkerboard_of(fine.card), lying, view=view)),
        "square": irradiance(fine, card_light(fine, square_of(fine.card), lying, view=view)),
    }


@dataclass(frozen=True)
class Geometry:
    """Coordinates of the fine frame's pixels.

    Attributes
    ----------
    u, v : ndarray
        From the optical centre over the half-diagonal [1].
    x, y : ndarray
        Of the plate point seen [mm].
    mm_per_px : float
        On the axis, of the fine frame [mm].
    ray_x, ray_y : ndarray
        Tangents of the ray seen through the believed lens [1].
    focal : float
        Focal length over the half-diagonal [1].
    radial : tuple of float
        The believed lens's coefficients of r^2 and r^4 [1].
    distance_mm, thickness_mm : float
        From the lens to the glass, and through it.
    index : float
        Of the glass [1].
    """

    u: np.ndarray
    v: np.ndarray
    x: np.ndarray
    y: np.ndarray
    mm_per_px: float
    ray_x: np.ndarray
    ray_y: np.ndarray
    focal: float
    radial: tuple[float, float]
    distance_mm: float
    thickness_mm: float
    index: float

    def seen(self, ray_x: np.ndarray, ray_y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return where the believed lens images rays of some tangents, as ``u`` and ``v``."""
        r2 = ray_x * ray_x + ray_y * ray_y
        k1, k2 = self.radial
        stretch = self.focal * (1 + k1 * r2 + k2 * r2 * r2)
        return ray_x * stretch, ray_y * stretch

    def in_glass(self, tangent2: np.ndarray) -> np.ndarray:
        """Return the tangent of a refracted ray over that of the ray, of whose tangent the square is given (Snell)."""
        return 1.0 / np.sqrt(self.index**2 + (self.index**2 - 1.0) * tangent2)

    def seen_before(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return where the believed rig shows points of its plate [mm], as ``u`` and ``v``."""
        radius = np.maximum(np.hypot(x, y), 1e-9)
        tangent = radius / (self.distance_mm + self.thickness_mm / self.index)
        for _ in range(20):  # the glass bends little: each round gains a factor of ten
            tangent = radius / (self.distance_mm + self.thickness_mm * self.in_glass(tangent**2))
        return self.seen(x / radius * tangent, y / radius * tangent)

    def middle_of(self, square: np.ndarray) -> tuple[float, float]:
        """Return the middle of a printed square on the plate [mm], from a picture of it: that of its edges."""
        share = np.hypot(*np.gradient(square.astype(float)))
        share /= share.sum()
        return float((share * self.x).sum()), float((share * self.y).sum())

    def raised(self, height_mm: float) -> tuple[np.ndarray, np.ndarray]:
        """Return where each pixel's point of a card so far above the glass was seen on it, as ``u`` and ``v``."""
        glass = self.thickness_mm * self.in_glass(self.ray_x**2 + self.ray_y**2)
        reach = self.distance_mm + height_mm + glass
        return self.seen_before(self.ray_x * reach, self.ray_y * reach)

    def leaning(self, angle: float, lean: tuple[float, float]) -> tuple[np.ndarray, np.ndarray]:
        """Return where each pixel's point of a plate that leans was seen before, as ``u`` and ``v``.

        It turns by an angle [rad] about its middle on the far face, towards a direction, and the glass with it.
        """
        along = lean[0] * self.ray_x + lean[1] * self.ray_y
        across = lean[0] * self.ray_y - lean[1] * self.ray_x
        depth = np.cos(angle) + np.sin(angle) * along
        along = (np.cos(angle) * along - np.sin(angle)) / depth
        across = across / depth
        whole = self.distance_mm + self.thickness_mm
        air = whole * np.cos(angle) - self.thickness_mm
        reach = air + self.thickness_mm * self.in_glass(along**2 + across**2)
        e, n = whole * np.sin(angle) + along * reach, across * reach
        return self.seen_before(lean[0] * e - lean[1] * n, lean[1] * e + lean[0] * n)


def undistorted(radius: np.ndarray, radial: tuple[float, float]) -> np.ndarray:
    """Return the radius at which a lens without distortion would image what one with it images at another (Newton)."""
    k1, k2 = radial
    found = radius.copy()
    for _ in range(20):
        r2 = found * found
        found = found - (found * (1 + k1 * r2 + k2 * r2 * r2) - radius) / (1 + 3 * k1 * r2 + 5 * k2 * r2 * r2)
    return found


@functools.cache
def geometry(name: str) -> Geometry:
    """Return the fine frame's coordinates."""
    fine = fine_scene(believed(name))
    projection = Projection.of(fine.camera, fine.plate)
    rows, cols = projection.shape
    col, row = np.meshgrid(np.arange(cols, dtype=float), np.arange(rows, dtype=float))
    x, y = projection.to_plate(col, row)
    cx, cy = projection.principal_point
    half = np.hypot(rows, cols) / 2
    u, v = (col - cx) / half, (row - cy) / half
    k1, k2, *others = projection.distortion
    assert not any(others)
    focal = projection.focal_px / half
    bent = np.maximum(np.hypot(u, v) / focal, 1e-9)
    straight = undistorted(bent, (k1, k2)) / bent / focal
    scale, plate = fine.camera.scale_px_per_mm, fine.plate
    distance = projection.focal_px / scale - plate.thickness_mm / plate.refractive_index
    return Geometry(
        u, v, x, y, 1.0 / scale, u * straight, v * straight, focal, (k1, k2), distance, plate.thickness_mm,
        plate.refractive_index,
    )  # fmt: skip
