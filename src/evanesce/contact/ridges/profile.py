r"""One ridge of a periodic row, pressed flat under a mean pressure: plane strain, in closed form up to one integral.

The undeformed furrow is h(x) = H |sin(pi x/lambda)|^m below the crest at x = 0. For m = 2 that is Westergaard's
sinusoid (1939); m sets the ridge's width at half height. Its contact is a superposition of periodic flat punches
(Sadowsky 1928) of growing half width: with s = sin(pi x/lambda) the punch of half width sigma presses with
cos(pi x/lambda)/sqrt(sigma^2 - s^2), has mean pressure 1 and opens the furrow beside it with the slope
(2/E*) cos(pi x/lambda)/sqrt(s^2 - sigma^2). That the slopes add up to h'(x) is Abel's equation for the weights
k(sigma); a power has a power as its solution:

    k(sigma) = m p_c sigma^(m-1),  p_c = pi E* H / (lambda B(m/2, 1/2)),

so that the mean pressure is p_c s_a^m. It closes the furrow (s_a = 1) at p_c, for m = 2 at Westergaard's
p* = pi E* (H/2)/lambda.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import beta

from evanesce.core.quadrature import gauss_legendre

Array = NDArray[np.float64]


def profile_exponent(width: float, pitch: float) -> float:
    """Return the exponent m at which a ridge has a given width at half its height.

    Parameters
    ----------
    width, pitch : float
        Width at half height, distance of neighbouring crests; same unit.

    Returns
    -------
    float
        ln(1/2)/ln(sin(pi width/(2 pitch))); 2 for a width of half the pitch.

    Raises
    ------
    ValueError
        If the width is not between 0 and the pitch.
    """
    if not 0 < width < pitch:
        raise ValueError(
            f"ridge width {width:g} must lie between 0 and the pitch {pitch:g}: nothing else leaves a furrow"
        )
    return float(np.log(0.5) / np.log(np.sin(0.5 * np.pi * width / pitch)))


def closure_pressure(modulus: float, height: float, pitch: float, exponent: float = 2.0) -> float:
    """Return the mean pressure that closes the furrows [MPa].

    Parameters
    ----------
    modulus : float
        E* [MPa].
    height, pitch : float
        Crest to valley, and crest to crest [mm].
    exponent : float
        m [1].

    Returns
    -------
    float
        [MPa].

    Raises
    ------
    ValueError
        If a parameter is not positive (a height of zero is allowed).

    References
    ----------
    H. M. Westergaard, J. Appl. Mech. 6 (1939) A49; K. L. Johnson, *Contact Mechanics* (1985), section 13.2, for m = 2.
    """
    if not (modulus > 0 and height >= 0 and pitch > 0 and exponent > 0):
        raise ValueError(f"E* {modulus:g} MPa, height {height:g} mm, pitch {pitch:g} mm, exponent {exponent:g}")
    return float(np.pi * modulus * height / (pitch * beta(0.5 * exponent, 0.5)))


def contact_edge(mean_pressure: ArrayLike, closure: float, exponent: float = 2.0) -> Array:
    """Return s_a = sin(pi a/lambda), a the half width of contact: (p/p_c)^(1/m), at most 1.

    Parameters
    ----------
    mean_pressure : array_like
        Over a whole pitch [MPa]; nothing touches where it is not positive.
    closure : float
        p_c [MPa].
    exponent : float
        m [1].

    Returns
    -------
    ndarray
        0 to 1, in the shape of ``mean_pressure``.
    """
    mean = np.clip(np.asarray(mean_pressure, dtype=float), 0.0, None)
    if closure == 0:
        return np.where(mean > 0, 1.0, 0.0)
    return np.minimum(mean / closure, 1.0) ** (1.0 / exponent)


def ridge_pressure(
    distance: ArrayLike, mean_pressure: ArrayLike, pitch: float, closure: float, exponent: float = 2.0
) -> Array:
    """Return the pressure at a distance from the crest.

    Parameters
    ----------
    distance : array_like
        From the crest, across the ridge [mm]; -pitch/2 to pitch/2.
    mean_pressure : array_like
        [MPa]; broadcasts with ``distance``.
    pitch, closure, exponent : float
        lambda [mm], p_c [MPa], m [1].

    Returns
    -------
    ndarray
        [MPa]; over a pitch it averages to ``mean_pressure``. Beyond closure the excess adds evenly.
    """
    phase = np.pi * np.asarray(distance, dtype=float) / pitch
    s, mean = np.abs(np.sin(phase)), np.clip(np.asarray(mean_pressure, dtype=float), 0.0, None)
    s, edge, mean = np.broadcast_arrays(s, contact_edge(mean, closure, exponent), mean)
    ratio = np.divide(s, edge, out=np.full(s.shape, np.inf), where=edge > 0)
    inside = ratio < 1
    pressure = np.zeros(s.shape)
    wave = exponent * closure * edge[inside] ** (exponent - 1) * np.abs(np.cos(phase) + 0 * s)[inside]
    pressure[inside] = wave * _punch_sum(ratio[inside], exponent)
    return pressure + np.maximum(mean - closure, 0.0)


def ridge_gap(
    distance: ArrayLike, mean_pressure: ArrayLike, pitch: float, height: float, closure: float, exponent: float = 2.0
) -> Array:
    """Return the gap of the furrow [mm], zero in contact and ``height`` at most.

    ``height`` is the undeformed one, crest to valley [mm].

    Parameters
    ----------
    distance : array_like
        From the crest, across the ridge [mm].
    mean_pressure : array_like
        Over a whole pitch [MPa]; broadcasts with ``distance``.
    pitch : float
        [mm].
    height : float
        Undeformed, crest to valley [mm].
    closure : float
        p_c [MPa].
    exponent : float
        m [1].

    Returns
    -------
    ndarray
        [mm].
    """
    s = np.abs(np.sin(np.pi * np.asarray(distance, dtype=float) / pitch))
    s, edge = np.broadcast_arrays(s, contact_edge(mean_pressure, closure, exponent))
    outside = s > edge
    gap = np.zeros(s.shape)
    scale = 2.0 * height * exponent / beta(0.5 * exponent, 0.5)
    gap[outside] = scale * s[outside] ** exponent * _opening_sum(edge[outside] / s[outside], exponent)
    return gap


def _punch_sum(ratio: Array, exponent: float) -> Array:
    """Return the integral of t^(m-1)/sqrt(t^2 - ratio^2) from ratio to 1."""
    nodes, regular, _ = _tables(exponent)
    return np.sqrt(1.0 - ratio**2) * np.interp(ratio, nodes, regular)


def _opening_sum(ratio: Array, exponent: float) -> Array:
    """Return the integral of t^(m-1) arccosh(1/t) from ratio to 1."""
    nodes, _, regular = _tables(exponent)
    return (1.0 - ratio**2) ** 1.5 * np.interp(ratio, nodes, regular)


@lru_cache(maxsize=32)
def _tables(exponent: float) -> tuple[Array, Array, Array]:
    """Tabulate both integrals on [0, 1] with their root at 1 divided out, so that linear interpolation holds to 1e-6.

    Substituting t^2 = rho^2 + (1 - rho^2) tau^2 makes the first sqrt(1 - rho^2) times the integral of t^(m-2) d tau,
    and the second, by parts, (1/m) times the integral of (t^m - rho^m)/(t sqrt(1 - t^2)): smooth but at rho = 0,
    where nodes crowd (rho = q^4) to resolve the algebraic or logarithmic end.
    """
    nodes = np.linspace(0.0, 1.0, 4097) ** 4
    tau, weight = gauss_legendre(96)
    # tau = v^4 crowds the quadrature at tau = 0, too
    v = 0.5 * (tau + 1.0)
    tau, weight = v**4, 0.5 * weight * 4 * v**3
    rho = nodes[:-1, None]
    t = np.sqrt(rho**2 + (1.0 - rho**2) * tau**2)
    punch = np.append((t ** (exponent - 2.0)) @ weight, 1.0)
    # t = cos(angle): the second becomes (1/m) integral of (t^m - rho^m)/t d angle from 0 to arccos(rho)
    span = np.arccos(rho)
    angle = span * (1.0 - v**4)
    t = np.cos(angle)
    opening = ((t**exponent - rho**exponent) / t @ weight) * span[:, 0] / exponent
    opening = np.append(opening / (1.0 - rho[:, 0] ** 2) ** 1.5, 1.0 / 3.0)
    return nodes, punch, opening
