"""The believed rig predicted as finely as its pixels need, to put right what the quick predictor's resolution leaves.

The quick predictor (:mod:`evanesce.prediction.predict`) blurs pictures of the model camera's own pixels. A lens that
is sharper than those, the edge of contact, and a tone curve that bends within a pixel of the model camera are all
beyond it; each of them would be found as a cause. Here light is gathered by pixels at least three times finer, and
added up to the real pixels before charge and tone, and to the model's only after.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.prediction.kept import Kept
from evanesce.prediction.point import Point
from evanesce.prediction.predict import Predictor
from evanesce.prediction.processes import Recipe
from evanesce.prediction.views import View, binned
from evanesce.rig import Scene

Array = NDArray[Any]

FINE_PX, CARD_PX = 3, 4
"""Of finer pixels along each of the model camera's. A card's edges lie along rows of pixels and its ink is sharp."""

RAYS, CARD_RAYS = 2, 1
"""Of the pinhole view along each finer pixel; along a real pixel that is fine enough, one, as when it is simulated. A
card's reflectance is a mean over each of them."""

KEEP_LIGHTS = 2
"""Of the plate's light on the finer view, and of its images: tens of megabytes each."""

GRID_SAMPLES = 1024
"""Of the contact grid of a smooth finger."""

PLACE_MM = 0.1
"""Places of the finger whose plate light is made; between them a contact is moved under the nearest one's."""


class FinePredictor(Predictor):
    """Predicts bins as :class:`Predictor` does, but for a resolution that does not show.

    Parameters
    ----------
    believed : Scene
        With the real camera.
    views : sequence of View
    factor : int
        By how much real frames are averaged down for the model camera.
    noise_scale : float
        See :class:`Predictor`.
    fine_px : int
        See :data:`FINE_PX`.
    rays : int
        See :data:`RAYS`.
    """

    def __init__(
        self,
        believed: Scene,
        views: Sequence[View],
        factor: int,
        *,
        noise_scale: float = 1.0,
        fine_px: int = FINE_PX,
        rays: int = RAYS,
    ) -> None:
        self.factor, before = factor, math.ceil(fine_px / factor)
        samples = believed.grid.samples
        if believed.finger.ridges is None:
            samples = min(max(samples, 1), GRID_SAMPLES)
        grid = believed.grid.model_copy(update={"samples": samples})
        # On the real pixels it is the chain of `evanesce simulate`, ray for ray.
        finer = 1 if before == 1 else rays * before
        real = believed.model_copy(update={"grid": grid})
        super().__init__(real, views, finer=finer, noise_scale=noise_scale, before=before)
        options = {"believed": believed, "views": self.views, "factor": factor, "noise_scale": noise_scale}
        self.recipe = Recipe(FinePredictor, {**options, "fine_px": fine_px, "rays": rays})
        self.flank_step = None
        self._lights, self._images = Kept(KEEP_LIGHTS), Kept(KEEP_LIGHTS)

    def side(self, view: View) -> int:
        """Return how many smaller pixels along one of the scene's gather any view's light."""
        return self.before

    def cube(self, point: Point, only: Sequence[int] | None = None) -> Array:
        """Return the predicted means of the bins (views, rows, cols) [DN]; NaN in views that are not in ``only``."""
        return binned(self.frames(point, only))

    def frames(self, point: Point, only: Sequence[int] | None = None) -> Array:
        """Return mean frames (views, rows, cols) at the model camera's pixels [DN]; NaN beside ``only``."""
        return super().cube(point, only).astype(np.float32)

    def _bins_of(self, picture: Array) -> Array:
        return binned(picture, self.factor)


def in_pixels(point: Point, smaller: float) -> dict[str, float]:
    """Return a point with the effects' lengths in pixels counted in pixels so many times smaller."""
    return {
        name: value * smaller if ":" in name and "_px" in name.partition(":")[2] else value
        for name, value in point.items()
    }


def placed(scene: Scene, shift_mm: tuple[float, float]) -> Scene:
    """Return a scene with the finger beside its believed place."""
    x, y = scene.finger.position_mm
    there = (x + shift_mm[0], y + shift_mm[1])
    return scene.model_copy(update={"finger": scene.finger.model_copy(update={"position_mm": there})})


class FineFrames:
    """The fine prediction at a point: bins of all views, and their whole frames.

    The plate's light is that of the finger's fitted place, of each session its own, to :data:`PLACE_MM`: it takes
    seconds, and another bundle of the same rig may find it on disk.

    Parameters
    ----------
    believed, views, factor, noise_scale
        See :class:`FinePredictor`.
    point : mapping
        Lengths in pixels are the model camera's.
    fixed : mapping, optional
        Settings of effects that the scene does not have: :attr:`evanesce.prediction.predict.Predictor.fixed`.
    fine_px : int
        See :data:`FINE_PX`.
    """

    def __init__(
        self,
        believed: Scene,
        views: Sequence[View],
        factor: int,
        point: Point,
        *,
        noise_scale: float = 1.0,
        fixed: Mapping[str, Mapping[str, Any]] | None = None,
        fine_px: int = FINE_PX,
    ) -> None:
        if not views:
            raise ValueError("no view to predict")
        self.believed, self.views, self.factor = believed, tuple(views), factor
        self._predictors: dict[tuple[int, bool], tuple[FinePredictor, dict[str, float]]] = {}
        for session, card in sorted({_kind(v) for v in views}):
            names = [f"@pose_{axis}[{session}]" for axis in "xy"]
            shift = [point.get(name, 0.0) for name in names]
            near = tuple(PLACE_MM * round(s / PLACE_MM) for s in shift)
            rest = {**point, **{name: s - n for name, s, n in zip(names, shift, near, strict=True)}}
            there, rays = placed(believed, (near[0], near[1])), CARD_RAYS if card else RAYS
            fine = FinePredictor(there, views, factor, noise_scale=noise_scale, fine_px=fine_px, rays=rays)
            fine.fixed = dict(fixed or {})
            self._predictors[session, card] = fine, in_pixels(rest, factor)

    def cube(self) -> Array:
        """Return the bins (views, rows, cols) [DN]."""
        return binned(self.frames())

    def frames(self) -> Array:
        """Return mean frames (views, rows, cols) at the model camera's pixels, float32 [DN]."""
        found: Array | None = None
        for kind, (fine, rest) in self._predictors.items():
            chosen = [k for k, v in enumerate(self.views) if _kind(v) == kind]
            part = fine.frames(rest, chosen)
            found = np.full_like(part, np.nan) if found is None else found
            found[chosen] = part[chosen]
        assert found is not None
        return found

    def picture(self, number: int) -> Array:
        """Return the mean frame (real rows, real cols) of a view [DN]."""
        fine, rest = self._predictors[_kind(self.views[number])]
        return fine.image(rest, number)


def _kind(view: View) -> tuple[int, bool]:
    """Return what views have to share to be predicted by one predictor: the session, and whether they show a card."""
    return view.session, view.is_card
