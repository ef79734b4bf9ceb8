"""What is not published of a rig in red light under a colour camera, and the settings that the real frame allows.

References
----------
The real contact frame: drmacani/Waveguide (MIT), commit 2288bc03, a thumbnail; read by
``docs/validation/real_frame_colour.py`` (docs/validation/sensor-colour.md).
"""

from __future__ import annotations

from dataclasses import replace

from evanesce.rig import Scene
from evanesce.sensor.automatic import STAGES
from evanesce.studies.voltage.unknowns import UNKNOWNS, Unknown

# Colour temperature of white balance and matrix [K], green and blue pixels' response over red ones': all settings of
# the grid whose RMS on the real frame is within 1 DN of the best (``possible`` of the script's --json).
SETTINGS: tuple[tuple[int, float, float], ...] = (
    (2500, 0.04, 0.01), (2700, 0.04, 0.01), (4559, 0.04, 0.02), (5200, 0.04, 0.02), (3250, 0.06, 0.02),
    (4559, 0.06, 0.03), (5200, 0.06, 0.03), (2500, 0.08, 0.02), (2700, 0.08, 0.02), (3580, 0.08, 0.03),
    (4559, 0.08, 0.04), (5200, 0.08, 0.04), (2360, 0.1, 0.02), (2850, 0.1, 0.03), (3580, 0.1, 0.04),
    (4000, 0.1, 0.04), (4559, 0.1, 0.05), (5200, 0.1, 0.05), (2500, 0.12, 0.03), (2700, 0.12, 0.03),
    (3250, 0.12, 0.04), (3580, 0.12, 0.05), (4000, 0.12, 0.05), (4559, 0.12, 0.06), (5200, 0.12, 0.06),
    (2360, 0.15, 0.03), (2700, 0.15, 0.04), (2850, 0.15, 0.04), (3250, 0.15, 0.05), (3580, 0.15, 0.06),
    (4000, 0.15, 0.06), (5200, 0.15, 0.08), (5881, 0.15, 0.08), (2360, 0.2, 0.04), (2500, 0.2, 0.05),
    (2700, 0.2, 0.05), (2850, 0.2, 0.06), (3580, 0.2, 0.08), (4000, 0.2, 0.08), (4559, 0.2, 0.1), (5200, 0.2, 0.1),
    (2360, 0.3, 0.06), (2700, 0.3, 0.08), (2850, 0.3, 0.08), (3250, 0.3, 0.1), (4559, 0.3, 0.15), (5200, 0.3, 0.15),
)  # fmt: skip
"""Joint settings of filters and white balance, by rising green response."""

WHITE_LEDS = 3
"""LEDs in series to which the bins of :data:`UNKNOWNS` belong."""


RED = Unknown("forward_voltage", 1.8, 2.3, "V", False, "about the 2.05 V of OSRAM LR T67F at 20 mA")
"""Bins of red LEDs: five in series at 12 V, or three as in strips of three colours; assumed."""


def longest_exposure(scene: Scene) -> float:
    """Return the largest product of exposure and gain that the published control reaches in a frame's time [ms].

    Parameters
    ----------
    scene : Scene

    Returns
    -------
    float
        [ms].
    """
    control = scene.camera.auto_exposure
    longest, gain = STAGES["normal" if control is None else control.mode][-1]
    return min(longest, 1e3 / scene.press.frame_rate_hz) * gain


def colour_unknowns(scene: Scene) -> tuple[Unknown, ...]:
    """Return the unknowns of a scene with a colour camera.

    Parameters
    ----------
    scene : Scene

    Returns
    -------
    tuple of Unknown
        The six of :data:`UNKNOWNS`, exposure as product with the gain, and what only a colour frame shows.
    """
    by_name = {u.name: u for u in UNKNOWNS}
    share = WHITE_LEDS / scene.leds.circuit.leds_per_segment
    forward = by_name["forward_voltage"]
    # The same voltage of a whole segment as in the monochrome study: what colour changes is colour alone.
    forward = replace(
        forward, low=forward.low * share, high=forward.high * share,
        why="8.4 to 9.9 V a segment: bins of three white LEDs, or of four or five red ones",
    )  # fmt: skip
    exposure = Unknown(
        "exposure", 1.0, longest_exposure(scene), "ms", True, "times gain; up to the published control's longest"
    )
    changed = {"forward_voltage": forward, "exposure": exposure}
    return (
        *(changed.get(u.name, u) for u in UNKNOWNS),
        Unknown("filters", 0, len(SETTINGS) - 1, "1", False, "settings that the real frame allows", len(SETTINGS)),
        Unknown(
            "flank", 0.012, 0.23, "1", True, "ring over contact of the real frame: by its twin, and pixel by pixel"
        ),
        Unknown("ground", 0.0009, 0.0127, "1", True, "ground over contact of the real frame"),
        Unknown("exposure_control", 0, 1, "1", False, "0 fixed, 1 the published control", 2),
        Unknown(
            "f_number", 1.4, 8.0, "1", True, "not published; with it the power of the LEDs' light, which is not either"
        ),
    )
