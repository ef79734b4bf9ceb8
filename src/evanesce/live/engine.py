"""Compute frame, mask, ground truth and figures of a setting at the rate of a slider; unchanged parts are cached."""

from __future__ import annotations

import time
from collections import OrderedDict
from collections.abc import Callable, Hashable
from dataclasses import dataclass, replace
from typing import Any, Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

from evanesce.chain.fast import FastCamera
from evanesce.chain.simulate import simulate, solve_contact
from evanesce.core.states import ContactState
from evanesce.evaluation.labels import RectifiedView, view_geometry
from evanesce.evaluation.perfect_view import PerfectView
from evanesce.live.controls import DEFAULT_RIDGES, Controls, controls_of, scene_at_resolution, scene_of
from evanesce.live.figures import Figures, Histogram, Profile, figures_of, histogram_of, profile_of, single_grey
from evanesce.live.truth_view import ContactShare
from evanesce.measurement.reference.segment import Crop, segment
from evanesce.optics.projection import Projection
from evanesce.optics.seen import seen_at
from evanesce.render.fast.transport import render_fast
from evanesce.rig import Scene

Image = NDArray[np.uint8]
Share = NDArray[np.float32]
T = TypeVar("T")

CACHE_SIZES = {"base": 8, "scene": 8, "view": 2, "contact": 32, "frame": 4, "share": 32}
"""Number of cached values of each kind: views of one camera take some 60 MB at full resolution."""

ZOOMS_MM = (1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.5, 8.0, 10.0, 13.0)
"""Half the height of the enlarged window [mm]: the smallest step that leaves a margin around the contact."""

MARGIN = 1.25
"""Smallest half height over the radius of a disc of the contact's area."""


@dataclass(frozen=True, kw_only=True)
class Shown:
    """Results of one setting.

    Attributes
    ----------
    controls : Controls
    scene : Scene
        At the resolution shown.
    frame : ndarray of uint8 (rows, cols)
        As the camera takes it [DN].
    view : ndarray of uint8 (rows, cols)
        Undistorted [DN]; the measured image.
    mask, truth : ndarray (rows, cols)
        Mask of the segmentation (bool), and true share of each pixel of ``view`` in contact.
    rectified : RectifiedView
        Geometry of ``view`` in ``frame``.
    window : Crop
        Part of ``view`` about the finger's tip that is shown enlarged.
    mm_per_px : float
        Of ``view`` at the tip [mm].
    tip : tuple of float
        (row, col) of the finger's tip in ``view``.
    figures, histogram, profile
        For the page.
    seconds : dict
        Wall time of the parts [s].
    note : str
        Why it took long, if the fast camera could not be used; else empty.
    """

    controls: Controls
    scene: Scene
    frame: Image
    view: Image
    mask: NDArray[np.bool_]
    truth: Share
    rectified: RectifiedView
    window: Crop
    mm_per_px: float
    tip: tuple[float, float]
    figures: Figures
    histogram: Histogram
    profile: Profile
    seconds: dict[str, float]
    note: str


@dataclass(frozen=True)
class _View:
    """One camera's undistorted view: of the nominal model and of the rig with its effects."""

    perfect: PerfectView
    shares: ContactShare

    @classmethod
    def of(cls, nominal: Scene, true: Scene, state: ContactState) -> _View:
        perfect = PerfectView.of(nominal)
        projection = Projection.of(true.camera, true.plate)
        return cls(perfect, ContactShare(view_geometry(projection, perfect.view), state.grid))


def window_around(view: PerfectView, area_mm2: float) -> Crop:
    """Return a window of 4 : 3 about the finger's tip, within the view, that holds a contact of an area [mm^2]."""
    smallest = MARGIN * (area_mm2 / np.pi) ** 0.5
    half_mm = next((zoom for zoom in ZOOMS_MM if zoom >= smallest), ZOOMS_MM[-1])
    row, col = view.to_view(*view.scene.finger.position_mm)
    (rows, cols), half = view.view.shape, half_mm / view.mm2_per_px**0.5
    half = min(half, (rows - 1) / 2, (cols - 1) * 3 / 8)
    high, wide = 2 * int(half), 2 * int(half * 4 / 3)
    r0, c0 = (
        int(np.clip(at - size / 2, 0, length - size)) for at, size, length in ((row, high, rows), (col, wide, cols))
    )
    return Crop(r0, r0 + high, c0, c0 + wide)


class Engine:
    """Frames, masks and figures of one scene's variants; one thread at a time.

    Parameters
    ----------
    scene : Scene
        At full resolution.
    seed : int
        Of the camera's noise, the same in every frame: only what was set changes on the page.
    backend : {"auto", "llvm", "numpy"}
    """

    def __init__(self, scene: Scene, *, seed: int = 0, backend: Literal["auto", "llvm", "numpy"] = "auto") -> None:
        self.base, self.seed = scene, seed
        self._backend = backend
        self._cameras: dict[int, FastCamera] = {}  # by how coarse they are
        self._cache: dict[str, OrderedDict[Hashable, Any]] = {kind: OrderedDict() for kind in CACHE_SIZES}

    def prepare(self, report: Callable[[str], None] = lambda text: None, *, coarser: int = 2) -> Shown:
        """Compute all that the first picture needs; ``report`` is called with the name of each step.

        Raises
        ------
        InputError
            If the scene cannot be shown.
        """
        from evanesce.render.fast.fields import fields_of
        from evanesce.render.fast.rig_fields import unit_light

        controls = controls_of(self.base, coarser=coarser)
        scene = self._scene(controls)
        report("light of each LED in the empty plate (seconds for a new rig, then cached on disk)")
        seen = seen_at(scene)
        unit_light(seen)
        report("fields of the rig and tables by gap")
        fields_of(seen)
        report("maps of the camera, first frame")
        return self.show(controls)

    def show(self, controls: Controls) -> Shown:
        """Return the results of one setting.

        Raises
        ------
        InputError
            If the setting is infeasible.
        """
        clock = _Clock()
        chain = controls.chain
        scene = self._scene(controls)
        clock.lap("scene")
        key = (controls.contact_key, _optical_key(scene))
        frame, state, true, note = self._cached("frame", key, lambda: self._take(scene, controls, clock))
        rig_key = (scene.camera.resolution_px, _rig_key(true))
        view = self._cached("view", rig_key, lambda: _View.of(scene, true, state))
        truth = self._cached("share", (rig_key, *controls.contact_key), lambda: view.shares.of(state))
        clock.lap("truth")
        straight = view.perfect.straight(frame)
        clock.lap("undistort")
        found = segment(straight, chain)
        clock.lap("segment")
        grey = single_grey(straight, chain.blur)
        window = window_around(view.perfect, state.nominal_contact_area)
        tip = view.perfect.to_view(*scene.finger.position_mm)
        scale = view.perfect.mm2_per_px
        in_contact = truth >= 0.5
        figures = figures_of(found, in_contact, straight, state.nominal_contact_area, scale)
        profile = profile_of(grey, truth, tip, scale**0.5, controls.along, controls.line_mm)
        histogram = histogram_of(grey, in_contact)
        clock.lap("figures")
        return Shown(
            controls=controls, scene=scene, frame=frame, view=straight, mask=found.mask, truth=truth,
            rectified=view.perfect.view, window=window, mm_per_px=scale**0.5, tip=tip, figures=figures,
            histogram=histogram, profile=profile, seconds=clock.laps, note=note,
        )  # fmt: skip

    def _scene(self, controls: Controls) -> Scene:
        """Return the scene of a setting at its resolution.

        Its grid is determined once: it does not depend on the ridges' height.
        """
        ridged = controls.ridge_height_um > 0

        def coarse() -> Scene:
            start = controls_of(self.base)
            height = start.ridge_height_um or DEFAULT_RIDGES.height_um
            return scene_at_resolution(
                scene_of(self.base, start.changed(ridge_height_um=height if ridged else 0.0)), coarser
            )

        coarser = controls.coarser
        base = self._cached("base", (coarser, ridged), coarse)
        rig = replace(controls, threshold=0.0, min_blob_px=0.0, line_mm=0.0, along="x")
        return self._cached("scene", rig, lambda: scene_of(base, controls))

    def _take(self, scene: Scene, controls: Controls, clock: _Clock) -> tuple[Image, ContactState, Scene, str]:
        """Solve the contact and expose: frame, contact, the rig with its effects, and why it was slow."""
        if scene.effects:
            found = simulate(scene, controls.force_N, seed=self.seed, render=render_fast)
            assert found.state is not None  # a force was given
            clock.lap("frame")
            return found.frame.data, found.state, found.scene, "slower: the scene has effects"
        state = self._cached("contact", controls.contact_key, lambda: self._press(scene, controls.force_N))
        clock.lap("contact")
        last = self._cameras.get(controls.coarser)
        camera = FastCamera(scene, self._backend) if last is None else last.retuned(scene)
        frame = camera.frame(state, seed=self.seed).data
        self._cameras[controls.coarser] = camera
        clock.lap("frame")
        return frame, state, seen_at(scene), f"slower: {camera.falls_back}" if camera.falls_back else ""

    def _press(self, scene: Scene, force_N: float) -> ContactState:
        _, state = solve_contact(scene, force_N, seed=self.seed, file="page")
        assert state is not None  # a force was given
        return state

    def _cached(self, kind: str, key: Hashable, make: Callable[[], T]) -> T:
        """Return a cached value, computed if needed; the least recently used beyond :data:`CACHE_SIZES` is dropped."""
        group = self._cache[kind]
        if key not in group:
            group[key] = make()
            while len(group) > CACHE_SIZES[kind]:
                group.popitem(last=False)
        group.move_to_end(key)
        found: T = group[key]
        return found


class _Clock:
    """Wall time from lap to lap [s]."""

    def __init__(self) -> None:
        self.laps: dict[str, float] = {}
        self._last = time.perf_counter()

    def lap(self, name: str) -> None:
        now = time.perf_counter()
        self.laps[name] = self.laps.get(name, 0.0) + now - self._last
        self._last = now


def _optical_key(scene: Scene) -> str:
    """Return as text the part of a scene that light and camera depend on."""
    return scene.model_dump_json(exclude={"title", "press", "sources", "assumptions", "render"})


def _rig_key(scene: Scene) -> str:
    """Return as text the part of a rig that determines the geometry of the view."""
    camera = scene.camera.model_dump_json(exclude={"lens": {"defocus_um"}})
    return camera + scene.plate.model_dump_json() + str(scene.finger.position_mm) + str(scene.grid)
