"""Frames as the believed rig, with departures, would show them on average: what the data are compared with.

The chain is that of :mod:`evanesce.chain.simulate`, its steps kept apart so that what a change does not touch is
computed once.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.bundle.card_light import card_light, plane_points
from evanesce.contact.solve import contact_state, parts_of
from evanesce.core.errors import InputError
from evanesce.core.states import ContactState, Frame, PlateLight, SensorLight
from evanesce.effects import Active, Context, Stage, active_effects, all_effects
from evanesce.optics.projection import Projection
from evanesce.optics.seen import seen_at, under_lamp
from evanesce.prediction.colour_noise import expected_colour
from evanesce.prediction.development import Development, light_levels, widened
from evanesce.prediction.kept import Kept
from evanesce.prediction.plate_light import (
    behind_plate,
    dark,
    finer_view,
    led_pattern,
    render_moved,
    sight,
    unlit,
    veiled,
)
from evanesce.prediction.point import Nuisances, Point, nuisances_of, scene_with
from evanesce.prediction.processes import Recipe, present, shares
from evanesce.prediction.tone import expected_tone
from evanesce.prediction.views import View, binned
from evanesce.render.cards import Pose, checkerboard_of, pose_of, square_of
from evanesce.render.fast.transport import render_fast
from evanesce.rig import Scene
from evanesce.rig.coarser import finer_pixels, in_smaller_pixels
from evanesce.sensor.expose import charge_of, signal_of
from evanesce.sensor.lens import form_image
from evanesce.sensor.response import card_response, led_response

Array = NDArray[Any]

SEED = 0
"""Of effects with random places: the critic takes their scaling and shape from it, never their places."""

KEEP_LIGHTS, KEEP_IMAGES, KEEP_BINS, KEEP_WAYS = 80, 80, 400, 8
KEEP_CONTACTS = 24
"""Of all predictors of a process together, some 25 MB each: as many states as most bundles hold."""


CONTACT_PX = 2
"""Of rays and of the lens along each of the model camera's pixels, where a contact is seen. Of what tells a modulus or
an off-axis load from the finger's place and load, derivatives then hold 98 and 99 %, by one 86 and 96 %
(benchmarks/critic_pixels.py)."""

FLANK_STEP = 4
"""Every so many pixels of the model camera it is looked what they see of the finger's flank: more would make it the
longest part of each step of a fit, and the fine model has it right."""


class _Watched(Context):
    """A context that notes whether an effect asked for the time or the number of the frame."""

    def __getattribute__(self, name: str) -> Any:
        if name in ("time_s", "index"):
            object.__setattr__(self, "asked", True)
        return super().__getattribute__(name)


# The fine model gathers the light of one contact by pixels of two sizes.
_CONTACTS = Kept(KEEP_CONTACTS)


class Predictor:
    """Predicts the views of an observation.

    Parameters
    ----------
    scene : Scene
        The believed rig, at the critic's resolution (:func:`evanesce.prediction.observe.model_scene`).
    views : sequence of View
    finer : int
        The light is computed on so many times as many rays along each side.
    noise_scale : float
        Real over modelled noise before the tone curve (:mod:`evanesce.prediction.noise_scale`).
    pixels : float
        Real pixels along one of the scene's: over those a colour camera's frames are demosaiced.
    before : int
        Smaller pixels along one of the scene's by which the lens gathers the light of a contact, of which ``finer`` is
        a multiple.
    """

    def __init__(
        self, scene: Scene, views: Sequence[View], *, finer: int = 1, noise_scale: float = 1.0, pixels: float = 1.0,
        before: int = 1,
    ) -> None:  # fmt: skip
        self.scene, self.views, self.finer, self.noise_scale = scene, tuple(views), finer, noise_scale
        self.pixels, self.before = pixels, before
        options = {"finer": finer, "noise_scale": noise_scale, "pixels": pixels, "before": before}
        self.recipe = Recipe(Predictor, {"scene": scene, "views": self.views, **options})
        self.correction: Array | None = None
        """Added to every prediction of bins (views, rows, cols) [DN]."""
        self.fixed: dict[str, Mapping[str, Any]] = {}
        """Settings of effects that the scene does not have: places that data showed."""
        self._lights, self._images = Kept(KEEP_LIGHTS), Kept(KEEP_IMAGES)
        self._bins, self._points, self._ways = Kept(KEEP_BINS), Kept(4), Kept(KEEP_WAYS)
        self.flank_step: int | None = FLANK_STEP * finer
        self._known: set[str] = set()
        self._timed: set[str] = set()

    def cube(self, point: Point, only: Sequence[int] | None = None) -> Array:
        """Return the predicted means of the bins (views, rows, cols) [DN]; NaN in views that are not in ``only``."""
        return self.begun(point, only)()

    def begun(self, point: Point, only: Sequence[int] | None = None) -> Callable[[], Array]:
        """Return what returns :meth:`cube`: other processes, where there are any, predict meanwhile."""
        wanted = list(range(len(self.views)) if only is None else only)
        if not wanted:
            raise ValueError("no view to predict")
        made = self._shared(Predictor.bins_at, point, wanted)
        correction = self.correction

        return lambda: self._cube_of(made(), correction)

    def cubes(self, points: Sequence[Point], only: Sequence[int] | None = None) -> list[Array | InputError]:
        """Return :meth:`cube` of several points, or why the rig cannot have one."""
        together = present()
        wanted = list(range(len(self.views)) if only is None else only)
        if together is None or len(points) < together.count:
            return [_tried(lambda one=point: self.cube(one, wanted)) for point in points]  # type: ignore[misc]
        tasks = [(dict(point), wanted) for point in points]
        answers = together.begin(self.recipe, self.fixed, Predictor.bins_at, tasks).results()
        return [a if isinstance(a, InputError) else self._cube_of(a, self.correction) for a in answers]

    def _cube_of(self, bins: Mapping[int, Array], correction: Array | None) -> Array:
        """Return bins by number as a cube (views, rows, cols), NaN where there are none."""
        found = np.full((len(self.views), *next(iter(bins.values())).shape), np.nan)
        for place, part in bins.items():
            found[place] = part
        return found if correction is None else found + correction

    def bins_at(self, point: Point, wanted: Sequence[int]) -> dict[int, Array]:
        """Return the bins (rows, cols) of some views, by number [DN], made by this process and not corrected."""
        scene = scene_with(self.scene, point, self.fixed)
        return {k: self._binned(scene, self.views[k], nuisances_of(point, self.views[k], k)) for k in wanted}

    def _shared(
        self, work: Callable[[Predictor, Point, list[int]], dict[int, Array]], point: Point, wanted: Sequence[int]
    ) -> Callable[[], dict[int, Array]]:
        """Return what returns something of some views, by number, made by all processes that there are."""
        together = present()
        if together is None:
            return lambda: work(self, point, list(wanted))
        parts = shares(self.views, together.count)
        asked = [(place, k) for place, part in enumerate(parts) for k in part if k in wanted]
        tasks, places = [(dict(point), [k]) for _, k in asked], [place for place, _ in asked]
        batch = together.begin(self.recipe, self.fixed, work, tasks, places)

        def finished() -> dict[int, Array]:
            found: dict[int, Array] = {}
            for answer in batch.results():
                if isinstance(answer, InputError):
                    raise answer
                found |= answer
            return found

        return finished

    def images(self, point: Point, places: Sequence[int]) -> Array:
        """Return the mean frames (places, rows, cols) of some views [DN]."""
        made = self._shared(Predictor.images_at, point, places)()
        return np.array([made[k] for k in places])

    def images_at(self, point: Point, places: Sequence[int]) -> dict[int, Array]:
        """Return mean frames (rows, cols) of some views, by number [DN], made by this process."""
        return {k: self.image(point, k) for k in places}

    def image(self, point: Point, place: int) -> Array:
        """Return the mean frame (rows, cols) of one view [DN]."""
        view = self.views[place]
        return self.picture(scene_with(self.scene, point, self.fixed), view, nuisances_of(point, view, place))

    def _binned(self, scene: Scene, view: View, nuisances: Nuisances) -> Array:
        """Return a view's bins; views that differ in nothing that anything asks for are predicted once."""
        active = {name for name in scene.effects}
        timeless = active <= self._known - self._timed and scene.slide is None
        moment = () if timeless else (view.time_s, view.index)
        averaged = view.frames > 1 and any(all_effects()[name].bands for name in active)
        state = (view.kind if view.is_card or not view.touches else "touch", view.force_N, view.voltage_V, averaged)
        key = (repr(scene.effects), nuisances, state, moment)
        found = self._bins.get(key, lambda: self._bins_of(self.picture(scene, view, nuisances)))
        return found

    def _bins_of(self, picture: Array) -> Array:
        """Return the bins of a mean frame."""
        return binned(picture)

    def _apply(self, stage: Stage, value: Any, effects: tuple[Active, ...], context: Context) -> Any:
        """Pass a value through the effects of a stage, and note which of them ask for the time."""
        for entry in effects:
            if entry.effect.stage is stage:
                watched = _Watched(context.scene, context.seed, context.time_s, context.index)
                value = entry.effect.apply(value, entry.parameters, watched)
                self._known.add(entry.effect.id)
                if "asked" in vars(watched):
                    self._timed.add(entry.effect.id)
        return value

    def picture(self, scene: Scene, view: View, nuisances: Nuisances) -> Array:
        """Return the mean frame of a view of a scene, effects in it [DN]."""
        lit = scene.model_copy(update={"leds": scene.leds.model_copy(update={"voltage_V": view.voltage_V})})
        lit = under_lamp(lit) if view.is_card else lit
        effects = tuple(e for e in active_effects(lit) if not e.effect.is_null(e.parameters) and _shows(e, view))
        context = Context(lit, SEED, view.time_s, view.index)
        rig = seen_at(self._apply(Stage.RIG, lit, effects, context))
        context = Context(rig, SEED, view.time_s, view.index)
        if view.kind == "lens_cap":
            cols, rows = rig.camera.resolution_px
            sensor: SensorLight = SensorLight(irradiance=np.zeros((rows, cols)))
        else:
            key, level, light = self._light(rig, view, nuisances, effects, context)
            stages = [e for e in effects if e.effect.stage in (Stage.PLATE_LIGHT, Stage.SENSOR_LIGHT)]
            touching = view.touches and not view.is_card
            way = (repr(stages), self._moment(stages, context), nuisances.slope)
            side = self.side(view)
            key = (key, *way, behind_plate(rig, bool(stages), not touching), side)
            sensor, at = self._images.get(
                key, lambda: (self._gathered(rig, side, light(), nuisances, effects, context), level)
            )
            # The way to the sensor is linear in the LEDs' power but for light that effects bring of their own.
            if at != level:
                own = self._own_light(rig, side, nuisances, effects, context, way) if stages else 0.0
                sensor = SensorLight(irradiance=own + (sensor.irradiance - own) * (level / at))
        return self._expose(rig, sensor, nuisances, effects, context, view.is_card)

    def _own_light(
        self, rig: Scene, side: int, nuisances: Nuisances, effects: tuple[Active, ...], context: Context,
        way: tuple[Any, ...],
    ) -> Array:  # fmt: skip
        """Return the irradiance (rows, cols) that effects on the way to the sensor bring while no LED shines."""
        off = unlit(rig)
        key = ("own light", sight(off), *way, behind_plate(off, True, False), side)
        there = replace(context, scene=off)
        return self._images.get(
            key, lambda: self._gathered(off, side, dark(finer_pixels(off, side)), nuisances, effects, there)
        ).irradiance

    def _moment(self, effects: Sequence[Active], context: Context) -> tuple[float, ...]:
        """Return the time and number of a frame if any effect may ask for them."""
        ids = {e.effect.id for e in effects}
        return () if ids <= self._known - self._timed else (context.time_s, context.index)

    def _light(
        self, rig: Scene, view: View, nuisances: Nuisances, effects: tuple[Active, ...], context: Context
    ) -> tuple[Any, float, Callable[[], PlateLight]]:
        """Return a key of the light that leaves the plate up to the LEDs' level, that level, and what makes it."""
        rays = sight(rig)
        if view.is_card:
            posed = (nuisances.shift_mm, nuisances.turn_deg)
            key: Any = ("card", view.kind, rays, repr(rig.card), repr(rig.plate), *posed)
            return (
                (*key, nuisances.veil), 1.0,
                lambda: veiled(self._lights.get(key, lambda: self._card(rig, view, nuisances)), nuisances.veil),
            )  # fmt: skip
        pattern, level = led_pattern(rig)
        leds = rig.leds
        glass = repr((rig.plate, rig.surroundings, leds.emitting_width_mm, leds.emitting_height_mm, leds.air_gap_share))
        if view.force_N is None:
            if rig.surroundings is None or level == 0.0:
                return ("dark", rays), 1.0, lambda: dark(rig)
            key = ("empty", rays, glass, pattern, level)
            ideal = finer_view(rig, self.finer)
            return key, 1.0, lambda: self._lights.get(key, lambda: render_fast(rig, None, view=ideal))
        force = float(self._apply(Stage.LOAD, view.force_N * float(np.exp(nuisances.log_force)), effects, context))
        touching = [e for e in effects if e.effect.stage is Stage.CONTACT]
        moment = (view.time_s,) if rig.slide is not None else self._moment(touching, context)
        contact_key = (force, *parts_of(rig), repr(touching), moment)

        def contact() -> ContactState:
            made = contact_state(rig, force, time_s=view.time_s if rig.slide is not None else 0.0)
            return self._apply(Stage.CONTACT, made, effects, context)

        key = (contact_key, nuisances.shift_mm, rays, glass, pattern)

        def light() -> PlateLight:
            def make() -> tuple[PlateLight, float]:
                if level == 0.0:
                    return dark(rig), 1.0
                state = _CONTACTS.get(contact_key, contact)
                return render_moved(rig, state, nuisances.shift_mm, self.finer, self.flank_step), level

            made, at = self._lights.get(key, make)
            # Everything on the way is linear in the LEDs' power while their pattern stays.
            return made if at == level else replace(made, radiance=made.radiance * (level / at))

        # No light at all is nothing that others could be scaled from.
        return (key if level > 0.0 else (*key, "off")), level, light

    def _card(self, rig: Scene, view: View, nuisances: Nuisances) -> PlateLight:
        """Return the light of a card that lies flat; where the pixels meet its plane is kept."""
        card = checkerboard_of(rig.card) if view.kind == "checkerboard" else square_of(rig.card)
        pose = pose_of(rig.card, Pose(shift=nuisances.shift_mm, rotation_deg=nuisances.turn_deg))
        ideal = finer_view(rig, self.finer)
        points = self._points.get(
            (sight(rig), pose.height),
            lambda: plane_points(Projection.of(rig.camera, rig.plate), ideal, pose.height),
        )
        return card_light(rig, card, pose, view=ideal, points=points, soft=True)

    def side(self, view: View) -> int:
        """Return how many smaller pixels along one of the scene's gather a view's light."""
        return self.before if view.touches and not view.is_card else 1

    def _gathered(
        self, rig: Scene, side: int, light: PlateLight, nuisances: Nuisances, effects: tuple[Active, ...],
        context: Context,
    ) -> SensorLight:  # fmt: skip
        finer = finer_pixels(rig, side)
        context = replace(context, scene=finer)
        effects = tuple(replace(e, parameters=in_smaller_pixels(e.parameters, side)) for e in effects)
        light = self._apply(Stage.PLATE_LIGHT, light, effects, context)
        sensor = form_image(light, finer.camera, finer.plate)
        sensor = self._apply(Stage.SENSOR_LIGHT, sensor, effects, context)
        sensor = SensorLight(irradiance=binned(sensor.irradiance, side))
        if any(nuisances.slope):
            rows, cols = sensor.irradiance.shape
            x, y = np.linspace(-1, 1, cols), np.linspace(-1, 1, rows)
            plane = 1.0 + nuisances.slope[0] * x[None, :] + nuisances.slope[1] * y[:, None]
            sensor = SensorLight(irradiance=sensor.irradiance * plane)
        return sensor

    def _expose(
        self, rig: Scene, sensor: SensorLight, nuisances: Nuisances, effects: tuple[Active, ...], context: Context,
        card: bool,
    ) -> Array:  # fmt: skip
        """Return the mean frame of an irradiance: pixel, readout and tone with all effects behind the lens."""
        light = sensor
        if nuisances.log_light:
            light = SensorLight(irradiance=sensor.irradiance * float(np.exp(nuisances.log_light)))
        plain = rig.camera.model_copy(update={"colour": None})
        charge = self._apply(Stage.CHARGE, charge_of(light, plain), effects, context)
        # Larger pixels are means of real ones, each developed with its own noise.
        scale = self.pixels * self.noise_scale * float(np.exp(nuisances.log_noise))
        after = [e for e in effects if e.effect.stage is Stage.FRAME]

        def unchanged(charge_e: Array) -> Array:
            return np.asarray(signal_of(charge_e, plain, None) + nuisances.black_DN, float)

        def read(charge_e: Array) -> Array:
            return np.asarray(self._apply(Stage.READOUT, unchanged(charge_e), effects, context), float)

        def finished(mean: Any) -> Array:
            if not after:
                return np.asarray(mean)
            frame = Frame(data=mean, time=context.time_s, index=context.index)
            return np.asarray(self._apply(Stage.FRAME, frame, effects, context).data, float)

        response = card_response(rig.camera) if card else led_response(rig)
        if response is None or rig.camera.colour is None:
            return finished(expected_tone(plain, scale).mean_of(read(charge)))
        # What a filter holds back of the light it does not of the dark current.
        dark_e = plain.pixel.dark_rate_e_per_s * plain.exposure_ms * 1e-3
        e_per_DN = plain.pixel.conversion_gain_e_per_DN / plain.analogue_gain
        behind = [e for e in effects if e.effect.stage is Stage.READOUT]
        alone = all(e.effect.pointwise for e in behind)

        def of_filters(one: Callable[[Array], Array]) -> Callable[[Array], Array]:
            return lambda light_e: np.array([one(share * light_e + dark_e) for share in response])

        development = Development(
            expected_colour(rig.camera, scale),
            e_per_DN * light_levels(rig.camera, response),
            of_filters(read),
            finished,
            None if alone else of_filters(unchanged),
            all(e.effect.pointwise for e in after),
            rig.camera.colour.mosaic if self.pixels == 1.0 else None,
        )
        settings = (
            repr(behind if alone else []),
            repr(after),
            scale,
            nuisances.black_DN,
            response,
            self._moment(behind + after, context),
        )
        # Lens and place of the camera decide where light falls, not what becomes of it.
        shown = rig.camera.model_dump_json(exclude={"lens", "principal_point_offset_px", "scale_px_per_mm"})
        way = self._ways.get((shown, *settings), development.way)
        light_e = charge - dark_e
        if self.pixels > 1.0:
            light_e = widened(light_e, rig.camera, response, self.pixels)
        return development.grey(light_e, way)


def _tried(make: Callable[[], Array]) -> Array | InputError:
    try:
        return make()
    except InputError as error:
        return error


def _shows(entry: Active, view: View) -> bool:
    """Tell whether a view shows an effect: bands average out in many frames, and cards are lit by the room."""
    return entry.effect.bands is None or (view.frames == 1 and not view.is_card)
