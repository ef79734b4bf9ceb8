"""Groups of causes that change frames alike, so that a set of them can be told by one name."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

GROUPS: Mapping[str, frozenset[str]] = {
    "light of the LED strips": frozenset(
        {
            "led_air_gap", "led_bin", "led_dead", "led_droop", "led_edge_reflections", "led_imbalance", "led_spread",
            "led_warmup", "supply_sag",
        }
    ),
    "size of the contact": frozenset(
        {
            "adhesion", "bone_stiffening", "creep", "force_offset", "liquid_film", "modulus", "off_axis_load",
            "real_contact", "ridge_height", "shear_area_loss",
        }
    ),
    "levels of the camera": frozenset({"ambient_light", "black_level", "saturation", "tone_curve"}),
    "light beside the contact": frozenset(
        {"backdrop", "lateral_glow", "led_spill", "plate_haze", "residue_film", "scratch"}
    ),
    "glass": frozenset({"edge_finish", "glass_absorption", "glass_dispersion"}),
    "lens": frozenset({"defocus", "distortion_drift", "plate_tilt", "vignetting"}),
}  # fmt: skip
"""By name. A cause that is in none is told by its own."""


def group_of(causes: Iterable[str]) -> str:
    """Return the name of the group that all causes belong to; empty if there is none.

    Parameters
    ----------
    causes : iterable of str
    """
    wanted = set(causes)
    return next((name for name, members in GROUPS.items() if wanted <= members), "")
