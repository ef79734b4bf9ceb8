"""Light beside the contact for the fast camera: what depends on the approach alone, imaged once and kept.

Of the light of :mod:`evanesce.render.fast.surroundings` the contact only hides a part, S: haze on the top face, flank,
backdrop. The rest, B, nothing hides. With the contact's cover c a frame receives blur((1 - c) S + B), which is

    blur(S + B) - blur(c S):

the first depends on the approach alone, the second is confined to the contact.
"""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from evanesce.chain.fast_optics import charge_per_irradiance
from evanesce.core.states import ContactState, PlateLight
from evanesce.optics.projection import Projection
from evanesce.render.fast.flank_table import flank_cover, flank_step, rounded_approach
from evanesce.render.fast.surroundings import surroundings_on_flank, surroundings_view
from evanesce.rig import Scene
from evanesce.sensor.lens import form_image

Image = NDArray[np.float32]

KEPT = 8
"""Approaches whose images are kept: 24 MB each at 2000 x 1500 pixels."""


@dataclass(frozen=True)
class Beside:
    """Mean charge of a frame by the light beside the contact.

    Attributes
    ----------
    whole : ndarray of float32 (rows, cols)
        blur(S + B) [e-].
    hidden : ndarray of float32 (rows, cols)
        S, not blurred: what a contact that covers everything would hide [e-].
    """

    whole: Image
    hidden: Image

    @classmethod
    def of(cls, scene: Scene, state: ContactState | None) -> Beside:
        """Image the light beside a contact, by the general chain.

        Parameters
        ----------
        scene : Scene
            With ``surroundings``.
        state : ContactState or None
            Only its approach counts; None: no finger.

        Returns
        -------
        Beside
        """
        view = Projection.of(scene.camera, scene.plate).ideal_view()
        around = surroundings_view(scene, view, finger=state is not None)
        hidden = around.top + around.backdrop
        if state is not None:
            step = flank_step(scene.camera.scale_px_per_mm)
            cover = flank_cover(scene, state, view, step=step)
            hidden = around.top + (1.0 - cover) * around.backdrop + surroundings_on_flank(scene, state, view, step)

        def charge(radiance: Image, *, blurred: bool) -> Image:
            light = PlateLight(
                radiance=radiance, variance=np.zeros((1, 1)), focal_px=view.focal_px,
                principal_point=view.principal_point, samples=0,
            )  # fmt: skip
            seen = form_image(light, scene.camera, scene.plate, blurred=blurred).irradiance
            return np.asarray(seen * charge_per_irradiance(scene), np.float32)

        return cls(charge(hidden + around.bottom, blurred=True), charge(hidden, blurred=False))


@dataclass
class KeptBeside:
    """Images of a scene's light beside the contact, of the last approaches.

    Attributes
    ----------
    scene : Scene
    """

    scene: Scene
    _kept: OrderedDict[float | None, Beside] = field(default_factory=OrderedDict, repr=False)

    def at(self, state: ContactState | None) -> Beside:
        """Return the images of a state's approach, to a tenth of a millimetre as those of the flank.

        Parameters
        ----------
        state : ContactState or None
        """
        mm = None if state is None else rounded_approach(self.scene, state)
        if mm not in self._kept:
            if len(self._kept) >= KEPT:
                self._kept.popitem(last=False)
            self._kept[mm] = Beside.of(self.scene, None if state is None or mm is None else replace(state, depth=mm))
        self._kept.move_to_end(mm)
        return self._kept[mm]
