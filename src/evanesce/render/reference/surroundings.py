"""Path-traced light that the strips spill above the plate: on the finger's flank, on a backdrop, through the plate.

The plate's own light is not among it; it adds. Spill is never guided (it enters by a face and leaves by the other), so
that paths are short and a built-in integrator serves in every variant. Where the finger touches the contact is black.
Haze does not act on it: spill crosses each face once, and a share of it would be lost.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from evanesce.core.states import ContactState, PlateLight
from evanesce.optics.flank.pressed import PressedFinger
from evanesce.optics.led import led_positions
from evanesce.optics.projection import IdealView, Projection
from evanesce.render.reference.passes import Until, pass_samples, trace
from evanesce.render.reference.scene import approach, camera_dict, make_mesh
from evanesce.render.variant import select
from evanesce.rig import Scene

Array = NDArray[np.float64]

DEPTH = 16
"""Longest path: each reflection at plate or finger loses light."""

SECTIONS = 128
"""Of the finger's circumference."""

CLEARANCE_MM = 0.004
"""Between glass and the black contact, and once more up to the finger."""


def render_spill(
    scene: Scene,
    state: ContactState | None,
    powers: Mapping[str, ArrayLike],
    view: IdealView,
    *,
    variant: str = "auto",
    samples_per_pixel: int = 64,
    passes: int = 4,
    seed: int = 0,
) -> PlateLight:
    """Path trace the light that the strips spill above the plate, as the camera sees it.

    Parameters
    ----------
    scene : Scene
        With ``surroundings``.
    state : ContactState or None
        None with the finger lifted away.
    powers : mapping
        Radiant power that enters the plate [W] by edge, of each LED there or of every one.
    view : IdealView
    variant : {"auto", "llvm", "scalar", "cuda"}
    samples_per_pixel, passes : int
        Samples in all passes together; independent passes that the variance is estimated from.
    seed : int

    Returns
    -------
    PlateLight
    """
    select(variant)
    projection = Projection.of(scene.camera, scene.plate)
    largest = max(float(np.max(p, initial=0.0)) for p in powers.values())
    shapes = {"type": "scene", **_plate(scene), **_bands(scene, powers, largest)}
    if state is not None:
        shapes |= _finger(scene, approach(state, scene.finger))
    shapes |= backdrop_shape(scene)
    per_pass = pass_samples(samples_per_pixel, passes)
    sums = trace(
        shapes, camera_dict(projection, view), {"type": "path", "max_depth": DEPTH, "rr_depth": DEPTH},
        samples=per_pass, until=Until(passes), seed=seed, name="spill",
    )  # fmt: skip
    return PlateLight(
        radiance=sums.mean[..., 0] * largest,
        variance=sums.variance_of_mean[..., 0] * largest**2,
        focal_px=view.focal_px,
        principal_point=view.principal_point,
        samples=per_pass * sums.count,
    )


def backdrop_shape(scene: Scene) -> dict[str, Any]:
    """Return a scene's backdrop as a shape, wide enough for what the camera sees of it; empty if it has none.

    Parameters
    ----------
    scene : Scene
    """
    if scene.surroundings is None or scene.surroundings.backdrop.reflectance == 0:
        return {}
    backdrop = scene.surroundings.backdrop
    half = 0.5 * max(scene.plate.size_mm) + 2.0 * backdrop.distance_mm
    middle = (0.0, 0.0, backdrop.distance_mm)
    return {"backdrop": _rectangle(middle, (0, 1, 0), (1, 0, 0), (half, half), backdrop.reflectance)}


def _rectangle(
    middle: tuple[float, float, float], right: Any, up: Any, half: tuple[float, float], reflectance: float, **more: Any
) -> dict[str, Any]:
    """Return a rectangle with the normal right x up; ``more`` are children."""
    import mitsuba as mi

    matrix = np.eye(4)
    right, up = np.asarray(right, float), np.asarray(up, float)
    matrix[:3, 0], matrix[:3, 1], matrix[:3, 2] = right * half[0], up * half[1], np.cross(right, up)
    matrix[:3, 3] = middle
    bsdf = {"type": "diffuse", "reflectance": {"type": "uniform", "value": reflectance}}
    return {"type": "rectangle", "to_world": mi.ScalarTransform4f(matrix.tolist()), "bsdf": bsdf, **more}


def _plate(scene: Scene) -> dict[str, Any]:
    """Return the plate's faces, and its edges, which take all light."""
    (hx, hy), t = (size / 2 for size in scene.plate.size_mm), scene.plate.thickness_mm
    glass = {"type": "dielectric", "int_ior": scene.plate.refractive_index, "ext_ior": 1.0}
    edge = t / 2
    return {
        "top": _rectangle((0, 0, 0), (1, 0, 0), (0, 1, 0), (hx, hy), 0.0) | {"bsdf": glass},
        "bottom": _rectangle((0, 0, -t), (0, 1, 0), (1, 0, 0), (hy, hx), 0.0) | {"bsdf": glass},
        "left": _rectangle((-hx, 0, -edge), (0, 1, 0), (0, 0, 1), (hy, edge), 0.0),
        "right": _rectangle((hx, 0, -edge), (0, 0, 1), (0, 1, 0), (edge, hy), 0.0),
        "upper": _rectangle((0, -hy, -edge), (0, 0, 1), (1, 0, 0), (edge, hx), 0.0),
        "lower": _rectangle((0, hy, -edge), (1, 0, 0), (0, 0, 1), (hx, edge), 0.0),
    }


def _bands(scene: Scene, powers: Mapping[str, ArrayLike], unit: float) -> dict[str, Any]:
    """Return the lit bands above the edges, in front of the LEDs; radiance for powers over ``unit``."""
    surroundings, width = scene.surroundings, scene.leds.emitting_width_mm
    if surroundings is None or surroundings.spill.share == 0 or unit == 0:
        return {}
    height, (hx, hy) = surroundings.spill.height_mm, (size / 2 for size in scene.plate.size_mm)
    found = {}
    for edge, centres in led_positions(scene.plate, scene.leds).items():
        power = np.broadcast_to(np.asarray(powers.get(edge, 0.0), float), centres.shape)
        for k, (at, own) in enumerate(zip(centres, power, strict=True)):
            radiance = surroundings.spill.share * float(own) / unit / (np.pi * width * height)
            emitter = {"type": "area", "radiance": {"type": "uniform", "value": radiance}}
            z, half = height / 2, (width / 2, height / 2)
            middle, along, up = {
                "left": ((-hx, at, z), (0, 1, 0), (0, 0, 1)),
                "right": ((hx, at, z), (0, -1, 0), (0, 0, 1)),
                "top": ((at, -hy, z), (-1, 0, 0), (0, 0, 1)),
                "bottom": ((at, hy, z), (1, 0, 0), (0, 0, 1)),
            }[edge]
            found[f"band_{edge}_{k}"] = _rectangle(middle, along, up, half, 0.0, emitter=emitter)
    return found


def _finger(scene: Scene, depth: float) -> dict[str, Any]:
    """Return the pressed finger, and the black contact below it."""
    import trimesh  # a third of a second that those who trace no path need not wait

    half = min(scene.finger.diameter_mm / 2, scene.finger.tip_radius_mm)
    finger = PressedFinger((0.0, 0.0), scene.finger.tip_radius_mm, half, scene.finger.length_mm, depth)
    r, z, _ = finger.rings()
    mesh = trimesh.creation.revolve(np.stack([np.append(r, 0.0), np.append(z, z[-1])], axis=1), sections=SECTIONS)
    raised = mesh.vertices + np.array([*scene.finger.position_mm, 2 * CLEARANCE_MM])
    body = {"type": "diffuse", "reflectance": {"type": "uniform", "value": scene.finger.diffuse_reflectance}}
    shapes = {"finger": make_mesh("finger", raised, mesh.faces, {"type": "twosided", "bsdf": body})}
    if finger.contact_radius > 0:
        import mitsuba as mi

        x, y = scene.finger.position_mm
        place = mi.ScalarTransform4f().translate([x, y, CLEARANCE_MM]).scale(finger.contact_radius)
        black = {"type": "diffuse", "reflectance": {"type": "uniform", "value": 0.0}}
        shapes["contact"] = {"type": "disk", "to_world": place, "bsdf": {"type": "twosided", "bsdf": black}}
    return shapes
