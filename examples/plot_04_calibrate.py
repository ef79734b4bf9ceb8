"""
Calibrate a camera from its own pictures
========================================

The lens bends the image, so that a pixel far from the axis sees more of the glass than one in the middle. Frames of a
printed checkerboard give the distortion, a frame of a square gives the area of a pixel, and a contact off the axis is
then measured as rightly as one on it.
"""

import matplotlib.pyplot as plt
import numpy as np

import evanesce as ev

# %%
# A quarter of the resolution, and a board of 2.5 mm squares: quick, and still a hundred corners and more in a frame.

scene = ev.load("thesis").with_(card__checkerboard_side_mm=2.5, card__checkerboard_squares=(16, 13))
camera = ev.Camera(ev.coarser(scene, 4))

# %%
# The board is held at two tilts and lies flat once, with the LEDs off and under even illumination. Tilts both ways
# separate the focal length from the distance; the square lies flat on the glass.

poses = [
    ev.Pose(height=9.0, tilt_x_deg=16.0, tilt_y_deg=5.0, rotation_deg=4.0),
    ev.Pose(height=9.5, tilt_x_deg=-6.0, tilt_y_deg=-16.0, rotation_deg=-7.0),
    ev.Pose(rotation_deg=1.3),
]
boards = [camera.shoot_target("checkerboard", pose, seed=k, index=k) for k, pose in enumerate(poses)]
square = camera.shoot_target("square", seed=9)
calibration = ev.calibrate(boards, checker_side_mm=2.5, square=square)
print(f"k1, k2 = {calibration.distortion[:2].round(3)}, area of a pixel {calibration.mm2_per_px:.5f} mm2")
print(f"corners left out of the fit lie {calibration.details['grid_rms_px']:.2f} px from where it puts them")

# %%
# The camera is moved, so that a contact lies 13 mm off its axis. It is measured with the nominal area of a pixel, and
# undistorted by the calibration; the threshold is half of the contact's grey level.

off_axis = ev.Camera(camera.scene.with_(camera__centre_mm=(-11.0, -7.0)))
shot = off_axis.shoot(force_N=2.0, seed=1)
nominal = ev.measure(shot.frame, scale_mm2_per_px=shot.scale_mm2_per_px, threshold=0.4, min_blob_px=125)
calibrated = ev.measure(shot.frame, calibration=calibration, threshold=0.4, min_blob_px=125)
errors = {"nominal\nscale": ev.compare(nominal, shot), "calibrated": ev.compare(calibrated, shot)}

# %%
# Left: one of the boards with the corners that were found. Middle: the area of glass that each pixel sees, over that
# of a pixel on the axis. Right: error of the contact area.

figure, axes = plt.subplots(1, 3, figsize=(13, 4), width_ratios=(1.2, 1.4, 0.8), layout="constrained")
axes[0].imshow(boards[0], cmap="gray")
corners = np.array([(c["image_x_px"], c["image_y_px"]) for c in calibration.details["corners"] if c["view"] == 1])
axes[0].plot(*corners.T, "+", color="#ff8c1a", markersize=5)
axes[0].set(title="checkerboard and corners", xlabel="column [px]", ylabel="row [px]")
relative = shot.truth.pixel_area_mm2 / shot.scale_mm2_per_px
area = axes[1].contourf(relative, levels=np.arange(1.0, 1.85, 0.05), cmap="viridis", extend="max")
axes[1].contour(shot.truth.coverage, levels=[0.5], colors="white")
row, column = np.argwhere(shot.truth.mask).mean(axis=0)
axes[1].text(column, row - 45, "contact", color="white", ha="center")
axes[1].set(title="area of glass seen by a pixel", xlabel="column [px]", ylim=axes[0].get_ylim(), aspect="equal")
figure.colorbar(area, ax=axes[1], label="over a pixel on the axis [1]", shrink=0.8)
bars = axes[2].bar(list(errors), [e.error_percent for e in errors.values()], color=["#ff8c1a", "#3d7dca"], width=0.6)
axes[2].bar_label(bars, fmt="%+.1f %%", padding=3)
axes[2].axhline(0, color="k", linewidth=0.8)
axes[2].set(title="error of the area", ylabel="error [%]")
axes[2].margins(y=0.2)
plt.show()
