"""Friction of a trial by the direction of its finger's ridges."""

from __future__ import annotations

import math

from scipy.special import ellipe

from evanesce.contact.sliding.friction_ellipse import directional_friction
from evanesce.dataset.design import TrialPlan


def ridge_friction(plan: TrialPlan) -> tuple[float, float]:
    """Return friction along the ridges over that across them, and the ridges' angle on the finger [rad].

    Parameters
    ----------
    plan : TrialPlan

    Returns
    -------
    ratio, angle : float
    """
    return plan.friction.ridge_friction_ratio, math.radians(plan.finger.ridge_orientation_deg)


def drive_factor(plan: TrialPlan) -> float:
    """Return the friction along a plan's drive over that across the ridges; the largest, where its direction changes.

    Parameters
    ----------
    plan : TrialPlan
    """
    ratio, angle = ridge_friction(plan)
    if "turn_deg" in plan.motion or "torsion_deg" in plan.motion:
        return max(ratio, 1.0)
    return directional_friction(ratio, angle - math.radians(plan.programme["direction_deg"]))[0]


def twist_factor(plan: TrialPlan) -> float:
    """Return the friction of a finger that turns in place over that across the ridges: a mean over all directions.

    Parameters
    ----------
    plan : TrialPlan

    Notes
    -----
    The power of friction of a skin that moves along t is |M t| of the :class:`friction ellipse
    <evanesce.contact.sliding.friction_ellipse.FrictionEllipse>`; its mean over a circle is an elliptic integral.
    """
    return 2.0 / math.pi * float(ellipe(1.0 - ridge_friction(plan)[0] ** 2))
