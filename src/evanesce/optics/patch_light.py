"""Light of a contact patch in closed form: guided irradiance in, diffuse body, light out; feedback through the plate.

All functions take arrays and floats. Angles are inside the glass, to the plate's normal.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from evanesce.core.quadrature import gauss_legendre
from evanesce.optics.interface import (
    fresnel_reflectance,
    frustrated_transmittance,
    internal_diffuse_reflectance,
)

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Interface:
    """Glass, air film, silicone with a Lambertian body.

    Attributes
    ----------
    n_glass, n_silicone : float
        [1].
    body_reflectance : float
        Diffuse reflectance of the silicone below its surface [1].
    wavelength : float
        [nm].
    """

    n_glass: float
    n_silicone: float
    body_reflectance: float
    wavelength: float


def angle_nodes(count: int, n_glass: float) -> tuple[Array, Array]:
    """Return angles [rad] over the whole hemisphere, denser where light is guided, and weights for d(theta).

    Gauss-Legendre on either side of the critical angle, so that the kink there falls between nodes.

    Parameters
    ----------
    count : int
        Nodes on either side of the critical angle.
    n_glass : float
        [1].

    Returns
    -------
    theta : ndarray (2 count,)
        Inside the glass [rad].
    weights : ndarray (2 count,)
        [rad].
    """
    critical = float(np.arcsin(1.0 / n_glass))
    u, w = gauss_legendre(count)
    parts = []
    for low, high in ((0.0, critical), (critical, np.pi / 2)):
        parts.append((low + (high - low) * (u + 1) / 2, w * (high - low) / 2))
    return np.concatenate([p[0] for p in parts]), np.concatenate([p[1] for p in parts])


def transmitted_irradiance_kernel(theta: ArrayLike, weights: ArrayLike, gap: ArrayLike, interface: Interface) -> Array:
    """Return the kernel from azimuth-averaged radiance at ``theta`` to irradiance inside the silicone.

    E = sum over theta of kernel * L, kernel = 2 pi T(theta, gap) cos(theta) sin(theta) d(theta).

    Parameters
    ----------
    theta, weights : array_like (angles,)
        Nodes [rad] and weights [rad], as of :func:`angle_nodes`.
    gap : array_like (gaps,)
        [mm].
    interface : Interface

    Returns
    -------
    ndarray (gaps, angles)
        [sr].
    """
    theta, weights = np.asarray(theta, float), np.asarray(weights, float)
    t = frustrated_transmittance(
        np.cos(theta)[None, :],
        np.asarray(gap, float)[:, None],
        interface.wavelength,
        interface.n_glass,
        interface.n_silicone,
    )
    return np.asarray(2 * np.pi * t * np.cos(theta) * np.sin(theta) * weights)


def returned_radiance(gap: ArrayLike, theta: ArrayLike, interface: Interface, inside: ArrayLike | None = None) -> Array:
    """Return the radiance that leaves the silicone back into the glass at ``theta`` per irradiance inside it.

    The body's light is reflected between body and surface any number of times; n^2 of the change of medium included.

    Parameters
    ----------
    gap : array_like
        [mm].
    theta : array_like
        Inside the glass [rad]; broadcasts against ``gap``.
    interface : Interface
    inside : array_like, optional
        :func:`~evanesce.optics.interface.internal_diffuse_reflectance` at the gaps, which takes longest, where it is
        known [1].

    Returns
    -------
    ndarray, broadcast of ``gap`` and ``theta``
        [1/sr].
    """
    gap = np.asarray(gap, float)
    if inside is None:
        inside = internal_diffuse_reflectance(gap, interface.wavelength, interface.n_glass, interface.n_silicone)
    body = interface.body_reflectance / (1.0 - interface.body_reflectance * np.asarray(inside))
    t = frustrated_transmittance(np.cos(theta), gap, interface.wavelength, interface.n_glass, interface.n_silicone)
    return np.asarray(body / np.pi * (interface.n_glass / interface.n_silicone) ** 2 * t)


def window_transmittance(theta_glass: ArrayLike, n_glass: float) -> Array:
    """Return radiance in air over radiance in the glass at the bottom face: (1 - R)/n^2.

    Parameters
    ----------
    theta_glass : array_like
        Angle inside the glass [rad].
    n_glass : float
        [1].

    Returns
    -------
    ndarray
        Shape of ``theta_glass`` [1].
    """
    return np.asarray((1.0 - fresnel_reflectance(np.cos(theta_glass), n_glass, 1.0)) / n_glass**2)


EXTERNAL_REFLECTANCE_NODES = 64


def external_diffuse_reflectance(n_glass: float) -> float:
    """Return the reflectance of bare glass for diffuse light from the air: the mean of R over d(sin^2 theta).

    Parameters
    ----------
    n_glass : float
        [1].
    """
    u, w = gauss_legendre(EXTERNAL_REFLECTANCE_NODES)
    cosine = 0.5 * (u + 1.0)
    return float(np.sum(w * fresnel_reflectance(cosine, 1.0, n_glass) * cosine))


@dataclass(frozen=True)
class Feedback:
    """What a contact element does to the irradiance of another at distance r, per area of the first.

    Attributes
    ----------
    loss : ndarray
        Guided light that the first takes in, as a share of the second's irradiance [1/mm^2].
    gain : ndarray
        Irradiance that the first's own light returns, per irradiance inside the first [1/mm^2].
    """

    loss: Array
    gain: Array


def feedback(
    r: ArrayLike,
    thickness: float,
    interface: Interface,
    theta: ArrayLike,
    radiance: ArrayLike,
    *,
    absorption_coefficient: float = 0.0,
    bounces: int = 8,
) -> Feedback:
    """Return the plate's response between two contact elements at distance r.

    A ray at angle theta meets the top face every 2 t tan(theta); the k-th annulus around an element is therefore lit
    (or shaded) at theta = arctan(r/(2 t k)). Contact elements in between are ignored: an effect of second order in the
    covered share.

    Parameters
    ----------
    r : array_like
        Distances [mm], above 0.
    thickness : float
        [mm].
    interface : Interface
    theta, radiance : array_like (angles,)
        Azimuth-averaged radiance of the plate without contact, of which only the shape counts.
    absorption_coefficient : float
        [1/mm].
    bounces : int
        Annuli k = 1 ... bounces.
    """
    r = np.asarray(r, float)
    theta, radiance = np.asarray(theta, float), np.asarray(radiance, float)
    nodes, weights = angle_nodes(64, interface.n_glass)
    smooth = np.interp(nodes, theta, radiance)
    zero = np.zeros(1)
    total = float(transmitted_irradiance_kernel(nodes, weights, zero, interface)[0] @ smooth)
    n = interface.n_glass
    loss, gain = np.zeros(r.shape), np.zeros(r.shape)
    for k in range(1, bounces + 1):
        angle = np.arctan2(r, 2 * thickness * k)
        cosine = np.cos(angle)
        # d(theta)/dr over the annulus' circumference: the area element of plan view
        per_area = (2 * thickness * k / (r**2 + (2 * thickness * k) ** 2)) / (2 * np.pi * r)
        t = frustrated_transmittance(cosine, 0.0, interface.wavelength, n, interface.n_silicone)
        bare = fresnel_reflectance(cosine, n, 1.0)
        along = bare ** (2 * k - 1) * np.exp(-absorption_coefficient * r / np.sin(angle))
        received = 2 * np.pi * cosine * np.sin(angle) * t * per_area
        gain += received * along * returned_radiance(0.0, angle, interface)
        loss += received * t * np.interp(angle, theta, radiance) / total
    return Feedback(loss, gain)
