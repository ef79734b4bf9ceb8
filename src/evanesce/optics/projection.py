"""Where a plate point appears in the image: pinhole, flat glass port, lens distortion.

The one geometry that the renderer, the sensor and the truth share. The pinhole looks up through the plate's bottom face
(z = -t) at the contact plane (z = 0); refraction there follows Snell's law exactly, so that the glass adds its own
radial term to the lens's.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from evanesce.rig import Camera, Plate

Array = NDArray[np.float64]


def rotation(tilt_x: float, tilt_y: float, roll: float) -> Array:
    """Return the matrix whose columns are the camera's axes in plate coordinates: Rz(roll) Ry(tilt_y) Rx(tilt_x).

    Parameters
    ----------
    tilt_x, tilt_y, roll : float
        [rad].
    """
    cx, sx, cy, sy, cz, sz = (f(a) for a in (tilt_x, tilt_y, roll) for f in (np.cos, np.sin))
    about_x = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    about_y = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    about_z = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
    return about_z @ about_y @ about_x


def distort(x: ArrayLike, y: ArrayLike, coefficients: tuple[float, float, float, float, float]) -> tuple[Array, Array]:
    """Apply OpenCV's radial-tangential distortion (k1, k2, p1, p2, k3) to normalised coordinates (any shape).

    Parameters
    ----------
    x, y : array_like
        Normalised coordinates (x, y, 1) before distortion [1].
    coefficients : tuple of float
        k1, k2, p1, p2, k3 [1].

    Returns
    -------
    x, y : ndarray
        Distorted [1].

    References
    ----------
    Brown, "Decentering distortion of lenses", Photogrammetric Engineering 32 (1966) 444.
    """
    x, y = np.asarray(x, float), np.asarray(y, float)
    k1, k2, p1, p2, k3 = coefficients
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    return (
        x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
        y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y,
    )


@dataclass(frozen=True)
class IdealView:
    """Pixel grid of a distortion-free pinhole that covers all that the distorted frame sees.

    Attributes
    ----------
    shape : tuple of int
        (rows, cols).
    focal_px : float
        [px].
    principal_point : tuple of float
        (x, y) [px], integer = pixel centre.
    """

    shape: tuple[int, int]
    focal_px: float
    principal_point: tuple[float, float]

    def finer(self, times: int) -> IdealView:
        """Return the grid with so many times as many pixels along each side."""
        (rows, cols), middle = self.shape, (times - 1) / 2
        px, py = (p * times + middle for p in self.principal_point)
        return IdealView((rows * times, cols * times), self.focal_px * times, (px, py))


@dataclass(frozen=True)
class Projection:
    """Camera geometry of a rig.

    Attributes
    ----------
    shape : tuple of int
        (rows, cols) of the frame.
    focal_px : float
        Focal length over pixel pitch [px].
    principal_point : tuple of float
        (x, y) [px], integer = pixel centre.
    distortion : tuple of float
        k1, k2, p1, p2, k3 (OpenCV's order).
    axes : ndarray (3, 3)
        Columns: camera x, y, z in plate coordinates.
    pinhole : ndarray (3,)
        Its position in plate coordinates [mm].
    thickness, refractive_index : float
        Of the plate [mm], [1].
    """

    shape: tuple[int, int]
    focal_px: float
    principal_point: tuple[float, float]
    distortion: tuple[float, float, float, float, float]
    axes: Array
    pinhole: Array
    thickness: float
    refractive_index: float

    @classmethod
    def of(cls, camera: Camera, plate: Plate) -> Projection:
        """Place the pinhole so that the scale on the axis is ``camera.scale_px_per_mm``.

        Through the port the contact plane appears at depth t/n below the bottom face (paraxially); tilts turn the
        camera about that apparent point, so that a tilted camera still looks at ``camera.centre_mm``.
        """
        cols, rows = camera.resolution_px
        focal_px = camera.lens.focal_length_mm * 1e3 / camera.pixel.pitch_um
        axes = rotation(*np.deg2rad([camera.tilt_x_deg, camera.tilt_y_deg, camera.roll_deg]))
        apparent_z = -plate.thickness_mm * (1.0 - 1.0 / plate.refractive_index)
        target = np.array([*camera.centre_mm, apparent_z])
        pinhole = target - axes[:, 2] * (focal_px / camera.scale_px_per_mm)
        dx, dy = camera.principal_point_offset_px
        return cls(
            shape=(rows, cols),
            focal_px=focal_px,
            principal_point=((cols - 1) / 2 + dx, (rows - 1) / 2 + dy),
            distortion=camera.lens.distortion.coefficients,
            axes=axes,
            pinhole=pinhole,
            thickness=plate.thickness_mm,
            refractive_index=plate.refractive_index,
        )

    @property
    def matrix(self) -> Array:
        """Camera matrix in OpenCV's form."""
        cx, cy = self.principal_point
        return np.array([[self.focal_px, 0, cx], [0, self.focal_px, cy], [0, 0, 1.0]])

    @property
    def clearance(self) -> float:
        """Height of the plate's bottom face above the pinhole [mm]."""
        return float(-self.thickness - self.pinhole[2])

    def distort(self, x: ArrayLike, y: ArrayLike) -> tuple[Array, Array]:
        """Apply the lens's distortion to normalised coordinates (any shape)."""
        return distort(x, y, self.distortion)

    def undistort(self, x: ArrayLike, y: ArrayLike) -> tuple[Array, Array]:
        """Invert :meth:`distort` (OpenCV's fixed point, to 1e-12)."""
        x, y = np.asarray(x, float), np.asarray(y, float)
        if not any(self.distortion):
            return x.copy(), y.copy()
        points = np.stack([x.ravel(), y.ravel()], axis=-1)[:, None, :]
        criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 200, 1e-12)
        k: Any = np.array(self.distortion)
        found = cv2.undistortPoints(points, np.eye(3), k, None, None, None, criteria)[:, 0, :]
        return found[:, 0].reshape(x.shape), found[:, 1].reshape(x.shape)

    def to_plate(self, u: ArrayLike, v: ArrayLike) -> tuple[Array, Array]:
        """Return the contact-plane point [mm] that a pixel position (column u, row v) sees."""
        cx, cy = self.principal_point
        x, y = self.undistort((np.asarray(u, float) - cx) / self.focal_px, (np.asarray(v, float) - cy) / self.focal_px)
        return self.ray_to_plate(x, y)

    def tangents(self, x: ArrayLike, y: ArrayLike) -> tuple[Array, Array]:
        """Return dx/dz and dy/dz in air, along the plate's axes, of undistorted normalised directions (x, y, 1)."""
        x, y = np.asarray(x, float), np.asarray(y, float)
        across, down, along = (self.axes[k, 0] * x + self.axes[k, 1] * y + self.axes[k, 2] for k in range(3))
        return across / along, down / along

    def bend(self, tan_x: Array, tan_y: Array) -> Array:
        """Return the slope in the glass over that in air [1]: n sin(theta_glass) = sin(theta_air)."""
        tan2 = tan_x * tan_x + tan_y * tan_y
        return np.asarray(1.0 / np.sqrt(self.refractive_index**2 + (self.refractive_index**2 - 1.0) * tan2))

    def ray_to_plate(self, x: ArrayLike, y: ArrayLike) -> tuple[Array, Array]:
        """Return the contact-plane point [mm] of an undistorted normalised direction (x, y, 1)."""
        tan_x, tan_y = self.tangents(x, y)
        reach = self.clearance + self.thickness * self.bend(tan_x, tan_y)
        return self.pinhole[0] + reach * tan_x, self.pinhole[1] + reach * tan_y

    def to_image(self, x: ArrayLike, y: ArrayLike) -> tuple[Array, Array]:
        """Return the pixel position (u, v) of contact-plane points [mm]; inverse of :meth:`to_plate`."""
        xn, yn = self.plate_to_ray(x, y)
        xd, yd = self.distort(xn, yn)
        cx, cy = self.principal_point
        return self.focal_px * xd + cx, self.focal_px * yd + cy

    def plate_to_ray(self, x: ArrayLike, y: ArrayLike) -> tuple[Array, Array]:
        """Return the undistorted normalised direction from which a contact-plane point [mm] is seen."""
        dx, dy = np.asarray(x, float) - self.pinhole[0], np.asarray(y, float) - self.pinhole[1]
        radius = np.hypot(dx, dy)
        h, t, n2 = self.clearance, self.thickness, self.refractive_index**2
        slope = radius / (h + t / self.refractive_index)
        for _ in range(12):  # Newton on slope -> reached radius; convex and monotonic, so it converges from here
            root = np.sqrt(n2 * (1 + slope**2) - slope**2)
            value = slope * (h + t / root) - radius
            derivative = h + t / root - t * slope**2 * (n2 - 1) / root**3
            slope = slope - value / derivative
        scale = np.divide(slope, radius, out=np.full_like(radius, 1.0 / (h + t / np.sqrt(n2))), where=radius > 0)
        d = np.stack([dx * scale, dy * scale, np.ones_like(dx)], axis=-1) @ self.axes
        return d[..., 0] / d[..., 2], d[..., 1] / d[..., 2]

    def ideal_view(self, margin_px: int = 4) -> IdealView:
        """Return the pinhole grid, of the same focal length, that covers the whole distorted frame plus a margin."""
        rows, cols = self.shape
        u, v = np.arange(-1, cols + 1), np.arange(-1, rows + 1)
        border_u = np.concatenate([u, u, np.full(v.size, -1), np.full(v.size, cols)])
        border_v = np.concatenate([np.full(u.size, -1), np.full(u.size, rows), v, v])
        cx, cy = self.principal_point
        x, y = self.undistort((border_u - cx) / self.focal_px, (border_v - cy) / self.focal_px)
        # The axis falls on the same fraction of a pixel as in the frame, so that a lens without distortion is a crop.
        part_x, part_y = cx - np.floor(cx), cy - np.floor(cy)
        left = int(np.ceil(-x.min() * self.focal_px - part_x)) + margin_px
        top = int(np.ceil(-y.min() * self.focal_px - part_y)) + margin_px
        right = int(np.ceil(x.max() * self.focal_px + part_x)) + margin_px
        bottom = int(np.ceil(y.max() * self.focal_px + part_y)) + margin_px
        axis = (float(left + part_x), float(top + part_y))
        return IdealView((top + bottom + 1, left + right + 1), self.focal_px, axis)

    def ideal_maps(self, view: IdealView) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return cv2.remap maps (x, y) that carry an image on ``view`` into the distorted frame."""
        rows, cols = self.shape
        cx, cy = self.principal_point
        u, v = np.meshgrid((np.arange(cols) - cx) / self.focal_px, (np.arange(rows) - cy) / self.focal_px)
        x, y = self.undistort(u, v)
        px, py = view.principal_point
        return (x * view.focal_px + px).astype(np.float32), (y * view.focal_px + py).astype(np.float32)
