"""What a photographed checkerboard should look like: print, light and lens, with the library's effects along the way.

Everything is in the frame's own pixels (or whole bins of them). The share of bright print is drawn once, sharp, from
the fitted geometry; blur and light then cost milliseconds. Fields of light come from the effects' own code.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from evanesce.core.errors import WorkError
from evanesce.core.states import PlateLight, SensorLight
from evanesce.effects import Context, all_effects
from evanesce.effects.lens.defocus import discrete_gaussian
from evanesce.effects.readout.tone_curve import departed
from evanesce.evaluation.board_geometry import FittedRig, bright_even, fit_rig
from evanesce.evaluation.board_light import BLOCK, block_mask, held_out_block, smooth_field
from evanesce.measurement.calibration.corners import CornerGrid, find_corners, grey
from evanesce.measurement.calibration.points import BoardView
from evanesce.optics.projection import Projection
from evanesce.render.fast.defects import contact_radiance
from evanesce.rig import Camera, Scene
from evanesce.sensor.lens import form_image, prepared_lens
from evanesce.sensor.tone import CURVES, Curve

Array = NDArray[np.float64]
Values = Mapping[str, float]

WORKING_COLS = 512
"""A wider frame is averaged over whole bins down to about this: four numbers in a bin tell little more than one."""

MIN_CORNERS = 60
INK_STEP_MM = 0.01
SIDES = ("left", "right", "top", "bottom")
COSINES = tuple((i, j) for i in range(4) for j in range(4) if 0 < i + j <= 3)


@dataclass(frozen=True)
class Photograph:
    """A photographed board, and what is believed of it.

    Attributes
    ----------
    full : ndarray (full rows, full cols)
        The picture as it came [DN].
    data : ndarray (rows, cols)
        The same, averaged over bins [DN].
    bin_px : int
        Side of a bin.
    grid : CornerGrid
        Corners of the full picture.
    rig : FittedRig
        Camera and print, fitted to the corners of open blocks.
    scene : Scene
        With the fitted camera, its pixels as large as a bin.
    curve : str
        Tone curve believed.
    share : ndarray (rows, cols)
        Of bright print in each bin, by a lens without blur.
    share_slopes : dict of str to ndarray
        Its derivatives by the ink's reach and by each parameter that moves the geometry.
    gain : ndarray (rows, cols)
        The believed lens's light, 1 where most [1].
    block : ndarray of int (rows, cols)
        Number of the block of two by two squares; -1: none.
    locked : ndarray of bool (rows, cols)
    corner_error_px : float
        Robust deviation, per axis, of a corner from where the others put it [bins].
    """

    full: Array
    data: Array
    bin_px: int
    grid: CornerGrid
    rig: FittedRig
    scene: Scene
    curve: Curve
    share: Array
    share_slopes: dict[str, Array]
    gain: Array
    block: NDArray[np.int64]
    locked: NDArray[np.bool_]
    corner_error_px: float

    @property
    def opened(self) -> NDArray[np.bool_]:
        """Bins that may be fitted."""
        return (self.block >= 0) & ~self.locked

    @property
    def context(self) -> Context:
        """For effects."""
        return Context(self.scene, seed=0)


def read_photograph(picture: NDArray[np.uint8], base: Scene, curve: Curve) -> Photograph:
    """Find the board, fit its geometry on alternate blocks, and draw the print.

    Parameters
    ----------
    picture : ndarray of uint8 (rows, cols) or (rows, cols, 3)
    base : Scene
        Plate, focal length and readout that are believed.
    curve : str

    Raises
    ------
    WorkError
        If there is no board, or too little of it.
    """
    grid = find_corners(picture)
    if len(grid) < MIN_CORNERS:
        raise WorkError(f"{len(grid)} corners found, half of which would be fitted (needed: {MIN_CORNERS})")
    return prepare(grey(picture), grid, base, curve)


def prepare(full: Array, grid: CornerGrid, base: Scene, curve: Curve) -> Photograph:
    """Return the photograph with its geometry, from corners that have been found."""
    size = (full.shape[1], full.shape[0])
    fitted = ~held_out_block(grid.index)
    half = BoardView("open blocks", grid.index[fitted].astype(np.float64), grid.fit.position[fitted])
    camera = base.camera.model_copy(update={"tone_curve": curve})
    rig = fit_rig(half, size, camera, base.plate, even_is_bright=bright_even(grid))
    miss = grid.fit.position - rig.predict(base.plate, grid.index.astype(np.float64))
    bend, error = _bend(grid, miss, fitted, full.shape)
    n = max(1, round(size[0] / WORKING_COLS))
    binned = _coarse_camera(rig.camera, n)
    scene = base.model_copy(update={"camera": binned, "effects": {}})
    share, slopes = _print(rig, base, full.shape, bend, n, scene)
    block, locked = _blocks(grid, full.shape, n)
    projection = Projection.of(binned, base.plate)
    gain = prepared_lens(binned, base.plate, projection.ideal_view()).gain
    return Photograph(
        full,
        binned_mean(full, n),
        n,
        grid,
        rig,
        scene,
        curve,
        share,
        slopes,
        gain / gain.max(),
        block,
        locked,
        error / n,
    )


def binned_mean(image: Array, n: int) -> Array:
    """Return means over bins of n by n pixels; what is over at right and bottom is left out."""
    rows, cols = image.shape[0] // n, image.shape[1] // n
    return np.asarray(image[: rows * n, : cols * n].reshape(rows, n, cols, n).mean(axis=(1, 3)))


def _coarse_camera(camera: Camera, n: int) -> Camera:
    cols, rows = camera.resolution_px
    kept = (cols // n, rows // n)
    dx, dy = camera.principal_point_offset_px
    # rows and columns that do not fill a bin are cut off at right and bottom: the frame's middle moves
    offset = ((dx + (cols - kept[0] * n) / 2) / n, (dy + (rows - kept[1] * n) / 2) / n)
    pixel = camera.pixel.model_copy(update={"pitch_um": camera.pixel.pitch_um * n})
    return camera.model_copy(
        update={
            "resolution_px": kept,
            "scale_px_per_mm": camera.scale_px_per_mm / n,
            "principal_point_offset_px": offset,
            "pixel": pixel,
        }
    )


def _bend(grid: CornerGrid, miss: Array, fitted: NDArray[np.bool_], shape: Any) -> tuple[tuple[Array, Array], float]:
    """Return the smooth displacement that the fitted lens leaves [px], and the deviation of corners from it."""
    at = grid.fit.position
    field_x, field_y = (smooth_field(at[fitted], miss[fitted, k], shape) for k in (0, 1))
    halves = fitted & ((grid.index // (2 * BLOCK)).sum(axis=1) % 2 == 0)
    others = fitted & ~halves
    left: list[Array] = []
    for k in (0, 1):
        part = smooth_field(at[halves], miss[halves, k], shape)
        left.append(miss[others, k] - ndimage.map_coordinates(part, at[others].T[::-1], order=1, mode="nearest"))
    return (field_x, field_y), float(1.4826 * np.median(np.abs(np.concatenate(left))))


def _print(
    rig: FittedRig, base: Scene, shape: Any, bend: tuple[Array, Array], n: int, scene: Scene
) -> tuple[Array, dict[str, Array]]:
    """Return the bins' share of bright print and its slopes by ink and by the effects that move the geometry."""
    v, u = np.indices(shape, dtype=np.float64)
    seen_u, seen_v = u - bend[0], v - bend[1]

    def drawn(camera: Camera, ink_mm: float = 0.0) -> Array:
        x, y = Projection.of(camera, base.plate).to_plate(seen_u, seen_v)
        board = replace(rig.board, ink_mm=ink_mm)
        return binned_mean(board.bright_share(x, y, 1.0 / camera.scale_px_per_mm), n)

    sharp = drawn(rig.camera)
    slopes = {"print.ink_mm": (drawn(rig.camera, INK_STEP_MM) - sharp) / INK_STEP_MM}
    tilt, whole = all_effects()["plate_tilt"], base.model_copy(update={"camera": rig.camera, "effects": {}})
    for name in tilt.amplitudes:
        turned = tilt.apply(whole, tilt.with_values({name: 0.1}), Context(whole, seed=0)).camera
        slopes[f"plate_tilt.{name}"] = (drawn(turned) - sharp) / 0.1
    drift, step = all_effects()["distortion_drift"], {"k1": 0.01, "k2": 0.01, "centre_x_um": 10.0, "centre_y_um": 10.0}
    for name, size in step.items():
        moved = drift.apply(SensorLight(irradiance=sharp), drift.with_values({name: size}), Context(scene, seed=0))
        slopes[f"distortion_drift.{name}"] = (moved.irradiance - sharp) / size
    return sharp, slopes


def _blocks(grid: CornerGrid, shape: Any, n: int) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Return each bin's block and whether that is locked; a bin counts only if it lies in one block wholly."""
    number = np.full(grid.index.max(axis=0) + 1, -1)
    number[tuple(grid.index.T)] = np.arange(len(grid))
    corners = np.stack([number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]], axis=-1)
    cells = np.argwhere((corners >= 0).all(axis=-1))
    blocks = cells // BLOCK
    names = blocks[:, 0] * (blocks[:, 1].max() + 1) + blocks[:, 1]
    drawn = np.full(shape, -1, dtype=np.int32)
    outlines = np.rint(grid.fit.position[corners[tuple(cells.T)]] * 16).astype(np.int32)
    for outline, name in zip(outlines, names, strict=True):
        cv2.fillConvexPoly(drawn, outline, int(name), shift=4)
    locked, opened = (block_mask(grid, shape, held_out=judged) for judged in (True, False))
    rows, cols = shape[0] // n, shape[1] // n
    tiles = drawn[: rows * n, : cols * n].reshape(rows, n, cols, n)
    whole = tiles.min(axis=(1, 3)) == tiles.max(axis=(1, 3))
    all_locked = binned_mean(locked.astype(np.float64), n) == 1.0
    counted = whole & (all_locked | (binned_mean(opened.astype(np.float64), n) == 1.0))
    return np.where(counted, tiles[:, 0, :, 0], -1).astype(np.int64), all_locked


@dataclass
class LightModel:
    """Grey values of a photograph by named numbers; fields that do not change are kept.

    Names are ``<effect>.<parameter>``; what is left out is absent. Nuisances: ``light.bright``, ``light.dark``
    (relative light of the print, 1 = full scale), ``lens.blur_px`` (standard deviation, bins) and ``print.ink_mm``.
    """

    photograph: Photograph
    _kept: dict[Any, Array] = field(default_factory=dict, repr=False)

    def __call__(self, values: Values) -> Array:
        """Return the mean grey value of each bin (rows, cols) [DN]."""
        one, pixel = self.photograph, self.photograph.scene.camera.pixel
        light = self.linear(values)
        light = light + values.get("black_level.offset_DN", 0.0) / (2**pixel.bits - 1 - pixel.black_level_DN)
        value = CURVES[one.curve](np.clip(light, 0.0, 1.0))
        gamma, contrast = values.get("tone_curve.gamma", 0.0), values.get("tone_curve.contrast", 0.0)
        return np.asarray(255.0 * (departed(value, gamma, contrast) if gamma or contrast else value))

    def linear(self, values: Values) -> Array:
        """Return the relative light of each bin (rows, cols)."""
        bright, dark = values["light.bright"], values["light.dark"]
        print_light = dark + (bright - dark) * self.share(values) + bright * self.veil(values)
        return np.asarray(print_light * self.photograph.gain * self.shading(values))

    def share(self, values: Values) -> Array:
        """Return the blurred share of bright print."""
        slopes = {name: values.get(name, 0.0) for name in self.photograph.share_slopes}
        corner = values.get("defocus.corner_blur_um", 0.0)
        key = ("share", *slopes.values(), values["lens.blur_px"], corner)
        if key not in self._kept:
            sharp = self.photograph.share + sum(
                v * self.photograph.share_slopes[k] for k, v in slopes.items() if v != 0.0
            )
            self._keep(key, self.spread(sharp, values))
        return self._kept[key]

    def spread(self, image: Array, values: Values) -> Array:
        """Blur evenly as believed, then by the effect's own further blur."""
        kernel = discrete_gaussian(values["lens.blur_px"] ** 2)
        even = cv2.sepFilter2D(image, cv2.CV_64F, kernel, kernel, borderType=cv2.BORDER_REPLICATE)
        corner = values.get("defocus.corner_blur_um", 0.0)
        if corner == 0.0:
            return np.asarray(even)
        effect = all_effects()["defocus"]
        parameters = effect.with_values({"corner_blur_um": corner})
        return np.asarray(effect.apply(SensorLight(irradiance=even), parameters, self.photograph.context).irradiance)

    def veil(self, values: Values) -> Array:
        """Return light added on the plate over that of bright print."""
        total: Any = 0.0
        for axis in "xy":
            if values.get(f"ambient_light.{axis}"):
                total = total + values[f"ambient_light.{axis}"] * self._ambient(axis)
        for side in SIDES:
            if values.get(f"led_edge_reflections.{side}"):
                decay = values["led_edge_reflections.decay_mm"]
                total = total + values[f"led_edge_reflections.{side}"] * self._edge(side, decay)
        if values.get("residue_film.relative_radiance"):
            total = total + values["residue_film.relative_radiance"] * self._film(values)
        return np.asarray(total)

    def shading(self, values: Values) -> Array:
        """Return what multiplies the light: the vignetting effect's share and the flexible field."""
        shape = self.photograph.data.shape
        total = np.ones(shape)
        if values.get("vignetting.k"):
            effect = all_effects()["vignetting"]
            table = {
                "k": values["vignetting.k"],
                "centre_offset_px[0]": values["vignetting.centre_x_px"],
                "centre_offset_px[1]": values["vignetting.centre_y_px"],
            }
            total = effect.apply(
                SensorLight(irradiance=total), effect.with_values(table), self.photograph.context
            ).irradiance
        bases = [(f"uneven_light.c{i}{j}", i, j) for i, j in COSINES]
        if any(values.get(name) for name, _, _ in bases):
            rows, cols = shape
            y, x = ((np.arange(k) + 0.5) * np.pi / k for k in (rows, cols))
            log_gain = sum(values.get(name, 0.0) * np.cos(j * y)[:, None] * np.cos(i * x)[None] for name, i, j in bases)
            total = total * np.exp(log_gain)
        return np.asarray(total)

    def plate_field(self, effect_id: str, table: dict[str, Any]) -> Array:
        """Return what an effect adds on the plate, as the frame sees it without blur and without the lens's gain."""
        one, effect = self.photograph, all_effects()[effect_id]
        view = Projection.of(one.scene.camera, one.scene.plate).ideal_view()
        zero = np.zeros(view.shape)
        dark = PlateLight(radiance=zero, variance=zero, focal_px=view.focal_px, principal_point=view.principal_point)
        lit = effect.apply(dark, effect.parameters(**table), one.context)
        seen = form_image(lit, one.scene.camera, one.scene.plate, blurred=False).irradiance
        flat = form_image(replace(dark, radiance=zero + 1.0), one.scene.camera, one.scene.plate, blurred=False)
        return np.asarray(seen / flat.irradiance)

    def contact(self) -> float:
        """Return the radiance of a contact in the frame's middle, which effects on the plate are given relative to."""
        scene = self.photograph.scene
        return float(contact_radiance(scene, *(np.array(c) for c in scene.camera.centre_mm)))

    def _ambient(self, axis: str) -> Array:
        """Return what the effect's gradient adds to its even part, which cannot be told from dark print."""
        key = ("ambient", axis)
        if key not in self._kept:
            gradient = (0.5, 0.0) if axis == "x" else (0.0, 0.5)
            whole = self.plate_field("ambient_light", {"radiance_W_per_mm2_sr": 1.0, "gradient": gradient})
            self._kept[key] = (whole - 1.0) / 0.5
        return self._kept[key]

    def _edge(self, side: str, decay: float) -> Array:
        key = ("edge", side, decay)
        if key not in self._kept:
            sides = tuple(float(side == s) for s in SIDES)
            table = {"relative_radiance": 1.0, "decay_mm": decay, "sides": sides}
            self._keep(key, self.plate_field("led_edge_reflections", table) / self.contact())
        return self._kept[key]

    def _film(self, values: Values) -> Array:
        x, y, radius = (values[f"residue_film.{name}"] for name in ("middle_x_mm", "middle_y_mm", "radius_mm"))
        key = ("film", x, y, radius)
        if key not in self._kept:
            table = {"relative_radiance": 1.0, "middle_mm": (x, y), "radius_mm": radius}
            self._keep(key, self.plate_field("residue_film", table) / self.contact())
        return self._kept[key]

    def _keep(self, key: Any, value: Array) -> None:
        if len(self._kept) > 80:
            for old in list(self._kept)[:40]:
                del self._kept[old]
        self._kept[key] = value
