"""What all frames of a fast camera share: maps from frame to contact grid, charges, the blur of lens and pixel."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from evanesce.core.states import PlateGrid
from evanesce.optics.projection import Projection
from evanesce.render.fast.feedback import CoarseGrid
from evanesce.render.fast.fields import Fields, fields_of
from evanesce.render.fast.flank_table import flank_step
from evanesce.render.fast.patch import field_image, refinement
from evanesce.render.fast.readout import Readout
from evanesce.render.fast.sampling import BLOCK, Maps, block_means, spread_blocks
from evanesce.render.fast.transport import plate_maps
from evanesce.rig import Scene
from evanesce.sensor.blur import FieldBlur
from evanesce.sensor.colour import CHANNELS, ImageProcessor, balance_table
from evanesce.sensor.lens import lens_blur, prepared_lens
from evanesce.sensor.pixel import photon_count
from evanesce.sensor.response import led_response
from evanesce.sensor.tone import develop

Array = NDArray[np.float64]
Image = NDArray[np.float32]

COVER_STEP = 2
GHOST_STEP = 4
"""Sides of the blocks of pixels over which cover and ghost are sampled once [px]."""

KEEP_SPECTRA = 12


@dataclass(frozen=True)
class Blur:
    """A kernel, folded by Fourier transforms; spectra are kept by size.

    Attributes
    ----------
    kernel : ndarray of float32 (k, k)
        Sum 1; empty for none.
    """

    kernel: Image
    _spectra: dict[tuple[int, int], Image] = field(default_factory=dict)

    @property
    def reach(self) -> int:
        """How far light is carried [px]."""
        return self.kernel.shape[0] // 2

    def fold(self, image: Image) -> Image:
        """Return an image blurred, dark around."""
        if self.reach == 0:
            return image
        reach, (rows, cols) = self.reach, image.shape
        # What is carried out on one side comes in on the other: a dark margin of the kernel's reach takes it.
        high, wide = (cv2.getOptimalDFTSize(n + reach) for n in (rows, cols))
        padded = cv2.copyMakeBorder(image, 0, high - rows, 0, wide - cols, cv2.BORDER_CONSTANT)
        spectrum = cv2.mulSpectrums(cv2.dft(padded, nonzeroRows=rows), self._spectrum((high, wide)), 0)
        whole = cv2.dft(spectrum, flags=cv2.DFT_INVERSE | cv2.DFT_SCALE | cv2.DFT_REAL_OUTPUT, nonzeroRows=rows)
        return np.asarray(whole[:rows, :cols], np.float32)

    def _spectrum(self, shape: tuple[int, int]) -> Image:
        if shape not in self._spectra:
            if len(self._spectra) >= KEEP_SPECTRA:
                self._spectra.pop(next(iter(self._spectra)))
            around = np.zeros(shape, np.float32)
            steps = np.arange(-self.reach, self.reach + 1)
            # A window smaller than the kernel: what falls together adds up.
            np.add.at(around, (steps[:, None] % shape[0], steps[None, :] % shape[1]), self.kernel)
            self._spectra[shape] = np.asarray(cv2.dft(around), np.float32)
        return self._spectra[shape]


@dataclass(frozen=True)
class Optics:
    """All of one scene and contact grid that frames share. Images cover the frame, filled up to whole blocks.

    Light is read on the contact grid, or on the refined one where its cells are too large for the camera.

    Attributes
    ----------
    contact_e : ndarray (rows, cols)
        Mean charge in full contact without feedback [e-].
    charge : ndarray (rows, cols)
        Charge per radiance [e- mm^2 sr/W].
    flank_e : ndarray (rows / flank_step, cols / flank_step)
        Its mean over blocks.
    direct : tuple
        Maps from each pixel to the grid that is read.
    ghost : tuple
        The same after one more round trip between the plate's faces, from the centres of blocks of ``GHOST_STEP``.
    cover : tuple
        Maps from the centres of blocks of ``COVER_STEP`` to the contact grid.
    rise : tuple
        Maps from the centres of blocks of ``BLOCK`` to the feedback's cells.
    refine : int
        Samples a side of one cell of the contact grid, for its coupling.
    halved : bool
        Whether their mean is read.
    samples : tuple of int
        (rows, cols) of the grid that is read.
    first : tuple of float
        Position of its first sample [mm].
    pitch : float
        Of it [mm].
    pixel : ndarray
        See :func:`pixel_kernel`.
    blur : Blur
    decay : ndarray
        Coupling by gap over that of contact.
    coarse : CoarseGrid
    flank_direction : tuple of ndarray
        Undistorted direction (u, v, 1) of the centres of blocks of ``flank_step``.
    flank_step : int
        [px].
    """

    contact_e: Image
    charge: Image
    flank_e: Image
    direct: Maps
    ghost: Maps
    cover: Maps
    rise: Maps
    refine: int
    halved: bool
    samples: tuple[int, int]
    first: tuple[float, float]
    pitch: float
    pixel: Image
    blur: Blur
    decay: Image
    coarse: CoarseGrid
    flank_direction: tuple[Array, Array]
    flank_step: int


def pixel_variance(sub_samples: int) -> float:
    """Return by how much the general chain's sampling widens light along one axis [px^2].

    A pixel of the pinhole view is a box; the frame's sub-samples read it by linear interpolation, whose mean over all
    phases is a triangle.

    Parameters
    ----------
    sub_samples : int
        Of a frame pixel along one axis.
    """
    return 1 / 12 + 1 / 6 + (1 - 1 / sub_samples**2) / 12


def pixel_kernel(samples_per_px: float, sub_samples: int, averaged: int = 1) -> Image:
    """Return what the general chain's sampling does to light on a grid, as a kernel along one axis.

    The remap from the grid interpolates and widens, too, and so did the mean of ``averaged`` samples: by so much the
    kernel is narrower.

    Parameters
    ----------
    samples_per_px : float
        Of the grid.
    sub_samples : int
        Of a frame pixel along one axis.
    averaged : int
        Finer samples in each of the grid's, along one axis.
    """
    pitch = 1.0 / samples_per_px
    spread = pixel_variance(sub_samples)
    left = spread - pitch**2 * (1 / 6 + (1 - 1 / averaged**2) / 12)
    if left <= pitch**2 / 6:
        side = max(left, 0.0) / (2 * pitch**2)
        return np.array([side, 1 - 2 * side, side], np.float32)
    # Shared among samples by a hat, which widens by pitch^2 / 6.
    scale = np.sqrt((left - pitch**2 / 6) / spread)
    fine = 64
    x = np.arange(-3 * fine, 3 * fine + 1) / fine
    box = np.clip((0.5 - np.abs(x)) * fine + 0.5, 0.0, 1.0)
    shape = np.convolve(box, np.clip(1.0 - np.abs(x), 0.0, None), mode="same")
    offsets = (np.arange(sub_samples) + 0.5) / sub_samples - 0.5
    shape = sum(np.interp(x - offset, x, shape) for offset in offsets)
    reach = int(np.ceil(2.0 * scale * samples_per_px)) + 1
    taps = np.arange(-reach, reach + 1) * pitch
    found = np.array([(shape * np.clip(1.0 - np.abs(scale * x - t) / pitch, 0.0, None)).sum() for t in taps])
    return np.asarray(found / found.sum(), np.float32)


def readout_of(scene: Scene) -> Readout:
    """Return the camera of a scene from mean charge to 8 bits, of a colour camera to the balanced mosaic.

    Parameters
    ----------
    scene : Scene
    """
    camera, pixel = scene.camera, scene.camera.pixel
    cols, rows = camera.resolution_px
    share: tuple[float, ...] = ()
    tone: NDArray[Any]
    if camera.colour is None:
        every = np.arange(2**pixel.bits, dtype=np.uint16)
        tone = develop(every, black_level_DN=pixel.black_level_DN, bits=pixel.bits, curve=camera.tone_curve)
    else:
        response, channels = led_response(scene), [CHANNELS.index(letter) for letter in camera.colour.mosaic]
        tone = balance_table(ImageProcessor.of(camera), pixel.black_level_DN, pixel.bits)[channels]
        share = tuple(response[channel] for channel in channels) if response else ()
    return Readout(
        shape=(rows, cols),
        dark_e=pixel.dark_rate_e_per_s * camera.exposure_ms * 1e-3,
        full_well_e=pixel.full_well_capacity_e,
        read_noise_e=pixel.read_noise_e,
        gain=camera.analogue_gain / pixel.conversion_gain_e_per_DN,
        black_DN=pixel.black_level_DN,
        tone=tone,
        share=share,
    )


def charge_per_irradiance(scene: Scene) -> float:
    """Return mean charge over irradiance [e- mm^2/W].

    Parameters
    ----------
    scene : Scene
    """
    camera, pixel = scene.camera, scene.camera.pixel
    photons = photon_count(
        np.ones(1),
        pitch_um=pixel.pitch_um,
        fill_factor=pixel.fill_factor,
        exposure_s=camera.exposure_ms * 1e-3,
        wavelength_nm=camera.wavelength_nm,
    )
    return float(photons[0]) * pixel.quantum_efficiency


def prepare(scene: Scene, grid: PlateGrid) -> Optics:
    """Compute what all frames on one contact grid share.

    Parameters
    ----------
    scene : Scene
    grid : PlateGrid
        Of the contact states.
    """
    fields, projection = fields_of(scene), Projection.of(scene.camera, scene.plate)
    lens = prepared_lens(scene.camera, scene.plate, projection.ideal_view())
    refine, sub_samples = refinement(grid.pitch, 1.0 / scene.camera.scale_px_per_mm), round(np.sqrt(len(lens.maps)))
    # Means of the refined samples are enough where a pixel is wider than what mean and interpolation blur.
    cell_px = grid.pitch * scene.camera.scale_px_per_mm
    halved = refine > 1 and pixel_variance(sub_samples) >= cell_px**2 * (1 / 6 + (1 - 1 / refine**2) / 12)
    read = 1 if halved else refine
    pitch, samples = grid.pitch / read, (grid.shape[0] * read, grid.shape[1] * read)
    first = (float(grid.extent[0]) + pitch / 2, float(grid.extent[2]) + pitch / 2)

    rows, cols = projection.shape
    high, wide = (-(-n // BLOCK) * BLOCK for n in (rows, cols))
    cx, cy = projection.principal_point
    u, v = np.meshgrid((np.arange(wide) - cx) / projection.focal_px, (np.arange(high) - cy) / projection.focal_px)
    direction = projection.undistort(u, v)
    direct, ghost = plate_maps(scene, direction, first, pitch)
    # The gain is per sub-sample.
    charge = lens.gain * (charge_per_irradiance(scene) * len(lens.maps))
    padded = np.pad(charge, ((0, high - rows), (0, wide - cols)), mode="edge").astype(np.float32)
    coarse = CoarseGrid.of(fields, grid)
    step = min(flank_step(scene.camera.scale_px_per_mm), BLOCK)

    def onto(coarser: tuple[float, float], step: int) -> Maps:
        # On a grid whose samples are ``coarser`` times as large along x and y, from the centres of blocks.
        return (
            (block_means(direct[0], step) + np.float32(0.5)) / np.float32(coarser[0]) - np.float32(0.5),
            (block_means(direct[1], step) + np.float32(0.5)) / np.float32(coarser[1]) - np.float32(0.5),
        )

    return Optics(
        contact_e=_contact_charge(fields, direct, first, pitch, padded),
        charge=padded,
        flank_e=block_means(padded, step),
        direct=direct,
        ghost=(block_means(ghost[0], GHOST_STEP), block_means(ghost[1], GHOST_STEP)),
        cover=onto((read, read), COVER_STEP),
        rise=onto((samples[1] / coarse.shape[1], samples[0] / coarse.shape[0]), BLOCK),
        refine=refine,
        halved=halved,
        samples=samples,
        first=first,
        pitch=pitch,
        pixel=pixel_kernel(1.0 / (scene.camera.scale_px_per_mm * pitch), sub_samples, refine // read),
        blur=_blur_of(lens.spread),
        decay=_decay(fields),
        coarse=coarse,
        flank_direction=(
            block_means(direction[0], step).astype(float),
            block_means(direction[1], step).astype(float),
        ),
        flank_step=step,
    )


def retuned(optics: Optics, scene: Scene, grid: PlateGrid, *, relit: bool, refocused: bool) -> Optics:
    """Return what :func:`prepare` would for a scene of other LED powers or another focus, the maps kept.

    Parameters
    ----------
    optics : Optics
        Of a scene that differs in nothing else that they depend on.
    scene : Scene
    grid : PlateGrid
        The one that ``optics`` are of.
    relit, refocused : bool
        What has changed.
    """
    if relit:
        fields = fields_of(scene)
        contact = _contact_charge(fields, optics.direct, optics.first, optics.pitch, optics.charge)
        optics = replace(optics, contact_e=contact, decay=_decay(fields), coarse=CoarseGrid.of(fields, grid))
    if refocused:
        optics = replace(optics, blur=_blur_of(lens_blur(scene.camera, scene.plate)))
    return optics


def _contact_charge(fields: Fields, direct: Maps, first: tuple[float, float], pitch: float, charge: Image) -> Image:
    """Return :attr:`Optics.contact_e`."""
    contact = np.tensordot(fields.coupling[:, 0] * fields.response[0], fields.modes, 1)
    # A block is a few hundredths of what the field's nodes are apart: linear between the blocks' centres will do.
    x, y = (block_means(m, BLOCK).astype(float) * pitch + p0 for m, p0 in zip(direct, first, strict=True))
    return spread_blocks(field_image(fields, contact, x, y), BLOCK) * charge


def _decay(fields: Fields) -> Image:
    """Return :attr:`Optics.decay`."""
    middle = np.tensordot(fields.coupling * fields.response, fields.modes.mean(axis=(1, 2)), (0, 0))
    return np.asarray(middle / middle[0], np.float32)


def _blur_of(spread: FieldBlur | None) -> Blur:
    return Blur(np.ones((1, 1), np.float32) if spread is None else np.asarray(spread.kernels[0], np.float32))
