"""
The reference segmentation and the refined estimator
====================================================

The thesis's segmentation counts pixels above a fixed threshold. The refined estimator undoes the tone curve, looks for
the boundary half-way between the light on its two sides, to a fraction of a pixel, and carries it onto the glass point
by point. Both state a 95 % interval of the area.
"""

import matplotlib.pyplot as plt
import numpy as np

import evanesce as ev

scene = ev.load("thesis").with_(card__checkerboard_side_mm=2.0, card__checkerboard_squares=(20, 16))
camera = ev.Camera(ev.coarser(scene, 2))

# %%
# Calibrate with one flat board, whose corners do not determine the focal length: it is the one on the lens.

focal_px = scene.camera.lens.focal_length_mm * 1e3 / camera.scene.camera.pixel.pitch_um
board, square = camera.shoot_target("checkerboard"), camera.shoot_target("square")
calibration = ev.calibrate([board], checker_side_mm=2.0, square=square, expect_focal_px=focal_px)

# %%
# Two pipelines, made once and used for every frame.

pipelines = {
    "reference, threshold 0.15": ev.Pipeline(calibration=calibration, threshold=0.15, min_blob_px=500),
    "refined": ev.Pipeline(calibration=calibration, estimator="refined", finger="smooth"),
}
forces_N = np.array([0.25, 0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 5.0])
shots = [camera.shoot(force, seed=1, index=k) for k, force in enumerate(forces_N)]
found = {name: [pipeline.measure(shot.frame) for shot in shots] for name, pipeline in pipelines.items()}

# %%
# Left: the boundaries at the rim of a contact of 2 N. Right: error of the area (dots) and the interval in which the
# true area should lie (bars), relative to the truth. A bar that crosses zero holds the truth; the reference
# segmentation's is centred on the area corrected for the threshold, which is why its dots lie beside it.

shot, refined, reference = (values[4] for values in (shots, found["refined"], found["reference, threshold 0.15"]))
figure, (left, right) = plt.subplots(1, 2, figsize=(12, 4.8), width_ratios=(1, 1.5), layout="constrained")
left.imshow(shot.frame, cmap="gray", vmin=0, vmax=255)
left.contour(shot.truth.coverage, levels=[0.5], colors="#3d7dca", linewidths=3)
unrectified = ev.measure(shot.frame, scale_mm2_per_px=shot.scale_mm2_per_px, threshold=0.15, min_blob_px=500)
left.contour(unrectified.mask, levels=[0.5], colors="#ff8c1a", linewidths=1.5)
for contour in refined.contours_px:
    left.plot(*contour.T, color="#2ca02c", linewidth=2, linestyle=(0, (4, 4)))
x, y = shot.truth.mask.nonzero()[1].max(), shot.truth.mask.nonzero()[0].mean()
left.set(xlim=(x - 22, x + 8), ylim=(y + 15, y - 15), title="rim of the contact, 2 N", xlabel="column [px]")
left.set_ylabel("row [px]")
styles = (("#3d7dca", "-"), ("#ff8c1a", "-"), ("#2ca02c", "--"))
handles = [plt.Line2D([], [], color=colour, linestyle=style) for colour, style in styles]
left.legend(handles, ["true", "reference", "refined"], loc="lower left", frameon=True)
truth = np.array([shot.truth.area_mm2 for shot in shots])
for shift, colour, (name, measured) in zip((-0.02, 0.02), ("#ff8c1a", "#2ca02c"), found.items(), strict=True):
    area = np.array([m.area_mm2 for m in measured])
    low, high = np.array([m.interval_mm2 for m in measured]).T
    at = forces_N * (1 + shift)
    right.vlines(at, 100 * (low / truth - 1), 100 * (high / truth - 1), color=colour, linewidth=6, alpha=0.35)
    right.plot(at, 100 * (area / truth - 1), "o", color=colour, label=name)
right.axhline(0, color="k", linewidth=0.8)
right.set(xscale="log", xticks=forces_N, xticklabels=[f"{f:g}" for f in forces_N], xlabel="normal force [N]")
right.set(ylabel="error of the area [%]", title="measured area (dots) and 95 % interval (bars)")
right.minorticks_off()
right.legend(frameon=False)
plt.show()
