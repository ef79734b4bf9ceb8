"""Figures of light-bands.md: one wavelength against white light in bands, fast renderer, a coarse camera.

Run: python docs/validation/light_bands.py (about a minute a band where its fields are not cached)
"""

from __future__ import annotations

import numpy as np

from evanesce.contact.solve import contact_state
from evanesce.measurement.reference.segment import Chain
from evanesce.optics.spectrum import pdms_index, soda_lime_index, white_bands
from evanesce.render.bands import banded, in_band
from evanesce.render.fast.transport import render_fast
from evanesce.rig import load_scene
from evanesce.studies.voltage.press import Press

COARSE = {
    "camera.resolution_px": [500, 375],
    "camera.scale_px_per_mm": 14.6,
    "camera.lens.focal_length_mm": 1.5,
    "camera.lens.distortion": {},
    "grid.samples": 512,
}


def main(count: int = 3) -> None:
    """Print bands, the change of radiance, of its distribution, and of the area found."""
    for band in white_bands(count):
        indices = float(soda_lime_index(band.wavelength)), float(pdms_index(band.wavelength))
        print(f"{band.wavelength:.0f} nm, weight {band.weight:.3f}: glass {indices[0]:.4f}, PDMS {indices[1]:.4f}")
    milky = load_scene("thesis", {"finger.scattering_length_mm": 1.0, "finger.scattering_power": 1.5})
    for band in white_bands(count):
        finger = in_band(milky, band).finger
        length = finger.scattering_length_mm
        print(f"{band.wavelength:.0f} nm: reflectance {finger.diffuse_reflectance:.3f}, {length:.2f} mm")
    for name in ("thesis", "thesis_ridged"):
        scene = load_scene(name, COARSE)
        state = contact_state(scene, 2.0)
        one, white = (banded(render_fast, n)(scene, state, seed=1).radiance for n in (1, count))
        inside = one > 0.5 * one.max()
        ratio = white[inside] / one[inside]
        spread = np.percentile(ratio / ratio.mean(), [1, 99])
        print(
            f"{name}: mean radiance in contact {ratio.mean():.4f} of that at {scene.camera.wavelength_nm:g} nm",
            end="; ",
        )
        print(f"1 and 99 % of the pixels at {spread[0]:.4f} and {spread[1]:.4f} of that ratio")
        areas = [
            Press.of(scene, 2.0, seed=1, render=banded(render_fast, n)).area(9.0, Chain(threshold=0.15, min_blob=20))
            for n in (1, count)
        ]
        print(
            f"{name}: area at threshold 0.15: {areas[0]:.3f} mm^2 in one band, {areas[1]:.3f} in {count}; true "
            f"{state.nominal_contact_area:.3f}"
        )


if __name__ == "__main__":
    main()
