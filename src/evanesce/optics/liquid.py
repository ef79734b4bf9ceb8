"""Light through a liquid between glass and silicone: three media, a film many wavelengths thick.

Guided light that meets a liquid passes where the liquid's index admits it, sin(theta) < n_liquid/n_glass, and is cut
off beyond. The film is thicker than the light is coherent, so that powers add up instead of amplitudes.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from evanesce.core.states import ContactState
from evanesce.optics.interface import fresnel_reflectance
from evanesce.rig import Scene

Array = NDArray[np.float64]
OUT_OF_REACH_MM = 1.0
"""Gap between asperities in liquid, for the air film's tables: couples nothing by itself."""


def film_transmittance(cos_theta: ArrayLike, n_glass: float, n_liquid: float, n_silicone: float) -> Array:
    """Return the unpolarised power transmittance of a thick film, its two surfaces' multiple reflections summed.

    Parameters
    ----------
    cos_theta : array_like
        Cosine of the angle of incidence in the glass, 0 to 1.
    n_glass, n_liquid, n_silicone : float
        Refractive indices [1].

    Returns
    -------
    ndarray
        (1 - R12)(1 - R23)/(1 - R12 R23) of each polarisation, the mean of both; 0 beyond the critical angle.
    """
    cos1 = np.asarray(cos_theta, float)
    sin2 = 1.0 - cos1**2
    cos2 = np.sqrt(np.clip(1.0 - sin2 * (n_glass / n_liquid) ** 2, 0.0, None))
    cos3 = np.sqrt(np.clip(1.0 - sin2 * (n_glass / n_silicone) ** 2, 0.0, None))
    passes = (cos2 > 0) & (cos3 > 0)
    total = np.zeros(cos1.shape)
    for power in (1, -1):  # s: n cos, p: cos/n
        a, b, c = (n**power * cos for n, cos in ((n_glass, cos1), (n_liquid, cos2), (n_silicone, cos3)))
        first = np.divide(a - b, a + b, out=np.ones(cos1.shape), where=passes) ** 2
        second = np.divide(b - c, b + c, out=np.ones(cos1.shape), where=passes) ** 2
        both = np.where(passes, 1.0 - first * second, 1.0)
        total += 0.5 * np.where(passes, (1.0 - first) * (1.0 - second) / both, 0.0)
    return total


@lru_cache(maxsize=64)
def liquid_coupling(n_glass: float, n_liquid: float, n_silicone: float) -> float:
    """Return the coupling of guided light through a liquid over that of contact, isotropic guided radiance.

    Parameters
    ----------
    n_glass, n_liquid, n_silicone : float
        Refractive indices [1].

    Returns
    -------
    float
    """
    # d(sin^2) from the critical angle to air on; square-root edges, so many midpoints
    edges = np.linspace(1.0 / n_glass**2, 1.0, 20_001)
    cosine = np.sqrt(1.0 - 0.5 * (edges[1:] + edges[:-1]))
    contact = 1.0 - fresnel_reflectance(cosine, n_glass, n_silicone)
    return float(film_transmittance(cosine, n_glass, n_liquid, n_silicone).sum() / contact.sum())


def lit_contact(scene: Scene, state: ContactState) -> ContactState:
    """Return a contact as light sees it: where liquid bridges the gap, a share of the cell couples like contact.

    Parameters
    ----------
    scene : Scene
        As seen at the wavelength of its light.
    state : ContactState

    Returns
    -------
    ContactState
        For renderers only, its mask is no contact; the state itself without liquid.
    """
    if state.wetted is None:
        return state
    index = float(state.parameters["liquid_refractive_index"])
    share = liquid_coupling(scene.plate.refractive_index, index, scene.finger.refractive_index)
    real = 1.0 if state.real_contact_fraction is None else np.asarray(state.real_contact_fraction, float)
    mask = np.clip(np.asarray(state.contact_mask, float), 0.0, 1.0)
    dry = mask * real
    gap = np.where((mask > 0) & (dry < mask), np.maximum(state.gap, OUT_OF_REACH_MM), state.gap)
    optical = dry + (1.0 - dry) * np.asarray(state.wetted, float) * share
    # A film of air cannot couple where liquid stands.
    gap = np.where(np.asarray(state.wetted) * (mask < 1) > 0.5, np.maximum(gap, OUT_OF_REACH_MM), gap)
    return replace(state, gap=gap, contact_mask=optical, real_contact_fraction=None, wetted=None)
