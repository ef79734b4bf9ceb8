"""How far H.264 moves the boundary of a drawn contact, against the law of the uncertainty budget: some six minutes.

    python benchmarks/codec_edges.py [--json FILE]

Six drawn contacts (tests/support/labs.py), smooth and ridged, sharp and blurred, bright and dim, are encoded at six
quantisers and measured with and without the codec. The budget's limit is CODEC_PX of
evanesce/measurement/uncertainty/components.py, by what a drawn sharp contact leaves of the frame at its edge.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import av
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from evanesce.measurement.refined.edge import EdgeSettings, coarse_mask, find_boundary, narrow_share
from evanesce.measurement.refined.light import tone_table
from evanesce.measurement.refined.plate import shoelace
from evanesce.measurement.refined.replica import replica
from evanesce.measurement.refined.synthesis import NARROW_SHARE, synthesised
from evanesce.measurement.uncertainty.components import CODEC_PX
from support.lab_boards import Board  # type: ignore[import-not-found]
from support.labs import Lab, Ridges, Rig, write_film  # type: ignore[import-not-found]

SETTINGS, TONE = EdgeSettings(), tone_table("bt709")
SMOOTH = Lab("smooth", (480, 360), 24.0, 800.0, (-0.12, 0.03), Board(15, 11, 1.0), True, 8.0, 0.9, 30, 12, 2, 100.0,
             0.25, (4.0, 0.7), (1.4, 5.0), ratio=0.9, noise=0.004, middle=(0.3, -0.2), seed=21)  # fmt: skip
LABS = (
    SMOOTH,
    replace(SMOOTH, name="ridged", ridges=Ridges(0.8, 0.6, 0.15, 4.0), seed=22),
    replace(SMOOTH, name="fine ridges", ridges=Ridges(0.5, 0.6, 0.15, 4.0), blur=1.1, seed=23),
    replace(SMOOTH, name="dim", ridges=Ridges(0.8, 0.55), step=0.12, blur=1.3, seed=24),
    replace(SMOOTH, name="noisy", noise=0.012, ridges=Ridges(0.7, 0.6, 0.1), seed=25),
    replace(SMOOTH, name="blurred", blur=1.8, seed=26),
)
QUANTISERS = (14, 18, 23, 28, 33, 38)
FRAMES = (4, 7, 11)


def read(image: np.ndarray, blur_px: float) -> tuple[float, float, float]:
    """Return area [px^2], perimeter [px] and what a drawn sharp contact leaves at the edge."""
    light = TONE[image] - np.percentile(TONE[image], 5)
    mask = coarse_mask(light, 0.01)
    assert mask is not None
    boundary, gain = find_boundary(light, mask, SETTINGS), 0.0
    if narrow_share(boundary, SETTINGS) > NARROW_SHARE:
        best = synthesised(light, boundary, blur_px, SETTINGS)
        boundary, left = best.boundary, best.residual
    else:
        again = replica(light, boundary, SETTINGS)
        assert again is not None
        gain, left = again.gain, again.residual
    area = abs(sum(shoelace(curve) for curve in boundary.contours)) / (1 + gain)
    return area, sum(float(np.linalg.norm(np.diff(c, axis=0), axis=1).sum()) for c in boundary.contours), left


def coded(frames: list[np.ndarray], quantiser: int) -> list[np.ndarray]:
    """Return the frames after the codec."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "film.mp4"
        write_film(path, frames, 30, quantiser)
        with av.open(str(path)) as container:
            return [picture.to_ndarray(format="rgb24")[..., 1] for picture in container.decode(video=0)]


def main() -> None:
    """Draw, encode, measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=Path)
    target, rows = parser.parse_args().json, []
    for lab in LABS:
        rig = Rig(lab)
        frames = [rig.frame(k) for k in range(lab.frames)]
        plain = {k: read(frames[k], lab.blur) for k in FRAMES}
        for quantiser in QUANTISERS:
            after = coded(frames, quantiser)
            for k in FRAMES:
                area, _, left = read(after[k], lab.blur)
                inwards = (plain[k][0] - area) / plain[k][1]
                limit = CODEC_PX[0] + CODEC_PX[1] * left**2
                rows.append({"lab": lab.name, "crf": quantiser, "frame": k, "inwards_px": inwards, "limit_px": limit})
            some = rows[-len(FRAMES) :]
            print(f"{lab.name:12s} crf {quantiser}  inwards {max(r['inwards_px'] for r in some):+.4f} px at most, limit"
                  f" {min(r['limit_px'] for r in some):.4f} px at least", flush=True)  # fmt: skip
    part = [row["inwards_px"] / row["limit_px"] for row in rows]
    moved = [row["inwards_px"] for row in rows]
    within = sum(0 <= p <= 1 for p in part)
    print(f"{len(rows)} frames: inwards {min(moved):+.4f} to {max(moved):+.4f} px; {within} between none and the limit,"
          f" at most {max(part):.2f} of it, median {np.median(part):.2f}")  # fmt: skip
    if target:
        target.write_text(json.dumps(rows, indent=1))


if __name__ == "__main__":
    main()
