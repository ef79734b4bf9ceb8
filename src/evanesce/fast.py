"""The fast camera: from a contact state to a noisy 8-bit frame at video rate, what does not change computed once.

It is the chain of :mod:`evanesce.simulate` for the ideal rig, behind the fast renderer. A scene with an effect, or with
a camera that the fast way does not model, goes through the general chain: slower, never different in what it means.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from evanesce import rng
from evanesce.effects import active_effects
from evanesce.optics.projection import Projection
from evanesce.render.feedback import CoarseGrid, coarse_mean, feedback
from evanesce.render.fields import Fields, fields_of
from evanesce.render.fused import Backend, Lit, Readout, in_threads, llvm_works, operators
from evanesce.render.patch import InterfaceBox, enlarged, field_images, refinement
from evanesce.render.transport import Maps, flank_depth, flank_lit, flank_place, plate_maps, render_fast
from evanesce.rig import Scene
from evanesce.sensor.lens import form_image, prepared_lens
from evanesce.sensor.pixel import photon_count
from evanesce.sensor.tone import develop
from evanesce.simulate import simulate, touch
from evanesce.states import ContactState, Frame, PlateGrid

Array = NDArray[np.float64]
Image = NDArray[np.float32]

FLANK_STEP = 4
BLUR_ERROR = 5e-3
"""Of the light of a point, what the separable sum may put elsewhere than the lens's kernel."""

LEAST_READ_NOISE_E = 1.0
"""Below, the steps of Poisson's distribution show, which the fast noise does not have."""


@dataclass(frozen=True)
class _Optics:
    """All of one scene and contact grid that frames share.

    Attributes
    ----------
    contact_e : ndarray (rows, cols)
        Mean charge in full contact without feedback [e-].
    charge_per_radiance : ndarray (rows, cols)
        [e- mm^2 sr/W].
    direct, turned : tuple
        Maps from the frame to the refined grid, directly and after one more turn between the plate's faces.
    refine : int
        Samples a side of one cell of the contact grid.
    fine : tuple of int
        (rows, cols) of the refined grid.
    blur : tuple of ndarray
        Factors of the separable kernels, (factor, signed factor) each.
    decay : ndarray
        Coupling by gap over that of contact.
    coarse : CoarseGrid
    pixel : ndarray
        See :func:`pixel_kernel`.
    first : tuple of float
        Place of the refined grid's first sample [mm].
    pitch : float
        [mm].
    reach : int
        Of the blur [px].
    direction : tuple of ndarray
        Undistorted direction (u, v, 1) of each pixel.
    """

    contact_e: Image
    charge_per_radiance: Image
    direct: Maps
    turned: Maps
    refine: int
    fine: tuple[int, int]
    blur: tuple[tuple[Image, Image], ...]
    decay: Image
    coarse: CoarseGrid
    pixel: Image
    first: tuple[float, float]
    pitch: float
    reach: int
    direction: tuple[Array, Array]


def separable(kernel: Array, error: float) -> tuple[tuple[Image, Image], ...]:
    """Return a symmetric kernel as the shortest sum of separable ones that moves at most ``error`` of the light.

    Parameters
    ----------
    kernel : ndarray (k, k)
        Symmetric, sum 1.
    error : float
        Largest sum of absolute differences [1].
    """
    values, vectors = np.linalg.eigh(kernel)
    order = np.argsort(-np.abs(values))
    total = np.zeros_like(kernel)
    parts: list[tuple[Array, Array]] = []
    for k in order:
        parts.append((vectors[:, k], values[k] * vectors[:, k]))
        total = total + np.outer(*parts[-1])
        if np.abs(kernel - total / total.sum()).sum() <= error:
            break
    scale = total.sum()
    return tuple((a.astype(np.float32), (b / scale).astype(np.float32)) for a, b in parts)


def blurred(image: Image, parts: tuple[tuple[Image, Image], ...]) -> Image:
    """Fold an image with separable kernels, dark around; stripes of rows in threads."""
    if not parts:
        return image
    reach = parts[0][0].size // 2
    padded = cv2.copyMakeBorder(image, reach, reach, 0, 0, cv2.BORDER_CONSTANT)
    out = np.empty_like(image)

    def work(rows: range) -> None:
        stripe = padded[rows.start : rows.stop + 2 * reach]
        total = cv2.sepFilter2D(stripe, cv2.CV_32F, *parts[0], borderType=cv2.BORDER_CONSTANT)
        for across, down in parts[1:]:
            total += cv2.sepFilter2D(stripe, cv2.CV_32F, across, down, borderType=cv2.BORDER_CONSTANT)
        out[rows.start : rows.stop] = total[reach : total.shape[0] - reach]

    in_threads(work, image.shape[0], max(64, -(-image.shape[0] // 2)))
    return out


class FastCamera:
    """Frames of one scene.

    Parameters
    ----------
    scene : Scene
    backend : {"auto", "llvm", "numpy"}
        ``auto`` takes llvm where it works.

    Attributes
    ----------
    backend : str
        ``llvm`` or ``numpy``.
    falls_back : str
        Why frames go through the general chain; empty if they do not.
    """

    def __init__(self, scene: Scene, backend: Literal["auto", "llvm", "numpy"] = "auto") -> None:
        self.scene = scene
        self.falls_back = _why_general(
            scene, [e.effect.id for e in active_effects(scene) if not e.effect.is_null(e.parameters)]
        )
        if backend == "auto":
            backend = "llvm" if llvm_works() else "numpy"
        elif backend == "llvm" and not llvm_works():
            raise ValueError("Dr.Jit's LLVM backend does not work here")
        self.backend: Backend = backend
        self._operators = operators(backend)
        self._readout = _readout(scene)
        self._fields: Fields | None = None
        self._optics: tuple[PlateGrid, _Optics] | None = None
        self._flank: dict[float, _FlankView] = {}  # by approach: some thirty tenths of a millimetre at most

    def frame(
        self, state: ContactState | None, *, seed: int, index: int = 0, time_s: float = 0.0, with_raw: bool = False
    ) -> Frame:
        """Take the picture of a contact; the same arguments give the same bytes.

        Parameters
        ----------
        state : ContactState or None
            What touches, before effects of the stage ``contact``; None: nothing.
        seed, index : int
            The run's seed and the frame's number: noise is a function of both.
        time_s : float
            Mid-exposure time [s].
        with_raw : bool
            Whether to keep the raw numbers, too.
        """
        if self.falls_back:
            return self._general(state, seed, index, time_s)
        lit = Lit(0, 0, np.zeros((0, 0), np.float32)) if state is None else self.mean_charge(state)
        key = rng.seed_sequence(seed, "exposure", index).generate_state(2)
        data, raw = self._operators.expose(lit, self._readout, (int(key[0]), int(key[1])), with_raw=with_raw)
        return Frame(data=data, raw=raw, time=time_s, index=index)

    def press(self, force_N: float | None, *, seed: int, index: int = 0, time_s: float = 0.0) -> Frame:
        """Press with a force [N] and take the picture: the frame of :func:`evanesce.simulate.simulate`.

        Effects of rig and load change the contact itself; they act here, not where a contact is given.
        """
        if self.falls_back:
            return simulate(self.scene, force_N, seed=seed, index=index, time_s=time_s, render=render_fast).frame
        _, state = touch(self.scene, force_N, seed=seed, time_s=time_s, index=index)
        return self.frame(state, seed=seed, index=index, time_s=time_s)

    def _general(self, state: ContactState | None, seed: int, index: int, time_s: float) -> Frame:
        """Take the picture by the general chain, with the contact as given."""

        def given(*_: Any, **__: Any) -> Any:
            return state

        force = None if state is None else state.normal_force
        found = simulate(self.scene, force, seed=seed, time_s=time_s, index=index, contact=given, render=render_fast)
        return found.frame

    def frames(
        self, states: Iterable[ContactState | None], *, seed: int, frame_rate_hz: float = 30.0, with_raw: bool = False
    ) -> Iterator[Frame]:
        """Take the pictures of a sequence.

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

    def mean_charge(self, state: ContactState) -> Lit:
        """Return the mean charge by light, blurred, in the smallest box that holds it [e-]."""
        scene = self.scene
        if self._fields is None:
            self._fields = fields_of(scene)
        fields = self._fields
        if fields.glow is not None:
            # What wanders in the silicone is not fused; lens and pixel take it from the general chain.
            light = form_image(render_fast(scene, state), scene.camera, scene.plate)
            charge = light.irradiance * _charge_per_irradiance(scene)
            return Lit(0, 0, charge.astype(np.float32))
        optics = self._optics_for(state.grid)
        end, coarse = float(fields.gaps[-1]), optics.coarse
        found = InterfaceBox.of(state, end, optics.refine)
        coupled = self._operators.coupling(found.gap, found.share, end, optics.decay)
        box = _Box(found.row, found.col, coupled, found.cover)
        mean = coarse_mean(coupled, (box.row, box.col), optics.fine, coarse.shape)
        change, taken = feedback(fields, coarse, coarse.contact * mean)
        depth = flank_depth(scene, state)
        flank = self._flank.get(depth)
        if flank is None:
            flank = self._flank[depth] = _FlankView.of(scene, optics, depth)
        dim = cv2.remap(flank_lit(scene, fields, taken, depth), flank.column, flank.row, cv2.INTER_LINEAR)
        return _on_frame(scene, fields.ghost, optics, box, change, flank, dim * flank.charge)

    def _optics_for(self, grid: PlateGrid) -> _Optics:
        if self._optics is None or self._optics[0] != grid:
            self._optics = (grid, _prepare(self.scene, grid))
            self._flank.clear()
        return self._optics[1]


@dataclass(frozen=True)
class _Box:
    """Part of the refined grid from (row, col) on: coupling; and cover, on the contact grid itself."""

    row: int
    col: int
    coupled: Image
    cover: Image


@dataclass(frozen=True)
class _FlankView:
    """Where every ``FLANK_STEP``-th pixel of the frame sees the flank.

    ``column`` and ``row`` are its place in the flank's table, ``charge`` [e- mm^2 sr/W] is 0 elsewhere; all start at
    pixel (``first_row``, ``first_col``).
    """

    first_row: int
    first_col: int
    column: Image
    row: Image
    charge: Image

    @classmethod
    def of(cls, scene: Scene, optics: _Optics, depth: float) -> _FlankView:
        """Find the flank in the frame."""
        step = FLANK_STEP
        column, row, seen = flank_place(
            scene, optics.direction[0][::step, ::step], optics.direction[1][::step, ::step], depth
        )
        charge = optics.charge_per_radiance[::step, ::step] * seen
        rows, cols = np.nonzero(seen.any(axis=1))[0], np.nonzero(seen.any(axis=0))[0]
        if rows.size == 0:
            return cls(0, 0, column[:1, :1], row[:1, :1], charge[:1, :1] * 0)
        part = np.s_[max(0, rows[0] - 1) : rows[-1] + 2, max(0, cols[0] - 1) : cols[-1] + 2]
        first = part[0].start * step, part[1].start * step
        return cls(*first, *(np.ascontiguousarray(a[part], np.float32) for a in (column, row, charge)))


def _frame_window(scene: Scene, optics: _Optics, box: _Box) -> tuple[int, int, int, int]:
    """Return rows and columns (r0, r1, c0, c1) of the frame that a box on the plate and its blur reach."""
    projection = Projection.of(scene.camera, scene.plate)
    x0, y0 = optics.first[0] + box.col * optics.pitch, optics.first[1] + box.row * optics.pitch
    x1, y1 = x0 + box.coupled.shape[1] * optics.pitch, y0 + box.coupled.shape[0] * optics.pitch
    side = np.linspace(0.0, 1.0, 9)
    x = np.concatenate([x0 + (x1 - x0) * side] * 2 + [np.full(9, x0), np.full(9, x1)])
    y = np.concatenate([np.full(9, y0), np.full(9, y1)] + [y0 + (y1 - y0) * side] * 2)
    u, v = projection.to_image(x, y)
    # The ghost of the second turn lies nearer to the axis.
    turn = 2 * scene.plate.thickness_mm
    foot = projection.pinhole
    slope = 1.0 / (projection.clearance * projection.refractive_index + projection.thickness)
    inner = 1.0 / (1.0 + turn * slope)
    gu, gv = projection.to_image(foot[0] + (x - foot[0]) * inner, foot[1] + (y - foot[1]) * inner)
    u, v = np.concatenate([u, gu]), np.concatenate([v, gv])
    margin = optics.reach + 4
    rows, cols = projection.shape
    r0, r1 = max(0, int(v.min()) - margin), min(rows, int(v.max()) + margin + 2)
    c0, c1 = max(0, int(u.min()) - margin), min(cols, int(u.max()) + margin + 2)
    return r0, max(r0, r1), c0, max(c0, c1)


def _on_frame(
    scene: Scene, ghost: float, optics: _Optics, box: _Box, change: Array, flank: _FlankView, dim: Image
) -> Lit:
    """Carry coupling and flank into the frame, to charges, and blur them there."""
    step = FLANK_STEP
    rows, cols = optics.charge_per_radiance.shape
    high, wide = (
        min(n, s * step) for n, s in ((rows - flank.first_row, dim.shape[0]), (cols - flank.first_col, dim.shape[1]))
    )
    r0, r1, c0, c1 = _frame_window(scene, optics, box)
    if r1 <= r0 or c1 <= c0:
        return Lit(flank.first_row, flank.first_col, enlarged(dim, step, (high, wide)))
    # A box for both, its corner on the flank's raster.
    top = min(r0, flank.first_row) // step * step
    left = min(c0, flank.first_col) // step * step
    bottom, right = max(r1, flank.first_row + high), max(c1, flank.first_col + wide)
    charge = np.zeros((bottom - top, right - left), np.float32)
    charge[
        flank.first_row - top : flank.first_row - top + high, flank.first_col - left : flank.first_col - left + wide
    ] = enlarged(dim, step, (high, wide))
    here = np.s_[r0:r1, c0:c1]
    inside = np.s_[r0 - top : r1 - top, c0 - left : c1 - left]
    charge[inside] = blurred(_contact_charge(ghost, optics, box, change, here, charge[inside]), optics.blur)
    return Lit(top, left, charge)


def _contact_charge(ghost: float, optics: _Optics, box: _Box, change: Array, here: Any, flank: Image) -> Image:
    """Return the charge of contact and of the flank beside it, before blur."""

    def from_box(image: Image, x: Image, y: Image, coarser: int = 1) -> Image:
        # A grid ``coarser`` times as coarse has its first sample (coarser - 1)/2 later.
        shift = (coarser - 1) / 2
        x = x * np.float32(1 / coarser) - np.float32((box.col + shift) / coarser)
        y = y * np.float32(1 / coarser) - np.float32((box.row + shift) / coarser)
        return np.asarray(cv2.remap(image, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=0))

    coupled = blurred(box.coupled, ((optics.pixel, optics.pixel),))
    total = from_box(coupled, optics.direct[0][here], optics.direct[1][here])
    shape = total.shape

    def dim(step: int, of: Callable[[Any], Any]) -> Image:
        # What is dim or smooth is sampled at every few pixels only.
        rows, cols = here
        at = np.s_[rows.start : rows.stop + step : step, cols.start : cols.stop + step : step]
        return enlarged(np.asarray(of(at), np.float32), step, shape)

    bare = dim(2, lambda at: 1 - from_box(box.cover, optics.direct[0][at], optics.direct[1][at], optics.refine))
    turned = dim(4, lambda at: from_box(coupled, optics.turned[0][at], optics.turned[1][at]))
    rise = (1.0 + change).astype(np.float32)
    per_x, per_y = (np.float32(a / b) for a, b in zip(rise.shape[::-1], optics.fine[::-1], strict=True))
    half = np.float32(0.5)

    def lifted(at: Any) -> Any:
        x, y = (optics.direct[0][at] + half) * per_x - half, (optics.direct[1][at] + half) * per_y - half
        return cv2.remap(rise, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)

    turned *= np.float32(ghost)
    turned *= bare
    total += turned
    total *= dim(8, lifted)
    total *= optics.contact_e[here]
    bare *= flank
    total += bare
    return total


def pixel_kernel(samples_per_px: float, sub_samples: int) -> Image:
    """Return what the general chain's sampling does to light on the refined grid, as a kernel along one axis.

    A pixel of the pinhole view is a box; the frame's sub-samples read it by linear interpolation, whose mean over all
    phases is a triangle. The remap from the refined grid interpolates, too: by so much the box is narrower.

    Parameters
    ----------
    samples_per_px : float
        Of the refined grid.
    sub_samples : int
        Of a frame pixel along one axis.
    """
    fine = 64
    pitch = 1.0 / samples_per_px
    width = np.sqrt(max(1.0 - 2.0 * pitch**2, 0.0625))
    x = np.arange(-3 * fine, 3 * fine + 1) / fine
    box = np.clip((width / 2 - np.abs(x)) * fine + 0.5, 0.0, 1.0)
    triangle = np.clip(1.0 - np.abs(x), 0.0, None)
    spread = np.convolve(box, triangle, mode="same")
    offsets = (np.arange(sub_samples) + 0.5) / sub_samples - 0.5
    spread = sum(np.interp(x - offset, x, spread) for offset in offsets)
    reach = int(np.ceil((0.5 * width + 1.0 + 0.5) * samples_per_px))
    taps = np.arange(-reach, reach + 1) * pitch
    found = np.array([(spread * np.clip(1.0 - np.abs(x - t) / pitch, 0.0, None)).sum() for t in taps])
    return np.asarray(found / found.sum(), np.float32)


def _why_general(scene: Scene, active: list[str]) -> str:
    """Return why a scene needs the general chain; empty if it does not."""
    pixel, lens = scene.camera.pixel, scene.camera.lens
    if active:
        return f"effects: {', '.join(active)}"
    if pixel.prnu > 0 or pixel.dsnu_e > 0:
        return "camera.pixel: fixed pattern"
    if pixel.read_noise_e < LEAST_READ_NOISE_E:
        return f"camera.pixel.read_noise_e below {LEAST_READ_NOISE_E:g}"
    if lens.field_curvature_um != 0.0:
        return "camera.lens.field_curvature_um: blur that varies over the field"
    return ""


def _readout(scene: Scene) -> Readout:
    camera, pixel = scene.camera, scene.camera.pixel
    every = np.arange(2**pixel.bits, dtype=np.uint16)
    cols, rows = camera.resolution_px
    return Readout(
        shape=(rows, cols),
        dark_e=pixel.dark_current_e_per_s * camera.exposure_ms * 1e-3,
        full_well_e=pixel.full_well_capacity_e,
        read_noise_e=pixel.read_noise_e,
        gain=camera.analogue_gain / pixel.conversion_gain_e_per_DN,
        black_DN=pixel.black_level_DN,
        tone=develop(every, black_level_DN=pixel.black_level_DN, bits=pixel.bits, curve=camera.tone_curve),
    )


def _charge_per_irradiance(scene: Scene) -> float:
    """Return mean charge over irradiance [e- mm^2/W]."""
    camera, pixel = scene.camera, scene.camera.pixel
    photons = photon_count(
        np.ones(1),
        pitch_um=pixel.pitch_um,
        fill_factor=pixel.fill_factor,
        exposure_s=camera.exposure_ms * 1e-3,
        wavelength_nm=camera.wavelength_nm,
    )
    return float(photons[0]) * pixel.quantum_efficiency


def _prepare(scene: Scene, grid: PlateGrid) -> _Optics:
    """Compute what all frames on one contact grid share."""
    fields, projection = fields_of(scene), Projection.of(scene.camera, scene.plate)
    view = projection.ideal_view()
    lens = prepared_lens(scene.camera, scene.plate, view)
    refine = refinement(grid.pitch, 1.0 / scene.camera.scale_px_per_mm)
    pitch = grid.pitch / refine
    first = (float(grid.extent[0]) + pitch / 2, float(grid.extent[2]) + pitch / 2)
    rows, cols = projection.shape
    cx, cy = projection.principal_point
    u, v = np.meshgrid((np.arange(cols) - cx) / projection.focal_px, (np.arange(rows) - cy) / projection.focal_px)
    direction = projection.undistort(u, v)
    coarse = CoarseGrid.of(fields, grid)
    direct, turned = plate_maps(scene, direction, first, pitch)
    x, y = (m.astype(float) * pitch + p0 for m, p0 in zip(direct, first, strict=True))
    # The gain is per sub-sample.
    charge = lens.gain * (_charge_per_irradiance(scene) * len(lens.maps))
    contact = fields.coupling[:, 0] * fields.response[0]
    level = sum(c * image for c, image in zip(contact, field_images(fields, x, y), strict=True))
    kernels = () if lens.spread is None else lens.spread.kernels
    middle = np.tensordot(fields.coupling * fields.response, fields.modes.mean(axis=(1, 2)), (0, 0))
    blur = separable(kernels[0], BLUR_ERROR) if kernels else ()
    return _Optics(
        direction=direction,
        contact_e=(level * charge).astype(np.float32),
        charge_per_radiance=charge.astype(np.float32),
        direct=direct,
        turned=turned,
        refine=refine,
        fine=(grid.shape[0] * refine, grid.shape[1] * refine),
        blur=blur,
        reach=kernels[0].shape[0] // 2 if kernels else 0,
        decay=(middle / middle[0]).astype(np.float32),
        coarse=coarse,
        pixel=pixel_kernel(1.0 / (scene.camera.scale_px_per_mm * pitch), round(np.sqrt(len(lens.maps)))),
        first=first,
        pitch=pitch,
    )
