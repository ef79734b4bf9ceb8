"""Write a bundle of simulated measurements, whole or not at all."""

from __future__ import annotations

import hashlib
import itertools
import json
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w
from numpy.typing import NDArray

from evanesce.bundle.area import MIN_BLOB_MM2, AreaReading, contact_area
from evanesce.bundle.bundle import scene_at
from evanesce.bundle.card_light import card_light
from evanesce.bundle.folder import new_folder, write_csv, write_frame, write_shear, write_shots
from evanesce.bundle.layout import (
    AUXILIARY,
    MEASUREMENT_FILE,
    PRESS_FOLDER,
    PRESS_TABLE,
    REPLICATES_FOLDER,
    REPLICATES_TABLE,
    SERIES_FOLDER,
    Shot,
    with_chosen,
    with_shear,
)
from evanesce.bundle.protocol import Protocol, default_protocol
from evanesce.chain.simulate import Render, expose, solve_contact
from evanesce.core import rng
from evanesce.core.states import ContactState, Frame, PlateLight
from evanesce.effects import Context, Stage, active_effects, all_effects, apply_stage
from evanesce.optics.projection import IdealView, Projection
from evanesce.optics.seen import under_lamp
from evanesce.render.cards import Card, Pose, checkerboard_of, pose_of, square_of
from evanesce.render.fast.transport import render_fast
from evanesce.rig import Scene, copy_scene_files, dump_scene
from evanesce.rig.coarser import finer_pixels
from evanesce.sensor.response import Response, card_response

Grey = NDArray[np.uint8]
Tick = Callable[[int, int], None]
CardRender = Callable[[Scene, Card, Pose], PlateLight]

# First numbers of frames that are not of a press: far apart, so that no two share a random stream.
_FIRST_INDEX = {REPLICATES_FOLDER: 100_000, "led_off": 200_000, "lens_cap": 300_000, "checkerboard": 400_000,
                "square": 500_000}  # fmt: skip

RAYS = 2
"""Of the pinhole view along each pixel at which light is gathered, where those are finer than the camera's.

The lens is remapped between rays, which blurs by part of their distance: one alone is 0.03 DN of a bin.
"""

LEAST_PX_PER_MM = 30.0
"""Pixels at which light is gathered are no larger: means of many frames show what larger ones leave of a contact's edge
(benchmarks/critic_pixels.py: two and three finer ones along each of 12 per mm)."""

BEHIND_THE_LENS = (Stage.CHARGE, Stage.READOUT, Stage.FRAME)


class Rig:
    """A simulated rig that exposes the frames of a bundle; equal light is rendered once.

    Parameters
    ----------
    scene : Scene
        The true rig.
    seed : int
    render : Render, optional
        The fast renderer by default.
    card : callable, optional
        ``card(scene, card, pose) -> PlateLight``.
    finer : int
        Pixels at which light is sampled along each of the camera's, where those are coarser than the lens's
        resolution.
    """

    def __init__(
        self, scene: Scene, seed: int, *, render: Render | None = None, card: CardRender | None = None, finer: int = 1
    ) -> None:
        self.scene, self.seed, self.finer = scene, seed, finer
        fast, flat = (render_fast, card_light) if finer == 1 else (_press_of_rays, _card_of_rays)
        self._render, self._card = render or fast, card or flat
        self._kept: tuple[str, PlateLight] | None = None

    def press(self, shot: Shot, index: int | None = None) -> tuple[Grey, ContactState]:
        """Return the frame of a press [DN], and the contact; as :meth:`taken`, the levels alone.

        Parameters
        ----------
        shot : Shot
        index : int, optional

        Returns
        -------
        frame : ndarray of uint8 (rows, cols)
            [DN].
        state : ContactState
        """
        frame, state = self.taken(shot, index)
        return np.asarray(frame.data, np.uint8), state

    def taken(self, shot: Shot, index: int | None = None) -> tuple[Frame, ContactState]:
        """Return the frame of a press, with what the camera chose itself, and the contact.

        Parameters
        ----------
        shot : Shot
        index : int, optional
            Number of the frame, which selects its noise; that of the shot by default.

        Returns
        -------
        frame : Frame
        state : ContactState
        """
        index = shot.index if index is None else index
        scene, state = solve_contact(
            scene_at(self.scene, shot), shot.force_N, seed=self.seed, time_s=shot.time_s, index=index
        )
        assert state is not None
        light = self._light(scene, state)
        return self._frame(scene, light, shot.time_s, index), state

    def led_off(self, index: int) -> Grey:
        """Return a frame with the LEDs off and the finger away [DN].

        Parameters
        ----------
        index : int
            Number of the frame, which selects its noise.

        Returns
        -------
        ndarray of uint8 (rows, cols)
        """
        dark = self.scene.leds.model_copy(
            update={
                "voltage_V": 0.0,
                "edge": {
                    name: edge.model_copy(update={"voltage_V": None}) for name, edge in self.scene.leds.edge.items()
                },
            }
        )
        scene, _ = solve_contact(self.scene.model_copy(update={"leds": dark}), None, seed=self.seed, index=index)
        return self._expose(scene, no_light(finer_pixels(scene, self.finer)), 0.0, index)

    def lens_cap(self, index: int) -> Grey:
        """Return a frame with the lens covered [DN]: only effects behind the lens are left.

        Parameters
        ----------
        index : int
            Number of the frame, which selects its noise.

        Returns
        -------
        ndarray of uint8 (rows, cols)
        """
        known = all_effects()
        behind = {name: table for name, table in self.scene.effects.items() if known[name].stage in BEHIND_THE_LENS}
        scene = self.scene.model_copy(update={"effects": behind})
        return self._expose(scene, no_light(finer_pixels(scene, self.finer)), 0.0, index)

    def card(self, kind: str, index: int) -> Grey:
        """Return the shot of ``checkerboard`` or ``square`` lying on the glass [DN].

        Parameters
        ----------
        kind : str
            ``checkerboard`` or ``square``.
        index : int
            Number of the frame, which selects its noise.

        Returns
        -------
        ndarray of uint8 (rows, cols)
        """
        lit = under_lamp(self.scene)
        scene = apply_stage(Stage.RIG, lit, active_effects(lit), Context(lit, self.seed, 0.0, index))
        card = checkerboard_of(scene.card) if kind == "checkerboard" else square_of(scene.card)
        light = self._card(finer_pixels(scene, self.finer), card, pose_of(scene.card))
        return np.asarray(self._frame(scene, light, 0.0, index, card_response(scene.camera)).data, np.uint8)

    def _expose(self, scene: Scene, light: PlateLight, time_s: float, index: int) -> Grey:
        return np.asarray(self._frame(scene, light, time_s, index).data, np.uint8)

    def _frame(
        self, scene: Scene, light: PlateLight, time_s: float, index: int, response: Response | None = None
    ) -> Frame:
        return expose(scene, light, seed=self.seed, time_s=time_s, index=index, finer=self.finer, response=response)[1]

    def _light(self, scene: Scene, state: ContactState) -> PlateLight:
        """Render; a held state is rendered once, so that its frames differ by noise alone."""
        digest = hashlib.sha256(scene.model_dump_json(exclude={"effects", "title"}).encode())
        for array in (state.gap, state.contact_mask, state.pressure):
            digest.update(np.ascontiguousarray(array).tobytes())
        key = digest.hexdigest()
        if self._kept is None or self._kept[0] != key:
            light_seed = rng.integer_seed(self.seed, "render", key)
            self._kept = (key, self._render(finer_pixels(scene, self.finer), state, seed=light_seed))
        return self._kept[1]


def _press_of_rays(scene: Scene, state: ContactState, *, seed: int) -> PlateLight:
    return render_fast(scene, state, seed=seed, view=_rays(scene))


def _card_of_rays(scene: Scene, card: Card, pose: Pose) -> PlateLight:
    return card_light(scene, card, pose, view=_rays(scene))


def _rays(scene: Scene) -> IdealView:
    return Projection.of(scene.camera, scene.plate).ideal_view().finer(RAYS)


def no_light(scene: Scene) -> PlateLight:
    """Return darkness on the scene's pinhole view.

    Parameters
    ----------
    scene : Scene

    Returns
    -------
    PlateLight
        Zero radiance and variance.
    """
    view = Projection.of(scene.camera, scene.plate).ideal_view()
    dark = np.zeros(view.shape)
    return PlateLight(
        radiance=dark, variance=dark, focal_px=view.focal_px, principal_point=view.principal_point, samples=0
    )


def fine_enough(scene: Scene) -> int:
    """Return how many pixels along each of the camera's gather light as finely as an edge of contact needs.

    Parameters
    ----------
    scene : Scene
    """
    return math.ceil(LEAST_PX_PER_MM / scene.camera.scale_px_per_mm)


def write_bundle(
    folder: Path,
    scene: Scene,
    *,
    seed: int,
    nominal: Scene | None = None,
    protocol: Protocol | None = None,
    render: Render | None = None,
    card: CardRender | None = None,
    provenance: Mapping[str, Any] | None = None,
    finer: int | None = None,
    tick: Tick = lambda done, total: None,
) -> None:
    """Simulate a protocol and write it as a bundle; the folder appears when all of it is there.

    Parameters
    ----------
    folder : Path
        Must not exist, or be empty.
    scene : Scene
        The true rig.
    seed : int
    nominal : Scene, optional
        The model of the rig that the bundle names; ``scene`` by default, so that there is no discrepancy.
    protocol : Protocol, optional
        :func:`~evanesce.bundle.protocol.default_protocol` if not given.
    render, card : callable, optional
        Renderers of contacts and cards; the fast ones by default.
    provenance : Mapping, optional
        Goes to ``provenance.json``.
    finer : int, optional
        See :class:`Rig`; by default :func:`fine_enough`, with ``render`` 1.
    tick : callable
        ``tick(done, total)`` after every frame.

    Raises
    ------
    InputError
        If the folder holds something.
    WorkError
        If it cannot be written.
    """
    protocol = protocol or default_protocol(scene)
    active_effects(scene)
    finer = (1 if render or card else fine_enough(scene)) if finer is None else finer
    rig = Rig(scene, seed, render=render, card=card, finer=finer)
    total = len(protocol.press) + sum(getattr(protocol, kind) for kind in (REPLICATES_FOLDER, *AUXILIARY))
    counter = itertools.count(1)

    def written() -> None:
        tick(next(counter), total)

    nominal = nominal or scene
    with new_folder(folder) as part:
        copy_scene_files(nominal, part)
        (part / "scene.toml").write_text(dump_scene(nominal), encoding="utf-8")
        frames, depths, shots = _press(part, rig, protocol, written)
        areas = _replicates(part, rig, protocol, nominal, depths[-1] if depths else float("nan"), written)
        _auxiliary(part, rig, protocol, written)
        series = _series(part, protocol, frames, depths, nominal, areas) if scene.slide is None else {}
        write_shear(part / SERIES_FOLDER, shots)
        described = {"schema_version": 1, "title": nominal.title, "scene": "scene.toml"} | (
            {"series": series} if series else {}
        )
        (part / MEASUREMENT_FILE).write_text(tomli_w.dumps(described), encoding="utf-8")
        if provenance is not None:
            text = json.dumps(dict(provenance), indent=2) + "\n"
            (part / "provenance.json").write_text(text, encoding="utf-8")


def _press(
    part: Path, rig: Rig, protocol: Protocol, written: Callable[[], None]
) -> tuple[list[Grey], list[float], list[Shot]]:
    """Write the frames of the presses and their table; return frames, depths [mm] and the table's lines."""
    frames, depths, shots = [], [], []
    for shot in protocol.press:
        frame, state = rig.taken(shot)
        levels = np.asarray(frame.data, np.uint8)
        write_frame(part, PRESS_FOLDER, shot.index, levels)
        frames.append(levels)
        depths.append(state.depth)
        shots.append(with_shear(with_chosen(shot, frame.chosen), state))
        written()
    write_shots(part / PRESS_TABLE, shots, depths)
    return frames, depths, shots


def _auxiliary(part: Path, rig: Rig, protocol: Protocol, written: Callable[[], None]) -> None:
    """Write the frames that need no table."""
    for kind in AUXILIARY:
        for k in range(getattr(protocol, kind)):
            index = _FIRST_INDEX[kind] + k
            if kind == "led_off":
                frame = rig.led_off(index)
            elif kind == "lens_cap":
                frame = rig.lens_cap(index)
            else:
                frame = rig.card(kind, index)
            write_frame(part, kind, k, frame)
            written()


def _replicates(
    part: Path, rig: Rig, protocol: Protocol, nominal: Scene, depth: float, written: Callable[[], None]
) -> list[float]:
    """Write frames of the last hold, repeated, and return their areas [mm^2]."""
    if not (protocol.replicates and protocol.press):
        return []
    held = max(protocol.press, key=lambda shot: shot.held_s if shot.voltage_V == rig.scene.leds.voltage_V else -1.0)
    last = max(shot.time_s for shot in protocol.press)
    shots, areas = [], []
    for k in range(protocol.replicates):
        time = last + 10.0 + k / rig.scene.press.frame_rate_hz
        shot = Shot(index=k, time_s=time, force_N=held.force_N, voltage_V=held.voltage_V, session=held.session)
        frame, state = rig.taken(shot, _FIRST_INDEX[REPLICATES_FOLDER] + k)
        levels = np.asarray(frame.data, np.uint8)
        write_frame(part, REPLICATES_FOLDER, k, levels)
        areas.append(contact_area(levels, nominal))
        shots.append(with_shear(with_chosen(shot, frame.chosen), state))
        written()
    write_shots(part / REPLICATES_FOLDER / REPLICATES_TABLE, shots, [depth] * len(shots))
    return areas


def _series(
    part: Path,
    protocol: Protocol,
    frames: list[Grey],
    depths: list[float],
    nominal: Scene,
    repeated: list[float],
) -> dict[str, dict[str, float]]:
    """Write area against force and force against displacement of the ramp; return what was held."""
    volts = nominal.leds.voltage_V
    ramp = [k for k, shot in enumerate(protocol.press) if shot.voltage_V == volts and shot.held_s == 0.0]
    if len(ramp) < 2:
        return {}
    folder, reading = part / SERIES_FOLDER, AreaReading()
    folder.mkdir()
    pixel = 1.0 / nominal.camera.scale_px_per_mm**2
    sigma = max(float(np.std(repeated, ddof=1)) if len(repeated) > 1 else 0.0, pixel)
    shots = [protocol.press[k] for k in ramp]
    rows = [
        [shot.force_N, contact_area(frames[k], nominal, reading), sigma] for shot, k in zip(shots, ramp, strict=True)
    ]
    write_csv(folder / "area_force.csv", ["force_N", "area_mm2", "sigma_mm2"], rows)
    found = {
        "area_force": {
            "voltage_V": volts, "threshold": reading.threshold, "blur_px": reading.blur_px,
            "min_blob_mm2": round(MIN_BLOB_MM2, 6),
        }
    }  # fmt: skip
    if np.isfinite([depths[k] for k in ramp]).all():
        write_csv(
            folder / "force_displacement.csv", ["displacement_mm", "force_N"],
            [[depths[k], shot.force_N] for shot, k in zip(shots, ramp, strict=True)],
        )  # fmt: skip
    return found
