"""For which unpublished parameters the thesis's observation on voltage holds, and where the area error is smallest.

Every sample of the unknowns is a rig of its own: contact, fast light on the contact grid (without a camera's pixels),
a blur as wide as lens and chain together, exposure, tone curve, threshold. Variance is attributed by Sobol' indices.
Contact and light depend on some unknowns only, and samples that share those share them.

References
----------
A. Saltelli, P. Annoni, I. Azzini, F. Campolongo, M. Ratto and S. Tarantola, "Variance based sensitivity analysis of
model output", Computer Physics Communications 181 (2010) 259.
W. Usher et al., "SALib", Journal of Open Source Software 2(9) (2017) 97, doi:10.21105/joss.00097.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.core.extras import require

Array = NDArray[np.float64]

GRID_MM, GRID_SAMPLES = 12.8, 400
THRESHOLDS = (0.0375, 0.05, 0.075, 0.1, 0.15, 0.2, 0.25, 0.3, 0.35, 0.4, 0.45, 0.5, 0.55, 0.6, 0.7, 0.8, 0.9)
"""Grey levels among which the best is sought; four of them are in use in the thesis."""

RATIOS = tuple(float(r) for r in np.round(np.arange(0.05, 1.0, 0.05), 2))
"""Linear light over the contact's own mean at which the area is cut, free of voltage and exposure."""

SEEN = 0.05
"""Share of the true area below which there is nothing to segment."""
FLAT = 0.05
"""Change of the estimate, relative to the last voltage, within which it has converged."""


@dataclass(frozen=True)
class Unknown:
    """A figure that the thesis does not publish (or that may differ at the ridges' scale), and where it may lie."""

    name: str
    low: float
    high: float
    unit: str
    logarithmic: bool
    why: str
    choices: int = 0
    """Whole numbers from 0 to one less, in place of a range; 0: a range."""

    def value(self, share: Array) -> Array:
        """Return values at shares 0 to 1 of the range.

        Parameters
        ----------
        share : ndarray
            0 to 1.

        Returns
        -------
        ndarray
            In the unknown's unit.
        """
        if self.choices:
            return np.minimum(np.floor(np.asarray(share, float) * self.choices), self.choices - 1.0)
        if self.logarithmic:
            return np.asarray(self.low * (self.high / self.low) ** share)
        return np.asarray(self.low + (self.high - self.low) * share)


UNKNOWNS = (
    Unknown("scattering_length", 0.25, 2.0, "mm", True, "PDMS phantoms 0.5 to 2 mm; deadened silicone less"),
    Unknown("ridge_pitch", 0.6, 1.5, "mm", True, "not published; ridges are 0.5 mm wide"),
    Unknown("reduced_modulus", 0.3, 6.0, "MPa", True, "0.77 by Hertz on glass, 1.8 in indentation"),
    Unknown("forward_voltage", 2.8, 3.3, "V", False, "bins of white LEDs at 20 mA"),
    Unknown("exposure", 1.0, 33.0, "ms", True, "not published; at most a frame's time at 30 Hz"),
    Unknown("threshold", 0.0375, 0.6, "1", True, "by hand; 0.0375, 0.15, 0.35 and 0.6 are in use"),
)  # fmt: skip
SHAPING = 3
"""The first so many unknowns change contact or light; the others only scale the light or cut it."""


THRESHOLD = 5
"""Place of the sample's own threshold."""


@dataclass(frozen=True)
class Plan:
    """Settings of the samples.

    Attributes
    ----------
    forces, voltages : tuple of float
        [N], [V], ascending.
    base : int
        N of the Saltelli sample, a power of two; N (unknowns + 2) samples in all.
    seed : int
    unknowns : tuple of Unknown
        The first :data:`SHAPING` of them change contact or light.
    """

    forces: tuple[float, ...]
    voltages: tuple[float, ...]
    base: int = 64
    seed: int = 1
    unknowns: tuple[Unknown, ...] = UNKNOWNS

    def shares(self) -> Array:
        """Return the sample, (samples, unknowns), as shares of each range.

        Returns
        -------
        ndarray (samples, unknowns)
        """
        require("design", "a sample of the unknowns", "SALib")
        from SALib.sample import sobol  # type: ignore[import-untyped]

        return np.asarray(sobol.sample(problem(self.unknowns), self.base, calc_second_order=False, seed=self.seed))


def problem(unknowns: tuple[Unknown, ...] = UNKNOWNS) -> dict[str, Any]:
    """Return the unknowns as SALib wants them, each from 0 to 1.

    Parameters
    ----------
    unknowns : tuple of Unknown

    Returns
    -------
    dict
    """
    names = [u.name for u in unknowns]
    return {"num_vars": len(names), "names": names, "bounds": [[0.0, 1.0]] * len(names)}


@dataclass(frozen=True)
class Samples:
    """Areas of all samples.

    Attributes
    ----------
    plan : Plan
    values : ndarray (samples, unknowns)
        In the unknowns' units.
    true_area : ndarray (samples, forces)
        [mm^2].
    own : ndarray (samples, forces, voltages)
        Area at the sample's own threshold [mm^2].
    area : ndarray (samples, forces, voltages, thresholds)
        [mm^2].
    by_ratio : ndarray (samples, forces, RATIOS)
        Area brighter than that share of the contact's own mean light [mm^2].
    open_middle : ndarray of bool (samples, forces)
        Whether the grooves next to the middle are open.
    contact : ndarray (samples, forces, voltages), optional
        In colour: mean light of the contact at the sample's exposure, over what fills a raw red pixel [1].
    other : dict of ndarray (samples, forces, voltages)
        In colour: area at the sample's own threshold by other readings [mm^2]; 0 in rows that are not independent.
    """

    plan: Plan
    values: Array
    true_area: Array
    own: Array
    area: Array
    by_ratio: Array
    open_middle: NDArray[np.bool_]
    contact: Array | None = None
    other: Mapping[str, Array] = field(default_factory=dict)

    @property
    def independent(self) -> NDArray[np.intp]:
        """Rows that are independent of each other: A and B of each of Saltelli's blocks."""
        return independent_rows(len(self.values), len(self.plan.unknowns))


def independent_rows(samples: int, unknowns: int) -> NDArray[np.intp]:
    """Return the rows of a Saltelli sample that are independent of each other: A and B of each block.

    Parameters
    ----------
    samples, unknowns : int

    Returns
    -------
    ndarray of int
    """
    starts = np.arange(0, samples, unknowns + 2)
    return np.sort(np.concatenate([starts, starts + unknowns + 1]))
