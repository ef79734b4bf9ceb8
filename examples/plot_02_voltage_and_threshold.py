"""
LED voltage and threshold: how wrong is the area?
=================================================

The contact grows brighter with the LEDs' voltage, while its true area stays. A threshold at a fixed grey level
therefore finds another boundary at each voltage. Which pairs of the two report the right area?
"""

import matplotlib.pyplot as plt
import numpy as np

import evanesce as ev

# %%
# Half the resolution is enough for an area, and four times as fast. Sizes that a measurement states in pixels are
# divided: 2000 px of minimum blob size become 500.

scene = ev.coarser(ev.load("thesis"), 2)
voltages_V = np.linspace(8.4, 10.2, 13)
thresholds = np.linspace(0.04, 0.8, 30)

# %%
# One press of 2 N at each voltage, measured at every threshold.

shots = [ev.Camera(scene.with_(leds__voltage_V=voltage)).shoot(force_N=2.0, seed=1) for voltage in voltages_V]
error_percent = np.full((len(thresholds), len(voltages_V)), np.nan)
for column, shot in enumerate(shots):
    for row, threshold in enumerate(thresholds):
        pipeline = ev.Pipeline(scale_mm2_per_px=shot.scale_mm2_per_px, threshold=threshold, min_blob_px=500)
        found = pipeline.measure(shot.frame)
        if found.pixels:
            error_percent[row, column] = 100 * (found.area_mm2 / shot.truth.area_mm2 - 1)

# %%
# Above: three of the frames. Below: the error of the area by voltage and threshold; grey where nothing is brighter
# than the threshold. On the black line the area is right: a higher voltage needs a higher threshold, until the frame
# saturates.

figure = plt.figure(figsize=(9, 8), layout="constrained")
grid = figure.add_gridspec(2, 3, height_ratios=(1, 1.5))
extent = ev.Camera(scene).extent_mm
for column, index in enumerate((1, 4, 10)):
    axis = figure.add_subplot(grid[0, column])
    axis.imshow(shots[index].frame, cmap="gray", vmin=0, vmax=255, extent=extent)
    axis.set(xlim=(-4, 4), ylim=(4, -4), xlabel="x [mm]", title=f"{voltages_V[index]:.2f} V")
    axis.set_ylabel("y [mm]" if column == 0 else "")
axis = figure.add_subplot(grid[1, :])
axis.set_facecolor("0.8")
levels = np.arange(-15, 15.5, 1)
filled = axis.contourf(voltages_V, thresholds, error_percent, levels, cmap="RdBu_r", extend="both")
lines = axis.contour(voltages_V, thresholds, error_percent, [-5, 5], colors="k", linewidths=0.7)
axis.clabel(lines, fmt="%+.0f %%", fontsize=9)
axis.contour(voltages_V, thresholds, error_percent, [0], colors="k", linewidths=2.2)
axis.set(xlabel="LED voltage [V]", ylabel="threshold [of full scale]", title="error of the measured area")
figure.colorbar(filled, ax=axis, label="error [%]")
plt.show()
