"""Mechanics of a plan: its interface, its shaft, and how far a drive goes to gross slip."""

from __future__ import annotations

import math

import numpy as np

from evanesce.contact.patch import AxisymmetricContact
from evanesce.contact.sliding.shaft import tilted_compliance
from evanesce.contact.sliding.solver import spring_load
from evanesce.dataset.config import Trial
from evanesce.dataset.design import TrialPlan
from evanesce.dataset.directional import drive_factor, twist_factor
from evanesce.dataset.programme import slide_speed
from evanesce.materials.friction import InterfaceFriction

SPEED_STEPS = 8
"""Steps to the speed at which friction and the way to gross slip agree: each leaves a share of ``speed_exponent``."""


def interface(plan: TrialPlan, contact: AxisymmetricContact) -> InterfaceFriction:
    """Return the interface tau0 + alpha p of a friction coefficient at the held load: across ridges, at 1 mm/s.

    The kind ``rotation`` has the mean over the directions of its ridges.
    """
    f = plan.friction
    mean = contact.normal_force / (math.pi * contact.contact_radius**2)
    across = InterfaceFriction(
        tau0=f.adhesive_share * f.friction_coefficient * mean,
        alpha=(1.0 - f.adhesive_share) * f.friction_coefficient,
        dynamic_ratio=f.dynamic_ratio,
        weakening_distance=f.weakening_distance_mm,
        speed_exponent=f.speed_exponent,
    )
    return across.times(twist_factor(plan)) if plan.kind == "rotation" else across


def gross_slip(
    plan: TrialPlan,
    trial: Trial,
    contact: AxisymmetricContact,
    friction: InterfaceFriction,
    modulus: float,
    shaft: float,
) -> tuple[float, float]:
    """Return a drive's way from rest to gross slip [mm] and the force there [N], in a plan's direction at its speed.

    Parameters
    ----------
    plan : TrialPlan
    trial : Trial
    contact : AxisymmetricContact
    friction : InterfaceFriction
        Across ridges, at the reference speed.
    modulus : float
        G* [MPa].
    shaft : float
        Its stiffness along the drive [N/mm].
    """
    strong = friction.times(drive_factor(plan))
    found, way = strong, reach(contact, strong, modulus, shaft)
    if friction.speed_exponent:
        for _ in range(SPEED_STEPS):  # a longer way to gross slip asks for a faster slide, whose friction is higher
            found = strong.times(float(friction.speed_factor(slide_speed(plan, trial, way))))
            way = reach(contact, found, modulus, shaft)
    return way, found.tau0 * math.pi * contact.contact_radius**2 + found.alpha * contact.normal_force


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
