"""A scene's loading programme: normal force, and drive displacement of a slide, at the time of each frame."""

from __future__ import annotations

import math

import numpy as np
from scipy.optimize import brentq

from evanesce.contact.laws import apply_law
from evanesce.contact.rate import as_loaded
from evanesce.contact.sliding.programme import SlideProgramme
from evanesce.core.errors import InputError
from evanesce.rig import Scene


def press_programme(scene: Scene) -> list[tuple[float, float]]:
    """Return time and normal force of every frame.

    A slide is sampled at the frame rate. A list of forces is one frame each at the frame rate. A ramp starts at its
    first force and is sampled at the frame rate until it has reached the last; in mm/min the depth moves evenly and the
    law's own depth gives the force.

    Parameters
    ----------
    scene : Scene

    Returns
    -------
    list of tuple
        ``(time_s, force_N)``.

    Raises
    ------
    InputError
        If it needs more than ``press.max_frames`` frames, or a ramp in mm/min meets a law without a depth.
    """
    press = scene.press
    if scene.slide is not None:
        times, loads, _ = slide_programme(scene).sample()
        _require_frames(times.size, press.max_frames)
        return [(float(t), float(f)) for t, f in zip(times, loads, strict=True)]
    if press.forces_N is not None:
        _require_frames(len(press.forces_N), press.max_frames)
        return [(index / press.frame_rate_hz, force) for index, force in enumerate(press.forces_N)]
    return _ramp(scene)


def _ramp(scene: Scene) -> list[tuple[float, float]]:
    press, ramp = scene.press, scene.press.ramp
    if ramp is None:  # Press guarantees one of the two
        raise InputError("neither forces_N nor ramp", key="press")
    low, high = sorted((ramp.start_N, ramp.stop_N))
    if ramp.rate_N_per_s is not None:
        first, last, rate = ramp.start_N, ramp.stop_N, ramp.rate_N_per_s
    else:
        first, last = _depth(scene, ramp.start_N), _depth(scene, ramp.stop_N)
        rate = (ramp.rate_mm_per_min or 0.0) / 60.0
    # the tolerance keeps a last frame that rounding would push past the end
    frames = math.floor(abs(last - first) / rate * press.frame_rate_hz + 1e-9) + 1
    _require_frames(frames, press.max_frames)
    times = np.arange(frames) / press.frame_rate_hz
    path = first + math.copysign(rate, last - first) * times
    if ramp.rate_N_per_s is not None:
        forces = np.clip(path, low, high)
    else:
        forces = np.array([_force_at(scene, depth, low, high) for depth in path])
    return [(float(t), float(f)) for t, f in zip(times, forces, strict=True)]


def slide_programme(scene: Scene) -> SlideProgramme:
    """Return the slide that a scene describes.

    Parameters
    ----------
    scene : Scene

    Returns
    -------
    SlideProgramme

    Raises
    ------
    ValueError
        For a scene without one.
    """
    slide, forces = scene.slide, scene.press.forces_N
    if slide is None:
        raise ValueError("the scene has no slide")
    assert forces is not None  # Scene guarantees one force
    return SlideProgramme(
        normal_force=forces[0],
        preload=slide.preload_N,
        press_time=slide.press_time_s,
        hold_time=slide.hold_time_s,
        speed=slide.speed_mm_per_s,
        distance=slide.distance_mm,
        reciprocate=slide.reciprocate,
        frame_rate=scene.press.frame_rate_hz,
    )


def _require_frames(frames: int, limit: int) -> None:
    if frames > limit:
        raise InputError(
            f"the loading programme needs {frames} frames", key="press.max_frames", allowed=f"at most {limit}"
        )


def _depth(scene: Scene, force: float) -> float:
    depth = apply_law(as_loaded(scene, force), force).contact.depth
    if not math.isfinite(depth):
        raise InputError(
            f"law {scene.contact.law} has no depth, which a ramp in mm/min needs",
            key="press.ramp.rate_mm_per_min",
            allowed="rate_N_per_s, or law hertz, scaled_hertz, jkr or halfspace",
        )
    return depth


def _force_at(scene: Scene, depth: float, low: float, high: float) -> float:
    """Invert depth(force) between two forces; it rises with force for every law that has a depth."""
    if depth <= _depth(scene, low):
        return low
    if depth >= _depth(scene, high):
        return high
    return float(brentq(lambda force: _depth(scene, force) - depth, low, high, xtol=1e-10))
