"""The whole loop on the thesis's rig: cards, calibration, presses, the author's measurement, truth, error split."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.chain.simulate import Render, expose, simulate
from evanesce.core import provenance
from evanesce.evaluation.evaluate import Camera, Evaluation, evaluate
from evanesce.measurement.calibration.board_images import find_boards
from evanesce.measurement.calibration.fit import Calibrated, calibrate
from evanesce.measurement.calibration.model import Calibration, save_calibration
from evanesce.measurement.calibration.rectify import Rectification, rectification, rectify
from evanesce.measurement.io.images import read_image
from evanesce.measurement.reference.area import SquareScale, square_scale
from evanesce.measurement.reference.segment import Chain
from evanesce.render.cards import CHECKERBOARD, SQUARE, Card, Pose, render_card
from evanesce.render.reference.path import render
from evanesce.rig import Scene, load_scene
from evanesce.sensor.codec import write_png

Tick = Callable[[str, int, int], None]
"""``tick(what, done, total)``, called as work proceeds."""

THRESHOLD = 0.15
"""One of the grey levels that the thesis sets by hand; 0.0375, 0.35 and 0.6 are the others."""

# Tilts both ways in x and y, so that the focal length can be told from the distance; the last lies on the glass.
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
    samples_per_pixel, passes : int
        Of the path tracer around the contact.
    card_samples_per_pixel : int
    poses : tuple of Pose
        Of the checkerboard.
    seed : int
    """

    forces: tuple[float, ...] = (1.0, 2.0, 5.0)
    samples_per_pixel: int = 48
    passes: int = 4
    card_samples_per_pixel: int = 4
    poses: tuple[Pose, ...] = POSES
    seed: int = 1

    @classmethod
    def quick(cls) -> DemoSettings:
        """Return less than a minute's work: one force, fewer paths, and the author's single static board."""
        return cls(forces=(2.0,), samples_per_pixel=36, passes=2, card_samples_per_pixel=2, poses=POSES[-1:])


@dataclass(frozen=True, kw_only=True)
class CalibratedRig:
    """What the cards told.

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
class Demo:
    """Everything the demo found."""

    rig: CalibratedRig
    frames: list[DemoFrame]
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
    renderer: Render | None = None,
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
    renderer : Render, optional
        Path tracer by default.
    record : dict, optional
        What provenance should say of the renderer.
    tick : callable
    """
    smooth = load_scene("thesis")
    (folder / "cards").mkdir(exist_ok=True)
    rig = calibrate_rig(smooth, folder / "cards", settings, variant, lambda done, total: tick("cards", done, total))
    chain = Chain(threshold=THRESHOLD)
    camera = Camera.of(smooth, rig.calibration, rig.square.mm2_per_px)  # the fingers share it
    options: dict[str, Any] = {}
    if renderer is None:
        options = {"samples_per_pixel": settings.samples_per_pixel, "passes": settings.passes, "variant": variant}
    frames = []
    fingers = {"smooth": smooth, "ridged": load_scene("thesis_ridged")}
    total = len(fingers) * len(settings.forces)
    for finger, scene in fingers.items():
        (folder / finger).mkdir(exist_ok=True)
        for k, force in enumerate(settings.forces):
            shot = simulate(
                scene, force, seed=settings.seed, index=k, time_s=k / scene.press.frame_rate_hz,
                render=renderer or render, **options,
            )  # fmt: skip
            write_png(folder / finger / f"frame_{k:06d}.png", shot.frame.data)
            found = evaluate(shot, chain, camera, seed=settings.seed)
            frames.append(DemoFrame(finger=finger, force_N=force, evaluation=found))
            tick("presses", len(frames), total)
    origin = provenance.record(seed=settings.seed, config=smooth.as_dict(), **(record or {}))
    return Demo(rig=rig, frames=frames, provenance=dict(origin))
