"""The plate's border path traced, with arrises bevelled as glass is cut: what the camera sees of the LEDs there.

Reference of the effect ``led_edge_reflections``, whose law is empirical. A bevel at 45 degrees turns guided light,
which runs along the plate, towards the camera; without it the LEDs are seen through the face and in their images by the
faces alone. There is no finger.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evanesce.core.states import PlateLight
from evanesce.optics.led import led_positions
from evanesce.optics.projection import IdealView, Projection
from evanesce.render.reference.haze import hazy
from evanesce.render.reference.led_groups import Powers, in_units
from evanesce.render.reference.passes import Until, pass_samples, trace
from evanesce.render.reference.path import integrator_for
from evanesce.render.reference.scene import EDGES, camera_dict, edge_spans, make_mesh, on_edge, plate_scene, quads_of
from evanesce.render.variant import select
from evanesce.rig import Scene

Array = NDArray[np.float64]


def render_border(
    scene: Scene,
    powers: Mapping[str, Powers],
    view: IdealView,
    *,
    bevel_mm: float = 0.0,
    roughness: float = 0.0,
    variant: str = "auto",
    samples_per_pixel: int = 64,
    passes: int = 8,
    seed: int = 0,
) -> PlateLight:
    """Path trace the empty plate with bevelled arrises.

    Parameters
    ----------
    scene : Scene
    powers : mapping
        Radiant power [W] by edge, of each LED there or of every one.
    view : IdealView
    bevel_mm : float
        Width of the bevels, top and bottom, along either leg; below the LEDs' distance from the faces [mm].
    roughness : float
        Of the bevels, Beckmann's alpha; 0 for polished ones.
    variant : {"auto", "llvm", "cuda"}
    samples_per_pixel, passes : int
        Samples in all passes together; independent passes that the variance is estimated from.
    seed : int

    Returns
    -------
    PlateLight
    """
    info = select(variant)
    lit, unit = in_units(powers)
    model = plate_scene(scene, None, lit, info.is_jit)
    if bevel_mm > 0:
        model.shapes.update(_bevelled(scene, bevel_mm, roughness))
    # Connections suppose that the faces reach to the edges.
    integrator = integrator_for(scene, info, model, lit, connect=False)
    per_pass = pass_samples(samples_per_pixel, passes)
    sums = trace(
        model.shapes, camera_dict(Projection.of(scene.camera, scene.plate), view), integrator,
        samples=per_pass, until=Until(passes), seed=seed, name="border",
    )  # fmt: skip
    return PlateLight(
        radiance=sums.mean[..., 0] * unit, variance=sums.variance_of_mean[..., 0] * unit**2,
        focal_px=view.focal_px, principal_point=view.principal_point, samples=per_pass * sums.count,
    )  # fmt: skip


def image_positions(scene: Scene, bounces: int) -> tuple[Array, Array]:
    """Return heights of the LEDs' centres as the camera sees them from below, and what the faces leave of their light.

    Reflected at the top face, then at the bottom one and so on, an LED at depth t/2 has images at heights (k - 1/2) t
    over the top face; the reflectance is that of normal incidence.

    Parameters
    ----------
    scene : Scene
    bounces : int
        Largest k.

    Returns
    -------
    height : ndarray (bounces + 1,)
        Over the top face, in glass throughout [mm].
    share : ndarray (bounces + 1,)
        R^k, over that of the LED seen directly [1].
    """
    n, k = scene.plate.refractive_index, np.arange(bounces + 1)
    return np.asarray((k - 0.5) * scene.plate.thickness_mm), np.asarray(((n - 1) / (n + 1)) ** (2.0 * k))


def _bevelled(scene: Scene, bevel: float, roughness: float) -> dict[str, Any]:
    """Return faces that end at the bevels, the dark parts of the edges between them, and the bevels."""
    plate, leds = scene.plate, scene.leds
    (hx, hy), t = (size / 2 for size in plate.size_mm), plate.thickness_mm
    bare: dict[str, Any] = {"type": "dielectric", "int_ior": plate.refractive_index, "ext_ior": 1.0}
    cut = bare if roughness == 0 else bare | {"type": "roughdielectric", "alpha": roughness}
    ground = {"type": "diffuse", "reflectance": {"type": "uniform", "value": plate.edge_reflectance}}

    def ring(inset: float, z: float) -> Array:
        x, y = hx - inset, hy - inset
        return np.array([(-x, -y, z), (x, -y, z), (x, y, z), (-x, y, z)])

    top, upper, lower, bottom = ring(bevel, 0.0), ring(0.0, -bevel), ring(0.0, bevel - t), ring(bevel, -t)
    slopes = [
        (low[k], low[k - 3], high[k - 3], high[k]) for high, low in ((top, upper), (lower, bottom)) for k in range(4)
    ]
    positions, dark = led_positions(plate, leds), []
    for edge in EDGES:
        length = plate.size_mm[1] if edge in ("left", "right") else plate.size_mm[0]
        spans = edge_spans(
            length, t, positions.get(edge, np.zeros(0)), leds.emitting_width_mm, leds.emitting_height_mm
        )[1]
        between = [(a0, a1, max(z0, bevel - t), min(z1, -bevel)) for a0, a1, z0, z1 in spans]
        dark.append(on_edge(edge, (hx, hy), between))
    return {
        "top": make_mesh("top", *quads_of(top[None]), hazy(scene, "top", bare, glass_front=False, contact=None)),
        "bottom": make_mesh(
            "bottom", *quads_of(bottom[None, ::-1]), hazy(scene, "bottom", bare, glass_front=False, contact=None)
        ),
        "bevels": make_mesh("bevels", *quads_of(np.array(slopes)), cut),
        "edges": make_mesh("edges", *quads_of(np.concatenate(dark)), ground),
    }
