"""Three-parameter Mooney-Rivlin: curves, linear fit with uncertainty, and where the fitted material stops being one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import stats

from evanesce.core.columns import Column, read_columns
from evanesce.core.errors import InputError
from evanesce.materials.tables import material, material_names

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class MooneyRivlin:
    """Incompressible W = C10 (I1 - 3) + C01 (I2 - 3) + C11 (I1 - 3)(I2 - 3), all in MPa.

    References
    ----------
    R. S. Rivlin and D. W. Saunders, Phil. Trans. R. Soc. A 243 (1951) 251.
    """

    c10: float
    c01: float
    c11: float = 0.0

    @property
    def shear_modulus(self) -> float:
        """Small-strain shear modulus 2 (C10 + C01) [MPa]."""
        return 2.0 * (self.c10 + self.c01)

    @property
    def youngs_modulus(self) -> float:
        """Small-strain Young's modulus 3 G [MPa]."""
        return 3.0 * self.shear_modulus

    def uniaxial(self, stretch: ArrayLike) -> Floats:
        """Return nominal stress [MPa] (force over undeformed section) at uniaxial stretches, any shape."""
        return uniaxial_basis(stretch) @ np.array([self.c10, self.c01, self.c11])

    def simple_shear(self, shear: ArrayLike) -> Floats:
        """Return shear stress [MPa] at amounts of simple shear, any shape."""
        g = np.asarray(shear, dtype=float)
        return 2.0 * g * (self.c10 + self.c01 + 2.0 * self.c11 * g**2)

    def energy(self, l1: ArrayLike, l2: ArrayLike) -> Floats:
        """Return W [MPa] at principal in-plane stretches; the third follows from incompressibility."""
        a, b = np.asarray(l1, dtype=float) ** 2, np.asarray(l2, dtype=float) ** 2
        c = 1.0 / (a * b)
        i1, i2 = a + b + c, a * b + c * (a + b)
        return self.c10 * (i1 - 3) + self.c01 * (i2 - 3) + self.c11 * (i1 - 3) * (i2 - 3)


def uniaxial_basis(stretch: ArrayLike) -> Floats:
    """Return the nominal stress per unit C10, C01, C11 at uniaxial stretches; shape (..., 3)."""
    s = np.asarray(stretch, dtype=float)
    i1, i2 = s**2 + 2.0 / s, 2.0 * s + s**-2
    front = 2.0 * (1.0 - s**-3)
    return np.stack([front * s, front, front * (s * (i2 - 3.0) + (i1 - 3.0))], axis=-1)


def drucker_tangent(material: MooneyRivlin, l1: ArrayLike, l2: ArrayLike) -> Floats:
    """Return the smaller eigenvalue of d(Kirchhoff stress)/d(log strain) in the plane of l1, l2 [MPa].

    With the third stress at zero, the two in-plane log strains are free, and the material is stable in Drucker's sense
    where the 2 x 2 tangent is positive definite for them.

    References
    ----------
    D. C. Drucker, J. Appl. Mech. 26 (1959) 101.
    """
    # tau_i = dW/d(ln l_i) along incompressible paths, so the tangent is the Hessian of W in log stretches.
    a, b = np.asarray(l1, dtype=float) ** 2, np.asarray(l2, dtype=float) ** 2
    c = 1.0 / (a * b)
    i1, i2 = a + b + c, a * b + c * (a + b)
    w1, w2 = material.c10 + material.c11 * (i2 - 3.0), material.c01 + material.c11 * (i1 - 3.0)
    g1 = (2 * (a - c), 2 * (b - c))
    g2 = (2 * (a * b - 1.0 / a), 2 * (a * b - 1.0 / b))  # I2 = 1/a + 1/b + a b (incompressible)
    h1 = (4 * (a + c), 4 * (b + c), 4 * c)
    h2 = (4 * (a * b + 1.0 / a), 4 * (a * b + 1.0 / b), 4 * a * b)

    def hessian(k: int, i: int, j: int) -> Floats:
        return w1 * h1[k] + w2 * h2[k] + material.c11 * (g1[i] * g2[j] + g1[j] * g2[i])

    xx, yy, xy = hessian(0, 0, 0), hessian(1, 1, 1), hessian(2, 0, 1)
    return 0.5 * (xx + yy) - np.hypot(0.5 * (xx - yy), xy)


@dataclass(frozen=True)
class StabilityLimits:
    """First loss of stability on each path from the undeformed state; None where there is none in the range searched.

    Attributes
    ----------
    compression, tension : float or None
        Uniaxial stretch below 1 and above 1.
    equibiaxial, planar : float or None
        Stretch above 1.
    simple_shear : float or None
        Amount of shear at which the shear stress stops rising.
    """

    compression: float | None
    tension: float | None
    equibiaxial: float | None
    planar: float | None
    simple_shear: float | None


def _first_loss(stable: Callable[[Floats], Floats], start: float, stop: float) -> float | None:
    """Return where a function first turns non-positive between start and stop, to 1e-6."""
    path = np.linspace(start, stop, 4001)
    bad = np.flatnonzero(~(stable(path) > 0.0))
    if len(bad) == 0:
        return None
    if bad[0] == 0:
        return float(path[0])
    low, high = path[bad[0] - 1], path[bad[0]]
    while abs(high - low) > 1e-6:
        middle = 0.5 * (low + high)
        if stable(np.array([middle]))[0] > 0.0:
            low = middle
        else:
            high = middle
    return float(0.5 * (low + high))


def stability_limits(material: MooneyRivlin, furthest: float = 8.0) -> StabilityLimits:
    """Return the Drucker limits of a material.

    Parameters
    ----------
    material : MooneyRivlin
    furthest : float
        Largest stretch (and 1/compression) and shear searched.
    """

    def uniaxial(s: Floats) -> Floats:
        return drucker_tangent(material, s, s**-0.5)

    return StabilityLimits(
        compression=_first_loss(uniaxial, 1.0, 1.0 / furthest),
        tension=_first_loss(uniaxial, 1.0, furthest),
        equibiaxial=_first_loss(lambda s: drucker_tangent(material, s, s), 1.0, furthest),
        planar=_first_loss(lambda s: drucker_tangent(material, s, np.ones_like(s)), 1.0, furthest),
        simple_shear=_first_loss(
            lambda g: 2.0 * (material.c10 + material.c01) + 12.0 * material.c11 * g**2, 0.0, furthest
        ),
    )


@dataclass(frozen=True)
class MooneyRivlinFit:
    """A fit with what it knows and does not know.

    Attributes
    ----------
    material : MooneyRivlin
    covariance : ndarray (terms, terms)
        Of the fitted coefficients [MPa^2].
    standard_error : ndarray (3,)
        Of C10, C01, C11 [MPa]; 0 for a coefficient that was held at zero.
    rms : float
        Residual standard deviation [MPa].
    condition : float
        Condition number of the column-scaled design; above about 100 the coefficients are not separately known.
    stretch_range : tuple of float
        Of the data.
    limits : StabilityLimits
    """

    material: MooneyRivlin
    covariance: Floats
    standard_error: Floats
    rms: float
    condition: float
    stretch_range: tuple[float, float]
    limits: StabilityLimits
    degrees_of_freedom: int

    def band(self, stretch: ArrayLike, confidence: float = 0.95) -> Floats:
        """Return the half-width of the confidence band of the mean nominal stress [MPa]."""
        basis = uniaxial_basis(stretch)[..., : len(self.covariance)]
        variance = np.einsum("...i,ij,...j->...", basis, self.covariance, basis)
        return stats.t.ppf(0.5 + confidence / 2.0, self.degrees_of_freedom) * np.sqrt(variance)


def fit_mooney_rivlin(stretch: ArrayLike, nominal_stress: ArrayLike, *, terms: int = 3) -> MooneyRivlinFit:
    """Fit the coefficients to a uniaxial curve; the model is linear in them, so the fit is one least-squares problem.

    Parameters
    ----------
    stretch : array_like (n,)
        Length over undeformed length; below 1 in compression.
    nominal_stress : array_like (n,)
        Force over undeformed section [MPa]; negative in compression.
    terms : int
        1 neo-Hookean, 2 Mooney-Rivlin, 3 with the mixed term.

    Raises
    ------
    ValueError
        For fewer points than coefficients + 1, stretch outside (0, 10], or stress of the wrong sign throughout.
    """
    s, p = (np.asarray(a, dtype=float).ravel() for a in (stretch, nominal_stress))
    if terms not in (1, 2, 3):
        raise ValueError(f"{terms} terms; 1, 2 or 3 are known")
    if len(s) != len(p) or len(s) < terms + 2:
        raise ValueError(f"{len(s)} stretches and {len(p)} stresses; at least {terms + 2} of each are needed")
    if not (np.isfinite(s).all() and np.isfinite(p).all()) or s.min() <= 0 or s.max() > 10:
        raise ValueError("stretch must lie between 0 and 10, stress be finite")
    if np.sum(p * (s - 1.0)) <= 0:
        raise ValueError("stress has the wrong sign: compression (stretch below 1) is negative")
    basis = uniaxial_basis(s)[:, :terms]
    scale = np.linalg.norm(basis, axis=0)
    scaled = basis / scale
    solution, *_ = np.linalg.lstsq(scaled, p, rcond=None)
    dof = len(s) - terms
    variance = float(np.sum((scaled @ solution - p) ** 2)) / dof
    covariance = variance * np.linalg.inv(scaled.T @ scaled) / np.outer(scale, scale)
    coefficients = np.zeros(3)
    coefficients[:terms] = solution / scale
    error = np.zeros(3)
    error[:terms] = np.sqrt(np.diag(covariance))
    material = MooneyRivlin(*coefficients.tolist())
    return MooneyRivlinFit(
        material,
        covariance,
        error,
        float(np.sqrt(variance)),
        float(np.linalg.cond(scaled)),
        (float(s.min()), float(s.max())),
        stability_limits(material),
        dof,
    )


COLUMNS = (
    Column("displacement", ("extension", "position"), "length", required=False),
    Column("force", ("load",), "force", required=False),
    Column("strain", ("engineering_strain", "compression"), "ratio", required=False),
    Column("stress", ("engineering_stress", "nominal_stress"), "stress", required=False),
)


def read_compression(path: Path, *, height: float | None = None, area: float | None = None) -> tuple[Floats, Floats]:
    """Read a compression test; return (stretch, nominal stress [MPa], negative).

    Either ``strain`` and ``stress_MPa`` columns, or ``displacement_mm`` and ``force_N`` with the sample's undeformed
    height [mm] and section [mm^2]. Compression may be written positive or negative; it must be one of both throughout.
    """
    data = read_columns(path, COLUMNS)
    if "strain" in data and "stress" in data:
        strain, stress = data["strain"], data["stress"]
    elif "displacement" in data and "force" in data:
        if height is None or area is None:
            raise InputError(
                "force and displacement need the sample's size", file=path, allowed="--height-mm and --area-mm2"
            )
        if height <= 0 or area <= 0:
            raise InputError(f"height {height:g} mm, section {area:g} mm^2", key="sample", allowed="above 0")
        strain, stress = data["displacement"] / height, data["force"] / area
    else:
        raise InputError("neither strain and stress nor displacement and force", file=path)
    # The sign of a test machine's channels is a matter of taste; only the magnitude is meant.
    strain, stress = (v * (np.sign(v[np.argmax(np.abs(v))]) or 1.0) for v in (strain, stress))
    worst = int(np.argmax(strain))
    if strain[worst] >= 1.0:
        raise InputError(
            f"row {worst + 2}: compressed by {strain[worst]:.3g} of its height", file=path, allowed="below 1 (100 %)"
        )
    kept = strain > 0.0
    if kept.sum() < 5:
        raise InputError(f"{int(kept.sum())} rows with compression", file=path, allowed="at least 5")
    return 1.0 - strain[kept], -stress[kept]


def of_material(name: str) -> MooneyRivlin:
    """Return the fit that the thesis gives for a silicone (table 6).

    Raises
    ------
    InputError
        For an unknown material, or one without a compression test.
    """
    found = material(name).mooney_rivlin
    if found is None:
        known = ", ".join(n for n in material_names() if material(n).mooney_rivlin is not None)
        raise InputError(f"no compression test of {name!r}", key="material", allowed=known)
    return MooneyRivlin(found.C10_Pa * 1e-6, found.C01_Pa * 1e-6, found.C11_Pa * 1e-6)
