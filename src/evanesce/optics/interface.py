"""Plane interface of glass and silicone with an air film between: Fresnel and frustrated reflectance, unpolarised.

All media are lossless, so that transmittance is one minus reflectance, from either side.

References
----------
M. Born and E. Wolf, *Principles of Optics*, 7th ed. (1999), sections 1.5 (Fresnel) and 1.6.4 (a homogeneous film).
S. Zhu, A. W. Yu, D. Hawley and R. Roy, "Frustrated total internal reflection: a demonstration and review", American
Journal of Physics 54 (1986) 601.
"""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from evanesce.core.quadrature import gauss_legendre

Array = NDArray[np.float64]
NM_PER_MM = 1e6


def critical_angle(n1: float, n2: float = 1.0) -> float:
    """Return the critical angle from medium 1 to medium 2 [rad]; pi/2 where there is none (n2 >= n1).

    Parameters
    ----------
    n1, n2 : float
        Refractive indices [1].
    """
    return float(np.arcsin(min(n2 / n1, 1.0)))


def _normal_cosine(sin2: Array, n: float, n1: float) -> NDArray[np.complex128]:
    """Return n cos(theta) in a medium of index ``n`` for the wave of squared sine ``sin2`` in medium 1 (Im >= 0)."""
    squared = n * n - n1 * n1 * sin2
    return np.sqrt(np.maximum(squared, 0.0)) + 1j * np.sqrt(np.maximum(-squared, 0.0))


def _amplitude(a: Any, b: Any) -> Any:
    """Return (a - b)/(a + b), and -1 at grazing incidence where both vanish."""
    total = a + b
    return np.divide(a - b, total, out=np.full(np.shape(total), -1.0 + 0j), where=total != 0)


def fresnel_reflectance(cos_theta: ArrayLike, n1: float, n2: float) -> Array:
    """Return the unpolarised power reflectance of the bare interface of two media.

    Parameters
    ----------
    cos_theta : array_like
        Cosine of the angle of incidence in medium 1, 0 to 1.
    n1, n2 : float
        Refractive indices [1].
    """
    cos_theta = np.asarray(cos_theta, float)
    c1 = n1 * cos_theta
    # Beyond the critical angle c2 is imaginary and both amplitudes have size 1, as with c2 = 0.
    c2 = np.sqrt(np.maximum(n2 * n2 - n1 * n1 + c1 * c1, 0.0))
    c1, c2 = np.maximum(c1, np.finfo(float).tiny), np.asarray(c2)
    s, p = (c1 - c2) / (c1 + c2), (n2 * n2 * c1 - n1 * n1 * c2) / (n2 * n2 * c1 + n1 * n1 * c2)
    return np.asarray(0.5 * (s * s + p * p))


def frustrated_reflectance(
    cos_theta: ArrayLike, gap: ArrayLike, wavelength: float, n1: float, n3: float, n2: float = 1.0
) -> Array:
    """Return the unpolarised power reflectance of medium 1, film 2 and medium 3.

    r = (r12 + r23 e^{2 i beta}) / (1 + r12 r23 e^{2 i beta}), beta = (2 pi gap/wavelength) n2 cos(theta2), with the
    root of positive imaginary part beyond the critical angle.

    Parameters
    ----------
    cos_theta : array_like
        Cosine of the angle of incidence in medium 1, 0 to 1.
    gap : array_like
        Film thickness [mm]; broadcasts against ``cos_theta``.
    wavelength : float
        In vacuum [nm].
    n1, n3, n2 : float
        Refractive indices of glass, silicone and film [1].

    Returns
    -------
    ndarray
        Reflectance, 0 to 1.
    """
    cos_theta, gap = np.broadcast_arrays(np.asarray(cos_theta, float), np.asarray(gap, float))
    sin2 = 1.0 - cos_theta**2
    c1, c2, c3 = n1 * cos_theta + 0j, _normal_cosine(sin2, n2, n1), _normal_cosine(sin2, n3, n1)
    k_gap = (2 * np.pi * NM_PER_MM / wavelength) * gap
    phase_minus_1 = np.expm1(2j * k_gap * c2)
    # (e^{2 i beta} - 1)/(2 i c2), which stays finite where the film's own wave grazes (c2 = 0).
    film = np.divide(phase_minus_1, 2j * c2, out=np.array(k_gap, complex), where=c2 != 0)
    total = np.zeros(cos_theta.shape)
    for w1, w2, w3 in ((1.0, 1.0, 1.0), (n1**-2.0, n2**-2.0, n3**-2.0)):  # s, p
        # The textbook form times (r12's and r23's denominators)/(2 b), so that nothing divides by b = c2 w2.
        a, c = c1 * w1, c3 * w3
        mean, b2 = 1.0 + 0.5 * phase_minus_1, (c2 * w2) ** 2
        numerator = (a - c) * mean - 1j * (a * c - b2) * film / w2
        denominator = (a + c) * mean - 1j * (a * c + b2) * film / w2
        r = np.divide(numerator, denominator, out=np.full(cos_theta.shape, -1.0 + 0j), where=denominator != 0)
        total += 0.5 * np.abs(r) ** 2
    return np.asarray(np.clip(total, 0.0, 1.0))


def frustrated_transmittance(
    cos_theta: ArrayLike, gap: ArrayLike, wavelength: float, n1: float, n3: float, n2: float = 1.0
) -> Array:
    """Return one minus :func:`frustrated_reflectance`: the share of power that reaches medium 3.

    Parameters
    ----------
    cos_theta, gap, wavelength, n1, n3, n2
        As for :func:`frustrated_reflectance`.

    Returns
    -------
    ndarray
        Broadcast of ``cos_theta`` and ``gap``, 0 to 1.
    """
    return np.asarray(1.0 - frustrated_reflectance(cos_theta, gap, wavelength, n1, n3, n2))


def decay_constant(cos_theta: ArrayLike, wavelength: float, n1: float, n2: float = 1.0) -> Array:
    """Return kappa [1/mm], by which the evanescent field falls as exp(-kappa z) and the coupling as exp(-2 kappa gap).

    Zero below the critical angle.

    Parameters
    ----------
    cos_theta : array_like
        Cosine of the angle of incidence in medium 1, 0 to 1.
    wavelength : float
        In vacuum [nm].
    n1, n2 : float
        Refractive indices of glass and film [1].

    Returns
    -------
    ndarray
        Shape of ``cos_theta``.
    """
    sin2 = 1.0 - np.asarray(cos_theta, float) ** 2
    return np.asarray((2 * np.pi * NM_PER_MM / wavelength) * _normal_cosine(sin2, n2, n1).imag)


def _sine_panels(n1: float, n2: float, n3: float, order: int = 200) -> tuple[Array, Array]:
    """Return nodes sin^2(theta1) and weights for integrals over d(sin^2) on [0, min(1, (n3/n1)^2)].

    T has square-root edges at both critical angles; the substitution s = a + (b - a)(3u^2 - 2u^3), flat at both ends of
    each panel, makes the integrand smooth there.
    """
    top = min(1.0, (n3 / n1) ** 2)
    edges = sorted({0.0, min(top, (n2 / n1) ** 2), top})
    u, w = gauss_legendre(order)
    u, w = 0.5 * (u + 1.0), 0.5 * w
    step, slope = u * u * (3.0 - 2.0 * u), 6.0 * u * (1.0 - u)
    nodes = [a + (b - a) * step for a, b in itertools.pairwise(edges)]
    weights = [(b - a) * slope * w for a, b in itertools.pairwise(edges)]
    return np.concatenate(nodes), np.concatenate(weights)


def internal_diffuse_reflectance(
    gap: ArrayLike, wavelength: float, n1: float, n3: float, n2: float = 1.0, *, order: int = 200
) -> Array:
    """Return the reflectance that diffuse light in medium 3 meets at the film, averaged over its hemisphere.

    1 - (n1/n3)^2 times the integral of T d(sin^2 theta1), by the invariance of n^2 cos(theta) d(omega) and the
    reciprocity of T. Angles of medium 3 that medium 1 does not take (n3 > n1) are reflected.

    Parameters
    ----------
    gap : array_like
        [mm].
    wavelength : float
        [nm].
    n1, n3, n2 : float
        [1].
    order : int
        Gauss-Legendre nodes on each side of the critical angle.
    """
    gap = np.asarray(gap, float)
    sin2, weights = _sine_panels(n1, n2, n3, order)
    t = frustrated_transmittance(np.sqrt(1.0 - sin2), gap[..., None], wavelength, n1, n3, n2)
    return np.asarray(1.0 - (n1 / n3) ** 2 * (t @ weights))


def guided_coupling(
    gap: ArrayLike, wavelength: float, n1: float, n3: float, n2: float = 1.0, *, order: int = 200
) -> Array:
    """Return the coupling of guided light relative to that of contact: 1 at gap 0, 0 far away.

    The mean of T over isotropic guided radiance (theta1 beyond the critical angle to medium 2), over its value at
    gap 0.

    Parameters
    ----------
    gap : array_like
        [mm].
    wavelength : float
        [nm].
    n1, n3, n2 : float
        [1]; n3 must exceed n2, or nothing guided couples.
    """
    gap = np.asarray(gap, float)
    sin2, weights = _sine_panels(n1, n2, n3, order)
    guided = weights * (sin2 > (n2 / n1) ** 2)
    cos_theta = np.sqrt(1.0 - sin2)
    contact = (1.0 - fresnel_reflectance(cos_theta, n1, n3)) @ guided
    return np.asarray(frustrated_transmittance(cos_theta, gap[..., None], wavelength, n1, n3, n2) @ guided / contact)
