"""Scalar series as a rig with departures would give them: areas by the whole chain, forces by the contact law and the
slide's friction."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.bundle.area import AreaReading
from evanesce.bundle.layout import Series, Shot, with_shear
from evanesce.chain.simulate import solve_contact
from evanesce.contact.slide import slide_forces
from evanesce.contact.solve import contact_state, parts_of
from evanesce.core.errors import InputError
from evanesce.effects import Active, Context, Stage, active_effects, apply_stage
from evanesce.inference.series.rows import LEAST_AREA_MM2, LEAST_FORCE_N, SHEAR
from evanesce.prediction.colour import area_in
from evanesce.prediction.fine import FinePredictor, in_pixels
from evanesce.prediction.kept import Kept
from evanesce.prediction.observe import model_factor, model_scene
from evanesce.prediction.point import Nuisances, scene_with
from evanesce.prediction.predict import Predictor
from evanesce.prediction.views import View
from evanesce.rig import Scene

Array = NDArray[Any]
Point = Mapping[str, float]

FORCES_FOR_DEPTH = np.geomspace(0.02, 12.0, 14)
"""Between which depth is interpolated [N]: beyond the forces of the thesis, 0.1 to 10 N, by ratios of 1.6."""
DEFAULT_FORCE_N = 3.0
"""At which a series was taken that does not say; in the middle of the thesis's."""
KEPT, KEPT_LAWS = 400, 80
"""Predictions, and laws of depth or sliding, that are kept: some rounds of a fit."""


class SeriesPredictor:
    """Predicts the logarithm of series at a point, a mapping of parameter names to values.

    Parameters
    ----------
    believed : Scene
    fine : bool
        Whether frames have the real camera's pixels and finer light, or are the model camera's.
    """

    def __init__(self, believed: Scene, *, fine: bool = False) -> None:
        self.believed, self._fine = believed, fine
        self.scene = believed if fine else model_scene(believed)
        self.factor = 1 if fine else model_factor(believed)
        """Real pixels along each of the frames'."""
        self._frames = self._predictor()
        self._smaller = self._frames.factor if isinstance(self._frames, FinePredictor) else 1
        self._kept = Kept(KEPT)
        self._depths = Kept(KEPT_LAWS)
        self._slides = Kept(KEPT_LAWS)

    def _predictor(self) -> Predictor:
        if self._fine:
            return FinePredictor(self.believed, (), model_factor(self.believed))
        return Predictor(self.scene, (), pixels=self.factor)

    def log(self, series: Series, point: Point) -> Array:
        """Return the logarithm of one series' values (n,).

        Raises
        ------
        InputError
            If the rig cannot have these values.
        """
        what = (series.x_name, series.y_name, tuple(series.x), tuple(series.held.items()), series.name)
        key = (what, tuple(sorted(point.items())))
        found: Array = self._kept.get(key, lambda: self._values(self.scene, series, point))
        return found

    def of_rig(self, scene: Scene, series: Series) -> Array:
        """Return the logarithm of one series' values (n,) for another rig at this resolution."""
        return self._values(scene, series, {})

    def _values(self, own: Scene, series: Series, point: Point) -> Array:
        scene = scene_with(own, in_pixels(point, self._smaller))
        if series.y_name != "area":
            force = self._shear(scene, series, point) if series.y_name in SHEAR else self._force(scene, series, point)
            return np.log(np.maximum(force * math.exp(-point.get(f"@load[{series.name}]", 0.0)), LEAST_FORCE_N))
        return np.log(self._areas(scene, series, point))

    def _areas(self, scene: Scene, series: Series, point: Point) -> Array:
        """Return areas by the reference segmentation of predicted frames [mm^2]."""
        held = series.held
        states = {
            "force": np.full(len(series), held.get("force_N", DEFAULT_FORCE_N)),
            "voltage": np.full(len(series), held.get("voltage_V", self.scene.leds.voltage_V)),
            "time": np.full(len(series), held.get("time_s", 0.0)),
        }
        if series.x_name == "displacement":
            states["force"] = self._force(scene, series, point)
        else:
            states[series.x_name] = np.asarray(series.x, float)
        reading = AreaReading(
            threshold=held.get("threshold", AreaReading.threshold),
            # Pixels of the model camera are larger, the blur's are the lab's.
            blur_px=held.get("blur_px", AreaReading.blur_px) / self.factor,
            min_blob_mm2=held.get("min_blob_mm2", AreaReading.min_blob_mm2),
        )
        nuisances = Nuisances(
            log_light=point.get("@light", 0.0),
            black_DN=point.get("@black", 0.0),
            log_force=point.get(f"@load[{series.name}]", 0.0),
        )
        # Pictures of fine frames are large, and a fit asks for no point twice: none are kept.
        frames = self._predictor() if self._fine else self._frames
        found = []
        for force, voltage, time in zip(*(states[n] for n in ("force", "voltage", "time")), strict=True):
            view = View(kind="press", force_N=float(force), voltage_V=float(voltage), time_s=float(time))
            found.append(area_in(frames.picture(scene, view, nuisances), frames.scene, reading))
        return np.maximum(np.array(found) * self._card_scale(scene), LEAST_AREA_MM2)

    def _card_scale(self, scene: Scene) -> float:
        """Return what areas are off by, where the square that set mm^2 per pixel has not the side it should have."""
        rig, _ = solve_contact(scene, None, seed=0)
        return float((self.scene.card.square_side_mm / rig.card.square_side_mm) ** 2)

    def _force(self, scene: Scene, series: Series, point: Point) -> Array:
        """Return the force at displacements, by turning the law's depth at forces around [N]."""
        time_s = series.held.get("time_s", 0.0)
        # A law takes fourteen contacts; most of what a fit varies leaves it as it is.
        rig, _ = solve_contact(scene, None, seed=0, time_s=time_s)
        loads = tuple(e for e in active_effects(scene) if e.effect.stage is Stage.LOAD)
        key = (time_s, repr(loads), *parts_of(rig))
        depths, forces = self._depths.get(key, lambda: law_of_depth(rig, loads, time_s))
        if len(forces) < 2:
            raise InputError(
                "has no depth", key="contact.law", allowed="a law with a depth, for series of displacement"
            )
        depth = np.asarray(series.x, float) + point.get(f"@zero[{series.name}]", 0.0)
        log_depth, log_force = (np.log(np.maximum(x, 1e-6)) for x in (depths, forces))
        return np.exp(np.interp(np.log(np.maximum(depth, 1e-6)), log_depth, log_force))

    def _shear(self, scene: Scene, series: Series, point: Point) -> Array:
        """Return the magnitude of tangential force [N] or torque [N mm] at ways of the finger's top over the plate."""
        rig, _ = solve_contact(scene, None, seed=0)
        loads = tuple(e for e in active_effects(scene) if e.effect.stage is Stage.LOAD)
        found = self._slides.get((repr(loads), *parts_of(rig)), lambda: shear_of_slide(rig, loads))
        way = np.asarray(series.x, float) + point.get(f"@zero[{series.name}]", 0.0)
        if np.max(series.x) > found["slide"][-1] * (1.0 + 1e-9):
            raise InputError(
                f"slides {found['slide'][-1]:g} mm", key="slide.distance_mm",
                allowed=f"at least {np.max(series.x):g}, the way of series {series.name}",
            )  # fmt: skip
        return np.asarray(np.interp(way, found["slide"], found[series.y_name]))


def shear_of_slide(rig: Scene, loads: tuple[Active, ...]) -> dict[str, Array]:
    """Return what a load cell reads of a rig's slide, up to where it first turns back.

    Parameters
    ----------
    rig : Scene
        With a slide.
    loads : tuple of Active
        Effects on the force.

    Returns
    -------
    dict of str to ndarray (n,)
        ``slide``, rising [mm], ``tangential_force`` [N] and ``torque`` [N mm], magnitudes.

    Raises
    ------
    InputError
        For a rig without a slide, or a slide without an answer.
    """
    if rig.slide is None or rig.press.forces_N is None:
        raise InputError("has no slide", key="slide", allowed="a table [slide], for series of slide_mm")
    # an effect on the force is refused there: the programme of a slide fixes it
    apply_stage(Stage.LOAD, float(rig.press.forces_N[0]), loads, Context(rig, 0, 0.0, 0))
    ways: list[float] = []
    along: list[float] = []
    torques: list[float] = []
    for state in slide_forces(rig):
        shot = with_shear(Shot(index=0, time_s=0.0, force_N=state.normal_force, voltage_V=0.0), state)
        if ways and shot.slide_mm <= ways[-1]:
            if shot.slide_mm <= 0.0 or not along[-1]:
                ways, along, torques = [], [], []  # still pressed, not yet slid
            else:
                break
        ways.append(shot.slide_mm)
        along.append(abs(shot.tangential_force_N))
        torques.append(abs(shot.torque_Nmm))
    return {"slide": np.array(ways), "tangential_force": np.array(along), "torque": np.array(torques)}


def law_of_depth(rig: Scene, loads: tuple[Active, ...], time_s: float) -> tuple[Array, Array]:
    """Return depths [mm], ascending, and the forces [N] that press a rig's finger so deep.

    Effects on the contact itself move or stretch it in its plane: how deep it is does not change.

    Parameters
    ----------
    rig : Scene
    loads : tuple of Active
        Effects on the force.
    time_s : float
    """
    forces, depths = [], []
    context = Context(rig, 0, time_s, 0)
    for force in FORCES_FOR_DEPTH:
        try:
            state = contact_state(rig, apply_stage(Stage.LOAD, float(force), loads, context), time_s=time_s)
        except InputError:
            continue  # beyond what the law knows
        if np.isfinite(state.depth):
            forces.append(float(force))
            depths.append(float(state.depth))
    order = np.argsort(depths)
    return np.array(depths)[order], np.array(forces)[order]


def log_of(predictor: SeriesPredictor, series: Sequence[Series], point: Point) -> Array:
    """Return the logarithm of the values of several series, one after the other (rows,)."""
    return np.concatenate([np.zeros(0), *(predictor.log(one, point) for one in series)])
