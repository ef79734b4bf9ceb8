"""Figures of the pages light-*.md: ``python docs/validation/light_plate.py`` (llvm needed; about a minute)."""

from __future__ import annotations

import numpy as np

from evanesce.contact.solve import contact_state
from evanesce.core.states import ContactState, PlateGrid
from evanesce.optics.emitters import led_table
from evanesce.optics.guide import contact_radiance, halo_radius
from evanesce.optics.interface import critical_angle, guided_coupling, internal_diffuse_reflectance
from evanesce.optics.led import led_powers
from evanesce.optics.led_circuit import segment_current
from evanesce.optics.projection import IdealView, Projection
from evanesce.render.reference.path import render
from evanesce.rig import LedCircuit, Scene, load_scene

GLASS, SILICONE, WAVELENGTH = 1.523, 1.41, 550.0


def interface() -> None:
    """Print the constants of the interface."""
    gaps = np.array([0.0, 0.05, 0.1, 0.2, 0.5, 1.0]) * 1e-3
    coupling = guided_coupling(gaps, WAVELENGTH, GLASS, SILICONE)
    inner = internal_diffuse_reflectance(gaps, WAVELENGTH, GLASS, SILICONE)
    print(f"critical angles: {np.degrees(critical_angle(GLASS)):.2f} deg to air", end=", ")
    print(f"{np.degrees(critical_angle(GLASS, SILICONE)):.2f} deg to silicone; halo {halo_radius(6.0, GLASS):.2f} mm")
    for g, c, r in zip(gaps, coupling, inner, strict=True):
        print(f"gap {1e3 * g:4.2f} um: guided light coupled {c:6.4f}, internal diffuse reflectance {r:6.4f}")


def circuit() -> None:
    """Print what three bins leave of the rated current."""
    for forward in (2.9, 3.1, 3.3):
        left = segment_current(LedCircuit(forward_voltage_V=forward), np.array([7.0, 8.0, 9.0])) / 20e-3
        print(f"bin {forward} V: " + ", ".join(f"{v} V {100 * x:.3g} %" for v, x in zip((7, 8, 9), left, strict=True)))


def disc(radius: float) -> ContactState:
    """Return a disc in full contact at the middle of the plate."""
    side = 2.2 * radius
    grid = PlateGrid((256, 256), side / 256)
    mask = (np.hypot(*np.meshgrid(grid.x, grid.y)) < radius).astype(float)
    return ContactState(
        grid=grid,
        pressure=mask,
        gap=np.where(mask > 0, 0.0, 0.05),
        contact_mask=mask,
        normal_force=1.0,
        nominal_contact_area=float(np.pi * radius**2),
        depth=0.4,
        law="disc",
    )


def centre(scene: Scene, state: ContactState, samples: int = 65536, **options: object) -> tuple[float, float]:
    """Return the radiance at the plate's middle (0.1 mm square) and its standard error."""
    projection = Projection.of(scene.camera, scene.plate)
    view = IdealView((6, 6), projection.focal_px, (2.5, 2.5))
    light = render(
        scene, state, view=view, samples_per_pixel=samples, passes=8, focus=False, variant="llvm", **options  # type: ignore[arg-type]
    )  # fmt: skip
    return float(light.radiance.mean()), float(np.sqrt(light.variance.sum()) / light.radiance.size)


def plate() -> None:
    """Print the path tracer against the closed form, and the feedback of a contact on itself."""
    scene = load_scene("thesis")
    black = scene.model_copy(update={"plate": scene.plate.model_copy(update={"edge_reflectance": 0.0})})
    leds = led_table(scene.plate, scene.leds, led_powers(scene.leds))
    expected = contact_radiance(
        0.0, 0.0, leds, 6.0, GLASS, SILICONE, 0.6, WAVELENGTH, scene.plate.absorption_coefficient_per_mm, nodes=48
    )
    found, error = centre(black, disc(0.5))
    print(f"black edges, disc of 0.5 mm: traced {found:.5g} +- {error:.1g}, image sum {expected:.5g}")
    found, error = centre(scene, disc(0.5))
    print(f"thesis rig, disc of 0.5 mm: {found:.5g} +- {error:.1g}")
    for radius in (1.0, 7.5):
        found, error = centre(scene, disc(radius))
        print(f"thesis rig, disc of {radius} mm: {found:.5g} +- {error:.1g}")
    depth = {}
    for limit in (64, 1000):
        deep = scene.model_copy(update={"render": scene.render.model_copy(update={"max_depth": limit})})
        depth[limit] = centre(deep, contact_state(deep, 2.0))
    print("depth limit: " + ", ".join(f"{k}: {v:.5g} +- {e:.1g}" for k, (v, e) in depth.items()))


if __name__ == "__main__":
    interface()
    circuit()
    plate()
