"""The fast camera: from a contact state to a noisy 8-bit frame at video rate, what does not change computed once.

It is the chain of :mod:`evanesce.chain.simulate` for the ideal rig, behind the fast renderer. A scene with an effect,
or with a camera that it does not model, goes through the general chain: slower, the same model.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from evanesce.chain.fast_optics import (
    COVER_STEP,
    GHOST_STEP,
    Optics,
    charge_per_irradiance,
    prepare,
    readout_of,
    retuned,
)
from evanesce.chain.fast_surroundings import Beside, KeptBeside
from evanesce.chain.simulate import simulate, solve_contact
from evanesce.core import rng
from evanesce.core.states import ContactState, Frame, PlateGrid, embedded
from evanesce.effects import active_effects
from evanesce.optics.liquid import lit_contact
from evanesce.optics.projection import Projection
from evanesce.optics.seen import seen_at
from evanesce.render.fast.feedback import coarse_mean, feedback
from evanesce.render.fast.fields import Fields, fields_of
from evanesce.render.fast.flank import FlankView
from evanesce.render.fast.flank_table import rounded_approach
from evanesce.render.fast.operators import Backend, operators
from evanesce.render.fast.operators_llvm import llvm_works
from evanesce.render.fast.patch import InterfaceBox
from evanesce.render.fast.readout import ChargeBox
from evanesce.render.fast.sampling import BLOCK, Maps, block_means, spread_blocks
from evanesce.render.fast.transport import render_fast
from evanesce.rig import Scene
from evanesce.rig.colour import Mosaic
from evanesce.rig.finger import OWN_FIGURES
from evanesce.sensor.automatic import is_automatic
from evanesce.sensor.colour import ImageProcessor, finish_mosaic
from evanesce.sensor.lens import form_image

Array = NDArray[np.float64]
Image = NDArray[np.float32]

LEAST_READ_NOISE_E = 1.0
"""Below, the steps of Poisson's distribution show, which the fast noise does not have."""


class FastCamera:
    """Frames of one scene.

    Parameters
    ----------
    scene : Scene
    backend : {"auto", "llvm", "numpy"}
        ``auto`` takes llvm where it works.

    Attributes
    ----------
    scene : Scene
        As its LEDs' light sees it (:func:`~evanesce.optics.seen.seen_at`); as given where ``falls_back``.
    backend : str
        ``llvm`` or ``numpy``.
    falls_back : str
        Why frames go through the general chain; empty if they do not.
    """

    def __init__(self, scene: Scene, backend: Literal["auto", "llvm", "numpy"] = "auto") -> None:
        self.falls_back = _why_general(
            scene, [e.effect.id for e in active_effects(scene) if not e.effect.is_null(e.parameters)]
        )
        # The general chain sees the scene itself, after effects that may change its light.
        scene = scene if self.falls_back else seen_at(scene)
        self.scene = scene
        if backend == "auto":
            backend = "llvm" if llvm_works() else "numpy"
        elif backend == "llvm" and not llvm_works():
            raise ValueError("Dr.Jit's LLVM backend does not work here")
        self.backend: Backend = backend
        self._operators = operators(backend)
        self._readout = readout_of(scene)
        colour = scene.camera.colour
        self._processor = None if colour is None else ImageProcessor.of(scene.camera)
        self._mosaic: Mosaic = "RGGB" if colour is None else colour.mosaic
        self._fields: Fields | None = None
        self._optics: tuple[PlateGrid, Optics] | None = None
        around = scene.surroundings is not None and not self.falls_back
        self._beside = KeptBeside(scene) if around else None
        self._flank: dict[float, FlankView] = {}  # by approach: some thirty tenths of a millimetre at most

    def retuned(self, scene: Scene) -> FastCamera:
        """Return the camera of a scene like this one; one that differs in LED powers or focus shares what is costly.

        Its frames are those of a camera made for it, a fifth of a second sooner.
        """
        other = FastCamera(scene, self.backend)
        scene = other.scene
        if self._optics is None or self.falls_back or other.falls_back or _lasting(scene) != _lasting(self.scene):
            return other
        relit = scene.leds != self.scene.leds
        grid, optics = self._optics
        refocused = scene.camera.lens != self.scene.camera.lens
        other._optics = grid, retuned(optics, scene, grid, relit=relit, refocused=refocused)
        light = fields_of(scene).flank
        other._flank = {mm: view.relit(light, mm) if relit else view for mm, view in self._flank.items()}
        return other

    def frame(
        self, state: ContactState | None, *, seed: int, index: int = 0, time_s: float = 0.0, with_raw: bool = False
    ) -> Frame:
        """Expose one frame of a contact; the same arguments give the same bytes.

        Parameters
        ----------
        state : ContactState or None
            The contact before effects of the stage ``contact``; None: the finger is away.
        seed, index : int
            The run's seed and the frame's number: noise is a function of both.
        time_s : float
            Mid-exposure time [s].
        with_raw : bool
            Whether to keep the raw numbers, too.
        """
        if self.falls_back:
            return self._general(state, seed, index, time_s)
        key = rng.seed_sequence(seed, "exposure", index).generate_state(2)
        exposure = self._operators.exposure(self._readout, (int(key[0]), int(key[1])), with_raw)
        lit = self.without_finger() if state is None else self.mean_charge(state, meanwhile=exposure.begin)
        data, raw = exposure.finish(lit)
        if self._processor is not None:
            data = finish_mosaic(data, self._processor, self._mosaic)
        return Frame(data=data, raw=raw, time=time_s, index=index)

    def press(self, force_N: float | None, *, seed: int, index: int = 0, time_s: float = 0.0) -> Frame:
        """Press with a force [N] and expose: the frame of :func:`evanesce.chain.simulate.simulate`.

        Effects of rig and load change the contact itself; they act here, not where a contact is given.
        """
        if self.falls_back:
            return simulate(self.scene, force_N, seed=seed, index=index, time_s=time_s, render=render_fast).frame
        _, state = solve_contact(self.scene, force_N, seed=seed, time_s=time_s, index=index)
        return self.frame(state, seed=seed, index=index, time_s=time_s)

    def _general(self, state: ContactState | None, seed: int, index: int, time_s: float) -> Frame:
        """Expose by the general chain, with the contact as given."""

        def given(*_: Any, **__: Any) -> Any:
            return state

        force = None if state is None else state.normal_force
        found = simulate(self.scene, force, seed=seed, time_s=time_s, index=index, contact=given, render=render_fast)
        return found.frame

    def frames(
        self, states: Iterable[ContactState | None], *, seed: int, frame_rate_hz: float = 30.0, with_raw: bool = False
    ) -> Iterator[Frame]:
        """Expose the frames of a sequence of contacts.

        Parameters
        ----------
        states : iterable of ContactState or None
        seed : int
        frame_rate_hz : float
            Of the frames' times [Hz].
        with_raw : bool
        """
        for index, state in enumerate(states):
            yield self.frame(state, seed=seed, index=index, time_s=index / frame_rate_hz, with_raw=with_raw)

    def without_finger(self) -> ChargeBox:
        """Return the mean charge by light while the finger is away, in a box that may be empty [e-]."""
        return ChargeBox(0, 0, np.zeros((0, 0), np.float32) if self._beside is None else self._beside.at(None).whole)

    def mean_charge(
        self, state: ContactState, *, meanwhile: Callable[[], None] = lambda: None, grid: PlateGrid | None = None
    ) -> ChargeBox:
        """Return the mean charge by light, blurred, in the smallest box that holds it [e-].

        Parameters
        ----------
        state : ContactState
        meanwhile : callable
            Called once between kernels, to start another that does not depend on light.
        grid : PlateGrid, optional
            That the state's grid is a part of, or is shifted from by a small way: what the camera keeps is of this
            one, so that it serves all of them. The feedback between contact and plate takes the shift to a sample.
        """
        lit, beside = self.charge_and_beside(state, meanwhile=meanwhile, grid=grid)
        if beside is None:
            return lit
        charge = beside.copy()
        high, wide = lit.charge.shape
        charge[lit.row : lit.row + high, lit.col : lit.col + wide] += lit.charge
        return ChargeBox(0, 0, charge)

    def charge_and_beside(
        self, state: ContactState, *, meanwhile: Callable[[], None] = lambda: None, grid: PlateGrid | None = None
    ) -> tuple[ChargeBox, Image | None]:
        """Return :meth:`mean_charge` in two parts: what depends on the contact, and what on the approach alone.

        Returns
        -------
        ChargeBox
            By contact and flank, less what they hide of the other part [e-].
        ndarray of float32 (rows, cols) or None
            The same array for approaches of a tenth of a millimetre; None without light beside the contact [e-].
        """
        scene, grid = self.scene, state.grid if grid is None else grid
        state = lit_contact(scene, state)
        if self._fields is None:
            self._fields = fields_of(scene)
        fields = self._fields
        if fields.subsurface is not None:
            # The fast operators have no subsurface scattering; lens and pixel take it from the general chain.
            meanwhile()
            light = form_image(render_fast(scene, embedded(state, grid)), scene.camera, scene.plate)
            charge = light.irradiance * charge_per_irradiance(scene)
            return ChargeBox(0, 0, charge.astype(np.float32)), None
        optics = self._optics_for(grid)
        end, coarse = float(fields.gaps[-1]), optics.coarse
        found = InterfaceBox.of(state, end, optics.refine)
        coupled = self._operators.coupling(found.gap, found.share, end, optics.decay)
        meanwhile()
        # On the whole grid: of the cell, and of the sample that is read.
        down, right = (part[0] - whole[0] for part, whole in ((state.grid.y, grid.y), (state.grid.x, grid.x)))
        cell = found.row // optics.refine + down / grid.pitch, found.col // optics.refine + right / grid.pitch
        read = 1 if optics.halved else optics.refine
        if optics.halved:
            coupled = block_means(coupled, optics.refine)
        box = _Box(cell[0] * read, cell[1] * read, coupled, cell, found.cover)
        mean = coarse_mean(coupled, (round(box.row), round(box.col)), optics.samples, coarse.shape)
        change, taken = feedback(fields, coarse, coarse.contact * mean)
        lit = _on_frame(scene, fields.ghost, optics, box, change, *self._flank_charge(state, fields, optics, taken))
        if self._beside is None:
            return lit, None
        beside = self._beside.at(state)
        return _less_hidden(beside, lit, scene, optics, box), beside.whole

    def _flank_charge(
        self, state: ContactState, fields: Fields, optics: Optics, taken: Array
    ) -> tuple[tuple[int, int], Image]:
        """Return the first pixel of the flank and its mean charge [e-], for the power that the contact takes in."""
        mm = rounded_approach(self.scene, state)
        view = self._flank.get(mm)
        if view is None:
            view = FlankView.of(self.scene, fields.flank, mm, optics.flank_direction, optics.flank_e, optics.flank_step)
            self._flank[mm] = view
        return (view.first_row, view.first_col), view.mean_charge(taken)

    def _optics_for(self, grid: PlateGrid) -> Optics:
        if self._optics is None or self._optics[0] != grid:
            self._optics = (grid, prepare(self.scene, grid))
            self._flank.clear()
        return self._optics[1]


@dataclass(frozen=True)
class _Box:
    """Part of the grid that is read, from (row, col) on: coupling; and cover, on the contact grid itself."""

    row: float
    col: float
    coupled: Image
    cover_first: tuple[float, float]
    cover: Image


def _frame_window(scene: Scene, optics: Optics, box: _Box) -> tuple[int, int, int, int]:
    """Return rows and columns (r0, r1, c0, c1) of the frame that a box on the plate and its blur reach."""
    projection = Projection.of(scene.camera, scene.plate)
    x0, y0 = optics.first[0] + box.col * optics.pitch, optics.first[1] + box.row * optics.pitch
    x1, y1 = x0 + box.coupled.shape[1] * optics.pitch, y0 + box.coupled.shape[0] * optics.pitch
    side = np.linspace(0.0, 1.0, 9)
    x = np.concatenate([x0 + (x1 - x0) * side] * 2 + [np.full(9, x0), np.full(9, x1)])
    y = np.concatenate([np.full(9, y0), np.full(9, y1)] + [y0 + (y1 - y0) * side] * 2)
    u, v = projection.to_image(x, y)
    # The ghost, after one more round trip between the faces, lies nearer to the axis.
    round_trip = 2 * scene.plate.thickness_mm
    foot = projection.pinhole
    slope = 1.0 / (projection.clearance * projection.refractive_index + projection.thickness)
    inner = 1.0 / (1.0 + round_trip * slope)
    gu, gv = projection.to_image(foot[0] + (x - foot[0]) * inner, foot[1] + (y - foot[1]) * inner)
    u, v = np.concatenate([u, gu]), np.concatenate([v, gv])
    margin = optics.blur.reach + 4
    rows, cols = optics.contact_e.shape
    r0, r1 = _blocks(v.min() - margin, v.max() + margin + 2, rows)
    c0, c1 = _blocks(u.min() - margin, u.max() + margin + 2, cols)
    return r0, r1, c0, c1


def _blocks(low: float, high: float, size: int) -> tuple[int, int]:
    """Return the whole blocks from ``low`` to ``high`` within 0 to ``size`` [px]."""
    first = max(0, int(low) // BLOCK * BLOCK)
    return first, max(first, min(size, -(-int(high) // BLOCK) * BLOCK))


def _on_frame(
    scene: Scene, ghost: float, optics: Optics, box: _Box, change: Array, first: tuple[int, int], flank: Image
) -> ChargeBox:
    """Return contact and flank in the frame as mean charge, blurred; the flank's starts at pixel ``first``."""
    rows, cols = scene.camera.resolution_px[::-1]
    high, wide = flank.shape
    r0, r1, c0, c1 = _frame_window(scene, optics, box)
    (top, left), charge = first, flank
    if r1 > r0 and c1 > c0:
        # A box for both.
        top, left = min(r0, first[0]), min(c0, first[1])
        bottom, right = max(r1, first[0] + high), max(c1, first[1] + wide)
        if (bottom - top, right - left) != flank.shape:
            charge = np.zeros((bottom - top, right - left), np.float32)
            down, across = first[0] - top, first[1] - left
            charge[down : down + high, across : across + wide] = flank
        inside = np.s_[r0 - top : r1 - top, c0 - left : c1 - left]
        here = (r0, r1, c0, c1)
        charge[inside] = optics.blur.fold(_contact_charge(ghost, optics, box, change, here, charge[inside]))
    return ChargeBox(top, left, charge[: rows - top, : cols - left])


def _read(
    image: Image, maps: Maps, here: tuple[int, int, int, int], first: tuple[float, float], step: int,
    border: int = cv2.BORDER_CONSTANT,
) -> Image:  # fmt: skip
    """Return an image of the grid, whose first sample is ``first``, in part of the frame, every ``step`` pixels."""
    r0, r1, c0, c1 = (n // step for n in here)
    x, y = maps[0][r0:r1, c0:c1] - np.float32(first[1]), maps[1][r0:r1, c0:c1] - np.float32(first[0])
    return np.asarray(cv2.remap(image, x, y, cv2.INTER_LINEAR, borderMode=border))


def _contact_charge(
    ghost: float, optics: Optics, box: _Box, change: Array, here: tuple[int, int, int, int], flank: Image
) -> Image:
    """Return the charge of contact and of the flank beside it, before blur."""

    def read(
        image: Image, maps: Maps, first: tuple[float, float], step: int, border: int = cv2.BORDER_CONSTANT
    ) -> Image:
        return _read(image, maps, here, first, step, border)

    first = box.row, box.col
    coupled = cv2.sepFilter2D(box.coupled, cv2.CV_32F, optics.pixel, optics.pixel, borderType=cv2.BORDER_CONSTANT)
    total = read(coupled, optics.direct, first, 1)
    cover = read(box.cover, optics.cover, box.cover_first, COVER_STEP)
    bare = spread_blocks(np.float32(1) - cover, COVER_STEP)
    reflected = spread_blocks(read(coupled, optics.ghost, first, GHOST_STEP) * np.float32(ghost), GHOST_STEP)
    reflected *= bare
    total += reflected
    rise = (1.0 + change).astype(np.float32)
    total *= spread_blocks(read(rise, optics.rise, (0, 0), BLOCK, cv2.BORDER_REPLICATE), BLOCK)
    r0, r1, c0, c1 = here
    total *= optics.contact_e[r0:r1, c0:c1]
    bare *= flank
    total += bare
    return total


def _less_hidden(beside: Beside, lit: ChargeBox, scene: Scene, optics: Optics, box: _Box) -> ChargeBox:
    """Return the charge of contact and flank less what the contact hides of the light beside it."""
    rows, cols = beside.whole.shape
    r0, r1, c0, c1 = _frame_window(scene, optics, box)
    if not (r1 > r0 and c1 > c0):
        return lit
    cover = spread_blocks(_read(box.cover, optics.cover, (r0, r1, c0, c1), box.cover_first, COVER_STEP), COVER_STEP)
    r1, c1 = min(r1, rows), min(c1, cols)
    hidden = optics.blur.fold(cover[: r1 - r0, : c1 - c0] * beside.hidden[r0:r1, c0:c1])
    high, wide = lit.charge.shape
    top, left = min(r0, lit.row), min(c0, lit.col)
    bottom, right = max(r1, lit.row + high), max(c1, lit.col + wide)
    charge = np.zeros((bottom - top, right - left), np.float32)
    charge[lit.row - top : lit.row - top + high, lit.col - left : lit.col - left + wide] = lit.charge
    charge[r0 - top : r1 - top, c0 - left : c1 - left] -= hidden
    return ChargeBox(top, left, charge)


def _why_general(scene: Scene, active: list[str]) -> str:
    """Return why a scene needs the general chain; empty if it does not."""
    pixel, lens = scene.camera.pixel, scene.camera.lens
    if scene.slide is not None:
        return "slide: the finger's body moves over the frame"
    if active:
        return f"effects: {', '.join(active)}"
    if pixel.prnu > 0 or pixel.dsnu_e > 0 or pixel.dark_nonuniformity_e_per_s > 0:
        return "camera.pixel: fixed pattern"
    if pixel.read_noise_e < LEAST_READ_NOISE_E:
        return f"camera.pixel.read_noise_e below {LEAST_READ_NOISE_E:g}"
    if is_automatic(scene.camera):
        return "camera: automatic exposure or white balance"
    if scene.camera.colour is not None and scene.camera.colour.denoising > 0.0:
        return "camera.colour.denoising"
    if lens.field_curvature_um != 0.0:
        return "camera.lens.field_curvature_um: blur that varies over the field"
    return ""


def _lasting(scene: Scene) -> dict[str, Any]:
    """Return all of a scene that a camera's maps, charges and noise may depend on, LED powers and focus left out."""
    data = scene.as_dict()
    leds, lens, finger = data["leds"], data["camera"]["lens"], data["finger"]
    for key in ("voltage_V", "circuit", "strip_resistance_ohm_per_mm"):
        leds.pop(key)
    for edge in leds["edge"].values():
        # A shift along the edge moves LEDs, and stays.
        edge.pop("voltage_V", None)
        edge.pop("strip_resistance_ohm_per_mm", None)
        edge.pop("relative_power", None)
    leds["edge"] = {name: edge for name, edge in leds["edge"].items() if edge != {"offset_mm": 0.0}}
    lens.pop("defocus_um")
    for key in ("material", "ridges", "modulus_factor", *OWN_FIGURES):
        finger.pop(key, None)
    return {key: data[key] for key in ("plate", "leds", "finger", "camera", "grid")}
