"""Compression tests: read a lab's file, fit the Mooney-Rivlin law with its uncertainty."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import stats

from evanesce.core.columns import Column, read_columns
from evanesce.core.errors import InputError
from evanesce.materials.hyperelastic import MooneyRivlin, StabilityLimits, stability_limits, uniaxial_basis

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class MooneyRivlinFit:
    """Fitted Mooney-Rivlin coefficients with their uncertainty.

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
    degrees_of_freedom : int
        Data less coefficients.
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
        """Return the half-width of the confidence band of the mean nominal stress.

        Parameters
        ----------
        stretch : array_like
            Any shape.
        confidence : float
            0 to 1.

        Returns
        -------
        ndarray
            [MPa].
        """
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

    Returns
    -------
    MooneyRivlinFit

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
    """Read a compression test.

    Parameters
    ----------
    path : Path
        CSV with ``strain`` and ``stress_MPa`` columns, or ``displacement_mm`` and ``force_N`` with the sample's size.
        Compression may be positive or negative; it must be one of both throughout.
    height, area : float, optional
        Of the undeformed sample [mm] and its section [mm^2].

    Returns
    -------
    stretch, nominal_stress : ndarray (n,)
        Below 1; [MPa], negative.

    Raises
    ------
    InputError
        For missing columns or sizes, compression by the whole height, or fewer than 5 rows with compression.
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
    # Test machines differ in the sign of their channels; only the magnitude counts.
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
