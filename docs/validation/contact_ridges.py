"""Ridged contacts: the first model beside the half-space solver. Prints the table and draws the picture of its page.

Run: ``python docs/validation/contact_ridges.py [--out docs/pictures/contact-ridges.png]``.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from evanesce.contact.analytic.hertz import hertz_contact
from evanesce.contact.halfspace.resolved import resolved_state
from evanesce.contact.ridges.heightmap import RidgeRow
from evanesce.contact.ridges.ridged import ridged_state
from evanesce.contact.solve import contact_state
from evanesce.core.states import PlateGrid
from evanesce.rig import load_scene

PATTERNS = ("parallel", "concentric", "loop", "whorl")


def fine_ridges() -> None:
    """Print how the two models part as the pitch grows against the radius of contact."""
    radius, modulus, force = 6.3, 0.47, 2.0
    grid = PlateGrid((640, 640), 0.0125)
    x, y = grid.x[None, :], grid.y[:, None]
    smooth = hertz_contact(force, radius, modulus)
    print("pitch/radius  height/pitch  area, first  half-space  difference")
    for pitch in (1.6, 0.8, 0.4, 0.2):
        for slope in (0.05, 0.09):
            row = RidgeRow("parallel", pitch, 0.45 * pitch, slope * pitch, 0.2)
            first = ridged_state(grid, (0.0, 0.0), smooth, row, modulus, law="first").nominal_contact_area
            heights = (x**2 + y**2) / (2 * radius) + row.heights(x, y)
            solved = resolved_state(grid, heights, modulus, force, law="halfspace").nominal_contact_area
            ratio = pitch / smooth.contact_radius
            print(f"{ratio:12.3f}  {slope:12.2f}  {first:11.3f}  {solved:10.3f}  {100 * (solved / first - 1):+9.2f} %")


def thesis_finger(out: Path) -> None:
    """Print areas of the thesis's ridged finger and draw pressure and both masks for each pattern, ridges raised."""
    print("pattern     height [um]  force [N]  smooth  first  half-space  [mm^2]")
    figure, axes = plt.subplots(len(PATTERNS), 3, figsize=(8, 10.5), constrained_layout=True)
    for line, pattern in zip(axes, PATTERNS, strict=True):
        for height, force in ((47.67, 1.0), (47.67, 5.0), (120.0, 1.0)):
            overrides = {
                "finger.ridges.pattern": pattern,
                "finger.ridges.height_um": height,
                "finger.ridges.orientation_deg": 65.0,
                "grid.samples": 640,
                "grid.size_mm": 10.0,
            }
            scene = load_scene("thesis_ridged", overrides)
            first = contact_state(scene, force)
            solved = contact_state(load_scene("thesis_ridged", overrides | {"contact.law": "halfspace"}), force)
            bare = hertz_contact(force, scene.finger.tip_radius_mm, float(solved.parameters["reduced_modulus_MPa"]))
            areas = np.pi * bare.contact_radius**2, first.nominal_contact_area, solved.nominal_contact_area
            print(f"{pattern:11s} {height:11.2f} {force:10.1f} " + "".join(f"{a:8.2f}" for a in areas))
        x0, x1, y0, y1 = solved.grid.extent
        pictures = (1e3 * solved.pressure, solved.contact_mask, first.contact_mask)
        titles = ("pressure [kPa], half-space", "contact, half-space", "contact, first model")
        for axis, picture, title in zip(line, pictures, titles, strict=True):
            axis.imshow(picture, extent=(x0, x1, y1, y0), cmap="viridis", interpolation="none")
            axis.set(xlim=(-3, 3), ylim=(3, -3), title=f"{pattern}: {title}" if axis is line[0] else title)
            axis.title.set_fontsize(8)
        figure.colorbar(line[0].images[0], ax=line[0], shrink=0.8)
    out.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(out, dpi=80)


def main() -> None:
    """Print both tables and draw the picture."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("docs/pictures/contact-ridges.png"))
    options = parser.parse_args()
    fine_ridges()
    thesis_finger(options.out)


if __name__ == "__main__":
    main()
