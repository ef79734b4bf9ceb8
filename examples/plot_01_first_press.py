"""
A first press: frame, truth and measured area
=============================================

A ridged silicone finger is pressed on the lit glass plate with 1.5 N. The camera below sees the light that couples
into the silicone where it touches; the measurement counts pixels brighter than a threshold. Because the simulation
knows where the finger touches, the measured area can be compared with the truth.
"""

import matplotlib.pyplot as plt
from matplotlib.colors import ListedColormap

import evanesce as ev

# %%
# A scene is data: plate, LEDs, finger, camera. ``with_`` returns a changed one, checked like a file; two underscores
# stand for the dot of a key, and the unit is part of the name. A table is replaced as a whole.

ridges = {"pattern": "loop", "pitch_um": 700, "width_um": 350, "height_um": 150, "orientation_deg": 70}
scene = ev.load("thesis_ridged").with_(leds__voltage_V=9.2, finger__ridges=ridges)

# %%
# A camera takes frames of the scene. ``shoot`` solves the contact, carries the light through plate, lens and sensor,
# and returns the frame with everything it came from.

camera = ev.Camera(scene)
shot = camera.shoot(force_N=1.5, seed=1)
print(shot, shot.frame.dtype)

# %%
# The measurement sees the frame alone. Without a calibration the frame is taken as it is, and each pixel counts the
# area that a pixel on the optical axis sees.

found = ev.measure(shot.frame, scale_mm2_per_px=shot.scale_mm2_per_px, threshold=0.15)
compared = ev.compare(found, shot)
print(f"true {shot.truth.area_mm2:.2f} mm2, measured {found.area_mm2:.2f} mm2 ({compared.error_percent:+.1f} %)")
print(f"boundary {1e3 * compared.displacement_mm.mean:.0f} um too far out on average")

# %%
# Left: the frame. Middle: the true contact pressure in the same pixels. Right: the true contact (blue) and what the
# threshold takes for contact around it (orange): it lies below half of the contact's light, so that every ridge is
# read too wide.

figure, axes = plt.subplots(1, 3, figsize=(11, 4), sharex=True, sharey=True, layout="constrained")
extent = camera.extent_mm
axes[0].imshow(shot.frame, cmap="gray", vmin=0, vmax=255, extent=extent)
axes[0].set_title("frame, 1.5 N at 9.2 V")
pressure = axes[1].imshow(1e3 * shot.truth.pressure_MPa, cmap="inferno", extent=extent)
axes[1].set_title("true contact pressure")
figure.colorbar(pressure, ax=axes[1], label="pressure [kPa]", shrink=0.75)
overlay = 1.0 * found.mask + shot.truth.mask
axes[2].imshow(overlay, cmap=ListedColormap(["black", "#ff8c1a", "#3d7dca"]), extent=extent)
axes[2].set_title(f"measured {found.area_mm2:.2f} mm², true {shot.truth.area_mm2:.2f} mm²")
for axis in axes:
    axis.set(xlim=(-3, 3), ylim=(3, -3), xlabel="x [mm]")
axes[0].set_ylabel("y [mm]")
plt.show()
