"""The truth of a frame in its own pixels: what a measurement should find."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from evanesce.core.states import ContactState
from evanesce.evaluation.labels import FrameLabels, RectifiedView, ViewGeometry, label, view_geometry
from evanesce.measurement.calibration.model import Calibration
from evanesce.measurement.calibration.rectify import rectification
from evanesce.optics.projection import Projection
from evanesce.rig import Scene
from evanesce.rig.camera import Camera
from evanesce.rig.plate import Plate

CACHED_GEOMETRIES = 2
"""Number of views whose pixel positions on the plate are cached; one of 2000 x 1500 pixels takes 72 MB."""


@dataclass(frozen=True, kw_only=True, repr=False)
class Truth:
    """The contact carried into the pixels of the frame; nothing is computed before it is asked for.

    Attributes
    ----------
    scene : Scene
        The rig as it was.
    state : ContactState or None
        None without contact.

    Examples
    --------
    >>> import evanesce as ev
    >>> shot = ev.Camera(ev.coarser(ev.load("thesis"), 4)).shoot(force_N=2.0, seed=1)
    >>> truth = shot.truth
    >>> truth.mask.shape, truth.mask.dtype
    ((375, 500), dtype('bool'))
    >>> round(truth.area_mm2, 1), round(float((truth.coverage * truth.pixel_area_mm2).sum()), 1)
    (18.8, 18.8)
    """

    scene: Scene
    state: ContactState | None

    def __repr__(self) -> str:
        return f"Truth(area_mm2={self.area_mm2:.4g})"

    @property
    def area_mm2(self) -> float:
        """Nominal contact area [mm^2], exact, also of what lies outside the frame; 0 without contact."""
        return 0.0 if self.state is None else self.state.nominal_contact_area

    @property
    def coverage(self) -> NDArray[np.float32]:
        """Share of each pixel in contact, 0 to 1, (rows, cols)."""
        return self._labels.mask

    @property
    def mask(self) -> NDArray[np.bool_]:
        """Pixels at least half in contact, (rows, cols)."""
        return self._labels.mask >= 0.5

    @property
    def pressure_MPa(self) -> NDArray[np.float32]:
        """Mean normal pressure over each pixel, (rows, cols) [MPa]."""
        return self._labels.pressure

    @property
    def gap_mm(self) -> NDArray[np.float32]:
        """Mean gap between silicone and glass over each pixel, (rows, cols) [mm]; NaN beyond the contact's grid."""
        return self._labels.gap

    @property
    def surface_state(self) -> NDArray[np.uint8] | None:
        """State at each pixel's centre, (rows, cols): 0 none, 1 near, 2 stick, 3 slip; None where nothing slides."""
        return self._labels.surface_state

    @property
    def pixel_area_mm2(self) -> NDArray[np.float64]:
        """Area of the contact plane that each pixel sees, (rows, cols) [mm^2]."""
        return self._labels.pixel_area

    def through(self, calibration: Calibration | None) -> FrameLabels:
        """Return the truth in the view that a calibration makes of the frame.

        Parameters
        ----------
        calibration : Calibration or None
            Whose undistortion and cut to valid pixels the frame goes through; None: the frame itself.

        Returns
        -------
        FrameLabels
        """
        return self._labels if calibration is None else label(self.state, self._geometry(calibration))

    @cached_property
    def _labels(self) -> FrameLabels:
        return label(self.state, self._geometry(None))

    def _geometry(self, calibration: Calibration | None) -> ViewGeometry:
        key = None
        if calibration is not None:
            numbers = np.concatenate([calibration.camera_matrix.ravel(), calibration.distortion])
            key = calibration.image_size, tuple(numbers.tolist())
        camera, plate = self.scene.camera, self.scene.plate
        return _geometry(camera.model_dump_json(), plate.model_dump_json(), key)


@lru_cache(maxsize=CACHED_GEOMETRIES)
def _geometry(camera: str, plate: str, calibration: tuple[tuple[int, int], tuple[float, ...]] | None) -> ViewGeometry:
    """Return the plate positions of the pixels of a view; takes a second for millions of them."""
    projection = Projection.of(Camera.model_validate_json(camera), Plate.model_validate_json(plate))
    if calibration is None:
        return view_geometry(projection)
    size, numbers = calibration
    stored = Calibration(
        image_size=size, camera_matrix=np.reshape(numbers[:9], (3, 3)), distortion=np.array(numbers[9:])
    )
    return view_geometry(projection, rectified_view(stored))


def rectified_view(calibration: Calibration) -> RectifiedView:
    """Return the view of a calibration as the truth is carried through it."""
    rectified = rectification(calibration)
    return RectifiedView(
        camera_matrix=calibration.camera_matrix,
        distortion=calibration.distortion,
        camera_matrix_new=rectified.camera_matrix_new,
        shape=rectified.shape,
    )
