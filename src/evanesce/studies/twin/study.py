"""The simulated twin of a photographed checkerboard: same board, rig, lens and light through the simulation's chain.

Everything is fitted on alternate blocks of two by two squares and evaluated on the others, which are held out: geometry
on the corners, light on the squares' middles, blur and ink on the grey values.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from evanesce.chain.simulate import expose
from evanesce.core.errors import WorkError
from evanesce.core.states import PlateLight
from evanesce.evaluation.board_geometry import FittedRig, PrintedBoard, bright_even, fit_rig
from evanesce.evaluation.board_light import block_mask, held_out_block, smooth_field, squares
from evanesce.measurement.calibration.corners import CornerGrid, find_corners, grey
from evanesce.measurement.calibration.points import BoardView
from evanesce.measurement.calibration.saddle import SaddleFit, fit_saddles
from evanesce.optics.projection import Projection
from evanesce.optics.seen import under_lamp
from evanesce.rig import Scene
from evanesce.sensor.expose import charge_of
from evanesce.sensor.lens import form_image
from evanesce.sensor.tone import CURVES, Curve

Array = NDArray[np.float64]

LIGHT_ROUNDS = 2
MIN_CORNERS = 60
_ROBUST_DN = 6.0


@dataclass(frozen=True)
class Light:
    """Relative light (1 = full scale of the raw numbers) of bright and of dark print, over the frame.

    Attributes
    ----------
    bright, dark : ndarray (rows, cols)
    """

    bright: Array
    dark: Array


@dataclass(frozen=True)
class Twin:
    """A photograph and its simulation.

    Attributes
    ----------
    photo : ndarray (rows, cols)
        Grey values of the photograph [DN].
    simulated : ndarray of uint8 (rows, cols)
        The twin, noise included [DN].
    mean : ndarray (rows, cols)
        The twin without noise and without rounding to whole numbers [DN].
    grid : CornerGrid
        Corners found in the photograph.
    own : SaddleFit
        The same corners fitted in the twin.
    rig : FittedRig
    scene : Scene
        The whole fitted rig, to simulate with.
    light : Light
    held_out : ndarray of bool (rows, cols)
        Pixels of the blocks that no fit has seen.
    fitted : ndarray of bool (rows, cols)
        Pixels of the blocks that were fitted.
    """

    photo: Array
    simulated: NDArray[np.uint8]
    mean: Array
    grid: CornerGrid
    own: SaddleFit
    rig: FittedRig
    scene: Scene
    light: Light
    held_out: NDArray[np.bool_]
    fitted: NDArray[np.bool_]

    @property
    def corners_held_out(self) -> NDArray[np.bool_]:
        """Which corners no fit has seen."""
        return held_out_block(self.grid.index)

    @property
    def corner_miss(self) -> Array:
        """Corner found minus corner predicted by the fitted rig, (n, 2) [px]."""
        return self.grid.fit.position - self.rig.predict(self.scene.plate, self.grid.index.astype(np.float64))


class _Studio:
    """The simulation's chain for one geometry: board and light in, grey values out."""

    def __init__(self, scene: Scene, rig: FittedRig) -> None:
        self.scene = scene.model_copy(update={"camera": rig.camera})
        projection = Projection.of(rig.camera, scene.plate)
        self.view = projection.ideal_view()
        cols, rows = np.arange(self.view.shape[1]), np.arange(self.view.shape[0])
        cx, cy = self.view.principal_point
        x, y = np.meshgrid((cols - cx) / self.view.focal_px, (rows - cy) / self.view.focal_px)
        self.plate_x, self.plate_y = projection.ray_to_plate(x, y)
        self.footprint_mm = 1.0 / rig.camera.scale_px_per_mm
        u, v = projection.distort(x, y)
        # where each pixel of the ideal view lands in the frame; far outside it the radial model may fold back
        fx, fy = projection.principal_point
        self.frame_x = (u * projection.focal_px + fx).astype(np.float32)
        self.frame_y = (v * projection.focal_px + fy).astype(np.float32)
        self.response = self._response()

    def _plate_light(self, radiance: Array) -> PlateLight:
        return PlateLight(
            radiance=radiance,
            variance=np.zeros_like(radiance),
            focal_px=self.view.focal_px,
            principal_point=self.view.principal_point,
        )

    def _response(self) -> Array:
        """Return relative light per radiance of each pixel, from a uniform field through the lens."""
        flat = form_image(self._plate_light(np.ones(self.view.shape)), self.scene.camera, self.scene.plate)
        return self._relative(charge_of(flat, self.scene.camera))

    def _relative(self, charge_e: Array) -> Array:
        pixel = self.scene.camera.pixel
        full = (2**pixel.bits - 1 - pixel.black_level_DN) * pixel.conversion_gain_e_per_DN
        return np.asarray(charge_e * self.scene.camera.analogue_gain / full)

    def radiance(self, light: Light, board: PrintedBoard) -> PlateLight:
        """Return the board's radiance under a light that is given where it arrives in the frame."""
        bright, dark = (
            cv2.remap(f / self.response, self.frame_x, self.frame_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
            for f in (light.bright, light.dark)
        )
        share = board.bright_share(self.plate_x, self.plate_y, self.footprint_mm)
        return self._plate_light(dark + (bright - dark) * share)

    def relative_light(self, light: Light, rig: FittedRig) -> Array:
        """Return the noise-free relative light of the frame."""
        sensor = form_image(self.radiance(light, rig.board), rig.camera, self.scene.plate)
        return self._relative(charge_of(sensor, rig.camera))


def make_twin(picture: NDArray[np.uint8], base: Scene, *, seed: int, curve: Curve = "libcamera") -> Twin:
    """Fit the simulation to a photograph of a checkerboard with squares of 1 mm, and simulate it.

    Parameters
    ----------
    picture : ndarray of uint8 (rows, cols) or (rows, cols, 3)
    base : Scene
        Plate, focal length and readout to keep; its camera is fitted.
    seed : int
        Of the sensor's noise.
    curve : str
        Tone curve assumed of the photograph.

    Returns
    -------
    Twin

    Raises
    ------
    WorkError
        If there is no board, or too little of it.
    """
    photo = grey(picture)
    grid = find_corners(picture)
    if len(grid) < MIN_CORNERS:
        raise WorkError(f"{len(grid)} corners found, half of which would be fitted (needed: {MIN_CORNERS})")
    size = (photo.shape[1], photo.shape[0])
    fit_half = ~held_out_block(grid.index)
    known = BoardView("photograph", grid.index.astype(np.float64), grid.fit.position)  # numbered as the grid is
    even = bright_even(grid)
    half = BoardView("half", known.world[fit_half], known.image[fit_half])
    camera = base.camera.model_copy(update={"tone_curve": curve})
    rig = fit_rig(half, size, camera, base.plate, even_is_bright=even)

    studio = _Studio(base, rig)
    linear = _undo(photo, curve)
    light = _first_light(linear, grid, even)
    fitted = block_mask(grid, photo.shape, held_out=False)
    for _ in range(LIGHT_ROUNDS):
        rig = _fit_blur(studio, light, rig, photo, fitted, curve)
        light = _corrected(light, linear, studio.relative_light(light, rig), grid, even)

    scene = base.model_copy(
        update={
            "camera": rig.camera,
            "title": "Twin of a photographed checkerboard",
            "sources": {},
            "assumptions": {},
        }
    )
    _, frame = expose(under_lamp(scene), studio.radiance(light, rig.board), seed=seed)
    mean = 255.0 * CURVES[curve](np.clip(studio.relative_light(light, rig), 0.0, 1.0))
    own = fit_saddles(frame.data.astype(np.float64), grid.fit.position, grid.lattice)
    held_out = block_mask(grid, photo.shape, held_out=True)
    return Twin(photo, frame.data, mean, grid, own, rig, scene, light, held_out, fitted)


def _undo(photo: Array, curve: Curve) -> Array:
    """Return the relative light of grey values that need not be whole numbers."""
    light = np.linspace(0.0, 1.0, 65536)
    return np.interp(photo / 255.0, CURVES[curve](light), light)


def _first_light(linear: Array, grid: CornerGrid, even: bool) -> Light:
    seen = squares(linear, grid, even)
    use = ~seen.held_out
    fields = [
        smooth_field(seen.centre[use & (seen.bright == b)], seen.value[use & (seen.bright == b)], linear.shape)
        for b in (True, False)
    ]
    return Light(bright=fields[0], dark=np.minimum(fields[1], fields[0]))


def _corrected(light: Light, linear: Array, simulated: Array, grid: CornerGrid, even: bool) -> Light:
    """Take out what blur did to the squares' middles: compare photograph and twin there and move both fields."""
    real, own = squares(linear, grid, even), squares(simulated, grid, even)
    use = ~real.held_out
    fields = []
    for b, field in ((True, light.bright), (False, light.dark)):
        some = use & (real.bright == b)
        fields.append(field + smooth_field(real.centre[some], (real.value - own.value)[some], linear.shape))
    bright = np.maximum(fields[0], 1e-4)
    return Light(bright=bright, dark=np.clip(fields[1], 1e-5, bright))


def _fit_blur(
    studio: _Studio, light: Light, rig: FittedRig, photo: Array, fitted: NDArray[np.bool_], curve: Curve
) -> FittedRig:
    """Fit defocus on the axis, its growth to the corner and the spread of the ink to the fitted blocks' grey values."""
    camera = rig.camera
    disc_um = camera.pixel.pitch_um * camera.lens.f_number  # defocus that spreads a point over one pixel

    def tried(theta: Array) -> FittedRig:
        lens = camera.lens.model_copy(
            update={"defocus_um": float(theta[0]) * disc_um, "field_curvature_um": float(theta[1]) * disc_um}
        )
        board = replace(rig.board, ink_mm=float(theta[2]) * studio.footprint_mm)
        return FittedRig(camera.model_copy(update={"lens": lens}), board)

    def miss(theta: Array) -> Array:
        simulated = 255.0 * CURVES[curve](np.clip(studio.relative_light(light, tried(theta)), 0.0, 1.0))
        return np.asarray((simulated - photo)[fitted])

    start = np.array([camera.lens.defocus_um / disc_um, camera.lens.field_curvature_um / disc_um, 0.0])
    start[2] = rig.board.ink_mm / studio.footprint_mm
    if not start.any():
        start = np.array([2.0, 8.0, 0.2])
    solved = least_squares(
        miss,
        start,
        diff_step=[0.1, 0.1, 0.1],
        bounds=([-40.0, 0.0, -5.0], [40.0, 60.0, 5.0]),
        loss="soft_l1",
        f_scale=_ROBUST_DN,
        max_nfev=8,
        ftol=1e-4,
    )
    return tried(solved.x)
