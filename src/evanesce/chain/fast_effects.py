"""The fast camera of a rig with effects: what no frame changes is computed once, the rest acts on its charge.

Each effect is asked what it does rather than declared: it is applied to light that is known, at two times and in two
frames. Effects that add the same light to every frame become one image of charge; those that multiply each pixel by the
same number become one field. What is left is applied to each frame: a blur to the light of the contact alone, all that
depends on time or on the whole frame to its sum.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.chain.fast import FastCamera
from evanesce.chain.fast_optics import charge_per_irradiance
from evanesce.chain.fast_surroundings import KEPT
from evanesce.core import rng
from evanesce.core.states import ContactState, Frame, PlateGrid, PlateLight, SensorLight
from evanesce.effects import Active, Context, Stage, apply_stage
from evanesce.optics.projection import Projection
from evanesce.render.fast.readout import ChargeBox, Readout
from evanesce.rig import Scene
from evanesce.sensor.colour import finish_mosaic
from evanesce.sensor.lens import form_image

Array = NDArray[np.float64]
Image = NDArray[np.float32]

SAME = 1e-6
"""Relative difference below which two answers of an effect are one [1]."""
OTHER = (0.317, 7)
"""Time [s] and number of a second frame that an effect is asked about."""


class NotFast(Exception):
    """An effect acts on light or contact in a way that the fast camera does not follow."""


@dataclass(frozen=True)
class _Lens:
    """Effects behind the lens: a field of gains, those that blur the contact's light, and those of each frame's sum."""

    gain: Image | None
    linear: tuple[Active, ...]
    each: tuple[Active, ...]


class FastEffects:
    """Frames of a rig with effects.

    Parameters
    ----------
    fast : FastCamera
        Of the rig without effects; it must not fall back.
    scene : Scene
        The rig, as its LEDs' light sees it.
    effects : sequence of Active
        Those of the stages contact and before have acted where a state is given.
    seed : int
        Of the rig.

    Raises
    ------
    NotFast
        If effects change the light that leaves the plate other than by adding to it.
    """

    def __init__(self, fast: FastCamera, scene: Scene, effects: Sequence[Active], seed: int) -> None:
        acting = tuple(e for e in effects if not e.effect.is_null(e.parameters))
        self._fast, self._scene, self._seed, self._effects = fast, scene, seed, acting
        self._per_irradiance = charge_per_irradiance(scene)
        self._lens = self._of_lens()
        self._beside: list[tuple[Image, Image]] = []
        fixed = self._added_light()
        hot, self._charge = self._added_charge()
        self._before = None if fixed is None else self._through(np.asarray(fixed * self._per_irradiance, np.float32))
        self._after = hot
        self._readout, self._signal = self._of_readout(fast._readout)
        # What neither time nor the frame's number changes is added up once.
        self._fixed = None if self._lens.each else _sum(self._before, hot)

    def frame(
        self, state: ContactState | None, *, index: int, time_s: float, with_raw: bool = False, grid: PlateGrid | None
    ) -> Frame:
        """Expose a frame.

        Parameters
        ----------
        state : ContactState or None
            After effects of the contact.
        index, time_s, with_raw
            As for :meth:`FastCamera.frame`.
        grid : PlateGrid or None
            See :meth:`FastCamera.mean_charge`.
        """
        fast, context = self._fast, self._context(index, time_s)
        if state is None:
            lit, beside = fast.without_finger(), None
        else:
            lit, beside = fast.charge_and_beside(state, grid=grid)
        lit = self._behind_lens(lit, beside, context)
        keys = tuple(int(k) for k in rng.seed_sequence(self._seed, "exposure", index).generate_state(2))
        of_frame = tuple(e for e in self._effects if e.effect.stage is Stage.FRAME)
        want_raw = with_raw or bool(of_frame)
        data: NDArray[Any]
        raw: NDArray[np.uint16] | None
        if self._signal:
            data, raw = self._by_signal(lit, keys, context)
        else:
            exposure = fast._operators.exposure(self._readout, (keys[0], keys[1]), want_raw)
            data, raw = exposure.finish(lit)
        if fast._processor is not None:
            data = finish_mosaic(data, fast._processor, fast._mosaic)
        frame: Frame = apply_stage(Stage.FRAME, Frame(data=data, raw=raw, time=time_s, index=index), of_frame, context)
        return frame

    # --- what is fixed ------------------------------------------------------------------------------------------------

    def _context(self, index: int = 0, time_s: float = 0.0) -> Context:
        return Context(self._scene, self._seed, time_s, index)

    def _stage(self, stage: Stage) -> tuple[Active, ...]:
        return tuple(e for e in self._effects if e.effect.stage is stage)

    def _added_light(self) -> Array | None:
        """Return the irradiance behind the lens that effects before it add to every frame."""
        acting = self._stage(Stage.PLATE_LIGHT)
        if not acting:
            return None
        view = Projection.of(self._scene.camera, self._scene.plate).ideal_view()
        known = _known(view.shape)

        def through(radiance: Array, context: Context) -> PlateLight:
            light = PlateLight(
                radiance=radiance, variance=np.zeros((1, 1)), focal_px=view.focal_px,
                principal_point=view.principal_point,
            )  # fmt: skip
            found: PlateLight = apply_stage(Stage.PLATE_LIGHT, light, acting, context)
            return found

        alone = through(np.zeros(view.shape), self._context())
        level = float(np.abs(alone.radiance).max())
        with_more = through(level * known, self._context(OTHER[1], OTHER[0]))
        if not _same(np.asarray(with_more.radiance) - level * known, np.asarray(alone.radiance)):
            raise NotFast(", ".join(e.effect.id for e in acting))
        return np.asarray(form_image(alone, self._scene.camera, self._scene.plate).irradiance)

    def _of_lens(self) -> _Lens:
        """Sort the effects behind the lens; from the first that depends on the frame on, all act on its sum."""
        acting = self._stage(Stage.SENSOR_LIGHT)
        cols, rows = self._scene.camera.resolution_px
        known, gain = _known((rows, cols)), np.ones((rows, cols))
        linear: list[Active] = []

        def through(entry: Active, light: Array, context: Context) -> Array:
            found = apply_stage(Stage.SENSOR_LIGHT, SensorLight(irradiance=light), (entry,), context)
            return np.asarray(found.irradiance, dtype=float)

        for k, entry in enumerate(acting):
            factor = through(entry, np.ones((rows, cols)), self._context())
            later = through(entry, known, self._context(OTHER[1], OTHER[0]))
            if _same(later, factor * known) and not linear:
                gain *= factor
                continue
            first = through(entry, known, self._context())
            if not (
                _same(later, first) and _same(through(entry, 2.0 * known + 1.0, self._context()), 2 * first + factor)
            ):
                return _Lens(_none_if_one(gain), tuple(linear), acting[k:])
            linear.append(entry)
        return _Lens(_none_if_one(gain), tuple(linear), ())

    def _added_charge(self) -> tuple[Image | None, tuple[Active, ...]]:
        """Return the charge that effects of the pixels add to every frame [e-]; if they do more, they act on each."""
        acting = self._stage(Stage.CHARGE)
        if not acting:
            return None, ()
        cols, rows = self._scene.camera.resolution_px
        alone = np.asarray(apply_stage(Stage.CHARGE, np.zeros((rows, cols)), acting, self._context()))
        known = np.linspace(0.0, 2.0 * self._scene.camera.pixel.full_well_capacity_e, rows * cols).reshape(rows, cols)
        more = np.asarray(apply_stage(Stage.CHARGE, known, acting, self._context(OTHER[1], OTHER[0])))
        if not _same(more - known, alone):
            return None, acting
        return alone.astype(np.float32), ()

    def _of_readout(self, readout: Readout) -> tuple[Readout, tuple[Active, ...]]:
        """Return the readout, with an offset of every pixel in its black level, and effects that act on each frame."""
        acting = self._stage(Stage.READOUT)
        known = np.linspace(0.0, readout.top, 256).reshape(16, 16)
        for k, entry in enumerate(acting):
            more = np.asarray(apply_stage(Stage.READOUT, known, (entry,), self._context(OTHER[1], OTHER[0]))) - known
            alone = np.asarray(apply_stage(Stage.READOUT, np.zeros((16, 16)), (entry,), self._context()))
            if np.ptp(alone) > 0.0 or not np.allclose(more, alone, rtol=0.0, atol=1e-9):
                return readout, acting[k:]
            readout = replace(readout, black_DN=readout.black_DN + float(alone[0, 0]))
        return readout, ()

    # --- each frame ---------------------------------------------------------------------------------------------------

    def _behind_lens(self, lit: ChargeBox, beside: Image | None, context: Context) -> ChargeBox:
        """Return the mean charge of a frame, of that by the finger's and the contact's light and by what is beside."""
        lens, rows, cols = self._lens, self._readout.shape[0], self._readout.shape[1]
        charge = lit.charge
        here = np.s_[lit.row : lit.row + charge.shape[0], lit.col : lit.col + charge.shape[1]]
        if not (lens.linear or lens.each or self._charge) and beside is None and self._fixed is None:
            return ChargeBox(lit.row, lit.col, charge if lens.gain is None else charge * lens.gain[here])
        if lens.linear:
            whole = np.zeros((rows, cols), np.float32)
            whole[here] = charge
            whole = self._through(whole)
            whole = whole if beside is None else whole + self._kept_beside(beside)
        else:
            whole = np.zeros((rows, cols), np.float32) if beside is None else self._kept_beside(beside).copy()
            whole[here] += charge if lens.gain is None else charge * lens.gain[here]
        if lens.each:
            whole = whole if self._before is None else whole + self._before
            light = SensorLight(irradiance=whole.astype(float) / self._per_irradiance)
            light = apply_stage(Stage.SENSOR_LIGHT, light, lens.each, context)
            whole = np.asarray(light.irradiance * self._per_irradiance, np.float32)
            whole = whole if self._after is None else whole + self._after
        elif self._fixed is not None:
            whole += self._fixed
        if self._charge:
            whole = np.asarray(apply_stage(Stage.CHARGE, whole.astype(float), self._charge, context), np.float32)
        return ChargeBox(0, 0, whole)

    def _through(self, charge: Image) -> Image:
        """Return charge by light after the effects of the lens that no frame changes."""
        if self._lens.gain is not None:
            charge = charge * self._lens.gain
        light = apply_stage(Stage.SENSOR_LIGHT, SensorLight(irradiance=charge), self._lens.linear, self._context())
        return np.asarray(light.irradiance, np.float32)

    def _kept_beside(self, beside: Image) -> Image:
        """Return the light beside a contact behind the lens, kept for the last approaches."""
        found = next((after for before, after in self._beside if before is beside), None)
        if found is None:
            found = self._through(beside)
            self._beside = [*self._beside, (beside, found)][-KEPT:]
        return found

    def _by_signal(
        self, lit: ChargeBox, keys: Sequence[int], context: Context
    ) -> tuple[NDArray[Any], NDArray[np.uint16]]:
        """Expose with effects between the pixels and their raw numbers."""
        from evanesce.render.fast.operators_numpy import developed_numpy, signal_numpy

        signal = signal_numpy(lit, self._readout, (keys[0], keys[1]))
        signal = np.asarray(apply_stage(Stage.READOUT, signal, self._signal, context))
        raw = np.clip(signal + 0.5, 0.0, self._readout.top).astype(np.uint16)
        return developed_numpy(raw, self._readout), raw


def _known(shape: tuple[int, int]) -> Array:
    """Return light without any symmetry, between a half and one and a half."""
    row, col = np.arange(shape[0])[:, None], np.arange(shape[1])[None, :]
    return np.asarray(1.0 + 0.25 * (np.sin(0.7 * row + 0.11 * col) + np.sin(0.13 * row - 0.9 * col)))


def _same(one: Array, other: Array) -> bool:
    return bool(np.abs(one - other).max() <= SAME * np.abs(other).max())


def _none_if_one(gain: Array) -> Image | None:
    return None if bool((gain == 1.0).all()) else gain.astype(np.float32)


def _sum(one: Image | None, other: Image | None) -> Image | None:
    return other if one is None else one if other is None else one + other
