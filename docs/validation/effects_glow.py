"""Figures of the validation pages of subsurface scattering and real contact.

Run: python docs/validation/effects_glow.py
"""

from __future__ import annotations

import numpy as np

from evanesce.contact.analytic.roughness import persson_contact_fraction
from evanesce.contact.solve import contact_state
from evanesce.optics.subsurface import absorption_coefficient, dipole_profile, profile, share_within
from evanesce.render.fast.fields import fields_of
from evanesce.render.fast.patch import patch_radiance
from evanesce.rig import load_scene


def main() -> None:
    """Print the tables."""
    albedo = 0.6
    print(f"Body of reflectance {albedo}: encircled share of what leaves within 0.25, 0.5, 1, 2, 4 mm")
    for length in (0.5, 1.0, 2.0):
        within = share_within(np.array([0.25, 0.5, 1.0, 2.0, 4.0]), albedo, length)
        sigma_a = absorption_coefficient(albedo, length)
        shown = "  ".join(f"{v:.2f}" for v in within)
        print(f"  l = {length} mm (sigma_s' {1 / length - sigma_a:.2f} /mm, sigma_a {sigma_a:.3f} /mm): {shown}")
    ratio = profile(np.array([0.1, 1.0, 4.0]), albedo, 1.0) / dipole_profile(
        np.array([0.1, 1.0, 4.0]), 1 - absorption_coefficient(albedo, 1.0), absorption_coefficient(albedo, 1.0)
    )
    print(f"  profile over dipole at 0.1, 1 and 4 mm, l = 1 mm: {np.round(ratio, 2)}")

    changes = {"contact": {"law": "hertz", "reduced_modulus_MPa": 4.0}}
    scene = load_scene("thesis_ridged", changes)
    state = contact_state(scene, 1.0)
    plain, pitch = patch_radiance(fields_of(scene), state)
    peak = float(plain.max())
    r = np.hypot(state.grid.x[None], state.grid.y[:, None])
    fine_r, gap = np.kron(r, np.ones((2, 2))), np.kron(np.asarray(state.gap), np.ones((2, 2)))
    groove, crest = (gap > 3e-3) & (fine_r < 0.9), (gap == 0) & (fine_r < 0.9)
    print(f"Ridged finger, 1 N, E* 4 MPa (grooves open), true contact {state.nominal_contact_area:.2f} mm^2:")
    for length in (0.0, 0.25, 0.5, 1.0, 2.0):
        lit = load_scene("thesis_ridged", changes | {"finger.scattering_length_mm": length})
        image, _ = patch_radiance(fields_of(lit), state)
        areas = "  ".join(f"{(image > t * peak).sum() * pitch**2:.2f}" for t in (0.05, 0.15, 0.35))
        crests, grooves = image[crest].mean() / peak, image[groove].mean() / peak
        print(f"  l = {length} mm: crest {crests:.3f}, groove {grooves:.3f} of the plain peak", end="; ")
        print(f"total {image.sum() / plain.sum():.3f}; area above 5, 15, 35 % of the plain peak {areas} mm^2")
    print("Real contact, smooth finger of the thesis, share at the middle of the contact by force and rms slope:")
    for slope in (0.1, 0.3, 1.0):
        shares = []
        for force in (0.5, 1.0, 2.0, 5.0):
            smooth = contact_state(load_scene("thesis"), force)
            modulus = float(smooth.parameters["reduced_modulus_MPa"])
            shares.append(float(persson_contact_fraction(smooth.pressure.max(), modulus, slope)))
        print(f"  {slope}: " + "  ".join(f"{s:.3f}" for s in shares) + "  at 0.5, 1, 2, 5 N")


if __name__ == "__main__":
    main()
