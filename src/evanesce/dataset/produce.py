"""Make one frame of a dataset as bytes: a function of the job and the frame's number alone."""

from __future__ import annotations

import json
import math
from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.core.states import ContactState, Frame, PlateGrid
from evanesce.dataset.config import CHANNELS, MAPS
from evanesce.dataset.design import TrialPlan, trial_plan
from evanesce.dataset.encode import exr, mask_png, png
from evanesce.dataset.job import Job
from evanesce.dataset.labels import FrameLabeller, LabelBox, offset, plate_labels
from evanesce.dataset.layout import frame_key
from evanesce.dataset.markers import ink_cover, inked, marker_labels
from evanesce.dataset.numbers import SCALARS, measured, slip_labelled
from evanesce.dataset.planar_trial import trial_of
from evanesce.dataset.rigs import (
    RigCamera,
    RigWithEffects,
    all_of,
    optical_scene,
    plate_grid,
    rig_scene,
    rig_with_effects,
)
from evanesce.dataset.shutter import smeared
from evanesce.dataset.trial import FrameTruth, Trial
from evanesce.effects import Stage
from evanesce.effects.contact.rolling_skew import lateness

Floats = NDArray[np.float64]

CACHED_CAMERAS = 2
"""Number of cameras that a process caches; one at 2000 x 1500 takes some 150 MB."""
CARRIED = {"pressure", "traction.x", "traction.y", "strength"}
"""Channels of what a contact carries, which neither its light nor its outline need."""


@dataclass(frozen=True)
class Record:
    """Members and manifest row of a frame.

    Attributes
    ----------
    frame : int
    trial : int
    row : dict
        Row of the manifest.
    members : dict of bytes
        By extension, in the order in which they are written.
    """

    frame: int
    trial: int
    row: dict[str, Any]
    members: dict[str, bytes]


@dataclass(frozen=True)
class Made:
    """A frame and its labels in memory.

    Attributes
    ----------
    frame, trial : int
    picture : Frame or None
        None where only labels were asked for.
    seen : LabelBox
        Labels in the distorted frame.
    plate : LabelBox
        On the plate plane.
    plate_grid : PlateGrid
        Its grid.
    meta : dict
        What ``KEY.json`` holds.
    """

    frame: int
    trial: int
    picture: Frame | None
    seen: LabelBox
    plate: LabelBox
    plate_grid: PlateGrid
    meta: dict[str, Any]

    @property
    def mask(self) -> NDArray[np.uint8]:
        """Surface state of each pixel, (rows, cols)."""
        return self.seen.whole("state").astype(np.uint8)


@dataclass
class _Ready:
    camera: RigCamera
    labeller: FrameLabeller
    grid: PlateGrid


@dataclass(frozen=True)
class _Current:
    """The present trial."""

    number: int
    plan: TrialPlan
    trial: Trial
    ready: _Ready
    described: dict[str, Any]


class Producer:
    """Make the frames of a job. It caches the present trial: use one producer per thread.

    Parameters
    ----------
    job : Job
    """

    def __init__(self, job: Job) -> None:
        self.job, self._digest = job, job.digest
        self._cameras: OrderedDict[tuple[int, str], _Ready] = OrderedDict()
        self._trial: _Current | None = None

    def record(self, frame: int) -> Record:
        """Make a frame and encode it.

        Raises
        ------
        Exception
            Whatever the physics or an effect raises; the caller handles the frame.
        """
        labels, stored = self.job.config.labels, {k: self.job.config.labels.channels(k) for k in MAPS}
        made = self.make(frame, stored["frame"], stored["plate"])
        meta, picture = made.meta, made.picture
        assert picture is not None
        header = {"scalars": meta["scalars"], "scalar_units": SCALARS, "key": meta["key"]}
        members = {"frame.png": png(picture.data)}
        if labels.raw:
            assert picture.raw is not None
            members["raw.png"] = png(picture.raw)
        if stored["frame"]:
            seen = replace(made.seen, channels={n: made.seen.channels[n] for n in stored["frame"]})
            geometry = frame_geometry(self.trial(made.trial).ready)
            members["labels.exr"] = exr(seen, labels.precision, {**header, "geometry": geometry})
        if stored["plate"]:
            geometry = plate_geometry(made.plate_grid)
            members["plate.exr"] = exr(made.plate, labels.precision, {**header, "geometry": geometry})
        members["mask.png"] = mask_png(made.mask)
        text = json.dumps(meta, sort_keys=True, allow_nan=False, separators=(",", ":"))
        members["json"] = (text + "\n").encode()
        row = {name: meta[name] for name in ("split", "kind")}
        row |= {"seed": meta["rig"]["seed"], "time_s": meta["scalars"]["time_s"]}
        return Record(frame, made.trial, row, members)

    def make(
        self,
        frame: int,
        frame_channels: Sequence[str] = tuple(CHANNELS),
        plate_channels: Sequence[str] = tuple(CHANNELS),
        *,
        exposed: bool = True,
    ) -> Made:
        """Make a frame.

        Parameters
        ----------
        frame : int
        frame_channels, plate_channels : sequence of str
            Labels in the distorted frame, to which the state always belongs, and on the plate plane.
        exposed : bool
            Whether a picture is taken; labels alone take a third of the time.

        Raises
        ------
        Exception
            Whatever the physics or an effect raises.
        """
        number = frame // self.job.config.trial.frames
        current = self.trial(number)
        ready, i = current.ready, frame - self.job.frames_of(number).start
        truth, time_s = current.trial.truth(i), float(current.trial.time[i])
        carried = not CARRIED.isdisjoint(frame_channels)
        lit, visible = self._visible(current, i, truth.state, carried)
        if truth.state is not None:
            plain = truth.state
            truth = self._with_contact_effects(truth, ready, frame, time_s)
            lit, visible = (
                truth.state if s is plain or s is None else _acted_on(ready.camera, s, frame, time_s)
                for s in (lit, visible)
            )
        labels, picture = self.job.config.labels, None
        marks: list[dict[str, Any]] = []
        if self.job.config.markers.pitch_mm and lit is not None and visible is not None:
            lit, marks = self._marked(current, i, lit, visible)
        if exposed:
            picture = ready.camera.frame(lit, index=frame, time_s=time_s, with_raw=labels.raw, grid=ready.grid)
        wanted = [name for name in CHANNELS if name == "state" or name in frame_channels]
        seen = ready.labeller.labels(FrameTruth(visible, truth.scalars), labels.margin_mm, wanted)
        grid = ready.grid if truth.state is None else shifted(ready.grid, truth.state.grid)
        flat = plate_labels(truth, grid, labels.margin_mm, plate_channels)
        return Made(frame, number, picture, seen, flat, grid, self.describe(current, frame, i, truth, marks))

    def trial(self, number: int) -> _Current:
        """Return a trial with its camera, made ready."""
        if self._trial is None or self._trial.number != number:
            config, plan = self.job.config, trial_plan(self.job.config, self.job.seed, number)
            scene = rig_scene(self.job.scene, plan.rig, plan.finger, config, plan.liquid)
            rig = rig_with_effects(scene, plan.rig.seed)
            ready = self._camera(plan, rig)
            start = self.job.frames_of(number).start

            def load(i: int, time_s: float, force_N: float) -> float:
                return ready.camera.load(start + i, time_s, force_N)

            trial = trial_of(plan, config, rig.scene, ready.grid, load)
            if any(entry.effect.stage is Stage.CONTACT for entry in rig.effects):
                # Whether an effect of the contact knows this finger shows only on a contact.
                contact = next((t.state for t in map(trial.truth, range(len(trial))) if t.state is not None), None)
                tried = rig_with_effects(scene, plan.rig.seed, contact)
                if tried.left_out != rig.left_out:
                    rig, ready = tried, self._camera(plan, tried)
            described = self._describe_trial(plan, trial, rig.left_out, ready.camera)
            current = _Current(number, plan, trial, ready, described)
            self._trial = current
            return current
        return self._trial

    def _camera(self, plan: TrialPlan, rig: RigWithEffects) -> _Ready:
        config = self.job.config
        key = (plan.rig.index, optical_scene(rig.scene).model_dump_json())
        if key not in self._cameras:
            camera = RigCamera(rig, plan.rig.seed, config.camera.backend)
            grid = plate_grid(camera.scene, config)
            self._cameras[key] = _Ready(camera, FrameLabeller(camera.scene, grid), grid)
            while len(self._cameras) > CACHED_CAMERAS:
                self._cameras.popitem(last=False)
        self._cameras.move_to_end(key)
        return self._cameras[key]

    @staticmethod
    def _visible(
        current: _Current, i: int, state: ContactState | None, carried: bool
    ) -> tuple[ContactState | None, ContactState | None]:
        """Return what light and frame labels are made of: the mean over the exposure, and what its middle sees.

        Where rows are exposed one after another, pressure and traction of the second are right only if ``carried``.
        """
        if state is None:
            return state, state
        camera = current.ready.camera
        scene, exposure = camera.scene, 1e-3 * camera.scene.camera.exposure_ms
        trial, motion = current.trial, current.trial.motion(i)
        slip = 0.0 if state.slip_velocity is None else float(np.hypot(*np.asarray(state.slip_velocity)).max())
        way, pixel = max(math.hypot(*motion.velocity), slip) * exposure, 1.0 / scene.camera.scale_px_per_mm
        if camera.readout_s == 0.0 and way <= pixel:
            return state, state
        late, visible = np.zeros(state.grid.shape), state
        if camera.readout_s != 0.0:
            late = lateness(scene, state.grid, camera.readout_s)
            visible = trial.state(i, late, light_alone=not carried)

        def outline(moment: Floats) -> ContactState:
            return trial.state(i, moment, light_alone=True)

        return smeared(visible, outline, late, exposure, way, pixel), visible

    @staticmethod
    def _with_contact_effects(truth: FrameTruth, ready: _Ready, frame: int, time_s: float) -> FrameTruth:
        """Return the truth with effects of the contact applied; what moves the grid moves the centre."""
        assert truth.state is not None
        state = _acted_on(ready.camera, truth.state, frame, time_s)
        if state is truth.state:
            return truth
        moved = np.subtract(state.grid.centre, truth.state.grid.centre)
        x, y = np.array([truth.scalars["centre_x_mm"], truth.scalars["centre_y_mm"]]) + moved
        place = {"centre_x_mm": float(x), "centre_y_mm": float(y)}
        return FrameTruth(state, {**truth.scalars, **place, **measured(state, (float(x), float(y)))})

    def _marked(
        self, current: _Current, i: int, lit: ContactState, visible: ContactState
    ) -> tuple[ContactState, list[dict[str, Any]]]:
        """Return a lit contact with its markers' ink, and the markers' labels."""
        camera, markers, trial = current.ready.camera, self.job.config.markers, current.trial
        late: Floats | float = 0.0
        if camera.readout_s != 0.0:
            late = lateness(camera.scene, trial.part(i), camera.readout_s)
        skin = trial.marked_skin(i, late)
        return inked(lit, ink_cover(skin, markers), markers), marker_labels(skin, markers, visible, camera.scene)

    def describe(
        self, current: _Current, frame: int, i: int, truth: FrameTruth, marks: list[dict[str, Any]]
    ) -> dict[str, Any]:
        """Return the content of ``KEY.json``, which ``schema.json`` validates."""
        return {
            **current.described,
            "key": frame_key(frame),
            "index": frame,
            "frame_in_trial": i,
            "markers": marks,
            "scalars": {name: _rounded(truth.scalars[name]) for name in SCALARS},
        }

    def _describe_trial(
        self, plan: TrialPlan, trial: Trial, left_out: tuple[str, ...], taken_by: RigCamera
    ) -> dict[str, Any]:
        """Return what all frames of a trial have in ``KEY.json``."""
        onsets = {
            "onset_first_slip_s": trial.onset_first_slip_s,
            "onset_gross_slip_s": trial.onset_gross_slip_s,
        }
        plans, camera = plan.as_dict(), taken_by.scene.camera
        return {
            "trial": plan.index,
            "kind": plan.kind,
            "split": plan.split,
            **{name: None if math.isnan(value) else value for name, value in onsets.items()},
            "finger": plans["finger"],
            "friction": plans["friction"],
            "rig": {**plans["rig"], "effects": all_of(self.job.scene, plan.rig), "left_out": list(left_out)},
            "camera": {
                "scale_px_per_mm": camera.scale_px_per_mm,
                "exposure_ms": camera.exposure_ms,
                "analogue_gain": camera.analogue_gain,
                "readout_ms": 1e3 * taken_by.readout_s,
            },
            "programme": plans["programme"],
            "motion": plans["motion"],
            "liquid": {} if trial.scene.liquid is None else trial.scene.liquid.model_dump(mode="json"),
            "seed": self.job.seed,
            "config_sha256": self._digest,
        }


def _acted_on(camera: RigCamera, state: ContactState, frame: int, time_s: float) -> ContactState:
    """Return a contact after the rig's effects; what they stretch is labelled anew."""
    changed = camera.contact(state, frame, time_s)
    return state if changed is state else slip_labelled(changed)


def shifted(grid: PlateGrid, part: PlateGrid) -> PlateGrid:
    """Return a grid shifted by less than a sample, so that the samples of a part of it are among its own."""
    down, right = (at - round(at) for at in offset(part, grid))
    if down == right == 0.0:
        return grid
    return replace(grid, centre=(grid.centre[0] + right * grid.pitch, grid.centre[1] + down * grid.pitch))


def _rounded(value: float) -> float:
    """Round to 12 digits, below which results depend on the processor, and drop the sign of zero."""
    return float(f"{value:.12g}") + 0.0


def frame_geometry(ready: _Ready) -> dict[str, Any]:
    """Return the geometry of the distorted frame."""
    from evanesce.optics.projection import Projection

    projection = Projection.of(ready.camera.scene.camera, ready.camera.scene.plate)
    return {
        "space": "distorted frame; [row, col], integer = pixel centre",
        "camera_matrix": projection.matrix.tolist(),
        "distortion_k1_k2_p1_p2_k3": list(projection.distortion),
        "axes_of_camera_in_plate": projection.axes.tolist(),
        "pinhole_mm": projection.pinhole.tolist(),
        "plate_thickness_mm": projection.thickness,
        "plate_refractive_index": projection.refractive_index,
    }


def plate_geometry(grid: PlateGrid) -> dict[str, Any]:
    """Return the geometry of the samples of the plate plane."""
    return {
        "space": "undistorted plate plane; [row, col], x = x0 + col pitch, y = y0 + row pitch",
        "pitch_mm": grid.pitch,
        "x0_mm": float(grid.x[0]),
        "y0_mm": float(grid.y[0]),
        "shape": list(grid.shape),
    }
