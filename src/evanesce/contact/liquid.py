"""A liquid about the contact: where it stands, and what it leaves of friction.

At rest a wetting liquid fills the narrowest gaps first, as capillary pressure falls with the gap: it stands wherever
the gap is below one height, that at which its volume is used up. At speed it is drawn into the contact: a film of the
central thickness of isoviscous-elastic lubrication (Hamrock and Dowson 1978)

    h/R = 7.32 (1 - 0.72 exp(-0.28)) U^0.64 W^-0.22,   U = eta u/(E' R),  W = F/(E' R^2),

u half the sliding speed, E' = 2 E*. Asperities of Gaussian height of standard deviation s reach through it by the share
erfc(h/(s sqrt 2)) of those that touch without it, and keep that share of dry friction; sheared liquid adds eta v/h on
the area. That is the curve of Stribeck: boundary, mixed, full film.

The film is no thicker than the volume on the contact's area, and less than fills the roughness is sheared in that share
of it. The asperities' share is that of the steady speed, so that no peak of static friction precedes the slide.

No squeeze flow, no capillary force: for water on a tip of 7.5 mm it is at most
4 pi R gamma = 7 mN.

References: B. J. Hamrock and D. Dowson, J. Lubrication Tech. 100 (1978) 236; J. A. Greenwood and J. B. P. Williamson,
Proc. R. Soc. A 295 (1966) 300 (Gaussian heights); R. Stribeck, Z. VDI 46 (1902) 1341.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import erfc

from evanesce.core.states import ContactState
from evanesce.materials.friction import InterfaceFriction
from evanesce.rig.liquid import Liquid

Floats = NDArray[np.float64]
PA_S_IN_MPA_S = 1e-6


def fill_height(gap: Floats, cell_mm2: float, volume_mm3: float) -> float:
    """Return the gap below which a volume fills everything outside contact [mm].

    Parameters
    ----------
    gap : ndarray
        Outside contact [mm].
    cell_mm2 : float
        Area of a sample.
    volume_mm3 : float

    Returns
    -------
    float
        The largest gap where there is more liquid than room on the grid.
    """
    heights = np.sort(gap[np.isfinite(gap)], axis=None)
    filled = np.cumsum(heights) * cell_mm2
    count = int(np.searchsorted(filled, volume_mm3, side="right"))
    if count >= heights.size:
        return float(heights[-1]) if heights.size else 0.0
    below, low = (filled[count - 1], heights[count - 1]) if count else (0.0, 0.0)
    return float(low + (heights[count] - low) * (volume_mm3 - below) / (filled[count] - below))


def wetted_state(state: ContactState, liquid: Liquid) -> ContactState:
    """Put a liquid about a contact: the share of each cell that it bridges from glass to silicone.

    Parameters
    ----------
    state : ContactState
    liquid : Liquid

    Returns
    -------
    ContactState
        With ``wetted``; the state itself without liquid. Contact and its area are what they were; ``liquid_left_uL`` is
        what finds no room on the grid.
    """
    if liquid.volume_uL == 0.0:
        return state
    mask, gap = np.asarray(state.contact_mask, dtype=float), np.asarray(state.gap, dtype=float)
    dry = mask < 1.0
    room = np.maximum(gap[dry & np.isfinite(gap)], 0.0)
    height = fill_height(room, state.grid.pitch**2, liquid.volume_uL)
    left = max(liquid.volume_uL - float(room.sum()) * state.grid.pitch**2, 0.0)
    # The rim crosses a cell over as much of a gap as the cell's own slope spans.
    slope = np.hypot(*np.gradient(np.where(np.isfinite(gap), gap, 2.0 * height), state.grid.pitch)) * state.grid.pitch
    inside = np.clip(0.5 + (height - gap) / np.maximum(slope, 1e-12), 0.0, 1.0)
    named = {"liquid_height_mm": height, "liquid_refractive_index": liquid.refractive_index, "liquid_left_uL": left}
    return replace(state, wetted=np.where(dry, inside, 1.0), parameters={**state.parameters, **named})


@dataclass(frozen=True)
class LubricatedFriction(InterfaceFriction):
    """Dry friction of which a film leaves a share, and which it adds its own shear to.

    Attributes
    ----------
    viscosity : float
        [MPa s].
    roughness : float
        [mm].
    film_at_1 : float
        Thickness of the film at 1 mm/s [mm].
    pressure : float
        Mean over the contact [MPa].
    supply : float
        Volume over the contact's area: no film is thicker [mm].
    """

    viscosity: float = 0.0
    roughness: float = 1.0
    film_at_1: float = 0.0
    pressure: float = 1.0
    supply: float = math.inf

    def film(self, speed: float) -> float:
        """Return the thickness of the film [mm].

        Parameters
        ----------
        speed : float
            [mm/s].

        Returns
        -------
        float
        """
        return min(self.film_at_1 * speed**0.64, self.supply)

    def speed_factor(self, speed: object) -> Floats:
        """Return friction over dry friction at rest: the asperities' share by speed, and the liquid's shear.

        Parameters
        ----------
        speed : array_like
            [mm/s], above 0.

        Returns
        -------
        ndarray
        """
        v = np.asarray(speed, dtype=float)
        film = np.minimum(self.film_at_1 * v**0.64, self.supply)
        share = erfc(film / (self.roughness * math.sqrt(2.0)))
        # A film thinner than the roughness is sheared between the asperities' flanks.
        wet = min(self.supply / self.roughness, 1.0)
        shear = wet * self.viscosity * v / np.maximum(film, self.roughness)
        return np.asarray(super().speed_factor(v) * share + shear / (self.tau0 + self.alpha * self.pressure))


def lubricated(
    friction: InterfaceFriction, liquid: Liquid, *, force: float, area: float, radius: float, modulus: float
) -> InterfaceFriction:
    """Return the friction of a wet interface; the dry one itself without liquid.

    Parameters
    ----------
    friction : InterfaceFriction
        Dry.
    liquid : Liquid
    force : float
        Normal [N].
    area : float
        Of contact [mm^2].
    radius : float
        Of the tip [mm].
    modulus : float
        E* [MPa].

    Returns
    -------
    InterfaceFriction
    """
    if liquid.volume_uL == 0.0:
        return friction
    stiff, viscosity = 2.0 * modulus, 1e-3 * PA_S_IN_MPA_S * liquid.viscosity_mPa_s
    speed, load = viscosity * 0.5 / (stiff * radius), force / (stiff * radius**2)
    film = radius * 7.32 * (1.0 - 0.72 * math.exp(-0.28)) * speed**0.64 * load**-0.22
    own = {name: getattr(friction, name) for name in InterfaceFriction.__dataclass_fields__}
    return LubricatedFriction(
        **own, viscosity=viscosity, roughness=1e-3 * liquid.roughness_um, film_at_1=film, pressure=force / area,
        supply=liquid.volume_uL / area,
    )  # fmt: skip
