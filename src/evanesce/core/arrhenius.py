"""Arrhenius' law: how a thermally activated rate changes with temperature."""

from __future__ import annotations

import numpy as np
from scipy.constants import Boltzmann, elementary_charge, zero_Celsius

BOLTZMANN_eV_PER_K = Boltzmann / elementary_charge


def rate_factor(energy_eV: float, from_C: float, to_C: float) -> float:
    """Return exp(E/k (1/T_from - 1/T_to)), by which a rate is larger at another temperature.

    Parameters
    ----------
    energy_eV : float
        Activation energy [eV]; 0: the rate does not depend on temperature.
    from_C, to_C : float
        [degC].

    Returns
    -------
    float
        [1].
    """
    return float(np.exp(energy_eV / BOLTZMANN_eV_PER_K * (1.0 / (from_C + zero_Celsius) - 1.0 / (to_C + zero_Celsius))))


def activation_energy(factor: float, from_C: float, to_C: float) -> float:
    """Return the activation energy by which a rate is ``factor`` times as large at another temperature [eV].

    Parameters
    ----------
    factor : float
        [1].
    from_C, to_C : float
        [degC].
    """
    return float(BOLTZMANN_eV_PER_K * np.log(factor) / (1.0 / (from_C + zero_Celsius) - 1.0 / (to_C + zero_Celsius)))
