"""Figures of the validation pages of effects on the light's way into the plate, on the shipped thesis scene.

Run: python docs/validation/effects_light.py
"""

from __future__ import annotations

import numpy as np

from evanesce.effects import Active, Context, all_effects
from evanesce.optics.guided_field import azimuthal_radiance, edge_radiance
from evanesce.optics.led import led_radiances
from evanesce.optics.led_circuit import radiant_power, strip_voltages
from evanesce.optics.patch_light import angle_nodes, transmitted_irradiance_kernel
from evanesce.render.fast.rig_optics import edge_light, interface_of
from evanesce.rig import Scene, load_scene

PLACES = {"centre": (0.0, 0.0), "left": (-7.0, 0.0), "right": (7.0, 0.0), "top": (0.0, -7.0), "bottom": (0.0, 7.0)}


def coupled(scene: Scene) -> np.ndarray:
    """Irradiance inside touching silicone at PLACES [W/mm^2]."""
    light, interface = edge_light(scene), interface_of(scene)
    theta, weights = angle_nodes(24, interface.n_glass)
    x, y = np.array(list(PLACES.values())).T
    radiance = azimuthal_radiance(light, x, y, theta, diffuse=edge_radiance(light))
    return radiance @ transmitted_irradiance_kernel(theta, weights, np.zeros(1), interface)[0]


def with_effect(scene: Scene, name: str, time_s: float = 0.0, **values: object) -> Scene:
    """Return the scene as the effect leaves it."""
    effect = all_effects()[name]
    entry = Active(effect, effect.parameters(**values))
    changed: Scene = effect.apply(scene, entry.parameters, Context(scene, seed=1, time_s=time_s))
    return changed


CASES: list[tuple[str, dict[str, object], float]] = [
    ("led_dead", {"loss": 1.0, "first": 1, "count": 3}, 0.0),
    ("led_imbalance", {"contrast_x": 0.3}, 0.0),
    ("led_spread", {"spread": 0.1}, 0.0),
    ("supply_sag", {"resistance_ohm_per_mm": 0.0003}, 0.0),
    ("supply_sag", {"resistance_ohm_per_mm": 0.02}, 0.0),
    ("led_warmup", {"warming_K": 30.0}, 60.0),
    ("led_bin", {"offset_V": 0.1}, 0.0),
    ("led_droop", {"droop": 0.1}, 0.0),
    ("glass_absorption", {"absorption_per_mm": 0.001}, 0.0),
    ("glass_dispersion", {"strength": 1.0}, 0.0),
    ("edge_finish", {"share": 1.0, "polish": 1.0}, 0.0),
    ("edge_finish", {"share": 1.0, "polish": 0.0, "reflectance": 0.85}, 0.0),
    ("edge_finish", {"share": 1.0, "polish": 0.0, "reflectance": 0.05}, 0.0),
    ("led_air_gap", {"share": 1.0}, 0.0),
]


def main() -> None:
    """Print the tables."""
    print("Irradiance coupled at a contact, change in percent, by place and supply voltage:")
    for volts in (9.0, 8.0):
        scene = load_scene("thesis", {"leds.voltage_V": volts})
        base = coupled(scene)
        for name, values, time_s in CASES:
            change = 100 * (coupled(with_effect(scene, name, time_s, **values)) / base - 1)
            shown = ", ".join(f"{k} {v:g}" for k, v in values.items())
            shown = "  ".join(f"{place} {c:+.2f}" for place, c in zip(PLACES, change, strict=True))
            print(f"  {volts:g} V  {name} ({shown}):  {shown}")
    print("Light left at 8, 8.5 and 9 V, percent of that at 12 V, by forward voltage at 20 mA (7.5 ohm in each LED):")
    for bin_V in (2.9, 3.1, 3.3):
        circuit = load_scene("thesis").leds.circuit.model_copy(
            update={"forward_voltage_V": bin_V, "led_resistance_ohm": 7.5}
        )
        left = 100 * radiant_power(circuit, np.array([8.0, 8.5, 9.0])) / radiant_power(circuit, 12.0)
        print(f"  {bin_V} V: " + "  ".join(f"{value:.3g}" for value in left))
    leds = load_scene("thesis").leds
    along = np.arange(8) * 16.67 + 1.7
    for ohm in (0.0003, 0.02):
        sag = 9.0 - strip_voltages(leds.circuit, 9.0, along, ohm)
        print(f"Sag at the far end of a strip of 8 LEDs at 9 V, {ohm:g} ohm/mm: {1e3 * sag[-1]:.3g} mV")
    scene = load_scene("thesis")
    spread = np.concatenate(
        list(led_radiances(scene.plate, with_effect(scene, "led_spread", spread=0.1).leds).values())
    )
    print(f"Spread 0.1 drawn with seed 1: relative standard deviation {spread.std() / spread.mean():.3f}")


if __name__ == "__main__":
    main()
