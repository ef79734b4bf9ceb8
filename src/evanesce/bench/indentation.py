"""Stiffness test of the thesis's chapter 3: a steel cylinder pressed across a finger, read by Hertz's elliptic contact.

E* is the contact modulus throughout, 1/E* = (1 - nu1^2)/E1 + (1 - nu2^2)/E2. The thesis's depth formula (eq 3.3) and
its conversion to Young's modulus (eq 3.6) use twice that, 2/E' = the same sum; see ``docs/background/thesis-notes.md``.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import brentq, curve_fit
from scipy.special import ellipe, ellipk

from evanesce.core.columns import Column, read_columns
from evanesce.core.errors import InputError, WorkError

Floats = NDArray[np.float64]

STEEL_YOUNGS_MPa = 210e3
STEEL_POISSON = 0.3


@dataclass(frozen=True)
class EllipticGeometry:
    """Shape of the contact of two bodies with principal relative curvatures 1/R_a <= 1/R_b.

    Attributes
    ----------
    effective_radius : float
        R' = 1/(1/R_a + 1/R_b) [mm].
    axis_ratio : float
        k = a/b >= 1.
    first, second : float
        Complete elliptic integrals K and E of eccentricity squared 1 - 1/k^2.
    depth_factor : float
        delta* of the depth, 1 for a circle.
    """

    effective_radius: float
    axis_ratio: float
    first: float
    second: float
    depth_factor: float

    def semi_axes(self, force: ArrayLike, modulus: ArrayLike) -> tuple[Floats, Floats]:
        """Return (a, b) [mm] at forces [N] and contact moduli E* [MPa] (thesis, eqs 3.9 and 3.10).

        Parameters
        ----------
        force : array_like
            [N].
        modulus : array_like
            E* [MPa].

        Returns
        -------
        tuple of ndarray
            a and b [mm].
        """
        f, e = np.asarray(force, dtype=float), np.asarray(modulus, dtype=float)
        a = np.cbrt(3.0 * self.axis_ratio**2 * self.second * f * self.effective_radius / (np.pi * e))
        return a, a / self.axis_ratio

    def depth(self, force: ArrayLike, modulus: ArrayLike) -> Floats:
        """Return the approach delta* (3 F R'/(2 E*))^(2/3)/(2 R') [mm].

        Parameters
        ----------
        force : array_like
            [N].
        modulus : array_like
            E* [MPa].

        Returns
        -------
        ndarray
            [mm].
        """
        f, e = np.asarray(force, dtype=float), np.asarray(modulus, dtype=float)
        return self._depth_scale * np.cbrt(f / e) ** 2

    def modulus(self, force: ArrayLike, depth: ArrayLike) -> Floats:
        """Return E* [MPa] from forces [N] and approaches [mm], each above 0.

        Parameters
        ----------
        force : array_like
            [N].
        depth : array_like
            [mm].

        Returns
        -------
        ndarray
            [MPa].
        """
        d = np.asarray(depth, dtype=float)
        return np.asarray(force, dtype=float) * (self._depth_scale / d) ** 1.5

    @property
    def _depth_scale(self) -> float:
        radius = self.effective_radius
        return self.depth_factor * (1.5 * radius) ** (2.0 / 3.0) / (2.0 * radius)


def elliptic_geometry(radius_1: float, radius_2: float) -> EllipticGeometry:
    """Return the contact shape for relative radii of curvature [mm] in the two principal planes, exactly.

    For a cylindrical finger crossed by a cylinder these are the two cylinders' radii.

    Parameters
    ----------
    radius_1, radius_2 : float
        [mm], positive.

    Returns
    -------
    EllipticGeometry

    References
    ----------
    H. Hertz (1882); K. L. Johnson, Contact Mechanics (1985), eqs 4.26 to 4.32; J. A. Greenwood, Tribol.
    Int. 30 (1997) 235.
    """
    low, high = sorted((radius_1, radius_2))
    if low <= 0 or not np.isfinite(high):
        raise ValueError(f"radii {radius_1:g} and {radius_2:g} mm; both must be positive and finite")
    ratio = high / low

    def mismatch(m: float) -> float:
        return (ellipe(m) / (1.0 - m) - ellipk(m)) / (ellipk(m) - ellipe(m)) - ratio

    # Near a circle the ratio is 1 + 3 m/4: below 1e-6 the ellipse is a circle to rounding.
    m = 0.0 if ratio < 1.0 + 1e-6 else brentq(mismatch, 1e-9, 1.0 - 1e-12, xtol=1e-15)
    first, second, k = float(ellipk(m)), float(ellipe(m)), 1.0 / np.sqrt(1.0 - m)
    radius = 1.0 / (1.0 / low + 1.0 / high)
    # delta = 3 F K/(2 pi a E*) with a from the semi-axes, over the form of :meth:`EllipticGeometry.depth`.
    factor = 2.0 / np.pi * first * (np.pi / (2.0 * k**2 * second)) ** (1.0 / 3.0)
    return EllipticGeometry(radius, float(k), first, second, float(factor))


def mean_pressure(force: ArrayLike, a: ArrayLike, b: ArrayLike) -> Floats:
    """Return F/(pi a b) [MPa]; the thesis prints the peak's formula here (eqs 3.11 and 3.12).

    Parameters
    ----------
    force : array_like
        [N].
    a, b : array_like
        Semi-axes [mm].

    Returns
    -------
    ndarray
        [MPa].
    """
    return np.asarray(force, dtype=float) / (np.pi * np.asarray(a, dtype=float) * np.asarray(b, dtype=float))


def peak_pressure(force: ArrayLike, a: ArrayLike, b: ArrayLike) -> Floats:
    """Return 3 F/(2 pi a b) [MPa].

    Parameters
    ----------
    force : array_like
        [N].
    a, b : array_like
        Semi-axes [mm].

    Returns
    -------
    ndarray
        [MPa].
    """
    return 1.5 * mean_pressure(force, a, b)


def youngs_from_reduced(
    modulus: ArrayLike,
    poisson_ratio: float,
    indenter_youngs: float = STEEL_YOUNGS_MPa,
    indenter_poisson: float = STEEL_POISSON,
) -> Floats:
    """Return the finger's Young's modulus [MPa] from the contact modulus E* [MPa].

    (1 - nu^2)/(1/E* - (1 - nu1^2)/E1). The thesis's eq 3.6 has the indenter's nu1 in the numerator, too; with E' = 2 E*
    the printed values follow from the finger's.

    Parameters
    ----------
    modulus : array_like
        E* [MPa].
    poisson_ratio : float
        Of the finger.
    indenter_youngs : float
        [MPa].
    indenter_poisson : float

    Returns
    -------
    ndarray
        [MPa].

    Raises
    ------
    ValueError
        If the contact is stiffer than the indenter allows.
    """
    compliance = 1.0 / np.asarray(modulus, dtype=float) - (1.0 - indenter_poisson**2) / indenter_youngs
    if np.any(compliance <= 0):
        raise ValueError("the contact modulus exceeds what the indenter allows")
    return (1.0 - poisson_ratio**2) / compliance


@dataclass(frozen=True)
class IndentationResult:
    """A stiffness test analysed.

    Attributes
    ----------
    force, depth : ndarray (n,)
        [N], and [mm] from the fitted first contact.
    reduced_modulus : ndarray (n,)
        E* at each sample [MPa].
    youngs_modulus : ndarray (n,)
        [MPa].
    semi_major, semi_minor : ndarray (n,)
        [mm].
    mean_pressure, peak_pressure : ndarray (n,)
        [MPa].
    intercept, slope : float
        E*(F) = intercept + slope F, fitted to the depths [MPa], [MPa/N].
    intercept_se, slope_se : float
    touch : float
        Machine position of first contact [mm].
    depth_rms : float
        Residual of the depth [mm].
    """

    force: Floats
    depth: Floats
    reduced_modulus: Floats
    youngs_modulus: Floats
    semi_major: Floats
    semi_minor: Floats
    mean_pressure: Floats
    peak_pressure: Floats
    intercept: float
    slope: float
    intercept_se: float
    slope_se: float
    touch: float
    depth_rms: float


COLUMNS = (Column("force", ("load", "fz"), "force"), Column("displacement", ("depth", "indentation"), "length"))


def read_indentation(path: Path) -> tuple[Floats, Floats]:
    """Read ``force_N`` and ``displacement_mm``; return both with signs such that pressing is positive.

    Parameters
    ----------
    path : Path

    Returns
    -------
    tuple of ndarray (n,)
        Force [N] and displacement [mm].
    """
    data = read_columns(path, COLUMNS)
    force, position = data["force"], data["displacement"]
    if np.max(np.abs(force)) == 0.0:
        raise InputError("the force is zero throughout", file=path, key="force")
    force = force * np.sign(force[np.argmax(np.abs(force))])
    if np.corrcoef(force, position)[0, 1] < 0:
        position = -position
    return force, position


def analyse(
    force: ArrayLike,
    displacement: ArrayLike,
    geometry: EllipticGeometry,
    poisson_ratio: float,
    *,
    find_touch: bool = True,
    min_force: float = 0.02,
) -> IndentationResult:
    """Fit E*(F) to a loading curve and derive what the thesis's chapter 3 derives.

    Parameters
    ----------
    force, displacement : array_like (n,)
        [N], [mm].
    geometry : EllipticGeometry
    poisson_ratio : float
        Of the finger.
    find_touch : bool
        Fit the position of first contact; otherwise it is displacement 0.
    min_force : float
        Samples below are left out [N]: noise, not contact.

    Returns
    -------
    IndentationResult

    Raises
    ------
    WorkError
        With fewer than 6 usable samples, or where the fit fails or gives a modulus that is not positive.
    """
    f, x = np.asarray(force, dtype=float), np.asarray(displacement, dtype=float)
    usable = np.isfinite(f) & np.isfinite(x) & (f > min_force)
    f, x = f[usable], x[usable]
    if len(f) < 6:
        raise WorkError(f"{len(f)} samples above {min_force:g} N; at least 6 are needed")

    def depth(load: Floats, intercept: float, slope: float, touch: float = 0.0) -> Floats:
        return touch + geometry.depth(load, np.maximum(intercept + slope * load, 1e-9))

    start = [float(np.median(geometry.modulus(f, np.maximum(x - x.min(), 1e-3 * np.ptp(x) + 1e-9)))), 0.0]
    try:
        fitted, covariance = curve_fit(depth, f, x, p0=[*start, float(x.min())] if find_touch else start)
    except RuntimeError as error:
        raise WorkError(f"the fit of E*(F) failed: {error}") from None
    intercept, slope, touch = (*fitted.tolist(), 0.0)[:3]
    modulus = intercept + slope * f
    if modulus.min() <= 0:
        raise WorkError(f"the fitted E* is {modulus.min():.3g} MPa: this is not the loading curve of a Hertz contact")
    pressed = x - touch
    a, b = geometry.semi_axes(f, modulus)
    spread = np.sqrt(np.diag(covariance))
    pointwise = geometry.modulus(f, np.where(pressed > 0, pressed, np.nan))
    return IndentationResult(
        force=f,
        depth=pressed,
        reduced_modulus=pointwise,
        youngs_modulus=youngs_from_reduced(modulus, poisson_ratio),
        semi_major=a,
        semi_minor=b,
        mean_pressure=mean_pressure(f, a, b),
        peak_pressure=peak_pressure(f, a, b),
        intercept=intercept,
        slope=slope,
        intercept_se=float(spread[0]),
        slope_se=float(spread[1]),
        touch=touch,
        depth_rms=float(np.sqrt(np.mean((x - depth(f, *fitted)) ** 2))),
    )
