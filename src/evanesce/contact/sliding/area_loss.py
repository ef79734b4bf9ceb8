"""Loss of contact area under shear (Sahli et al. 2018)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]


def area_under_shear(area: ArrayLike, tangential_force: ArrayLike, area_loss: float) -> Floats:
    """Return A = A_0 - alpha_A Q^2 [mm^2].

    Parameters
    ----------
    area : array_like
        A_0 [mm^2] without shear.
    tangential_force : array_like
        Q [N].
    area_loss : float
        alpha_A [mm^2/N^2], >= 0.

    Returns
    -------
    ndarray
        [mm^2].

    Raises
    ------
    ValueError
        Where nothing would be left.

    References
    ----------
    R. Sahli et al., PNAS 115 (2018) 471.
    """
    left = np.asarray(area, dtype=float) - area_loss * np.asarray(tangential_force, dtype=float) ** 2
    if area_loss < 0 or np.any(left < 0):
        raise ValueError("the shear would take more area than there is: outside the law's range")
    return left


def area_loss_scaled(area: ArrayLike, loss_at_reference: float, reference_area: float) -> Floats:
    """Return alpha_A = alpha_ref (A_0/A_ref)^(-3/2), found over four decades of area (Sahli et al. 2018).

    Parameters
    ----------
    area : array_like
        A_0 [mm^2].
    loss_at_reference : float
        alpha_ref [mm^2/N^2].
    reference_area : float
        A_ref [mm^2].

    Returns
    -------
    ndarray
        [mm^2/N^2].
    """
    return loss_at_reference * (np.asarray(area, dtype=float) / reference_area) ** -1.5


def area_loss_for(area: float, sliding_force: float, remaining: float) -> float:
    """Return the alpha_A at which a share of the area remains under the force of full sliding.

    Parameters
    ----------
    area : float
        Without shear [mm^2].
    sliding_force : float
        [N].
    remaining : float
        Share of the area, in (0, 1].

    Returns
    -------
    float
        [mm^2/N^2].

    Raises
    ------
    ValueError
        For values out of range.
    """
    if not 0.0 < remaining <= 1.0 or sliding_force <= 0 or area <= 0:
        raise ValueError("area and force must be positive, the remaining share in (0, 1]")
    return area * (1.0 - remaining) / sliding_force**2
