"""A measurement bundle in memory: its tables, and its frames read when they are asked for."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from evanesce.bundle.files import check_size
from evanesce.bundle.layout import (
    AUXILIARY,
    MAX_STEP_S,
    MIN_DWELL_S,
    MIN_REPLICATES,
    PRESS_FOLDER,
    PRESS_TABLE,
    REPLICATES_FOLDER,
    SAME_VOLTAGE_V,
    SERIES_OBSERVABLES,
    Replicates,
    Series,
    Shot,
    same_force,
)
from evanesce.core.errors import InputError
from evanesce.measurement.io.force import force_doubts
from evanesce.measurement.io.frames import open_frames
from evanesce.measurement.io.images import read_image
from evanesce.measurement.reference.segment import grey
from evanesce.rig import Scene

Grey = NDArray[np.uint8]


@dataclass(frozen=True, eq=False)
class Bundle:
    """A measurement bundle; frames are read when asked for, everything else has been checked.

    Attributes
    ----------
    path : Path
        The folder.
    scene : Scene
        The nominal model of the rig.
    title : str
    press : tuple of Shot
        In the order of time.
    replicates : Replicates
    series : Mapping of str to Series
    """

    path: Path
    scene: Scene
    title: str = ""
    press: tuple[Shot, ...] = ()
    replicates: Replicates = field(default_factory=Replicates)
    series: Mapping[str, Series] = field(default_factory=lambda: MappingProxyType({}))
    _files: Mapping[str, tuple[Path, ...]] = field(default_factory=lambda: MappingProxyType({}), repr=False)
    _video: Path | None = field(default=None, repr=False)

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, cols) of every frame [px]."""
        cols, rows = self.scene.camera.resolution_px
        return rows, cols

    def frame(self, shot: Shot) -> Grey:
        """Return a press frame [DN].

        A colour camera's frame keeps its colour; of another camera, colour is made grey by the segmentation's luma
        weights.

        Parameters
        ----------
        shot : Shot
            One of :attr:`press`.

        Returns
        -------
        ndarray of uint8 (rows, cols), or (rows, cols, 3) of a scene with a colour camera
            [DN].

        Raises
        ------
        InputError
            If the file is damaged, has 16 bits or another size than the scene's camera.
        KeyError
            If the shot is none of :attr:`press`.
        """
        if self._video is not None:
            return self._film[shot.index]
        number = {s.index: k for k, s in enumerate(self.press)}[shot.index]
        return self._read(self._files[PRESS_FOLDER][number])

    def frames(self, kind: str) -> tuple[Grey, ...]:
        """Return all frames of ``press``, ``replicates`` or one of :data:`AUXILIARY`; empty where there are none.

        Parameters
        ----------
        kind : str
            ``press``, ``replicates`` or one of :data:`~evanesce.bundle.layout.AUXILIARY`.

        Returns
        -------
        tuple of ndarray of uint8
            Each as from :meth:`frame` [DN].
        """
        if kind == PRESS_FOLDER:
            return tuple(self.frame(shot) for shot in self.press)
        if kind not in (REPLICATES_FOLDER, *AUXILIARY):
            raise KeyError(kind)
        return tuple(self._read(path) for path in self._files.get(kind, ()))

    def count(self, kind: str) -> int:
        """Return how many frames of a kind there are.

        Parameters
        ----------
        kind : str
            As for :meth:`frames`.

        Returns
        -------
        int
        """
        return len(self.press) if kind == PRESS_FOLDER else len(self._files.get(kind, ()))

    def files(self, kind: str) -> tuple[Path, ...]:
        """Return the picture files of ``press``, ``replicates`` or an auxiliary kind; none of a video."""
        return self._files.get(kind, ())

    @property
    def doubts(self) -> list[str]:
        """What makes the tables doubtful, to be told before anything is made of them."""
        forces = np.array([shot.force_N for shot in self.press])
        grams = "1 g is 0.00981 N"
        return [doubt.text for doubt in force_doubts(PRESS_TABLE, forces, grams)] if forces.size else []

    @cached_property
    def replicate_frames(self) -> tuple[Grey, ...]:
        """Frames of the held state."""
        return self.frames(REPLICATES_FOLDER)

    @cached_property
    def led_off(self) -> tuple[Grey, ...]:
        """Frames with the LEDs off and the finger away."""
        return self.frames("led_off")

    @cached_property
    def lens_cap(self) -> tuple[Grey, ...]:
        """Frames with the lens covered."""
        return self.frames("lens_cap")

    @cached_property
    def checkerboard(self) -> tuple[Grey, ...]:
        """Shots of the checkerboard on the glass."""
        return self.frames("checkerboard")

    @cached_property
    def square(self) -> tuple[Grey, ...]:
        """Shots of the square on the glass."""
        return self.frames("square")

    @cached_property
    def available(self) -> frozenset[str]:
        """The :data:`~evanesce.bundle.layout.OBSERVABLES` that are there."""
        found = {kind for kind in AUXILIARY if self._files.get(kind)}
        if self.press:
            first = self.press[0]
            found.add("press")
            if any(abs(s.voltage_V - first.voltage_V) > SAME_VOLTAGE_V for s in self.press):
                found.add("voltage")
            if any(not same_force(s.force_N, first.force_N) for s in self.press):
                found.add("force")
            if any(s.held_s >= MIN_DWELL_S for s in self.press):
                found.add("time")
            if self.scene.slide is not None or any(map(_moving, self.press, self.press[1:])):
                found.add("motion")
            if not any(np.isnan(s.displacement_mm) for s in self.press):
                found.add("displacement")
        if len(self.replicates) >= MIN_REPLICATES:
            found.add("replicates")
        if self.series:
            found.add("series")
        if any(one.x_name == "slide" for one in self.series.values()):
            found.add("motion")
        return frozenset(found)

    @property
    def has_frames(self) -> bool:
        """Whether there is any frame at all."""
        return bool(self.press or len(self.replicates) or any(self._files.get(kind) for kind in AUXILIARY))

    @property
    def testable(self) -> frozenset[str]:
        """Observables by which effects can be tested: :attr:`available`, and those of series without frames."""
        return self.available if self.has_frames else self.available | set(SERIES_OBSERVABLES)

    @cached_property
    def _film(self) -> dict[int, Grey]:
        """The video's frames that the table names, decoded in one go."""
        assert self._video is not None
        wanted = {shot.index for shot in self.press}
        found: dict[int, Grey] = {}
        stream = open_frames(self._video)
        seen = 0
        for frame in stream:
            seen += 1
            if frame.index in wanted:
                found[frame.index] = self._checked(frame.data, self._video)
            if len(found) == len(wanted):
                return found
        stream.finish()
        missing = min(wanted - set(found))
        raise InputError(
            f"frame {missing} is named, but the video holds {seen}", file=self.path / PRESS_TABLE, key="column index",
            allowed=f"0 to {seen - 1}",
        )  # fmt: skip

    def _read(self, path: Path) -> Grey:
        loaded = read_image(path)
        if any(note.code == "bit_depth" for note in loaded.notes):
            raise InputError("16-bit samples", file=path, allowed="8 bits, as the measurement pipeline reads them")
        return self._checked(loaded.data, path)

    def _checked(self, data: Grey, path: Path) -> Grey:
        check_size((data.shape[1], data.shape[0]), self.scene, path)
        coloured = self.scene.camera.colour is not None
        if coloured and data.ndim == 2:
            data = np.repeat(data[..., None], 3, axis=2)  # a filter mosaic's grey picture: equal channels
        if not coloured and data.ndim == 3:
            data = np.floor(255.0 * grey(data) + 0.5).astype(np.uint8)
        data.flags.writeable = False
        return data


def scene_at(scene: Scene, shot: Shot) -> Scene:
    """Return the nominal model of the rig with the LEDs' supply of a shot.

    Parameters
    ----------
    scene : Scene
    shot : Shot

    Returns
    -------
    Scene
    """
    if shot.voltage_V == scene.leds.voltage_V:
        return scene
    return scene.model_copy(update={"leds": scene.leds.model_copy(update={"voltage_V": shot.voltage_V})})


def _moving(one: Shot, following: Shot) -> bool:
    """Return whether the finger moved between two frames."""
    close = one.session == following.session and following.time_s - one.time_s <= MAX_STEP_S
    return close and not same_force(one.force_N, following.force_N)
