"""The whole chain on one page, in physical order: rig, load, contact, light, lens, pixel, readout, frame."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Literal, get_args

from evanesce.core import rng
from evanesce.core.states import ContactState, Frame, PlateLight, SensorLight
from evanesce.effects import Active, Context, Stage, active_effects, all_effects, apply_stage
from evanesce.effects.protocol import ANY_SCENE
from evanesce.optics.seen import seen_at, under_lamp
from evanesce.rig import Scene
from evanesce.rig.coarser import finer_pixels
from evanesce.sensor.automatic import is_automatic, settle
from evanesce.sensor.expose import charge_of, frame_of, signal_of
from evanesce.sensor.lens import form_image
from evanesce.sensor.pixel import fixed_pattern
from evanesce.sensor.response import Response, card_response, led_response

Omission = Literal["distortion", "blur", "noise"]
"""Parts of the camera that can be left out: lens distortion; defocus and diffraction; all noise and fixed pattern."""

Render = Callable[..., PlateLight]
"""``render(scene, state, *, seed, **options) -> PlateLight``; ``state`` is None without contact."""


@dataclass(frozen=True)
class SimulatedFrame:
    """Everything from the truth to the frame.

    Attributes
    ----------
    scene : Scene
        The rig after effects of the stage ``rig``, as its LEDs' light sees it (:func:`~evanesce.optics.seen.seen_at`).
    state : ContactState or None
        Truth; None where the finger is away.
    plate_light : PlateLight
    sensor_light : SensorLight
    frame : Frame
    """

    scene: Scene
    state: ContactState | None
    plate_light: PlateLight
    sensor_light: SensorLight
    frame: Frame


def simulate(
    scene: Scene,
    force_N: float | None,
    *,
    seed: int,
    time_s: float = 0.0,
    index: int = 0,
    contact: Callable[..., ContactState] | None = None,
    render: Render | None = None,
    file: Path | str = ANY_SCENE,
    **render_options: Any,
) -> SimulatedFrame:
    """Simulate one frame.

    Parameters
    ----------
    scene : Scene
    force_N : float or None
        Normal force that the load cell reports [N]; None leaves the finger away (a dark frame).
    seed : int
        The run's one seed; light, noise and effects draw from their own streams of it.
    time_s, index : float, int
        Mid-exposure time [s] and number of the frame.
    contact : callable, optional
        ``contact(scene, force_N, time_s=...) -> ContactState``; the scene's contact law by default.
    render : callable, optional
        :data:`Render`; the path tracer by default.
    file : Path or str
        The scene's file, for errors.
    **render_options
        Passed to ``render``.

    Raises
    ------
    InputError
        If the scene's effects are not valid.
    """
    scene, state = solve_contact(scene, force_N, seed=seed, time_s=time_s, index=index, contact=contact, file=file)

    light_seed = rng.integer_seed(seed, "render", index)
    plate_light = (render or _path_tracer())(scene, state, seed=light_seed, **render_options)

    sensor_light, frame = expose(scene, plate_light, seed=seed, time_s=time_s, index=index, file=file)
    return SimulatedFrame(scene, state, plate_light, sensor_light, frame)


def solve_contact(
    scene: Scene,
    force_N: float | None,
    *,
    seed: int,
    time_s: float = 0.0,
    index: int = 0,
    contact: Callable[..., ContactState] | None = None,
    file: Path | str = ANY_SCENE,
) -> tuple[Scene, ContactState | None]:
    """Solve the contact: the half of the chain before the light.

    Parameters
    ----------
    scene, force_N, seed, time_s, index, contact, file
        As for :func:`simulate`.

    Returns
    -------
    scene : Scene
        The rig after effects of the stage ``rig``, at that time, as its LEDs' light sees it
        (:func:`~evanesce.optics.seen.seen_at`).
    state : ContactState or None
        The contact; None where the finger is away.
    """
    effects = active_effects(scene, file)
    scene = seen_at(apply_stage(Stage.RIG, scene, effects, Context(scene, seed, time_s, index)))
    if force_N is None:
        return scene, None
    context = Context(scene, seed, time_s, index)
    force_N = apply_stage(Stage.LOAD, force_N, effects, context)
    state = (contact or _scene_contact())(scene, force_N, time_s=time_s)
    return scene, apply_stage(Stage.CONTACT, state, effects, context)


def simulate_card(
    scene: Scene,
    which: Literal["checkerboard", "square"],
    *,
    seed: int,
    pose: Any = None,
    time_s: float = 0.0,
    index: int = 0,
    render: Render | None = None,
    file: Path | str = ANY_SCENE,
    **render_options: Any,
) -> Frame:
    """Simulate a frame of a calibration target, a printed card, under a white lamp, LEDs off.

    Parameters
    ----------
    scene : Scene
        Its ``[card]`` table describes the print.
    which : {"checkerboard", "square"}
    pose : Pose, optional
        Intended (:class:`evanesce.render.cards.Pose`); flat on the glass if not given.
    seed, time_s, index, file
        As for :func:`simulate`.
    render : callable, optional
        ``render(scene, card, pose, **render_options) -> PlateLight``; by default the path tracer,
        :func:`evanesce.render.cards.render_card` with a ``seed``.
    **render_options
        Passed to ``render``.
    """
    from evanesce.render.cards import checkerboard_of, pose_of, render_card, require_above_glass, square_of

    scene = under_lamp(scene)
    # Effects that modulate the LEDs' light have none to modulate.
    modulating = {name for name in scene.effects if all_effects()[name].bands}
    scene = scene.model_copy(
        update={"effects": {n: table for n, table in scene.effects.items() if n not in modulating}}
    )
    rig, _ = solve_contact(scene, None, seed=seed, time_s=time_s, index=index, file=file)
    card = checkerboard_of(rig.card) if which == "checkerboard" else square_of(rig.card)
    real = pose_of(rig.card, pose)
    require_above_glass(card, real)
    if render is None:
        render = partial(render_card, seed=rng.integer_seed(seed, "card", which, index))
    light = render(rig, card, real, **render_options)
    response = card_response(rig.camera)
    return expose(rig, light, seed=seed, time_s=time_s, index=index, file=file, response=response)[1]


def expose(
    scene: Scene,
    plate_light: PlateLight,
    *,
    seed: int,
    time_s: float = 0.0,
    index: int = 0,
    without: Collection[Omission] = (),
    finer: int = 1,
    response: Response | None = None,
    file: Path | str = ANY_SCENE,
) -> tuple[SensorLight, Frame]:
    """Expose a frame: the half of the chain behind the plate, so that one rendered light serves many cameras.

    Parameters
    ----------
    scene : Scene
        After effects of the stage ``rig``.
    plate_light : PlateLight
    seed, time_s, index, file
        As for :func:`simulate`.
    without : collection of str
        Parts of the camera that are left out (:data:`Omission`); quantisation and tone curve always stay.
    finer : int
        The light comes on the view of a camera with so many times finer pixels, averaged behind the lens.
    response : tuple of float, optional
        Of a colour camera's filters to the light (:mod:`evanesce.sensor.response`); by default to the LEDs'.

    Returns
    -------
    sensor_light : SensorLight
    frame : Frame

    Raises
    ------
    ValueError
        If a part to be left out is unknown.
    """
    if unknown := set(without) - set(get_args(Omission)):
        raise ValueError(f"a camera cannot leave out {sorted(unknown)}; known: {get_args(Omission)}")
    scene = seen_at(scene)
    effects, context = active_effects(scene, file), Context(scene, seed, time_s, index)
    fine = finer_pixels(scene, finer)
    plate_light = apply_stage(Stage.PLATE_LIGHT, plate_light, effects, replace(context, scene=fine))

    lens = {"distortion": "distortion" not in without, "blurred": "blur" not in without}
    sensor_light = _averaged(form_image(plate_light, fine.camera, scene.plate, **lens), finer)
    sensor_light = apply_stage(Stage.SENSOR_LIGHT, sensor_light, effects, context)
    return sensor_light, _read_out(sensor_light, effects, context, response=response, noisy="noise" not in without)


def expose_light(
    scene: Scene,
    light: SensorLight,
    *,
    seed: int,
    time_s: float = 0.0,
    index: int = 0,
    file: Path | str = ANY_SCENE,
) -> Frame:
    """Expose a frame of the LEDs' light behind the lens.

    Parameters
    ----------
    scene : Scene
        After effects of the stage ``rig``.
    light : SensorLight
        Before effects.
    seed, time_s, index, file
        As for :func:`simulate`.

    Returns
    -------
    Frame
    """
    effects, context = active_effects(scene, file), Context(scene, seed, time_s, index)
    return _read_out(apply_stage(Stage.SENSOR_LIGHT, light, effects, context), effects, context)


def _read_out(
    light: SensorLight,
    effects: tuple[Active, ...],
    context: Context,
    *,
    response: Response | None = None,
    noisy: bool = True,
) -> Frame:
    """Return the frame of an irradiance: charge, exposure control, readout, development, each with its effects."""
    scene, seed, index = context.scene, context.seed, context.index
    camera, pixel, (cols, rows) = scene.camera, scene.camera.pixel, scene.camera.resolution_px
    pattern = None
    if noisy:
        own = rng.generator(seed, "sensor")
        pattern = fixed_pattern((rows, cols), pixel.prnu, pixel.dsnu_e, own, pixel.dark_spread)
    response = led_response(scene) if response is None else response
    charge_e, processor = charge_of(light, camera, pattern, response), None
    if is_automatic(camera):
        camera, processor = settle(charge_e, camera)
        context = replace(context, scene=scene.model_copy(update={"camera": camera}))
        charge_e = charge_of(light, camera, pattern, response)
    charge_e = apply_stage(Stage.CHARGE, charge_e, effects, context)

    signal_DN = signal_of(charge_e, camera, rng.generator(seed, "exposure", index) if noisy else None)
    signal_DN = apply_stage(Stage.READOUT, signal_DN, effects, context)

    frame = frame_of(signal_DN, camera, time_s=context.time_s, index=index, processor=processor)
    if scene.camera.auto_exposure is not None:
        frame = replace(frame, exposure_ms=camera.exposure_ms, analogue_gain=camera.analogue_gain)
    if processor is not None and scene.camera.colour is not None and scene.camera.colour.white_balance == "automatic":
        frame = replace(frame, balance=(processor.red_gain, processor.blue_gain))
    developed: Frame = apply_stage(Stage.FRAME, frame, effects, context)
    return developed


def _averaged(light: SensorLight, finer: int) -> SensorLight:
    """Return the mean of each ``finer`` x ``finer`` pixels."""
    if finer == 1:
        return light
    rows, cols = (n // finer for n in light.irradiance.shape)
    return SensorLight(irradiance=light.irradiance.reshape(rows, finer, cols, finer).mean(axis=(1, 3)))


def simulate_press(scene: Scene, *, seed: int, **options: Any) -> Iterator[SimulatedFrame]:
    """Simulate the scene's loading programme, frame by frame.

    A ramp in mm/min moves the finger after its effects at time 0: a stiffer one responds with more force.

    Parameters
    ----------
    scene : Scene
    seed : int
    **options
        As for :func:`simulate`.
    """
    for index, (time_s, force_N) in enumerate(programme(scene, seed=seed, file=options.get("file", ANY_SCENE))):
        yield simulate(scene, force_N, seed=seed, time_s=time_s, index=index, **options)


def programme(scene: Scene, *, seed: int, file: Path | str = ANY_SCENE) -> list[tuple[float, float]]:
    """Return the scene's loading programme, for the rig after its effects at time 0.

    Parameters
    ----------
    scene : Scene
    seed : int
    file : Path or str
        The scene's file, for errors.

    Returns
    -------
    list of tuple
        Time [s] and normal force [N] of each frame.

    Raises
    ------
    InputError
        If it needs too many frames, or the contact law cannot follow it.
    """
    from evanesce.contact.programme import press_programme

    rig, _ = solve_contact(scene, None, seed=seed, file=file)
    return press_programme(rig)


# Fetched on first use: a caller with its own contact or light needs neither solver nor renderer installed.
def _scene_contact() -> Callable[..., ContactState]:
    from evanesce.contact.solve import contact_state

    return contact_state


def _path_tracer() -> Render:
    from evanesce.render.reference.path import render

    return render
