"""A finger stiffer or softer than its material, under every law.

A body whose stresses are all m times as large, pressed without adhesion, takes under m F the shape of the other
under F, large deformation and Coulomb friction included: contact(F, m E) = m contact(F/m, E), the factor on its
stresses alone.
"""

from __future__ import annotations

from dataclasses import replace

from evanesce.contact.patch import AxisymmetricContact
from evanesce.core.states import ContactState
from evanesce.rig import Finger


def stiffness_factor(finger: Finger, force: float) -> float:
    """Return how many times as stiff as its material the finger is under a force [N].

    Parameters
    ----------
    finger : Finger
    force : float
        [N].

    Returns
    -------
    float
    """
    return finger.modulus_factor * (1.0 + finger.stiffening_per_N * force)


def stiffened_contact(contact: AxisymmetricContact, factor: float) -> AxisymmetricContact:
    """Return a contact of the same shape whose stresses are ``factor`` times as large.

    Parameters
    ----------
    contact : AxisymmetricContact
    factor : float

    Returns
    -------
    AxisymmetricContact
    """
    if factor == 1.0:
        return contact
    within = contact.force_within
    return replace(contact, normal_force=factor * contact.normal_force, force_within=lambda r: factor * within(r))


def stiffened_state(state: ContactState, factor: float) -> ContactState:
    """Return a state of the same shape whose stresses are ``factor`` times as large.

    Parameters
    ----------
    state : ContactState
    factor : float

    Returns
    -------
    ContactState
    """
    if factor == 1.0:
        return state
    x, y = state.tangential_force
    return replace(
        state,
        pressure=factor * state.pressure,
        traction=None if state.traction is None else factor * state.traction,
        normal_force=factor * state.normal_force,
        tangential_force=(factor * x, factor * y),
    )
