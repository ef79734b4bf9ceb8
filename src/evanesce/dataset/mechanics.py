"""Mechanics of a plan: its interface, its shaft, and how far a drive goes to gross slip."""

from __future__ import annotations

import math

import numpy as np

from evanesce.contact.patch import AxisymmetricContact
from evanesce.contact.sliding.shaft import tilted_compliance
from evanesce.contact.sliding.solver import spring_load
from evanesce.dataset.design import TrialPlan
from evanesce.materials.friction import InterfaceFriction


def interface(plan: TrialPlan, contact: AxisymmetricContact) -> InterfaceFriction:
    """Return the interface tau0 + alpha p of a friction coefficient at the held load."""
    f = plan.friction
    mean = contact.normal_force / (math.pi * contact.contact_radius**2)
    return InterfaceFriction(
        tau0=f.adhesive_share * f.friction_coefficient * mean,
        alpha=(1.0 - f.adhesive_share) * f.friction_coefficient,
        dynamic_ratio=f.dynamic_ratio,
        weakening_distance=f.weakening_distance_mm,
    )


def reach(contact: AxisymmetricContact, friction: InterfaceFriction, modulus: float, shaft: float) -> float:
    """Return the way of a drive from rest to gross slip [mm]: the innermost spring's, and the shaft's under full force.

    Parameters
    ----------
    contact : AxisymmetricContact
    friction : InterfaceFriction
        Its static strength; weakening on the way shortens it.
    modulus : float
        G* [MPa].
    shaft : float
        Its stiffness along the drive [N/mm].
    """
    a, width = contact.contact_radius, 1e-3 * contact.contact_radius
    innermost = float(spring_load(contact, np.array([0.0, width]))[0])
    tip = (friction.alpha * innermost + friction.tau0 * 2.0 * a) / modulus
    return tip + (friction.tau0 * math.pi * a**2 + friction.alpha * contact.normal_force) / shaft


def shaft_stiffness(plan: TrialPlan) -> float:
    """Return the stiffness of the tilted shaft along the slide [N/mm]."""
    angle = math.radians(plan.programme["contact_angle_deg"])
    f = plan.finger
    return 1.0 / float(tilted_compliance(f.axial_stiffness_N_per_mm, f.shaft_stiffness_N_per_mm, angle)[0, 0])
