"""The whole loop on the thesis's rig: calibration targets, presses, reference segmentation, truth, error split.

The table's frames come from the fast renderer; one frame of each finger is path traced as well and compared with it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.chain.simulate import expose, simulate
from evanesce.core import provenance
from evanesce.evaluation.evaluate import Camera, Evaluation, evaluate
from evanesce.evaluation.labels import label, view_geometry
from evanesce.measurement.calibration.board_images import find_boards
from evanesce.measurement.calibration.fit import Calibrated, calibrate
from evanesce.measurement.calibration.model import Calibration, save_calibration
from evanesce.measurement.calibration.rectify import Rectification, rectification, rectify
from evanesce.measurement.io.images import read_image
from evanesce.measurement.reference.area import SquareScale, square_scale
from evanesce.measurement.reference.segment import Chain
from evanesce.optics.projection import Projection
from evanesce.render.cards import CHECKERBOARD, SQUARE, Card, Pose, render_card
from evanesce.render.fast.transport import render_fast
from evanesce.render.reference.path import render
from evanesce.rig import Scene, load_scene
from evanesce.sensor.codec import write_png

Tick = Callable[[str, int, int], None]
"""``tick(what, done, total)``, called as work proceeds."""

THRESHOLD = 0.15
"""A grey level that an eye may pick from the histogram; the thesis prints none."""

MARGIN_PX = 60
"""Surroundings of the contact that are shown [px]."""

# Tilts both ways in x and y, so that the focal length can be separated from the distance; the last lies on the glass.
POSES = (
    Pose(height=9.5, tilt_x_deg=16.0, tilt_y_deg=3.0, rotation_deg=4.0),
    Pose(height=9.0, tilt_x_deg=-15.0, tilt_y_deg=5.0, rotation_deg=-7.0, shift=(1.0, -0.6)),
    Pose(height=11.0, tilt_x_deg=2.0, tilt_y_deg=17.0, rotation_deg=11.0, shift=(-0.8, 0.9)),
    Pose(height=11.5, tilt_x_deg=-4.0, tilt_y_deg=-16.0, rotation_deg=2.0, shift=(0.4, 0.3)),
    Pose(height=11.0, tilt_x_deg=11.0, tilt_y_deg=-12.0, rotation_deg=45.0, shift=(0.5, 1.2)),
    Pose(shift=(0.37, -0.21), rotation_deg=1.3),
)


@dataclass(frozen=True, kw_only=True)
class DemoSettings:
    """How much the demo does.

    Attributes
    ----------
    forces : tuple of float
        Normal forces [N], for each finger.
    compared_force : float or None
        Normal force [N] of the frames that both renderers take; None: no comparison.
    samples_per_pixel, passes : int
        Of the path tracer around the contact.
    card_samples_per_pixel : int
    poses : tuple of Pose
        Of the checkerboard.
    seed : int
    """

    forces: tuple[float, ...] = (1.0, 2.0, 5.0)
    compared_force: float | None = 2.0
    samples_per_pixel: int = 48
    passes: int = 4
    card_samples_per_pixel: int = 4
    poses: tuple[Pose, ...] = POSES
    seed: int = 1

    @classmethod
    def quick(cls) -> DemoSettings:
        """Return less than a minute's work: one force, fewer paths, and a single board that lies on the glass."""
        return cls(forces=(2.0,), samples_per_pixel=16, passes=2, card_samples_per_pixel=2, poses=POSES[-1:])


@dataclass(frozen=True, kw_only=True)
class CalibratedRig:
    """Calibration found from the pictures of the printed targets.

    Attributes
    ----------
    calibration : Calibration
    result : Calibrated
        Of the checkerboard.
    square : SquareScale
    rectified : Rectification
    pictures : dict
        One checkerboard and the square as the camera saw them, uint8 [DN].
    """

    calibration: Calibration
    result: Calibrated
    square: SquareScale
    rectified: Rectification
    pictures: dict[str, NDArray[np.uint8]]


@dataclass(frozen=True, kw_only=True)
class DemoFrame:
    """One press of one finger."""

    finger: str
    force_N: float
    evaluation: Evaluation

    def row(self) -> dict[str, Any]:
        """Return the table's row, units in the keys."""
        return {"finger": self.finger, "force_N": self.force_N} | self.evaluation.row()


@dataclass(frozen=True, kw_only=True)
class RendererPair:
    """One press by both renderers, without sensor noise, so that what differs is light.

    Attributes
    ----------
    finger : str
    force_N : float
    fast, reference : ndarray of uint8 (rows, cols)
        Frames [DN], cut to the contact and its surroundings.
    true_mask : ndarray of bool (rows, cols)
        Contact in the same pixels.
    """

    finger: str
    force_N: float
    fast: NDArray[np.uint8]
    reference: NDArray[np.uint8]
    true_mask: NDArray[np.bool_]

    @property
    def difference(self) -> NDArray[np.float64]:
        """Fast minus path traced [DN]."""
        return self.fast.astype(float) - self.reference

    def row(self) -> dict[str, Any]:
        """Return the mean and the RMS difference inside the contact [DN], the reference's noise included."""
        inside = self.difference[self.true_mask]
        level = float(self.reference[self.true_mask].mean())
        return {
            "finger": self.finger, "force_N": self.force_N, "contact_level_DN": level,
            "mean_difference_DN": float(inside.mean()), "rms_difference_DN": float(np.sqrt((inside**2).mean())),
        }  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Demo:
    """Everything the demo found."""

    rig: CalibratedRig
    frames: list[DemoFrame]
    pairs: list[RendererPair]
    provenance: dict[str, Any]

    def as_dict(self) -> dict[str, Any]:
        """Return the JSON result."""
        rig = self.rig
        return {
            "calibration": {
                "mm2_per_px": rig.square.mm2_per_px,
                "px_per_mm2": 1.0 / rig.square.mm2_per_px,
                "grid_rms_px": rig.result.grid_rms_px,
                "camera_matrix": rig.calibration.camera_matrix.tolist(),
                "distortion": rig.calibration.distortion.tolist(),
                "warnings": [{"code": w.code, "text": w.text} for w in rig.result.warnings],
            },
            "frames": [frame.row() for frame in self.frames],
            "renderers": [pair.row() for pair in self.pairs],
            "provenance": self.provenance,
        }


def calibrate_rig(
    scene: Scene, folder: Path, settings: DemoSettings, variant: str, tick: Callable[[int, int], None]
) -> CalibratedRig:
    """Render both cards, keep the pictures in ``folder``, and calibrate from those files as a lab would.

    Raises
    ------
    WorkError
        If a board is not found, which a rig that cannot see its card deserves.
    """
    count = len(settings.poses) + 1

    def shoot(card: Card, pose: Pose | None, index: int, name: str) -> Path:
        light = render_card(
            scene, card, pose, variant=variant, samples_per_pixel=settings.card_samples_per_pixel, passes=2,
            seed=settings.seed + index,
        )  # fmt: skip
        path = folder / f"{name}.png"
        write_png(path, expose(scene, light, seed=settings.seed, index=index)[1].data)
        tick(index + 1, count)
        return path

    boards = [shoot(CHECKERBOARD, p, k, f"checkerboard_{k}") for k, p in enumerate(settings.poses)]
    square_file = shoot(SQUARE, None, len(boards), "square")
    found = find_boards(boards, CHECKERBOARD.side)
    result = calibrate(found.views, found.image_size)
    rectified = rectification(result.calibration)
    picture = read_image(square_file).data
    square = square_scale(rectify(picture, rectified), SQUARE.side)
    calibration = Calibration(
        image_size=result.calibration.image_size,
        camera_matrix=result.calibration.camera_matrix,
        distortion=result.calibration.distortion,
        mm2_per_px=square.mm2_per_px,
        square_side_mm=SQUARE.side,
        details=result.calibration.details,
    )
    save_calibration(folder / "calibration.json", calibration)
    pictures = {"checkerboard": read_image(boards[-1]).data, "square": picture}
    return CalibratedRig(calibration=calibration, result=result, square=square, rectified=rectified, pictures=pictures)


def run_demo(
    folder: Path,
    settings: DemoSettings,
    *,
    variant: str = "auto",
    reference: bool = False,
    record: dict[str, Any] | None = None,
    tick: Tick = lambda what, done, total: None,
) -> Demo:
    """Run the loop; pictures, frames and the calibration go to ``folder`` as they are made.

    Parameters
    ----------
    folder : Path
        Exists.
    settings : DemoSettings
    variant : str
        Mitsuba variant.
    reference : bool
        Path trace every frame of the table.
    record : dict, optional
        What provenance should say of the renderer.
    tick : callable
        Called with what is being done, how much of it is done, and of how much.
    """
    smooth = load_scene("thesis")
    fingers = {"smooth": smooth, "ridged": load_scene("thesis_ridged")}
    (folder / "cards").mkdir(exist_ok=True)
    rig = calibrate_rig(smooth, folder / "cards", settings, variant, lambda done, total: tick("cards", done, total))
    chain = Chain(threshold=THRESHOLD)
    camera = Camera.of(smooth, rig.calibration, rig.square.mm2_per_px)  # the fingers share it
    traced: dict[str, Any] = {
        "render": render, "samples_per_pixel": settings.samples_per_pixel, "passes": settings.passes, "variant": variant
    }  # fmt: skip
    frames, pairs = [], []
    total = len(fingers) * len(settings.forces)
    for finger, scene in fingers.items():
        (folder / finger).mkdir(exist_ok=True)
        for k, force in enumerate(settings.forces):
            time_s = k / scene.press.frame_rate_hz
            options = traced if reference else {"render": render_fast}
            shot = simulate(scene, force, seed=settings.seed, index=k, time_s=time_s, **options)
            write_png(folder / finger / f"frame_{k:06d}.png", shot.frame.data)
            found = evaluate(shot, chain, camera, seed=settings.seed)
            frames.append(DemoFrame(finger=finger, force_N=force, evaluation=found))
            tick("presses", len(frames), total)
    if settings.compared_force is not None:
        for finger, scene in fingers.items():
            pairs.append(both_renderers(finger, scene, settings.compared_force, traced, seed=settings.seed))
            tick("path tracing", len(pairs), len(fingers))
    origin = provenance.record(seed=settings.seed, config=smooth.as_dict(), **(record or {}))
    return Demo(rig=rig, frames=frames, pairs=pairs, provenance=dict(origin))


def both_renderers(finger: str, scene: Scene, force_N: float, traced: dict[str, Any], *, seed: int) -> RendererPair:
    """Take one press by the fast renderer and by the path tracer, sensor noise left out.

    Parameters
    ----------
    finger : str
    scene : Scene
    force_N : float
        Normal force [N].
    traced : dict
        The path tracer and its options, as :func:`evanesce.chain.simulate.simulate` takes them.
    seed : int
    """
    shots = [simulate(scene, force_N, seed=seed, **options) for options in ({"render": render_fast}, traced)]
    fast, reference = (expose(s.scene, s.plate_light, seed=seed, without={"noise"})[1].data for s in shots)
    rig = shots[0].scene
    projection = Projection.of(rig.camera, rig.plate)
    state = shots[0].state
    assert state is not None  # a force was given
    mask = label(state, view_geometry(projection, None)).mask > 0.5
    rows, cols = (np.flatnonzero(mask.any(axis=axis)) for axis in (1, 0))
    high, wide = mask.shape
    part = (
        slice(max(int(rows[0]) - MARGIN_PX, 0), min(int(rows[-1]) + MARGIN_PX, high)),
        slice(max(int(cols[0]) - MARGIN_PX, 0), min(int(cols[-1]) + MARGIN_PX, wide)),
    )
    return RendererPair(
        finger=finger, force_N=force_N, fast=fast[part], reference=reference[part], true_mask=mask[part]
    )
