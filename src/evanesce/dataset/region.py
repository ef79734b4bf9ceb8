"""Region of interest: the part of the camera's view that the contacts of a dataset need, read out on few pixels."""

from __future__ import annotations

import math
from functools import cache
from typing import Any

import numpy as np

from evanesce.contact.analytic.partial_slip import tangential_modulus
from evanesce.contact.laws import smooth_contact
from evanesce.contact.tilt import require_on_tip
from evanesce.core.errors import InputError
from evanesce.dataset.config import CameraOptions, DatasetConfig, Trial
from evanesce.dataset.design import RigPlan, TrialPlan, trial_plan
from evanesce.dataset.directional import ridge_friction
from evanesce.dataset.mechanics import gross_slip, interface, shaft_stiffness
from evanesce.dataset.motions import cycle_of, is_planar, path_of
from evanesce.materials import silicone_of
from evanesce.optics.projection import Projection
from evanesce.rig import Scene

SAMPLED_TRIALS = 64
"""Trials whose contacts the region must hold, however many are made; 0.5 % of 2000 others are cut at the most."""
MARGIN = 1.02
"""Of the region over those contacts."""


def contact_reach(plan: TrialPlan, scene: Scene, trial: Trial) -> tuple[float, float]:
    """Return how far a trial's contact goes from the finger's position along x and y [mm], rim included.

    Parameters
    ----------
    plan : TrialPlan
    scene : Scene
        With the trial's finger.
    trial : Trial
        Section of the configuration.
    """
    p, force = plan.programme, plan.programme["normal_force_N"]
    contact, modulus = smooth_contact(scene, force)
    require_on_tip(scene, contact.contact_radius)
    radius, along, aside = contact.contact_radius, 0.0, (0.0, 0.0)
    friction, shaft = interface(plan, contact), shaft_stiffness(plan)
    shear = float(tangential_modulus(modulus, silicone_of(scene.finger).poisson_ratio))
    gross, limit = gross_slip(plan, trial, contact, friction, shear, shaft)
    if is_planar(plan) and plan.kind != "wiggle":
        return _planar_reach(plan, scene, limit, gross, shear, shaft)
    if plan.kind == "slide":
        along = 0.5 * (gross - limit / shaft + p["distance_mm"])
    elif plan.kind == "wiggle":
        along = p["wiggle_share"] * limit / (2.0 * radius * shear)
    elif plan.kind == "change":
        radius = max(radius, smooth_contact(scene, p["second_force_share"] * force)[0].contact_radius)
        aside = abs(p["shift_mm"]), 0.5 * abs(p["shift_mm"])
    angle = math.radians(p["direction_deg"])
    return radius + abs(along * math.cos(angle)) + aside[0], radius + abs(along * math.sin(angle)) + aside[1]


def _planar_reach(
    plan: TrialPlan, scene: Scene, limit: float, gross: float, shear: float, shaft: float
) -> tuple[float, float]:
    """Return :func:`contact_reach` of a finger on a path: half of the path's extent, and the wider contact's rim."""
    p, m = plan.programme, plan.motion
    force = p["normal_force_N"]
    factors = m.get("force_factor", 1.0), p["second_force_share"] if plan.kind == "regrasp" else 1.0
    radii = [smooth_contact(scene, factor * force)[0].contact_radius for factor in (1.0, *factors)]
    extent, shift = np.zeros(2), 0.0
    if plan.kind != "spin":
        stiffness = 1.0 / (1.0 / (2.0 * radii[0] * shear) + 1.0 / shaft)
        path = path_of(plan, gross, cycle_of(plan, limit, stiffness))
        corners = np.array([path.at(np.array(way)) for way in (0.0, path.legs[0], path.length)])
        aside = abs(1.0 - ridge_friction(plan)[0]) * limit / shaft  # ridges push the tip off its way, no farther
        extent = 0.5 * (np.ptp(corners, axis=0) + aside)
    if plan.kind == "regrasp":
        shift = abs(p["shift_mm"])
    return max(radii) + float(extent[0]) + shift, max(radii) + float(extent[1]) + 0.5 * shift


def reaches(scene: Scene, config: DatasetConfig, seed: int, trials: int) -> np.ndarray:
    """Return :func:`contact_reach` of the first trials, shape (n, 2) [mm]."""
    from evanesce.dataset.rigs import rig_scene

    whole = config.model_copy(update={"camera": CameraOptions()})

    @cache
    def with_finger(index: int) -> Scene:
        plan = next(p for p in plans if p.finger.index == index)
        return rig_scene(scene, RigPlan(0, 0, {}, {}), plan.finger, whole)

    plans = [trial_plan(config, seed, i) for i in range(trials)]
    return np.array([contact_reach(plan, with_finger(plan.finger.index), config.trial) for plan in plans])


def fitted_region(scene: Scene, config: DatasetConfig, seed: int) -> tuple[float, float]:
    """Return the smallest region (width, height) with the aspect of the frame that holds the contacts [mm]."""
    assert config.camera.size_px is not None  # the caller's
    cols, rows = config.camera.size_px
    x, y = MARGIN * 2.0 * reaches(scene, config, seed, SAMPLED_TRIALS).max(axis=0)
    width = round(float(max(x, y * cols / rows)), 2)
    return width, round(width * rows / cols, 4)


def crop(camera: dict[str, Any], scene: Scene, options: CameraOptions) -> None:
    """Cut a camera's table to the region about the finger, binned to the size asked for.

    Parameters
    ----------
    camera : dict
        Changed in place.
    scene : Scene
        With that camera, whole.
    options : CameraOptions
        With size and region.

    Raises
    ------
    InputError
        If the camera does not see the region.
    """
    from evanesce.dataset.rigs import bin_pixels

    assert options.size_px is not None  # the caller's
    assert options.region_mm is not None
    projection = Projection.of(scene.camera, scene.plate)
    cols, rows = options.size_px
    x, y = scene.finger.position_mm
    u, v = projection.to_image(np.array([x, x - 0.5, x + 0.5]), np.array([y, y, y]))
    binned = options.region_mm[0] * float(u[2] - u[1]) / cols
    first = [float(u[0]) - 0.5 * (cols * binned - 1), float(v[0]) - 0.5 * (rows * binned - 1)]
    whole = scene.camera.resolution_px
    for axis, size in enumerate((cols, rows)):
        room = whole[axis] - size * binned
        if room < 0.0:
            raise InputError(
                f"{options.region_mm[0]:g} x {options.region_mm[1]:g} mm are more than the camera sees",
                key="camera.region_mm", allowed="a smaller region, or a smaller camera.scale_px_per_mm in the scene",
            )  # fmt: skip
        first[axis] = min(max(first[axis], 0.0), room)
    bin_pixels(camera, 1.0 / binned)
    camera["resolution_px"] = [cols, rows]
    # integer = pixel centre: a new pixel's centre is the middle of the pixels it joins
    camera["principal_point_offset_px"] = [
        (old - start + 0.5) / binned - 0.5 - (size - 1) / 2
        for old, start, size in zip(projection.principal_point, first, (cols, rows), strict=True)
    ]


def crop_warning(scene: Scene, config: DatasetConfig, seed: int, trials: int) -> str:
    """Return a sentence where contacts leave the frame; empty if none does."""
    from evanesce.dataset.rigs import rig_scene

    plan = trial_plan(config, seed, 0)
    seen = rig_scene(scene, RigPlan(0, 0, {}, {}), plan.finger, config)
    projection = Projection.of(seen.camera, seen.plate)
    rows, cols = projection.shape
    far = reaches(scene, config, seed, min(trials, SAMPLED_TRIALS))
    x0, y0 = seen.finger.position_mm
    corners_x = x0 + far[:, :1] * np.array([-1, 1, 0, 0])
    corners_y = y0 + far[:, 1:] * np.array([0, 0, -1, 1])
    u, v = projection.to_image(corners_x, corners_y)
    cut = np.any((u < -0.5) | (u > cols - 0.5) | (v < -0.5) | (v > rows - 0.5), axis=1)
    if not cut.any():
        return ""
    wide, high = 2.0 * far.max(axis=0)
    scale = seen.camera.scale_px_per_mm
    return (
        f"the frame shows {cols / scale:.3g} x {rows / scale:.3g} mm, contacts and their ways take up to {wide:.3g} x"
        f" {high:.3g} mm: cut off in {int(cut.sum())} of {cut.size} trials (--size {cols}x{rows} takes a region about"
        " them)"
    )
