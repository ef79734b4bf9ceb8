"""State of the ridges' grooves in the middle of a scene's contact."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from evanesce.contact.solve import contact_state
from evanesce.rig import Scene
from evanesce.studies.voltage.reduced_rig import middle_open


@dataclass(frozen=True, kw_only=True)
class Grooves:
    """State of the grooves in the middle of the scene's contact.

    Attributes
    ----------
    force_N, reduced_modulus_MPa : float
    peak_pressure_MPa : float
        Of the smooth finger, by Hertz.
    closure_pressure_MPa : float
        Mean pressure that closes the grooves.
    open_middle : bool
    contact_share : float
        True area over that of the smooth finger.
    """

    force_N: float
    reduced_modulus_MPa: float
    peak_pressure_MPa: float
    closure_pressure_MPa: float
    open_middle: bool
    contact_share: float


def grooves(scene: Scene, force: float) -> Grooves:
    """Return the state of the grooves of a scene with an analytic law under a force [N].

    Parameters
    ----------
    scene : Scene
    force : float
        [N].

    Returns
    -------
    Grooves
    """
    state = contact_state(scene, force)
    modulus = float(state.parameters.get("reduced_modulus_MPa", float("nan")))
    radius = scene.finger.tip_radius_mm
    ridges = scene.finger.ridges
    pitch = 1e-3 * ridges.pitch_um if ridges else 0.0
    cell = scene.grid.size_mm / scene.grid.samples
    smooth = float(np.pi * (0.75 * force * radius / modulus) ** (2 / 3))
    return Grooves(
        force_N=force,
        reduced_modulus_MPa=modulus,
        peak_pressure_MPa=1.5 * force / smooth if smooth > 0 else 0.0,
        closure_pressure_MPa=float(state.parameters.get("ridge_closure_pressure_MPa", float("nan"))),
        open_middle=middle_open(np.asarray(state.contact_mask), pitch / cell),
        contact_share=state.nominal_contact_area / smooth if smooth > 0 else float("nan"),
    )
