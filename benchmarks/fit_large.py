"""``evanesce fit`` on frames of 2000 x 1500 pixels: ``PYTHONPATH=. python benchmarks/fit_large.py``.

The thesis's rig with five departures of the library's own forms, simulated as a whole measurement. Printed are the time
of the fit, the most memory that one of its processes took, errors of held-out areas, and whether intervals hold what
was hidden.
"""

from __future__ import annotations

import resource
import sys
import tempfile
import time
from pathlib import Path

from evanesce.bundle import read_bundle
from evanesce.bundle.write import write_bundle
from evanesce.inference.calibration.answer import result_of
from evanesce.inference.calibration.fit import fit_rig
from evanesce.rig import load_scene

FRAME = {"camera.resolution_px": [2000, 1500], "camera.scale_px_per_mm": 58.37}
HIDDEN = {
    "effects.modulus.relative": 0.12, "effects.vignetting.k": 0.1, "effects.black_level.offset_DN": 4.0,
    "effects.distortion_drift.k1": 0.004, "effects.led_droop.droop": 0.1,
}  # fmt: skip
WORKERS = 2


def main() -> None:
    """Make the measurement, fit it and print the figures."""
    with tempfile.TemporaryDirectory(prefix="fit-large-") as folder:
        path = Path(folder) / "mine"
        write_bundle(path, load_scene("thesis", {**FRAME, **HIDDEN}), seed=3, nominal=load_scene("thesis", FRAME))
        began = time.monotonic()
        found = fit_rig(read_bundle(path), workers=WORKERS, tell=lambda line: print("   ", line, file=sys.stderr))
        seconds = time.monotonic() - began
    answer = result_of(found)
    most = max(resource.getrusage(who).ru_maxrss for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    before, after = answer["held_out"]["area_error_percent"]
    told = {row["key"]: row for row in answer["figures"] if row["told"]}
    hidden = {key: value for key, value in HIDDEN.items() if key in told}
    held = [key for key, value in hidden.items() if told[key]["lo"] <= value <= told[key]["hi"]]
    print(f"{seconds:.0f} s on {WORKERS} processes, {most / 1e6:.1f} GB the largest")
    print(f"held-out areas off by {before:.2f} % before, {after:.2f} % after; good: {answer['good']}")
    print(f"intervals hold {len(held)} of {len(hidden)} hidden figures that are determined, of {len(HIDDEN)}")


if __name__ == "__main__":
    main()
