"""The scalar fallback on a machine where no LLVM works: doctor, a small rendering and its measurement.

``DRJIT_LIBLLVM_PATH`` names a file that is not there, so that no libLLVM is found. Checks that doctor and provenance
name the scalar variant, that the frame is measured, and that light and area agree with those of llvm as far as the
noise of both allows.

    python .ci/scalar.py
"""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from evanesce.render.exr import LightFile, read_light

PX_PER_MM = 8.0
TRUE_AREA_MM2 = 18.785
"""Of the smooth finger of the scene thesis under 2 N, by Hertz's law."""

PATHS, PASSES = 128, 8
SIGMAS = 4.4
"""Two-sided probability of 1e-5 under the normal law."""

RENDER = [
    "render", "thesis", "--force", "2", "--spp", str(PATHS), "--passes", str(PASSES), "--variant", "auto",
    "--set", "camera.resolution_px=[240,180]", "--set", f"camera.scale_px_per_mm={PX_PER_MM}",
    "--set", "camera.pixel.pitch_um=11.3", "--set", "camera.exposure_ms=0.1",
]  # fmt: skip
MEASURE = ["--no-undistort", "--mm2-per-px", str(PX_PER_MM**-2), "--threshold", "0.15", "--min-blob", "100"]


def evanesce(folder: Path, arguments: list[str], **environ: str) -> str:
    """Run a command, with a cache of its own, and return what it prints."""
    given = {k: v for k, v in os.environ.items() if k != "DRJIT_LIBLLVM_PATH"}
    given |= {"EVANESCE_CACHE": str(folder / "cache")} | environ
    command = [sys.executable, "-m", "evanesce.cli", *arguments]
    done = subprocess.run(command, env=given, capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"{' '.join(arguments)}: exit code {done.returncode}\n{done.stdout}{done.stderr}"
    return done.stdout + done.stderr


def shot(folder: Path, seed: int, **environ: str) -> tuple[LightFile, dict[str, Any], float, str]:
    """Return light, provenance, measured area [mm^2] and messages of one rendering."""
    made, result = folder / "frames", folder / "measured.json"
    printed = evanesce(folder, [*RENDER, "--seed", str(seed), "--out", str(made)], **environ)
    evanesce(folder, ["measure", str(made / "frame_000000.png"), *MEASURE, "--json", str(result)], **environ)
    light = read_light(made / "light_000000.exr")
    measured = json.loads(result.read_text(encoding="utf-8"))
    return light, light.provenance, float(measured["frames"][0]["area_mm2"]), printed


def main() -> None:
    """Compare the fallback with llvm; fail by an assertion."""
    with tempfile.TemporaryDirectory() as name:
        folders = {family: Path(name) / family for family in ("scalar", "llvm")}
        for folder in folders.values():
            folder.mkdir()
        hidden = {"DRJIT_LIBLLVM_PATH": str(Path(name) / "libLLVM.so")}

        reported = folders["scalar"] / "doctor.json"
        evanesce(folders["scalar"], ["doctor", "--json", str(reported)], **hidden)
        report = json.loads(reported.read_text(encoding="utf-8"))
        assert report["auto"] == "scalar_rgb", report["auto"]
        assert any("no such file" in note and "libllvm19" in note for note in report["notes"]), report["notes"]

        slow, origin, slow_area, printed = shot(folders["scalar"], 1, **hidden)
        assert origin["name"] == "scalar_rgb", origin["name"]
        assert "using scalar" in printed, printed
        fast, origin, fast_area, _ = shot(folders["llvm"], 2)
        assert origin["name"] == "llvm_ad_mono", f"{origin['name']}: {origin['note']}"

    inside = slow.contact["mask"] > 0.999
    assert inside.sum() > 800, inside.sum()
    sums = [float(found.light.radiance[inside].sum()) for found in (slow, fast)]
    error = math.sqrt(sum(float(found.light.variance[inside].sum()) for found in (slow, fast)))
    assert error < 0.02 * sums[1], f"standard error {error / sums[1]:.3f} of the light: the comparison shows nothing"
    sigmas = (sums[0] - sums[1]) / error
    assert abs(sigmas) < SIGMAS, f"light inside the contact differs by {sigmas:.1f} standard errors"
    # Noise moves the outline by less than half a pixel.
    radius = math.sqrt(TRUE_AREA_MM2 / math.pi)
    strip = 2 * math.pi * radius * 0.5 / PX_PER_MM
    for area, other in ((slow_area, fast_area), (fast_area, slow_area)):
        assert abs(area - other) < strip, (slow_area, fast_area)
        assert abs(area - TRUE_AREA_MM2) < 3 * strip, (area, TRUE_AREA_MM2)
    print(
        f"scalar fallback: light over llvm's {sums[0] / sums[1]:.4f} ({sigmas:+.1f} standard errors), areas "
        f"{slow_area:.2f} and {fast_area:.2f} mm^2, true {TRUE_AREA_MM2} mm^2, {int(np.sum(inside))} pixels"
    )


if __name__ == "__main__":
    main()
