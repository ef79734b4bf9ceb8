"""A slide marched one step at a time, for a drive that answers to what the contact does."""

from __future__ import annotations

import numpy as np

from evanesce.contact.patch import AxisymmetricContact
from evanesce.contact.sliding.solver import (
    SlideFrame,
    _frame,
    _rest_frame,
    _Springs,
    _step,
    spring_load,
    spring_strength,
)
from evanesce.materials.friction import InterfaceFriction


class SteppedSlide:
    """The model of :func:`~evanesce.contact.sliding.solver.march`; a rigid drive, and no loss of area.

    Parameters
    ----------
    contact : AxisymmetricContact
        At rest.
    friction : InterfaceFriction
    modulus : float
        G* [MPa].
    largest_radius : float
        Contact radius that is not exceeded [mm].
    springs : int
        Over the largest radius.

    Attributes
    ----------
    edges : ndarray (springs + 1,)
        Borders of the springs [mm].
    frame : SlideFrame
        The last one.
    """

    def __init__(
        self,
        contact: AxisymmetricContact,
        friction: InterfaceFriction,
        modulus: float,
        largest_radius: float,
        springs: int = 256,
    ) -> None:
        self._friction, self._modulus = friction, modulus
        self.edges = np.linspace(0.0, largest_radius, springs + 1)
        self._contact, self._load, self._strength = contact, *self._of(contact)
        at_rest = friction.alpha * self._load + friction.tau0 * self._strength
        self._row = _Springs(self.edges, np.zeros(springs), np.zeros(springs), np.zeros(springs), at_rest)
        self.frame: SlideFrame = _rest_frame(contact, 0.0, self._row)

    def step(self, contact: AxisymmetricContact, time: float, displacement: float) -> SlideFrame:
        """Move drive and load; return the frame.

        Parameters
        ----------
        contact : AxisymmetricContact
            Normal contact at the end of the step.
        time : float
            Of the end [s], after that of the last frame.
        displacement : float
            Of the drive [mm].
        """
        if contact is not self._contact:
            self._contact, self._load, self._strength = contact, *self._of(contact)
        elapsed = time - self.frame.time
        speed = abs(displacement - self._row.displacement) / elapsed
        factor = float(self._friction.speed_factor(speed)) if speed > 0 else 1.0
        area = np.pi * contact.contact_radius**2
        rigid, no_loss = float("inf"), 0.0
        force, moved = _step(
            self._row, self._load, self._strength, self._friction, factor, self._modulus, displacement, rigid, no_loss,
            area, elapsed, self.frame.tangential_force,
        )  # fmt: skip
        self.frame = _frame(contact, time, self._row, force, no_loss, moved, displacement, rigid)
        return self.frame

    def _of(self, contact: AxisymmetricContact) -> tuple[np.ndarray, np.ndarray]:
        return spring_load(contact, self.edges), spring_strength(contact.contact_radius, self.edges)
